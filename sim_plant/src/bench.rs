//! The controller's cycle and the true arm in one process: no bus, no clock, no other process.
//!
//! For campaigns that need thousands of seconds of arm time, and for tests that look at what the true arm does. Everything
//! on the control thread is the daemon's own ([`sinew::control::Cycle`] with observer, governor, planner, guard); what is
//! left out is the wire.

use crate::truth::{Truth, TruthSettings};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::Shape;
use sinew::config::{Config, ObstacleConfig, SafeHold, ScenarioConfig};
use sinew::control::obstacles::Placement;
use sinew::control::{CableMask, Record};
use sinew::control::{
    Cycle, DrivesCommand, DrivesInput, DrivesPhase, EncoderReadings, Mode, ObstacleDemand, ObstaclePair, Request,
    STAY_LOOKAHEADS, Settings, TargetInput, TickInputs, TickOutput, TipReading,
};
use sinew::estimator::Observer;
use sinew::model::Arm;
use sinew::scenario::Course;
use std::collections::VecDeque;

/// Emergency code of a drive that trips.
const OVER_CURRENT: u32 = 0x2310;

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

/// A sensor of the tip's position, in the controller's clock.
#[derive(Debug, Clone)]
pub struct TipMeter {
    /// Standard deviation of each coordinate (m).
    pub sigma_m: f64,
    /// Time between two measurements (s).
    pub interval_s: f64,
    /// Time until one arrives (s).
    pub delay_s: f64,
    /// By how much all of them are off (m).
    pub off_m: [f64; 3],
    on_its_way: VecDeque<TipReading>,
    newest: Option<TipReading>,
}

impl TipMeter {
    /// A tracker: 50 measurements a second, 30 ms old.
    pub fn tracker(sigma_m: f64) -> Self {
        let (interval_s, delay_s) = (0.02, 0.03);
        Self { sigma_m, interval_s, delay_s, off_m: [0.0; 3], on_its_way: VecDeque::new(), newest: None }
    }

    /// What has arrived by `now_ns`, the tip being at `tip`.
    fn measure(&mut self, tip: Vector3<f64>, now_ns: u64, rng: &mut Xoshiro256PlusPlus) -> Option<TipReading> {
        let last_ns = self.on_its_way.back().or(self.newest.as_ref()).map(|reading| reading.capture_ns);
        if last_ns.is_none_or(|last_ns| (now_ns - last_ns) as f64 >= 1e9 * self.interval_s - 1e3) {
            let noise = Vector3::from_fn(|_, _| {
                let normal: f64 = StandardNormal.sample(rng);
                self.sigma_m * normal
            });
            self.on_its_way
                .push_back(TipReading { position_m: tip + noise + Vector3::from(self.off_m), capture_ns: now_ns });
        }
        while let Some(first) = self.on_its_way.front()
            && (now_ns - first.capture_ns) as f64 >= 1e9 * self.delay_s - 1e3
        {
            self.newest = self.on_its_way.pop_front();
        }
        self.newest
    }
}

/// What befalls drives, encoders or the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trouble {
    /// The loop's process is gone: the drives are on their own.
    Dead,
    /// The bus of these cables (first and one past the last) is lost: their drives are on their own, and the loop learns of it
    /// when they do.
    Bus(usize, usize),
    /// The drive of this cable trips and gives no torque.
    Trip(usize),
    /// The encoder of this cable is silent.
    Silent(usize),
    /// The encoder of this cable shows 50 mm more.
    Jump(usize),
    /// Every tick comes too late.
    Late,
}

/// What drives do without a master, by the configuration.
struct Alone {
    hold: Vec<SafeHold>,
    timeout_s: f64,
    safe_n: f64,
    /// Most that a tension changes in a tick (N).
    step_n: f64,
    /// Safe tensions of drives that are told them (N), the mean that they follow, its share of a tick, and the ticks between
    /// two that are told.
    told_n: Vec<f64>,
    mean_n: Vec<f64>,
    share: f64,
    turn: u64,
}

