//! Claims about what only an interface of the kernel has: error frames, bus-off, a full transmit queue, an interface
//! that goes away. What every bus has is in `conformance.rs`.
//!
//! Needs a kernel with CAN (`SINEW_VCAN` is set, as `tests/vm/suite` does) and the right to make interfaces: each claim
//! has a vcan of its own. In the virtual machine everything must run; elsewhere what is not permitted is left out, and
//! says so. A vcan has no controller: error frames are sent by the test, as a driver would put them into the queue.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a helper that fails is a test that fails

use std::process::Command;
use std::time::Duration;

use sinew_hal::bus_config::{BusKind, BusSpec, OpenError, Restart, open};
use sinew_hal::can::{BusCounters, BusState, CanBus, Filter, Frame, Id, ReceiveError, SendError};
use sinew_hal::clock::monotonic_ns;
use sinew_hal::socketcan_bus::SocketCanBus;
use socketcan::{CanSocket, Socket};
use std::os::fd::AsRawFd;

/// Long enough for any machine; a claim that holds never waits for it.
const WAIT: Duration = Duration::from_secs(10);
/// Long enough that a frame on its way would have come.
const QUIET: Duration = Duration::from_millis(30);

fn ip(arguments: &[&str]) -> bool {
    Command::new("ip").args(arguments).status().is_ok_and(|s| s.success())
}

/// An interface of the test's own, removed at the end.
struct Interface(String);

impl Interface {
    /// `None`, with the reason said, where there is no CAN or no right.
    fn make(name: &str) -> Option<Self> {
        if std::env::var("SINEW_VCAN").is_err() {
            eprintln!("{name}: SINEW_VCAN is not set, so no CAN here: left out");
            return None;
        }
        let interface = Self(name.to_owned());
        if interface.add() {
            return Some(interface);
        }
        assert!(std::env::var("SINEW_VM").is_err(), "{name} could not be made in the virtual machine");
        eprintln!("not allowed to make {name}: left out");
        None
    }

    fn add(&self) -> bool {
        ip(&["link", "add", &self.0, "type", "vcan"]) && ip(&["link", "set", &self.0, "mtu", "72", "up"])
    }

    fn set_up(&self, up: bool) {
        assert!(ip(&["link", "set", &self.0, if up { "up" } else { "down" }]));
    }

    fn spec(&self) -> BusSpec {
        let restart = Restart::Reopen {
            first: Duration::from_millis(5),
            longest: Duration::from_millis(50),
            cycle_interface: false,
        };
        BusSpec { fd: true, restart, ..BusSpec::new(BusKind::Socketcan, &self.0) }
    }

    fn bus(&self) -> Box<dyn CanBus> {
        open(&self.spec()).unwrap_or_else(|e| panic!("{e}"))
    }
}

impl Drop for Interface {
    fn drop(&mut self) {
        let _ = ip(&["link", "delete", &self.0]);
    }
}

/// What a driver reports: class bits, and eight bytes of detail (`linux/can/error.h`).
struct Driver(CanSocket);

impl Driver {
    fn on(interface: &Interface) -> Self {
        Self(CanSocket::open(&interface.0).unwrap())
    }

    fn report(&self, class: u32, data: [u8; 8]) {
        let mut bytes = [0_u8; 16];
        bytes[..4].copy_from_slice(&(class | libc::CAN_ERR_FLAG).to_ne_bytes());
        bytes[4] = 8;
        bytes[8..].copy_from_slice(&data);
        // SAFETY: the pointer and the length are those of a live array.
        let sent = unsafe { libc::send(self.0.as_raw_fd(), bytes.as_ptr().cast(), bytes.len(), 0) };
        assert_eq!(sent, 16, "{}", std::io::Error::last_os_error());
    }

    fn counters(&self, transmit: u8, receive: u8) {
        self.report(0x200, [0, 0, 0, 0, 0, 0, transmit, receive]);
    }

    fn bus_off(&self) {
        self.report(libc::CAN_ERR_BUSOFF, [0; 8]);
    }

