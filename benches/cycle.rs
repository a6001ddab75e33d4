//! The whole cycle (observer, plan with two Newton iterations, guard) of the paper's arm, with the controller's own
//! configuration, tick by tick on a moving target: p50, p99, p99.9 and the largest of 5,000 ticks, free and with two
//! balls within the warning distance. Percentiles, not means: a loop is judged by its late ticks.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // a bench may panic and print

use hdrhistogram::Histogram;
use nalgebra::{Vector3, Vector4};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::Shape;
use sinew::config::{Config, ShapeConfig};
use sinew::control::obstacles::Placement;
use sinew::control::*;
use sinew::estimator::Observer;
use sinew::integrator::{Scheme, Stepper};
use sinew::model::{Arm, State};
use std::path::PathBuf;
use std::time::Instant;

const TICKS: u64 = 5_000;

fn main() {
    let file = |name: &str| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("config").join(name);
    let config = Config::load(&[file("arm.toml"), file("controller.toml"), file("drives.toml")]).unwrap();
    for (name, balls) in [("free", 0), ("two balls near", 2)] {
        let histogram = run(&config, balls);
        let at = |q: f64| histogram.value_at_quantile(q) as f64 / 1e3;
        println!(
            "cycle, {name:15} p50 {:8.1} us  p99 {:8.1} us  p99.9 {:8.1} us  max {:8.1} us",
            at(0.5),
            at(0.99),
            at(0.999),
            histogram.max() as f64 / 1e3
        );
    }
}

fn run(config: &Config, balls: u64) -> Histogram<u64> {
    let period_s = config.timing.period_s;
    let period_ns = (period_s * 1e9) as u64;
    let mut settings = Settings::new(config);
    settings.start_tensions_n.fill(10.0);
    let mut cycle = Cycle::new(&settings, Observer::new(&config.arm, &settings.observer, period_s));
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
    let mut drives = DrivesInput { phase: DrivesPhase::Off, ready: true, fault: None, bus_lost: None };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut histogram = Histogram::new(3).unwrap();
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
            position_m: tip.position + Vector3::new(0.05 * angle.sin(), 0.02 * (1.0 - angle.cos()), 0.02),
            quaternion: Vector4::from(config.arm.base_quaternion),
            velocity_mps: Vector3::zeros(),
            angular_velocity_radps: Vector3::zeros(),
        };
        let inputs = TickInputs {
            tick,
            now_ns,
            late: false,
            encoders: EncoderReadings {
                lengths_m: &lengths,
                valid: CableMask::first(lengths.len()),
                capture_ns: now_ns,
            },
            tensions_measured_n: &[],
            obstacles: &obstacles,
            demand: ObstacleDemand::Proceed,
            target: Some(TargetInput { now: target, ahead: None, weight: 0.0, sequence: 0, fresh: true }),
            drives,
            request,
        };
        let begin = Instant::now();
        let output = cycle.tick(&inputs, &mut rng, &mut || false);
        let elapsed = begin.elapsed();
        cycle.report(&inputs);
        while cycle.events_mut().pop().is_some() {}
        if output.mode == Mode::Tracking {
            tracked += 1;
            histogram.record(elapsed.as_nanos() as u64).unwrap();
        }
        let on = output.drives == DrivesCommand::On;
        drives.phase = if on { DrivesPhase::Enabled } else { DrivesPhase::Off };
        stepper.step(&arm, &scheme, period_s, &state, cycle.tensions_n(), 12, &mut next).unwrap();
        std::mem::swap(&mut state, &mut next);
    }
    histogram
}
