//! One planning step of the safe subspace, to convergence, from the states of `tests/golden/plan_steps.json`.

#[path = "../../tests/support/settings.rs"]
mod settings;

use crate::{count, cpu_seconds};
use nalgebra::{Vector3, Vector4};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};
use settings::planner_config;
use sinew::collision::ObstacleSet;
use sinew::config::{ArmConfig, PlannerConfig, SwarmConfig, WarningBranch};
use sinew::model::State;
use sinew::planner::{Goal, Inputs, Planner};

/// The paper's final curvatures (44).
pub const SHAPE: [f64; 8] = [0.806, 0.806, -2.417, 0.0, -1.611, -2.417, -1.611, -2.417];

/// Where a planning step starts: read once.
pub struct Case {
    pub state: State,
    pub u_previous: Vec<f64>,
    pub obstacles: Vec<[f64; 3]>,
    pub shape: bool,
    pub t: f64,
    pub eta: f64,
}

pub fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().expect("an array").iter().map(|x| x.as_f64().expect("a number")).collect()
}

/// Reads case `k` of the reference data.
pub fn case(k: usize) -> Case {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/plan_steps.json");
    let data: Value = serde_json::from_str(&std::fs::read_to_string(path).expect("the reference data")).expect("JSON");
    let case = &data["cases"][k];
    let v = |key: &str| numbers(&case[key]);
    Case {
        state: State { q: v("q0"), qd: v("v0"), qdd: v("vd0"), a: v("a0"), lambda: v("lam0") },
        u_previous: v("u_prev"),
        obstacles: v("obstacles").chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
        shape: case["scenario"] == "shape",
        t: case["t"].as_f64().expect("a time"),
        eta: case["eta"].as_f64().expect("a step"),
    }
}

/// The goal of a case; a tip's position comes with the request, because its curve is the Python side's too.
pub fn goal<'a>(case: &Case, request: &Value) -> Goal<'a> {
    if case.shape {
        Goal::Shape { curvatures: &SHAPE, weight: -9.99e5 * (case.t - 100.0).powi(2) + 1e10, rate: 1.0 }
    } else {
        let h = std::f64::consts::FRAC_1_SQRT_2;
        let position = Vector3::from_row_slice(&numbers(&request["position"]));
        Goal::Tip { position, quaternion: Vector4::new(h, 0.0, h, 0.0), pose: 5e12, rate: 5e10, damping: 1e8 }
    }
}

/// W's diagonal per segment, R's is 1.
pub fn change(case: &Case) -> [f64; 4] {
    if case.shape { [2e6; 4] } else { [1e4, 2e4, 3e4, 4e4] }
}

/// The paper's setting without obstacles; the swarm does all sweeps that it is given.
pub fn settings(eta: f64, penalty: f64) -> PlannerConfig {
    let base = planner_config(WarningBranch::Complementarity);
    PlannerConfig {
        lookahead_s: eta,
        period_s: eta,
        avoidance: false,
        swarm: SwarmConfig { stall_sweeps: usize::MAX, penalty, ..base.swarm },
        ..base
    }
}

#[derive(Default)]
pub struct Server {
    loaded: Option<(usize, Case, Planner)>,
}

impl Server {
    /// Plans the same step `repeats` times and returns each time in seconds.
    pub fn plan(&mut self, request: &Value) -> Value {
        let k = count(request, "case");
        if self.loaded.as_ref().is_none_or(|(loaded, ..)| *loaded != k) {
            let case = case(k);
            let config = ArmConfig::paper();
            let planner = Planner::new(&config, &settings(case.eta, 0.0), 1.0, &change(&case));
            self.loaded = Some((k, case, planner));
        }
        let (_, case, planner) = self.loaded.as_mut().expect("just loaded");
        let none = ObstacleSet::new();
        let inputs = Inputs {
            state: &case.state,
            u_previous: &case.u_previous,
            disturbance: &[],
            led_to: None,
            goal: goal(case, request),
            now: &none,
            ahead: &none,
        };
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut seconds = Vec::new();
        let mut report = planner.plan(&inputs, &mut rng, &mut || false);
        for _ in 0..count(request, "repeats") {
            let begin = cpu_seconds();
            report = planner.plan(&inputs, &mut rng, &mut || false);
            seconds.push(cpu_seconds() - begin);
        }
        json!({
            "seconds": seconds, "cost": report.cost, "iterations": report.iterations, "tensions": planner.tensions(),
            "status": format!("{:?}", report.status), "kkt_residual": report.kkt_residual,
        })
    }
}
