//! From whatever target is given to a reference that the arm may follow: bounded in speed and acceleration, always
//! continuous, in the arm's own coordinates.
//!
//! The reference is a posture: mean curvatures `kappa_ref(t) = kappa_goal(t) + e(t)`. `kappa_goal` is the posture that
//! reaches the target, by inverse statics, continuous with where the arm is and following a target that moves. `e` is what
//! a step of the target left, a quintic that fades to zero with rate and acceleration (Flash and Hogan 1985), over a time
//! in which no point of the arm exceeds the limits. A straight line in space may leave the reachable set; one in
//! curvatures does not.

use crate::config::{ArmConfig, GovernorConfig, PlannerConfig, Scale};
use crate::math::quaternion::{conjugate, from_rotation_vector, product};
use crate::model::Arm;
use crate::posture::{
    Inverse, InverseSettings, Met, Outcome, POSE, Reference, ReferenceSettings, RestingArm, Surroundings, Wanted,
    pose_error, pose_weights, segment_lengths,
};
use nalgebra::{Vector3, Vector4};

/// What is wanted at the end of lookahead and lead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wish<'a> {
    /// A pose of the tip.
    Tip {
        /// Position (m, base frame).
        position: Vector3<f64>,
        /// Unit quaternion (body to base).
        quaternion: Vector4<f64>,
    },
    /// Mean curvatures (1/m).
    Shape(&'a [f64]),
    /// To come to rest and stay.
    Rest,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Tip,
    Shape,
    Rest,
}

/// A target that moves at once by more than this share of the arm's length, or turns by more than this (rad), is a step.
const STEP: f64 = 0.01;
const STEP_RAD: f64 = 0.05;
/// Posture error (rad of bend) from which the way counts as blocked: the reference slows down, and waits at twice that.
const BLOCKED_RAD: f64 = 0.1;
/// By how much farther than the planner the reference keeps from obstacles, over the arm's length: the planner's rows are
/// for what the reference could not know.
const AHEAD_OF_PLANNER: f64 = 7e-4;
/// What a posture's load beyond it counts as, over the reach.
const OVERLOAD: f64 = 100.0;
/// Root mean square speed of the arm's mass up to which a tip keeps its task, over the arm's length (1/s).
const QUIET: f64 = 0.04;
/// How far from obstacles the reference begins to look at them, over the arm's length.
const REACH: f64 = 0.11;
/// Iterations of inverse statics for a new target, a tick.
const ITERATIONS_PER_TICK: usize = 2;
/// Iterations after which a start of the inverse statics is given up.
const ITERATIONS_MAX: usize = 120;
/// Iterations have ended where no bend angle changes by more than this (rad).
const CONVERGED_RAD: f64 = 2e-5;
/// The pose is reached as well as it can be where another centre changes no bend angle by more than this (rad).
const RECENTRED_RAD: f64 = 1e-3;
/// Samples along a path for its length.
const SAMPLES: usize = 16;
/// Peak rate, acceleration and where a quintic from rest to rest has them: 15/8 and 10/sqrt(3).
const PEAK_RATE: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.774;

