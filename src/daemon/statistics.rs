//! Distributions of the loop's times, per branch of the planner; fed from records, never on the control thread.

use super::deadlines::overran;
use crate::ipc::payload::{PlannerBranch, State, SupervisorState};
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Stages of a tick, those of its record first. `cycle` is from the wake-up to the end of sending; `report` is what the
/// control thread does after it: distances, the record and its way out. What a tick takes is both.
const STAGES: [&str; 8] = ["wakeup", "input", "estimate", "plan", "guard", "send", "cycle", "report"];
/// Those of the record.
const RECORDED: usize = STAGES.len() - 1;
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

/// What a tick planned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Branch {
    /// Nothing: there was nothing to plan.
    Idle,
    /// Nothing: deadlines had been missed, and the tensions were held or ramped.
    Late,
    /// In the safe subspace.
    Safe,
    /// In the warning subspace.
    Warning,
}

impl Branch {
    pub(crate) fn of(state: &State) -> Self {
        match PlannerBranch::from_wire(state.planner_branch) {
            Some(PlannerBranch::Safe) => Self::Safe,
            None | Some(PlannerBranch::None) => match SupervisorState::from_wire(state.supervisor) {
                Some(SupervisorState::Holding | SupervisorState::Tracking | SupervisorState::Homing) => Self::Late,
                _ => Self::Idle,
            },
            Some(_) => Self::Warning,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Late => "late",
            Self::Safe => "safe",
            Self::Warning => "warning",
        }
    }
}

/// The time after sending of a tick, which is over only when its record has left.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AfterSending {
    pub(crate) branch: Branch,
    pub(crate) report_ns: u64,
}

/// Times of a tick: what of a record the histograms need.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Times {
    branch: Branch,
    stages_ns: [u64; RECORDED],
}

impl Times {
    pub(crate) fn of(state: &State) -> Self {
        let t = &state.timing;
        let stages_ns = [t.wakeup_ns, t.input_ns, t.estimate_ns, t.plan_ns, t.guard_ns, t.send_ns, t.cycle_ns];
        Self { branch: Branch::of(state), stages_ns }
    }

    /// Whether the torques left after the end of their period.
    fn overran(&self, period_ns: u64) -> bool {
        let [wakeup_ns, .., cycle_ns] = self.stages_ns;
        overran(wakeup_ns, cycle_ns, period_ns)
    }
}

/// Histograms of every stage by branch.
#[derive(Debug, Default)]
pub(crate) struct Statistics {
    branches: BTreeMap<Branch, Vec<Histogram<u64>>>,
    overran: u64,
}

impl Statistics {
    /// Counts a tick; `period_ns` is 0 in lockstep, where nothing is due.
    pub(crate) fn note(&mut self, times: &Times, period_ns: u64) {
        for (histogram, time) in self.histograms(times.branch).iter_mut().zip(times.stages_ns) {
            histogram.saturating_record(time);
        }
        self.overran += u64::from(times.overran(period_ns));
    }

    /// Counts what followed.
    pub(crate) fn note_after(&mut self, after: &AfterSending) {
        if let Some(histogram) = self.histograms(after.branch).last_mut() {
            histogram.saturating_record(after.report_ns);
        }
    }

    fn histograms(&mut self, branch: Branch) -> &mut Vec<Histogram<u64>> {
        self.branches.entry(branch).or_insert_with(|| {
            // 1 ns to 100 s with three digits: valid bounds, so that none is missing.
            STAGES.iter().filter_map(|_| Histogram::new_with_bounds(1, LONGEST_NS, 3).ok()).collect()
        })
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
        self.branches.iter().map(|(branch, h)| (branch.name().to_owned(), stages(h))).collect()
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
    fn a_tick_that_held_because_it_was_late_is_not_idle() {
        use SupervisorState::{Arming, Disarmed, Faulted, Holding, Homing, Stopping, Tracking};
        let branch = |supervisor: SupervisorState, planned: PlannerBranch| {
            let (supervisor, planner_branch) = (supervisor.wire(), planned.wire());
            Branch::of(&State { supervisor, planner_branch, ..State::default() }).name()
        };
        for supervisor in [Holding, Tracking, Homing] {
            assert_eq!(branch(supervisor, PlannerBranch::None), "late", "{supervisor:?}");
            assert_eq!(branch(supervisor, PlannerBranch::Safe), "safe");
            assert_eq!(branch(supervisor, PlannerBranch::Swarm), "warning");
        }
        for supervisor in [Disarmed, Arming, Stopping, Faulted] {
            assert_eq!(branch(supervisor, PlannerBranch::None), "idle", "{supervisor:?}");
        }
    }

    #[test]
    fn what_follows_sending_is_a_stage_of_its_own() {
        let mut statistics = Statistics::default();
        let mut state = State::default();
        (state.timing.cycle_ns, state.planner_branch) = (300_000, PlannerBranch::Safe.wire());
        statistics.note(&Times::of(&state), 0);
        assert_eq!(statistics.stages()["safe"]["report"].count, 0);
        statistics.note_after(&AfterSending { branch: Branch::Safe, report_ns: 40_000 });
        let stages = statistics.stages();
        let (cycle, report) = (stages["safe"]["cycle"], stages["safe"]["report"]);
        assert_eq!((cycle.count, report.count), (1, 1));
        assert!((report.max - 40.0).abs() < 0.1 && (cycle.max - 300.0).abs() < 1.0);
    }

    #[test]
    fn torques_that_left_after_their_period_are_counted() {
        let mut statistics = Statistics::default();
        let mut state = State::default();
        (state.timing.wakeup_ns, state.timing.cycle_ns) = (400_000, 700_000);
        statistics.note(&Times::of(&state), 1_000_000);
        statistics.note(&Times::of(&state), 2_000_000);
        statistics.note(&Times::of(&state), 0);
        assert_eq!(statistics.overran(), 1);
    }
}
