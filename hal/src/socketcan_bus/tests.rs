//! The handle's logic without CAN in the kernel: a pair of local datagram sockets stands for the wire, with the
//! kernel's frame format on it. The kernel's half is tested by the conformance suite on a vcan.

use std::cell::RefCell;
use std::os::fd::{AsRawFd, OwnedFd};

use rustix::net::{AddressFamily, SocketFlags, SocketType};

use super::*;
use crate::bus_config::BusKind;
use crate::can::Id;
use crate::canopen::NodeId;
use crate::cia402::CycleWriter;
use crate::cia402::Layout;
use crate::cia402::cyclic::{Address, Shared};

thread_local! {
    /// The wire's end of the socket that `reconnect` made last; none: the interface is still missing.
    static WIRE: RefCell<Vec<CanSocket>> = const { RefCell::new(Vec::new()) };
    static MAY_RECONNECT: RefCell<bool> = const { RefCell::new(false) };
}

fn pair() -> (CanSocket, CanSocket) {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let (a, b) = rustix::net::socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None).unwrap();
    let socket = |fd: OwnedFd| {
        let s = CanSocket::from(fd);
        socket::set_common_options(&s).unwrap();
        s
    };
    (socket(a), socket(b))
}

fn reconnect(_: InterfaceName, _: bool) -> Result<CanSocket, Refusal> {
    if !MAY_RECONNECT.with(|m| *m.borrow()) {
        return Err(Refusal::Down);
    }
    let (near, far) = pair();
    WIRE.with(|w| w.borrow_mut().push(far));
    Ok(near)
}

fn spec(queue_length: usize) -> BusSpec {
    let restart =
        Restart::Reopen { first: Duration::from_millis(1), longest: Duration::from_millis(4), cycle_interface: false };
    BusSpec { queue_length, restart, ..BusSpec::new(BusKind::Socketcan, "can9") }
}

fn bus(spec: &BusSpec) -> (SocketCanBus, CanSocket) {
    let (near, far) = pair();
    (SocketCanBus::with_socket(InterfaceName::new(&spec.name).unwrap(), spec, near, reconnect), far)
}

fn frame(i: u16) -> Frame {
    Frame::classic(Id::Standard(i & 0x7ff), &i.to_le_bytes()).unwrap()
}

fn put(wire: &CanSocket, frame: &Frame) {
    let mut bytes = [0; FD_LEN];
    let len = wire::encode(frame, &mut bytes);
    socket::send(wire, &bytes[..len]).unwrap();
}

fn put_error(wire: &CanSocket, class: u32, data: [u8; 8]) {
    let mut bytes = [0; 16];
    bytes[..4].copy_from_slice(&(libc::CAN_ERR_FLAG | class).to_ne_bytes());
    bytes[4] = 8;
    bytes[8..].copy_from_slice(&data);
    socket::send(wire, &bytes).unwrap();
}

fn drain(wire: &CanSocket) -> Vec<Frame> {
    let mut all = Vec::new();
    let mut bytes = [0; FD_LEN];
    while let Ok(arrival) = socket::receive(wire, &mut bytes) {
        match wire::decode(&bytes[..arrival.len]) {
            Datagram::Frame(f) => all.push(f),
            other => panic!("{other:?}"),
        }
    }
    all
}

const WAIT: Duration = Duration::from_secs(10);

#[test]
fn a_full_transmit_queue_is_bridged_in_order_and_then_refused() {
    let (mut bus, wire) = bus(&spec(5));
    let mut sent = 0;
    while bus.queued() < 5 {
        bus.send(&frame(sent)).unwrap();
        sent += 1;
    }
    assert!(sent > 5, "the kernel took nothing");
    assert_eq!(bus.send(&frame(999)), Err(SendError::Full));
    assert_eq!(bus.counters(), BusCounters { sent: u64::from(sent), refused: 1, ..BusCounters::default() });
    let mut all = drain(&wire);
    // Any later call hands over what waits.
    assert_eq!(bus.receive(Duration::ZERO), Ok(None));
    assert_eq!(bus.queued(), 0);
    all.extend(drain(&wire));
    assert_eq!(all, (0..sent).map(frame).collect::<Vec<_>>());
}

