//! Claims about the plant as a process: `sim_plant` on a virtual bus, and the master's half of the protocol against it.
// The lint's exception for tests does not reach the helpers of an integration test.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use sinew::config::{BUILTIN_FILES, ScenarioConfig};
use sinew::model::Arm;
use sinew::scenario::Course;
use sinew_hal::can::{CanBus, Frame};
use sinew_hal::canopen::{Emergency, Message, NodeId};
use sinew_hal::cia402::{CycleWriter, Decoder, DriveSetup, Goal, Master, MasterConfig, ObjectWrite};
use sinew_hal::clock::monotonic_ns;
use sinew_hal::virtual_bus::{VirtualBus, path_of, remove_stale};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

const CABLES: usize = 24;
const PERIOD_NS: u64 = 10_000_000;
/// Tension per step of the torque on the wire (N), from `drives.toml`.
const QUANTUM_N: f64 = 0.35 * 10.0 / (1000.0 * 0.015);
/// Cable length per count (m), from `drives.toml`.
const COUNT_M: f64 = std::f64::consts::TAU * 0.015 / (10.0 * 4096.0);

fn signal(child: &Child, number: rustix::process::Signal) {
    let pid = rustix::process::Pid::from_child(child);
    rustix::process::kill_process(pid, number).unwrap();
}

struct Plant {
    child: Child,
    bus: String,
    folder: tempfile::TempDir,
}

impl Plant {
    fn start(arguments: &[&str]) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let bus = format!("pt{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = BUILTIN_FILES
            .iter()
            .filter(|(name, _)| ["arm.toml", "controller.toml", "drives.toml", "plant.toml"].contains(name))
            .map(|(name, text)| {
                let path = folder.path().join(name);
                std::fs::write(&path, text.replace("\"sinew0\"", &format!("\"{bus}\""))).unwrap();
                path
            })
            .collect();
        let mut child = Command::new(env!("CARGO_BIN_EXE_sim_plant"))
            .arg("--config")
            .args(&files)
            .args(arguments)
            .current_dir(folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert!(line.contains("24 drives"), "{line}");
        Self { child, bus, folder }
    }

    fn stop(mut self, controller: Controller) -> tempfile::TempDir {
        drop(controller);
        signal(&self.child, rustix::process::Signal::TERM);
        assert!(self.child.wait().unwrap().success());
        assert!(!path_of(&self.bus).unwrap().exists(), "the bus's file is still there");
        std::mem::replace(&mut self.folder, tempfile::tempdir().unwrap())
    }
}

impl Drop for Plant {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = remove_stale(&self.bus);
    }
}

/// A controller without control: it commands what it is told.
struct Controller {
    master: Master,
    writer: Option<CycleWriter>,
    decoder: Decoder,
    bus: VirtualBus,
    now_ns: u64,
    emergencies: Vec<(u8, u16)>,
    lockstep: bool,
    /// Lockstep: periods that SYNC began and that TIME has not ended.
    open_periods: u64,
}

impl Controller {
    fn new(bus: &str) -> Self {
        Self::with_guard(bus, true, 100)
    }

    /// With drives that bear silence for so long (ms).
    fn with_guard(bus: &str, lockstep: bool, guard_ms: u16) -> Self {
        let drives = (1..=CABLES as u8)
            .map(|n| {
                let mut drive = DriveSetup::new(0, NodeId::new(n).unwrap());
                drive.rated_torque_mnm = Some(350);
                drive.writes = ObjectWrite::sinew_guard(1000 * u32::from(guard_ms), 0, false).to_vec();
                drive
            })
            .collect();
        let mut config = MasterConfig::new(drives, NodeId::new(127).unwrap(), 10_000);
        config.heartbeat_timeout_ms = config.heartbeat_timeout_ms.max(guard_ms);
        config.drive_heartbeat_timeout_ms = config.heartbeat_timeout_ms;
        let handle = VirtualBus::open(bus, false).unwrap();
        let mut master = Master::new(config, vec![Box::new(handle)]).unwrap();
        let now_ns = monotonic_ns();
        master.start(now_ns);
        let decoder = master.decoder();
        let bus = VirtualBus::open(bus, false).unwrap();
        Self { master, writer: None, decoder, bus, now_ns, emergencies: Vec::new(), lockstep, open_periods: 0 }
    }

