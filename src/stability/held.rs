//! Arm and controller together, at rest where the controller holds the arm.

use super::StabilityError;
use super::plant::{Differs, Plant};
use super::posture::{TensionBox, at_curvatures, reach};
use crate::config::Config;
use crate::control::{
    CURVATURES_MAX, CableMask, Cycle, DrivesCommand, DrivesInput, DrivesPhase, EncoderReadings, Estimate, Estimator,
    EstimatorFailure, Mode, ObstacleDemand, ObstaclePair, Request, Settings, Target, TargetInput, TickInputs,
};
use crate::estimator::{Kept, Observer};
use crate::model::{Arm, State};
use crate::posture::RestingArm;
use nalgebra::{Vector3, Vector4};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Where the arm is held.
#[derive(Debug, Clone, PartialEq)]
pub enum Place {
    /// At rest under the least tensions, by a hold.
    Rest,
    /// With its tip at a pose that is followed.
    Pose {
        /// Position (m, base frame).
        position: Vector3<f64>,
        /// Unit quaternion (body to base).
        quaternion: Vector4<f64>,
        /// Mean curvatures (1/m) of the posture that reaches it; found where they are not given.
        curvatures: Option<Vec<f64>>,
    },
    /// At mean curvatures (1/m), `(y, z)` segment by segment, that are followed.
    Shape(Vec<f64>),
}

/// The observer, which is told where the arm is as long as that is led.
#[derive(Debug, Clone)]
struct Patient {
    observer: Observer,
    led: bool,
}

impl Estimator for Patient {
    fn start(&mut self, lengths_m: &[f64], tensions_n: &[f64]) -> Result<(), EstimatorFailure> {
        if self.led { Ok(()) } else { Estimator::start(&mut self.observer, lengths_m, tensions_n) }
    }

    fn update(&mut self, sent_n: &[f64], lengths_m: &[f64], periods: u32) -> Result<Estimate, EstimatorFailure> {
        if self.led {
            return Ok(Estimate { settled: true, ..Estimate::default() });
        }
        Estimator::update(&mut self.observer, sent_n, lengths_m, periods)
    }

    fn state(&self) -> &State {
        self.observer.state()
    }

    fn predicted(&self) -> &State {
        self.observer.predicted()
    }

    fn disturbance_n(&self) -> &[f64] {
        self.observer.disturbance()
    }
}

/// Longest start, way to a target, in ticks; and time (s) at its end.
const TICKS_MAX: usize = 20_000;
const AFTER_S: f64 = 1.0;
/// Iterations for the tensions that hold a posture before the start.
const START_ITERATIONS: usize = 60;
/// Newton iterations with which the arm is led, a tick.
const LEADING_ITERATIONS: usize = 2;
/// How often the arm is led beside the reference by what the estimate is off.
const BESIDE_ITERATIONS: usize = 2;
/// Steps in which the observer comes to rest, periods of each, and where it has (rad, rad/s).
const OBSERVER_STEPS_MAX: usize = 1500;
const OBSERVER_PERIODS: u32 = 5;
const SETTLED_RAD: f64 = 1e-9;
/// Ticks over which properties of the true arm are changed.
const CHANGE_TICKS: usize = 20;
/// Largest difference of a bend angle from the place's own that is still there (rad).
const THERE_RAD: f64 = 0.02;

/// A controller that holds an arm.
#[derive(Debug, Clone)]
pub struct Held {
    cycle: Cycle<Patient>,
    plant: Plant,
    /// The true arm in equilibrium at the reference's mean curvatures.
    leader: RestingArm,
    /// The model at the same mean curvatures, with the moments that it lacks beside those tensions.
    believed: RestingArm,
    /// By how much the arm is led beside the reference, so that the estimate is on it (1/m).
    beside: Vec<f64>,
    /// Tensions that hold it there (N).
    holding_n: Vec<f64>,
    box_n: TensionBox,
    target: Option<TargetInput>,
    obstacles: ObstaclePair,
    drives: DrivesPhase,
    tick: u64,
    period_s: f64,
    rng: Xoshiro256PlusPlus,
}

