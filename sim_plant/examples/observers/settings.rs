//! What a run may vary, and the settings that follow from it.

#[path = "../../../tests/support/settings.rs"]
mod planner_settings;

use crate::closed_loop::Settings;
use crate::scenario::{Scenario, ScenarioName};
use sinew::config::{
    ArmConfig, BarrierConfig, BodyModel, Config, ObserverConfig, PlannerConfig, SwarmConfig, WarningBranch,
};
use sinew::integrator::Scheme;

/// Choices of a run; the default is what the study found best.
#[derive(Debug, Clone)]
pub struct Choice {
    pub scenario: ScenarioName,
    /// Of the runs with obstacles, and of the others (s).
    pub duration: f64,
    pub short: f64,
    /// s.
    pub period: f64,
    pub lookahead: f64,
    /// Newton iterations per tick.
    pub iterations: usize,
    /// m.
    pub clearance: f64,
    /// Barrier, 0 for none; its activation (m).
    pub gamma: f64,
    pub activation: f64,
    pub warning: WarningBranch,
    pub points: bool,
    /// s; `None` for the lag that follows from the weights.
    pub lead: Option<f64>,
    /// K over EI/L, D/K (s), tau_f (s), T_b (s).
    pub stiffness_ratio: f64,
    pub damping: f64,
    pub filter: f64,
    pub disturbance_time: f64,
    /// N/s; `None` for the arm's.
    pub rate_max: Option<f64>,
    /// The model in place of the observer.
    pub open_loop: bool,
    /// Friction coefficient that is made up for where a row asks for it.
    pub compensation: f64,
    /// Ticks of the row with latency.
    pub latency: usize,
    pub trace: Option<std::path::PathBuf>,
}

impl Default for Choice {
    fn default() -> Self {
        Self {
            scenario: ScenarioName::Tip,
            duration: 100.0,
            short: 30.0,
            period: 0.01,
            lookahead: 0.1,
            iterations: 2,
            clearance: 0.005,
            gamma: 0.3,
            activation: 0.15,
            warning: WarningBranch::Seeded,
            points: false,
            lead: None,
            stiffness_ratio: 2.0,
            damping: 2.0,
            filter: 0.1,
            disturbance_time: 0.4,
            rate_max: None,
            open_loop: false,
            compensation: 0.1,
            latency: 1,
            trace: None,
        }
    }
}

impl Choice {
    pub fn settings(&self) -> Settings {
        let scenario = Scenario::new(self.scenario);
        let mut arm = ArmConfig::paper();
        if let Some(rate) = self.rate_max {
            arm.tension_rate_npsmax = rate;
        }
        let scheme = Scheme::new(arm.rho_inf);
        let lag = scenario.rate_over_pose() * scheme.gamma / (scheme.phi * self.lookahead);
        let observer = ObserverConfig {
            model_damping_ratio: if self.open_loop { 1.0 } else { 2.5 },
            rho_inf: if self.open_loop { arm.rho_inf } else { 0.0 },
            stiffness_ratio: self.stiffness_ratio,
            damping_s: self.damping,
            filter_time_s: self.filter,
            disturbance_time_s: self.disturbance_time,
            ..Config::builtin().observer
        };
        let planner = PlannerConfig {
            lookahead_s: self.lookahead,
            period_s: self.period,
            newton_iterations_max: self.iterations,
            body: if self.points { BodyModel::Points } else { BodyModel::Arm },
            body_radius_m: 0.0,
            clearance_m: self.clearance,
            warning_distance_m: if self.gamma > 0.0 { self.activation } else { 0.01 },
            warning_hysteresis_m: 0.005,
            barrier: (self.gamma > 0.0).then_some(BarrierConfig { gamma: self.gamma, activation_m: self.activation }),
            swarm: SwarmConfig {
                particles_normal: 15,
                particles_uniform: 5,
                sweeps_max: 10,
                stall_sweeps: 3,
                tolerance: 1e-6,
                penalty: scenario.penalty(),
                ..planner_settings::swarm_config()
            },
            lead_s: self.lead,
            ..planner_settings::planner_config(self.warning)
        };
        // The shape example's lag is 20 s and its target stands still: nothing to lead.
        let lead = self.lead.unwrap_or(if scenario.is_tip() { lag } else { 0.0 });
        Settings {
            scenario,
            arm,
            observer,
            planner,
            lead,
            open_loop: self.open_loop,
            compensation: self.compensation,
            latency: self.latency,
            duration: self.duration,
            short: self.short,
            trace: self.trace.clone(),
        }
    }
}
