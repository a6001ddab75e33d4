//! Distributions of the loop's times, per branch of the planner; fed from records, never on the control thread.

use crate::ipc::payload::{PlannerBranch, State};
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Stages of a tick.
const STAGES: [&str; 7] = ["wakeup", "input", "estimate", "plan", "guard", "send", "cycle"];
/// Longest time told apart (ns); what is longer counts as this.
const LONGEST_NS: u64 = 100_000_000_000;

/// A distribution (us).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99 of 100 are below.
    pub p99: f64,
    /// 999 of 1000 are below.
    pub p999: f64,
    /// Largest.
    pub max: f64,
    /// How many.
    pub count: u64,
}

/// Stage to distribution.
pub type Stages = BTreeMap<String, Percentiles>;

/// Times of a tick: what of a record the histograms need.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Times {
    branch: &'static str,
    stages_ns: [u64; STAGES.len()],
}

impl Times {
    pub(crate) fn of(state: &State) -> Self {
        let t = &state.timing;
        let branch = match PlannerBranch::from_wire(state.planner_branch) {
            None | Some(PlannerBranch::None) => "idle",
            Some(PlannerBranch::Safe) => "safe",
            Some(_) => "warning",
        };
        let stages_ns = [t.wakeup_ns, t.input_ns, t.estimate_ns, t.plan_ns, t.guard_ns, t.send_ns, t.cycle_ns];
        Self { branch, stages_ns }
    }

    /// Whether the torques left after the end of their period. The wake-up's delay counts from the tick that was due
    /// first; those left out since are counted as missed, and this one belongs to the last.
    fn overran(&self, period_ns: u64) -> bool {
        let [wakeup_ns, .., cycle_ns] = self.stages_ns;
        wakeup_ns % period_ns.max(1) + cycle_ns > period_ns
    }
}

/// Histograms of every stage by branch.
#[derive(Debug, Default)]
pub(crate) struct Statistics {
    branches: BTreeMap<&'static str, Vec<Histogram<u64>>>,
    overran: u64,
}

impl Statistics {
    /// Counts a tick; `period_ns` is 0 in lockstep, where nothing is due.
    pub(crate) fn note(&mut self, times: &Times, period_ns: u64) {
        let histograms = self.branches.entry(times.branch).or_insert_with(|| {
            // 1 ns to 100 s with three digits: valid bounds, so that none is missing.
            STAGES.iter().filter_map(|_| Histogram::new_with_bounds(1, LONGEST_NS, 3).ok()).collect()
        });
        for (histogram, time) in histograms.iter_mut().zip(times.stages_ns) {
            histogram.saturating_record(time);
        }
        self.overran += u64::from(period_ns > 0 && times.overran(period_ns));
    }

    /// Ticks whose torques left after the end of their period.
    pub(crate) fn overran(&self) -> u64 {
        self.overran
    }

    pub(crate) fn stages(&self) -> BTreeMap<String, Stages> {
        let us = |ns: u64| ns as f64 * 1e-3;
        let percentiles = |h: &Histogram<u64>| Percentiles {
            p50: us(h.value_at_quantile(0.5)),
            p99: us(h.value_at_quantile(0.99)),
            p999: us(h.value_at_quantile(0.999)),
            max: us(h.max()),
            count: h.len(),
        };
        let stages = |h: &Vec<Histogram<u64>>| {
            STAGES.iter().zip(h).map(|(stage, h)| ((*stage).to_owned(), percentiles(h))).collect()
        };
        self.branches.iter().map(|(branch, h)| ((*branch).to_owned(), stages(h))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_counted_with_the_branch_that_planned() {
        let mut statistics = Statistics::default();
        let mut state = State::default();
        for k in 1..=1000 {
            state.planner_branch = PlannerBranch::Safe.wire();
            state.timing.plan_ns = 1000 * k;
            statistics.note(&Times::of(&state), 0);
        }
        state.planner_branch = PlannerBranch::Seeded.wire();
        statistics.note(&Times::of(&state), 0);
        let stages = statistics.stages();
        let plan = stages["safe"]["plan"];
        assert_eq!((plan.count, stages["warning"]["plan"].count), (1000, 1));
        assert!((plan.p50 - 500.0).abs() < 1.0 && (plan.p99 - 990.0).abs() < 1.0, "{plan:?}");
        assert!(!stages.contains_key("idle"));
    }

    #[test]
    fn torques_that_leave_after_the_period_are_counted_once_and_those_of_a_tick_that_was_left_out_not() {
        const PERIOD_NS: u64 = 1_000_000;
        let overran = |wakeup_ns, cycle_ns| {
            let mut statistics = Statistics::default();
            let mut state = State::default();
            (state.timing.wakeup_ns, state.timing.cycle_ns) = (wakeup_ns, cycle_ns);
            statistics.note(&Times::of(&state), PERIOD_NS);
            statistics.overran()
        };
        assert_eq!(overran(0, PERIOD_NS), 0);
        assert_eq!(overran(1, PERIOD_NS), 1);
        assert_eq!(overran(400_000, 700_000), 1);
        // Three ticks were left out, and the one that ran was in time.
        assert_eq!(overran(3 * PERIOD_NS + 100_000, 700_000), 0);
        assert_eq!(overran(3 * PERIOD_NS + 400_000, 700_000), 1);
    }
}
