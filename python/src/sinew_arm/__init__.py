"""Client of sinew, the real-time controller of cable-driven continuum arms."""

from __future__ import annotations

from ._motion import Track
from .aio import AsyncArm
from .client import Arm
from .design import plan, simulate
from .domain import Domain
from .errors import (
    FaultError,
    IncompatibleError,
    InterruptedMotionError,
    NoDaemonError,
    NotPermittedError,
    RefusedError,
    RejectedError,
    SinewError,
    TimedOutError,
    UnusableError,
)
from .messages import (
    ball,
    box,
    capsule,
    encoder_state,
    half_space,
    measured_tip,
    obstacle_set,
    request,
    shape_target,
    tip_target,
)
from .paths import Path
from .payloads import Encoders, Obstacle, Obstacles, Request, RequestKind, Response, State, SupervisorState, Target, Tip
from .recording import Recording
from .simulated import SimulatedArm
from .sources import Source, Watch

__all__ = [
    "Arm",
    "AsyncArm",
    "Domain",
    "Encoders",
    "FaultError",
    "IncompatibleError",
    "InterruptedMotionError",
    "NoDaemonError",
    "NotPermittedError",
    "Obstacle",
    "Obstacles",
    "Path",
    "Recording",
    "RefusedError",
    "RejectedError",
    "Request",
    "RequestKind",
    "Response",
    "SimulatedArm",
    "SinewError",
    "Source",
    "State",
    "SupervisorState",
    "Target",
    "TimedOutError",
    "Tip",
    "Track",
    "UnusableError",
    "Watch",
    "ball",
    "box",
    "capsule",
    "encoder_state",
    "half_space",
    "measured_tip",
    "obstacle_set",
    "plan",
    "request",
    "shape_target",
    "simulate",
    "tip_target",
]

__version__ = "0.1.0"
