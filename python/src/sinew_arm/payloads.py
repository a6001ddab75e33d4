"""What lies in shared memory: payloads and codes.

Made by `python/generate.py` from `src/ipc/PAYLOADS.md`; not to be edited. Arrays are views of the payload,
cut to what is in use; assigning to one fills the places behind with zeros.
"""

from __future__ import annotations

import ctypes
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ._payload import BoolArray, Code, FloatArray, IntArray, Payload

SCHEMA_VERSION = 1
"""Version of all payloads."""
NO_TICK = 2**64 - 1
"""`Header.tick` of what belongs to no tick."""
FLAG_LEAVING = 1
"""`Obstacles.flags`: the source ends in order."""


class ObstacleKind(Code):
    """Shape of an obstacle in its own frame."""

    BALL = 1
    """`dimensions_m = [radius, 0, 0]`."""
    CAPSULE = 2
    """Along the local z axis, `dimensions_m = [half length between the centres, radius, 0]`."""
    BOX = 3
    """`dimensions_m` = half extents along the local axes."""
    HALF_SPACE = 4
    """Solid below the plane through the local origin whose outward normal is the local z axis."""
    HULL = 5
    """Convex hull of the vertices `hull_offset..hull_offset + hull_count` of the set, in the local frame."""


class TargetMode(Code):
    """What a target asks for."""

    TIP = 1
    """Tip pose and twist."""
    SHAPE = 2
    """Average curvature of each segment about its local y and z."""


class EncoderSource(Code):
    """Who measured the cables."""

    DRIVES = 1
    """The drives, over the bus."""
    EXTERNAL = 2
    """A sensor on another wire."""
    REPLAY = 3
    """A recording that is played back."""


class SupervisorState(Code):
    """State of the supervisor."""

    DISARMED = 0
    """Drives without torque."""
    ARMING = 1
    """Drives enabled, the observer settles, the pose is held."""
    HOLDING = 2
    """The pose is held."""
    TRACKING = 3
    """The target is followed."""
    HOMING = 4
    """On the way to the home pose."""
    STOPPING = 5
    """On the way to rest, then disarmed."""
    FAULTED = 6
    """Latched; `fault_code` and `fault_detail` hold the cause, `clear` releases it."""


class PlannerStatus(Code):
    """How the planner ended in a tick."""

    IDLE = 0
    """It did not run."""
    CONVERGED = 1
    """Converged."""
    BUDGET_SPENT = 2
    """Time or work budget spent; the best answer so far, inside its bounds."""
    RELAXED = 3
    """Distance constraints conflicted and were relaxed."""
    FAILED = 4
    """No usable answer; the last tensions were kept."""


class PlannerBranch(Code):
    """Which branch of the planner gave the answer."""

    NONE = 0
    """None."""
    SAFE = 1
    """Safe subspace: complementarity of the tension box alone."""
    SWARM = 2
    """Warning subspace, by the swarm."""
    SEEDED = 3
    """Warning subspace, by the swarm seeded with the complementarity solution."""
    COMPLEMENTARITY = 4
    """Warning subspace, by complementarity with distance rows."""
    STANDARD_SWARM = 5
    """Warning subspace, by the standard swarm."""


class SourceHealth(Code):
    """How fresh a source of inputs is."""

    ABSENT = 0
    """This place is not used, or nothing was ever accepted."""
    FRESH = 1
    """Newer than `stale_after`."""
    STALE = 2
    """Older than `stale_after`: obstacles grow with age."""
    EXPIRED = 3
    """Older than `hold_after`: the arm is asked to hold."""
    HELD = 4
    """A target that stands still and is held: its age does not matter."""
    REFUSED = 5
    """It sends, or sent, and nothing of it was ever accepted: the arm is asked to hold."""


class RejectCause(Code):
    """Why an input was not taken over; the place of its counter in `SourceReport.rejected`."""

    SCHEMA = 0
    """The payload's schema version is another."""
    NOT_FINITE = 1
    """NaN or infinite."""
    FUTURE = 2
    """Captured later than now plus the tolerance."""
    BACKWARDS = 3
    """Captured before the last accepted one of this source."""
    SEQUENCE = 4
    """The sequence number did not increase."""
    UNKNOWN_KIND = 5
    """An obstacle kind or target mode without meaning."""
    OVERFULL = 6
    """More entries announced than a set can hold."""
    DIMENSIONS = 7
    """A dimension is zero, negative or absurd."""
    QUATERNION = 8
    """A quaternion is not of unit length."""
    COVARIANCE = 9
    """A covariance is not positive semidefinite."""
    HULL = 10
    """Hull vertices outside the pool, fewer than four, or flat."""
    DUPLICATE_ID = 11
    """Two obstacles of one set have the same id."""
    WRONG_COUNT = 12
    """Another number of cables or segments than the arm has."""
    TOO_MANY_SOURCES = 13
    """No place is left for another source, or another process has the source's id."""
    TOO_OLD = 14
    """The capture time is older than `hold_after` already."""
    WEIGHT = 15
    """A weight is negative or absurd."""


class AlarmCode(Code):
    """What is wrong beside faults and limits, whose alarms have their own codes. What an alarm does to the motion and
    what clears it, `sinew status` tells, and the log where it begins, in the same words.
    """

    SOURCE_STALE = 500
    """A source of obstacles is silent."""
    SOURCE_EXPIRED = 501
    """A source of obstacles is too old."""
    SOURCE_REFUSED = 502
    """Sets of a source of obstacles are refused."""
    SOURCE_ABSENT = 503
    """A source of obstacles that must be there is not."""
    TARGET_EXPIRED = 504
    """The target that is followed is too old."""
    DRIVE_FAULT = 505
    """A drive is in fault while the arm is disarmed."""
    DRIVES_LACK = 506
    """Drives lack a protection, which the configuration accepts."""
    REAL_TIME = 507
    """A real-time right was not granted."""
    RECORDING = 508
    """The recording ended early."""


