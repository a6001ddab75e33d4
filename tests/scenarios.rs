//! The paper's examples in open loop against the golden runs and the bounds that a plan must keep.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use sinew::config::{BodyModel, ScenarioConfig, WarningBranch};
use sinew::report::Summary;
use sinew::scenario::Run;
use support::*;

#[test]
fn plans_without_avoidance_follow_the_golden_runs_at_every_step() {
    for (file, data) in golden_files("kappa") {
        let name = format!("{}-no-avoidance", data["scenario"].as_str().unwrap());
        let mut scenario = ScenarioConfig::find(&name).unwrap();
        scenario.arm = arm_config(&data["params"]);
        let mut run = Run::new(&scenario, 1).unwrap();
        let times = numbers(&data["t"]);
        let mut worst = (0.0f64, 0.0f64);
        for (k, t) in times.iter().enumerate() {
            while (run.steps() as f64 + 0.5) * scenario.planner.lookahead_s < *t {
                run.step(&mut || 0).unwrap();
            }
            let u = numbers(&data["u"][k]);
            let du = run.tensions().iter().zip(&u).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
            let n = run.state().q.len();
            let tip = numbers(&data["tip"][k]);
            let dr = run.state().q[n - 7..].iter().zip(&tip).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
            worst = (worst.0.max(du), worst.1.max(dr));
            assert!(du <= 1e-3, "{file} at {t} s: tensions differ by {du} N");
            assert!(dr <= 1e-6, "{file} at {t} s: tip differs by {dr} m");
        }
        assert_eq!(run.steps(), run.total(), "{file}: {worst:?}");
    }
}

fn run(name: &str, warning: WarningBranch, body: BodyModel, seed: u64) -> Summary {
    let mut scenario = ScenarioConfig::find(name).unwrap();
    scenario.planner.warning = warning;
    scenario.planner.body = body;
    let mut run = Run::new(&scenario, seed).unwrap();
    let mut collector = run.collector();
    while run.steps() < run.total() {
        let step = run.step(&mut || 0).unwrap();
        assert!(run.tensions().iter().all(|u| (0.0..=220.0).contains(u)), "{name}: {:?}", run.tensions());
        run.collect(&step, &mut collector);
    }
    collector.summary(name, seed, 0.1, 0.1, false)
}

/// No obstacle is entered deeper than `depth` (m) by the planned body.
fn keeps_clear(s: &Summary, warning: WarningBranch, body: BodyModel, depth: f64) {
    for o in &s.obstacles {
        let d = match body {
            BodyModel::Points => o.points.surface_distance_min_m,
            BodyModel::Arm => o.surface_distance_min_m,
        };
        assert!(d >= -depth, "{} {warning:?} {body:?}: {d} m to obstacle {}", s.scenario, o.id);
    }
}

/// What the issue of a plan with obstacles is: distances on the planned body, error of the tip, failed steps.
fn judge(name: &str, warning: WarningBranch, body: BodyModel, depth: f64) -> Summary {
    let s = run(name, warning, body, 1);
    keeps_clear(&s, warning, body, depth);
    if let Some(e) = &s.tip_error_m {
        assert!(e.norm_max <= 12e-3, "{name} {warning:?} {body:?}: tip error {}", e.norm_max);
        assert!(s.quaternion_error_max.unwrap() <= 4e-3, "{name} {warning:?} {body:?}");
    }
    s
}

#[test]
fn exact_branches_keep_their_distance_and_never_fail_a_step() {
    for name in ["tip", "shape"] {
        for warning in [WarningBranch::Complementarity, WarningBranch::Seeded] {
            for body in [BodyModel::Points, BodyModel::Arm] {
                let s = judge(name, warning, body, 1e-6);
                assert_eq!(s.not_converged, Some(0), "{name} {warning:?} {body:?}");
                assert!(s.newton.warning.is_some(), "{name}: no step was near an obstacle");
            }
        }
    }
}

