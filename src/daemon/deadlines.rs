//! Which tick is due when, which are left out, and which deadlines were missed: arithmetic on times that were read
//! elsewhere.
//!
//! The deadline of a tick is the end of its period: by then its torques must have left. A loop that wakes when the next
//! tick is due leaves out those whose deadline is over; none is replayed.

/// Whether a tick's torques left after the end of its period (ns), by its record. The wake-up's delay counts from the tick
/// that was due first; those left out since missed deadlines of their own, and this one belongs to the last. `period_ns` is
/// 0 in lockstep, where nothing is due.
pub const fn overran(wakeup_ns: u64, cycle_ns: u64, period_ns: u64) -> bool {
    period_ns > 0 && wakeup_ns % period_ns + cycle_ns > period_ns
}

/// The loop's deadlines.
#[derive(Debug)]
pub(super) struct Deadlines {
    start_ns: u64,
    period_ns: u64,
    /// The next tick, or the one that has begun.
    tick: u64,
    left_out: u64,
    /// The torques of the tick before left after its period.
    overran: bool,
}

/// A tick that begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Begun {
    pub(super) tick: u64,
    /// When it was due (ns).
    pub(super) scheduled_ns: u64,
    /// The wake-up's delay (ns), counted from the tick that was due first.
    pub(super) wakeup_ns: u64,
    /// Deadlines missed since the tick before: ticks left out, and that tick itself if it overran.
    pub(super) missed: u32,
    /// Ticks left out so far.
    pub(super) left_out: u64,
}

impl Deadlines {
    /// Tick 0 is due at `start_ns`.
    pub(super) fn new(start_ns: u64, period_ns: u64) -> Self {
        Self { start_ns, period_ns, tick: 0, left_out: 0, overran: false }
    }

    /// The next tick.
    pub(super) fn tick(&self) -> u64 {
        self.tick
    }

    /// When it is due (ns).
    pub(super) fn due_ns(&self) -> u64 {
        self.start_ns + self.tick * self.period_ns
    }

    /// The loop woke.
    pub(super) fn begin(&mut self, woke_ns: u64) -> Begun {
        let wakeup_ns = woke_ns.saturating_sub(self.due_ns());
        let left_out = wakeup_ns / self.period_ns;
        self.tick += left_out;
        self.left_out += left_out;
        let missed = left_out + u64::from(self.overran);
        Begun {
            tick: self.tick,
            scheduled_ns: self.due_ns(),
            wakeup_ns,
            missed: u32::try_from(missed).unwrap_or(u32::MAX),
            left_out: self.left_out,
        }
    }

    /// The torques of the tick that began have left.
    pub(super) fn end(&mut self, sent_ns: u64) {
        self.overran = sent_ns > self.due_ns() + self.period_ns;
        self.tick += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, LoopConfig};
    use crate::control::obstacles::ObstacleDemand;
    use crate::control::supervisor::{Action, Observed, Progress};
    use crate::control::{DrivesInput, DrivesPhase, Fault, FaultList, Mode, Request, Supervisor};
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    const PERIOD_NS: u64 = 1_000;

    #[test]
    fn each_deadline_is_missed_once_by_whoever_missed_it() {
        let mut d = Deadlines::new(5_000, PERIOD_NS);
        let first = d.begin(5_100);
        assert_eq!((first.tick, first.scheduled_ns, first.wakeup_ns, first.missed), (0, 5_000, 100, 0));
        d.end(6_000);
        assert_eq!(d.begin(6_050).missed, 0, "at the end of the period is in time");
        // Tick 1 takes until 5 periods after its beginning: it overran, and 2 to 5 are left out.
        d.end(11_050);
        let next = d.begin(11_060);
        assert_eq!((next.tick, next.scheduled_ns, next.wakeup_ns), (6, 11_000, 4_060));
        assert_eq!((next.missed, next.left_out), (5, 4));
        d.end(11_500);
        // A loop that sleeps too long has missed what it left out, and nothing else.
        let slept = d.begin(15_999);
        assert_eq!((slept.tick, slept.missed, slept.left_out), (10, 3, 7));
        d.end(16_001);
        assert_eq!(d.begin(16_010).missed, 1, "it began in time, its torques did not leave in time");
    }

