//! Obstacles beside the clamped base, where no tension moves the arm: the rest of the plan does not suffer from them.

use super::*;
use sinew::config::ScenarioConfig;
use sinew::scenario::Run;

/// Two seconds in which the tip goes 60 mm along y.
const MOTION: &str = r#"
name = "base"
duration_s = 2.0
weight_tension_change = [1e4, 2e4, 3e4, 4e4]
[task]
mode = "tip"
weight_pose = 5e12
weight_rate = 5e10
weight_damping = 1e8
[task.path]
kind = "waypoints"
[[task.path.waypoints]]
time_s = 0.0
position_m = [0.6, 0.0, -2.4]
quaternion = [0.7071067811865476, 0.0, 0.7071067811865476, 0.0]
[[task.path.waypoints]]
time_s = 2.0
position_m = [0.6, 0.06, -2.4]
quaternion = [0.7071067811865476, 0.0, 0.7071067811865476, 0.0]
[start]
kind = "tip_pose"
guess_curvatures_1pm = [-1.0, 0.0, 0.5, 0.0, 1.0, 0.0, -0.5, 0.0]
[planner]
clearance_m = 0.01
"#;

/// A plane at this height that the arm hangs through, as the one that it is mounted on.
fn plane(z_m: f64) -> String {
    format!(
        "[[obstacles]]\nid = \"plane\"\nshape = \"half_space\"\nposition_m = [0.0, 0.0, {z_m}]\nquaternion = [0.0, 1.0, 0.0, 0.0]\n"
    )
}

/// A box beside the base whose face is 5 mm from the backbone.
const BRACKET: &str = "[[obstacles]]\nid = \"bracket\"\nshape = \"box\"\nhalf_extents_m = [0.02, 0.05, 0.05]\nposition_m = [-0.025, 0.0, -0.03]\n";

/// A ball in the tip's way.
const BALL: &str = "[[obstacles]]\nid = \"ball\"\nshape = \"ball\"\nradius_m = 0.1\nposition_m = [0.6, 0.13, -2.4]\n";

struct Motion2s {
    tip_error: f64,
    tension: f64,
    /// Least distance to the last obstacle (m).
    distance: f64,
    not_converged: usize,
    relaxed: usize,
    hopeless: usize,
}

fn motion(obstacles: &str, change: impl Fn(&mut PlannerConfig)) -> Motion2s {
    let mut scenario = ScenarioConfig::parse("base.toml", &format!("{MOTION}{obstacles}")).unwrap();
    change(&mut scenario.planner);
    let mut run = Run::new(&scenario, 1).unwrap();
    let mut m =
        Motion2s { tip_error: 0.0, tension: 0.0, distance: f64::INFINITY, not_converged: 0, relaxed: 0, hopeless: 0 };
    while run.steps() < run.total() {
        let step = run.step(&mut || 0).unwrap();
        let goal = run.course().goal(step.time_s);
        let (error, _) = sinew::report::tip_error(&goal, &step.tip).unwrap();
        m.tip_error = m.tip_error.max(Vector3::from(error).norm());
        m.tension = run.tensions().iter().fold(m.tension, |a, u| a.max(*u));
        m.distance = m.distance.min(run.distances().0.last().copied().unwrap_or(f64::INFINITY));
        m.not_converged += usize::from(step.report.status != Status::Converged);
        m.relaxed += usize::from(step.report.relaxed);
        m.hopeless += usize::from(step.report.hopeless > 0);
    }
    m
}

