//! Claims about the observer: what it computes, that it is passive, that it forgets wrong starts, that it never
//! allocates.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use nalgebra::{DMatrix, DVector};
use sinew::config::{ArmConfig, Config, ObserverConfig, Routing};
use sinew::estimator::{CableSpace, Observer, StartError};
use sinew::integrator::{Scheme, Stepper, consistent_start, equilibrium};
use sinew::math::block_tridiagonal::BLOCK;
use sinew::model::{Arm, State};

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

const PERIOD: f64 = 0.01;

fn settings() -> ObserverConfig {
    ObserverConfig { disturbance_time_s: 0.6, ..Config::builtin().observer }
}

fn small_arm() -> ArmConfig {
    let mut config = ArmConfig::paper();
    config.segments.truncate(2);
    config.segments[1].connector_length_m = 0.0;
    config.segments.iter_mut().for_each(|s| s.elements = 3);
    config
}

fn tensions(arm: &Arm) -> Vec<f64> {
    (0..arm.cable_count()).map(|c| 12.0 + 10.0 * (1.3 * c as f64).sin()).collect()
}

fn lengths(arm: &Arm, q: &[f64]) -> Vec<f64> {
    let mut l = vec![0.0; arm.cable_count()];
    arm.cable_lengths_into(q, &mut l);
    l
}

fn rest(arm: &Arm, u: &[f64]) -> State {
    let mut state = State::at_rest(arm.straight());
    equilibrium(arm, &mut Stepper::new(arm), u, &mut state).unwrap();
    state
}

fn largest(v: &[f64]) -> f64 {
    v.iter().fold(0.0, |a: f64, x| a.max(x.abs()))
}

fn bends(arm: &Arm, state: &State) -> Vec<f64> {
    let mut k = vec![0.0; 2 * arm.segment_count()];
    let mut kd = k.clone();
    arm.curvatures_into(&state.q, &state.qd, &mut k, &mut kd);
    k
}

/// The implicit equations of design section 6, evaluated from their definition at the state after an update: the
/// residual of the dynamics with `u + T (beta + w)` must vanish, `w` made from the lengths of the new state.
#[test]
fn an_update_solves_the_implicit_equations_with_their_correction_for_both_routings() {
    for routing in [Routing::Local, Routing::Through] {
        let mut config = small_arm();
        config.routing = routing;
        let set = settings();
        let mut observer = Observer::new(&config, &set, PERIOD);
        // The observer's own arm: its damping differs from the configured one.
        let arm = observer.arm().clone();
        let u = tensions(&arm);
        let mut measured = lengths(&arm, &rest(&arm, &u).q);
        observer.start(&measured, &u).unwrap();
        measured.iter_mut().enumerate().for_each(|(c, l)| *l += 1e-3 * (c as f64).cos());

        let space = CableSpace::new(&arm);
        let n = space.angle_count();
        let mut y = vec![0.0; n];
        for _ in 0..3 {
            let (beta, before) = (observer.disturbance_moments().to_vec(), observer.state().clone());
            let update = observer.update(&u, &measured);
            assert!(!update.failed);
            let state = observer.state();
            let (l, mut z) = (lengths(&arm, &state.q), vec![0.0; n]);
            for c in 0..l.len() {
                for i in 0..n {
                    z[i] += space.row(c)[i] * (l[c] - measured[c]);
                }
            }
            assert!(z.iter().zip(observer.innovation()).all(|(a, b)| (a - b).abs() < 1e-12));
            let mut acting = u.clone();
            for i in 0..n {
                let segment = &config.segments[i / 2];
                let k = set.stiffness_ratio * segment.bending_stiffness_nm2 / segment.length_m;
                // The filter's new value from its own implicit equation, then w from its definition.
                let new = (set.filter_time_s * y[i] + PERIOD * z[i]) / (set.filter_time_s + PERIOD);
                let w = k * z[i] + k * set.damping_s * (z[i] - new) / set.filter_time_s;
                y[i] = new;
                for (c, a) in acting.iter_mut().enumerate() {
                    *a += space.row(c)[i] * (beta[i] + w);
                }
                let want = beta[i] + PERIOD / set.disturbance_time_s * w;
                assert!((observer.disturbance_moments()[i] - want).abs() < 1e-9);
            }
            let (mut upper, mut lower) = (vec![0.0; state.q.len()], vec![0.0; state.lambda.len()]);
            arm.residual_into(&state.into(), &acting, &mut upper, &mut lower);
            assert!(largest(&upper) < 1e-4, "{routing:?}: residual {}", largest(&upper));
            assert!(largest(&lower) < 1e-9, "{routing:?}: constraints {}", largest(&lower));
            assert!(largest(&before.q) > 0.0 && before.q != state.q);
        }
    }
}

