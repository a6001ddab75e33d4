//! The summary of a run, field by field as the command line's JSON prints it. A field that does not apply is null.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// From and to (s).
pub type Interval = [f64; 2];

/// A whole run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Scenario's name.
    pub scenario: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// Period (s).
    pub period_s: f64,
    /// Lookahead (s).
    pub lookahead_s: f64,
    /// Planning steps.
    pub ticks: u64,
    /// Steps whose Newton iteration did not converge within its limit; null where a fixed number of iterations is the
    /// rule and convergence is not asked for.
    pub not_converged: Option<u64>,
    /// Steps in which some required distance could not be kept and was asked for as far as possible; null in closed loop.
    #[serde(default)]
    pub relaxed: Option<u64>,
    /// Steps that left out pairs of arm and obstacle which may matter, for want of room; null in closed loop.
    #[serde(default)]
    pub truncated: Option<u64>,
    /// Newton iterations per step; null where a fixed number of them is the rule.
    pub newton: Newton,
    /// Distances, one entry per obstacle.
    pub obstacles: Vec<ObstacleSummary>,
    /// Tensions.
    pub tension_n: Tensions,
    /// Tip's position error (tip mode).
    pub tip_error_m: Option<TipError>,
    /// Largest component of the tip's quaternion error (tip mode).
    pub quaternion_error_max: Option<f64>,
    /// Largest curvature error at the end (shape mode, 1/m).
    pub curvature_error_final_1pm: Option<f64>,
    /// Computing times (us).
    pub time_us: Times,
    /// Work of the particle swarm; null where none searched, and in closed loop, where the record does not tell.
    pub swarm: Option<Swarm>,
    /// Loop statistics (closed loop only).
    #[serde(rename = "loop")]
    pub loop_: Option<Loop>,
    /// Faults that occurred, in words.
    pub faults: Vec<String>,
}

/// Newton iterations per branch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Newton {
    /// Safe subspace.
    pub safe: Option<Count>,
    /// Warning subspace.
    pub warning: Option<Count>,
}

/// Mean and largest of a count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Count {
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: u64,
}

/// One obstacle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObstacleSummary {
    /// Its name.
    pub id: String,
    /// Smallest surface distance along the whole arm (m), below 0 in contact.
    pub surface_distance_min_m: f64,
    /// When (s).
    pub at_s: f64,
    /// Times of contact (s).
    pub inside_s: Vec<Interval>,
    /// The same at the paper's points.
    pub points: Approach,
}

/// Smallest distance of something to an obstacle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Approach {
    /// Smallest surface distance (m).
    pub surface_distance_min_m: f64,
    /// When (s).
    pub at_s: f64,
    /// Times of contact (s).
    pub inside_s: Vec<Interval>,
}

/// Tensions of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tensions {
    /// Smallest (N).
    pub min: f64,
    /// Largest (N).
    pub max: f64,
    /// Cables that reached the upper bound, `"segment,cable"`.
    pub saturated: BTreeMap<String, Saturation>,
}

/// A cable at its upper bound.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Saturation {
    /// First time (s).
    pub first_s: f64,
    /// Number of ticks.
    pub ticks: u64,
}

/// Tip's position error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TipError {
    /// Smallest signed error per axis (m).
    pub min: [f64; 3],
    /// Largest signed error per axis (m).
    pub max: [f64; 3],
    /// Largest norm (m).
    pub norm_max: f64,
    /// Mean norm (m).
    pub norm_mean: f64,
}

/// Computing times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Times {
    /// Planning steps in the safe subspace.
    pub safe: Option<Percentiles>,
    /// Planning steps in the warning subspace.
    pub warning: Option<Percentiles>,
    /// Whole cycles of the loop (closed loop only).
    pub cycle: Option<Percentiles>,
}

/// Percentiles of a time (us).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99th.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// Work of the particle swarm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Swarm {
    /// Particles evaluated.
    pub evaluations: u64,
    /// Per second of the steps that searched, all of their planning counted: the search alone is faster (`cargo bench
    /// --bench cycle`). Null on a clock that stands still.
    pub evaluations_per_s: Option<f64>,
}

/// Statistics of the periodic loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Loop {
    /// Deadlines missed: the two below together.
    pub missed: u64,
    /// Ticks left out because the loop woke too late for them.
    pub left_out: u64,
    /// Ticks whose torques left after their period.
    pub overran: u64,
    /// Lateness of wake-ups; null in lockstep.
    pub wakeup_us: Option<Percentiles>,
}
