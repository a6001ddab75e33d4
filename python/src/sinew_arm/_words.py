"""Lines of the arm's socket, without the socket: what is said, and what an answer means."""

from __future__ import annotations

import json
from typing import Any

from .errors import IncompatibleError, NotPermittedError, RefusedError
from .payloads import FLAG_LEAVING, NO_TICK, ObstacleKind, Obstacles, RefusalReason, SupervisorState, Target, TargetMode

# What only stops an arm goes to every daemon of the arm that is found.
STOPPING = ("stop", "hold", "disarm", "emergency-stop")
_SHORTEST_SPEED = 0.01


def speed_line(scale: float) -> str:
    """The line that asks for a share of the configured speed.

    Raises:
        ValueError: It is not between 0.01 and 1.

    """
    if not _SHORTEST_SPEED <= scale <= 1:
        raise ValueError(f"speed {scale}: expected 0.01 to 1, a share of the configured speed")
    return f"speed {scale!r}"


def target_fields(target: Target, *, stamped: bool) -> dict[str, Any]:
    """A target as the socket takes it; stamped with its capture time, or as old as the moment at which it is taken."""
    fields: dict[str, Any] = {"weight": target.weight, "valid_from_ns": target.valid_from_ns}
    if stamped:
        fields |= stamps(target.header.capture_ns, target.header.tick)
    if target.mode is TargetMode.SHAPE:
        fields["curvature_1pm"] = target.curvature_1pm.tolist()
        fields["curvature_rate_1pms"] = target.curvature_rate_1pms.tolist()
    else:
        for name in ("position_m", "quaternion", "velocity_mps", "angular_velocity_radps"):
            fields[name] = getattr(target, name).tolist()
    return fields


def obstacle_fields(obstacles: Obstacles) -> dict[str, Any]:
    """A set of obstacles as the socket takes it."""
    words = {
        ObstacleKind.BALL: "ball",
        ObstacleKind.CAPSULE: "capsule",
        ObstacleKind.BOX: "box",
        ObstacleKind.HALF_SPACE: "half-space",
        ObstacleKind.HULL: "hull",
    }
    arrays = ("position_m", "quaternion", "velocity_mps", "dimensions_m", "covariance_m2")
    listed = []
    for obstacle in obstacles.obstacles:
        fields = {name: getattr(obstacle, name).tolist() for name in arrays}
        fields |= {"id": obstacle.id, "kind": words.get(obstacle.kind, "unknown")}
        listed.append(fields | {"hull_offset": obstacle.hull_offset, "hull_count": obstacle.hull_count})
    leaving = {"leaving": True} if obstacles.flags & FLAG_LEAVING else {}
    stamped = stamps(obstacles.header.capture_ns, obstacles.header.tick)
    return {**stamped, **leaving, "obstacles": listed, "vertices_m": obstacles.vertices_m.tolist()}


def stamps(capture_ns: int, tick: int) -> dict[str, int]:
    """Capture time, and the tick where there is one."""
    return {"capture_ns": capture_ns} if tick == NO_TICK else {"capture_ns": capture_ns, "tick": tick}


def understand(asked: str, text: bytes) -> Any:
    """What the daemon answered: the report, or the mode that its answer tells.

    Raises:
        NotPermittedError: It does not listen to this user, or did not understand.
        RefusedError: It does not carry the request out.
        IncompatibleError: It says something else.

    """
    try:
        said = json.loads(text)
    except ValueError:
        raise IncompatibleError(f"an answer that is none: {text[:80]!r}; is the daemon of another version?") from None
    if said == "taken":
        return said
    if isinstance(said, dict) and "refused" in said:
        raise NotPermittedError(f"the daemon refuses: {said['refused']}")
    if isinstance(said, dict) and "status" in said:
        return said["status"]
    if isinstance(said, dict) and "answer" in said:
        answer = said["answer"]
        supervisor = SupervisorState(answer["supervisor"])
        if answer["accepted"]:
            return supervisor
        reason = RefusalReason(answer["reason"])
        raise RefusedError(asked, reason, answer["detail"], supervisor, answer["fault_code"], answer["text"])
    raise IncompatibleError(f"an answer to something else: {text[:80]!r}; is the daemon of another version?")