/// The governor of one arm. [`Governor::new`] allocates, nothing else does.
#[derive(Debug)]
pub struct Governor {
    settings: GovernorConfig,
    /// Time constants (s) of the mean that a swing goes about, of the answer to it, and of the way back.
    mean_s: f64,
    fade_s: f64,
    approach_s: f64,
    /// A target that moves by more than this at once is a step (m).
    step_m: f64,
    /// Range of the tensions of each segment's cables (N).
    tension_range_n: Vec<f64>,
    inverse: Inverse,
    /// Length of the segment of each curvature (m).
    length: Vec<f64>,
    tensions: Vec<f64>,
    kind: Kind,
    /// Target that `inverse` is at or on its way to.
    position: Vector3<f64>,
    quaternion: Vector4<f64>,
    /// Iterations so far and starts tried, while a new target is looked for.
    solving: Option<(usize, usize)>,
    /// At rest after a tip target: the tip is held, and whether it is already known where.
    holds_tip: Option<bool>,
    /// Best equilibrium so far of those starts, and its error.
    best: RestingArm,
    best_error: f64,
    goal: Vec<f64>,
    /// Coefficients of `e` over time/duration, six per curvature.
    offset: Vec<[f64; 6]>,
    duration: f64,
    time: f64,
    /// What the path wants, at this tick and the one before (1/m).
    desired: Vec<f64>,
    before_desired: Vec<f64>,
    reference: Reference,
    rate: Vec<f64>,
    acceleration: Vec<f64>,
    drift: Vec<f64>,
    command: Vec<f64>,
    /// Of [`Governor::damp`]: swing as curvatures, its mean, the answer (1/m).
    swing: Vec<f64>,
    mean: Vec<f64>,
    answer: Vec<f64>,
    /// Pace at which targets are approached, and the one asked for: 1 unless something asks to slow down.
    pace: f64,
    pace_wanted: f64,
    /// Target of the tick before.
    last: (Vector3<f64>, Vector4<f64>),
    met: Met,
    /// Time for which the way has been blocked (s).
    blocked_s: f64,
    /// Time for which the reference has not come nearer to the goal after its path (s).
    stuck_s: f64,
    outcome: Option<Outcome>,
    blocked: bool,
    q: Vec<f64>,
    chain: Vec<f64>,
    joints: Vec<Vector3<f64>>,
    before: Vec<Vector3<f64>>,
}

impl Governor {
    /// For an arm. Allocates.
    pub fn new(arm: &Arm, config: &ArmConfig, settings: &GovernorConfig, planner: &PlannerConfig) -> Self {
        let scale = Scale::of(config);
        let tension_n = config.tension_n_min;
        let inverse = InverseSettings { attitude_length_m: settings.attitude_length_m, ..InverseSettings::default() };
        let tension_range_n: Vec<f64> =
            config.segments.iter().map(|s| config.segment_tension_n_max(s) - config.tension_n_min).collect();
        let around = ReferenceSettings {
            clearance_m: planner.clearance_m + AHEAD_OF_PLANNER * config.length_m(),
            approach_1ps: settings.approach_1ps,
            reach_m: REACH * config.length_m(),
            evasion_mps: settings.evasion_mps,
            evasion_mps2: settings.evasion_mps2,
            withdrawal_mps: settings.speed_mps,
            quiet_mps: QUIET * config.length_m(),
            tension_range_n: tension_range_n.clone(),
        };
        let count = 2 * arm.segment_count();
        let length = segment_lengths(arm);
        Self {
            settings: *settings,
            mean_s: scale.time_s(MEAN),
            fade_s: scale.time_s(FADE),
            approach_s: scale.time_s(APPROACH),
            step_m: STEP * config.length_m(),
            tension_range_n,
            inverse: Inverse::new(arm, &inverse),
            length,
            tensions: vec![tension_n; arm.cable_count()],
            kind: Kind::Rest,
            position: Vector3::zeros(),
            quaternion: Vector4::new(1.0, 0.0, 0.0, 0.0),
            solving: None,
            holds_tip: None,
            best: RestingArm::new(arm),
            best_error: f64::INFINITY,
            goal: vec![0.0; count],
            offset: vec![[0.0; 6]; count],
            duration: 0.0,
            time: 0.0,
            desired: vec![0.0; count],
            before_desired: vec![0.0; count],
            reference: Reference::new(arm, config, planner.body_radius_m, &around),
            rate: vec![0.0; count],
            acceleration: vec![0.0; count],
            drift: vec![0.0; count],
            command: vec![0.0; count],
            swing: vec![0.0; count],
            mean: vec![0.0; count],
            answer: vec![0.0; count],
            pace: 1.0,
            pace_wanted: 1.0,
            last: (Vector3::zeros(), Vector4::new(1.0, 0.0, 0.0, 0.0)),
            met: Met::default(),
            blocked_s: 0.0,
            stuck_s: 0.0,
            outcome: None,
            blocked: false,
            q: arm.straight(),
            chain: vec![0.0; count],
            joints: vec![Vector3::zeros(); arm.segment_count()],
            before: vec![Vector3::zeros(); arm.segment_count()],
        }
    }