/// One Newton step of the corrected system by a dense solve, against the observer's first iterate: with a measurement
/// that is the estimate's own to 1e-7 rad, the update is one step of the linearised system.
#[test]
fn the_low_rank_correction_equals_a_dense_solve_of_the_corrected_tangent() {
    let config = small_arm();
    let set = settings();
    let mut observer = Observer::new(&config, &set, PERIOD);
    let arm = observer.arm().clone();
    let u = tensions(&arm);
    let start = lengths(&arm, &rest(&arm, &u).q);
    observer.start(&start, &u).unwrap();
    let state = observer.state().clone();
    let space = CableSpace::new(&arm);
    let (n, nc) = (space.angle_count(), arm.cable_count());
    let measured: Vec<f64> = start.iter().enumerate().map(|(c, l)| l + 1e-7 * (2.0 * c as f64).sin()).collect();

    // At rest the predictor is the state itself.
    let scheme = Scheme::new(0.0);
    let rates = scheme.rates(PERIOD);
    let mut acting = u.clone();
    let mut z = vec![0.0; n];
    let model = lengths(&arm, &state.q);
    for c in 0..nc {
        for i in 0..n {
            z[i] += space.row(c)[i] * (model[c] - measured[c]);
        }
    }
    let gain: Vec<f64> = (0..n)
        .map(|i| {
            let s = &config.segments[i / 2];
            let k = set.stiffness_ratio * s.bending_stiffness_nm2 / s.length_m;
            k + k * set.damping_s / (set.filter_time_s + PERIOD)
        })
        .collect();
    for c in 0..nc {
        for i in 0..n {
            acting[c] += space.row(c)[i] * (observer.disturbance_moments()[i] + gain[i] * z[i]);
        }
    }
    let mut stepper = Stepper::new(&arm);
    stepper.linearize(&arm, &(&state).into(), &acting, rates).unwrap();
    let size = stepper.linearization.f.len();
    let mut dense = DMatrix::zeros(size, size);
    for k in 0..size {
        let mut e = vec![0.0; size];
        e[k] = 1.0;
        let mut column = vec![0.0; size];
        stepper.linearization.tangent.multiply_into(&e, &mut column);
        dense.set_column(k, &DVector::from_vec(column));
    }
    let mut rows = vec![0.0; 7 * arm.node_count() * nc];
    stepper.linearization.input_into(&arm, &mut rows);
    // Constraints have no row.
    let b = DMatrix::from_fn(size, nc, |r, c| {
        let (node, row) = (r / BLOCK, r % BLOCK);
        if row < 7 { rows[(7 * node + row) * nc + c] } else { 0.0 }
    });
    let t = DMatrix::from_fn(nc, n, |c, i| space.row(c)[i]);
    let v = &b * t;
    dense += &v * DMatrix::from_diagonal(&DVector::from_vec(gain)) * v.transpose();
    let f = DVector::from_column_slice(&stepper.linearization.f);
    let want = dense.lu().solve(&(&b * DVector::from_vec(acting) - f)).unwrap();
    observer.update(&u, &measured);
    let scale = (0..size).filter(|r| r % 11 < 7).fold(0.0f64, |a, r| a.max(want[r].abs()));
    assert!(scale > 1e-9);
    for node in 0..arm.node_count() {
        for c in 0..7 {
            let moved = observer.state().q[7 * node + c] - state.q[7 * node + c];
            assert!((moved - want[11 * node + c]).abs() < 1e-4 * scale, "{moved} {}", want[11 * node + c]);
        }
    }
}

