//! Closed forms of arms that change along themselves: tapered beams, cables that converge, wind around, end on the way.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use nalgebra::Vector3;
use sinew::config::{ArmConfig, Profile, Routing};
use sinew::integrator::{Stepper, equilibrium};
use sinew::model::{Arm, State};
use support::arms::*;

fn solve(arm: &Arm, u: &[f64]) -> State {
    let mut state = State::at_rest(arm.straight());
    equilibrium(arm, &mut Stepper::new(arm), u, &mut state).unwrap();
    state
}

fn curvatures(arm: &Arm, state: &State) -> Vec<Vector3<f64>> {
    (0..arm.node_count()).map(|i| arm.element_curvature(&state.q, &state.qd, i).0).collect()
}

/// Root of a growing function in `low..high`.
fn root(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    assert!(f(low) <= 0.0 && f(high) >= 0.0);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if f(middle) < 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[test]
fn a_couple_bends_a_tapered_segment_by_the_integral_of_its_compliance() {
    let (a, b, t) = (0.4, 2.5, 20.0);
    let moment = 2.0 * t * HOLE;
    // EI from a to b times its own: the slope at the end is M L ln(b/a) / (EI (b - a)); with a step, that of two beams.
    let taper = moment / EI * LENGTH * f64::ln(b / a) / (b - a);
    let step = moment / EI * LENGTH * (0.37 / a + 0.63 / b);
    let cases =
        [(Profile(vec![[0.0, a], [1.0, b]]), taper), (Profile(vec![[0.0, a], [0.37, a], [0.37, b], [1.0, b]]), step)];
    for (bending, want) in cases {
        for elements in [1, 3, 10] {
            let mut config = beam(elements);
            config.segments[0].taper.bending = bending.clone();
            let arm = Arm::new(&config);
            let state = solve(&arm, &[t, 0.0, -t, 0.0]);
            let got: f64 = curvatures(&arm, &state).iter().map(|k| k[2] * LENGTH / elements as f64).sum();
            assert!((got - want).abs() < 1e-9, "{elements} elements: {got} for {want}");
        }
    }
}

#[test]
fn a_wedge_and_a_cone_vibrate_as_kirchhoff_says() {
    // Kirchhoff 1879: first angular frequency of a cantilever that tapers to a point, over sqrt(EI / (m L^4)) at its base.
    for (of_stiffness, of_mass, want) in [(3, 1, 5.315), (4, 2, 8.719)] {
        let mut config = beam(50);
        let segment = &mut config.segments[0];
        let profile = |power: i32| {
            Profile((0..=200).map(|k| f64::from(k) / 200.0).map(|x| [x, (1.0 - x).max(2e-3).powi(power)]).collect())
        };
        segment.taper.bending = profile(of_stiffness);
        segment.taper.backbone_mass = profile(of_mass);
        let arm = Arm::new(&config);
        let (omega, _) = frequencies(&arm, &State::at_rest(arm.straight()), &[0.0; 4]);
        let got = omega[0] / (EI / (DENSITY * LENGTH.powi(4))).sqrt();
        assert!((got / want - 1.0).abs() < 5e-3, "{got} for {want}");
    }
}

/// Twist (rad) of one element under `n` helical cables of tension `t` each, which turn by `turn` over it: minimum of
/// `GJ/(2 l) (2 sin(a/2))^2 + n t length`, `length^2 = l^2 + (2 h sin((turn + a)/2))^2`.
fn twist(l: f64, gj: f64, turn: f64, n: f64, t: f64) -> f64 {
    let slope = |a: f64| {
        let length = (l * l + (2.0 * HOLE * ((turn + a) / 2.0).sin()).powi(2)).sqrt();
        gj / l * a.sin() + n * t * HOLE * HOLE * (turn + a).sin() / length
    };
    root(slope, -1.0, 1.0)
}

#[test]
fn helical_cables_twist_each_element_by_its_own_equilibrium() {
    let gj = EI / 1.3;
    for turn in [-2.0, 0.7, 3.0] {
        for elements in [4, 9] {
            let mut config = beam(elements);
            config.segments[0].route.turn = Profile(vec![[0.0, 0.0], [1.0, turn]]);
            let arm = Arm::new(&config);
            let state = solve(&arm, &[30.0; 4]);
            let l = LENGTH / elements as f64;
            let want = 2.0 * (twist(l, gj, turn / elements as f64, 4.0, 30.0) / 2.0).sin() / l;
            assert!(want * turn < 0.0 && want.abs() > 1e-2, "the cables unwind: {want}");
            for k in curvatures(&arm, &state) {
                assert!((k - Vector3::new(want, 0.0, 0.0)).norm() < 1e-8, "{turn} {elements}: {k:?} for {want}");
            }
        }
    }
}

#[test]
fn a_helical_cable_twists_to_the_continuous_limit() {
    // Torque of a cable at distance h whose hole turns at w (rad/m): -T h^2 (w + k) / sqrt(1 + h^2 (w + k)^2), balanced by GJ k.
    let (gj, w, t) = (EI / 1.3, 5.0, 40.0);
    let torque = |k: f64| 4.0 * t * HOLE.powi(2) * (w + k) / (1.0 + (HOLE * (w + k)).powi(2)).sqrt();
    let want = root(|k| gj * k + torque(k), -w, w);
    let errors: Vec<f64> = [4, 8, 16, 32]
        .iter()
        .map(|&elements| {
            let mut config = beam(elements);
            config.segments[0].route.turn = Profile(vec![[0.0, 0.0], [1.0, w * LENGTH]]);
            let arm = Arm::new(&config);
            (curvatures(&arm, &solve(&arm, &[t; 4]))[0][0] - want).abs()
        })
        .collect();
    assert!(errors[3] < 2e-3 * want.abs(), "{errors:?} of {want}");
    assert!(orders(&errors).iter().all(|o| (1.8..2.2).contains(o)), "{errors:?}");
}

#[test]
fn a_converging_cable_bends_to_the_continuous_curvature() {
    // The cable runs along (1 - k h, h') in the backbone's frame, so its moment is T h (1 - k h) / |(1 - k h, h')|.
    let (t, from, to) = (60.0, 1.2, 0.2);
    let slope = HOLE * (to - from) / LENGTH;
    let curvature = |x: f64| {
        let h = HOLE * (from + (to - from) * x);
        let moment = |k: f64| t * h * (1.0 - k * h) / (1.0 - k * h).hypot(slope);
        root(|k| EI * k - moment(k), 0.0, 5.0)
    };
    let n = 20_000;
    let want: f64 = (0..n).map(|i| curvature((f64::from(i) + 0.5) / f64::from(n)) * LENGTH / f64::from(n)).sum();
    let errors: Vec<f64> = [5, 10, 20, 40]
        .iter()
        .map(|&elements| {
            let mut config = beam(elements);
            config.segments[0].route.radius = Profile(vec![[0.0, from], [1.0, to]]);
            let arm = Arm::new(&config);
            let state = solve(&arm, &[t, 0.0, 0.0, 0.0]);
            let bend = |k: &Vector3<f64>| 2.0 * (k[2] * LENGTH / elements as f64 / 2.0).asin();
            (curvatures(&arm, &state).iter().map(bend).sum::<f64>() - want).abs()
        })
        .collect();
    assert!(errors[3] < 1e-3 * want, "{errors:?} of {want}");
    assert!(orders(&errors).iter().all(|o| (1.7..2.3).contains(o)), "{errors:?} {:?}", orders(&errors));
}

#[test]
fn lengths_of_a_straight_arm_are_those_of_a_helix_of_chords() {
    let mut config = beam(6);
    config.segments[0].route.turn = Profile(vec![[0.0, 0.3], [1.0, 2.7]]);
    config.segments[0].cable_ends = vec![1.0, 0.5, 1.0 / 6.0, 1.0];
    let arm = Arm::new(&config);
    let mut lengths = [0.0; 4];
    arm.cable_lengths_into(&arm.straight(), &mut lengths);
    let chord = (LENGTH / 6.0).hypot(2.0 * HOLE * (0.4f64 / 2.0).sin());
    for (length, elements) in lengths.iter().zip([6.0, 3.0, 1.0, 6.0]) {
        assert!((length - elements * chord).abs() < 1e-12, "{length}");
    }
}

/// Three equal beams behind one another.
fn three(routing: Routing) -> ArmConfig {
    let mut config = beam(4);
    config.routing = routing;
    config.segments = vec![config.segments[0].clone(); 3];
    config
}

#[test]
fn a_cable_bends_the_elements_between_its_start_and_its_end_and_no_others() {
    // (routing, cables_from of the last segment, end of its first cable): elements that it bends.
    let cases = [
        (Routing::Local, None, 0.75, 8..11),
        (Routing::Through, None, 0.25, 0..9),
        (Routing::Local, Some(1), 0.5, 4..10),
        (Routing::Through, Some(2), 1.0, 8..12),
    ];
    for (routing, from, end, bent) in cases {
        let mut config = three(routing);
        config.segments[2].cables_from = from;
        config.segments[2].cable_ends = vec![end, 1.0, 1.0, 1.0];
        let arm = Arm::new(&config);
        let mut u = [0.0; 12];
        u[8] = 30.0;
        let state = solve(&arm, &u);
        let (mut whole, mut alone) = (beam(1), [0.0; 4]);
        whole.segments[0].length_m = LENGTH / 4.0;
        alone[0] = 30.0;
        let one = Arm::new(&whole);
        let want = curvatures(&one, &solve(&one, &alone))[0];
        for (i, k) in curvatures(&arm, &state).iter().enumerate() {
            let want = if bent.contains(&i) { want } else { Vector3::zeros() };
            assert!((k - want).norm() < 1e-8, "{routing:?} {from:?} {end} element {i}: {k:?} for {want:?}");
        }
    }
}

#[test]
fn a_cable_stretches_by_its_tension_over_its_stiffness_and_back() {
    let mut config = beam(4);
    config.segments[0].cable_stiffness_n = Some(2e4);
    config.segments[0].cable_feed_m = 1.5;
    let arm = Arm::new(&config);
    // 100 N over 20 kN: 0.5 % of 2.15 m.
    let drum = arm.at_drum(1, 0.65, 100.0);
    assert!((drum - ((0.65 + 1.5) / 1.005 - 1.5)).abs() < 1e-15);
    assert!((arm.along_arm(1, drum, 100.0) - 0.65).abs() < 1e-15);
    let rigid = Arm::new(&beam(4));
    assert_eq!((rigid.at_drum(1, 0.65, 100.0), rigid.along_arm(1, 0.65, 100.0)), (0.65, 0.65));
}
