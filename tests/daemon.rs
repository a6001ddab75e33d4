//! Claims about the daemon as a process: request transitions, bad inputs, faults, kills, lockstep.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "daemon_support/mod.rs"]
mod support;

use sinew::daemon::status::StatusReport;
use sinew::ipc::monotonic_ns;
use sinew::ipc::payload::{Obstacle, Obstacles, RequestKind, SupervisorState, Tip};
use sinew_hal::can::{CanBus, Id};
use sinew_hal::virtual_bus::VirtualBus;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use support::*;

#[test]
fn requests_move_the_arm_through_its_modes_and_an_ordered_stop_leaves_nothing() {
    let place = Place::shipped();
    let plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&[]);
    place.until("a first tick", |s| s.ticks > 0);
    let (code, said) = place.operate(&["track"]);
    assert_eq!(code, Some(1));
    assert!(said.contains("`sinew arm` first"), "{said}");
    place.arm();
    let (code, said) = place.operate(&["track"]);
    assert_eq!(code, Some(1), "no target: {said}");
    let (code, said) = place.operate(&["target", "--pose", "0.05,0,-2.73,0.7071,0,0.7071,0"]);
    assert_eq!(code, Some(0), "{said}");
    let (code, said) = place.operate(&["track"]);
    assert_eq!(code, Some(1));
    assert!(said.contains("perception client"), "no publisher is not an empty set: {said}");

    let injecting = Running(place.sinew(&["obstacles", "inject", "--ball", "0.5,0.5,-1,0.1"]).spawn().unwrap());
    place.until("a source", |s| s.obstacles.iter().any(|o| o.health == "fresh"));
    let accepted = |request: &str| {
        let (code, said) = place.operate(&[request]);
        assert_eq!(code, Some(0), "{request}: {said}\n{:#?}", place.status());
    };
    accepted("track");
    place.until("tracking", |s| s.mode == "tracking");
    let (_, listed) = place.operate(&["obstacles", "list", "--json"]);
    assert!(listed.contains("surface_distance_m"), "{listed}");
    accepted("home");
    place.until("home", |s| s.mode == "holding");
    assert_eq!(place.operate(&["clear"]).0, Some(1), "nothing is latched");

    // Killed, the client is missed: the arm holds, and may not track again.
    accepted("track");
    drop(injecting);
    place.until("the declared action", |s| s.mode == "holding" && s.obstacles.iter().any(|o| o.health == "expired"));
    assert_eq!(place.operate(&["track"]).0, Some(1));

    accepted("stop");
    place.until("disarmed", |s| s.mode == "disarmed" && s.drives.enabled == 0);
    assert_eq!(place.operate(&["disarm"]).0, Some(0), "already so");
    let (status, said) = daemon.terminate();
    assert_eq!(status.code(), Some(0), "{said}");
    assert!(place.status().is_none());
    drop(plant);
    place.assert_clean();
}

#[test]
fn a_speed_is_asked_for_and_shown_and_a_target_out_of_reach_is_refused_with_the_miss() {
    let place = Place::new(|name, text| match name {
        "controller.toml" => format!("{text}\n[governor]\nout_of_reach = \"refuse\"\n"),
        _ => text,
    });
    let _plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&[]);
    place.arm();
    let (code, said) = place.operate(&["speed", "50%"]);
    let expected = "speed: holding, at 50 % of the configured speed until the arm is disarmed";
    assert_eq!((code, said.trim()), (Some(0), expected));
    place.until("half the speed", |s| s.speed_scale == 0.5);
    for bad in ["0", "0.5%", "120%", "-50%", "fast"] {
        let (code, said) = place.operate(&["speed", bad]);
        assert!(code == Some(2) && said.contains(bad) && said.contains("1% to 100%"), "{bad}: {said}");
    }
    let (_, said) = place.operate(&["status"]);
    assert!(said.contains("speed: 50 % of the configured, until the arm is disarmed"), "{said}");

    let _injecting = Running(place.sinew(&["obstacles", "inject"]).spawn().unwrap());
    place.until("a source", |s| s.obstacles.iter().any(|o| o.health == "fresh"));
    let (code, said) = place.operate(&["target", "--pose", "1,0,-5,0.7071,0,0.7071,0"]);
    assert_eq!(code, Some(0), "{said}");
    let (code, said) = place.operate(&["track"]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("out of reach: the arm holds; it misses the target by 2"), "{said}");
    let report = place.until("the reason", |s| s.mode == "holding" && !s.alarms.is_empty());
    let reach = report.reach.clone().unwrap_or_else(|| panic!("{report:#?}"));
    // From (1, 0, -5) to wherever an arm of 2.75 m gets.
    let [x, y, z] = reach.nearest_m;
    let miss = ((x - 1.0).powi(2) + y.powi(2) + (z + 5.0).powi(2)).sqrt();
    assert!(reach.refused && (reach.miss_m - miss).abs() < 1e-9 && miss > 2.2, "{reach:?}");
    assert!(
        report.alarms.iter().any(|a| a.what == "the target is out of reach" && a.does == reach.text()),
        "{report:#?}"
    );

    assert_eq!(place.operate(&["disarm"]).0, Some(0));
    place.until("the speed is forgotten", |s| s.mode == "disarmed" && s.speed_scale == 1.0);
    daemon.kill();
}

