//! `[loop]`: the control thread's period, scheduling and what it does when it is late.

use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// Timing of the control thread.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoopConfig {
    /// Period (s), 1 to 100 ms.
    pub period_s: f64,
    /// Processor that the control thread is pinned to; `None` leaves it to the scheduler.
    pub cpu: Option<usize>,
    /// SCHED_FIFO priority 1 to 99; 0 keeps normal scheduling.
    pub priority: u8,
    /// Lock and pre-fault the process's memory.
    pub lock_memory: bool,
    /// Longest time that a processor may take to leave its idle state (s), 0 to 10 ms, asked for in whole microseconds;
    /// `None` does not ask.
    pub wake_latency_s: Option<f64>,
    /// Refuse to start without what is asked for above; otherwise run on degraded and say so.
    pub require_realtime: bool,
    /// Missed deadlines, as far as not forgotten, up to which the last tensions are held.
    pub overruns_hold: u32,
    /// After that, time in which the tensions are ramped to their least value (s).
    pub ramp_s: f64,
    /// Time in which held cables are let go after a fault (s).
    pub release_s: f64,
    /// Time given to the arm to be lowered when the daemon is told to end (s).
    pub stop_timeout_s: f64,
    /// Missed deadlines, as far as not forgotten, at which the supervisor faults; more than `overruns_hold`.
    pub overruns_fault: u32,
    /// Part of the period kept back for guard, sending and the record (s); the planner gets what is left before it.
    pub reserve_s: f64,
}

/// Time without a torque in time after which it is no longer enough to hold (s), where nothing else is configured: a few
/// ticks at 100 Hz, and at 1 kHz more than the longest stalls of a machine that is shared (5 ms in benches/results/loop).
const HOLD_S: f64 = 0.02;
/// The same for the fault (s): when the drives, too, give the daemon up (`drives.sync_timeout_s`).
const FAULT_S: f64 = 0.1;

/// `[loop]`.
pub static LOOP: TableSpec = TableSpec {
    header: "[loop]",
    name: "loop",
    about: "The control thread: its period, its scheduling, and what happens when it is late.",
    keys: &[
        Key::optional(
            "period_s",
            Kind::Float(Range::closed(0.001, 0.1)),
            "s",
            "a tenth of the lookahead, and what one classic bus carries",
            "Period. The planner's lookahead must be a whole multiple of it.",
        ),
        Key::optional(
            "cpu",
            Kind::Integer(0, 1023),
            "",
            "not pinned",
            "Processor that the control thread is pinned to.",
        ),
        Key::default("priority", Kind::Integer(0, 99), "", "80", "SCHED_FIFO priority; 0 keeps normal scheduling."),
        Key::default("lock_memory", Kind::Bool, "", "true", "Lock and pre-fault the memory."),
        Key::optional(
            "wake_latency_s",
            Kind::Float(Range::closed(0.0, 0.01)),
            "s",
            "not asked for",
            "Longest time that any processor may take to leave its idle state while the loop runs, in whole microseconds \
             (`/dev/cpu_dma_latency`). 0 wakes soonest, and the processors draw power as if they worked.",
        ),
        Key::default(
            "require_realtime",
            Kind::Bool,
            "",
            "false",
            "Refuse to start where processor, priority, memory lock or wake-up latency are not granted; otherwise run on \
             degraded.",
        ),
        Key::optional(
            "overruns_hold",
            Kind::Integer(0, 1000),
            "deadlines",
            "20 ms, at least 2",
            "Missed deadlines up to which a tick that finds one missed holds the last tensions. A tick misses its own if it \
             is left out or its torques leave after its period; five ticks that planned in time forget one miss.",
        ),
        Key::default(
            "ramp_s",
            Kind::Float(Range::above(0.0, 60.0)),
            "s",
            "0.5",
            "Above that, time in which the tensions are ramped to their least value; planning is tried again when five ticks \
             in a row were in time. Also the ramp of a stop and of a fault.",
        ),
        Key::default(
            "release_s",
            Kind::Float(Range::above(0.0, 600.0)),
            "s",
            "20.0",
            "Time in which a stop after a fault lets go of cables that are held (`drives.defaults.safe_hold`) where the arm can no \
             longer be lowered: slowly, and not around obstacles.",
        ),
        Key::default(
            "stop_timeout_s",
            Kind::Float(Range::closed(0.0, 3600.0)),
            "s",
            "120.0",
            "Time that the daemon, told to end (SIGTERM), gives the arm to be lowered to where it rests without torque; then the \
             tensions are taken off where it is. The unit's `TimeoutStopSec` must be longer. `sinew stop` waits as long as the way \
             is blocked; `sinew disarm` does not. 0: no stop lowers the arm; the tensions are ramped down where it is.",
        ),
        Key::optional(
            "overruns_fault",
            Kind::Integer(1, 10000),
            "deadlines",
            "0.1 s, at least 10",
            "Missed deadlines, less those forgotten, at which the supervisor faults; greater than `overruns_hold`.",
        ),
        Key::default(
            "reserve_s",
            Kind::Float(Range::closed(0.0, 0.05)),
            "s",
            "0.0002",
            "Part of the period kept back for what follows planning: guard, sending and the record (stages `guard`, `send` and \
             `report` of `sinew status`); at most half of it.",
        ),
    ],
};

