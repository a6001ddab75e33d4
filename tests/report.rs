//! Claims about reports of recordings and explanations of their instants.
// The lint's exception for tests does not reach the helpers of an integration test.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use serde_json::Value;
use sinew::config::Config;
use sinew::control::Limit;
use sinew::daemon::words::event_in_words;
use sinew::ipc::Event;
use sinew::ipc::payload::{AlarmRecord, Header, SourceHealth, SourceReport, State, SupervisorState};
use sinew::recording::{About, Recording, Viewer};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const TICK_NS: u64 = 10_000_000;
/// When the loop's time began on the clock of the file (ns).
const BEGAN_NS: u64 = 1_709_251_100_000_000_000;

fn sinew(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sinew")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn event(tick: u64, code: u32, detail: u32, value: f64, text: &'static str) -> Event {
    Event { time_ns: 1_000 + tick * TICK_NS, tick, code, detail, flags: 0, value, second: 0.0, text }
}

/// Ten seconds: armed, tracking from 2 s, source 7 silent at 5 s and expired at 6 s, at which the arm holds, a track that is
/// refused at 7 s, and an encoder that falls silent at 8 s.
fn recording(folder: &Path) -> PathBuf {
    let path = folder.join("run.mcap");
    let config = Config::builtin();
    let viewer = Viewer::new(&config.arm, 30).map(|viewer| viewer.telling(event_in_words));
    let about = About::new("paper").with("period_s", 0.01).with("lockstep", false).set(&config).shown(viewer);
    let mut file = Recording::create(&path, &about).unwrap();
    for tick in 0..1000 {
        let time_ns = BEGAN_NS + tick * TICK_NS;
        for event in events(tick) {
            file.event(time_ns, &event).unwrap();
        }
        file.state(time_ns, &state(tick)).unwrap();
    }
    file.finish().unwrap();
    path
}

fn events(tick: u64) -> Vec<Event> {
    match tick {
        200 => vec![event(200, 404, 0, 0.0, "track"), event(200, 303, 404, 0.0, "tracking")],
        600 => vec![
            event(600, Limit::ObstaclesExpired.code(), 0, 1.0, Limit::ObstaclesExpired.text()),
            event(600, 302, Limit::ObstaclesExpired.code(), 0.0, "holding"),
        ],
        700 => vec![event(700, 404, 1, 12.0, "track")],
        800 => vec![event(800, 20, 7, 0.06, "an encoder is silent"), event(800, 306, 20, 0.0, "faulted")],
        _ => Vec::new(),
    }
}

fn state(tick: u64) -> State {
    let mode = match tick {
        0..200 => SupervisorState::Holding,
        200..600 => SupervisorState::Tracking,
        600..800 => SupervisorState::Holding,
        _ => SupervisorState::Faulted,
    };
    let health = match tick {
        0..500 => SourceHealth::Fresh,
        500..600 => SourceHealth::Stale,
        _ => SourceHealth::Expired,
    };
    let mut s = State {
        header: Header::new(0, tick, 1_000 + tick * TICK_NS).for_tick(tick),
        time_s: tick as f64 * 0.01,
        supervisor: mode.wire(),
        cable_count: 24,
        segment_count: 4,
        target_mode: 1,
        tip_error_m: if tick == 345 { 0.033 } else { 0.002 },
        distance_count: 1,
        ..State::default()
    };
    s.tension_command_n[..24].fill(25.0);
    s.tension_command_n[7] = 77.5;
    s.distances[0].source_id = 7;
    s.distances[0].obstacle_id = 1;
    s.distances[0].surface_distance_m = if tick == 456 { 0.0123 } else { 0.25 };
    s.obstacle_sources[0] =
        SourceReport { source_id: 7, health: health.wire(), accepted: 3, age_s: 0.1, ..Default::default() };
    s.timing.cycle_ns = 700_000;
    if tick >= 600 {
        s.limits = 1 << (Limit::ObstaclesExpired.code() - 100);
        s.alarm_count = 1;
        s.alarms[0] = AlarmRecord { code: 501, subject: 7, since_ns: 1_000 + 600 * TICK_NS };
    }
    if tick >= 800 {
        (s.fault_code, s.fault_detail, s.fault_values) = (20, 7, [0.06, f64::NAN]);
    }
    s.set_nodes(20, |i| [0.0, 0.0, -0.14 * (i + 1) as f64], |_| [1.0, 0.0, 0.0, 0.0]);
    s
}

