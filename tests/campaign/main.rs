//! A campaign of faults around a moving arm, judged by the true arm.
//!
//! Each class has a name and a declared outcome. A trial of it starts a plant, a daemon, a camera and a task, lets the arm
//! follow its path, does what the class says at a moment drawn from the seed, lets time pass, and orders a stop over the
//! arm's socket. Then the true arm is asked: it touched nothing while its drives obeyed, no drum was told a tension outside the box, and in the end
//! none pulls. The short form, a trial of some classes, is a test; `tests/campaign/run` does all of them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod classes;
mod processes;
#[path = "../daemon_support/mod.rs"]
mod support;

use classes::{CAMERA, CLASSES, Class, Disk, Expect};
use processes::{family, whereabouts};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::config::Config;
use sinew::daemon::operator::{OperatorError, Said, Word};
use sinew::ipc::monotonic_ns;
use sinew::ipc::payload::{RequestKind, Target};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use support::*;

/// The camera's ball: beside the arm, off its path.
const BALL: ([f64; 3], f64) = ([0.28, 0.05, -2.1], 0.1);
/// What nothing takes longer than: beyond it is a hang, and told as such.
const HANG: Duration = Duration::from_secs(2);
/// One stop in so many is waited for until the arm rests.
const WHOLE_STOPS: u64 = 6;
/// Longest time from the order of a stop to drives without torque.
const REST: Duration = Duration::from_secs(60);
/// Longest time that a trial may take with all its waits; beyond it is a hang of the trial.
const TRIAL: Duration = Duration::from_secs(200);
/// Longest wait where that has been told.
const WAITS: Duration = Duration::from_secs(20);

/// Everything of one trial, for a class to lay hands on.
pub struct Trial {
    /// Files, names, configuration.
    pub place: Place,
    /// Of the trial's seed.
    pub rng: Xoshiro256PlusPlus,
    /// The client that sends the ball.
    pub camera: Option<Child>,
    /// The daemon.
    pub daemon: Child,
    /// Ends with the trial.
    pub helpers: Vec<Child>,
    task: Task,
    said: PathBuf,
}

