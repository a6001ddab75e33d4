//! Capstan friction made up for: what the drums must pull so that the arm feels what was planned.
//!
//! A cable's tension falls by `exp(-mu angle)` over the bend that it has passed where it is pulled in, and rises by as
//! much where it pays out. The tension that planner, observer and governor think of is the mean of it over the elements of a
//! cable's route; their models have at each passage the share of that mean which is left there, for a moment that changes along a
//! segment bends it unevenly. The command is the planned tension divided by the mean. The angle is the estimate's.
//! The direction is that of the *planned* cable rate, a smoothed sign that follows with a lag: taken from the measured
//! rate it would be positive feedback, a push along whatever the arm does.

use crate::config::FrictionConfig;
use crate::model::{Arm, State};

/// The compensation of one arm. Nothing but [`FrictionCompensation::new`] allocates.
#[derive(Debug, Clone)]
pub struct FrictionCompensation {
    coefficient: f64,
    speed_mps: f64,
    follows: f64,
    rate: Vec<f64>,
    /// Smoothed direction per cable: 1 pulled in, -1 paying out.
    direction: Vec<f64>,
    /// Bend of each element (rad).
    bend: Vec<f64>,
    factor: Vec<f64>,
    /// Passages of each cable in the arm's list, from the base on, with their elements.
    route: Vec<Vec<(usize, usize)>>,
    /// Tension at each passage over the mean along its cable.
    share: Vec<f64>,
}

impl FrictionCompensation {
    /// At rest. `period_s` is the time between two updates. Allocates.
    pub fn new(config: &FrictionConfig, arm: &Arm, period_s: f64) -> Self {
        let cables = arm.cable_count();
        Self {
            coefficient: config.coefficient,
            speed_mps: config.speed_mps,
            follows: period_s / (period_s + config.time_s),
            rate: vec![0.0; cables],
            direction: vec![0.0; cables],
            bend: vec![0.0; arm.elements.len()],
            factor: vec![1.0; cables],
            route: (0..cables).map(|cable| arm.passes_of(cable).collect()).collect(),
            share: vec![1.0; arm.passes.len()],
        }
    }

    /// Whether there is anything to make up for.
    pub fn is_active(&self) -> bool {
        self.coefficient > 0.0
    }

    /// No motion is planned: every factor is exactly 1.
    pub fn rest(&mut self) {
        self.direction.fill(0.0);
        self.factor.fill(1.0);
        self.share.fill(1.0);
    }

    /// Takes over where the arm is and how it is planned to move.
    pub fn update(&mut self, arm: &Arm, estimate: &State, planned: &State) {
        if !self.is_active() {
            return;
        }
        arm.cable_rates_into(&planned.q, &planned.qd, &mut self.rate);
        for (i, (bend, element)) in self.bend.iter_mut().zip(&arm.elements).enumerate() {
            let kappa = arm.element_curvature(&estimate.q, &estimate.qd, i).0;
            *bend = kappa[1].hypot(kappa[2]) * element.length;
        }
        for (cable, route) in self.route.iter().enumerate() {
            let wanted = (-self.rate[cable] / self.speed_mps).tanh();
            // A rate that is not a number has no direction.
            let wanted = if wanted.is_finite() { wanted } else { 0.0 };
            self.direction[cable] += self.follows * (wanted - self.direction[cable]);
            let exponent = -self.coefficient * self.direction[cable];
            let (mut passed, mut sum) = (0.0, 0.0);
            for &(pass, element) in route {
                // Half-way through an element half its bend is passed.
                let left = (exponent * (passed + 0.5 * self.bend[element])).exp();
                self.share[pass] = left;
                sum += left;
                passed += self.bend[element];
            }
            let mean = sum / route.len() as f64;
            let sound = mean.is_finite() && mean > 0.0;
            self.factor[cable] = if sound { mean } else { 1.0 };
            for &(pass, _) in route {
                self.share[pass] = if sound { self.share[pass] / mean } else { 1.0 };
            }
        }
    }

    /// Smoothed direction of each cable, -1 to 1: what the next update depends on.
    pub fn memory(&mut self) -> &mut [f64] {
        &mut self.direction
    }

    /// Tension at each passage of a cable over the mean along its route, in the order of [`Arm::passes`].
    pub fn shares(&self) -> &[f64] {
        &self.share
    }

