"""The library's model and planner over numpy arrays."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from sinew_arm import design
from sinew_arm.simulated import find_program

ROOT = Path(__file__).resolve().parents[2]


def test_an_arm_is_described() -> None:
    paper = design.describe("paper")
    assert (paper.name, paper.segments, paper.cables, paper.nodes) == ("paper", 4, 24, 21)
    # Four segments, and connectors between them.
    assert paper.length_m == pytest.approx(4 * 0.65 + 3 * 0.05)
    assert paper.segment_length_m.sum() == pytest.approx(4 * 0.65, abs=0.21)
    assert paper.cable_segment.tolist() == [c // 6 for c in range(24)]
    assert paper.tension_n_max.tolist() == [220.0] * 24
    assert design.describe(ROOT / "config" / "arm.toml").name == "paper"
    assert design.describe("rao-2021").name != "paper"


def test_a_dictionary_is_an_arm_of_ones_own() -> None:
    longer = design.document("paper")
    longer["arm"]["segment_defaults"]["length_m"] = np.float64(0.8)
    assert design.describe(longer).length_m - design.describe("paper").length_m == pytest.approx(0.6)
    longer["arm"]["segment_defaults"]["length_m"] = -1.0
    with pytest.raises(ValueError, match=r"length_m.*-1"):
        design.describe(longer)
    with pytest.raises(ValueError, match=r"no arm `nothing`.*paper, .*rao-2021"):
        design.describe("nothing")
    with pytest.raises(TypeError, match="nothing that a file can hold"):
        design.describe({"arm": {"name": object()}})


def test_an_arm_without_load_hangs_straight() -> None:
    rest = design.equilibria("paper", np.zeros(24))
    assert rest.node_position_m.shape == (1, 21, 3)
    assert rest.tip_position_m[0] == pytest.approx([0, 0, -2.75])
    assert rest.node_position_m[0, -1] == pytest.approx(rest.tip_position_m[0])
    assert np.abs(rest.curvature_1pm).max() < 1e-12


def test_small_tensions_bend_as_a_beam() -> None:
    """A cable at 50 mm from the backbone is a moment of its tension times that: kappa = T d / EI."""
    tension = np.zeros((2, 24))
    tension[0, 18:24] = [1, 0, 0, 0, 0, 0]
    tension[1, 18:24] = [2, 0, 0, 0, 0, 0]
    bent = design.equilibria("paper", tension)
    curvature = np.linalg.norm(bent.curvature_1pm, axis=2)
    assert curvature[:, :3].max() < 0.05 * curvature[0, 3]
    assert curvature[0, 3] == pytest.approx(1.0 * 0.05 / 7.0, rel=0.02)
    assert curvature[1, 3] / curvature[0, 3] == pytest.approx(2, rel=0.02)


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="23 numbers, expected 24"):
        design.equilibria("paper", np.zeros((3, 23)))
    with pytest.raises(ValueError, match="guess: 2 numbers, expected 8"):
        design.equilibria("paper", np.zeros(24), guess_1pm=[0, 0])
    with pytest.raises(ValueError, match=r"\(steps, cables\)"):
        design.simulate("paper", np.zeros(24), step_s=0.01)
    with pytest.raises(ValueError, match="positive number of seconds"):
        design.simulate("paper", np.zeros((1, 24)), step_s=0.0)
    with pytest.raises(ValueError, match="NaN"):
        design.simulate("paper", np.full((1, 24), np.nan), step_s=0.01)


def test_a_simulation_settles_in_the_equilibrium() -> None:
    tension = np.zeros(24)
    tension[18] = 5.0
    # Its slowest modes take their time: the damping is raised.
    damped = design.document("paper")
    damped["arm"]["segment_defaults"]["damping_stiffness_s"] = 0.5
    motion = design.simulate(damped, np.tile(tension, (1500, 1)), step_s=0.02)
    assert motion.times_s[[0, 1, -1]] == pytest.approx([0, 0.02, 30])
    assert motion.tip_position_m[0] == pytest.approx([0, 0, -2.75])
    rest = design.equilibria(damped, tension)
    away = np.linalg.norm(rest.tip_position_m[0] - motion.tip_position_m[0])
    assert away > 0.005
    assert np.linalg.norm(motion.tip_position_m[-1] - rest.tip_position_m[0]) < 0.02 * away
    assert np.linalg.norm(motion.tip_velocity_mps[-1]) < 0.02 * away
    # From the equilibrium nothing moves.
    still = design.simulate(damped, np.tile(tension, (10, 1)), step_s=0.02, start_tension_n=tension)
    assert np.abs(still.tip_position_m - rest.tip_position_m).max() < 1e-9


def test_velocities_are_those_of_the_positions() -> None:
    tension = np.zeros((100, 24))
    tension[:, 18] = np.linspace(0, 5, 100)
    motion = design.simulate("paper", tension, step_s=0.002)
    central = (motion.tip_position_m[2:] - motion.tip_position_m[:-2]) / 0.004
    assert np.abs(central - motion.tip_velocity_mps[1:-1]).max() < 0.02 * np.abs(central).max()


def test_a_step_that_is_too_long_is_told() -> None:
    tension = np.zeros((3, 24))
    tension[:, 0] = 1e7
    with pytest.raises(ArithmeticError, match="could not be computed at"):
        design.simulate("paper", tension, step_s=0.5)


def test_a_plan_is_that_of_the_command() -> None:
    planned = design.plan("tip-no-avoidance")
    program = find_program("sinew", os.environ.get("SINEW_PROGRAMS"))
    ran = subprocess.run([program, "plan", "tip-no-avoidance", "--json"], check=True, capture_output=True)
    summary = json.loads(ran.stdout)
    assert planned.diverged is None
    assert len(planned.times_s) == summary["ticks"]
    assert np.diff(planned.times_s) == pytest.approx(summary["period_s"])
    assert planned.tension_n.max() == pytest.approx(summary["tension_n"]["max"], rel=1e-9)
    assert planned.tension_n.min() == pytest.approx(summary["tension_n"]["min"], abs=1e-9)
    least = planned.distance_m.min(axis=0)
    for name, distance, obstacle in zip(planned.obstacles, least, summary["obstacles"]):
        assert name == obstacle["id"]
        assert distance == pytest.approx(obstacle["surface_distance_min_m"], rel=1e-6, abs=1e-9)
    assert planned.converged.sum() == summary["ticks"] - summary["not_converged"]
    assert planned.curvature_1pm.shape == (len(planned.times_s), 4, 2)
    assert planned.plan_s.min() > 0


def test_a_plan_of_another_arm_and_of_some_steps() -> None:
    weaker = design.document("paper")
    weaker["arm"]["tension_n_max"] = 150.0
    few = design.plan("tip-no-avoidance", arm=weaker, steps=7)
    assert len(few.times_s) == 7
    assert few.tension_n.max() <= 150.0
    own = design.scenario_document("rao-2021/shape")
    own["arm"] = str(ROOT / "config" / "arms" / "rao-2021" / "arm.toml")
    assert design.plan(own, steps=3).tension_n.shape[0] == 3
    assert design.plan("rao-2021/shape", steps=3).tension_n.shape == (3, design.describe("rao-2021").cables)
    with pytest.raises(ValueError, match="expected swarm, seeded or complementarity"):
        design.plan("tip", warning="luck")
    with pytest.raises(ValueError, match="series of"):
        design.plan("penalty-sweep")
    with pytest.raises(ValueError, match="no scenario `nothing`"):
        design.plan("nothing")


def test_the_seed_decides_what_the_swarm_finds() -> None:
    first, again, other = (design.plan("tip", warning="swarm", seed=seed, steps=150) for seed in (3, 3, 4))
    assert first.near_obstacles.any()
    np.testing.assert_array_equal(first.tension_n, again.tension_n)
    assert not np.array_equal(first.tension_n, other.tension_n)
    assert (first.seed, other.seed) == (3, 4)
