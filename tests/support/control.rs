//! A rig around the controller: an estimator that is the model itself, planners that do as they are told, and the
//! world of inputs of a tick.
#![allow(dead_code)] // each test binary uses its own part
#![allow(clippy::unwrap_used)] // a rig that cannot be built fails its test

#[path = "settings.rs"]
mod planner_settings;

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::Shape;
use sinew::config::*;
use sinew::control::*;
use sinew::integrator::{Scheme, Stepper};
use sinew::model::{Arm, State};
use sinew::planner::{Branch, Deadline, Inputs, Planner, Report, Status};

pub const PERIOD_S: f64 = 0.01;
pub const PERIOD_NS: u64 = 10_000_000;

/// Settings of the paper's arm at 100 Hz.
pub fn settings() -> Settings {
    let config = Config::builtin();
    let planner = PlannerConfig {
        period_s: PERIOD_S,
        newton_iterations_max: 2,
        body: BodyModel::Arm,
        body_radius_m: 0.055,
        clearance_m: 0.01,
        warning_hysteresis_m: 0.005,
        barrier: Some(BarrierConfig { gamma: 0.3, activation_m: 0.15 }),
        swarm: SwarmConfig {
            particles_normal: 15,
            particles_uniform: 5,
            sweeps_max: 4,
            stall_sweeps: 4,
            ..planner_settings::swarm_config()
        },
        ..planner_settings::planner_config(WarningBranch::Seeded)
    };
    let observer =
        ObserverConfig { stiffness_ratio: 3.0, disturbance_time_s: 1.0, settle_timeout_s: 2.0, ..config.observer };
    // Fast: what these tests look at takes a second or two.
    let governor = GovernorConfig { speed_mps: 0.5, acceleration_mps2: 1.0, bend_rate_radps: 1.5, ..config.governor };
    let parts = Settings::from_parts(
        config.arm,
        config.timing,
        planner,
        config.weights,
        observer,
        governor,
        config.guard,
        config.supervision,
    );
    // Faults end in the ramp; tests of cables that stay say so.
    Settings { safe_hold: vec![SafeHold::Ramp; parts.arm.cable_count()], ..parts }
}

/// The same with a pretension: the safe value is not zero.
pub fn pretensioned() -> Settings {
    let mut s = settings();
    s.arm.tension_n_min = 5.0;
    s.start_tensions_n = vec![5.0; s.arm.cable_count()];
    s
}

/// Knows the arm perfectly: it is the model, moved by the tensions that acted, whatever was measured.
#[derive(Debug)]
pub struct Mirror {
    arm: Arm,
    scheme: Scheme,
    stepper: Stepper,
    straight: State,
    state: State,
    next: State,
    updates: u32,
    /// Updates until it says that it has settled; `u32::MAX` for never.
    settle_after: u32,
    /// What it claims as innovation (rad).
    innovation_rad: f64,
}

impl Mirror {
    pub fn new(config: &ArmConfig) -> Self {
        let arm = Arm::new(config);
        let straight = State::at_rest(arm.straight());
        Self {
            scheme: Scheme::new(config.rho_inf),
            stepper: Stepper::new(&arm),
            state: straight.clone(),
            next: straight.clone(),
            straight,
            updates: 0,
            settle_after: 20,
            innovation_rad: 0.0,
            arm,
        }
    }

    /// One that never says that it has settled.
    pub fn never_settles(self) -> Self {
        Self { settle_after: u32::MAX, ..self }
    }

    /// One that claims this innovation (rad).
    pub fn claims(self, innovation_rad: f64) -> Self {
        Self { innovation_rad, ..self }
    }
}

impl Estimator for Mirror {
    fn start(&mut self, lengths_m: &[f64], _tensions_n: &[f64]) -> Result<(), EstimatorFailure> {
        if lengths_m.iter().any(|l| !l.is_finite()) {
            return Err(EstimatorFailure::NoStart);
        }
        self.state.copy_from(&self.straight);
        self.updates = 0;
        Ok(())
    }