#[test]
fn a_new_cycle_takes_the_place_of_what_is_left_of_the_one_before() {
    const DRIVES: usize = 4;
    const FRAMES: usize = DRIVES + 1;
    let (bus, wire) = bus(&spec(256));
    let node = |i: usize| NodeId::new(i as u8 + 1).unwrap();
    let drives = (0..DRIVES).map(|i| Address { bus: 0, node: node(i), rank: i, torque_permille_max: i16::MAX });
    let shared = Arc::new(Shared::new(DRIVES, 1));
    let mut writer =
        CycleWriter::new(vec![Box::new(bus)], drives.collect(), vec![Layout::Classic], 0.0, shared.clone());
    let unsent = || shared.unsent[0].load(Ordering::Relaxed);
    // Nobody reads: at some cycle the kernel's queue is full, and part of it is left when the next one begins.
    let mut cycle = 0;
    let mut write = || {
        cycle += 1;
        (cycle, writer.write_cycle(&[cycle; DRIVES]))
    };
    let (after, left) = loop {
        let (cycle, report) = write();
        assert!(report.not_sent.is_empty() && report.sync_not_sent == 0, "{report:?}");
        if report.superseded > 0 {
            break (cycle, report.superseded);
        }
    };
    assert!(left <= FRAMES && unsent() == left as u64);
    // The wire is free again: what was left of the last cycle gives way to the newest torques, whole and in order.
    let cycle_of = |frame: &Frame| match frame.data() {
        [] => None,
        data => Some(i16::from_le_bytes([data[2], data[3]])),
    };
    let before = drain(&wire);
    assert_eq!(before.len(), FRAMES * (after as usize - 1) - left);
    let (newest, report) = write();
    assert_eq!((report.superseded, unsent()), (FRAMES, (left + FRAMES) as u64));
    let cycles: Vec<_> = drain(&wire).iter().map(cycle_of).collect();
    assert_eq!(cycles, [Some(newest), Some(newest), Some(newest), Some(newest), None]);
    assert_eq!(write().1.superseded, 0);
}

#[test]
fn waiting_frames_go_out_while_a_receive_waits() {
    let (mut bus, wire) = bus(&spec(3));
    let mut sent = 0;
    while bus.queued() < 3 {
        bus.send(&frame(0)).unwrap();
        sent += 1;
    }
    let far = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(5));
        // Only when all are there, those that waited too, comes the answer.
        let mut arrived = 0;
        while arrived < sent {
            arrived += drain(&wire).len();
            std::thread::yield_now();
        }
        put(&wire, &frame(42));
    });
    assert_eq!(bus.receive(WAIT).unwrap().unwrap().frame, frame(42));
    far.join().unwrap();
}

#[test]
fn without_a_queue_a_full_kernel_refuses_at_once() {
    let (mut bus, _wire) = bus(&spec(0));
    let mut sent = 0;
    let refused = loop {
        match bus.send(&frame(1)) {
            Ok(()) => sent += 1,
            Err(e) => break e,
        }
    };
    assert_eq!((refused, bus.counters().sent), (SendError::Full, sent));
}

#[test]
fn received_frames_carry_a_monotonic_time_that_is_not_in_the_future() {
    let (mut bus, wire) = bus(&spec(1));
    let before = monotonic_ns();
    put(&wire, &frame(7));
    let received = bus.receive(WAIT).unwrap().unwrap();
    assert_eq!(received.frame, frame(7));
    // A tick of the coarse wall clock may lie between the two.
    assert!(received.time_ns + 10_000_000 >= before && received.time_ns <= monotonic_ns());
}

#[test]
fn a_flush_hands_over_what_the_kernel_takes_and_tells_what_is_left() {
    let (mut bus, wire) = bus(&spec(5));
    while bus.queued() < 5 {
        bus.send(&frame(1)).unwrap();
    }
    assert_eq!(CanBus::flush(&mut bus), 5);
    drain(&wire);
    assert_eq!(CanBus::flush(&mut bus), 0);
    assert_eq!(drain(&wire), [frame(1); 5]);
}

