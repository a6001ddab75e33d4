"""The blocking client of an arm."""

from __future__ import annotations

import json
import os
import time
from typing import TYPE_CHECKING, Any, Callable, TypeVar, Union, overload

from . import _line, _memory, _words
from ._motion import Following, Track, Wait, check
from .domain import Domain, no_daemon
from .errors import NoDaemonError, RefusedError, SinewError, TimedOutError
from .paths import Path
from .payloads import Encoders, Obstacles, RefusalReason, Request, Response, State, SupervisorState, Target, Tip
from .sources import Gate, Seen, Source, Watch

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType

    from typing_extensions import Self

_Message = TypeVar("_Message", bound=Union[Encoders, Obstacles, Target, Tip])

_POLL_S = 2e-4
_LOOK_S = 1.0

# What `arm` is refused for while a daemon, its drives or its sources still come up.
STARTING = (RefusalReason.DRIVES_NOT_READY, RefusalReason.NOT_SETTLED, RefusalReason.OBSTACLES_EXPIRED)
AGAIN_S = 0.05

ARMING = Wait(SupervisorState.HOLDING, (SupervisorState.ARMING,))
STOPPING = Wait(SupervisorState.DISARMED, (SupervisorState.STOPPING,))
HOMING = Wait(SupervisorState.HOLDING, (SupervisorState.HOMING,))
HOLDING = Wait(SupervisorState.HOLDING, ())
TRACKING = Wait(SupervisorState.TRACKING, ())