    fn update(&mut self, sent_n: &[f64], _: &[f64], periods: u32) -> Result<Estimate, EstimatorFailure> {
        for _ in 0..periods {
            self.stepper
                .step(&self.arm, &self.scheme, PERIOD_S, &self.state, sent_n, 4, &mut self.next)
                .map_err(|_| EstimatorFailure::Step)?;
            std::mem::swap(&mut self.state, &mut self.next);
        }
        self.updates += 1;
        let z = self.innovation_rad;
        let settled = self.updates >= self.settle_after;
        Ok(Estimate { innovation_max_rad: z, beyond_bound: z > 0.3, growing: z < 0.0, settled, ..Estimate::default() })
    }

    fn state(&self) -> &State {
        &self.state
    }

    fn disturbance_n(&self) -> &[f64] {
        &[]
    }
}

/// A planner that does as it is told.
#[derive(Debug)]
pub struct Told {
    pub tensions: Vec<f64>,
    pub status: Status,
    /// From this call on, the tension of cable 3 is this.
    pub poison: Option<(u32, f64)>,
    pub calls: u32,
}

impl Told {
    pub fn constant(tension_n: f64) -> Self {
        Self { tensions: vec![tension_n; 24], status: Status::IterationLimit, poison: None, calls: 0 }
    }
}

impl Plan for Told {
    fn plan(&mut self, _: &Inputs<'_>, _: &mut Xoshiro256PlusPlus, _: &mut dyn Deadline) -> Report {
        self.calls += 1;
        if let Some((_, value)) = self.poison.filter(|(from, _)| self.calls >= *from) {
            self.tensions[3] = value;
        }
        Report {
            status: self.status,
            branch: Branch::Safe,
            iterations: 2,
            correction: 0.0,
            kkt_residual: 0.0,
            optimal: true,
            relaxed: false,
            hopeless: 0,
            truncated: false,
            solver_iterations: 0,
            sweeps: 0,
            evaluations: 0,
            cost: 0.0,
            distance_min: f64::INFINITY,
        }
    }

    fn tensions(&self) -> &[f64] {
        &self.tensions
    }
}

/// Controller and world.
pub struct Rig<P: Plan = Planner> {
    pub cycle: Cycle<Mirror, P>,
    pub arm: Arm,
    pub obstacles: ObstaclePair,
    pub tick: u64,
    pub rng: Xoshiro256PlusPlus,
    pub drives: DrivesInput,
    pub target: Option<TargetInput>,
    pub demand: ObstacleDemand,
    /// Deadlines missed before each tick.
    pub missed: u32,
    pub valid: CableMask,
    /// Added to the measured lengths (m).
    pub offset: Vec<f64>,
    /// Lengths that do not move any more.
    pub frozen: Vec<Option<f64>>,
    pub lengths: Vec<f64>,
    /// The drives follow their command; otherwise they stay as they are.
    pub drives_follow: bool,
    pub last: TickOutput,
}

impl Rig<Planner> {
    pub fn real(settings: &Settings, seed: u64) -> Self {
        Self::around(Cycle::new(settings, Mirror::new(&settings.arm)), &settings.arm, seed)
    }
}

impl Rig<Told> {
    pub fn told(settings: &Settings, told: impl Fn() -> Told) -> Self {
        let cycle = Cycle::with_planner(settings, Mirror::new(&settings.arm), told());
        Self::around(cycle, &settings.arm, 1)
    }
}

impl<P: Plan> Rig<P> {
    pub fn around(cycle: Cycle<Mirror, P>, arm: &ArmConfig, seed: u64) -> Self {
        let arm = Arm::new(arm);
        let cables = arm.cable_count();
        Self {
            cycle,
            obstacles: ObstaclePair::new(),
            tick: 0,
            rng: Xoshiro256PlusPlus::seed_from_u64(seed),
            drives: DrivesInput {
                phase: DrivesPhase::Off,
                ready: true,
                fault: None,
                bus_lost: None,
                emergency_stop: None,
            },
            target: None,
            demand: ObstacleDemand::Proceed,
            missed: 0,
            valid: CableMask::first(cables),
            offset: vec![0.0; cables],
            frozen: vec![None; cables],
            lengths: vec![0.0; cables],
            drives_follow: true,
            last: TickOutput { mode: Mode::Disarmed, drives: DrivesCommand::Off, answer: None },
            arm,
        }
    }