#[test]
fn a_measured_tip_is_shown_with_what_the_estimate_lacks_and_one_that_cannot_be_is_told() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&["--arm-on-start"]);
    let before = place.until("holding", |s| s.mode == "holding");
    assert!(before.tip_sensor.is_none() && before.tip.measured_m.is_none(), "{before:#?}");
    let mut sensor = place.client().tips(9).unwrap();
    // 20 mm beside the estimate of an arm that rests, then half a metre, then nothing.
    let (off_mm, [x, y, z]) = (Arc::new(AtomicU64::new(20)), before.tip.position_m);
    let set_mm = off_mm.clone();
    let measuring = std::thread::spawn(move || {
        while let off_mm @ 1.. = off_mm.load(Ordering::Relaxed) {
            let position_m = [x + 1e-3 * off_mm as f64, y, z];
            sensor.publish(&mut Tip { position_m, ..Tip::default() }, monotonic_ns()).unwrap();
            std::thread::sleep(Duration::from_millis(20));
        }
    });
    let report = place.until("a bias", |s| s.tip.bias_m[0] > 0.002);
    assert!(report.tip_sensor.as_ref().is_some_and(|s| s.id == 9 && s.health == "fresh"), "{report:#?}");
    let [bias, y, z] = report.tip.bias_m;
    assert!(bias < 0.0201 && y.abs() < 1e-3 && z.abs() < 1e-3, "{report:#?}");
    assert!((report.tip.measured_m.unwrap()[0] - before.tip.position_m[0] - 0.02).abs() < 1e-12);
    let (_, said) = place.operate(&["status"]);
    assert!(said.contains("measured at (") && said.contains("tip sensor"), "{said}");
    let told = |s: &StatusReport| s.alarms.iter().any(|a| a.what == "the tip sensor and the cables differ by too much");
    set_mm.store(500, Ordering::Relaxed);
    place.until("the alarm", told);
    set_mm.store(0, Ordering::Relaxed);
    measuring.join().unwrap();
    // Silence is no alarm, and the arm holds on.
    let last = place.until("no alarm", |s| !told(s));
    assert!(last.mode == "holding" && last.tip.measured_m.is_none(), "{last:#?}");
    daemon.kill();
}

#[test]
fn a_signal_while_a_lockstep_daemon_waits_for_its_drives_is_an_end_in_order_that_leaves_nothing() {
    let place = Place::shipped();
    let daemon = place.daemon(&["--lockstep"]);
    let (status, said) = daemon.terminate();
    assert_eq!(status.code(), Some(0), "{said}");
    assert!(!said.contains("did not come up"), "{said}");
    place.assert_clean();
}

