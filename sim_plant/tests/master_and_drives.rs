//! The master's half of CiA 402 against the drives' half, on a bus in memory, in lockstep: the clock is a number.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

use proptest::prelude::*;
use sim_plant::drive::objects::{PRODUCT, dictionary};
use sim_plant::drive::{Drive, DriveBank, Nameplate};
use sinew_hal::can::{BusCounters, BusState, CanBus, Filter, Frame, Id, ReceiveError, Received, SendError};
use sinew_hal::canopen::emcy::{code, register};
use sinew_hal::canopen::sdo_client::{Outcome, SdoClient, SdoError};
use sinew_hal::canopen::{AbortCode, NmtCommand, NmtState, NodeId};
use sinew_hal::cia402::objects as o;
use sinew_hal::cia402::state::Command;
use sinew_hal::cia402::{
    CycleWriter, Decoder, DriveMask, DriveSetup, Event, Fault, Goal, Master, MasterConfig, ObjectWrite, Order, Phase,
    Progress, State,
};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const MS: u64 = 1_000_000;

/// A bus in memory: every handle has a queue, a frame goes into all queues but the sender's.
struct MemoryBus {
    queues: Arc<Mutex<Vec<VecDeque<Received>>>>,
    me: usize,
}

impl MemoryBus {
    fn new() -> Self {
        Self { queues: Arc::new(Mutex::new(vec![VecDeque::new()])), me: 0 }
    }
    fn handle(&self) -> Self {
        let mut q = self.queues.lock().unwrap();
        q.push(VecDeque::new());
        Self { queues: self.queues.clone(), me: q.len() - 1 }
    }
}

impl CanBus for MemoryBus {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        for (i, q) in self.queues.lock().unwrap().iter_mut().enumerate() {
            if i != self.me {
                q.push_back(Received { frame: *frame, time_ns: 0 });
            }
        }
        Ok(())
    }
    fn receive(&mut self, _: Duration) -> Result<Option<Received>, ReceiveError> {
        Ok(self.queues.lock().unwrap()[self.me].pop_front())
    }
    fn state(&self) -> BusState {
        BusState::ErrorActive
    }
    fn counters(&self) -> BusCounters {
        BusCounters::default()
    }
    fn set_filters(&mut self, _: &[Filter]) -> Result<(), ReceiveError> {
        Ok(())
    }
    fn duplicate(&self) -> std::io::Result<Box<dyn CanBus>> {
        Ok(Box::new(self.handle()))
    }
}

fn node(n: u8) -> NodeId {
    NodeId::new(n).unwrap()
}

/// Master, drives and the receive side on any number of buses.
struct Bench {
    now_ns: u64,
    master: Master,
    banks: Vec<(MemoryBus, DriveBank)>,
    receivers: Vec<MemoryBus>,
    decoder: Decoder,
    events: Vec<Event>,
}

impl Bench {
    fn new(buses: usize, per_bus: u8, adjust: impl FnOnce(&mut MasterConfig)) -> Self {
        let mut drives = Vec::new();
        for bus in 0..buses {
            for n in 1..=per_bus {
                let mut d = DriveSetup::new(bus, node(n));
                d.identity.product = Some(PRODUCT);
                d.rated_torque_mnm = Some(5000);
                d.writes = ObjectWrite::sinew_guard(30_000, 0).to_vec();
                drives.push(d);
            }
        }
        let mut config = MasterConfig::new(drives, node(127), 10_000);
        adjust(&mut config);
        let wires: Vec<_> = (0..buses).map(|_| MemoryBus::new()).collect();
        let banks = wires
            .iter()
            .map(|w| {
                (
                    w.handle(),
                    DriveBank::new((1..=per_bus).map(|n| Drive::new(node(n), Nameplate::default(), 0)).collect()),
                )
            })
            .collect();
        let receivers = wires.iter().map(MemoryBus::handle).collect();
        let handles = wires.into_iter().map(|w| Box::new(w) as Box<dyn CanBus>).collect();
        let mut master = Master::new(config, handles).unwrap();
        let decoder = master.decoder();
        master.start(0);
        Self { now_ns: 0, master, banks, receivers, decoder, events: Vec::new() }
    }

    /// One millisecond.
    fn step(&mut self) -> Progress {
        self.now_ns += MS;
        let now = self.now_ns;
        let progress = self.master.pump(now);
        self.serve();
        progress
    }

