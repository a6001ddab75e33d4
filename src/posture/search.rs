//! A search for the posture that reaches a pose: inverse statics from where the arm is, then from other postures, as long as
//! none reaches it.

use super::inverse::{Inverse, InverseSettings};
use super::reference::segment_lengths;
use super::rest::RestingArm;
use crate::model::Arm;
use nalgebra::{Vector3, Vector4};

/// Iterations after which a start is given up.
const ITERATIONS_MAX: usize = 120;
/// Iterations with whole steps, and the share of a step after them.
const WHOLE_STEPS: usize = 50;
const STEP_SHARE: f64 = 0.3;
/// Starts tried after the first.
const STARTS: usize = 6;
/// Iterations have ended where no bend angle changes by more than this (rad).
const CONVERGED_RAD: f64 = 2e-5;
/// The pose is reached as well as it can be where another centre changes no bend angle by more than this (rad).
const RECENTRED_RAD: f64 = 1e-3;

/// The search of one arm. [`Search::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Search {
    inverse: Inverse,
    /// Length of the segment of each curvature (m).
    length: Vec<f64>,
    /// Range of the tensions of each segment's cables (N).
    tension_range_n: Vec<f64>,
    chain: Vec<f64>,
    /// Iterations so far and starts tried, while it is under way.
    at: Option<(usize, usize)>,
    best: RestingArm,
    best_error_m: f64,
    best_load: f64,
}

impl Search {
    /// For an arm and the range of the tensions of each segment's cables (N). Allocates.
    pub fn new(arm: &Arm, settings: &InverseSettings, tension_range_n: &[f64]) -> Self {
        let length = segment_lengths(arm);
        Self {
            inverse: Inverse::new(arm, settings),
            chain: vec![0.0; length.len()],
            length,
            tension_range_n: tension_range_n.to_vec(),
            at: None,
            best: RestingArm::new(arm),
            best_error_m: f64::INFINITY,
            best_load: 0.0,
        }
    }

    /// Begins anew from a posture: of all that reach a pose the one that is nearest is found first.
    pub fn begin(&mut self, from: &RestingArm) {
        self.at = Some((0, 0));
        self.best_error_m = f64::INFINITY;
        self.inverse.rest_mut().copy_from(from);
        self.inverse.centre_at(from.curvatures().iter().copied());
    }

    /// Gives it up.
    pub fn cancel(&mut self) {
        self.at = None;
    }

    /// Whether it has not ended.
    pub const fn is_under_way(&self) -> bool {
        self.at.is_some()
    }

    /// One iteration towards a pose, under tensions `u` (N) beside the moments that hold the curvatures; whether the search ends
    /// with it. `error` tells what an equilibrium with the load of its cables is off (m), where iterations have ended there, and
    /// what is off by less than `enough_m` is good enough. The inverse statics end at the best.
    pub fn iterate(
        &mut self,
        u: &[f64],
        position: &Vector3<f64>,
        quaternion: &Vector4<f64>,
        enough_m: f64,
        error: impl FnOnce(&RestingArm, f64) -> f64,
    ) -> bool {
        let Some((iterations, starts)) = &mut self.at else { return true };
        *iterations += 1;
        // What the roll counts for changes with the posture, and whole steps may go round in a circle for it.
        let by = if *iterations < WHOLE_STEPS { 1.0 } else { STEP_SHARE };
        if let Ok(outcome) = self.inverse.iterate_by(by, u, position, quaternion) {
            let mut converged = outcome.change_rad < CONVERGED_RAD;
            if converged {
                // What bending costs has held it off the pose: from here it costs nothing, until that changes nothing.
                let rest = self.inverse.rest().curvatures();
                let off = rest.iter().zip(self.inverse.centre()).zip(&self.length);
                converged = off.map(|((k, c), l)| (k - c).abs() * l).fold(0.0, f64::max) < RECENTRED_RAD;
                self.inverse.recentre();
            }
            if !converged && *iterations < ITERATIONS_MAX {
                return false;
            }
            // A posture beyond the cables' tensions is none.
            let mut load = 0.0f64;
            for (segment, range_n) in self.tension_range_n.iter().enumerate() {
                load = load.max(self.inverse.rest().load_into(segment, *range_n, &mut self.chain));
            }
            let error_m = error(self.inverse.rest(), load);
            if error_m < self.best_error_m {
                (self.best_error_m, self.best_load) = (error_m, load);
                self.best.copy_from(self.inverse.rest());
            }
        }
        if self.best_error_m >= enough_m && *starts < STARTS {
            *starts += 1;
            *iterations = 0;
            let start = *starts;
            self.start_from(start);
            return false;
        }
        self.at = None;
        if self.best_error_m.is_finite() {
            self.inverse.rest_mut().copy_from(&self.best);
        }
        true
    }

    /// The best equilibrium that was found, and the load of its cables; `None` where none was.
    pub fn best(&self) -> Option<(&RestingArm, f64)> {
        self.best_error_m.is_finite().then_some((&self.best, self.best_load))
    }

    /// The inverse statics, to go on from where the search has ended.
    pub const fn inverse_mut(&mut self) -> &mut Inverse {
        &mut self.inverse
    }

    /// What a squared bend angle costs (m^2), the position error's square being 1.
    pub const fn effort(&self) -> f64 {
        self.inverse.effort()
    }

    /// Another posture to start from: straight, then bent towards one side after another.
    fn start_from(&mut self, start: usize) {
        self.chain.fill(0.0);
        if start > 1 {
            let angle = 2.4 * start as f64;
            for (i, k) in self.chain.iter_mut().enumerate() {
                let bend = if (i / 2) % 2 == start % 2 { 0.9 } else { 0.3 };
                *k = bend / self.length[i] * if i % 2 == 0 { angle.cos() } else { angle.sin() };
            }
        }
        self.inverse.rest_mut().restart(&self.chain);
        self.inverse.centre_at(std::iter::repeat(0.0));
    }
}
