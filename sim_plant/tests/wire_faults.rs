//! Faults on the wire between the master and the drives, without arm and daemon: the start, which has SDO and NMT, and
//! what the drives do by themselves. Each test is a row of `hal/FAULTS.md`. The clock is a number: a period is 10 ms.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use bench::{MS, MemoryBus, node};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sim_plant::drive::{Drive, DriveBank, Nameplate, Pumped};
use sim_plant::wire::{WireFault, WireFaults};
use sinew_hal::can::{Frame, Id};
use sinew_hal::canopen::NmtState;
use sinew_hal::canopen::emcy::code;
use sinew_hal::canopen::sdo_client::SdoError;
use sinew_hal::cia402::{
    CycleWriter, DriveSetup, Fault, Goal, Layout, Master, MasterConfig, ObjectWrite, Order, Phase, Progress, State,
};
use sinew_hal::clock::Lockstep;
use sinew_hal::fault_shim::FaultShim;
use std::sync::Arc;
use std::time::Duration;

const PERIOD_MS: u64 = 10;
/// As shipped in `config/drives.toml`: SYNC 0.1 s, heartbeat 0.15 s.
const SYNC_TIMEOUT_US: u32 = 100_000;
const HEARTBEAT_TIMEOUT_MS: u16 = 150;
const NODES: [u8; 3] = [1, 2, 3];

/// A master, a wire with faults, three drives.
struct Bench {
    now_ns: u64,
    clock: Arc<Lockstep>,
    master: Master,
    wire: FaultShim<MemoryBus>,
    bank: DriveBank,
}

impl Bench {
    fn new(wire: &[&str], seed: u64) -> Self {
        Self::adjusted(|_| {}, wire, seed)
    }

    fn adjusted(adjust: impl FnOnce(&mut MasterConfig), wire: &[&str], seed: u64) -> Self {
        let setup = |n: &u8| {
            let mut d = DriveSetup::new(0, node(*n));
            d.writes = ObjectWrite::sinew_guard(SYNC_TIMEOUT_US, 0, false).to_vec();
            d
        };
        let mut config = MasterConfig::new(NODES.iter().map(setup).collect(), node(127), 10_000);
        config.heartbeat_timeout_ms = HEARTBEAT_TIMEOUT_MS;
        config.drive_heartbeat_timeout_ms = HEARTBEAT_TIMEOUT_MS;
        config.rpdo_timeout_ms = (SYNC_TIMEOUT_US / 1000) as u16;
        adjust(&mut config);
        let bus = MemoryBus::default();
        let clock = Arc::new(Lockstep::new(0));
        let bank = DriveBank::new(NODES.iter().map(|n| Drive::new(node(*n), Nameplate::default(), 0)).collect());
        let far = FaultShim::clean(bus.handle(), seed, clock.clone());
        let mut master = Master::new(config, vec![Box::new(bus)]).unwrap();
        master.start(0);
        let mut bench = Self { now_ns: 0, clock, master, wire: far, bank };
        bench.disturb(wire);
        bench
    }

    /// From now on these faults, none if empty.
    fn disturb(&mut self, wire: &[&str]) {
        let faults: Vec<WireFault> = wire.iter().map(|f| f.parse().unwrap()).collect();
        let mut faults = WireFaults::new(faults);
        faults.advance_to(0.0);
        let plans = faults.plans(&NODES, Duration::from_millis(PERIOD_MS));
        self.wire.set_plans(&plans, &plans).unwrap();
    }

    fn disturbed(&self) -> u64 {
        let (a, b) = self.wire.counts();
        [a, b].iter().map(|c| c.dropped + c.corrupted + c.duplicated + c.reordered + c.delayed).sum()
    }

    fn serve(&mut self) {
        let now = self.now_ns;
        while self.bank.pump(&mut self.wire, Duration::ZERO, &mut || now) != Pumped::Idle {}
    }

    /// One millisecond.
    fn step(&mut self) -> Progress {
        self.now_ns += MS;
        self.clock.advance_to(self.now_ns);
        let progress = self.master.pump(self.now_ns);
        self.serve();
        progress
    }

