//! How strongly an arm's outputs answer its cables: what weights on changes of tensions are measured in.

use super::problem::{Goal, Quadratic};
use crate::config::PlannerConfig;
use crate::integrator::{AffineMap, Stepper};
use crate::math::chain::Singular;
use crate::model::{Arm, Motion, State};

/// Diagonal of `S_y^T Q S_y` (1/N^2, in the units of Q), its mean over the cables of each segment: S_y is what the outputs of
/// the straight arm at rest answer a tension with at the end of the lookahead. Allocates.
///
/// # Errors
/// The tangent is singular: something has no mass.
pub fn sensitivity(arm: &Arm, config: &PlannerConfig, rho_inf: f64, goal: &Goal<'_>) -> Result<Vec<f64>, Singular> {
    let scheme = super::prediction(config, rho_inf);
    let rates = scheme.rates(config.lookahead_s);
    let state = State::at_rest(arm.straight());
    let cables = arm.cable_count();
    let none = vec![0.0; cables];
    let mut stepper = Stepper::new(arm);
    stepper.linearize(arm, &Motion::from(&state), &none, rates)?;
    let mut map = AffineMap::new(arm);
    stepper.affine_map_into(arm, &mut map);
    let mut quadratic = Quadratic::new(arm);
    quadratic.build(arm, &state, rates, &map, goal, 0.0, &none, &none);
    let mut sums = vec![(0.0, 0usize); arm.segment_count()];
    for cable in 0..cables {
        let (sum, count) = &mut sums[arm.cable_segment[cable]];
        *sum += quadratic.a[cable * cables + cable];
        *count += 1;
    }
    Ok(sums.into_iter().map(|(sum, count)| sum / count.max(1) as f64).collect())
}