    /// Mean curvatures of the reference (1/m).
    pub fn reference(&self) -> &[f64] {
        self.reference.rest().curvatures()
    }

    /// Swing of the arm beside its reference, as the motion in curvatures that is nearest to it (1/m).
    pub fn swing(&self) -> &[f64] {
        &self.swing
    }

    /// Mean curvatures to command (1/m): the reference's, and what takes energy out of the arm's swing.
    pub fn command(&self) -> &[f64] {
        &self.command
    }

    /// Answers the arm's swing beside its reference by a motion that takes energy out of it.
    ///
    /// With node displacements `s` of the arm from the equilibrium at its own mean curvatures, and `Phi` those of a change
    /// of curvature, accelerations `kappa''` change the swing's energy at the rate `-s'^T M Phi kappa''`. So
    /// `kappa' = c (Phi^T M Phi)^-1 Phi^T M s`, the motion in curvatures that is nearest to the swing, only ever takes
    /// energy out of it, whatever its modes. What is constant in `s` is the model's error, no swing, and is left out.
    fn damp(&mut self, h: f64) {
        for i in 0..self.swing.len() {
            self.mean[i] += h / self.mean_s * (self.swing[i] - self.mean[i]);
            let push = self.settings.swing_damping_1ps * (self.swing[i] - self.mean[i]);
            self.answer[i] += h * (push - self.answer[i] / self.fade_s);
        }
    }

    /// Where the reference has its tip (m, base frame).
    pub fn reference_tip(&self) -> Vector3<f64> {
        self.reference.rest().tip().0
    }

    /// Coordinates q of the reference's equilibrium (7N).
    pub fn reference_coordinates(&self) -> &[f64] {
        &self.reference.rest().state().q
    }

    /// Pace at which targets are to be approached, taken on within some tenths of a second; evasion keeps its own.
    pub fn set_pace(&mut self, pace: f64) {
        self.pace_wanted = pace;
    }

    /// What the last step met.
    pub fn met(&self) -> &Met {
        &self.met
    }

    /// What the tip is wanted at, with the limits on its motion.
    pub fn tip(&self) -> (Vector3<f64>, Vector4<f64>) {
        (self.position, self.quaternion)
    }

