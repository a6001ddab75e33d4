//! Claims about a loop in real time whose ticks take longer than their period: hold, ramp, fault.
//!
//! Periods are 50 ms here and limits generous, so that what the test overruns by is more than what a busy machine adds.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "daemon_support/mod.rs"]
mod support;

use sinew::daemon::status::StatusReport;
use sinew::daemon::{AutoRequests, Daemon, Options};
use sinew::ipc::payload::SupervisorState;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use support::*;

const PERIOD: Duration = Duration::from_millis(50);

/// By how much the ticks are longer (us): all of them, and the next one alone.
static EVERY_US: AtomicU64 = AtomicU64::new(0);
static ONCE_US: AtomicU64 = AtomicU64::new(0);

/// On the control thread: a tick that computes for longer.
fn lengthen(tick: &mut dyn FnMut()) {
    let us = EVERY_US.load(Ordering::Acquire) + ONCE_US.swap(0, Ordering::AcqRel);
    std::thread::sleep(Duration::from_micros(us));
    tick();
}

fn micros(periods: f64) -> u64 {
    PERIOD.mul_f64(periods).as_micros() as u64
}

/// A tick as it was recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tick {
    mode: u64,
    /// A planner ran.
    planned: bool,
    /// Sum of the commanded tensions (N).
    tension_n: f64,
    fault: u64,
}

/// An arm that holds 40 N a cable, recorded, in a loop with these limits.
struct Held {
    daemon: Daemon,
    plant: Plant,
    place: Place,
}

impl Held {
    fn new(hold: u32, fault: u32) -> Self {
        for us in [&EVERY_US, &ONCE_US] {
            us.store(0, Ordering::Release);
        }
        let place = Place::new(|_, text| {
            text.replace("period_s = 0.01", "period_s = 0.05")
                .replace("overruns_hold = 1000", &format!("overruns_hold = {hold}"))
                .replace("overruns_fault = 10000", &format!("overruns_fault = {fault}"))
        });
        let config = place.config();
        assert_eq!((config.timing.overruns_hold, config.timing.overruns_fault), (hold, fault));
        assert_eq!(config.timing.period_s, PERIOD.as_secs_f64());
        let plant = Plant::start(&place, false, &[]);
        let options = Options {
            record: Some(place.folder.path().join("daemon.mcap")),
            auto: AutoRequests { arm: true, track: false },
            around_tick: Some(lengthen),
            start_tensions_n: Some(vec![40.0; 24]),
            ..Options::default()
        };
        let held = Self { daemon: Daemon::start(&config, &options).unwrap(), plant, place };
        held.until("holding", |s| s.mode == "holding");
        held
    }

    fn until(&self, what: &str, condition: impl Fn(&StatusReport) -> bool) -> StatusReport {
        let deadline = Instant::now() + WAIT;
        loop {
            let report = self.daemon.status();
            if condition(&report) {
                return report;
            }
            assert!(Instant::now() < deadline, "{what}: {report:#?}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Stops; every tick from the first that held.
    fn end(self) -> Vec<Tick> {
        EVERY_US.store(0, Ordering::Release);
        let Self { daemon, plant, place } = self;
        daemon.wait(&AtomicBool::new(true), |_| {}).unwrap();
        drop(plant);
        let mut ticks = Vec::new();
        sinew::recording::read_each(&place.folder.path().join("daemon.mcap"), |message| {
            if message.topic.ends_with("/state") {
                let v = &message.value;
                let tensions = v["tension_command_n"].as_array().unwrap();
                ticks.push(Tick {
                    mode: v["supervisor"].as_u64().unwrap(),
                    planned: v["planner_branch"].as_u64().unwrap() != 0,
                    tension_n: tensions.iter().map(|u| u.as_f64().unwrap()).sum(),
                    fault: v["fault_code"].as_u64().unwrap(),
                });
            }
        })
        .unwrap();
        let first = ticks.iter().position(|t| t.mode == HOLDING).unwrap();
        ticks.split_off(first)
    }
}

const HOLDING: u64 = SupervisorState::Holding as u64;

/// Ticks of a hold that did not plan: the first that kept the tensions and the first that lowered them.
fn degraded(ticks: &[Tick]) -> (Option<usize>, Option<usize>) {
    let pairs = || ticks.windows(2).enumerate().filter(|(_, w)| w[1].mode == HOLDING && !w[1].planned);
    let kept = pairs().find(|(_, w)| w[1].tension_n == w[0].tension_n).map(|(k, _)| k + 1);
    let lowered = pairs().find(|(_, w)| w[1].tension_n < w[0].tension_n).map(|(k, _)| k + 1);
    (kept, lowered)
}

/// A loop whose every tick takes so many periods holds, ramps and faults, in this order.
fn overloaded(periods: f64) {
    let held = Held::new(20, 60);
    EVERY_US.store(micros(periods), Ordering::Release);
    let report = held.until("a fault", |s| s.fault.is_some());
    assert_eq!(report.fault.as_ref().map(|f| f.code), Some(50), "{report:#?}");
    assert!(report.fault.unwrap().detail >= 60);
    let ticks = held.end();
    let (Some(kept), Some(lowered)) = degraded(&ticks) else { panic!("no hold or no ramp: {ticks:?}") };
    let faulted = ticks.iter().position(|t| t.fault == 50).expect("the fault is recorded");
    assert!(kept < lowered && lowered < faulted, "{kept}, {lowered}, {faulted}: {ticks:?}");
    assert!(ticks[faulted].tension_n < 0.9 * ticks[kept].tension_n, "{ticks:?}");
}

#[test]
fn a_loop_whose_every_tick_takes_one_and_a_half_periods_holds_ramps_and_faults() {
    overloaded(1.5);
}

#[test]
fn a_loop_whose_every_tick_takes_five_periods_holds_ramps_and_faults() {
    overloaded(5.0);
}

#[test]
fn a_stall_that_stays_alone_is_counted_by_its_length_and_the_arm_holds_on() {
    let held = Held::new(30, 60);
    let before = held.daemon.status();
    ONCE_US.store(micros(20.0), Ordering::Release);
    held.until("the stall", |s| s.missed >= before.missed + 20);
    let after = held.until("more ticks", |s| s.ticks > before.ticks + 60);
    assert_eq!((after.mode.as_str(), after.fault), ("holding", None));
    let ticks = held.end();
    let (kept, lowered) = degraded(&ticks);
    assert!(kept.is_some() && lowered.is_none(), "{kept:?}, {lowered:?}: {ticks:?}");
}