impl Held {
    /// Brings a loop to rest at a place, with an arm that is as its model says. Allocates.
    ///
    /// # Errors
    /// The place cannot be held, see [`StabilityError`].
    pub fn at(config: &Config, place: &Place) -> Result<Self, StabilityError> {
        let arm = Arm::new(&config.arm);
        let count = 2 * arm.segment_count();
        let curvatures = match place {
            Place::Rest => None,
            Place::Pose { position, quaternion, curvatures: None } => Some(reach(config, position, quaternion)?),
            Place::Pose { curvatures: Some(k), .. } | Place::Shape(k) => Some(k.clone()),
        };
        if let Some(k) = &curvatures
            && (k.len() != count || k.iter().any(|k| !k.is_finite()))
        {
            return Err(StabilityError::Shape { given: k.len(), wanted: count });
        }
        let mut settings = Settings::new(config);
        // Only a motion is told to be wrong, and here nothing moves.
        settings.supervision = settings.supervision.warning();
        let box_n = TensionBox::of(config);
        settings.start_tensions_n.fill(box_n.least_n + box_n.lift_n);
        let mut leader = RestingArm::new(&arm);
        if let Some(k) = &curvatures {
            leader = at_curvatures(config, &arm, k)
                .ok_or_else(|| StabilityError::NoRest("no equilibrium has these mean curvatures".to_owned()))?;
            settings.start_tensions_n = box_n.tensions(&arm, leader.moments(), 1.0)?;
            for _ in 0..START_ITERATIONS {
                box_n.lead(&mut leader, k, 1.0, &mut settings.start_tensions_n)?;
            }
        }
        let period_s = config.timing.period_s;
        let mut plant = Plant::new(&config.arm, period_s, config.observer.latency_ticks);
        plant.rest_near(&settings.start_tensions_n, &leader.state().q)?;
        leader.take_shape(&plant.state().q, &plant.state().lambda);
        let observer = Observer::new(&config.arm, &config.observer, period_s);
        let mut held = Self {
            cycle: Cycle::new(&settings, Patient { observer, led: true }),
            plant,
            believed: leader.clone(),
            leader,
            beside: vec![0.0; count],
            holding_n: settings.start_tensions_n.clone(),
            box_n,
            target: None,
            obstacles: ObstaclePair::new(),
            drives: DrivesPhase::Off,
            tick: 0,
            period_s,
            rng: Xoshiro256PlusPlus::seed_from_u64(1),
        };
        held.tell_observer()?;
        held.begin(&settings.start_tensions_n)?;
        held.target = target(place);
        if held.target.is_some() {
            held.go()?;
        }
        held.wait(AFTER_S)?;
        held.let_go()?;
        if let Some(k) = &curvatures {
            held.is_there(k, config)?;
        }
        Ok(held)
    }

    /// The same with an arm that differs from its model. Allocates.
    ///
    /// # Errors
    /// No equilibrium, or the controller lets go, on the way.
    pub fn with(&self, differs: &Differs) -> Result<Self, StabilityError> {
        let mut other = self.clone();
        let from = *self.plant.differs();
        let statics = (from.stiffness, from.pull) != (differs.stiffness, differs.pull);
        if statics {
            for tick in 1..=CHANGE_TICKS {
                other.plant.differ(&from.towards(differs, tick as f64 / CHANGE_TICKS as f64));
                let State { q, lambda, .. } = other.plant.state().clone();
                other.leader = RestingArm::new(other.plant.arm());
                other.leader.take_shape(&q, &lambda);
                other.lead(None)?;
            }
            other.wait(AFTER_S)?;
            for _ in 0..BESIDE_ITERATIONS {
                other.let_go()?;
                other.aim();
                other.lead(None)?;
            }
            other.let_go()?;
        }
        other.plant.differ(differs);
        Ok(other)
    }

    /// Period of the loop (s).
    pub const fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The true arm.
    pub const fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Commanded tensions that hold the arm (N).
    pub fn tensions_n(&self) -> &[f64] {
        &self.holding_n
    }

    /// Mode of the controller.
    pub const fn mode(&self) -> Mode {
        self.cycle.mode()
    }

