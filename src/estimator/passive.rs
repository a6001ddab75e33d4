//! The passive observer (design section 6): the model with a spring and a Maxwell damper in cable space.
//!
//! `z = T^T (l_model - l_measured)`, `w = K z + D (z - y)/tau_f`, `tau_f y' = z - y`, `beta' = w/T_b`. The model feels
//! `u + T (beta + w)`; `T beta` is the disturbance that the planner predicts with, and through a latency `w` fades out.
//! The correction is implicit: with `D_e = D/(tau_f + h)` and `w = (K + D_e) z_k - D_e y_{k-1}` it adds
//! `(G T)(K + D_e)(G T)^T` to the tangent, which an 8x8 Woodbury correction of the block-tridiagonal factor solves. An
//! explicit one diverges within 0.03 s: the spring would be stiffer than the light end disks allow.

use super::cable_space::CableSpace;
use super::health::Health;
use super::memory::Kept;
use crate::config::{ArmConfig, ObserverConfig};
use crate::integrator::{Scheme, Stepper};
use crate::math::block_tridiagonal::{BLOCK, COORDINATES};
use crate::math::dense;
use crate::model::{Arm, Motion, State};

/// Stop of the iteration: the next correction of the coordinates would have a norm below this (m, 1). A thousandth of an
/// encoder step moves the tip by more.
const TOLERANCE: f64 = 1e-8;
/// Newton iterations of one observer step; two are usual.
const ITERATIONS_MAX: usize = 8;
/// Newton iterations of one model step of the latency compensation.
const PREDICTION_ITERATIONS_MAX: usize = 6;
/// Time constant (s) with which the correction `w` fades from the prediction through the latency. The planner carries the
/// acceleration it starts from over its whole lookahead. Left out at once, `w` is a step of force, and one or two
/// milliseconds later the light end disks are still answering it: the closed loop diverges (1.3 m at 1 ms, one tick).
/// Kept for good, it is an open-loop force on an error that the observer takes away: diverges from 150 ms on. With 10 to
/// 50 ms every latency from 1 to 200 ms is stable (`sim_plant/tests/closed_loop.rs`).
const CORRECTION_FADES_S: f64 = 0.05;

/// What one tick brought. Data, not faults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Update {
    /// Largest |z| (rad).
    pub innovation_max: f64,
    /// Its growth within the configured window (rad).
    pub innovation_growth: f64,
    /// `innovation_max` is beyond the configured bound, or not a number.
    pub beyond_bound: bool,
    /// `innovation_growth` is beyond the configured limit, or not a number.
    pub growing: bool,
    /// |z| and bend rates have been below their limits for the configured time.
    pub settled: bool,
    /// Largest bend rate of the estimate (rad/s).
    pub rate_max: f64,
    /// Cables without a usable length.
    pub missing: usize,
    /// Newton iterations.
    pub iterations: usize,
    /// The step could not be computed: the estimate is that of the tick before.
    pub failed: bool,
}

/// The observer of one arm. [`Observer::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Observer {
    pub(super) arm: Arm,
    scheme: Scheme,
    period: f64,
    pub(super) stepper: Stepper,
    pub(super) space: CableSpace,
    /// All cables, for the disturbance: its meaning must not jump when a measurement drops out.
    full: CableSpace,
    /// K per bend angle (N m/rad).
    stiffness: Vec<f64>,
    /// D per bend angle (N m s/rad).
    damping: Vec<f64>,
    filter_time: f64,
    disturbance_time: f64,
    pub(super) state: State,
    next: State,
    predicted: State,
    y: Vec<f64>,
    pub(super) beta: Vec<f64>,
    disturbance: Vec<f64>,
    /// Tensions sent and not yet in the estimate: the oldest acted in the tick that ends now.
    pub(super) sent: Vec<Vec<f64>>,
    /// Mean of those that acted over the present step.
    acting: Vec<f64>,
    health: Health,
    pub(super) length: Vec<f64>,
    pub(super) z: Vec<f64>,
    pub(super) w: Vec<f64>,
    /// What is left of `w` on the way through the latency.
    fading: Vec<f64>,
    pub(super) effective: Vec<f64>,
    /// `V = B T`, row-major 11N x angles, and `S^-1 V`.
    pub(super) v: Vec<f64>,
    pub(super) sv: Vec<f64>,
    /// The panel of moments is dense: every column counts in every node.
    dense: Vec<usize>,
    pub(super) small_a: Vec<f64>,
    pub(super) small_b: Vec<f64>,
    pub(super) dx: Vec<f64>,
    pub(super) curvatures: [Vec<f64>; 2],
    /// Coordinates as they were before a look.
    pub(super) kept: Vec<f64>,
}

