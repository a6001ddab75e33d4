//! Scenario files: the built-in ones are the paper's, and mistakes are refused at their place.

use super::{expect, shipped};
use sinew::config::{Motion, SCENARIOS, ScenarioConfig, ShapeConfig, Start, Task, TipPath, WarningBranch};
use std::f64::consts::PI;
use std::path::PathBuf;

fn scenario(name: &str) -> ScenarioConfig {
    ScenarioConfig::find(name).map_err(|error| error.report()).unwrap()
}

#[test]
fn the_tip_scenario_is_the_papers() {
    let tip = scenario("tip");
    assert_eq!((tip.duration_s, tip.planner.period_s, tip.planner.lookahead_s), (100.0, 0.1, 0.1));
    assert_eq!(tip.weight_tension_change.as_deref(), Some(&[1e4, 2e4, 3e4, 4e4][..]));
    assert_eq!(tip.planner.swarm.penalty, 1e12);
    assert_eq!(tip.planner.warning_distance_m, 0.01);
    assert_eq!(tip.planner.lead_s, Some(0.0), "the paper has no lead");
    assert!(tip.planner.barrier.is_none() && tip.planner.avoidance && tip.planner.clearance_m == 0.0);
    let Task::Tip {
        path: TipPath::Lemniscate { scale_m, height_m, duration_s, .. },
        weight_pose,
        weight_rate,
        weight_damping,
    } = &tip.task
    else {
        panic!("{:?}", tip.task)
    };
    assert_eq!((*scale_m, *height_m, *duration_s), (0.6, -2.4, 100.0));
    assert_eq!((*weight_pose, *weight_rate, *weight_damping), (5e12, 5e10, 1e8));
    assert!(matches!(&tip.start, Start::TipPose { guess_curvatures_1pm } if guess_curvatures_1pm.len() == 8));
    assert_eq!(tip.obstacles[0].motion, Motion::Linear { position_m: [0.45, 0.15, -1.20], velocity_mps: [0.0; 3] });
    let Motion::Circle { rate_radps, acceleration_radps2, .. } = tip.obstacles[1].motion else { panic!() };
    assert!((rate_radps - 7.0 * PI / 600.0).abs() < 1e-16 && (acceleration_radps2 - PI / 6000.0).abs() < 1e-18);
    assert!(!scenario("tip-no-avoidance").planner.avoidance);
}

#[test]
fn the_shape_scenario_is_the_papers() {
    let shape = scenario("shape");
    let curvatures = vec![0.806, 0.806, -2.417, 0.0, -1.611, -2.417, -1.611, -2.417];
    let task = Task::Shape { curvatures_1pm: curvatures, weight_end: 1e10, weight_slope: 9.99e5, end_s: 100.0 };
    assert_eq!(shape.task, task);
    assert_eq!((shape.weight_tension, shape.planner.swarm.penalty), (Some(1.0), 1e16));
    assert_eq!(shape.weight_tension_change.as_deref(), Some(&[2e6; 4][..]));
    assert_eq!(shape.obstacles[1].motion.position_at(40.0), [0.25, 0.50, -1.60]);
    assert!(shape.obstacles.iter().all(|obstacle| obstacle.shape == ShapeConfig::Ball { radius_m: 0.1 }));
    assert!(!scenario("shape-no-avoidance").planner.avoidance);
}

#[test]
fn the_sweeps_are_figures_4_and_16() {
    let penalties: Vec<_> = scenario("penalty-sweep").sweep.iter().map(|run| run.penalty.unwrap()).collect();
    assert_eq!(penalties, [1e8, 1e9, 1e10, 1e11, 1e12]);
    assert_eq!(scenario("penalty-sweep").planner.warning, WarningBranch::Swarm);
    let comparison = scenario("swarm-comparison");
    assert_eq!((comparison.planner.newton_iterations_max, comparison.planner.swarm.sweeps_max), (30, 60));
    let runs: Vec<_> = comparison.sweep.iter().map(|run| (run.warning.unwrap(), run.particles.unwrap())).collect();
    let (improved, standard) = (WarningBranch::Swarm, WarningBranch::StandardSwarm);
    assert_eq!(runs, [(improved, 20), (improved, 40), (improved, 60), (standard, 20), (standard, 40), (standard, 60)]);
    assert!(comparison.sweep.iter().all(|run| run.window_s == Some([13.7, 14.6])));
}

#[test]
fn a_scenario_that_does_not_exist_is_refused_with_the_names() {
    expect(ScenarioConfig::find("tipp"), &["no scenario `tipp`", "built-in scenarios: tip, tip-no-avoidance"]);
}

