//! The controller's cycle and the true arm in one process: no bus, no clock, no other process.
//!
//! For campaigns that need thousands of seconds of arm time, and for tests that look at what the true arm does. Everything
//! on the control thread is the daemon's own ([`sinew::control::Cycle`] with observer, governor, planner, guard); what is
//! left out is the wire.

use crate::truth::{Truth, TruthSettings};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::config::{Config, ScenarioConfig};
use sinew::control::{CableMask, Record};
use sinew::control::{
    Cycle, DrivesCommand, DrivesInput, DrivesPhase, EncoderReadings, Mode, ObstacleDemand, ObstaclePair, Request,
    Settings, TargetInput, TickInputs, TickOutput,
};
use sinew::estimator::Observer;
use sinew::model::Arm;
use sinew::scenario::Course;

/// How a drive differs from what the controller's configuration says of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lie {
    /// Tension at the cable over the one commanded. A cable does not push: 0 where the drive turns the other way.
    pub pull: f64,
    /// Motion that the encoder shows over the cable's own, from the straight arm on.
    pub shows: f64,
    /// Length (m) by which the cable slips on its drum for each metre that is pulled in; the encoder shows the drum.
    pub slip: f64,
}

impl Lie {
    /// None.
    pub const NONE: Self = Self { pull: 1.0, shows: 1.0, slip: 0.0 };
    /// Motor and encoder wired the other way round.
    pub const BACKWARDS: Self = Self { pull: 0.0, shows: -1.0, slip: 0.0 };

    /// The gear is `factor` times the one configured.
    pub const fn gear(factor: f64) -> Self {
        Self { pull: factor, shows: factor, slip: 0.0 }
    }
}

/// A controller with its arm.
pub struct Bench {
    /// The controller.
    pub cycle: Cycle<Observer>,
    /// The arm.
    pub truth: Truth,
    /// Target of the next tick.
    pub target: Option<TargetInput>,
    /// Obstacles of the next tick.
    pub obstacles: ObstaclePair,
    /// What the obstacles' sources ask for.
    pub demand: ObstacleDemand,
    /// Lies of the drives, one per cable.
    pub lies: Vec<Lie>,
    /// Why the plant could not go on; it stays where it was.
    pub broken: Option<String>,
    /// Largest change of a tension per second while the planner was at work (N/s).
    pub tension_rate_max_nps: f64,
    /// Whether brakes hold the arm.
    braked: bool,
    start_n: Vec<f64>,
    straight_m: Vec<f64>,
    before_m: Vec<f64>,
    slipped_m: Vec<f64>,
    shown_m: Vec<f64>,
    pulled_n: Vec<f64>,
    told_n: Vec<f64>,
    drives: DrivesPhase,
    tick: u64,
    period_s: f64,
    rng: Xoshiro256PlusPlus,
}

impl Bench {
    /// Drives off; the arm rests, straight or where [`Truth::start_at_equilibrium`] takes it.
    pub fn new(config: &Config, settings: &Settings, truth: &TruthSettings) -> Self {
        let period_s = config.timing.period_s;
        let observer = Observer::new(&config.arm, &config.observer, period_s);
        let arm = Arm::new(&config.arm);
        let cables = arm.cable_count();
        let mut straight_m = vec![0.0; cables];
        arm.cable_lengths_into(&arm.straight(), &mut straight_m);
        Self {
            cycle: Cycle::new(settings, observer),
            truth: Truth::new(&config.arm, truth),
            target: None,
            obstacles: ObstaclePair::new(),
            demand: ObstacleDemand::Proceed,
            lies: vec![Lie::NONE; cables],
            broken: None,
            tension_rate_max_nps: 0.0,
            braked: true,
            start_n: settings.start_tensions_n.clone(),
            before_m: straight_m.clone(),
            shown_m: straight_m.clone(),
            straight_m,
            slipped_m: vec![0.0; cables],
            pulled_n: vec![0.0; cables],
            told_n: vec![0.0; cables],
            drives: DrivesPhase::Off,
            tick: 0,
            period_s,
            rng: Xoshiro256PlusPlus::seed_from_u64(truth.seed),
        }
    }