    fn restarted(&self) {
        self.report(libc::CAN_ERR_RESTARTED, [0; 8]);
    }
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::classic(Id::Standard(id), data).unwrap()
}

#[test]
fn error_frames_of_the_kernel_become_states_and_never_frames() {
    let Some(interface) = Interface::make("sinew-err") else { return };
    let driver = Driver::on(&interface);
    let mut bus = SocketCanBus::open(&interface.spec()).unwrap();
    for (transmit, receive, state) in
        [(96, 0, BusState::ErrorWarning), (0, 128, BusState::ErrorPassive), (12, 34, BusState::ErrorActive)]
    {
        driver.counters(transmit, receive);
        assert_eq!(bus.receive(QUIET), Ok(None), "an error frame came out as a frame");
        assert_eq!((bus.state(), bus.error_counters()), (state, (transmit, receive)));
    }
    assert_eq!(bus.counters(), BusCounters { errors: 3, ..BusCounters::default() });
}

#[test]
fn bus_off_is_reported_at_once_to_every_handle_and_ends_with_the_controllers_restart() {
    let Some(interface) = Interface::make("sinew-off") else { return };
    let driver = Driver::on(&interface);
    let mut bus = interface.bus();
    let mut sender = bus.duplicate().unwrap();
    let mut other = interface.bus();
    driver.bus_off();
    assert_eq!(bus.receive(WAIT), Err(ReceiveError::Bus(BusState::BusOff)));
    assert_eq!(sender.send(&frame(1, &[])), Err(SendError::Bus(BusState::BusOff)), "the sender has not been told");
    assert_eq!(other.receive(WAIT), Err(ReceiveError::Bus(BusState::BusOff)));
    assert_eq!(bus.receive(QUIET), Err(ReceiveError::Bus(BusState::BusOff)), "it ended by itself");
    driver.restarted();
    for handle in [&mut bus, &mut other] {
        while handle.receive(QUIET) != Ok(None) {}
        assert_eq!(handle.state(), BusState::ErrorActive);
    }
    sender.send(&frame(2, &[2])).unwrap();
    assert_eq!(other.receive(WAIT).unwrap().unwrap().frame, frame(2, &[2]), "an old frame came out");
}

#[test]
fn bus_off_ends_by_taking_the_interface_down_and_up_where_that_is_wanted() {
    let Some(interface) = Interface::make("sinew-cyc") else { return };
    let driver = Driver::on(&interface);
    let restart =
        Restart::Reopen { first: Duration::from_millis(5), longest: Duration::from_millis(50), cycle_interface: true };
    let mut bus = SocketCanBus::open(&BusSpec { restart, ..interface.spec() }).unwrap();
    driver.bus_off();
    assert_eq!(bus.receive(WAIT), Err(ReceiveError::Bus(BusState::BusOff)));
    // Nobody restarts the controller; the loop ends or the test runner ends it.
    while bus.receive(QUIET) != Ok(None) {}
    assert_eq!(bus.state(), BusState::ErrorActive);
    let mut other = interface.bus();
    other.send(&frame(3, &[3])).unwrap();
    assert_eq!(bus.receive(WAIT).unwrap().unwrap().frame, frame(3, &[3]));
}

