//! The control thread itself, as the daemon runs it, from inputs to frames on the bus: it allocates nothing.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "daemon_support/mod.rs"]
mod support;

use assert_no_alloc::{AllocDisabler, assert_no_alloc, permit_alloc};
use sinew::daemon::{AutoRequests, Daemon, LockstepOptions, Options};
use sinew::ipc::payload::SupervisorState;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use support::*;

#[global_allocator]
static GUARD: AllocDisabler = AllocDisabler;

/// Ticks of the claim.
const TICKS: u64 = 10_000;
static GUARDED: AtomicU64 = AtomicU64::new(0);

/// Every tick of the control thread comes through here, the arming and the observer's start among them; an allocation
/// under the guard ends the process.
fn around(tick: &mut dyn FnMut()) {
    assert_no_alloc(tick);
    GUARDED.fetch_add(1, Ordering::Relaxed);
}

#[test]
fn ten_thousand_ticks_of_the_control_thread_allocate_nothing() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, true, &[]);
    let options = Options {
        lockstep: Some(LockstepOptions { obstacles: vec![SOURCE], target: true, ..Default::default() }),
        auto: AutoRequests { arm: true, track: true },
        ticks: Some(TICKS),
        around_tick: Some(around),
        ..Options::default()
    };
    let daemon = Daemon::start(&place.config(), &options).unwrap();
    let mut client = TickClient::new(&place);
    let (mut tracked, mut warned) = (0_u64, 0_u64);
    client.run(
        |state| state.header.tick + 1 == TICKS,
        |state| {
            assert_eq!(state.fault_code, 0, "at tick {}", state.header.tick);
            tracked += u64::from(state.supervisor == SupervisorState::Tracking.wire());
            warned += u64::from(state.planner_branch > 1);
        },
    );
    drop(client);
    daemon.wait(&AtomicBool::new(true), |_| {}).unwrap();
    assert!(GUARDED.load(Ordering::Relaxed) >= TICKS);
    assert!(tracked > TICKS / 2 && warned > 100, "{tracked} ticks tracked, {warned} in the warning subspace");
}

#[test]
fn the_guard_sees_an_allocation() {
    // In a process of its own, for the guard ends it.
    if std::env::var_os("SINEW_TEST_ALLOCATE").is_some() {
        around(&mut || drop(std::hint::black_box(vec![0_u8; 100])));
        permit_alloc(|| println!("survived"));
        return;
    }
    let out = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "the_guard_sees_an_allocation", "--nocapture"])
        .env("SINEW_TEST_ALLOCATE", "1")
        .output()
        .unwrap();
    assert!(!out.status.success());
    assert!(!String::from_utf8_lossy(&out.stdout).contains("survived"));
}
