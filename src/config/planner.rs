//! Settings of the combined planner (paper, section 3).

use serde::Serialize;

/// What solves the warning subspace.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WarningBranch {
    /// The improved particle swarm, (27)-(36), alone.
    Swarm,
    /// The swarm with the extended complementarity problem's solution among its seeds.
    Seeded,
    /// The extended complementarity problem alone.
    Complementarity,
    /// The standard particle swarm (29) with a uniform start, for comparison (figure 16).
    StandardSwarm,
}

impl WarningBranch {
    /// The name that the configuration has for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Swarm => "swarm",
            Self::Seeded => "seeded",
            Self::Complementarity => "complementarity",
            Self::StandardSwarm => "standard_swarm",
        }
    }
}

/// Which model of the arm's body the distances are measured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyModel {
    /// The paper's potential collision points: element mid-points, nodes, connector ends.
    Points,
    /// The backbone's whole curve.
    Arm,
}

/// Discrete barrier `d_next - d_s >= (1 - gamma)(d - d_s)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BarrierConfig {
    /// Share of the remaining distance that one lookahead may use up, in (0, 1].
    pub gamma: f64,
    /// Surface distance above the clearance from which it acts (m).
    pub activation_m: f64,
}

/// Particle swarm, Algorithm 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SwarmConfig {
    /// delta_1: particles from N(u_{k-1}, sigma^2).
    pub particles_normal: usize,
    /// delta_2: particles from U(u_min, u_max).
    pub particles_uniform: usize,
    /// sigma (N).
    pub sigma_n: f64,
    /// phi_1: fewest particles moved by the logistic map.
    pub chaotic_min: usize,
    /// phi_2: most particles moved by the logistic map.
    pub chaotic_max: usize,
    /// Inertia weight omega of (29) at the first and the last sweep; linear between.
    pub inertia: [f64; 2],
    /// Acceleration coefficients varsigma_1 (own best) and varsigma_2 (swarm's best).
    pub acceleration: [f64; 2],
    /// Most sweeps per call.
    pub sweeps_max: usize,
    /// Sweeps without relative improvement of `tolerance` after which it stops.
    pub stall_sweeps: usize,
    /// Relative improvement that counts.
    pub tolerance: f64,
    /// Penalty factor nu of (28).
    pub penalty: f64,
}

/// Settings of the combined planner.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannerConfig {
    /// Lookahead eta (s): the implicit step that is planned.
    pub lookahead_s: f64,
    /// Period of the loop (s); equal to the lookahead in the paper.
    pub period_s: f64,
    /// Most Newton iterations of the outer loop per step.
    pub newton_iterations_max: usize,
    /// The outer loop stops when the norm of the coordinates' correction is below this (m, 1).
    pub newton_tolerance: f64,
    /// Which branch solves the warning subspace.
    pub warning: WarningBranch,
    /// False plans without regard to obstacles.
    pub avoidance: bool,
    /// The body's model.
    pub body: BodyModel,
    /// The body's radius (m) around the backbone; 0 reproduces the paper.
    pub body_radius_m: f64,
    /// d_s as a clearance between surfaces (m); the paper's d_s is the ball's radius plus this.
    pub clearance_m: f64,
    /// d_w: margin on top of d_s inside which the warning branch plans (m).
    pub warning_distance_m: f64,
    /// Extra margin that must be regained before the safe branch plans again (m).
    pub warning_hysteresis_m: f64,
    /// Barrier of the receding-horizon use; `None` for the paper's hard constraint.
    pub barrier: Option<BarrierConfig>,
    /// The swarm.
    pub swarm: SwarmConfig,
    /// Time budget of one planning step (s); `None` leaves only the work counts.
    pub budget_s: Option<f64>,
    /// Lead time (s) added to the target's sampling time; `None` computes the lag from the weights.
    pub lead_s: Option<f64>,
}

impl PlannerConfig {
    /// Distance above the clearance within which the warning branch plans (m): d_w, and never less than the barrier's
    /// reach, since only the warning branch knows distances.
    pub fn warning_margin_m(&self) -> f64 {
        self.warning_distance_m.max(self.barrier.map_or(0.0, |b| b.activation_m))
    }
}
