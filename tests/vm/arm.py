"""What the scripts have in common that run the real system in here: configuration files, programs, `sinew status`."""

import json
import os
import re
import subprocess
import sys
import time
import typing

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")


class Failed(Exception):
    """What was expected and not found."""


def require(condition, message):
    if not condition:
        raise Failed(message)


def run_main(main):
    """Ends the process with what `main` found, told in a line rather than by a traceback."""
    try:
        main()
    except Failed as failure:
        sys.exit(f"{os.path.basename(sys.argv[0])}: FAILED: {failure}")


# Of [drives]: an emulated processor that others use as well may take longer than the shipped 0.1 s for an answer.
SLOW_START = "sdo_timeout_s = 2.0"


def configuration(folder, drives, changes):
    """The shipped files with keys changed ({file: {key: value}}), `drives` being that of the buses; the paths."""
    paths = []
    for name in ("arm.toml", "controller.toml", drives, "plant.toml"):
        with open(os.path.join(ROOT, "config", name), encoding="utf-8") as file:
            text = file.read()
        for key, value in changes.get(name, {}).items():
            text, count = re.subn(rf"(?m)^#? *{key} = .*$", f"{key} = {value}", text)
            require(count == 1, f"config/{name} has {count} lines with `{key}`")
        if name == drives:
            text, count = re.subn(r"(?m)^\[drives\]$", f"[drives]\n{SLOW_START}", text)
            require(count == 1, f"config/{name} has {count} tables [drives]")
        paths.append(os.path.join(folder, name))
        with open(paths[-1], "w", encoding="utf-8") as file:
            file.write(text)
    return paths


class Sinew:
    """The programs, and a daemon's answers. Nothing here ends by a time-out: who runs the script has one for the whole."""

    def __init__(self, binaries, config):
        self.program = os.path.join(binaries, "sinew")
        self.plant = os.path.join(binaries, "sim_plant")
        self.config = config

    def call(self, *arguments):
        return subprocess.run([self.program, *arguments], capture_output=True, text=True, check=False)

    def ask(self, request):
        """A request as an operator makes it."""
        answer = self.call(request, "--config", *self.config)
        print(f"sinew {request}: {(answer.stdout + answer.stderr).strip()}", flush=True)
        return answer.returncode == 0

    def status(self):
        """The report, or nothing where no daemon answers."""
        answer = self.call("status", "--json", "--config", *self.config)
        return json.loads(answer.stdout) if answer.stdout.startswith("{") else None

    def until(self, what, condition, alive=()):
        """The first report that fulfils the condition."""
        last = None
        while True:
            for process in alive:
                require(process.poll() is None, f"a process ended with {process.poll()} before {what}; last: {last}")
            report = self.status()
            if report is not None:
                brief = {key: report[key] for key in ("mode", "fault")}
                brief["drives"] = report["drives"]
                brief["buses"] = [bus["state"] for bus in report["buses"]]
                if brief != last:
                    print(f"   {report['ticks']} ticks: {json.dumps(brief)}", flush=True)
                    last = brief
                if condition(report):
                    return report
            time.sleep(0.1)


class Candump:
    """A recording of interfaces by can-utils, as text of one line a frame."""

    def __init__(self, path, interfaces):
        self.path = path
        self.file = open(path, "w", encoding="utf-8")
        # -D: goes on when an interface goes down; a large buffer: an emulated processor may leave it waiting.
        command = ["candump", "-L", "-D", "-r", "8000000", *interfaces]
        self.process = subprocess.Popen(command, stdout=self.file)
        # A frame that is sent before it has its sockets is lost.
        while True:
            with open("/proc/net/can/rcvlist_all", encoding="utf-8") as table:
                lists = table.read()
            if all(re.search(rf"(?m)^ *{name} ", lists) for name in interfaces):
                return
            require(self.process.poll() is None, "candump ended")
            time.sleep(0.05)

    def stop(self):
        self.process.terminate()
        self.process.wait()
        self.file.close()


# An FD frame has a second # and a digit of flags, the lowest of which is the bit-rate switch.
LINE = re.compile(r"\(\d+\.\d+\) (\S+) ([0-9A-F]+)#(?:#([0-9A-F]))?([0-9A-F]*)$")


class Frame(typing.NamedTuple):
    """As candump has it."""

    interface: str
    identifier: int
    data: bytes
    is_fd: bool
    has_rate_switch: bool


def frames(path):
    """Every frame of a recording."""
    with open(path, encoding="utf-8") as file:
        for line in file:
            match = LINE.match(line)
            # The last line of a recording that was stopped may be cut; remote requests there are none.
            if match and len(match[4]) % 2 == 0:
                flags = match[3]
                switch = flags is not None and int(flags, 16) & 1 == 1
                yield Frame(match[1], int(match[2], 16), bytes.fromhex(match[4]), flags is not None, switch)
