//! The controller's times on the paper's arm, as a loop is judged: by percentiles, not means.
//!
//! - One Newton iteration with all 24 tension columns (linearise, factor, the panel, apply), 20,000 times over states
//!   of a moving arm.
//! - What one more evaluation of the swarm costs.
//! - The whole cycle (observer, plan with two Newton iterations, guard), 10,000 ticks of a moving target, with the
//!   controller's own configuration: free; with two balls within the barrier's reach, 40 particles and a budget; and the
//!   same with a target that goes into one of them and out again, so that distances hold the arm back. There every
//!   plan's answer is compared with the swarm's seeds, by a plain evaluation of its own.
//!
//! Times of the cycle are also told in processor time of the thread: on a machine that others use at the same time the
//! wall clock measures their turns as well. The deadline is on the wall clock, as in the loop.
//!
//! `cargo bench --bench cycle` (about 20 s after building) writes `benches/results/cycle.txt`. A name as argument runs one
//! part and writes nothing: `newton`, `swarm`, `safe`, `warning`, `pressed`.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // a bench may panic and print

#[path = "plot/mod.rs"]
mod plot;

use hdrhistogram::Histogram;
use nalgebra::{Vector3, Vector4};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::{Obstacle, ObstacleSet, Shape};
use sinew::config::{Config, ShapeConfig, WarningBranch};
use sinew::control::obstacles::Placement;
use sinew::control::*;
use sinew::estimator::Observer;
use sinew::integrator::{AffineMap, Scheme, Stepper};
use sinew::model::{Arm, Motion, State};
use sinew::planner::{Branch, Deadline, Goal, Inputs, Planner, Report, Status};
use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::{Duration, Instant};

const TICKS: u64 = 10_000;
/// Budget of a whole warning cycle, and what of it is kept for the guard: planning ends by the difference.
const BUDGET: Duration = Duration::from_micros(800);
const RESERVE: Duration = Duration::from_micros(60);

/// The lines of a run: printed as they come, stored at the end.
#[derive(Default)]
struct Lines(Vec<String>);

impl Lines {
    fn say(&mut self, line: String) {
        println!("{line}");
        self.0.push(line);
    }

    fn times(&mut self, what: &str, h: &Histogram<u64>) {
        let at = |q: f64| h.value_at_quantile(q) as f64 / 1e3;
        self.say(format!(
            "{what:34} p50 {:8.1} us   p99 {:8.1} us   p99.9 {:8.1} us   max {:8.1} us",
            at(0.5),
            at(0.99),
            at(0.999),
            h.max() as f64 / 1e3
        ));
    }
}

fn main() {
    let machine = plot::machine().unwrap();
    let mut lines = Lines::default();
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let runs = |name: &str| wanted.is_empty() || wanted.iter().any(|w| w == name);
    let file = |name: &str| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("config").join(name);
    let mut config = Config::load(&[file("arm.toml"), file("controller.toml"), file("drives.toml")]).unwrap();
    if runs("newton") {
        newton(&config, &mut lines);
    }
    if runs("swarm") {
        swarm(&config, &mut lines);
    }
    if runs("safe") {
        let times = run(&config, 0, 0.02);
        times.print("safe cycle", &mut lines);
    }
    (config.planner.swarm.particles_normal, config.planner.swarm.particles_uniform) = (30, 10);
    for (name, what, sway_m) in [("warning", "warning cycle", 0.02), ("pressed", "warning cycle, pressed", 0.08)] {
        if runs(name) {
            let times = run(&config, 2, sway_m);
            times.print(what, &mut lines);
            times.print_warning(&mut lines);
        }
    }
    if wanted.is_empty() {
        plot::write("cycle.txt", &machine, &lines.0).unwrap();
    }
}

fn histogram() -> Histogram<u64> {
    Histogram::new(3).unwrap()
}