#[test]
fn a_signal_while_tracking_ramps_down_and_disables_before_the_end() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&["--arm-on-start"]);
    place.until("holding", |s| s.mode == "holding");
    let mut bus = VirtualBus::open(&place.bus, false).unwrap();
    let (status, said) = daemon.terminate();
    assert_eq!(status.code(), Some(0), "{said}");
    // The last statusword of every drive is "switch on disabled".
    let mut last = [0xffff_u16; 24];
    while let Ok(Some(received)) = bus.receive(Duration::ZERO) {
        if let (Id::Standard(id @ 0x181..=0x198), [low, high, ..]) = (received.frame.id(), received.frame.data()) {
            last[usize::from(id - 0x181)] = u16::from_le_bytes([*low, *high]);
        }
    }
    assert!(last.iter().all(|word| word & 0x4f == 0x40), "{last:04x?}");
}

#[test]
fn a_second_daemon_for_the_same_arm_is_refused_and_the_first_goes_on() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&[]);
    place.until("a first tick", |s| s.ticks > 0);
    let (code, said) = place.operate(&["run"]);
    assert_eq!(code, Some(2));
    assert!(said.contains("already running"), "{said}");
    let ticks = place.status().unwrap().ticks;
    place.until("more ticks", |s| s.ticks > ticks);
    assert_eq!(daemon.terminate().0.code(), Some(0));
}

#[test]
fn bad_obstacles_are_rejected_counted_and_named_in_the_status() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let _daemon = place.daemon(&[]);
    let client = place.client();
    let mut publisher = client.obstacles(77).unwrap();
    let ball = Obstacle::ball(1, [0.5, 0.0, -1.0], 0.1);
    let mut good = Obstacles::default();
    assert!(good.push(ball));
    let mut nan = good;
    nan.obstacles[0].position_m[1] = f64::NAN;
    let mut overfull = good;
    overfull.count = 65;
    let rejected = |cause: &'static str| {
        move |s: &sinew::daemon::status::StatusReport| s.obstacles.iter().any(|o| o.rejected.contains_key(cause))
    };
    publisher.publish(&mut good, monotonic_ns()).unwrap();
    place.until("accepted", |s| s.obstacles.iter().any(|o| o.id == 77 && o.accepted == 1));
    publisher.publish(&mut nan, monotonic_ns()).unwrap();
    place.until("NaN", rejected("NaN or infinite number"));
    publisher.publish(&mut good.clone(), monotonic_ns() + 1_000_000_000).unwrap();
    place.until("future", rejected("capture time lies in the future"));
    publisher.publish(&mut overfull, monotonic_ns()).unwrap();
    let report = place.until("overfull", rejected("more entries than the capacity"));
    assert_eq!(report.obstacles[0].rejected.values().sum::<u64>(), 3, "each once: {report:#?}");
    let (_, said) = place.operate(&["status"]);
    assert!(said.contains("1 x more entries than the capacity"), "{said}");
}

#[test]
fn a_daemon_whose_log_nobody_reads_goes_on_and_ends_in_order() {
    use std::io::Write;
    let place = Place::shipped();
    let plant = Plant::start(&place, false, &[]);
    let (log, mut full) = std::io::pipe().unwrap();
    let stderr = full.try_clone().unwrap();
    // Whoever writes behind this waits: it ends when the pipe does.
    let filling = std::thread::spawn(move || while full.write_all(&[b'\n'; 4096]).is_ok() {});
    let mut command = place.sinew(&["run"]);
    let child = command.env("SINEW_LOG", "info").stderr(stderr).spawn().unwrap();
    drop(command);
    let mut daemon = Daemon { child };
    let deadline = Instant::now() + WAIT;
    while place.status().is_none() {
        assert!(daemon.child.try_wait().unwrap().is_none() && Instant::now() < deadline, "it does not start");
        std::thread::sleep(Duration::from_millis(20));
    }
    // Modes and requests are lines of the log, of the I/O thread; drives coming up are the bus thread's.
    place.arm();
    for _ in 0..10 {
        assert!(place.request(RequestKind::Hold).is_accepted());
    }
    let ticks = place.status().unwrap().ticks;
    place.until("more ticks", |s| s.ticks > ticks && s.mode == "holding");
    let pid = rustix::process::Pid::from_child(&daemon.child);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    // It cannot say its last words and does not wait for ever to do so.
    let deadline = Instant::now() + WAIT;
    let status = loop {
        if let Some(status) = daemon.child.try_wait().unwrap() {
            break status;
        }
        assert!(Instant::now() < deadline, "it does not end");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(0));
    drop(log);
    filling.join().unwrap();
    drop(plant);
}

