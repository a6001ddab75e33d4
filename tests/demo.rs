//! Claims about the demonstration: separate processes, a judgement by the truth, and nothing left behind.
//!
//! `sim_plant` must be built: `cargo build --workspace`, as `tests/run` does.
// The lint's exception for tests does not reach the helpers of an integration test.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use sinew::config::BUILTIN_FILES;
use sinew::ipc::payload::{SourceHealth, SupervisorState};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

const WAIT: Duration = Duration::from_secs(90);

struct Demo {
    child: Child,
    folder: tempfile::TempDir,
}

impl Demo {
    fn start(arguments: &[&str]) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), arguments)
    }

    /// A minute of the tip example.
    fn in_real_time() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let files = unhurried(folder.path());
        let arguments = ["tip", "--duration", "60"].into_iter().chain(files.iter().map(String::as_str));
        Self::start_in(folder, &arguments.collect::<Vec<_>>())
    }

    fn start_in(folder: tempfile::TempDir, arguments: &[&str]) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_sinew"))
            .arg("demo")
            .args(arguments)
            .arg("--keep")
            .arg(folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { child, folder }
    }

    /// Processes that this demo has started, by name of what each has become: their log is in the demo's folder.
    fn children(&self) -> Vec<(u32, String)> {
        let own = self.child.id();
        let mut found = Vec::new();
        for entry in std::fs::read_dir("/proc").unwrap().flatten() {
            let Ok(pid) = entry.file_name().to_string_lossy().parse::<u32>() else { continue };
            let Ok(stat) = std::fs::read_to_string(entry.path().join("stat")) else { continue };
            // Behind the name, which may hold anything: state and parent.
            let Some((_, rest)) = stat.rsplit_once(')') else { continue };
            let mut fields = rest.split_whitespace();
            if fields.next() != Some("Z") && fields.next() == Some(&own.to_string()) {
                let line = std::fs::read(entry.path().join("cmdline")).unwrap_or_default();
                found.push((pid, String::from_utf8_lossy(&line).replace('\0', " ")));
            }
        }
        found
    }

    fn child(&self, what: &str) -> Pid {
        let deadline = Instant::now() + WAIT;
        while Instant::now() < deadline {
            let found = self.children().into_iter().find(|(_, line)| line.contains(what) && !line.contains("leash"));
            if let Some((pid, _)) = found {
                return Pid::from_raw(i32::try_from(pid).unwrap()).unwrap();
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("no process {what} among {:?}", self.children());
    }

    /// Waits until the daemon records, so that all are at work.
    fn until_it_runs(&self) {
        let deadline = Instant::now() + WAIT;
        let size = |name: &str| std::fs::metadata(self.folder.path().join(name)).map_or(0, |m| m.len());
        while size("daemon.mcap") < 400_000 {
            assert!(Instant::now() < deadline, "the daemon does not record");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// The output; nothing of this demo may be left.
    fn end(self) -> (Output, tempfile::TempDir) {
        let (id, folder) = (self.child.id(), self.folder);
        let output = self.child.wait_with_output().unwrap();
        assert_eq!(files_of(id), Vec::<String>::new());
        assert_eq!(processes_of(id), Vec::<String>::new());
        (output, folder)
    }
}

/// The built-in configuration without what a busy machine makes of a loop in real time: nothing of it is claimed here.
fn unhurried(folder: &Path) -> Vec<String> {
    let mut arguments = vec!["--config".to_owned()];
    for (name, text) in BUILTIN_FILES {
        if ["arm.toml", "controller.toml", "drives.toml", "plant.toml"].contains(name) {
            let text = text
                .replace("encoder_silent_s = 0.05", "encoder_silent_s = 2.0")
                .replace("heartbeat_timeout_s = 0.15", "heartbeat_timeout_s = 3.0")
                .replace("sync_timeout_s = 0.1", "sync_timeout_s = 3.0")
                .replace("[loop]\n", "[loop]\noverruns_hold = 1000\noverruns_fault = 10000\n");
            std::fs::write(folder.join(name), text).unwrap();
            arguments.push(folder.join(name).display().to_string());
        }
    }
    arguments
}

/// Files in shared memory with the names of a demo.
fn files_of(id: u32) -> Vec<String> {
    let names = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.file_name().to_string_lossy().into_owned());
    let own = [format!("sinewdemo{id}_"), format!("sinew-bus-dm{id}-")];
    names.filter(|name| own.iter().any(|own| name.starts_with(own))).collect()
}

/// Processes in the domain of a demo.
fn processes_of(id: u32) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").unwrap().flatten() {
        let environment = std::fs::read(entry.path().join("environ")).unwrap_or_default();
        if String::from_utf8_lossy(&environment).contains(&format!("=sinewdemo{id}_")) {
            let line = std::fs::read(entry.path().join("cmdline")).unwrap_or_default();
            found.push(String::from_utf8_lossy(&line).replace('\0', " "));
        }
    }
    found
}

