//! The command line as its users and scripts meet it: output, JSON, exit codes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

use serde_json::Value;
use std::process::{Command, Output};

fn sinew(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sinew")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn file(name: &str, content: &str) -> (tempfile::TempDir, String) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join(name);
    std::fs::write(&path, content).unwrap();
    let path = path.to_string_lossy().into_owned();
    (directory, path)
}

const SHORT: &str = r#"
name = "short"
duration_s = 1.0
weight_tension_change = [2e6, 2e6, 2e6, 2e6]
[task]
mode = "shape"
curvatures_1pm = [0.8, 0.8, -2.4, 0.0, -1.6, -2.4, -1.6, -2.4]
weight_end = 1e10
[start]
kind = "straight"
"#;

#[test]
fn json_is_one_object_with_every_field_and_nothing_else() {
    let (_directory, path) = file("short.toml", SHORT);
    let output = sinew(&["plan", &path, "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    for key in [
        "scenario",
        "seed",
        "period_s",
        "lookahead_s",
        "ticks",
        "not_converged",
        "relaxed",
        "truncated",
        "newton",
        "obstacles",
        "tension_n",
        "tip_error_m",
        "quaternion_error_max",
        "curvature_error_final_1pm",
        "time_us",
        "swarm",
        "loop",
        "faults",
    ] {
        assert!(object.get(key).is_some(), "{key} is absent");
    }
    assert_eq!(object["ticks"], 10);
    assert_eq!(object["loop"], Value::Null);
    assert_eq!(object["swarm"], Value::Null, "no obstacle, no search");
    assert_eq!(object["tip_error_m"], Value::Null);
    assert_eq!(object["newton"]["warning"], Value::Null);
    assert!(object["newton"]["safe"]["mean"].as_f64().unwrap() >= 1.0);
    assert!(object["time_us"]["safe"]["p50"].as_f64().unwrap() > 0.0);
}

#[test]
fn a_plan_that_searched_tells_its_evaluations_per_second() {
    let content = format!(
        "{SHORT}\n[[obstacles]]\nid = \"beside\"\nshape = \"ball\"\nradius_m = 0.1\nposition_m = [0.102, 0.0, -1.5]\n"
    );
    let (_directory, path) = file("beside.toml", &content);
    let output = sinew(&["plan", &path, "--warning", "swarm", "--json"]);
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(object["swarm"]["evaluations"].as_u64().unwrap() > 40, "{object}");
    assert!(object["swarm"]["evaluations_per_s"].as_f64().unwrap() > 0.0, "{object}");
    assert!(text(&sinew(&["plan", &path, "--warning", "swarm"]).stdout).contains("per second"));
    let exact = sinew(&["plan", &path, "--warning", "complementarity", "--json"]);
    let object: Value = serde_json::from_slice(&exact.stdout).unwrap();
    assert!(object["newton"]["warning"].is_object(), "the ball is near enough");
    assert_eq!(object["swarm"], Value::Null);
}

#[test]
fn a_plan_through_an_obstacle_exits_with_1() {
    // The base stands in the ball: no tensions can avoid it.
    let content = format!(
        "{SHORT}\n[[obstacles]]\nid = \"in the way\"\nshape = \"ball\"\nradius_m = 0.1\nposition_m = [0.0, 0.0, -0.05]\n"
    );
    let (_directory, path) = file("contact.toml", &content);
    let output = sinew(&["plan", &path, "--warning", "complementarity", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}{}", text(&output.stdout), text(&output.stderr));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(object["obstacles"][0]["surface_distance_min_m"].as_f64().unwrap() < 0.0);
}

#[test]
fn unusable_input_exits_with_2_and_says_where() {
    let (_directory, path) = file("bad.toml", &SHORT.replace("duration_s = 1.0", "duration_s = -1.0"));
    let output = sinew(&["plan", &path]);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    for part in ["bad.toml", "duration_s", "-1"] {
        assert!(message.contains(part), "{part} is missing in {message}");
    }
    for arguments in [&["plan", "no-such-scenario"][..], &["plan", "tip", "--warning", "guess"], &["nonsense"]] {
        assert_eq!(sinew(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn a_recording_of_a_plan_holds_every_step() {
    let (directory, path) = file("short.toml", SHORT);
    let out = directory.path().join("run.mcap");
    let output = sinew(&["plan", &path, "--out", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let messages = sinew::recording::read(&out).unwrap();
    let states: Vec<_> = messages.iter().filter(|m| m.topic.ends_with("/state")).collect();
    assert_eq!(states.len(), 10);
    let first = states[0].value["tension_command_n"].as_array().unwrap();
    assert_eq!(first.len(), 24);
    assert!(states[9].value["curvature_error_1pm"].as_f64().unwrap() < 2.5);
}

#[test]
fn the_built_in_files_pass_the_check() {
    let root = env!("CARGO_MANIFEST_DIR");
    let files = ["arm", "controller", "drives"].map(|f| format!("{root}/config/{f}.toml"));
    let output = sinew(&["check", "--config", &files[0], &files[1], &files[2]]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = sinew(&["check", "--config", &files[0], "/nonexistent.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("/nonexistent.toml"));
}