impl Alone {
    fn new(config: &Config) -> Self {
        let (drives, period_s) = (&config.drives, config.timing.period_s);
        let cables = config.arm.cable_count();
        Self {
            hold: drives.drives.iter().map(|drive| drive.safe_hold).collect(),
            timeout_s: drives.sync_timeout_s,
            safe_n: drives.safe_tension_n,
            step_n: config.arm.tension_n_max * period_s / drives.safe_ramp_s.max(1e-3),
            told_n: vec![0.0; cables],
            mean_n: vec![0.0; cables],
            share: period_s / (STAY_LOOKAHEADS * config.planner.lookahead_s + period_s),
            turn: (drives.read_back_s / period_s).ceil().max(1.0) as u64,
        }
    }

    /// A tick with a master that sends `tensions_n`.
    fn follow(&mut self, tick: u64, tensions_n: &[f64]) {
        self.mean_n.iter_mut().zip(tensions_n).for_each(|(mean, u)| *mean += self.share * (u - *mean));
        if tick.is_multiple_of(self.turn) {
            let cable = (tick / self.turn) as usize % self.told_n.len();
            self.told_n[cable] = self.mean_n[cable];
        }
    }

    /// The tension (N) that follows `u` without a master.
    fn next(&self, cable: usize, u: f64) -> f64 {
        let goal = match self.hold[cable] {
            SafeHold::Hold | SafeHold::Brake => u,
            SafeHold::Rest => self.told_n[cable],
            SafeHold::Ramp => self.safe_n,
        };
        u + (goal - u).clamp(-self.step_n, self.step_n)
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
    /// A sensor of the tip, if there is one.
    pub tip_sensor: Option<TipMeter>,
    /// Why the plant could not go on; it stays where it was.
    pub broken: Option<String>,
    /// Largest change of a tension per second while the planner was at work (N/s).
    pub tension_rate_max_nps: f64,
    /// What went wrong, and the tick from which on.
    trouble: Option<(Trouble, u64)>,
    alone: Alone,
    mode: Mode,
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
    /// Of the tip's sensor.
    noise: Xoshiro256PlusPlus,
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
            tip_sensor: None,
            broken: None,
            tension_rate_max_nps: 0.0,
            trouble: None,
            alone: Alone::new(config),
            mode: Mode::Disarmed,
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
            noise: Xoshiro256PlusPlus::seed_from_u64(!truth.seed),
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

    /// The obstacles of a scenario, to be placed before each tick.
    ///
    /// # Errors
    /// There are too many, or one has no shape.
    pub fn insert(&mut self, obstacles: &[ObstacleConfig]) -> Result<(), String> {
        for (k, obstacle) in obstacles.iter().enumerate() {
            let shape = Shape::new(&obstacle.shape).map_err(|error| format!("{error:?}"))?;
            self.obstacles.insert(k as u64, &shape).map_err(|error| format!("{error:?}"))?;
        }
        Ok(())
    }

    /// Obstacles where they are at the scenario's time `now_s`, and so much later as the lookahead (s).
    ///
    /// # Errors
    /// One is nowhere.
    pub fn place(&mut self, obstacles: &[ObstacleConfig], now_s: f64, lookahead_s: f64) -> Result<(), String> {
        for (k, obstacle) in obstacles.iter().enumerate() {
            let at = |t: f64| obstacle.motion.position_at(t.max(0.0));
            let placement = Placement {
                position_now_m: at(now_s),
                position_ahead_m: at(now_s + lookahead_s),
                quaternion: obstacle.quaternion,
                growth_m: 0.0,
            };
            self.obstacles.place(k, &placement).map_err(|error| format!("{error:?}"))?;
        }
        Ok(())
    }

    /// Something goes wrong from the next tick on, and stays so.
    pub fn befall(&mut self, trouble: Trouble) {
        self.trouble = Some((trouble, self.tick));
    }

    /// One tick, then the arm for a period.
    pub fn step(&mut self, request: Option<Request>) -> TickOutput {
        self.tick += 1;
        self.show();
        let trouble = self.trouble.map(|(trouble, _)| trouble);
        let since_s = self.trouble.map_or(0.0, |(_, tick)| (self.tick - tick) as f64 * self.period_s);
        let noticed = since_s > self.alone.timeout_s;
        let output = match trouble {
            Some(Trouble::Dead) => TickOutput { mode: self.mode, drives: DrivesCommand::On, answer: None },
            _ => self.think(request, noticed),
        };
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
        for cable in 0..self.told_n.len() {
            let alone = match trouble {
                Some(Trouble::Dead) => true,
                Some(Trouble::Bus(first, end)) => (first..end).contains(&cable),
                _ => false,
            };
            self.told_n[cable] = match trouble {
                Some(Trouble::Trip(tripped)) if tripped == cable => 0.0,
                _ if alone && noticed => self.alone.next(cable, self.told_n[cable]),
                _ if alone => self.told_n[cable],
                _ => self.cycle.tensions_n()[cable],
            };
        }
        if trouble.is_none() {
            self.alone.follow(self.tick, &self.told_n);
        }
        let told = self.told_n.iter().zip(&self.lies);
        self.pulled_n.iter_mut().zip(told).for_each(|(pulled, (told, lie))| *pulled = told * lie.pull);
        if let Err(error) = self.truth.step(&self.pulled_n, self.period_s) {
            let time_s = self.time_s();
            self.broken.get_or_insert_with(|| format!("at {time_s:.2} s: {error}"));
        }
        output
    }

    /// The loop's tick; `noticed` tells whether what is silent counts as lost.
    fn think(&mut self, request: Option<Request>, noticed: bool) -> TickOutput {
        let now_ns = (self.time_s() * 1e9).round() as u64;
        let trouble = self.trouble.map(|(trouble, _)| trouble);
        let (mut phase, mut missed) = (self.drives, 0);
        let (mut fault, mut bus_lost, mut unread) = (None, None, 0..0);
        match trouble {
            Some(Trouble::Bus(first, end)) => {
                unread = first..end;
                if noticed {
                    bus_lost = Some(0);
                    phase = DrivesPhase::Changing;
                }
            }
            Some(Trouble::Trip(cable)) => {
                fault = Some((cable as u16, OVER_CURRENT));
                phase = DrivesPhase::Changing;
            }
            Some(Trouble::Silent(cable)) => unread = cable..cable + 1,
            Some(Trouble::Jump(cable)) => self.shown_m[cable] += 0.05,
            Some(Trouble::Late) => missed = 20,
            Some(Trouble::Dead) | None => {}
        }
        if self.drives == DrivesPhase::Off {
            phase = DrivesPhase::Off;
        }
        let mut valid = CableMask::default();
        (0..self.shown_m.len()).filter(|cable| !unread.contains(cable)).for_each(|cable| valid.insert(cable));
        let tip = self.truth.tip().position;
        let tip = self.tip_sensor.as_mut().and_then(|meter| meter.measure(tip, now_ns, &mut self.noise));
        let inputs = TickInputs {
            tick: self.tick,
            now_ns,
            missed,
            encoders: EncoderReadings { lengths_m: &self.shown_m, valid, capture_ns: now_ns },
            // A drive measures its own current: what it was told, whatever its gear.
            tensions_measured_n: &self.told_n,
            obstacles: &self.obstacles,
            demand: self.demand,
            tip,
            target: self.target,
            drives: DrivesInput { phase, ready: fault.is_none(), fault, bus_lost, emergency_stop: None },
            request,
        };
        let output = self.cycle.tick(&inputs, &mut self.rng, &mut || false);
        self.cycle.report(&inputs);
        let on = output.drives == DrivesCommand::On;
        self.drives = if on { DrivesPhase::Enabled } else { DrivesPhase::Off };
        self.mode = output.mode;
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