    /// At rest where a scenario starts, drives off.
    ///
    /// # Errors
    /// The arm has no such equilibrium.
    pub fn at_start_of(scenario: &ScenarioConfig, config: &Config, truth: &TruthSettings) -> Result<Self, String> {
        let mut settings = Settings::new(config);
        let (state, tensions) = Course::new(scenario).start(&config.arm).map_err(|error| error.to_string())?;
        settings.start_tensions_n = tensions.iter().map(|u| u.max(config.arm.tension_n_min)).collect();
        let arm = Arm::new(&config.arm);
        let mut k = vec![0.0; 2 * arm.segment_count()];
        arm.curvatures_into(&state.q, &state.qd, &mut k, &mut vec![0.0; 2 * arm.segment_count()]);
        let mut bench = Self::new(config, &settings, truth);
        bench.truth.start_at_equilibrium(&settings.start_tensions_n, &k).map_err(|error| error.to_string())?;
        Ok(bench)
    }

    /// Time (s) of the next tick.
    pub fn time_s(&self) -> f64 {
        self.tick as f64 * self.period_s
    }

    /// One tick, then the arm for a period.
    pub fn step(&mut self, request: Option<Request>) -> TickOutput {
        self.tick += 1;
        let now_ns = (self.time_s() * 1e9).round() as u64;
        let cables = self.truth.lengths().len();
        self.show();
        let inputs = TickInputs {
            tick: self.tick,
            now_ns,
            missed: 0,
            encoders: EncoderReadings { lengths_m: &self.shown_m, valid: CableMask::first(cables), capture_ns: now_ns },
            // A drive measures its own current: what it was told, whatever its gear.
            tensions_measured_n: &self.told_n,
            obstacles: &self.obstacles,
            demand: self.demand,
            target: self.target,
            drives: DrivesInput { phase: self.drives, ready: true, fault: None, bus_lost: None, emergency_stop: None },
            request,
        };
        let output = self.cycle.tick(&inputs, &mut self.rng, &mut || false);
        self.cycle.report(&inputs);
        let on = output.drives == DrivesCommand::On;
        self.drives = if on { DrivesPhase::Enabled } else { DrivesPhase::Off };
        // Brakes hold the arm where it is until the cables have their start tensions.
        self.braked &= self.cycle.tensions_n() != self.start_n;
        if self.braked {
            return output;
        }
        if self.cycle.supervisor().is_planning() {
            let changes = self.cycle.tensions_n().iter().zip(&self.told_n).map(|(now, before)| (now - before).abs());
            self.tension_rate_max_nps =
                changes.fold(0.0, f64::max).max(self.tension_rate_max_nps * self.period_s) / self.period_s;
        }
        self.told_n.copy_from_slice(self.cycle.tensions_n());
        let told = self.told_n.iter().zip(&self.lies);
        self.pulled_n.iter_mut().zip(told).for_each(|(pulled, (told, lie))| *pulled = told * lie.pull);
        if let Err(error) = self.truth.step(&self.pulled_n, self.period_s) {
            let time_s = self.time_s();
            self.broken.get_or_insert_with(|| format!("at {time_s:.2} s: {error}"));
        }
        output
    }

    /// What the encoders show.
    fn show(&mut self) {
        for (cable, (&length, lie)) in self.truth.lengths().iter().zip(&self.lies).enumerate() {
            let pulled_in = self.before_m[cable] - length;
            self.before_m[cable] = length;
            if pulled_in > 0.0 {
                self.slipped_m[cable] += lie.slip * pulled_in;
            }
            self.shown_m[cable] =
                self.straight_m[cable] + lie.shows * (length - self.straight_m[cable]) - self.slipped_m[cable];
        }
    }

    /// Record of the last tick.
    pub fn record(&mut self) -> &Record {
        self.cycle.record_mut()
    }

    /// Arms and waits for the hold.
    ///
    /// # Errors
    /// What ended it instead.
    pub fn arm(&mut self, most_s: f64) -> Result<(), String> {
        let mut request = Some(Request::Arm);
        for _ in 0..(most_s / self.period_s) as usize {
            match self.step(request.take()).mode {
                Mode::Holding => return Ok(()),
                Mode::Faulted => break,
                _ => {}
            }
        }
        match self.cycle.supervisor().latch().first {
            Some(latched) => Err(format!("{}", latched.fault)),
            None => Err("no hold".into()),
        }
    }
}
