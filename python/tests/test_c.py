"""The header of C: its example compiles without a warning, and the daemon takes what it writes."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path

import pytest

from sinew_arm import Arm, Watch
from sinew_arm.payloads import NO_TICK, SCHEMA_VERSION, Obstacles

ROOT = Path(__file__).resolve().parents[2]
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I", str(ROOT / "include")]


def compile_c(source: Path, out: Path, *options: str) -> None:
    command = ["cc", *STRICT, *options, str(source), "-lm", "-o", str(out)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_a_set_of_c_is_the_set_of_python(arm: Arm, watch: Watch, tmp_path: Path) -> None:
    compile_c(ROOT / "examples" / "obstacles.c", tmp_path / "obstacles", "-std=c11")
    written = subprocess.run([tmp_path / "obstacles", "2.5"], check=True, capture_output=True).stdout
    made = Obstacles.from_buffer_copy(written)
    assert (made.header.schema_version, made.header.tick) == (SCHEMA_VERSION, NO_TICK)
    ball, post = made.obstacles
    assert ball.position_m == pytest.approx([0.4 + 0.32 * math.cos(0.25), -0.15 + 0.32 * math.sin(0.25), -1.68])
    assert ball.velocity_mps == pytest.approx([-0.032 * math.sin(0.25), 0.032 * math.cos(0.25), 0])
    assert post.dimensions_m.tolist() == [0.7, 0.05, 0]
    watch.show(made)
    for state in arm.states(timeout_s=10):
        if len(state.distances) == 2:
            break
    distances = {d.obstacle_id: d.surface_distance_m for d in state.distances}
    # The arm hangs on the z axis: the paper's arm is a curve.
    assert distances[1] == pytest.approx(math.hypot(ball.position_m[0], ball.position_m[1]) - 0.1, abs=5e-3)
    assert distances[2] == pytest.approx(0.75, abs=1e-3)
    watch.check()


def test_the_header_has_the_layout_in_c_plus_plus_too(tmp_path: Path) -> None:
    source = tmp_path / "only.cpp"
    source.write_text('#include "sinew_payloads.h"\nint main() { return sinew_state{}.header.tick != 0; }\n')
    command = ["c++", *STRICT, "-std=c++11", str(source), "-o", str(tmp_path / "only")]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    # An assertion of the layout can fail.
    header = (ROOT / "include" / "sinew_payloads.h").read_text()
    (tmp_path / "wrong").mkdir()
    (tmp_path / "wrong" / "sinew_payloads.h").write_text(header.replace("double time_s;", "float time_s;"))
    wrong = ["c++", "-std=c++11", "-I", str(tmp_path / "wrong"), str(source), "-o", str(tmp_path / "only")]
    assert subprocess.run(wrong, capture_output=True, check=False).returncode != 0