    /// One tick; `stop` is what the planner hears when it asks. Does not allocate but for what the cycle does.
    pub fn step_with(&mut self, request: Option<Request>, mut stop: impl FnMut() -> bool) -> TickOutput {
        self.arm.cable_lengths_into(&self.cycle.estimator().state().q, &mut self.lengths);
        for cable in 0..self.lengths.len() {
            self.lengths[cable] = self.frozen[cable].unwrap_or(self.lengths[cable] + self.offset[cable]);
        }
        self.tick += 1;
        let now_ns = self.tick * PERIOD_NS;
        let inputs = TickInputs {
            tick: self.tick,
            now_ns,
            missed: self.missed,
            encoders: EncoderReadings { lengths_m: &self.lengths, valid: self.valid, capture_ns: now_ns },
            tensions_measured_n: &[],
            obstacles: &self.obstacles,
            demand: self.demand,
            tip: None,
            target: self.target,
            drives: self.drives,
            request,
        };
        self.last = self.cycle.tick(&inputs, &mut self.rng, &mut stop);
        self.cycle.report(&inputs);
        if self.drives_follow {
            self.drives.phase = match (self.drives.phase, self.last.drives) {
                (DrivesPhase::Off, DrivesCommand::On) => DrivesPhase::Changing,
                (_, DrivesCommand::On) => DrivesPhase::Enabled,
                (DrivesPhase::Enabled, _) => DrivesPhase::Changing,
                _ => DrivesPhase::Off,
            };
        }
        self.last
    }

    pub fn step(&mut self, request: Option<Request>) -> TickOutput {
        self.step_with(request, || false)
    }

    /// Ticks without a request.
    pub fn run(&mut self, ticks: usize) {
        for _ in 0..ticks {
            self.step(None);
        }
    }

    /// Asks and expects consent.
    #[track_caller]
    pub fn ask(&mut self, request: Request) {
        let answer = self.step(Some(request)).answer.unwrap();
        assert_eq!(answer.refusal, None, "{request:?} while {:?}", self.cycle.mode());
    }

    /// Arms and waits for the hold.
    #[track_caller]
    pub fn arm(&mut self) {
        self.ask(Request::Arm);
        for _ in 0..300 {
            self.step(None);
            if self.cycle.mode() == Mode::Holding {
                return;
            }
        }
        panic!("no hold: {:?}", self.cycle.supervisor());
    }

    pub fn fault(&self) -> Option<Fault> {
        self.cycle.supervisor().latch().first.map(|latched| latched.fault)
    }

    /// A ball in both sets.
    pub fn ball(&mut self, id: u64, radius_m: f64, at: [f64; 3]) {
        let shape = Shape::new(&ShapeConfig::Ball { radius_m }).unwrap();
        let index = self.obstacles.insert(id, &shape).unwrap();
        self.move_to(index, at, [0.0; 3]);
    }

    pub fn move_to(&mut self, index: usize, at: [f64; 3], velocity: [f64; 3]) {
        self.obstacles.place_moving(index, at, [1.0, 0.0, 0.0, 0.0], velocity, 0.0, 0.1, 0.0).unwrap();
    }
}

/// A tip target with the attitude of the straight arm.
pub fn tip(position: [f64; 3], velocity: [f64; 3]) -> TargetInput {
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let now = Target::Tip {
        position_m: position.into(),
        quaternion: nalgebra::Vector4::new(h, 0.0, h, 0.0),
        velocity_mps: velocity.into(),
        angular_velocity_radps: nalgebra::Vector3::zeros(),
    };
    TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true }
}

/// A resting shape target.
pub fn shape(curvatures: [f64; 8]) -> TargetInput {
    let mut curvatures_1pm = [0.0; CURVATURES_MAX];
    curvatures_1pm[..8].copy_from_slice(&curvatures);
    let now = Target::Shape { curvatures_1pm, rates_1pms: [0.0; CURVATURES_MAX] };
    TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true }
}