#[test]
fn frames_wait_in_order_for_a_full_transmit_queue_and_are_refused_when_the_own_queue_is_full() {
    const KERNEL: u16 = 4;
    const OWN: u16 = 3;
    let Some(interface) = Interface::make("sinew-buf") else { return };
    let spec = BusSpec { queue_length: usize::from(OWN), ..interface.spec() };
    let mut bus = open(&spec).unwrap();
    let mut other = interface.bus();
    // What vcan does not have: a wire that takes its time, and a queue before it. Full, it answers ENOBUFS.
    let limit = KERNEL.to_string();
    let delay = ["qdisc", "add", "dev", &interface.0, "root", "netem", "delay", "200ms", "limit", &limit];
    if !Command::new("tc").args(delay).status().is_ok_and(|s| s.success()) {
        assert!(std::env::var("SINEW_VM").is_err(), "the virtual machine has no netem");
        eprintln!("no right to slow {} down, or no netem: left out", interface.0);
        return;
    }
    let mut taken = 0;
    let refused = loop {
        match bus.send(&frame(taken, &[])) {
            Ok(()) => taken += 1,
            Err(e) => break e,
        }
    };
    assert_eq!(refused, SendError::Full);
    // More if the machine was so slow that the wire took some meanwhile.
    assert!(taken >= KERNEL + OWN, "{taken} frames were taken by queues of {KERNEL} and {OWN}");
    assert_eq!((bus.counters().sent, bus.counters().refused), (u64::from(taken), 1));
    assert_eq!(bus.state(), BusState::ErrorActive, "a full queue is no loss of the bus");
    // A receive hands on what waits as soon as there is room.
    let mut heard = Vec::new();
    while heard.len() < usize::from(taken) {
        assert_eq!(bus.receive(Duration::from_millis(1)), Ok(None));
        if let Some(received) = other.receive(Duration::from_millis(1)).unwrap() {
            heard.push(received.frame);
        }
    }
    assert_eq!(heard, (0..taken).map(|id| frame(id, &[])).collect::<Vec<_>>());
    while bus.send(&frame(0x100, &[])).is_err() {
        std::thread::sleep(QUIET);
    }
    assert_eq!(other.receive(WAIT).unwrap().unwrap().frame, frame(0x100, &[]));
}

#[test]
fn an_interface_whose_transmit_queue_is_shorter_than_a_cycle_is_refused_until_it_is_longer() {
    let Some(interface) = Interface::make("sinew-short") else { return };
    let lengthen = |frames: &str| assert!(ip(&["link", "set", &interface.0, "txqueuelen", frames]));
    let spec = BusSpec { burst: 25, ..interface.spec() };
    // What drivers of real controllers set.
    lengthen("10");
    let refused = open(&spec).map(drop).unwrap_err();
    assert!(matches!(refused, OpenError::ShortQueue { found: 10, burst: 25, .. }), "{refused}");
    let text = refused.to_string();
    let command = text.split('`').nth(1).unwrap().strip_prefix("ip ").unwrap();
    assert!(ip(&command.split(' ').collect::<Vec<_>>()), "{command}");
    drop(open(&spec).unwrap());
    lengthen("10");
    drop(open(&BusSpec { burst: 7, ..interface.spec() }).unwrap());
    drop(open(&interface.spec()).unwrap());
}

#[test]
fn an_interface_that_is_removed_and_made_again_comes_back() {
    let Some(interface) = Interface::make("sinew-gone") else { return };
    let (mut a, mut b) = (interface.bus(), interface.bus());
    b.set_filters(&[Filter { value: 0x123, mask: 0x7ff }]).unwrap();
    assert!(ip(&["link", "delete", &interface.0]));
    assert_eq!(b.receive(WAIT), Err(ReceiveError::Bus(BusState::Down)));
    assert_eq!(a.send(&frame(1, &[])), Err(SendError::Bus(BusState::Down)));
    assert!(matches!(open(&interface.spec()).err().unwrap(), OpenError::Missing { .. }));
    assert!(interface.add());
    while b.receive(QUIET) != Ok(None) {}
    while a.send(&frame(0x123, &[1])).is_err() {
        std::thread::sleep(QUIET);
    }
    assert_eq!(b.receive(WAIT).unwrap().unwrap().frame, frame(0x123, &[1]));
    a.send(&frame(0x124, &[])).unwrap();
    assert_eq!(b.receive(QUIET), Ok(None), "the filters were lost with the interface");
}

