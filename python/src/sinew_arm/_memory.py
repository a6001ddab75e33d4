"""Shared memory: iceoryx2's ports, with this package's payloads and exceptions."""

from __future__ import annotations

import contextlib
import ctypes
import time
from typing import Any, Generic, TypeVar, Union

import iceoryx2 as iox2

from .domain import Domain, no_daemon
from .errors import IncompatibleError, NoDaemonError, TimedOutError, UnusableError
from .payloads import (
    NO_TICK,
    SCHEMA_VERSION,
    Encoders,
    Header,
    Obstacles,
    Request,
    Response,
    State,
    Target,
    Tip,
)

_SERVICES: dict[type[Any], str] = {
    Encoders: "encoders",
    Obstacles: "obstacles",
    Target: "target",
    Tip: "tip",
    State: "state",
}
_POLL_S = 2e-4
# A publisher must live until its message was taken.
_TAKEN_S = 5e-3

_Message = TypeVar("_Message", bound=Union[Encoders, Obstacles, Target, Tip, State])


class Session:
    """A node of iceoryx2, which must live as long as its ports."""

    def __init__(self, domain: Domain, arm: str) -> None:
        """Makes the node.

        Raises:
            NotPermittedError: Shared memory is another user's.
            UnusableError: What iceoryx2 reports.

        """
        domain.check_memory(arm)
        self.arm = arm
        config = iox2.config.default()
        try:
            config.global_cfg.prefix = iox2.FileName.new(domain.prefix)
            config.global_cfg.root_path = iox2.Path.new(domain.root)
            builder = iox2.NodeBuilder.new().name(iox2.NodeName.new("sinew python client"))
            # Signals stay Python's, so that Ctrl-C raises KeyboardInterrupt.
            builder = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).config(config)
            with domain.turn(arm):
                self._node: Any = builder.create(iox2.ServiceType.Ipc)
        except Exception as error:
            raise UnusableError(f"shared memory cannot be used: {error}") from error

    def close(self) -> None:
        """Lets the node go."""
        self._node = None

    def topic(self, kind: type[Any]) -> Any:
        """A publish-subscribe service of the arm."""
        return self._open(_SERVICES[kind], lambda builder: builder.publish_subscribe(kind).open())

    def requests(self) -> Any:
        """The request-response service of the arm."""
        return self._open("request", lambda builder: builder.request_response(Request, Response).open())

    def _open(self, service: str, opened: Any) -> Any:
        name = f"sinew/{self.arm}/{service}"
        try:
            return opened(self._node.service_builder(iox2.ServiceName.new(name)))
        except (iox2.PublishSubscribeOpenError, iox2.RequestResponseOpenError) as error:
            cause = str(error)
            if "DoesNotExist" in cause or "MarkedForDestruction" in cause:
                raise NoDaemonError(no_daemon(self.arm)) from None
            if "Incompatible" in cause:
                raise IncompatibleError(
                    f"service {name} has another payload: the daemon is not of schema version {SCHEMA_VERSION}"
                ) from None
            raise UnusableError(f"opening {name} failed: {cause}") from None


class Subscriber(Generic[_Message]):
    """Receives the newest message of each publisher."""

    def __init__(self, session: Session, kind: type[_Message]) -> None:
        """Opens the port."""
        self._kind: type[_Message] = kind
        self._session: Session | None = session
        self._port: Any = _made(lambda: session.topic(kind).subscriber_builder().create(), session.arm)

    def receive(self) -> _Message | None:
        """The newest message that was not received yet."""
        newest = None
        while (sample := self._port.receive()) is not None:
            newest = sample
        if newest is None:
            return None
        message: _Message = self._kind.from_buffer_copy(newest.payload().contents)  # type: ignore[assignment]
        return message

    def close(self) -> None:
        """Lets the port go."""
        self._port = self._session = None


class Publisher(Generic[_Message]):
    """Publishes one source's messages and numbers them."""

    def __init__(self, session: Session, kind: type[_Message], source_id: int) -> None:
        """Opens the port."""
        self._session: Session | None = session
        self._port: Any = _made(lambda: session.topic(kind).publisher_builder().create(), session.arm)
        self._source_id = source_id
        self._sequence = 0
        self._sent_at = 0.0

    def send(self, message: _Message, capture_ns: int, tick: int = NO_TICK) -> None:
        """Fills in the header and sends; never waits for a subscriber."""
        stamp(message.header, self._source_id, self._sequence, capture_ns, tick)
        self._port.send_copy(message)
        self._sequence += 1
        self._sent_at = time.monotonic()

    def close(self) -> None:
        """Lets the port go, once the last message can be taken."""
        if self._port is not None:
            time.sleep(max(0.0, self._sent_at + _TAKEN_S - time.monotonic()))
        self._port = self._session = None


class Requester:
    """Sends requests and waits for their answers."""

    def __init__(self, session: Session) -> None:
        """Opens the port."""
        self._session: Session | None = session
        self._port: Any = _made(lambda: session.requests().client_builder().create(), session.arm)
        self._arm = session.arm
        self._sequence = 0

    def ask(self, request: Request, timeout_s: float) -> Response:
        """The answer, whatever it is.

        Raises:
            NoDaemonError: Nobody serves the arm any more.
            TimedOutError: There is no answer.

        """
        stamp(request.header, request.header.source_id, self._sequence, monotonic_ns(), NO_TICK)
        self._sequence += 1
        pending = self._port.send_copy(request)
        if pending.number_of_server_connections == 0:
            raise NoDaemonError(no_daemon(self._arm))
        deadline = time.monotonic() + timeout_s
        while (answer := pending.receive()) is None:
            if time.monotonic() > deadline:
                raise TimedOutError(f'the daemon of arm "{self._arm}" did not answer within {timeout_s} s')
            time.sleep(_POLL_S)
        return Response.from_buffer_copy(answer.payload().contents)

    def close(self) -> None:
        """Lets the port go."""
        self._port = self._session = None


def stamp(header: Header, source_id: int, sequence: int, capture_ns: int, tick: int) -> None:
    """Fills in a header."""
    header.schema_version = SCHEMA_VERSION
    header.source_id = source_id
    header.sequence = sequence
    header.capture_ns = capture_ns
    header.tick = tick


def monotonic_ns() -> int:
    """The time base of all payloads (ns), the same in every process of a computer."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


def _made(make: Any, arm: str) -> Any:
    try:
        return make()
    except (NoDaemonError, IncompatibleError, UnusableError):
        raise
    except Exception as error:
        raise UnusableError(f'a port to arm "{arm}" cannot be made: {error}') from error


def quiet() -> None:
    """Leaves iceoryx2's own messages out: what matters is raised."""
    with contextlib.suppress(AttributeError):
        iox2.set_log_level(iox2.LogLevel.Fatal)


assert ctypes.sizeof(Header) == 32  # noqa: S101 - `_SERVICES` carries these very bytes