class Arm:
    """The daemon of one arm. A context manager; closing it does not stop the arm.

    Requests go over the arm's socket, as those of the command `sinew`: they need no part in shared memory, and what this
    user may do is in `[access]`. Records (`state`, `states`) come from shared memory, which is the daemon's user's.
    """

    def __init__(self, name: str = "paper", *, domain: Domain | None = None, timeout_s: float = 2.0) -> None:
        """Finds the daemon.

        Args:
            name: Name of the arm.
            domain: Where to look; default: as the environment says.
            timeout_s: Longest wait for an answer (s).

        Raises:
            NoDaemonError: None runs for the arm.

        """
        self.name = name
        self.domain = domain or Domain.from_env()
        self.timeout_s = timeout_s
        self._session: _memory.Session | None = None
        self._states: _memory.Subscriber[State] | None = None
        self._requests: _memory.Requester | None = None
        self.gate = Gate()
        self.last_tick: int | None = None
        _memory.quiet()
        _line.connect(self.domain, name, timeout_s).close()

    @classmethod
    def wait_for(cls, name: str = "paper", *, domain: Domain | None = None, timeout_s: float = 30.0) -> Arm:
        """The same as soon as a daemon runs.

        Raises:
            NoDaemonError: None has run within the time.

        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                return cls(name, domain=domain)
            except NoDaemonError:
                if time.monotonic() > deadline:
                    raise
            time.sleep(0.05)

    def close(self) -> None:
        """Lets go of shared memory."""
        for port in (self._states, self._requests, self._session):
            if port is not None:
                port.close()
        self._states = self._requests = self._session = None

    def __enter__(self) -> Self:
        """The arm."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes it."""
        self.close()

    # Requests. Each raises `RefusedError` with the daemon's reason, `NotPermittedError`, `NoDaemonError`, `TimedOutError`.

    def arm(self, *, wait_s: float | None = 60.0) -> SupervisorState:
        """Enables the drives and holds the pose; waits until it is held, or not at all with `wait_s=None`.

        Raises:
            RefusedError: The daemon does not; while it still starts, it is asked again.
            FaultError: A fault came in between.
            TimedOutError: It takes longer than `wait_s` (s).

        """
        deadline = time.monotonic() + (wait_s or 0.0)
        while True:
            try:
                mode = self._ask("arm")
                break
            except RefusedError as error:
                if error.reason not in STARTING or time.monotonic() > deadline:
                    raise
                time.sleep(AGAIN_S)
        return mode if wait_s is None else self._wait(ARMING, wait_s)

    @overload
    def track(self, what: Path, *, source_id: int = 0x5059, approach_s: float = 4.0) -> Track: ...

    @overload
    def track(self, what: Target | None = None) -> SupervisorState: ...

    def track(
        self, what: Path | Target | None = None, *, source_id: int = 0x5059, approach_s: float = 4.0
    ) -> Track | SupervisorState:
        """Follows the target, a given one, or a path to its end.

        Args:
            what: Nothing: the target that the daemon has. A target: it is given to the daemon, which keeps it. A path: the
                arm is brought to its first point, then along it; the last one is kept.
            source_id: Id under which a path is published.
            approach_s: Time of the arm for the way to a path's first point (s).

        Returns:
            What came of a path; otherwise the mode.

        Raises:
            FaultError: A fault came in between.
            InterruptedMotionError: The arm was asked for something else, or holds since it may not move.

        """
        if isinstance(what, Path):
            following = Following(what, approach_s)
            states = list(self._follow(following, source_id))
            return Track.of(following.times_s, states)
        if what is not None:
            self.set_target(what)
        self._ask("track")
        return self._wait(TRACKING, self.timeout_s + 10.0)

    def tracking(self, path: Path, *, source_id: int = 0x5059, approach_s: float = 4.0) -> Iterator[State]:
        """Follows a path as `track` does, and gives every record meanwhile. Leaving the loop leaves the arm tracking."""
        return self._follow(Following(path, approach_s), source_id)

    def hold(self, *, wait_s: float | None = 10.0) -> SupervisorState:
        """Holds the present pose."""
        mode = self._ask("hold")
        return mode if wait_s is None else self._wait(HOLDING, wait_s)

    def home(self, *, wait_s: float | None = 60.0) -> SupervisorState:
        """Goes to the home pose; waits until it is held there."""
        mode = self._ask("home")
        return mode if wait_s is None else self._wait(HOMING, wait_s)

    def stop(self, *, wait_s: float | None = 180.0) -> SupervisorState:
        """Lowers the arm to rest, then disarms it; waits until it is disarmed."""
        mode = self._ask("stop")
        return mode if wait_s is None else self._wait(STOPPING, wait_s)

    def disarm(self, *, wait_s: float | None = 60.0) -> SupervisorState:
        """Takes the torque off where the arm is; waits until it is disarmed."""
        mode = self._ask("disarm")
        return mode if wait_s is None else self._wait(STOPPING, wait_s)

    def clear(self) -> SupervisorState:
        """Releases a latched fault whose cause is gone, and forgets sources that are gone for good."""
        return self._ask("clear")

    def speed(self, scale: float) -> SupervisorState:
        """Moves at a share of the configured speed, 0.01 to 1, until the arm is disarmed.

        Raises:
            ValueError: Another number.

        """
        return self._ask(_words.speed_line(scale))

    def emergency_stop(self) -> SupervisorState:
        """Presses the operator's emergency stop, which stays pressed."""
        return self._ask("emergency-stop")

    def emergency_release(self) -> SupervisorState:
        """Releases it; the fault that it raised stays until it is cleared."""
        return self._ask("emergency-release")

    def set_target(self, target: Target) -> SupervisorState:
        """Gives the daemon a target, which it keeps until another comes."""
        return self._ask("target " + json.dumps(_words.target_fields(target, stamped=False)))

    def request(self, request: Request) -> Response:
        """Sends a request through shared memory and returns its answer, whatever it is."""
        if self._requests is None:
            self._requests = _memory.Requester(self._own_session())
        return self._requests.ask(request, self.timeout_s)

    def status(self) -> dict[str, Any]:
        """The daemon's report: the object of `sinew status --json`."""
        return dict(_line.report(self.domain, self.name, self.timeout_s))

    # Records.

    def states(self, *, timeout_s: float | None = None) -> Iterator[State]:
        """Records of the loop, the newest first of those that were not seen: a slow reader misses some, never lags.

        Args:
            timeout_s: Longest silence (s); default: as long as the daemon is there.

        Raises:
            NoDaemonError: The daemon has gone.
            TimedOutError: It was silent for too long.

        """
        port = self.state_port()
        while True:
            yield self._next(port, timeout_s)

    def state(self, *, timeout_s: float = 5.0) -> State:
        """The next record that was not seen yet, or the newest one.

        Raises:
            NoDaemonError: The daemon has gone.
            TimedOutError: There is none within the time (s).

        """
        return self._next(self.state_port(), timeout_s)

    # Sources.

    def obstacles(self, source_id: int = 2, *, by: str | None = None) -> Source[Obstacles]:
        """A source of obstacles under an id, which is its own over its restarts.

        `by` is `memory`, `socket`, or as this user may. To tell the same over and over see `watch`.
        """
        return self._source(Obstacles, source_id, by)

    def targets(self, source_id: int = 3, *, by: str | None = None) -> Source[Target]:
        """A source of targets, point by point; see `track` for a whole path."""
        return self._source(Target, source_id, by)

    def encoders(self, source_id: int = 4) -> Source[Encoders]:
        """A source of cable lengths and tensions, in place of the drives'."""
        return self._source(Encoders, source_id, "memory")

    def tips(self, source_id: int = 5) -> Source[Tip]:
        """A source of measured positions of the tip (m, base frame): a camera, a tracker."""
        return self._source(Tip, source_id, "memory")

    def watch(
        self,
        seen: Seen | Callable[[], Seen] = (),
        *,
        source_id: int = 1,
        rate_hz: float = 50.0,
        by: str | None = None,
    ) -> Watch:
        """Publishes what a source sees from a thread of its own, until it is closed.

        Args:
            seen: Obstacles, a set, or what gives either when it is called; nothing says that there is nothing to see.
            source_id: Id of the source.
            rate_hz: How often (1/s); in lockstep once for every tick.
            by: As for `obstacles`; in lockstep shared memory.

        """
        lockstep = bool(self.status().get("lockstep"))
        way = "memory" if lockstep else by or self._way()

        def make() -> tuple[Source[Obstacles], _memory.Subscriber[State] | None, Callable[[], None]]:
            # Ports belong to the thread that uses them.
            session = _memory.Session(self.domain, self.name) if way == "memory" else None
            source = Source(self.domain, self.name, Obstacles, source_id, session=session, timeout_s=self.timeout_s)
            states = _memory.Subscriber(session, State) if lockstep and session is not None else None

            def done() -> None:
                for port in (states, session):
                    if port is not None:
                        port.close()

            return source, states, done

        return Watch(make, lambda: _line.is_there(self.domain, self.name), seen, 1.0 / rate_hz, self.gate)

    # Inside.

    def _ask(self, line: str) -> SupervisorState:
        mode = _line.ask(self.domain, self.name, line, self.timeout_s)
        return SupervisorState(mode)

    def _own_session(self) -> _memory.Session:
        if self._session is None:
            self._session = _memory.Session(self.domain, self.name)
        return self._session

    def _way(self) -> str:
        return "memory" if _line.user(self.domain, self.name) == os.geteuid() else "socket"

    def _source(self, kind: type[_Message], source_id: int, by: str | None) -> Source[_Message]:
        way = by or self._way()
        if way not in ("memory", "socket"):
            raise ValueError(f"by: {by!r}, expected memory or socket")
        session = self._own_session() if way == "memory" else None
        return Source(self.domain, self.name, kind, source_id, session=session, timeout_s=self.timeout_s)

    def state_port(self) -> _memory.Subscriber[State]:
        """The port by which records come."""
        if self._states is None:
            self._states = _memory.Subscriber(self._own_session(), State)
        return self._states

    def _next(self, port: _memory.Subscriber[State], timeout_s: float | None) -> State:
        begin = looked = time.monotonic()
        self.gate.done(self.last_tick)
        while (state := port.receive()) is None:
            now = time.monotonic()
            if now - looked > _LOOK_S:
                looked = now
                if not _line.is_there(self.domain, self.name):
                    raise NoDaemonError(no_daemon(self.name))
            if timeout_s is not None and now - begin > timeout_s:
                raise TimedOutError(f'the daemon of arm "{self.name}" made no tick within {timeout_s} s')
            time.sleep(_POLL_S)
        self.last_tick = state.header.tick
        return state

    def report(self) -> dict[str, Any] | None:
        """The daemon's report where it can be had: `None` for whom it does not answer."""
        try:
            return self.status()
        except SinewError:
            return None

    def _check(self, state: State, wait: Wait) -> None:
        if wait.failed(state):
            check(state, wait, self.report())

    def _wait(self, wait: Wait, wait_s: float) -> SupervisorState:
        wait = Wait(wait.goal, wait.on_the_way)
        deadline = time.monotonic() + wait_s
        for state in self.states(timeout_s=wait_s):
            if wait.reached(state):
                return state.supervisor
            self._check(state, wait)
            if time.monotonic() > deadline:
                raise TimedOutError(f"the arm is {state.supervisor}, not {wait.goal}, after {wait_s} s")
        raise AssertionError("states never end")

    def _follow(self, following: Following, source_id: int) -> Iterator[State]:
        self.set_target(following.first())
        self._ask("track")
        with self.gate.closed(), self.targets(source_id) as source:
            for state in self.states(timeout_s=30.0):
                self._check(state, following.wait)
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
        self.set_target(following.last())
