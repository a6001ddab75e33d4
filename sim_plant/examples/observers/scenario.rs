//! The paper's two examples, (38)-(47), written out for the study.

use nalgebra::{Vector3, Vector4};
use sinew::collision::{Obstacle, ObstacleSet, Shape, pose};
use sinew::config::ShapeConfig;
use sinew::planner::Goal;
use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// Which task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum ScenarioName {
    /// The paper's tip example.
    Tip,
    /// The paper's shape example.
    Shape,
}

/// (44), 1/m.
const SHAPE: [f64; 8] = [0.806, 0.806, -2.417, 0.0, -1.611, -2.417, -1.611, -2.417];

/// A task over time.
#[derive(Debug, Clone)]
pub struct Scenario {
    tip: bool,
    target: Vec<f64>,
}

/// Tensions and curvatures at t = 0.
pub struct Start {
    pub tensions: Vec<f64>,
    pub curvatures: Vec<f64>,
}

impl Scenario {
    pub fn new(name: ScenarioName) -> Self {
        Self { tip: name == ScenarioName::Tip, target: SHAPE.to_vec() }
    }

    /// The shape example with half of (44) as its target, held.
    pub fn half_shape() -> Self {
        Self { tip: false, target: SHAPE.iter().map(|k| k / 2.0).collect() }
    }

    pub fn is_tip(&self) -> bool {
        self.tip
    }

    /// Target curvatures of the shape task (1/m).
    pub fn curvatures(&self) -> &[f64] {
        &self.target
    }

    pub fn rate_over_pose(&self) -> f64 {
        if self.tip { 5e10 / 5e12 } else { 1.0 }
    }

    /// nu.
    pub fn penalty(&self) -> f64 {
        if self.tip { 1e12 } else { 1e16 }
    }

    /// W's entry per segment.
    pub fn change(&self) -> Vec<f64> {
        if self.tip { (1..=4).map(|k| 1e4 * f64::from(k)).collect() } else { vec![2e6; 4] }
    }

    pub fn goal(&self, t: f64) -> Goal<'_> {
        if self.tip {
            Goal::Tip {
                position: self.position(t),
                quaternion: Self::quaternion(),
                pose: 5e12,
                rate: 5e10,
                damping: 1e8,
            }
        } else {
            Goal::Shape { curvatures: &self.target, weight: -9.99e5 * (t.min(100.0) - 100.0).powi(2) + 1e10, rate: 1.0 }
        }
    }

    /// (38)-(39), m.
    pub fn position(&self, t: f64) -> Vector3<f64> {
        let theta = match t {
            t if t <= 25.0 => PI / 100.0 * t,
            t if t <= 50.0 => -PI / 100.0 * (t - 25.0) + 5.0 * PI / 4.0,
            t if t <= 75.0 => -PI / 100.0 * (t - 50.0) + PI,
            t => PI / 100.0 * (t - 75.0) + 7.0 * PI / 4.0,
        };
        let rho = 0.6 * (2.0 * theta).cos();
        Vector3::new(rho * theta.cos(), rho * theta.sin(), -2.4)
    }

    /// (40).
    pub fn quaternion() -> Vector4<f64> {
        Vector4::new(FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2, 0.0)
    }

    /// Two balls of 0.1 m, (43) or (47).
    pub fn obstacles(&self) -> ObstacleSet {
        let mut set = ObstacleSet::new();
        for id in 0..2 {
            let ball = Shape::new(&ShapeConfig::Ball { radius_m: 0.1 }).unwrap();
            let at = pose([0.0; 3], [1.0, 0.0, 0.0, 0.0]).unwrap();
            set.insert(Obstacle::new(id, ball, &at).unwrap()).unwrap();
        }
        set
    }

    /// Puts them where they are at `t`.
    pub fn move_obstacles(&self, t: f64, set: &mut ObstacleSet) {
        let centres = if self.tip {
            let a = (PI * t / 6000.0 + 7.0 * PI / 600.0) * t;
            [[0.45, 0.15, -1.20], [0.40 + 0.32 * a.cos(), -0.15 + 0.32 * a.sin(), -1.68]]
        } else {
            [[0.20, -0.10, -2.40], [0.25, 0.50, -0.01 * t - 1.20]]
        };
        for (k, c) in centres.into_iter().enumerate() {
            set.set_pose(k, &pose(c, [1.0, 0.0, 0.0, 0.0]).unwrap()).unwrap();
        }
    }

    /// The start that belongs to the task: the reference's static equilibrium, or straight.
    pub fn start(&self, arm: &sinew::model::Arm) -> Start {
        if !self.tip {
            return Start { tensions: vec![0.0; arm.cable_count()], curvatures: vec![0.0; 2 * arm.segment_count()] };
        }
        let text = include_str!("../../../tests/golden/tip_start.json");
        let value: serde_json::Value = serde_json::from_str(text).unwrap();
        let numbers =
            |key: &str| value[key].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect::<Vec<f64>>();
        let q = numbers("q0");
        let (mut k, mut kd) = (vec![0.0; 2 * arm.segment_count()], vec![0.0; 2 * arm.segment_count()]);
        arm.curvatures_into(&q, &vec![0.0; q.len()], &mut k, &mut kd);
        Start { tensions: numbers("u0"), curvatures: k }
    }
}
