//! Faults on the wire, and what the whole does about them: daemon, bus, drives and arm, in lockstep, with the shipped
//! time limits. Each test is a row of `hal/FAULTS.md`, and each number of periods stands there too.
//!
//! The arm holds its pose; from three seconds after its drives were enabled on, frames go wrong. Period 0 is the first
//! one whose frames are hit, in either direction; "after n periods" means that the fault is latched in tick n, counted
//! from there.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "daemon_support/mod.rs"]
mod support;

use sim_plant::server::Served;
use sinew::ipc::payload::{RefusalReason, RequestKind, SupervisorState};
use sinew_hal::can::BusState;
use sinew_hal::virtual_bus::VirtualBus;
use std::time::{Duration, Instant};
use support::*;

/// Period 0 of the faults (s since the first drive was enabled).
const FROM_S: f64 = 3.0;
const PERIOD_S: f64 = 0.01;

/// The shipped limits: time is simulated, so a busy machine cannot exceed them.
fn place() -> Place {
    Place::new(|_, text| {
        text.replace("encoder_silent_s = 2.0", "encoder_silent_s = 0.05")
            .replace("heartbeat_timeout_s = 3.0", "heartbeat_timeout_s = 0.15")
            .replace("sync_timeout_s = 3.0", "sync_timeout_s = 0.1")
    })
}

/// The same on two packed CAN FD buses: one frame carries the torques of a bus's twelve drives.
fn packed_place() -> Place {
    let place = place();
    let file = place.files.iter().find(|f| f.ends_with("drives.toml")).unwrap();
    let text = std::fs::read_to_string(file).unwrap();
    let (head, rest) = text.split_once("[[drives.buses]]").unwrap();
    let (_, defaults) = rest.split_once("[drives.defaults]").unwrap();
    let bus = |i| {
        format!(
            "[[drives.buses]]\nname = \"bus{i}\"\nkind = \"virtual\"\ninterface = \"{}{i}\"\nfd = true\n\
             layout = \"packed\"\n\n",
            place.bus
        )
    };
    std::fs::write(file, format!("{head}{}{}[drives.defaults]{defaults}", bus(0), bus(1))).unwrap();
    place
}

/// One tick of the daemon's recording.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tick {
    tick: u64,
    mode: u32,
    fault: u32,
    cable: u32,
    most_n: f64,
}

/// A run and its period 0.
#[derive(Debug)]
struct Run {
    ticks: Vec<Tick>,
    served: Served,
    zero: u64,
}

impl Run {
    /// Period in which the first fault was latched, its code and its cable (from 1) or bus.
    fn stopped(&self) -> Option<(i64, u32, u32)> {
        self.ticks.iter().find(|t| t.fault != 0).map(|t| (t.tick as i64 - self.zero as i64, t.fault, t.cable))
    }
}

fn record(place: &Place, served: Served) -> Run {
    let mut ticks = Vec::new();
    sinew::recording::read_each(&place.folder.path().join("run.mcap"), |message| {
        if message.topic.ends_with("/state") {
            let v = &message.value;
            let tensions = v["tension_command_n"].as_array().unwrap();
            ticks.push(Tick {
                tick: v["header"]["tick"].as_u64().unwrap(),
                mode: v["supervisor"].as_u64().unwrap() as u32,
                fault: v["fault_code"].as_u64().unwrap() as u32,
                cable: v["fault_detail"].as_u64().unwrap() as u32 + 1,
                most_n: tensions.iter().map(|t| t.as_f64().unwrap()).fold(0.0, f64::max),
            });
        }
    })
    .unwrap();
    assert!(ticks.windows(2).all(|pair| pair[1].tick == pair[0].tick + 1), "no tick is left out of the recording");
    // The last tick's SYNC is the last one that the plant served, `periods_enabled` after the first drive was enabled.
    let zero = ticks.last().unwrap().tick + 1 + (FROM_S / PERIOD_S).round() as u64 - served.periods_enabled;
    Run { ticks, served, zero }
}

