//! The full record of a tick.

use super::{Header, MAX_ALARMS, MAX_CABLES, MAX_CURVATURES, MAX_NODES, MAX_SOURCES, MAX_TRACKED, REJECT_CAUSES};
use iceoryx2::prelude::ZeroCopySend;

/// Distance of the arm to one tracked obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.ObstacleDistance.v1")]
pub struct ObstacleDistance {
    /// Source of the obstacle.
    pub source_id: u32,
    /// Id of the obstacle within its source.
    pub obstacle_id: u32,
    /// Smallest distance between the surfaces (m) at the estimate, growth not subtracted; negative: contact.
    pub surface_distance_m: f64,
    /// By how much the planner grew the obstacle (m).
    pub growth_m: f64,
}

/// What became of one source's messages.
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.SourceReport.v1")]
pub struct SourceReport {
    /// Source id; 0 and `health` absent: place not used.
    pub source_id: u32,
    /// [`super::SourceHealth`].
    pub health: u32,
    /// Sequence number of the last accepted message.
    pub sequence: u64,
    /// Age of the last accepted message's capture time at the tick (s); infinite if there was none.
    pub age_s: f64,
    /// Messages accepted.
    pub accepted: u64,
    /// Messages rejected, at the place of their [`super::RejectCause`].
    pub rejected: [u64; REJECT_CAUSES],
}

impl SourceReport {
    /// Messages rejected for whatever cause.
    pub fn rejected_total(&self) -> u64 {
        self.rejected.iter().sum()
    }
}

/// An alarm that is on: what is wrong, and since when. Its words go with the code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.AlarmRecord.v1")]
pub struct AlarmRecord {
    /// Code of the fault, of the limit, or [`super::AlarmCode`].
    pub code: u32,
    /// What it is about, by code: the fault's detail, a source id, a count of drives.
    pub subject: u32,
    /// Time of the tick at which it was seen first (ns).
    pub since_ns: u64,
}

/// Where a tick's time went (ns).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.TickTiming.v1")]
pub struct TickTiming {
    /// Wake-up after the deadline at which the tick should begin.
    pub wakeup_ns: u64,
    /// Taking over inputs.
    pub input_ns: u64,
    /// Observer.
    pub estimate_ns: u64,
    /// Supervisor and planner.
    pub plan_ns: u64,
    /// Guard.
    pub guard_ns: u64,
    /// Handing the tensions to the drives.
    pub send_ns: u64,
    /// Wake-up to the end of sending.
    pub cycle_ns: u64,
}

