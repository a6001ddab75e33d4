"""What is waited for and what is sent along the way, without a connection: for the blocking and the asynchronous client."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ._payload import FloatArray
from .errors import FaultError, InterruptedMotionError
from .paths import Path
from .payloads import State, SupervisorState, Target

# How far ahead of time points are sent (s): beyond the planner's lookahead and lead.
_AHEAD_S = 0.4
# Least time between two points (s): the daemon keeps 64 of them.
_POINTS_S = 0.01
# The first records may be those of before the request.
_GRACE_TICKS = 20
_NS = 1_000_000_000


def fault(state: State, report: dict[str, Any] | None) -> FaultError:
    """The latched fault, in the daemon's words where its report has them."""
    said = (report or {}).get("fault") or {}
    what = said.get("what", f"see docs/CODES.md (detail {state.fault_detail})")
    return FaultError(state.fault_code, state.fault_detail, what, said.get("clears", ""))


def alarms(report: dict[str, Any] | None) -> str:
    """What is wrong, in the daemon's words; empty where nothing is."""
    listed = (report or {}).get("alarms") or []
    return "; ".join(f"{alarm.get('about', '')}: {alarm.get('what', '')}" for alarm in listed)


@dataclass
class Wait:
    """Until the arm is in a mode; `on_the_way` are those in which it may be until then."""

    goal: SupervisorState
    on_the_way: tuple[SupervisorState, ...]
    first_tick: int | None = None

    def left(self, state: State) -> bool:
        """Whether the arm is in a mode that leads elsewhere; one of before the request does not count."""
        if self.first_tick is None:
            self.first_tick = state.header.tick
        early = state.header.tick < self.first_tick + _GRACE_TICKS
        return not early and state.supervisor not in (self.goal, *self.on_the_way)

    def failed(self, state: State) -> bool:
        """Whether the arm will not get there: it left, or a fault is latched."""
        stops = self.goal is SupervisorState.DISARMED
        return (state.supervisor is SupervisorState.FAULTED and not stops) or self.left(state)

    def reached(self, state: State) -> bool:
        """Whether the arm is there."""
        return state.supervisor is self.goal


def check(state: State, wait: Wait, report: dict[str, Any] | None) -> None:
    """Raises why the arm will not get there (`Wait.failed`).

    Raises:
        FaultError: A fault is latched.
        InterruptedMotionError: The arm does something else.

    """
    if state.supervisor is SupervisorState.FAULTED:
        raise fault(state, report)
    why = alarms(report)
    text = f"the arm is {state.supervisor}, not {wait.goal}" + (f": {why}" if why else "")
    raise InterruptedMotionError(text, state.supervisor)


@dataclass(frozen=True)
class Track:
    """What came of following a path; a row for each record that was seen.

    Attributes:
        times_s: (n,), of the path; negative on the way to its first point.
        tip_position_m: (n, 3), estimated, base frame.
        target_position_m: (n, 3), asked for; NaN for a shape.
        tip_error_m: (n,); NaN for a shape.
        curvature_1pm: (n, 2 segments), estimated.
        curvature_error_1pm: (n,); NaN for a path of the tip.
        tension_n: (n, cables), commanded.

    """

    times_s: FloatArray
    tip_position_m: FloatArray
    target_position_m: FloatArray
    tip_error_m: FloatArray
    curvature_1pm: FloatArray
    curvature_error_1pm: FloatArray
    tension_n: FloatArray

    @classmethod
    def of(cls, times_s: list[float], states: list[State]) -> Track:
        """Of the records and their times."""

        def rows(name: str) -> FloatArray:
            return np.array([getattr(state, name) for state in states], dtype=float)

        return cls(
            np.array(times_s),
            rows("tip_position_m"),
            rows("target_position_m"),
            rows("tip_error_m"),
            rows("curvature_1pm"),
            rows("curvature_error_1pm"),
            rows("tension_command_n"),
        )


@dataclass
class Following:
    """A path that is sent ahead of the arm, in the time of the daemon's records."""

    path: Path
    approach_s: float
    origin_ns: int | None = None
    sent_s: float = -np.inf
    times_s: list[float] = field(default_factory=list)
    wait: Wait = field(
        default_factory=lambda: Wait(SupervisorState.TRACKING, (SupervisorState.TRACKING,)),
    )

    def first(self) -> Target:
        """Where the path begins."""
        return self.path.at(0.0)

    def last(self) -> Target:
        """Where it ends, to be held."""
        return self.path.at(self.path.duration_s)

    def now_s(self, state: State) -> float | None:
        """Time of the path at a record; `None` before the arm tracks."""
        if self.origin_ns is None:
            if state.supervisor is not SupervisorState.TRACKING:
                return None
            self.origin_ns = state.header.capture_ns + round(self.approach_s * _NS)
        return (state.header.capture_ns - self.origin_ns) / _NS

    def due(self, now_s: float) -> Target | None:
        """The point to be sent at a time of the path."""
        point_s = min(now_s + _AHEAD_S, self.path.duration_s)
        if point_s < 0 or point_s < self.sent_s + _POINTS_S - 1e-9 or self.sent_s >= self.path.duration_s:
            return None
        self.sent_s = point_s
        origin = self.origin_ns or 0
        return self.path.at(point_s, valid_from_ns=origin + round(point_s * _NS))

    def over(self, now_s: float) -> bool:
        """Whether the path's time is over."""
        return now_s >= self.path.duration_s
