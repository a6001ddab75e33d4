//! One tick: estimate, decide, plan, check.
//!
//! [`Cycle::tick`] is everything that must happen before the tensions are sent; [`Cycle::report`] completes the record
//! and belongs after sending, so that distances and telemetry never delay a command.

mod elapsed;
mod follow;
mod memory;
mod motion;
mod plan;
mod postures;
mod report;
mod stay;
mod supervise;

use super::budget::{Phase, StopWatch};
use super::estimator::{Estimate, Estimator};
use super::fault::{Fault, FaultList, Limit, Limits};
use super::friction::FrictionCompensation;
use super::governor::Governor;
use super::guard::{EncoderGuard, EncoderReadings, Floor, TensionGuard, TensionVerdict};
use super::obstacles::{ObstacleDemand, ObstaclePair};
use super::ramp::Ramp;
use super::record::Record;
use super::settings::Settings;
use super::steering::Steering;
use super::supervision::Supervision;
use super::supervisor::{
    Action, Answer, Decision, DrivesCommand, DrivesInput, DrivesPhase, Mode, Observed, Progress, Request, Supervisor,
};
use super::target::{TargetInput, lag_s};
use super::tip_sensor::{TipReading, TipSensor};
use super::{CABLES_MAX, CURVATURES_MAX, EventRing};
use crate::collision::{Body, BodyGeometry};
use crate::model::{Arm, State};
use crate::planner::{Deadline, Inputs, Planner, Report, prediction};
use elapsed::Elapsed;
use motion::MotionWatch;
use nalgebra::Vector3;
use plan::Wanted;
use postures::Postures;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew_hal::clock::seconds_to_ns;
use stay::Stay;

/// What the cycle needs of a planner, so that a test can put a broken one in its place.
pub trait Plan {
    /// Plans one step, see [`Planner::plan`]. Must not allocate.
    fn plan(&mut self, inputs: &Inputs<'_>, rng: &mut Xoshiro256PlusPlus, deadline: &mut dyn Deadline) -> Report;

    /// Tensions of the last plan (N), one per cable.
    fn tensions(&self) -> &[f64];

    /// State at the end of the last plan's step; `None` where the planner has no model.
    fn planned(&self) -> Option<&State> {
        None
    }

    /// Takes over what friction leaves of the tensions at each passage, see [`Arm::take_shares`].
    fn take_shares(&mut self, _shares: &[f64]) {}
}

impl Plan for Planner {
    fn plan(&mut self, inputs: &Inputs<'_>, rng: &mut Xoshiro256PlusPlus, deadline: &mut dyn Deadline) -> Report {
        Self::plan(self, inputs, rng, deadline)
    }

    fn tensions(&self) -> &[f64] {
        Self::tensions(self)
    }

    fn planned(&self) -> Option<&State> {
        Some(Self::planned(self))
    }

    fn take_shares(&mut self, shares: &[f64]) {
        self.arm.take_shares(shares);
    }
}

/// Time constant of the mean tensions at which cables stay at a fault, in lookaheads.
pub const STAY_LOOKAHEADS: f64 = 5.0;

/// What a tick works from.
#[derive(Debug, Clone, Copy)]
pub struct TickInputs<'a> {
    /// Tick, from 0.
    pub tick: u64,
    /// Time of the tick (ns, the loop's clock): the scheduled one, so that jitter does not enter the control law.
    pub now_ns: u64,
    /// Deadlines missed since the tick before: ticks left out, and that tick itself if its torques left after its period.
    pub missed: u32,
    /// Newest encoder readings.
    pub encoders: EncoderReadings<'a>,
    /// Measured tensions (N), for the record alone; empty for none, NaN where not valid.
    pub tensions_measured_n: &'a [f64],
    /// Obstacles when the tensions begin to act, [`Cycle::latency_s`] after `now_ns`, and one lookahead later.
    pub obstacles: &'a ObstaclePair,
    /// What the obstacle inputs ask for.
    pub demand: ObstacleDemand,
    /// The newest measured tip, if something measures it.
    pub tip: Option<TipReading>,
    /// Target, if there is one.
    pub target: Option<TargetInput>,
    /// Drives.
    pub drives: DrivesInput,
    /// A request, at most one a tick.
    pub request: Option<Request>,
}

