//! Closed forms and claims about equilibria, and about the cables that cause them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use nalgebra::{DMatrix, Rotation3, UnitQuaternion, Vector3, Vector4};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::config::{ArmConfig, ChordRule, Routing, StrainRule};
use sinew::integrator::{StaticsError, Stepper, equilibrium};
use sinew::math::quaternion::product;
use sinew::model::{Arm, Linearization, Motion, Rates, State};
use support::arms::*;

fn solve(arm: &Arm, u: &[f64]) -> State {
    let mut state = State::at_rest(arm.straight());
    equilibrium(arm, &mut Stepper::new(arm), u, &mut state).unwrap();
    state
}

/// Root of a growing function in `low..high`.
fn root(mut f: impl FnMut(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    assert!(f(low) <= 0.0 && f(high) >= 0.0);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if f(middle) < 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Angle of one element under tensions `t` (towards the bend) and `o` (opposite). In a planar chain of equal elements
/// the cables' length and the energy are sums over elements of functions of the element's own angle, so equilibrium
/// holds element by element: `E'(a) = (t - o) h cos(a/2) - (t + o) c'(a)`, c the chord.
fn element_angle(l: f64, (chord, strain): (ChordRule, StrainRule), t: f64, o: f64) -> f64 {
    root(
        |a| {
            let elastic = match strain {
                StrainRule::VectorPart => EI / l * a.sin(),
                StrainRule::Logarithm => EI / l * a,
            };
            let chord_slope = match chord {
                ChordRule::Simpson => -l / 6.0 * (a / 2.0).sin(),
                ChordRule::Trapezoid => -l / 2.0 * (a / 2.0).sin(),
            };
            elastic - (t - o) * HOLE * (a / 2.0).cos() + (t + o) * chord_slope
        },
        0.0,
        1.5,
    )
}

fn angle_between(arm: &Arm, state: &State, i: usize) -> f64 {
    let (a, b) = (arm.pose(&state.q, i).1, arm.pose(&state.q, i + 1).1);
    let c = product(&Vector4::new(a[0], -a[1], -a[2], -a[3]), &b);
    2.0 * c.fixed_rows::<3>(1).norm().atan2(c[0].abs())
}

#[test]
fn each_element_bends_by_the_angle_of_its_own_equilibrium() {
    for rules in RULES {
        for (t, o) in [(30.0, -30.0), (60.0, 0.0), (100.0, 60.0)] {
            let mut config = beam(6);
            (config.chord, config.strain) = rules;
            let arm = Arm::new(&config);
            let state = solve(&arm, &[t, 0.0, o, 0.0]);
            let want = element_angle(LENGTH / 6.0, rules, t, o);
            for i in 0..6 {
                let got = angle_between(&arm, &state, i);
                assert!((got - want).abs() < 1e-9, "{rules:?} {t} {o} element {i}: {got} for {want}");
            }
        }
    }
}

#[test]
fn a_pure_couple_gives_the_curvature_m_over_ei_whatever_the_mesh() {
    // The vector-part rule makes it exact: 2 sin(a/2)/l = M/EI.
    for chord in [ChordRule::Simpson, ChordRule::Trapezoid] {
        for elements in [1, 3, 10] {
            let mut config = beam(elements);
            config.chord = chord;
            let arm = Arm::new(&config);
            let t = 40.0;
            let state = solve(&arm, &[0.0, t, 0.0, -t]);
            let moment = 2.0 * t * HOLE;
            for i in 0..elements {
                let (k, rate) = arm.element_curvature(&state.q, &state.qd, i);
                // A hole towards z bends about -y.
                let want = Vector3::new(0.0, -moment / EI, 0.0);
                assert!((k - want).norm() < 1e-9, "{chord:?} {elements}: {k:?} for {want:?}");
                assert_eq!(rate, Vector3::zeros());
            }
        }
    }
}

#[test]
fn the_tip_of_a_bent_segment_converges_to_the_circle_with_the_mesh() {
    let t = 100.0;
    let curvature = 2.0 * t * HOLE / EI;
    let angle = curvature * LENGTH;
    let circle = Vector3::new(angle.sin() / curvature, (1.0 - angle.cos()) / curvature, 0.0);
    for rules in RULES {
        let errors: Vec<f64> = [4, 8, 16, 32]
            .iter()
            .map(|&elements| {
                let mut config = beam(elements);
                (config.chord, config.strain) = rules;
                let arm = Arm::new(&config);
                (tip(&arm, &solve(&arm, &[t, 0.0, -t, 0.0])) - circle).norm()
            })
            .collect();
        assert!(errors[3] < 1e-3 * LENGTH, "{rules:?}: {errors:?}");
        assert!(orders(&errors).iter().all(|o| (1.8..2.2).contains(o)), "{rules:?}: {errors:?} {:?}", orders(&errors));
    }
}

#[test]
fn one_cable_bends_to_the_continuous_curvature_with_the_mesh() {
    // In the limit a cable at distance h shortens by h per radian, so EI kappa = T h.
    let want = 80.0 * HOLE / EI;
    for rules in RULES {
        let errors: Vec<f64> = [4, 8, 16, 32]
            .iter()
            .map(|&elements| {
                let mut config = beam(elements);
                (config.chord, config.strain) = rules;
                let arm = Arm::new(&config);
                let state = solve(&arm, &[80.0, 0.0, 0.0, 0.0]);
                (angle_between(&arm, &state, 0) * elements as f64 / LENGTH - want).abs()
            })
            .collect();
        assert!(orders(&errors).iter().all(|o| (1.8..2.2).contains(o)), "{rules:?}: {errors:?}");
    }
}

/// Tip of the elastica under a dead transverse load, `load = P L^2/EI`: (deflection, shortening) over L.
/// Bisshopp and Drucker 1945: with `k^2 = (1 + sin a)/2` (a the tip's slope) and `sin f = 1/(k sqrt 2)`,
/// `sqrt(load) = K(k) - F(f, k)`, `deflection = 1 - 2 (E(k) - E(f, k))/sqrt(load)`,
/// `shortening = 1 - sqrt(2 sin a/load)`.
fn elastica(load: f64) -> (f64, f64) {
    let integral = |slope: f64, power: f64| {
        let k2 = 0.5 * (1.0 + slope.sin());
        let from = (1.0 / (2.0 * k2).sqrt()).asin();
        let (n, width) = (2000, std::f64::consts::FRAC_PI_2 - from);
        let f = |x: f64| (1.0 - k2 * x.sin().powi(2)).powf(power);
        let h = width / n as f64;
        (0..n).map(|i| from + i as f64 * h).map(|x| h / 6.0 * (f(x) + 4.0 * f(x + 0.5 * h) + f(x + h))).sum::<f64>()
    };
    let root_load = load.sqrt();
    let slope = root(|a| integral(a, -0.5) - root_load, 1e-9, 1.56);
    (1.0 - 2.0 * integral(slope, 0.5) / root_load, 1.0 - (2.0 * slope.sin() / load).sqrt())
}

#[test]
fn the_elastica_solution_has_the_published_values() {
    // Bisshopp and Drucker 1945; digits of Mattiasson 1981.
    for (load, deflection, shortening) in
        [(1.0, 0.30172, 0.05643), (2.0, 0.49346, 0.16064), (5.0, 0.71379, 0.38763), (10.0, 0.81061, 0.55500)]
    {
        let (d, s) = elastica(load);
        assert!((d - deflection).abs() < 1e-5 && (s - shortening).abs() < 1e-5, "{load}: {d} {s}");
    }
}

/// Equilibrium with a weight at the tip and nothing else heavy.
fn under_weight(rules: (ChordRule, StrainRule), elements: usize, load: f64) -> (Arm, State) {
    let mut config = beam(elements);
    (config.chord, config.strain) = rules;
    config.segments[0].backbone_mass_kgpm = 0.0;
    config.payload.mass_kg = 1.0;
    config.gravity_mps2 = [0.0, 0.0, -load * EI / LENGTH.powi(2)];
    let arm = Arm::new(&config);
    let state = solve(&arm, &[0.0; 4]);
    (arm, state)
}

#[test]
fn a_tip_weight_bends_the_arm_to_the_elastica_with_the_square_of_the_mesh() {
    for rules in RULES {
        for load in [1.0, 5.0, 10.0] {
            let (deflection, shortening) = elastica(load);
            let want = LENGTH * Vector3::new(1.0 - shortening, 0.0, -deflection);
            let errors: Vec<f64> = [5, 10, 20, 40]
                .iter()
                .map(|&elements| {
                    let (arm, state) = under_weight(rules, elements, load);
                    (tip(&arm, &state) - want).norm()
                })
                .collect();
            assert!(errors[3] < 1e-3 * LENGTH, "{rules:?} {load}: {errors:?}");
            let observed = orders(&errors);
            assert!(observed.iter().all(|o| (1.8..2.2).contains(o)), "{rules:?} {load}: {errors:?} {observed:?}");
        }
    }
}

#[test]
fn small_weights_give_the_linear_deflection() {
    let load = 1e-4;
    let (arm, state) = under_weight((ChordRule::Simpson, StrainRule::Logarithm), 40, load);
    let z = -tip(&arm, &state)[2] / LENGTH;
    assert!((z / (load / 3.0) - 1.0).abs() < 1e-3, "{z}");
}

fn turned(config: &ArmConfig, turn: &Rotation3<f64>, shift: Vector3<f64>) -> ArmConfig {
    let mut turned = config.clone();
    let q = UnitQuaternion::from_rotation_matrix(turn);
    let p = Vector4::new(q.w, q.i, q.j, q.k);
    turned.base_quaternion = product(&p, &Vector4::from(config.base_quaternion)).into();
    turned.gravity_mps2 = (turn * Vector3::from(config.gravity_mps2)).into();
    turned.base_position_m = (turn * Vector3::from(config.base_position_m) + shift).into();
    turned
}

#[test]
fn equilibria_turn_and_shift_along_with_base_and_gravity() {
    let turn = Rotation3::from_euler_angles(0.7, -1.1, 2.3);
    let shift = Vector3::new(1.0, -2.0, 0.5);
    for routing in [Routing::Local, Routing::Through] {
        let mut config = ArmConfig::paper();
        config.routing = routing;
        config.gravity_mps2 = [0.0, 2.0, -9.81];
        config.base_position_m = [0.1, 0.2, 0.3];
        let u: Vec<f64> = (0..24).map(|c| 15.0 + 10.0 * (f64::from(c) * 1.3).sin()).collect();
        let (a, b) = (Arm::new(&config), Arm::new(&turned(&config, &turn, shift)));
        let (x, y) = (solve(&a, &u), solve(&b, &u));
        for i in 0..=a.node_count() {
            let ((r, p), (s, o)) = (a.pose(&x.q, i), b.pose(&y.q, i));
            assert!((turn * r + shift - s).norm() < 1e-8, "{routing:?} node {i}");
            let tangents = [&p, &o].map(sinew::math::quaternion::rotation);
            assert!((turn.matrix() * tangents[0] - tangents[1]).norm() < 1e-8, "{routing:?} node {i}");
        }
        assert!((a.elastic_energy(&x.q) / b.elastic_energy(&y.q) - 1.0).abs() < 1e-8);
    }
}

fn paper_equilibrium(config: &ArmConfig, level: f64, seed: u64) -> (Arm, Vec<f64>, State) {
    let arm = Arm::new(config);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let u: Vec<f64> = random_vector(&mut rng, arm.cable_count(), level).iter().map(|x| x.abs()).collect();
    let state = solve(&arm, &u);
    (arm, u, state)
}

#[test]
fn equilibria_satisfy_the_equations_and_are_stable_minima() {
    for (seed, gravity) in [(1, 0.0), (2, -9.81), (3, -2.0)] {
        let mut config = ArmConfig::paper();
        config.gravity_mps2 = [0.0, 0.0, gravity];
        let (arm, u, state) = paper_equilibrium(&config, 20.0, seed);
        let (force, constraint) = residual(&arm, &state, &u);
        assert!(force < 1e-7 && constraint < 1e-12, "seed {seed}: {force:.1e} {constraint:.1e}");
        let n = arm.node_count();
        let (z, stiffness) = projected_stiffness(&arm, &state, &u);
        let least = stiffness.symmetric_eigenvalues().min();
        assert!(least > 0.0, "seed {seed}: {least}");
        // The same by the potential itself: every allowed small motion, put back on the constraints, costs energy.
        let energy = total_energy(&arm, &state, &u);
        for k in [0, 7, 3 * n - 1] {
            for step in [1e-4, -1e-4] {
                let mut moved = state.clone();
                for (q, d) in moved.q.iter_mut().zip(z.column(k).iter()) {
                    *q += step * d;
                }
                let moved = State::at_rest(onto_constraints(&arm, &moved.q));
                assert!(total_energy(&arm, &moved, &u) > energy, "seed {seed} motion {k}");
            }
        }
    }
}

/// The chain with the quaternions of `q`, normalised, and the positions that its chords give.
fn onto_constraints(arm: &Arm, q: &[f64]) -> Vec<f64> {
    let mut out = q.to_vec();
    let mut psi = vec![0.0; 4 * arm.node_count()];
    for node in out.chunks_exact_mut(7) {
        let norm = node[3..].iter().map(|p| p * p).sum::<f64>().sqrt();
        node[3..].iter_mut().for_each(|p| *p /= norm);
    }
    for i in 0..arm.node_count() {
        arm.constraints_into(&out, &mut psi);
        for c in 0..3 {
            out[7 * i + c] -= psi[4 * i + c];
        }
    }
    out
}

#[test]
fn large_tensions_are_reached_from_the_straight_arm() {
    let arm = Arm::new(&ArmConfig::paper());
    let mut u = vec![0.0; 24];
    (u[0], u[8], u[13], u[20]) = (220.0, 150.0, 220.0, 220.0);
    let state = solve(&arm, &u);
    let (force, constraint) = residual(&arm, &state, &u);
    assert!(force < 1e-6 && constraint < 1e-11, "{force:.1e} {constraint:.1e}");
    // A segment of two radians: far beyond what one Newton step from straight could reach.
    assert!((tip(&arm, &state) - Vector3::new(0.0, 0.0, -2.75)).norm() > 1.0);
}

#[test]
fn loads_beyond_the_path_from_straight_give_the_error_and_the_last_state_on_the_way() {
    let arm = Arm::new(&ArmConfig::paper());
    for level in [1e3, 1e4, 1e8] {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(0);
        let u: Vec<f64> = random_vector(&mut rng, 24, level).iter().map(|x| x.abs()).collect();
        let mut state = State::at_rest(arm.straight());
        let end = equilibrium(&arm, &mut Stepper::new(&arm), &u, &mut state);
        let Err(StaticsError::NotReached { share }) = end else { panic!("{level}: {end:?}") };
        assert!((0.0..1.0).contains(&share));
        let load: Vec<f64> = u.iter().map(|u| share * u).collect();
        let (force, constraint) = residual(&arm, &state, &load);
        assert!(force < 1e-5 && constraint < 1e-10, "{level}: {force:.1e} {constraint:.1e} at {share}");
    }
}

#[test]
fn tensions_that_are_not_numbers_give_the_error_and_leave_the_guess() {
    let arm = Arm::new(&ArmConfig::paper());
    for bad in [f64::NAN, f64::INFINITY] {
        let mut u = vec![10.0; 24];
        u[3] = bad;
        let mut state = State::at_rest(arm.straight());
        let end = equilibrium(&arm, &mut Stepper::new(&arm), &u, &mut state);
        assert_eq!(end, Err(StaticsError::NotReached { share: 0.0 }));
        assert_eq!(state, State::at_rest(arm.straight()));
    }
}

#[test]
fn a_column_loses_its_stability_at_eulers_load() {
    // pi^2 EI/(4 L^2) on the tip of a straight cantilever; the projected stiffness changes its sign there.
    let euler = (std::f64::consts::PI / (2.0 * LENGTH)).powi(2) * EI;
    for rules in RULES {
        let errors: Vec<f64> = [5, 10, 20]
            .iter()
            .map(|&elements| {
                let mut config = beam(elements);
                (config.chord, config.strain) = rules;
                config.segments[0].backbone_mass_kgpm = 0.0;
                config.payload.mass_kg = 1.0;
                let mut arm = Arm::new(&config);
                let load = root(|load| -least_stiffness(&mut arm, load), 0.5 * euler, 1.5 * euler);
                (load / euler - 1.0).abs()
            })
            .collect();
        let observed = orders(&errors);
        assert!(errors[2] < 0.01 && observed.iter().all(|o| (1.8..2.2).contains(o)), "{rules:?}: {errors:?}");
    }
}

/// Smallest eigenvalue of the projected stiffness of the straight arm pressed with `load` (N) at its tip.
fn least_stiffness(arm: &mut Arm, load: f64) -> f64 {
    arm.gravity = Vector3::new(-load, 0.0, 0.0);
    // Straight, with the load in its chords' multipliers.
    let mut state = State::at_rest(arm.straight());
    state.lambda.iter_mut().step_by(4).for_each(|l| *l = -load);
    let n = arm.node_count();
    let (mut upper, mut lower) = (vec![0.0; 7 * n], vec![0.0; 4 * n]);
    arm.residual_into(&Motion::from(&state), &[0.0; 4], &mut upper, &mut lower);
    for i in 0..n {
        // The base's quaternion is 1: the norm's multiplier takes the first quaternion row.
        state.lambda[4 * i + 3] = -0.5 * upper[7 * i + 3];
    }
    assert!(residual(arm, &state, &[0.0; 4]).0 < 1e-9);
    projected_stiffness(arm, &state, &[0.0; 4]).1.symmetric_eigenvalues().min()
}

/// Basis of the allowed motions, and the static tangent on it.
fn projected_stiffness(arm: &Arm, state: &State, u: &[f64]) -> (DMatrix<f64>, DMatrix<f64>) {
    // Not through the stepper: its factorisation refuses the very load at which the stiffness is singular.
    let mut linearization = Linearization::new(arm);
    arm.linearize(&Motion::from(state), u, Rates::STATIC, &mut linearization);
    let tangent = dense(&linearization.tangent);
    let (z, rows) = (allowed_motions(&tangent, arm.node_count()), coordinate_rows(arm.node_count()));
    let stiffness = z.transpose() * tangent.select_rows(&rows).select_columns(&rows) * &z;
    (z, stiffness)
}

#[test]
fn the_input_matrix_is_the_cables_virtual_work() {
    for routing in [Routing::Local, Routing::Through] {
        for seed in 0..5 {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let arm = Arm::new(&random_arm(&mut rng, routing, ChordRule::Simpson, StrainRule::VectorPart));
            let state = random_state(&mut rng, &arm);
            let (n, nc) = (7 * arm.node_count(), arm.cable_count());
            let mut g = vec![0.0; n * nc];
            arm.cable_input_into(&state.q, &mut g);
            let mut rates = vec![0.0; nc];
            arm.cable_rates_into(&state.q, &state.qd, &mut rates);
            let lengths = |h: f64| {
                let q: Vec<f64> = state.q.iter().zip(&state.qd).map(|(q, v)| q + h * v).collect();
                let mut lengths = vec![0.0; nc];
                arm.cable_lengths_into(&q, &mut lengths);
                lengths
            };
            let (ahead, behind) = (lengths(1e-5), lengths(-1e-5));
            let u = random_vector(&mut rng, nc, 50.0);
            let mut force = vec![0.0; n];
            arm.add_cable_forces(&state.q, &u, 1.0, &mut force);
            let power: f64 = force.iter().zip(&state.qd).map(|(f, v)| f * v).sum();
            let work: f64 = rates.iter().zip(&u).map(|(l, u)| -u * l).sum();
            assert!((power - work).abs() < 1e-9 * (1.0 + work.abs()), "{routing:?} {power} {work}");
            for c in 0..nc {
                let column: f64 = (0..n).map(|r| g[r * nc + c] * state.qd[r]).sum();
                assert!((column + rates[c]).abs() < 1e-11, "{routing:?} cable {c}");
                let slope = (ahead[c] - behind[c]) / 2e-5;
                assert!((slope - rates[c]).abs() < 1e-7, "{routing:?} cable {c}: {slope} for {}", rates[c]);
            }
        }
    }
}

#[test]
fn through_cables_pass_every_disk_from_the_base_and_local_ones_only_their_segment() {
    for routing in [Routing::Local, Routing::Through] {
        let mut config = ArmConfig::paper();
        config.routing = routing;
        let arm = Arm::new(&config);
        let (mut g, mut lengths) = (vec![0.0; 7 * 20 * 24], vec![0.0; 24]);
        let q = arm.bent(&[0.5, -0.3, 0.8, 0.2, -0.7, 0.4, 0.6, -0.9]);
        arm.cable_input_into(&q, &mut g);
        let straight = arm.straight();
        arm.cable_lengths_into(&straight, &mut lengths);
        for c in 0..24 {
            let segment = c / 6;
            for node in 0..20 {
                let felt = (0..7).any(|k| g[(7 * node + k) * 24 + c].abs() > 1e-12);
                let last = 5 * (segment + 1) - 1;
                // A local cable pulls on its segment's base disk too: the last node of the segment before.
                let first = if routing == Routing::Local { (5 * segment).saturating_sub(1) } else { 0 };
                assert_eq!(felt, (first..=last).contains(&node), "{routing:?} cable {c} node {node}");
            }
            let want =
                if routing == Routing::Local { 0.65 } else { 0.65 * (segment + 1) as f64 + 0.05 * segment as f64 };
            assert!((lengths[c] - want).abs() < 1e-12, "{routing:?} cable {c}: {}", lengths[c]);
        }
    }
}

#[test]
fn a_single_tension_bends_its_segment_towards_its_cable() {
    for routing in [Routing::Local, Routing::Through] {
        let mut config = ArmConfig::paper();
        config.routing = routing;
        let arm = Arm::new(&config);
        for c in 0..24 {
            let mut u = vec![0.0; 24];
            u[c] = 30.0;
            let state = solve(&arm, &u);
            let (mut k, mut kd) = ([0.0; 8], [0.0; 8]);
            arm.curvatures_into(&state.q, &state.qd, &mut k, &mut kd);
            let angle = config.segments[c / 6].hole_angles_rad[c % 6];
            for s in 0..4 {
                // Towards the hole (y, z): (k_y, k_z) along (-z, y), with T rho/EI in size and nothing across.
                let (k_y, k_z) = (k[2 * s], k[2 * s + 1]);
                let (along, across) = (-k_y * angle.sin() + k_z * angle.cos(), k_y * angle.cos() + k_z * angle.sin());
                let bends = if routing == Routing::Local { s == c / 6 } else { s <= c / 6 };
                let want = if bends { 30.0 * 0.05 / 7.0 } else { 0.0 };
                assert!((along - want).abs() < 0.03 * 0.214, "{routing:?} cable {c} segment {s}: {along} for {want}");
                assert!(across.abs() < 1e-8, "{routing:?} cable {c} segment {s}: {across}");
            }
        }
    }
}