    fn run_ms(&mut self, ms: u32) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// Milliseconds until a condition holds.
    fn until(&mut self, what: &str, most_ms: u64, done: impl Fn(&Progress) -> bool) -> u64 {
        for ms in 1..=most_ms {
            if done(&self.step()) {
                return ms;
            }
        }
        panic!("{what}: {:?} {:?}", self.step(), self.master.take_faults());
    }

    /// All drives give torque; the control loop's sender.
    fn enabled(wire_later: &[&str]) -> (Self, CycleWriter) {
        Self::enabled_with(Layout::Classic, wire_later)
    }

    fn enabled_with(layout: Layout, wire_later: &[&str]) -> (Self, CycleWriter) {
        Self::enabled_as(|c| c.layouts = vec![layout], wire_later)
    }

    fn enabled_as(adjust: impl FnOnce(&mut MasterConfig), wire_later: &[&str]) -> (Self, CycleWriter) {
        let mut b = Self::adjusted(adjust, &[], 1);
        b.until("operational", 3000, |p| p.at_goal);
        b.master.set_goal(Goal::Enabled, b.now_ns);
        b.until("enabled", 1000, |p| p.at_goal);
        let mut writer = b.master.take_writer().unwrap();
        (0..30).for_each(|_| b.cycle(&mut writer));
        assert_eq!((b.torques(), b.master.take_faults()), ([500; 3], vec![]));
        b.disturb(wire_later);
        (b, writer)
    }

    /// A period of the control loop.
    fn cycle(&mut self, writer: &mut CycleWriter) {
        writer.write_cycle(&[500; 3]);
        self.serve();
        for _ in 0..PERIOD_MS {
            self.step();
        }
    }

    fn torques(&self) -> [i16; 3] {
        std::array::from_fn(|i| self.bank.drives()[i].torque_permille())
    }

    /// Periods until no drive gives torque any more.
    fn periods_to_rest(&mut self, writer: &mut CycleWriter) -> u32 {
        (1..200)
            .find(|_| {
                self.cycle(writer);
                self.torques() == [0; 3]
            })
            .expect("the drives never went safe")
    }

    /// With all frames there again drives that went safe stay so, and obey after a reset.
    fn stays_safe_until_reset(&mut self, mut writer: CycleWriter) {
        self.disturb(&[]);
        (0..50).for_each(|_| self.cycle(&mut writer));
        assert_eq!(self.torques(), [0; 3]);
        assert!(self.bank.drives().iter().all(|d| d.state() == State::Fault));
        self.master.return_writer(writer);
        self.master.reset_faults(self.now_ns);
        self.until("reset", 500, |p| p.at_goal);
        self.master.set_goal(Goal::Enabled, self.now_ns);
        self.until("enabled again", 500, |p| p.enabled == 3);
    }

    /// On a good wire, all come up.
    fn starts_anew(&mut self) {
        self.disturb(&[]);
        self.master.start(self.now_ns);
        self.until("operational", 10_000, |p| p.at_goal);
    }

    fn codes(&mut self) -> Vec<u16> {
        let faults = self.master.take_faults();
        let code = |f: &sinew_hal::cia402::DriveFault| match f.fault {
            Fault::Emergency(e) => Some(e.code),
            _ => None,
        };
        faults.iter().filter_map(code).collect()
    }
}

// ---- what the drives do by themselves ----

#[test]
fn drives_without_sync_go_safe() {
    let (mut b, mut writer) = Bench::enabled(&["drop:sync"]);
    // 100 ms after the last SYNC, which was a period ago, then down the slope of 10,000 per mille a second.
    assert_eq!(b.periods_to_rest(&mut writer), 14);
    assert_eq!(b.codes(), [code::SYNC_TIMEOUT; 3]);
    assert!(b.bank.drives().iter().all(|d| d.state() == State::Fault));
}

#[test]
fn drives_without_torques_go_safe() {
    for layout in [Layout::Classic, Layout::Packed] {
        let (mut b, mut writer) = Bench::enabled_with(layout, &["drop:rpdo"]);
        assert_eq!(b.bank.drives()[2].dictionary().int(0x1400, 5), 100);
        assert_eq!(b.periods_to_rest(&mut writer), 14);
        assert_eq!(b.codes(), [code::RPDO_TIMEOUT; 3], "SYNC and heartbeat go on");
        b.stays_safe_until_reset(writer);
    }
}

