//! The anytime curve: how far each branch's answer is from the best known one for the time that it was given.
//!
//! The steps are those at which distances hold the arm back: the golden ones (the shape example has them, the tip
//! example's golden steps are free), and steps of the tip example's open-loop run, spread over all that qualify. Each is
//! planned again and again with a deadline of 10 us to 10 ms.
//!
//! An answer is judged by what it does: its tensions are applied to the model for one lookahead. Its price is the cost
//! (15a) of where the arm really ends, plus the depth by which a distance is violated there times twice what a metre of
//! distance costs at the optimum. With such a factor no violation pays, so that the optimum of (15) is the cheapest
//! answer, and one that goes a little too deep does not set the measure. The gap is the price over that of the best
//! answer known: the complementarity branch's without a deadline, the golden optimum, or the best one seen.
//!
//! A planner cannot stop inside its first Newton iteration, so the time spent, not the one given, is the curve's
//! abscissa. The curve is that of the worst step: the largest over the steps of the median over the seeds. The table has
//! the median of all and the largest of all, too, into which goes whatever else the machine did at that moment.
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
use serde_json::Value;
use sinew::collision::{Body, BodyGeometry};
use sinew::config::{PlannerConfig, ScenarioConfig, WarningBranch};
use sinew::integrator::{Scheme, Stepper};
use sinew::model::State;
use sinew::planner::{Branch, Deadline, Goal};
use sinew::scenario::{Course, Run};
use std::time::{Duration, Instant};
use support::planning::{PlanCase, plan_cases};
use support::settings::planner_config;

const BRANCHES: [(WarningBranch, &str); 4] = [
    (WarningBranch::Seeded, "seeded"),
    (WarningBranch::Complementarity, "complementarity"),
    (WarningBranch::Swarm, "swarm"),
    (WarningBranch::StandardSwarm, "standard swarm"),
];
const BUDGETS_US: [u64; 13] = [10, 50, 100, 150, 200, 300, 500, 700, 1_000, 2_000, 3_000, 5_000, 10_000];
/// Plans of one case with one budget, each with a seed of its own.
const REPEATS: u64 = 7;
/// Steps of the tip example.
const TIP_STEPS: usize = 8;
/// Gaps below this are drawn at it: they are rounding.
const GAP_MIN: f64 = 1e-9;
/// By how much the clearance is moved to learn what it costs (m).
const SHIFT_M: f64 = 1e-4;
/// Distances hold the arm back where they cost at least this part of the optimum.
const BINDING: f64 = 1e-4;
/// Least price of a violation: this part of the optimum for a millimetre.
const PRICE_MIN_1PM: f64 = 0.01 / 1e-3;

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
    price: f64,
    depth_m: f64,
    newton: usize,
    evaluations: usize,
    converged: bool,
}

fn main() {
    let machine = plot::machine().unwrap();
    let golden: Vec<PlanCase> = plan_cases().into_iter().filter(is_bound).collect();
    let tip = tip_cases();
    let counts = [golden.len(), tip.len()];
    assert!(counts.iter().all(|n| *n > 0), "no step at which distances hold the arm back among {counts:?}");
    let cases: Vec<PlanCase> = golden.into_iter().chain(tip).collect();
    let mut samples = Vec::new();
    let mut best = Vec::new();
    for (k, case) in cases.iter().enumerate() {
        let mut judge = Judge::new(case);
        let mut least = judge.price(case, &optimum(case, 0.0, true)).0;
        if !case.data.is_null() {
            least = least.min(judge.price(case, &support::numbers(&case.data["u_opt"])).0);
        }
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
                    let (price, depth_m) = judge.price(case, planner.tensions());
                    least = least.min(price);
                    samples.push(Sample {
                        branch: b,
                        budget: t,
                        case: k,
                        time_us,
                        price,
                        depth_m,
                        newton: report.iterations,
                        evaluations: report.evaluations,
                        converged: report.status == sinew::planner::Status::Converged,
                    });
                }
            }
        }
        best.push(least);
    }
    report(&machine, &samples, &best, counts);
}

