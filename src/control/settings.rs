//! Everything that the cycle is built from.

use crate::config::{
    ArmConfig, Config, FrictionConfig, GovernorConfig, GuardConfig, LoopConfig, ObserverConfig, PlannerConfig,
    SafeHold, Scale, SupervisionConfig, TipSensorConfig, WeightsConfig,
};

/// Settings of a [`super::Cycle`], checked where they were read.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The arm.
    pub arm: ArmConfig,
    /// Period and overrun policy.
    pub timing: LoopConfig,
    /// Planner; its period is the loop's.
    pub planner: PlannerConfig,
    /// Weights of both kinds of target.
    pub weights: WeightsConfig,
    /// Time-out and innovation limits.
    pub observer: ObserverConfig,
    /// Friction that is made up for.
    pub friction: FrictionConfig,
    /// How a measured tip is used.
    pub tip_sensor: TipSensorConfig,
    /// Guard.
    pub guard: GuardConfig,
    /// Limits of motion.
    pub governor: GovernorConfig,
    /// What motion, tensions and cables are watched for.
    pub supervision: SupervisionConfig,
    /// What becomes of each cable at a fault that permits to hold.
    pub safe_hold: Vec<SafeHold>,
    /// Whether the arm may be armed while obstacles are not known.
    pub arm_unknown: bool,
    /// Tensions (N), one per cable, to which arming brings the cables and under which the observer settles; the safe
    /// values unless a task must start from another equilibrium.
    pub start_tensions_n: Vec<f64>,
    /// Home: average curvatures (1/m), (y, z) segment by segment; the straight arm unless told otherwise.
    pub home_curvatures_1pm: Vec<f64>,
    /// Home is reached when every bend angle is this near (rad); the closed loop's own error there is about 0.01.
    pub home_tolerance_rad: f64,
    /// Planning steps that may fail in a row before it is a fault; the last tensions are kept meanwhile.
    pub singular_plans_max: u32,
}

impl Settings {
    /// From the daemon's configuration.
    pub fn new(config: &Config) -> Self {
        let parts = Self::from_parts(
            config.arm.clone(),
            config.timing.clone(),
            config.planner.clone(),
            config.weights.clone(),
            config.observer.clone(),
            config.governor,
            config.guard.clone(),
            config.supervision,
        );
        let safe_hold = config.drives.drives.iter().map(|drive| drive.safe_hold).collect();
        Self {
            friction: config.friction.clone(),
            tip_sensor: config.tip_sensor,
            safe_hold,
            arm_unknown: config.obstacles.arm_unknown,
            ..parts
        }
    }

    /// From the parts that matter; start, home, friction (none), tip sensor and cables at a fault (hold) have their defaults.
    pub fn from_parts(
        arm: ArmConfig,
        timing: LoopConfig,
        planner: PlannerConfig,
        weights: WeightsConfig,
        observer: ObserverConfig,
        governor: GovernorConfig,
        guard: GuardConfig,
        supervision: SupervisionConfig,
    ) -> Self {
        let tip_sensor = TipSensorConfig::of(&Scale::of(&arm));
        Self {
            safe_hold: vec![SafeHold::Hold; arm.cable_count()],
            arm_unknown: false,
            start_tensions_n: vec![arm.tension_n_min; arm.cable_count()],
            home_curvatures_1pm: vec![0.0; 2 * arm.segments.len()],
            home_tolerance_rad: 0.0325,
            singular_plans_max: 5,
            arm,
            timing,
            planner,
            weights,
            observer,
            governor,
            friction: FrictionConfig::NONE,
            tip_sensor,
            guard,
            supervision,
        }
    }

    /// The safe tension of every cable (N): the least one of its box.
    pub fn safe_tension_n(&self) -> f64 {
        self.arm.tension_n_min
    }
}
