//! Safe or warning subspace (17), and the barrier on the approach (design section 6).

use crate::config::{BarrierConfig, PlannerConfig};

/// The decision (17) with hysteresis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WarningState {
    /// d_s + d_w (m).
    enter: f64,
    /// d_s + d_w + hysteresis (m).
    leave: f64,
    /// `None` before the first decision.
    warning: Option<bool>,
}

impl WarningState {
    /// Undecided, which counts as warning; the first decision has no past to hold to and enters at `d_s + d_w`.
    pub fn new(clearance_m: f64, warning_distance_m: f64, hysteresis_m: f64) -> Self {
        let enter = clearance_m + warning_distance_m;
        Self { enter, leave: enter + hysteresis_m, warning: None }
    }

    /// With the planner's settings.
    pub fn from_config(config: &PlannerConfig) -> Self {
        Self::new(config.clearance_m, config.warning_margin_m(), config.warning_hysteresis_m)
    }

    /// Decide on the smallest distance of all pairs (m; infinite where there is no obstacle). Warning at or below
    /// `d_s + d_w`; safe again only above that plus the hysteresis. NaN is a warning.
    pub fn update(&mut self, distance_min_m: f64) -> bool {
        let bound = if self.warning == Some(true) { self.leave } else { self.enter };
        let warning = distance_min_m.is_nan() || distance_min_m <= bound;
        self.warning = Some(warning);
        warning
    }

    /// As decided last.
    pub fn is_warning(&self) -> bool {
        self.warning.unwrap_or(true)
    }
}

/// The least distance (m) that a pair may have at the end of the step: the clearance `d_s`, or, inside the barrier's
/// activation, `d_s + (1 - gamma)(d - d_s)` of the distance `d` that the same body point has now. A pair inside its
/// clearance may thus recover gradually.
pub fn required_distance(distance_now_m: f64, clearance_m: f64, barrier: Option<&BarrierConfig>) -> f64 {
    match barrier {
        Some(b) if distance_now_m.is_nan() || distance_now_m - clearance_m <= b.activation_m => {
            clearance_m + (1.0 - b.gamma) * (distance_now_m - clearance_m)
        }
        _ => clearance_m,
    }
}
