//! The master's half of CiA 402 against the drives' half, on a bus in memory, in lockstep: the clock is a number. What
//! does not depend on the layout of the frames is claimed for both.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

mod bench;

use bench::{Bench, MS, MemoryBus, configure, node, transfer};
use proptest::prelude::*;
use sim_plant::drive::objects::{LABEL, PRODUCT, dictionary};
use sim_plant::drive::{Drive, DriveBank, Nameplate};
use sinew_hal::can::{CanBus, Frame, Id, Kind, Received};
use sinew_hal::canopen::emcy::{code, register};
use sinew_hal::canopen::sdo::{Request, Response, Start};
use sinew_hal::canopen::sdo_client::{Outcome, SdoError};
use sinew_hal::canopen::{AbortCode, NmtCommand, NmtState};
use sinew_hal::cia402::layout::packed_frame;
use sinew_hal::cia402::objects as o;
use sinew_hal::cia402::script::{Advance, Runner};
use sinew_hal::cia402::state::Command;
use sinew_hal::cia402::{
    DriveMask, DriveSetup, Event, Fault, Goal, Layout, Master, MasterConfig, ObjectWrite, Order, Phase, State,
};
use std::time::Duration;

fn twenty_four_drives_on_four_buses_go_from_power_up_to_torque_and_back(layout: Layout) {
    let mut b = Bench::new(layout, 4, 6, |_| {});
    b.enable();
    assert_eq!(b.master.take_faults(), []);
    assert!(b.master.status().all(|s| s.rated_torque_mnm == Some(5000) && s.absent.is_empty()));
    let mut writer = b.master.take_writer().unwrap();
    let torques: Vec<i16> = (0..24).map(|i| 10 * i - 50).collect();
    for i in 0..24 {
        b.drive(i / 6, i % 6).set_feedback(1000 + i as i32, 0, torques[i] / 2);
    }
    b.events.clear();
    b.cycle(&mut writer, &torques);
    for i in 0..24 {
        assert_eq!(b.drive(i / 6, i % 6).torque_permille(), torques[i]);
        assert_eq!(b.decoder.feedback()[i].position_counts, 1000 + i as i32);
        assert_eq!(b.decoder.feedback()[i].torque_permille, torques[i] / 2);
    }
    assert_eq!(b.events.iter().filter(|e| matches!(e, Event::Complete { .. })).count(), 1);
    assert!(b.decoder.missing().is_empty());
    b.master.return_writer(writer);
    b.master.set_goal(Goal::Disabled, b.now_ns);
    b.run_until(1000, |p| p.at_goal);
    assert!((0..24).all(|i| b.drive(i / 6, i % 6).torque_permille() == 0));
    assert_eq!(b.master.take_faults(), []);
}

fn a_torque_counts_from_the_next_sync_on_and_not_before(layout: Layout) {
    let mut b = Bench::new(layout, 1, 1, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[100]);
    let data = o::encode_rpdo1(Command::EnableOperation.controlword(), 300);
    let now = b.now_ns;
    let rpdo = match layout {
        Layout::Classic => Frame::classic(Id::Standard(0x201), &data),
        Layout::Packed => packed_frame(&data),
    };
    let rpdo = rpdo.unwrap();
    let sync = Frame::classic(Id::Standard(0x80), &[]).unwrap();
    b.drive(0, 0).on_frame(&rpdo, now);
    assert_eq!(b.drive(0, 0).torque_permille(), 100);
    b.drive(0, 0).on_frame(&sync, now);
    assert_eq!(b.drive(0, 0).torque_permille(), 300);
}

fn torque_beyond_the_limit_is_cut_and_reported_by_both_sides(layout: Layout) {
    let mut b = Bench::new(layout, 1, 2, |c| c.drives[1].torque_permille_max = 400);
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    let report = writer.write_cycle(&[900, 900]);
    let mut second = DriveMask::default();
    second.insert(1);
    assert_eq!(report.limited, second);
    b.serve();
    assert_eq!((b.drive(0, 0).torque_permille(), b.drive(0, 1).torque_permille()), (900, 400));
}