fn daemon(place: &Place, ticks: Option<u64>) -> Daemon {
    let file = place.folder.path().join("run.mcap").display().to_string();
    let ticks = ticks.map(|n| n.to_string());
    let mut arguments = vec!["--lockstep", "--arm-on-start", "--record", &file];
    arguments.extend(ticks.iter().flat_map(|n| ["--ticks", n.as_str()]));
    place.daemon(&arguments)
}

/// The arm goes on as if nothing had happened; something has.
fn tolerates(wire: &[&str]) -> Run {
    tolerates_on(&place(), wire)
}

fn tolerates_on(place: &Place, wire: &[&str]) -> Run {
    let plant = Plant::start_on(place, true, &[], wire);
    let (status, said) = daemon(place, Some(800)).finish();
    assert_eq!(status.code(), Some(0), "{said}");
    let run = record(place, plant.stop());
    assert!(run.served.disturbed > 0, "no frame was hit");
    assert_eq!(run.stopped(), None);
    let last = run.ticks.iter().rfind(|t| t.tick < 800).unwrap();
    assert!(last.tick > run.zero + 100, "the run goes on after the faults");
    assert_eq!(last.mode, SupervisorState::Holding.wire());
    run
}

/// The arm stops: a fault is latched, the tensions come down, nothing but `clear` releases it, and that only when the
/// cause is gone, after which the arm can be armed again.
fn stops(faults: &[&str], wire: &[&str]) -> Run {
    stops_on(&place(), faults, wire)
}

fn stops_on(place: &Place, faults: &[&str], wire: &[&str]) -> Run {
    let plant = Plant::start_on(place, true, faults, wire);
    let daemon = daemon(place, None);
    let seen = place.until("a fault", |s| s.fault.is_some()).ticks;
    assert!(!place.request(RequestKind::Arm).is_accepted(), "latched");
    // Two seconds on, the cause is gone and the drives' own time limits are over; the fault stays.
    let later = place.until("drives off", |s| s.ticks > seen + 200 && s.drives.enabled == 0);
    assert_eq!((later.mode.as_str(), later.fault.is_some()), ("faulted", true));
    // Refused only until the last drive has been disabled in its turn.
    let deadline = Instant::now() + WAIT;
    while !place.request(RequestKind::Clear).is_accepted() {
        assert!(Instant::now() < deadline, "{:#?}", place.status());
        std::thread::sleep(Duration::from_millis(20));
    }
    place.arm();
    assert_eq!(daemon.terminate().0.code(), Some(0));
    record(place, plant.stop())
}

/// The same where the cause does not go away.
fn stops_for_good(faults: &[&str], wire: &[&str]) -> Run {
    let place = place();
    let plant = Plant::start_on(&place, true, faults, wire);
    let (status, said) = daemon(&place, Some(900)).finish();
    assert_eq!(status.code(), Some(1), "{said}");
    let run = record(&place, plant.stop());
    let last = run.ticks.last().unwrap();
    assert_eq!((last.mode, last.most_n), (SupervisorState::Faulted.wire(), 0.0));
    run
}

// ---- SYNC ----

#[test]
fn sync_lost_once() {
    tolerates(&["drop:sync@3-3.01"]);
}

#[test]
fn sync_lost_for_five_periods() {
    tolerates(&["drop:sync@3-3.05"]);
}

#[test]
fn sync_lost_for_long() {
    let run = stops(&[], &["drop:sync@3-4"]);
    assert_eq!(run.stopped(), Some((6, 20, 1)));
}

