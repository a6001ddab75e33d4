/* What lies in shared memory: payloads and codes.
 *
 * Made by `python/generate.py` from `src/ipc/PAYLOADS.md`; not to be edited. For C11 and C++11, little-endian.
 * A field that stands for a code is a plain number, since anybody can write any.
 */
#ifndef SINEW_PAYLOADS_H
#define SINEW_PAYLOADS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define SINEW_ASSERT(what) static_assert(what, #what)
#else
#define SINEW_ASSERT(what) _Static_assert(what, #what)
#endif

/* Version of all payloads. */
#define SINEW_SCHEMA_VERSION 1u
/* `tick` in a header of what belongs to no tick. */
#define SINEW_NO_TICK UINT64_MAX
/* `flags` of `sinew_obstacles`: the source ends in order. */
#define SINEW_FLAG_LEAVING 1u

/* Shape of an obstacle in its own frame. */
enum {
    /* `dimensions_m = [radius, 0, 0]`. */
    SINEW_OBSTACLE_KIND_BALL = 1,
    /* Along the local z axis, `dimensions_m = [half length between the centres, radius, 0]`. */
    SINEW_OBSTACLE_KIND_CAPSULE = 2,
    /* `dimensions_m` = half extents along the local axes. */
    SINEW_OBSTACLE_KIND_BOX = 3,
    /* Solid below the plane through the local origin whose outward normal is the local z axis. */
    SINEW_OBSTACLE_KIND_HALF_SPACE = 4,
    /* Convex hull of the vertices `hull_offset..hull_offset + hull_count` of the set, in the local frame. */
    SINEW_OBSTACLE_KIND_HULL = 5
};

/* What a target asks for. */
enum {
    /* Tip pose and twist. */
    SINEW_TARGET_MODE_TIP = 1,
    /* Average curvature of each segment about its local y and z. */
    SINEW_TARGET_MODE_SHAPE = 2
};

/* Who measured the cables. */
enum {
    /* The drives, over the bus. */
    SINEW_ENCODER_SOURCE_DRIVES = 1,
    /* A sensor on another wire. */
    SINEW_ENCODER_SOURCE_EXTERNAL = 2,
    /* A recording that is played back. */
    SINEW_ENCODER_SOURCE_REPLAY = 3
};

/* State of the supervisor. */
enum {
    /* Drives without torque. */
    SINEW_SUPERVISOR_STATE_DISARMED = 0,
    /* Drives enabled, the observer settles, the pose is held. */
    SINEW_SUPERVISOR_STATE_ARMING = 1,
    /* The pose is held. */
    SINEW_SUPERVISOR_STATE_HOLDING = 2,
    /* The target is followed. */
    SINEW_SUPERVISOR_STATE_TRACKING = 3,
    /* On the way to the home pose. */
    SINEW_SUPERVISOR_STATE_HOMING = 4,
    /* On the way to rest, then disarmed. */
    SINEW_SUPERVISOR_STATE_STOPPING = 5,
    /* Latched; `fault_code` and `fault_detail` hold the cause, `clear` releases it. */
    SINEW_SUPERVISOR_STATE_FAULTED = 6
};

/* How the planner ended in a tick. */
enum {
    /* It did not run. */
    SINEW_PLANNER_STATUS_IDLE = 0,
    /* Converged. */
    SINEW_PLANNER_STATUS_CONVERGED = 1,
    /* Time or work budget spent; the best answer so far, inside its bounds. */
    SINEW_PLANNER_STATUS_BUDGET_SPENT = 2,
    /* Distance constraints conflicted and were relaxed. */
    SINEW_PLANNER_STATUS_RELAXED = 3,
    /* No usable answer; the last tensions were kept. */
    SINEW_PLANNER_STATUS_FAILED = 4
};

/* Which branch of the planner gave the answer. */
enum {
    /* None. */
    SINEW_PLANNER_BRANCH_NONE = 0,
    /* Safe subspace: complementarity of the tension box alone. */
    SINEW_PLANNER_BRANCH_SAFE = 1,
    /* Warning subspace, by the swarm. */
    SINEW_PLANNER_BRANCH_SWARM = 2,
    /* Warning subspace, by the swarm seeded with the complementarity solution. */
    SINEW_PLANNER_BRANCH_SEEDED = 3,
    /* Warning subspace, by complementarity with distance rows. */
    SINEW_PLANNER_BRANCH_COMPLEMENTARITY = 4,
    /* Warning subspace, by the standard swarm. */
    SINEW_PLANNER_BRANCH_STANDARD_SWARM = 5
};