/// The answer of the complementarity branch that nothing hurries, with the clearance moved by so much (m).
fn optimum(case: &PlanCase, shift_m: f64, avoidance: bool) -> Vec<f64> {
    let clearance_m = case.settings.clearance_m + shift_m;
    let warning = WarningBranch::Complementarity;
    let settings = PlannerConfig { clearance_m, avoidance, warning, ..case.settings.clone() };
    let mut planner = sinew::planner::Planner::new(&case.config, &settings, 1.0, &case.change);
    case.plan(&mut planner, &mut Xoshiro256PlusPlus::seed_from_u64(1), &mut || false);
    planner.tensions().to_vec()
}

/// Whether distances hold the arm back: the optimum without them costs less, and lies too deep.
fn is_bound(case: &PlanCase) -> bool {
    let mut planner = case.planner(WarningBranch::Complementarity);
    let report = case.plan(&mut planner, &mut Xoshiro256PlusPlus::seed_from_u64(1), &mut || false);
    if !case.settings.avoidance || report.branch != Branch::Warning {
        return false;
    }
    let mut judge = Judge::new(case);
    let (bound, free) = (judge.cost(case, planner.tensions()).0, judge.cost(case, &optimum(case, 0.0, false)));
    bound > (1.0 + BINDING) * free.0 && free.1 > 0.0
}

/// Steps of the tip example, as it is planned in open loop by the complementarity branch.
fn tip_cases() -> Vec<PlanCase> {
    let scenario = ScenarioConfig::find("tip").unwrap();
    assert!(scenario.weight_tension == Some(1.0), "the cases' own weight");
    let course = Course::new(&scenario);
    let mut run = Run::new(&scenario, 1).unwrap();
    run.set_warning(WarningBranch::Complementarity);
    let base = planner_config(WarningBranch::Complementarity);
    let eta = base.lookahead_s;
    let mut found = Vec::new();
    while run.steps() < run.total() {
        let t = (run.steps() + 1) as f64 * eta;
        let (state, u_previous) = (run.state().clone(), run.tensions().to_vec());
        let step = run.step(&mut || 0).unwrap();
        if step.report.branch != Branch::Warning {
            continue;
        }
        let Goal::Tip { position, quaternion, pose, rate, damping } = course.goal(t) else {
            unreachable!("a tip path")
        };
        let mut obstacles = course.obstacles().unwrap();
        course.place(&mut obstacles, t);
        let mut settings = base.clone();
        (settings.body, settings.body_radius_m) = (scenario.planner.body, scenario.planner.body_radius_m);
        settings.swarm.penalty = scenario.planner.swarm.penalty;
        let case = PlanCase {
            what: format!("tip t {t:.1}"),
            config: scenario.arm.clone(),
            settings,
            change: scenario.weight_tension_change.clone().unwrap(),
            state,
            u_previous,
            goal: Goal::Tip { position, quaternion, pose, rate, damping },
            obstacles,
            data: Value::Null,
        };
        if is_bound(&case) {
            found.push(case);
        }
    }
    let (count, kept) = (found.len(), TIP_STEPS.min(found.len()));
    let wanted = |k: usize| (0..kept).any(|i| i * count / kept == k);
    found.into_iter().enumerate().filter(|(k, _)| wanted(*k)).map(|(_, case)| case).collect()
}

/// Applies tensions and says what comes of it.
struct Judge {
    arm: sinew::model::Arm,
    stepper: Stepper,
    scheme: Scheme,
    body: Body,
    next: State,
    frames: [Vec<nalgebra::Vector3<f64>>; 2],
    /// What a metre of violation costs.
    violation_1pm: f64,
}

impl Judge {
    fn new(case: &PlanCase) -> Self {
        let arm = case.arm();
        let nodes = arm.node_count() + 1;
        let mut judge = Self {
            stepper: Stepper::new(&arm),
            scheme: Scheme::new(case.config.rho_inf),
            body: Body::new(&BodyGeometry::from_arm(&case.config), case.settings.body, case.settings.body_radius_m),
            next: case.state.clone(),
            frames: [vec![nalgebra::Vector3::zeros(); nodes], vec![nalgebra::Vector3::zeros(); nodes]],
            arm,
            violation_1pm: 0.0,
        };
        let [here, farther] = [0.0, SHIFT_M].map(|shift_m| judge.cost(case, &optimum(case, shift_m, true)).0);
        judge.violation_1pm = (2.0 * (farther - here) / SHIFT_M).max(PRICE_MIN_1PM * here);
        judge
    }

