//! What the planner promises whatever it is asked: optimal where it says so, bounded always, repeatable, never worse
//! than its seeds.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use nalgebra::{Vector3, Vector4};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::{Obstacle, ObstacleSet, Shape, penalty, pose};
use sinew::config::{ArmConfig, BodyModel, ChordRule, PlannerConfig, Routing, ShapeConfig, StrainRule, SwarmConfig};
use sinew::config::{BarrierConfig, WarningBranch};
use sinew::integrator::{AffineMap, Scheme, Stepper, consistent_start, equilibrium};
use sinew::model::{Arm, Motion, State};
use sinew::planner::swarm::{Pairs, Swarm, Variant};
use sinew::planner::{Branch, Goal, Inputs, Planner, Quadratic, Report, Status};
use support::arms::*;

const BRANCHES: [WarningBranch; 4] =
    [WarningBranch::Swarm, WarningBranch::Seeded, WarningBranch::Complementarity, WarningBranch::StandardSwarm];

fn settings(warning: WarningBranch) -> PlannerConfig {
    PlannerConfig {
        lookahead_s: 0.1,
        period_s: 0.1,
        newton_iterations_max: 10,
        newton_tolerance: 1e-8,
        warning,
        avoidance: true,
        body: BodyModel::Arm,
        body_radius_m: 0.02,
        clearance_m: 0.005,
        warning_distance_m: 0.01,
        warning_hysteresis_m: 0.005,
        barrier: Some(BarrierConfig { gamma: 0.5, activation_m: 0.1 }),
        swarm: SwarmConfig {
            particles_normal: 15,
            particles_uniform: 5,
            sigma_n: 2.0,
            chaotic_min: 2,
            chaotic_max: 8,
            inertia: [0.9, 0.4],
            acceleration: [1.5, 1.5],
            sweeps_max: 20,
            stall_sweeps: 20,
            tolerance: 0.0,
            penalty: 1e12,
        },
        budget_s: None,
        lead_s: None,
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
    Inputs { state: &bench.state, u_previous: &bench.u, disturbance: &[], goal, now: obstacles, ahead: obstacles }
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
fn quadratic(bench: &Bench, planner: &Planner, goal: &Goal<'_>) -> (Quadratic, AffineMap) {
    let rates = Scheme::new(bench.config.rho_inf).rates(planner.config().lookahead_s);
    let (mut stepper, mut map) = (Stepper::new(&bench.arm), AffineMap::new(&bench.arm));
    stepper.linearize(&bench.arm, &Motion::from(planner.planned()), planner.tensions(), rates).unwrap();
    stepper.affine_map_into(&mut map);
    let mut quadratic = Quadratic::new(&bench.arm);
    let change = vec![1e4; bench.u.len()];
    quadratic.build(&bench.arm, planner.planned(), rates, &map, goal, 1.0, &change, &bench.u);
    (quadratic, map)
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
        let (q, map) = quadratic(&bench, &planner, &goal);
        // The iterate is the solution: no correction is left at its own tensions.
        let mut dx = vec![0.0; map.x0.len()];
        map.evaluate_into(planner.tensions(), &mut dx);
        assert!(dx.iter().all(|d| d.abs() < 1e-7));
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
            // A swarm that finds nothing better than what is applied has come to rest there.
            let rests = planner.tensions() == bench.u;
            let want = if rests { Status::Converged } else { Status::BudgetSpent };
            assert_eq!(report.status, want, "{what} {branch:?} {report:?}");
            assert!(!rests || what == "near" && branch == WarningBranch::StandardSwarm);
            assert!(report.sweeps <= 1 && asked.get() >= 1);
            assert!(report.cost.is_finite() && planner.planned().is_finite());
            assert_bounded(&planner, &bench.config);
        }
    }
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
                    let goal = Goal::Shape { curvatures: &curvatures, weight: 1e10 };
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

/// The swarm's own problem at the start of a step: quadratic, pairs and bounds, made outside the planner.
struct SwarmCase {
    quadratic: Quadratic,
    rows: Vec<sinew::collision::Proximity>,
    required: Vec<f64>,
    length: Vec<f64>,
    origin: Vec<f64>,
    slope: Vec<f64>,
    balls: ObstacleSet,
}

impl SwarmCase {
    fn new(bench: &Bench, config: &PlannerConfig) -> Self {
        let balls = bench.balls(0.028);
        let goal = bench.goal(toward(bench, &balls) * 0.05);
        let rates = Scheme::new(bench.config.rho_inf).rates(0.1);
        let (mut stepper, mut map) = (Stepper::new(&bench.arm), AffineMap::new(&bench.arm));
        stepper.linearize(&bench.arm, &Motion::from(&bench.state), &bench.u, rates).unwrap();
        stepper.affine_map_into(&mut map);
        let mut quadratic = Quadratic::new(&bench.arm);
        quadratic.build(&bench.arm, &bench.state, rates, &map, &goal, 1.0, &[1e4; 24], &bench.u);
        let n = bench.arm.node_count();
        let (mut r, mut t) = (vec![Vector3::zeros(); n + 1], vec![Vector3::zeros(); n + 1]);
        bench.arm.frames_into(&bench.state.q, &mut r, &mut t);
        let geometry = sinew::collision::BodyGeometry::from_arm(&bench.config);
        let mut body = sinew::collision::Body::new(&geometry, config.body, config.body_radius_m);
        let rows = body.find(&r, &t, &balls, 0.05).rows.to_vec();
        assert!(rows.len() >= 2);
        // Body points that follow their nodes' positions.
        let (mut origin, mut slope) = (Vec::new(), Vec::new());
        for row in &rows {
            let at = 11 * row.point.element.max(1) - 11;
            for c in 0..3 {
                origin.push(row.position[c] + map.x0[at + c]);
                slope.extend_from_slice(map.row(at + c));
            }
        }
        let required = vec![config.clearance_m; rows.len()];
        let length = vec![0.1; rows.len()];
        Self { quadratic, rows, required, length, origin, slope, balls }
    }

    fn pairs(&self, clearance: f64) -> Pairs<'_> {
        Pairs {
            rows: &self.rows,
            required: &self.required,
            length: &self.length,
            clearance,
            origin: &self.origin,
            slope: &self.slope,
            obstacles: &self.balls,
        }
    }

    /// (28), particle by particle.
    fn cost(&self, clearance: f64, nu: f64, u: &[f64]) -> f64 {
        let n = u.len();
        let mut cost = self.quadratic.cost(u);
        for (r, row) in self.rows.iter().enumerate() {
            let at = Vector3::from_fn(|c, _| {
                let slope = &self.slope[(3 * r + c) * n..(3 * r + c + 1) * n];
                self.origin[3 * r + c] + slope.iter().zip(u).map(|(s, u)| s * u).sum::<f64>()
            });
            let d = self.balls.moved_distance(row, &at);
            if d < self.required[r] {
                cost += nu * penalty(d - self.required[r] + clearance, clearance, self.length[r]).0;
            }
        }
        cost
    }
}

