//! With which weights the loop steers mean curvatures.

use super::settings::Settings;
use crate::model::Arm;
use crate::planner::{Goal, sensitivity};

/// Weight of the posture over that of a position, as a share of the squared length of a segment.
const POSTURE_SHARE: f64 = 0.1;
/// R over the least of W, where none is given.
const TENSION_SHARE: f64 = 1e-4;

/// Weights of the cost in closed loop, for `sinew check`, with the keys that override them.
pub fn weights_in_words(settings: &Settings) -> Vec<(&'static str, String)> {
    let steering = Steering::new(settings);
    let list = |x: &[f64]| x.iter().map(|x| format!("{x:.2e}")).collect::<Vec<_>>().join(", ");
    vec![
        ("weights.tip.tension", format!("{:.2e} 1/N^2", steering.tension)),
        ("weights.tip.tension_change", format!("{} 1/N^2", list(&steering.change))),
        ("over the arm's own", {
            let ratio: Vec<f64> = steering.change.iter().zip(&steering.sensitivity).map(|(w, a)| w / a).collect();
            format!("{} (weights.tip.change_ratio)", list(&ratio))
        }),
    ]
}

/// Weights of the cost in closed loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Steering {
    /// On mean curvatures (m^2).
    pub curvature: f64,
    /// On their rates over that (s^2).
    pub rate: f64,
    /// R = r I (1/N^2).
    pub tension: f64,
    /// Diagonal of W per segment (1/N^2), for a period equal to the lookahead.
    pub change: Vec<f64>,
    /// What W is measured in: the diagonal of `S^T Q S` per segment (1/N^2).
    pub sensitivity: Vec<f64>,
}

impl Steering {
    /// As configured, the rest from the arm. Allocates.
    ///
    /// # Panics
    /// If a node of the arm has no mass, which the configuration does not permit.
    pub fn new(settings: &Settings) -> Self {
        let weights = &settings.weights.tip;
        let length = settings.arm.segments[0].length_m;
        let (curvature, rate) = (weights.pose * POSTURE_SHARE * length * length, weights.rate / weights.pose);
        let arm = Arm::new(&settings.arm);
        let zeros = vec![0.0; 2 * arm.segment_count()];
        let goal = Goal::Shape { curvatures: &zeros, weight: curvature, rate };
        let sensitivity = sensitivity(&arm, &settings.planner, settings.arm.rho_inf, &goal)
            .unwrap_or_else(|_| panic!("the arm {} has a node without mass", settings.arm.name));
        let change = weights
            .tension_change
            .clone()
            .unwrap_or_else(|| sensitivity.iter().map(|a| weights.change_ratio * a).collect());
        let least = change.iter().copied().fold(f64::INFINITY, f64::min);
        Self { curvature, rate, tension: weights.tension.unwrap_or(TENSION_SHARE * least), change, sensitivity }
    }
}