/// Linearise, factor, solve for all columns, apply: what one iterate of the planner costs before it optimises.
fn newton(config: &Config, lines: &mut Lines) {
    let arm = Arm::new(&config.arm);
    let scheme = Scheme::new(config.arm.rho_inf);
    let rates = scheme.rates(config.planner.lookahead_s);
    let (mut stepper, mut map) = (Stepper::new(&arm), AffineMap::new(&arm));
    let u: Vec<f64> = (0..arm.cable_count()).map(|c| 20.0 + 15.0 * (c as f64 * 1.9).sin()).collect();
    let mut parts = [histogram(), histogram(), histogram(), histogram(), histogram()];
    let mut states = Vec::new();
    for k in 0..20 {
        let bend: Vec<f64> = (0..2 * arm.segment_count()).map(|s| (f64::from(k) * 0.3 + s as f64).sin()).collect();
        states.push(State::at_rest(arm.bent(&bend)));
    }
    for k in 0..20_000 {
        let mut state = states[k % states.len()].clone();
        let begin = Instant::now();
        stepper.linearization.scale = 1e4;
        arm.linearize(&Motion::from(&state), &u, rates, &mut stepper.linearization);
        let assembled = Instant::now();
        stepper.factor.factor(&stepper.linearization.tangent).unwrap();
        let factored = Instant::now();
        stepper.affine_map_into(&arm, &mut map);
        let solved = Instant::now();
        stepper.advance(&arm, &u, rates, &mut state);
        let end = Instant::now();
        assert!(state.q[0].is_finite());
        let times = [end - begin, assembled - begin, factored - assembled, solved - factored, end - solved];
        for (h, t) in parts.iter_mut().zip(times) {
            h.record(t.as_nanos() as u64).unwrap();
        }
    }
    for (what, h) in ["Newton iteration, 24 columns", "  assembly", "  factorisation", "  panel", "  correct and apply"]
        .iter()
        .zip(&parts)
    {
        lines.times(what, h);
    }
}

/// What one more evaluation of the swarm costs: two planners that differ in their sweeps alone, 43 particles near two
/// balls; everything but the sweeps cancels in the difference.
fn swarm(config: &Config, lines: &mut Lines) {
    let arm = Arm::new(&config.arm);
    let state = State::at_rest(arm.bent(&[0.3, 0.2, -0.2, 0.1, 0.2, -0.3, 0.1, 0.2]));
    let tip = arm.tip(&state.q, &state.qd);
    let (mut now, u) = (ObstacleSet::new(), vec![10.0; arm.cable_count()]);
    for (k, side) in [1.0, -1.0].into_iter().enumerate() {
        let ball = Shape::new(&ShapeConfig::Ball { radius_m: 0.1 }).unwrap();
        let at = tip.position + Vector3::new(0.0, side * 0.2, 0.1);
        let at = sinew::collision::pose(at.into(), [1.0, 0.0, 0.0, 0.0]).unwrap();
        now.insert(Obstacle::new(k as u64, ball, &at).unwrap()).unwrap();
    }
    let weights = &config.weights.tip;
    let goal = Goal::Tip {
        position: tip.position + Vector3::new(0.02, 0.02, 0.02),
        quaternion: tip.quaternion,
        pose: weights.pose,
        rate: weights.rate,
        damping: weights.damping,
    };
    let inputs = Inputs { state: &state, u_previous: &u, disturbance: &[], led_to: None, goal, now: &now, ahead: &now };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut measure = |sweeps: usize| {
        let mut settings = config.planner.clone();
        settings.warning = WarningBranch::Seeded;
        settings.newton_iterations_max = 1;
        let swarm = &mut settings.swarm;
        (swarm.particles_normal, swarm.particles_uniform) = (30, 10);
        (swarm.sweeps_max, swarm.stall_sweeps) = (sweeps, sweeps);
        let mut planner =
            Planner::new(&config.arm, &settings, weights.tension.unwrap(), weights.tension_change.as_ref().unwrap());
        let (mut h, mut evaluations) = (histogram(), 0);
        for _ in 0..500 {
            let begin = Instant::now();
            let report = planner.plan(&inputs, &mut rng, &mut || false);
            h.record(begin.elapsed().as_nanos() as u64).unwrap();
            evaluations = report.evaluations;
        }
        (h.value_at_quantile(0.5) as f64 * 1e-9, evaluations as f64)
    };
    let ((few_s, few), (many_s, many)) = (measure(10), measure(110));
    let rate = (many - few) / (many_s - few_s);
    lines.say(format!(
        "swarm, 43 particles, two balls      {:.2} million evaluations per second ({:.2} us each)",
        rate / 1e6,
        1e6 / rate
    ));
}

/// A planner that the bench can look at between two ticks.
struct Shared {
    inner: Rc<RefCell<(Planner, Tally)>>,
    u: Vec<f64>,
}

/// Sums over all plans.
#[derive(Default, Clone)]
struct Tally {
    warning: u64,
    plans: u64,
    iterations: u64,
    solver_iterations: u64,
    sweeps: u64,
    evaluations: u64,
    spent: u64,
    judged: u64,
    last: Option<Report>,
}