#[test]
fn the_swarms_answer_is_never_worse_than_any_seed_and_costs_what_it_says() {
    let bench = Bench::paper();
    let config = settings(WarningBranch::Swarm);
    let case = SwarmCase::new(&bench, &config);
    let (lower, upper) = (vec![0.0; 24], vec![220.0; 24]);
    let mut swarm = Swarm::new(24, &config.swarm, 3);
    let mut beaten = 0;
    for seed in 0..40 {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let other: Vec<f64> = random_vector(&mut rng, 24, 30.0).iter().map(|u| u.abs()).collect();
        let third: Vec<f64> = bench.u.iter().map(|u| 0.9 * u).collect();
        let seeds: [&[f64]; 3] = [&bench.u, &other, &third];
        for variant in [Variant::Improved, Variant::Standard] {
            // From no time at all to many sweeps.
            for sweeps in [1usize, 2, 10] {
                let mut left = sweeps;
                let report = swarm.search(
                    variant,
                    &config.swarm,
                    &case.quadratic,
                    &case.pairs(config.clearance_m),
                    &lower,
                    &upper,
                    &seeds,
                    None,
                    &mut rng,
                    &mut || {
                        left -= 1;
                        left == 0
                    },
                );
                assert_eq!(report.sweeps, sweeps);
                let own = case.cost(config.clearance_m, config.swarm.penalty, swarm.answer());
                assert!((own / report.cost - 1.0).abs() < 1e-9, "{own} {report:?}");
                for s in seeds {
                    let cost = case.cost(config.clearance_m, config.swarm.penalty, s);
                    assert!(report.cost <= cost * (1.0 + 1e-12), "{variant:?} seed {seed}: {report:?} for {cost}");
                }
                assert!(swarm.answer().iter().all(|u| (0.0..=220.0).contains(u)));
                beaten += usize::from(report.seed.is_none());
            }
        }
    }
    assert!(beaten > 20, "the swarm finds better than its seeds: {beaten}");
}

#[test]
fn a_swarm_that_must_be_strict_never_undercuts_a_seed_that_keeps_its_distance() {
    let bench = Bench::paper();
    let config = settings(WarningBranch::Seeded);
    let case = SwarmCase::new(&bench, &config);
    let soft = SwarmConfig { penalty: 0.0, ..config.swarm };
    let mut swarm = Swarm::new(24, &config.swarm, 3);
    let violation = |u: &[f64]| {
        (0..case.rows.len()).fold(0.0f64, |worst, r| {
            let at = Vector3::from_fn(|c, _| {
                let slope = &case.slope[(3 * r + c) * 24..(3 * r + c + 1) * 24];
                case.origin[3 * r + c] + slope.iter().zip(u).map(|(s, u)| s * u).sum::<f64>()
            });
            worst.max(case.required[r] - case.balls.moved_distance(&case.rows[r], &at))
        })
    };
    let mut tempted = 0;
    for seed in 0..20 {
        for strict in [None, Some(1e-9)] {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            // Without a penalty only strictness keeps the distance.
            swarm.search(
                Variant::Improved,
                &soft,
                &case.quadratic,
                &case.pairs(config.clearance_m),
                &[0.0; 24],
                &[220.0; 24],
                &[&bench.u, &bench.u],
                strict,
                &mut rng,
                &mut || false,
            );
            let worst = violation(swarm.answer());
            match strict {
                None => tempted += usize::from(worst > 1e-6),
                Some(limit) => assert!(worst <= limit + 1e-12, "seed {seed}: {worst}"),
            }
        }
    }
    assert!(tempted > 0, "the soft optimum lies inside an obstacle");
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
