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

/// The observer, which starts anew at every tick as long as the arm is led.
#[derive(Debug, Clone)]
struct Patient {
    observer: Observer,
    led: bool,
}

impl Estimator for Patient {
    fn start(&mut self, lengths_m: &[f64], tensions_n: &[f64]) -> Result<(), EstimatorFailure> {
        Estimator::start(&mut self.observer, lengths_m, tensions_n)
    }

    fn update(&mut self, sent_n: &[f64], lengths_m: &[f64], periods: u32) -> Result<Estimate, EstimatorFailure> {
        if self.led {
            Estimator::start(&mut self.observer, lengths_m, sent_n)?;
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
/// Newton iterations with which the arm is led, a tick.
const LEADING_ITERATIONS: usize = 2;
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
            settings.start_tensions_n = box_n.tensions(&arm, &leader, 1.0)?;
        }
        let period_s = config.timing.period_s;
        let mut plant = Plant::new(&config.arm, period_s, config.observer.latency_ticks);
        plant.rest_near(&settings.start_tensions_n, &leader.state().q)?;
        leader.take_shape(&plant.state().q, &plant.state().lambda);
        let observer = Observer::new(&config.arm, &config.observer, period_s);
        let mut held = Self {
            cycle: Cycle::new(&settings, Patient { observer, led: true }),
            plant,
            leader,
            holding_n: settings.start_tensions_n.clone(),
            box_n,
            target: None,
            obstacles: ObstaclePair::new(),
            drives: DrivesPhase::Off,
            tick: 0,
            period_s,
            rng: Xoshiro256PlusPlus::seed_from_u64(1),
        };
        held.begin(&settings.start_tensions_n)?;
        held.target = target(place);
        if held.target.is_some() {
            held.go()?;
        }
        held.wait(AFTER_S)?;
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

    /// Tensions sent (N).
    pub fn tensions_n(&self) -> &[f64] {
        self.cycle.tensions_n()
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
            let none = vec![self.box_n.least_n; self.holding_n.len()];
            for _ in 0..LEADING_ITERATIONS {
                let singular = |_| StabilityError::NoRest("the arm is at an instability".to_owned());
                self.leader.linearize(&none).map_err(singular)?;
                self.leader.advance(&reference);
            }
            self.holding_n = self.box_n.tensions(self.plant.arm(), &self.leader, self.plant.differs().pull)?;
        }
        let holding = &self.holding_n;
        self.cycle.memory(&mut |kept, values| {
            // Of the controller's numbers tensions are what it has sent.
            if kept == Kept::Tensions {
                values.copy_from_slice(holding);
            }
        });
        self.plant.rest_near(&self.holding_n, &self.leader.state().q)
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