/// What a tick decided; the tensions are [`Cycle::tensions_n`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickOutput {
    /// Mode after the tick.
    pub mode: Mode,
    /// What the drives shall do.
    pub drives: DrivesCommand,
    /// The answer to the request, if there was one.
    pub answer: Option<Answer>,
}

/// The controller of one arm.
#[derive(Debug, Clone)]
pub struct Cycle<E, P = Planner> {
    settings: Settings,
    steering: Steering,
    arm: Arm,
    estimator: E,
    planner: P,
    supervisor: Supervisor,
    encoders: EncoderGuard,
    tensions: TensionGuard,
    friction: FrictionCompensation,
    supervision: Supervision,
    tip_sensor: TipSensor,
    ramp: Ramp,
    body: Body,
    period_ns: u64,
    elapsed: Elapsed,
    latency_s: f64,
    lead_s: f64,

    observing: bool,
    estimate: Estimate,
    postures: Postures,
    motion: MotionWatch,
    governor: Governor,
    /// Speed over the configured one that was asked for.
    speed_scale: f64,
    singular_in_row: u32,
    /// What the encoders' readings mean along the arm, where cables stretch (m).
    read_m: Vec<f64>,
    model_lengths: Vec<f64>,
    model_rates: Vec<f64>,
    /// Largest tension of each cable (N).
    maxima_n: Vec<f64>,
    safe: Vec<f64>,
    /// Where cables stay at a fault.
    stay: Stay,
    release: Ramp,
    zeros: Vec<f64>,
    proposed: Vec<f64>,
    /// What acts along the cables' routes: what planner and observer think in.
    sent: Vec<f64>,
    /// What the drums are told: [`Self::sent`], and what friction takes.
    commanded: Vec<f64>,
    applied: Vec<f64>,
    curvatures: [f64; CURVATURES_MAX],
    curvature_rates: [f64; CURVATURES_MAX],
    positions: Vec<Vector3<f64>>,
    tangents: Vec<Vector3<f64>>,
    record: Record,
}

impl<E: Estimator> Cycle<E> {
    /// With the real planner. Allocates; nothing else here does.
    ///
    /// # Panics
    /// If the arm has more cables or segments than a record holds, which the configuration does not permit, or start
    /// tensions or home curvatures are not as many as the arm needs.
    pub fn new(settings: &Settings, estimator: E) -> Self {
        let steering = Steering::new(settings);
        let planner = Planner::new(&settings.arm, &settings.planner, steering.tension, &steering.change);
        Self::assemble(settings, estimator, planner, steering)
    }
}

impl<E: Estimator, P: Plan> Cycle<E, P> {
    /// With a given planner. Allocates.
    ///
    /// # Panics
    /// As [`Cycle::new`].
    pub fn with_planner(settings: &Settings, estimator: E, planner: P) -> Self {
        Self::assemble(settings, estimator, planner, Steering::new(settings))
    }