#[test]
fn a_path_wins_over_a_built_in_name_and_its_arm_is_found_beside_it() {
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(directory.path().join("arm.toml"), shipped("arm.toml").replace("\"paper\"", "\"mine\"")).unwrap();
    let text = SCENARIOS[0].1.replace("name = \"tip\"", "name = \"tip\"\narm = \"arm.toml\"");
    let path: PathBuf = directory.path().join("tip");
    std::fs::write(&path, &text).unwrap();
    let found = ScenarioConfig::find(path.to_str().unwrap()).map_err(|error| error.report()).unwrap();
    assert_eq!(found.arm.name, "mine");
    std::fs::write(directory.path().join("arm.toml"), "[arm]\nname = \"x\"\ntension_n_max = -1\nsegment_count = 1\n")
        .unwrap();
    expect(ScenarioConfig::load(&path), &["arm.toml:3:17", "`arm.tension_n_max` = -1"]);
}

/// The tip or shape scenario with one text replaced: refused, with these words.
fn refuse_scenario(name: &str, from: &str, to: &str, parts: &[&str]) {
    let text = SCENARIOS.iter().find(|(scenario, _)| *scenario == name).unwrap().1;
    assert!(text.contains(from), "{from}");
    let line = text[..text.find(from).unwrap()].matches('\n').count() + 1;
    let place = format!("mine.toml:{line}:");
    let mut all = vec![place.as_str()];
    all.extend_from_slice(parts);
    expect(ScenarioConfig::parse("mine.toml", &text.replacen(from, to, 1)), &all);
}

#[test]
fn a_scenarios_mistakes_are_refused() {
    refuse_scenario("tip", "seed = 1", "sed = 1", &["unknown key `sed`", "did you mean `seed`"]);
    refuse_scenario(
        "tip",
        "radius_m = 0.1",
        "radius_m = -0.1",
        &["`obstacles[0].radius_m` = -0.1", "> 0 and <= 1000 m"],
    );
    refuse_scenario("tip", "id = \"2\"", "id = \"1\"", &["`obstacles[1].id` = \"1\"", "different for every obstacle"]);
    refuse_scenario(
        "tip",
        "weight_tension_change = [1e4, ",
        "weight_tension_change = [",
        &["exactly 4 numbers, one per segment"],
    );
    refuse_scenario(
        "tip",
        "guess_curvatures_1pm = [",
        "guess_curvatures_1pm = [1.0, 1.0, ",
        &["exactly 8 numbers, two per segment"],
    );
    refuse_scenario(
        "shape",
        "curvatures_1pm = [0.806, ",
        "curvatures_1pm = [",
        &["`task.curvatures_1pm`", "exactly 8 numbers"],
    );
    refuse_scenario("shape", "weight_slope = 9.99e5", "weight_slope = 2e6", &["`task.weight_slope` = 2e6", "0 to 1e6"]);
    refuse_scenario(
        "shape",
        "end_s = 100.0",
        "weight_pose = 1.0\nend_s = 100.0",
        &["`task.weight_pose` = 1.0 does not apply here"],
    );
    refuse_scenario(
        "swarm-comparison",
        "window_s = [13.7, 14.6]",
        "window_s = [14.6, 13.7]",
        &["`sweep[0].window_s`", "from < to"],
    );
}

#[test]
fn a_key_of_another_shape_does_not_apply() {
    let text = SCENARIOS[0].1.replacen("position_m = [0.45", "half_extents_m = [1, 1, 1]\nposition_m = [0.45", 1);
    expect(
        ScenarioConfig::parse("mine.toml", &text),
        &["`obstacles[0].half_extents_m` = [1, 1, 1] does not apply here"],
    );
}

#[test]
fn every_shape_and_motion_can_be_written() {
    let text = r#"
name = "all"
duration_s = 10.0
weight_tension_change = [1, 1, 1, 1]

[task]
mode = "tip"
[task.path]
kind = "waypoints"
waypoints = [
    { time_s = 0, position_m = [0, 0, -2.5], quaternion = [1, 0, 0, 0] },
    { time_s = 5, position_m = [0.1, 0, -2.5], quaternion = [1, 0, 0, 0] },
]

[start]
kind = "straight"

[[obstacles]]
id = "capsule"
shape = "capsule"
half_length_m = 0.3
radius_m = 0.05
motion = "waypoints"
waypoints = [{ time_s = 0, position_m = [1, 0, 0] }, { time_s = 4, position_m = [0, 0, 0] }]

[[obstacles]]
id = "box"
shape = "box"
half_extents_m = [0.1, 0.2, 0.3]
position_m = [1, 1, 1]

[[obstacles]]
id = "floor"
shape = "half_space"
position_m = [0, 0, -3]

[[obstacles]]
id = "hull"
shape = "hull"
points_m = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
position_m = [2, 0, 0]
"#;
    let scenario = ScenarioConfig::parse("all.toml", text).map_err(|error| error.report()).unwrap();
    assert_eq!(scenario.obstacles[0].motion.position_at(1.0), [0.75, 0.0, 0.0]);
    assert_eq!(scenario.obstacles[2].shape, ShapeConfig::HalfSpace);
    assert_eq!(scenario.planner.swarm.penalty, 1e12);

    let flat = text.replace("[0, 0, 1]]", "[1, 1, 0]]");
    expect(
        ScenarioConfig::parse("all.toml", &flat),
        &["all.toml:40:", "`obstacles[3].points_m`", "all points lie in one plane"],
    );
    let pointed = |count: usize| {
        let points: Vec<_> = (0..count).map(|k| format!("[{}, {}, {}]", k % 7, k % 11, k % 13)).collect();
        let hull = "[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]";
        ScenarioConfig::parse("all.toml", &text.replace(hull, &format!("[{}]", points.join(", "))))
    };
    // What a run can set up is what the reader takes.
    let most = pointed(256).map_err(|error| error.report()).unwrap();
    let ShapeConfig::Hull { points_m } = &most.obstacles[3].shape else { panic!("{:?}", most.obstacles[3].shape) };
    assert!(sinew::collision::Shape::new(&ShapeConfig::Hull { points_m: points_m.clone() }).is_ok());
    expect(pointed(257), &["all.toml:40:", "`obstacles[3].points_m`", "4 to 256"]);
    let falling = text.replace("time_s = 5", "time_s = 0");
    expect(
        ScenarioConfig::parse("all.toml", &falling),
        &["all.toml:12:", "`task.path.waypoints[1].time_s` = 0", "permitted: > 0 s"],
    );
}

