//! Validation and merging of inputs: pure, without allocation, with time as an argument.
//!
//! Enters: payloads as they came, any bits whatever. Leaves: the newest valid content of every source, counters of what
//! was rejected and why, the health of each source, and obstacles extrapolated and grown for the planner. Nothing is
//! dropped in silence: a rejected message is counted by cause, a silent source grows, then asks for a hold.

mod check;
mod encoders;
mod obstacles;
mod source;
mod target;
mod tip;

pub use encoders::*;
pub use obstacles::*;
pub use source::*;
pub use target::*;
pub use tip::*;

/// Thresholds of the intake; one set each for obstacles, targets and encoders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputLimits {
    /// A source is stale when the age of its newest content exceeds this (s).
    pub stale_after_s: f64,
    /// A source is expired when the age exceeds this (s), not below `stale_after_s`: the arm is asked to hold.
    pub hold_after_s: f64,
    /// Growth of a stale source's obstacles per second of age beyond `stale_after_s` (m/s).
    pub growth_mps: f64,
    /// Most that an obstacle grows by its source's age (m).
    pub growth_m_max: f64,
    /// Obstacles are grown by this many standard deviations of their position in its worst direction.
    pub sigma_multiple: f64,
    /// A capture time may lie this far in the future (s): clocks are the same, threads are not.
    pub future_tolerance_s: f64,
}

impl Default for InputLimits {
    /// Three frames of a 30 Hz camera until stale, half a second until hold.
    fn default() -> Self {
        Self {
            stale_after_s: 0.1,
            hold_after_s: 0.5,
            growth_mps: 0.1,
            growth_m_max: 1.0,
            sigma_multiple: 3.0,
            future_tolerance_s: 0.005,
        }
    }
}

/// Difference `later - earlier` (s), negative if `later` is earlier.
pub(crate) fn elapsed_s(earlier_ns: u64, later_ns: u64) -> f64 {
    if later_ns >= earlier_ns {
        (later_ns - earlier_ns) as f64 * 1e-9
    } else {
        -((earlier_ns - later_ns) as f64 * 1e-9)
    }
}