    /// One tick of the controller, then of the arm. Allocates.
    ///
    /// # Errors
    /// The arm's step failed, or the controller leaves its mode.
    pub fn step(&mut self) -> Result<(), StabilityError> {
        self.cycle.estimator_mut().led = false;
        let before = self.cycle.mode();
        self.tick(None);
        if self.cycle.mode() != before {
            return Err(StabilityError::NoMap(self.why()));
        }
        self.plant.step(self.cycle.tensions_n())
    }

    /// Visits every number that arm and controller remember from tick to tick: the arm's first, then the observer's, then the
    /// controller's.
    pub fn memory(&mut self, visit: &mut dyn FnMut(Kept, &mut [f64])) {
        self.plant.memory(visit);
        self.cycle.estimator_mut().observer.memory(visit);
        self.cycle.memory(visit);
    }

    fn tick(&mut self, request: Option<Request>) {
        self.tick += 1;
        let now_ns = (1e9 * self.tick as f64 * self.period_s).round() as u64;
        let lengths_m = self.plant.lengths();
        let inputs = TickInputs {
            tick: self.tick,
            now_ns,
            missed: 0,
            encoders: EncoderReadings { lengths_m, valid: CableMask::first(lengths_m.len()), capture_ns: now_ns },
            tensions_measured_n: &[],
            obstacles: &self.obstacles,
            demand: ObstacleDemand::Proceed,
            tip: None,
            target: self.target,
            drives: DrivesInput { phase: self.drives, ready: true, fault: None, bus_lost: None, emergency_stop: None },
            request,
        };
        let output = self.cycle.tick(&inputs, &mut self.rng, &mut || false);
        let on = output.drives == DrivesCommand::On;
        self.drives = if on { DrivesPhase::Enabled } else { DrivesPhase::Off };
    }

    /// A tick after which the arm rests at the reference's mean curvatures, under tensions that hold it there: what the
    /// controller would send is not asked for. It plans for an arm with mass.
    fn lead(&mut self, request: Option<Request>) -> Result<(), StabilityError> {
        self.tick(request);
        if self.cycle.mode() == Mode::Faulted {
            return Err(StabilityError::NotHeld(self.why()));
        }
        if self.cycle.supervisor().is_planning() {
            let reference = self.cycle.governor().reference().to_vec();
            let wanted: Vec<f64> = reference.iter().zip(&self.beside).map(|(k, b)| k + b).collect();
            let pull = self.plant.differs().pull;
            for _ in 0..LEADING_ITERATIONS {
                self.box_n.lead(&mut self.leader, &wanted, pull, &mut self.holding_n)?;
            }
        }
        // What swings is nothing: all of it is the mean, and there is no answer. Tensions are what was sent.
        let (holding, swing, mut is_mean) = (&self.holding_n, self.cycle.governor().swing().to_vec(), true);
        self.cycle.memory(&mut |kept, values| match kept {
            Kept::Curvatures if is_mean => {
                values.copy_from_slice(&swing);
                is_mean = false;
            }
            Kept::Curvatures => values.fill(0.0),
            Kept::Tensions => values.copy_from_slice(holding),
            _ => {}
        });
        self.plant.rest_near(&self.holding_n, &self.leader.state().q)?;
        self.tell_observer()
    }

    /// Tells the observer that the arm rests where it is, with the moments that its model lacks there.
    fn tell_observer(&mut self) -> Result<(), StabilityError> {
        let wanted = self.leader.curvatures().to_vec();
        for _ in 0..LEADING_ITERATIONS {
            let singular = |_| StabilityError::NoRest("the model is at an instability".to_owned());
            self.believed.linearize(&self.holding_n).map_err(singular)?;
            self.believed.advance(&wanted);
        }
        let observer = &mut self.cycle.estimator_mut().observer;
        observer.resume(self.believed.state());
        observer.memory(&mut |kept, values| match kept {
            Kept::Moments => values.copy_from_slice(self.believed.moments()),
            Kept::Tensions => values.copy_from_slice(&self.holding_n),
            _ => {}
        });
        Ok(())
    }