/// The data in a page.
fn data(page: &str) -> Value {
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn the_page_tells_what_happened_and_why_and_loads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path());
    let output = sinew(&["report", &path.display().to_string()]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let page = std::fs::read_to_string(folder.path().join("run.html")).unwrap();
    for loads in ["src=", "<link", "@import", "fetch(", "url(", "import("] {
        assert!(!page.contains(loads), "{loads}");
    }
    assert!(page.contains("uPlot"));
    let data = data(&page);
    let story = &data["story"];
    let modes: Vec<(&str, f64, &str)> = story["modes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|m| (m["name"].as_str().unwrap(), m["from_s"].as_f64().unwrap(), m["why"].as_str().unwrap_or("")))
        .collect();
    let expected = [
        ("holding", 0.0, ""),
        ("tracking", 2.0, "asked by track"),
        ("holding", 6.0, "obstacles unknown or too old: holding"),
        ("faulted", 8.0, "an encoder is silent"),
    ];
    assert_eq!(modes, expected);
    let row = |name: &str| {
        let rows = story["rows"].as_array().unwrap();
        rows.iter().find(|r| r["name"] == name).unwrap_or_else(|| panic!("no {name} in {rows:?}"))["spans"][0].clone()
    };
    let silent = row("obstacles of source 7: stale");
    assert!(
        (silent["from_s"].as_f64().unwrap() - 5.0).abs() < 1e-9
            && (silent["to_s"].as_f64().unwrap() - 6.0).abs() < 1e-9
    );
    row("obstacles of source 7: expired");
    row("obstacles unknown or too old: holding");
    let events = story["events"].as_array().unwrap();
    let told = |part: &str| {
        let found = events.iter().find(|e| e["text"].as_str().unwrap().contains(part));
        found.unwrap_or_else(|| panic!("no {part} in {events:#?}"))
    };
    let fault = told("fault: the encoder of cable 2,2 has been silent for 0.060 s");
    assert_eq!(fault["severity"], "error");
    assert!((fault["at_s"].as_f64().unwrap() - 8.0).abs() < 1e-9);
    assert!(fault["remedy"].as_str().unwrap().contains("restore the encoder's readings"));
    assert!(told("request: track, refused")["text"].as_str().unwrap().contains("obstacles are unknown or too old"));
    // A peak of one tick in a thousand is there, and so are names.
    let plot = |title: &str| {
        let plots = story["plots"].as_array().unwrap();
        plots.iter().find(|p| p["title"].as_str().unwrap().starts_with(title)).unwrap().clone()
    };
    let most = |curve: &Value, key: &str, pick: fn(f64, f64) -> f64| {
        curve[key].as_array().unwrap().iter().filter_map(Value::as_f64).reduce(pick).unwrap()
    };
    assert_eq!(most(&plot("Tip: distance")["curves"][0], "high", f64::max), 33.0);
    assert_eq!(most(&plot("Distances")["curves"][0], "low", f64::min), 12.3);
    assert_eq!(plot("Distances")["curves"][1]["name"], "obstacle 1 of source 7");
    let tensions = plot("Tensions commanded");
    assert_eq!(
        (&tensions["curves"][7]["name"], tensions["curves"].as_array().unwrap().len()),
        (&Value::from("2,2"), 24)
    );
    let statistics = story["statistics"].to_string();
    for part in [
        "largest 33.00 mm",
        "12.3 mm, to obstacle 1 of source 7, at 4.56 s",
        "25.00 N to 77.50 N",
        "tracking 4.00 s",
        "median 700 us",
    ] {
        assert!(statistics.contains(part), "{part} is not in {statistics}");
    }
    assert!(data["attachments"]["settings.json"].as_str().unwrap().contains("hole_angles_rad"));
    assert_eq!(story["began_utc"], "20240229T235820Z");
    assert_eq!(story["whole"], true);
}

#[test]
fn a_report_replaces_a_report_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path()).display().to_string();
    let out = folder.path().join("mine.html");
    std::fs::write(&out, "what I wrote").unwrap();
    let output = sinew(&["report", &path, "--out", &out.display().to_string()]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("mine.html is there already"), "{}", text(&output.stderr));
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "what I wrote");
    std::fs::remove_file(&out).unwrap();
    for _ in 0..2 {
        assert!(sinew(&["report", &path, "--out", &out.display().to_string()]).status.success());
    }
    let output = sinew(&["report", &out.display().to_string(), "--out", "-"]);
    assert_eq!(output.status.code(), Some(2), "a page is no recording");
    assert!(text(&output.stderr).contains("no MCAP recording"), "{}", text(&output.stderr));
}