#[test]
fn sync_lost_for_good() {
    let place = place();
    let plant = Plant::start_on(&place, true, &[], &["drop:sync@3"]);
    let daemon = daemon(&place, None);
    let seen = place.until("a fault", |s| s.fault.is_some()).ticks;
    place.until("drives off", |s| s.ticks > seen + 200 && s.drives.enabled == 0);
    // A drive that hears no SYNC obeys no order, and says nothing from which it could be seen that it did.
    let answer = place.request(RequestKind::Clear);
    assert_eq!(answer.reason, RefusalReason::CausePersists.wire(), "{answer:?}");
    assert!(place.status().unwrap().fault.is_some(), "latched");
    assert_eq!(daemon.terminate().0.code(), Some(1));
    let run = record(&place, plant.stop());
    assert_eq!(run.stopped(), Some((6, 20, 1)));
    assert_eq!(run.ticks.last().unwrap().most_n, 0.0);
}

#[test]
fn sync_late_by_a_period() {
    tolerates(&["delay:sync@3-4"]);
}

#[test]
fn sync_twice() {
    tolerates(&["duplicate:sync@3-4"]);
}

#[test]
fn sync_before_its_last_torque() {
    tolerates(&["reorder:rpdo.24@3-4"]);
}

#[test]
fn sync_after_the_next_torque() {
    tolerates(&["reorder:sync@3-4"]);
}

// ---- RPDO: torque and controlword ----

#[test]
fn torques_lost_for_five_periods() {
    tolerates(&["drop:rpdo@3-3.05"]);
}

#[test]
fn torques_lost_for_long() {
    // The drives' own deadline (1400:05), 100 ms after the last one.
    let run = stops(&[], &["drop:rpdo@3-4"]);
    assert_eq!(run.stopped(), Some((10, 10, 1)));
}

#[test]
fn torques_of_one_drive_lost_for_long() {
    let run = stops(&[], &["drop:rpdo.5@3-4"]);
    assert_eq!(run.stopped(), Some((10, 10, 5)));
}

#[test]
fn torques_lost_for_good() {
    let place = place();
    let plant = Plant::start_on(&place, true, &[], &["drop:rpdo@3"]);
    let daemon = daemon(&place, None);
    let seen = place.until("a fault", |s| s.fault.is_some()).ticks;
    // The part of the report that speaks of drives is renewed twice a second, which is many ticks of lockstep.
    place.until("drives off, which say why", |s| {
        let why = s.drives.fault.as_ref().is_some_and(|f| f.contains("8250"));
        s.ticks > seen + 200 && s.drives.enabled == 0 && why
    });
    // The order to reset is lost as well. That is noticed when no drive follows it.
    assert!(place.request(RequestKind::Clear).is_accepted());
    let stuck = "a transition of the power state machine did not happen";
    place.until("a drive that does not obey", |s| s.drives.fault.as_ref().is_some_and(|f| f.contains(stuck)));
    assert!(!place.request(RequestKind::Arm).is_accepted(), "drives in fault");
    daemon.terminate();
    let run = record(&place, plant.stop());
    assert_eq!(run.stopped(), Some((10, 10, 1)));
    assert_eq!(run.ticks.last().unwrap().most_n, 0.0);
}

#[test]
fn packed_torques_lost_once() {
    let run = tolerates_on(&packed_place(), &["drop:rpdo@3-3.01"]);
    assert_eq!(run.served.disturbed, 2, "one frame of each bus");
}

#[test]
fn packed_torques_lost_for_long() {
    let run = stops_on(&packed_place(), &[], &["drop:rpdo@3-4"]);
    assert_eq!(run.stopped(), Some((10, 10, 1)));
}

#[test]
fn torques_late_by_a_period() {
    tolerates(&["delay:rpdo@3-4"]);
}

#[test]
fn torques_twice() {
    tolerates(&["duplicate:rpdo@3-4"]);
}

#[test]
fn torques_out_of_order() {
    tolerates(&["reorder:rpdo@3-4"]);
}

#[test]
fn torques_spoilt() {
    // One bit in the controlword or in the torque of each: the seed chooses.
    let run = stops(&[], &["corrupt:rpdo.5@3-4"]);
    assert!(matches!(run.stopped(), Some((0..=20, 10, 5))), "{:?}", run.stopped());
}

// ---- TPDO: statusword, position, torque ----

#[test]
fn feedback_lost_for_five_periods() {
    tolerates(&["drop:tpdo.5@3-3.05"]);
}

