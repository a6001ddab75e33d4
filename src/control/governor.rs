//! From whatever target is given to a reference that the arm may follow: bounded in speed and acceleration, always
//! continuous, in the arm's own coordinates.
//!
//! The reference is a posture: mean curvatures `kappa_ref(t) = kappa_goal(t) + e(t)`. `kappa_goal` is the posture that
//! reaches the target, by inverse statics, continuous with where the arm is and following a target that moves. `e` is what
//! a step of the target left, a quintic that fades to zero with rate and acceleration (Flash and Hogan 1985), over a time
//! in which no point of the arm exceeds the limits. A straight line in space may leave the reachable set; one in
//! curvatures does not.

use super::follower::{Follower, Limits, Moved};
use super::pace::Pace;
use super::path::{Path, Way};
use super::reach::Reach;
use super::tip_offset::TipOffset;
use crate::config::{ArmConfig, GovernorConfig, ObserverConfig, OutOfReach, PlannerConfig, Scale};
use crate::estimator::PositionCovariance;
use crate::model::Arm;
use crate::posture::{
    InverseSettings, Met, POSE, Reference, ReferenceSettings, RestingArm, Search, Surroundings, Wanted, pose_error,
    pose_weights, segment_lengths,
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
/// Root mean square speed of the arm's mass up to which a tip keeps its task, over the arm's length (1/s).
const QUIET: f64 = 0.04;
/// Largest standard deviation of a position that obstacles are given way for, over the arm's length: an arm that swings because it
/// dodges must not dodge the more for it.
const SIGMA_MAX: f64 = 0.0025;
/// Acceleration of a tip that follows a target, over that of a path.
const FOLLOWING: f64 = 10.0;
/// How far from obstacles the reference begins to look at them, over the arm's length.
const REACH: f64 = 0.11;
/// Iterations of inverse statics for a new target, a tick.
const ITERATIONS_PER_TICK: usize = 2;
/// The governor of one arm. [`Governor::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Governor {
    settings: GovernorConfig,
    /// Time constants (s) of the mean that a swing goes about, of the answer to it, and of the way back.
    mean_s: f64,
    fade_s: f64,
    approach_s: f64,
    /// A target that moves by more than this at once is a step (m).
    step_m: f64,
    /// The search for the posture of a new target, and the way to it.
    search: Search,
    way: Way,
    /// Length of the segment of each curvature (m).
    length: Vec<f64>,
    tensions: Vec<f64>,
    kind: Kind,
    /// The tip's target, with the limits on its motion.
    follower: Follower,
    /// At rest after a tip target: the tip is held, and whether it is already known where.
    holds_tip: Option<bool>,
    /// How near the arm gets to the tip target; `None` while that is looked for.
    reach: Option<Reach>,
    /// Time for which a tip target that is followed has been missed with nothing in the way (s).
    missed_s: f64,
    /// Between target and where the tip is led.
    offset: TipOffset,
    /// What lasts of what the estimate lacks of the tip, and what it lacks now (m, base frame).
    lasting: Vector3<f64>,
    lacks: Vector3<f64>,
    goal: Vec<f64>,
    /// `e`.
    path: Path,
    /// What the path wants, at this tick and the one before (1/m).
    desired: Vec<f64>,
    before_desired: Vec<f64>,
    reference: Reference,
    covariance: PositionCovariance,
    sigmas: f64,
    /// Largest standard deviation that obstacles are given way for (m).
    sigma_max_m: f64,
    doubt: Vec<f64>,
    possible_swing_m: f64,
    rate: Vec<f64>,
    acceleration: Vec<f64>,
    drift: Vec<f64>,
    command: Vec<f64>,
    /// Of [`Governor::damp`]: swing as curvatures, its mean, the answer (1/m).
    swing: Vec<f64>,
    mean: Vec<f64>,
    answer: Vec<f64>,
    /// Pace at which targets are approached: 1 unless something asks to slow down.
    pace: Pace,
    /// Target of the tick before, as it was given.
    wished: (Vector3<f64>, Vector4<f64>),
    met: Met,
    /// Time for which the way has been blocked (s).
    blocked_s: f64,
    /// Time for which the reference has not come nearer to the goal after its path (s).
    stuck_s: f64,
    blocked: bool,
}

