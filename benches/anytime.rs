//! The anytime curve: how far each branch's answer is from the best known optimum for the time that it was given.
//!
//! Every golden planning step of the warning subspace is planned again and again with a deadline of 10 us to 10 ms. An
//! answer is judged by what it does: its tensions are applied to the model for one lookahead, and the cost (15a) of
//! where the arm really ends plus the penalty (28) of its distances there is compared with the same sum for the golden
//! optimum (or for the best answer seen, where that is lower). A planner cannot stop inside its first Newton iteration,
//! so the time spent, not the one given, is the curve's abscissa.
//!
//! `cargo bench --bench anytime` (about a minute after building) writes `benches/results/anytime.csv`, `anytime.svg`
//! and prints the Newton counts.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a bench may panic and print

#[path = "plot/mod.rs"]
mod plot;
#[path = "../tests/support/mod.rs"]
mod support;

use plot::Line;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::{Body, BodyGeometry, penalty};
use sinew::config::WarningBranch;
use sinew::integrator::{Scheme, Stepper};
use sinew::model::State;
use sinew::planner::{Branch, Deadline};
use std::time::{Duration, Instant};
use support::planning::{PlanCase, plan_cases};

const BRANCHES: [(WarningBranch, &str); 4] = [
    (WarningBranch::Seeded, "seeded"),
    (WarningBranch::Complementarity, "complementarity"),
    (WarningBranch::Swarm, "swarm"),
    (WarningBranch::StandardSwarm, "standard swarm"),
];
const BUDGETS_US: [u64; 13] = [10, 50, 100, 150, 200, 300, 500, 700, 1_000, 2_000, 3_000, 5_000, 10_000];
/// Plans of one case with one budget, each with a seed of its own.
const REPEATS: u64 = 7;
/// Gaps below this are drawn at it: they are rounding.
const GAP_MIN: f64 = 1e-9;

/// The deadline of one plan.
struct Until {
    begin: Instant,
    until: Duration,
}

impl Deadline for Until {
    fn used(&mut self) -> f64 {
        self.begin.elapsed().as_secs_f64() / self.until.as_secs_f64()
    }
}

/// What one plan came to.
struct Sample {
    branch: usize,
    budget: usize,
    case: usize,
    time_us: f64,
    cost: f64,
    newton: usize,
    evaluations: usize,
    converged: bool,
}

fn main() {
    let cases: Vec<PlanCase> = plan_cases().into_iter().filter(in_warning).collect();
    assert!(!cases.is_empty(), "no golden step lies in the warning subspace");
    let mut samples = Vec::new();
    let mut best = Vec::new();
    for (k, case) in cases.iter().enumerate() {
        let mut judge = Judge::new(case);
        let optimum: Vec<f64> = support::numbers(&case.data["u_opt"]);
        let mut least = judge.cost(case, &optimum);
        for (b, (branch, _)) in BRANCHES.iter().enumerate() {
            let mut planner = case.planner(*branch);
            for (t, budget) in BUDGETS_US.iter().enumerate() {
                for seed in 0..REPEATS {
                    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
                    let until = Duration::from_micros(*budget);
                    planner.forget();
                    let begin = Instant::now();
                    let report = case.plan(&mut planner, &mut rng, &mut Until { begin, until });
                    let time_us = begin.elapsed().as_nanos() as f64 / 1e3;
                    let cost = judge.cost(case, planner.tensions());
                    least = least.min(cost);
                    samples.push(Sample {
                        branch: b,
                        budget: t,
                        case: k,
                        time_us,
                        cost,
                        newton: report.iterations,
                        evaluations: report.evaluations,
                        converged: report.status == sinew::planner::Status::Converged,
                    });
                }
            }
        }
        best.push(least);
    }
    report(&samples, &best, cases.len());
}

/// Whether the step's iterates meet the warning subspace.
fn in_warning(case: &PlanCase) -> bool {
    let mut planner = case.planner(WarningBranch::Complementarity);
    let report = case.plan(&mut planner, &mut Xoshiro256PlusPlus::seed_from_u64(1), &mut || false);
    report.branch == Branch::Warning
}

/// Applies tensions and says what comes of it.
struct Judge {
    arm: sinew::model::Arm,
    stepper: Stepper,
    scheme: Scheme,
    body: Body,
    next: State,
    frames: [Vec<nalgebra::Vector3<f64>>; 2],
}