/* How fresh a source of inputs is. */
enum {
    /* This place is not used, or nothing was ever accepted. */
    SINEW_SOURCE_HEALTH_ABSENT = 0,
    /* Newer than `stale_after`. */
    SINEW_SOURCE_HEALTH_FRESH = 1,
    /* Older than `stale_after`: obstacles grow with age. */
    SINEW_SOURCE_HEALTH_STALE = 2,
    /* Older than `hold_after`: the arm is asked to hold. */
    SINEW_SOURCE_HEALTH_EXPIRED = 3,
    /* A target that stands still and is held: its age does not matter. */
    SINEW_SOURCE_HEALTH_HELD = 4,
    /* It sends, or sent, and nothing of it was ever accepted: the arm is asked to hold. */
    SINEW_SOURCE_HEALTH_REFUSED = 5
};

/* Why an input was not taken over; the place of its counter in `SourceReport.rejected`. */
enum {
    /* The payload's schema version is another. */
    SINEW_REJECT_CAUSE_SCHEMA = 0,
    /* NaN or infinite. */
    SINEW_REJECT_CAUSE_NOT_FINITE = 1,
    /* Captured later than now plus the tolerance. */
    SINEW_REJECT_CAUSE_FUTURE = 2,
    /* Captured before the last accepted one of this source. */
    SINEW_REJECT_CAUSE_BACKWARDS = 3,
    /* The sequence number did not increase. */
    SINEW_REJECT_CAUSE_SEQUENCE = 4,
    /* An obstacle kind or target mode without meaning. */
    SINEW_REJECT_CAUSE_UNKNOWN_KIND = 5,
    /* More entries announced than a set can hold. */
    SINEW_REJECT_CAUSE_OVERFULL = 6,
    /* A dimension is zero, negative or absurd. */
    SINEW_REJECT_CAUSE_DIMENSIONS = 7,
    /* A quaternion is not of unit length. */
    SINEW_REJECT_CAUSE_QUATERNION = 8,
    /* A covariance is not positive semidefinite. */
    SINEW_REJECT_CAUSE_COVARIANCE = 9,
    /* Hull vertices outside the pool, fewer than four, or flat. */
    SINEW_REJECT_CAUSE_HULL = 10,
    /* Two obstacles of one set have the same id. */
    SINEW_REJECT_CAUSE_DUPLICATE_ID = 11,
    /* Another number of cables or segments than the arm has. */
    SINEW_REJECT_CAUSE_WRONG_COUNT = 12,
    /* No place is left for another source, or another process has the source's id. */
    SINEW_REJECT_CAUSE_TOO_MANY_SOURCES = 13,
    /* The capture time is older than `hold_after` already. */
    SINEW_REJECT_CAUSE_TOO_OLD = 14,
    /* A weight is negative or absurd. */
    SINEW_REJECT_CAUSE_WEIGHT = 15
};

/* What is wrong beside faults and limits, whose alarms have their own codes. What an alarm does to the motion and
 * what clears it, `sinew status` tells, and the log where it begins, in the same words. */
enum {
    /* A source of obstacles is silent. */
    SINEW_ALARM_CODE_SOURCE_STALE = 500,
    /* A source of obstacles is too old. */
    SINEW_ALARM_CODE_SOURCE_EXPIRED = 501,
    /* Sets of a source of obstacles are refused. */
    SINEW_ALARM_CODE_SOURCE_REFUSED = 502,
    /* A source of obstacles that must be there is not. */
    SINEW_ALARM_CODE_SOURCE_ABSENT = 503,
    /* The target that is followed is too old. */
    SINEW_ALARM_CODE_TARGET_EXPIRED = 504,
    /* A drive is in fault while the arm is disarmed. */
    SINEW_ALARM_CODE_DRIVE_FAULT = 505,
    /* Drives lack a protection, which the configuration accepts. */
    SINEW_ALARM_CODE_DRIVES_LACK = 506,
    /* A real-time right was not granted. */
    SINEW_ALARM_CODE_REAL_TIME = 507,
    /* The recording ended early. */
    SINEW_ALARM_CODE_RECORDING = 508
};

/* What an operator asks for. */
enum {
    /* Enable the drives and hold the pose. */
    SINEW_REQUEST_KIND_ARM = 1,
    /* Take the torque off the drives, in order. */
    SINEW_REQUEST_KIND_DISARM = 2,
    /* Hold the present pose. */
    SINEW_REQUEST_KIND_HOLD = 3,
    /* Follow the target. */
    SINEW_REQUEST_KIND_TRACK = 4,
    /* Release a latched fault whose cause is gone. */
    SINEW_REQUEST_KIND_CLEAR = 5,
    /* Come to rest, then disarm. */
    SINEW_REQUEST_KIND_STOP = 6,
    /* Go to the home pose. */
    SINEW_REQUEST_KIND_HOME = 7,
    /* Take over `Request.target` as if it came by the `target` service. */
    SINEW_REQUEST_KIND_SET_TARGET = 8,
    /* Only report the state. */
    SINEW_REQUEST_KIND_STATUS = 9,
    /* Press the operator's emergency stop: the arm stops, and may not be armed until it is released. */
    SINEW_REQUEST_KIND_EMERGENCY_STOP = 10,
    /* Release it; the fault that it raised stays until it is cleared. */
    SINEW_REQUEST_KIND_EMERGENCY_RELEASE = 11,
    /* Scale the speed of the reference by `Request.speed_scale`, until another request or the arm is disarmed. */
    SINEW_REQUEST_KIND_SPEED = 12
};

