//! What no target moves the arm faster than, and what the arm does about one that it does not reach; judged by the true arm.

#![allow(clippy::expect_used)] // a test stops where it cannot go on
use nalgebra::Vector3;
use sim_plant::bench::Bench;
use sim_plant::poses::{Pose, random};
use sim_plant::truth::TruthSettings;
use sinew::collision::Shape;
use sinew::config::{Config, OutOfReach, ShapeConfig};
use sinew::control::obstacles::Placement;
use sinew::control::{Limit, Mode, Request, Settings, Target, TargetInput};
use sinew::model::Arm;
use sinew::posture::RestingArm;

/// What the encoders' steps and the arm's swing add to a speed that is asked for, in share of the full one.
const SWING_SHARE: f64 = 0.14;

fn armed(change: impl Fn(&mut Config)) -> (Config, Bench) {
    let mut config = Config::builtin();
    change(&mut config);
    let mut bench = Bench::new(&config, &Settings::new(&config), &TruthSettings::study(1));
    bench.arm(60.0).expect("armed");
    (config, bench)
}

fn target(pose: &Pose, velocity_mps: Vector3<f64>) -> TargetInput {
    let now = Target::Tip {
        position_m: pose.position,
        quaternion: pose.quaternion,
        velocity_mps,
        angular_velocity_radps: Vector3::zeros(),
    };
    TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true }
}

/// Runs for a time; the largest speed of the true tip and how far it went (m/s, m).
fn run(bench: &mut Bench, seconds: f64, mut request: Option<Request>, mut each: impl FnMut(&mut Bench)) -> (f64, f64) {
    let (from, begin) = (bench.truth.tip().position, bench.time_s());
    let (mut before, mut fastest) = (from, 0.0f64);
    while bench.time_s() < begin + seconds {
        each(bench);
        let at = bench.time_s();
        bench.step(request.take());
        let tip = bench.truth.tip().position;
        fastest = fastest.max((tip - before).norm() / (bench.time_s() - at));
        before = tip;
    }
    (fastest, (before - from).norm())
}

/// Fastest on the way to a pose, and how long the path takes (s).
fn way(scale: f64) -> (f64, f64) {
    let (config, mut bench) = armed(|_| ());
    bench.cycle.set_speed_scale(scale);
    bench.target = Some(target(&random(&config, 7), Vector3::zeros()));
    let mut request = Some(Request::Track);
    let begin = bench.time_s();
    let mut fastest = 0.0f64;
    while bench.time_s() < begin + 2.0
        || bench.cycle.governor().is_solving()
        || bench.cycle.governor().remaining_s() > 0.0
    {
        fastest = fastest.max(run(&mut bench, 0.1, request.take(), |_| ()).0);
        assert!(bench.time_s() < begin + 200.0 && bench.cycle.mode() == Mode::Tracking, "{:?}", bench.cycle.mode());
    }
    (fastest, bench.time_s() - begin)
}

#[test]
fn half_the_speed_is_half_the_speed_of_the_true_tip() {
    let (full, half) = (way(1.0), way(0.5));
    let speed = Config::builtin().governor.speed_mps;
    assert!(full.0 < (1.0 + SWING_SHARE) * speed && half.0 < (0.5 + SWING_SHARE) * speed, "{full:?} {half:?}");
    assert!((0.4..0.6).contains(&(half.0 / full.0)), "{full:?} {half:?}");
    assert!((1.8..2.1).contains(&(half.1 / full.1)), "{full:?} {half:?}");
}

/// Poses of the model's equilibria at shares of some mean curvatures, from the straight arm on.
fn poses_towards(config: &Config, curvatures: &[f64], count: usize) -> Vec<Pose> {
    let arm = Arm::new(&config.arm);
    let u = vec![config.arm.tension_n_min; arm.cable_count()];
    let mut rest = RestingArm::new(&arm);
    let mut pose = |k: usize| {
        let wanted: Vec<f64> = curvatures.iter().map(|c| c * k as f64 / count as f64).collect();
        for _ in 0..4 {
            rest.linearize(&u).expect("regular");
            rest.advance(&wanted);
        }
        let (position, quaternion) = rest.tip();
        Pose { position, quaternion, curvatures: wanted }
    };
    (0..=count).map(&mut pose).collect()
}

