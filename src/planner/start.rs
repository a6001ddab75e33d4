//! Start of a tip task: static equilibrium with the tip at a given pose and the least sum of squared tensions.

use super::complementarity::{Problem, Solver};
use super::problem::{Goal, Quadratic};
use crate::integrator::{AffineMap, StaticsError, Stepper, equilibrium};
use crate::math::block_tridiagonal::BLOCK;
use crate::model::{Arm, Motion, Rates, State};
use nalgebra::{Vector3, Vector4};

/// Why no start was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StartError {
    /// The iteration ended away from the pose.
    #[error(
        "no equilibrium with the tip at the wanted pose was found: {} mm from it after {iterations} iterations",
        1e3 * distance
    )]
    PoseNotReached {
        /// Distance of the tip from the wanted position (m).
        distance: f64,
        /// Iterations.
        iterations: usize,
    },
    /// The tensions found do not hold an equilibrium.
    #[error(transparent)]
    Statics(#[from] StaticsError),
}

/// A weight that makes the pose a constraint: over the largest tension's square and the arm's length, it leaves about 4e-9
/// of the length.
const POSE_WEIGHT: f64 = 1e13 / 6400.0;
/// Largest error of the position over the arm's length, and change of a tension over the largest, where it has ended.
const POSITION: f64 = 4e-7;
const TENSION: f64 = 1e-7 / 220.0;
const ITERATIONS_MAX: usize = 400;

/// Finds tensions and state from the guess in `state`, which chooses among the arm's branches. Allocates.
///
/// Each iteration takes the static equations' affine map at the iterate and the box-constrained tensions that are
/// least under it with the tip at the pose; steps are shortened so that no quaternion jumps.
///
/// # Errors
/// [`StartError`].
pub fn tip_start(
    arm: &Arm,
    position: Vector3<f64>,
    quaternion: Vector4<f64>,
    lower: &[f64],
    upper: &[f64],
    state: &mut State,
) -> Result<Vec<f64>, StartError> {
    let nc = arm.cable_count();
    let mut stepper = Stepper::new(arm);
    let mut map = AffineMap::new(arm);
    let mut quadratic = Quadratic::new(arm);
    let mut solver = Solver::new(nc, 0);
    let mut dx = vec![0.0; BLOCK * arm.node_count()];
    let mut u = lower.to_vec();
    let mut wanted = u.clone();
    let still = vec![0.0; nc];
    let length: f64 = arm.elements.iter().map(|e| e.length + e.connector).sum();
    let largest_n = upper.iter().copied().fold(0.0, f64::max);
    // The quaternion's rows weigh as much as the position's, in units of the length; both in units of the tensions.
    let pose = POSE_WEIGHT * (largest_n / length).powi(2);
    let goal = Goal::Tip { position, quaternion, pose, rate: 0.0, damping: 0.0 };
    let mut iterations = 0;
    loop {
        iterations += 1;
        let linear = stepper.linearize(arm, &Motion::from(&*state), &u, Rates::STATIC);
        let distance = (arm.tip(&state.q, &state.qd).position - position).norm();
        if linear.is_err() || iterations > ITERATIONS_MAX || !distance.is_finite() {
            return Err(StartError::PoseNotReached { distance, iterations });
        }
        stepper.affine_map_into(arm, &mut map);
        quadratic.build(arm, state, Rates::STATIC, &map, &goal, 1.0, &still, &still);
        let problem = Problem { a: &quadratic.a, b: &quadratic.b, lower, upper, c: &[], d: &[], price: &[] };
        wanted.copy_from_slice(&u);
        solver.solve(&problem, &mut wanted, &mut || false);
        dx.copy_from_slice(stepper.correction_for(arm, &wanted));
        let largest =
            (0..arm.node_count()).flat_map(|i| &dx[BLOCK * i..BLOCK * i + 7]).fold(0.0f64, |a, x| a.max(x.abs()));
        let change = u.iter().zip(&wanted).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
        let share = (0.05 / largest).min(1.0);
        dx.iter_mut().for_each(|x| *x *= share);
        u.iter_mut().zip(&wanted).for_each(|(u, w)| *u += share * (w - *u));
        stepper.apply(&dx, Rates::STATIC, state);
        if share == 1.0 && largest < 1e-10 && change < TENSION * largest_n {
            break;
        }
    }
    equilibrium(arm, &mut stepper, &u, state)?;
    let distance = (arm.tip(&state.q, &state.qd).position - position).norm();
    if distance > POSITION * length {
        return Err(StartError::PoseNotReached { distance, iterations });
    }
    Ok(u)
}