impl Plan for Shared {
    fn plan(&mut self, inputs: &Inputs<'_>, rng: &mut Xoshiro256PlusPlus, deadline: &mut dyn Deadline) -> Report {
        let (planner, tally) = &mut *self.inner.borrow_mut();
        let report = planner.plan(inputs, rng, deadline);
        self.u.copy_from_slice(planner.tensions());
        tally.last = Some(report);
        report
    }

    fn tensions(&self) -> &[f64] {
        &self.u
    }
}

impl Tally {
    fn count(&mut self, planner: &Planner, obstacles: &ObstaclePair) {
        let Some(report) = self.last.take() else { return };
        if let Some(margin) = planner.seed_margin(obstacles.ahead()) {
            assert!(margin >= -1e-9 * report.cost.abs(), "an answer is worse than a seed by {}", -margin);
            self.judged += 1;
        }
        self.plans += 1;
        self.warning += u64::from(report.branch == Branch::Warning);
        self.iterations += report.iterations as u64;
        self.solver_iterations += report.solver_iterations as u64;
        self.sweeps += report.sweeps as u64;
        self.evaluations += report.evaluations as u64;
        self.spent += u64::from(report.status == Status::BudgetSpent);
    }
}

/// The cycle's clock.
struct Clock {
    begin: Instant,
    until: Duration,
    marks: [Duration; 3],
}

impl Deadline for Clock {
    fn used(&mut self) -> f64 {
        self.begin.elapsed().as_secs_f64() / self.until.as_secs_f64()
    }
}

impl StopWatch for Clock {
    fn mark(&mut self, phase: Phase) {
        self.marks[phase as usize] = self.begin.elapsed();
    }
}

struct Times {
    cycle: Histogram<u64>,
    processor: Histogram<u64>,
    estimate: Histogram<u64>,
    plan: Histogram<u64>,
    guard: Histogram<u64>,
    within: u64,
    processor_within: u64,
    tally: Tally,
}

impl Times {
    fn print(&self, what: &str, lines: &mut Lines) {
        lines.times(what, &self.cycle);
        lines.times("  in processor time", &self.processor);
        lines.times("  estimate", &self.estimate);
        lines.times("  plan", &self.plan);
        lines.times("  guard", &self.guard);
    }

    fn print_warning(&self, lines: &mut Lines) {
        let t = &self.tally;
        lines.say(format!(
            "  within {} us: {:.3} % of {TICKS} ticks, {:.3} % in processor time; warning branch in {:.1} %; budget spent in {:.2} %",
            BUDGET.as_micros(),
            100.0 * self.within as f64 / TICKS as f64,
            100.0 * self.processor_within as f64 / TICKS as f64,
            100.0 * t.warning as f64 / t.plans as f64,
            100.0 * t.spent as f64 / t.plans as f64,
        ));
        lines.say(format!(
            "  per tick: {:.2} Newton iterations with {:.2} of the complementarity problem, {:.1} sweeps, {:.0} evaluations; {} answers, none worse than a seed",
            t.iterations as f64 / t.plans as f64,
            t.solver_iterations as f64 / t.plans as f64,
            t.sweeps as f64 / t.plans as f64,
            t.evaluations as f64 / t.plans as f64,
            t.judged,
        ));
    }
}

/// Processor time of this thread.
fn processor_time() -> Duration {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(t.tv_sec as u64, t.tv_nsec as u32)
}