class RequestKind(Code):
    """What an operator asks for."""

    ARM = 1
    """Enable the drives and hold the pose."""
    DISARM = 2
    """Take the torque off the drives, in order."""
    HOLD = 3
    """Hold the present pose."""
    TRACK = 4
    """Follow the target."""
    CLEAR = 5
    """Release a latched fault whose cause is gone."""
    STOP = 6
    """Come to rest, then disarm."""
    HOME = 7
    """Go to the home pose."""
    SET_TARGET = 8
    """Take over `Request.target` as if it came by the `target` service."""
    STATUS = 9
    """Only report the state."""
    EMERGENCY_STOP = 10
    """Press the operator's emergency stop: the arm stops, and may not be armed until it is released."""
    EMERGENCY_RELEASE = 11
    """Release it; the fault that it raised stays until it is cleared."""
    SPEED = 12
    """Scale the speed of the reference by `Request.speed_scale`, until another request or the arm is disarmed."""


class Verdict(Code):
    """Whether a request was accepted."""

    ACCEPTED = 0
    """It is carried out."""
    REFUSED = 1
    """It is not; the reason says why."""


class RefusalReason(Code):
    """Why a request was refused."""

    NONE = 0
    """It was accepted."""
    UNKNOWN_REQUEST = 1
    """The request's kind has no meaning in this version."""
    SCHEMA = 2
    """The request's schema version is another."""
    WRONG_STATE = 3
    """Not possible in the present supervisor state."""
    FAULTED = 4
    """A fault is latched; clear it first."""
    CAUSE_PERSISTS = 5
    """The fault's cause persists."""
    DRIVES_NOT_READY = 6
    """The drives are not ready."""
    NOT_SETTLED = 7
    """The observer has not settled."""
    NO_TARGET = 8
    """There is no target, or it is stale."""
    BAD_TARGET = 9
    """The target was refused; `detail` is the `RejectCause`."""
    BUSY = 10
    """Too many requests wait."""
    NO_ANSWER = 11
    """The control thread did not answer in time."""
    OBSTACLES_EXPIRED = 12
    """There is no obstacle source, or one is expired."""
    SHUTTING_DOWN = 13
    """The daemon is shutting down."""
    BAD_SPEED = 14
    """`Request.speed_scale` is not between 0.01 and 1."""