fn ordered_disabling_takes_one_drive_after_the_other(layout: Layout) {
    let mut b = Bench::new(layout, 1, 3, |c| c.order_of_disabling = Order::OneByOneReversed);
    b.enable();
    b.master.set_goal(Goal::Disabled, b.now_ns);
    let mut seen = Vec::new();
    for _ in 0..300 {
        b.step();
        let states: Vec<_> = (0..3).map(|i| b.drive(0, i).state() == State::SwitchOnDisabled).collect();
        if seen.last() != Some(&states) {
            seen.push(states);
        }
    }
    assert_eq!(seen, [[false, false, false], [false, false, true], [false, true, true], [true, true, true]]);
}

fn a_drive_that_keeps_its_torque_without_a_master_lets_go_of_it_slowly_before_it_is_reset(layout: Layout) {
    let mut b = Bench::new(layout, 1, 1, |c| {
        c.drives[0].writes = ObjectWrite::sinew_guard(30_000, 0, true).to_vec();
        // 500 per mille in 2 s.
        c.drives[0].release = ObjectWrite::sinew_release(0, 250).to_vec();
        c.release_ms = 2100;
    });
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[500]);
    for _ in 0..50 {
        b.now_ns += 10 * MS;
        b.serve();
    }
    assert_eq!((b.drive(0, 0).state(), b.drive(0, 0).torque_permille()), (State::Fault, 500));
    // A new master begins.
    b.master.return_writer(writer);
    b.master.start(b.now_ns);
    let (began_ns, mut last) = (b.now_ns, 500);
    while b.drive(0, 0).torque_permille() != 0 {
        b.step();
        let torque = b.drive(0, 0).torque_permille();
        assert!(torque <= last && last - torque < 10, "{last} then {torque}");
        last = torque;
        assert!(b.now_ns < began_ns + 3000 * MS, "{torque} left");
    }
    assert!(b.now_ns > began_ns + 1800 * MS, "{} ms", (b.now_ns - began_ns) / MS);
    b.run_until(1000, |p| p.ready == 1);
    assert_eq!(b.drive(0, 0).state(), State::SwitchOnDisabled);
}

fn a_lost_master_takes_the_torque_to_the_safe_value_and_the_fault_is_latched(layout: Layout) {
    for safe in [0, 30] {
        let mut b =
            Bench::new(layout, 1, 1, |c| c.drives[0].writes = ObjectWrite::sinew_guard(0, safe, false).to_vec());
        b.enable();
        let mut writer = b.master.take_writer().unwrap();
        b.cycle(&mut writer, &[500]);
        // The control loop goes on, the heartbeat does not.
        for _ in 0..50 {
            b.now_ns += 10 * MS;
            writer.write_cycle(&[500]);
            b.serve();
        }
        assert_eq!(b.drive(0, 0).state(), State::Fault);
        assert_eq!(b.drive(0, 0).torque_permille(), safe);
        b.step();
        let faults = b.master.take_faults();
        let told = faults.iter().any(|f| matches!(f.fault, Fault::Emergency(e) if e.code == code::HEARTBEAT));
        assert!(told, "{faults:?}");
        assert!(faults.iter().any(|f| f.to_string().contains("heartbeat of the master lost")));
        // The heartbeat is back, torque is not, whatever is commanded without a reset.
        b.master.return_writer(writer);
        b.master.set_goal(Goal::Enabled, b.now_ns);
        for _ in 0..200 {
            b.step();
        }
        assert_eq!(b.drive(0, 0).state(), State::Fault);
        b.master.reset_faults(b.now_ns);
        b.run_until(500, |p| p.at_goal);
        assert_eq!(b.drive(0, 0).torque_permille(), 0);
        b.master.set_goal(Goal::Enabled, b.now_ns);
        b.run_until(500, |p| p.enabled == 1);
    }
}

