//! Postures to hold the arm in: of given curvatures, of a pose of the tip, random ones; and tensions that hold them.

use super::StabilityError;
use crate::config::{Config, GovernorConfig};
use crate::control::Reach;
use crate::estimator::CableSpace;
use crate::model::Arm;
use crate::planner::complementarity::{Problem, Solver};
use crate::posture::{InverseSettings, RestingArm, Search};
use nalgebra::{Vector3, Vector4};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Largest bend angle of a segment of a random posture (rad).
const BEND_MAX_RAD: f64 = 1.3;
/// Load steps of the way from the straight arm to a shape, and iterations at its end.
const STEPS: u32 = 16;
const MORE: u32 = 8;
/// Norm of the coordinates' last correction, over the arm's length, where a shape is reached.
const REACHED: f64 = 4e-9;
/// Weight of the moments over that of the tensions' sum of squares, and how far beyond the box is looked.
const MOMENTS: f64 = 1e6;
const BEYOND: f64 = 100.0;
/// By how much the least tension held is above the box, over its range.
const LIFT: f64 = 0.01;

/// The equilibrium at mean curvatures (1/m) under the least tensions and moments of the cables. `None` where the way to it
/// from the straight arm meets an instability.
pub(super) fn at_curvatures(config: &Config, arm: &Arm, curvatures: &[f64]) -> Option<RestingArm> {
    let u = vec![config.arm.tension_n_min; arm.cable_count()];
    let mut rest = RestingArm::new(arm);
    let mut norm = f64::NAN;
    for k in 1..=STEPS + MORE {
        let share = (f64::from(k) / f64::from(STEPS)).min(1.0);
        let wanted: Vec<f64> = curvatures.iter().map(|c| share * c).collect();
        rest.linearize(&u).ok()?;
        norm = rest.advance(&wanted);
    }
    (norm < REACHED * config.arm.length_m()).then_some(rest)
}

/// A random posture, evenly over the disc of bends of each segment: mean curvatures (1/m), `(y, z)` segment by segment, that
/// have an equilibrium, and the pose of its tip: position (m, base frame) and quaternion (body to base). The same seed gives
/// the same posture. Allocates.
pub fn random_posture(config: &Config, seed: u64) -> (Vec<f64>, (Vector3<f64>, Vector4<f64>)) {
    let arm = Arm::new(&config.arm);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    loop {
        let mut bends = |length_m: f64| {
            let bend = BEND_MAX_RAD * rng.random_range(0.0f64..1.0).sqrt();
            let side = rng.random_range(0.0..std::f64::consts::TAU);
            [bend * side.cos() / length_m, bend * side.sin() / length_m]
        };
        let curvatures: Vec<f64> = config.arm.segments.iter().flat_map(|s| bends(s.length_m)).collect();
        if let Some(rest) = at_curvatures(config, &arm, &curvatures) {
            return (curvatures, rest.tip());
        }
    }
}

/// Mean curvatures (1/m) of an equilibrium whose tip is at a pose (m, base frame; unit quaternion, body to base), by the
/// governor's own search from the straight arm. Allocates.
///
/// # Errors
/// [`StabilityError::OutOfReach`].
pub fn reach(config: &Config, position: &Vector3<f64>, quaternion: &Vector4<f64>) -> Result<Vec<f64>, StabilityError> {
    let GovernorConfig { attitude_length_m, reach_m, .. } = config.governor;
    let arm = Arm::new(&config.arm);
    let u = vec![config.arm.tension_n_min; arm.cable_count()];
    let range_n: Vec<f64> =
        config.arm.segments.iter().map(|s| config.arm.segment_tension_n_max(s) - config.arm.tension_n_min).collect();
    let settings = InverseSettings { attitude_length_m, ..InverseSettings::default() };
    let mut search = Search::new(&arm, &settings, &range_n);
    search.begin(&RestingArm::new(&arm));
    let of = |rest: &RestingArm, load| Reach::of(rest, load, &(*position, *quaternion), reach_m, attitude_length_m);
    let error = |rest: &RestingArm, load| of(rest, load).error_m(reach_m, attitude_length_m);
    while !search.iterate(&u, position, quaternion, reach_m, error) {}
    match search.best().map(|(rest, load)| (rest, of(rest, load))) {
        Some((rest, reach)) if !reach.is_out => Ok(rest.curvatures().to_vec()),
        other => Err(StabilityError::OutOfReach(other.map_or(f64::NAN, |(_, reach)| reach.miss_m))),
    }
}