/* Whether a request was accepted. */
enum {
    /* It is carried out. */
    SINEW_VERDICT_ACCEPTED = 0,
    /* It is not; the reason says why. */
    SINEW_VERDICT_REFUSED = 1
};

/* Why a request was refused. */
enum {
    /* It was accepted. */
    SINEW_REFUSAL_REASON_NONE = 0,
    /* The request's kind has no meaning in this version. */
    SINEW_REFUSAL_REASON_UNKNOWN_REQUEST = 1,
    /* The request's schema version is another. */
    SINEW_REFUSAL_REASON_SCHEMA = 2,
    /* Not possible in the present supervisor state. */
    SINEW_REFUSAL_REASON_WRONG_STATE = 3,
    /* A fault is latched; clear it first. */
    SINEW_REFUSAL_REASON_FAULTED = 4,
    /* The fault's cause persists. */
    SINEW_REFUSAL_REASON_CAUSE_PERSISTS = 5,
    /* The drives are not ready. */
    SINEW_REFUSAL_REASON_DRIVES_NOT_READY = 6,
    /* The observer has not settled. */
    SINEW_REFUSAL_REASON_NOT_SETTLED = 7,
    /* There is no target, or it is stale. */
    SINEW_REFUSAL_REASON_NO_TARGET = 8,
    /* The target was refused; `detail` is the `RejectCause`. */
    SINEW_REFUSAL_REASON_BAD_TARGET = 9,
    /* Too many requests wait. */
    SINEW_REFUSAL_REASON_BUSY = 10,
    /* The control thread did not answer in time. */
    SINEW_REFUSAL_REASON_NO_ANSWER = 11,
    /* There is no obstacle source, or one is expired. */
    SINEW_REFUSAL_REASON_OBSTACLES_EXPIRED = 12,
    /* The daemon is shutting down. */
    SINEW_REFUSAL_REASON_SHUTTING_DOWN = 13,
    /* `Request.speed_scale` is not between 0.01 and 1. */
    SINEW_REFUSAL_REASON_BAD_SPEED = 14
};

#define SINEW_HEADER_TYPE_NAME "sinew.Header.v1"
struct sinew_header {
    /* `SCHEMA_VERSION`. */
    uint32_t schema_version;
    /* Who sends: chosen by the sender, stable over its restarts; 0 for the daemon. */
    uint32_t source_id;
    /* Increases with every message of a source; a restarted source begins at 0 again, with a newer capture time. */
    uint64_t sequence;
    /* CLOCK_MONOTONIC (ns) when the content was measured, not when it was sent. */
    uint64_t capture_ns;
    /* Lockstep: the tick that this input is for; `NO_TICK` otherwise. In `State`: the tick that it reports. */
    uint64_t tick;
};
SINEW_ASSERT(sizeof(struct sinew_header) == 32);
SINEW_ASSERT(offsetof(struct sinew_header, schema_version) == 0);
SINEW_ASSERT(offsetof(struct sinew_header, source_id) == 4);
SINEW_ASSERT(offsetof(struct sinew_header, sequence) == 8);
SINEW_ASSERT(offsetof(struct sinew_header, capture_ns) == 16);
SINEW_ASSERT(offsetof(struct sinew_header, tick) == 24);

#define SINEW_ENCODERS_TYPE_NAME "sinew.Encoders.v1"
struct sinew_encoders {
    /* Header. */
    struct sinew_header header;
    /* Number of cables that follow; must be the arm's. */
    uint32_t cable_count;
    /* `EncoderSource`. */
    uint32_t source;
    /* Bit c of word c/64: the length of cable c is valid. */
    uint64_t length_valid[2];
    /* Bit c of word c/64: the tension of cable c is valid. */
    uint64_t tension_valid[2];
    /* Lengths (m), base to tip, cable by cable within a segment. */
    double length_m[96];
    /* Tensions (N). */
    double tension_n[96];
};
SINEW_ASSERT(sizeof(struct sinew_encoders) == 1608);
SINEW_ASSERT(offsetof(struct sinew_encoders, header) == 0);
SINEW_ASSERT(offsetof(struct sinew_encoders, cable_count) == 32);
SINEW_ASSERT(offsetof(struct sinew_encoders, source) == 36);
SINEW_ASSERT(offsetof(struct sinew_encoders, length_valid) == 40);
SINEW_ASSERT(offsetof(struct sinew_encoders, tension_valid) == 56);
SINEW_ASSERT(offsetof(struct sinew_encoders, length_m) == 72);
SINEW_ASSERT(offsetof(struct sinew_encoders, tension_n) == 840);