#[test]
fn feedback_lost_for_long() {
    let run = stops(&[], &["drop:tpdo.5@3-4"]);
    assert_eq!(run.stopped(), Some((5, 20, 5)));
}

#[test]
fn feedback_late_by_a_period() {
    tolerates(&["delay:tpdo@3-4"]);
}

#[test]
fn feedback_late_by_five_periods() {
    tolerates(&["delay5:tpdo@3-4"]);
}

#[test]
fn feedback_twice() {
    tolerates(&["duplicate:tpdo@3-4"]);
}

#[test]
fn feedback_out_of_order() {
    tolerates(&["reorder:tpdo@3-4"]);
}

#[test]
fn feedback_spoilt() {
    let run = stops(&[], &["corrupt:tpdo.5@3-4"]);
    assert!(matches!(run.stopped(), Some((0..=20, 10 | 21, 5))), "{:?}", run.stopped());
}

// ---- heartbeats ----

#[test]
fn heartbeats_of_the_master_lost_twice() {
    tolerates(&["drop:master@3-3.1"]);
}

#[test]
fn heartbeats_of_the_master_lost_for_long() {
    let run = stops(&[], &["drop:master@3-4"]);
    assert!(matches!(run.stopped(), Some((11..=18, 10, 1))), "{:?}", run.stopped());
}

#[test]
fn heartbeats_of_the_master_disturbed() {
    tolerates(&["delay2:master=0.3@3-4", "duplicate:master=0.3@3-4", "reorder:master=0.3@3-4"]);
}

#[test]
fn heartbeats_of_the_master_spoilt() {
    tolerates(&["corrupt:master@3-4"]);
}

#[test]
fn heartbeats_of_a_drive_lost_twice() {
    tolerates(&["drop:heartbeat.5@3-3.1"]);
}

#[test]
fn heartbeats_of_a_drive_lost_for_long() {
    let run = stops(&[], &["drop:heartbeat.5@3-4"]);
    assert!(matches!(run.stopped(), Some((11..=18, 10, 5))), "{:?}", run.stopped());
}

#[test]
fn heartbeats_of_drives_disturbed() {
    tolerates(&["delay2:heartbeat=0.3@3-4", "duplicate:heartbeat=0.3@3-4", "reorder:heartbeat=0.3@3-4"]);
}

#[test]
fn heartbeats_of_a_drive_spoilt() {
    let run = stops(&[], &["corrupt:heartbeat.5@3-4"]);
    assert!(matches!(run.stopped(), Some((0..=18, 10, 5))), "{:?}", run.stopped());
}

// ---- emergency objects ----

#[test]
fn emergency_lost() {
    let run = stops(&["trip:5@3"], &["drop:emcy@3-4"]);
    assert_eq!(run.stopped(), Some((1, 10, 5)));
}

#[test]
fn emergency_disturbed() {
    for kind in ["delay3", "duplicate", "reorder", "corrupt"] {
        let run = stops(&["trip:5@3"], &[&format!("{kind}:emcy@3-4")]);
        assert_eq!(run.stopped(), Some((1, 10, 5)), "{kind}");
    }
}

// ---- SDO and NMT in operation: what is read back, and nothing that the loop waits for ----

#[test]
fn sdo_and_nmt_lost_in_operation() {
    let run = tolerates(&["drop:sdo@3-4", "drop:nmt@3-4", "drop:rpdo.1@3-3.01"]);
    assert!(run.served.disturbed > 5, "{}: each object is asked for again in its turn", run.served.disturbed);
}

// ---- all frames ----

#[test]
fn bus_lost_for_four_periods() {
    tolerates(&["drop@3-3.04"]);
}

#[test]
fn bus_lost_for_long() {
    let run = stops(&[], &["drop@3-4"]);
    assert_eq!(run.stopped(), Some((5, 20, 1)));
}

#[test]
fn a_hundredth_of_all_frames_lost() {
    tolerates(&["drop=0.01"]);
}

