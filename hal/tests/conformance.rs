//! Claims that every backend of `CanBus` keeps, written once and made for each.
//!
//! The virtual bus is tested always. SocketCAN is tested where `SINEW_VCAN` names an interface that is up and of MTU 72
//! (`ip link add vcan0 type vcan; ip link set vcan0 mtu 72 up`) and that nobody else uses; loss of the link in addition
//! where the test may take that interface down.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a helper that fails is a test that fails

use std::collections::BTreeMap;
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sinew_hal::bus_config::{BusKind, BusSpec, OpenError, Restart, open};
use sinew_hal::can::{BusCounters, BusState, CanBus, Filter, Frame, Id, Kind, ReceiveError, Received, SendError};
use sinew_hal::canopen::NodeId;
use sinew_hal::cia402::objects::encode_rpdo1;
use sinew_hal::cia402::{DriveSetup, Layout, Master, MasterConfig};
use sinew_hal::clock::monotonic_ns;
use sinew_hal::virtual_bus::VirtualBus;

/// Long enough for any machine; a claim that holds never waits for it.
const WAIT: Duration = Duration::from_secs(10);
/// Long enough that a frame on its way would have come.
const QUIET: Duration = Duration::from_millis(30);

/// One bus under test.
struct Bench {
    spec: BusSpec,
    /// An interface is shared by all tests, so they take turns.
    _turn: Option<MutexGuard<'static, ()>>,
}

impl Bench {
    fn virtual_bus(claim: &str) -> Option<Self> {
        Some(Self { spec: spec(BusKind::Virtual, &format!("conformance-{claim}-{}", std::process::id())), _turn: None })
    }

    fn socketcan(claim: &str) -> Option<Self> {
        static TURN: Mutex<()> = Mutex::new(());
        let Ok(interface) = std::env::var("SINEW_VCAN") else {
            eprintln!("{claim}: SINEW_VCAN names no interface, SocketCAN not tested");
            return None;
        };
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        Some(Self { spec: spec(BusKind::Socketcan, &interface), _turn: Some(turn) })
    }

    fn open(&self) -> Box<dyn CanBus> {
        open(&self.spec).unwrap_or_else(|e| panic!("{e}"))
    }