#[test]
fn a_drive_without_its_torques_goes_safe_alone() {
    let (mut b, mut writer) = Bench::enabled(&["drop:rpdo.2"]);
    (0..30).for_each(|_| b.cycle(&mut writer));
    assert_eq!(b.torques(), [500, 0, 500]);
    assert_eq!(b.codes(), [code::RPDO_TIMEOUT]);
}

#[test]
fn torques_are_expected_from_the_first_one_on() {
    // Operational for long before anything is sent, and silent again while there is no torque: no fault.
    let mut b = Bench::new(&["drop:rpdo"], 1);
    b.until("operational", 3000, |p| p.ready == 3);
    b.run_ms(500);
    b.disturb(&[]);
    b.run_ms(50);
    b.disturb(&["drop:rpdo"]);
    b.run_ms(500);
    assert_eq!(b.master.take_faults(), []);
    assert!(b.bank.drives().iter().all(|d| d.state() == State::SwitchOnDisabled));
}

#[test]
fn drives_without_heartbeat_go_safe() {
    let (mut b, mut writer) = Bench::enabled(&["drop:master"]);
    let periods = b.periods_to_rest(&mut writer);
    assert!((15..=21).contains(&periods), "150 ms after the last heartbeat, and 50 ms of slope: {periods}");
    assert_eq!(b.codes(), [code::HEARTBEAT; 3]);
}

#[test]
fn drives_on_a_lost_bus_go_safe_latch_it_and_obey_again_after_a_reset() {
    let (mut b, mut writer) = Bench::enabled(&["drop"]);
    assert_eq!(b.periods_to_rest(&mut writer), 14);
    assert!(b.bank.drives().iter().all(|d| d.state() == State::Fault));
    b.stays_safe_until_reset(writer);
}

#[test]
fn a_lost_torque_is_replaced_by_the_next() {
    let (mut b, mut writer) = Bench::enabled(&["drop:rpdo.2"]);
    writer.write_cycle(&[600; 3]);
    b.serve();
    assert_eq!(b.torques(), [600, 500, 600], "kept for a period");
    b.disturb(&[]);
    writer.write_cycle(&[700; 3]);
    b.serve();
    assert_eq!(b.torques(), [700; 3]);
}

// ---- switching off ----

/// Milliseconds from the wish until each drive is off, the last one first, with these faults on the wire since long ago.
fn off_after_ms(wire: &[&str]) -> ([Option<u64>; 3], Bench, CycleWriter) {
    let in_order = |c: &mut MasterConfig| c.order_of_disabling = Order::OneByOneReversed;
    let (mut b, mut writer) = Bench::enabled_as(in_order, wire);
    // Until whoever is not heard is known not to be.
    (0..30).for_each(|_| b.cycle(&mut writer));
    b.master.set_goal(Goal::Disabled, b.now_ns);
    let begun_ns = b.now_ns;
    let mut off = [None; 3];
    for _ in 0..200 {
        writer.write_cycle(&[500; 3]);
        b.serve();
        for _ in 0..PERIOD_MS {
            b.step();
            for (off, drive) in off.iter_mut().zip(b.bank.drives()) {
                if off.is_none() && drive.state() == State::SwitchOnDisabled {
                    *off = Some((b.now_ns - begun_ns) / MS);
                }
            }
        }
    }
    (off, b, writer)
}

#[test]
fn dead_drives_do_not_hold_up_the_disabling_of_the_others() {
    let (all, ..) = off_after_ms(&[]);
    let step = all[1].unwrap() - all[2].unwrap();
    assert!(step >= PERIOD_MS && all[0].unwrap() == all[1].unwrap() + step, "one after the other: {all:?}");
    // The last two are dead; the first is off as soon as the last would have been, and not seconds later.
    let (off, mut b, _) = off_after_ms(&["drop:all.2", "drop:all.3"]);
    assert_eq!(off[0], all[2]);
    // Each dead one is named with the time, all the same.
    let faults = b.master.take_faults();
    for drive in [1, 2] {
        let lost = |f: &Fault| matches!(f, Fault::HeartbeatLost { .. });
        let stays = |f: &Fault| matches!(f, Fault::Transition { found: State::OperationEnabled, .. });
        assert!(faults.iter().any(|f| f.drive == drive && lost(&f.fault)), "{faults:?}");
        assert!(faults.iter().any(|f| f.drive == drive && stays(&f.fault)), "{faults:?}");
    }
}

