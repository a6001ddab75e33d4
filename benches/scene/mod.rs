//! What the benches plan in: the daemon's setting, a goal near the tip, balls beside the arm.

#[path = "../../tests/support/mod.rs"]
pub mod support;

use nalgebra::Vector3;
use sinew::collision::ObstacleSet;
use sinew::config::{BarrierConfig, BodyModel, PlannerConfig, WarningBranch};
use sinew::math::quaternion::rotation;
use sinew::model::{Arm, State};
use sinew::planner::Goal;
use support::planning::insert_ball;

/// Two Newton iterations a tick of 10 ms, distances along the whole arm, barrier.
pub fn receding(warning: WarningBranch) -> PlannerConfig {
    PlannerConfig {
        period_s: 0.01,
        newton_iterations_max: 2,
        body: BodyModel::Arm,
        clearance_m: 0.01,
        warning_hysteresis_m: 0.005,
        barrier: Some(BarrierConfig { gamma: 0.3, activation_m: 0.15 }),
        ..support::settings::planner_config(warning)
    }
}

/// 5 cm from the tip, attitude as it is, the paper's weights.
pub fn goal(arm: &Arm, state: &State) -> Goal<'static> {
    let tip = arm.tip(&state.q, &state.qd);
    Goal::Tip {
        position: tip.position + Vector3::new(0.03, -0.03, 0.02),
        quaternion: tip.quaternion,
        pose: 5e12,
        rate: 5e10,
        damping: 1e8,
    }
}

/// Balls of 0.1 m beside nodes all along the arm, ball `k` with its surface `gap_m(k)` from the backbone.
pub fn balls(arm: &Arm, state: &State, count: usize, gap_m: impl Fn(usize) -> f64) -> ObstacleSet {
    let n = arm.node_count();
    let mut set = ObstacleSet::with_capacity(count);
    for k in 0..count {
        let (r, p) = arm.pose(&state.q, n - 1 - (k * 7) % n);
        let angle = k as f64 * 2.4;
        let side = rotation(&p) * Vector3::new(0.0, angle.cos(), angle.sin());
        insert_ball(&mut set, k as u64, 0.1, (r + side * (0.1 + gap_m(k))).into());
    }
    set
}