#[test]
fn the_master_leaves_nothing_in_a_handles_queue_that_it_would_want_back() {
    MAY_RECONNECT.set(true);
    let (near, wire) = pair();
    let other = CanSocket::from(rustix::io::dup(&near).unwrap());
    let name = InterfaceName::new("can9").unwrap();
    let bus = SocketCanBus::with_socket(name, &spec(256), near, reconnect);
    // A cable that is off: the queue of the interface is full and stays so.
    let mut bytes = [0; FD_LEN];
    let len = wire::encode(&frame(0), &mut bytes);
    while socket::send(&other, &bytes[..len]).is_ok() {}
    let node = |n| crate::canopen::NodeId::new(n).unwrap();
    let drives = (1..=24).map(|n| crate::cia402::DriveSetup::new(0, node(n))).collect();
    let config = crate::cia402::MasterConfig::new(drives, node(127), 10_000);
    let mut master = crate::cia402::Master::new(config, vec![Box::new(bus)]).unwrap();
    for ms in 0..20_000 {
        if ms % 500 == 0 {
            master.start(ms * 1_000_000);
        }
        master.poll(ms * 1_000_000);
    }
    drain(&wire);
    // The frame that the handle held, then those of the last start: a heartbeat, and a reset of each drive.
    let mut found = Vec::new();
    for _ in 0..100 {
        master.poll(20_000 * 1_000_000);
        found.extend(drain(&wire));
    }
    assert_eq!(found.len(), 1 + 1 + 24, "{found:?}");
}

#[test]
fn error_frames_change_the_state_of_all_handles_and_are_no_frames() {
    let (mut bus, wire) = bus(&spec(4));
    MAY_RECONNECT.set(true);
    let mut sender = bus.duplicate().unwrap();
    put_error(&wire, 0x204, [0, 0x08, 0, 0, 0, 0, 100, 2]);
    put(&wire, &frame(1));
    assert_eq!(bus.receive(WAIT).unwrap().unwrap().frame, frame(1));
    assert_eq!((bus.state(), bus.error_counters()), (BusState::ErrorWarning, (100, 2)));
    put_error(&wire, 0x40, [0; 8]);
    assert_eq!(bus.receive(WAIT), Err(ReceiveError::Bus(BusState::BusOff)));
    assert_eq!(sender.send(&frame(2)), Err(SendError::Bus(BusState::BusOff)));
    assert_eq!(bus.receive(Duration::from_millis(3)), Err(ReceiveError::Bus(BusState::BusOff)));
    put_error(&wire, 0x100, [0; 8]);
    assert_eq!(bus.receive(Duration::ZERO), Ok(None));
    assert_eq!(sender.send(&frame(2)), Ok(()));
    assert_eq!(bus.counters().errors, 3);
}

#[test]
fn bus_off_empties_the_queues_of_all_handles_whoever_was_told() {
    // The sender calls while the bus is off, or only when it is back.
    for calls in [true, false] {
        MAY_RECONNECT.set(true);
        let (mut bus, wire) = bus(&spec(4));
        let mut sender = bus.duplicate().unwrap();
        let sent_to = WIRE.with(|w| w.borrow_mut().pop()).unwrap();
        while sender.send(&frame(1)).is_ok() {}
        let sent = sender.counters().sent;
        put_error(&wire, 0x40, [0; 8]);
        assert_eq!(bus.receive(WAIT), Err(ReceiveError::Bus(BusState::BusOff)));
        assert_eq!(drain(&sent_to).len() as u64, sent - 4, "the rest waits in the handle");
        if calls {
            assert_eq!(sender.send(&frame(2)), Err(SendError::Bus(BusState::BusOff)));
        }
        put_error(&wire, 0x100, [0; 8]);
        assert_eq!(bus.receive(Duration::ZERO), Ok(None));
        assert_eq!(sender.send(&frame(3)), Ok(()));
        assert_eq!(drain(&sent_to), [frame(3)], "old frames came out after the loss");
        assert_eq!((sender.counters().sent, sender.counters().refused), (sent - 4 + 1, 1 + 4));
    }
}

#[test]
fn a_transmit_queue_shorter_than_a_cycle_is_refused_with_its_remedy() {
    let name = InterfaceName::new("can9").unwrap();
    let refused = check_queue(name, 10, 25).unwrap_err();
    assert!(matches!(refused, OpenError::ShortQueue { found: 10, burst: 25, .. }));
    assert!(refused.to_string().ends_with("`ip link set can9 txqueuelen 128`"), "{refused}");
    assert!(check_queue(name, 24, 25).is_err() && check_queue(name, 25, 25).is_ok());
    assert!(check_queue(name, 10, 7).is_ok(), "six drives on a bus as it comes");
    assert!(matches!(check_queue(name, 128, 129), Err(OpenError::ShortQueue { remedy: 256, .. })));
}

