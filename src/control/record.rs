//! Everything about a tick, as one `Copy` value of fixed size: what telemetry takes away from the control thread.

use super::fault::{Latched, Limits};
use super::reach::Reach;
use super::supervisor::{DrivesPhase, Mode};
use super::target::Target;
use super::{CABLES_MAX, CURVATURES_MAX, CableMask, NODES_MAX};
use crate::collision::OBSTACLES_MAX;
use crate::planner::Report;

/// Distance of the estimated arm to one obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distance {
    /// Identifier of the obstacle, as its set has it.
    pub id: u64,
    /// Smallest distance between the surfaces along the whole arm (m); negative: contact. Growth is not subtracted.
    pub along_arm_m: f64,
    /// The same at the paper's points (m).
    pub at_points_m: f64,
    /// By how much the planner grew the obstacle (m).
    pub growth_m: f64,
}

/// Where a tick's time went (ns); the caller fills it, for the cycle knows no clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Timing {
    /// Wake-up after the time at which the tick should begin.
    pub wakeup_ns: u64,
    /// Taking over inputs.
    pub input_ns: u64,
    /// Encoders and observer.
    pub estimate_ns: u64,
    /// Supervisor and planner.
    pub plan_ns: u64,
    /// Guard.
    pub guard_ns: u64,
    /// Handing over the tensions.
    pub send_ns: u64,
    /// Wake-up to the end of sending.
    pub cycle_ns: u64,
}

/// The record of a tick. Arrays are as long as any arm needs; counts say how much of them is this arm's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Tick, from 0.
    pub tick: u64,
    /// Its time (ns).
    pub now_ns: u64,
    /// Mode after the tick.
    pub mode: Mode,
    /// The first cause of the latched faults.
    pub fault: Option<Latched>,
    /// Faults since the last clear, repetitions included.
    pub fault_count: u32,
    /// Limits that acted.
    pub limits: Limits,
    /// Measured position of the tip (m), base frame; NaN where none is fresh.
    pub tip_measured_m: [f64; 3],
    /// What lasts of measured less estimated tip (m), base frame.
    pub tip_bias_m: [f64; 3],
    /// Swing of the tip that there may be, peak to peak (m); 0 where nothing was watched yet.
    pub swing_m: f64,
    /// Covariance of the estimated tip position (m^2, base frame), row by row; NaN where nothing was estimated yet.
    pub tip_covariance_m2: [f64; 9],
    /// Speed over the configured one that was asked for.
    pub speed_scale: f64,
    /// How near the arm gets to the tip target; `None` without one, or while that is looked for.
    pub reach: Option<Reach>,
    /// Drives.
    pub drives: DrivesPhase,
    /// Missed deadlines that are not forgotten.
    pub deadlines_missed: u32,
    /// Events that were overwritten before they were taken.
    pub events_dropped: u64,
    /// The planner's report; `None` where it did not run.
    pub plan: Option<Report>,
    /// Whether the estimate below follows the arm; otherwise it is the arm at rest as its cables' lengths show it, evenly bent,
    /// and without them the last one, or the straight arm.
    pub observing: bool,
    /// Whether the observer has settled.
    pub settled: bool,
    /// Largest |z| (rad).
    pub innovation_max_rad: f64,

    /// Number of cables.
    pub cable_count: usize,
    /// Tensions commanded in this tick (N).
    pub tension_command_n: [f64; CABLES_MAX],
    /// Tensions measured (N); NaN where there is none.
    pub tension_measured_n: [f64; CABLES_MAX],
    /// Cable lengths used by the observer (m).
    pub cable_length_m: [f64; CABLES_MAX],
    /// Which of them were bridged.
    pub bridged: CableMask,
    /// Time of the readings (ns).
    pub encoder_capture_ns: u64,

    /// Number of average curvatures, two per segment.
    pub curvature_count: usize,
    /// Estimated average curvatures (1/m), (y, z) segment by segment.
    pub curvature_1pm: [f64; CURVATURES_MAX],
    /// Innovation z (rad), the same order; NaN where the observer gives none.
    pub innovation_rad: [f64; CURVATURES_MAX],
    /// Disturbance beta (N m), the same order; NaN where the observer gives none.
    pub disturbance_nm: [f64; CURVATURES_MAX],

    /// Estimated tip position (m, base frame).
    pub tip_position_m: [f64; 3],
    /// Estimated tip quaternion `[w x y z]`, tip to base.
    pub tip_quaternion: [f64; 4],
    /// Estimated tip velocity (m/s, base frame).
    pub tip_velocity_mps: [f64; 3],
    /// Estimated tip angular velocity (rad/s, base frame).
    pub tip_angular_velocity_radps: [f64; 3],

    /// Target at the tick's time.
    pub target: Option<Target>,
    /// Sequence number of the target in use.
    pub target_sequence: u64,
    /// Norm of the tip's position error against it (m); NaN without a tip target.
    pub tip_error_m: f64,
    /// Norm of the quaternion error, sign in the tip's hemisphere; NaN without a tip target.
    pub quaternion_error: f64,
    /// Largest absolute error of a curvature (1/m); NaN without a shape target.
    pub curvature_error_1pm: f64,

    /// Number of nodes below.
    pub node_count: usize,
    /// Node i below is the arm's node `(i + 1) stride - 1`, counted from 0 behind the base; the last one is the tip.
    pub node_stride: usize,
    /// Estimated positions (m, base frame) and quaternions `[x y z, w x y z]`.
    pub nodes: [[f64; 7]; NODES_MAX],

    /// Number of obstacles below.
    pub obstacle_count: usize,
    /// Distances, in the order of the set.
    pub distances: [Distance; OBSTACLES_MAX],
    /// Time.
    pub timing: Timing,
}

impl Default for Record {
    fn default() -> Self {
        Self {
            tick: 0,
            now_ns: 0,
            mode: Mode::Disarmed,
            fault: None,
            fault_count: 0,
            limits: Limits::default(),
            tip_measured_m: [f64::NAN; 3],
            tip_bias_m: [0.0; 3],
            swing_m: 0.0,
            tip_covariance_m2: [f64::NAN; 9],
            speed_scale: 1.0,
            reach: None,
            drives: DrivesPhase::Off,
            deadlines_missed: 0,
            events_dropped: 0,
            plan: None,
            observing: false,
            settled: false,
            innovation_max_rad: f64::NAN,
            cable_count: 0,
            tension_command_n: [0.0; CABLES_MAX],
            tension_measured_n: [f64::NAN; CABLES_MAX],
            cable_length_m: [f64::NAN; CABLES_MAX],
            bridged: CableMask::default(),
            encoder_capture_ns: 0,
            curvature_count: 0,
            curvature_1pm: [0.0; CURVATURES_MAX],
            innovation_rad: [f64::NAN; CURVATURES_MAX],
            disturbance_nm: [f64::NAN; CURVATURES_MAX],
            tip_position_m: [0.0; 3],
            tip_quaternion: [1.0, 0.0, 0.0, 0.0],
            tip_velocity_mps: [0.0; 3],
            tip_angular_velocity_radps: [0.0; 3],
            target: None,
            target_sequence: 0,
            tip_error_m: f64::NAN,
            quaternion_error: f64::NAN,
            curvature_error_1pm: f64::NAN,
            node_count: 0,
            node_stride: 1,
            nodes: [[0.0; 7]; NODES_MAX],
            obstacle_count: 0,
            distances: [Distance::default(); OBSTACLES_MAX],
            timing: Timing::default(),
        }
    }
}
