//! What the planner promises whatever it is asked: optimal where it says so, bounded always, repeatable, never worse
//! than its seeds.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod base;
mod stops;
#[path = "../support/mod.rs"]
mod support;
mod swarm;

use nalgebra::{Vector3, Vector4};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::{Obstacle, ObstacleSet, Shape, pose};
use sinew::config::{ArmConfig, BodyModel, ChordRule, PlannerConfig, Routing, ShapeConfig, StrainRule, SwarmConfig};
use sinew::config::{BarrierConfig, WarningBranch};
use sinew::integrator::{AffineMap, Scheme, Stepper, consistent_start, equilibrium};
use sinew::model::{Arm, Motion, State};
use sinew::planner::{Branch, Goal, Inputs, Planner, Quadratic, Report, Status};
use support::arms::*;
use support::settings;

const BRANCHES: [WarningBranch; 4] =
    [WarningBranch::Swarm, WarningBranch::Seeded, WarningBranch::Complementarity, WarningBranch::StandardSwarm];

fn settings(warning: WarningBranch) -> PlannerConfig {
    PlannerConfig {
        newton_iterations_max: 10,
        body: BodyModel::Arm,
        body_radius_m: 0.02,
        clearance_m: 0.005,
        warning_hysteresis_m: 0.005,
        barrier: Some(BarrierConfig { gamma: 0.5, activation_m: 0.1 }),
        swarm: SwarmConfig {
            particles_normal: 15,
            particles_uniform: 5,
            sweeps_max: 20,
            stall_sweeps: 20,
            ..settings::swarm_config()
        },
        ..settings::planner_config(warning)
    }
}

/// An arm at rest in equilibrium under some tensions.
struct Bench {
    config: ArmConfig,
    arm: Arm,
    state: State,
    u: Vec<f64>,
}

impl Bench {
    fn new(config: ArmConfig) -> Self {
        Self::under(config, 10.0)
    }

    /// At rest under tensions about `level` (N).
    fn under(mut config: ArmConfig, level: f64) -> Self {
        config.gravity_mps2 = [0.0; 3];
        // A tick may change a tension by its whole range unless a claim is about the rate.
        config.tension_rate_npsmax = 1e4;
        let arm = Arm::new(&config);
        let u: Vec<f64> = (0..arm.cable_count()).map(|c| level * (1.0 + 0.8 * (c as f64 * 1.9).sin())).collect();
        let mut stepper = Stepper::new(&arm);
        let mut state = State::at_rest(arm.straight());
        equilibrium(&arm, &mut stepper, &u, &mut state).unwrap();
        consistent_start(&arm, &mut stepper, &u, &mut state).unwrap();
        Self { config, arm, state, u }
    }

    fn paper() -> Self {
        Self::new(ArmConfig::paper())
    }

    fn planner(&self, settings: &PlannerConfig) -> Planner {
        Planner::new(&self.config, settings, 1.0, &vec![1e4; self.arm.segment_count()])
    }

    /// The tip moved by `shift`, as it stands.
    fn goal(&self, shift: Vector3<f64>) -> Goal<'static> {
        let tip = self.arm.tip(&self.state.q, &self.state.qd);
        Goal::Tip { position: tip.position + shift, quaternion: tip.quaternion, pose: 5e12, rate: 5e10, damping: 1e8 }
    }

    /// Two balls whose surfaces are `gap` away from nodes of the arm's backbone.
    fn balls(&self, gap: f64) -> ObstacleSet {
        let mut set = ObstacleSet::new();
        let n = self.arm.node_count();
        for (k, node) in [n / 2, n - 1].into_iter().enumerate() {
            let (r, p) = self.arm.pose(&self.state.q, node);
            let side = sinew::math::quaternion::rotation(&p).column(1 + k) * if k == 0 { 1.0 } else { -1.0 };
            let centre = r + side * (0.1 + gap);
            let ball = Shape::new(&ShapeConfig::Ball { radius_m: 0.1 }).unwrap();
            set.insert(Obstacle::new(k as u64, ball, &pose(centre.into(), [1.0, 0.0, 0.0, 0.0]).unwrap()).unwrap())
                .unwrap();
        }
        set
    }
}

