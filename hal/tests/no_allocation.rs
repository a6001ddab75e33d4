//! After `open`, sending and receiving allocate nothing, frames and whole cycles of drives alike: a counting allocator
//! watches the test's thread.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a helper that fails is a test that fails

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

use sinew_hal::bus_config::{BusKind, BusSpec, open};
use sinew_hal::can::{BusState, CanBus, Filter, Frame, Id, Kind};
use sinew_hal::canopen::NodeId;
use sinew_hal::cia402::objects::TPDO1;
use sinew_hal::cia402::{DriveSetup, Event, Layout, Master, MasterConfig};
use sinew_hal::clock::{Clock, Lockstep, Monotonic, monotonic_ns};
use sinew_hal::fault_shim::{Delay, FaultPlan, FaultShim};
use sinew_hal::virtual_bus::VirtualBus;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call is passed on to the system's allocator; the counter is a plain thread-local that never allocates.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's obligations are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(f: impl FnOnce()) -> u64 {
    let before = ALLOCATIONS.get();
    f();
    ALLOCATIONS.get() - before
}

fn name(test: &str) -> String {
    format!("no-allocation-{test}-{}", std::process::id())
}

/// Everything that a control loop does with a bus, 10,000 times.
fn exercise(a: &mut dyn CanBus, b: &mut dyn CanBus) {
    let classic = Frame::classic(Id::Standard(0x201), &[1; 8]).unwrap();
    let fd = Frame::new(Id::Extended(0x1234_5678), Kind::Fd { bit_rate_switch: true }, &[2; 64]).unwrap();
    for i in 0..10_000 {
        a.send(&classic).unwrap();
        a.send(&fd).unwrap();
        while b.receive(Duration::ZERO).unwrap().is_some() {}
        if i % 500 == 0 {
            assert_eq!(b.receive(Duration::from_micros(300)), Ok(None));
            b.set_filters(&[Filter { value: 0x200, mask: 0x600 }]).unwrap();
            b.set_filters(&[]).unwrap();
        }
        assert!(a.state().carries_frames());
        assert!(a.counters().refused == 0);
    }
}

#[test]
fn the_counter_counts() {
    assert!(allocations(|| drop(std::hint::black_box(Box::new(1_u64)))) >= 1);
}

#[test]
fn the_virtual_bus_allocates_nothing_after_open() {
    let mut a = VirtualBus::open(&name("virtual"), true).unwrap();
    let mut b = a.duplicate().unwrap();
    assert_eq!(allocations(|| exercise(&mut a, &mut *b)), 0);
}

#[test]
fn neither_a_slow_receiver_nor_a_bus_that_goes_down_allocates() {
    let mut a = VirtualBus::open(&name("faults"), true).unwrap();
    let mut b = a.duplicate().unwrap();
    let frame = Frame::classic(Id::Standard(1), &[]).unwrap();
    let count = allocations(|| {
        for _ in 0..10_000 {
            a.send(&frame).unwrap();
        }
        while b.receive(Duration::ZERO).unwrap().is_some() {}
        a.set_state(BusState::Down);
        assert!(a.send(&frame).is_err());
        assert!(b.receive(Duration::from_millis(1)).is_err());
        assert!(b.receive(Duration::from_millis(1)).is_err());
        a.set_state(BusState::ErrorActive);
        assert_eq!(b.receive(Duration::from_millis(1)), Ok(None));
    });
    assert_eq!(count, 0);
    assert!(b.counters().lost > 0);
}

#[test]
fn the_socketcan_bus_allocates_nothing_after_open() {
    let Ok(interface) = std::env::var("SINEW_VCAN") else {
        eprintln!("SINEW_VCAN names no interface, SocketCAN not tested");
        return;
    };
    let spec = BusSpec { fd: true, ..BusSpec::new(BusKind::Socketcan, interface) };
    let mut a = open(&spec).unwrap_or_else(|e| panic!("{e}"));
    let mut b = a.duplicate().unwrap();
    assert_eq!(allocations(|| exercise(&mut *a, &mut *b)), 0);
}

