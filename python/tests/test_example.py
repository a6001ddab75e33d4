"""The script of the manual, as a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from sinew_arm import SimulatedArm

SCRIPT = Path(__file__).resolve().parents[1] / "examples" / "drive.py"


def test_thirty_lines_drive_an_arm_through_everything(simulated: SimulatedArm) -> None:
    assert len(SCRIPT.read_text().splitlines()) <= 30
    domain = simulated.domain
    assert domain.run_dir is not None
    environment = {"SINEW_IPC_PREFIX": domain.prefix, "SINEW_IPC_ROOT": domain.root, "SINEW_RUN_DIR": domain.run_dir}
    command = [sys.executable, str(SCRIPT)]
    ran = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.returncode == 0, ran.stderr
    said = [line.split(":")[0] for line in ran.stdout.splitlines()]
    assert said == ["armed", "tracked", "held", "fault", "cleared"], ran.stdout
    assert ran.stdout.rstrip().endswith("cleared: disarmed")
