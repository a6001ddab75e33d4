//! The true arm: the model's equations, with properties that may differ from the model's.

use super::StabilityError;
use crate::config::{ArmConfig, Scale};
use crate::estimator::Kept;
use crate::integrator::{Scheme, Stepper, equilibrium};
use crate::model::{Arm, State};
use std::collections::VecDeque;

/// How the true arm differs from the controller's model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Differs {
    /// Damping over the model's.
    pub damping: f64,
    /// Stiffness over the model's.
    pub stiffness: f64,
    /// Tension at the cable over the commanded one.
    pub pull: f64,
    /// Ticks by which tensions come later than the controller knows.
    pub late_ticks: usize,
}

impl Differs {
    /// In nothing.
    pub const NONE: Self = Self { damping: 1.0, stiffness: 1.0, pull: 1.0, late_ticks: 0 };

    /// Between two, at a share of the way from `self`.
    pub(super) fn towards(&self, to: &Self, share: f64) -> Self {
        let between = |a: f64, b: f64| a * (b / a).powf(share);
        Self {
            damping: between(self.damping, to.damping),
            stiffness: between(self.stiffness, to.stiffness),
            pull: between(self.pull, to.pull),
            late_ticks: to.late_ticks,
        }
    }
}

/// Largest step (s), and least number of steps in the first period.
const STEP_S_MAX: f64 = 0.005;
const STEPS_OF_PERIOD: f64 = 200.0;
/// Numerical damping at high frequency: an arm that hardly damps is integrated without growth.
const RHO_INF: f64 = 0.5;
const ITERATIONS_MAX: usize = 12;

/// The true arm.
#[derive(Debug, Clone)]
pub struct Plant {
    /// The model's own properties, and these.
    model: Arm,
    arm: Arm,
    differs: Differs,
    latency_ticks: usize,
    scheme: Scheme,
    stepper: Stepper,
    state: State,
    next: State,
    /// Tensions on their way, oldest first (N).
    coming: VecDeque<Vec<f64>>,
    acting: Vec<f64>,
    lengths: Vec<f64>,
    steps: usize,
    step_s: f64,
}

impl Plant {
    /// Straight, without tensions; commands act `latency_ticks` late, as the controller knows. Allocates.
    pub fn new(config: &ArmConfig, period_s: f64, latency_ticks: usize) -> Self {
        let model = Arm::new(config);
        let cables = model.cable_count();
        let most_s = (std::f64::consts::TAU / Scale::of(config).omega_radps / STEPS_OF_PERIOD).min(STEP_S_MAX);
        let steps = (period_s / most_s - 1e-9).ceil().max(1.0);
        let state = State::at_rest(model.straight());
        let mut lengths = vec![0.0; cables];
        model.cable_lengths_into(&state.q, &mut lengths);
        Self {
            arm: model.clone(),
            differs: Differs::NONE,
            latency_ticks,
            scheme: Scheme::new(RHO_INF),
            stepper: Stepper::new(&model),
            next: state.clone(),
            state,
            coming: vec![vec![0.0; cables]; latency_ticks].into(),
            acting: vec![0.0; cables],
            lengths,
            steps: steps as usize,
            step_s: period_s / steps,
            model,
        }
    }

    /// Makes it differ otherwise from now on; its state stays.
    pub fn differ(&mut self, differs: &Differs) {
        self.arm = self.model.clone();
        for element in &mut self.arm.elements {
            element.damping *= differs.damping;
            element.stiffness *= differs.stiffness;
        }
        let late = self.latency_ticks + differs.late_ticks;
        while self.coming.len() > late {
            self.coming.pop_front();
        }
        while self.coming.len() < late {
            let newest = self.coming.back().unwrap_or(&self.acting).clone();
            self.coming.push_back(newest);
        }
        self.differs = *differs;
    }

    /// How it differs.
    pub const fn differs(&self) -> &Differs {
        &self.differs
    }

    /// Cable lengths (m).
    pub fn lengths(&self) -> &[f64] {
        &self.lengths
    }

    /// State.
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// Its model.
    pub const fn arm(&self) -> &Arm {
        &self.arm
    }

    /// A tick of motion after `commanded` (N) was sent.
    pub(super) fn step(&mut self, commanded: &[f64]) -> Result<(), StabilityError> {
        self.take(commanded);
        for _ in 0..self.steps {
            let report = self
                .stepper
                .step(&self.arm, &self.scheme, self.step_s, &self.state, &self.acting, ITERATIONS_MAX, &mut self.next)
                .map_err(|error| StabilityError::NoMap(error.to_string()))?;
            if !report.converged && report.correction > 1e-6 {
                return Err(StabilityError::NoMap("the true arm's step does not converge".to_owned()));
            }
            std::mem::swap(&mut self.state, &mut self.next);
        }
        self.measure();
        Ok(())
    }

    /// A tick of an arm without mass: the equilibrium under `commanded` (N), which acts at once.
    pub(super) fn rest(&mut self, commanded: &[f64]) -> Result<(), StabilityError> {
        self.coming.iter_mut().for_each(|u| u.copy_from_slice(commanded));
        self.take(commanded);
        equilibrium(&self.arm, &mut self.stepper, &self.acting, &mut self.state)
            .map_err(|error| StabilityError::NoRest(error.to_string()))?;
        self.measure();
        Ok(())
    }

    /// The equilibrium under `commanded` (N) that is nearest to the coordinates `q` (7N).
    pub(super) fn rest_near(&mut self, commanded: &[f64], q: &[f64]) -> Result<(), StabilityError> {
        self.state.q.copy_from_slice(q);
        self.state.lambda.fill(0.0);
        self.rest(commanded)
    }

    fn take(&mut self, commanded: &[f64]) {
        let pull = self.differs.pull;
        self.coming.push_back(commanded.to_vec());
        if let Some(oldest) = self.coming.pop_front() {
            self.acting.iter_mut().zip(&oldest).for_each(|(acting, u)| *acting = pull * u);
        }
    }

    fn measure(&mut self) {
        self.arm.cable_lengths_into(&self.state.q, &mut self.lengths);
    }

    /// Visits every number that its next tick depends on beside what it is given.
    pub(super) fn memory(&mut self, visit: &mut dyn FnMut(Kept, &mut [f64])) {
        visit(Kept::Coordinates, &mut self.state.q);
        visit(Kept::Rates, &mut self.state.qd);
        visit(Kept::Accelerations, &mut self.state.qdd);
        visit(Kept::Accelerations, &mut self.state.a);
        self.coming.iter_mut().for_each(|u| visit(Kept::Tensions, u));
        // What encoders show belongs to the coordinates, which were just written.
        self.measure();
    }
}