#[test]
fn drives_without_feedback_lose_their_power_and_hold_nobody_up() {
    let (all, ..) = off_after_ms(&[]);
    let (off, b, _) = off_after_ms(&["drop:tpdo.2", "drop:tpdo.3"]);
    assert_eq!(off[0], all[2]);
    // Torque is off at once; that a transition does not show is known after its time, and then the power goes too.
    let timeout_ms = u64::from(b.master.config().transition_timeout_ms);
    for off in [off[1].unwrap(), off[2].unwrap()] {
        assert!((timeout_ms..timeout_ms + 3 * PERIOD_MS).contains(&off), "{off}");
    }
}

// ---- SDO at the start ----

/// The drives come up in spite of it.
fn starts_with(wire: &[&str], seed: u64) {
    let mut b = Bench::new(wire, seed);
    b.until("operational", 20_000, |p| p.at_goal);
    assert!(b.disturbed() > 0, "no frame was hit");
    assert_eq!(b.master.take_faults(), []);
}

#[test]
fn sdo_lost_now_and_then() {
    for seed in 1..=5 {
        starts_with(&["drop:sdo=0.02"], seed);
    }
}

#[test]
fn sdo_lost_for_good() {
    let mut b = Bench::new(&["drop:sdo.2"], 1);
    // Three attempts of 100 ms for the first object, and as long a silence between two of them.
    let ms = b.until("one drive failed", 1000, |p| p.failed == 1);
    assert!((500..=510).contains(&ms), "{ms}");
    let faults = b.master.take_faults();
    let timeout = matches!(faults[0].fault, Fault::Sdo { error: SdoError::Timeout { .. }, .. });
    assert!(faults.len() == 1 && faults[0].drive == 1 && timeout, "{faults:?}");
    // Started anew without the fault, all come up.
    b.starts_anew();
}

#[test]
fn sdo_late_by_a_period() {
    starts_with(&["delay:sdo"], 1);
}

#[test]
fn sdo_of_a_slow_drive() {
    // The drives' processor is away now and then, for longer than an answer may take: answers come late and in order.
    let mut late = 0;
    for seed in 1..=20 {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut b = Bench::new(&[], seed);
        let mut away_until = 0;
        for ms in 0u64.. {
            assert!(ms < 60_000, "seed {seed}: {:?}", b.master.take_faults());
            b.now_ns += MS;
            b.clock.advance_to(b.now_ns);
            let progress = b.master.pump(b.now_ns);
            if ms >= away_until {
                b.serve();
            }
            // No further one before it can have been made up for.
            if ms > away_until + 600 && rng.random_bool(0.02) {
                away_until = ms + rng.random_range(50..350);
            }
            if b.master.status().all(|s| !matches!(s.phase, Phase::Booting | Phase::Configuring)) {
                assert_eq!(progress.failed, 0, "seed {seed}: {:?}", b.master.take_faults());
                break;
            }
        }
        late += b.master.status().map(|s| s.sdo_ignored).sum::<u64>();
        for d in b.bank.drives() {
            assert_eq!(d.dictionary().int(0x1400, 5), 100, "seed {seed}");
            assert_eq!(d.dictionary().int(0x2000, 1), i64::from(SYNC_TIMEOUT_US), "seed {seed}");
        }
    }
    assert!(late > 20, "no answer was late: {late}");
}

#[test]
fn sdo_twice() {
    starts_with(&["duplicate:sdo"], 1);
}

#[test]
fn sdo_out_of_order() {
    for seed in 1..=5 {
        starts_with(&["reorder:sdo=0.1"], seed);
    }
}