impl Judge {
    fn new(case: &PlanCase) -> Self {
        let arm = case.arm();
        let nodes = arm.node_count() + 1;
        Self {
            stepper: Stepper::new(&arm),
            scheme: Scheme::new(case.config.rho_inf),
            body: Body::new(&BodyGeometry::from_arm(&case.config), case.settings.body, case.settings.body_radius_m),
            next: case.state.clone(),
            frames: [vec![nalgebra::Vector3::zeros(); nodes], vec![nalgebra::Vector3::zeros(); nodes]],
            arm,
        }
    }

    /// (15a) plus the penalties of (28) at the end of the step; infinite where the model cannot follow.
    fn cost(&mut self, case: &PlanCase, u: &[f64]) -> f64 {
        let eta = case.settings.lookahead_s;
        if self.stepper.step(&self.arm, &self.scheme, eta, &case.state, u, 40, &mut self.next).is_err() {
            return f64::INFINITY;
        }
        let mut scratch = vec![0.0; 4 * self.arm.segment_count()];
        let mut cost = case.goal.error_cost(&self.arm, &self.next, &mut scratch);
        for (i, (u, v)) in u.iter().zip(&case.u_previous).enumerate() {
            cost += u * u + case.change[self.arm.cable_segment[i]] * (u - v).powi(2);
        }
        let [r, t] = &mut self.frames;
        self.arm.frames_into(&self.next.q, r, t);
        let clearance = case.settings.clearance_m;
        for row in self.body.find(r, t, &case.obstacles, clearance).rows {
            let length = case.obstacles.as_slice()[row.obstacle].penalty_length();
            // Micrometres are what the exact branches leave; the penalty is for the rest.
            let d = (row.distance + 1e-6).min(clearance);
            cost += case.settings.swarm.penalty * penalty(d, clearance, length).0;
        }
        cost
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    if values.is_empty() { f64::NAN } else { values[values.len() / 2] }
}

fn report(samples: &[Sample], best: &[f64], cases: usize) {
    let mut rows = Vec::new();
    let mut lines = Vec::new();
    println!(
        "{cases} golden steps in the warning subspace, {REPEATS} seeds each; gap: cost over the best known, less one"
    );
    println!(
        "{:16} {:>9} {:>11} {:>12} {:>12} {:>7} {:>12} {:>11}",
        "branch", "given us", "spent us", "gap median", "gap worst", "Newton", "evaluations", "converged %"
    );
    for (b, (_, name)) in BRANCHES.iter().enumerate() {
        let mut points = Vec::new();
        for (t, budget) in BUDGETS_US.iter().enumerate() {
            let of = || samples.iter().filter(|s| s.branch == b && s.budget == t);
            let count = of().count() as f64;
            let gap = |s: &Sample| s.cost / best[s.case] - 1.0;
            let time = median(of().map(|s| s.time_us).collect());
            let middle = median(of().map(gap).collect());
            let worst = of().map(gap).fold(0.0, f64::max);
            let newton = of().map(|s| s.newton as f64).sum::<f64>() / count;
            let evaluations = of().map(|s| s.evaluations as f64).sum::<f64>() / count;
            let converged = 100.0 * of().filter(|s| s.converged).count() as f64 / count;
            println!(
                "{name:16} {budget:9} {time:11.0} {middle:12.2e} {worst:12.2e} {newton:7.1} {evaluations:12.0} {converged:11.0}"
            );
            rows.push(format!(
                "{name},{budget},{time:.1},{middle:.3e},{worst:.3e},{newton:.2},{evaluations:.0},{converged:.0}"
            ));
            points.push((time, middle.max(GAP_MIN)));
        }
        // Budgets that end in the same iteration give the same point.
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        lines.push(Line { name: (*name).to_owned(), points });
    }
    let header = "branch,given_us,spent_us_median,gap_median,gap_worst,newton_mean,evaluations_mean,converged_percent";
    plot::write_csv("anytime.csv", header, &rows).unwrap();
    plot::chart(
        "anytime.svg",
        "Cost above the best known against time spent (golden steps near obstacles)",
        "time spent (us)",
        "cost gap (relative)",
        &lines,
    )
    .unwrap();
}
