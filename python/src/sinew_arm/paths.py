"""A path that the arm follows in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ._payload import FloatArray
from .messages import shape_target, tip_target
from .payloads import Target

_TURN_STEP_S = 1e-3
_SPACE, _TURN = 3, 4


@dataclass(frozen=True)
class Path:
    """Points over time, joined by cubic curves; the arm is at rest at both ends.

    Attributes:
        times_s: (n,), rising, from 0 on.
        values: (n, 7): position (m, base frame) and quaternion `[w x y z]` of the tip; or (n, 2 segments): curvatures (1/m).
        is_shape: Whether `values` are curvatures.

    """

    times_s: FloatArray
    values: FloatArray
    is_shape: bool

    @classmethod
    def of_tip(cls, times_s: npt.ArrayLike, positions_m: npt.ArrayLike, quaternions: npt.ArrayLike) -> Path:
        """A path of the tip: times (n,), positions (n, 3) in m, base frame, quaternions (n, 4) `[w x y z]`, or one for all.

        Raises:
            ValueError: Shapes that do not fit, times that do not rise, numbers that are none.

        """
        times = _times(times_s)
        places = np.asarray(positions_m, dtype=float)
        turns = np.array(np.broadcast_to(np.asarray(quaternions, dtype=float), (len(times), _TURN)))
        if places.shape != (len(times), _SPACE):
            raise ValueError(f"positions_m: shape {places.shape}, expected ({len(times)}, 3)")
        lengths = np.linalg.norm(turns, axis=1, keepdims=True)
        if not np.all(np.abs(lengths - 1) < 1e-2):
            raise ValueError("quaternions: expected unit length (to a hundredth)")
        turns /= lengths
        # q and -q are the same attitude: the nearer one to that before.
        signs = np.sign(np.einsum("ij,ij->i", turns[1:], turns[:-1]))
        turns[1:] *= np.cumprod(np.where(signs == 0, 1, signs))[:, None]
        return cls(times, _finite(np.hstack([places, turns])), is_shape=False)

    @classmethod
    def of_shape(cls, times_s: npt.ArrayLike, curvatures_1pm: npt.ArrayLike) -> Path:
        """A path of the shape: times (n,), curvatures (n, segments, 2) or (n, 2 segments) in 1/m.

        Raises:
            ValueError: As `of_tip`.

        """
        times = _times(times_s)
        curvatures = np.asarray(curvatures_1pm, dtype=float)
        if curvatures.ndim < 2 or len(curvatures) != len(times):
            raise ValueError(f"curvatures_1pm: shape {curvatures.shape}, expected ({len(times)}, segments, 2)")
        flat = curvatures.reshape(len(times), -1)
        if flat.shape[1] % 2:
            raise ValueError(f"curvatures_1pm: {flat.shape[1]} in a row, expected two for each segment")
        return cls(times, _finite(flat), is_shape=True)

    @property
    def duration_s(self) -> float:
        """Time of the last point (s)."""
        return float(self.times_s[-1])

    def at(self, time_s: float, valid_from_ns: int = 0) -> Target:
        """The target of a time; before the first point and behind the last one, those at rest."""
        value, rate = self._value(time_s)
        if self.is_shape:
            return shape_target(value, rate_1pms=rate, valid_from_ns=valid_from_ns)
        return tip_target(
            value[:_SPACE],
            _unit(value[_SPACE:]),
            velocity_mps=rate[:_SPACE],
            angular_velocity_radps=self._turning(time_s),
            valid_from_ns=valid_from_ns,
        )

    def _value(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        times, values = self.times_s, self.values
        if time_s <= times[0] or time_s >= times[-1]:
            end = values[0] if time_s <= times[0] else values[-1]
            return end.copy(), np.zeros_like(end)
        k = int(np.searchsorted(times, time_s, side="right")) - 1
        width = float(times[k + 1] - times[k])
        s = (time_s - float(times[k])) / width
        p, q = values[k], values[k + 1]
        a, b = (width * self._slope(i) for i in (k, k + 1))
        value = (
            (2 * s**3 - 3 * s**2 + 1) * p + (s**3 - 2 * s**2 + s) * a + (3 * s**2 - 2 * s**3) * q + (s**3 - s**2) * b
        )
        rate = (6 * s**2 - 6 * s) * (p - q) + (3 * s**2 - 4 * s + 1) * a + (3 * s**2 - 2 * s) * b
        return value, rate / width

    def _slope(self, k: int) -> FloatArray:
        """Rate at a point: that of the parabola through it and its neighbours; 0 at both ends."""
        times, values = self.times_s, self.values
        if k in (0, len(times) - 1):
            return np.zeros_like(values[k])
        before, behind = float(times[k] - times[k - 1]), float(times[k + 1] - times[k])
        left, right = (values[k] - values[k - 1]) / before, (values[k + 1] - values[k]) / behind
        slope: FloatArray = (behind * left + before * right) / (before + behind)
        return slope

    def _turning(self, time_s: float) -> FloatArray:
        """Angular velocity (rad/s, base frame), by a central difference."""
        early, late = (_unit(self._value(time_s + h)[0][_SPACE:]) for h in (-_TURN_STEP_S, _TURN_STEP_S))
        w0, v0 = early[0], -early[1:]
        w1, v1 = late[0], late[1:]
        vector = w1 * v0 + w0 * v1 + np.cross(v1, v0)
        scalar = w1 * w0 - float(v1 @ v0)
        sine = float(np.linalg.norm(vector))
        angle = 2 * float(np.arctan2(sine, scalar))
        return np.zeros(3) if sine == 0 else vector / sine * (angle / (2 * _TURN_STEP_S))


def _unit(turn: FloatArray) -> FloatArray:
    unit: FloatArray = turn / np.linalg.norm(turn)
    return unit


def _times(times_s: npt.ArrayLike) -> FloatArray:
    times = np.asarray(times_s, dtype=float)
    if times.ndim != 1 or len(times) == 0 or not np.all(np.diff(times) > 0) or times[0] < 0:
        raise ValueError("times_s: expected rising numbers from 0 on")
    return _finite(times)


def _finite(values: FloatArray) -> FloatArray:
    if not np.isfinite(values).all():
        raise ValueError("a path with NaN or infinite numbers")
    return values