    fn listen(&mut self, wait: Duration) -> bool {
        let Ok(Some(received)) = self.bus.receive(wait) else { return false };
        self.note(&received.frame);
        self.decoder.on_frame(0, &received);
        true
    }

    fn note(&mut self, frame: &Frame) {
        match Message::of(frame) {
            Some(Message::Sync) => self.open_periods += 1,
            Some(Message::Time) => self.open_periods -= 1,
            _ => {}
        }
        if let Some(Message::Emergency(node)) = Message::of(frame)
            && let Some(emergency) = Emergency::decode(frame.data())
        {
            self.emergencies.push((node.get(), emergency.code));
        }
    }

    fn until(&mut self, goal: Goal) {
        self.master.set_goal(goal, self.now_ns);
        let deadline = Instant::now() + Duration::from_secs(20);
        loop {
            self.now_ns = monotonic_ns().max(self.now_ns);
            let progress = self.master.pump(self.now_ns);
            while self.listen(Duration::ZERO) {}
            if progress.at_goal {
                return;
            }
            assert!(Instant::now() < deadline, "{progress:?} {:?}", self.master.take_faults());
            std::thread::sleep(Duration::from_micros(500));
        }
    }

    fn enable(&mut self) {
        self.until(Goal::Disabled);
        self.until(Goal::Enabled);
        self.writer = self.master.take_writer();
    }

    /// One cycle; returns the counts of those that answered it.
    fn cycle(&mut self, torques: &[i16]) -> Vec<Option<i32>> {
        self.now_ns += PERIOD_NS;
        let writer = self.writer.as_mut().unwrap();
        let cycle = writer.write_cycle(torques).cycle;
        let answered = |decoder: &Decoder| decoder.feedback().iter().filter(|f| f.cycle == cycle).count();
        let deadline = Instant::now() + Duration::from_secs(20);
        // In lockstep the plant says when nobody else will answer.
        while if self.lockstep {
            self.decoder.cycle() < cycle || self.open_periods > 0
        } else {
            answered(&self.decoder) < CABLES
        } {
            assert!(Instant::now() < deadline, "{} of {CABLES} answered", answered(&self.decoder));
            self.listen(Duration::from_millis(1));
        }
        self.master.pump(self.now_ns);
        let counts = |f: &sinew_hal::cia402::Feedback| (f.cycle == cycle).then_some(f.position_counts);
        self.decoder.feedback().iter().map(counts).collect()
    }
}

/// Torques that change from cycle to cycle.
fn script(cycle: usize) -> Vec<i16> {
    (0..CABLES).map(|c| 20 + ((7 * cycle + 13 * c) % 40) as i16).collect()
}

fn lengths_m(counts: &[Option<i32>]) -> Vec<f64> {
    counts.iter().map(|c| f64::from(c.unwrap()) * COUNT_M).collect()
}

fn tip_start() -> (Vec<i16>, Vec<f64>) {
    let scenario = ScenarioConfig::find("tip").unwrap();
    let (state, tensions) = Course::new(&scenario).start(&scenario.arm).unwrap();
    let arm = Arm::new(&scenario.arm);
    let (mut bent, mut straight) = (vec![0.0; CABLES], vec![0.0; CABLES]);
    arm.cable_lengths_into(&state.q, &mut bent);
    arm.cable_lengths_into(&arm.straight(), &mut straight);
    let pulled = straight.iter().zip(&bent).map(|(s, b)| s - b).collect();
    (tensions.iter().map(|u| (u / QUANTUM_N).round() as i16).collect(), pulled)
}