#[test]
fn the_fault_shim_allocates_nothing_after_creation() {
    let bus = VirtualBus::open(&name("shim"), true).unwrap();
    let mut peer = bus.duplicate().unwrap();
    let chance = FaultPlan {
        drop: 0.1,
        corrupt: 0.1,
        duplicate: 0.1,
        reorder: 0.1,
        delay: 0.5,
        delay_by: Delay::Frames(700),
        ..FaultPlan::default()
    };
    let mut shim = FaultShim::new(bus, chance.clone(), chance, 1, Arc::new(Monotonic)).unwrap();
    assert_eq!(allocations(|| exercise(&mut shim, &mut *peer)), 0);
    assert_eq!(allocations(|| exercise_receive(&mut *peer, &mut shim)), 0);
    assert!(shim.counts().0.delayed > 1000 && shim.counts().1.delayed > 1000);
}

fn exercise_receive(peer: &mut dyn CanBus, shim: &mut dyn CanBus) {
    let frame = Frame::classic(Id::Standard(5), &[9; 4]).unwrap();
    for _ in 0..10_000 {
        peer.send(&frame).unwrap();
        while shim.receive(Duration::ZERO).unwrap().is_some() {}
    }
}

/// Cycles of 24 drives on four buses: torques out, answers in, some of them missing, some of them malformed.
fn exercise_cycles(layout: Layout) {
    let node = |n: usize| NodeId::new(n as u8).unwrap();
    let drives = (0..24).map(|i| DriveSetup::new(i / 6, node(i % 6 + 1))).collect();
    let config = MasterConfig { layouts: vec![layout; 4], ..MasterConfig::new(drives, node(127), 1000) };
    let claim = format!("cycles-{layout:?}");
    let buses: Vec<_> = (0..4).map(|b| VirtualBus::open(&name(&format!("{claim}-{b}")), true).unwrap()).collect();
    let mut peers: Vec<_> = buses.iter().map(|b| b.duplicate().unwrap()).collect();
    let mut receivers: Vec<_> = buses.iter().map(|b| b.duplicate().unwrap()).collect();
    let handles = buses.into_iter().map(|b| Box::new(b) as Box<dyn CanBus>).collect();
    let mut master = Master::new(config, handles).unwrap();
    let (mut writer, mut decoder) = (master.take_writer().unwrap(), master.decoder());
    let kind = if layout == Layout::Packed { Kind::Fd { bit_rate_switch: true } } else { Kind::Classic };
    let len: usize = TPDO1.iter().map(|m| m.bytes()).sum();
    let answer = |n: u16, len: usize| Frame::new(Id::Standard(0x180 + n), kind, &[1; 8][..len]).unwrap();
    let (mut complete, mut heard) = (0, 0);
    let count = allocations(|| {
        for cycle in 0..2000_i16 {
            let report = writer.write_cycle(&[cycle; 24]);
            assert!(report.not_sent.is_empty() && report.sync_not_sent == 0 && report.error.is_none());
            for peer in &mut peers {
                while peer.receive(Duration::ZERO).unwrap().is_some() {
                    heard += 1;
                }
                (1..=6).filter(|n| cycle % 10 != 0 || *n != 3).for_each(|n| peer.send(&answer(n, len)).unwrap());
                peer.send(&answer(3, 2)).unwrap();
            }
            for (bus, receiver) in receivers.iter_mut().enumerate() {
                while let Some(received) = receiver.receive(Duration::ZERO).unwrap() {
                    complete += u32::from(matches!(decoder.on_frame(bus, &received), Event::Complete { .. }));
                }
            }
        }
    });
    assert_eq!(count, 0);
    assert_eq!(complete, 1800);
    // RPDOs and SYNC.
    assert_eq!(heard, 2000 * 4 * if layout == Layout::Packed { 2 } else { 7 });
}

#[test]
fn a_cycle_of_the_classic_layout_allocates_nothing() {
    exercise_cycles(Layout::Classic);
}

#[test]
fn a_cycle_of_the_packed_layout_allocates_nothing() {
    exercise_cycles(Layout::Packed);
}

#[test]
fn clocks_allocate_nothing() {
    let lockstep = Lockstep::new(0);
    let count = allocations(|| {
        for i in 0..100 {
            Monotonic.sleep_until(monotonic_ns() + 1000);
            lockstep.advance_to(i);
            lockstep.sleep_until(i);
        }
    });
    assert_eq!(count, 0);
}
