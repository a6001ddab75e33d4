//! Drives that do not do what they are told, limits that are changed from outside, emergency stops: what the whole does about
//! them; daemon, bus, drives and arm, in lockstep.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "daemon_support/mod.rs"]
mod support;

use sinew::ipc::payload::{RefusalReason, RequestKind};
use sinew_hal::can::CanBus;
use sinew_hal::canopen::NodeId;
use sinew_hal::canopen::cob::{SDO_REQUEST, frame};
use sinew_hal::cia402::objects::{EVENT_TIMER, MAX_TORQUE, RPDO_COMMUNICATION};
use sinew_hal::virtual_bus::VirtualBus;
use std::time::{Duration, Instant};
use support::*;

/// A daemon that holds an arm in lockstep, with faults of the plant.
fn holding(place: &Place, faults: &[&str]) -> (Plant, Daemon) {
    let plant = Plant::start(place, true, faults);
    let daemon = place.daemon(&["--lockstep", "--arm-on-start"]);
    place.until("holding", |s| s.mode == "holding" || s.fault.is_some());
    (plant, daemon)
}

fn faulted(place: &Place) -> sinew::daemon::status::FaultStatus {
    place.until("drives off", |s| s.fault.is_some() && s.drives.enabled == 0).fault.unwrap()
}

/// Clears as soon as the last drive is off; arms again.
fn clears_and_arms(place: &Place) {
    let deadline = Instant::now() + WAIT;
    while !place.request(RequestKind::Clear).is_accepted() {
        assert!(Instant::now() < deadline, "{:#?}", place.status());
        std::thread::sleep(Duration::from_millis(20));
    }
    place.arm();
}

/// Another node writes to the drive of node 8, which is that of cable 7.
fn foreign_write(place: &Place, command: u8, index: u16, sub: u8, value: [u8; 4]) {
    let mut bus = VirtualBus::open(&place.bus, false).unwrap();
    let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), value);
    let payload = [command, low, high, sub, a, b, c, d];
    bus.send(&frame(NodeId::new(8).unwrap().cob(SDO_REQUEST), &payload).unwrap()).unwrap();
}

#[test]
fn a_drive_that_pulls_more_than_it_is_told_stops_the_arm_and_is_named() {
    let place = Place::shipped();
    let (_plant, _daemon) = holding(&place, &["pull:7:60@3"]);
    let fault = faulted(&place);
    assert_eq!((fault.code, fault.detail), (14, 6), "{fault:?}");
    assert!(fault.what.contains("the drive of cable 2,1 ") && fault.clears.contains("6072"), "{fault:?}");
}

#[test]
fn a_torque_limit_that_another_node_writes_stops_the_arm_and_is_set_anew_by_clear() {
    let place = Place::shipped();
    let (_plant, _daemon) = holding(&place, &[]);
    let [v0, v1] = 30_000u16.to_le_bytes();
    foreign_write(&place, 0x2b, MAX_TORQUE, 0, [v0, v1, 0, 0]);
    let fault = faulted(&place);
    assert_eq!((fault.code, fault.detail), (10, 7), "{fault:?}");
    // The drive's own words come with the bus thread's next report.
    place.until("the cause", |s| s.fault.as_ref().is_some_and(|f| f.what.contains("changed from outside")));
    clears_and_arms(&place);
    // Read back for some seconds more, it holds what it must.
    let ticks = place.status().unwrap().ticks;
    let later = place.until("some seconds", |s| s.ticks > ticks + 300 || s.fault.is_some());
    assert_eq!(later.fault, None);
}

#[test]
fn a_drive_whose_commands_another_node_cut_off_loses_its_torque_all_the_same() {
    let place = Place::shipped();
    let (_plant, _daemon) = holding(&place, &[]);
    // Its RPDO is no longer valid: it hears neither torques nor controlwords. Without the event timer it would not mind.
    foreign_write(&place, 0x2b, RPDO_COMMUNICATION, EVENT_TIMER, [0; 4]);
    foreign_write(&place, 0x23, RPDO_COMMUNICATION, 1, 0x8000_0208u32.to_le_bytes());
    let fault = faulted(&place);
    assert_eq!((fault.code, fault.detail), (10, 7), "{fault:?}");
    clears_and_arms(&place);
}

#[test]
fn an_emergency_stop_at_a_drive_stops_the_arm_and_stays_until_it_is_released() {
    let place = Place::new(|_, text| {
        text.replace("[drives]\n", "[drives]\nemergency_stop_bit = 14\nemergency_stop_low = false\n")
    });
    let (_plant, _daemon) = holding(&place, &["press:7@3"]);
    let fault = faulted(&place);
    assert_eq!((fault.code, fault.detail), (15, 6), "{fault:?}");
    let status = place.until("an alarm", |s| s.alarms.iter().any(|a| a.about == "emergency stop"));
    assert_eq!(status.mode, "faulted");
    let deadline = Instant::now() + WAIT;
    loop {
        let response = place.request(RequestKind::Clear);
        assert!(!response.is_accepted(), "it is still pressed");
        if response.reason == RefusalReason::CausePersists.wire() {
            break;
        }
        assert!(Instant::now() < deadline, "{:#?}", place.status());
    }
}

#[test]
fn the_operators_emergency_stop_is_latched_shown_and_released_in_two_steps() {
    let place = Place::shipped();
    let (_plant, _daemon) = holding(&place, &[]);
    let (code, said) = place.operate(&["emergency-stop"]);
    assert_eq!(code, Some(0), "{said}");
    let fault = faulted(&place);
    assert_eq!(fault.code, 15, "{fault:?}");
    place.until("an alarm", |s| s.alarms.iter().any(|a| a.about == "emergency stop"));
    assert!(!place.request(RequestKind::Clear).is_accepted(), "it is still pressed");
    let (code, said) = place.operate(&["emergency-stop", "--release"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(place.status().unwrap().fault.is_some(), "released is not cleared");
    clears_and_arms(&place);
    // Pressed while nothing moves, it keeps the arm from being armed.
    assert!(place.request(RequestKind::Stop).is_accepted());
    place.until("disarmed", |s| s.mode == "disarmed");
    assert_eq!(place.operate(&["emergency-stop"]).0, Some(0));
    let (code, said) = place.operate(&["arm"]);
    assert!(code == Some(1) && said.contains("an emergency stop is pressed"), "{code:?} {said}");
}