    fn assemble(settings: &Settings, estimator: E, planner: P, steering: Steering) -> Self {
        let arm = Arm::new(&settings.arm);
        let (cables, segments, nodes) = (arm.cable_count(), arm.segment_count(), arm.node_count());
        assert!(cables <= CABLES_MAX && 2 * segments <= CURVATURES_MAX, "{cables} cables, {segments} segments");
        let (start, home) = (settings.start_tensions_n.len(), settings.home_curvatures_1pm.len());
        assert!(start == cables && home == 2 * segments, "{start} start tensions, {home} home curvatures");
        let planning = &settings.planner;
        let scheme = prediction(&settings.planner, settings.arm.rho_inf);
        let period_s = settings.timing.period_s;
        let weights = &settings.weights;
        let latency_s = settings.observer.latency_ticks as f64 * period_s;
        let lag_s =
            planning.lead_s.unwrap_or_else(|| lag_s(weights.tip.rate, weights.tip.pose, &scheme, planning.lookahead_s));
        Self {
            supervisor: Supervisor::new(
                &settings.timing,
                &settings.observer,
                settings.safe_hold.iter().any(|hold| hold.stays()),
                settings.arm_unknown,
            ),
            encoders: EncoderGuard::new(&settings.guard, cables, settings.timing.period_s),
            tensions: TensionGuard::new(&settings.arm, &settings.guard, period_s),
            friction: FrictionCompensation::new(&settings.friction, &arm, period_s),
            supervision: Supervision::new(
                &arm,
                &settings.arm,
                &settings.supervision,
                settings.observer.latency_ticks,
                ((latency_s + planning.lookahead_s + lag_s) / period_s).round() as usize,
            ),
            tip_sensor: TipSensor::new(&settings.tip_sensor, period_s),
            ramp: Ramp::new(cables, settings.timing.ramp_s),
            // The rows of a search are the planner's business; measuring needs none.
            body: Body::with_capacity(&BodyGeometry::from_arm(&settings.arm), planning.body, planning.body_radius_m, 1),
            period_ns: seconds_to_ns(period_s),
            elapsed: Elapsed::new(seconds_to_ns(period_s)),
            latency_s,
            lead_s: latency_s + planning.lookahead_s + lag_s,
            observing: false,
            estimate: Estimate::default(),
            postures: Postures::new(settings, &arm),
            motion: MotionWatch::new(settings.arm.length_m(), cables),
            governor: Governor::new(&arm, &settings.arm, &settings.governor, planning, &settings.observer),
            speed_scale: 1.0,
            singular_in_row: 0,
            read_m: vec![f64::NAN; cables],
            model_lengths: vec![0.0; cables],
            model_rates: vec![0.0; cables],
            maxima_n: settings.arm.tension_maxima_n(),
            safe: vec![settings.safe_tension_n(); cables],
            stay: Stay::new(&arm, &settings.safe_hold, period_s / (STAY_LOOKAHEADS * planning.lookahead_s + period_s)),
            release: Ramp::new(cables, settings.timing.release_s),
            zeros: vec![0.0; cables],
            proposed: vec![0.0; cables],
            sent: vec![0.0; cables],
            commanded: vec![0.0; cables],
            applied: vec![0.0; cables],
            curvatures: [0.0; CURVATURES_MAX],
            curvature_rates: [0.0; CURVATURES_MAX],
            positions: vec![Vector3::zeros(); nodes + 1],
            tangents: vec![Vector3::zeros(); nodes + 1],
            record: Record::default(),
            steering,
            settings: settings.clone(),
            arm,
            estimator,
            planner,
        }
    }

    /// Time (s) from a tick until its tensions act, beyond the ordinary cycle.
    pub const fn latency_s(&self) -> f64 {
        self.latency_s
    }

    /// How far ahead of the tick a target is wanted (s): latency, lookahead, and the lag of the rate weights or `lead_s` in
    /// its place.
    pub const fn lead_s(&self) -> f64 {
        self.lead_s
    }

    /// Tensions to send (N), one per cable: finite and inside the box; zero while the drives are off.
    pub fn tensions_n(&self) -> &[f64] {
        &self.commanded
    }

    /// Present mode.
    pub const fn mode(&self) -> Mode {
        self.supervisor.mode()
    }

    /// What happened; the caller takes the events out.
    pub const fn events_mut(&mut self) -> &mut EventRing {
        self.supervisor.events_mut()
    }

    /// The supervisor.
    pub const fn supervisor(&self) -> &Supervisor {
        &self.supervisor
    }

