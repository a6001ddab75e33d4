"""Where the daemon of an arm is found: shared memory, and the arm's socket."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .errors import NoDaemonError, NotPermittedError

# Longest wait for one's turn.
_TURN_S = 0.5
_DEFAULT_PREFIX = "iox2_"
_DEFAULT_ROOT = "/tmp/iceoryx2/"  # noqa: S108 - iceoryx2's own


@dataclass(frozen=True)
class Domain:
    """Processes see each other when they use the same domain.

    Attributes:
        prefix: Prefix of all files in shared memory.
        root: Folder of iceoryx2's own files.
        run_dir: Folder of the arms' sockets; `None` for the usual ones.

    """

    prefix: str = _DEFAULT_PREFIX
    root: str = _DEFAULT_ROOT
    run_dir: str | None = None

    @classmethod
    def from_env(cls) -> Domain:
        """The default domain, with what `SINEW_IPC_PREFIX`, `SINEW_IPC_ROOT` and `SINEW_RUN_DIR` override."""
        return cls(
            os.environ.get("SINEW_IPC_PREFIX", _DEFAULT_PREFIX),
            os.environ.get("SINEW_IPC_ROOT", _DEFAULT_ROOT),
            os.environ.get("SINEW_RUN_DIR"),
        )

    def socket_name(self) -> str:
        """Name of the socket's file: any domain but the default one has a number behind it."""
        if (self.prefix, self.root) == (_DEFAULT_PREFIX, _DEFAULT_ROOT):
            return "control"
        # FNV-1a.
        number = 0xCBF29CE484222325
        for byte in (self.root + self.prefix).encode():
            number = ((number ^ byte) * 0x100000001B3) % 2**64
        return f"control-{number:016x}"

    def sockets(self, arm: str) -> list[Path]:
        """Sockets that are there for an arm, the most trusted first.

        Raises:
            NotPermittedError: A folder of one cannot be trusted.

        """
        found = []
        for base, owner in self._folders():
            path = base / arm / self.socket_name()
            if not path.exists():
                continue
            _check(base, owner)
            _check(base / arm, None)
            found.append(path)
        return found

    def _folders(self) -> list[tuple[Path, int | None]]:
        if self.run_dir is not None:
            return [(Path(self.run_dir), None)]
        own = os.geteuid()
        users = [own]
        if own == 0:
            sessions = [name for name in _names("/run/user") if name.isdigit()]
            temporary = [name[6:] for name in _names("/tmp") if name.startswith("sinew-")]  # noqa: S108
            others = {int(name) for name in sessions + temporary if name.isdigit()}
            users += sorted(others - {own})
        folders: list[tuple[Path, int | None]] = [(Path("/run/sinew"), None)]
        for uid in users:
            folders += [(Path(f"/run/user/{uid}/sinew"), uid), (Path(f"/tmp/sinew-{uid}"), uid)]  # noqa: S108
        return folders

    @contextlib.contextmanager
    def turn(self, arm: str) -> Iterator[None]:
        """Holds this user's other processes off while something is made in shared memory, or leftovers are removed.

        Where the turn cannot be had, or not in time, all goes on without: it keeps a rare collision away.
        """
        file = -1
        try:
            folder = self.sockets(arm)[0].parent.parent
            file = os.open(folder / "turn", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
            deadline = time.monotonic() + _TURN_S
            while time.monotonic() < deadline:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                time.sleep(2e-3)
        except (OSError, IndexError, NotPermittedError):
            # No daemon, or another user's folder.
            pass
        try:
            yield
        finally:
            if file >= 0:
                os.close(file)

    def check_memory(self, arm: str) -> None:
        """Refuses shared memory that is not this user's: what a process of another user leaves there, the daemon waits for.

        Raises:
            NoDaemonError: There is none.
            NotPermittedError: It is another user's.

        """
        root = Path(self.root)
        if not root.exists():
            raise NoDaemonError(no_daemon(arm))
        try:
            _check(root, os.geteuid())
        except NotPermittedError as error:
            raise NotPermittedError(
                f"{error}; shared memory is the daemon's user's alone: run this as that user, or use the socket"
            ) from None


def no_daemon(arm: str) -> str:
    """What to say where none is found."""
    return f'no daemon running for arm "{arm}" (start it with `sinew run`, or check SINEW_IPC_PREFIX)'


def _names(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def _check(folder: Path, owner: int | None) -> None:
    """Whoever owns a folder decides what is in it."""
    there = os.lstat(folder)
    if stat.S_ISLNK(there.st_mode):
        raise NotPermittedError(f"{folder} is not used: it is a symbolic link")
    if owner is not None and there.st_uid != owner:
        raise NotPermittedError(f"{folder} is not used: it belongs to user {there.st_uid}")
    if there.st_mode & 0o022:
        raise NotPermittedError(f"{folder} is not used: others may write to it")
