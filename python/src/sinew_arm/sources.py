"""Sources of inputs: what perception, tasks and sensors publish."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Callable, Generic, TypeVar, Union, cast

from . import _line, _memory, _words
from .errors import NoDaemonError, SinewError
from .messages import obstacle_set
from .payloads import FLAG_LEAVING, NO_TICK, Encoders, Obstacle, Obstacles, State, Target, Tip

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

    from .domain import Domain

_Message = TypeVar("_Message", bound=Union[Encoders, Obstacles, Target, Tip])

Seen = Union[Obstacles, Sequence[Obstacle]]
"""What a source sees: a set, or a list of obstacles."""

_POLL_S = 2e-4
_LOOK_S = 1.0
_GLANCE_S = 0.1


class Source(Generic[_Message]):
    """One source of inputs under an id of its own, by shared memory or by the arm's socket. A context manager.

    An id belongs to the process that was accepted under it first.
    """

    def __init__(
        self,
        domain: Domain,
        arm: str,
        kind: type[_Message],
        source_id: int,
        *,
        session: _memory.Session | None,
        timeout_s: float,
    ) -> None:
        """Opens the way; made by `Arm`. Without a session it is the socket."""
        self.source_id = source_id
        self._kind: type[_Message] = kind
        self._newest_ns = 0
        self._publisher: _memory.Publisher[_Message] | None = None
        self._stream: _line.Stream | None = None
        if session is not None:
            self._publisher = _memory.Publisher(session, kind, source_id)
        elif kind in (Encoders, Tip):
            raise SinewError("what sensors measure goes through shared memory alone: run this as the daemon's user")
        else:
            what = "obstacles" if kind is Obstacles else "targets"
            self._stream = _line.Stream(domain, arm, what, source_id, timeout_s)

    def send(self, message: _Message, capture_ns: int | None = None, tick: int = NO_TICK) -> None:
        """Publishes; never waits for the daemon.

        Args:
            message: What is published; its header is filled in here.
            capture_ns: When the content was measured (ns, CLOCK_MONOTONIC); default: now.
            tick: In lockstep alone: the tick that it is for.

        Raises:
            RejectedError: By the socket: the daemon does not take over what was sent before. Through shared memory
                `State.obstacle_sources` tells.
            NoDaemonError: By the socket: the daemon has gone.

        """
        captured = _memory.monotonic_ns() if capture_ns is None else capture_ns
        self._newest_ns = max(captured, self._newest_ns)
        if self._publisher is not None:
            self._publisher.send(message, captured, tick)
        elif self._stream is not None:
            message.header.capture_ns = captured
            message.header.tick = tick
            self._stream.send(_fields(message))
        else:
            raise SinewError("the source is closed")

    def close(self) -> None:
        """Leaves in order: nobody misses the source from now on."""
        farewell = self._kind()
        if isinstance(farewell, Obstacles) and not (self._publisher is None and self._stream is None):
            farewell.flags = FLAG_LEAVING
            # A daemon that has gone, or hears nothing of this source, does not miss it.
            with contextlib.suppress(SinewError):
                # As old as what was sent last: in lockstep time is the daemon's own.
                self.send(cast("_Message", farewell), self._newest_ns or None)
        for way in (self._publisher, self._stream):
            if way is not None:
                way.close()
        self._publisher = self._stream = None

    def __enter__(self) -> Self:
        """The source."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes it."""
        self.close()


def _fields(message: Any) -> dict[str, Any]:
    return (
        _words.obstacle_fields(message)
        if isinstance(message, Obstacles)
        else _words.target_fields(message, stamped=True)
    )


class Gate:
    """In lockstep: a source lets the next tick begin once a loop that follows a path has done with the one before."""

    def __init__(self) -> None:
        """Open."""
        self._changed = threading.Condition()
        self._followers = 0
        self._done: int | None = None

    @contextlib.contextmanager
    def closed(self) -> Iterator[None]:
        """Ticks wait for `done`."""
        with self._changed:
            self._followers += 1
            self._done = None
        try:
            yield
        finally:
            with self._changed:
                self._followers -= 1
                self._changed.notify_all()

    def done(self, tick: int | None) -> None:
        """All is done with the record of a tick."""
        with self._changed:
            self._done = tick
            self._changed.notify_all()

    def wait(self, tick: int) -> bool:
        """Waits a moment until all is done with the record of a tick; whether it is."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._followers == 0 or self._done is None or self._done >= tick, _GLANCE_S
            )


class Watch:
    """Publishes what a source sees, over and over, from a thread of its own. A context manager.

    A source that is silent is blind, and an arm does not move where nobody looks: so what is seen is told again and again,
    many times a second, or in lockstep once for every tick.
    """

    def __init__(
        self,
        make: Callable[[], tuple[Source[Obstacles], _memory.Subscriber[State] | None, Callable[[], None]]],
        there: Callable[[], bool],
        seen: Seen | Callable[[], Seen],
        period_s: float,
        gate: Gate,
    ) -> None:
        """Made by `Arm.watch`."""
        self._gate = gate
        self._make = make
        self._there = there
        self._seen = seen
        self._period_s = period_s
        self._end = threading.Event()
        self._ready = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="sinew watch", daemon=True)
        self._thread.start()
        self._ready.wait()
        self.check()

    def show(self, seen: Seen) -> None:
        """What the source sees from now on."""
        self._seen = seen

    def check(self) -> None:
        """Raises what went wrong in the thread, once."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> None:
        """Ends the thread, and leaves in order."""
        self._end.set()
        self._thread.join()

    def __enter__(self) -> Self:
        """The watch."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes it, and raises what went wrong in the thread unless something else is on its way."""
        self.close()
        if error is None:
            self.check()

    def _set(self) -> Obstacles:
        seen = self._seen() if callable(self._seen) else self._seen
        return seen if isinstance(seen, Obstacles) else obstacle_set(seen)

    def _run(self) -> None:
        try:
            source, states, done = self._make()
            try:
                with source:
                    if states is None:
                        self._in_real_time(source)
                    else:
                        self._in_lockstep(source, states)
            finally:
                done()
        except BaseException as error:  # noqa: BLE001 - raised where it is looked at
            self._error = error
        finally:
            self._ready.set()

    def _in_real_time(self, source: Source[Obstacles]) -> None:
        due = time.monotonic()
        while not self._end.is_set():
            source.send(self._set())
            self._ready.set()
            due = max(due + self._period_s, time.monotonic() - self._period_s)
            self._end.wait(max(0.0, due - time.monotonic()))

    def _in_lockstep(self, source: Source[Obstacles], states: _memory.Subscriber[State]) -> None:
        newest = states.receive()
        tick, now_ns = (0, 0) if newest is None else (newest.header.tick + 1, newest.header.capture_ns)
        while True:
            source.send(self._set(), now_ns, tick)
            self._ready.set()
            silent = time.monotonic()
            while (state := states.receive()) is None or state.header.tick < tick:
                if self._end.is_set():
                    return
                if time.monotonic() - silent > _LOOK_S:
                    if not self._there():
                        raise NoDaemonError("the daemon has gone")
                    silent = time.monotonic()
                time.sleep(_POLL_S)
            tick, now_ns = state.header.tick + 1, state.header.capture_ns
            while not self._gate.wait(tick - 1):
                if self._end.is_set():
                    return