    /// The estimator.
    pub const fn estimator(&self) -> &E {
        &self.estimator
    }

    /// The supervision of motion, tensions and cables.
    pub const fn supervision(&self) -> &Supervision {
        &self.supervision
    }

    /// The governor.
    pub const fn governor(&self) -> &Governor {
        &self.governor
    }

    /// Asks for a share of the configured speed on every way to a target, above 0 and at most 1: kept until another is asked
    /// for, or the arm is disarmed. Giving way to obstacles, holding and stopping keep their own.
    pub const fn set_speed_scale(&mut self, scale: f64) {
        self.speed_scale = scale;
    }

    /// Share of the configured speed that was asked for.
    pub const fn speed_scale(&self) -> f64 {
        self.speed_scale
    }

    /// Where the estimate has its tip (m, base frame).
    pub fn estimated_tip(&self) -> Vector3<f64> {
        self.arm.pose(&self.estimator.state().q, self.arm.node_count()).0
    }

    /// One tick, up to the tensions. Does not allocate, never panics on any input, asks `deadline` while planning.
    pub fn tick(
        &mut self,
        inputs: &TickInputs<'_>,
        rng: &mut Xoshiro256PlusPlus,
        deadline: &mut impl StopWatch,
    ) -> TickOutput {
        let mut faults = FaultList::default();
        let mut limits = Limits::default();
        let periods = self.elapsed.advance(inputs.now_ns, inputs.encoders.capture_ns);
        self.watch_encoders(inputs, periods, &mut faults, &mut limits);
        let progress = self.follow(inputs, periods, &mut faults);
        if inputs.target.is_some_and(|t| !t.is_sound()) {
            faults.push(Fault::TargetNotFinite);
        }
        if faults.iter().any(|fault| fault.spoils_estimate()) {
            self.observing = false;
        }
        deadline.mark(Phase::Estimate);

        let before = (self.supervisor.mode(), self.supervisor.is_planning());
        self.measure_curvatures();
        let tip = self.observing.then(|| {
            let state = self.estimator.state();
            self.arm.tip(&state.q, &state.qd)
        });
        self.measure_tip(inputs, tip.as_ref(), periods, &mut limits);
        let verdict = self.supervise(inputs, tip.as_ref(), periods, &mut faults);
        limits.0 |= verdict.limits.0;
        let tip_speed_mps = tip.map_or(f64::NAN, |tip| tip.velocity.norm());
        let seen = self.observed(inputs, faults, progress, verdict.hold, tip_speed_mps);
        let decision = self.supervisor.step(&seen);
        self.on_change(before);
        limits.0 |= decision.limits.0;
        let plan = self.propose(inputs, &decision, &mut limits, rng, deadline);
        deadline.mark(Phase::Plan);

        let mut drives = decision.drives;
        if let Some(fault) = self.check(&decision, &mut limits) {
            self.supervisor.raise(fault, inputs.tick, inputs.now_ns, inputs.drives.phase);
            // The tick of the fault is the first one of the ramp. The drives keep their torque for it.
            self.ramp.end();
            self.ramp_down(inputs);
            drives = DrivesCommand::On;
        }
        if self.supervisor.mode() != Mode::Faulted {
            self.stay.remember(self.supervisor.is_planning(), &self.commanded);
        }
        self.supervisor.note_limits(limits, inputs.tick, inputs.now_ns);
        deadline.mark(Phase::Guard);
        self.record.plan = plan;
        self.record.limits = limits;
        TickOutput { mode: self.supervisor.mode(), drives, answer: decision.answer }
    }