    /// What an answer costs with its violation, and the violation (m).
    fn price(&mut self, case: &PlanCase, u: &[f64]) -> (f64, f64) {
        let (cost, depth_m) = self.cost(case, u);
        (cost + self.violation_1pm * depth_m, depth_m)
    }

    /// (15a) at the end of the step, and by how much a distance is violated there (m); infinite where the model cannot
    /// follow.
    fn cost(&mut self, case: &PlanCase, u: &[f64]) -> (f64, f64) {
        let eta = case.settings.lookahead_s;
        if self.stepper.step(&self.arm, &self.scheme, eta, &case.state, u, 40, &mut self.next).is_err() {
            return (f64::INFINITY, 0.0);
        }
        let mut scratch = vec![0.0; 4 * self.arm.segment_count()];
        let mut cost = case.goal.error_cost(&self.arm, &self.next, &mut scratch);
        for (i, (u, v)) in u.iter().zip(&case.u_previous).enumerate() {
            cost += u * u + case.change[self.arm.cable_segment[i]] * (u - v).powi(2);
        }
        let [r, t] = &mut self.frames;
        self.arm.frames_into(&self.next.q, r, t);
        let clearance = case.settings.clearance_m;
        let nearest = self.body.find(r, t, &case.obstacles, clearance).rows.iter().map(|row| row.distance);
        (cost, (clearance - nearest.fold(f64::INFINITY, f64::min)).max(0.0))
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    if values.is_empty() { f64::NAN } else { values[values.len() / 2] }
}

fn report(machine: &str, samples: &[Sample], best: &[f64], [golden, tip]: [usize; 2]) {
    let mut rows = Vec::new();
    let mut lines = Vec::new();
    let steps =
        format!("steps held back by obstacles: {golden} golden, {tip} of the tip example; {REPEATS} seeds each");
    println!("{steps}; gap: price over that of the best answer known, less one");
    println!(
        "{:16} {:>9} {:>11} {:>12} {:>12} {:>12} {:>12} {:>7} {:>12} {:>11}",
        "branch",
        "given us",
        "spent us",
        "gap median",
        "worst step",
        "largest",
        "deepest um",
        "Newton",
        "evaluations",
        "converged %"
    );
    for (b, (_, name)) in BRANCHES.iter().enumerate() {
        let mut points = Vec::new();
        for (t, budget) in BUDGETS_US.iter().enumerate() {
            let of = || samples.iter().filter(|s| s.branch == b && s.budget == t);
            let count = of().count() as f64;
            let gap = |s: &Sample| s.price / best[s.case] - 1.0;
            let time = median(of().map(|s| s.time_us).collect());
            let middle = median(of().map(gap).collect());
            let of_step = |k: usize| median(of().filter(|s| s.case == k).map(gap).collect());
            let worst = (0..best.len()).map(of_step).fold(0.0, f64::max);
            let largest = of().map(gap).fold(0.0, f64::max);
            let deepest = 1e6 * of().map(|s| s.depth_m).fold(0.0, f64::max);
            let newton = of().map(|s| s.newton as f64).sum::<f64>() / count;
            let evaluations = of().map(|s| s.evaluations as f64).sum::<f64>() / count;
            let converged = 100.0 * of().filter(|s| s.converged).count() as f64 / count;
            println!(
                "{name:16} {budget:9} {time:11.0} {middle:12.2e} {worst:12.2e} {largest:12.2e} {deepest:12.2} {newton:7.1} {evaluations:12.0} {converged:11.0}"
            );
            rows.push(format!(
                "{name},{budget},{time:.1},{middle:.3e},{worst:.3e},{largest:.3e},{deepest:.2},{newton:.2},{evaluations:.0},{converged:.0}"
            ));
            points.push((time, worst.max(GAP_MIN)));
        }
        // Budgets that end in the same iteration give the same point.
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        lines.push(Line { name: (*name).to_owned(), points });
    }
    let header = "branch,given_us,spent_us_median,gap_median,gap_worst_step,gap_largest,deepest_um,newton_mean,evaluations_mean,converged_percent";
    plot::write_csv("anytime.csv", &format!("{machine}; {steps}"), header, &rows).unwrap();
    plot::chart(
        "anytime.svg",
        "Gap to the best answer known against time spent: the worst of the steps that obstacles hold back",
        "time spent, median (us)",
        "gap of the worst step (relative)",
        &lines,
    )
    .unwrap();
}