#[test]
fn a_target_that_runs_is_followed_at_the_scaled_speed() {
    let (config, mut bench) = armed(|_| ());
    let speed = config.governor.speed_mps;
    let poses = poses_towards(&config, &random(&config, 7).curvatures, 200);
    bench.cycle.set_speed_scale(0.5);
    run(&mut bench, 5.0, None, |_| ());
    // Twice as fast as the whole speed.
    let mut way = vec![0.0];
    for pair in poses.windows(2) {
        way.push(way[way.len() - 1] + (pair[1].position - pair[0].position).norm());
    }
    let begin = bench.time_s();
    let seconds = 0.9 * way[way.len() - 1] / (2.0 * speed);
    assert!(seconds > 3.0, "long enough to be seen: {seconds} s");
    let (fastest, gone) = run(&mut bench, seconds, Some(Request::Track), |bench| {
        let at = 2.0 * speed * (bench.time_s() - begin);
        let k = way.partition_point(|w| *w <= at).clamp(1, poses.len() - 1);
        let share = (at - way[k - 1]) / (way[k] - way[k - 1]);
        let position = poses[k - 1].position.lerp(&poses[k].position, share);
        let quaternion = poses[k - 1].quaternion.lerp(&poses[k].quaternion, share).normalize();
        bench.target = Some(target(&Pose { position, quaternion, curvatures: Vec::new() }, Vector3::zeros()));
    });
    assert_eq!(bench.cycle.mode(), Mode::Tracking);
    // The target sets off at once, and the arm swings for it: by less than the speed that it takes on.
    assert!(fastest < 0.9 * speed, "{fastest} m/s");
    assert!((0.35..0.55).contains(&(gone / seconds / speed)), "{gone} m in {seconds} s");
}

#[test]
fn a_scale_is_kept_over_modes_and_forgotten_when_the_arm_is_disarmed() {
    let (_, mut bench) = armed(|_| ());
    bench.cycle.set_speed_scale(0.3);
    run(&mut bench, 0.5, Some(Request::Home), |_| ());
    assert_eq!((bench.record().speed_scale, bench.cycle.speed_scale()), (0.3, 0.3));
    run(&mut bench, 0.5, Some(Request::Hold), |_| ());
    assert_eq!(bench.record().speed_scale, 0.3);
    run(&mut bench, 30.0, Some(Request::Stop), |_| ());
    assert_eq!(bench.cycle.mode(), Mode::Disarmed);
    assert_eq!((bench.record().speed_scale, bench.cycle.speed_scale()), (1.0, 1.0));
}

#[test]
fn a_stop_from_slow_motion_is_as_quick_as_any() {
    let stopped = |scale: f64| {
        let (config, mut bench) = armed(|_| ());
        bench.target = Some(target(&random(&config, 7), Vector3::zeros()));
        run(&mut bench, 60.0, Some(Request::Track), |_| ());
        bench.cycle.set_speed_scale(scale);
        let begin = bench.time_s();
        let mut request = Some(Request::Stop);
        while bench.cycle.mode() != Mode::Disarmed && bench.time_s() < begin + 200.0 {
            run(&mut bench, 0.1, request.take(), |_| ());
        }
        bench.time_s() - begin
    };
    let (full, slow) = (stopped(1.0), stopped(0.05));
    assert!((slow - full).abs() < 0.1 * full, "{full} s, {slow} s at a twentieth of the speed");
}

fn far_away(position: [f64; 3]) -> Pose {
    let quaternion = Config::builtin().arm.base_quaternion.into();
    Pose { position: position.into(), quaternion, curvatures: Vec::new() }
}

#[test]
fn a_target_out_of_reach_is_approached_and_the_miss_is_told() {
    let (_, mut bench) = armed(|_| ());
    let wanted = far_away([0.5, 0.3, -3.2]);
    bench.target = Some(target(&wanted, Vector3::zeros()));
    run(&mut bench, 60.0, Some(Request::Track), |_| ());
    assert_eq!(bench.cycle.mode(), Mode::Tracking);
    let tip = bench.truth.tip().position;
    let record = bench.record();
    let reach = record.reach.expect("found out");
    assert!(reach.is_out && record.limits.contains(Limit::OutOfReach), "{reach:?}");
    // The miss is what the true arm is away from it, and the nearest point where it is.
    assert!(((tip - wanted.position).norm() - reach.miss_m).abs() < 0.02, "{tip} {reach:?}");
    assert!((tip - reach.nearest_m).norm() < 0.02, "{tip} {reach:?}");
    assert!(reach.miss_m > 0.3, "{reach:?}");
}