    fn observed(
        &mut self,
        inputs: &TickInputs<'_>,
        faults: FaultList,
        progress: Progress,
        hold: Option<Limit>,
        tip_speed_mps: f64,
    ) -> Observed {
        let count = 2 * self.arm.segment_count();
        let moves = self.motion.moves(inputs.now_ns, tip_speed_mps, self.encoders.lengths_m());
        let home = &self.settings.home_curvatures_1pm;
        let tolerance = self.settings.home_tolerance_rad;
        let length = |i: usize| self.settings.arm.segments[i / 2].length_m;
        Observed {
            tick: inputs.tick,
            now_ns: inputs.now_ns,
            request: inputs.request,
            drives: inputs.drives,
            faults,
            progress,
            target_fresh: inputs.target.is_some_and(|target| target.fresh),
            obstacles: inputs.demand,
            hold,
            unreachable: self.governor.is_refused(),
            at_safe_tension: self.sent.iter().zip(&self.safe).all(|(sent, safe)| sent <= safe),
            at_home: self.curvatures[..count]
                .iter()
                .zip(home)
                .enumerate()
                .all(|(i, (k, home))| length(i) * (k - home).abs() <= tolerance),
            lowered: self.governor.has_arrived(self.postures.rest()),
            bent: self.postures.is_bent(),
            moves,
            missed: inputs.missed,
        }
    }

    /// What a change of mode, or the beginning or end of planning, does to the cycle's own state.
    fn on_change(&mut self, (mode_before, planned_before): (Mode, bool)) {
        let (mode, plans) = (self.supervisor.mode(), self.supervisor.is_planning());
        if plans && !planned_before {
            let state = self.estimator.predicted();
            let count = 2 * self.arm.segment_count();
            self.governor.restart(&state.q, &state.lambda, &self.curvatures[..count]);
            self.supervision.restart();
        }
        if mode == mode_before {
            return;
        }
        self.ramp.end();
        self.singular_in_row = 0;
        if mode == Mode::Disarmed {
            self.speed_scale = 1.0;
        }
        if mode == Mode::Starting {
            self.observing = false;
            self.postures.forget();
        }
    }

    /// Writes the tensions that the decision asks for to `proposed`.
    fn propose(
        &mut self,
        inputs: &TickInputs<'_>,
        decision: &Decision,
        limits: &mut Limits,
        rng: &mut Xoshiro256PlusPlus,
        deadline: &mut impl StopWatch,
    ) -> Option<Report> {
        let begin_ns = inputs.now_ns.saturating_sub(self.period_ns);
        if !matches!(decision.action, Action::Ramp | Action::Tighten | Action::Stay) {
            self.ramp.end();
        }
        if decision.action != Action::Release {
            self.release.end();
        }
        let target = match decision.action {
            Action::Off => {
                self.proposed.fill(0.0);
                return None;
            }
            // From what the drums pull: friction is no longer made up for.
            Action::Keep => {
                self.proposed.copy_from_slice(&self.commanded);
                return None;
            }
            Action::Ramp => {
                self.ramp.begin(&self.commanded, begin_ns);
                self.ramp.tensions_into(&self.safe, inputs.now_ns, &mut self.proposed);
                return None;
            }
            Action::Stay => {
                self.stay(inputs, begin_ns);
                return None;
            }
            Action::Release => {
                self.release.begin(&self.commanded, begin_ns);
                self.release.tensions_into(&self.safe, inputs.now_ns, &mut self.proposed);
                return None;
            }
            Action::Tighten => {
                match self.postures.tensions_n() {
                    Some(start) if inputs.drives.phase == DrivesPhase::Enabled => {
                        self.ramp.begin(&self.commanded, begin_ns);
                        self.ramp.tensions_into(start, inputs.now_ns, &mut self.proposed);
                    }
                    _ => {
                        self.ramp.end();
                        self.proposed.fill(0.0);
                    }
                }
                return None;
            }
            Action::Raise => Wanted::shape(self.postures.start()),
            Action::Lower => Wanted::shape(self.postures.rest()),
            Action::Hold => Wanted::Rest,
            Action::Home => Wanted::shape(&self.settings.home_curvatures_1pm),
            Action::Track => match self.wanted(inputs) {
                Some(wanted) => wanted,
                // The supervisor tracks only with a target; without one, keeping what acts is the harmless answer.
                None => {
                    self.proposed.copy_from_slice(&self.sent);
                    return None;
                }
            },
        };
        Some(self.plan(inputs, &target, limits, rng, deadline))
    }