fn inputs<'a>(bench: &'a Bench, goal: Goal<'a>, obstacles: &'a ObstacleSet) -> Inputs<'a> {
    Inputs {
        state: &bench.state,
        u_previous: &bench.u,
        disturbance: &[],
        led_to: None,
        goal,
        now: obstacles,
        ahead: obstacles,
    }
}

fn run(planner: &mut Planner, inputs: &Inputs<'_>, seed: u64) -> Report {
    planner.plan(inputs, &mut Xoshiro256PlusPlus::seed_from_u64(seed), &mut || false)
}

#[track_caller]
fn assert_bounded(planner: &Planner, config: &ArmConfig) {
    for u in planner.tensions() {
        assert!((config.tension_n_min..=config.tension_n_max).contains(u), "{:?}", planner.tensions());
    }
}

/// The quadratic of (15a) at a planned state, built anew outside the planner.
/// With it the correction that is left at the planned tensions (11N).
fn quadratic(bench: &Bench, planner: &Planner, goal: &Goal<'_>) -> (Quadratic, Vec<f64>) {
    let rates = Scheme::new(bench.config.rho_inf).rates(planner.config().lookahead_s);
    let (mut stepper, mut map) = (Stepper::new(&bench.arm), AffineMap::new(&bench.arm));
    stepper.linearize(&bench.arm, &Motion::from(planner.planned()), planner.tensions(), rates).unwrap();
    stepper.affine_map_into(&bench.arm, &mut map);
    let mut quadratic = Quadratic::new(&bench.arm);
    let change = vec![1e4; bench.u.len()];
    quadratic.build(&bench.arm, planner.planned(), rates, &map, goal, 1.0, &change, &bench.u);
    (quadratic, stepper.correction_for(&bench.arm, planner.tensions()).clone())
}

#[test]
fn the_planned_tensions_satisfy_the_optimality_conditions_of_the_step() {
    let bench = Bench::paper();
    let none = ObstacleSet::new();
    for shift in [Vector3::new(0.01, 0.0, 0.0), Vector3::new(-0.2, 0.1, 0.1), Vector3::new(0.0, -0.5, 0.6)] {
        let goal = bench.goal(shift);
        let mut planner =
            bench.planner(&PlannerConfig { newton_iterations_max: 40, ..settings(WarningBranch::Seeded) });
        let report = run(&mut planner, &inputs(&bench, goal, &none), 1);
        assert_eq!((report.status, report.branch), (Status::Converged, Branch::Safe), "{report:?}");
        assert!(report.kkt_residual < 1e-12);
        let (q, left) = quadratic(&bench, &planner, &goal);
        // The iterate is the solution: no correction is left at its own tensions.
        assert!(left.iter().all(|d| d.abs() < 1e-7), "{left:?}");
        let n = bench.u.len();
        let mut active = 0;
        for i in 0..n {
            let u = planner.tensions()[i];
            let slope: f64 = q.b[i] + (0..n).map(|j| q.a[i * n + j] * planner.tensions()[j]).sum::<f64>();
            let newtons = slope / q.a[i * n + i];
            if u <= bench.config.tension_n_min + 1e-9 {
                active += 1;
                assert!(newtons > -1e-4, "cable {i} wants to grow by {newtons} N from its lower bound");
            } else if u >= bench.config.tension_n_max - 1e-9 {
                active += 1;
                assert!(newtons < 1e-4, "cable {i} wants to fall by {newtons} N from its upper bound");
            } else {
                assert!(newtons.abs() < 1e-4, "cable {i} wants to move by {newtons} N");
            }
        }
        assert!((q.cost(planner.tensions()) / report.cost - 1.0).abs() < 1e-6, "{report:?}");
        if shift.norm() > 0.5 {
            assert!(active > 0, "a far goal presses tensions to their bounds");
        }
    }
}