/// Unforced and linearised: a small bend of the estimate while the arm is known to be straight. Stored is the model's
/// energy and what the spring and the Maxwell damper's spring hold.
#[test]
fn the_energy_of_an_estimates_error_does_not_grow() {
    let config = ArmConfig::paper();
    let mut set = settings();
    // Without the integral part, which is not passive; nearly no damping of the arm's own.
    set.disturbance_time_s = 1e12;
    let mut soft = config.clone();
    soft.segments.iter_mut().for_each(|s| s.damping_stiffness_s = 1e-3);
    let mut observer = Observer::new(&soft, &set, PERIOD);
    let arm = observer.arm().clone();
    let u = vec![0.0; arm.cable_count()];
    let bent = arm.bent(&[1e-3, 0.0, 0.0, -2e-3, 1e-3, 1e-3, -1e-3, 2e-3]);
    observer.start(&lengths(&arm, &bent), &u).unwrap();
    let straight = lengths(&arm, &arm.straight());
    // The moments that held the bend go with it: a start in the straight shape would leave nothing to decay.
    let mut y = [0.0; 8];
    let beta = observer.disturbance_moments().to_vec();
    assert!(largest(&beta) > 1e-3);
    let mut state = observer.state().clone();
    consistent_start(&arm, &mut Stepper::new(&arm), &u, &mut state).unwrap();
    observer.resume(&state);
    let mut energies = Vec::new();
    for _ in 0..2000 {
        let update = observer.update(&u, &straight);
        assert!(!update.failed);
        let (s, z) = (observer.state(), observer.innovation());
        let mut energy = arm.kinetic_energy(&s.q, &s.qd) + arm.elastic_energy(&s.q);
        for i in 0..8 {
            let k = 2.0 * 7.0 / 0.65;
            y[i] = (0.3 * y[i] + PERIOD * z[i]) / (0.3 + PERIOD);
            energy += 0.5 * k * z[i] * z[i] + 0.5 * (2.0 * k / 0.3) * (z[i] - y[i]).powi(2);
        }
        energies.push(energy);
    }
    for pair in energies[1..].windows(2) {
        assert!(pair[1] <= pair[0] * (1.0 + 1e-6) + 1e-15, "{} -> {}", pair[0], pair[1]);
    }
    assert!(energies[1999] < 0.05 * energies[1], "{} of {}", energies[1999], energies[1]);
}

#[test]
fn a_start_reproduces_the_measured_bend_angles_and_is_an_equilibrium() {
    let config = ArmConfig::paper();
    let mut observer = Observer::new(&config, &settings(), PERIOD);
    let arm = observer.arm().clone();
    let u = tensions(&arm);
    // An arm of other stiffness: the model under u alone would rest elsewhere.
    let mut other = config.clone();
    other.segments.iter_mut().for_each(|s| s.bending_stiffness_nm2 *= 0.9);
    let other = Arm::new(&other);
    let truth = rest(&other, &u);
    observer.start(&lengths(&other, &truth.q), &u).unwrap();
    let measured = lengths(&other, &truth.q);
    for _ in 0..10 {
        let update = observer.update(&u, &measured);
        assert!(update.innovation_max < 1e-8, "{update:?}");
        assert!(update.rate_max < 1e-6, "{update:?}");
    }
    assert!(largest(observer.disturbance_moments()) > 0.01, "the softer arm needs a disturbance");
}

#[test]
fn a_look_shows_the_arm_that_the_lengths_show_and_leaves_a_start_as_it_is() {
    let config = ArmConfig::paper();
    let mut observer = Observer::new(&config, &settings(), PERIOD);
    let arm = observer.arm().clone();
    for scale in [0.5, -0.3] {
        let curvatures: Vec<f64> = (0..2 * arm.segment_count()).map(|i| scale * (1.7 * i as f64).sin()).collect();
        let truth = arm.bent(&curvatures);
        let measured = lengths(&arm, &truth);
        assert_no_alloc(|| (0..6).for_each(|_| assert!(observer.look(&measured))));
        let off = truth.iter().zip(&observer.state().q).fold(0.0f64, |a, (t, q)| a.max((t - q).abs()));
        assert!(off < 1e-6, "{off}");
        let mut broken = measured.clone();
        broken[7] = f64::NAN;
        assert!(!observer.look(&broken), "nothing is known");
        assert_eq!(lengths(&arm, &observer.state().q).len(), measured.len());
    }
    // Lengths of no arm do not carry it away for good.
    let absurd: Vec<f64> = (0..arm.cable_count()).map(|c| 10.0 * (c as f64).sin()).collect();
    for _ in 0..20 {
        observer.look(&absurd);
    }
    assert!(observer.state().q.iter().all(|q| q.is_finite()));
    let u = tensions(&arm);
    let measured = lengths(&arm, &rest(&arm, &u).q);
    let mut fresh = Observer::new(&config, &settings(), PERIOD);
    for observer in [&mut observer, &mut fresh] {
        observer.start(&measured, &u).unwrap();
    }
    assert_eq!(observer.state().q, fresh.state().q, "bit by bit");
}

