//! A tip target out of reach, in numbers and words: for the status, alarms and answers of commands.

use crate::control::Limit;
use crate::ipc::payload::{State, SupervisorState, TargetMode};
use serde::{Deserialize, Serialize};

/// By how much a tip target is out of reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReachStatus {
    /// Whether the arm holds because of it; otherwise it approaches the nearest pose.
    pub refused: bool,
    /// Distance of the nearest point from the target (m).
    pub miss_m: f64,
    /// Attitude error there (rad), roll about the tip's tangent left out.
    pub miss_rad: f64,
    /// Load of the cables there; above 1 the posture needs more than they may pull.
    pub load: f64,
    /// The nearest point (m, base frame).
    pub nearest_m: [f64; 3],
}

impl ReachStatus {
    /// Of a record; `None` where no target is out of reach.
    pub fn of(state: &State) -> Option<Self> {
        let is_out = state.limits >> (Limit::OutOfReach.code() - 100) & 1 == 1;
        // Where the mode was left meanwhile there is no target to speak of.
        if !is_out || !state.reach_miss_m.is_finite() {
            return None;
        }
        Some(Self {
            refused: state.supervisor != SupervisorState::Tracking.wire(),
            miss_m: state.reach_miss_m,
            miss_rad: state.reach_miss_rad,
            load: state.reach_load,
            nearest_m: state.reach_nearest_m,
        })
    }

    /// What the arm does about it, and by how much it misses.
    pub fn text(&self) -> String {
        let does = if self.refused { "the arm holds" } else { "the nearest pose is approached" };
        let [x, y, z] = self.nearest_m;
        let turn = self.miss_rad.to_degrees();
        let turned = if turn >= 0.1 { format!(" and {turn:.1} deg") } else { String::new() };
        let load = if self.load > 1.0 {
            format!(", which needs {:.2} times what its cables may pull", self.load)
        } else {
            String::new()
        };
        format!(
            "{does}; it misses the target by {:.1} mm{turned}, nearest at ({x:.3}, {y:.3}, {z:.3}) m{load}",
            1e3 * self.miss_m
        )
    }
}

/// Whether it is being looked for how near the arm gets to the tip target that it follows.
pub(super) fn is_sought(state: &State) -> bool {
    state.supervisor == SupervisorState::Tracking.wire()
        && state.target_mode == TargetMode::Tip.wire()
        && state.reach_miss_m.is_nan()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_out_of_reach_is_told_with_what_is_done_and_what_is_not_is_not_told() {
        let mut state = State {
            limits: 1 << (Limit::OutOfReach.code() - 100),
            supervisor: SupervisorState::Tracking.wire(),
            reach_miss_m: 0.9123,
            reach_miss_rad: 0.1,
            reach_load: 0.4,
            reach_nearest_m: [0.1, -0.2, -2.5],
            ..State::default()
        };
        assert_eq!(
            ReachStatus::of(&state).unwrap().text(),
            "the nearest pose is approached; it misses the target by 912.3 mm and 5.7 deg, nearest at (0.100, -0.200, -2.500) m"
        );
        state.supervisor = SupervisorState::Holding.wire();
        (state.reach_miss_rad, state.reach_load) = (0.0, 1.3);
        assert_eq!(
            ReachStatus::of(&state).unwrap().text(),
            "the arm holds; it misses the target by 912.3 mm, nearest at (0.100, -0.200, -2.500) m, which needs 1.30 times what its cables may pull"
        );
        state.limits = 0;
        assert_eq!(ReachStatus::of(&state), None);
        assert!(!is_sought(&state));
        state = State {
            target_mode: TargetMode::Tip.wire(),
            supervisor: SupervisorState::Tracking.wire(),
            ..State::default()
        };
        assert!(is_sought(&state));
        state.reach_miss_m = 0.0;
        assert!(!is_sought(&state));
    }
}