/// Everything about a tick.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.State.v1")]
pub struct State {
    /// Header; `tick` counts from 0, `capture_ns` is the tick's time.
    pub header: Header,
    /// Time since the loop began (s).
    pub time_s: f64,
    /// [`super::SupervisorState`].
    pub supervisor: u32,
    /// 0: no fault; otherwise the code of `control`'s fault.
    pub fault_code: u32,
    /// What the fault is about (cable, drive, source), by code.
    pub fault_detail: u32,
    /// [`super::PlannerStatus`].
    pub planner_status: u32,
    /// [`super::PlannerBranch`].
    pub planner_branch: u32,
    /// Newton iterations of the outer loop.
    pub newton_iterations: u32,
    /// Sweeps of the swarm.
    pub swarm_sweeps: u32,
    /// [`super::TargetMode`]; 0 without a target.
    pub target_mode: u32,
    /// Sequence number of the target in use.
    pub target_sequence: u64,
    /// Cost J of the answer.
    pub cost: f64,
    /// KKT residual of the answer.
    pub kkt_residual: f64,
    /// Number of cables.
    pub cable_count: u32,
    /// Number of segments.
    pub segment_count: u32,
    /// Number of nodes below (not of the arm, if the stride is above 1).
    pub node_count: u32,
    /// Node i below is the arm's node `(i + 1) node_stride - 1`; the last one is always the tip.
    pub node_stride: u32,
    /// Number of obstacles in `distances`.
    pub distance_count: u32,
    /// Tracked obstacles that found no place (over the capacity).
    pub distance_dropped: u32,
    /// Commanded tensions (N).
    pub tension_command_n: [f64; MAX_CABLES],
    /// Measured tensions (N); NaN where not valid.
    pub tension_measured_n: [f64; MAX_CABLES],
    /// Measured cable lengths (m); NaN where not valid.
    pub cable_length_m: [f64; MAX_CABLES],
    /// Estimated tip position (m), base frame.
    pub tip_position_m: [f64; 3],
    /// Estimated tip quaternion `[w x y z]`, tip to base.
    pub tip_quaternion: [f64; 4],
    /// Estimated tip velocity (m/s), base frame.
    pub tip_velocity_mps: [f64; 3],
    /// Estimated tip angular velocity (rad/s), base frame.
    pub tip_angular_velocity_radps: [f64; 3],
    /// Desired tip position (m) at the tick; NaN in shape mode.
    pub target_position_m: [f64; 3],
    /// Desired tip quaternion at the tick; NaN in shape mode.
    pub target_quaternion: [f64; 4],
    /// Norm of the tip's position error (m); NaN in shape mode.
    pub tip_error_m: f64,
    /// Norm of the tip's quaternion error, sign chosen in the tip's hemisphere; NaN in shape mode.
    pub quaternion_error: f64,
    /// Estimated average curvatures (1/m), (y, z) segment by segment.
    pub curvature_1pm: [f64; MAX_CURVATURES],
    /// Desired average curvatures (1/m); NaN in tip mode.
    pub target_curvature_1pm: [f64; MAX_CURVATURES],
    /// Largest absolute error of a curvature (1/m); NaN in tip mode.
    pub curvature_error_1pm: f64,
    /// Observer's innovation z (rad), (y, z) segment by segment.
    pub innovation_rad: [f64; MAX_CURVATURES],
    /// Observer's disturbance estimate beta (N m).
    pub disturbance_nm: [f64; MAX_CURVATURES],
    /// Estimated node positions (m), base frame.
    pub node_position_m: [[f64; 3]; MAX_NODES],
    /// Estimated node quaternions `[w x y z]`, body to base.
    pub node_quaternion: [[f64; 4]; MAX_NODES],
    /// Distances, one per tracked obstacle.
    pub distances: [ObstacleDistance; MAX_TRACKED],
    /// Obstacle sources.
    pub obstacle_sources: [SourceReport; MAX_SOURCES],
    /// Target.
    pub target_report: SourceReport,
    /// Encoders.
    pub encoder_report: SourceReport,
    /// Obstacle sets refused because all places for sources are taken.
    pub obstacle_sources_refused: u64,
    /// Ticks left out since the loop began, because it was late.
    pub ticks_missed: u64,
    /// Records that found their queue full.
    pub records_dropped: u64,
    /// Obstacle sources that are stale or expired.
    pub stale_sources: u64,
    /// Where the time of this tick went.
    pub timing: TickTiming,
    /// Limits that act, bit by bit: bit k is the limit of code 100 + k.
    pub limits: u64,
    /// Swing of the tip beside its motion that there may be, peak to peak (m).
    pub swing_m: f64,
    /// Covariance of the estimated tip position (m^2, base frame), row by row; NaN where nothing was estimated yet.
    pub tip_covariance_m2: [f64; 9],
    /// Speed over the configured one that was asked for; 1 after the arm was disarmed.
    pub speed_scale: f64,
    /// Distance of the nearest point that the arm reaches from the tip target (m); NaN without one, or while it is looked for.
    pub reach_miss_m: f64,
    /// Attitude error there, roll left out (rad); NaN as above.
    pub reach_miss_rad: f64,
    /// Load of the cables there, 1 being all that they may pull; NaN as above.
    pub reach_load: f64,
    /// The nearest point (m), base frame; NaN as above.
    pub reach_nearest_m: [f64; 3],
    /// Numbers that the latched fault carries, by code; NaN where there is none.
    pub fault_values: [f64; 2],
    /// Bit 0: another cable of the segment may be the one of the fault.
    pub fault_flags: u32,
    /// Number of alarms.
    pub alarm_count: u32,
    /// Alarms that are on, as of a tenth of a second ago at most.
    pub alarms: [AlarmRecord; MAX_ALARMS],
    /// Measured tip.
    pub tip_report: SourceReport,
    /// Measured position of the tip (m), base frame; NaN where none is fresh.
    pub tip_measured_m: [f64; 3],
    /// What lasts of measured less estimated tip (m), base frame: taken off the tip targets; 0 without a sensor.
    pub tip_bias_m: [f64; 3],
}