/// What is left of a run; clients go first, the place last.
struct Ran {
    _ticker: Ticker,
    daemon: Option<Daemon>,
    _plant: Plant,
    place: Place,
    code: u32,
}

/// Runs in lockstep into a fault of the plant, following a moving tip; the tensions have come down to the
/// safe value then.
fn run_into(fault: &str) -> Ran {
    let place = Place::shipped();
    let plant = Plant::start(&place, true, &[fault]);
    let daemon = place.daemon(&[
        "--lockstep",
        "--arm-on-start",
        "--track-on-start",
        "--await-obstacles",
        "11",
        "--await-target",
    ]);
    let ticker = TickClient::new(&place).spawn();
    let report = place.until("a fault", |s| s.fault.is_some());
    place.until("drives off", |s| s.drives.enabled == 0);
    // The status and the states come by different threads: the tick that sees the drives off may be one later.
    let (states, deadline) = (place.client().states().unwrap(), Instant::now() + WAIT);
    let state = loop {
        let state = states.wait(WAIT).unwrap().unwrap();
        if state.tension_command_n[..24].iter().all(|t| *t == 0.0) {
            break state;
        }
        assert!(Instant::now() < deadline, "{:?}", &state.tension_command_n[..24]);
    };
    assert_eq!(state.supervisor, SupervisorState::Faulted.wire());
    assert!(!place.request(RequestKind::Arm).is_accepted(), "a latched fault must be cleared first");
    let fault = report.fault.unwrap();
    assert!(!fault.clears.is_empty());

    Ran { _ticker: ticker, daemon: Some(daemon), _plant: plant, place, code: fault.code }
}

#[test]
fn an_encoder_that_jumps_is_a_latched_fault_with_its_cause() {
    assert_eq!(run_into("jump:5:0.03@4").code, 21);
}

#[test]
fn an_encoder_that_falls_silent_is_a_latched_fault_with_its_cause() {
    assert_eq!(run_into("silence:5@4").code, 20);
}

#[test]
fn an_encoder_that_sticks_is_a_latched_fault_with_its_cause() {
    let code = run_into("stick:5@2").code;
    assert!([22, 30, 31].contains(&code), "stuck, or noticed by the innovation: {code}");
}

#[test]
fn a_drive_that_trips_is_a_latched_fault_and_clear_makes_the_arm_work_again() {
    let mut ran = run_into("trip:3@4");
    assert_eq!(ran.code, 10);
    let place = &ran.place;
    let deadline = Instant::now() + WAIT;
    while !place.request(RequestKind::Clear).is_accepted() {
        assert!(Instant::now() < deadline, "{:#?}", place.status());
        std::thread::sleep(Duration::from_millis(50));
    }
    place.arm();
    assert_eq!(ran.daemon.take().unwrap().terminate().0.code(), Some(0));
}

#[test]
fn a_killed_daemon_leaves_drives_that_go_safe_and_a_new_one_works() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&["--arm-on-start"]);
    place.until("holding", |s| s.mode == "holding");
    let mut bus = VirtualBus::open(&place.bus, false).unwrap();
    daemon.kill();
    // Every drive says that its master, or the SYNC, is gone.
    let (mut spoke, deadline) = (BTreeSet::new(), Instant::now() + WAIT);
    while spoke.len() < 24 {
        assert!(Instant::now() < deadline, "only {spoke:?} went safe");
        if let Ok(Some(received)) = bus.receive(Duration::from_millis(50))
            && let Id::Standard(id @ 0x81..=0x98) = received.frame.id()
            && received.frame.data()[..2] != [0, 0]
        {
            spoke.insert(id);
        }
    }
    let second = place.daemon(&[]);
    place.arm();
    assert_eq!(second.terminate().0.code(), Some(0));
}