fn a_safe_torque_beyond_the_rated_one_is_taken_and_held_within_the_limit(layout: Layout) {
    // A motor may give several times its rated torque for a while, and a safe tension may need it.
    for (safe, held) in [(1500, 1500), (-10_000, -3000)] {
        let mut b = Bench::new(layout, 1, 1, |c| {
            c.drives[0].torque_permille_max = 3000;
            c.drives[0].writes = ObjectWrite::sinew_guard(30_000, safe, false).to_vec();
        });
        b.enable();
        let mut writer = b.master.take_writer().unwrap();
        b.cycle(&mut writer, &[2000]);
        assert_eq!(b.drive(0, 0).torque_permille(), 2000);
        for _ in 0..1000 {
            b.step();
        }
        assert_eq!((b.drive(0, 0).torque_permille(), b.drive(0, 0).state()), (held, State::Fault));
    }
}

fn a_missing_sync_is_a_fault_within_its_timeout(layout: Layout) {
    let mut b = Bench::new(layout, 1, 1, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[500]);
    for _ in 0..200 {
        b.step();
    }
    assert_eq!((b.drive(0, 0).state(), b.drive(0, 0).torque_permille()), (State::Fault, 0));
    let faults = b.master.take_faults();
    assert!(
        faults.iter().any(|f| matches!(f.fault, Fault::Emergency(e) if e.code == code::SYNC_TIMEOUT)),
        "{faults:?}"
    );
}

fn quick_stop_brakes_along_the_slope(layout: Layout) {
    let mut b = Bench::new(layout, 1, 1, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[1000]);
    b.master.set_goal(Goal::QuickStop, b.now_ns);
    b.step();
    b.cycle(&mut writer, &[1000]);
    let first = b.drive(0, 0).torque_permille();
    b.cycle(&mut writer, &[1000]);
    let second = b.drive(0, 0).torque_permille();
    assert!(first - second == 100, "10,000 per mille a second are 100 in 10 ms: {first} {second}");
    for _ in 0..12 {
        b.cycle(&mut writer, &[1000]);
    }
    assert_eq!((b.drive(0, 0).torque_permille(), b.drive(0, 0).state()), (0, State::SwitchOnDisabled));
}

fn a_device_fault_is_reported_and_the_drive_is_not_driven_back(layout: Layout) {
    let mut b = Bench::new(layout, 1, 2, |_| {});
    b.enable();
    let now = b.now_ns;
    b.drive(0, 1).trip(code::OVER_CURRENT, register::CURRENT, now);
    for _ in 0..200 {
        b.step();
    }
    let faults = b.master.take_faults();
    assert!(faults.iter().all(|f| f.drive == 1));
    assert!(faults.iter().any(|f| matches!(f.fault, Fault::LeftOperation { found: State::Fault, .. })), "{faults:?}");
    assert_eq!(b.drive(0, 0).state(), State::OperationEnabled);
    assert_eq!(b.drive(0, 1).state(), State::Fault);
    assert_eq!(b.drive(0, 1).dictionary().int(o::ERROR_FIELD, 1), i64::from(code::OVER_CURRENT));
}

fn a_device_fault_cuts_the_safe_torque_of_a_communication_fault_too(layout: Layout) {
    // In the reaction, on the slope from 500 to 400 per mille, and when that has ended.
    for ms in [1, 100] {
        let mut b =
            Bench::new(layout, 1, 1, |c| c.drives[0].writes = ObjectWrite::sinew_guard(30_000, 400, false).to_vec());
        b.enable();
        let mut writer = b.master.take_writer().unwrap();
        b.cycle(&mut writer, &[500]);
        while !matches!(b.drive(0, 0).state(), State::FaultReactionActive | State::Fault) {
            b.step();
        }
        for _ in 0..ms {
            b.step();
        }
        let now = b.now_ns;
        let state = if ms == 1 { State::FaultReactionActive } else { State::Fault };
        assert_eq!(b.drive(0, 0).state(), state);
        assert!(b.drive(0, 0).torque_permille() >= 400);
        b.drive(0, 0).trip(code::OVER_CURRENT, register::CURRENT, now);
        for _ in 0..50 {
            assert_eq!((b.drive(0, 0).torque_permille(), b.drive(0, 0).state()), (0, State::Fault));
            b.step();
        }
        let first = b.drive(0, 0).dictionary().int(o::ERROR_CODE, 0);
        assert_eq!(first, i64::from(code::SYNC_TIMEOUT), "the first cause stays");
        assert_eq!(b.drive(0, 0).dictionary().int(o::ERROR_FIELD, 1), i64::from(code::OVER_CURRENT));
    }
}