#[test]
fn the_arm_rests_in_the_scenarios_start_until_a_controller_takes_it_over_without_a_jump() {
    let plant = Plant::start(&["--lockstep", "--start-scenario", "tip"]);
    let mut controller = Controller::new(&plant.bus);
    controller.enable();
    let (torques, pulled) = tip_start();
    // Disabled and enabled, but without torque: the brakes hold, and the drives report what they hold.
    let braked = controller.cycle(&[0; CABLES]);
    for (c, feedback) in controller.decoder.feedback().iter().enumerate() {
        assert!((feedback.torque_permille - torques[c]).abs() <= 1, "cable {c}: {}", feedback.torque_permille);
    }
    // The plant is not the controller's model: the same tensions bend it a little more.
    for (c, (found, wanted)) in lengths_m(&braked).iter().zip(&pulled).enumerate() {
        assert!((found - wanted).abs() < 0.1 * wanted.abs() + 3e-3, "cable {c}: {found} m, {wanted} m");
    }
    let mut last = braked.clone();
    for _ in 0..200 {
        last = controller.cycle(&torques);
    }
    for (c, (now, then)) in lengths_m(&last).iter().zip(lengths_m(&braked)).enumerate() {
        assert!((now - then).abs() < 1.5e-3, "cable {c} moved by {} m", now - then);
    }
    // And it is the torque that holds it: without, it falls straight.
    for _ in 0..1000 {
        last = controller.cycle(&[0; CABLES]);
    }
    let farthest = lengths_m(&last).iter().fold(0.0f64, |a, l| a.max(l.abs()));
    let bent = pulled.iter().fold(0.0f64, |a, l| a.max(l.abs()));
    assert!(farthest < 0.1 * bent, "{farthest} m from straight, {bent} m at the start");
    plant.stop(controller);
}

#[test]
fn a_seed_gives_the_same_encoders_bit_for_bit_and_another_seed_others() {
    let run = |seed: &str| {
        let plant = Plant::start(&["--lockstep", "--seed", seed]);
        let mut controller = Controller::new(&plant.bus);
        controller.enable();
        (0..100).map(|k| controller.cycle(&script(k))).collect::<Vec<_>>()
    };
    let first = run("3");
    assert!(first.iter().flatten().all(Option::is_some));
    assert_ne!(first[0], first[99]);
    assert_eq!(first, run("3"));
    assert_ne!(first, run("4"));
}

#[test]
fn answers_to_a_sync_carry_the_state_after_its_step() {
    let plant = Plant::start(&["--lockstep"]);
    let mut controller = Controller::new(&plant.bus);
    controller.enable();
    let before = controller.cycle(&[0; CABLES]);
    assert_eq!(before, vec![Some(0); CABLES]);
    // One cable at 100 N for one period: seen in the answer to the same SYNC.
    let mut torques = [0; CABLES];
    torques[0] = 429;
    let after = controller.cycle(&torques);
    assert!(after[0].unwrap() > 0, "{after:?}");
    plant.stop(controller);
}

#[test]
fn broken_encoders_and_drives_show_on_the_bus_as_they_would() {
    let plant = Plant::start(&[
        "--lockstep",
        "--fault",
        "stick:2@1",
        "--fault",
        "jump:3:0.05@1",
        "--fault",
        "silence:4@1",
        "--fault",
        "trip:5@1",
    ]);
    let mut controller = Controller::new(&plant.bus);
    controller.enable();
    let mut history = Vec::new();
    for k in 0..150 {
        history.push(controller.cycle(&script(k)));
    }
    let broken = history.iter().position(|h| h[3].is_none()).expect("cable 4 falls silent");
    assert!((95..=105).contains(&broken), "{broken}");
    assert!(history[broken..].iter().all(|h| h[3].is_none()), "and stays so");
    let moved = |cable: usize, range: std::ops::Range<usize>| {
        range.map(|k| (history[k + 1][cable].unwrap() - history[k][cable].unwrap()).abs()).max().unwrap()
    };
    assert!(moved(1, 0..broken - 1) > 0, "cable 2 moves");
    assert_eq!(moved(1, broken + 1..148), 0, "cable 2 sticks");
    assert!(f64::from(moved(2, broken - 3..broken + 3)) * COUNT_M > 0.045, "cable 3 jumps");
    assert!(f64::from(moved(0, 0..148)) * COUNT_M < 0.02, "cable 1 is whole");
    assert_eq!(controller.emergencies, [(5, 0x2310)]);
    plant.stop(controller);
}

