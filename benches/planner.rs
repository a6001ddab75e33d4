//! Time of one planning step of the paper's arm, in the daemon's setting (two Newton iterations, 10 ms period), and of
//! the swarm alone.
//!
//! The state is an equilibrium under tensions of about 10 N; the goal is 5 cm away; the obstacles are balls beside the
//! arm whose surfaces are 8 mm from its backbone for the first two, farther for the others.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

// The scene is fixed and good; a bench that cannot build it should stop.

mod scene;

use divan::{Bencher, black_box, counter::ItemsCount};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::ObstacleSet;
use sinew::config::{ArmConfig, WarningBranch};
use sinew::integrator::{Stepper, consistent_start, equilibrium};
use sinew::model::{Arm, State};
use sinew::planner::{Branch, Inputs, Planner};

fn main() {
    divan::main();
}

struct Scene {
    config: ArmConfig,
    arm: Arm,
    state: State,
    u: Vec<f64>,
    obstacles: ObstacleSet,
}

fn beside(config: ArmConfig, count: usize) -> Scene {
    let arm = Arm::new(&config);
    let u: Vec<f64> = (0..arm.cable_count()).map(|c| 10.0 + 8.0 * (c as f64 * 1.9).sin()).collect();
    let mut stepper = Stepper::new(&arm);
    let mut state = State::at_rest(arm.straight());
    equilibrium(&arm, &mut stepper, &u, &mut state).expect("a gentle load");
    consistent_start(&arm, &mut stepper, &u, &mut state).expect("a regular mass");
    let gap_m = |k: usize| if k < 2 { 0.008 } else { 0.02 + 0.01 * k as f64 };
    let obstacles = scene::balls(&arm, &state, count, gap_m);
    Scene { config, arm, state, u, obstacles }
}

fn step(bencher: Bencher<'_, '_>, s: &Scene, warning: WarningBranch, branch: Branch) {
    let mut planner = Planner::new(&s.config, &scene::receding(warning), 1.0, &vec![1e4; s.arm.segment_count()]);
    let goal = scene::goal(&s.arm, &s.state);
    let inputs = Inputs {
        state: &s.state,
        u_previous: &s.u,
        disturbance: &[],
        led_to: None,
        goal,
        now: &s.obstacles,
        ahead: &s.obstacles,
    };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let report = planner.plan(&inputs, &mut rng, &mut || false);
    assert_eq!(report.branch, branch, "the bench measures another branch than its name says");
    bencher.counter(ItemsCount::new(report.evaluations.max(1))).bench_local(|| {
        planner.forget();
        planner.plan(black_box(&inputs), &mut rng, &mut || false).iterations
    });
}

/// Without obstacles.
#[divan::bench]
fn safe(bencher: Bencher<'_, '_>) {
    step(bencher, &beside(ArmConfig::paper(), 0), WarningBranch::Seeded, Branch::Safe);
}

/// Without obstacles, eight segments of five elements with twelve cables each.
#[divan::bench]
fn safe_96_cables(bencher: Bencher<'_, '_>) {
    let mut config = ArmConfig::paper();
    let mut segment = config.segments[0].clone();
    segment.length_m = 0.3;
    segment.hole_angles_rad = (0..12).map(|c| f64::from(c) * std::f64::consts::TAU / 12.0).collect();
    config.segments = vec![segment; 8];
    config.segments[7].connector_length_m = 0.0;
    step(bencher, &beside(config, 0), WarningBranch::Seeded, Branch::Safe);
}

/// The extended complementarity problem alone.
#[divan::bench(args = [2, 16, 64])]
fn complementarity(bencher: Bencher<'_, '_>, obstacles: usize) {
    step(bencher, &beside(ArmConfig::paper(), obstacles), WarningBranch::Complementarity, Branch::Warning);
}

/// The swarm with that solution among its seeds; items are swarm evaluations.
#[divan::bench(args = [2, 16, 64])]
fn seeded(bencher: Bencher<'_, '_>, obstacles: usize) {
    step(bencher, &beside(ArmConfig::paper(), obstacles), WarningBranch::Seeded, Branch::Warning);
}

/// The swarm alone; items are swarm evaluations.
#[divan::bench(args = [2, 16, 64])]
fn swarm(bencher: Bencher<'_, '_>, obstacles: usize) {
    step(bencher, &beside(ArmConfig::paper(), obstacles), WarningBranch::Swarm, Branch::Warning);
}
