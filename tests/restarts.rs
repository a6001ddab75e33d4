//! Claims about processes that are killed (SIGKILL) while the arm is held or tracks: what the others do, and that a new
//! one works. All of them are real processes; `sim_plant` must be built: `cargo build --workspace`, as `tests/run` does.
//!
//! The bad inputs that the project promises to survive, and where each is claimed:
//!
//! | input | outcome | claimed by |
//! |---|---|---|
//! | configuration: unknown key | refused, with a suggestion | `config::an_unknown_key_is_refused_with_a_suggestion` |
//! | configuration: negative stiffness | refused, with the range | `config::a_negative_stiffness_is_refused` |
//! | configuration: segment count 0 | refused, with the range | `config::a_segment_count_of_zero_is_refused` |
//! | configuration: two cables on one node id | refused, naming both | `config::two_cables_on_one_node_id_are_refused` |
//! | obstacle with NaN; of the future; overfull set | rejected, counted, named in the status | `daemon::bad_obstacles_are_rejected_counted_and_named_in_the_status`, one by one in `ipc::intake` |
//! | target with NaN; bad weight | refused, with its cause | `ipc::intake::target` |
//! | encoder sticks, jumps, goes silent | latched fault, tensions to the safe value | `daemon::an_encoder_that_...`, `control_cycle::a_..._encoder_...` |
//! | SIGKILL of the daemon | drives go safe by themselves; a new one works | `daemon::a_killed_daemon_leaves_drives_that_go_safe_and_a_new_one_works` |
//! | SIGKILL of the plant | lost bus, latched; `clear` works when it is back | here |
//! | SIGKILL of the obstacle client | declared action; a new one with the same source id is believed at once | here, `demo` |
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test may panic
mod daemon_support;

use daemon_support::{Place, WAIT};
use sinew::ipc::payload::{Header, RequestKind, Target};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A process that is killed, at the latest at the end of the test.
struct Victim(Child);

impl Victim {
    fn plant(place: &Place) -> Self {
        let folder = Path::new(env!("CARGO_BIN_EXE_sinew")).parent().unwrap();
        let mut command = Command::new(folder.join("sim_plant"));
        command.arg("--config").args(&place.files).stdout(Stdio::piped());
        let mut child = command.spawn().expect("sim_plant must be built beside sinew");
        // It says so when its drives are on the bus.
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert!(line.contains("24 drives"), "{line}");
        Self(child)
    }

    fn obstacle_client(place: &Place) -> Self {
        let ipc = &place.config().ipc;
        let mut command = Command::new(env!("CARGO_BIN_EXE_sinew"));
        command.args(["client", "obstacles", "--scenario", "tip", "--source", "1"]);
        command
            .env("SINEW_IPC_PREFIX", &ipc.prefix)
            .env("SINEW_IPC_ROOT", ipc.root_path.as_ref().expect("a place of its own"));
        Self(command.spawn().unwrap())
    }

    fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Victim {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn clear(place: &Place) {
    let deadline = Instant::now() + WAIT;
    while !place.request(RequestKind::Clear).is_accepted() {
        assert!(Instant::now() < deadline, "{:#?}", place.status());
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_killed_plant_is_a_lost_bus_and_the_arm_works_again_with_a_new_one() {
    let place = Place::shipped();
    let plant = Victim::plant(&place);
    let daemon = place.daemon(&["--arm-on-start"]);
    place.until("holding", |s| s.mode == "holding");
    plant.kill();
    let report = place.until("a fault", |s| s.fault.is_some());
    let code = report.fault.unwrap().code;
    assert!([10, 11, 13, 20].contains(&code), "drives, bus or encoders: {code}");
    place.until("drives given up", |s| s.drives.fault.is_some());
    let plant = Victim::plant(&place);
    clear(&place);
    place.arm();
    assert_eq!(daemon.terminate().0.code(), Some(0));
    plant.kill();
}

#[test]
fn a_second_daemon_and_a_second_plant_on_one_bus_are_refused_and_harm_nothing() {
    let place = Place::shipped();
    let plant = Victim::plant(&place);
    let daemon = place.daemon(&["--arm-on-start"]);
    place.until("holding", |s| s.mode == "holding");
    // Another arm's daemon, as far as shared memory goes: only the bus is the same.
    let others: Vec<_> = place.files.iter().filter(|file| !file.ends_with("arm.toml")).collect();
    let arm = place.folder.path().join("another.toml");
    let text = std::fs::read_to_string(place.folder.path().join("arm.toml")).unwrap();
    std::fs::write(&arm, text.replace("\"paper\"", "\"another\"")).unwrap();
    let second = Command::new(env!("CARGO_BIN_EXE_sinew"))
        .args(["run", "--ticks", "1", "--config"])
        .args(&others)
        .arg(&arm)
        .output()
        .unwrap();
    assert_eq!(second.status.code(), Some(2));
    let said = String::from_utf8_lossy(&second.stderr);
    assert!(said.contains(&place.bus) && said.contains("commands its drives is already running"), "{said}");
    let folder = Path::new(env!("CARGO_BIN_EXE_sinew")).parent().unwrap();
    let second = Command::new(folder.join("sim_plant")).arg("--config").args(&place.files).output().unwrap();
    assert_eq!(second.status.code(), Some(2));
    let said = String::from_utf8_lossy(&second.stderr).replace('\n', " ");
    assert!(said.contains("stands for its drives"), "{said}");
    // Before, both reset or answered for the drives of the first.
    assert_eq!(place.status().unwrap().mode, "holding");
    assert_eq!(daemon.terminate().0.code(), Some(0));
    plant.kill();
}

#[test]
fn a_killed_obstacle_client_leads_to_a_hold_and_a_new_one_lets_the_arm_track_again() {
    let place = Place::shipped();
    let plant = Victim::plant(&place);
    let daemon = place.daemon(&[]);
    let client = Victim::obstacle_client(&place);
    place.until("obstacles", |s| s.obstacles.iter().any(|o| o.health == "fresh"));
    place.arm();
    let mut task = place.client();
    // The straight arm's own tip: a set-point that asks for no motion.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let target = Target {
        header: Header::default(),
        position_m: [0.0, 0.0, -2.75],
        quaternion: [half, 0.0, half, 0.0],
        ..Target::default()
    };
    assert!(task.set_target(9, target, WAIT).unwrap().is_accepted());
    assert!(place.request(RequestKind::Track).is_accepted());
    place.until("tracking", |s| s.mode == "tracking");
    // A set-point is held as long as it stands; nothing about it grows old.
    place.until("a held target", |s| s.target.health == "held" && s.mode == "tracking");

    client.kill();
    let report = place.until("the declared action", |s| s.mode == "holding");
    assert!(report.fault.is_none(), "{report:#?}");
    assert!(report.obstacles.iter().any(|o| o.health == "expired"), "{:#?}", report.obstacles);
    let refused = place.request(RequestKind::Track);
    assert!(!refused.is_accepted() && refused.text().contains("obstacle"), "{}", refused.text());

    let client = Victim::obstacle_client(&place);
    let report = place.until("obstacles again", |s| s.obstacles.iter().any(|o| o.health == "fresh"));
    // The new process begins its sequence anew; the source is the same, and nothing of it was refused.
    assert_eq!(report.obstacles.len(), 1);
    assert!(report.obstacles[0].rejected.is_empty(), "{:#?}", report.obstacles);
    assert!(place.request(RequestKind::Track).is_accepted());
    place.until("tracking again", |s| s.mode == "tracking");
    client.kill();
    assert_eq!(daemon.terminate().0.code(), Some(0));
    plant.kill();
}
