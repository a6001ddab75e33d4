"""The arm's socket against a daemon that is none: what it may do that the real one seldom does."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sinew_arm import Domain, IncompatibleError, NoDaemonError, NotPermittedError, RefusedError, TimedOutError
from sinew_arm._line import HungUpError, ask, report
from sinew_arm.payloads import RefusalReason, SupervisorState

ANSWER = (
    b'{"answer":{"asked":"track","accepted":%s,"reason":8,"detail":0,"supervisor":2,"fault_code":0,'
    b'"fault_detail":0,"text":"no fresh target"}}\n'
)


@contextmanager
def daemon(folder: Path, *answers: bytes | None) -> Iterator[tuple[Domain, list[bytes]]]:
    """Answers one connection after the other; with `None` it never does."""
    domain = Domain("x_", "/nowhere/", str(folder))
    (folder / "paper").mkdir(mode=0o755)
    heard: list[bytes] = []
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(folder / "paper" / domain.socket_name()))
        listener.listen()
        over = threading.Event()

        def serve() -> None:
            for answer in answers:
                guest, _ = listener.accept()
                with guest:
                    heard.append(guest.recv(4096))
                    if answer is None:
                        over.wait(10)
                    else:
                        guest.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        yield domain, heard
        over.set()
        thread.join()


def test_the_socket_of_a_domain_has_the_name_that_the_daemon_gives_it() -> None:
    assert Domain().socket_name() == "control"
    # FNV-1a of the root path and the prefix, by hand: an empty name is its offset.
    assert Domain("", "").socket_name() == "control-cbf29ce484222325"
    assert Domain("a", "").socket_name() == "control-af63dc4c8601ec8c"
    assert Domain("foobar", "").socket_name() == Domain("bar", "foo").socket_name() == "control-85944171f73967e8"


def test_an_answer_is_a_mode_or_a_refusal(tmp_path: Path) -> None:
    with daemon(tmp_path, ANSWER % b"true", ANSWER % b"false") as (domain, heard):
        assert ask(domain, "paper", "track", 5) is SupervisorState.HOLDING
        with pytest.raises(RefusedError, match="track is refused: no fresh target") as refused:
            ask(domain, "paper", "track", 5)
    assert refused.value.reason is RefusalReason.NO_TARGET
    assert heard == [b"track\n", b"track\n"]


def test_a_daemon_that_has_no_time_is_asked_again_for_its_report_alone(tmp_path: Path) -> None:
    with daemon(tmp_path, b"", b'{"status":{"mode":"holding"}}\n', b"") as (domain, heard):
        assert report(domain, "paper", 5) == {"mode": "holding"}
        with pytest.raises(HungUpError, match="hung up without an answer"):
            ask(domain, "paper", "arm", 5)
    assert heard == [b"status\n", b"status\n", b"arm\n"]


def test_what_is_not_understood_is_told(tmp_path: Path) -> None:
    refused = b'{"refused":"not to you"}\n'
    with daemon(tmp_path, b"what?\n", b'{"other":1}\n', refused, None) as (domain, _):
        for _ in range(2):
            with pytest.raises(IncompatibleError, match="another version"):
                ask(domain, "paper", "hold", 5)
        with pytest.raises(NotPermittedError, match="not to you"):
            ask(domain, "paper", "hold", 5)
        with pytest.raises(TimedOutError, match=r"within 0\.2 s"):
            ask(domain, "paper", "hold", 0.2)


def test_a_socket_that_a_killed_daemon_left_is_none(tmp_path: Path) -> None:
    with daemon(tmp_path) as (domain, _):
        pass
    with pytest.raises(NoDaemonError, match="no daemon running"):
        ask(domain, "paper", "hold", 1)
