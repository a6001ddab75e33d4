"""Payloads, made and read without a daemon."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sinew_arm import messages, payloads
from sinew_arm._payload import Payload
from sinew_arm.payloads import LAYOUT, Encoders, Obstacle, Obstacles, Response, State, SupervisorState, Target

GENERATOR = Path(__file__).resolve().parents[1] / "generate.py"


def generate(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(GENERATOR), *arguments], capture_output=True, text=True, check=False)


def test_the_module_is_what_the_page_says() -> None:
    checked = generate("--check")
    assert checked.returncode == 0, checked.stderr


def test_what_is_stale_is_told(tmp_path: Path) -> None:
    root = GENERATOR.parent.parent
    copied = [
        "src/ipc/PAYLOADS.md",
        "include/sinew_payloads.h",
        "python/generate.py",
        "python/src/sinew_arm/payloads.py",
    ]
    for name in copied:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((root / name).read_bytes())

    def check() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(tmp_path / "python" / "generate.py"), "--check"]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    assert check().returncode == 0
    page = tmp_path / "src/ipc/PAYLOADS.md"
    page.write_text(page.read_text().replace("Time since the loop began (s).", "Time since some beginning (s)."))
    checked = check()
    assert checked.returncode == 1
    for name in ("payloads.py", "sinew_payloads.h"):
        assert f"{name} is not what PAYLOADS.md says: run python/generate.py" in checked.stderr


@pytest.mark.parametrize("kind", LAYOUT, ids=lambda kind: kind.__name__)
def test_bytes_lie_where_the_page_says(kind: type[Payload]) -> None:
    size, offsets = LAYOUT[kind]
    assert ctypes.sizeof(kind) == size
    names = [entry[0] for entry in kind._fields_]
    assert tuple(getattr(kind, name).offset for name in names) == offsets
    assert [name.lstrip("_") for name in names] == list(kind.FIELDS)
    assert kind.type_name() == f"sinew.{kind.__name__}.v{payloads.SCHEMA_VERSION}"


def test_arrays_are_views_cut_to_what_is_in_use() -> None:
    state = State()
    assert state.tension_command_n.shape == (0,)
    state.cable_count, state.segment_count, state.node_count = 24, 4, 20
    state.tension_command_n = np.arange(24.0)
    assert state.tension_command_n.shape == (24,)
    assert state.node_position_m.shape == (20, 3)
    assert state.node_quaternion.shape == (20, 4)
    assert state.curvature_1pm.shape == (8,)
    state.tension_command_n[3] = -1
    assert state.copy().tension_command_n[3] == -1
    assert State.from_buffer_copy(bytes(state)) == state
    state.tension_command_n = [5.0]
    assert list(state.tension_command_n[:3]) == [5.0, 0.0, 0.0]


def test_what_does_not_fit_is_refused() -> None:
    state = State()
    with pytest.raises(ValueError, match="96 at most"):
        state.tension_command_n = np.zeros(97)
    with pytest.raises(ValueError, match="64 at most, 3"):
        state.node_position_m = np.zeros((2, 4))
    with pytest.raises(ValueError, match="3 at most"):
        state.tip_position_m = np.zeros((1, 3))


def test_numbers_have_their_meanings() -> None:
    state = State()
    state.supervisor = 2
    assert state.supervisor is SupervisorState.HOLDING
    assert str(state.supervisor) == "holding"
    assert state.target_mode is None
    state.target_mode = payloads.TargetMode.SHAPE
    assert state.target_mode is payloads.TargetMode.SHAPE
    state.supervisor = 77
    assert (int(state.supervisor), str(state.supervisor)) == (77, "unknown 77")


def test_bits_and_text() -> None:
    encoders = messages.encoder_state([1.0, np.nan, 3.0], [np.nan, 2.0, np.inf])
    assert encoders.length_valid.tolist() == [True, False, True]
    assert encoders.tension_valid.tolist() == [False, True, False]
    assert bytes(encoders)[Encoders._length_valid.offset] == 0b101
    assert encoders.length_m.tolist() == [1.0, 0.0, 3.0]
    response = Response()
    response.text = "ä" * 100
    assert response.text == "ä" * 64
    response.text = "a" + "ä" * 100
    assert response.text == "a" + "ä" * 63


def points_inside(obstacle: Obstacle, points: np.ndarray) -> list[bool]:
    """By the definitions of the kinds, in the obstacle's frame."""
    w, x, y, z = obstacle.quaternion
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    local = (np.asarray(points) - obstacle.position_m) @ turn
    a, b, _ = obstacle.dimensions_m
    if obstacle.kind == payloads.ObstacleKind.CAPSULE:
        axis = np.stack([0 * local[:, 0], 0 * local[:, 0], np.clip(local[:, 2], -a, a)], axis=1)
        return list(np.linalg.norm(local - axis, axis=1) <= b)
    if obstacle.kind == payloads.ObstacleKind.HALF_SPACE:
        return list(local[:, 2] <= 0)
    raise AssertionError(obstacle.kind)


@pytest.mark.parametrize("along", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.3, -0.7, 0.2)])
def test_a_capsule_lies_from_end_to_end(along: tuple[float, float, float]) -> None:
    begin = np.array([0.1, 0.2, -1.0])
    end = begin + along
    made = messages.capsule(4, begin, end, 0.05)
    side = np.cross(along, [0.9, 0.1, 0.4])
    side /= np.linalg.norm(side)
    beyond = end + 0.04 * np.asarray(along) / np.linalg.norm(along)
    points = np.array([begin, end, beyond, end + 0.06 * side, (begin + end) / 2 + 0.04 * side])
    assert points_inside(made, points) == [True, True, True, False, True]


@pytest.mark.parametrize("normal", [(0, 0, 2), (0, 0, -1), (1, 1, 0)])
def test_a_half_space_is_behind_its_plane(normal: tuple[float, float, float]) -> None:
    place = np.array([0.0, 0.0, -1.0])
    made = messages.half_space(1, place, normal)
    assert points_inside(made, np.array([place - normal, place + normal])) == [True, False]


def test_a_set_holds_what_is_given() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    hull = messages.ball(9, (0, 0, 0), 1.0)
    made = messages.obstacle_set([messages.ball(1, (1, 2, 3), 0.5, sigma_m=0.1)], [(hull, corners), (hull, corners)])
    assert (made.count, made.vertex_count) == (3, 8)
    first, second, third = made.obstacles
    assert first.dimensions_m.tolist() == [0.5, 0, 0]
    assert first.covariance_m2.tolist() == pytest.approx([0.01, 0, 0, 0.01, 0, 0.01])
    assert (second.hull_offset, second.hull_count, third.hull_offset) == (0, 4, 4)
    assert made.vertices_m.tolist() == [*corners.tolist(), *corners.tolist()]
    with pytest.raises(ValueError, match="a set holds 64"):
        messages.obstacle_set([first] * 65)
    assert isinstance(made, Obstacles)


def test_targets_are_checked() -> None:
    target = messages.tip_target((1, 2, 3), (0.999, 0, 0, 0))
    assert target.quaternion.tolist() == [1, 0, 0, 0]
    with pytest.raises(ValueError, match=r"length 2\.0000"):
        messages.tip_target((1, 2, 3), (2, 0, 0, 0))
    shape = messages.shape_target(np.ones((4, 2)))
    assert (shape.segment_count, shape.curvature_1pm.tolist()) == (4, [1.0] * 8)
    with pytest.raises(ValueError, match="3 curvatures"):
        messages.shape_target([1, 2, 3])
    assert isinstance(shape, Target)
