"""The client against the real daemon and a simulated arm."""

from __future__ import annotations

import asyncio
import fcntl
import shutil
import subprocess
import sys
import time
from pathlib import Path as FilePath

import numpy as np
import pytest

import sinew_arm as sinew
from conftest import CONFIG, Start
from sinew_arm import (
    Arm,
    AsyncArm,
    Domain,
    FaultError,
    InterruptedMotionError,
    NoDaemonError,
    NotPermittedError,
    Path,
    RefusedError,
    RejectedError,
    RequestKind,
    SimulatedArm,
    SupervisorState,
    TimedOutError,
    Watch,
)
from sinew_arm.payloads import ObstacleKind, RefusalReason, RejectCause, SourceHealth, Verdict

HANGING = (2**-0.5, 0.0, 2**-0.5, 0.0)
BELOW = np.array([0.0, 0.0, -2.75])


def bow(sideways_m: float = 0.15, duration_s: float = 3.0) -> Path:
    """To the side and back, from where the arm hangs."""
    times = np.linspace(0, duration_s, 31)
    away = np.sin(np.pi * times / duration_s) ** 2
    return Path.of_tip(times, BELOW + np.outer(away, [sideways_m, 0.0, 0.02]), HANGING)


def until(arm: Arm, mode: SupervisorState) -> sinew.State:
    for state in arm.states(timeout_s=10):
        if state.supervisor is mode:
            return state
    raise AssertionError