#define SINEW_OBSTACLE_TYPE_NAME "sinew.Obstacle.v1"
struct sinew_obstacle {
    /* Id, unique within the source. */
    uint32_t id;
    /* `ObstacleKind`. */
    uint32_t kind;
    /* Origin of the obstacle's frame (m), base frame, at the capture time. */
    double position_m[3];
    /* Unit quaternion `[w x y z]`, obstacle to base. */
    double quaternion[4];
    /* Velocity of the origin (m/s), base frame. */
    double velocity_mps[3];
    /* Dimensions (m), by kind; unused ones 0. */
    double dimensions_m[3];
    /* Covariance of the position (m^2), base frame: xx, xy, xz, yy, yz, zz. */
    double covariance_m2[6];
    /* First vertex of a hull in the set's pool. */
    uint32_t hull_offset;
    /* Number of vertices of a hull; 0 otherwise. */
    uint32_t hull_count;
};
SINEW_ASSERT(sizeof(struct sinew_obstacle) == 168);
SINEW_ASSERT(offsetof(struct sinew_obstacle, id) == 0);
SINEW_ASSERT(offsetof(struct sinew_obstacle, kind) == 4);
SINEW_ASSERT(offsetof(struct sinew_obstacle, position_m) == 8);
SINEW_ASSERT(offsetof(struct sinew_obstacle, quaternion) == 32);
SINEW_ASSERT(offsetof(struct sinew_obstacle, velocity_mps) == 64);
SINEW_ASSERT(offsetof(struct sinew_obstacle, dimensions_m) == 88);
SINEW_ASSERT(offsetof(struct sinew_obstacle, covariance_m2) == 112);
SINEW_ASSERT(offsetof(struct sinew_obstacle, hull_offset) == 160);
SINEW_ASSERT(offsetof(struct sinew_obstacle, hull_count) == 164);

#define SINEW_OBSTACLES_TYPE_NAME "sinew.Obstacles.v1"
struct sinew_obstacles {
    /* Header; `source_id` tells sources apart. */
    struct sinew_header header;
    /* Number of obstacles in use; 0 is a statement: nothing is there. */
    uint32_t count;
    /* Number of vertices in use. */
    uint32_t vertex_count;
    /* `FLAG_LEAVING`. */
    uint32_t flags;
    /* 0. */
    uint32_t reserved;
    /* Obstacles. */
    struct sinew_obstacle obstacles[64];
    /* Vertices of the hulls (m), each in its obstacle's frame. */
    double vertices_m[256][3];
};
SINEW_ASSERT(sizeof(struct sinew_obstacles) == 16944);
SINEW_ASSERT(offsetof(struct sinew_obstacles, header) == 0);
SINEW_ASSERT(offsetof(struct sinew_obstacles, count) == 32);
SINEW_ASSERT(offsetof(struct sinew_obstacles, vertex_count) == 36);
SINEW_ASSERT(offsetof(struct sinew_obstacles, flags) == 40);
SINEW_ASSERT(offsetof(struct sinew_obstacles, reserved) == 44);
SINEW_ASSERT(offsetof(struct sinew_obstacles, obstacles) == 48);
SINEW_ASSERT(offsetof(struct sinew_obstacles, vertices_m) == 10800);

#define SINEW_TARGET_TYPE_NAME "sinew.Target.v1"
struct sinew_target {
    /* Header. */
    struct sinew_header header;
    /* CLOCK_MONOTONIC (ns) at which the arm shall be there; 0: at once. */
    uint64_t valid_from_ns;
    /* `TargetMode`. */
    uint32_t mode;
    /* Shape mode: number of segments; must be the arm's. Tip mode: 0. */
    uint32_t segment_count;
    /* Tip position (m), base frame. */
    double position_m[3];
    /* Tip's unit quaternion `[w x y z]`, tip to base. */
    double quaternion[4];
    /* Tip velocity (m/s), base frame. */
    double velocity_mps[3];
    /* Tip angular velocity (rad/s), base frame. */
    double angular_velocity_radps[3];
    /* Average curvatures (1/m), (y, z) segment by segment. */
    double curvature_1pm[32];
    /* Their rates (1/(m s)). */
    double curvature_rate_1pms[32];
    /* Weight that the client gives its task; recorded. It does not change the motion, whose pace is the governor's.
     * 0: none. */
    double weight;
};
SINEW_ASSERT(sizeof(struct sinew_target) == 672);
SINEW_ASSERT(offsetof(struct sinew_target, header) == 0);
SINEW_ASSERT(offsetof(struct sinew_target, valid_from_ns) == 32);
SINEW_ASSERT(offsetof(struct sinew_target, mode) == 40);
SINEW_ASSERT(offsetof(struct sinew_target, segment_count) == 44);
SINEW_ASSERT(offsetof(struct sinew_target, position_m) == 48);
SINEW_ASSERT(offsetof(struct sinew_target, quaternion) == 72);
SINEW_ASSERT(offsetof(struct sinew_target, velocity_mps) == 104);
SINEW_ASSERT(offsetof(struct sinew_target, angular_velocity_radps) == 128);
SINEW_ASSERT(offsetof(struct sinew_target, curvature_1pm) == 152);
SINEW_ASSERT(offsetof(struct sinew_target, curvature_rate_1pms) == 408);
SINEW_ASSERT(offsetof(struct sinew_target, weight) == 664);