#[test]
fn near_obstacles_the_planned_distances_are_kept_and_no_small_move_of_the_tensions_is_better() {
    let bench = Bench::paper();
    let balls = bench.balls(0.03);
    // Towards the balls, so that they matter.
    let goal = bench.goal(Vector3::new(0.0, 0.0, 0.0) + toward(&bench, &balls) * 0.05);
    let mut planner = bench.planner(&PlannerConfig {
        newton_iterations_max: 40,
        barrier: None,
        ..settings(WarningBranch::Complementarity)
    });
    let report = run(&mut planner, &inputs(&bench, goal, &balls), 1);
    assert_eq!((report.status, report.branch), (Status::Converged, Branch::Warning), "{report:?}");
    assert!(!report.relaxed && report.kkt_residual < 1e-9, "{report:?}");
    let clearance = planner.config().clearance_m;
    assert!(report.distance_min > clearance - 1e-6, "{report:?}");
    assert!(report.distance_min < clearance + 1e-3, "the ball is touched: {report:?}");
    let mut free = bench.planner(&PlannerConfig { avoidance: false, ..planner.config().clone() });
    let unconstrained = run(&mut free, &inputs(&bench, goal, &balls), 1);
    assert!(unconstrained.cost < report.cost, "the obstacle costs something");
}

fn toward(bench: &Bench, balls: &ObstacleSet) -> Vector3<f64> {
    let (r, _) = bench.arm.pose(&bench.state.q, bench.arm.node_count() - 1);
    (balls.as_slice()[1].position() - r).normalize()
}