impl Governor {
    /// For an arm. Allocates.
    pub fn new(
        arm: &Arm,
        config: &ArmConfig,
        settings: &GovernorConfig,
        planner: &PlannerConfig,
        observer: &ObserverConfig,
    ) -> Self {
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
        // A lead of the user's own says how far behind its target the tip is to come.
        let along_after_s = planner.lead_s.is_none().then(|| scale.time_s(FADE));
        let count = 2 * arm.segment_count();
        let length = segment_lengths(arm);
        Self {
            settings: *settings,
            mean_s: scale.time_s(MEAN),
            fade_s: scale.time_s(FADE),
            approach_s: scale.time_s(APPROACH),
            step_m: STEP * config.length_m(),
            search: Search::new(arm, &inverse, &tension_range_n),
            way: Way::new(arm, &length),
            length,
            tensions: vec![tension_n; arm.cable_count()],
            kind: Kind::Rest,
            follower: Follower::default(),
            holds_tip: None,
            reach: None,
            missed_s: 0.0,
            offset: TipOffset::new(scale.time_s(MEAN), along_after_s, OFFSET_MAX * config.length_m()),
            lasting: Vector3::zeros(),
            lacks: Vector3::zeros(),
            goal: vec![0.0; count],
            path: Path::new(count),
            desired: vec![0.0; count],
            before_desired: vec![0.0; count],
            reference: Reference::new(arm, config, planner.body_radius_m, &around),
            covariance: PositionCovariance::new(arm, observer),
            sigmas: observer.margin_sigmas,
            sigma_max_m: SIGMA_MAX * config.length_m(),
            doubt: vec![0.0; arm.elements.len()],
            possible_swing_m: 0.0,
            rate: vec![0.0; count],
            acceleration: vec![0.0; count],
            drift: vec![0.0; count],
            command: vec![0.0; count],
            swing: vec![0.0; count],
            mean: vec![0.0; count],
            answer: vec![0.0; count],
            pace: Pace::new(settings),
            wished: (Vector3::zeros(), Vector4::new(1.0, 0.0, 0.0, 0.0)),
            met: Met::default(),
            blocked_s: 0.0,
            stuck_s: 0.0,
            blocked: false,
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

    /// The swing that there may be, of the tip (m, peak to peak).
    pub fn set_swing(&mut self, swing_m: f64) {
        self.possible_swing_m = swing_m;
    }

    /// The estimated tip beside the reference's of as long ago as that is ahead of the arm, and what the estimate is known to
    /// lack of the tip: what lasts of it, and what it is now where that is measured (all m, base frame).
    pub fn see_tip(&mut self, beside_m: Vector3<f64>, lasting_m: Vector3<f64>, lacks_m: Option<Vector3<f64>>) {
        self.offset.see(beside_m);
        (self.lasting, self.lacks) = (lasting_m, lacks_m.unwrap_or(lasting_m));
    }

    /// Takes over what friction leaves of the tensions at each passage, see [`Arm::take_shares`].
    pub fn take_shares(&mut self, shares: &[f64]) {
        self.reference.take_shares(shares);
    }

    /// What the position of each element may be off by (m): [`ObserverConfig::margin_sigmas`] standard deviations.
    pub fn doubt_m(&self) -> &[f64] {
        &self.doubt
    }

    /// How well the estimate knows where the arm is.
    pub const fn covariance(&self) -> &PositionCovariance {
        &self.covariance
    }

    /// What the answer to the arm's swing remembers (1/m): the swing's mean, the answer.
    pub fn memory(&mut self) -> [&mut [f64]; 2] {
        [&mut self.mean, &mut self.answer]
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

    /// Pace at which targets are to be approached, for supervision; evasion keeps its own.
    pub fn set_pace(&mut self, pace: f64) {
        self.pace.set_pace(pace);
    }

    /// Share of the configured speed that an operator asks for; the smaller of pace and scale counts.
    pub fn set_scale(&mut self, scale: f64) {
        self.pace.set_scale(scale);
    }

    /// What the last step met.
    pub fn met(&self) -> &Met {
        &self.met
    }

    /// What the tip is wanted at, with the limits on its motion.
    pub fn tip(&self) -> (Vector3<f64>, Vector4<f64>) {
        *self.follower.pose()
    }

    /// Time until the path of the last step ends (s), if nothing is in its way.
    pub fn remaining_s(&self) -> f64 {
        self.path.remaining_s()
    }

    /// Whether a new target is still being looked for.
    pub fn is_solving(&self) -> bool {
        self.search.is_under_way()
    }

    /// Whether the arm cannot follow, and the reference waits.
    pub fn is_blocked(&self) -> bool {
        self.blocked
    }

    /// Whether a way to mean curvatures (1/m) is over, and the reference is there.
    pub fn has_arrived(&self, curvatures: &[f64]) -> bool {
        // What is let go of on its way swings.
        let rate = self.rate.iter().zip(&self.length).map(|(rate, length)| rate.abs() * length).fold(0.0, f64::max);
        self.kind == Kind::Shape
            && !self.on_path()
            && self.way.bend_between(self.reference(), curvatures) < ARRIVED_RAD
            && rate * self.approach_s < ARRIVING_RAD
    }

    /// Whether a way is over without having led to its goal.
    pub fn is_stuck(&self) -> bool {
        self.stuck_s > STUCK_S
    }

    /// Starts from where the arm is, a shape `q` with multipliers and mean curvatures (1/m), at rest.
    pub fn restart(&mut self, q: &[f64], lambda: &[f64], curvatures: &[f64]) {
        self.kind = Kind::Rest;
        self.holds_tip = None;
        self.search.cancel();
        self.reach = None;
        self.pace.restart();
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
        self.path.end();
        self.offset.restart();
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
        self.pace.advance(h);
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
        if !self.is_refused() {
            self.reach = None;
        }
        self.kind = Kind::Rest;
        self.search.cancel();
        // As far as the present rates carry while they fade, at four times the acceleration of a path.
        let speed = self.way.speed(self.reference.rest().curvatures(), &self.rate);
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
        self.search.cancel();
        self.reach = None;
        for i in 0..self.goal.len() {
            // What no cable moves is left as it is.
            self.goal[i] = if self.reference.rest().is_moved(i) { kappa[i] } else { self.reference()[i] };
        }
        if new {
            self.begin(None);
        }
    }

    /// Limits of a tip that follows, at the present pace.
    fn limits(&self) -> Limits {
        let GovernorConfig { speed_mps, acceleration_mps2, turn_rate_radps, .. } = self.settings;
        // In the time in which the speed is taken on, the turn rate is.
        let acceleration = FOLLOWING * acceleration_mps2;
        Limits {
            position: [self.pace.now() * speed_mps, acceleration],
            attitude: [self.pace.now() * turn_rate_radps, acceleration * turn_rate_radps / speed_mps],
        }
    }

    fn follow_tip(&mut self, h: f64, position: &Vector3<f64>, quaternion: &Vector4<f64>) {
        let wished = (*position, *quaternion);
        let moved = Moved::between(&self.wished, &wished);
        self.wished = wished;
        let following = self.kind == Kind::Tip && !self.search.is_under_way();
        if following && !self.path.is_under_way() {
            self.offset.follow(h, &moved.way);
        }
        let unled = (position - self.lasting, *quaternion);
        let led = (self.offset.lead(&unled.0), *quaternion);
        // One that runs faster than the limit leaves the arm behind, and is no step for that; once it no longer does, the
        // rest of the way is a path.
        let limits = self.limits();
        let is_step = |(gap, turn): (f64, f64)| gap > self.step_m || turn > STEP_RAD;
        let runs = moved.way.norm() > limits.position[0] * h || moved.turn.norm() > limits.attitude[0] * h;
        let jumps = is_step((moved.way.norm(), moved.turn.norm()));
        if self.kind != Kind::Tip || jumps || (!runs && is_step(self.follower.lacks(&led, &moved, h, &limits))) {
            self.kind = Kind::Tip;
            self.offset.restart();
            self.follower.place(unled);
            self.reach = None;
            self.missed_s = 0.0;
            self.search.begin(self.reference.rest());
        } else {
            self.follower.follow(h, &led, &moved, &limits);
        }
        let (position, quaternion) = self.follower.pose();
        if self.search.is_under_way() {
            self.solve();
        } else if self.path.is_under_way()
            && self.follower.before().0 != *position
            && self.search.inverse_mut().iterate(&self.tensions, position, quaternion).is_ok()
        {
            self.goal.copy_from_slice(self.search.inverse_mut().rest().curvatures());
        }
    }

    fn solve(&mut self) {
        let (target, reach_m) = (*self.follower.pose(), self.settings.reach_m);
        let attitude_length_m = self.settings.attitude_length_m;
        let of = |rest: &RestingArm, load: f64| Reach::of(rest, load, &target, reach_m, attitude_length_m);
        let error = |rest: &RestingArm, load: f64| of(rest, load).error_m(reach_m, attitude_length_m);
        let ended =
            (0..ITERATIONS_PER_TICK).any(|_| self.search.iterate(&self.tensions, &target.0, &target.1, reach_m, error));
        if !ended {
            return;
        }
        let Some((best, load)) = self.search.best() else {
            // No equilibrium at all was found on the way there.
            self.reach = Some(Reach { is_out: true, ..of(self.reference.rest(), 0.0) });
            return;
        };
        self.reach = Some(of(best, load));
        // A target that is refused moves nothing.
        if self.settings.out_of_reach == OutOfReach::Approach || !self.reach.is_some_and(|reach| reach.is_out) {
            self.goal.copy_from_slice(best.curvatures());
            self.begin(None);
        }
    }

    fn reach_of(&self, rest: &RestingArm, load: f64) -> Reach {
        Reach::of(rest, load, self.follower.pose(), self.settings.reach_m, self.settings.attitude_length_m)
    }

    /// How near the arm gets to the tip target; `None` without one, or while that is looked for. Of a target that was refused
    /// it stays until there is another.
    pub fn reach(&self) -> Option<&Reach> {
        self.reach.as_ref()
    }

    /// Whether the target is farther away than the arm reaches.
    pub fn is_out_of_reach(&self) -> bool {
        self.kind == Kind::Tip && self.reach.is_some_and(|reach| reach.is_out)
    }

    /// Whether the target is out of reach and is not to be approached: the arm is to hold.
    pub fn is_refused(&self) -> bool {
        self.settings.out_of_reach == OutOfReach::Refuse && self.is_out_of_reach()
    }

    /// While a target is followed: whether it has left the reach, or is back. What an obstacle, or the arm's lag, keeps from it
    /// has not.
    fn watch_reach(&mut self, h: f64) {
        let now = self.reach_of(self.reference.rest(), self.met.load_max);
        if now.is_out && !self.met.hindered {
            self.missed_s += h;
        } else if !now.is_out {
            self.missed_s = 0.0;
        }
        let was_out = self.is_out_of_reach();
        let is_out = now.is_out && (was_out || self.missed_s > MISSED_S);
        self.reach = Some(Reach { is_out, ..now });
    }

    /// Makes `e` what lies between reference and goal, with the reference's motion, and fade; within a time that is given, at
    /// the limits of a path without one.
    fn begin(&mut self, duration_s: Option<f64>) {
        // The path's own time goes by at the pace: a given time is one of the clock.
        let pace = self.pace.now();
        let kappa = self.reference.rest().curvatures();
        let own_s = duration_s.map_or_else(
            || {
                let speed = self.way.speed(kappa, &self.rate);
                self.way.duration_s(kappa, &self.goal, pace * speed, &self.settings)
            },
            |clock_s| pace * clock_s,
        );
        let offset = kappa.iter().zip(&self.goal).map(|(kappa, goal)| kappa - goal);
        let motion = self.rate.iter().zip(&self.acceleration);
        self.path.begin(
            own_s,
            pace,
            offset.zip(motion).map(|(offset, (rate, acceleration))| (offset, *rate, *acceleration)),
        );
        self.blocked_s = 0.0;
        self.desired.copy_from_slice(kappa);
        self.before_desired.copy_from_slice(&self.desired);
    }

    /// Whether a path after a step is under way.
    fn on_path(&self) -> bool {
        self.path.is_under_way()
    }

    fn move_on(&mut self, h: f64, q: &[f64], curvatures: &[f64], around: Option<&Surroundings<'_>>) {
        let full_pace = self.pace.now();
        let mut pace = full_pace;
        self.blocked = false;
        let on_path = self.on_path();
        if on_path {
            // Both what the reference lacks of the path, because of obstacles, and what the arm lacks of the reference.
            let error = self
                .way
                .bend_between(self.reference(), curvatures)
                .max(2.0 * self.way.bend_between(self.reference(), &self.desired));
            let free = (2.0 - error / BLOCKED_RAD).clamp(0.0, 1.0);
            pace *= free;
            self.blocked = free < 0.5;
            self.blocked_s = if self.blocked { self.blocked_s + h } else { 0.0 };
        }
        self.path.advance(pace * h);
        if self.blocked_s > GIVE_UP_S {
            self.path.give_up();
        }
        let away = self.kind == Kind::Shape && self.way.bend_between(self.reference(), &self.goal) > ARRIVED_RAD;
        self.stuck_s = if away && !on_path { self.stuck_s + full_pace * h } else { 0.0 };
        for i in 0..self.goal.len() {
            let (e, e2) = self.path.at(i);
            self.desired[i] = self.goal[i] + e;
            self.acceleration[i] = pace * pace * e2;
        }
        if self.reference.linearize(&self.tensions, q, curvatures, &mut self.swing).is_err() {
            return;
        }
        self.damp(h);
        self.covariance.update(curvatures, self.reference.ends(), self.possible_swing_m, &self.lacks);
        let sigma = self.covariance.element_sigma_m();
        let most_m = self.sigma_max_m;
        self.doubt.iter_mut().zip(sigma).for_each(|(doubt, sigma)| *doubt = self.sigmas * sigma.min(most_m));
        self.reference.set_doubt(&self.doubt);
        if self.kind == Kind::Rest && !on_path && self.holds_tip == Some(false) {
            self.follower.place(self.reference.rest().tip());
            self.holds_tip = Some(true);
        }
        let steers_tip = match self.kind {
            Kind::Tip => !self.search.is_under_way() && !self.is_refused(),
            Kind::Rest => self.holds_tip == Some(true),
            Kind::Shape => false,
        };
        let following = steers_tip && !on_path;
        let kappa = self.reference.rest().curvatures();
        let (mut tip, mut drift_weight) = (None, 1.0);
        if following {
            // As far as nothing else is at stake, the posture stays.
            self.drift.fill(0.0);
            drift_weight = self.search.effort();
            let at = self.reference.rest().tip();
            let (before, now) = (self.follower.before(), self.follower.pose());
            let lacks = pose_error(&at, &before.0, &before.1);
            let moved = pose_error(now, &before.0, &before.1);
            let share = (h / self.approach_s).min(1.0);
            let gap = Vector3::new(lacks[0], lacks[1], lacks[2]).norm();
            let turn = Vector3::new(lacks[3], lacks[4], lacks[5]).norm();
            let least = |size: f64, most: f64| if share * size > most { most / size } else { share };
            let limits = self.limits();
            let (sr, st) = (least(gap, limits.position[0] * h), least(turn, limits.attitude[0] * h));
            let mut change = [0.0; POSE];
            for r in 0..POSE {
                change[r] = moved[r] - if r < 3 { sr } else { st } * lacks[r];
            }
            let weights = pose_weights(self.reference.rest().jacobian(), kappa.len(), self.settings.attitude_length_m);
            tip = Some((change, weights));
            self.desired.copy_from_slice(kappa);
        } else {
            // Back to the path as slowly as anywhere.
            let lacks = self.way.bend_between(kappa, &self.before_desired);
            let share = (h / self.approach_s).min(1.0);
            let most = full_pace * self.settings.bend_rate_radps * h;
            let back = if share * lacks > most { most / lacks } else { share };
            for i in 0..self.drift.len() {
                self.drift[i] = self.desired[i] - self.before_desired[i] + back * (self.before_desired[i] - kappa[i]);
            }
            // What obstacles held back is not made up for faster than any way is gone.
            let (far, most) = (self.reference.farthest(&self.drift), full_pace * self.settings.speed_mps * h);
            if far > most {
                self.drift.iter_mut().for_each(|d| *d *= most / far);
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
            if self.kind == Kind::Tip {
                self.watch_reach(h);
            }
        }
    }
}

/// Time for which a target that is followed may be missed before it counts as out of reach (s).
const MISSED_S: f64 = 1.0;
/// Over the inverse of the first angular frequency: time constants of the mean that a swing goes about, with which the answer
/// to a swing fades, and with which the reference makes up for what it lacks.
const MEAN: f64 = 2.35;
/// Farthest that a tip is led beside its target, over the arm's length.
const OFFSET_MAX: f64 = 0.004;
const FADE: f64 = 1.57;
const APPROACH: f64 = 0.78;
/// Time after which a path that is blocked is given up for the target itself (s).
const GIVE_UP_S: f64 = 1.0;
/// A posture is reached within this (rad of bend), and by a reference that would not go farther than this on its own.
const ARRIVED_RAD: f64 = 0.01;
const ARRIVING_RAD: f64 = 0.001;
/// Time after a path without its goal from which it is not waited for (s).
const STUCK_S: f64 = 5.0;