fn what_is_wrong_at_start_is_named(layout: Layout) {
    // A node that is not there.
    let mut b = Bench::new(layout, 1, 1, |c| c.drives[0].node = node(9));
    b.run_until(6000, |p| p.failed == 1);
    assert!(
        matches!(b.master.take_faults()[..], [f] if f.node == node(9) && matches!(f.fault, Fault::NoBootUp { .. }))
    );
    // Another product.
    let mut b = Bench::new(layout, 1, 1, |c| c.drives[0].identity.product = Some(7));
    b.run_until(1000, |p| p.failed == 1);
    let wrong = Fault::Value { index: 0x1018, sub: 2, expected: 7, found: PRODUCT, mask: u32::MAX };
    assert_eq!(b.master.take_faults()[0].fault, wrong);
    // Another motor.
    let mut b = Bench::new(layout, 1, 1, |c| c.drives[0].rated_torque_mnm = Some(4000));
    b.run_until(1000, |p| p.failed == 1);
    assert!(matches!(b.master.take_faults()[0].fault, Fault::Value { index: 0x6076, expected: 4000, found: 5000, .. }));
    // A value that the drive refuses, and an object that it has not.
    for (index, sub, abort) in [(o::GUARD, 2, AbortCode::VALUE_HIGH), (0x2fff, 0, AbortCode::NO_OBJECT)] {
        let data = 20_000i16.to_le_bytes().to_vec();
        let write = ObjectWrite { index, sub, data, optional: false };
        let mut b = Bench::new(layout, 1, 1, |c| c.drives[0].writes = vec![write]);
        b.run_until(1000, |p| p.failed == 1);
        let fault = b.master.take_faults()[0];
        let error = SdoError::Aborted(abort);
        assert_eq!(fault.fault, Fault::Sdo { index, sub, write: true, error });
        assert!(fault.to_string().contains(abort.words()), "{fault}");
    }
}

fn a_drive_that_restarts_or_falls_silent_is_a_fault(layout: Layout) {
    let mut b = Bench::new(layout, 1, 2, |_| {});
    b.enable();
    let now = b.now_ns;
    b.drive(0, 0).power_cycle(now);
    b.run_until(100, |p| p.failed == 1);
    assert_eq!(b.master.take_faults()[0].fault, Fault::Rebooted);
    b.banks[0].1 = DriveBank::new(vec![]);
    for _ in 0..300 {
        b.step();
    }
    let faults = b.master.take_faults();
    assert!(faults.iter().any(|f| f.drive == 1 && f.fault == Fault::HeartbeatLost { timeout_ms: 200 }), "{faults:?}");
}

fn a_lost_answer_is_named_in_the_next_cycle(layout: Layout) {
    let mut b = Bench::new(layout, 1, 3, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[0; 3]);
    b.banks[0].1 = DriveBank::new(b.banks[0].1.drives()[..2].to_vec());
    b.cycle(&mut writer, &[0; 3]);
    b.events.clear();
    b.cycle(&mut writer, &[0; 3]);
    let mut third = DriveMask::default();
    third.insert(2);
    let told = b.events.iter().any(|e| matches!(e, Event::Incomplete { missing, .. } if *missing == third));
    assert!(told, "{:?}", b.events);
}

