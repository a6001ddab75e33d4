//! The command line as its users and scripts meet it: output, JSON, exit codes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

use serde_json::Value;
use std::process::{Command, Output, Stdio};

/// The program, as one who has set nothing for an arm of his own.
fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sinew"));
    for variable in ["SINEW_IPC_PREFIX", "SINEW_IPC_ROOT", "SINEW_RUN_DIR", "SINEW_LOG"] {
        command.env_remove(variable);
    }
    command
}

fn sinew(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
}

/// The same with standard output and standard error elsewhere; the exit code.
fn sinew_into(arguments: &[&str], stdout: Stdio, stderr: Stdio) -> Option<i32> {
    let mut command = program();
    command.args(arguments).stdout(stdout).stderr(stderr).status().unwrap().code()
}

/// The writing end of a pipe that nobody reads any more.
fn closed_pipe() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
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
    let files = ["arm", "controller", "drives"].map(shipped);
    let output = sinew(&["check", "--config", &files[0], &files[1], &files[2]]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = sinew(&["check", "--config", &files[0], "/nonexistent.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("/nonexistent.toml"));
}

#[test]
fn a_check_shows_no_number_with_all_its_digits() {
    for arm in ["arm", "arms/rao-2021/arm", "arms/renda-2018/arm"] {
        let output = sinew(&["check", "--config", &shipped(arm), &shipped("drives")]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let said = text(&output.stdout);
        let endless = said.split(|c: char| !c.is_ascii_digit()).find(|digits| digits.len() > 7);
        assert_eq!(endless, None, "{said}");
    }
}

fn shipped(name: &str) -> String {
    format!("{}/config/{name}.toml", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn a_reader_that_has_gone_is_no_error_and_a_full_disk_is_one() {
    let (_directory, path) = file("short.toml", SHORT);
    let check = ["check", "--config", &shipped("arm"), &shipped("controller"), &shipped("drives")];
    for arguments in [&["plan", path.as_str()][..], &["plan", &path, "--json"], &check] {
        assert_eq!(sinew_into(arguments, closed_pipe(), Stdio::null()), Some(0), "{arguments:?}");
        let full = std::fs::File::create("/dev/full").unwrap();
        let mut command = program();
        let output = command.args(arguments).stdout(full).stderr(Stdio::piped()).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let message = text(&output.stderr);
        assert!(message.contains("standard output") && message.contains("No space left"), "{message}");
    }
    // What is said aside may go nowhere, too.
    assert_eq!(sinew_into(&["target", "--pose", "1"], Stdio::null(), closed_pipe()), Some(2));
}

#[test]
fn what_would_have_no_effect_is_refused() {
    for (arguments, word) in [
        (&["plan", "swarm-comparison", "--warning", "complementarity"][..], "variations"),
        (&["plan", "tip-no-avoidance", "--warning", "swarm"], "avoids nothing"),
        (&["demo", "shape-no-avoidance", "--fast", "--warning", "swarm"], "avoids nothing"),
        (&["demo", "penalty-sweep", "--fast"], "5 variations"),
        (&["demo", "tip", "--fast", "--duration", "nan"], "above 0 s"),
        (&["demo", "tip", "--fast", "--duration=-1"], "above 0 s"),
        (&["demo", "tip", "--fast", "--kill-obstacle-client-at", "nan"], "above 0 s"),
        (&["demo", "tip", "--fast", "--duration", "1", "--kill-obstacle-client-at", "2"], "ends before"),
    ] {
        let output = sinew(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(word), "{arguments:?}: {}", text(&output.stderr));
    }
}

#[test]
fn a_message_names_the_path_and_its_cause_once() {
    let (_directory, path) = file("short.toml", SHORT);
    for (arguments, named) in [
        (&["plan", path.as_str(), "--out", "/nonexistent/run.mcap"][..], "/nonexistent/run.mcap"),
        (&["demo", "tip", "--fast", "--keep", "/proc/nonexistent"], "--keep /proc/nonexistent"),
    ] {
        let output = sinew(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let message = text(&output.stderr);
        assert!(message.contains(named), "{message}");
        assert_eq!(message.matches("No such file").count(), 1, "{message}");
    }
    let message = text(&sinew(&["target"]).stderr);
    assert!(message.contains("--pose") && message.contains("--curvatures"), "{message}");
}

#[test]
fn a_check_warns_of_what_is_permitted_and_will_not_do() {
    let change = |name: &str, from: &str, to: &str| {
        let content = std::fs::read_to_string(shipped(name)).unwrap();
        assert!(content.contains(from), "{name} has no {from}");
        file(&format!("{name}.toml"), &content.replacen(from, to, 1))
    };
    let (_a, arm) = change("arm", "damping_stiffness_s = 0.05", "damping_stiffness_s = 0.0");
    let (_c, controller) = change("controller", "# cpu = 1", "cpu = 1023");
    let output = sinew(&["check", "--config", &arm, &controller, &shipped("drives"), &shipped("plant")]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let warnings = text(&output.stderr);
    for part in ["segment 4: damping_stiffness_s = 0 s", "loop.cpu = 1023"] {
        assert!(warnings.contains(part), "{part} is missing in {warnings}");
    }
    assert!(text(&output.stdout).contains("plant.toml is sim_plant's"), "{}", text(&output.stdout));
    let files = [shipped("arm"), shipped("controller"), shipped("drives")];
    let output = sinew(&["check", "--config", &files[0], &files[1], &files[2]]);
    assert_eq!(text(&output.stderr), "");
    assert!(!text(&output.stdout).contains("not checked"));
}

/// Names of all fields of an object, and of those below it.
fn fields(value: &Value, found: &mut std::collections::BTreeSet<String>) {
    match value {
        Value::Object(object) => {
            for (key, below) in object {
                // Cables are named by their numbers.
                found.extend((!key.contains(',')).then(|| key.clone()));
                fields(below, found);
            }
        }
        Value::Array(array) => array.iter().for_each(|below| fields(below, found)),
        _ => {}
    }
}

#[test]
fn every_field_of_the_json_is_documented() {
    let document = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/src/report/SCRIPTS.md")).unwrap();
    let content = format!(
        "{SHORT}\n[[obstacles]]\nid = \"beside\"\nshape = \"ball\"\nradius_m = 0.1\nposition_m = [0.102, 0.0, -1.5]\n"
    );
    let (_directory, path) = file("beside.toml", &content);
    let output = sinew(&["plan", &path, "--warning", "swarm", "--json"]);
    let mut found = std::collections::BTreeSet::new();
    fields(&serde_json::from_slice(&output.stdout).unwrap(), &mut found);
    assert!(found.contains("evaluations_per_s") && found.contains("inside_s"), "{found:?}");
    for field in &found {
        assert!(document.contains(&format!("`{field}`")), "{field} is not in src/report/SCRIPTS.md");
    }
}

#[test]
fn what_the_environment_says_wrongly_is_told() {
    for (variable, value, told) in
        [("SINEW_LOG", "sinew=loud,,=", "SINEW_LOG="), ("SINEW_IPC_ROOT", "rel/", "starts with /")]
    {
        let output = program().env(variable, value).args(["home"]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(told), "{variable}: {said}");
    }
    let files = ["arm", "controller", "drives"].map(|name| format!("config/{name}.toml"));
    let check = program().env("SINEW_IPC_PREFIX", "other_").args(["check", "--config"]).args(files).output().unwrap();
    assert!(String::from_utf8_lossy(&check.stdout).contains("prefix other_"), "as `run` has it");
}

#[test]
fn a_terminal_without_a_width_gets_whole_words() {
    let check = ["check", "--config", &shipped("arm"), &shipped("controller"), &shipped("drives")];
    let (_directory, bad) = file("bad.toml", "[arm]\nfoo = 1\n");
    for (arguments, whole) in [(&check[..], "shared memory"), (&["check", "--config", &bad], "unknown key")] {
        let words: Vec<String> = arguments.iter().map(|word| format!("'{word}'")).collect();
        let script = format!("stty cols 0 rows 0; {} {}", env!("CARGO_BIN_EXE_sinew"), words.join(" "));
        let Ok(output) = Command::new("script").args(["-qec", &script, "/dev/null"]).stdin(Stdio::null()).output()
        else {
            return eprintln!("not tested: there is no `script`");
        };
        let said = text(&output.stdout);
        assert!(said.contains(whole), "{said}");
        let lines = said.lines().count();
        assert!(lines < 80, "{lines} lines");
    }
}

#[test]
fn twenty_thousand_mistakes_are_counted_and_not_all_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("many.toml");
    std::fs::write(&file, (0..20_000).map(|n| format!("[t{n}]\n")).collect::<String>()).unwrap();
    let output = sinew(&["check", "--config", file.to_str().unwrap()]);
    // Lines are broken anywhere.
    let said = String::from_utf8_lossy(&output.stderr).replace(['\n', '│'], " ");
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(output.status.code(), Some(2));
    assert!(said.contains("the first 50 are"), "{}", said.chars().take(400).collect::<String>());
    assert!(said.len() < 200_000, "{} bytes", said.len());
}

#[test]
fn a_recording_replaces_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("plan.mcap");
    std::fs::write(&out, "precious").unwrap();
    let output = sinew(&["plan", "tip", "--out", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("there already"));
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "precious");
}