#[test]
fn a_swarm_without_particles_is_refused() {
    let text = SCENARIOS[0].1;
    let at = text
        .find("[planner.swarm]")
        .map_or(text.len(), |at| text[at + 1..].find("\n[").map_or(text.len(), |n| at + 1 + n));
    let cut = text.find("[planner.swarm]").map_or(text.to_owned(), |from| format!("{}{}", &text[..from], &text[at..]));
    let with = |normal: usize, uniform: usize| {
        let swarm =
            format!("particles_normal = {normal}\nparticles_uniform = {uniform}\nchaotic_min = 0\nchaotic_max = 0\n");
        ScenarioConfig::parse("mine.toml", &format!("{cut}\n[planner.swarm]\n{swarm}"))
    };
    let refused = ["mine.toml:", "`planner.swarm.particles_uniform` = 0", "no particles", "permitted: 1 to 10000"];
    expect(with(0, 0), &refused);
    assert!(with(1, 0).is_ok() && with(0, 1).is_ok());
}

#[test]
fn a_tip_scenario_cannot_start_under_tensions_outside_the_box() {
    let from = SCENARIOS[0].1.find("kind = \"tip_pose\"").unwrap();
    let end = from + SCENARIOS[0].1[from..].find("\n\n").unwrap();
    let mut text = SCENARIOS[0].1.to_owned();
    text.replace_range(from..end, &format!("kind = \"tensions\"\ntensions_n = [{}230]", "0, ".repeat(23)));
    expect(ScenarioConfig::parse("mine.toml", &text), &["`start.tensions_n`", "0 to 220 N each"]);
}

#[test]
fn a_shape_that_few_cables_cannot_hold_is_refused_and_others_are_not() {
    let directory = tempfile::tempdir().unwrap();
    let read = |cables: &str, curvatures: &str| {
        let arm = include_str!("../../config/arm.toml").replace("segment_count = 4", "segment_count = 1");
        let arm = arm.replace("cables = 6\nhole_start_deg = 30.0", cables);
        std::fs::write(directory.path().join("arm.toml"), arm).unwrap();
        let text = format!(
            "name = \"bend\"\narm = \"arm.toml\"\nduration_s = 10.0\n[task]\nmode = \"shape\"\ncurvatures_1pm = {curvatures}\n\
             [start]\nkind = \"straight\"\n"
        );
        let file = directory.path().join("bend.toml");
        std::fs::write(&file, text).unwrap();
        ScenarioConfig::load(&file)
    };
    // Cables on y: moments about z alone.
    for (cables, curvatures) in [
        ("cables = 1", "[0.0, 1.0]"),
        ("cables = 2", "[0.0, -1.0]"),
        ("cables = 3", "[1.0, 0.3]"),
        ("cables = 3", "[-0.2, -1.0]"),
        ("hole_angles_deg = [0, 90]", "[-0.5, 1.0]"),
    ] {
        assert!(read(cables, curvatures).is_ok(), "{cables} {curvatures}");
    }
    for (cables, curvatures, part) in [
        ("cables = 1", "[0.0, -1.0]", "its one cable does not bend it that way"),
        ("cables = 2", "[0.5, 1.0]", "segment 1: its 2 cables do not bend it that way"),
        ("hole_angles_deg = [0, 90]", "[0.5, 1.0]", "its 2 cables do not"),
    ] {
        let refusal = read(cables, curvatures).unwrap_err().report();
        for part in [part, "task.curvatures_1pm"] {
            assert!(refusal.contains(part), "{part} is not in\n{refusal}");
        }
    }
}