/// What tensions there are (N).
#[derive(Debug, Clone)]
pub(super) struct TensionBox {
    pub(super) least_n: f64,
    most_n: Vec<f64>,
    /// By how much the least tension held is above the least one.
    pub(super) lift_n: f64,
}

impl TensionBox {
    pub(super) fn of(config: &Config) -> Self {
        let (least_n, most_n) = (config.arm.tension_n_min, config.arm.tension_maxima_n());
        Self { least_n, most_n, lift_n: LIFT * (config.arm.tension_n_max - least_n) }
    }

    /// Commanded tensions (N), of which `pull` times as much acts, that give bending moments (N m) beyond the least tensions': of
    /// all that do those with the least sum of squares, all a little above the least. Allocates.
    ///
    /// # Errors
    /// [`StabilityError::Tension`].
    pub(super) fn tensions(&self, arm: &Arm, moments: &[f64], pull: f64) -> Result<Vec<f64>, StabilityError> {
        let (cables, space) = (arm.cable_count(), CableSpace::new(arm));
        let largest = (0..cables).map(|c| space.lever(c).iter().map(|l| l * l).sum::<f64>()).fold(0.0, f64::max);
        let weight = MOMENTS / largest;
        let (mut a, mut b) = (vec![0.0; cables * cables], vec![0.0; cables]);
        for i in 0..cables {
            let dot = |other: &[f64]| space.lever(i).iter().zip(other).map(|(x, y)| x * y).sum::<f64>();
            for j in 0..cables {
                a[i * cables + j] = weight * dot(space.lever(j)) + if i == j { 1.0 } else { 0.0 };
            }
            b[i] = -weight * dot(moments);
        }
        let lift = pull * (self.least_n + self.lift_n) - self.least_n;
        let (lower, upper) = (vec![lift; cables], vec![BEYOND * self.most_n[0]; cables]);
        let mut u = lower.clone();
        let problem = Problem { a: &a, b: &b, lower: &lower, upper: &upper, c: &[], d: &[], price: &[] };
        Solver::new(cables, 0).solve(&problem, &mut u, &mut || false);
        u.iter_mut().for_each(|u| *u = (*u + self.least_n) / pull);
        match (0..cables).find(|c| u[*c] > self.most_n[*c]) {
            Some(cable) => Err(StabilityError::Tension { needed_n: u[cable], most_n: self.most_n[cable] }),
            None => Ok(u),
        }
    }

    /// An iteration for the commanded tensions (N), of which `pull` times as much acts, under which an arm rests at mean
    /// curvatures (1/m). What all cables of a segment pull alike bends it, too, once it is bent.
    ///
    /// # Errors
    /// [`StabilityError`].
    pub(super) fn lead(
        &self,
        rest: &mut RestingArm,
        curvatures: &[f64],
        pull: f64,
        tensions_n: &mut Vec<f64>,
    ) -> Result<(), StabilityError> {
        let acting: Vec<f64> = tensions_n.iter().map(|u| pull * u).collect();
        let (q, lambda) = (rest.state().q.clone(), rest.state().lambda.clone());
        rest.take_shape(&q, &lambda);
        rest.linearize(&acting).map_err(|_| StabilityError::NoRest("the arm is at an instability".to_owned()))?;
        rest.advance(curvatures);
        let space = CableSpace::new(rest.arm());
        let mut moments = rest.moments().to_vec();
        for (cable, u) in acting.iter().enumerate() {
            moments.iter_mut().zip(space.lever(cable)).for_each(|(m, lever)| *m += lever * (u - self.least_n));
        }
        *tensions_n = self.tensions(rest.arm(), &moments, pull)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_posture_that_reaches_a_pose_has_its_tip_there() {
        let config = Config::builtin();
        let arm = Arm::new(&config.arm);
        // From the third on the search with whole steps went round in circles, up to 26 mm off.
        for seed in [1, 7, 38, 48, 57] {
            let (_, (position, quaternion)) = random_posture(&config, seed);
            let curvatures = reach(&config, &position, &quaternion).unwrap();
            let (tip, _) = at_curvatures(&config, &arm, &curvatures).unwrap().tip();
            assert!((tip - position).norm() < 1e-3, "{seed}: {tip} for {position}");
        }
    }
}