    /// What acts along each cable's route over what its drum pulls.
    pub fn factors(&self) -> &[f64] {
        &self.factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ArmConfig;

    const MU: f64 = 0.1;

    fn bent(rate: f64) -> (Arm, State) {
        let arm = Arm::new(&ArmConfig::paper());
        let curvatures = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut state = State::at_rest(arm.bent(&curvatures));
        let h = 1e-6;
        let more = arm.bent(&curvatures.map(|k| k * (1.0 + h)));
        state.qd = more.iter().zip(&state.q).map(|(a, b)| rate * (a - b) / h).collect();
        (arm, state)
    }

    fn settled(config: &FrictionConfig, arm: &Arm, state: &State) -> Vec<f64> {
        let mut compensation = FrictionCompensation::new(config, arm, 0.01);
        (0..200).for_each(|_| compensation.update(arm, state, state));
        compensation.factors().to_vec()
    }

    #[test]
    fn a_cable_pulled_over_a_bend_loses_what_the_capstan_takes_on_average() {
        // Segment 1 bends by 0.65 rad; a cable's elements have passed 0.065, 0.195, ... of it at their middles.
        let config = FrictionConfig { coefficient: MU, speed_mps: 1e-6, time_s: 0.01 };
        let (arm, state) = bent(1.0);
        let factors = settled(&config, &arm, &state);
        let mean =
            |sign: f64| (0..5).map(|i| (-sign * MU * 0.65 * (f64::from(i) + 0.5) / 5.0).exp()).sum::<f64>() / 5.0;
        let mut rates = vec![0.0; 24];
        arm.cable_rates_into(&state.q, &state.qd, &mut rates);
        for cable in 0..6 {
            let wanted = mean(-rates[cable].signum());
            assert!((factors[cable] - wanted).abs() < 1e-3, "cable {cable}: {} for {wanted}", factors[cable]);
        }
        assert!(factors[..6].iter().any(|f| *f < 0.97) && factors[..6].iter().any(|f| *f > 1.03));
        // Each passage has its share of the mean: most at the base of a cable that is pulled in, least of one that pays out.
        let mut compensation = FrictionCompensation::new(&config, &arm, 0.01);
        (0..200).for_each(|_| compensation.update(&arm, &state, &state));
        for cable in 0..6 {
            let along: Vec<f64> = arm.passes_of(cable).map(|(pass, _)| compensation.shares()[pass]).collect();
            let ratio = (-(-rates[cable].signum()) * MU * 0.65 / 5.0).exp();
            assert_eq!(along.len(), 5);
            assert!((along.iter().sum::<f64>() / 5.0 - 1.0).abs() < 1e-12, "{along:?}");
            assert!(along.windows(2).all(|pair| (pair[1] / pair[0] - ratio).abs() < 1e-3), "{cable}: {along:?}");
        }
        // What is straight has no friction.
        assert!(factors[6..].iter().all(|f| (f - 1.0).abs() < 1e-9), "{factors:?}");
    }

    #[test]
    fn without_motion_or_without_coefficient_nothing_is_added() {
        let config = FrictionConfig { coefficient: MU, speed_mps: 1e-3, time_s: 0.05 };
        let (arm, state) = bent(0.0);
        assert!(settled(&config, &arm, &state).iter().all(|f| *f == 1.0));
        let (arm, state) = bent(1.0);
        assert!(settled(&FrictionConfig::NONE, &arm, &state).iter().all(|f| *f == 1.0));
        let mut compensation = FrictionCompensation::new(&config, &arm, 0.01);
        compensation.update(&arm, &state, &state);
        assert!(compensation.factors().iter().any(|f| *f != 1.0));
        assert!(compensation.shares().iter().any(|share| *share != 1.0));
        compensation.rest();
        assert!(compensation.factors().iter().chain(compensation.shares()).all(|f| *f == 1.0));
    }

    #[test]
    fn a_reversal_is_followed_with_its_lag_and_a_broken_plan_changes_nothing() {
        let config = FrictionConfig { coefficient: MU, speed_mps: 1e-6, time_s: 0.09 };
        let (arm, state) = bent(1.0);
        let mut compensation = FrictionCompensation::new(&config, &arm, 0.01);
        compensation.update(&arm, &state, &state);
        // 0.01/(0.01 + 0.09) of the way.
        assert!((compensation.direction[0].abs() - 0.1).abs() < 1e-9, "{}", compensation.direction[0]);
        let broken = State { qd: vec![f64::NAN; state.qd.len()], ..state.clone() };
        compensation.update(&arm, &state, &broken);
        assert!(compensation.factors().iter().all(|f| f.is_finite() && *f > 0.9 && *f < 1.1));
    }
}