fn frames_that_a_bus_does_not_take_are_counted_and_its_drives_keep_their_torques(layout: Layout) {
    let mut b = Bench::new(layout, 2, 3, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[100; 6]);
    assert_eq!([b.master.unsent(0), b.master.unsent(1)], [0, 0]);
    // The torques of the second bus are not taken, its SYNC is.
    b.refuse(1, Some(|id| (0x200..0x280).contains(&id)));
    let report = writer.write_cycle(&[200; 6]);
    b.serve();
    assert_eq!((report.not_sent.iter().collect::<Vec<_>>(), report.sync_not_sent), (vec![3, 4, 5], 0));
    let torques: Vec<_> = (0..6).map(|i| b.drive(i / 3, i % 3).torque_permille()).collect();
    assert_eq!(torques, [200, 200, 200, 100, 100, 100]);
    let rpdos = if layout == Layout::Packed { 1 } else { 3 };
    assert_eq!([b.master.unsent(0), b.master.unsent(1)], [0, rpdos]);
    // Nor is its SYNC.
    b.refuse(1, Some(|id| (0x200..0x280).contains(&id) || id == 0x80));
    assert_eq!(writer.write_cycle(&[200; 6]).sync_not_sent, 0b10);
    assert_eq!([b.master.unsent(0), b.master.unsent(1)], [0, 2 * rpdos + 1]);
    // What comes later is taken, and nothing of what was refused comes after all.
    b.refuse(1, None);
    b.cycle(&mut writer, &[300; 6]);
    assert!((0..6).all(|i| b.drive(i / 3, i % 3).torque_permille() == 300));
    assert_eq!(b.master.unsent(1), 2 * rpdos + 1);
}

#[test]
fn a_bus_that_takes_nothing_for_long_is_not_flooded_when_it_does_again() {
    let (wire, drives) = (MemoryBus::default(), 24u8);
    let mut listener = wire.handle();
    let setups = (1..=drives).map(|n| DriveSetup::new(0, node(n))).collect();
    let mut master = Master::new(MasterConfig::new(setups, node(127), 10_000), vec![Box::new(wire)]).unwrap();
    // The cable is off, for a minute; whoever waits for the drives starts over and over.
    listener.refuse(Some(|_| true));
    for ms in 0..60_000 {
        if ms % 500 == 0 {
            master.start(ms * MS);
        }
        master.poll(ms * MS);
    }
    assert_eq!(listener.waiting(), 0);
    assert_eq!(master.given_up(0), 119 * 25, "all of the starts before");
    listener.refuse(None);
    master.poll(60_000 * MS);
    let mut found = Vec::new();
    while let Ok(Some(received)) = listener.receive(Duration::ZERO) {
        found.push(received.frame);
    }
    let reset = |n| NmtCommand::ResetNode.encode(Some(node(n)));
    let mut expected: Vec<_> = (1..=drives).map(reset).collect();
    expected.insert(0, NmtState::Operational.heartbeat(node(127)));
    assert_eq!(found, expected, "one start's frames and one heartbeat");
}

#[test]
fn what_waits_for_a_bus_is_bounded_and_the_oldest_goes_first() {
    let (wire, drives) = (MemoryBus::default(), 126u8);
    let mut listener = wire.handle();
    let setups = (1..=drives).map(|n| DriveSetup::new(0, node(n))).collect();
    let mut master = Master::new(MasterConfig::new(setups, node(127), 10_000), vec![Box::new(wire)]).unwrap();
    listener.refuse(Some(|_| true));
    master.start(0);
    // All are heard and none hears: three attempts to read the first object, and an abort after each.
    for n in 1..=drives {
        let received = Received { frame: NmtState::BootUp.heartbeat(node(n)), time_ns: 0 };
        master.poll(0);
        master.on_frame(0, &received, 0);
    }
    let progress = (0..2000).map(|ms| master.poll(ms * MS)).last().unwrap();
    assert_eq!(progress.failed, usize::from(drives));
    let made = u64::from(drives) * (1 + 6);
    listener.refuse(None);
    master.poll(2000 * MS);
    let mut found = Vec::new();
    while let Ok(Some(received)) = listener.receive(Duration::ZERO) {
        found.push(received.frame);
    }
    assert!(found.len() <= 513 && master.given_up(0) + 513 >= made, "{} of {made}", found.len());
    // The resets of the beginning are gone, the last aborts are there.
    assert!(found.iter().all(|f| f.id() != Id::Standard(0)));
    let aborts = found.iter().rev().take(usize::from(drives)).filter(|f| f.data()[0] == 0x80).count();
    assert!(aborts + 1 >= usize::from(drives), "{aborts}");
}