#[test]
fn a_lost_link_empties_the_queue_and_comes_back_with_growing_intervals() {
    MAY_RECONNECT.set(false);
    let (mut bus, _wire) = bus(&spec(8));
    bus.set_filters(&[]).unwrap_err(); // a local socket has no CAN filters
    while bus.queued() < 8 {
        bus.send(&frame(1)).unwrap();
    }
    let sent = bus.counters().sent;
    bus.lose_link();
    assert_eq!((bus.state(), bus.queued()), (BusState::Down, 0));
    assert_eq!((bus.counters().sent, bus.counters().refused), (sent - 8, 8));
    assert_eq!(bus.send(&frame(2)), Err(SendError::Bus(BusState::Down)));
    assert_eq!(bus.receive(WAIT), Err(ReceiveError::Bus(BusState::Down)), "the change is reported at once");
    assert_eq!(bus.receive(Duration::from_millis(20)), Err(ReceiveError::Bus(BusState::Down)));
    assert_eq!(bus.backoff_ns, 4_000_000, "the longest interval");
    MAY_RECONNECT.set(true);
    assert_eq!(bus.receive(Duration::from_millis(20)), Ok(None));
    assert_eq!(bus.state(), BusState::ErrorActive);
    let wire = WIRE.with(|w| w.borrow_mut().pop()).unwrap();
    assert_eq!(drain(&wire), [], "old frames came out after the loss");
    bus.send(&frame(3)).unwrap();
    assert_eq!(drain(&wire), [frame(3)]);
}

/// Whether the other end of this socket has been closed.
fn is_closed(far: &CanSocket) -> bool {
    let mut bytes = [0; FD_LEN];
    socket::receive(far, &mut bytes).is_ok_and(|arrival| arrival.len == 0)
}

fn last_wire() -> CanSocket {
    WIRE.with(|w| w.borrow_mut().pop()).unwrap()
}

#[test]
fn a_handle_that_only_sends_neither_opens_nor_closes_a_socket_where_another_receives() {
    MAY_RECONNECT.set(true);
    let (mut bus, _wire) = bus(&spec(4));
    let mut sender = bus.another().unwrap();
    let first = last_wire();
    assert_eq!(bus.receive(Duration::ZERO), Ok(None));
    sender.lose_link();
    let opened = || WIRE.with(|w| w.borrow().len());
    // Long after any interval of its own.
    for _ in 0..20 {
        std::thread::sleep(Duration::from_millis(1));
        assert_eq!(sender.send(&frame(1)), Err(SendError::Bus(BusState::Down)));
    }
    assert_eq!(opened(), 0, "it opened a socket itself");
    // The receiver sees to it: first to a new one, then that the old one is closed.
    assert_eq!(bus.receive(Duration::ZERO), Ok(None));
    assert_eq!(opened(), 1);
    assert_eq!(sender.state(), BusState::Down, "not before its next call");
    assert_eq!(sender.send(&frame(2)), Ok(()));
    let second = last_wire();
    assert_eq!(drain(&second), [frame(2)]);
    assert!(!is_closed(&first), "it closed a socket itself");
    assert_eq!(bus.receive(Duration::ZERO), Ok(None));
    assert!(is_closed(&first));
    // And once more, with the interface away for a while.
    MAY_RECONNECT.set(false);
    sender.lose_link();
    assert_eq!(sender.send(&frame(3)), Err(SendError::Bus(BusState::Down)));
    assert_eq!(bus.receive(Duration::from_millis(12)), Ok(None));
    assert_eq!(sender.send(&frame(3)), Err(SendError::Bus(BusState::Down)));
    MAY_RECONNECT.set(true);
    assert_eq!(bus.receive(Duration::from_millis(12)), Ok(None));
    assert_eq!(sender.send(&frame(4)), Ok(()));
    assert_eq!(drain(&last_wire()), [frame(4)]);
}

