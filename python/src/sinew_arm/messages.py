"""Obstacles, targets and encoder states made from numbers and arrays. All lengths in m, base frame unless said otherwise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .payloads import (
    Encoders,
    EncoderSource,
    Obstacle,
    ObstacleKind,
    Obstacles,
    Request,
    RequestKind,
    Target,
    TargetMode,
    Tip,
)

_UNROTATED = (1.0, 0.0, 0.0, 0.0)
_AT_REST = (0.0, 0.0, 0.0)


def _obstacle(
    kind: ObstacleKind,
    number: int,
    position_m: npt.ArrayLike,
    dimensions_m: npt.ArrayLike,
    quaternion: npt.ArrayLike,
    velocity_mps: npt.ArrayLike,
    sigma_m: float,
) -> Obstacle:
    made = Obstacle()
    made.id = number
    made.kind = kind
    made.position_m = position_m
    made.quaternion = quaternion
    made.velocity_mps = velocity_mps
    made.dimensions_m = dimensions_m
    variance = sigma_m**2
    made.covariance_m2 = (variance, 0.0, 0.0, variance, 0.0, variance)
    return made


def ball(
    number: int,
    position_m: npt.ArrayLike,
    radius_m: float,
    *,
    velocity_mps: npt.ArrayLike = _AT_REST,
    sigma_m: float = 0.0,
) -> Obstacle:
    """A ball around `position_m` (3,).

    `number` is its id within the source, `velocity_mps` (3,) moves it on between two sets, `sigma_m` is the standard
    deviation of its position.
    """
    size = (radius_m, 0.0, 0.0)
    return _obstacle(ObstacleKind.BALL, number, position_m, size, _UNROTATED, velocity_mps, sigma_m)


def capsule(
    number: int,
    begin_m: npt.ArrayLike,
    end_m: npt.ArrayLike,
    radius_m: float,
    *,
    velocity_mps: npt.ArrayLike = _AT_REST,
    sigma_m: float = 0.0,
) -> Obstacle:
    """All points within `radius_m` of the line from `begin_m` (3,) to `end_m` (3,); the rest as `ball`."""
    begin, end = np.asarray(begin_m, dtype=float), np.asarray(end_m, dtype=float)
    along = end - begin
    length = float(np.linalg.norm(along))
    size = (length / 2, radius_m, 0.0)
    turn = _turn_of_z(along / length) if length > 0 else np.array(_UNROTATED)
    return _obstacle(ObstacleKind.CAPSULE, number, (begin + end) / 2, size, turn, velocity_mps, sigma_m)


def box(
    number: int,
    position_m: npt.ArrayLike,
    half_extents_m: npt.ArrayLike,
    quaternion: npt.ArrayLike = _UNROTATED,
    *,
    velocity_mps: npt.ArrayLike = _AT_REST,
    sigma_m: float = 0.0,
) -> Obstacle:
    """A box around `position_m` (3,), `half_extents_m` (3,) along its own axes; `quaternion` `[w x y z]`, box to base."""
    return _obstacle(ObstacleKind.BOX, number, position_m, half_extents_m, quaternion, velocity_mps, sigma_m)


def half_space(
    number: int,
    position_m: npt.ArrayLike,
    normal: npt.ArrayLike,
    *,
    velocity_mps: npt.ArrayLike = _AT_REST,
    sigma_m: float = 0.0,
) -> Obstacle:
    """All that is behind the plane through `position_m` (3,) with the outward `normal` (3,), of any length but 0."""
    outward = np.asarray(normal, dtype=float)
    turn = _turn_of_z(outward / np.linalg.norm(outward))
    return _obstacle(ObstacleKind.HALF_SPACE, number, position_m, _AT_REST, turn, velocity_mps, sigma_m)


def _turn_of_z(direction: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The shortest turn that brings z to a unit vector."""
    x, y, z = direction
    if z < -1 + 1e-12:
        return np.array((0.0, 1.0, 0.0, 0.0))
    turn = np.array((1 + z, -y, x, 0.0))
    unit: npt.NDArray[np.float64] = turn / np.linalg.norm(turn)
    return unit