#[test]
fn at_rest_the_mean_curvatures_become_exact_after_a_wrong_start() {
    let config = ArmConfig::paper();
    let mut observer = Observer::new(&config, &settings(), PERIOD);
    let arm = observer.arm().clone();
    let u = tensions(&arm);
    let mut other = config.clone();
    other.segments.iter_mut().for_each(|s| s.bending_stiffness_nm2 *= 0.95);
    let other = Arm::new(&other);
    let truth = rest(&other, &u);
    observer.start(&lengths(&arm, &arm.straight()), &u).unwrap();
    let measured = lengths(&other, &truth.q);
    let mut settled = false;
    for _ in 0..6000 {
        settled = observer.update(&u, &measured).settled;
    }
    assert!(settled);
    let (got, want) = (bends(&arm, observer.state()), bends(&other, &truth));
    for (g, w) in got.iter().zip(&want) {
        // Cables measure bend angles; what a segment's distribution of curvature adds is of second order.
        assert!((g - w).abs() < 1e-4, "{got:?} {want:?}");
    }
}

#[test]
fn a_missing_or_broken_length_leaves_the_estimate_where_it_belongs() {
    let config = ArmConfig::paper();
    let mut observer = Observer::new(&config, &settings(), PERIOD);
    let arm = observer.arm().clone();
    let u = tensions(&arm);
    let truth = rest(&arm, &u);
    let good = lengths(&arm, &truth.q);
    observer.start(&good, &u).unwrap();
    let mut broken = good.clone();
    (broken[3], broken[9]) = (f64::NAN, f64::INFINITY);
    for _ in 0..200 {
        let update = observer.update(&u, &broken);
        assert_eq!(update.missing, 2);
        assert!(!update.failed && update.innovation_max < 1e-8, "{update:?}");
    }
    // A broken length that is taken as true is an innovation beyond doubt.
    broken[9] = good[9] + 0.05;
    let update = observer.update(&u, &broken);
    assert!(update.innovation_max > 0.05 && update.innovation_growth > 0.05 && update.missing == 1, "{update:?}");
    // All cables silent: the model runs on alone.
    let update = observer.update(&u, &[f64::NAN; 24]);
    assert!(!update.failed && update.missing == 24, "{update:?}");
}

#[test]
fn latency_is_bridged_with_the_tensions_already_sent() {
    let config = ArmConfig::paper();
    let mut set = settings();
    set.latency_ticks = 3;
    let mut observer = Observer::new(&config, &set, PERIOD);
    let arm = observer.arm().clone();
    let u = tensions(&arm);
    let truth = rest(&arm, &u);
    let measured = lengths(&arm, &truth.q);
    observer.start(&measured, &u).unwrap();
    assert!((observer.prediction_s() - 0.03).abs() < 1e-12);
    let pulled: Vec<f64> = u.iter().enumerate().map(|(c, u)| u + if c == 4 { 20.0 } else { 0.0 }).collect();
    let distance =
        |o: &Observer, s: &State| largest(&s.q.iter().zip(&o.state().q).map(|(a, b)| a - b).collect::<Vec<_>>());
    observer.update(&pulled, &measured);
    // The pull has been sent but does not act yet: the estimate rests, the prediction moves.
    assert!(observer.state().q.iter().zip(&truth.q).all(|(a, b)| (a - b).abs() < 1e-7));
    let predicted = observer.predicted().clone();
    assert!(distance(&observer, &predicted) > 1e-5);
}

/// An observer that follows an arm pulled to one side, and the arm: after `ticks` ticks of 10 ms with the readings of each.
fn following(set: &ObserverConfig, ticks: usize) -> (Observer, Arm, Stepper, Scheme, State, Vec<f64>) {
    let config = ArmConfig::paper();
    let mut observer = Observer::new(&config, set, PERIOD);
    let arm = Arm::new(&config);
    let u = tensions(&arm);
    let mut truth = rest(&arm, &u);
    observer.start(&lengths(&arm, &truth.q), &u).unwrap();
    let pulled: Vec<f64> = u.iter().enumerate().map(|(c, u)| u + if c % 6 == 1 { 15.0 } else { 0.0 }).collect();
    let (mut stepper, scheme) = (Stepper::new(&arm), Scheme::new(config.rho_inf));
    for _ in 0..ticks {
        step(&arm, &mut stepper, &scheme, &pulled, &mut truth, 1);
        assert!(!observer.update(&pulled, &lengths(&arm, &truth.q)).failed);
    }
    (observer, arm, stepper, scheme, truth, pulled)
}

fn step(arm: &Arm, stepper: &mut Stepper, scheme: &Scheme, u: &[f64], truth: &mut State, periods: usize) {
    for _ in 0..periods {
        let mut next = truth.clone();
        stepper.step(arm, scheme, PERIOD, truth, u, 6, &mut next).unwrap();
        *truth = next;
    }
}

