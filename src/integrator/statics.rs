//! Static equilibrium for given tensions, and a consistent start of a motion.

use super::step::{StepError, Stepper};
use crate::math::block_tridiagonal::BLOCK;
use crate::model::{Arm, Motion, Rates, State};

/// Why no equilibrium was found.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum StaticsError {
    /// Newton failed even for load steps of 1/1024.
    #[error("no equilibrium was reached: continuation stopped at {share:.4} of the load")]
    NotReached {
        /// Share of the load up to which equilibria were found.
        share: f64,
    },
}

/// Most Newton iterations of one load step.
const ITERATIONS_MAX: usize = 40;

/// Static equilibrium under tensions `u` (N), from the guess in `state`; rates and accelerations are set to zero.
///
/// Newton with step halving on the full load; where that fails, the load is applied in steps (natural continuation
/// from the guess's own load-free neighbour). Returns the number of Newton iterations. Allocates.
///
/// Only the tensions are applied in steps: gravity acts in full from the start. What is found is an equilibrium near the
/// path from the guess, stable or not: a straight arm under even tensions beyond its buckling load stays straight. Give
/// a bent guess where that matters.
///
/// # Errors
/// [`StaticsError::NotReached`]; `state` then holds the last equilibrium on the way, or the guess where there is none.
pub fn equilibrium(arm: &Arm, stepper: &mut Stepper, u: &[f64], state: &mut State) -> Result<usize, StaticsError> {
    state.qd.fill(0.0);
    state.qdd.fill(0.0);
    state.a.fill(0.0);
    let guess = state.clone();
    if let Ok(n) = newton(arm, stepper, u, state) {
        return Ok(n);
    }
    state.copy_from(&guess);
    let (mut share, mut increment, mut total) = (0.0f64, 0.25f64, 0);
    let mut load = u.to_vec();
    let mut reached = guess;
    while share < 1.0 {
        let target = (share + increment).min(1.0);
        load.iter_mut().zip(u).for_each(|(l, u)| *l = target * u);
        match newton(arm, stepper, &load, state) {
            Ok(n) => {
                total += n;
                share = target;
                increment *= 1.5;
                reached.copy_from(state);
            }
            Err(_) => {
                state.copy_from(&reached);
                increment *= 0.5;
                if increment < 1.0 / 1024.0 {
                    return Err(StaticsError::NotReached { share });
                }
            }
        }
    }
    Ok(total)
}

/// Newton on the static equations; halves the step while the iteration does not contract.
///
/// A trial is judged by the correction that the present tangent would make next (the natural level function, Deuflhard
/// 2004, 3.3), not by the residual: the residual grows with the chords' stiffness, and on a fine mesh it lets only tiny
/// steps pass, although the iterates come nearer with each whole one.
fn newton(arm: &Arm, stepper: &mut Stepper, u: &[f64], state: &mut State) -> Result<usize, StepError> {
    let mut trial = state.clone();
    let n = arm.node_count();
    let (mut upper, mut lower) = (vec![0.0; 7 * n], vec![0.0; 4 * n]);
    let (mut dx, mut scaled) = (vec![0.0; BLOCK * n], vec![0.0; BLOCK * n]);
    let norm = |x: &[f64]| (0..n).flat_map(|i| &x[BLOCK * i..BLOCK * i + 7]).map(|x| x * x).sum::<f64>().sqrt();
    for iteration in 1..=ITERATIONS_MAX {
        stepper.linearize(arm, &Motion::from(&*state), u, Rates::STATIC)?;
        let scale = stepper.linearization.scale;
        dx.copy_from_slice(stepper.correction());
        let full = norm(&dx);
        if !full.is_finite() {
            return Err(StepError::Diverged);
        }
        let mut share = 1.0;
        loop {
            trial.copy_from(state);
            scaled.iter_mut().zip(&dx).for_each(|(s, x)| *s = share * x);
            stepper.apply(&scaled, Rates::STATIC, &mut trial);
            // A quaternion must not jump past its neighbour: half a unit of change at most.
            let jump = (0..n).flat_map(|i| &scaled[BLOCK * i + 3..BLOCK * i + 7]).fold(0.0f64, |a, x| a.max(x.abs()));
            if share * full < 1e-10 {
                break;
            }
            if jump < 0.5 {
                arm.residual_into(&Motion::from(&trial), u, &mut upper, &mut lower);
                right_side_into(&upper, &lower, -scale, &mut scaled);
                stepper.factor.solve_in_place(&mut scaled);
                if norm(&scaled) <= (1.0 - 0.5 * share) * full {
                    break;
                }
            }
            share *= 0.5;
            if share < 1e-4 {
                return Err(StepError::Diverged);
            }
        }
        state.copy_from(&trial);
        if share == 1.0 && full < 1e-10 {
            return Ok(iteration);
        }
    }
    Err(StepError::Diverged)
}

/// The right side of a system in node order: minus the upper rows, `factor` times the lower ones.
fn right_side_into(upper: &[f64], lower: &[f64], factor: f64, out: &mut [f64]) {
    for ((block, upper), lower) in out.chunks_exact_mut(BLOCK).zip(upper.chunks_exact(7)).zip(lower.chunks_exact(4)) {
        block[..7].iter_mut().zip(upper).for_each(|(x, f)| *x = -f);
        block[7..].iter_mut().zip(lower).for_each(|(x, psi)| *x = factor * psi);
    }
}

/// Accelerations and multipliers that belong to `state.q`, `state.qd` under tensions `u`: the solution of
/// `[M, psi_q^T; psi_q, 0] [q''; lambda] = [G u - V q' - dE/dq; -(d^2 psi)(q', q')]`. Sets `a = q''`. Coordinates and
/// rates must satisfy the constraints and their derivative already. Allocates.
///
/// # Errors
/// The matrix is singular.
pub fn consistent_start(arm: &Arm, stepper: &mut Stepper, u: &[f64], state: &mut State) -> Result<(), StepError> {
    let n = arm.node_count();
    let (mut upper, mut lower) = (vec![0.0; 7 * n], vec![0.0; 4 * n]);
    state.qdd.fill(0.0);
    state.lambda.fill(0.0);
    arm.residual_into(&Motion::from(&*state), u, &mut upper, &mut lower);
    arm.constraint_acceleration_into(&state.q, &state.qd, &mut lower);
    let scale = arm.nodes.iter().map(|m| m.mass).fold(0.0, f64::max);
    arm.mass_into(&state.q, scale, &mut stepper.linearization.tangent);
    stepper.factor.factor(&stepper.linearization.tangent)?;
    let mut x = vec![0.0; BLOCK * n];
    right_side_into(&upper, &lower, scale, &mut x);
    stepper.factor.solve_in_place(&mut x);
    for i in 0..n {
        state.qdd[7 * i..7 * i + 7].copy_from_slice(&x[BLOCK * i..BLOCK * i + 7]);
        for c in 0..4 {
            state.lambda[4 * i + c] = scale * x[BLOCK * i + 7 + c];
        }
    }
    state.a.copy_from_slice(&state.qdd);
    Ok(())
}