    /// Lets the observer alone come to rest on the lengths that it sees.
    fn let_go(&mut self) -> Result<(), StabilityError> {
        let observer = &mut self.cycle.estimator_mut().observer;
        for _ in 0..OBSERVER_STEPS_MAX {
            let update = observer.update_over(&self.holding_n, self.plant.lengths(), OBSERVER_PERIODS);
            if update.failed {
                return Err(StabilityError::NotHeld("the observer's step fails".to_owned()));
            }
            if update.innovation_max < SETTLED_RAD && update.rate_max < SETTLED_RAD {
                break;
            }
        }
        Ok(())
    }

    /// Leads the arm by as much beside the reference as the estimate is off.
    fn aim(&mut self) {
        let state = self.cycle.estimator_mut().observer.state().clone();
        let mut found = self.beside.clone();
        let mut rates = found.clone();
        self.plant.arm().curvatures_into(&state.q, &state.qd, &mut found, &mut rates);
        let reference = self.cycle.governor().reference();
        for ((beside, found), wanted) in self.beside.iter_mut().zip(&found).zip(reference) {
            *beside += wanted - found;
        }
    }

    /// Arms an arm that brakes hold until its cables have their start tensions.
    fn begin(&mut self, start_n: &[f64]) -> Result<(), StabilityError> {
        let (mut request, mut braked) = (Some(Request::Arm), true);
        for _ in 0..TICKS_MAX {
            if braked {
                self.tick(request.take());
                braked = self.cycle.tensions_n() != start_n;
            } else {
                self.lead(None)?;
            }
            match self.cycle.mode() {
                Mode::Holding => return Ok(()),
                Mode::Faulted => break,
                _ => {}
            }
        }
        Err(StabilityError::NotHeld(self.why()))
    }

    /// To the target.
    fn go(&mut self) -> Result<(), StabilityError> {
        let mut request = Some(Request::Track);
        for _ in 0..TICKS_MAX {
            let first = request.is_some();
            self.lead(request.take())?;
            if self.cycle.mode() != Mode::Tracking {
                return Err(StabilityError::NotHeld(self.why()));
            }
            let governor = self.cycle.governor();
            if !first && !governor.is_solving() && governor.remaining_s() <= 0.0 {
                return self.wait(AFTER_S);
            }
        }
        Err(StabilityError::NotHeld("the way to it does not end".to_owned()))
    }

    fn wait(&mut self, time_s: f64) -> Result<(), StabilityError> {
        for _ in 0..(time_s / self.period_s).ceil() as usize {
            self.lead(None)?;
        }
        Ok(())
    }

    fn is_there(&self, curvatures: &[f64], config: &Config) -> Result<(), StabilityError> {
        let mut found = curvatures.to_vec();
        let mut rates = found.clone();
        let state = self.plant.state();
        self.plant.arm().curvatures_into(&state.q, &state.qd, &mut found, &mut rates);
        let length = |i: usize| config.arm.segments[i / 2].length_m;
        let off = (0..found.len()).map(|i| length(i) * (found[i] - curvatures[i]).abs()).fold(0.0, f64::max);
        // A pose may be held in a posture beside the one that was found first.
        if off > THERE_RAD && !matches!(self.target.map(|t| t.now), Some(Target::Tip { .. })) {
            return Err(StabilityError::NotHeld(format!("it rests {off:.3} rad of bend beside the shape")));
        }
        Ok(())
    }

    fn why(&self) -> String {
        match self.cycle.supervisor().latch().first {
            Some(latched) => latched.fault.to_string(),
            None => format!("it is {:?}", self.cycle.mode()),
        }
    }
}

fn target(place: &Place) -> Option<TargetInput> {
    let now = match place {
        Place::Rest => return None,
        Place::Pose { position, quaternion, .. } => Target::Tip {
            position_m: *position,
            quaternion: *quaternion,
            velocity_mps: Vector3::zeros(),
            angular_velocity_radps: Vector3::zeros(),
        },
        Place::Shape(k) => {
            let mut curvatures_1pm = [0.0; CURVATURES_MAX];
            curvatures_1pm.iter_mut().zip(k).for_each(|(to, k)| *to = *k);
            Target::Shape { curvatures_1pm, rates_1pms: [0.0; CURVATURES_MAX] }
        }
    };
    Some(TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true })
}
