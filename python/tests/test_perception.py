"""From a depth picture to obstacles, without a daemon."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sinew_arm import SinewError
from sinew_arm.payloads import Obstacle, ObstacleKind
from sinew_arm.perception import Tracker, clusters, cover, points_of_depth, rotation, without_arm

Points = npt.NDArray[np.float64]


def sphere(centre: tuple[float, float, float], radius: float, count: int = 400) -> Points:
    made = np.random.default_rng(1).normal(size=(count, 3))
    points: Points = np.asarray(centre) + radius * made / np.linalg.norm(made, axis=1, keepdims=True)
    return points


def rod(begin: tuple[float, float, float], end: tuple[float, float, float], radius: float, count: int = 600) -> Points:
    rng = np.random.default_rng(2)
    along = np.asarray(end, dtype=float) - begin
    side = np.linalg.svd(along[None])[2][1:]
    angle = rng.uniform(0, 2 * np.pi, count)
    around = radius * (np.cos(angle)[:, None] * side[0] + np.sin(angle)[:, None] * side[1])
    points: Points = np.asarray(begin) + rng.uniform(0, 1, count)[:, None] * along + around
    return points


def outside(points: Points, obstacles: list[Obstacle]) -> float:
    """How far the farthest point is outside of all obstacles."""
    least = np.full(len(points), np.inf)
    for obstacle in obstacles:
        local = (points - obstacle.position_m) @ rotation(obstacle.quaternion)
        a, b, _ = obstacle.dimensions_m
        if obstacle.kind == ObstacleKind.BALL:
            distance = np.linalg.norm(local, axis=1) - a
        else:
            assert obstacle.kind == ObstacleKind.CAPSULE
            local[:, 2] -= np.clip(local[:, 2], -a, a)
            distance = np.linalg.norm(local, axis=1) - b
        least = np.minimum(least, distance)
    return float(least.max())


def test_a_picture_becomes_points_where_they_are() -> None:
    # The camera looks along the base's x axis, its x axis is -y of the base.
    turn = (0.5, -0.5, 0.5, -0.5)
    depth = np.full((3, 5), np.nan)
    depth[1, 2] = 2.0
    depth[1, 4] = 2.0
    depth[2, 2] = 4.0
    depth[0, 0] = 100.0
    points = points_of_depth(depth, (10.0, 10.0), (2.0, 1.0), (1.0, 0.0, 0.5), turn)
    expected = [[3.0, 0.0, 0.5], [3.0, -0.4, 0.5], [5.0, 0.0, 0.1]]
    assert points == pytest.approx(np.array(expected))


def test_what_a_gap_lies_between_is_apart() -> None:
    one, two = sphere((0, 0, 0), 0.1), sphere((0.5, 0, 0), 0.1, 200)
    noise = np.array([[3.0, 3.0, 3.0]])
    parts = clusters(np.concatenate([two, one, noise]), 0.05)
    assert [len(part) for part in parts] == [400, 200]
    assert np.allclose(np.sort(parts[0], axis=0), np.sort(one, axis=0))
    assert len(clusters(np.concatenate([one, two]), 0.6)) == 1
    assert clusters(np.empty((0, 3)), 0.1) == []


def test_a_ball_is_covered_by_a_ball_and_a_rod_by_a_capsule() -> None:
    points = sphere((0.3, -0.2, -1.0), 0.1)
    (made,) = cover(points, margin_m=0.01)
    assert made.kind == ObstacleKind.BALL
    assert made.position_m == pytest.approx([0.3, -0.2, -1.0], abs=0.01)
    assert made.dimensions_m[0] == pytest.approx(0.11, abs=0.01)
    assert outside(points, [made]) <= -0.01 + 1e-9
    points = rod((0.1, 0.2, -1.0), (0.9, 0.5, -1.3), 0.04)
    (made,) = cover(points)
    assert made.kind == ObstacleKind.CAPSULE
    assert made.dimensions_m[:2] == pytest.approx([0.45, 0.04], abs=0.02)
    assert outside(points, [made]) < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_left_outside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(rng.integers(1, 60), 3)) * rng.uniform(0.01, 1, 3) + rng.normal(size=3)
    for most in (np.inf, 0.2, 0.05):
        made = cover(points, radius_m_max=most)
        assert outside(points, made) < 1e-9
        assert [obstacle.id for obstacle in made] == list(range(1, len(made) + 1))
        radii = [obstacle.dimensions_m[int(obstacle.kind == ObstacleKind.CAPSULE)] for obstacle in made]
        assert max(radii) <= most


def test_the_arm_itself_is_left_out() -> None:
    nodes = np.array([[0, 0, 0], [0, 0, -1], [1, 0, -1]], dtype=float)
    points = np.array([[0.05, 0, -0.5], [0.2, 0, -0.5], [0.5, 0.09, -1], [1.2, 0, -1], [1.05, 0, -1]])
    assert without_arm(points, nodes, 0.1).tolist() == points[[1, 3]].tolist()


def test_what_moves_keeps_its_id_and_has_a_velocity() -> None:
    tracker = Tracker(0.05, margin_m=0.01)
    still = sphere((1, 1, 0), 0.1)
    mover = 0
    for k in range(30):
        moving = sphere((0.02 * k, 0.0, 0.0), 0.1)
        seen = tracker.update(np.concatenate([still, moving] if k % 2 else [moving, still]), 0.1 * k)
        numbers = {obstacle.position_m[1] > 0.5: obstacle for obstacle in seen}
        assert {obstacle.id for obstacle in seen} == {1, 2}
        mover = numbers[False].id if k == 0 else mover
        assert numbers[False].id == mover
    assert numbers[False].velocity_mps == pytest.approx([0.2, 0, 0], abs=1e-3)
    assert numbers[True].velocity_mps == pytest.approx([0, 0, 0], abs=1e-6)
    (back,) = tracker.update(sphere((5, 5, 5), 0.1), 3.0)
    assert back.id == 3
    crowd = np.concatenate([sphere((k, 0, 0), 0.1, 20) for k in range(65)])
    with pytest.raises(SinewError, match="65 clusters"):
        Tracker(0.3).update(crowd, 0.0)