#[test]
fn mapping_is_changed_only_in_the_prescribed_order() {
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    let aborted = |c| Outcome::Failed(SdoError::Aborted(c));
    let ok = Outcome::Done(vec![]);
    let mut write = |index, sub, data: &[u8]| transfer(&mut d, index, sub, Some(data));
    let torque = 0x6071_0010u32.to_le_bytes();
    assert_eq!(write(0x1600, 0, &[0]), aborted(AbortCode::DEVICE_STATE)); // the PDO is valid
    assert_eq!(write(0x1400, 1, &0x0000_0301u32.to_le_bytes()), aborted(AbortCode::VALUE_RANGE));
    assert_eq!(write(0x1400, 1, &0x8000_0201u32.to_le_bytes()), ok);
    assert_eq!(write(0x1600, 1, &torque), aborted(AbortCode::UNSUPPORTED_ACCESS)); // count is not 0
    assert_eq!(write(0x1600, 0, &[0]), ok);
    assert_eq!(write(0x1600, 1, &0x6077_0010u32.to_le_bytes()), aborted(AbortCode::NOT_MAPPABLE)); // read-only
    assert_eq!(write(0x1600, 1, &0x5555_0010u32.to_le_bytes()), aborted(AbortCode::NO_OBJECT));
    assert_eq!(write(0x1600, 1, &0x6071_0020u32.to_le_bytes()), aborted(AbortCode::NOT_MAPPABLE)); // wrong length
    for sub in 1..=5 {
        assert_eq!(write(0x1600, sub, &torque), ok);
    }
    assert_eq!(write(0x1600, 0, &[5]), aborted(AbortCode::PDO_LENGTH));
    assert_eq!(write(0x1600, 0, &[18]), aborted(AbortCode::VALUE_HIGH));
    assert_eq!(write(0x1600, 0, &[1]), ok);
    assert_eq!(write(0x1400, 2, &[245]), aborted(AbortCode::VALUE_RANGE));
    assert_eq!(write(0x1400, 1, &0x0000_0080u32.to_le_bytes()), aborted(AbortCode::VALUE_RANGE)); // SYNC's identifier
    assert_eq!(write(0x1400, 1, &0x0000_0301u32.to_le_bytes()), ok);
}

#[test]
fn every_pair_of_state_and_command_does_what_the_standard_says() {
    let to = |d: &mut Drive, c: Command| {
        let _ = transfer(d, o::CONTROLWORD, 0, Some(&c.controlword().to_le_bytes()));
    };
    let path: [(State, &[Command]); 5] = [
        (State::SwitchOnDisabled, &[]),
        (State::ReadyToSwitchOn, &[Command::Shutdown]),
        (State::SwitchedOn, &[Command::Shutdown, Command::SwitchOn]),
        (State::OperationEnabled, &[Command::Shutdown, Command::SwitchOn, Command::EnableOperation]),
        (State::QuickStopActive, &[Command::Shutdown, Command::SwitchOn, Command::EnableOperation, Command::QuickStop]),
    ];
    for (state, commands) in path {
        for command in Command::ALL {
            let mut d = Drive::new(node(1), Nameplate::default(), 0);
            let _ = transfer(&mut d, o::QUICK_STOP_OPTION, 0, Some(&6i16.to_le_bytes()));
            commands.iter().for_each(|&c| to(&mut d, c));
            assert_eq!(d.state(), state);
            to(&mut d, command);
            assert_eq!(d.state(), state.after(command, true).unwrap_or(state), "{state} {command:?}");
        }
    }
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    d.trip(code::OVER_CURRENT, register::CURRENT, 0);
    for c in Command::ALL {
        assert_eq!(d.state(), State::Fault);
        to(&mut d, c);
    }
    assert_eq!(d.state(), State::SwitchOnDisabled);
}

