//! Missed deadlines, and what they lead to: hold, ramp, fault.
//!
//! A deadline is missed by a tick that is left out, for the loop woke when the next one was due, and by a tick whose
//! torques leave after its period. It is deadlines that are counted and not late ticks: a tick that follows an overrun
//! does not plan, so it is quick and in time, and by its punctuality a loop whose planning never fits would look healthy
//! for ever; and a stall of 90 periods is 90 periods in which the drives kept an old torque, not one late tick.
//!
//! The count leaks: [`FORGET_TICKS`] ticks that planned and were in time forget one miss. A tick that did not plan
//! forgets nothing, for it has not shown that planning fits. So a loop that misses every sixth deadline or more ends in
//! the fault sooner or later, and one that misses one in a hundred never gets beyond holding for a tick.
//!
//! | misses not forgotten | a tick that finds new ones | a tick that finds none |
//! |---|---|---|
//! | up to `overruns_hold` | holds the last tensions | plans |
//! | above it | ramps | ramps on, until [`FORGET_TICKS`] in a row found none; then it plans, as a trial |
//! | `overruns_fault` | fault | - |

use crate::config::LoopConfig;

/// Ticks in time that forget one missed deadline, and that a ramp waits for before planning is tried again.
pub const FORGET_TICKS: u32 = 5;

/// What missed deadlines demand of a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Demand {
    /// Nothing.
    Plan,
    /// Keep the last tensions.
    Hold,
    /// Ramp to the safe tension.
    Ramp,
}

/// The leaking count.
#[derive(Debug, Clone)]
pub(super) struct Overruns {
    hold: u32,
    fault: u32,
    /// Misses times [`FORGET_TICKS`].
    shares: u64,
    /// Ticks in a row that found no deadline missed.
    in_time: u32,
    /// The tick before planned.
    planned: bool,
}

impl Overruns {
    pub(super) fn new(timing: &LoopConfig) -> Self {
        let (hold, fault) = (timing.overruns_hold, timing.overruns_fault);
        Self { hold, fault, shares: 0, in_time: u32::MAX, planned: false }
    }

    /// Begins a tick that found `missed` deadlines missed since the one before. While nothing is planned nothing counts.
    pub(super) fn begin(&mut self, planning: bool, missed: u32) {
        if !planning {
            (self.shares, self.in_time) = (0, u32::MAX);
        } else if missed > 0 {
            self.shares += u64::from(missed) * u64::from(FORGET_TICKS);
            self.in_time = 0;
        } else {
            self.shares = self.shares.saturating_sub(u64::from(self.planned));
            self.in_time = self.in_time.saturating_add(1);
        }
    }

    /// Ends it: whether it plans.
    pub(super) fn end(&mut self, planned: bool) {
        self.planned = planned;
    }

    /// Missed deadlines that are not forgotten; a part of one counts as one.
    pub(super) fn count(&self) -> u32 {
        self.shares.div_ceil(u64::from(FORGET_TICKS)).min(u64::from(u32::MAX)) as u32
    }

    /// Whether there are too many of them.
    pub(super) fn is_fault(&self) -> bool {
        self.shares >= u64::from(self.fault) * u64::from(FORGET_TICKS)
    }

    pub(super) fn demand(&self) -> Demand {
        if self.shares > u64::from(self.hold) * u64::from(FORGET_TICKS) && self.in_time < FORGET_TICKS {
            Demand::Ramp
        } else if self.in_time == 0 {
            Demand::Hold
        } else {
            Demand::Plan
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overruns(hold: u32, fault: u32) -> Overruns {
        Overruns { hold, fault, shares: 0, in_time: u32::MAX, planned: false }
    }

    /// Ticks with these misses; what each had to do.
    fn run(o: &mut Overruns, missed: impl IntoIterator<Item = u32>) -> Vec<Demand> {
        let tick = |missed| {
            o.begin(true, missed);
            let demand = o.demand();
            o.end(demand == Demand::Plan);
            demand
        };
        missed.into_iter().map(tick).collect()
    }

    use Demand::{Hold, Plan, Ramp};

    #[test]
    fn a_single_miss_holds_for_a_tick_and_is_forgotten_by_five_that_planned_in_time() {
        let mut o = overruns(2, 10);
        assert_eq!(run(&mut o, [0, 1, 0]), [Plan, Hold, Plan]);
        // The tick that held was in time and forgets nothing; the next four that planned leave a fifth.
        run(&mut o, [0; 4]);
        assert_eq!((o.shares, o.count()), (1, 1));
        run(&mut o, [0]);
        assert_eq!((o.shares, o.count()), (0, 0));
        run(&mut o, [0; 10]);
        assert_eq!(o.shares, 0, "punctuality cannot be saved up");
    }

    #[test]
    fn a_stall_counts_by_its_length() {
        assert_eq!(run(&mut overruns(2, 10), [2, 0]), [Hold, Plan]);
        assert_eq!(run(&mut overruns(2, 10), [3, 0, 0, 0, 0, 0]), [Ramp, Ramp, Ramp, Ramp, Ramp, Plan]);
        let mut o = overruns(2, 10);
        run(&mut o, [9]);
        assert!(!o.is_fault());
        let mut o = overruns(2, 10);
        run(&mut o, [10]);
        assert!(o.is_fault() && o.count() == 10);
    }

    #[test]
    fn a_ramp_forgets_nothing_and_a_trial_that_fails_adds_to_the_count() {
        let mut o = overruns(2, 10);
        run(&mut o, [4]);
        for more in 5..10 {
            // Five ticks in time without planning, and the trial at the end of them overruns.
            assert_eq!(run(&mut o, [0; 5]), [Ramp, Ramp, Ramp, Ramp, Plan]);
            assert_eq!(run(&mut o, [1]), [Ramp]);
            assert_eq!(o.count(), more);
        }
        assert!(!o.is_fault());
        run(&mut o, [0, 0, 0, 0, 0, 1]);
        assert!(o.is_fault());
    }

    #[test]
    fn planning_goes_on_once_a_trial_was_in_time_and_the_count_leaks_from_then_on() {
        let mut o = overruns(2, 10);
        run(&mut o, [5, 0, 0, 0, 0]);
        assert_eq!(run(&mut o, [0; 20]), [Plan; 20]);
        assert_eq!((o.shares, o.count()), (25 - 19, 2));
    }

    #[test]
    fn nothing_counts_while_nothing_is_planned() {
        let mut o = overruns(2, 10);
        run(&mut o, [9]);
        o.begin(false, 50);
        assert_eq!((o.count(), o.demand()), (0, Plan));
        assert_eq!(run(&mut o, [0]), [Plan]);
    }
}
