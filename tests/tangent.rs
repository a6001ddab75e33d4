//! The analytic tangent against central differences of the residual, entry by entry over the whole matrix.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::config::Routing;
use sinew::math::block_tridiagonal::BLOCK;
use sinew::math::chain::Factor;
use sinew::model::{Arm, CurvatureSensitivity, Linearization, Motion, Rates, State};
use support::arms::*;

const SCALE: f64 = 50.0;

/// Residual in the order and scaling of the tangent at `state + x`, rates and accelerations following.
fn moved_residual(arm: &Arm, state: &State, u: &[f64], rates: Rates, row: usize, x: f64) -> Vec<f64> {
    let mut s = state.clone();
    let (node, c) = (row / BLOCK, row % BLOCK);
    if c < 7 {
        s.q[7 * node + c] += x;
        s.qd[7 * node + c] += rates.cg * x;
        s.qdd[7 * node + c] += rates.cb * x;
    } else {
        s.lambda[4 * node + c - 7] += SCALE * x;
    }
    let n = arm.node_count();
    let (mut upper, mut lower) = (vec![0.0; 7 * n], vec![0.0; 4 * n]);
    arm.residual_into(&Motion::from(&s), u, &mut upper, &mut lower);
    (0..n)
        .flat_map(|i| {
            upper[7 * i..7 * i + 7]
                .iter()
                .copied()
                .chain(lower[4 * i..4 * i + 4].iter().map(|v| SCALE * v))
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Dense central differences with Richardson's extrapolation: the error is of fourth order in the step.
fn differences(arm: &Arm, state: &State, u: &[f64], rates: Rates) -> DMatrix<f64> {
    let n = BLOCK * arm.node_count();
    let mut m = DMatrix::zeros(n, n);
    for column in 0..n {
        let slope = |h: f64| -> Vec<f64> {
            let (a, b) =
                (moved_residual(arm, state, u, rates, column, h), moved_residual(arm, state, u, rates, column, -h));
            a.iter().zip(&b).map(|(a, b)| (a - b) / (2.0 * h)).collect()
        };
        let (fine, coarse) = (slope(1e-4), slope(2e-4));
        for r in 0..n {
            m[(r, column)] = (4.0 * fine[r] - coarse[r]) / 3.0;
        }
    }
    m
}

fn each_case(mut check: impl FnMut(&str, &Arm, &State, &[f64], Rates)) {
    for routing in [Routing::Local, Routing::Through] {
        for (chord, strain) in RULES {
            for seed in 0..5 {
                let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
                let mut config = random_arm(&mut rng, routing, chord, strain);
                if seed == 0 {
                    // The smallest arm: one element, one node.
                    config.segments.truncate(1);
                    config.segments[0].elements = 1;
                }
                if seed > 1 {
                    vary(&mut rng, &mut config);
                }
                let mut arm = Arm::new(&config);
                if seed > 2 {
                    // As friction leaves tensions.
                    let shares: Vec<f64> = arm.passes.iter().map(|_| rng.random_range(0.8..1.2)).collect();
                    arm.take_shares(&shares);
                }
                let state = random_state(&mut rng, &arm);
                let u = random_vector(&mut rng, arm.cable_count(), 60.0);
                for rates in [Rates::STATIC, Rates { cg: 20.0, cb: 0.0 }, Rates { cg: 15.0, cb: 300.0 }] {
                    check(&format!("{routing:?} {chord:?} {strain:?} seed {seed} {rates:?}"), &arm, &state, &u, rates);
                }
            }
        }
    }
}

fn linearize(arm: &Arm, state: &State, u: &[f64], rates: Rates) -> Linearization {
    let mut out = Linearization::new(arm);
    out.scale = SCALE;
    arm.linearize(&Motion::from(state), u, rates, &mut out);
    out
}

#[test]
fn the_tangent_is_the_derivative_of_the_residual_and_nothing_lies_outside_its_blocks() {
    let mut nodes = Vec::new();
    each_case(|what, arm, state, u, rates| {
        let (got, want) = (dense(&linearize(arm, state, u, rates).tangent), differences(arm, state, u, rates));
        let size = want.amax();
        for (k, (g, w)) in got.iter().zip(want.iter()).enumerate() {
            let (r, c) = (k % got.nrows(), k / got.nrows());
            assert!((g - w).abs() <= 1e-8 * size, "{what}: row {r} column {c}: {g} for {w} of {size}");
        }
        nodes.push(arm.node_count());
    });
    // Blocks beyond the three diagonals exist only from three nodes on.
    assert!(nodes.iter().any(|&n| n >= 6) && nodes.contains(&1), "{nodes:?}");
}

#[test]
fn the_tangent_has_the_derivative_of_the_cables_forces() {
    // The part that is often left out: it is what the tensions change.
    each_case(|what, arm, state, u, rates| {
        let with = dense(&linearize(arm, state, u, rates).tangent);
        let without = dense(&linearize(arm, state, &vec![0.0; u.len()], rates).tangent);
        let part = &with - &without;
        let size = part.amax();
        assert!(size > 1.0, "{what}");
        let n = arm.node_count();
        for column in coordinate_rows(n) {
            let force = |h: f64| {
                let mut q = state.q.clone();
                q[7 * (column / BLOCK) + column % BLOCK] += h;
                let mut out = vec![0.0; 7 * n];
                arm.add_cable_forces(&q, u, -1.0, &mut out);
                out
            };
            let (ahead, behind) = (force(1e-5), force(-1e-5));
            for (k, row) in coordinate_rows(n).into_iter().enumerate() {
                let want = (ahead[k] - behind[k]) / 2e-5;
                assert!((part[(row, column)] - want).abs() < 1e-6 * size, "{what}: row {row} column {column}");
            }
        }
    });
}

#[test]
fn the_static_tangent_is_symmetric_and_so_is_the_mass() {
    each_case(|what, arm, state, u, rates| {
        if rates == Rates::STATIC {
            // Without motion: the gyroscopic and inertial parts of a moving state are not gradients.
            let still = State { lambda: state.lambda.clone(), ..State::at_rest(state.q.clone()) };
            let tangent = dense(&linearize(arm, &still, u, rates).tangent);
            assert!((&tangent - tangent.transpose()).amax() <= 1e-12 * tangent.amax(), "{what}");
            let mut mass = Linearization::new(arm).tangent;
            arm.mass_into(&state.q, SCALE, &mut mass);
            let mass = dense(&mass);
            assert!((&mass - mass.transpose()).amax() <= 1e-14 * mass.amax(), "{what}");
        }
    });
}

#[test]
fn the_left_side_less_the_input_is_the_residual() {
    each_case(|what, arm, state, u, rates| {
        let l = linearize(arm, state, u, rates);
        let want = moved_residual(arm, state, u, rates, 0, 0.0);
        let size = want.iter().fold(0.0f64, |a, v| a.max(v.abs()));
        let mut b = vec![0.0; 7 * want.len() / BLOCK * u.len()];
        l.input_into(arm, &mut b);
        // A product with B is B's: sum and difference of all cables.
        let t: Vec<f64> = (0..u.len()).flat_map(|c| [1.0, 1.0 - 2.0 * (c % 2) as f64]).collect();
        let mut bt = vec![0.0; 2 * 7 * want.len() / BLOCK];
        l.input_times_into(arm, &t, 2, &mut bt);
        let mut force = vec![0.0; 7 * want.len() / BLOCK];
        l.force_into(arm, u, &mut force);
        for (r, want) in want.iter().enumerate() {
            if r % BLOCK >= 7 {
                assert!((l.f[r] - want).abs() <= 1e-12 * size, "{what} row {r}: {} for {want}", l.f[r]);
                assert_eq!(l.pull[r], 0.0, "{what} row {r}: a constraint");
                continue;
            }
            let at = 7 * (r / BLOCK) + r % BLOCK;
            let row = &b[at * u.len()..(at + 1) * u.len()];
            for (k, got) in bt[2 * at..2 * at + 2].iter().enumerate() {
                let want: f64 = row.iter().zip(t[k..].iter().step_by(2)).map(|(b, t)| b * t).sum();
                assert!((got - want).abs() <= 1e-12, "{what} row {r}: {got} for {want}");
            }
            let input: f64 = row.iter().zip(u).map(|(b, u)| b * u).sum();
            assert!((l.f[r] - input - want).abs() <= 1e-12 * size, "{what} row {r}: {} for {want}", l.f[r] - input);
            assert!((force[at] - input).abs() <= 1e-12 * size, "{what} row {r}: {} for {input}", force[at]);
            assert!((l.pull[r] - input).abs() <= 1e-12 * size, "{what} row {r}: {} for {input}", l.pull[r]);
        }
    });
}

#[test]
fn the_elimination_solves_the_system_of_every_arm() {
    each_case(|what, arm, state, u, rates| {
        let l = linearize(arm, state, u, rates);
        let n = arm.node_count();
        let mut factor = Factor::new(n);
        factor.factor(&l.tangent).unwrap();
        let dense = dense(&l.tangent);
        let rhs: Vec<f64> = (0..BLOCK * n).map(|r| (r as f64 * 0.7).sin()).collect();
        let (mut x, mut back) = (rhs.clone(), vec![0.0; rhs.len()]);
        factor.solve_in_place(&mut x);
        l.tangent.multiply_into(&x, &mut back);
        let largest = x.iter().fold(0.0f64, |a, v| a.max(v.abs()));
        for (r, (got, want)) in back.iter().zip(&rhs).enumerate() {
            let bound = 1e-9 * (1.0 + dense.row(r).amax() * largest);
            assert!((got - want).abs() <= bound, "{what} row {r}: {got} for {want}");
        }
    });
}

#[test]
fn curvature_sensitivities_are_the_derivatives_of_the_mean_curvatures() {
    each_case(|what, arm, state, _, rates| {
        let outputs = 2 * arm.segment_count();
        let mean = |node: usize, c: usize, h: f64| {
            let (mut q, mut qd) = (state.q.clone(), state.qd.clone());
            q[7 * node + 3 + c] += h;
            qd[7 * node + 3 + c] += rates.cg * h;
            let (mut k, mut kd) = (vec![0.0; outputs], vec![0.0; outputs]);
            arm.curvatures_into(&q, &qd, &mut k, &mut kd);
            [k, kd].concat()
        };
        let n = arm.node_count();
        let mut got = vec![DMatrix::<f64>::zeros(2 * outputs, 4); n + 1];
        for (i, element) in arm.elements.iter().enumerate() {
            let CurvatureSensitivity { k, kd } = arm.curvature_sensitivity(&state.q, &state.qd, i, rates.cg);
            for end in 0..2 {
                for o in 0..2 {
                    for c in 0..4 {
                        got[i + end][(2 * element.segment + o, c)] += k[end][(o, c)];
                        got[i + end][(outputs + 2 * element.segment + o, c)] += kd[end][(o, c)];
                    }
                }
            }
        }
        for node in 0..n {
            for c in 0..4 {
                let (ahead, behind) = (mean(node, c, 1e-5), mean(node, c, -1e-5));
                for o in 0..2 * outputs {
                    let want = (ahead[o] - behind[o]) / 2e-5;
                    let got = got[node + 1][(o, c)];
                    assert!((got - want).abs() < 1e-6 * (1.0 + want.abs()), "{what} node {node} {c} {o}: {got} {want}");
                }
            }
        }
    });
}

#[test]
fn constraint_rates_and_accelerations_are_time_derivatives_of_the_constraints() {
    each_case(|what, arm, state, _, rates| {
        if rates != Rates::STATIC {
            return;
        }
        let m = 4 * arm.node_count();
        let at = |h: f64| {
            let q: Vec<f64> = state.q.iter().zip(&state.qd).map(|(q, v)| q + h * v).collect();
            let mut psi = vec![0.0; m];
            arm.constraints_into(&q, &mut psi);
            psi
        };
        let (mut rate, mut minus_acceleration) = (vec![0.0; m], vec![0.0; m]);
        arm.constraint_rate_into(&state.q, &state.qd, &mut rate);
        arm.constraint_acceleration_into(&state.q, &state.qd, &mut minus_acceleration);
        let h = 1e-4;
        let (ahead, here, behind) = (at(h), at(0.0), at(-h));
        for k in 0..m {
            let slope = (ahead[k] - behind[k]) / (2.0 * h);
            assert!((rate[k] - slope).abs() < 1e-6, "{what} {k}: {} for {slope}", rate[k]);
            let bend = (ahead[k] - 2.0 * here[k] + behind[k]) / (h * h);
            assert!((minus_acceleration[k] + bend).abs() < 1e-5, "{what} {k}: {} for {bend}", -minus_acceleration[k]);
        }
    });
}

#[test]
fn inertia_gyroscopic_and_elastic_forces_are_lagranges() {
    // d/dt(dT/dq') - dT/dq and dE/dq from the energies alone: their power would not show a gyroscopic sign.
    each_case(|what, arm, state, _, rates| {
        if rates != Rates::STATIC {
            return;
        }
        let n = state.q.len();
        let (mut dynamic, mut elastic) = (vec![0.0; n], vec![0.0; n]);
        arm.add_inertia(&state.q, &state.qdd, &mut dynamic);
        arm.add_gyroscopic(&state.q, &state.qd, &mut dynamic);
        arm.add_elastic(&state.q, &mut elastic);
        let along = |x: &[f64], v: &[f64], t: f64| x.iter().zip(v).map(|(x, v)| x + t * v).collect::<Vec<_>>();
        let bump = |x: &[f64], k: usize, h: f64| {
            let mut x = x.to_vec();
            x[k] += h;
            x
        };
        let h = 1e-4;
        for k in 0..n {
            // T is quadratic in the rates, so this difference is exact.
            let momentum = |t: f64| {
                let (q, qd) = (along(&state.q, &state.qd, t), along(&state.qd, &state.qdd, t));
                (arm.kinetic_energy(&q, &bump(&qd, k, 1.0)) - arm.kinetic_energy(&q, &bump(&qd, k, -1.0))) / 2.0
            };
            let of_q = |f: &dyn Fn(&[f64]) -> f64| (f(&bump(&state.q, k, h)) - f(&bump(&state.q, k, -h))) / (2.0 * h);
            let want = (momentum(h) - momentum(-h)) / (2.0 * h) - of_q(&|q| arm.kinetic_energy(q, &state.qd));
            assert!((dynamic[k] - want).abs() < 1e-7, "{what} row {k}: {} for {want}", dynamic[k]);
            let want = of_q(&|q| arm.elastic_energy(q));
            assert!((elastic[k] - want).abs() < 1e-5, "{what} row {k}: {} for {want}", elastic[k]);
        }
    });
}