/// One exchange with a drive's SDO server.
fn ask(d: &mut Drive, request: [u8; 8]) -> [u8; 8] {
    d.on_frame(&Frame::classic(Id::Standard(0x601), &request).unwrap(), 0);
    std::iter::from_fn(|| d.pop()).find(|f| f.id() == Id::Standard(0x581)).unwrap().data().try_into().unwrap()
}

#[test]
fn a_drive_that_does_not_say_how_long_its_short_answers_are_is_configured_all_the_same() {
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    let mut drive = DriveSetup::new(0, node(1));
    drive.writes = ObjectWrite::sinew_guard(30_000, -7, false).to_vec();
    let mut runner = Runner::new(&MasterConfig::new(vec![drive], node(127), 10_000), 0);
    let mut next = runner.start(0);
    let mut unsized_answers = 0;
    while let Advance::Send(request) = next {
        let mut answer = ask(&mut d, request);
        if answer[0] & 0xe3 == 0x43 {
            // e = 1, s = 0: what stands behind the value means nothing.
            let len = 4 - usize::from(answer[0] >> 2 & 3);
            answer[0] = 0x42;
            answer[4 + len..].fill(0xa5);
            unsized_answers += usize::from(len < 4);
        }
        next = runner.on_response(&answer, 0);
    }
    assert_eq!(next, Advance::Done);
    assert!(unsized_answers > 10, "{unsized_answers}");
    assert_eq!(d.dictionary().int(o::GUARD, 2), -7);
}

#[test]
fn a_short_write_without_its_size_is_as_long_as_its_object() {
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    for (index, sub, data, value) in [
        (o::MODE, 0, [10, 0xa5, 0xa5, 0xa5], 10),
        (o::GUARD, 2, [0xf9, 0xff, 0xa5, 0xa5], -7),
        (o::GUARD, 1, [0x30, 0x75, 0, 0], 30_000),
    ] {
        let request = Request::Download { index, sub, start: Start::Expedited(None, data) }.encode();
        assert_eq!(request[0], 0x22, "e = 1, s = 0");
        assert_eq!(ask(&mut d, request), Response::Download { index, sub }.encode());
        assert_eq!(d.dictionary().int(index, sub), value);
    }
    // A string has no length of its own: what is there is it.
    let start = Start::Expedited(None, *b"arm1");
    ask(&mut d, Request::Download { index: LABEL, sub: 0, start }.encode());
    assert_eq!(transfer(&mut d, LABEL, 0, None), Outcome::Done(b"arm1".to_vec()));
}

#[test]
fn long_strings_travel_in_segments_both_ways() {
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    let label = b"segment 3, cable 5, a rather long label";
    assert_eq!(transfer(&mut d, 0x2001, 0, Some(label)), Outcome::Done(vec![]));
    assert_eq!(transfer(&mut d, 0x2001, 0, None), Outcome::Done(label.to_vec()));
}