def obstacle_set(obstacles: Sequence[Obstacle] = (), hulls: Sequence[tuple[Obstacle, npt.ArrayLike]] = ()) -> Obstacles:
    """A set of obstacles; an empty one says that the source looks and sees nothing.

    Args:
        obstacles: Balls, capsules, boxes, half-spaces.
        hulls: Pairs of an obstacle, of which id and frame are taken, and the vertices (n, 3) of its hull in that frame.

    Raises:
        ValueError: More than a set can hold.

    """
    made = Obstacles()
    places = made._obstacles
    listed = [*obstacles, *(obstacle for obstacle, _ in hulls)]
    if len(listed) > len(places):
        raise ValueError(f"{len(listed)} obstacles, a set holds {len(places)}")
    for place, obstacle in enumerate(listed):
        places[place] = obstacle
    made.count = len(listed)
    vertices: list[npt.NDArray[np.float64]] = []
    for place, (_, corners) in enumerate(hulls, start=len(obstacles)):
        given = np.asarray(corners, dtype=float)
        inside = places[place]
        inside.kind = ObstacleKind.HULL
        inside.hull_offset = sum(map(len, vertices))
        inside.hull_count = len(given)
        vertices.append(given)
    if vertices:
        made.vertex_count = sum(map(len, vertices))
        made.vertices_m = np.concatenate(vertices)
    return made


def tip_target(
    position_m: npt.ArrayLike,
    quaternion: npt.ArrayLike,
    *,
    velocity_mps: npt.ArrayLike = _AT_REST,
    angular_velocity_radps: npt.ArrayLike = _AT_REST,
    valid_from_ns: int = 0,
) -> Target:
    """A pose of the tip: position (3,), quaternion (4,) `[w x y z]`, tip to base, which is normalised.

    Args:
        position_m: Position.
        quaternion: Attitude.
        velocity_mps: Velocity (3,) there.
        angular_velocity_radps: Angular velocity (3,) there (rad/s).
        valid_from_ns: When the tip shall be there (ns, CLOCK_MONOTONIC); 0: at once.

    Raises:
        ValueError: A quaternion that is far from unit length.

    """
    turn = np.asarray(quaternion, dtype=float)
    length = float(np.linalg.norm(turn))
    if not abs(length - 1) < 1e-2:
        raise ValueError(f"the quaternion has length {length:.4f}, expected 1 (to a hundredth)")
    made = Target()
    made.mode = TargetMode.TIP
    made.position_m = position_m
    made.quaternion = turn / length
    made.velocity_mps = velocity_mps
    made.angular_velocity_radps = angular_velocity_radps
    made.valid_from_ns = valid_from_ns
    return made


def shape_target(
    curvature_1pm: npt.ArrayLike, *, rate_1pms: npt.ArrayLike | None = None, valid_from_ns: int = 0
) -> Target:
    """A shape: the average curvature (1/m) of each segment about its local y and z, (segments, 2) or flat.

    Args:
        curvature_1pm: Curvatures.
        rate_1pms: Their rates (1/(m s)), of the same shape.
        valid_from_ns: When the arm shall have it (ns, CLOCK_MONOTONIC); 0: at once.

    Raises:
        ValueError: Not two for each segment.

    """
    flat = np.asarray(curvature_1pm, dtype=float).reshape(-1)
    if len(flat) == 0 or len(flat) % 2:
        raise ValueError(f"{len(flat)} curvatures, expected two for each segment")
    made = Target()
    made.mode = TargetMode.SHAPE
    made.segment_count = len(flat) // 2
    made.quaternion = _UNROTATED
    made.curvature_1pm = flat
    made.curvature_rate_1pms = np.zeros_like(flat) if rate_1pms is None else np.asarray(rate_1pms).reshape(-1)
    made.valid_from_ns = valid_from_ns
    return made


def encoder_state(length_m: npt.ArrayLike, tension_n: npt.ArrayLike | None = None) -> Encoders:
    """Measured cables, base to tip: lengths (cables,) in m and tensions (cables,) in N. NaN marks what is not valid."""
    lengths = np.asarray(length_m, dtype=float)
    tensions = np.full(lengths.shape, np.nan) if tension_n is None else np.asarray(tension_n, dtype=float)
    made = Encoders()
    made.source = EncoderSource.EXTERNAL
    made.cable_count = len(lengths)
    made.length_valid = np.isfinite(lengths)
    made.tension_valid = np.isfinite(tensions)
    made.length_m = np.nan_to_num(lengths)
    made.tension_n = np.nan_to_num(tensions)
    return made


def measured_tip(position_m: npt.ArrayLike) -> Tip:
    """Where a sensor outside of the arm sees the tip: position (3,) in m, base frame."""
    made = Tip()
    made.position_m = np.asarray(position_m, dtype=float)
    return made


def request(kind: RequestKind, *, target: Target | None = None, speed_scale: float = 1.0) -> Request:
    """A request as it goes through shared memory."""
    made = Request()
    made.kind = kind
    made.target = target or tip_target(_AT_REST, _UNROTATED)
    made.speed_scale = speed_scale
    return made