impl Drop for Trial {
    /// Also where the trial itself failed: nobody stays.
    fn drop(&mut self) {
        for child in self.helpers.iter_mut().chain(self.camera.as_mut()).chain([&mut self.daemon]) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Trial {
    /// A pause drawn from the seed (ms).
    pub fn pause(&mut self, from_ms: u64, to_ms: u64) {
        std::thread::sleep(Duration::from_millis(self.rng.random_range(from_ms..to_ms)));
    }

    /// A client of the command line that ends by itself or with the trial.
    pub fn helper(&mut self, arguments: &[&str]) -> &mut Child {
        let child = self.place.sinew(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        self.keep(child)
    }

    /// Another program, ended with the trial.
    pub fn keep(&mut self, child: Child) -> &mut Child {
        self.helpers.push(child);
        self.helpers.last_mut().unwrap()
    }

    /// Ends the task client.
    pub fn end_task(&mut self) {
        self.task.end();
    }
}

/// A client that gives targets: the tip swings slowly around the straight pose.
struct Task {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Task {
    fn start(place: &Place) -> Self {
        let (stop, client) = (Arc::new(AtomicBool::new(false)), place.client());
        let mut targets = client.targets(12).unwrap();
        let flag = stop.clone();
        let thread = std::thread::spawn(move || {
            let (_client, begun) = (client, Instant::now());
            let half = std::f64::consts::FRAC_1_SQRT_2;
            while !flag.load(Ordering::Acquire) {
                let t = begun.elapsed().as_secs_f64();
                let mut target = Target {
                    position_m: [0.08 * (0.4 * t).sin(), 0.05, -2.72],
                    quaternion: [half, 0.0, half, 0.0],
                    velocity_mps: [0.032 * (0.4 * t).cos(), 0.0, 0.0],
                    ..Target::default()
                };
                // A class may have taken its shared memory away.
                let _ = targets.publish(&mut target, monotonic_ns());
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        Self { stop, thread: Some(thread) }
    }

    fn end(&mut self) {
        self.stop.store(true, Ordering::Release);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(ended.is_none_or(|e| e.is_ok()) || std::thread::panicking());
    }
}

/// What a trial came to.
#[derive(Debug, Default)]
struct Found {
    /// Mode before the stop was ordered; `None`: no daemon.
    mode: Option<String>,
    /// From the order to the answer (ms).
    stop_ms: Option<f64>,
    wrong: Vec<String>,
}

fn place(class: &Class) -> Place {
    let (roles, small) = (class.roles, class.record == Some(Disk::Small));
    Place::new(|file, text| {
        let access = format!("\n[access]\npublish = [\"{CAMERA}\"]\n");
        let text = if roles && file == "drives.toml" { text + &access } else { text };
        let text = if small && file == "drives.toml" { text + "\n[recording]\nfree_mib = 0\n" } else { text };
        text.replace("heartbeat_timeout_s = 3.0", "heartbeat_timeout_s = 0.5")
            .replace("sync_timeout_s = 3.0", "sync_timeout_s = 0.5")
    })
}

/// The daemon, with the recording of its class.
fn recording(class: &Class, place: &Place) -> Command {
    let path = place.folder.path().join("recordings");
    let text = path.display().to_string();
    match class.record {
        None => place.sinew(&["run"]),
        Some(Disk::Folder) => {
            std::fs::create_dir(&path).unwrap();
            place.sinew(&["run", "--record", &text])
        }
        Some(Disk::Small) => {
            std::fs::create_dir(&path).unwrap();
            let run = place.sinew(&["run", "--record", &text]);
            let mut command = Command::new("unshare");
            let mount = format!("mount -t tmpfs -o size=1m tmpfs {text} && exec \"$@\"");
            command.args(["--mount", "--propagation", "private", "sh", "-c", &mount, "sh"]);
            command.arg(run.get_program()).args(run.get_args());
            command
        }
    }
}

/// Runs a trial on a thread of its own and waits for it. One that does not end is an error that says where every process
/// and thread of it waits; it ends the campaign, for what it holds cannot be given back.
fn bounded_trial(class: &'static Class, seed: u64) -> Found {
    let (send, receive) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let tried = std::panic::catch_unwind(|| trial(class, seed));
        let _ = send.send(tried.unwrap_or_else(|panic| {
            let text =
                panic.downcast_ref::<String>().cloned().or(panic.downcast_ref::<&str>().map(|s| (*s).to_owned()));
            let text = text.unwrap_or_default();
            Found {
                wrong: vec![format!("the trial itself: {}", text.chars().take(1000).collect::<String>())],
                ..Found::default()
            }
        }));
    });
    receive.recv_timeout(TRIAL).unwrap_or_else(|_| {
        eprintln!("FAILED {} (seed {seed}): not ended after {} s; waiting are:", class.name, TRIAL.as_secs());
        for pid in family() {
            eprintln!("{}", whereabouts(pid).unwrap_or_else(|error| format!("{pid}: {error}")));
        }
        // Left alone they would go on beside the next test.
        for pid in family().into_iter().filter(|pid| *pid != std::process::id()) {
            let pid = rustix::process::Pid::from_raw(pid as i32).unwrap();
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::KILL);
        }
        std::process::exit(1)
    })
}

fn trial(class: &Class, seed: u64) -> Found {
    let mut found = Found::default();
    let place = place(class);
    let config = place.config();
    let trace = place.folder.path().join("truth.mcap");
    let plant = Plant::start_traced(&place, class.drives, class.wire, &trace);
    let said = place.folder.path().join("daemon.log");
    let mut run = recording(class, &place);
    let daemon = run.stderr(std::fs::File::create(&said).unwrap()).spawn().unwrap();
    place.until("a first tick", |s| s.ticks > 0);
    let ball = format!("{},{},{},{}", BALL.0[0], BALL.0[1], BALL.0[2], BALL.1);
    let camera = place.sinew(&["obstacles", "inject", "--ball", &ball]).stderr(Stdio::null()).spawn().unwrap();
    let task = Task::start(&place);
    let rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut trial = Trial { place, rng, camera: Some(camera), daemon, helpers: Vec::new(), task, said };
    trial.place.arm();
    let deadline = Instant::now() + WAIT;
    while !trial.place.request(RequestKind::Track).is_accepted() {
        assert!(Instant::now() < deadline, "never tracks: {:#?}", trial.place.status());
        std::thread::sleep(Duration::from_millis(20));
    }
    trial.pause(100, 600);
    let begun_ns = monotonic_ns();
    (class.does)(&mut trial);
    trial.pause(200, 600);
    if class.waits_s > 0.0 {
        std::thread::sleep(Duration::from_secs_f64(class.waits_s));
    }

    let address = trial.place.address();
    // What is declared may take its time; that nothing happens shows at once.
    let deadline = Instant::now() + Duration::from_secs(8);
    loop {
        let begun = Instant::now();
        found.mode = match address.ask(Word::Status, WAITS) {
            Ok(Said::Status(report)) => Some(report.mode),
            Err(OperatorError::NoDaemon(_) | OperatorError::Io { .. } | OperatorError::Garbled { .. }) => None,
            other => {
                found.wrong.push(format!("status: {other:?}"));
                break;
            }
        };
        if begun.elapsed() > HANG {
            found.wrong.push(format!("status took {:.1} s", begun.elapsed().as_secs_f64()));
        }
        if fits(class, found.mode.as_deref()) || class.expect == Expect::GoesOn || Instant::now() > deadline {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let ordered = Instant::now();
    let stopped = address.ask(Word::Stop, WAITS);
    if ordered.elapsed() > HANG {
        found.wrong.push(format!("stop took {:.1} s", ordered.elapsed().as_secs_f64()));
    }
    match stopped {
        Ok(Said::Answer(answer)) => {
            found.stop_ms = Some(1e3 * ordered.elapsed().as_secs_f64());
            // Refused where the arm does not move: in a fault, or disarmed.
            if !answer.accepted && !["disarmed", "faulted"].contains(&found.mode.as_deref().unwrap_or("")) {
                found.wrong.push(format!("stop refused in {:?}: {}", found.mode, answer.text));
            }
        }
        Err(_) if class.expect == Expect::Gone => {}
        other => found.wrong.push(format!("stop: {other:?}")),
    }
    // A stop is a motion of many seconds, which most trials cut short.
    let mut until = Until::of(class, begun_ns);
    if !seed.is_multiple_of(WHOLE_STOPS) && found.stop_ms.is_some() {
        trial.pause(50, 400);
        until.first_ns = Some(until.first_ns.unwrap_or(u64::MAX).min(monotonic_ns()));
        let _ = address.ask(Word::Disarm, WAITS);
    }
    end(&mut trial, class, &mut found);
    // The ramp, or the drives' own guards, have had their time.
    plant.stop();
    judge(&trace, &config, &until, &mut found);
    drop(trial);
    if !fits(class, found.mode.as_deref()) {
        found.wrong.push(format!(
            "declared: {:?}, found: {}",
            class.expect,
            found.mode.as_deref().unwrap_or("no daemon")
        ));
    }
    found
}

/// Whether the mode is the declared one.
fn fits(class: &Class, mode: Option<&str>) -> bool {
    match class.expect {
        Expect::GoesOn => mode == Some("tracking"),
        Expect::Holds => mode == Some("holding"),
        Expect::Faults => mode == Some("faulted"),
        Expect::Gone => mode.is_none(),
        Expect::Stops => mode.is_none_or(|m| ["disarmed", "stopping"].contains(&m)),
        Expect::Safe => true,
    }
}

/// Waits until drives are off, ends all processes, and looks at how they ended.
fn end(trial: &mut Trial, class: &Class, found: &mut Found) {
    let deadline = Instant::now() + REST;
    loop {
        match trial.place.address().ask(Word::Status, Duration::from_secs(5)) {
            Ok(Said::Status(report)) if report.drives.enabled == 0 => break,
            Err(OperatorError::NoDaemon(_)) => {
                // The guards' time-out and ramp.
                std::thread::sleep(Duration::from_millis(1200));
                break;
            }
            _ if Instant::now() > deadline => {
                found.wrong.push("the drives are still enabled".into());
                break;
            }
            _ => std::thread::sleep(Duration::from_millis(10)),
        }
    }
    trial.task.end();
    for child in trial.helpers.iter_mut().chain(trial.camera.as_mut()) {
        let _ = child.kill();
        let _ = child.wait();
    }
    let pid = rustix::process::Pid::from_child(&trial.daemon);
    let _ = rustix::process::kill_process(pid, rustix::process::Signal::CONT);
    let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    let deadline = Instant::now() + 2 * WAITS;
    let status = loop {
        match trial.daemon.try_wait().unwrap() {
            Some(status) => break Some(status),
            None if Instant::now() > deadline => break None,
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let mut text = String::new();
    let _ = std::fs::File::open(&trial.said).and_then(|mut file| file.read_to_string(&mut text));
    match status {
        None => {
            found.wrong.push("the daemon does not end".into());
            let _ = trial.daemon.kill();
            let _ = trial.daemon.wait();
        }
        // 2: the recording ended early.
        Some(status) if class.record.is_some() && status.code() == Some(2) => {}
        Some(status) if class.expect != Expect::Gone && ![Some(0), Some(1)].contains(&status.code()) => {
            found.wrong.push(format!("the daemon ended with {status}: {text}"));
        }
        Some(_) => {}
    }
    if text.contains("panicked") {
        found.wrong.push(format!("panic: {text}"));
    }
    // Whatever a class left in shared memory goes with its prefix.
    for entry in std::fs::read_dir("/dev/shm").unwrap().flatten() {
        if entry.file_name().to_string_lossy().starts_with(trial.place.prefix()) {
            let _ = std::fs::remove_file(entry.path()).or_else(|_| std::fs::remove_dir(entry.path()));
        }
    }
    let _ = std::fs::remove_dir_all(trial.place.folder.path().join("ipc"));
}

/// Until when contact counts: an arm whose drives have let go swings as it is.
struct Until {
    /// CLOCK_MONOTONIC (ns).
    first_ns: Option<u64>,
    /// Since the first cable pulled (ns).
    after_enabling_ns: u64,
}

impl Until {
    fn of(class: &Class, begun_ns: u64) -> Self {
        // Faults of drives and wire begin 3 s after the first drive was enabled.
        let late = !class.drives.is_empty() || !class.wire.is_empty();
        let lets_go = !late && [Expect::Faults, Expect::Gone].contains(&class.expect);
        Self { first_ns: lets_go.then_some(begun_ns), after_enabling_ns: if late { 3_000_000_000 } else { u64::MAX } }
    }
}

/// The true arm: no contact while the drives obey, no tension outside, nothing pulls in the end.
fn judge(trace: &Path, config: &Config, until: &Until, found: &mut Found) {
    let (centre, radius) = BALL;
    let body_m = config.planner.body_radius_m;
    let (mut nearest, mut most, mut least, mut last) = (f64::INFINITY, 0.0f64, 0.0f64, f64::INFINITY);
    let mut first_ns = u64::MAX;
    sinew::recording::read_each(trace, |message| {
        let v = &message.value;
        let tensions = v["tension_command_n"].as_array().into_iter().flatten().filter_map(|t| t.as_f64());
        last = 0.0;
        for tension in tensions {
            (most, least, last) = (most.max(tension), least.min(tension), f64::max(last, tension));
        }
        let now_ns = v["header"]["capture_ns"].as_u64().unwrap();
        if last > 0.0 {
            first_ns = first_ns.min(now_ns);
        }
        if now_ns > until.first_ns.unwrap_or(u64::MAX) || now_ns > first_ns.saturating_add(until.after_enabling_ns) {
            return;
        }
        for node in v["nodes"].as_array().into_iter().flatten() {
            let p: Vec<f64> = node["position_m"].as_array().into_iter().flatten().filter_map(|x| x.as_f64()).collect();
            let d = p.iter().zip(centre).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
            nearest = nearest.min(d - radius - body_m);
        }
    })
    .unwrap();
    assert!(nearest.is_finite(), "the trace has the arm");
    if nearest < 0.0 {
        found.wrong.push(format!("contact: {:.1} mm", 1e3 * nearest));
    }
    if most > config.arm.tension_n_max * (1.0 + 1e-9) || least < -1e-9 {
        found.wrong.push(format!("tensions of {least} to {most} N"));
    }
    if last > config.drives.safe_tension_n + 1.0 {
        found.wrong.push(format!("in the end a cable pulls with {last:.1} N"));
    }
}

/// Runs trials of classes, round after round, and writes a table; the failures.
fn campaign(classes: &[&'static Class], trials: usize, seed: u64) -> Vec<String> {
    let mut rows = Rows::new();
    let mut failed = Vec::new();
    for number in 0..trials {
        let class = classes[number % classes.len()];
        if class.root && !rustix::process::geteuid().is_root() {
            continue;
        }
        let own = seed.wrapping_mul(1_000_003).wrapping_add(number as u64);
        // Told before: one that hangs is known by it.
        eprintln!("{} of {trials}: {} (--class {} --seed {own})", number + 1, class.name, class.name);
        let begun = Instant::now();
        let found = bounded_trial(class, own);
        eprintln!("    {:.1} s", begun.elapsed().as_secs_f64());
        let row = rows.entry(class.name).or_default();
        row.0 += 1;
        row.2.extend(found.stop_ms);
        if !found.wrong.is_empty() {
            row.1 += 1;
            failed.push(format!("{} (--class {} --seed {own}): {}", class.name, class.name, found.wrong.join("; ")));
            eprintln!("FAILED {}", failed[failed.len() - 1]);
        }
        // After each, so that one that is broken off has what it found.
        if let Some(path) = std::env::var_os("SINEW_CAMPAIGN_TABLE") {
            std::fs::write(path, table(classes, &rows, failed.len(), seed)).unwrap();
        }
    }
    let table = table(classes, &rows, failed.len(), seed);
    println!("{table}");
    failed
}

/// Of each class: trials, failed ones, and how long a stop took to be answered (ms).
type Rows<'a> = BTreeMap<&'a str, (usize, usize, Vec<f64>)>;

fn table(classes: &[&Class], rows: &Rows<'_>, failed: usize, seed: u64) -> String {
    let mut table = String::from(
        "| class | declared | trials | failed | stop answered, worst (ms) | over 100 ms |\n|---|---|---|---|---|---|\n",
    );
    for class in classes {
        let Some((trials, failures, stops)) = rows.get(class.name) else { continue };
        let worst = stops.iter().fold(0.0f64, |a, b| a.max(*b));
        let over = stops.iter().filter(|ms| **ms > 100.0).count();
        let _ = writeln!(
            table,
            "| {} | {:?} | {trials} | {failures} | {worst:.1} | {over} of {} |",
            class.name,
            class.expect,
            stops.len()
        );
    }
    let all: usize = rows.values().map(|row| row.0).sum();
    let _ = writeln!(table, "\n{all} trials of {} classes, {} failed, seed {seed}.", rows.len(), failed);
    table
}

fn number(variable: &str) -> Option<u64> {
    std::env::var(variable).ok()?.parse().ok()
}

#[test]
fn classes_have_names_of_their_own() {
    let names: std::collections::BTreeSet<&str> = CLASSES.iter().map(|class| class.name).collect();
    assert_eq!(names.len(), CLASSES.len());
}

/// A trial of every sixth class; the whole is `tests/campaign/run`.
#[test]
fn the_short_campaign() {
    let some: Vec<&'static Class> = CLASSES.iter().step_by(6).collect();
    let failed = campaign(&some, some.len(), 1);
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// By hand: `SINEW_CAMPAIGN_TRIALS`, `_SEED`, `_CLASS` and `_TABLE` are set by `tests/campaign/run`.
#[test]
#[ignore = "takes an hour: tests/campaign/run"]
fn the_long_campaign() {
    let wanted = std::env::var("SINEW_CAMPAIGN_CLASS").ok();
    let classes: Vec<&'static Class> =
        CLASSES.iter().filter(|c| wanted.as_deref().is_none_or(|name| c.name == name)).collect();
    assert!(!classes.is_empty(), "there is no class {wanted:?}");
    let trials = number("SINEW_CAMPAIGN_TRIALS").unwrap_or(1000) as usize;
    let failed = campaign(&classes, trials, number("SINEW_CAMPAIGN_SEED").unwrap_or(1));
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}
