//! Claims about what a recording has for viewers, and about what a killed process leaves.
// The lint's exception for tests does not reach the helpers of an integration test.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use serde_json::{Value, json};
use sinew::config::ArmConfig;
use sinew::daemon::words::event_in_words;
use sinew::ipc::payload::{Header, Obstacle, Obstacles, SourceReport, State, TargetMode};
use sinew::ipc::{Event, Tap};
use sinew::recording::{
    About, CONFIGURATION, FileEnd, Recorder, Recording, SOFTWARE, Viewer, facts, last_ns, read, read_between, read_raw,
};
use std::ops::ControlFlow;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

const TICK_NS: u64 = 10_000_000;
/// Ticks in which the second obstacle is still there.
const BOTH: u64 = 100;

fn state(tick: u64) -> State {
    let mut s = State {
        header: Header::new(0, tick, tick * TICK_NS).for_tick(tick),
        time_s: tick as f64 * 0.01,
        supervisor: 3,
        cable_count: 24,
        segment_count: 4,
        target_mode: TargetMode::Tip.wire(),
        target_position_m: [0.1, 0.2, -2.5],
        target_quaternion: [1.0, 0.0, 0.0, 0.0],
        distance_count: 1,
        ..State::default()
    };
    s.distances[0].source_id = 7;
    s.distances[0].obstacle_id = 1;
    s.distances[0].surface_distance_m = 0.25;
    s.distances[0].growth_m = 0.01;
    s.obstacle_sources[0] = SourceReport { source_id: 7, accepted: 3, ..Default::default() };
    s.set_nodes(20, |i| [0.0, 0.0, -0.14 * (i + 1) as f64], |_| [1.0, 0.0, 0.0, 0.0]);
    s
}

/// A ball on its way along x, and a hull that is no longer there after [`BOTH`] ticks.
fn obstacles(tick: u64) -> Obstacles {
    let mut set = Obstacles { header: Header::new(7, tick, tick * TICK_NS), ..Obstacles::default() };
    let ball = Obstacle::ball(1, [0.4, 0.1, -1.2], 0.1);
    assert!(set.push(Obstacle { velocity_mps: [0.5, 0.0, 0.0], ..ball }));
    let vertices = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    if tick < BOTH {
        assert!(set.push_hull(Obstacle { id: 2, ..Obstacle::default() }, &vertices));
    }
    set
}

fn fault() -> Event {
    // A silent encoder of the eighth cable.
    Event {
        time_ns: 3 * TICK_NS,
        tick: 3,
        code: 20,
        detail: 7,
        flags: 0,
        value: 0.5,
        second: f64::NAN,
        text: "an encoder is silent",
    }
}

fn about(pictures_1ps: u32) -> About {
    let arm = ArmConfig::paper();
    let viewer = Viewer::new(&arm, pictures_1ps).map(|v| v.naming(7, 1, "the ball").telling(event_in_words));
    About::new("paper").configured(Some("[arm]\n".into())).set(&arm).shown(viewer)
}

fn write(path: &Path, ticks: u64, pictures_1ps: u32) {
    let mut recording = Recording::create(path, &about(pictures_1ps)).unwrap();
    recording.event(0, &fault()).unwrap();
    for tick in 0..ticks {
        // An obstacle client at 10 Hz.
        if tick % 10 == 0 {
            recording.obstacles(tick * TICK_NS, &obstacles(tick)).unwrap();
        }
        recording.state(tick * TICK_NS, &state(tick)).unwrap();
    }
    recording.finish().unwrap();
}

fn counts(path: &Path) -> Vec<(String, u64)> {
    let bytes = std::fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let stats = summary.stats.unwrap();
    let count = |id: &u16| stats.channel_message_counts.get(id).copied().unwrap_or(0);
    let mut counts: Vec<_> = summary.channels.iter().map(|(id, channel)| (channel.topic.clone(), count(id))).collect();
    counts.sort();
    counts
}

#[test]
fn pictures_come_at_their_rate_and_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, 200, 30);
    let counts = counts(&path);
    let of = |name: &str| counts.iter().find(|(topic, _)| topic.ends_with(name)).unwrap().1;
    // 2 s; ticks of 10 ms meet pictures of 33 ms in step.
    assert_eq!((of("/state"), of("/scene"), of("/transforms"), of("/points"), of("/log")), (200, 60, 60, 20, 1));
    let none = folder.path().join("none.mcap");
    write(&none, 200, 0);
    assert!(std::fs::metadata(&none).unwrap().len() < std::fs::metadata(&path).unwrap().len());
    assert_eq!(read(&none).unwrap(), read(&path).unwrap(), "sinew's own messages are the same with them");
}