    #[test]
    fn a_record_tells_whether_its_tick_overran_and_nothing_of_those_left_out_before_it() {
        assert!(!overran(0, PERIOD_NS, PERIOD_NS) && overran(1, PERIOD_NS, PERIOD_NS));
        assert!(overran(400, 700, PERIOD_NS));
        // Three ticks were left out, and the one that ran was in time, or not.
        assert!(!overran(3 * PERIOD_NS + 100, 700, PERIOD_NS) && overran(3 * PERIOD_NS + 400, 700, PERIOD_NS));
        assert!(!overran(5, 1_000_000, 0), "in lockstep nothing is due");
    }

    /// What a run under a load came to.
    struct Ran {
        actions: Vec<Action>,
        mode: Mode,
        fault: Option<Fault>,
        /// Deadlines missed in all.
        missed: u64,
    }

    impl Ran {
        fn count(&self, action: Action) -> usize {
            self.actions.iter().filter(|a| **a == action).count()
        }

        fn first(&self, action: Action) -> Option<usize> {
            self.actions.iter().position(|a| *a == action)
        }
    }

    /// A holding arm under a load, in time that only computing and sleeping move: `cost` is what a tick takes (ns) that
    /// begins at a time and has this action, before its torques leave.
    fn run(overruns: Option<(u32, u32)>, ticks: usize, mut cost: impl FnMut(u64, Action) -> u64) -> Ran {
        let config = Config::builtin();
        let (hold, fault) = overruns.unwrap_or((config.timing.overruns_hold, config.timing.overruns_fault));
        let timing = LoopConfig { overruns_hold: hold, overruns_fault: fault, ..config.timing };
        let mut supervisor = Supervisor::new(&timing, &config.observer, false, false);
        let seen = |missed, request| Observed {
            tick: 0,
            now_ns: 0,
            request,
            drives: DrivesInput {
                phase: DrivesPhase::Enabled,
                ready: true,
                fault: None,
                bus_lost: None,
                emergency_stop: None,
            },
            faults: FaultList::default(),
            progress: Progress::Done,
            target_fresh: true,
            obstacles: ObstacleDemand::Proceed,
            hold: None,
            unreachable: false,
            at_safe_tension: false,
            at_home: false,
            lowered: true,
            bent: false,
            moves: false,
            missed,
        };
        supervisor.step(&seen(0, Some(Request::Arm)));
        supervisor.step(&seen(0, None));
        assert_eq!(supervisor.mode(), Mode::Holding);
        let (mut deadlines, mut now_ns, mut missed) = (Deadlines::new(0, PERIOD_NS), 0_u64, 0);
        let mut actions = Vec::new();
        while actions.len() < ticks && supervisor.mode() == Mode::Holding {
            now_ns = now_ns.max(deadlines.due_ns());
            let begun = deadlines.begin(now_ns);
            missed += u64::from(begun.missed);
            let action = supervisor.step(&seen(begun.missed, None)).action;
            actions.push(action);
            now_ns += cost(now_ns, action);
            deadlines.end(now_ns);
        }
        Ran { actions, mode: supervisor.mode(), fault: supervisor.latch().first.map(|latched| latched.fault), missed }
    }

    /// A load that planning alone has: holding and ramping take a tenth of the period.
    fn planning(cost_ns: u64) -> impl FnMut(u64, Action) -> u64 {
        move |_, action| if matches!(action, Action::Keep | Action::Ramp) { PERIOD_NS / 10 } else { cost_ns }
    }

