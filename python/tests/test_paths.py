"""Paths, without a daemon."""

from __future__ import annotations

import numpy as np
import pytest

from sinew_arm import Path
from sinew_arm.paths import Path as SamePath

UNROTATED = (1.0, 0.0, 0.0, 0.0)


def circle(points: int = 41) -> Path:
    times = np.linspace(0, 4, points)
    places = np.stack([np.cos(times), np.sin(times), 0 * times - 2], axis=1)
    turns = np.stack([np.cos(times / 2), 0 * times, 0 * times, np.sin(times / 2)], axis=1)
    return Path.of_tip(times, places, turns)


def test_a_path_goes_through_its_points_and_rests_at_both_ends() -> None:
    path = circle()
    for k in (0, 7, 40):
        target = path.at(float(path.times_s[k]))
        assert np.allclose(target.position_m, path.values[k, :3])
        assert np.allclose(target.quaternion, path.values[k, 3:])
    for time_s in (-1.0, 0.0, 4.0, 9.0):
        target = path.at(time_s)
        assert not target.velocity_mps.any()
    assert np.allclose(path.at(9.0).position_m, path.values[-1, :3])
    assert path.duration_s == 4
    assert path.at(1.0, valid_from_ns=5).valid_from_ns == 5


def test_between_points_it_is_near_the_curve_with_its_rates() -> None:
    path = circle()
    for time_s in (1.03, 2.07, 3.0):
        target = path.at(time_s)
        assert np.allclose(target.position_m, [np.cos(time_s), np.sin(time_s), -2], atol=1e-4)
        assert np.allclose(target.velocity_mps, [-np.sin(time_s), np.cos(time_s), 0], atol=5e-3)
        assert np.allclose(target.angular_velocity_radps, [0, 0, 1], atol=5e-3)
        assert np.linalg.norm(target.quaternion) == pytest.approx(1)


def test_a_quaternion_of_the_other_sign_is_the_same_attitude() -> None:
    path = circle(5)
    flipped = path.values[:, 3:] * np.array([1, -1, -1, 1, -1])[:, None]
    same = Path.of_tip(path.times_s, path.values[:, :3], flipped)
    assert np.allclose(same.values, path.values)


def test_a_shape_has_rates_too() -> None:
    times = np.linspace(0, 2, 21)
    curvatures = np.stack([times**2, -times], axis=1)[:, None, :]
    target = Path.of_shape(times, curvatures).at(1.0)
    assert np.allclose(target.curvature_1pm, [1, -1])
    assert np.allclose(target.curvature_rate_1pms, [2, -1])


@pytest.mark.parametrize(
    ("times", "places", "turns", "words"),
    [
        ([0, 0], np.zeros((2, 3)), UNROTATED, "rising"),
        ([-1, 0], np.zeros((2, 3)), UNROTATED, "rising"),
        ([], np.zeros((0, 3)), UNROTATED, "rising"),
        ([0, 1], np.zeros((2, 2)), UNROTATED, "expected \\(2, 3\\)"),
        ([0, 1], np.zeros((2, 3)), (2, 0, 0, 0), "unit length"),
        ([0, 1], np.full((2, 3), np.nan), UNROTATED, "NaN"),
    ],
)
def test_what_is_no_path_is_refused(times: list[float], places: np.ndarray, turns: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Path.of_tip(times, places, turns)  # type: ignore[arg-type]


def test_a_shape_of_an_odd_number_is_refused() -> None:
    with pytest.raises(ValueError, match="two for each segment"):
        SamePath.of_shape([0, 1], np.zeros((2, 3)))
    with pytest.raises(ValueError, match="segments, 2"):
        SamePath.of_shape([0, 1], np.zeros(2))
