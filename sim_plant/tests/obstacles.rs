//! What the true arm does when it is stopped beside an obstacle, and when a ball flies at it.
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test

use nalgebra::Vector3;
use sim_plant::bench::Bench;
use sim_plant::truth::TruthSettings;
use sinew::collision::{Body, BodyGeometry, Shape};
use sinew::config::{BodyModel, Config, ScenarioConfig, ShapeConfig};
use sinew::control::obstacles::Placement;
use sinew::control::{Mode, Request};

/// The true arm, held in the paper's start, and what its surface was nearest to.
struct World {
    bench: Bench,
    body: Body,
    nodes: (Vec<Vector3<f64>>, Vec<Vector3<f64>>),
    tip: Vector3<f64>,
    least_m: f64,
    fastest_mps: f64,
    config: Config,
}

impl World {
    fn new() -> Self {
        let config = Config::builtin();
        let truth = TruthSettings::study(1);
        let scenario = ScenarioConfig::find("tip").expect("built in");
        let mut bench = Bench::at_start_of(&scenario, &config, &truth).expect("the paper's start");
        bench.arm(60.0).expect("armed");
        let count = bench.truth.config().node_count() + 1;
        let geometry = BodyGeometry::from_arm(bench.truth.config());
        let body = Body::with_capacity(&geometry, BodyModel::Arm, 0.0, 16);
        let mut nodes = (vec![Vector3::zeros(); count], vec![Vector3::zeros(); count]);
        bench.truth.frames_into(&mut nodes.0, &mut nodes.1);
        let tip = bench.truth.tip().position;
        Self { bench, body, nodes, tip, least_m: f64::INFINITY, fastest_mps: 0.0, config }
    }

    fn ball(&mut self, radius_m: f64) {
        let shape = Shape::new(&ShapeConfig::Ball { radius_m }).unwrap();
        self.bench.obstacles.insert(1, &shape).unwrap();
    }

    fn place(&mut self, from: Vector3<f64>, velocity: Vector3<f64>, time_s: f64) {
        let at = |time_s: f64| (from + time_s * velocity).into();
        let ahead_s = time_s + self.config.planner.lookahead_s;
        let placement = Placement {
            position_now_m: at(time_s),
            position_ahead_m: at(ahead_s),
            quaternion: [1.0, 0.0, 0.0, 0.0],
            growth_m: 0.0,
        };
        self.bench.obstacles.place(0, &placement).unwrap();
    }

    fn step(&mut self, request: Option<Request>) -> Mode {
        let mode = self.bench.step(request).mode;
        assert_eq!(self.bench.broken, None);
        let tip = self.bench.truth.tip().position;
        self.fastest_mps = self.fastest_mps.max((tip - self.tip).norm() / self.config.timing.period_s);
        self.tip = tip;
        self.bench.truth.frames_into(&mut self.nodes.0, &mut self.nodes.1);
        let measured = self.body.measure(&self.nodes.0, &self.nodes.1, self.bench.obstacles.now());
        self.least_m = measured.along_arm.iter().copied().fold(self.least_m, f64::min);
        mode
    }
}

#[test]
fn a_stop_lowers_the_arm_around_an_obstacle_and_disarmed_is_told_of_an_arm_at_rest() {
    let mut world = World::new();
    // In the way of the last third, from the start to where the arm hangs.
    let (from, to) = (world.tip, Vector3::new(0.0, 0.0, -2.75));
    world.ball(0.06);
    world.place(from + 0.5 * (to - from) + Vector3::new(0.0, 0.05, 0.0), Vector3::zeros(), 0.0);
    let mut mode = world.step(Some(Request::Stop));
    let mut ticks = 0;
    while mode == Mode::Stopping && ticks < 12_000 {
        mode = world.step(None);
        ticks += 1;
    }
    assert_eq!(mode, Mode::Disarmed, "after {ticks} ticks");
    assert!(world.least_m > 0.0, "{} m", world.least_m);
    assert!(world.tip.x.hypot(world.tip.y) < 0.15, "it hangs: {:?}", world.tip);
    let before = world.tip;
    world.step(None);
    let left_mps = (world.tip - before).norm() / world.config.timing.period_s;
    assert!(left_mps < 0.01 * 2.75, "{left_mps} m/s");
    assert!(world.fastest_mps < 2.0 * world.config.governor.speed_mps, "{} m/s", world.fastest_mps);
}

#[test]
fn a_ball_that_flies_at_the_body_is_given_way_to() {
    let mut world = World::new();
    let middle = world.nodes.0[world.nodes.0.len() * 2 / 3];
    let velocity = 0.3 * Vector3::new(0.2, -0.9, 0.3).normalize();
    let (from, tip) = (middle - 5.0 * velocity, world.tip);
    world.ball(0.1);
    for k in 0..1800 {
        world.place(from, velocity, f64::from(k) * world.config.timing.period_s);
        assert_eq!(world.step(None), Mode::Holding);
    }
    assert!(world.least_m > 0.0, "{} m", world.least_m);
    assert!(world.fastest_mps < 1.3 * world.config.governor.evasion_mps, "{} m/s", world.fastest_mps);
    assert!((world.tip - tip).norm() < 1.0, "it stayed about where it was: {:?}", world.tip - tip);
}
