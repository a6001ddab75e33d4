//! The golden planning cases, ready to be planned.
#![allow(dead_code)] // each binary uses its own part
#![allow(clippy::unwrap_used)] // a broken file or scene should stop the test

use super::settings::planner_config;
use nalgebra::{Vector3, Vector4};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::Value;
use sinew::collision::{Obstacle, ObstacleSet, Shape, pose};
use sinew::config::{ArmConfig, PlannerConfig, ShapeConfig, SwarmConfig, WarningBranch};
use sinew::model::{Arm, State};
use sinew::planner::{Deadline, Goal, Inputs, Planner, Report};

/// Final curvatures of the shape example (44).
pub const SHAPE: [f64; 8] = [0.806, 0.806, -2.417, 0.0, -1.611, -2.417, -1.611, -2.417];

/// The paper's lemniscate (38)-(39), written out here once more so that the scenario's own code is not its judge.
pub fn tip_target(t: f64) -> Vector3<f64> {
    use std::f64::consts::PI;
    let theta = match t {
        t if t <= 25.0 => PI / 100.0 * t,
        t if t <= 50.0 => -PI / 100.0 * (t - 25.0) + 5.0 * PI / 4.0,
        t if t <= 75.0 => -PI / 100.0 * (t - 50.0) + PI,
        t => PI / 100.0 * (t - 75.0) + 7.0 * PI / 4.0,
    };
    let rho = 0.6 * (2.0 * theta).cos();
    Vector3::new(rho * theta.cos(), rho * theta.sin(), -2.4)
}

/// A ball in a set.
pub fn insert_ball(set: &mut ObstacleSet, id: u64, radius_m: f64, at: [f64; 3]) {
    let ball = Shape::new(&ShapeConfig::Ball { radius_m }).unwrap();
    let pose = pose(at, [1.0, 0.0, 0.0, 0.0]).unwrap();
    set.insert(Obstacle::new(id, ball, &pose).unwrap()).unwrap();
}

/// One golden planning step: where it starts, what it wants, what is in the way.
pub struct PlanCase {
    pub what: String,
    pub config: ArmConfig,
    pub settings: PlannerConfig,
    /// W's diagonal entry per segment.
    pub change: Vec<f64>,
    pub state: State,
    pub u_previous: Vec<f64>,
    pub goal: Goal<'static>,
    pub obstacles: ObstacleSet,
    /// The file's own record.
    pub data: Value,
}

impl PlanCase {
    fn new(what: String, params: &Value, data: Value) -> Self {
        let v = |k: &str| super::numbers(&data[k]);
        let shape = data["scenario"] == "shape";
        let (t, eta) = (super::number(&data["t"]), super::number(&data["eta"]));
        let base = planner_config(WarningBranch::Seeded);
        let penalty = if shape { 1e16 } else { 1e12 };
        let settings = PlannerConfig {
            lookahead_s: eta,
            period_s: eta,
            avoidance: data["avoid"].as_bool().unwrap(),
            swarm: SwarmConfig { penalty, ..base.swarm },
            ..base
        };
        let mut obstacles = ObstacleSet::new();
        for (k, c) in v("obstacles").chunks_exact(3).enumerate() {
            insert_ball(&mut obstacles, k as u64, 0.1, c.try_into().unwrap());
        }
        let h = std::f64::consts::FRAC_1_SQRT_2;
        let goal = if shape {
            Goal::Shape { curvatures: &SHAPE, weight: -9.99e5 * (t - 100.0).powi(2) + 1e10, rate: 1.0 }
        } else {
            let quaternion = Vector4::new(h, 0.0, h, 0.0);
            Goal::Tip { position: tip_target(t), quaternion, pose: 5e12, rate: 5e10, damping: 1e8 }
        };
        let config = super::arm_config(params);
        Self {
            what,
            settings,
            change: (1..=config.segments.len()).map(|k| if shape { 2e6 } else { 1e4 * k as f64 }).collect(),
            config,
            state: State { q: v("q0"), qd: v("v0"), qdd: v("vd0"), a: v("a0"), lambda: v("lam0") },
            u_previous: v("u_prev"),
            goal,
            obstacles,
            data,
        }
    }

    /// The golden optimum's cost (15a).
    pub fn optimum(&self) -> f64 {
        super::number(&self.data["J_opt"])
    }

    pub fn planner(&self, warning: WarningBranch) -> Planner {
        Planner::new(&self.config, &PlannerConfig { warning, ..self.settings.clone() }, 1.0, &self.change)
    }

    pub fn arm(&self) -> Arm {
        Arm::new(&self.config)
    }

    pub fn inputs(&self) -> Inputs<'_> {
        Inputs {
            state: &self.state,
            u_previous: &self.u_previous,
            disturbance: &[],
            led_to: None,
            goal: self.goal,
            now: &self.obstacles,
            ahead: &self.obstacles,
        }
    }

    pub fn plan(&self, planner: &mut Planner, rng: &mut Xoshiro256PlusPlus, deadline: &mut dyn Deadline) -> Report {
        planner.plan(&self.inputs(), rng, deadline)
    }
}

/// All golden planning cases.
pub fn plan_cases() -> Vec<PlanCase> {
    super::golden_files("cases")
        .into_iter()
        .flat_map(|(file, data)| {
            let params = data["params"].clone();
            let cases = data["cases"].as_array().unwrap().clone();
            cases.into_iter().enumerate().map(move |(k, c)| {
                let what = format!("{file} case {k} ({} t {} avoid {})", c["scenario"], c["t"], c["avoid"]);
                PlanCase::new(what, &params, c)
            })
        })
        .collect()
}