    fn serve(&mut self) {
        let now = self.now_ns;
        for (bus, bank) in &mut self.banks {
            while !matches!(bank.pump(bus, Duration::ZERO, &mut || now), sim_plant::drive::Pumped::Idle) {}
        }
        for (i, r) in self.receivers.iter_mut().enumerate() {
            while let Ok(Some(mut f)) = r.receive(Duration::ZERO) {
                f.time_ns = now;
                self.events.push(self.decoder.on_frame(i, &f));
            }
        }
    }

    fn run_until(&mut self, ms: u64, mut done: impl FnMut(&Progress) -> bool) -> Progress {
        for _ in 0..ms {
            let p = self.step();
            if done(&p) {
                return p;
            }
        }
        panic!("not reached: {:?} {:?}", self.step(), self.master.take_faults());
    }

    fn enable(&mut self) {
        self.run_until(3000, |p| p.at_goal);
        self.master.set_goal(Goal::Enabled, self.now_ns);
        self.run_until(1000, |p| p.at_goal);
    }

    fn drive(&mut self, bus: usize, i: usize) -> &mut Drive {
        &mut self.banks[bus].1.drives_mut()[i]
    }

    /// A cycle of the control thread, then 10 ms in which everything else runs.
    fn cycle(&mut self, writer: &mut CycleWriter, torques: &[i16]) {
        let report = writer.write_cycle(torques);
        assert!(report.not_sent.is_empty() && report.sync_not_sent == 0, "{report:?}");
        self.serve();
        for _ in 0..10 {
            self.step();
        }
    }
}