#[test]
fn where_nobody_receives_a_handle_comes_back_by_itself() {
    MAY_RECONNECT.set(true);
    let (mut bus, _wire) = bus(&spec(4));
    {
        // One that received, and is no more.
        let mut receiver = bus.another().unwrap();
        assert_eq!(receiver.receive(Duration::ZERO), Ok(None));
    }
    bus.lose_link();
    while bus.send(&frame(1)).is_err() {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(drain(&last_wire()), [frame(1)]);
}

#[test]
fn a_handle_that_comes_back_late_does_not_hide_that_the_controller_went_off_since() {
    MAY_RECONNECT.set(true);
    let (mut early, _wire) = bus(&spec(4));
    let mut late = early.another().unwrap();
    for handle in [&mut early, &mut late] {
        assert_eq!(handle.receive(Duration::ZERO), Ok(None));
    }
    let _ = last_wire();
    early.lose_link();
    late.lose_link();
    while early.receive(Duration::from_millis(10)) != Ok(None) {}
    let wire = last_wire();
    put_error(&wire, 0x40, [0; 8]);
    assert_eq!(early.receive(WAIT), Err(ReceiveError::Bus(BusState::BusOff)));
    while late.link_lost {
        let _ = late.receive(Duration::from_millis(10));
    }
    assert_eq!((early.state(), late.state()), (BusState::BusOff, BusState::BusOff));
    // A loss of the link after it ends it: the interface was taken down and up.
    early.lose_link();
    while early.receive(Duration::from_millis(10)) != Ok(None) {}
    assert_eq!((early.state(), late.state()), (BusState::ErrorActive, BusState::ErrorActive));
}

#[test]
fn what_arrived_before_the_link_was_lost_is_delivered_first() {
    let (mut bus, wire) = bus(&BusSpec { restart: Restart::Never, ..spec(1) });
    put(&wire, &frame(1));
    bus.lose_link();
    assert_eq!(bus.receive(WAIT).unwrap().unwrap().frame, frame(1));
    assert_eq!(bus.receive(Duration::from_millis(1)), Err(ReceiveError::Bus(BusState::Down)));
}

#[test]
fn with_restart_never_a_lost_link_stays_lost() {
    MAY_RECONNECT.set(true);
    let (mut bus, _wire) = bus(&BusSpec { restart: Restart::Never, ..spec(1) });
    bus.lose_link();
    assert_eq!(bus.receive(WAIT), Err(ReceiveError::Bus(BusState::Down)));
    assert_eq!(bus.receive(Duration::from_millis(20)), Err(ReceiveError::Bus(BusState::Down)));
}

#[test]
fn a_storm_of_error_frames_does_not_hold_a_poll() {
    let (mut bus, wire) = bus(&spec(1));
    for _ in 0..100 {
        put_error(&wire, 0x88, [0; 8]);
    }
    put(&wire, &frame(1));
    assert_eq!(bus.receive(Duration::ZERO), Ok(None));
    assert_eq!(bus.receive(Duration::ZERO).unwrap().unwrap().frame, frame(1));
    assert_eq!(bus.counters().errors, 100);
}

#[test]
fn damaged_datagrams_are_counted_and_skipped() {
    let (mut bus, wire) = bus(&spec(1));
    for len in [1, 15, 17, 71, 100] {
        socket::send(&wire, &vec![0xff; len]).unwrap();
    }
    put(&wire, &frame(1));
    assert_eq!(bus.receive(WAIT).unwrap().unwrap().frame, frame(1));
    assert_eq!(bus.counters().errors, 5);
}

#[test]
fn interface_names_that_the_kernel_cannot_hold_are_refused() {
    for name in ["", "sixteen-bytes-ok", "a/b", "a b", "a\0b"] {
        let spec = BusSpec::new(BusKind::Socketcan, name);
        assert!(matches!(SocketCanBus::open(&spec), Err(OpenError::Name(_))), "{name:?}");
    }
    assert_eq!(InterfaceName::new("fifteen-bytes-x").unwrap().as_str(), "fifteen-bytes-x");
}

#[test]
fn every_refusal_of_the_kernel_has_a_reason_of_its_own() {
    let name = InterfaceName::new("can9").unwrap();
    let reason = |e: i32| Refusal::from_io("bind", &io::Error::from_raw_os_error(e)).into_error(name);
    assert!(matches!(reason(libc::EAFNOSUPPORT), OpenError::NoCan { .. }));
    assert!(matches!(reason(libc::EPROTONOSUPPORT), OpenError::NoCan { .. }));
    assert!(matches!(reason(libc::ENODEV), OpenError::Missing { .. }));
    assert!(matches!(reason(libc::ENETDOWN), OpenError::Down { .. }));
    assert!(matches!(reason(libc::EPERM), OpenError::Permission { .. }));
    assert!(reason(libc::EIO).to_string().starts_with("CAN interface can9: bind: "));
    assert!(Refusal::Mtu(16).into_error(name).to_string().contains("MTU of 16 (expected 72)"));
}

#[test]
fn sockets_are_not_inherited_by_children() {
    let (bus, _wire) = bus(&spec(1));
    let fd = bus.socket.as_raw_fd();
    // SAFETY: a plain query of a live descriptor.
    assert_ne!(unsafe { libc::fcntl(fd, libc::F_GETFD) } & libc::FD_CLOEXEC, 0);
}
