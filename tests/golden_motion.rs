//! Equilibria and end states against the golden data.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use sinew::integrator::{Scheme, Stepper, equilibrium};
use sinew::model::{Arm, State};
use support::*;

#[test]
fn equilibria_for_given_tensions_agree() {
    for (file, data) in golden_files("sets") {
        for set in data["sets"].as_array().unwrap() {
            let arm = Arm::new(&arm_config(&set["params"]));
            let mut stepper = Stepper::new(&arm);
            for (k, case) in set["cases"].as_array().unwrap().iter().enumerate() {
                let what = format!("{file}/{} case {k}", set["name"].as_str().unwrap());
                let mut state = State::at_rest(arm.straight());
                equilibrium(&arm, &mut stepper, &numbers(&case["u"]), &mut state).unwrap();
                assert_close(&format!("{what} q"), &state.q, &numbers(&case["q"]), 1e-7);
                // Unloaded multipliers are rounding noise: compare forces on a scale of at least 1 N.
                let want = numbers(&case["lam"]);
                let scale = want.iter().fold(1.0f64, |a, x| a.max(x.abs()));
                let worst = state.lambda.iter().zip(&want).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
                assert!(worst <= 1e-7 * scale, "{what} lambda {worst:.2e}");
                let mut lengths = vec![0.0; arm.cable_count()];
                arm.cable_lengths_into(&state.q, &mut lengths);
                assert_close(&format!("{what} lengths"), &lengths, &numbers(&case["cable_len"]), 1e-7);
                let mut curvatures = vec![0.0; 2 * arm.segment_count()];
                let mut rates = curvatures.clone();
                arm.curvatures_into(&state.q, &state.qd, &mut curvatures, &mut rates);
                let bent = numbers(&case["kappa_seg"]);
                // A straight arm is compared on a scale of 1 mm of deviation over the arm.
                let scale = bent.iter().fold(1e-3f64, |a, k| a.max(k.abs()));
                let worst = curvatures.iter().zip(&bent).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
                assert!(worst <= 1e-7 * scale, "{what} kappa_seg {worst:.2e}");
                let n = state.q.len();
                assert_close(&format!("{what} tip"), &state.q[n - 7..], &numbers(&case["tip"]), 1e-7);
            }
        }
    }
}

#[test]
fn motions_end_in_the_same_state_with_no_more_newton_iterations() {
    for (file, data) in golden_files("runs") {
        let config = arm_config(&data["params"]);
        let arm = Arm::new(&config);
        for run in data["runs"].as_array().unwrap() {
            let eta = number(&run["eta"]);
            let what = format!("{file}/{} eta {eta}", run["name"].as_str().unwrap());
            let scheme = Scheme::new(number(&run["rho_inf"]));
            let mut stepper = Stepper::new(&arm);
            // `u` names the tensions of the equilibrium at the start; a release lets go of them.
            let u = if run["name"].as_str().unwrap().starts_with("release") {
                vec![0.0; arm.cable_count()]
            } else {
                run["u"].as_str().map_or_else(|| numbers(&run["u"]), |key| numbers(&run[key]))
            };
            let mut state = State::at_rest(numbers(&run["q0"]));
            state.lambda.copy_from_slice(&numbers(&run["lam0"]));
            let mut next = state.clone();
            let steps = (number(&run["T"]) / eta).round() as usize;
            let (mut total, mut most) = (0, 0);
            let mut trajectory = run["traj"].as_array().unwrap().iter().peekable();
            for k in 1..=steps {
                let report = stepper.step(&arm, &scheme, eta, &state, &u, 20, &mut next).unwrap();
                assert!(report.converged, "{what} step {k}");
                total += report.iterations;
                most = most.max(report.iterations);
                std::mem::swap(&mut state, &mut next);
                if let Some(row) = trajectory.next_if(|r| (number(&r[0]) - k as f64 * eta).abs() < 1e-9) {
                    let n = state.q.len();
                    let mut got = state.q[n - 7..].to_vec();
                    got.extend_from_slice(&state.qd[n - 7..n - 4]);
                    assert_close(&format!("{what} tip at step {k}"), &got, &numbers(row)[1..], 1e-7);
                }
            }
            assert!(trajectory.next().is_none(), "{what}: trajectory not used up");
            assert_close(&format!("{what} q_end"), &state.q, &numbers(&run["q_end"]), 1e-7);
            assert_close(&format!("{what} v_end"), &state.qd, &numbers(&run["v_end"]), 1e-7);
            assert_close(&format!("{what} lam_end"), &state.lambda, &numbers(&run["lam_end"]), 1e-7);
            assert!(most as u64 <= run["newton_max"].as_u64().unwrap(), "{what}: {most} Newton iterations");
            let mean = total as f64 / steps as f64;
            assert!(mean < number(&run["newton_mean"]) + 0.05, "{what}: {mean} Newton iterations on average");
        }
    }
}