#[test]
fn a_motion_that_runs_away_ends() {
    // A bracket 3 mm from the backbone of which 10 mm are asked at once: the pairs just above it take all tensions there
    // are, and no motion is left that a step of 0.1 s can tell.
    let bracket = BRACKET.replace("[-0.025, 0.0, -0.03]", "[-0.023, 0.0, -0.036]");
    let mut ended = 0;
    for branch in [WarningBranch::Seeded, WarningBranch::Complementarity] {
        for iterations in [2, 5, 30] {
            let mut scenario = ScenarioConfig::parse("base.toml", &format!("{MOTION}{bracket}")).unwrap();
            (scenario.planner.warning, scenario.planner.newton_iterations_max) = (branch, iterations);
            let mut run = Run::new(&scenario, 1).unwrap();
            while run.steps() < run.total() {
                let before = run.tensions().to_vec();
                match run.step(&mut || 0) {
                    Ok(step) => {
                        let far = step.tip.position.norm();
                        assert!(far < 10.0, "{branch:?}, {iterations} iterations: the tip at {far} m");
                    }
                    Err(_) => {
                        assert_eq!(run.tensions(), before, "the last tensions are kept");
                        ended += 1;
                        break;
                    }
                }
            }
        }
    }
    assert!(ended > 0, "some of them diverge");
}

const BARRIER: Option<BarrierConfig> = Some(BarrierConfig { gamma: 0.3, activation_m: 0.15 });

#[test]
fn a_plane_or_a_bracket_at_the_base_leaves_the_motion_as_it_is_without() {
    let free = motion("", |_| ());
    assert!(free.tip_error < 7e-3 && free.tension < 140.0, "{} m, {} N", free.tip_error, free.tension);
    let scenes = [("plane", plane(0.0)), ("5 mm", plane(-0.005)), ("20 mm", plane(-0.02)), ("bracket", BRACKET.into())];
    for (what, obstacles) in scenes {
        for branch in [WarningBranch::Seeded, WarningBranch::Complementarity] {
            for iterations in [2, 30] {
                for barrier in [None, BARRIER] {
                    let m = motion(&obstacles, |planner| {
                        planner.warning = branch;
                        planner.newton_iterations_max = iterations;
                        planner.barrier = barrier;
                        // The bracket stands beside the backbone, the planes cut through the body.
                        planner.body_radius_m = if what == "bracket" { 0.0 } else { 0.055 };
                    });
                    let what = format!("{what}, {branch:?}, {iterations} iterations, {barrier:?}");
                    assert!(m.tip_error < free.tip_error + 0.5e-3, "{what}: {} m off", m.tip_error);
                    assert!(m.tension < free.tension + 15.0, "{what}: {} N", m.tension);
                    assert!(m.not_converged == 0 || iterations == 2, "{what}: {} steps", m.not_converged);
                    // It is said in every step that the clearance cannot be kept.
                    assert_eq!((m.relaxed, m.hopeless), (20, 20), "{what}");
                }
            }
        }
    }
}

#[test]
fn a_plane_through_the_base_loosens_no_other_obstacle() {
    for branch in [WarningBranch::Seeded, WarningBranch::Complementarity] {
        for barrier in [None, BARRIER] {
            let keeps = |obstacles: &str| {
                motion(obstacles, |planner| {
                    planner.warning = branch;
                    planner.barrier = barrier;
                })
            };
            let (alone, beside) = (keeps(BALL), keeps(&format!("{}{BALL}", plane(0.0))));
            let what = format!("{branch:?}, {barrier:?}: {} m alone, {} beside", alone.distance, beside.distance);
            assert!(alone.distance < 0.011 && beside.distance > 0.01 - 1e-6, "{what}");
            assert_eq!(beside.not_converged, 0, "{what}");
            assert!((beside.tip_error - alone.tip_error).abs() < 0.1e-3, "{what}");
        }
    }
}

#[test]
fn a_pair_that_no_tension_moves_is_no_conflict_and_leaves_the_next_step_its_start() {
    // With a body without radius the plane cuts nothing but the clamped point itself.
    let plan = |obstacles: &str| motion(obstacles, |planner| planner.warning = WarningBranch::Complementarity);
    let (alone, beside) = (plan(BALL), plan(&format!("{}{BALL}", plane(0.0))));
    assert_eq!((alone.relaxed, alone.hopeless), (0, 0));
    assert_eq!((beside.relaxed, beside.hopeless), (0, 20));
}