#[test]
fn the_swarm_alone_stays_within_the_softness_of_its_penalty() {
    for body in [BodyModel::Points, BodyModel::Arm] {
        for name in ["tip", "shape"] {
            judge(name, WarningBranch::Swarm, body, 0.5e-3);
        }
        // The tip's error is a matter of the seed (see the scenario's file): the middle one keeps the bound, too.
        let mut errors: Vec<f64> = (1..=5)
            .map(|seed| {
                let s = run("tip", WarningBranch::Swarm, body, seed);
                keeps_clear(&s, WarningBranch::Swarm, body, 0.5e-3);
                assert!(s.quaternion_error_max.unwrap() <= 4e-3, "{body:?} seed {seed}");
                s.tip_error_m.unwrap().norm_max
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[2] <= 12e-3, "{body:?}: {errors:?}");
    }
}

#[test]
fn the_tip_example_without_avoidance_gives_the_reference_figures() {
    let s = run("tip-no-avoidance", WarningBranch::Seeded, BodyModel::Points, 1);
    let e = s.tip_error_m.unwrap();
    // Design section 12: -6.7e-3..6.7e-3 m over all axes, y -4.0e-3..5.4e-3 m.
    for (got, want) in [(e.min[0], -6.69e-3), (e.max[0], 6.69e-3), (e.min[1], -4.11e-3), (e.max[1], 5.36e-3)] {
        assert!((got - want).abs() < 0.02e-3, "{got} for {want}");
    }
    assert_eq!(s.not_converged, Some(0));
    let inside = &s.obstacles[1].points.inside_s;
    assert_eq!(inside, &[[7.9, 21.7], [41.7, 48.2], [82.1, 84.9]]);
    assert!(s.tension_n.saturated.is_empty());
    assert!((s.tension_n.max - 162.99).abs() < 0.01, "{}", s.tension_n.max);
}

#[test]
fn the_shape_example_saturates_the_paper_s_cables_at_the_reference_times() {
    let s = run("shape-no-avoidance", WarningBranch::Seeded, BodyModel::Points, 1);
    let names: Vec<_> = s.tension_n.saturated.keys().cloned().collect();
    assert_eq!(names, ["3,3", "4,3"]);
    assert!((s.curvature_error_final_1pm.unwrap() - 0.0592).abs() < 1e-4);
    let first = &s.obstacles[0].points;
    assert_eq!(first.inside_s, [[13.8, 18.2]]);
    assert!((first.surface_distance_min_m + 0.0543619).abs() < 1e-6, "{}", first.surface_distance_min_m);
}

/// The tip example without avoidance over 20 s, with other settings: ticks, largest tip error (m).
fn tip_with(change: impl Fn(&mut ScenarioConfig)) -> (u64, f64) {
    let mut scenario = ScenarioConfig::find("tip-no-avoidance").unwrap();
    scenario.duration_s = 20.0;
    change(&mut scenario);
    let mut run = Run::new(&scenario, 1).unwrap();
    let mut collector = run.collector();
    while run.steps() < run.total() {
        let step = run.step(&mut || 0).unwrap();
        run.collect(&step, &mut collector);
    }
    assert!((run.steps() as f64 * scenario.planner.period_s - 20.0).abs() < 1e-9);
    let s = collector.summary("tip", 1, scenario.planner.period_s, scenario.planner.lookahead_s, false);
    (s.ticks, s.tip_error_m.unwrap().norm_max)
}

#[test]
fn a_period_below_the_lookahead_keeps_the_pace_and_a_lead_takes_the_lag_away() {
    let (ticks, paper) = tip_with(|_| ());
    assert_eq!(ticks, 200);
    // The lag is that of the weights, whatever the period; by backward Euler it is 0.1 s where the paper's setting has 0.198.
    for (period_s, want) in [(0.05, 400), (0.02, 1000)] {
        let (ticks, error) = tip_with(|s| s.planner.period_s = period_s);
        assert_eq!(ticks, want);
        assert!(
            (error - 0.1 / 0.198 * paper).abs() < 1e-3,
            "{period_s} s: {error} m, {paper} m in the paper's setting"
        );
    }
    for (period_s, lead_s) in [(0.1, 0.2), (0.02, 0.1)] {
        let (_, led) = tip_with(|s| (s.planner.period_s, s.planner.lead_s) = (period_s, Some(lead_s)));
        assert!(led < 0.35 * paper, "{period_s} s: {led} m with a lead, {paper} m without");
    }
}

#[test]
fn the_same_seed_gives_the_same_plan() {
    let a = run("tip", WarningBranch::Seeded, BodyModel::Arm, 3);
    let b = run("tip", WarningBranch::Seeded, BodyModel::Arm, 3);
    assert_eq!(a, b);
}
