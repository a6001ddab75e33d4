//! Claims about recordings.
// The lint's exception for tests does not reach the helpers of an integration test.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use sinew::ipc::payload::{Header, Obstacle, Obstacles, SourceReport, State, Target, TargetMode};
use sinew::ipc::{Event, Tap};
use sinew::recording::{About, Bounds, Recorder, Recording, read};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::Ordering;

const TICK_NS: u64 = 10_000_000;

fn state(tick: u64) -> State {
    let mut s = State {
        header: Header::new(0, tick, tick * TICK_NS).for_tick(tick),
        time_s: tick as f64 * 0.01,
        cable_count: 24,
        segment_count: 4,
        tip_error_m: 1e-3 * tick as f64,
        distance_count: 1,
        ..State::default()
    };
    s.tension_command_n = std::array::from_fn(|c| c as f64 + tick as f64);
    s.distances[0].surface_distance_m = 0.25;
    s.obstacle_sources[0] = SourceReport { source_id: 7, accepted: 3, age_s: f64::INFINITY, ..Default::default() };
    s.set_nodes(20, |i| [i as f64, 0.0, -1.0], |_| [1.0, 0.0, 0.0, 0.0]);
    s
}

fn obstacles() -> Obstacles {
    let mut set = Obstacles { header: Header::new(7, 5, TICK_NS), ..Obstacles::default() };
    let vertices = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    assert!(set.push(Obstacle::ball(1, [0.4, 0.1, -1.2], 0.1)));
    assert!(set.push_hull(Obstacle { id: 2, ..Obstacle::default() }, &vertices));
    set
}

fn target() -> Target {
    Target { mode: TargetMode::Shape.wire(), segment_count: 4, curvature_1pm: [0.806; 32], ..Target::default() }
}

fn event() -> Event {
    Event {
        time_ns: 3 * TICK_NS,
        tick: 3,
        code: 9,
        detail: 2,
        flags: 0,
        value: 0.5,
        second: 0.0,
        text: "source expired",
    }
}

fn write(path: &Path, ticks: u64) {
    let about = About::new("paper").with("scenario", "tip");
    let mut recording = Recording::create(path, &about).unwrap();
    recording.obstacles(0, &obstacles()).unwrap();
    recording.target(0, &target()).unwrap();
    recording.event(0, &event()).unwrap();
    for tick in 0..ticks {
        recording.state(tick * TICK_NS, &state(tick)).unwrap();
    }
    recording.finish().unwrap();
}

#[test]
fn what_was_written_is_read_back_by_the_schemas_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, 3);
    let messages = read(&path).unwrap();
    let of = |topic: &str| messages.iter().filter(|m| m.topic == format!("sinew/paper/{topic}")).collect::<Vec<_>>();
    let states = of("state");
    assert_eq!(states.len(), 3);
    let s = &states[2].value;
    assert_eq!((states[2].time_ns, &s["header"]["tick"]), (2 * TICK_NS, &2.into()));
    assert_eq!(s["tension_command_n"].as_array().unwrap().len(), 24);
    assert_eq!(s["tension_command_n"][23], 25.0);
    assert_eq!(s["nodes"].as_array().unwrap().len(), 20);
    assert_eq!(s["nodes"][19]["position_m"][0], 19.0);
    assert_eq!(s["distances"][0]["surface_distance_m"], 0.25);
    assert_eq!(s["obstacle_sources"].as_array().unwrap().len(), 1);
    assert_eq!(s["obstacle_sources"][0]["accepted"], 3);
    assert!(s["curvature_error_1pm"].is_null(), "not a number in tip mode");
    assert_eq!(s["timing"]["cycle_ns"], 0);
    let o = &of("obstacles")[0].value;
    assert_eq!(o["obstacles"][0]["vertices_m"].as_array().unwrap().len(), 0);
    assert_eq!(o["obstacles"][1]["vertices_m"].as_array().unwrap().len(), 12);
    assert_eq!(of("target")[0].value["curvature_1pm"].as_array().unwrap().len(), 8);
    assert_eq!(of("events")[0].value["text"], "source expired");
}

#[test]
fn a_tick_of_the_papers_arm_takes_three_kilobytes() {
    let folder = tempfile::tempdir().unwrap();
    let size = |ticks| {
        let path = folder.path().join(format!("run-{ticks}.mcap"));
        write(&path, ticks);
        std::fs::metadata(path).unwrap().len()
    };
    let per_tick = (size(1000) - size(500)) / 500;
    assert!(per_tick < 3000, "{per_tick} bytes");
}

