//! The clock at the ends of a tick's parts, and what the planner asks whether its time is over.

use crate::control::{Budget, Phase, StopWatch};
use crate::planner::Deadline;
use sinew_hal::clock::monotonic_ns;

/// Looks at CLOCK_MONOTONIC.
pub(super) struct Watch {
    /// `None` in lockstep, where only work counts.
    budget: Option<Budget>,
    scheduled_ns: u64,
    marks_ns: [u64; 3],
}

impl Watch {
    /// Of the tick scheduled for `scheduled_ns`, whose inputs were there at `began_ns`.
    pub(super) fn new(budget: Option<Budget>, scheduled_ns: u64, began_ns: u64) -> Self {
        Self { budget, scheduled_ns, marks_ns: [began_ns; 3] }
    }

    /// When each [`Phase`] ended (ns).
    pub(super) fn marks_ns(&self) -> [u64; 3] {
        self.marks_ns
    }
}

impl Deadline for Watch {
    fn used(&mut self) -> f64 {
        let Some(budget) = &self.budget else { return 0.0 };
        // Planning begins where the estimate ends: what inputs and observer took is not taken from the planner's own limit.
        let began_ns = self.marks_ns[Phase::Estimate as usize];
        let budget_ns = budget.left_ns(self.scheduled_ns, began_ns);
        if budget_ns == 0 { 1.0 } else { monotonic_ns().saturating_sub(began_ns) as f64 / budget_ns as f64 }
    }
}

impl StopWatch for Watch {
    fn mark(&mut self, phase: Phase) {
        self.marks_ns[phase as usize] = monotonic_ns();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, LoopConfig};

    const SECOND: u64 = 1_000_000_000;

    /// A watch of a tick with a period of 1000 s that was scheduled for and began at these times.
    fn watch(budget_s: Option<f64>, scheduled_ns: u64, began_ns: u64) -> Watch {
        let timing = LoopConfig { period_s: 1000.0, reserve_s: 100.0, ..Config::builtin().timing };
        Watch::new(Some(Budget::new(&timing, budget_s)), scheduled_ns, began_ns)
    }

    #[test]
    fn the_planners_own_limit_counts_from_where_planning_begins() {
        // The loop's clock may be younger than what the test would like to have passed: it lies ahead.
        let now_ns = monotonic_ns() + 2000 * SECOND;
        let mut watch = watch(Some(50.0), now_ns - 300 * SECOND, now_ns - 300 * SECOND);
        // Inputs and observer took 300 s, six times the limit.
        watch.marks_ns[Phase::Estimate as usize] = now_ns;
        assert_eq!(watch.used(), 0.0);
        watch.marks_ns[Phase::Estimate as usize] = monotonic_ns().saturating_sub(1);
        assert!(watch.used() > 0.0);
    }

    #[test]
    fn what_the_period_leaves_counts_from_the_tick_however_late_planning_begins() {
        let now_ns = monotonic_ns() + 2000 * SECOND;
        for (scheduled_s_ago, over) in [(0, false), (899, false), (901, true), (5000, true)] {
            let scheduled_ns = now_ns.saturating_sub(scheduled_s_ago * SECOND);
            let mut watch = watch(None, scheduled_ns, scheduled_ns);
            watch.marks_ns[Phase::Estimate as usize] = now_ns;
            assert_eq!(watch.used() >= 1.0, over, "{scheduled_s_ago} s");
        }
    }

    #[test]
    fn the_end_of_the_estimate_is_the_beginning_and_in_lockstep_time_never_runs_out() {
        let before_ns = monotonic_ns();
        let mut watch = Watch::new(None, 0, 0);
        watch.mark(Phase::Estimate);
        assert!(watch.marks_ns()[Phase::Estimate as usize] >= before_ns);
        assert_eq!((watch.marks_ns()[Phase::Plan as usize], watch.used()), (0, 0.0));
    }
}