#[test]
fn sdo_spoilt() {
    // A value that was spoilt is found when it is read back: what comes up is configured as wanted, or named.
    for seed in 1..=20 {
        let mut b = Bench::new(&["corrupt:sdo=0.02"], seed);
        b.until("an end", 30_000, |p| p.ready + p.failed == 3);
        let faults = b.master.take_faults();
        for (i, d) in b.bank.drives().iter().enumerate() {
            if faults.iter().all(|f| f.drive != i) {
                assert_eq!(d.dictionary().int(0x2000, 1), i64::from(SYNC_TIMEOUT_US), "seed {seed}");
                assert_eq!(d.dictionary().int(0x1016, 1) & 0xffff, i64::from(HEARTBEAT_TIMEOUT_MS), "seed {seed}");
                assert_eq!(d.dictionary().int(0x6060, 0), 10, "seed {seed}");
            }
        }
    }
}

// ---- NMT at the start ----

#[test]
fn nmt_reset_lost() {
    let mut b = Bench::new(&["drop:nmt"], 1);
    // The boot-up of power-up is as good as that of the reset; it is the start that is missing then.
    let ms = b.until("failed", 7000, |p| p.failed == 3);
    let faults = b.master.take_faults();
    let expected = NmtState::Operational;
    assert!(faults.iter().all(|f| matches!(f.fault, Fault::Nmt { expected: e, .. } if e == expected)), "{faults:?}");
    assert!((1000..2000).contains(&ms), "a second after the configuration: {ms}");
    b.starts_anew();
}

#[test]
fn nmt_late_twice_or_out_of_order() {
    for wire in ["delay:nmt", "duplicate:nmt", "reorder:nmt"] {
        starts_with(&[wire], 1);
    }
}

#[test]
fn nmt_spoilt() {
    let mut b = Bench::new(&["corrupt:nmt"], 1);
    b.until("an end", 10_000, |p| p.ready + p.failed == 3);
    // Another node's number or command: nobody is operational who should not be, and who is missing is named.
    let (ready, faults) = (b.step().ready, b.master.take_faults());
    assert_eq!(ready + faults.iter().map(|f| f.drive).collect::<std::collections::BTreeSet<_>>().len(), 3);
    b.starts_anew();
}

#[test]
fn boot_up_lost() {
    let mut b = Bench::new(&["drop:heartbeat.2"], 1);
    let ms = b.until("one drive failed", 7000, |p| p.failed == 1);
    assert!((5000..=5002).contains(&ms), "{ms}");
    assert!(matches!(b.master.take_faults()[..], [f] if f.drive == 1 && matches!(f.fault, Fault::NoBootUp { .. })));
}

// ---- anything at all ----

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever the wire does to the start: the master ends each drive ready or failed with a fault that says so, and
    /// started anew on a good wire all come up.
    #[test]
    fn a_start_on_any_wire_ends_and_can_be_repeated(
        seed: u64,
        drop in 0.0f64..0.2,
        corrupt in 0.0f64..0.05,
        duplicate in 0.0f64..0.2,
        reorder in 0.0f64..0.2,
        delay in 0.0f64..0.2,
    ) {
        let wire = [
            format!("drop={drop}"),
            format!("corrupt={corrupt}"),
            format!("duplicate={duplicate}"),
            format!("reorder={reorder}"),
            format!("delay3={delay}"),
        ];
        let wire: Vec<&str> = wire.iter().map(String::as_str).collect();
        let mut b = Bench::new(&wire, seed);
        b.until("an end", 30_000, |p| p.ready + p.failed == 3);
        let failed = b.step().failed;
        let faults = b.master.take_faults();
        prop_assert!(failed == 0 || !faults.is_empty());
        b.starts_anew();
    }

    /// Arbitrary frames at drives that give torque: no panic, and never more torque than the limit.
    #[test]
    fn arbitrary_frames_never_make_a_drive_exceed_its_limit(
        frames in proptest::collection::vec((0u16..0x800, proptest::collection::vec(any::<u8>(), 0..9)), 0..200)
    ) {
        let (mut b, _writer) = Bench::enabled(&[]);
        for (id, data) in frames {
            let frame = Frame::classic(Id::Standard(id), &data).unwrap();
            b.bank.on_frame(&frame, b.now_ns);
            for d in b.bank.drives() {
                let limit = d.dictionary().int(0x6072, 0);
                prop_assert!(i64::from(d.torque_permille()).abs() <= limit.max(1000));
            }
        }
    }
}