#[test]
fn a_plant_that_is_gone_is_a_lost_bus_and_clear_works_when_it_is_back() {
    let place = Place::shipped();
    let plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&["--arm-on-start"]);
    place.until("holding", |s| s.mode == "holding");
    drop(plant);
    let report = place.until("a fault", |s| s.fault.is_some());
    let code = report.fault.unwrap().code;
    assert!([10, 11, 13, 20].contains(&code), "drives, bus or encoders: {code}");
    place.until("drives given up", |s| s.drives.fault.is_some());
    std::thread::sleep(Duration::from_millis(700));
    assert!(!place.request(RequestKind::Clear).is_accepted(), "the cause persists");
    let _plant = Plant::start(&place, false, &[]);
    let deadline = Instant::now() + WAIT;
    while !place.request(RequestKind::Clear).is_accepted() {
        assert!(Instant::now() < deadline, "{:#?}", place.status());
        std::thread::sleep(Duration::from_millis(50));
    }
    place.arm();
    assert_eq!(daemon.terminate().0.code(), Some(0));
}

#[test]
fn a_run_in_lockstep_gives_the_same_tensions_bit_for_bit() {
    let run = || lockstep_run(&Place::shipped(), "3", 400);
    let (first, second) = (run(), run());
    let differing = first.iter().zip(&second).position(|(a, b)| a != b);
    assert_eq!(differing, None, "first tick that differs");
    assert!(first.last().unwrap().iter().any(|t| *t != 0), "tensions were sent at all");
}

#[test]
fn a_bus_above_its_load_limit_is_refused_before_anything_is_opened() {
    let place = Place::new(|_, text| text.replace("period_s = 0.01\n", "period_s = 0.005\n"));
    for command in ["check", "run"] {
        let (code, said) = place.operate(&[command]);
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains("load_limit") && said.contains("period_s"), "{said}");
    }
    assert!(!sinew_hal::virtual_bus::path_of(&place.bus).unwrap().exists());
}

#[test]
fn commands_without_a_daemon_say_so() {
    let place = Place::shipped();
    for arguments in [&["status"][..], &["arm"], &["obstacles", "list"]] {
        let (code, said) = place.operate(arguments);
        assert_eq!(code, Some(1));
        assert!(said.contains("no daemon running"), "{said}");
    }
    let (code, said) = place.operate(&["target", "--pose", "1,2,3"]);
    assert_eq!(code, Some(2));
    assert!(said.contains("expected 7"), "{said}");
}

#[test]
fn a_rust_and_a_python_client_feed_a_running_daemon_at_the_same_time() {
    use std::process::{Command, Stdio};
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let environment = std::env::current_exe().unwrap().ancestors().nth(3).unwrap().join("python-env");
    let made = Command::new("bash").arg(root.join("tests/support/python_env.sh")).arg(environment).output().unwrap();
    assert!(made.status.success(), "no Python environment: {}", String::from_utf8_lossy(&made.stderr));
    let python = String::from_utf8(made.stdout).unwrap();

    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let _daemon = place.daemon(&[]);
    let script = root.join("examples/obstacle_client.py");
    let mut command = Command::new(python.trim());
    command.arg(script).args(["--arm", "paper", "--source", "2", "--rate", "100"]).envs(place.domain.env());
    let _python = Running(command.stdout(Stdio::null()).spawn().unwrap());
    let arguments = ["obstacles", "inject", "--ball", "0.5,0.1,-1.0,0.1", "--for", "60"];
    let _rust = Running(place.sinew(&arguments).stdout(Stdio::null()).spawn().unwrap());

    let both = |least: u64| {
        move |s: &sinew::daemon::status::StatusReport| {
            s.obstacles.iter().filter(|o| o.accepted >= least && o.rejected.is_empty()).count() == 2
        }
    };
    let first = place.until("both clients heard", both(1));
    assert!(first.obstacles.iter().any(|o| o.id == 2), "{first:#?}");
    place.until("both go on", both(50));
}