impl Observer {
    /// Builds all buffers; `period_s` is the time between two updates. Allocates.
    pub fn new(arm_config: &ArmConfig, config: &ObserverConfig, period_s: f64) -> Self {
        let mut arm = Arm::new(arm_config);
        for element in &mut arm.elements {
            element.damping *= config.model_damping_ratio;
        }
        let (n, nc, angles) = (arm.node_count(), arm.cable_count(), 2 * arm.segment_count());
        let space = CableSpace::new(&arm);
        let stiffness: Vec<f64> = arm_config
            .segments
            .iter()
            .flat_map(|s| [config.stiffness_ratio * s.bending_stiffness_nm2 / s.length_m; 2])
            .collect();
        let damping = stiffness.iter().map(|k| k * config.damping_s).collect();
        let straight = State::at_rest(arm.straight());
        Self {
            scheme: Scheme::new(config.rho_inf),
            period: period_s,
            stepper: Stepper::new(&arm),
            full: space.clone(),
            space,
            stiffness,
            damping,
            filter_time: config.filter_time_s,
            disturbance_time: config.disturbance_time_s,
            next: straight.clone(),
            predicted: straight.clone(),
            state: straight,
            y: vec![0.0; angles],
            beta: vec![0.0; angles],
            disturbance: vec![0.0; nc],
            sent: vec![vec![0.0; nc]; config.latency_ticks + 1],
            acting: vec![0.0; nc],
            health: Health::new(config, period_s),
            length: vec![0.0; nc],
            z: vec![0.0; angles],
            w: vec![0.0; angles],
            fading: vec![0.0; angles],
            effective: vec![0.0; nc],
            v: vec![0.0; COORDINATES * n * angles],
            sv: vec![0.0; COORDINATES * n * angles],
            dense: vec![0; n],
            small_a: vec![0.0; angles * angles],
            small_b: vec![0.0; angles],
            dx: vec![0.0; BLOCK * n],
            curvatures: [vec![0.0; angles], vec![0.0; angles]],
            kept: vec![0.0; 7 * arm.node_count()],
            arm,
        }
    }

    /// The estimate at the time of the newest measurement.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The estimate at the time when tensions computed now begin to act: [`Observer::state`] and the model's steps
    /// through the latency with the tensions already sent. This is what to plan from.
    pub fn predicted(&self) -> &State {
        if self.sent.len() > 1 { &self.predicted } else { &self.state }
    }

    /// Time from [`Observer::state`] to [`Observer::predicted`] (s).
    pub fn prediction_s(&self) -> f64 {
        (self.sent.len() - 1) as f64 * self.period
    }

    /// `T beta` (N, one per cable): the tensions that act beside those sent, for the planner to predict with.
    pub fn disturbance(&self) -> &[f64] {
        &self.disturbance
    }

    /// `beta` (N m): the disturbance as bending moments, two per segment.
    pub fn disturbance_moments(&self) -> &[f64] {
        &self.beta
    }

    /// `w` (N m): the observer's correction, two moments per segment. With [`Observer::disturbance_moments`] it is what acts on
    /// the arm beside the tensions that were sent.
    pub fn correction_moments(&self) -> &[f64] {
        &self.w
    }

    /// `z` (rad): the bend angles by which model and measurement differ, two per segment; 0 where not observable.
    pub fn innovation(&self) -> &[f64] {
        &self.z
    }

    /// Takes over what friction leaves of the tensions at each passage, see [`Arm::take_shares`].
    pub fn take_shares(&mut self, shares: &[f64]) {
        self.arm.take_shares(shares);
    }

    /// Continues from a state known otherwise, without disturbance and memory. Does not allocate.
    pub fn resume(&mut self, state: &State) {
        self.reset();
        self.state.copy_from(state);
        self.settle_prediction();
    }

    /// Visits every number that the next update depends on beside what it is given.
    pub fn memory(&mut self, visit: &mut dyn FnMut(Kept, &mut [f64])) {
        visit(Kept::Coordinates, &mut self.state.q);
        visit(Kept::Rates, &mut self.state.qd);
        visit(Kept::Accelerations, &mut self.state.qdd);
        visit(Kept::Accelerations, &mut self.state.a);
        visit(Kept::Angles, &mut self.y);
        visit(Kept::Moments, &mut self.beta);
        // The oldest has acted already.
        self.sent[1..].iter_mut().for_each(|sent| visit(Kept::Tensions, sent));
    }

