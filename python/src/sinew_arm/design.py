"""Arms as designs: at rest, in motion and planned, by the library itself. Needs the extension `sinew-arm-native`.

An arm is a name of the library (`paper`, `rao-2021`, ...), a path of a file with `[arm]`, or such a file's content as a
dictionary, which `document` gives to be changed. Lengths are in m, tensions in N, all in the base frame.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union, cast

import numpy as np
import numpy.typing as npt

from ._payload import BoolArray, FloatArray, IntArray
from .errors import SinewError

Design = Union[str, "os.PathLike[str]", Mapping[str, Any]]
"""A name of the library, a path, or a dictionary."""


@dataclass(frozen=True)
class Description:
    """Sizes and bounds of an arm.

    Attributes:
        name: Name.
        length_m: Base to tip.
        segments: Number of segments.
        cables: Number of cables.
        nodes: Number of nodes, the clamped base among them.
        cable_segment: (cables,), segment of each cable, from 0.
        segment_length_m: (segments,).
        tension_n_min: Least tension of a cable.
        tension_n_max: (cables,), largest.

    """

    name: str
    length_m: float
    segments: int
    cables: int
    nodes: int
    cable_segment: npt.NDArray[np.int64]
    segment_length_m: FloatArray
    tension_n_min: float
    tension_n_max: FloatArray


@dataclass(frozen=True)
class Postures:
    """An arm, row by row.

    Attributes:
        node_position_m: (n, nodes, 3), from the base on.
        tip_position_m: (n, 3).
        tip_quaternion: (n, 4), `[w x y z]`, tip to base.
        tip_velocity_mps: (n, 3).
        curvature_1pm: (n, segments, 2), average curvatures about local y and z.

    """

    node_position_m: FloatArray
    tip_position_m: FloatArray
    tip_quaternion: FloatArray
    tip_velocity_mps: FloatArray
    curvature_1pm: FloatArray


@dataclass(frozen=True)
class Simulation(Postures):
    """A motion; the first row is where it begins.

    Attributes:
        times_s: (n,).

    """

    times_s: FloatArray


@dataclass(frozen=True)
class Plan(Postures):
    """A planned scenario, a row for each step; further attributes beside those of `Postures`.

    Attributes:
        times_s: (n,), end of each step.
        tension_n: (n, cables).
        obstacles: Names of the obstacles.
        distance_m: (n, obstacles), smallest distance between the whole arm's surface and an obstacle's; negative inside.
        cost: (n,), the cost that was minimised.
        plan_s: (n,), computing time.
        iterations: (n,), Newton iterations.
        converged: (n,), whether they ended by themselves.
        near_obstacles: (n,), whether obstacles were near enough to be planned around.
        diverged: Why the motion ended before its time; `None` where it did not.
        seed: Of all random choices.

    """

    times_s: FloatArray
    tension_n: FloatArray
    obstacles: list[str]
    distance_m: FloatArray
    cost: FloatArray
    plan_s: FloatArray
    iterations: IntArray
    converged: BoolArray
    near_obstacles: BoolArray
    diverged: str | None
    seed: int


def document(arm: Design) -> dict[str, Any]:
    """An arm's file as a dictionary of one's own: `document("paper")["arm"]["segment_defaults"]["length_m"]`."""
    _, text = _read(arm, _native().arm_text)
    return cast("dict[str, Any]", json.loads(_native().toml_to_json(text)))


def scenario_document(scenario: Design) -> dict[str, Any]:
    """A scenario's file as a dictionary of one's own."""
    _, text = _read(scenario, _native().scenario_text)
    return cast("dict[str, Any]", json.loads(_native().toml_to_json(text)))


def to_toml(content: Mapping[str, Any]) -> str:
    """A dictionary as the text of a file."""
    return str(_native().json_to_toml(json.dumps(content, default=_number)))


def describe(arm: Design) -> Description:
    """Sizes and bounds of an arm.

    Raises:
        ValueError: The file is refused; the message has everything wrong in it.

    """
    found = json.loads(_native().describe(*_read(arm, _native().arm_text)))
    for name in ("segment_length_m", "tension_n_max"):
        found[name] = np.array(found[name])
    found["cable_segment"] = np.array(found["cable_segment"], dtype=np.int64)
    return Description(**found)


def equilibria(arm: Design, tension_n: npt.ArrayLike, *, guess_1pm: npt.ArrayLike | None = None) -> Postures:
    """The arm at rest under tensions, without what is in its way.

    Args:
        arm: The arm.
        tension_n: (n, cables), or (cables,) for one row.
        guess_1pm: (segments, 2), curvatures of the chain from which each row is reached, which chooses among several
            equilibria; default: straight.

    Returns:
        A row for each; NaN where no equilibrium was found.

    Raises:
        ValueError: The arm is refused, or another number of cables.

    """
    name, text = _read(arm, _native().arm_text)
    rows = np.ascontiguousarray(np.atleast_2d(np.asarray(tension_n, dtype=float)))
    return Postures(**_shaped(_native().equilibria(name, text, rows, _guess(arm, guess_1pm))))


def simulate(
    arm: Design,
    tension_n: npt.ArrayLike,
    *,
    step_s: float,
    start_tension_n: npt.ArrayLike | None = None,
    guess_1pm: npt.ArrayLike | None = None,
) -> Simulation:
    """The motion under given tensions by the full dynamics (generalised-alpha), from rest.

    Args:
        arm: The arm.
        tension_n: (steps, cables), the tensions of each step.
        step_s: Length of a step (s).
        start_tension_n: (cables,), in whose equilibrium the motion begins; default: the arm's least ones.
        guess_1pm: As for `equilibria`.

    Raises:
        ValueError: The arm is refused, or another number of cables.
        ArithmeticError: There is no such equilibrium, or a step does not converge.

    """
    name, text = _read(arm, _native().arm_text)
    rows = np.ascontiguousarray(np.asarray(tension_n, dtype=float))
    if rows.ndim != 2:
        raise ValueError(f"tension_n: shape {rows.shape}, expected (steps, cables)")
    if start_tension_n is None:
        about = describe(arm)
        start_tension_n = np.full(about.cables, about.tension_n_min)
    start = np.ascontiguousarray(np.asarray(start_tension_n, dtype=float))
    return Simulation(**_shaped(_native().simulate(name, text, start, _guess(arm, guess_1pm), rows, float(step_s))))


def plan(
    scenario: Design,
    *,
    arm: Design | None = None,
    seed: int | None = None,
    warning: str | None = None,
    steps: int | None = None,
) -> Plan:
    """Plans a scenario in open loop as `sinew plan`: its model is the arm.

    Args:
        scenario: A built-in scenario (`tip`, `rao-2021/shape`, ...), a path, or a dictionary (`scenario_document`).
        arm: In place of the arm that the scenario names.
        seed: Of the swarm; default: the scenario's.
        warning: What plans near obstacles: `swarm`, `seeded` or `complementarity`; default: the scenario's.
        steps: Most steps; default: to the end.

    Raises:
        ValueError: Scenario or arm is refused, or there is no start.

    """
    native = _native()
    name, text = _read(scenario, native.scenario_text)
    with tempfile.TemporaryDirectory(prefix="sinew-plan-") as folder:
        if arm is not None:
            content = json.loads(native.toml_to_json(text))
            content["arm"] = "arm.toml"
            Path(folder, "arm.toml").write_text(_read(arm, native.arm_text)[1], encoding="utf-8")
            # What names the arm's file is relative to its own.
            name, text = str(Path(folder, "scenario.toml")), native.json_to_toml(json.dumps(content))
        found = native.plan(name, text, seed, warning, steps)
    return Plan(**_shaped(found))


def _native() -> Any:
    try:
        import sinew_arm_native
    except ImportError as error:
        raise SinewError(
            f"simulating and planning need the extension: pip install ./python/native, or python/run ({error})"
        ) from None
    return sinew_arm_native


def _read(design: Design, built_in: Any) -> tuple[str, str]:
    """What stands for the file in messages, and its text."""
    if isinstance(design, Mapping):
        return "dictionary", to_toml(design)
    path = Path(design)
    if path.is_file():
        return str(path), path.read_text(encoding="utf-8")
    return str(design), built_in(str(design))


def _guess(arm: Design, guess_1pm: npt.ArrayLike | None) -> FloatArray:
    if guess_1pm is None:
        return np.zeros(2 * describe(arm).segments)
    return np.ascontiguousarray(np.asarray(guess_1pm, dtype=float).reshape(-1))


def _shaped(found: dict[str, Any]) -> dict[str, Any]:
    curvature = found["curvature_1pm"]
    found["curvature_1pm"] = curvature.reshape(len(curvature), -1, 2)
    return found


def _number(value: Any) -> Any:
    """Numbers and arrays of numpy in a dictionary."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{value!r} is nothing that a file can hold")