#[test]
fn another_node_with_sinews_own_id_is_told_and_nothing_is_armed() {
    let place = Place::new(|file, text| match file {
        "drives.toml" => text.replace("[drives]\n", "[drives]\nmaster_node_id = 99\n"),
        _ => text,
    });
    let _plant = Plant::start(&place, false, &[]);
    let _daemon = place.daemon(&[]);
    place.until("drives ready", |s| s.drives.ready == s.drives.count && s.drives.count > 0);
    // The daemon's own heartbeats are none of another's, however many.
    place.until("some heartbeats", |s| s.ticks > 100);
    assert_eq!(place.status().unwrap().drives.fault, None);
    let mut bus = VirtualBus::open(&place.bus, false).unwrap();
    let beat = sinew_hal::can::Frame::classic(Id::Standard(0x700 + 99), &[5]).unwrap();
    (0..10).for_each(|_| bus.send(&beat).unwrap());
    let report = place.until("the conflict", |s| s.drives.fault.is_some());
    assert!(report.drives.fault.unwrap().contains("sinew's own node id"));
    let (code, said) = place.operate(&["arm"]);
    assert!(code == Some(1) && said.contains("not ready"), "{said}");
}

#[test]
fn drives_of_another_vendor_than_configured_are_not_used() {
    let place = Place::new(|file, text| match file {
        "drives.toml" => text
            .replace("vendor_id = 0", "vendor_id = 154")
            .replace("[drives]\n", "[drives]\naccept_without = [\"sync_guard\"]\n"),
        _ => text,
    });
    let _plant = Plant::start(&place, false, &[]);
    let _daemon = place.daemon(&[]);
    let report = place.until("refused", |s| s.drives.fault.is_some());
    assert!(report.drives.fault.unwrap().contains("configuration failed") && report.drives.ready == 0);
}

/// Bits of the tensions of a run in lockstep whose client does something in between.
fn tensions_of(place: &Place, ticks: u64, mut meanwhile: impl FnMut(u64)) -> Vec<Vec<u64>> {
    let _plant = Plant::start(place, true, &[]);
    let ticks_text = ticks.to_string();
    let arguments =
        ["--lockstep", "--arm-on-start", "--await-obstacles", "11", "--await-target", "--ticks", &ticks_text];
    let mut daemon = place.daemon(&arguments);
    let mut client = TickClient::new(place);
    let mut tensions = Vec::new();
    client.run(
        |state| state.header.tick + 1 == ticks,
        |state| {
            assert_eq!(state.header.tick, tensions.len() as u64, "no tick is left out");
            tensions.push(state.tension_command_n[..24].iter().map(|t| t.to_bits()).collect());
            meanwhile(state.header.tick);
        },
    );
    drop(client);
    let (status, said) = daemon.finish();
    assert_eq!(status.code(), Some(0), "{said}");
    tensions
}

#[test]
fn in_lockstep_a_client_without_a_processor_changes_nothing_however_long_it_takes() {
    let place = Place::shipped();
    let undisturbed = tensions_of(&place, 120, |_| {});
    // Longer than anything in real time is waited for.
    let starved = tensions_of(&place, 120, |tick| {
        if tick == 60 {
            std::thread::sleep(Duration::from_secs(7));
        }
    });
    assert_eq!(undisturbed, starved);
}

#[test]
fn in_lockstep_a_client_that_is_gone_is_not_waited_for_and_one_that_comes_back_is() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, true, &[]);
    let _daemon = place.daemon(&["--lockstep", "--await-obstacles", "11", "--await-target"]);
    let mut client = TickClient::new(&place);
    client.run(|state| state.header.tick >= 20, |_| {});
    drop(client);
    let alone = place.until("goes on alone", |s| s.ticks > 60).ticks;
    // Back, and slower than the loop: once it is heard no tick is missed.
    let mut client = TickClient::new(&place);
    let (mut last, mut in_a_row) = (alone, 0);
    let deadline = Instant::now() + WAIT;
    let waited_for = std::cell::Cell::new(false);
    client.run(
        |_| waited_for.get(),
        |state| {
            in_a_row = if state.header.tick == last + 1 { in_a_row + 1 } else { 0 };
            last = state.header.tick;
            waited_for.set(in_a_row == 50);
            assert!(Instant::now() < deadline, "the loop does not wait for it: tick {last}");
            std::thread::sleep(Duration::from_millis(3));
        },
    );
}
