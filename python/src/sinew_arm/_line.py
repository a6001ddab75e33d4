"""The arm's socket: one line, one answer; and a stream of what is published."""

from __future__ import annotations

import json
import socket
import struct
import time
from pathlib import Path
from typing import Any

from . import _words
from .domain import Domain, no_daemon
from .errors import NoDaemonError, NotPermittedError, RejectedError, TimedOutError, UnusableError

_PART = 1 << 16


def _connect(path: Path, timeout_s: float) -> socket.socket | None:
    """`None` where a killed daemon left its socket."""
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    line.settimeout(timeout_s)
    try:
        line.connect(str(path))
    except (ConnectionRefusedError, FileNotFoundError):
        line.close()
        return None
    except PermissionError:
        line.close()
        raise NotPermittedError(f"{path} may not be opened: `[access]` of the daemon says who may") from None
    except socket.timeout:
        line.close()
        raise TimedOutError(f"{path}: nobody listens within {timeout_s} s") from None
    except OSError as error:
        line.close()
        raise UnusableError(f"{path}: {error}") from None
    return line


def connect_all(domain: Domain, arm: str, timeout_s: float) -> list[socket.socket]:
    """Connections to whoever listens, the most trusted first; never empty.

    Raises:
        NoDaemonError: Nobody listens.

    """
    lines = [line for line in (_connect(path, timeout_s) for path in domain.sockets(arm)) if line is not None]
    if not lines:
        raise NoDaemonError(no_daemon(arm))
    return lines


def connect(domain: Domain, arm: str, timeout_s: float) -> socket.socket:
    """The most trusted one."""
    first, *others = connect_all(domain, arm, timeout_s)
    for other in others:
        other.close()
    return first


def is_there(domain: Domain, arm: str) -> bool:
    """Whether a daemon listens for the arm."""
    try:
        connect(domain, arm, 1.0).close()
    except NoDaemonError:
        return False
    except TimedOutError:
        pass
    return True


def user(domain: Domain, arm: str) -> int:
    """User of the daemon, as the kernel has it."""
    with connect(domain, arm, 1.0) as line:
        credentials = line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    _, uid, _ = struct.unpack("3i", credentials)
    return int(uid)


class HungUpError(UnusableError):
    """The daemon hangs up without an answer: it ends, or too many ask at once."""


def report(domain: Domain, arm: str, timeout_s: float) -> Any:
    """The daemon's report; where it has no time for it, it is asked again.

    Raises:
        SinewError: As `ask`.

    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return ask(domain, arm, "status", timeout_s)
        except HungUpError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def ask(domain: Domain, arm: str, text: str, timeout_s: float) -> Any:
    """Says a line and understands the answer; what only stops is said to every daemon of the arm, before an answer is read.

    Raises:
        SinewError: As `_words.understand`; nobody is there, or does not answer in time.

    """
    asked = text.split(" ", 1)[0]
    lines = connect_all(domain, arm, timeout_s)
    if asked not in _words.STOPPING:
        for other in lines[1:]:
            other.close()
        del lines[1:]
    deadline = time.monotonic() + timeout_s
    try:
        for line in lines:
            _say(line, text)
        answers = [_words.understand(asked, _read(line, arm, deadline, timeout_s)) for line in lines]
    finally:
        for line in lines:
            line.close()
    return answers[0]


def _say(line: socket.socket, text: str) -> None:
    try:
        line.sendall(f"{text}\n".encode())
    except OSError:
        # An answer may be there all the same: a refusal.
        return


def _read(line: socket.socket, arm: str, deadline: float, timeout_s: float) -> bytes:
    parts: list[bytes] = []
    while True:
        line.settimeout(max(deadline - time.monotonic(), 1e-3))
        try:
            part = line.recv(_PART)
        except ConnectionResetError:
            part = b""
        except socket.timeout:
            raise TimedOutError(f'the daemon of arm "{arm}" did not answer within {timeout_s} s') from None
        if not part and not parts:
            raise HungUpError(f'the daemon of arm "{arm}" hung up without an answer')
        if not part:
            return b"".join(parts)
        parts.append(part)


class Stream:
    """What is published over the socket under one source id."""

    def __init__(self, domain: Domain, arm: str, what: str, source_id: int, timeout_s: float) -> None:
        """Opens it; `what` is `obstacles` or `targets`."""
        self._line = connect(domain, arm, timeout_s)
        self._heard = b""
        _say(self._line, f"publish {what} {source_id}")

    def send(self, fields: dict[str, Any]) -> None:
        """Sends a line.

        Raises:
            RejectedError: The daemon does not take over what was sent before.
            NoDaemonError: It has hung up.

        """
        self.check()
        try:
            self._line.settimeout(1.0)
            self._line.sendall(json.dumps(fields).encode() + b"\n")
        except socket.timeout:
            raise TimedOutError("the daemon does not take what is published") from None
        except OSError as error:
            self.check()
            raise NoDaemonError(f"the daemon has hung up: {error}") from None

    def check(self) -> None:
        """Raises what the daemon has said about what was sent; it says what changes."""
        self._line.setblocking(False)
        try:
            part = self._line.recv(_PART)
        except BlockingIOError:
            part = b""
        except OSError as error:
            raise NoDaemonError(f"the daemon has hung up: {error}") from None
        self._heard += part
        *lines, self._heard = self._heard.split(b"\n")
        if lines:
            try:
                _words.understand("publishing", lines[-1])
            except NotPermittedError as error:
                raise RejectedError(str(error)) from None

    def close(self) -> None:
        """Hangs up."""
        self._line.close()