#define SINEW_TIP_TYPE_NAME "sinew.Tip.v1"
struct sinew_tip {
    /* Header. */
    struct sinew_header header;
    /* Position (m), base frame. */
    double position_m[3];
};
SINEW_ASSERT(sizeof(struct sinew_tip) == 56);
SINEW_ASSERT(offsetof(struct sinew_tip, header) == 0);
SINEW_ASSERT(offsetof(struct sinew_tip, position_m) == 32);

#define SINEW_OBSTACLE_DISTANCE_TYPE_NAME "sinew.ObstacleDistance.v1"
struct sinew_obstacle_distance {
    /* Source of the obstacle. */
    uint32_t source_id;
    /* Id of the obstacle within its source. */
    uint32_t obstacle_id;
    /* Smallest distance between the surfaces (m) at the estimate, growth not subtracted; negative: contact. */
    double surface_distance_m;
    /* By how much the planner grew the obstacle (m). */
    double growth_m;
};
SINEW_ASSERT(sizeof(struct sinew_obstacle_distance) == 24);
SINEW_ASSERT(offsetof(struct sinew_obstacle_distance, source_id) == 0);
SINEW_ASSERT(offsetof(struct sinew_obstacle_distance, obstacle_id) == 4);
SINEW_ASSERT(offsetof(struct sinew_obstacle_distance, surface_distance_m) == 8);
SINEW_ASSERT(offsetof(struct sinew_obstacle_distance, growth_m) == 16);

#define SINEW_SOURCE_REPORT_TYPE_NAME "sinew.SourceReport.v1"
struct sinew_source_report {
    /* Source id; 0 and `health` absent: place not used. */
    uint32_t source_id;
    /* `SourceHealth`. */
    uint32_t health;
    /* Sequence number of the last accepted message. */
    uint64_t sequence;
    /* Age of the last accepted message's capture time at the tick (s); infinite if there was none. */
    double age_s;
    /* Messages accepted. */
    uint64_t accepted;
    /* Messages rejected, at the place of their `RejectCause`. */
    uint64_t rejected[16];
};
SINEW_ASSERT(sizeof(struct sinew_source_report) == 160);
SINEW_ASSERT(offsetof(struct sinew_source_report, source_id) == 0);
SINEW_ASSERT(offsetof(struct sinew_source_report, health) == 4);
SINEW_ASSERT(offsetof(struct sinew_source_report, sequence) == 8);
SINEW_ASSERT(offsetof(struct sinew_source_report, age_s) == 16);
SINEW_ASSERT(offsetof(struct sinew_source_report, accepted) == 24);
SINEW_ASSERT(offsetof(struct sinew_source_report, rejected) == 32);

#define SINEW_ALARM_RECORD_TYPE_NAME "sinew.AlarmRecord.v1"
struct sinew_alarm_record {
    /* Code of the fault, of the limit, or `AlarmCode`. */
    uint32_t code;
    /* What it is about, by code: the fault's detail, a source id, a count of drives. */
    uint32_t subject;
    /* Time of the tick at which it was seen first (ns). */
    uint64_t since_ns;
};
SINEW_ASSERT(sizeof(struct sinew_alarm_record) == 16);
SINEW_ASSERT(offsetof(struct sinew_alarm_record, code) == 0);
SINEW_ASSERT(offsetof(struct sinew_alarm_record, subject) == 4);
SINEW_ASSERT(offsetof(struct sinew_alarm_record, since_ns) == 8);