    #[test]
    fn planning_that_never_fits_its_period_holds_then_ramps_then_is_a_fault() {
        for cost_ns in [1_100, 1_200, 1_500, 5_000, 20_000] {
            let ran = run(Some((20, 60)), 10_000, planning(cost_ns));
            assert_eq!(ran.mode, Mode::Faulted, "{cost_ns} ns of {PERIOD_NS}");
            assert!(matches!(ran.fault, Some(Fault::Overruns { count: 60.. })), "{:?}", ran.fault);
            let (held, ramped) = (ran.first(Action::Keep).unwrap(), ran.first(Action::Ramp).unwrap());
            assert!(held < ramped, "{held}, {ramped}");
            assert!(ran.actions.len() < 600, "{} ticks", ran.actions.len());
        }
    }

    #[test]
    fn a_load_in_every_tick_whatever_it_does_holds_then_ramps_then_is_a_fault() {
        for cost_ns in [1_200, 1_500, 5_000] {
            let ran = run(Some((20, 60)), 10_000, |_, _| cost_ns);
            assert_eq!(ran.mode, Mode::Faulted, "{cost_ns} ns of {PERIOD_NS}");
            assert!(ran.first(Action::Keep).unwrap() < ran.first(Action::Ramp).unwrap());
            assert!(ran.missed < 70, "at the limit, not long after: {}", ran.missed);
        }
    }

    #[test]
    fn the_shipped_limits_end_an_overload_within_a_second_of_ticks_of_10_ms() {
        for cost_ns in [1_200, 1_500, 5_000] {
            let ran = run(None, 10_000, planning(cost_ns));
            assert_eq!(ran.mode, Mode::Faulted);
            assert!(ran.actions.len() <= 100, "{} ticks", ran.actions.len());
        }
    }

    /// Stalls of this length at these intervals (ns) beside planning that takes a fifth of the period.
    fn stalling(stall_ns: u64, every_ns: u64) -> impl FnMut(u64, Action) -> u64 {
        let mut next_ns = every_ns;
        move |now_ns, _| {
            let stalls = now_ns >= next_ns;
            next_ns += if stalls { every_ns } else { 0 };
            if stalls { stall_ns } else { PERIOD_NS / 5 }
        }
    }

    /// The defaults of a loop at 1 kHz; `PERIOD_NS` stands for a millisecond.
    const KILOHERTZ: Option<(u32, u32)> = Some((20, 100));

    #[test]
    fn isolated_stalls_cost_a_tick_of_holding_each_and_never_more() {
        for stall_ms in [2, 6, 20] {
            let ran = run(KILOHERTZ, 20_000, stalling(PERIOD_NS * stall_ms - 300, 1_000_000));
            assert_eq!((ran.mode, ran.count(Action::Ramp)), (Mode::Holding, 0), "{stall_ms} ms every second");
            // Each leaves as many periods without torques in time as it is long, less the one that it ends in.
            assert!(ran.missed >= 19 * (stall_ms - 1), "{stall_ms} ms: {}", ran.missed);
            assert!((19..=20).contains(&ran.count(Action::Keep)), "{}", ran.count(Action::Keep));
        }
    }

    #[test]
    fn stalls_of_90_ms_ten_times_a_second_are_a_fault() {
        let ran = run(KILOHERTZ, 20_000, stalling(90 * PERIOD_NS, 100_000));
        assert_eq!(ran.fault.map(|f| f.code()), Some(50));
        assert!(ran.missed < 200, "with the second one: {}", ran.missed);
    }

    #[test]
    fn a_healthy_loop_with_its_sporadic_misses_goes_on_for_ever() {
        for share in [3e-4, 2e-3, 1e-2] {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(7);
            // The stalls of a shared machine: mostly under a period and a half, now and then several.
            let mut cost = |_, _| match rng.random_range(0.0..1.0) {
                x if x < 0.1 * share => PERIOD_NS * rng.random_range(2..6),
                x if x < share => PERIOD_NS * 3 / 2,
                _ => PERIOD_NS / 5,
            };
            let ran = run(KILOHERTZ, 1_000_000, &mut cost);
            assert_eq!((ran.mode, ran.count(Action::Ramp)), (Mode::Holding, 0), "{share}");
            assert!(ran.missed as f64 > 0.5e6 * share, "it did miss some: {}", ran.missed);
        }
    }
}