macro_rules! with_both_layouts {
    ($($claim:ident)*) => {
        mod classic {
            $(#[test] fn $claim() { super::$claim(super::Layout::Classic) })*
        }
        mod packed {
            $(#[test] fn $claim() { super::$claim(super::Layout::Packed) })*
        }
    };
}

with_both_layouts! {
    twenty_four_drives_on_four_buses_go_from_power_up_to_torque_and_back
    a_torque_counts_from_the_next_sync_on_and_not_before
    torque_beyond_the_limit_is_cut_and_reported_by_both_sides
    ordered_disabling_takes_one_drive_after_the_other
    a_lost_master_takes_the_torque_to_the_safe_value_and_the_fault_is_latched
    a_drive_that_keeps_its_torque_without_a_master_lets_go_of_it_slowly_before_it_is_reset
    a_safe_torque_beyond_the_rated_one_is_taken_and_held_within_the_limit
    a_missing_sync_is_a_fault_within_its_timeout
    quick_stop_brakes_along_the_slope
    a_device_fault_is_reported_and_the_drive_is_not_driven_back
    a_device_fault_cuts_the_safe_torque_of_a_communication_fault_too
    what_is_wrong_at_start_is_named
    a_drive_that_restarts_or_falls_silent_is_a_fault
    a_lost_answer_is_named_in_the_next_cycle
    frames_that_a_bus_does_not_take_are_counted_and_its_drives_keep_their_torques
}

/// Payloads of classic and of CAN FD frames.
fn any_payload() -> impl Strategy<Value = (Kind, Vec<u8>)> {
    let bytes = |most| proptest::collection::vec(any::<u8>(), 0..=most);
    prop_oneof![
        bytes(8).prop_map(|data| (Kind::Classic, data)),
        bytes(64).prop_map(|data| (Kind::Fd { bit_rate_switch: true }, data)),
    ]
}

proptest! {
    #[test]
    fn arbitrary_frames_neither_panic_a_drive_nor_give_torque_beyond_its_limit(
        packed: bool,
        frames in proptest::collection::vec((0u16..0x800, any_payload()), 0..200)
    ) {
        let mut d = Drive::new(node(1), Nameplate::default(), 0);
        let (layout, rpdo) = if packed { (Layout::Packed, 0x200) } else { (Layout::Classic, 0x201) };
        configure(&mut d, layout, 1);
        for (i, (id, (kind, data))) in frames.iter().enumerate() {
            // Half of them at the identifiers that the drive listens to.
            let id = if i % 2 == 0 { *id } else { [0, 0x80, rpdo, 0x601, 0x77f][i / 2 % 5] };
            d.on_frame(&Frame::new(Id::Standard(id), *kind, data).unwrap(), i as u64 * MS);
            while d.pop().is_some() {}
            let limit = d.dictionary().int(o::MAX_TORQUE, 0);
            prop_assert!(i64::from(d.torque_permille()).abs() <= limit.max(1000));
            if d.state() != State::OperationEnabled && d.state() != State::QuickStopActive
                && d.state() != State::FaultReactionActive && d.dictionary().int(o::GUARD, 2) == 0 {
                prop_assert_eq!(d.torque_permille(), 0);
            }
        }
        // A reset of the node brings back everything.
        d.on_frame(&NmtCommand::ResetNode.encode(None), 1000 * MS);
        let fresh = dictionary(1, Nameplate::default());
        for e in fresh.descriptions().filter(|e| e.index != o::STATUSWORD) {
            prop_assert_eq!(d.dictionary().read(e.index, e.sub), fresh.read(e.index, e.sub));
        }
        prop_assert_eq!(d.nmt(), NmtState::PreOperational);
    }

    #[test]
    fn arbitrary_frames_panic_neither_master_nor_decoder(
        packed: bool,
        frames in proptest::collection::vec((0u16..0x800, any_payload()), 0..100)
    ) {
        let layout = if packed { Layout::Packed } else { Layout::Classic };
        let mut b = Bench::new(layout, 1, 2, |_| {});
        for _ in 0..20 { b.step(); }
        for (id, (kind, data)) in &frames {
            let frame = Frame::new(Id::Standard(*id), *kind, data).unwrap();
            let received = Received { frame, time_ns: b.now_ns };
            b.master.on_frame(0, &received, b.now_ns);
            b.decoder.on_frame(0, &received);
            b.step();
        }
        prop_assert!(b.master.status().all(|s| s.phase != Phase::Waiting));
    }
}