#define SINEW_TICK_TIMING_TYPE_NAME "sinew.TickTiming.v1"
struct sinew_tick_timing {
    /* Wake-up after the deadline at which the tick should begin. Unit: ns. */
    uint64_t wakeup_ns;
    /* Taking over inputs. Unit: ns. */
    uint64_t input_ns;
    /* Observer. Unit: ns. */
    uint64_t estimate_ns;
    /* Supervisor and planner. Unit: ns. */
    uint64_t plan_ns;
    /* Guard. Unit: ns. */
    uint64_t guard_ns;
    /* Handing the tensions to the drives. */
    uint64_t send_ns;
    /* Wake-up to the end of sending. Unit: ns. */
    uint64_t cycle_ns;
};
SINEW_ASSERT(sizeof(struct sinew_tick_timing) == 56);
SINEW_ASSERT(offsetof(struct sinew_tick_timing, wakeup_ns) == 0);
SINEW_ASSERT(offsetof(struct sinew_tick_timing, input_ns) == 8);
SINEW_ASSERT(offsetof(struct sinew_tick_timing, estimate_ns) == 16);
SINEW_ASSERT(offsetof(struct sinew_tick_timing, plan_ns) == 24);
SINEW_ASSERT(offsetof(struct sinew_tick_timing, guard_ns) == 32);
SINEW_ASSERT(offsetof(struct sinew_tick_timing, send_ns) == 40);
SINEW_ASSERT(offsetof(struct sinew_tick_timing, cycle_ns) == 48);