/// Periods that a loop has where none is given (s).
const PERIODS_S: &[f64] = &[0.001, 0.002, 0.004, 0.005, 0.008, 0.01, 0.02, 0.025, 0.04, 0.05, 0.1];
/// Periods of a lookahead.
const PERIODS_OF_LOOKAHEAD: f64 = 10.0;
/// Time that one cable's frames take on a classic bus of 1 Mbit/s that is loaded by 70 % (s); see `sinew check`.
const CABLE_S: f64 = 0.00035;

/// The period of a loop for an arm that plans so far ahead (s): a tenth of it where one classic bus carries the arm's
/// cables so often.
fn default_period_s(scale: &Scale, lookahead_s: f64) -> f64 {
    let wanted = (lookahead_s / PERIODS_OF_LOOKAHEAD).max(CABLE_S * scale.cables as f64);
    // The next longer one only where the next shorter one is too short for the bus.
    let least = CABLE_S * scale.cables as f64;
    let shorter = PERIODS_S.iter().rev().find(|p| **p <= wanted * (1.0 + 1e-2) && **p >= least);
    let longer = || PERIODS_S.iter().find(|p| **p >= wanted);
    shorter.or_else(longer).copied().unwrap_or(0.1)
}

/// Reads `[loop]` for an arm whose planner looks so far ahead (s).
pub(super) fn read(table: &Section<'_>, scale: &Scale, lookahead_s: f64) -> LoopConfig {
    let period_s = table.float_opt("period_s").unwrap_or_else(|| default_period_s(scale, lookahead_s));
    // Rounded first: 0.02 s are 20 periods of 1 ms, not 20 and a bit.
    let periods = |seconds: f64| (seconds / period_s).round() as usize;
    let config = LoopConfig {
        period_s,
        cpu: table.count_opt("cpu"),
        priority: table.integer("priority") as u8,
        lock_memory: table.boolean("lock_memory"),
        wake_latency_s: table.float_opt("wake_latency_s"),
        require_realtime: table.boolean("require_realtime"),
        overruns_hold: table.count_opt("overruns_hold").unwrap_or_else(|| periods(HOLD_S).clamp(2, 1000)) as u32,
        ramp_s: table.float("ramp_s"),
        release_s: table.float("release_s"),
        stop_timeout_s: table.float("stop_timeout_s"),
        overruns_fault: table.count_opt("overruns_fault").unwrap_or_else(|| periods(FAULT_S).clamp(10, 10_000)) as u32,
        reserve_s: table.float("reserve_s"),
    };
    if config.overruns_fault <= config.overruns_hold {
        let help = format!(
            "permitted: {} to 10000 ticks (`overruns_hold` = {})",
            config.overruns_hold + 1,
            config.overruns_hold
        );
        table.refuse("overruns_fault", "not greater than `overruns_hold`", &help);
    }
    if config.reserve_s > config.period_s / 2.0 {
        let help = format!("permitted: 0 to {} s, half of `period_s`", config.period_s / 2.0);
        table.refuse("reserve_s", "more than half of the period", &help);
    }
    config
}
