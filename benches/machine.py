"""On what, when and of which commit something was measured: one description for all benches.

As a program: JSON, or with `--line` one line for the head of a result's file. A `+` behind the commit: tracked files differed
from it, results that benches had written apart.
"""

import datetime
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def command(*words):
    try:
        return subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def describe():
    text = Path("/proc/cpuinfo").read_text()
    model = next((line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")), "unknown")
    commit = command("git", "rev-parse", "--short", "HEAD") or "unknown"
    changed = command("git", "status", "--porcelain", "-uno", "--", ".", ":!benches/results", ":!benches/peers/results")
    return {
        "commit": commit + ("+" if changed else ""),
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "rustc": command("rustc", "--version") or "unknown",
        "kernel": platform.release(),
        "processor": model,
        "processors": os.cpu_count(),
        "hypervisor": "hypervisor" in text,
        "load_average": os.getloadavg()[0],
    }


def changed_note(commit):
    """What the `+` of a commit means, where it has one."""
    return " (+: with changes that are not in that commit)" if commit.endswith("+") else ""


def line(m):
    virtual = " of a virtual machine" if m["hypervisor"] else ""
    return (
        f"commit {m['commit']}{changed_note(m['commit'])}, {m['date']}, {m['rustc']}, Linux {m['kernel']}, {m['processor']}, "
        f"{m['processors']} processors{virtual}, load average {m['load_average']:.2f} at the start"
    )


if __name__ == "__main__":
    print(line(describe()) if sys.argv[1:] == ["--line"] else json.dumps(describe(), indent=1))