#[test]
fn a_handle_that_only_sends_comes_back_with_the_one_that_receives_and_with_its_filters() {
    let Some(interface) = Interface::make("sinew-hand") else { return };
    let mut receiver = interface.bus();
    let mut sender = receiver.duplicate().unwrap();
    sender.set_filters(&[Filter { value: 0x7ff, mask: 0x7ff }]).unwrap();
    let mut other = interface.bus();
    for round in 0..3 {
        assert_eq!(receiver.receive(QUIET), Ok(None));
        interface.set_up(false);
        assert_eq!(receiver.receive(WAIT), Err(ReceiveError::Bus(BusState::Down)));
        assert_eq!(sender.send(&frame(1, &[])), Err(SendError::Bus(BusState::Down)));
        interface.set_up(true);
        // By itself it stays away, long after any interval of its own.
        for _ in 0..4 {
            std::thread::sleep(QUIET);
            assert_eq!(sender.send(&frame(1, &[])), Err(SendError::Bus(BusState::Down)));
        }
        while receiver.receive(QUIET) != Ok(None) {}
        while other.receive(QUIET) != Ok(None) {}
        while sender.send(&frame(2, &[round])).is_err() {
            assert_eq!(receiver.receive(QUIET), Ok(None));
        }
        assert_eq!(other.receive(WAIT).unwrap().unwrap().frame, frame(2, &[round]), "an old frame came out");
        assert_eq!(receiver.receive(WAIT).unwrap().unwrap().frame, frame(2, &[round]));
        other.send(&frame(3, &[])).unwrap();
        assert_eq!(receiver.receive(WAIT).unwrap().unwrap().frame, frame(3, &[]));
        assert_eq!(sender.counters().received, 0);
    }
}

#[test]
fn filters_are_the_kernels_so_what_they_keep_out_fills_no_buffer() {
    let Some(interface) = Interface::make("sinew-flt") else { return };
    let (mut a, mut b) = (interface.bus(), interface.bus());
    b.set_filters(&[Filter { value: 0x123, mask: 0x7ff }]).unwrap();
    // Many more than a socket's receive buffer holds.
    for _ in 0..5_000 {
        a.send(&frame(0x124, &[0; 8])).unwrap();
    }
    a.send(&frame(0x123, &[1])).unwrap();
    assert_eq!(b.receive(WAIT).unwrap().unwrap().frame, frame(0x123, &[1]));
    assert_eq!(b.counters(), BusCounters { received: 1, ..BusCounters::default() });
}

#[test]
fn frames_that_waited_carry_the_kernels_time_of_each_arrival() {
    let Some(interface) = Interface::make("sinew-tim") else { return };
    // The wall clock of the stamps and the monotonic one may run apart a little.
    const SLACK_NS: u64 = 1_000_000;
    let (mut a, mut b, mut witness) = (interface.bus(), interface.bus(), interface.bus());
    // The kernel begins to stamp a while after the first socket that asks for it, out of a work queue; a frame that came
    // before gets the time at which it is read.
    let stamped = (0..100).any(|_| {
        a.send(&frame(9, &[])).unwrap();
        assert!(witness.receive(WAIT).unwrap().is_some());
        std::thread::sleep(QUIET);
        b.receive(WAIT).unwrap().unwrap().time_ns + (QUIET.as_nanos() / 2) as u64 <= monotonic_ns()
    });
    assert!(stamped, "a hundred frames carry the time at which they were read");
    let mut between_ns = Vec::new();
    for i in 0..3 {
        let before_ns = monotonic_ns();
        a.send(&frame(i, &[])).unwrap();
        // Then it has been everywhere.
        assert_eq!(witness.receive(WAIT).unwrap().unwrap().frame, frame(i, &[]));
        between_ns.push((before_ns, monotonic_ns()));
        std::thread::sleep(QUIET);
    }
    for (before_ns, after_ns) in between_ns {
        let time_ns = b.receive(WAIT).unwrap().unwrap().time_ns;
        assert!(time_ns + SLACK_NS >= before_ns && time_ns <= after_ns + SLACK_NS, "{before_ns} {time_ns} {after_ns}");
    }
}

#[test]
fn an_interface_that_is_down_is_refused_with_its_remedy_and_used_when_it_is_up() {
    let Some(interface) = Interface::make("sinew-dwn") else { return };
    interface.set_up(false);
    let error = open(&interface.spec()).err().unwrap();
    assert_eq!(error.to_string(), "CAN interface sinew-dwn is down: `ip link set sinew-dwn up`");
    interface.set_up(true);
    drop(interface.bus());
}