#[test]
fn a_controller_that_dies_is_noticed_in_real_time_even_in_lockstep() {
    let plant = Plant::start(&["--lockstep"]);
    let mut controller = Controller::new(&plant.bus);
    controller.enable();
    for k in 0..20 {
        controller.cycle(&script(k));
    }
    assert_eq!(controller.emergencies, []);
    // No SYNC any more: the guards of all drives trip, and the safe torque of 0 lets the arm fall straight.
    let deadline = Instant::now() + Duration::from_secs(40);
    while controller.emergencies.len() < CABLES && Instant::now() < deadline {
        controller.listen(Duration::from_millis(20));
    }
    let mut nodes: Vec<u8> = controller.emergencies.iter().map(|e| e.0).collect();
    nodes.sort_unstable();
    nodes.dedup();
    assert_eq!(nodes.len(), CABLES, "{:?}", controller.emergencies);
    plant.stop(controller);
}

#[test]
fn real_time_passes_without_a_sync_and_the_encoders_follow() {
    let plant = Plant::start(&[]);
    // What a busy machine keeps from this test is not lost to its drives.
    let mut controller = Controller::with_guard(&plant.bus, false, 10_000);
    controller.enable();
    let mut torques = [0; CABLES];
    torques[0] = 200;
    let first = controller.cycle(&torques)[0].unwrap();
    // A single cable bends the whole segment within a second or so, whatever the number of SYNCs: a handful here.
    let deadline = Instant::now() + Duration::from_secs(20);
    while f64::from(controller.cycle(&torques)[0].unwrap() - first) * COUNT_M < 5e-3 {
        assert!(Instant::now() < deadline, "the arm does not move");
        std::thread::sleep(Duration::from_millis(100));
    }
    plant.stop(controller);
}

#[test]
fn the_trace_holds_every_tick_of_the_truth() {
    let plant = Plant::start(&["--lockstep", "--trace", "truth.mcap"]);
    let mut controller = Controller::new(&plant.bus);
    controller.enable();
    for k in 0..50 {
        controller.cycle(&script(k));
    }
    let folder = plant.stop(controller);
    let messages = sinew::recording::read(&folder.path().join("truth.mcap")).unwrap();
    let ticks: Vec<u64> = messages.iter().map(|m| m.value["header"]["tick"].as_u64().unwrap()).collect();
    assert!(ticks.len() > 50 && ticks.windows(2).all(|t| t[1] == t[0] + 1), "{ticks:?}");
    let last = &messages.last().unwrap().value;
    assert_eq!(last["nodes"].as_array().unwrap().len(), 40);
    let told = last["tension_command_n"].as_array().unwrap();
    for (c, torque) in script(49).into_iter().enumerate() {
        assert!((told[c].as_f64().unwrap() - f64::from(torque) * QUANTUM_N).abs() < 1e-9);
    }
}

#[test]
fn what_cannot_be_run_is_refused_with_code_2() {
    let refused = |arguments: &[&str], part: &str| {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in BUILTIN_FILES.iter().filter(|(name, _)| !name.starts_with("drives-")) {
            std::fs::write(folder.path().join(name), text.replace("\"sinew0\"", "\"pt-none\"")).unwrap();
        }
        let output = Command::new(env!("CARGO_BIN_EXE_sim_plant"))
            .args(["--config", "arm.toml", "controller.toml", "drives.toml", "plant.toml"])
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(text.contains(part), "{part} is not in {text}");
    };
    refused(&["--fault", "melt:1"], "stick:2,1@12.5");
    refused(&["--fault", "stick:25"], "the arm has no cable 25: it has 24");
    refused(&["--start-tensions", "1,2"], "2 start tensions for 24 cables");
    refused(&["--start-scenario", "nowhere"], "built-in scenarios");
    refused(&["--trace", "/dev/full"], "No space left");
}