    /// Largest bend angle between two postures (rad).
    fn bend_between(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).zip(&self.length).map(|((a, b), l)| (a - b).abs() * l).fold(0.0, f64::max)
    }

    /// Time until the path of the last step ends (s), if nothing is in its way.
    pub fn remaining_s(&self) -> f64 {
        self.duration - self.time
    }

    /// Whether a new target is still being looked for.
    pub fn is_solving(&self) -> bool {
        self.solving.is_some()
    }

    /// Whether the arm cannot follow, and the reference waits.
    pub fn is_blocked(&self) -> bool {
        self.blocked
    }

    /// Whether a way to mean curvatures (1/m) is over, and the reference is there.
    pub fn has_arrived(&self, curvatures: &[f64]) -> bool {
        self.kind == Kind::Shape && !self.on_path() && self.bend_between(self.reference(), curvatures) < ARRIVED_RAD
    }

    /// Whether a way is over without having led to its goal.
    pub fn is_stuck(&self) -> bool {
        self.stuck_s > STUCK_S
    }

    /// How well the posture reaches the tip target; `None` where there is none.
    pub fn outcome(&self) -> Option<Outcome> {
        self.outcome
    }

    /// Starts from where the arm is, a shape `q` with multipliers and mean curvatures (1/m), at rest.
    pub fn restart(&mut self, q: &[f64], lambda: &[f64], curvatures: &[f64]) {
        self.kind = Kind::Rest;
        self.holds_tip = None;
        self.solving = None;
        self.outcome = None;
        self.blocked = false;
        self.blocked_s = 0.0;
        self.stuck_s = 0.0;
        self.reference.rest_mut().take_shape(q, lambda);
        self.goal.copy_from_slice(curvatures);
        self.desired.copy_from_slice(curvatures);
        self.rate.fill(0.0);
        self.acceleration.fill(0.0);
        self.mean.fill(0.0);
        self.answer.fill(0.0);
        self.command.copy_from_slice(curvatures);
        self.offset.fill([0.0; 6]);
        self.duration = 0.0;
        self.time = 0.0;
    }

    /// One tick of `h` seconds towards what is wanted; `curvatures` (1/m) are those of the arm. Does not allocate.
    pub fn advance(
        &mut self,
        h: f64,
        wish: &Wish<'_>,
        q: &[f64],
        curvatures: &[f64],
        around: Option<&Surroundings<'_>>,
    ) {
        self.before_desired.copy_from_slice(&self.desired);
        self.pace += h / (PACE_S + h) * (self.pace_wanted - self.pace);
        match *wish {
            Wish::Rest => {
                if self.kind != Kind::Rest {
                    self.come_to_rest();
                }
            }
            Wish::Shape(kappa) => self.follow_shape(kappa),
            Wish::Tip { position, quaternion } => self.follow_tip(h, &position, &quaternion),
        }
        self.move_on(h, q, curvatures, around);
    }

    /// A posture is held as it is, a tip where it comes to rest.
    fn come_to_rest(&mut self) {
        self.holds_tip = if self.kind == Kind::Tip { Some(false) } else { None };
        self.kind = Kind::Rest;
        self.solving = None;
        self.outcome = None;
        // As far as the present rates carry while they fade, at four times the acceleration of a path.
        let speed = self.speed();
        let fade_s = (0.5 * speed / self.settings.acceleration_mps2).max(0.2);
        for i in 0..self.goal.len() {
            self.goal[i] = self.reference()[i] + 0.5 * fade_s * self.rate[i];
        }
        self.begin(Some(fade_s));
    }

    fn follow_shape(&mut self, kappa: &[f64]) {
        let moved = |i: usize| self.reference.rest().is_moved(i);
        let step = (0..kappa.len())
            .filter(|i| moved(*i))
            .map(|i| (self.goal[i] - kappa[i]).abs() * self.length[i])
            .fold(0.0, f64::max);
        let new = self.kind != Kind::Shape || step > STEP_RAD;
        self.kind = Kind::Shape;
        self.solving = None;
        self.outcome = None;
        for i in 0..self.goal.len() {
            // What no cable moves is left as it is.
            self.goal[i] = if self.reference.rest().is_moved(i) { kappa[i] } else { self.reference()[i] };
        }
        if new {
            self.begin(None);
        }
    }

    fn follow_tip(&mut self, h: f64, position: &Vector3<f64>, quaternion: &Vector4<f64>) {
        let gap = position - self.position;
        let turn = rotation_between(&self.quaternion, quaternion);
        let new = self.kind != Kind::Tip || gap.norm() > self.step_m || turn.norm() > STEP_RAD;
        if new {
            self.kind = Kind::Tip;
            self.position = *position;
            self.quaternion = *quaternion;
            self.best_error = f64::INFINITY;
            self.solving = Some((0, 0));
            // Of all postures the one that is nearest.
            self.inverse.rest_mut().copy_from(self.reference.rest());
            self.inverse.centre_at(self.reference.rest().curvatures().iter().copied());
            self.last = (*position, *quaternion);
        } else {
            self.last = (self.position, self.quaternion);
            // A target that runs faster than the limit is followed at the limit.
            let share = |size: f64, most: f64| if size > most { most / size } else { 1.0 };
            let s = share(gap.norm(), self.pace * self.settings.speed_mps * h);
            self.position += s * gap;
            let s = share(turn.norm(), self.pace * self.settings.turn_rate_radps * h);
            self.quaternion = product(&self.quaternion, &from_rotation_vector(&(s * turn))).normalize();
        }
        match self.solving {
            Some((iterations, starts)) => self.solve(iterations, starts),
            None if self.time < self.duration && self.last.0 != self.position => {
                if let Ok(outcome) = self.inverse.iterate(&self.tensions, &self.position, &self.quaternion) {
                    self.outcome = Some(outcome);
                    self.goal.copy_from_slice(self.inverse.rest().curvatures());
                }
            }
            None => {}
        }
    }

    fn solve(&mut self, mut iterations: usize, mut starts: usize) {
        for _ in 0..ITERATIONS_PER_TICK {
            let outcome = self.inverse.iterate(&self.tensions, &self.position, &self.quaternion);
            iterations += 1;
            let ended = match outcome {
                Ok(outcome) => {
                    let mut converged = outcome.change_rad < CONVERGED_RAD;
                    if converged {
                        // What bending costs has held it off the pose: from here it costs nothing, until that changes nothing.
                        let rest = self.inverse.rest().curvatures();
                        let off = rest.iter().zip(self.inverse.centre()).zip(&self.length);
                        converged = off.map(|((k, c), l)| (k - c).abs() * l).fold(0.0, f64::max) < RECENTRED_RAD;
                        self.inverse.recentre();
                    }
                    if converged || iterations == ITERATIONS_MAX {
                        // A posture beyond the cables' tensions is none.
                        let mut load = 0.0f64;
                        for segment in 0..self.joints.len() {
                            load = load.max(self.inverse.rest().load_into(
                                segment,
                                self.tension_range_n[segment],
                                &mut self.drift,
                            ));
                        }
                        let over = OVERLOAD * self.settings.reach_m * (load - 1.0).max(0.0);
                        let error = outcome.position_m + 0.1 * outcome.attitude_rad + over;
                        if error < self.best_error {
                            self.best_error = error;
                            self.best.copy_from(self.inverse.rest());
                            self.outcome = Some(outcome);
                        }
                        true
                    } else {
                        false
                    }
                }
                Err(_) => true,
            };
            if !ended {
                continue;
            }
            let reached = self.best_error < self.settings.reach_m;
            if !reached && starts < STARTS {
                starts += 1;
                iterations = 0;
                self.chain_of_start(starts);
                self.inverse.rest_mut().restart(&self.chain);
                self.inverse.centre_at(std::iter::repeat(0.0));
                continue;
            }
            if self.best_error.is_finite() {
                self.inverse.rest_mut().copy_from(&self.best);
                self.goal.copy_from_slice(self.best.curvatures());
                self.begin(None);
            }
            self.solving = None;
            return;
        }
        self.solving = Some((iterations, starts));
    }

    /// Whether the target is farther away than its posture reaches.
    pub fn is_out_of_reach(&self) -> bool {
        self.kind == Kind::Tip && self.solving.is_none() && self.best_error > self.settings.reach_m
    }

    /// Other postures to start from: straight, then bent towards one side after another.
    fn chain_of_start(&mut self, start: usize) {
        self.chain.fill(0.0);
        if start > 1 {
            let angle = 2.4 * start as f64;
            for (i, k) in self.chain.iter_mut().enumerate() {
                let bend = if (i / 2) % 2 == start % 2 { 0.9 } else { 0.3 };
                *k = bend / self.length[i] * if i % 2 == 0 { angle.cos() } else { angle.sin() };
            }
        }
    }

    /// Makes `e` what lies between reference and goal, with the reference's motion, and fade.
    fn begin(&mut self, duration_s: Option<f64>) {
        let t = duration_s.unwrap_or_else(|| self.duration_for());
        for i in 0..self.goal.len() {
            let (c0, c1, c2) =
                (self.reference()[i] - self.goal[i], self.rate[i] * t, 0.5 * self.acceleration[i] * t * t);
            self.offset[i] = [
                c0,
                c1,
                c2,
                -10.0 * c0 - 6.0 * c1 - 3.0 * c2,
                15.0 * c0 + 8.0 * c1 + 3.0 * c2,
                -6.0 * c0 - 3.0 * c1 - c2,
            ];
        }
        self.duration = t;
        self.time = 0.0;
        self.blocked_s = 0.0;
        self.desired.copy_from_slice(self.reference.rest().curvatures());
        self.before_desired.copy_from_slice(&self.desired);
    }

    /// Speed of the reference's fastest joint (m/s), by the constant-curvature chain.
    fn speed(&mut self) -> f64 {
        let dt = 1e-3;
        self.joints_at(0.0);
        let before: Vector3<f64> = self.joints[self.joints.len() - 1];
        for i in 0..self.chain.len() {
            self.chain[i] = self.reference()[i] + dt * self.rate[i];
        }
        self.place_joints();
        (self.joints[self.joints.len() - 1] - before).norm() / dt
    }

    fn joints_at(&mut self, share: f64) {
        for i in 0..self.chain.len() {
            let from = self.reference()[i];
            self.chain[i] = from + share * (self.goal[i] - from);
        }
        self.place_joints();
    }

    fn place_joints(&mut self) {
        let arm = self.inverse.rest().arm();
        arm.bent_into(&self.chain, &mut self.q);
        for (joint, range) in self.joints.iter_mut().zip(&arm.segment_elements) {
            *joint = arm.pose(&self.q, range.end).0;
        }
    }

    /// Time (s) in which the way from reference to goal keeps to the limits.
    fn duration_for(&mut self) -> f64 {
        let s = self.settings;
        let speed = self.speed();
        let mut fastest = 0.0f64;
        self.joints_at(0.0);
        self.before.copy_from_slice(&self.joints);
        for k in 1..=SAMPLES {
            self.joints_at(k as f64 / SAMPLES as f64);
            for (joint, before) in self.joints.iter().zip(&mut self.before) {
                fastest = fastest.max((joint - *before).norm() * SAMPLES as f64);
                *before = *joint;
            }
        }
        let bend = self.bend_between(self.reference(), &self.goal);
        (PEAK_RATE * fastest / s.speed_mps)
            .max((PEAK_ACCELERATION * fastest / s.acceleration_mps2).sqrt())
            .max(PEAK_RATE * bend / s.bend_rate_radps)
            .max(4.0 * speed / s.acceleration_mps2)
            .max(0.1)
    }

    /// Whether a path after a step is under way.
    fn on_path(&self) -> bool {
        self.time < self.duration
    }

    fn move_on(&mut self, h: f64, q: &[f64], curvatures: &[f64], around: Option<&Surroundings<'_>>) {
        let mut pace = self.pace;
        self.blocked = false;
        let on_path = self.on_path();
        if on_path {
            // Both what the reference lacks of the path, because of obstacles, and what the arm lacks of the reference.
            let error = self
                .bend_between(self.reference(), curvatures)
                .max(2.0 * self.bend_between(self.reference(), &self.desired));
            let free = (2.0 - error / BLOCKED_RAD).clamp(0.0, 1.0);
            pace *= free;
            self.blocked = free < 0.5;
            self.blocked_s = if self.blocked { self.blocked_s + h } else { 0.0 };
        }
        self.time = (self.time + pace * h).min(self.duration);
        if self.blocked_s > GIVE_UP_S {
            self.time = self.duration;
        }
        let away = self.kind == Kind::Shape && self.bend_between(self.reference(), &self.goal) > ARRIVED_RAD;
        self.stuck_s = if away && !on_path { self.stuck_s + h } else { 0.0 };
        let x = if self.duration > 0.0 { self.time / self.duration } else { 1.0 };
        let t = self.duration.max(1e-9);
        for i in 0..self.goal.len() {
            let c = &self.offset[i];
            let (e, e2) = if x >= 1.0 {
                (0.0, 0.0)
            } else {
                (
                    c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5])))),
                    (2.0 * c[2] + x * (6.0 * c[3] + x * (12.0 * c[4] + x * 20.0 * c[5]))) / (t * t),
                )
            };
            self.desired[i] = self.goal[i] + e;
            self.acceleration[i] = pace * pace * e2;
        }
        if self.reference.linearize(&self.tensions, q, curvatures, &mut self.swing).is_err() {
            return;
        }
        self.damp(h);
        if self.kind == Kind::Rest && !on_path && self.holds_tip == Some(false) {
            (self.position, self.quaternion) = self.reference.rest().tip();
            self.holds_tip = Some(true);
        }
        if self.kind == Kind::Rest {
            self.last = (self.position, self.quaternion);
        }
        let steers_tip = match self.kind {
            Kind::Tip => self.solving.is_none(),
            Kind::Rest => self.holds_tip == Some(true),
            Kind::Shape => false,
        };
        let following = steers_tip && !on_path;
        let kappa = self.reference.rest().curvatures();
        let (mut tip, mut drift_weight) = (None, 1.0);
        if following {
            // As far as nothing else is at stake, the posture stays.
            self.drift.fill(0.0);
            drift_weight = self.inverse.effort();
            let at = self.reference.rest().tip();
            let lacks = pose_error(&at, &self.last.0, &self.last.1);
            let moved = pose_error(&(self.position, self.quaternion), &self.last.0, &self.last.1);
            let share = (h / self.approach_s).min(1.0);
            let gap = Vector3::new(lacks[0], lacks[1], lacks[2]).norm();
            let turn = Vector3::new(lacks[3], lacks[4], lacks[5]).norm();
            let least = |size: f64, most: f64| if share * size > most { most / size } else { share };
            let (sr, st) = (least(gap, self.settings.speed_mps * h), least(turn, self.settings.turn_rate_radps * h));
            let mut change = [0.0; POSE];
            for r in 0..POSE {
                change[r] = moved[r] - if r < 3 { sr } else { st } * lacks[r];
            }
            let weights = pose_weights(self.reference.rest().jacobian(), kappa.len(), self.settings.attitude_length_m);
            tip = Some((change, weights));
            self.desired.copy_from_slice(kappa);
        } else {
            // Back to the path as slowly as anywhere.
            let lacks = self.bend_between(kappa, &self.before_desired);
            let share = (h / self.approach_s).min(1.0);
            let most = self.settings.bend_rate_radps * h;
            let back = if share * lacks > most { most / lacks } else { share };
            for i in 0..self.drift.len() {
                self.drift[i] = self.desired[i] - self.before_desired[i] + back * (self.before_desired[i] - kappa[i]);
            }
            // What obstacles held back is not made up for faster than any way is gone.
            let far = self.reference.farthest(&self.drift);
            if far > self.settings.speed_mps * h {
                self.drift.iter_mut().for_each(|d| *d *= self.settings.speed_mps * h / far);
            }
        }
        let wanted = Wanted { drift: &self.drift, drift_weight, tip };
        self.met = self.reference.step(h, &wanted, around);
        for (c, (r, a)) in self.command.iter_mut().zip(self.reference.rest().curvatures().iter().zip(&self.answer)) {
            *c = r + a;
        }
        for (rate, delta) in self.rate.iter_mut().zip(self.reference.delta()) {
            *rate = delta / h;
        }
        if following {
            self.goal.copy_from_slice(self.reference.rest().curvatures());
            self.desired.copy_from_slice(&self.goal);
            self.acceleration.fill(0.0);
        }
    }
}