fn text(output: &Output) -> String {
    format!("{}\n{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// Commanded tensions of every tick that tracks, up to `ticks` of them.
fn tensions(folder: &Path, ticks: usize) -> Vec<Vec<u64>> {
    let mut found = Vec::new();
    sinew::recording::read_each(&folder.join("daemon.mcap"), |message| {
        if message.topic.ends_with("/state") && message.value["supervisor"] == 3 && found.len() < ticks {
            let numbers = message.value["tension_command_n"].as_array().unwrap();
            found.push(numbers.iter().map(|u| u.as_f64().unwrap().to_bits()).collect());
        }
    })
    .unwrap();
    found
}

#[test]
fn a_short_run_prints_one_object_judged_by_the_true_arm_and_leaves_nothing() {
    let (output, folder) = Demo::start(&["tip", "--fast", "--json", "--duration", "5"]).end();
    assert!(output.status.success(), "{}", text(&output));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    let keys: BTreeSet<&str> = object.as_object().unwrap().keys().map(String::as_str).collect();
    for key in ["scenario", "ticks", "newton", "obstacles", "tension_n", "tip_error_m", "time_us", "loop", "faults"] {
        assert!(keys.contains(key), "{key} is not in {keys:?}");
    }
    assert_eq!(object["ticks"], 500);
    assert_eq!(object["faults"], serde_json::json!([]));
    // A fixed number of iterations is the rule here: what counts them does not apply, and is there all the same.
    assert_eq!(object["newton"], serde_json::json!({"safe": null, "warning": null}));
    assert!(keys.contains("not_converged") && object["not_converged"].is_null());
    assert_eq!(object["loop"]["missed"], 0);
    let error = &object["tip_error_m"];
    // The truth, not the estimate: never perfect, never far.
    assert!((1e-4..5e-3).contains(&error["norm_mean"].as_f64().unwrap()), "{error}");
    assert!(object["obstacles"].as_array().unwrap().iter().all(|o| o["surface_distance_min_m"].as_f64() > Some(0.0)));
    // Nothing of the run is left but what was to be kept.
    let kept: BTreeSet<PathBuf> =
        std::fs::read_dir(folder.path()).unwrap().flatten().map(|e| e.file_name().into()).collect();
    assert!(kept.contains(Path::new("truth.mcap")) && kept.contains(Path::new("daemon.mcap")), "{kept:?}");
}

#[test]
fn a_run_for_people_ends_by_naming_the_page_and_the_report() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("tip.html");
    let (output, _kept) = Demo::start(&["tip", "--fast", "--duration", "1"]).end();
    assert!(output.status.success(), "{}", text(&output));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        said.contains("what happened and why: add --report FILE.html") && said.contains("in a browser: add --view"),
        "{said}"
    );
    let report = ["tip", "--fast", "--duration", "1", "--report", page.to_str().unwrap()];
    let (output, _kept) = Demo::start(&report).end();
    let said = text(&output);
    assert!(said.contains(&format!("what happened, and why: {}", page.display())) && page.exists(), "{said}");
}

#[test]
fn another_arm_needs_nothing_but_its_own_file() {
    // Loops of 4, 4 and 2 ms: the task sends its points 0.4 s ahead, and the daemon keeps 64.
    for (name, length_m) in [("rao-2021/tip", 0.4), ("festo-bha/tip", 0.75), ("rucker-webster-2011/tip", 0.242)] {
        let (output, _folder) = Demo::start(&[name, "--fast", "--json", "--duration", "3"]).end();
        assert!(output.status.success(), "{name}: {}", text(&output));
        let object: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(object["faults"], serde_json::json!([]), "{name}");
        let error = &object["tip_error_m"];
        assert!(error["norm_mean"].as_f64().unwrap() < 0.005 * length_m, "{name}: {error}");
        assert!(error["norm_max"].as_f64().unwrap() < 0.015 * length_m, "{name}: {error}");
    }
}

#[test]
fn a_seed_gives_the_same_tensions_bit_for_bit_and_another_seed_others() {
    let run = |seed: &str| {
        let (output, folder) = Demo::start(&["tip", "--fast", "--json", "--duration", "1", "--seed", seed]).end();
        assert!(output.status.success(), "{}", text(&output));
        // The approach and the second itself.
        let found = tensions(folder.path(), 500);
        assert_eq!(found.len(), 500);
        found
    };
    let first = run("2");
    let second = run("2");
    if let Some(tick) = (0..500).find(|&k| first[k] != second[k]) {
        panic!("the runs part at tick {tick} of tracking");
    }
    assert_ne!(first, run("3"));
}