#[test]
fn a_file_cut_anywhere_stays_readable() {
    const TICKS: u64 = 1000;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, TICKS);
    let whole = std::fs::read(&path).unwrap();
    assert_eq!(read(&path).unwrap().len() as u64, TICKS + 3);
    let cut = folder.path().join("cut.mcap");
    for share in [5, 20, 37, 50, 77, 95, 99] {
        let length = whole.len() * share / 100;
        std::fs::write(&cut, &whole[..length]).unwrap();
        let messages = read(&cut).unwrap_or_else(|e| panic!("cut at {share} %: {e}"));
        let states: Vec<_> = messages.iter().filter(|m| m.topic.ends_with("state")).collect();
        for (tick, message) in states.iter().enumerate() {
            assert_eq!(message.value["header"]["tick"], tick);
        }
        // A chunk of one second at most is lost.
        let expected = (TICKS as usize * share / 100).saturating_sub(110);
        assert!(states.len() >= expected, "cut at {share} %: {} states, expected {expected}", states.len());
    }
}

#[test]
fn the_recorder_writes_what_passes_and_finishes_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut recorder = Recorder::start(&path, &About::new("paper"), 1_000).unwrap();
    let dropped = recorder.dropped();
    for tick in 0..100 {
        recorder.state(&state(tick));
    }
    recorder.obstacles(&obstacles());
    recorder.event(&event());
    drop(recorder);
    let messages = read(&path).unwrap();
    assert_eq!(messages.len() as u64 + dropped.load(Ordering::Relaxed), 102);
    assert_eq!(dropped.load(Ordering::Relaxed), 0, "the queue holds more than this");
    assert_eq!(messages[1].time_ns, TICK_NS + 1_000);
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().expect("a finished file has a summary");
    assert_eq!(summary.stats.unwrap().message_count, 102);
}

#[test]
fn a_recording_is_dealt_to_files_that_are_each_whole() {
    let folder = tempfile::tempdir().unwrap();
    let bounds = Bounds { file_bytes: 2 << 20, ..Bounds::NONE };
    let about = About::new("paper");
    let mut recorder = Recorder::start_within(folder.path(), &about, 0, bounds).unwrap().patient();
    // 2.8 kB a tick.
    const TICKS: u64 = 2000;
    (0..TICKS).for_each(|tick| recorder.state(&state(tick)));
    assert_eq!(recorder.finish().unwrap(), 0);
    let mut files: Vec<_> = std::fs::read_dir(folder.path()).unwrap().flatten().map(|e| e.path()).collect();
    assert!(files.len() > 1, "{files:?}");
    files.sort_by_key(|file| read(file).unwrap()[0].time_ns);
    let mut ticks = Vec::new();
    for file in &files {
        let bytes = std::fs::read(file).unwrap();
        assert!(mcap::Summary::read(&bytes).unwrap().is_some(), "{} is finished", file.display());
        assert!(bytes.len() < 4 << 20, "{}", bytes.len());
        ticks.extend(read(file).unwrap().iter().map(|m| m.value["header"]["tick"].as_u64().unwrap()));
    }
    assert!(ticks.iter().copied().eq(0..TICKS), "none twice, none lost");
}

#[test]
fn every_recording_tells_what_time_of_day_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    drop(Recorder::start(&path, &About::new("paper"), 0).unwrap());
    let bytes = std::fs::read(&path).unwrap();
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let offset_ns = sinew::recording::wall_clock_offset_ns();
    let now_ns = offset_ns + sinew::ipc::monotonic_ns();
    let wall_ns = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64;
    assert!(wall_ns.abs_diff(now_ns) < 1_000_000_000);
    // To ten seconds: the digits before.
    let digits = &offset_ns.to_string()[..9];
    assert!(text.contains("wall_clock_offset_ns") && text.contains(digits), "{digits}");
}

#[test]
fn a_file_that_is_no_recording_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("not.mcap");
    std::fs::write(&path, b"something else altogether").unwrap();
    assert!(read(&path).is_err());
    assert!(read(&folder.path().join("missing.mcap")).unwrap_err().to_string().contains("missing.mcap"));
}

#[test]
fn independent_tools_read_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, 200);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let environment = std::env::current_exe().unwrap().ancestors().nth(3).unwrap().join("python-env");
    let made = Command::new("bash").arg(root.join("tests/support/python_env.sh")).arg(environment).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let python = String::from_utf8(made.stdout).unwrap();
    let script = root.join("tests/support/read_recording.py");
    let output = Command::new(python.trim()).arg(script).arg(&path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), "200 24 222.0 19.0 source expired 7");
}
