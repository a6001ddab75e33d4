//! Deadlines that fire anywhere in a step, told by counted work: no claim looks at a clock.

use super::*;
use sinew::planner::Deadline;

/// Says that it is over after a number of asks, and counts them. The share grows with the asks where `even`.
struct Asks {
    until: usize,
    asked: usize,
    late: usize,
    even: bool,
}

impl Asks {
    fn new(until: usize, even: bool) -> Self {
        Self { until, asked: 0, late: 0, even }
    }
}

impl Deadline for Asks {
    fn used(&mut self) -> f64 {
        self.late += usize::from(self.asked > self.until);
        self.asked += 1;
        match (self.asked > self.until, self.even) {
            (true, _) => 1.0,
            (false, true) => self.asked as f64 / (self.until + 1) as f64,
            (false, false) => 0.0,
        }
    }
}

/// Steps that are hard to plan: the goal far off inside the balls, balls that the arm already touches from two sides
/// (rows without a common solution), the state moving fast and away from its equilibrium, many balls.
fn hard(bench: &Bench) -> Vec<(&'static str, State, ObstacleSet)> {
    let mut off = bench.state.clone();
    off.qd.iter_mut().enumerate().for_each(|(k, v)| *v = 0.5 * (k as f64).sin());
    let mut between = bench.balls(-0.03);
    let mut many = bench.balls(0.028);
    for k in 0..6 {
        let (r, p) = bench.arm.pose(&bench.state.q, bench.arm.node_count() - k);
        let side = sinew::math::quaternion::rotation(&p).column(1 + k % 2) * if k % 4 < 2 { -1.0 } else { 1.0 };
        let set = if k < 2 { &mut between } else { &mut many };
        let ball = Shape::new(&ShapeConfig::Ball { radius_m: 0.05 }).unwrap();
        let at = pose((r + side * 0.07).into(), [1.0, 0.0, 0.0, 0.0]).unwrap();
        set.insert(Obstacle::new(10 + k as u64, ball, &at).unwrap()).unwrap();
    }
    vec![
        ("far off", off.clone(), bench.balls(0.028)),
        ("between", bench.state.clone(), between),
        ("many", bench.state.clone(), many.clone()),
        ("many, far off", off, many),
        ("free, far off", bench.state.clone(), ObstacleSet::new()),
    ]
}

#[test]
fn a_step_that_is_stopped_anywhere_is_bounded_no_worse_than_its_seeds_and_ends_at_once() {
    let bench = Bench::paper();
    let (mut spent, mut judged, mut ends) = (0, 0, 0);
    for (what, state, obstacles) in hard(&bench) {
        let goal = bench.goal(Vector3::new(0.3, -0.2, 0.4));
        let inputs = Inputs { state: &state, ..inputs(&bench, goal, &obstacles) };
        for branch in BRANCHES {
            for even in [false, true] {
                for k in [0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 30, 45, 70, 100, 100_000] {
                    let what = format!("{what}, {branch:?}, {k} asks, even {even}");
                    let mut planner = bench.planner(&settings(branch));
                    let mut deadline = Asks::new(k, even);
                    let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
                    let report = planner.plan(&inputs, &mut rng, &mut deadline);
                    assert_bounded(&planner, &bench.config);
                    assert!(report.cost.is_finite() && planner.planned().is_finite(), "{what}: {report:?}");
                    // After the end nobody is asked, and nothing is done that would have had to ask but what finishes
                    // the running iteration: one step of the solver, one sweep.
                    assert_eq!(deadline.late, 0, "{what}: {report:?}");
                    // Begin, preparation and end of each iteration ask, and each sweep but an iteration's last.
                    assert!(report.sweeps <= deadline.asked + report.iterations, "{what}: {report:?}");
                    if deadline.asked > k {
                        spent += usize::from(report.status == Status::BudgetSpent);
                        assert!(report.iterations <= 1 + k / 3, "{what}: {report:?}");
                        let standing = branch == WarningBranch::StandardSwarm;
                        let over = matches!(report.status, Status::BudgetSpent | Status::IterationLimit);
                        assert!(report.status == Status::BudgetSpent || standing && over, "{what}: {report:?}");
                    } else {
                        ends += 1;
                    }
                    if let Some(margin) = planner.seed_margin(&obstacles) {
                        assert!(margin >= -1e-9 * report.cost.abs(), "{what}: worse than a seed by {}", -margin);
                        judged += 1;
                    }
                }
            }
        }
    }
    assert!(spent > 300 && judged > 200 && ends > 20, "{spent} spent, {judged} judged, {ends} ended by themselves");
}

#[test]
fn no_iteration_takes_the_time_of_those_after_it() {
    let bench = Bench::paper();
    let obstacles = bench.balls(0.028);
    let goal = bench.goal(Vector3::new(0.3, -0.2, 0.4));
    for branch in BRANCHES {
        let mut config = settings(branch);
        config.newton_iterations_max = 2;
        config.swarm.sweeps_max = 1_000_000;
        config.swarm.stall_sweeps = 1_000_000;
        let mut planner = bench.planner(&config);
        let mut deadline = Asks::new(200, true);
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
        let report = planner.plan(&inputs(&bench, goal, &obstacles), &mut rng, &mut deadline);
        assert_eq!(report.iterations, 2, "{branch:?} {report:?}");
        assert_eq!(deadline.late, 0);
    }
}