#[test]
fn an_update_over_several_periods_ends_where_as_many_updates_do() {
    for periods in [2, 5, 10] {
        let (mut often, arm, mut stepper, scheme, mut truth, u) = following(&settings(), 15);
        let (mut once, mut short) = (often.clone(), often.clone());
        let from = once.state().clone();
        for _ in 0..periods {
            step(&arm, &mut stepper, &scheme, &u, &mut truth, 1);
            often.update(&u, &lengths(&arm, &truth.q));
        }
        let measured = lengths(&arm, &truth.q);
        let update = once.update_over(&u, &measured, periods);
        assert!(!update.failed && !update.beyond_bound && !update.growing, "{update:?}");
        short.update(&u, &measured);
        let tip = |s: &State| arm.tip(&s.q, &s.qd).position;
        let error = |o: &Observer| (tip(o.state()) - tip(&truth)).norm();
        let moved = (tip(&truth) - tip(&from)).norm();
        assert!(moved > 1e-3 * f64::from(periods), "the arm is on its way: {moved} m");
        // One long step damps more than many short ones; what is left of the way is a small part of it.
        assert!(error(&once) < error(&often) + 0.04 * moved, "{} and {} of {moved}", error(&once), error(&often));
        assert!(error(&short) > 4.0 * error(&once), "{} and {}", error(&short), error(&once));
    }
}

#[test]
fn over_several_periods_the_tensions_of_the_latency_act_for_as_long_as_they_did() {
    let mut set = settings();
    set.latency_ticks = 2;
    let (observer, ..) = following(&set, 0);
    let arm = observer.arm().clone();
    let u = tensions(&arm);
    let start = lengths(&arm, &rest(&arm, &u).q);
    let with = |add: f64| u.iter().enumerate().map(|(c, u)| u + if c == 4 { add } else { 0.0 }).collect::<Vec<f64>>();
    let after = |acts: &[f64], periods| {
        let mut o = observer.clone();
        o.start(&start, &u).unwrap();
        // Two ticks' tensions are under way, and the third acts for what is left of five periods.
        o.update(&with(0.0), &start);
        o.update(&with(acts[0]), &start);
        o.update(&with(acts[1]), &start);
        o.update_over(&with(acts[2]), &start, periods);
        o.state().clone()
    };
    let bend = |s: &State| bends(&arm, s);
    // What acted: u, acts[0], acts[1], then acts[2] twice or, over two periods, not at all.
    let mean = bend(&after(&[5.0, 5.0, 5.0], 5));
    for same in [[20.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 10.0]] {
        let other = bend(&after(&same, 5));
        let apart = largest(&mean.iter().zip(&other).map(|(a, b)| a - b).collect::<Vec<_>>());
        assert!(apart < 1e-9 || apart < 1e-3 * largest(&other), "{same:?}: {mean:?} {other:?}");
    }
    assert_eq!(bend(&after(&[0.0, 0.0, 0.0], 2)), bend(&after(&[0.0, 0.0, 50.0], 2)), "it does not act yet");
}

#[test]
fn start_and_update_do_not_allocate_whichever_cables_are_missing() {
    let config = ArmConfig::paper();
    let mut set = settings();
    set.latency_ticks = 2;
    let mut observer = Observer::new(&config, &set, PERIOD);
    let arm = observer.arm().clone();
    let u = tensions(&arm);
    let measured = lengths(&arm, &rest(&arm, &u).q);
    let mut found = measured.clone();
    assert_no_alloc(|| {
        observer.start(&measured, &u).unwrap();
        for k in 0..50 {
            let cable = k % 24;
            found[cable] = if found[cable].is_nan() { measured[cable] } else { f64::NAN };
            let update = observer.update_over(&u, &found, 1 + (k % 3) as u32);
            assert!(!update.failed);
        }
    });
}

#[test]
fn a_start_refuses_what_it_cannot_use() {
    let config = ArmConfig::paper();
    let mut observer = Observer::new(&config, &settings(), PERIOD);
    let measured = lengths(observer.arm(), &observer.arm().straight());
    assert_eq!(observer.start(&measured[1..], &[0.0; 24]), Err(StartError::Input));
    assert_eq!(observer.start(&measured, &[f64::NAN; 24]), Err(StartError::Input));
    let impossible: Vec<f64> = measured.iter().enumerate().map(|(c, l)| l + if c == 0 { 5.0 } else { 0.0 }).collect();
    assert!(matches!(observer.start(&impossible, &[0.0; 24]), Err(StartError::Shape { .. })));
}