#[test]
fn a_target_out_of_reach_is_refused_by_key_and_the_arm_stays() {
    let (config, mut bench) = armed(|config| config.governor.out_of_reach = OutOfReach::Refuse);
    let wanted = far_away([0.5, 0.3, -3.2]);
    bench.target = Some(target(&wanted, Vector3::zeros()));
    let (fastest, gone) = run(&mut bench, 15.0, Some(Request::Track), |_| ());
    assert_eq!(bench.cycle.mode(), Mode::Holding);
    assert!(fastest < 0.005 && gone < 0.002, "{fastest} m/s, {gone} m");
    let record = bench.record();
    let reach = record.reach.expect("it is told while the arm holds for it");
    assert!(reach.is_out && record.limits.contains(Limit::OutOfReach), "{reach:?}");
    assert!(
        ((reach.nearest_m - wanted.position).norm() - reach.miss_m).abs() < 1e-9 && reach.miss_m > 0.3,
        "{reach:?}"
    );
    // One within reach is followed once it is asked for.
    bench.target = Some(target(&random(&config, 7), Vector3::zeros()));
    let (_, gone) = run(&mut bench, 20.0, Some(Request::Track), |_| ());
    assert_eq!(bench.cycle.mode(), Mode::Tracking);
    assert!(gone > 0.2 && !bench.record().limits.contains(Limit::OutOfReach), "{gone} m");
}

#[test]
fn a_target_that_leaves_the_reach_is_followed_to_its_edge_and_there_the_arm_holds() {
    let (_, mut bench) = armed(|config| config.governor.out_of_reach = OutOfReach::Refuse);
    let start = bench.truth.tip();
    let begin = bench.time_s();
    let leave = |bench: &mut Bench| {
        let t = bench.time_s() - begin;
        // The straight arm is as long as it gets.
        let pose = Pose {
            position: start.position + Vector3::new(0.0, 0.0, -0.02 * (t - 5.0).max(0.0)),
            quaternion: start.quaternion,
            curvatures: Vec::new(),
        };
        bench.target = Some(target(&pose, Vector3::zeros()));
    };
    run(&mut bench, 5.0, Some(Request::Track), leave);
    assert_eq!(bench.cycle.mode(), Mode::Tracking, "within reach");
    run(&mut bench, 10.0, None, leave);
    assert_eq!(bench.cycle.mode(), Mode::Holding);
    assert!(bench.record().limits.contains(Limit::OutOfReach) && bench.record().reach.is_some_and(|r| r.is_out));
    let (fastest, gone) = run(&mut bench, 5.0, None, leave);
    assert!(fastest < 0.02 && gone < 0.005, "{fastest} m/s, {gone} m");
}

#[test]
fn nothing_wild_changes_a_tension_faster_than_the_arm_is_declared_to() {
    let (config, mut bench) = armed(|_| ());
    let most = config.arm.tension_rate_npsmax;
    assert!(most.is_finite());
    // A kilometre away, somewhere else, and a ball that is said to be on the arm.
    for position in [[1000.0, 0.0, 0.0], [0.0, -1000.0, 300.0]] {
        bench.target = Some(target(&far_away(position), Vector3::zeros()));
        run(&mut bench, 6.0, Some(Request::Track), |_| ());
    }
    let shape = Shape::new(&ShapeConfig::Ball { radius_m: 0.5 }).expect("a ball");
    bench.obstacles.insert(1, &shape).expect("a place for it");
    let at: [f64; 3] = (0.6 * bench.truth.tip().position).into();
    let place = Placement { position_now_m: at, position_ahead_m: at, quaternion: [1.0, 0.0, 0.0, 0.0], growth_m: 0.0 };
    bench.obstacles.place(0, &place).expect("placed");
    run(&mut bench, 10.0, None, |_| ());
    let found = bench.tension_rate_max_nps;
    assert!(found > 0.0 && found <= most * (1.0 + 1e-9), "{found} N/s, permitted {most}");
    assert!(bench.broken.is_none());
}
