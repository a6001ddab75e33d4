//! Short closed-loop runs of the study: observer, planner and plant together.
#![allow(dead_code)] // the study's modules, of which a test uses a part
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test stops where it cannot go on

#[path = "../examples/observers/closed_loop.rs"]
mod closed_loop;
#[path = "../examples/observers/scenario.rs"]
mod scenario;
#[path = "../examples/observers/settings.rs"]
mod settings;

use closed_loop::{Case, Outcome, run};
use settings::Choice;

fn tip(case: Case, duration: f64, change: impl Fn(&mut Choice), seed: u64) -> Outcome {
    let mut choice = Choice { duration, short: duration, ..Choice::default() };
    change(&mut choice);
    run(&choice.settings(), case, seed)
}

/// What must not differ between two runs: everything but the time they took.
fn figures(o: &Outcome) -> ([f64; 3], [f64; 6], usize) {
    let rest = [o.quaternion_error, o.distance_arm.0, o.estimate_error, o.roughness, o.innovation, o.distance_points.0];
    (o.tip_error, rest, o.relaxed)
}

#[test]
fn two_runs_with_one_seed_are_the_same_bit_for_bit() {
    let once = tip(Case::Obstacles, 1.0, |_| (), 3);
    assert_eq!(once.failed, None);
    assert!(once.warning > 0, "the run must pass through the swarm");
    assert_eq!(figures(&once), figures(&tip(Case::Obstacles, 1.0, |_| (), 3)));
    assert_ne!(figures(&once), figures(&tip(Case::Obstacles, 1.0, |_| (), 4)));
}

#[test]
fn the_first_evasion_of_the_tip_example_keeps_clear_with_every_plant() {
    for seed in 1..=2 {
        let o = tip(Case::Wide, 10.0, |_| (), seed);
        assert_eq!(o.failed, None);
        // 10 mm of clearance less what the estimate errs by; design section 6 had 13.5 mm of estimate error at best.
        assert!(o.distance_arm.0 > 5e-3 && o.distance_arm.0 < 20e-3, "seed {seed}: {}", o.line());
        assert!(o.tip_error[0] < 3e-3 && o.tip_error[1] < 8e-3 && o.estimate_error < 8e-3, "seed {seed}: {}", o.line());
    }
}

#[test]
fn holding_a_pose_is_steady_at_periods_of_5_10_and_20_milliseconds() {
    for period in [0.005, 0.01, 0.02] {
        let o = tip(Case::Hold, 8.0, |c| c.period = period, 1);
        assert_eq!(o.failed, None);
        assert!(o.tip_error[1] < 5e-3 && o.roughness < 0.5, "{period} s: {}", o.line());
    }
}

#[test]
fn latency_is_harmless_once_compensated_from_a_millisecond_to_two_hundred() {
    for (period, latency, duration) in [(0.001, 1, 1.0), (0.001, 2, 1.0), (0.01, 1, 8.0), (0.02, 10, 8.0)] {
        let change = |c: &mut Choice| (c.period, c.latency) = (period, latency);
        let o = tip(Case::Latency, duration, change, 1);
        assert_eq!(o.failed, None, "{latency} ticks of {period} s");
        assert!(o.tip_error[1] < 8e-3, "{latency} ticks of {period} s: {}", o.line());
    }
}