    /// The observer's model: the configured arm with the observer's damping.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// One tick: `u_sent` (N) are the tensions sent in the tick before, `lengths` (m) the newest measurement; one that is
    /// not finite does not count.
    ///
    /// With a latency of n ticks the tensions that acted meanwhile are those sent n ticks earlier; the observer keeps
    /// them. Does not allocate.
    ///
    /// # Panics
    /// If the slices are not one number per cable.
    pub fn update(&mut self, u_sent: &[f64], lengths: &[f64]) -> Update {
        self.update_over(u_sent, lengths, 1)
    }

    /// The same after ticks left out: `lengths` were measured `periods` periods (at least one) after those before, and
    /// `u_sent` acted since. One implicit step of that length, up to a planner's lookahead: it takes as long as any, and what
    /// acted meanwhile enters by its mean.
    ///
    /// # Panics
    /// As [`Observer::update`].
    pub fn update_over(&mut self, u_sent: &[f64], lengths: &[f64], periods: u32) -> Update {
        assert_eq!(lengths.len(), self.arm.cable_count(), "one length per cable");
        let periods = periods.max(1);
        self.take_sent(u_sent, periods);
        self.space.select(|c| lengths[c].is_finite());
        let missing = (0..lengths.len()).filter(|c| !self.space.is_valid(*c)).count();
        let stepped = self.step(lengths, f64::from(periods) * self.period);
        let mut innovation = self.z.iter().fold(0.0, |a: f64, z| if z.is_nan() { f64::NAN } else { a.max(z.abs()) });
        if stepped.is_none() {
            innovation = f64::NAN;
        }
        self.settle_prediction();
        let rate = self.bend_rate();
        self.health.skip(periods - 1);
        let checked = self.health.check(innovation, rate);
        Update {
            innovation_max: innovation,
            innovation_growth: checked.growth,
            beyond_bound: checked.beyond_bound,
            growing: checked.growing,
            settled: checked.settled,
            rate_max: rate,
            missing,
            iterations: stepped.unwrap_or(0),
            failed: stepped.is_none(),
        }
    }

    pub(super) fn reset(&mut self) {
        self.y.fill(0.0);
        self.beta.fill(0.0);
        self.z.fill(0.0);
        self.w.fill(0.0);
        self.health.reset();
    }

    /// Moves the queue of tensions on; those that acted over the step end up in `acting`.
    fn take_sent(&mut self, u_sent: &[f64], periods: u32) {
        self.acting.fill(0.0);
        // From then on the queue holds nothing else.
        let moved = periods.min(self.sent.len() as u32);
        for _ in 0..moved {
            self.sent.rotate_left(1);
            if let Some(newest) = self.sent.last_mut() {
                newest.copy_from_slice(u_sent);
            }
            self.acting.iter_mut().zip(&self.sent[0]).for_each(|(acting, u)| *acting += u);
        }
        let rest = f64::from(periods - moved);
        for (acting, u) in self.acting.iter_mut().zip(u_sent) {
            *acting = (*acting + rest * u) / f64::from(periods);
        }
    }