#[test]
fn ctrl_c_stops_everything_in_order() {
    let demo = Demo::in_real_time();
    demo.until_it_runs();
    assert_eq!(demo.children().len(), 4, "{:?}", demo.children());
    kill_process(Pid::from_child(&demo.child), Signal::INT).unwrap();
    let (output, _folder) = demo.end();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    assert!(text(&output).contains("interrupted after"), "{}", text(&output));
}

#[test]
fn a_duration_beyond_the_scenarios_is_cut_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("short.toml");
    let content = "name = \"short\"\nduration_s = 0.5\nweight_tension_change = [2e6, 2e6, 2e6, 2e6]\n\
                [task]\nmode = \"shape\"\ncurvatures_1pm = [0.8, 0.8, -2.4, 0.0, -1.6, -2.4, -1.6, -2.4]\n\
                weight_end = 1e10\n[start]\nkind = \"straight\"\n";
    std::fs::write(&file, content).unwrap();
    let (output, _folder) = Demo::start(&[file.to_str().unwrap(), "--fast", "--json", "--duration", "5"]).end();
    assert!(output.status.success(), "{}", text(&output));
    assert!(text(&output).contains("--duration 5: short ends after 0.5 s"), "{}", text(&output));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(object["ticks"], 50);
}

#[test]
fn an_interrupted_run_is_judged_up_to_the_interruption() {
    let folder = tempfile::tempdir().unwrap();
    let pictures = folder.path().join("pictures.toml");
    std::fs::write(&pictures, "[recording]\npictures_1ps = 0\n").unwrap();
    let files = unhurried(folder.path()).into_iter().chain([pictures.display().to_string()]);
    let arguments: Vec<_> = ["tip", "--fast", "--json"].map(str::to_owned).into_iter().chain(files).collect();
    let demo = Demo::start_in(folder, &arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let deadline = Instant::now() + WAIT;
    // Past the approach of 4 s, whatever the machine does meanwhile, and far from the end at 100 s: 3 kB a tick.
    while std::fs::metadata(demo.folder.path().join("daemon.mcap")).map_or(0, |m| m.len()) < 2_500_000 {
        assert!(Instant::now() < deadline, "the daemon does not record");
        std::thread::sleep(Duration::from_millis(10));
    }
    kill_process(Pid::from_child(&demo.child), Signal::INT).unwrap();
    let (output, folder) = demo.end();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    assert!(text(&output).contains("interrupted after"), "{}", text(&output));
    // The arm went limp behind the ramp of the stop, which is in the recording and not in the judgement.
    assert!(told(folder.path()).iter().any(|t| t.mode == SupervisorState::Stopping as u64));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(object["ticks"].as_u64() > Some(100), "{object}");
    assert!(object["tip_error_m"]["norm_max"].as_f64() < Some(0.02), "{object}");
    for obstacle in object["obstacles"].as_array().unwrap() {
        assert_eq!(obstacle["inside_s"], serde_json::json!([]), "{object}");
    }
}

#[test]
fn a_demo_that_is_killed_takes_its_processes_along() {
    let mut demo = Demo::in_real_time();
    demo.until_it_runs();
    assert_eq!(processes_of(demo.child.id()).len(), 4);
    demo.child.kill().unwrap();
    demo.child.wait().unwrap();
    let deadline = Instant::now() + WAIT;
    let id = demo.child.id();
    let processes = || processes_of(id);
    while !processes().is_empty() {
        assert!(Instant::now() < deadline, "{:?}", processes());
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_plant_that_is_killed_ends_the_demo_with_its_name() {
    let demo = Demo::start(&["tip", "--fast", "--duration", "60"]);
    demo.until_it_runs();
    kill_process(demo.child("sim_plant"), Signal::KILL).unwrap();
    let (output, _folder) = demo.end();
    assert!(!output.status.success());
    assert!(text(&output).contains("plant ended by itself: signal: 9"), "{}", text(&output));
}

#[test]
fn an_encoder_that_jumps_is_a_fault_in_the_report() {
    let (output, _folder) =
        Demo::start(&["tip", "--fast", "--json", "--duration", "20", "--fault", "jump:7:0.05@5"]).end();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    let faults = object["faults"].as_array().unwrap();
    assert!(faults.iter().any(|f| f.as_str().unwrap().contains("encoder")), "{faults:?}");
    // The judgement ends there: 20 s of a limp arm would be 2000 ticks and a large error.
    assert!(object["ticks"].as_u64().unwrap() < 500, "{}", object["ticks"]);
}

/// What the daemon's records say of the ticks of a run.
struct Told {
    mode: u64,
    health: u64,
    growth_m: f64,
    tip_m: [f64; 3],
}

fn told(folder: &Path) -> Vec<Told> {
    let mut found = Vec::new();
    sinew::recording::read_each(&folder.join("daemon.mcap"), |message| {
        if message.topic.ends_with("/state") {
            let v = &message.value;
            let growth = v["distances"].as_array().unwrap().iter().map(|d| d["growth_m"].as_f64().unwrap());
            found.push(Told {
                mode: v["supervisor"].as_u64().unwrap(),
                health: v["obstacle_sources"][0]["health"].as_u64().unwrap_or(0),
                growth_m: growth.fold(0.0, f64::max),
                tip_m: std::array::from_fn(|i| v["tip_position_m"][i].as_f64().unwrap()),
            });
        }
    })
    .unwrap();
    found
}

#[test]
fn an_obstacle_client_that_is_killed_in_the_middle_of_avoiding_leads_to_growth_a_hold_and_no_contact() {
    const FRESH: u64 = SourceHealth::Fresh as u64;
    const TRACKING: u64 = SupervisorState::Tracking as u64;
    const HOLDING: u64 = SupervisorState::Holding as u64;
    // At 12 s of the scenario the arm gives way to the moving ball.
    let arguments = ["tip", "--fast", "--json", "--duration", "18", "--kill-obstacle-client-at", "12"];
    let (output, folder) = Demo::start(&arguments).end();
    assert!(output.status.success(), "{}", text(&output));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(object["ticks"], 1800, "the arm is judged to the end");
    assert_eq!(object["faults"], serde_json::json!([]));
    for obstacle in object["obstacles"].as_array().unwrap() {
        assert!(obstacle["surface_distance_min_m"].as_f64().unwrap() > 0.0, "{obstacle}");
        assert_eq!(obstacle["inside_s"], serde_json::json!([]));
    }
    let told = told(folder.path());
    let first = told.iter().position(|t| t.mode == TRACKING).unwrap();
    let stale = first + told[first..].iter().position(|t| t.health != FRESH).expect("the source grows stale");
    // 4 s of approach and 12 s, and the time until silence is noticed, in ticks of 10 ms; the kill itself is not bound to
    // a tick.
    assert!((1600..1800).contains(&(stale - first)), "{}", stale - first);
    assert!(told[first..stale].iter().all(|t| t.mode == TRACKING));
    let held = stale + told[stale..].iter().position(|t| t.mode == HOLDING).expect("the declared action: a hold");
    // Meanwhile its obstacles grow.
    assert!(told[held - 1].growth_m > told[stale - 2].growth_m + 1e-3, "{} m", told[held - 1].growth_m);
    // From then on it holds: nothing tracks again, the tip does not go on along its path (of 38 mm/s), and gives way by less
    // than a third of what its obstacles have grown by, 54 mm at most: they are kept away by 3 sigma of the estimate as well.
    let end = held + told[held..].iter().position(|t| t.mode != HOLDING).unwrap_or(told.len() - held);
    assert!(end - held > 100, "{}", end - held);
    let by = |from: &Told, to: &Told| -> [f64; 3] { std::array::from_fn(|i| to.tip_m[i] - from.tip_m[i]) };
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let before = by(&told[held - 20], &told[held]);
    for t in &told[held..end] {
        let moved = by(&told[held], t);
        let along = moved.iter().zip(before).map(|(m, b)| m * b).sum::<f64>() / norm(before);
        assert!(along < 0.03, "{along} m along its path");
        assert!(norm(moved) < (0.3 * t.growth_m).min(0.054), "{moved:?} m, obstacles grown by {} m", t.growth_m);
    }
}

#[test]
fn an_unknown_scenario_is_refused() {
    let output = Command::new(env!("CARGO_BIN_EXE_sinew")).args(["demo", "nowhere"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output).contains("built-in scenarios"), "{}", text(&output));
}

#[test]
fn interfaces_that_do_not_fit_or_do_not_exist_are_refused_with_the_reason() {
    let demo = Demo::start(&["tip", "--fast", "--can", "can-none,can-none-2"]);
    let (output, _folder) = demo.end();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output).contains("--can names 2 interface(s), the configuration has 1 bus(es)"), "{}", text(&output));

    let demo = Demo::start(&["tip", "--fast", "--can", "can-none"]);
    let (output, _folder) = demo.end();
    assert_eq!(output.status.code(), Some(2));
    // The report may break its lines anywhere between words.
    let said = text(&output).replace(['│', '\n'], " ").split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("can-none"), "{said}");
    assert!(said.contains("does not exist") || said.contains("no CAN sockets"), "{said}");
}