#[test]
fn the_same_seed_gives_the_same_answer_bit_for_bit() {
    let bench = Bench::paper();
    let balls = bench.balls(0.028);
    let goal = bench.goal(toward(&bench, &balls) * 0.03);
    for branch in BRANCHES {
        let bits = |seed: u64| {
            let mut planner = bench.planner(&settings(branch));
            let report = run(&mut planner, &inputs(&bench, goal, &balls), seed);
            assert_eq!(report.branch, Branch::Warning);
            planner.tensions().iter().map(|u| u.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(bits(7), bits(7), "{branch:?}");
        // The standard swarm finds nothing better than its seeds here, whatever the random numbers.
        if branch == WarningBranch::Swarm {
            assert_ne!(bits(7), bits(8), "{branch:?}: the random source is used");
        }
    }
}

#[test]
fn a_planner_without_time_still_gives_bounded_tensions_and_says_so() {
    let bench = Bench::paper();
    for (what, obstacles) in [("free", ObstacleSet::new()), ("near", bench.balls(0.028))] {
        for branch in BRANCHES {
            let mut planner = bench.planner(&settings(branch));
            let goal = bench.goal(Vector3::new(0.3, -0.2, 0.4));
            let asked = std::cell::Cell::new(0);
            let report =
                planner.plan(&inputs(&bench, goal, &obstacles), &mut Xoshiro256PlusPlus::seed_from_u64(3), &mut || {
                    asked.set(asked.get() + 1);
                    true
                });
            assert_eq!(report.iterations, 1, "{what} {branch:?} {report:?}");
            // Where the standard swarm finds nothing better than what is applied, resting is no convergence.
            let rests = planner.tensions() == bench.u;
            let stands = what == "near" && branch == WarningBranch::StandardSwarm;
            let want = if stands { Status::IterationLimit } else { Status::BudgetSpent };
            assert_eq!(report.status, want, "{what} {branch:?} {report:?}");
            assert!(rests || !stands);
            assert!(!(rests && report.optimal), "{what} {branch:?} {report:?}");
            assert!(report.sweeps <= 1 && asked.get() >= 1);
            assert!(report.cost.is_finite() && planner.planned().is_finite());
            assert_bounded(&planner, &bench.config);
        }
    }
}

#[test]
fn the_newton_iterations_of_a_tick_are_a_setting_and_what_they_leave_is_reported_and_checked() {
    let bench = Bench::paper();
    let balls = bench.balls(0.028);
    let goal = bench.goal(toward(&bench, &balls) * 0.03);
    let plan = |iterations: usize, tolerance: f64| {
        let mut planner = bench.planner(&PlannerConfig {
            newton_iterations_max: iterations,
            newton_tolerance: tolerance,
            period_s: 0.01,
            ..settings(WarningBranch::Complementarity)
        });
        let report = run(&mut planner, &inputs(&bench, goal, &balls), 1);
        assert!(report.iterations <= iterations);
        (report, planner.tensions().to_vec())
    };
    let (exact, optimum) = plan(40, 1e-8);
    assert_eq!(exact.status, Status::Converged, "{exact:?}");
    let off = |u: &[f64]| u.iter().zip(&optimum).fold(0.0f64, |a, (u, v)| a.max((u - v).abs()));
    let mut last = f64::INFINITY;
    let mut errors = Vec::new();
    for iterations in 1..=3 {
        let (report, u) = plan(iterations, 1e-8);
        assert_eq!((report.status, report.iterations), (Status::IterationLimit, iterations), "{report:?}");
        assert!(report.correction > 1e-8 && report.correction < last, "{report:?}, {last} before");
        last = report.correction;
        errors.push(off(&u));
    }
    // One is not enough near obstacles; the second brings what the third hardly betters.
    assert!(errors[1] < 0.2 * errors[0], "{errors:?} N from the optimum");
    assert!(errors[1] - errors[2] < 0.2 * (errors[0] - errors[1]), "{errors:?} N from the optimum");
    // The check ends the loop as soon as what is left is below the tolerance.
    let (loose, _) = plan(40, 2.0 * last);
    assert_eq!(loose.status, Status::Converged);
    assert!(loose.iterations <= 3 && loose.correction < 2.0 * last, "{loose:?}");
}

#[test]
fn tensions_change_by_no_more_than_the_rate_limit_allows_in_a_period() {
    let mut bench = Bench::paper();
    bench.config.tension_rate_npsmax = 40.0;
    let none = ObstacleSet::new();
    let balls = bench.balls(0.028);
    for (branch, obstacles) in BRANCHES.iter().flat_map(|b| [(b, &none), (b, &balls)]) {
        let mut planner = bench.planner(&PlannerConfig { period_s: 0.05, ..settings(*branch) });
        run(&mut planner, &inputs(&bench, bench.goal(Vector3::new(0.5, 0.5, 0.5)), obstacles), 5);
        let largest = planner.tensions().iter().zip(&bench.u).fold(0.0f64, |a, (u, v)| a.max((u - v).abs()));
        assert!(largest <= 2.0 + 1e-12, "{branch:?}: {largest}");
        assert!(largest > 1.9, "{branch:?}: the limit is reached by so far a goal, {largest}");
        assert_bounded(&planner, &bench.config);
    }
}

#[test]
fn last_tensions_outside_the_box_are_planned_from_inside_it() {
    let mut bench = Bench::paper();
    bench.config.tension_n_min = 5.0;
    bench.u[0] = -30.0;
    bench.u[1] = 900.0;
    let mut planner = bench.planner(&settings(WarningBranch::Seeded));
    run(&mut planner, &inputs(&bench, bench.goal(Vector3::zeros()), &ObstacleSet::new()), 5);
    assert_bounded(&planner, &bench.config);
}

#[test]
fn planning_with_a_disturbance_is_planning_with_shifted_tensions() {
    // What acts is u + w, so the two plans differ by w in the tensions and in nothing else.
    let bench = Bench::paper();
    let none = ObstacleSet::new();
    let w: Vec<f64> = (0..24).map(|c| 3.0 * (c as f64 * 0.7).cos()).collect();
    let goal = bench.goal(Vector3::new(0.02, -0.03, 0.01));
    let plan = |config: &ArmConfig, u: &[f64], w: &[f64]| {
        // W alone, no R: du is the same for both.
        let settings = PlannerConfig { newton_iterations_max: 40, ..settings(WarningBranch::Seeded) };
        let mut planner = Planner::new(config, &settings, 0.0, &[1e4; 4]);
        let inputs = Inputs { u_previous: u, disturbance: w, ..inputs(&bench, goal, &none) };
        let report = run(&mut planner, &inputs, 1);
        assert_eq!(report.status, Status::Converged);
        (planner.tensions().to_vec(), planner.planned().clone(), report.cost)
    };
    let mut wide = bench.config.clone();
    (wide.tension_n_min, wide.tension_n_max) = (-1e3, 1e3);
    let (u, with, cost) = plan(&wide, &bench.u, &w);
    let shifted: Vec<f64> = bench.u.iter().zip(&w).map(|(u, w)| u + w).collect();
    let (v, without, cost_shifted) = plan(&wide, &shifted, &[]);
    for c in 0..24 {
        assert!((u[c] + w[c] - v[c]).abs() < 1e-5, "cable {c}: {} + {} for {}", u[c], w[c], v[c]);
    }
    let worst = with.q.iter().zip(&without.q).fold(0.0f64, |a, (x, y)| a.max((x - y).abs()));
    assert!(worst < 1e-9, "{worst:e}");
    assert!((cost / cost_shifted - 1.0).abs() < 1e-9);
}

#[test]
fn a_disturbance_moves_the_planned_distances_too() {
    // The same equivalence where the rows and the swarm's positions must be shifted.
    let bench = Bench::paper();
    let balls = bench.balls(0.028);
    let goal = bench.goal(toward(&bench, &balls) * 0.05);
    let w: Vec<f64> = (0..24).map(|c| 3.0 * (c as f64 * 0.7).cos()).collect();
    let mut wide = bench.config.clone();
    (wide.tension_n_min, wide.tension_n_max) = (-1e3, 1e3);
    let plan = |u: &[f64], w: &[f64]| {
        let config = PlannerConfig { newton_iterations_max: 40, ..settings(WarningBranch::Complementarity) };
        let mut planner = Planner::new(&wide, &config, 0.0, &[1e4; 4]);
        let inputs = Inputs { u_previous: u, disturbance: w, ..inputs(&bench, goal, &balls) };
        let report = run(&mut planner, &inputs, 1);
        assert_eq!((report.status, report.branch), (Status::Converged, Branch::Warning), "{report:?}");
        planner.tensions().to_vec()
    };
    let shifted: Vec<f64> = bench.u.iter().zip(&w).map(|(u, w)| u + w).collect();
    let (u, v) = (plan(&bench.u, &w), plan(&shifted, &[]));
    for c in 0..24 {
        assert!((u[c] + w[c] - v[c]).abs() < 1e-3, "cable {c}: {} + {} for {}", u[c], w[c], v[c]);
    }
}

#[test]
fn arms_of_every_size_plan() {
    for (segments, elements, cables) in [(1, 1, 3), (2, 3, 4), (2, 5, 12), (8, 2, 3), (8, 5, 6), (5, 4, 12)] {
        let mut config = ArmConfig::paper();
        let mut segment = config.segments[0].clone();
        segment.elements = elements;
        segment.length_m = 0.3;
        segment.hole_angles_rad =
            (0..cables).map(|c| std::f64::consts::TAU * f64::from(c) / f64::from(cables)).collect();
        config.segments = vec![segment; segments];
        config.segments[segments - 1].connector_length_m = 0.0;
        for routing in [Routing::Local, Routing::Through] {
            config.routing = routing;
            let bench = Bench::new(config.clone());
            for branch in BRANCHES {
                for obstacles in [ObstacleSet::new(), bench.balls(0.028)] {
                    let mut planner = bench.planner(&settings(branch));
                    let report =
                        run(&mut planner, &inputs(&bench, bench.goal(Vector3::new(0.01, 0.02, 0.01)), &obstacles), 2);
                    assert_ne!(report.status, Status::Singular, "{segments} {elements} {cables}");
                    assert_bounded(&planner, &bench.config);
                    let curvatures = vec![0.3; 2 * segments];
                    let goal = Goal::Shape { curvatures: &curvatures, weight: 1e10, rate: 1.0 };
                    let report = run(&mut planner, &inputs(&bench, goal, &obstacles), 2);
                    assert_ne!(report.status, Status::Singular, "{segments} {elements} {cables}");
                    assert_bounded(&planner, &bench.config);
                }
            }
        }
    }
}

#[test]
fn a_state_that_is_not_finite_holds_the_last_tensions_and_leaves_no_trace() {
    let mut bench = Bench::paper();
    let good = bench.state.clone();
    let balls = bench.balls(0.028);
    for branch in BRANCHES {
        for (part, bad) in [(0, f64::NAN), (1, f64::INFINITY), (2, f64::NAN)] {
            let goal = bench.goal(Vector3::new(0.01, 0.0, 0.0));
            let mut planner = bench.planner(&settings(branch));
            let fresh = run(&mut planner, &inputs(&bench, goal, &balls), 4);
            let want = planner.tensions().to_vec();
            [&mut bench.state.q, &mut bench.state.qd, &mut bench.state.a][part][40] = bad;
            let report = run(&mut planner, &inputs(&bench, goal, &balls), 4);
            assert_eq!(report.status, Status::Singular, "{branch:?} {part} {report:?}");
            assert_eq!(planner.tensions(), bench.u, "{branch:?} {part}");
            bench.state = good.clone();
            let again = run(&mut planner, &inputs(&bench, goal, &balls), 4);
            assert_eq!(again.cost.to_bits(), fresh.cost.to_bits());
            assert_eq!(planner.tensions(), want, "{branch:?} {part}");
        }
    }
}

#[test]
fn an_iteration_that_leaves_the_arm_holds_the_last_tensions_and_says_so() {
    let mut bench = Bench::paper();
    let balls = bench.balls(0.028);
    let rest = bench.state.clone();
    for branch in BRANCHES {
        let mut refused = 0;
        for speed in [1e2, 1e3, 1e4, 1e5] {
            bench.state = rest.clone();
            bench.state.qd.iter_mut().enumerate().for_each(|(k, v)| *v = speed * (k as f64).sin());
            let mut planner = bench.planner(&settings(branch));
            let report = run(&mut planner, &inputs(&bench, bench.goal(Vector3::zeros()), &balls), 3);
            assert!(report.correction <= 1e3 || report.status == Status::Singular, "{branch:?} {speed}: {report:?}");
            if report.status == Status::Singular {
                assert_eq!(planner.tensions(), bench.u, "{branch:?} {speed}: {report:?}");
                refused += usize::from(report.correction.is_finite());
            }
            // No trace is left for a step that can be planned.
            bench.state = rest.clone();
            let after = run(&mut planner, &inputs(&bench, bench.goal(Vector3::zeros()), &balls), 3);
            assert_ne!(after.status, Status::Singular, "{branch:?} {speed}: {after:?}");
        }
        assert!(refused > 0, "{branch:?}: speeds that no arm has");
    }
}

#[test]
fn a_safe_plan_that_ends_near_an_obstacle_is_none_yet_and_takes_no_time_that_is_over() {
    let bench = Bench::paper();
    // Outside the warning distance by a millimetre, and the goal is beyond it.
    let balls = bench.balls(0.02 + 0.005 + 0.01 + 0.001);
    let goal = bench.goal(toward(&bench, &balls) * 0.05);
    let config = |iterations: usize| PlannerConfig {
        newton_iterations_max: iterations,
        newton_tolerance: 1.0,
        barrier: None,
        ..settings(WarningBranch::Seeded)
    };
    // With time the second iteration plans again, with regard to the ball.
    let two = run(&mut bench.planner(&config(2)), &inputs(&bench, goal, &balls), 1);
    assert_eq!((two.branch, two.iterations, two.status), (Branch::Warning, 2, Status::Converged), "{two:?}");
    // Without the safe plan goes out, and is reported as what it is.
    let one = run(&mut bench.planner(&config(1)), &inputs(&bench, goal, &balls), 1);
    assert_eq!((one.branch, one.iterations, one.status), (Branch::Safe, 1, Status::IterationLimit), "{one:?}");
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let late = bench.planner(&config(10)).plan(&inputs(&bench, goal, &balls), &mut rng, &mut || true);
    assert_eq!((late.branch, late.iterations, late.status), (Branch::Safe, 1, Status::BudgetSpent), "{late:?}");
}

#[test]
fn pairs_that_find_no_room_are_told_and_such_a_plan_is_not_optimal() {
    let bench = Bench::paper();
    let mut many = ObstacleSet::new();
    for k in 0..60 {
        let (r, p) = bench.arm.pose(&bench.state.q, 1 + k % bench.arm.node_count());
        let side = sinew::math::quaternion::rotation(&p).column(1 + k % 2) * if k % 4 < 2 { 1.0 } else { -1.0 };
        let ball = Shape::new(&ShapeConfig::Ball { radius_m: 0.05 }).unwrap();
        let at = pose((r + side * 0.1).into(), [1.0, 0.0, 0.0, 0.0]).unwrap();
        many.insert(Obstacle::new(k as u64, ball, &at).unwrap()).unwrap();
    }
    for (what, obstacles, truncated) in [("many", many, true), ("two", bench.balls(0.028), false)] {
        for branch in BRANCHES {
            let mut planner = bench.planner(&settings(branch));
            let report = run(&mut planner, &inputs(&bench, bench.goal(Vector3::zeros()), &obstacles), 1);
            assert_eq!(report.branch, Branch::Warning);
            assert_eq!(report.truncated, truncated, "{what} {branch:?}: {report:?}");
            assert!(
                !truncated || (!report.optimal && report.status != Status::Converged),
                "{what} {branch:?}: {report:?}"
            );
        }
    }
}

#[test]
fn a_goal_that_is_not_finite_is_not_reported_as_reached() {
    let bench = Bench::paper();
    let mut planner = bench.planner(&settings(WarningBranch::Seeded));
    for obstacles in [ObstacleSet::new(), bench.balls(0.028)] {
        let report = run(&mut planner, &inputs(&bench, bench.goal(Vector3::new(f64::NAN, 0.0, 0.0)), &obstacles), 1);
        assert_eq!(report.status, Status::Singular, "{report:?}");
        assert_eq!(planner.tensions(), bench.u);
    }
}

#[test]
fn last_tensions_that_are_not_numbers_give_the_least_tensions_and_say_so() {
    let mut bench = Bench::paper();
    bench.config.tension_n_min = 5.0;
    bench.u[3] = f64::NAN;
    let mut planner = bench.planner(&settings(WarningBranch::Seeded));
    for obstacles in [ObstacleSet::new(), bench.balls(0.028)] {
        let report = run(&mut planner, &inputs(&bench, bench.goal(Vector3::zeros()), &obstacles), 1);
        assert_eq!(report.status, Status::Singular, "{report:?}");
        assert_eq!(planner.tensions()[3], 5.0);
        assert_bounded(&planner, &bench.config);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_target_takes_the_tensions_out_of_their_box(
        position in prop::array::uniform3(-5.0f64..5.0),
        quaternion in prop::array::uniform4(-1.0f64..1.0),
        gap in 0.0f64..0.06,
        branch in 0usize..4,
        weight in 1.0f64..1e13,
        seed in any::<u64>(),
    ) {
        let bench = Bench::paper();
        let balls = bench.balls(gap);
        let mut planner = bench.planner(&settings(BRANCHES[branch]));
        let goal = Goal::Tip {
            position: position.into(),
            quaternion: Vector4::from(quaternion),
            pose: weight,
            rate: 1e-2 * weight,
            damping: 1e-4 * weight,
        };
        let report = run(&mut planner, &inputs(&bench, goal, &balls), seed);
        prop_assert!(report.iterations >= 1);
        assert_bounded(&planner, &bench.config);
    }

    #[test]
    fn random_arms_stay_in_their_box(seed in any::<u64>(), branch in 0usize..4, gap in 0.0f64..0.06) {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut config = random_arm(&mut rng, Routing::Local, ChordRule::Simpson, StrainRule::VectorPart);
        (config.tension_n_min, config.tension_n_max) = (4.0, 60.0);
        let bench = Bench::under(config, 1.0);
        let balls = bench.balls(gap);
        let mut planner = bench.planner(&settings(BRANCHES[branch]));
        for shift in [0.01, 0.1, 1.0] {
            run(&mut planner, &inputs(&bench, bench.goal(Vector3::new(shift, -shift, shift)), &balls), seed);
            assert_bounded(&planner, &bench.config);
        }
    }
}