#[test]
fn an_independent_reader_sees_the_arm_where_the_state_says_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, 200, 30);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let environment = std::env::current_exe().unwrap().ancestors().nth(3).unwrap().join("python-env");
    let made = Command::new("bash").arg(root.join("tests/support/python_env.sh")).arg(environment).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let python = String::from_utf8(made.stdout).unwrap();
    let script = root.join("tests/support/read_pictures.py");
    let output = Command::new(python.trim()).arg(script).arg(&path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(told["counts"], json!({ "scene": 60, "transforms": 60, "log": 1, "points": 20 }));
    assert_eq!(told["entities"], json!(["arm", "mode", "target", "obstacle 7/1"]));
    assert_eq!(told["deleted"], json!(["obstacle 7/2"]), "what is gone is deleted once");
    assert_eq!((&told["disks"], &told["backbone"]), (&json!(21), &json!(21)), "twenty nodes and the base");
    let tip = &told["tip"];
    assert!(tip[0] == 0.0 && (tip[1].as_f64().unwrap() + 2.8).abs() < 1e-12, "{tip}");
    // The last picture is at 1.97 s, seven ticks behind the last set: it has moved on.
    let x = told["ball"][0].as_f64().unwrap();
    assert!((0.4..0.4 + 0.5 * 0.1).contains(&x) && x > 0.42, "{x}");
    assert_eq!(told["ball"][1], 0.2);
    assert_eq!(told["label"], "the ball, 250 mm");
    let frames =
        json!(["paper/base", "paper/segment 1", "paper/segment 2", "paper/segment 3", "paper/tip", "paper/target"]);
    assert_eq!(told["frames"], frames);
    assert_eq!(told["log"], json!([[4, "fault: the encoder of cable 2,2 has been silent for 0.500 s"]]));
    assert!(told["points"].as_u64().unwrap() > 300);
    assert_eq!(told["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!((&told["segments"], &told["configuration"]), (&json!(4), &json!("[arm]\n")));
}

#[test]
fn what_stands_before_the_messages_is_read_without_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, 200, 30);
    let whole = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &whole[..whole.len() / 3]).unwrap();
    for file in [&path, &cut] {
        let facts = facts(file).unwrap();
        assert_eq!(facts.metadata["arm"], "paper");
        assert_eq!(facts.attachments[CONFIGURATION], "[arm]\n");
        assert!(facts.attachments[SOFTWARE].contains(env!("CARGO_PKG_VERSION")));
    }
}

#[test]
fn a_time_is_found_by_the_index_and_without() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, 500, 30);
    let whole = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &whole[..whole.len() * 9 / 10]).unwrap();
    for (file, end) in [(&path, FileEnd::Whole), (&cut, FileEnd::Cut)] {
        let mut ticks = Vec::new();
        read_between(file, &["state"], (100 * TICK_NS, 110 * TICK_NS), |message| {
            ticks.push(message.decode::<Value>()?["header"]["tick"].as_u64().unwrap());
            Ok(ControlFlow::Continue(()))
        })
        .unwrap();
        assert!(ticks.iter().copied().eq(100..110), "{ticks:?}");
        let mut count = 0;
        let ended = read_raw(file, |_| {
            count += 1;
            Ok(ControlFlow::Continue(()))
        });
        assert_eq!(ended.unwrap(), end);
        let last = last_ns(file).unwrap().unwrap();
        assert_eq!(last == 499 * TICK_NS, end == FileEnd::Whole, "{last}");
        assert!(count > 400, "{count}");
    }
}

/// A recorder that goes on stands for a process that is killed: what it has not handed to the system is lost.
#[test]
fn a_killed_process_loses_a_second_at_most() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut recorder = Recorder::start(&path, &about(30), 0).unwrap();
    let (begin, ticks) = (Instant::now(), 220);
    for tick in 0..ticks {
        recorder.state(&state(tick));
        std::thread::sleep((Duration::from_nanos(TICK_NS) * (tick as u32 + 1)).saturating_sub(begin.elapsed()));
    }
    let copy = folder.path().join("copy.mcap");
    std::fs::copy(&path, &copy).unwrap();
    let states = |file: &Path| read(file).unwrap().iter().filter(|m| m.topic.ends_with("state")).count() as u64;
    let kept = states(&copy);
    assert!(kept + 100 >= ticks, "{kept} of {ticks} ticks of 10 ms");
    // Where no further message comes, the rest is written all the same.
    std::thread::sleep(Duration::from_millis(1000));
    std::fs::copy(&path, &copy).unwrap();
    assert_eq!(states(&copy), ticks);
    drop(recorder);
}