    fn open_classic(&self) -> Box<dyn CanBus> {
        open(&BusSpec { fd: false, ..self.spec.clone() }).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Takes the bus down or up for everybody; false if the test may not.
    fn set_up(&self, up: bool) -> bool {
        match self.spec.kind {
            BusKind::Virtual => {
                let state = if up { BusState::ErrorActive } else { BusState::Down };
                VirtualBus::open(&self.spec.name, false).unwrap().set_state(state);
                true
            }
            BusKind::Socketcan => Command::new("ip")
                .args(["link", "set", &self.spec.name, if up { "up" } else { "down" }])
                .status()
                .is_ok_and(|s| s.success()),
        }
    }
}

fn spec(kind: BusKind, name: &str) -> BusSpec {
    let restart =
        Restart::Reopen { first: Duration::from_millis(5), longest: Duration::from_millis(50), cycle_interface: false };
    BusSpec { fd: true, restart, ..BusSpec::new(kind, name) }
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::classic(Id::Standard(id), data).unwrap()
}

fn next(bus: &mut dyn CanBus) -> Received {
    bus.receive(WAIT).unwrap().expect("no frame came")
}

/// Frames of every kind, identifier width and length that the wire has.
fn all_kinds() -> Vec<Frame> {
    let mut all = Vec::new();
    let bytes: Vec<u8> = (0..64).map(|i| 0xff - i).collect();
    for id in [Id::Standard(0), Id::Standard(0x7ff), Id::Extended(0), Id::Extended(0x7ff), Id::Extended(0x1fff_ffff)] {
        for len in 0..=8 {
            all.push(Frame::new(id, Kind::Classic, &bytes[..len]).unwrap());
            all.push(Frame::new(id, Kind::Remote, &bytes[..len]).unwrap());
        }
        for len in [0, 1, 8, 12, 16, 20, 24, 32, 48, 64] {
            for bit_rate_switch in [false, true] {
                all.push(Frame::new(id, Kind::Fd { bit_rate_switch }, &bytes[..len]).unwrap());
            }
        }
    }
    all
}

fn frames_of_every_kind_arrive_unchanged_and_in_order(bench: &Bench) {
    let (mut a, mut b) = (bench.open(), bench.open());
    for chunk in all_kinds().chunks(20) {
        chunk.iter().for_each(|f| a.send(f).unwrap());
        for f in chunk {
            assert_eq!(next(&mut *b).frame, *f);
        }
    }
}

fn a_sender_does_not_hear_itself_but_everybody_else_does(bench: &Bench) {
    let (mut a, mut b, mut c) = (bench.open(), bench.open(), bench.open());
    let mut a2 = a.duplicate().unwrap();
    a.send(&frame(1, &[1])).unwrap();
    b.send(&frame(2, &[2])).unwrap();
    assert_eq!(next(&mut *a).frame, frame(2, &[2]));
    assert_eq!(next(&mut *b).frame, frame(1, &[1]));
    for both in [&mut c, &mut a2] {
        assert_eq!(next(&mut **both).frame, frame(1, &[1]));
        assert_eq!(next(&mut **both).frame, frame(2, &[2]));
    }
    for all in [&mut a, &mut b, &mut c, &mut a2] {
        assert_eq!(all.receive(QUIET), Ok(None));
    }
}

fn all_receivers_see_the_frames_of_several_senders_in_one_order(bench: &Bench) {
    // Together no more than a socket's default receive buffer holds: nothing may be lost here.
    const EACH: u16 = 60;
    let mut receivers = [bench.open(), bench.open()];
    let senders: Vec<_> = (0..3_u16)
        .map(|s| {
            let mut bus = bench.open();
            std::thread::spawn(move || {
                for i in 0..EACH {
                    while bus.send(&frame(s, &i.to_le_bytes())) == Err(SendError::Full) {
                        std::thread::yield_now();
                    }
                }
                // What waits in a queue of this handle goes out at its calls.
                let _ = bus.receive(Duration::from_millis(1));
            })
        })
        .collect();
    let seen: Vec<Vec<Frame>> =
        receivers.iter_mut().map(|r| (0..3 * EACH).map(|_| next(&mut **r).frame).collect()).collect();
    senders.into_iter().for_each(|s| s.join().unwrap());
    // A vcan, unlike a wire, delivers what two processors send at once on both, so there the receivers agree only on
    // the order of each sender.
    if bench.spec.kind == BusKind::Virtual {
        assert_eq!(seen[0], seen[1]);
    }
    for frames in seen {
        let mut last = BTreeMap::new();
        for f in frames {
            let number = u16::from_le_bytes(f.data().try_into().unwrap());
            let before = last.insert(f.id(), number);
            assert!(before.map_or(number == 0, |b| b + 1 == number), "{f:?} after {before:?}");
        }
    }
}

fn a_handle_hears_only_what_is_sent_after_it_was_opened(bench: &Bench) {
    let mut a = bench.open();
    let _keeps_the_bus_alive = bench.open();
    a.send(&frame(1, &[])).unwrap();
    let mut late = bench.open();
    a.send(&frame(2, &[])).unwrap();
    assert_eq!(next(&mut *late).frame, frame(2, &[]));
}

fn filters_pass_what_any_of_them_matches(bench: &Bench) {
    let (mut a, mut b) = (bench.open(), bench.open());
    let heard = |a: &mut dyn CanBus, b: &mut dyn CanBus| {
        let extended = Frame::classic(Id::Extended(0x181), &[]).unwrap();
        for id in [0x080, 0x181, 0x182, 0x1ff, 0x200, 0x701, 0x77f, 0x7ff] {
            a.send(&frame(id, &[])).unwrap();
        }
        a.send(&extended).unwrap();
        let mut ids = Vec::new();
        while let Some(r) = b.receive(QUIET).unwrap() {
            ids.push(r.frame.id());
        }
        ids
    };
    let standard = |ids: &[u16]| ids.iter().map(|&i| Id::Standard(i)).collect::<Vec<_>>();
    b.set_filters(&[Filter { value: 0x180, mask: 0x780 }, Filter { value: 0x701, mask: 0x7ff }]).unwrap();
    assert_eq!(heard(&mut *a, &mut *b), standard(&[0x181, 0x182, 0x1ff, 0x701]));
    // A duplicate has the filters of its original, and then its own.
    let mut c = b.duplicate().unwrap();
    c.send(&frame(0x300, &[])).unwrap();
    assert_eq!(b.receive(QUIET), Ok(None), "0x300 passed");
    b.set_filters(&[Filter { value: 0x200, mask: 0x7ff }]).unwrap();
    assert_eq!(heard(&mut *a, &mut *b), standard(&[0x200]));
    let mut of_c = Vec::new();
    while let Some(r) = c.receive(Duration::ZERO).unwrap() {
        of_c.push(r.frame.id());
    }
    assert_eq!(of_c, standard(&[0x181, 0x182, 0x1ff, 0x701]));
    b.set_filters(&[]).unwrap();
    assert_eq!(heard(&mut *a, &mut *b).len(), 9);
    // A filter passes the remote requests of its identifiers too.
    b.set_filters(&[Filter { value: 0x123, mask: 0x7ff }]).unwrap();
    let remote = Frame::new(Id::Standard(0x123), Kind::Remote, &[0; 4]).unwrap();
    a.send(&remote).unwrap();
    assert_eq!(next(&mut *b).frame, remote);
}

fn a_classic_handle_neither_sends_nor_hears_fd_frames(bench: &Bench) {
    let (mut fd, mut classic) = (bench.open(), bench.open_classic());
    let long = Frame::new(Id::Standard(1), Kind::Fd { bit_rate_switch: true }, &[1; 64]).unwrap();
    assert_eq!(classic.send(&long), Err(SendError::Unsupported));
    fd.send(&long).unwrap();
    fd.send(&frame(2, &[2])).unwrap();
    assert_eq!(next(&mut *classic).frame, frame(2, &[2]));
    classic.send(&frame(3, &[3])).unwrap();
    assert_eq!(next(&mut *fd).frame, frame(3, &[3]));
}

fn receive_times_lie_between_sending_and_receiving_and_are_those_of_arrival(bench: &Bench) {
    // The kernel stamps in wall-clock time; a slow adjustment of it moves the converted stamp a little.
    const SLACK_NS: u64 = 1_000_000;
    let (mut a, mut b, mut witness) = (bench.open(), bench.open(), bench.open());
    let before = monotonic_ns();
    a.send(&frame(1, &[])).unwrap();
    // A kernel hands a frame on when it has time to. Once somebody else has it, it has been everywhere.
    next(&mut *witness);
    let arrived = monotonic_ns();
    std::thread::sleep(Duration::from_millis(50));
    let received = next(&mut *b);
    assert!(received.time_ns + SLACK_NS >= before, "{} before {before}", received.time_ns);
    assert!(received.time_ns <= arrived + SLACK_NS, "{} is when it was fetched, not when it came", received.time_ns);
}

fn a_receive_waits_for_its_timeout_and_wakes_for_a_frame(bench: &Bench) {
    let (mut a, mut b) = (bench.open(), bench.open());
    assert_eq!(b.receive(Duration::ZERO), Ok(None));
    let start = monotonic_ns();
    assert_eq!(b.receive(QUIET), Ok(None));
    assert!(monotonic_ns() - start >= QUIET.as_nanos() as u64, "it did not wait");
    let receiver = std::thread::spawn(move || {
        let r = next(&mut *b);
        (r, b)
    });
    std::thread::sleep(QUIET);
    a.send(&frame(9, &[9])).unwrap();
    let (r, mut b) = receiver.join().unwrap();
    assert_eq!(r.frame, frame(9, &[9]));
    assert_eq!(b.receive(Duration::ZERO), Ok(None));
}

fn counters_count_what_happened(bench: &Bench) {
    let (mut a, mut b) = (bench.open(), bench.open());
    for i in 0..10 {
        a.send(&frame(i, &[])).unwrap();
    }
    (0..10_u16).for_each(|i| assert_eq!(next(&mut *b).frame, frame(i, &[])));
    assert_eq!(a.counters(), BusCounters { sent: 10, ..BusCounters::default() });
    assert_eq!(b.counters(), BusCounters { received: 10, ..BusCounters::default() });
}

fn a_receiver_that_sleeps_too_long_counts_every_frame_it_lost(bench: &Bench) {
    const SENT: u64 = 20_000;
    let (mut a, mut b) = (bench.open(), bench.open());
    for i in 0..SENT {
        while a.send(&frame(1, &(i as u32).to_le_bytes())) == Err(SendError::Full) {
            let _ = a.receive(Duration::from_millis(1));
        }
    }
    let mut got = Vec::new();
    while let Some(r) = b.receive(QUIET).unwrap() {
        got.push(u32::from_le_bytes(r.frame.data().try_into().unwrap()));
    }
    // A socket tells what it dropped with the next frame that it has room for. What was late comes before it.
    a.send(&frame(2, &[])).unwrap();
    loop {
        let received = next(&mut *b).frame;
        if received == frame(2, &[]) {
            break;
        }
        got.push(u32::from_le_bytes(received.data().try_into().unwrap()));
    }
    assert!(got.is_sorted() && !got.is_empty());
    assert_eq!(got.len() as u64 + b.counters().lost, SENT);
}

fn two_threads_use_a_handle_and_its_duplicate(bench: &Bench) {
    let mut drive = bench.open();
    let mut sender = bench.open();
    let mut receiver = sender.duplicate().unwrap();
    receiver.set_filters(&[Filter { value: 0x180, mask: 0x7ff }]).unwrap();
    let answers = std::thread::spawn(move || {
        for _ in 0..200 {
            let command = next(&mut *drive);
            drive.send(&frame(0x180, command.frame.data())).unwrap();
        }
    });
    for i in 0..200_u16 {
        sender.send(&frame(0x200, &i.to_le_bytes())).unwrap();
        assert_eq!(next(&mut *receiver).frame, frame(0x180, &i.to_le_bytes()));
    }
    answers.join().unwrap();
}

fn a_lost_bus_is_reported_once_at_once_and_comes_back(bench: &Bench) {
    let (mut a, mut b) = (bench.open(), bench.open());
    a.send(&frame(1, &[])).unwrap();
    if !bench.set_up(false) {
        eprintln!("not allowed to take {} down", bench.spec.name);
        return;
    }
    assert_eq!(next(&mut *b).frame, frame(1, &[]), "what came before the loss is still delivered");
    assert_eq!(b.receive(WAIT), Err(ReceiveError::Bus(BusState::Down)));
    assert_eq!(b.state(), BusState::Down);
    assert_eq!(a.send(&frame(2, &[])), Err(SendError::Bus(BusState::Down)));
    let start = monotonic_ns();
    assert_eq!(b.receive(QUIET), Err(ReceiveError::Bus(BusState::Down)));
    assert!(monotonic_ns() - start >= QUIET.as_nanos() as u64, "a dead bus makes its receiver spin");
    assert!(bench.set_up(true));
    // Each comes back by itself within its interval; the loop ends or the test runner ends it.
    while b.receive(Duration::from_millis(20)) != Ok(None) {}
    while a.send(&frame(3, &[3])).is_err() {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(next(&mut *b).frame, frame(3, &[3]), "an old frame came out after the loss");
    assert_eq!((a.state(), b.state()), (BusState::ErrorActive, BusState::ErrorActive));
}

fn cycles_of_both_layouts_arrive_as_their_frames(bench: &Bench) {
    let node = |n| NodeId::new(n).unwrap();
    let mut peer = bench.open();
    for layout in [Layout::Classic, Layout::Packed] {
        let drives = (1..=6).map(|n| DriveSetup::new(0, node(n))).collect();
        let config = MasterConfig { layouts: vec![layout], ..MasterConfig::new(drives, node(127), 1000) };
        let mut writer = Master::new(config, vec![bench.open()]).unwrap().take_writer().unwrap();
        for cycle in 1..=20_i16 {
            let torques: Vec<i16> = (0..6).map(|i| 100 * i - cycle).collect();
            let report = writer.write_cycle(&torques);
            assert!(report.error.is_none(), "{report:?}");
            // Controlwords are 0: nobody has set a goal.
            let slots: Vec<u8> = torques.iter().flat_map(|t| encode_rpdo1(0, *t)).collect();
            if layout == Layout::Packed {
                let all = Frame::new(Id::Standard(0x200), Kind::Fd { bit_rate_switch: true }, &slots).unwrap();
                assert_eq!(next(&mut *peer).frame, all);
            } else {
                (0x201..)
                    .zip(slots.chunks(4))
                    .for_each(|(id, slot)| assert_eq!(next(&mut *peer).frame, frame(id, slot)));
            }
            assert_eq!(next(&mut *peer).frame, frame(0x80, &[]));
        }
    }
    assert_eq!(peer.receive(QUIET), Ok(None));
}

macro_rules! conformance {
    ($($claim:ident)*) => {
        mod virtual_bus {
            $(#[test] fn $claim() { super::Bench::virtual_bus(stringify!($claim)).iter().for_each(super::$claim); })*
        }
        mod socketcan {
            $(#[test] fn $claim() { super::Bench::socketcan(stringify!($claim)).iter().for_each(super::$claim); })*
        }
    };
}

conformance! {
    frames_of_every_kind_arrive_unchanged_and_in_order
    a_sender_does_not_hear_itself_but_everybody_else_does
    all_receivers_see_the_frames_of_several_senders_in_one_order
    a_handle_hears_only_what_is_sent_after_it_was_opened
    filters_pass_what_any_of_them_matches
    a_classic_handle_neither_sends_nor_hears_fd_frames
    receive_times_lie_between_sending_and_receiving_and_are_those_of_arrival
    a_receive_waits_for_its_timeout_and_wakes_for_a_frame
    counters_count_what_happened
    a_receiver_that_sleeps_too_long_counts_every_frame_it_lost
    two_threads_use_a_handle_and_its_duplicate
    cycles_of_both_layouts_arrive_as_their_frames
    a_lost_bus_is_reported_once_at_once_and_comes_back
}

#[test]
fn an_interface_that_does_not_exist_is_not_confused_with_a_kernel_without_can() {
    let Err(error) = open(&BusSpec::new(BusKind::Socketcan, "can-none")) else { panic!("it opened") };
    if std::env::var("SINEW_VCAN").is_ok() {
        assert!(matches!(error, OpenError::Missing { .. }), "{error}");
        assert!(error.to_string().contains("can-none does not exist"));
    } else {
        assert!(matches!(error, OpenError::Missing { .. } | OpenError::NoCan { .. }), "{error}");
        assert!(error.to_string().contains("can-none"));
    }
}

#[test]
fn an_interface_that_is_not_can_is_refused_as_such_where_there_is_can() {
    let Err(error) = open(&BusSpec::new(BusKind::Socketcan, "lo")) else { panic!("it opened") };
    let expected = if std::env::var("SINEW_VCAN").is_ok() {
        matches!(error, OpenError::NotCan { found: 772, .. })
    } else {
        matches!(error, OpenError::NotCan { found: 772, .. } | OpenError::NoCan { .. })
    };
    assert!(expected, "{error}");
}

/// Needs the right to change the interface; leaves it as it was.
#[test]
fn a_socketcan_interface_that_is_down_or_classic_is_refused_with_its_remedy() {
    let Some(bench) = Bench::socketcan("refusals") else { return };
    if !bench.set_up(false) {
        eprintln!("not allowed to take {} down", bench.spec.name);
        return;
    }
    let down = open(&bench.spec).err().unwrap();
    let mtu = |mtu: &str| {
        assert!(Command::new("ip").args(["link", "set", &bench.spec.name, "mtu", mtu]).status().unwrap().success());
    };
    mtu("16");
    assert!(bench.set_up(true));
    let classic = open(&bench.spec).err().unwrap();
    let opens_classic = open(&BusSpec { fd: false, ..bench.spec.clone() }).is_ok();
    assert!(bench.set_up(false));
    mtu("72");
    assert!(bench.set_up(true));
    assert!(matches!(down, OpenError::Down { .. }), "{down}");
    assert!(matches!(classic, OpenError::Mtu { found: 16, .. }), "{classic}");
    assert!(opens_classic);
    drop(bench.open());
}
