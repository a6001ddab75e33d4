//! Settings of planner and observer that tests, benches and examples start from.
#![allow(dead_code)] // each binary uses its own part

use sinew::config::{BodyModel, ObserverConfig, PlannerConfig, SwarmConfig, WarningBranch};

/// A swarm of 40 particles that does all its sweeps, as many as the reference made.
pub fn swarm_config() -> SwarmConfig {
    SwarmConfig {
        particles_normal: 30,
        particles_uniform: 10,
        sigma_n: 2.0,
        chaotic_min: 2,
        chaotic_max: 8,
        inertia: [0.9, 0.4],
        acceleration: [1.5, 1.5],
        sweeps_max: 60,
        stall_sweeps: 60,
        tolerance: 0.0,
        penalty: 1e12,
    }
}

/// The paper's setting: period and lookahead of 0.1 s, Newton to convergence, hard distances at the paper's points.
pub fn planner_config(warning: WarningBranch) -> PlannerConfig {
    PlannerConfig {
        lookahead_s: 0.1,
        period_s: 0.1,
        newton_iterations_max: 30,
        newton_tolerance: 1e-8,
        warning,
        avoidance: true,
        body: BodyModel::Points,
        body_radius_m: 0.0,
        clearance_m: 0.0,
        warning_distance_m: 0.01,
        warning_hysteresis_m: 0.0,
        barrier: None,
        swarm: swarm_config(),
        budget_s: None,
        lead_s: None,
    }
}

/// The observer as it is shipped.
pub fn observer_config() -> ObserverConfig {
    ObserverConfig {
        stiffness_ratio: 2.0,
        damping_s: 2.0,
        filter_time_s: 0.3,
        disturbance_time_s: 0.4,
        model_damping_ratio: 2.5,
        rho_inf: 0.0,
        settle_innovation_rad: 0.01,
        settle_rate_radps: 0.01,
        settle_time_s: 0.5,
        settle_timeout_s: 20.0,
        innovation_bound_rad: 0.3,
        innovation_growth_rad: 0.15,
        innovation_window_s: 0.1,
        latency_ticks: 0,
    }
}