def clear(arm: Arm) -> None:
    """Clears, as soon as the tensions are where they are safe."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            arm.clear()
            return
        except RefusedError as error:
            if "in a moment" not in str(error):
                raise
            time.sleep(0.05)
    raise AssertionError


def test_an_arm_is_armed_follows_a_path_holds_fails_and_is_cleared(arm: Arm, watch: Watch) -> None:
    assert arm.arm() is SupervisorState.HOLDING
    track = arm.track(bow(), approach_s=1.0)
    rows = len(track.times_s)
    assert track.tension_n.shape == (rows, 24)
    assert track.tip_position_m.shape == track.target_position_m.shape == (rows, 3)
    assert track.curvature_1pm.shape == (rows, 8)
    assert track.times_s[0] < -0.9
    assert track.times_s[-1] >= 3.0
    # It went where it was asked to, and back.
    assert track.target_position_m[:, 0].max() == pytest.approx(0.15, abs=0.005)
    assert track.tip_position_m[:, 0].max() == pytest.approx(0.15, abs=0.03)
    assert np.abs(track.tip_position_m[-1] - BELOW).max() < 0.05
    assert np.nanmax(track.tip_error_m) < 0.05
    assert arm.hold() is SupervisorState.HOLDING
    with pytest.raises(FaultError, match="emergency") as caught:  # noqa: PT012 - it is told at one of the next records
        for count, _ in enumerate(arm.tracking(bow())):
            if count == 10:
                arm.emergency_stop()
    state = until(arm, SupervisorState.FAULTED)
    assert state.fault_code != 0
    assert caught.value.code == state.fault_code
    assert caught.value.clears
    with pytest.raises(RefusedError) as refused:
        arm.track()
    assert refused.value.reason is RefusalReason.FAULTED
    assert refused.value.fault_code == state.fault_code
    arm.emergency_release()
    clear(arm)
    assert until(arm, SupervisorState.DISARMED).fault_code == 0
    watch.check()


def test_refusals_carry_the_reason_and_the_words_of_the_daemon(arm: Arm, watch: Watch) -> None:
    with pytest.raises(RefusedError, match="disarmed") as refused:
        arm.track()
    assert refused.value.asked == "track"
    assert refused.value.supervisor is SupervisorState.DISARMED
    arm.arm()
    with pytest.raises(RefusedError, match="no fresh target") as refused:
        arm.track()
    assert refused.value.reason is RefusalReason.NO_TARGET
    with pytest.raises(RefusedError) as refused:
        arm.set_target(sinew.shape_target(np.zeros((3, 2))))
    assert refused.value.reason is RefusalReason.BAD_TARGET
    assert refused.value.cause is RejectCause.WRONG_COUNT
    with pytest.raises(ValueError, match=r"0\.01 to 1"):
        arm.speed(2.0)
    watch.check()


def test_a_speed_is_asked_for_and_told(arm: Arm, watch: Watch) -> None:
    arm.arm()
    arm.speed(0.25)
    assert arm.status()["speed_scale"] == 0.25
    for state in arm.states(timeout_s=5):
        if state.speed_scale == 0.25:
            break
    watch.check()


def test_a_target_is_followed_and_a_shape_too(arm: Arm, watch: Watch) -> None:
    arm.arm()
    curvatures = np.zeros((4, 2))
    curvatures[3, 0] = 0.3
    assert arm.track(sinew.shape_target(curvatures)) is SupervisorState.TRACKING
    for state in arm.states(timeout_s=20):
        if abs(state.curvature_1pm[6] - 0.3) < 0.02:
            break
    track = arm.track(Path.of_shape([0, 2], np.stack([curvatures, 0 * curvatures])), approach_s=0.5)
    assert np.isnan(track.tip_error_m).all()
    assert abs(track.curvature_1pm[-1, 6]) < 0.1
    assert np.nanmax(track.curvature_error_1pm) < 0.2
    assert arm.home() is SupervisorState.HOLDING
    assert arm.stop() is SupervisorState.DISARMED
    watch.check()


def test_whoever_is_stopped_by_somebody_else_is_told(arm: Arm, watch: Watch) -> None:
    arm.arm()
    with Arm(arm.name, domain=arm.domain) as other:
        words = "the arm is holding, not tracking"
        with pytest.raises(InterruptedMotionError, match=words) as caught:  # noqa: PT012 - at one of the next records
            for count, _ in enumerate(arm.tracking(bow(duration_s=200.0))):
                if count == 5:
                    other.hold(wait_s=None)
    assert caught.value.supervisor is SupervisorState.HOLDING
    watch.check()


def test_in_lockstep_time_waits_for_who_follows_a_path(arm: Arm, watch: Watch) -> None:
    arm.arm()
    ticks = []
    for state in arm.tracking(bow(duration_s=1.0), approach_s=0.0):
        ticks.append(state.header.tick)
        if len(ticks) == 10:
            # Arm time of many seconds, if it did not wait.
            time.sleep(1.0)
        if len(ticks) == 20:
            # Who waits for a mode in the loop's body is not waited for.
            assert arm.speed(1.0) is SupervisorState.TRACKING
            later = arm.state().header.tick
            assert later > state.header.tick
            ticks.append(later)
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
    assert len(ticks) > 100
    # Nobody is waited for any more.
    before = arm.state().header.tick
    time.sleep(0.5)
    assert arm.state().header.tick > before + 10
    watch.check()


def test_obstacles_arrive_as_they_were_sent(arm: Arm, watch: Watch) -> None:
    ball = sinew.ball(7, (0.5, 0.0, -1.0), 0.1)
    wall = sinew.half_space(8, (-2.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    watch.show([ball, wall])
    for state in arm.states(timeout_s=10):
        if len(state.distances) == 2:
            break
    distances = {d.obstacle_id: d.surface_distance_m for d in state.distances}
    assert {d.source_id for d in state.distances} == {1}
    # The arm hangs on the z axis: the paper's arm is a curve.
    assert distances[7] == pytest.approx(0.4, abs=1e-3)
    assert distances[8] == pytest.approx(2.0, abs=1e-3)
    report = state.obstacle_sources[0]
    assert (report.source_id, report.health) == (1, SourceHealth.FRESH)
    assert report.rejected.sum() == 0
    watch.check()


def test_what_is_called_for_obstacles_may_fail_and_tells(arm: Arm) -> None:
    def blind() -> list[sinew.Obstacle]:
        raise RuntimeError("no picture")

    with pytest.raises(RuntimeError, match="no picture"):
        arm.watch(blind)


def test_a_source_by_the_socket_is_told_what_is_wrong_with_its_sets(start: Start) -> None:
    simulated = start(watched_by=None)
    with Arm(simulated.name, domain=simulated.domain) as arm, arm.obstacles(5, by="socket") as source:
        now = arm.state().header.capture_ns
        source.send(sinew.obstacle_set([sinew.capsule(1, (1, 0, 0), (1, 0, -1), 0.1)]), now)
        for state in arm.states(timeout_s=10):
            if state.distances:
                break
        assert state.distances[0].surface_distance_m == pytest.approx(0.9, abs=1e-3)
        wrong = sinew.ball(1, (1, 0, 0), -1.0)
        with pytest.raises(RejectedError, match="dimension"):  # noqa: PT012 - it is told at one of the next ones
            for _ in range(500):
                source.send(sinew.obstacle_set([wrong]), arm.state().header.capture_ns)
                time.sleep(0.01)


def test_a_source_in_shared_memory_is_told_by_the_records(start: Start) -> None:
    simulated = start(watched_by=None)
    with Arm(simulated.name, domain=simulated.domain) as arm, arm.obstacles(5, by="memory") as source:
        box = sinew.box(3, (1.0, 0.0, -1.0), (0.1, 0.1, 0.1))
        box.kind = 99
        source.send(sinew.obstacle_set([box]), arm.state().header.capture_ns)
        for state in arm.states(timeout_s=10):
            reports = {report.source_id: report for report in state.obstacle_sources}
            if 5 in reports and reports[5].rejected.any():
                break
        assert reports[5].rejected[RejectCause.UNKNOWN_KIND] == 1
        box.kind = ObstacleKind.BOX
        source.send(sinew.obstacle_set([box]), arm.state().header.capture_ns)
        for state in arm.states(timeout_s=10):
            if state.distances:
                break
        assert state.distances[0].surface_distance_m == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("way", ["memory", "socket"])
def test_targets_come_point_by_point(arm: Arm, watch: Watch, way: str) -> None:
    arm.arm()
    with arm.targets(21, by=way) as source:
        for state in arm.states(timeout_s=10):
            source.send(sinew.tip_target((0.0, 0.0, -2.74), HANGING), state.header.capture_ns)
            if state.target_report.accepted > 10:
                break
    assert state.target_report.source_id == 21
    # In lockstep the loop may run ahead of whoever computes: what was told last is held then.
    assert state.target_report.health in (SourceHealth.FRESH, SourceHealth.HELD)
    assert state.target_report.rejected.sum() == 0
    watch.check()


def test_encoders_of_another_than_the_drives_are_not_taken(arm: Arm, watch: Watch) -> None:
    with arm.encoders(31) as source:
        before = arm.state()
        source.send(sinew.encoder_state(np.ones(24)), before.header.capture_ns)
        for state in arm.states(timeout_s=10):
            if state.encoder_report.rejected.any():
                break
    assert state.encoder_report.rejected[RejectCause.TOO_MANY_SOURCES] == 1
    watch.check()


def test_a_measured_tip_is_told_with_what_the_estimate_lacks(arm: Arm, watch: Watch) -> None:
    arm.arm()
    with arm.tips(32) as source:
        for state in arm.states(timeout_s=10):
            source.send(sinew.measured_tip(state.tip_position_m + np.array([0.02, 0, 0])), state.header.capture_ns)
            if state.tip_bias_m[0] > 1e-3:
                break
    assert state.tip_report.source_id == 32
    assert state.tip_measured_m[0] == pytest.approx(state.tip_position_m[0] + 0.02, abs=5e-3)
    assert np.abs(state.tip_bias_m[1:]).max() < 1e-3
    watch.check()


def test_requests_go_through_shared_memory_too(arm: Arm, watch: Watch) -> None:
    answer = arm.request(sinew.request(RequestKind.STATUS))
    assert (answer.verdict, answer.supervisor) == (Verdict.ACCEPTED, SupervisorState.DISARMED)
    answer = arm.request(sinew.request(RequestKind.TRACK))
    assert answer.verdict is Verdict.REFUSED
    assert answer.reason is not RefusalReason.NONE
    assert answer.text
    answer = arm.request(sinew.request(RequestKind.SPEED, speed_scale=7.0))
    assert answer.reason is RefusalReason.BAD_SPEED
    watch.check()


def test_records_count_on_and_silence_is_told(arm: Arm) -> None:
    with pytest.raises(TimedOutError, match=r"no tick within 0\.3 s"):
        # Nobody watches: the first tick waits.
        arm.state(timeout_s=0.3)
    with arm.watch():
        states = [state for state, _ in zip(arm.states(timeout_s=5), range(20))]
    ticks = [state.header.tick for state in states]
    assert ticks == sorted(set(ticks))
    assert states[0].cable_count == 24
    assert states[-1].node_position_m.shape == (20, 3)
    assert states[-1].node_position_m[-1] == pytest.approx(states[-1].tip_position_m)


def test_a_daemon_that_ends_is_told(simulated: SimulatedArm, arm: Arm) -> None:
    watch = arm.watch()
    arm.state()
    assert simulated.end_daemon() == 0
    with pytest.raises(NoDaemonError, match="no daemon running"):
        for _ in arm.states():
            pass
    watch.close()
    with pytest.raises(NoDaemonError, match="has gone"):
        watch.check()
    with pytest.raises(NoDaemonError):
        arm.status()
    with pytest.raises(NoDaemonError):
        Arm(simulated.name, domain=simulated.domain)


def test_where_no_daemon_is_that_is_said(tmp_path: FilePath) -> None:
    nowhere = Domain("sinewpynone_", f"{tmp_path}/ipc/", str(tmp_path))
    with pytest.raises(NoDaemonError, match='no daemon running for arm "other"'):
        Arm("other", domain=nowhere)
    with pytest.raises(NoDaemonError):
        Arm.wait_for("other", domain=nowhere, timeout_s=0.2)


def test_folders_of_others_are_not_trusted(simulated: SimulatedArm, tmp_path: FilePath) -> None:
    assert simulated.domain.run_dir is not None
    run_dir = FilePath(simulated.domain.run_dir)
    (tmp_path / "link").symlink_to(run_dir)
    linked = Domain(simulated.domain.prefix, simulated.domain.root, str(tmp_path / "link"))
    with pytest.raises(NotPermittedError, match="symbolic link"):
        Arm(simulated.name, domain=linked)
    run_dir.chmod(0o777)
    with pytest.raises(NotPermittedError, match="others may write to it"):
        Arm(simulated.name, domain=simulated.domain)


def test_shared_memory_of_others_is_not_touched(simulated: SimulatedArm) -> None:
    FilePath(simulated.domain.root).chmod(0o777)
    with Arm(simulated.name, domain=simulated.domain) as arm:
        assert arm.status()["arm"] == "paper"
        with pytest.raises(NotPermittedError, match="use the socket"):
            arm.state()


def test_who_has_the_turn_is_waited_for_and_not_for_ever(simulated: SimulatedArm) -> None:
    assert simulated.domain.run_dir is not None
    with (
        Arm(simulated.name, domain=simulated.domain) as arm,
        FilePath(simulated.domain.run_dir, "turn").open("w") as turn,
    ):
        fcntl.flock(turn, fcntl.LOCK_EX)
        begin = time.monotonic()
        with pytest.raises(TimedOutError):
            arm.state(timeout_s=0.01)
        assert 0.5 <= time.monotonic() - begin < 5


def test_the_same_in_an_event_loop(simulated: SimulatedArm) -> None:
    async def drive() -> tuple[sinew.Track, int]:
        async with AsyncArm(simulated.name, domain=simulated.domain) as arm:
            with arm.watch():
                assert (await arm.status())["mode"] == "disarmed"
                assert await arm.arm() is SupervisorState.HOLDING
                beats = 0

                async def beat() -> None:
                    nonlocal beats
                    while True:
                        beats += 1
                        await asyncio.sleep(0.001)

                other = asyncio.ensure_future(beat())
                track = await arm.track(bow(), approach_s=1.0)
                other.cancel()
                assert await arm.hold() is SupervisorState.HOLDING
                ticks = []
                async for state in arm.tracking(bow(duration_s=0.5), approach_s=0.0):
                    ticks.append(state.header.tick)
                    if len(ticks) == 10:
                        await asyncio.sleep(0.5)
                        ticks.append((await arm.state()).header.tick)
                assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
                with pytest.raises(FaultError, match="emergency"):  # noqa: PT012 - it is told at one of the next records
                    pressed = False
                    async for _ in arm.tracking(bow()):
                        if not pressed:
                            pressed = True
                            await arm.emergency_stop()
                await arm.emergency_release()
                return track, beats

    track, beats = asyncio.run(drive())
    assert track.target_position_m[:, 0].max() == pytest.approx(0.15, abs=0.005)
    # Others had their turn meanwhile.
    assert beats > 50


def test_an_event_loop_is_told_of_silence_and_of_the_end(simulated: SimulatedArm) -> None:
    async def drive() -> None:
        async with AsyncArm(simulated.name, domain=simulated.domain) as arm:
            with pytest.raises(TimedOutError):
                await arm.state(timeout_s=0.2)
            watch = arm.watch()
            await arm.state()
            await asyncio.to_thread(simulated.end_daemon)
            with pytest.raises(NoDaemonError):
                async for _ in arm.states():
                    pass
            watch.close()

    asyncio.run(drive())


def test_in_real_time_a_watch_keeps_the_arm_awake(start: Start) -> None:
    simulated = start(lockstep=False)
    with Arm(simulated.name, domain=simulated.domain) as arm:
        with pytest.raises(RefusedError) as refused:
            arm.arm(wait_s=None)
        assert refused.value.reason in (RefusalReason.OBSTACLES_EXPIRED, RefusalReason.DRIVES_NOT_READY)
        with arm.watch(lambda: [sinew.ball(1, (0.6, 0.0, -1.0), 0.1)], source_id=2):
            assert arm.arm() is SupervisorState.HOLDING
            state = arm.state()
            reports = {report.source_id: report for report in state.obstacle_sources}
            assert reports[2].health is SourceHealth.FRESH
        arm.disarm()


ORPHAN = """
import os, sys, time
from pathlib import Path
from sinew_arm import SimulatedArm

arm = SimulatedArm([Path(name) for name in sys.argv[1:]])
print(arm.folder, *(process.pid for _, process, _ in arm._processes), flush=True)
os.kill(os.getpid(), 9)
"""


def test_a_simulated_arm_ends_with_its_starter_and_leaves_nothing(simulated: SimulatedArm) -> None:
    command = [sys.executable, "-c", ORPHAN, *map(str, CONFIG)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    folder, *pids = ran.stdout.split()
    assert len(pids) == 2, ran.stderr
    deadline = time.monotonic() + 10
    while any(FilePath("/proc", pid).exists() for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    shutil.rmtree(folder)

    def left(place: FilePath) -> list[FilePath]:
        return [path for path in FilePath("/dev/shm").iterdir() if place.name[len("sinew-py-") :] in path.name]

    # Nobody was left to remove it.
    for path in left(FilePath(folder)):
        path.unlink()
    assert left(simulated.folder)
    simulated.close()
    assert not left(simulated.folder)
    assert not simulated.folder.exists()
