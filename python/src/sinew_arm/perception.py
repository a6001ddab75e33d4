"""From a depth camera's picture to obstacles: points, clusters, and balls and capsules that cover them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

from ._payload import FloatArray
from .errors import SinewError
from .messages import ball, capsule
from .payloads import Obstacle

_OBSTACLES_MAX = 64
# Beyond this ratio of its extents a cluster is longer than thick.
_LONG = 1.6
# Of the distance that a cluster may move between two pictures, over its largest extent.
_SAME = 1.0


def points_of_depth(
    depth_m: npt.ArrayLike,
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    position_m: npt.ArrayLike,
    quaternion: npt.ArrayLike,
    *,
    range_m: tuple[float, float] = (0.1, 10.0),
) -> FloatArray:
    """Points (n, 3) in the base frame of a depth picture.

    Args:
        depth_m: (rows, columns), distance along the camera's z axis; NaN and what is out of range is left out.
        focal_px: Focal lengths along x (columns, to the right) and y (rows, down).
        centre_px: Where the z axis meets the picture, (x, y).
        position_m: (3,), place of the camera.
        quaternion: (4,) `[w x y z]`, camera to base.
        range_m: Least and largest depth that is believed.

    """
    depth = np.asarray(depth_m, dtype=float)
    rows, columns = (np.asarray(index) for index in np.indices(depth.shape))
    seen = np.isfinite(depth) & (depth >= range_m[0]) & (depth <= range_m[1])
    z = depth[seen]
    x = (columns[seen] - centre_px[0]) / focal_px[0] * z
    y = (rows[seen] - centre_px[1]) / focal_px[1] * z
    points: FloatArray = np.stack([x, y, z], axis=1) @ rotation(quaternion).T + np.asarray(position_m, dtype=float)
    return points


def rotation(quaternion: npt.ArrayLike) -> FloatArray:
    """Rotation matrix (3, 3) of a quaternion `[w x y z]`, which is normalised."""
    given = np.asarray(quaternion, dtype=float)
    w, x, y, z = given / np.linalg.norm(given)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def without_arm(points_m: npt.ArrayLike, node_position_m: npt.ArrayLike, radius_m: float) -> FloatArray:
    """Points (n, 3) farther than `radius_m` from the line through an arm's nodes (m, 3), such as `State.node_position_m`.

    A camera sees the arm, too, and the arm cannot keep from itself. `State` has no base node: put it first.
    """
    points, nodes = np.asarray(points_m, dtype=float), np.asarray(node_position_m, dtype=float)
    least = np.full(len(points), np.inf)
    for begin, end in zip(nodes[:-1], nodes[1:]):
        least = np.minimum(least, _distance(points, begin, end))
    kept: FloatArray = points[least > radius_m]
    return kept


def clusters(points_m: npt.ArrayLike, gap_m: float, *, points_min: int = 5) -> list[FloatArray]:
    """Parts of a cloud (n, 3) that a gap of about `gap_m` lies between, the largest first.

    Points are counted into cubes of that size, and cubes that touch belong together. Parts of fewer than `points_min` are
    taken for noise.
    """
    points = np.asarray(points_m, dtype=float).reshape(-1, 3)
    places, cube_of = np.unique(np.floor(points / gap_m).astype(np.int64), axis=0, return_inverse=True)
    numbers = {tuple(place): number for number, place in enumerate(places.tolist())}
    label = np.full(len(places), -1)
    around = [step for step in product((-1, 0, 1), repeat=3) if step != (0, 0, 0)]
    count = 0
    for first in range(len(places)):
        if label[first] >= 0:
            continue
        label[first] = count
        waiting = [first]
        while waiting:
            x, y, z = places[waiting.pop()].tolist()
            for dx, dy, dz in around:
                near = numbers.get((x + dx, y + dy, z + dz))
                if near is not None and label[near] < 0:
                    label[near] = count
                    waiting.append(near)
        count += 1
    labels = label[cube_of.reshape(-1)]
    parts = [points[labels == number] for number in range(count)]
    return sorted((part for part in parts if len(part) >= points_min), key=len, reverse=True)


def cover(points_m: npt.ArrayLike, *, margin_m: float = 0.0, radius_m_max: float = np.inf) -> list[Obstacle]:
    """Balls and capsules around a cluster (n, 3), numbered from 1: no point is outside of all of them.

    A cluster that is longer than thick becomes a capsule. One that needs a larger radius than `radius_m_max` is halved
    across its longest axis, again and again. `margin_m` is added to each radius: a camera sees a surface, and with noise.
    """
    return list(_covers(np.asarray(points_m, dtype=float), 1, margin_m, radius_m_max))


def _covers(points: FloatArray, number: int, margin_m: float, radius_m_max: float) -> Iterator[Obstacle]:
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False) if len(points) > 2 else (None, None, np.eye(3))
    local = (points - middle) @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    extent = high - low
    centre = middle + (low + high) / 2 @ axes
    thick = float(np.hypot(extent[1], extent[2]))
    if extent[0] > _LONG * thick:
        axis = np.hypot(local[:, 1] - (low + high)[1] / 2, local[:, 2] - (low + high)[2] / 2)
        radius = max(float(axis.max()), 1e-4)
        # The round ends reach as far as the points do on the axis, and those beside it are nearer than the middle's.
        half = extent[0] / 2
        begin, end = centre - half * axes[0], centre + half * axes[0]
        made = capsule(number, begin, end, radius + margin_m)
    else:
        radius = max(float(np.linalg.norm(points - centre, axis=1).max()), 1e-4)
        made = ball(number, centre, radius + margin_m)
    if radius <= radius_m_max or len(points) < 2 or extent[0] <= 0:
        yield made
        return
    left = local[:, 0] <= (low + high)[0] / 2
    first = list(_covers(points[left], number, margin_m, radius_m_max))
    yield from first
    yield from _covers(points[~left], number + len(first), margin_m, radius_m_max)


class Tracker:
    """Obstacles from one cloud after the other: what is seen again keeps its id, and has a velocity."""

    def __init__(self, gap_m: float, *, margin_m: float = 0.0, points_min: int = 5, smoothing_s: float = 0.2) -> None:
        """Settings as of `clusters` and `cover`; velocities are smoothed over `smoothing_s`."""
        self._gap_m = gap_m
        self._margin_m = margin_m
        self._points_min = points_min
        self._smoothing_s = smoothing_s
        self._next = 1
        self._known: list[tuple[int, FloatArray, FloatArray]] = []
        self._at_s = 0.0

    def update(self, points_m: npt.ArrayLike, time_s: float) -> list[Obstacle]:
        """The obstacles of a cloud (n, 3) that was taken at a time (s).

        Raises:
            SinewError: More than a set can hold: a larger gap, or more points to a cluster.

        """
        found = [cover(part, margin_m=self._margin_m)[0] for part in self._parts(points_m)]
        step_s = time_s - self._at_s
        known, self._known = self._known, []
        for obstacle in found:
            place = obstacle.position_m.copy()
            reach = _SAME * float(obstacle.dimensions_m.sum())
            near = min(known, key=lambda k: float(np.linalg.norm(k[1] + step_s * k[2] - place)), default=None)
            if near is not None and np.linalg.norm(near[1] + step_s * near[2] - place) < reach and step_s > 0:
                known = [k for k in known if k is not near]
                number, before, velocity = near
                share = min(1.0, step_s / self._smoothing_s)
                velocity = velocity + share * ((place - before) / step_s - velocity)
            else:
                number, velocity = self._next, np.zeros(3)
                self._next += 1
            obstacle.id = number
            obstacle.velocity_mps = velocity
            self._known.append((number, place, velocity))
        self._at_s = time_s
        return found

    def _parts(self, points_m: npt.ArrayLike) -> Sequence[FloatArray]:
        parts = clusters(points_m, self._gap_m, points_min=self._points_min)
        if len(parts) > _OBSTACLES_MAX:
            raise SinewError(
                f"{len(parts)} clusters, a set holds {_OBSTACLES_MAX}: take a larger gap or more points to each"
            )
        return parts


def _distance(points: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Of points (n, 3) from a line between two points."""
    along = end - begin
    square = float(along @ along)
    share = np.clip((points - begin) @ along / square, 0, 1) if square > 0 else np.zeros(len(points))
    distance: FloatArray = np.linalg.norm(points - begin - share[:, None] * along, axis=1)
    return distance