#[test]
fn a_file_that_was_cut_is_told_up_to_there_and_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() * 7 / 10]).unwrap();
    let output = sinew(&["report", &cut.display().to_string(), "--out", "-"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let data = data(&text(&output.stdout));
    assert_eq!(data["story"]["whole"], false);
    let to_s = data["story"]["to_s"].as_f64().unwrap();
    assert!((6.0..8.0).contains(&to_s), "{to_s}");
    let told = sinew(&["explain", &cut.display().to_string()]);
    assert!(text(&told.stdout).contains("holding since 6.000 s"), "{}", text(&told.stdout));
}

#[test]
fn an_instant_is_explained_with_its_cause_and_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path()).display().to_string();
    let at = |seconds: &str| {
        let output = sinew(&["explain", &path, "--at", seconds]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let (follows, holds, faulted) = (at("3.0"), at("7.5"), at("9.99"));
    for (told, parts) in [
        (&follows, &["tick 300", "tracking since 2.000 s: asked by track", "20240229T235823Z", "fault       none"][..]),
        (
            &follows,
            &["2.000 s, request: track", "nearest is obstacle 1 of source 7 at 250.0 mm", "77.50 N (cable 2,2)"],
        ),
        (
            &holds,
            &["holding since 6.000 s: obstacles unknown or too old", "7.000 s, request: track, refused: obstacles are"],
        ),
        (
            &holds,
            &[
                "obstacles 7: the source is too old since 6.000 s",
                "what clears it: the source is back",
                "source 7: expired",
            ],
        ),
        (
            &faulted,
            &[
                "faulted since 8.000 s: an encoder is silent",
                "to clear it: restore the encoder's readings, then `clear`",
            ],
        ),
        (&faulted, &["the encoder of cable 2,2 has been silent for 0.060 s at 8.000 s (code 20)"]),
    ] {
        for part in parts {
            assert!(told.contains(part), "{part} is not in\n{told}");
        }
    }
    assert!(!follows.contains("wrong"), "{follows}");
    let beyond = sinew(&["explain", &path, "--at", "12.3"]);
    assert_eq!(beyond.status.code(), Some(2));
    assert!(text(&beyond.stderr).contains("holds 0.000 s to 9.990 s"), "{}", text(&beyond.stderr));
}

#[test]
fn a_plan_is_reported_with_the_names_of_its_scenario() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plan.mcap");
    let file = path.display().to_string();
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/scenarios/shape.toml").display().to_string();
    assert_ne!(sinew(&["plan", &scenario, "--out", &file]).status.code(), Some(2));
    let output = sinew(&["report", &file, "--out", "-"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let data = data(&text(&output.stdout));
    assert!(data["title"].as_str().unwrap().contains("scenario shape"), "{}", data["title"]);
    let plots = data["story"]["plots"].as_array().unwrap();
    let distances = plots.iter().find(|p| p["title"].as_str().unwrap().starts_with("Distances")).unwrap();
    let names: Vec<&str> =
        distances["curves"].as_array().unwrap().iter().map(|c| c["name"].as_str().unwrap()).collect();
    assert!(names.len() > 1 && names.iter().all(|name| !name.contains("source")), "{names:?}");
    assert!(sinew(&["explain", &file]).status.success());
}
