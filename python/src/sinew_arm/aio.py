"""The client of an arm for asyncio: as `Arm`, with everything that waits to be awaited."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, Callable, overload

from . import _line
from ._motion import Following, Track, Wait, check
from .client import AGAIN_S, ARMING, HOLDING, HOMING, STARTING, STOPPING, TRACKING, Arm
from .domain import Domain, no_daemon
from .errors import NoDaemonError, RefusedError, TimedOutError
from .paths import Path
from .payloads import Encoders, Obstacles, State, SupervisorState, Target, Tip

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from types import TracebackType

    from typing_extensions import Self

    from .sources import Seen, Source, Watch

_POLL_S = 1e-3
_LOOK_S = 1.0


class AsyncArm:
    """The daemon of one arm, for one event loop. An asynchronous context manager; closing it does not stop the arm.

    Arguments, results and exceptions are those of `Arm`.
    """

    def __init__(self, name: str = "paper", *, domain: Domain | None = None, timeout_s: float = 2.0) -> None:
        """Finds the daemon."""
        self._arm = Arm(name, domain=domain, timeout_s=timeout_s)
        self.name = name
        self.domain = self._arm.domain
        self.timeout_s = timeout_s

    def close(self) -> None:
        """Lets go of shared memory."""
        self._arm.close()

    async def __aenter__(self) -> Self:
        """The arm."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes it."""
        self.close()

    async def arm(self, *, wait_s: float | None = 60.0) -> SupervisorState:
        """Enables the drives and holds the pose."""
        deadline = time.monotonic() + (wait_s or 0.0)
        while True:
            try:
                mode = await self._ask("arm")
                break
            except RefusedError as error:
                if error.reason not in STARTING or time.monotonic() > deadline:
                    raise
                await asyncio.sleep(AGAIN_S)
        return mode if wait_s is None else await self._wait(ARMING, wait_s)

    @overload
    async def track(self, what: Path, *, source_id: int = 0x5059, approach_s: float = 4.0) -> Track: ...

    @overload
    async def track(self, what: Target | None = None) -> SupervisorState: ...

    async def track(
        self, what: Path | Target | None = None, *, source_id: int = 0x5059, approach_s: float = 4.0
    ) -> Track | SupervisorState:
        """Follows the target, a given one, or a path to its end."""
        if isinstance(what, Path):
            following = Following(what, approach_s)
            states = [state async for state in self._follow(following, source_id)]
            return Track.of(following.times_s, states)
        if what is not None:
            await self.set_target(what)
        await self._ask("track")
        return await self._wait(TRACKING, self.timeout_s + 10.0)

    def tracking(self, path: Path, *, source_id: int = 0x5059, approach_s: float = 4.0) -> AsyncIterator[State]:
        """Follows a path and gives every record meanwhile."""
        return self._follow(Following(path, approach_s), source_id)

    async def hold(self, *, wait_s: float | None = 10.0) -> SupervisorState:
        """Holds the present pose."""
        return await self._to("hold", HOLDING, wait_s)

    async def home(self, *, wait_s: float | None = 60.0) -> SupervisorState:
        """Goes to the home pose."""
        return await self._to("home", HOMING, wait_s)

    async def stop(self, *, wait_s: float | None = 180.0) -> SupervisorState:
        """Lowers the arm to rest, then disarms it."""
        return await self._to("stop", STOPPING, wait_s)

    async def disarm(self, *, wait_s: float | None = 60.0) -> SupervisorState:
        """Takes the torque off where the arm is."""
        return await self._to("disarm", STOPPING, wait_s)

    async def clear(self) -> SupervisorState:
        """Releases a latched fault whose cause is gone."""
        return await asyncio.to_thread(self._arm.clear)

    async def speed(self, scale: float) -> SupervisorState:
        """Moves at a share of the configured speed, 0.01 to 1."""
        return await asyncio.to_thread(self._arm.speed, scale)

    async def emergency_stop(self) -> SupervisorState:
        """Presses the operator's emergency stop, which stays pressed."""
        return await asyncio.to_thread(self._arm.emergency_stop)

    async def emergency_release(self) -> SupervisorState:
        """Releases it."""
        return await asyncio.to_thread(self._arm.emergency_release)

    async def set_target(self, target: Target) -> SupervisorState:
        """Gives the daemon a target."""
        return await asyncio.to_thread(self._arm.set_target, target)

    async def status(self) -> dict[str, Any]:
        """The daemon's report."""
        return await asyncio.to_thread(self._arm.status)

    async def states(self, *, timeout_s: float | None = None) -> AsyncIterator[State]:
        """Records of the loop."""
        port = self._arm.state_port()
        begin = looked = time.monotonic()
        self._arm.gate.done(self._arm.last_tick)
        while True:
            state = port.receive()
            now = time.monotonic()
            if state is not None:
                self._arm.last_tick = state.header.tick
                yield state
                self._arm.gate.done(self._arm.last_tick)
                begin = looked = time.monotonic()
                # Others have their turn, however fast records come.
                await asyncio.sleep(0)
                continue
            if now - looked > _LOOK_S:
                looked = now
                if not await asyncio.to_thread(_line.is_there, self.domain, self.name):
                    raise NoDaemonError(no_daemon(self.name))
            if timeout_s is not None and now - begin > timeout_s:
                raise TimedOutError(f'the daemon of arm "{self.name}" made no tick within {timeout_s} s')
            await asyncio.sleep(_POLL_S)

    async def state(self, *, timeout_s: float = 5.0) -> State:
        """The next record that was not seen yet, or the newest one."""
        async for state in self.states(timeout_s=timeout_s):
            return state
        raise AssertionError("states never end")

    def obstacles(self, source_id: int = 2, *, by: str | None = None) -> Source[Obstacles]:
        """A source of obstacles; sending never waits."""
        return self._arm.obstacles(source_id, by=by)

    def targets(self, source_id: int = 3, *, by: str | None = None) -> Source[Target]:
        """A source of targets."""
        return self._arm.targets(source_id, by=by)

    def encoders(self, source_id: int = 4) -> Source[Encoders]:
        """A source of cable lengths and tensions."""
        return self._arm.encoders(source_id)

    def tips(self, source_id: int = 5) -> Source[Tip]:
        """A source of measured positions of the tip."""
        return self._arm.tips(source_id)

    def watch(
        self,
        seen: Seen | Callable[[], Seen] = (),
        *,
        source_id: int = 1,
        rate_hz: float = 50.0,
        by: str | None = None,
    ) -> Watch:
        """Publishes what a source sees from a thread of its own: an ordinary context manager (`with`)."""
        return self._arm.watch(seen, source_id=source_id, rate_hz=rate_hz, by=by)

    async def _ask(self, line: str) -> SupervisorState:
        return SupervisorState(await asyncio.to_thread(_line.ask, self.domain, self.name, line, self.timeout_s))

    async def _to(self, line: str, wait: Wait, wait_s: float | None) -> SupervisorState:
        mode = await self._ask(line)
        return mode if wait_s is None else await self._wait(wait, wait_s)

    async def _check(self, state: State, wait: Wait) -> None:
        if wait.failed(state):
            check(state, wait, await asyncio.to_thread(self._arm.report))

    async def _wait(self, wait: Wait, wait_s: float) -> SupervisorState:
        wait = Wait(wait.goal, wait.on_the_way)
        deadline = time.monotonic() + wait_s
        async for state in self.states(timeout_s=wait_s):
            if wait.reached(state):
                return state.supervisor
            await self._check(state, wait)
            if time.monotonic() > deadline:
                raise TimedOutError(f"the arm is {state.supervisor}, not {wait.goal}, after {wait_s} s")
        raise AssertionError("states never end")

    async def _follow(self, following: Following, source_id: int) -> AsyncIterator[State]:
        await self.set_target(following.first())
        await self._ask("track")
        with self._arm.gate.closed(), self.targets(source_id) as source:
            async for state in self.states(timeout_s=30.0):
                await self._check(state, following.wait)
                now_s = following.now_s(state)
                if now_s is None:
                    continue
                point = following.due(now_s)
                if point is not None:
                    source.send(point, state.header.capture_ns)
                following.times_s.append(now_s)
                yield state
                if following.over(now_s):
                    break
        await self.set_target(following.last())