#define SINEW_STATE_TYPE_NAME "sinew.State.v1"
struct sinew_state {
    /* Header; `tick` counts from 0, `capture_ns` is the tick's time. */
    struct sinew_header header;
    /* Time since the loop began (s). */
    double time_s;
    /* `SupervisorState`. */
    uint32_t supervisor;
    /* 0: no fault; otherwise the code of `control`'s fault. */
    uint32_t fault_code;
    /* What the fault is about (cable, drive, source), by code. */
    uint32_t fault_detail;
    /* `PlannerStatus`. */
    uint32_t planner_status;
    /* `PlannerBranch`. */
    uint32_t planner_branch;
    /* Newton iterations of the outer loop. */
    uint32_t newton_iterations;
    /* Sweeps of the swarm. */
    uint32_t swarm_sweeps;
    /* `TargetMode`; 0 without a target. */
    uint32_t target_mode;
    /* Sequence number of the target in use. */
    uint64_t target_sequence;
    /* Cost J of the answer. */
    double cost;
    /* KKT residual of the answer. */
    double kkt_residual;
    /* Number of cables. */
    uint32_t cable_count;
    /* Number of segments. */
    uint32_t segment_count;
    /* Number of nodes below (not of the arm, if the stride is above 1). */
    uint32_t node_count;
    /* Node i below is the arm's node `(i + 1) node_stride - 1`; the last one is always the tip. */
    uint32_t node_stride;
    /* Number of obstacles in `distances`. */
    uint32_t distance_count;
    /* Tracked obstacles that found no place (over the capacity). */
    uint32_t distance_dropped;
    /* Commanded tensions (N). */
    double tension_command_n[96];
    /* Measured tensions (N); NaN where not valid. */
    double tension_measured_n[96];
    /* Measured cable lengths (m); NaN where not valid. */
    double cable_length_m[96];
    /* Estimated tip position (m), base frame. */
    double tip_position_m[3];
    /* Estimated tip quaternion `[w x y z]`, tip to base. */
    double tip_quaternion[4];
    /* Estimated tip velocity (m/s), base frame. */
    double tip_velocity_mps[3];
    /* Estimated tip angular velocity (rad/s), base frame. */
    double tip_angular_velocity_radps[3];
    /* Desired tip position (m) at the tick; NaN in shape mode. */
    double target_position_m[3];
    /* Desired tip quaternion at the tick; NaN in shape mode. */
    double target_quaternion[4];
    /* Norm of the tip's position error (m); NaN in shape mode. */
    double tip_error_m;
    /* Norm of the tip's quaternion error, sign chosen in the tip's hemisphere; NaN in shape mode. */
    double quaternion_error;
    /* Estimated average curvatures (1/m), (y, z) segment by segment. */
    double curvature_1pm[32];
    /* Desired average curvatures (1/m); NaN in tip mode. */
    double target_curvature_1pm[32];
    /* Largest absolute error of a curvature (1/m); NaN in tip mode. */
    double curvature_error_1pm;
    /* Observer's innovation z (rad), (y, z) segment by segment. */
    double innovation_rad[32];
    /* Observer's disturbance estimate beta (N m). */
    double disturbance_nm[32];
    /* Estimated node positions (m), base frame. */
    double node_position_m[64][3];
    /* Estimated node quaternions `[w x y z]`, body to base. */
    double node_quaternion[64][4];
    /* Distances, one per tracked obstacle. */
    struct sinew_obstacle_distance distances[256];
    /* Obstacle sources. */
    struct sinew_source_report obstacle_sources[8];
    /* Target. */
    struct sinew_source_report target_report;
    /* Encoders. */
    struct sinew_source_report encoder_report;
    /* Obstacle sets refused because all places for sources are taken. */
    uint64_t obstacle_sources_refused;
    /* Ticks left out since the loop began, because it was late. */
    uint64_t ticks_missed;
    /* Records that found their queue full. */
    uint64_t records_dropped;
    /* Obstacle sources that are stale or expired. */
    uint64_t stale_sources;
    /* Where the time of this tick went. */
    struct sinew_tick_timing timing;
    /* Limits that act, bit by bit: bit k is the limit of code 100 + k. */
    uint64_t limits;
    /* Swing of the tip beside its motion that there may be, peak to peak (m). */
    double swing_m;
    /* Covariance of the estimated tip position (m^2, base frame), row by row; NaN where nothing was estimated yet. */
    double tip_covariance_m2[9];
    /* Speed over the configured one that was asked for; 1 after the arm was disarmed. */
    double speed_scale;
    /* Distance of the nearest point that the arm reaches from the tip target (m); NaN without one, or while it is
     * looked for. */
    double reach_miss_m;
    /* Attitude error there, roll left out (rad); NaN as above. */
    double reach_miss_rad;
    /* Load of the cables there, 1 being all that they may pull; NaN as above. */
    double reach_load;
    /* The nearest point (m), base frame; NaN as above. */
    double reach_nearest_m[3];
    /* Numbers that the latched fault carries, by code; NaN where there is none. */
    double fault_values[2];
    /* Bit 0: another cable of the segment may be the one of the fault. */
    uint32_t fault_flags;
    /* Number of alarms. */
    uint32_t alarm_count;
    /* Alarms that are on, as of a tenth of a second ago at most. */
    struct sinew_alarm_record alarms[32];
    /* Measured tip. */
    struct sinew_source_report tip_report;
    /* Measured position of the tip (m), base frame; NaN where none is fresh. */
    double tip_measured_m[3];
    /* What lasts of measured less estimated tip (m), base frame: taken off the tip targets; 0 without a sensor. */
    double tip_bias_m[3];
};
SINEW_ASSERT(sizeof(struct sinew_state) == 15936);
SINEW_ASSERT(offsetof(struct sinew_state, header) == 0);
SINEW_ASSERT(offsetof(struct sinew_state, time_s) == 32);
SINEW_ASSERT(offsetof(struct sinew_state, supervisor) == 40);
SINEW_ASSERT(offsetof(struct sinew_state, fault_code) == 44);
SINEW_ASSERT(offsetof(struct sinew_state, fault_detail) == 48);
SINEW_ASSERT(offsetof(struct sinew_state, planner_status) == 52);
SINEW_ASSERT(offsetof(struct sinew_state, planner_branch) == 56);
SINEW_ASSERT(offsetof(struct sinew_state, newton_iterations) == 60);
SINEW_ASSERT(offsetof(struct sinew_state, swarm_sweeps) == 64);
SINEW_ASSERT(offsetof(struct sinew_state, target_mode) == 68);
SINEW_ASSERT(offsetof(struct sinew_state, target_sequence) == 72);
SINEW_ASSERT(offsetof(struct sinew_state, cost) == 80);
SINEW_ASSERT(offsetof(struct sinew_state, kkt_residual) == 88);
SINEW_ASSERT(offsetof(struct sinew_state, cable_count) == 96);
SINEW_ASSERT(offsetof(struct sinew_state, segment_count) == 100);
SINEW_ASSERT(offsetof(struct sinew_state, node_count) == 104);
SINEW_ASSERT(offsetof(struct sinew_state, node_stride) == 108);
SINEW_ASSERT(offsetof(struct sinew_state, distance_count) == 112);
SINEW_ASSERT(offsetof(struct sinew_state, distance_dropped) == 116);
SINEW_ASSERT(offsetof(struct sinew_state, tension_command_n) == 120);
SINEW_ASSERT(offsetof(struct sinew_state, tension_measured_n) == 888);
SINEW_ASSERT(offsetof(struct sinew_state, cable_length_m) == 1656);
SINEW_ASSERT(offsetof(struct sinew_state, tip_position_m) == 2424);
SINEW_ASSERT(offsetof(struct sinew_state, tip_quaternion) == 2448);
SINEW_ASSERT(offsetof(struct sinew_state, tip_velocity_mps) == 2480);
SINEW_ASSERT(offsetof(struct sinew_state, tip_angular_velocity_radps) == 2504);
SINEW_ASSERT(offsetof(struct sinew_state, target_position_m) == 2528);
SINEW_ASSERT(offsetof(struct sinew_state, target_quaternion) == 2552);
SINEW_ASSERT(offsetof(struct sinew_state, tip_error_m) == 2584);
SINEW_ASSERT(offsetof(struct sinew_state, quaternion_error) == 2592);
SINEW_ASSERT(offsetof(struct sinew_state, curvature_1pm) == 2600);
SINEW_ASSERT(offsetof(struct sinew_state, target_curvature_1pm) == 2856);
SINEW_ASSERT(offsetof(struct sinew_state, curvature_error_1pm) == 3112);
SINEW_ASSERT(offsetof(struct sinew_state, innovation_rad) == 3120);
SINEW_ASSERT(offsetof(struct sinew_state, disturbance_nm) == 3376);
SINEW_ASSERT(offsetof(struct sinew_state, node_position_m) == 3632);
SINEW_ASSERT(offsetof(struct sinew_state, node_quaternion) == 5168);
SINEW_ASSERT(offsetof(struct sinew_state, distances) == 7216);
SINEW_ASSERT(offsetof(struct sinew_state, obstacle_sources) == 13360);
SINEW_ASSERT(offsetof(struct sinew_state, target_report) == 14640);
SINEW_ASSERT(offsetof(struct sinew_state, encoder_report) == 14800);
SINEW_ASSERT(offsetof(struct sinew_state, obstacle_sources_refused) == 14960);
SINEW_ASSERT(offsetof(struct sinew_state, ticks_missed) == 14968);
SINEW_ASSERT(offsetof(struct sinew_state, records_dropped) == 14976);
SINEW_ASSERT(offsetof(struct sinew_state, stale_sources) == 14984);
SINEW_ASSERT(offsetof(struct sinew_state, timing) == 14992);
SINEW_ASSERT(offsetof(struct sinew_state, limits) == 15048);
SINEW_ASSERT(offsetof(struct sinew_state, swing_m) == 15056);
SINEW_ASSERT(offsetof(struct sinew_state, tip_covariance_m2) == 15064);
SINEW_ASSERT(offsetof(struct sinew_state, speed_scale) == 15136);
SINEW_ASSERT(offsetof(struct sinew_state, reach_miss_m) == 15144);
SINEW_ASSERT(offsetof(struct sinew_state, reach_miss_rad) == 15152);
SINEW_ASSERT(offsetof(struct sinew_state, reach_load) == 15160);
SINEW_ASSERT(offsetof(struct sinew_state, reach_nearest_m) == 15168);
SINEW_ASSERT(offsetof(struct sinew_state, fault_values) == 15192);
SINEW_ASSERT(offsetof(struct sinew_state, fault_flags) == 15208);
SINEW_ASSERT(offsetof(struct sinew_state, alarm_count) == 15212);
SINEW_ASSERT(offsetof(struct sinew_state, alarms) == 15216);
SINEW_ASSERT(offsetof(struct sinew_state, tip_report) == 15728);
SINEW_ASSERT(offsetof(struct sinew_state, tip_measured_m) == 15888);
SINEW_ASSERT(offsetof(struct sinew_state, tip_bias_m) == 15912);