    /// The implicit step of `h` seconds; `None` and the old estimate where it fails.
    fn step(&mut self, lengths: &[f64], h: f64) -> Option<usize> {
        let n = self.space.angle_count();
        let rates = self.scheme.rates(h);
        self.scheme.predict(h, &self.state, &mut self.next);
        let mut iterations = 0;
        let mut last = f64::INFINITY;
        loop {
            self.correct(lengths, h);
            self.effective.copy_from_slice(&self.acting);
            self.full.add_tensions(&self.beta, &mut self.effective);
            self.space.add_tensions(&self.w, &mut self.effective);
            self.stepper.linearize(&self.arm, &Motion::from(&self.next), &self.effective, rates).ok()?;
            self.moment_panel();
            // (S + V C V^T) dx = r: dx = s - S^-1 V m, m = (C^-1 + V^T S^-1 V)^-1 V^T s, s = S^-1 r. As V = B T, that is
            // the correction for tensions less by T m.
            let s = self.stepper.correction();
            self.small_a.fill(0.0);
            self.small_b.fill(0.0);
            for (r, x) in s.chunks_exact(BLOCK).flat_map(|node| &node[..COORDINATES]).enumerate() {
                let (v, sv) = (&self.v[r * n..(r + 1) * n], &self.sv[r * n..(r + 1) * n]);
                for i in 0..n {
                    if v[i] != 0.0 {
                        self.small_b[i] += v[i] * x;
                        for k in 0..n {
                            self.small_a[i * n + k] += v[i] * sv[k];
                        }
                    }
                }
            }
            for i in 0..n {
                self.small_a[i * n + i] += 1.0 / (self.stiffness[i] + self.damper(i, h));
            }
            if !dense::solve_in_place(n, &mut self.small_a, &mut self.small_b) {
                return None;
            }
            self.small_b.iter_mut().for_each(|m| *m = -*m);
            self.space.add_tensions(&self.small_b, &mut self.effective);
            let correction = self.stepper.advance(&self.arm, &self.effective, rates, &mut self.next);
            iterations += 1;
            if !correction.is_finite() || correction > 1e3 {
                return None;
            }
            // Newton's corrections shrink faster from one to the next, so the one to come is below this: it need not be
            // made to be known.
            let shrink = if iterations > 1 { (correction / last).min(1.0) } else { 1.0 };
            last = correction;
            let next = correction * shrink;
            if next < TOLERANCE || iterations == ITERATIONS_MAX {
                break;
            }
        }
        self.correct(lengths, h);
        self.scheme.finish(&self.state, &mut self.next);
        if !self.next.is_finite() {
            return None;
        }
        std::mem::swap(&mut self.state, &mut self.next);
        for i in 0..n {
            self.y[i] = (self.filter_time * self.y[i] + h * self.z[i]) / (self.filter_time + h);
            self.beta[i] += h / self.disturbance_time * self.w[i];
        }
        Some(iterations)
    }

    /// D_e of a bend angle (N m/rad) in a step of `h` seconds.
    fn damper(&self, angle: usize, h: f64) -> f64 {
        self.damping[angle] / (self.filter_time + h)
    }

    /// `z` and `w` at the iterate of a step of `h` seconds.
    fn correct(&mut self, lengths: &[f64], h: f64) {
        self.arm.cable_lengths_into(&self.next.q, &mut self.length);
        self.space.angles_into(&self.length, lengths, &mut self.z);
        for i in 0..self.w.len() {
            // An angle that no cable tells feels nothing: neither spring nor what the damper remembers.
            self.w[i] = if self.space.is_observable(i) {
                let damper = self.damper(i, h);
                (self.stiffness[i] + damper) * self.z[i] - damper * self.y[i]
            } else {
                0.0
            };
        }
    }

    /// `V = B T` and `S^-1 V` at the last linearisation.
    pub(super) fn moment_panel(&mut self) {
        let n = self.space.angle_count();
        self.stepper.linearization.input_times_into(&self.arm, self.space.matrix(), n, &mut self.v);
        self.sv.copy_from_slice(&self.v);
        self.stepper.factor.solve_panel_in_place(n, &self.dense, &mut self.sv);
    }

    /// Disturbance as tensions, and the model's steps through the latency.
    pub(super) fn settle_prediction(&mut self) {
        self.disturbance.fill(0.0);
        self.full.add_tensions(&self.beta, &mut self.disturbance);
        self.predicted.copy_from(&self.state);
        self.fading.copy_from_slice(&self.w);
        for sent in &self.sent[1..] {
            for (e, (u, d)) in self.effective.iter_mut().zip(sent.iter().zip(&self.disturbance)) {
                *e = u + d;
            }
            self.fading.iter_mut().for_each(|w| *w *= CORRECTION_FADES_S / (CORRECTION_FADES_S + self.period));
            self.space.add_tensions(&self.fading, &mut self.effective);
            let step = self.stepper.step(
                &self.arm,
                &self.scheme,
                self.period,
                &self.predicted,
                &self.effective,
                PREDICTION_ITERATIONS_MAX,
                &mut self.next,
            );
            // A prediction that fails is worth less than none.
            if step.is_err() || !self.next.is_finite() {
                return;
            }
            std::mem::swap(&mut self.predicted, &mut self.next);
        }
    }

    /// Largest rate of a segment's bend angles (rad/s).
    fn bend_rate(&mut self) -> f64 {
        let [k, kd] = &mut self.curvatures;
        self.arm.curvatures_into(&self.state.q, &self.state.qd, k, kd);
        let mut largest = 0.0f64;
        for s in 0..self.arm.segment_count() {
            let length = self.arm.segment_length(s);
            for rate in &kd[2 * s..2 * s + 2] {
                largest = if rate.is_nan() { f64::NAN } else { largest.max(rate.abs() * length) };
            }
        }
        largest
    }
}