/// `sway_m`: how far the target goes to the side of the first ball; beyond 0.04 m distances hold the arm back.
fn run(config: &Config, balls: u64, sway_m: f64) -> Times {
    let period_s = config.timing.period_s;
    let period_ns = (period_s * 1e9) as u64;
    let mut settings = Settings::new(config);
    settings.start_tensions_n.fill(10.0);
    let shared = |tension: f64, change: &[f64]| Shared {
        inner: Rc::new(RefCell::new((
            Planner::new(&settings.arm, &settings.planner, tension, change),
            Tally::default(),
        ))),
        u: vec![0.0; config.arm.cable_count()],
    };
    let weights = &settings.weights.tip;
    let planner = shared(weights.tension.unwrap(), weights.tension_change.as_ref().unwrap());
    let watched = planner.inner.clone();
    let observer = Observer::new(&config.arm, &settings.observer, period_s);
    let mut cycle = Cycle::with_planner(&settings, observer, planner);
    // The arm is the model itself: this measures time, not control.
    let arm = Arm::new(&config.arm);
    let (scheme, mut stepper) = (Scheme::new(config.arm.rho_inf), Stepper::new(&arm));
    let mut state = State::at_rest(arm.straight());
    let mut next = state.clone();
    let mut lengths = vec![0.0; arm.cable_count()];
    let mut obstacles = ObstaclePair::new();
    let tip = arm.tip(&state.q, &state.qd);
    for k in 0..balls {
        let side = if k == 0 { 1.0 } else { -1.0 };
        let at: [f64; 3] = (tip.position + Vector3::new(0.0, side * 0.2, 0.1)).into();
        obstacles.insert(k, &Shape::new(&ShapeConfig::Ball { radius_m: 0.1 }).unwrap()).unwrap();
        let placement =
            Placement { position_now_m: at, position_ahead_m: at, quaternion: [1.0, 0.0, 0.0, 0.0], growth_m: 0.0 };
        obstacles.place(k as usize, &placement).unwrap();
    }
    let mut drives =
        DrivesInput { phase: DrivesPhase::Off, ready: true, fault: None, bus_lost: None, emergency_stop: None };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut times = Times {
        cycle: histogram(),
        processor: histogram(),
        estimate: histogram(),
        plan: histogram(),
        guard: histogram(),
        within: 0,
        processor_within: 0,
        tally: Tally::default(),
    };
    let until = if balls == 0 { Duration::MAX } else { BUDGET - RESERVE };
    let (mut tick, mut tracked, mut asked) = (0, 0, false);
    while tracked < TICKS {
        tick += 1;
        arm.cable_lengths_into(&state.q, &mut lengths);
        let mode = cycle.mode();
        let request = match mode {
            Mode::Disarmed => Some(Request::Arm),
            Mode::Holding if !asked => {
                asked = true;
                Some(Request::Track)
            }
            Mode::Faulted => panic!("the cycle ended in a fault after {tick} ticks"),
            _ => None,
        };
        let now_ns = tick * period_ns;
        let angle = 0.5 * tracked as f64 * period_s;
        let target = Target::Tip {
            position_m: tip.position + Vector3::new(0.05 * angle.sin(), sway_m * (1.0 - angle.cos()), 0.02),
            quaternion: Vector4::from(config.arm.base_quaternion),
            velocity_mps: Vector3::zeros(),
            angular_velocity_radps: Vector3::zeros(),
        };
        let inputs = TickInputs {
            tick,
            now_ns,
            missed: 0,
            encoders: EncoderReadings {
                lengths_m: &lengths,
                valid: CableMask::first(lengths.len()),
                capture_ns: now_ns,
            },
            tensions_measured_n: &[],
            obstacles: &obstacles,
            demand: ObstacleDemand::Proceed,
            tip: None,
            target: Some(TargetInput { now: target, ahead: None, weight: 0.0, sequence: 0, fresh: true }),
            drives,
            request,
        };
        let begun = processor_time();
        let mut clock = Clock { begin: Instant::now(), until, marks: [Duration::ZERO; 3] };
        let output = cycle.tick(&inputs, &mut rng, &mut clock);
        let elapsed = clock.begin.elapsed();
        let processor = processor_time() - begun;
        cycle.report(&inputs);
        while cycle.events_mut().pop().is_some() {}
        let [estimated, planned, checked] = clock.marks;
        if output.mode == Mode::Tracking {
            tracked += 1;
            let (planner, tally) = &mut *watched.borrow_mut();
            tally.count(planner, &obstacles);
            times.cycle.record(elapsed.as_nanos() as u64).unwrap();
            times.estimate.record(estimated.as_nanos() as u64).unwrap();
            times.plan.record((planned - estimated).as_nanos() as u64).unwrap();
            times.guard.record((checked - planned).as_nanos() as u64).unwrap();
            times.within += u64::from(elapsed <= BUDGET);
            times.processor.record(processor.as_nanos() as u64).unwrap();
            times.processor_within += u64::from(processor <= BUDGET);
        }
        let on = output.drives == DrivesCommand::On;
        drives.phase = if on { DrivesPhase::Enabled } else { DrivesPhase::Off };
        stepper.step(&arm, &scheme, period_s, &state, cycle.tensions_n(), 12, &mut next).unwrap();
        std::mem::swap(&mut state, &mut next);
    }
    times.tally = watched.borrow().1.clone();
    times
}
