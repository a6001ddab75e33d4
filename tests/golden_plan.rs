//! Planning steps from given states against the golden optima.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use nalgebra::{Vector3, Vector4};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::{Body, BodyGeometry};
use sinew::config::{BodyModel, WarningBranch};
use sinew::model::{Arm, State};
use sinew::planner::{Planner, Report, Status};
use support::planning::{PlanCase, plan_cases};
use support::*;

fn plan(case: &PlanCase, warning: WarningBranch, seed: u64) -> (Planner, Report) {
    let mut planner = case.planner(warning);
    let report = case.plan(&mut planner, &mut Xoshiro256PlusPlus::seed_from_u64(seed), &mut || false);
    (planner, report)
}

/// Surface distances of a state's points, one per obstacle (m).
fn point_distances(case: &PlanCase, state: &State) -> Vec<f64> {
    let arm = case.arm();
    let nodes = arm.node_count() + 1;
    let (mut r, mut t) = (vec![Vector3::zeros(); nodes], vec![Vector3::zeros(); nodes]);
    arm.frames_into(&state.q, &mut r, &mut t);
    let mut body = Body::new(&BodyGeometry::from_arm(&case.config), BodyModel::Points, 0.0);
    body.measure(&r, &t, &case.obstacles).at_points.to_vec()
}

#[test]
fn safe_and_complementarity_steps_reach_the_optimal_cost_and_tensions() {
    for case in plan_cases() {
        let (planner, report) = plan(&case, WarningBranch::Complementarity, 1);
        let (what, want, cost) = (&case.what, case.optimum(), report.cost);
        assert_eq!(report.status, Status::Converged, "{what}: {report:?}");
        assert!(((cost - want) / want).abs() <= 1e-6, "{what}: cost {cost} for {want}");
        let u = planner.tensions();
        let worst = u.iter().zip(numbers(&case.data["u_opt"])).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
        assert!(worst <= 1e-3, "{what}: tensions differ by {worst} N");
        // An interior-point solver's optimum of the full problem, where it found one: never below ours.
        if let Some(bound) = case.data["ipopt_J"].as_f64() {
            assert!(cost <= bound * (1.0 + 1e-6), "{what}: cost {cost} above IPOPT's {bound}");
        }
        assert_eq!(u.len(), case.config.cable_count());
        let planned = planner.planned();
        assert_close(&format!("{what} q1"), &planned.q, &numbers(&case.data["q1"]), 1e-6);
        assert_close(&format!("{what} v1"), &planned.qd, &numbers(&case.data["v1"]), 1e-5);
        assert_close(&format!("{what} lam1"), &planned.lambda, &numbers(&case.data["lam1"]), 1e-5);
        // The file measures to the balls' centroids.
        let distances: Vec<f64> = point_distances(&case, planned).iter().map(|d| d + 0.1).collect();
        assert_close(&format!("{what} dist_min"), &distances, &numbers(&case.data["dist_min"]), 1e-6);
        let newton = case.data["newton"].as_u64().unwrap();
        assert!(report.iterations as u64 <= newton + 1, "{what}: {} Newton iterations for {newton}", report.iterations);
    }
}

#[test]
fn the_seeded_swarm_is_never_worse_than_the_optimum_it_was_given() {
    for case in plan_cases() {
        let (_, report) = plan(&case, WarningBranch::Seeded, 7);
        let (what, want) = (&case.what, case.optimum());
        assert_eq!(report.status, Status::Converged, "{what}: {report:?}");
        assert!(report.cost <= want * (1.0 + 1e-6), "{what}: cost {} for {want}", report.cost);
    }
}

#[test]
fn the_improved_swarm_comes_as_near_to_the_optimum_as_the_reference_swarm() {
    let mut judged = 0;
    for case in plan_cases() {
        let Some(reference) = case.data["swarm_J"].as_array() else { continue };
        let worst = reference.iter().map(number).fold(0.0, f64::max);
        for seed in 1..=3 {
            let (_, report) = plan(&case, WarningBranch::Swarm, seed);
            // Within the warning subspace the swarm decides; elsewhere the safe branch is exact.
            let optimum = case.optimum();
            let allowed = optimum + 2.0 * (worst - optimum).abs().max(1e-6 * optimum);
            assert!(report.cost <= allowed, "{} seed {seed}: {} above {allowed}", case.what, report.cost);
            judged += 1;
        }
    }
    assert!(judged > 0);
}

#[test]
fn the_tip_start_has_the_reference_tensions() {
    for (file, data) in golden_files("u0") {
        let config = arm_config(&data["params"]);
        let arm = Arm::new(&config);
        let nc = arm.cable_count();
        let h = std::f64::consts::FRAC_1_SQRT_2;
        for bend in [0.5, 1.0, 1.5] {
            let mut state = State::at_rest(arm.bent(&[-bend, 0.0, 0.5 * bend, 0.0, bend, 0.0, -0.5 * bend, 0.0]));
            let u = sinew::planner::tip_start(
                &arm,
                Vector3::new(0.6, 0.0, -2.4),
                Vector4::new(h, 0.0, h, 0.0),
                &vec![0.0; nc],
                &vec![220.0; nc],
                &mut state,
            )
            .unwrap();
            let worst = u.iter().zip(numbers(&data["u0"])).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
            assert!(worst < 1e-3, "{file} bend {bend}: {worst} N");
            assert_close(&file, &state.q, &numbers(&data["q0"]), 1e-6);
        }
    }
}