/// Time constant with which another pace is taken on (s).
const PACE_S: f64 = 0.3;
/// Over the inverse of the first angular frequency: time constants of the mean that a swing goes about, with which the answer
/// to a swing fades, and with which the reference makes up for what it lacks.
const MEAN: f64 = 2.35;
const FADE: f64 = 1.57;
const APPROACH: f64 = 0.78;
/// Time after which a path that is blocked is given up for the target itself (s).
const GIVE_UP_S: f64 = 1.0;
/// A posture is reached within this (rad of bend).
const ARRIVED_RAD: f64 = 0.01;
/// Time after a path without its goal from which it is not waited for (s).
const STUCK_S: f64 = 5.0;
/// Starts tried after the first.
const STARTS: usize = 6;

/// Rotation vector (rad, frame of `a`) that takes attitude `a` to `b` the short way.
fn rotation_between(a: &Vector4<f64>, b: &Vector4<f64>) -> Vector3<f64> {
    let d = product(&conjugate(a), b);
    let sign = if d[0] < 0.0 { -1.0 } else { 1.0 };
    let v = Vector3::new(d[1], d[2], d[3]) * sign;
    let sine = v.norm();
    v * if sine > 1e-9 { 2.0 * sine.atan2(d[0].abs()) / sine } else { 2.0 }
}