impl Default for State {
    fn default() -> Self {
        Self {
            header: Header::default(),
            time_s: 0.0,
            supervisor: 0,
            fault_code: 0,
            fault_detail: 0,
            planner_status: 0,
            planner_branch: 0,
            newton_iterations: 0,
            swarm_sweeps: 0,
            target_mode: 0,
            target_sequence: 0,
            cost: 0.0,
            kkt_residual: 0.0,
            cable_count: 0,
            segment_count: 0,
            node_count: 0,
            node_stride: 1,
            distance_count: 0,
            distance_dropped: 0,
            tension_command_n: [0.0; MAX_CABLES],
            tension_measured_n: [0.0; MAX_CABLES],
            cable_length_m: [0.0; MAX_CABLES],
            tip_position_m: [0.0; 3],
            tip_quaternion: [1.0, 0.0, 0.0, 0.0],
            tip_velocity_mps: [0.0; 3],
            tip_angular_velocity_radps: [0.0; 3],
            target_position_m: [f64::NAN; 3],
            target_quaternion: [f64::NAN; 4],
            tip_error_m: f64::NAN,
            quaternion_error: f64::NAN,
            curvature_1pm: [0.0; MAX_CURVATURES],
            target_curvature_1pm: [f64::NAN; MAX_CURVATURES],
            curvature_error_1pm: f64::NAN,
            innovation_rad: [0.0; MAX_CURVATURES],
            disturbance_nm: [0.0; MAX_CURVATURES],
            node_position_m: [[0.0; 3]; MAX_NODES],
            node_quaternion: [[1.0, 0.0, 0.0, 0.0]; MAX_NODES],
            distances: [ObstacleDistance::default(); MAX_TRACKED],
            obstacle_sources: [SourceReport::default(); MAX_SOURCES],
            target_report: SourceReport::default(),
            encoder_report: SourceReport::default(),
            obstacle_sources_refused: 0,
            ticks_missed: 0,
            records_dropped: 0,
            stale_sources: 0,
            timing: TickTiming::default(),
            limits: 0,
            swing_m: 0.0,
            tip_covariance_m2: [f64::NAN; 9],
            speed_scale: 1.0,
            reach_miss_m: f64::NAN,
            reach_miss_rad: f64::NAN,
            reach_load: f64::NAN,
            reach_nearest_m: [f64::NAN; 3],
            fault_values: [f64::NAN; 2],
            fault_flags: 0,
            alarm_count: 0,
            alarms: [AlarmRecord::default(); MAX_ALARMS],
            tip_report: SourceReport::default(),
            tip_measured_m: [f64::NAN; 3],
            tip_bias_m: [0.0; 3],
        }
    }
}

impl State {
    /// Stride with which an arm of `nodes` nodes fits: the smallest that leaves at most [`MAX_NODES`].
    pub const fn stride_for(nodes: usize) -> usize {
        let stride = nodes.div_ceil(MAX_NODES);
        if stride == 0 { 1 } else { stride }
    }

    /// Copies the arm's nodes, every [`State::stride_for`]-th and always the tip. Does not allocate.
    ///
    /// `position_m` and `quaternion` give node `i` of `nodes` (0 is the first one after the clamped base).
    pub fn set_nodes(
        &mut self,
        nodes: usize,
        position_m: impl Fn(usize) -> [f64; 3],
        quaternion: impl Fn(usize) -> [f64; 4],
    ) {
        let stride = Self::stride_for(nodes);
        let count = nodes.div_ceil(stride);
        for i in 0..count {
            let node = ((i + 1) * stride).min(nodes) - 1;
            self.node_position_m[i] = position_m(node);
            self.node_quaternion[i] = quaternion(node);
        }
        self.node_count = count as u32;
        self.node_stride = stride as u32;
    }
}
