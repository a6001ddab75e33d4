//! Time of the model's and the integrator's parts over the arm's size: nodes 5 to 200, cables 6 to 96.
//!
//! `[segments, elements each, cables each]`; the paper's arm is `[4, 5, 6]`. No obstacles, no planner: see `planner`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

use divan::{Bencher, black_box};
use sinew::config::ArmConfig;
use sinew::integrator::{AffineMap, Scheme, Stepper};
use sinew::model::{Arm, Linearization, Motion, State};

/// Nodes 5, 20, 20, 40, 200; cables 6, 24, 48, 96, 48.
const SIZES: [[usize; 3]; 5] = [[1, 5, 6], [4, 5, 6], [4, 5, 12], [8, 5, 12], [8, 25, 6]];
const ETA_S: f64 = 0.01;

fn main() {
    divan::main();
}

fn arm([segments, elements, cables]: [usize; 3]) -> Arm {
    let mut config = ArmConfig::paper();
    let mut segment = config.segments[0].clone();
    segment.elements = elements;
    let step = std::f64::consts::TAU / cables as f64;
    segment.hole_angles_rad = (0..cables).map(|c| step * (c as f64 + 0.5)).collect();
    config.segments = vec![segment; segments];
    config.segments[segments - 1].connector_length_m = 0.0;
    Arm::new(&config)
}

struct Case {
    arm: Arm,
    state: State,
    u: Vec<f64>,
    scheme: Scheme,
    stepper: Stepper,
}

/// A bent arm at rest with every cable under tension: no term of the tangent vanishes.
fn case(size: [usize; 3]) -> Case {
    let arm = arm(size);
    let bend: Vec<f64> = (0..2 * arm.segment_count()).map(|k| (k as f64 * 1.3).sin()).collect();
    let state = State::at_rest(arm.bent(&bend));
    let u = (0..arm.cable_count()).map(|c| 20.0 + 10.0 * (c as f64 * 0.9).sin()).collect();
    let stepper = Stepper::new(&arm);
    Case { arm, state, u, scheme: Scheme::new(0.8), stepper }
}

/// A stepper whose tangent is factored, which the later parts start from.
fn factored(size: [usize; 3]) -> Case {
    let mut c = case(size);
    let rates = c.scheme.rates(ETA_S);
    // A bench on a singular tangent would measure nothing: stop.
    assert!(c.stepper.linearize(&c.arm, &Motion::from(&c.state), &c.u, rates).is_ok());
    c
}

/// Tangent, left side and input matrix.
#[divan::bench(args = SIZES)]
fn linearize(bencher: Bencher<'_, '_>, size: [usize; 3]) {
    let c = case(size);
    let mut out = Linearization::new(&c.arm);
    bencher.bench_local(|| {
        c.arm.linearize(black_box(&Motion::from(&c.state)), &c.u, c.scheme.rates(ETA_S), &mut out);
        out.f[0]
    });
}

/// Block-tridiagonal factorisation.
#[divan::bench(args = SIZES)]
fn factor(bencher: Bencher<'_, '_>, size: [usize; 3]) {
    let Stepper { linearization, mut factor, .. } = factored(size).stepper;
    bencher.bench_local(|| factor.factor(black_box(&linearization.tangent)).is_ok());
}

/// One right-hand side per cable and one more.
#[divan::bench(args = SIZES)]
fn affine_map(bencher: Bencher<'_, '_>, size: [usize; 3]) {
    let mut c = factored(size);
    let mut map = AffineMap::new(&c.arm);
    bencher.bench_local(|| {
        c.stepper.affine_map_into(&c.arm, black_box(&mut map));
        map.x0[0]
    });
}

/// A whole step of a single Newton iteration: predict, linearise, factor, solve, apply, finish.
#[divan::bench(args = SIZES)]
fn newton_iteration(bencher: Bencher<'_, '_>, size: [usize; 3]) {
    let mut c = case(size);
    let mut next = c.state.clone();
    bencher.bench_local(|| c.stepper.step(&c.arm, &c.scheme, ETA_S, black_box(&c.state), &c.u, 1, &mut next).is_ok());
}

/// The residual alone: what a line search would pay.
#[divan::bench(args = SIZES)]
fn residual(bencher: Bencher<'_, '_>, size: [usize; 3]) {
    let c = case(size);
    let n = c.arm.node_count();
    let (mut upper, mut lower) = (vec![0.0; 7 * n], vec![0.0; 4 * n]);
    bencher.bench_local(|| {
        c.arm.residual_into(black_box(&Motion::from(&c.state)), &c.u, &mut upper, &mut lower);
        upper[0]
    });
}