    /// The guard: moves what may leave to `sent`.
    fn check(&mut self, decision: &Decision, limits: &mut Limits) -> Option<Fault> {
        if decision.action == Action::Off {
            // Nothing leaves but zero: no box, no rate.
            self.friction.rest();
            self.take_shares();
            self.sent.fill(0.0);
            self.commanded.fill(0.0);
            return None;
        }
        // The box holds once the cables are tight; before that, and where a start was cut short, it begins at zero.
        let tight = self.sent.iter().zip(&self.safe).all(|(sent, safe)| sent >= safe);
        let floor = if tight && decision.action != Action::Tighten { Floor::Box } else { Floor::Zero };
        if !decision.action.plans() {
            self.friction.rest();
        }
        let verdict = self.send(floor);
        if verdict.limited > 0 {
            limits.insert(Limit::RateLimited);
        }
        verdict.fault.or_else(|| {
            let count = self.singular_in_row;
            (count >= self.settings.singular_plans_max).then_some(Fault::PlanSingular { count })
        })
    }

    /// One tick of what a fault leads to, from what the drums were told last.
    fn ramp_down(&mut self, inputs: &TickInputs<'_>) {
        let begin_ns = inputs.now_ns.saturating_sub(self.period_ns);
        if self.supervisor.is_held() {
            self.stay(inputs, begin_ns);
        } else {
            self.ramp.begin(&self.commanded, begin_ns);
            self.ramp.tensions_into(&self.safe, inputs.now_ns, &mut self.proposed);
        }
        self.friction.rest();
        self.send(Floor::Zero);
    }

    /// Proposes what each cable is declared to do at a fault, and what drives that fail leave to it.
    fn stay(&mut self, inputs: &TickInputs<'_>, begin_ns: u64) {
        if !self.ramp.is_begun() {
            self.stay.begin(&self.safe);
        }
        self.stay.take_over(inputs.drives.fault, self.settings.arm.tension_n_min, &self.maxima_n);
        self.ramp.begin(&self.commanded, begin_ns);
        self.ramp.tensions_into(self.stay.tensions_n(), inputs.now_ns, &mut self.proposed);
        self.stay.hurry(&mut self.proposed);
    }

    /// Judges `proposed` with what friction takes added, and moves it to `commanded` and `sent`.
    fn send(&mut self, floor: Floor) -> TensionVerdict {
        if self.friction.is_active() {
            let low = self.settings.arm.tension_n_min;
            for ((u, factor), high) in self.proposed.iter_mut().zip(self.friction.factors()).zip(&self.maxima_n) {
                // What lies outside the box as it is planned stays so, for the guard to see.
                if (low..=*high).contains(u) {
                    *u = (*u / factor).clamp(low, *high);
                }
            }
        }
        self.take_shares();
        self.applied.copy_from_slice(&self.commanded);
        let verdict = self.tensions.check(&self.proposed, &self.applied, floor, &mut self.commanded);
        for ((sent, u), factor) in self.sent.iter_mut().zip(&self.commanded).zip(self.friction.factors()) {
            *sent = u * factor;
        }
        verdict
    }

    /// Lets all models have what friction leaves of the tensions at each passage.
    fn take_shares(&mut self) {
        if self.friction.is_active() {
            let shares = self.friction.shares();
            self.planner.take_shares(shares);
            self.estimator.take_shares(shares);
            self.governor.take_shares(shares);
        }
    }

    /// The record, for the caller to fill in the timing.
    pub const fn record_mut(&mut self) -> &mut Record {
        &mut self.record
    }
}