// ---- nodes ----

#[test]
fn drive_silent() {
    let run = stops(&[], &["drop:all.5@3-4"]);
    assert_eq!(run.stopped(), Some((5, 20, 5)));
}

#[test]
fn drive_dead() {
    let run = stops_for_good(&["dead:5@3"], &[]);
    assert_eq!(run.stopped(), Some((6, 20, 5)));
}

#[test]
fn drive_restarts() {
    let run = stops(&["reboot:5@3"], &[]);
    assert_eq!(run.stopped(), Some((1, 10, 5)));
}

#[test]
fn drive_trips() {
    let run = stops(&["trip:5@3"], &[]);
    assert_eq!(run.stopped(), Some((1, 10, 5)));
}

#[test]
fn encoder_jumps() {
    let run = stops(&["jump:5:0.03@3"], &[]);
    assert_eq!(run.stopped(), Some((1, 21, 5)));
}

// ---- the bus itself, in real time: lockstep has no time without frames ----

#[test]
fn bus_off() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&["--arm-on-start"]);
    place.until("holding", |s| s.mode == "holding");
    let bus = VirtualBus::open(&place.bus, false).unwrap();
    bus.set_state(BusState::BusOff);
    let fault = place.until("a fault", |s| s.fault.is_some()).fault.unwrap();
    assert_eq!(fault.code, 13, "{fault:?}");
    // Its drives' states are unknown, so the ramp cannot end either; whatever the reason, it is refused.
    assert!(!place.request(RequestKind::Clear).is_accepted(), "the cause persists");
    bus.set_state(BusState::ErrorActive);
    let deadline = Instant::now() + WAIT;
    while !place.request(RequestKind::Clear).is_accepted() {
        assert!(Instant::now() < deadline, "{:#?}", place.status());
        std::thread::sleep(Duration::from_millis(50));
    }
    place.arm();
    let (status, said) = daemon.terminate();
    assert_eq!(status.code(), Some(0), "{said}");
}

#[test]
fn encoder_sticks() {
    // While it holds nothing tells a stuck encoder from a steady arm: it must move.
    let place = place();
    let plant = Plant::start_on(&place, true, &["stick:5@2"], &[]);
    let file = place.folder.path().join("run.mcap").display().to_string();
    let arguments = ["--lockstep", "--arm-on-start", "--track-on-start", "--await-obstacles", "11", "--await-target"];
    let daemon = place.daemon(&[&arguments[..], &["--record", &file]].concat());
    let ticker = TickClient::new(&place).spawn();
    let code = place.until("a fault", |s| s.fault.is_some()).fault.unwrap().code;
    assert!([22, 30, 31].contains(&code), "{code}");
    place.until("drives off", |s| s.drives.enabled == 0);
    assert!(!place.request(RequestKind::Arm).is_accepted(), "latched");
    drop(ticker);
    assert_eq!(daemon.terminate().0.code(), Some(1));
    plant.stop();
}

// ---- tracking ----

/// The tip example for a minute, judged by the true arm: mean and largest tip error (m).
fn tip_error(wire: &[&str]) -> (f64, f64) {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_sinew"))
        .args(["demo", "tip", "--fast", "--json", "--duration", "60", "--seed", "1"])
        .args(wire)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let object: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(object["faults"], serde_json::json!([]));
    assert_eq!(object["ticks"], 6000);
    let error = |key: &str| object["tip_error_m"][key].as_f64().unwrap();
    (error("norm_mean"), error("norm_max"))
}

#[test]
fn a_hundredth_of_all_frames_lost_while_tracking() {
    let (mean, most) = tip_error(&[]);
    let (lossy_mean, lossy_most) = tip_error(&["--wire", "drop=0.01"]);
    assert_ne!(mean, lossy_mean, "no frame was lost");
    assert!(lossy_mean <= 1.5 * mean && lossy_most <= 1.5 * most, "{mean} {most} {lossy_mean} {lossy_most}");
}
