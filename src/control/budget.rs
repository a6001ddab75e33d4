//! How much time planning may use (design, section 9): pure arithmetic on times that the caller read.

use crate::config::LoopConfig;
use crate::planner::Deadline;
use sinew_hal::clock::seconds_to_ns;

/// A part of the tick, for the caller's stop watch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Encoders judged and state estimated.
    Estimate,
    /// Mode decided and tensions planned.
    Plan,
    /// Tensions checked.
    Guard,
}

/// The caller's clock, as far as the cycle may know it: the planner's deadline, and told of the tick's parts. Every
/// `FnMut() -> bool` is one, which says whether the time for planning is over.
pub trait StopWatch: Deadline {
    /// Told when a part of the tick has ended.
    fn mark(&mut self, _phase: Phase) {}
}

impl<F: FnMut() -> bool> StopWatch for F {}

/// Time that the planner may use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    period_ns: u64,
    reserve_ns: u64,
    most_ns: u64,
}

impl Budget {
    /// From the loop's settings; `budget_s` is the planner's own limit, if it has one.
    pub fn new(timing: &LoopConfig, budget_s: Option<f64>) -> Self {
        Self {
            period_ns: seconds_to_ns(timing.period_s),
            reserve_ns: seconds_to_ns(timing.reserve_s),
            most_ns: budget_s.map_or(u64::MAX, seconds_to_ns),
        }
    }

    /// Latest time (ns) at which the tensions of the tick scheduled for `scheduled_ns` must be handed over.
    pub const fn send_deadline_ns(&self, scheduled_ns: u64) -> u64 {
        scheduled_ns.saturating_add(self.period_ns)
    }

    /// What is left for planning that begins at `now_ns` (ns): until the send deadline less the reserve, at most the planner's
    /// own limit; 0 when it is over. The reserve is for guard, sending and the record: the next tick cannot begin before.
    pub const fn left_ns(&self, scheduled_ns: u64, now_ns: u64) -> u64 {
        let left = self.send_deadline_ns(scheduled_ns).saturating_sub(self.reserve_ns).saturating_sub(now_ns);
        if left < self.most_ns { left } else { self.most_ns }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn budget(most: Option<u64>) -> Budget {
        Budget { period_ns: 1_000, reserve_ns: 200, most_ns: most.unwrap_or(u64::MAX) }
    }

    #[test]
    fn the_budget_is_what_is_left_until_the_send_deadline_less_the_reserve() {
        let b = budget(None);
        assert_eq!(b.send_deadline_ns(5_000), 6_000);
        assert_eq!(b.left_ns(5_000, 5_000), 800);
        assert_eq!(b.left_ns(5_000, 5_300), 500);
    }

    #[test]
    fn no_budget_is_left_after_the_deadline_and_none_is_negative() {
        let b = budget(None);
        assert_eq!(b.left_ns(5_000, 5_800), 0);
        assert_eq!(b.left_ns(5_000, u64::MAX), 0);
    }

    #[test]
    fn the_planners_own_limit_caps_the_budget() {
        assert_eq!(budget(Some(300)).left_ns(5_000, 5_000), 300);
        assert_eq!(budget(Some(300)).left_ns(5_000, 5_700), 100);
    }
}
