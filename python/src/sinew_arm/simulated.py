"""A simulated arm and its daemon as processes of their own, for tests and notebooks: no hardware, no privileges."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

from .client import Arm
from .domain import Domain
from .errors import NoDaemonError, SinewError, TimedOutError

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

_LAST_WORDS = 2000
_SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - where POSIX has it


def find_program(name: str, programs: str | os.PathLike[str] | None = None) -> Path:
    """A program of sinew: in a given folder, in that of `SINEW_PROGRAMS`, or on the path.

    Raises:
        SinewError: It is not there.

    """
    folder = programs or os.environ.get("SINEW_PROGRAMS")
    found = shutil.which(name, path=os.fspath(folder) if folder else None)
    if found is None:
        raise SinewError(f"the program `{name}` is not found: build it with `cargo build --release --workspace`")
    return Path(found)


class SimulatedArm:
    """`sim_plant` and `sinew run` on a virtual bus and in shared memory of their own. A context manager.

    However their starter ends, they end with it: with the very thread that made this.

    Attributes:
        name: Name of the arm.
        domain: Where its daemon is found, as `Arm(name, domain=domain)` takes it.
        folder: Configuration, logs and the recording; removed with the arm.

    """

    def __init__(
        self,
        config: Sequence[str | os.PathLike[str]],
        *,
        programs: str | os.PathLike[str] | None = None,
        lockstep: bool = True,
        watched_by: int | None = 1,
        arguments: Sequence[str] = (),
        plant_arguments: Sequence[str] = (),
        record: bool = False,
        start_s: float = 60.0,
    ) -> None:
        """Starts both.

        Args:
            config: Configuration files, as for `sinew run`; the simulated arm's `[plant]` may be among them. The names of
                buses and what is said of shared memory are replaced.
            programs: Folder of the programs; default: `SINEW_PROGRAMS`, or the path.
            lockstep: Time by ticks, as fast as all can; otherwise real time.
            watched_by: In lockstep the source of obstacles (`Arm.watch`) for which each tick waits; `None` for none.
            arguments: Further ones of `sinew run`.
            plant_arguments: Further ones of `sim_plant`, such as `--fault trip:3@2`.
            record: Whether the daemon records (`recording`).
            start_s: Longest wait for either (s).

        """
        self.folder = Path(tempfile.mkdtemp(prefix="sinew-py-"))
        self._processes: list[tuple[str, subprocess.Popen[bytes], IO[bytes]]] = []
        self._buses: list[str] = []
        mark = self.folder.name[len("sinew-py-") :]
        self.domain = Domain(f"sinewpy{mark}_", f"{self.folder}/ipc/", f"{self.folder}/run")
        try:
            (self.folder / "run").mkdir(0o755)
            files = self._configure(config, mark)
            self._start(files, programs, lockstep, watched_by, arguments, plant_arguments, record, start_s)
        except BaseException:
            self.close()
            raise

    @property
    def recording(self) -> Path:
        """The daemon's recording; whole once the arm is closed with `close(keep=True)`, readable before."""
        return self.folder / "daemon.mcap"

    def log(self, name: str) -> str:
        """What `plant` or `daemon` has said."""
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def end_daemon(self, timeout_s: float = 60.0) -> int:
        """Stops the daemon in order, and gives its exit code. In lockstep somebody must still watch."""
        return self._end("daemon", timeout_s)

    def close(self, *, keep: bool = False) -> None:
        """Ends both, at once, and removes the folder unless it is to be kept."""
        for _, process, _ in self._processes:
            # What it leaves in shared memory is removed below.
            process.kill()
            process.wait()
        for _, _, output in self._processes:
            output.close()
        self._processes.clear()
        for name in (f"{self.domain.prefix}*", *(f"sinew-bus-{bus}*" for bus in self._buses)):
            for left in _SHARED_MEMORY.glob(name):
                left.unlink(missing_ok=True)
        if not keep:
            shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Self:
        """The arm."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes it."""
        self.close()

    def _configure(self, config: Sequence[str | os.PathLike[str]], mark: str) -> list[str]:
        files = []
        texts = [Path(path).read_text(encoding="utf-8") for path in config]
        names = [re.search(r'^name = "([^"]+)"', text, re.MULTILINE) for text in texts if "[arm]" in text]
        self.name = next((name.group(1) for name in names if name), "")

        def bus(_: re.Match[str]) -> str:
            self._buses.append(f"py{mark}{len(self._buses)}")
            return f'interface = "{self._buses[-1]}"'

        for number, given in enumerate(texts):
            if re.search(r"^\[ipc\]", given, re.MULTILINE):
                raise SinewError(f"{config[number]}: [ipc] is the simulated arm's own to say")
            text = re.sub(r'^interface\s*=\s*"[^"]*"', bus, given, flags=re.MULTILINE)
            place = self.folder / f"{number}-{Path(config[number]).name}"
            place.write_text(text, encoding="utf-8")
            files.append(str(place))
        ipc = self.folder / "ipc.toml"
        ipc.write_text(f'[ipc]\nprefix = "{self.domain.prefix}"\nroot_path = "{self.domain.root}"\n', encoding="utf-8")
        return [*files, str(ipc)]

    def _start(
        self,
        files: list[str],
        programs: str | os.PathLike[str] | None,
        lockstep: bool,
        watched_by: int | None,
        arguments: Sequence[str],
        plant_arguments: Sequence[str],
        record: bool,
        start_s: float,
    ) -> None:
        sinew = str(find_program("sinew", programs))
        leash = [sinew, "leash", str(os.getpid()), "--"]
        plant = [*leash, str(find_program("sim_plant", programs)), *plant_arguments]
        daemon = [*leash, sinew, "run", *arguments]
        if lockstep:
            plant.append("--lockstep")
            daemon.append("--lockstep")
            if watched_by is not None:
                daemon += ["--await-obstacles", str(watched_by)]
        if record:
            daemon += ["--record", str(self.recording)]
        deadline = time.monotonic() + start_s
        self._spawn("plant", [*plant, "--config", *files])
        while "drives on" not in self.log("plant"):
            self._look("plant", deadline)
        self._spawn(
            "daemon", [*daemon, "--config", *(file for file in files if "[plant]" not in Path(file).read_text())]
        )
        while True:
            try:
                Arm(self.name, domain=self.domain).close()
                return
            except NoDaemonError:
                self._look("daemon", deadline)

    def _spawn(self, name: str, command: list[str]) -> None:
        environment = {**os.environ, "SINEW_IPC_PREFIX": self.domain.prefix, "SINEW_IPC_ROOT": self.domain.root}
        environment["SINEW_RUN_DIR"] = str(self.domain.run_dir)
        output = (self.folder / f"{name}.log").open("wb")
        process = subprocess.Popen(  # noqa: S603 - programs of sinew
            command, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
        )
        self._processes.append((name, process, output))

    def _look(self, name: str, deadline: float) -> None:
        process = next(process for known, process, _ in self._processes if known == name)
        if process.poll() is not None:
            raise SinewError(f"{name} ended by itself ({process.returncode}):\n{self.log(name)[-_LAST_WORDS:]}")
        if time.monotonic() > deadline:
            raise TimedOutError(f"{name} does not come up:\n{self.log(name)[-_LAST_WORDS:]}")
        time.sleep(0.02)

    def _end(self, name: str, timeout_s: float) -> int:
        process = next(process for known, process, _ in self._processes if known == name)
        process.send_signal(signal.SIGTERM)
        try:
            return process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise TimedOutError(f"{name} does not end:\n{self.log(name)[-_LAST_WORDS:]}") from None