#define SINEW_REQUEST_TYPE_NAME "sinew.Request.v1"
struct sinew_request {
    /* Header. */
    struct sinew_header header;
    /* `RequestKind`. */
    uint32_t kind;
    /* 0. */
    uint32_t reserved;
    /* For `RequestKind.SetTarget`; otherwise ignored. */
    struct sinew_target target;
    /* For `RequestKind.Speed`: speed over the configured one, 0.01 to 1; otherwise ignored. */
    double speed_scale;
};
SINEW_ASSERT(sizeof(struct sinew_request) == 720);
SINEW_ASSERT(offsetof(struct sinew_request, header) == 0);
SINEW_ASSERT(offsetof(struct sinew_request, kind) == 32);
SINEW_ASSERT(offsetof(struct sinew_request, reserved) == 36);
SINEW_ASSERT(offsetof(struct sinew_request, target) == 40);
SINEW_ASSERT(offsetof(struct sinew_request, speed_scale) == 712);

#define SINEW_RESPONSE_TYPE_NAME "sinew.Response.v1"
struct sinew_response {
    /* Header; `sequence` is the request's. */
    struct sinew_header header;
    /* `Verdict`. */
    uint32_t verdict;
    /* `RefusalReason`. */
    uint32_t reason;
    /* A number that belongs to the reason (e.g. the `RejectCause` of a bad target); 0 otherwise. */
    uint32_t detail;
    /* `SupervisorState` after the request. */
    uint32_t supervisor;
    /* Fault code, as in `State`. */
    uint32_t fault_code;
    /* Detail of the fault, as in `State`. */
    uint32_t fault_detail;
    /* Explanation for people, UTF-8, filled up with zeros. */
    uint8_t text[128];
};
SINEW_ASSERT(sizeof(struct sinew_response) == 184);
SINEW_ASSERT(offsetof(struct sinew_response, header) == 0);
SINEW_ASSERT(offsetof(struct sinew_response, verdict) == 32);
SINEW_ASSERT(offsetof(struct sinew_response, reason) == 36);
SINEW_ASSERT(offsetof(struct sinew_response, detail) == 40);
SINEW_ASSERT(offsetof(struct sinew_response, supervisor) == 44);
SINEW_ASSERT(offsetof(struct sinew_response, fault_code) == 48);
SINEW_ASSERT(offsetof(struct sinew_response, fault_detail) == 52);
SINEW_ASSERT(offsetof(struct sinew_response, text) == 56);

#endif
