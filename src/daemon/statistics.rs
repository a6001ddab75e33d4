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

/// Histograms of every stage by branch.
#[derive(Debug, Default)]
pub(crate) struct Statistics {
    branches: BTreeMap<&'static str, Vec<Histogram<u64>>>,
}

impl Statistics {
    pub(crate) fn note(&mut self, state: &State) {
        let t = &state.timing;
        let times = [t.wakeup_ns, t.input_ns, t.estimate_ns, t.plan_ns, t.guard_ns, t.send_ns, t.cycle_ns];
        let branch = match PlannerBranch::from_wire(state.planner_branch) {
            None | Some(PlannerBranch::None) => "idle",
            Some(PlannerBranch::Safe) => "safe",
            Some(_) => "warning",
        };
        let histograms = self.branches.entry(branch).or_insert_with(|| {
            // 1 ns to 100 s with three digits: valid bounds, so that none is missing.
            STAGES.iter().filter_map(|_| Histogram::new_with_bounds(1, LONGEST_NS, 3).ok()).collect()
        });
        for (histogram, time) in histograms.iter_mut().zip(times) {
            histogram.saturating_record(time);
        }
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
            statistics.note(&state);
        }
        state.planner_branch = PlannerBranch::Seeded.wire();
        statistics.note(&state);
        let stages = statistics.stages();
        let plan = stages["safe"]["plan"];
        assert_eq!((plan.count, stages["warning"]["plan"].count), (1000, 1));
        assert!((plan.p50 - 500.0).abs() < 1.0 && (plan.p99 - 990.0).abs() < 1.0, "{plan:?}");
        assert!(!stages.contains_key("idle"));
    }
}