#[test]
fn twenty_four_drives_on_four_buses_go_from_power_up_to_torque_and_back() {
    let mut b = Bench::new(4, 6, |_| {});
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

#[test]
fn a_torque_counts_from_the_next_sync_on_and_not_before() {
    let mut b = Bench::new(1, 1, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[100]);
    let data = o::encode_rpdo1(Command::EnableOperation.controlword(), 300);
    let now = b.now_ns;
    let rpdo = Frame::classic(Id::Standard(0x201), &data).unwrap();
    let sync = Frame::classic(Id::Standard(0x80), &[]).unwrap();
    b.drive(0, 0).on_frame(&rpdo, now);
    assert_eq!(b.drive(0, 0).torque_permille(), 100);
    b.drive(0, 0).on_frame(&sync, now);
    assert_eq!(b.drive(0, 0).torque_permille(), 300);
}

#[test]
fn torque_beyond_the_limit_is_cut_and_reported_by_both_sides() {
    let mut b = Bench::new(1, 2, |c| c.drives[1].torque_permille_max = 400);
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    let report = writer.write_cycle(&[900, 900]);
    let mut second = DriveMask::default();
    second.insert(1);
    assert_eq!(report.limited, second);
    b.serve();
    assert_eq!((b.drive(0, 0).torque_permille(), b.drive(0, 1).torque_permille()), (900, 400));
}

#[test]
fn ordered_disabling_takes_one_drive_after_the_other() {
    let mut b = Bench::new(1, 3, |c| c.order_of_disabling = Order::OneByOneReversed);
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

#[test]
fn a_lost_master_takes_the_torque_to_the_safe_value_and_the_fault_is_latched() {
    for safe in [0, 30] {
        let mut b = Bench::new(1, 1, |c| c.drives[0].writes = ObjectWrite::sinew_guard(0, safe).to_vec());
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

#[test]
fn a_missing_sync_is_a_fault_within_its_timeout() {
    let mut b = Bench::new(1, 1, |_| {});
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

#[test]
fn quick_stop_brakes_along_the_slope() {
    let mut b = Bench::new(1, 1, |_| {});
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

#[test]
fn a_device_fault_is_reported_and_the_drive_is_not_driven_back() {
    let mut b = Bench::new(1, 2, |_| {});
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

#[test]
fn what_is_wrong_at_start_is_named() {
    // A node that is not there.
    let mut b = Bench::new(1, 1, |c| c.drives[0].node = node(9));
    b.run_until(6000, |p| p.failed == 1);
    assert!(
        matches!(b.master.take_faults()[..], [f] if f.node == node(9) && matches!(f.fault, Fault::NoBootUp { .. }))
    );
    // Another product.
    let mut b = Bench::new(1, 1, |c| c.drives[0].identity.product = Some(7));
    b.run_until(1000, |p| p.failed == 1);
    let wrong = Fault::Value { index: 0x1018, sub: 2, expected: 7, found: PRODUCT, mask: u32::MAX };
    assert_eq!(b.master.take_faults()[0].fault, wrong);
    // Another motor.
    let mut b = Bench::new(1, 1, |c| c.drives[0].rated_torque_mnm = Some(4000));
    b.run_until(1000, |p| p.failed == 1);
    assert!(matches!(b.master.take_faults()[0].fault, Fault::Value { index: 0x6076, expected: 4000, found: 5000, .. }));
    // A value that the drive refuses, and an object that it has not.
    for (index, sub, abort) in [(o::GUARD, 2, AbortCode::VALUE_HIGH), (0x2fff, 0, AbortCode::NO_OBJECT)] {
        let data = 2000i16.to_le_bytes().to_vec();
        let write = ObjectWrite { index, sub, data, optional: false };
        let mut b = Bench::new(1, 1, |c| c.drives[0].writes = vec![write]);
        b.run_until(1000, |p| p.failed == 1);
        let fault = b.master.take_faults()[0];
        let error = SdoError::Aborted(abort);
        assert_eq!(fault.fault, Fault::Sdo { index, sub, write: true, error });
        assert!(fault.to_string().contains(abort.words()), "{fault}");
    }
}

#[test]
fn a_drive_that_restarts_or_falls_silent_is_a_fault() {
    let mut b = Bench::new(1, 2, |_| {});
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

#[test]
fn a_lost_answer_is_named_in_the_next_cycle() {
    let mut b = Bench::new(1, 3, |_| {});
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

/// Runs one SDO transfer against a drive.
fn transfer(d: &mut Drive, index: u16, sub: u8, write: Option<&[u8]>) -> Outcome {
    let mut client = SdoClient::new(MS);
    let mut next = Some(match write {
        Some(data) => client.download(index, sub, data, 0),
        None => client.upload(index, sub, 0),
    });
    while let Some(p) = next.take() {
        d.on_frame(&Frame::classic(Id::Standard(0x601), &p).unwrap(), 0);
        while let Some(f) = d.pop() {
            if f.id() == Id::Standard(0x581) {
                let (outcome, send) = client.on_response(f.data(), 0);
                if outcome != Outcome::Pending {
                    return outcome;
                }
                next = send;
            }
        }
    }
    Outcome::Pending
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
    assert_eq!(write(0x1600, 0, &[9]), aborted(AbortCode::VALUE_HIGH));
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

#[test]
fn long_strings_travel_in_segments_both_ways() {
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    let label = b"segment 3, cable 5, a rather long label";
    assert_eq!(transfer(&mut d, 0x2001, 0, Some(label)), Outcome::Done(vec![]));
    assert_eq!(transfer(&mut d, 0x2001, 0, None), Outcome::Done(label.to_vec()));
}

proptest! {
    #[test]
    fn arbitrary_frames_neither_panic_a_drive_nor_give_torque_beyond_its_limit(
        frames in proptest::collection::vec((0u16..0x800, proptest::collection::vec(any::<u8>(), 0..9)), 0..200)
    ) {
        let mut d = Drive::new(node(1), Nameplate::default(), 0);
        for (i, (id, data)) in frames.iter().enumerate() {
            // Half of them at the identifiers that the drive listens to.
            let id = if i % 2 == 0 { *id } else { [0, 0x80, 0x201, 0x601, 0x77f][i / 2 % 5] };
            d.on_frame(&Frame::classic(Id::Standard(id), data).unwrap(), i as u64 * MS);
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
        frames in proptest::collection::vec((0u16..0x800, proptest::collection::vec(any::<u8>(), 0..9)), 0..100)
    ) {
        let mut b = Bench::new(1, 2, |_| {});
        for _ in 0..20 { b.step(); }
        for (id, data) in &frames {
            let frame = Frame::classic(Id::Standard(*id), data).unwrap();
            let received = Received { frame, time_ns: b.now_ns };
            b.master.on_frame(0, &received, b.now_ns);
            b.decoder.on_frame(0, &received);
            b.step();
        }
        prop_assert!(b.master.status().all(|s| s.phase != Phase::Waiting));
    }
}