class Header(Payload):
    """Payload of 32 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "schema_version", "source_id", "sequence", "capture_ns", "tick"
    )
    _fields_: ClassVar = [
        ("schema_version", ctypes.c_uint32),
        ("source_id", ctypes.c_uint32),
        ("sequence", ctypes.c_uint64),
        ("capture_ns", ctypes.c_uint64),
        ("tick", ctypes.c_uint64),
    ]

    schema_version: int
    """`SCHEMA_VERSION`."""
    source_id: int
    """Who sends: chosen by the sender, stable over its restarts; 0 for the daemon."""
    sequence: int
    """Increases with every message of a source; a restarted source begins at 0 again, with a newer capture time."""
    capture_ns: int
    """CLOCK_MONOTONIC (ns) when the content was measured, not when it was sent."""
    tick: int
    """Lockstep: the tick that this input is for; `NO_TICK` otherwise. In `State`: the tick that it reports."""

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Header.v1"


class Encoders(Payload):
    """Payload of 1608 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "header", "cable_count", "source", "length_valid", "tension_valid", "length_m", "tension_n"
    )
    _fields_: ClassVar = [
        ("header", Header),
        ("cable_count", ctypes.c_uint32),
        ("_source", ctypes.c_uint32),
        ("_length_valid", ctypes.c_uint64 * 2),
        ("_tension_valid", ctypes.c_uint64 * 2),
        ("_length_m", ctypes.c_double * 96),
        ("_tension_n", ctypes.c_double * 96),
    ]

    header: Header
    """Header."""
    cable_count: int
    """Number of cables that follow; must be the arm's."""

    @property
    def source(self) -> EncoderSource:
        """Who measured the cables."""
        return EncoderSource(self._source)

    @source.setter
    def source(self, value: int) -> None:
        self._source = int(value)

    @property
    def length_valid(self) -> BoolArray:
        """Bit c of word c/64: the length of cable c is valid. Shape (cables,)."""
        return self._bits('length_valid', 128)[: self.cable_count]

    @length_valid.setter
    def length_valid(self, value: npt.ArrayLike) -> None:
        self._set_bits('length_valid', 128, value)

    @property
    def tension_valid(self) -> BoolArray:
        """Bit c of word c/64: the tension of cable c is valid. Shape (cables,)."""
        return self._bits('tension_valid', 128)[: self.cable_count]

    @tension_valid.setter
    def tension_valid(self, value: npt.ArrayLike) -> None:
        self._set_bits('tension_valid', 128, value)

    @property
    def length_m(self) -> FloatArray:
        """Lengths (m), base to tip, cable by cable within a segment. Shape (cable_count,)."""
        return self._array('length_m', np.float64, (96,))[: self.cable_count]

    @length_m.setter
    def length_m(self, value: npt.ArrayLike) -> None:
        self._put('length_m', np.float64, (96,), value)

    @property
    def tension_n(self) -> FloatArray:
        """Tensions (N). Shape (cable_count,)."""
        return self._array('tension_n', np.float64, (96,))[: self.cable_count]

    @tension_n.setter
    def tension_n(self, value: npt.ArrayLike) -> None:
        self._put('tension_n', np.float64, (96,), value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Encoders.v1"


class Obstacle(Payload):
    """Payload of 168 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "id", "kind", "position_m", "quaternion", "velocity_mps", "dimensions_m", "covariance_m2", "hull_offset",
        "hull_count"
    )
    _fields_: ClassVar = [
        ("id", ctypes.c_uint32),
        ("_kind", ctypes.c_uint32),
        ("_position_m", ctypes.c_double * 3),
        ("_quaternion", ctypes.c_double * 4),
        ("_velocity_mps", ctypes.c_double * 3),
        ("_dimensions_m", ctypes.c_double * 3),
        ("_covariance_m2", ctypes.c_double * 6),
        ("hull_offset", ctypes.c_uint32),
        ("hull_count", ctypes.c_uint32),
    ]

    id: int
    """Id, unique within the source."""
    hull_offset: int
    """First vertex of a hull in the set's pool."""
    hull_count: int
    """Number of vertices of a hull; 0 otherwise."""

    @property
    def kind(self) -> ObstacleKind:
        """Shape of an obstacle in its own frame."""
        return ObstacleKind(self._kind)

    @kind.setter
    def kind(self, value: int) -> None:
        self._kind = int(value)

    @property
    def position_m(self) -> FloatArray:
        """Origin of the obstacle's frame (m), base frame, at the capture time. Shape (3,)."""
        return self._array('position_m', np.float64, (3,))

    @position_m.setter
    def position_m(self, value: npt.ArrayLike) -> None:
        self._put('position_m', np.float64, (3,), value)

    @property
    def quaternion(self) -> FloatArray:
        """Unit quaternion `[w x y z]`, obstacle to base. Shape (4,)."""
        return self._array('quaternion', np.float64, (4,))

    @quaternion.setter
    def quaternion(self, value: npt.ArrayLike) -> None:
        self._put('quaternion', np.float64, (4,), value)

    @property
    def velocity_mps(self) -> FloatArray:
        """Velocity of the origin (m/s), base frame. Shape (3,)."""
        return self._array('velocity_mps', np.float64, (3,))

    @velocity_mps.setter
    def velocity_mps(self, value: npt.ArrayLike) -> None:
        self._put('velocity_mps', np.float64, (3,), value)

    @property
    def dimensions_m(self) -> FloatArray:
        """Dimensions (m), by kind; unused ones 0. Shape (3,)."""
        return self._array('dimensions_m', np.float64, (3,))

    @dimensions_m.setter
    def dimensions_m(self, value: npt.ArrayLike) -> None:
        self._put('dimensions_m', np.float64, (3,), value)

    @property
    def covariance_m2(self) -> FloatArray:
        """Covariance of the position (m^2), base frame: xx, xy, xz, yy, yz, zz. Shape (6,)."""
        return self._array('covariance_m2', np.float64, (6,))

    @covariance_m2.setter
    def covariance_m2(self, value: npt.ArrayLike) -> None:
        self._put('covariance_m2', np.float64, (6,), value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Obstacle.v1"


class Obstacles(Payload):
    """Payload of 16944 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "header", "count", "vertex_count", "flags", "reserved", "obstacles", "vertices_m"
    )
    _fields_: ClassVar = [
        ("header", Header),
        ("count", ctypes.c_uint32),
        ("vertex_count", ctypes.c_uint32),
        ("flags", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("_obstacles", Obstacle * 64),
        ("_vertices_m", ctypes.c_double * 3 * 256),
    ]

    header: Header
    """Header; `source_id` tells sources apart."""
    count: int
    """Number of obstacles in use; 0 is a statement: nothing is there."""
    vertex_count: int
    """Number of vertices in use."""
    flags: int
    """`FLAG_LEAVING`."""
    reserved: int
    """0."""

    @property
    def obstacles(self) -> list[Obstacle]:
        """Obstacles. Those in use, to be changed in place."""
        return self._list(self._obstacles, self.count)

    @property
    def vertices_m(self) -> FloatArray:
        """Vertices of the hulls (m), each in its obstacle's frame. Shape (vertex_count, 3)."""
        return self._array('vertices_m', np.float64, (256, 3))[: self.vertex_count]

    @vertices_m.setter
    def vertices_m(self, value: npt.ArrayLike) -> None:
        self._put('vertices_m', np.float64, (256, 3), value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Obstacles.v1"


class Target(Payload):
    """Payload of 672 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "header", "valid_from_ns", "mode", "segment_count", "position_m", "quaternion", "velocity_mps",
        "angular_velocity_radps", "curvature_1pm", "curvature_rate_1pms", "weight"
    )
    _fields_: ClassVar = [
        ("header", Header),
        ("valid_from_ns", ctypes.c_uint64),
        ("_mode", ctypes.c_uint32),
        ("segment_count", ctypes.c_uint32),
        ("_position_m", ctypes.c_double * 3),
        ("_quaternion", ctypes.c_double * 4),
        ("_velocity_mps", ctypes.c_double * 3),
        ("_angular_velocity_radps", ctypes.c_double * 3),
        ("_curvature_1pm", ctypes.c_double * 32),
        ("_curvature_rate_1pms", ctypes.c_double * 32),
        ("weight", ctypes.c_double),
    ]

    header: Header
    """Header."""
    valid_from_ns: int
    """CLOCK_MONOTONIC (ns) at which the arm shall be there; 0: at once."""
    segment_count: int
    """Shape mode: number of segments; must be the arm's. Tip mode: 0."""
    weight: float
    """Weight that the client gives its task; recorded. It does not change the motion, whose pace is the governor's. 0:
    none.
    """

    @property
    def mode(self) -> TargetMode:
        """What a target asks for."""
        return TargetMode(self._mode)

    @mode.setter
    def mode(self, value: int) -> None:
        self._mode = int(value)

    @property
    def position_m(self) -> FloatArray:
        """Tip position (m), base frame. Shape (3,)."""
        return self._array('position_m', np.float64, (3,))

    @position_m.setter
    def position_m(self, value: npt.ArrayLike) -> None:
        self._put('position_m', np.float64, (3,), value)

    @property
    def quaternion(self) -> FloatArray:
        """Tip's unit quaternion `[w x y z]`, tip to base. Shape (4,)."""
        return self._array('quaternion', np.float64, (4,))

    @quaternion.setter
    def quaternion(self, value: npt.ArrayLike) -> None:
        self._put('quaternion', np.float64, (4,), value)

    @property
    def velocity_mps(self) -> FloatArray:
        """Tip velocity (m/s), base frame. Shape (3,)."""
        return self._array('velocity_mps', np.float64, (3,))

    @velocity_mps.setter
    def velocity_mps(self, value: npt.ArrayLike) -> None:
        self._put('velocity_mps', np.float64, (3,), value)

    @property
    def angular_velocity_radps(self) -> FloatArray:
        """Tip angular velocity (rad/s), base frame. Shape (3,)."""
        return self._array('angular_velocity_radps', np.float64, (3,))

    @angular_velocity_radps.setter
    def angular_velocity_radps(self, value: npt.ArrayLike) -> None:
        self._put('angular_velocity_radps', np.float64, (3,), value)

    @property
    def curvature_1pm(self) -> FloatArray:
        """Average curvatures (1/m), (y, z) segment by segment. Shape (2 segment_count,)."""
        return self._array('curvature_1pm', np.float64, (32,))[: 2 * self.segment_count]

    @curvature_1pm.setter
    def curvature_1pm(self, value: npt.ArrayLike) -> None:
        self._put('curvature_1pm', np.float64, (32,), value)

    @property
    def curvature_rate_1pms(self) -> FloatArray:
        """Their rates (1/(m s)). Shape (2 segment_count,)."""
        return self._array('curvature_rate_1pms', np.float64, (32,))[: 2 * self.segment_count]

    @curvature_rate_1pms.setter
    def curvature_rate_1pms(self, value: npt.ArrayLike) -> None:
        self._put('curvature_rate_1pms', np.float64, (32,), value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Target.v1"


class Tip(Payload):
    """Payload of 56 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "header", "position_m"
    )
    _fields_: ClassVar = [
        ("header", Header),
        ("_position_m", ctypes.c_double * 3),
    ]

    header: Header
    """Header."""

    @property
    def position_m(self) -> FloatArray:
        """Position (m), base frame. Shape (3,)."""
        return self._array('position_m', np.float64, (3,))

    @position_m.setter
    def position_m(self, value: npt.ArrayLike) -> None:
        self._put('position_m', np.float64, (3,), value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Tip.v1"


class ObstacleDistance(Payload):
    """Payload of 24 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "source_id", "obstacle_id", "surface_distance_m", "growth_m"
    )
    _fields_: ClassVar = [
        ("source_id", ctypes.c_uint32),
        ("obstacle_id", ctypes.c_uint32),
        ("surface_distance_m", ctypes.c_double),
        ("growth_m", ctypes.c_double),
    ]

    source_id: int
    """Source of the obstacle."""
    obstacle_id: int
    """Id of the obstacle within its source."""
    surface_distance_m: float
    """Smallest distance between the surfaces (m) at the estimate, growth not subtracted; negative: contact."""
    growth_m: float
    """By how much the planner grew the obstacle (m)."""

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.ObstacleDistance.v1"


class SourceReport(Payload):
    """Payload of 160 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "source_id", "health", "sequence", "age_s", "accepted", "rejected"
    )
    _fields_: ClassVar = [
        ("source_id", ctypes.c_uint32),
        ("_health", ctypes.c_uint32),
        ("sequence", ctypes.c_uint64),
        ("age_s", ctypes.c_double),
        ("accepted", ctypes.c_uint64),
        ("_rejected", ctypes.c_uint64 * 16),
    ]

    source_id: int
    """Source id; 0 and `health` absent: place not used."""
    sequence: int
    """Sequence number of the last accepted message."""
    age_s: float
    """Age of the last accepted message's capture time at the tick (s); infinite if there was none."""
    accepted: int
    """Messages accepted."""

    @property
    def health(self) -> SourceHealth:
        """How fresh a source of inputs is."""
        return SourceHealth(self._health)

    @health.setter
    def health(self, value: int) -> None:
        self._health = int(value)

    @property
    def rejected(self) -> IntArray:
        """Messages rejected, at the place of their `RejectCause`. Shape (16,)."""
        return self._array('rejected', np.uint64, (16,))

    @rejected.setter
    def rejected(self, value: npt.ArrayLike) -> None:
        self._put('rejected', np.uint64, (16,), value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.SourceReport.v1"


class AlarmRecord(Payload):
    """Payload of 16 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "code", "subject", "since_ns"
    )
    _fields_: ClassVar = [
        ("code", ctypes.c_uint32),
        ("subject", ctypes.c_uint32),
        ("since_ns", ctypes.c_uint64),
    ]

    code: int
    """Code of the fault, of the limit, or `AlarmCode`."""
    subject: int
    """What it is about, by code: the fault's detail, a source id, a count of drives."""
    since_ns: int
    """Time of the tick at which it was seen first (ns)."""

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.AlarmRecord.v1"


class TickTiming(Payload):
    """Payload of 56 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "wakeup_ns", "input_ns", "estimate_ns", "plan_ns", "guard_ns", "send_ns", "cycle_ns"
    )
    _fields_: ClassVar = [
        ("wakeup_ns", ctypes.c_uint64),
        ("input_ns", ctypes.c_uint64),
        ("estimate_ns", ctypes.c_uint64),
        ("plan_ns", ctypes.c_uint64),
        ("guard_ns", ctypes.c_uint64),
        ("send_ns", ctypes.c_uint64),
        ("cycle_ns", ctypes.c_uint64),
    ]

    wakeup_ns: int
    """Wake-up after the deadline at which the tick should begin. Unit: ns."""
    input_ns: int
    """Taking over inputs. Unit: ns."""
    estimate_ns: int
    """Observer. Unit: ns."""
    plan_ns: int
    """Supervisor and planner. Unit: ns."""
    guard_ns: int
    """Guard. Unit: ns."""
    send_ns: int
    """Handing the tensions to the drives."""
    cycle_ns: int
    """Wake-up to the end of sending. Unit: ns."""

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.TickTiming.v1"


class State(Payload):
    """Payload of 15936 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "header", "time_s", "supervisor", "fault_code", "fault_detail", "planner_status", "planner_branch",
        "newton_iterations", "swarm_sweeps", "target_mode", "target_sequence", "cost", "kkt_residual", "cable_count",
        "segment_count", "node_count", "node_stride", "distance_count", "distance_dropped", "tension_command_n",
        "tension_measured_n", "cable_length_m", "tip_position_m", "tip_quaternion", "tip_velocity_mps",
        "tip_angular_velocity_radps", "target_position_m", "target_quaternion", "tip_error_m", "quaternion_error",
        "curvature_1pm", "target_curvature_1pm", "curvature_error_1pm", "innovation_rad", "disturbance_nm",
        "node_position_m", "node_quaternion", "distances", "obstacle_sources", "target_report", "encoder_report",
        "obstacle_sources_refused", "ticks_missed", "records_dropped", "stale_sources", "timing", "limits", "swing_m",
        "tip_covariance_m2", "speed_scale", "reach_miss_m", "reach_miss_rad", "reach_load", "reach_nearest_m",
        "fault_values", "fault_flags", "alarm_count", "alarms", "tip_report", "tip_measured_m", "tip_bias_m"
    )
    _fields_: ClassVar = [
        ("header", Header),
        ("time_s", ctypes.c_double),
        ("_supervisor", ctypes.c_uint32),
        ("fault_code", ctypes.c_uint32),
        ("fault_detail", ctypes.c_uint32),
        ("_planner_status", ctypes.c_uint32),
        ("_planner_branch", ctypes.c_uint32),
        ("newton_iterations", ctypes.c_uint32),
        ("swarm_sweeps", ctypes.c_uint32),
        ("_target_mode", ctypes.c_uint32),
        ("target_sequence", ctypes.c_uint64),
        ("cost", ctypes.c_double),
        ("kkt_residual", ctypes.c_double),
        ("cable_count", ctypes.c_uint32),
        ("segment_count", ctypes.c_uint32),
        ("node_count", ctypes.c_uint32),
        ("node_stride", ctypes.c_uint32),
        ("distance_count", ctypes.c_uint32),
        ("distance_dropped", ctypes.c_uint32),
        ("_tension_command_n", ctypes.c_double * 96),
        ("_tension_measured_n", ctypes.c_double * 96),
        ("_cable_length_m", ctypes.c_double * 96),
        ("_tip_position_m", ctypes.c_double * 3),
        ("_tip_quaternion", ctypes.c_double * 4),
        ("_tip_velocity_mps", ctypes.c_double * 3),
        ("_tip_angular_velocity_radps", ctypes.c_double * 3),
        ("_target_position_m", ctypes.c_double * 3),
        ("_target_quaternion", ctypes.c_double * 4),
        ("tip_error_m", ctypes.c_double),
        ("quaternion_error", ctypes.c_double),
        ("_curvature_1pm", ctypes.c_double * 32),
        ("_target_curvature_1pm", ctypes.c_double * 32),
        ("curvature_error_1pm", ctypes.c_double),
        ("_innovation_rad", ctypes.c_double * 32),
        ("_disturbance_nm", ctypes.c_double * 32),
        ("_node_position_m", ctypes.c_double * 3 * 64),
        ("_node_quaternion", ctypes.c_double * 4 * 64),
        ("_distances", ObstacleDistance * 256),
        ("_obstacle_sources", SourceReport * 8),
        ("target_report", SourceReport),
        ("encoder_report", SourceReport),
        ("obstacle_sources_refused", ctypes.c_uint64),
        ("ticks_missed", ctypes.c_uint64),
        ("records_dropped", ctypes.c_uint64),
        ("stale_sources", ctypes.c_uint64),
        ("timing", TickTiming),
        ("limits", ctypes.c_uint64),
        ("swing_m", ctypes.c_double),
        ("_tip_covariance_m2", ctypes.c_double * 9),
        ("speed_scale", ctypes.c_double),
        ("reach_miss_m", ctypes.c_double),
        ("reach_miss_rad", ctypes.c_double),
        ("reach_load", ctypes.c_double),
        ("_reach_nearest_m", ctypes.c_double * 3),
        ("_fault_values", ctypes.c_double * 2),
        ("fault_flags", ctypes.c_uint32),
        ("alarm_count", ctypes.c_uint32),
        ("_alarms", AlarmRecord * 32),
        ("tip_report", SourceReport),
        ("_tip_measured_m", ctypes.c_double * 3),
        ("_tip_bias_m", ctypes.c_double * 3),
    ]

    header: Header
    """Header; `tick` counts from 0, `capture_ns` is the tick's time."""
    time_s: float
    """Time since the loop began (s)."""
    fault_code: int
    """0: no fault; otherwise the code of `control`'s fault."""
    fault_detail: int
    """What the fault is about (cable, drive, source), by code."""
    newton_iterations: int
    """Newton iterations of the outer loop."""
    swarm_sweeps: int
    """Sweeps of the swarm."""
    target_sequence: int
    """Sequence number of the target in use."""
    cost: float
    """Cost J of the answer."""
    kkt_residual: float
    """KKT residual of the answer."""
    cable_count: int
    """Number of cables."""
    segment_count: int
    """Number of segments."""
    node_count: int
    """Number of nodes below (not of the arm, if the stride is above 1)."""
    node_stride: int
    """Node i below is the arm's node `(i + 1) node_stride - 1`; the last one is always the tip."""
    distance_count: int
    """Number of obstacles in `distances`."""
    distance_dropped: int
    """Tracked obstacles that found no place (over the capacity)."""
    tip_error_m: float
    """Norm of the tip's position error (m); NaN in shape mode."""
    quaternion_error: float
    """Norm of the tip's quaternion error, sign chosen in the tip's hemisphere; NaN in shape mode."""
    curvature_error_1pm: float
    """Largest absolute error of a curvature (1/m); NaN in tip mode."""
    target_report: SourceReport
    """Target."""
    encoder_report: SourceReport
    """Encoders."""
    obstacle_sources_refused: int
    """Obstacle sets refused because all places for sources are taken."""
    ticks_missed: int
    """Ticks left out since the loop began, because it was late."""
    records_dropped: int
    """Records that found their queue full."""
    stale_sources: int
    """Obstacle sources that are stale or expired."""
    timing: TickTiming
    """Where the time of this tick went."""
    limits: int
    """Limits that act, bit by bit: bit k is the limit of code 100 + k."""
    swing_m: float
    """Swing of the tip beside its motion that there may be, peak to peak (m)."""
    speed_scale: float
    """Speed over the configured one that was asked for; 1 after the arm was disarmed."""
    reach_miss_m: float
    """Distance of the nearest point that the arm reaches from the tip target (m); NaN without one, or while it is
    looked for.
    """
    reach_miss_rad: float
    """Attitude error there, roll left out (rad); NaN as above."""
    reach_load: float
    """Load of the cables there, 1 being all that they may pull; NaN as above."""
    fault_flags: int
    """Bit 0: another cable of the segment may be the one of the fault."""
    alarm_count: int
    """Number of alarms."""
    tip_report: SourceReport
    """Measured tip."""

    @property
    def supervisor(self) -> SupervisorState:
        """State of the supervisor."""
        return SupervisorState(self._supervisor)

    @supervisor.setter
    def supervisor(self, value: int) -> None:
        self._supervisor = int(value)

    @property
    def planner_status(self) -> PlannerStatus:
        """How the planner ended in a tick."""
        return PlannerStatus(self._planner_status)

    @planner_status.setter
    def planner_status(self, value: int) -> None:
        self._planner_status = int(value)

    @property
    def planner_branch(self) -> PlannerBranch:
        """Which branch of the planner gave the answer."""
        return PlannerBranch(self._planner_branch)

    @planner_branch.setter
    def planner_branch(self, value: int) -> None:
        self._planner_branch = int(value)

    @property
    def target_mode(self) -> TargetMode | None:
        """`TargetMode`; 0 without a target."""
        return TargetMode(self._target_mode) if self._target_mode else None

    @target_mode.setter
    def target_mode(self, value: int | None) -> None:
        self._target_mode = int(value or 0)

    @property
    def tension_command_n(self) -> FloatArray:
        """Commanded tensions (N). Shape (cable_count,)."""
        return self._array('tension_command_n', np.float64, (96,))[: self.cable_count]

    @tension_command_n.setter
    def tension_command_n(self, value: npt.ArrayLike) -> None:
        self._put('tension_command_n', np.float64, (96,), value)

    @property
    def tension_measured_n(self) -> FloatArray:
        """Measured tensions (N); NaN where not valid. Shape (cable_count,)."""
        return self._array('tension_measured_n', np.float64, (96,))[: self.cable_count]

    @tension_measured_n.setter
    def tension_measured_n(self, value: npt.ArrayLike) -> None:
        self._put('tension_measured_n', np.float64, (96,), value)

    @property
    def cable_length_m(self) -> FloatArray:
        """Measured cable lengths (m); NaN where not valid. Shape (cable_count,)."""
        return self._array('cable_length_m', np.float64, (96,))[: self.cable_count]

    @cable_length_m.setter
    def cable_length_m(self, value: npt.ArrayLike) -> None:
        self._put('cable_length_m', np.float64, (96,), value)

    @property
    def tip_position_m(self) -> FloatArray:
        """Estimated tip position (m), base frame. Shape (3,)."""
        return self._array('tip_position_m', np.float64, (3,))

    @tip_position_m.setter
    def tip_position_m(self, value: npt.ArrayLike) -> None:
        self._put('tip_position_m', np.float64, (3,), value)

    @property
    def tip_quaternion(self) -> FloatArray:
        """Estimated tip quaternion `[w x y z]`, tip to base. Shape (4,)."""
        return self._array('tip_quaternion', np.float64, (4,))

    @tip_quaternion.setter
    def tip_quaternion(self, value: npt.ArrayLike) -> None:
        self._put('tip_quaternion', np.float64, (4,), value)

    @property
    def tip_velocity_mps(self) -> FloatArray:
        """Estimated tip velocity (m/s), base frame. Shape (3,)."""
        return self._array('tip_velocity_mps', np.float64, (3,))

    @tip_velocity_mps.setter
    def tip_velocity_mps(self, value: npt.ArrayLike) -> None:
        self._put('tip_velocity_mps', np.float64, (3,), value)

    @property
    def tip_angular_velocity_radps(self) -> FloatArray:
        """Estimated tip angular velocity (rad/s), base frame. Shape (3,)."""
        return self._array('tip_angular_velocity_radps', np.float64, (3,))

    @tip_angular_velocity_radps.setter
    def tip_angular_velocity_radps(self, value: npt.ArrayLike) -> None:
        self._put('tip_angular_velocity_radps', np.float64, (3,), value)

    @property
    def target_position_m(self) -> FloatArray:
        """Desired tip position (m) at the tick; NaN in shape mode. Shape (3,)."""
        return self._array('target_position_m', np.float64, (3,))

    @target_position_m.setter
    def target_position_m(self, value: npt.ArrayLike) -> None:
        self._put('target_position_m', np.float64, (3,), value)

    @property
    def target_quaternion(self) -> FloatArray:
        """Desired tip quaternion at the tick; NaN in shape mode. Shape (4,)."""
        return self._array('target_quaternion', np.float64, (4,))

    @target_quaternion.setter
    def target_quaternion(self, value: npt.ArrayLike) -> None:
        self._put('target_quaternion', np.float64, (4,), value)

    @property
    def curvature_1pm(self) -> FloatArray:
        """Estimated average curvatures (1/m), (y, z) segment by segment. Shape (2 segment_count,)."""
        return self._array('curvature_1pm', np.float64, (32,))[: 2 * self.segment_count]

    @curvature_1pm.setter
    def curvature_1pm(self, value: npt.ArrayLike) -> None:
        self._put('curvature_1pm', np.float64, (32,), value)

    @property
    def target_curvature_1pm(self) -> FloatArray:
        """Desired average curvatures (1/m); NaN in tip mode. Shape (2 segment_count,)."""
        return self._array('target_curvature_1pm', np.float64, (32,))[: 2 * self.segment_count]

    @target_curvature_1pm.setter
    def target_curvature_1pm(self, value: npt.ArrayLike) -> None:
        self._put('target_curvature_1pm', np.float64, (32,), value)

    @property
    def innovation_rad(self) -> FloatArray:
        """Observer's innovation z (rad), (y, z) segment by segment. Shape (2 segment_count,)."""
        return self._array('innovation_rad', np.float64, (32,))[: 2 * self.segment_count]

    @innovation_rad.setter
    def innovation_rad(self, value: npt.ArrayLike) -> None:
        self._put('innovation_rad', np.float64, (32,), value)

    @property
    def disturbance_nm(self) -> FloatArray:
        """Observer's disturbance estimate beta (N m). Shape (2 segment_count,)."""
        return self._array('disturbance_nm', np.float64, (32,))[: 2 * self.segment_count]

    @disturbance_nm.setter
    def disturbance_nm(self, value: npt.ArrayLike) -> None:
        self._put('disturbance_nm', np.float64, (32,), value)

    @property
    def node_position_m(self) -> FloatArray:
        """Estimated node positions (m), base frame. Shape (node_count, 3)."""
        return self._array('node_position_m', np.float64, (64, 3))[: self.node_count]

    @node_position_m.setter
    def node_position_m(self, value: npt.ArrayLike) -> None:
        self._put('node_position_m', np.float64, (64, 3), value)

    @property
    def node_quaternion(self) -> FloatArray:
        """Estimated node quaternions `[w x y z]`, body to base. Shape (node_count, 4)."""
        return self._array('node_quaternion', np.float64, (64, 4))[: self.node_count]

    @node_quaternion.setter
    def node_quaternion(self, value: npt.ArrayLike) -> None:
        self._put('node_quaternion', np.float64, (64, 4), value)

    @property
    def distances(self) -> list[ObstacleDistance]:
        """Distances, one per tracked obstacle. Those in use, to be changed in place."""
        return self._list(self._distances, self.distance_count)

    @property
    def obstacle_sources(self) -> list[SourceReport]:
        """Obstacle sources."""
        return self._list(self._obstacle_sources, 8)

    @property
    def tip_covariance_m2(self) -> FloatArray:
        """Covariance of the estimated tip position (m^2, base frame), row by row; NaN where nothing was estimated yet.
        Shape (9,).
        """
        return self._array('tip_covariance_m2', np.float64, (9,))

    @tip_covariance_m2.setter
    def tip_covariance_m2(self, value: npt.ArrayLike) -> None:
        self._put('tip_covariance_m2', np.float64, (9,), value)

    @property
    def reach_nearest_m(self) -> FloatArray:
        """The nearest point (m), base frame; NaN as above. Shape (3,)."""
        return self._array('reach_nearest_m', np.float64, (3,))

    @reach_nearest_m.setter
    def reach_nearest_m(self, value: npt.ArrayLike) -> None:
        self._put('reach_nearest_m', np.float64, (3,), value)

    @property
    def fault_values(self) -> FloatArray:
        """Numbers that the latched fault carries, by code; NaN where there is none. Shape (2,)."""
        return self._array('fault_values', np.float64, (2,))

    @fault_values.setter
    def fault_values(self, value: npt.ArrayLike) -> None:
        self._put('fault_values', np.float64, (2,), value)

    @property
    def alarms(self) -> list[AlarmRecord]:
        """Alarms that are on, as of a tenth of a second ago at most. Those in use, to be changed in place."""
        return self._list(self._alarms, self.alarm_count)

    @property
    def tip_measured_m(self) -> FloatArray:
        """Measured position of the tip (m), base frame; NaN where none is fresh. Shape (3,)."""
        return self._array('tip_measured_m', np.float64, (3,))

    @tip_measured_m.setter
    def tip_measured_m(self, value: npt.ArrayLike) -> None:
        self._put('tip_measured_m', np.float64, (3,), value)

    @property
    def tip_bias_m(self) -> FloatArray:
        """What lasts of measured less estimated tip (m), base frame: taken off the tip targets; 0 without a sensor.
        Shape (3,).
        """
        return self._array('tip_bias_m', np.float64, (3,))

    @tip_bias_m.setter
    def tip_bias_m(self, value: npt.ArrayLike) -> None:
        self._put('tip_bias_m', np.float64, (3,), value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.State.v1"


class Request(Payload):
    """Payload of 720 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "header", "kind", "reserved", "target", "speed_scale"
    )
    _fields_: ClassVar = [
        ("header", Header),
        ("_kind", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("target", Target),
        ("speed_scale", ctypes.c_double),
    ]

    header: Header
    """Header."""
    reserved: int
    """0."""
    target: Target
    """For `RequestKind.SetTarget`; otherwise ignored."""
    speed_scale: float
    """For `RequestKind.Speed`: speed over the configured one, 0.01 to 1; otherwise ignored."""

    @property
    def kind(self) -> RequestKind:
        """What an operator asks for."""
        return RequestKind(self._kind)

    @kind.setter
    def kind(self, value: int) -> None:
        self._kind = int(value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Request.v1"


class Response(Payload):
    """Payload of 184 bytes."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        "header", "verdict", "reason", "detail", "supervisor", "fault_code", "fault_detail", "text"
    )
    _fields_: ClassVar = [
        ("header", Header),
        ("_verdict", ctypes.c_uint32),
        ("_reason", ctypes.c_uint32),
        ("detail", ctypes.c_uint32),
        ("_supervisor", ctypes.c_uint32),
        ("fault_code", ctypes.c_uint32),
        ("fault_detail", ctypes.c_uint32),
        ("_text", ctypes.c_uint8 * 128),
    ]

    header: Header
    """Header; `sequence` is the request's."""
    detail: int
    """A number that belongs to the reason (e.g. the `RejectCause` of a bad target); 0 otherwise."""
    fault_code: int
    """Fault code, as in `State`."""
    fault_detail: int
    """Detail of the fault, as in `State`."""

    @property
    def verdict(self) -> Verdict:
        """Whether a request was accepted."""
        return Verdict(self._verdict)

    @verdict.setter
    def verdict(self, value: int) -> None:
        self._verdict = int(value)

    @property
    def reason(self) -> RefusalReason:
        """Why a request was refused."""
        return RefusalReason(self._reason)

    @reason.setter
    def reason(self, value: int) -> None:
        self._reason = int(value)

    @property
    def supervisor(self) -> SupervisorState:
        """`SupervisorState` after the request."""
        return SupervisorState(self._supervisor)

    @supervisor.setter
    def supervisor(self, value: int) -> None:
        self._supervisor = int(value)

    @property
    def text(self) -> str:
        """Explanation for people, UTF-8, filled up with zeros."""
        return self._get_text('text')

    @text.setter
    def text(self, value: str) -> None:
        self._set_text('text', value)

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        return "sinew.Response.v1"


# What the page says of every payload: its size, and where its fields begin.
LAYOUT: dict[type[Payload], tuple[int, tuple[int, ...]]] = {
    Header: (
        32,
        (
            0, 4, 8, 16, 24
        ),
    ),
    Encoders: (
        1608,
        (
            0, 32, 36, 40, 56, 72, 840
        ),
    ),
    Obstacle: (
        168,
        (
            0, 4, 8, 32, 64, 88, 112, 160, 164
        ),
    ),
    Obstacles: (
        16944,
        (
            0, 32, 36, 40, 44, 48, 10800
        ),
    ),
    Target: (
        672,
        (
            0, 32, 40, 44, 48, 72, 104, 128, 152, 408, 664
        ),
    ),
    Tip: (
        56,
        (
            0, 32
        ),
    ),
    ObstacleDistance: (
        24,
        (
            0, 4, 8, 16
        ),
    ),
    SourceReport: (
        160,
        (
            0, 4, 8, 16, 24, 32
        ),
    ),
    AlarmRecord: (
        16,
        (
            0, 4, 8
        ),
    ),
    TickTiming: (
        56,
        (
            0, 8, 16, 24, 32, 40, 48
        ),
    ),
    State: (
        15936,
        (
            0, 32, 40, 44, 48, 52, 56, 60, 64, 68, 72, 80, 88, 96, 100, 104, 108, 112, 116, 120, 888, 1656, 2424, 2448,
            2480, 2504, 2528, 2552, 2584, 2592, 2600, 2856, 3112, 3120, 3376, 3632, 5168, 7216, 13360, 14640, 14800,
            14960, 14968, 14976, 14984, 14992, 15048, 15056, 15064, 15136, 15144, 15152, 15160, 15168, 15192, 15208,
            15212, 15216, 15728, 15888, 15912
        ),
    ),
    Request: (
        720,
        (
            0, 32, 36, 40, 712
        ),
    ),
    Response: (
        184,
        (
            0, 32, 36, 40, 44, 48, 52, 56
        ),
    ),
}
