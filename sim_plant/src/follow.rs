//! A scenario in the closed loop, as `sinew demo` runs it, without bus and processes. What it showed is told by the true arm.

use crate::bench::Bench;
use crate::truth::TruthSettings;
use nalgebra::{Vector3, Vector4};
use sinew::collision::{Body, BodyGeometry};
use sinew::config::{ArmConfig, BodyModel, Config, Motion, Scale, ScenarioConfig, ShapeConfig, Start, Task, TipPath};
use sinew::control::{CURVATURES_MAX, Mode, Request, Target, TargetInput};

/// Time before a path at its first pose (s).
const APPROACH_S: f64 = 10.0;

/// What a run showed, all by the true arm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Followed {
    /// Mean and largest error of the tip's position over the arm's length; NaN for a shape.
    pub error: (f64, f64),
    /// When it was largest (s).
    pub worst_s: f64,
    /// Largest error of a mean curvature at the end over the largest curvature wanted; NaN for a path.
    pub curvature_error: f64,
    /// Least distance of the backbone from an obstacle over the arm's length; infinite without.
    pub distance: f64,
    /// Root mean square of the change of a tension a tick over the largest tension.
    pub roughness: f64,
    /// Largest change of a tension per time, over the largest tension times the first angular frequency.
    pub tension_rate: f64,
    /// Largest error of the estimated tip over the arm's length.
    pub estimate_error: f64,
    /// Why it ended early.
    pub failed: Option<String>,
}

/// The plant that any arm is measured against: EI 5 % softer, tensions 3 % off, twice the mesh, 20 % more damping, encoder
/// steps of 1e-5 of the length, steps of at most a two-hundredth of the first period.
pub fn plant(config: &Config, seed: u64) -> TruthSettings {
    TruthSettings {
        disk_mass_factor: 1.0,
        encoder_step_m: 1e-5 * config.arm.length_m(),
        ..TruthSettings::study_of(config, seed)
    }
}

/// The paper's rod, 2.4 m of it, as an arm of so many segments, each with cables at these angles (deg).
pub fn divided(segments: usize, cables_deg: &[f64]) -> ArmConfig {
    let mut arm = ArmConfig::paper();
    let mut segment = arm.segments[0].clone();
    segment.length_m = 2.4 / segments as f64;
    segment.elements = (32 / segments).max(2);
    segment.connector_length_m = 0.0;
    segment.hole_angles_rad = cables_deg.iter().map(|angle| angle.to_radians()).collect();
    arm.segments = vec![segment; segments];
    arm
}

/// The similar scenario of `s` times the size, at the same pace: arm, path, obstacles and start. Its weights and its planner are
/// those of an open-loop run and stay.
pub fn scaled(scenario: &ScenarioConfig, s: f64) -> ScenarioConfig {
    let mut scenario = scenario.clone();
    let vector = |v: &mut [f64; 3]| v.iter_mut().for_each(|x| *x *= s);
    scenario.arm = scenario.arm.scaled(s);
    match &mut scenario.task {
        Task::Tip { path: TipPath::Lemniscate { scale_m, height_m, .. }, .. } => {
            *scale_m *= s;
            *height_m *= s;
        }
        Task::Tip { path: TipPath::Waypoints(points), .. } => {
            points.iter_mut().for_each(|point| vector(&mut point.position_m));
        }
        Task::Shape { curvatures_1pm, .. } => curvatures_1pm.iter_mut().for_each(|k| *k /= s),
    }
    scenario.planner.body_radius_m *= s;
    match &mut scenario.start {
        Start::Straight => {}
        Start::Tensions(tensions_n) => tensions_n.iter_mut().for_each(|u| *u *= s.powi(4)),
        Start::TipPose { guess_curvatures_1pm } => guess_curvatures_1pm.iter_mut().for_each(|k| *k /= s),
    }
    for obstacle in &mut scenario.obstacles {
        match &mut obstacle.shape {
            ShapeConfig::Ball { radius_m } => *radius_m *= s,
            ShapeConfig::Capsule { half_length_m, radius_m } => {
                *half_length_m *= s;
                *radius_m *= s;
            }
            ShapeConfig::Box { half_extents_m } => vector(half_extents_m),
            ShapeConfig::HalfSpace => {}
            ShapeConfig::Hull { points_m } => points_m.iter_mut().for_each(vector),
        }
        match &mut obstacle.motion {
            Motion::Linear { position_m, velocity_mps } => {
                vector(position_m);
                vector(velocity_mps);
            }
            Motion::Circle { centre_m, radius_m, .. } => {
                vector(centre_m);
                *radius_m *= s;
            }
            Motion::Waypoints(points) => points.iter_mut().for_each(|(_, position_m)| vector(position_m)),
        }
    }
    scenario
}

/// Runs a scenario with the arm of `config`, whose planner avoids as the scenario says, up to its end or `duration_s`. `trace`
/// sees the bench, the task's time (s) and the tip's error (m) after each tick.
///
/// # Errors
/// The arm does not stand where the scenario starts, or its controller does not come to hold it.
pub fn follow(
    config: &Config,
    truth: &TruthSettings,
    scenario: &ScenarioConfig,
    duration_s: Option<f64>,
    mut trace: impl FnMut(&mut Bench, f64, f64),
) -> Result<Followed, String> {
    let mut config = config.clone();
    config.planner.avoidance = scenario.planner.avoidance;
    let mut bench = Bench::at_start_of(scenario, &config, truth)?;
    bench.insert(&scenario.obstacles)?;
    bench.arm(config.observer.settle_timeout_s + 10.0).map_err(|why| format!("not armed: {why}"))?;
    let (h, lookahead, length) = (config.timing.period_s, config.planner.lookahead_s, config.arm.length_m());
    let nodes = bench.truth.config().node_count() + 1;
    let (mut r, mut t) = (vec![Vector3::zeros(); nodes], vec![Vector3::zeros(); nodes]);
    let mut body = Body::with_capacity(&BodyGeometry::from_arm(bench.truth.config()), BodyModel::Arm, 0.0, 16);
    let approach_s = if matches!(scenario.task, Task::Tip { .. }) { APPROACH_S } else { 0.0 };
    let begin = bench.time_s() + approach_s;
    let duration = duration_s.unwrap_or(scenario.duration_s);
    let mut request = Some(Request::Track);
    let mut shown =
        Followed { distance: f64::INFINITY, error: (0.0, 0.0), curvature_error: f64::NAN, ..Followed::default() };
    let (mut count, mut squares) = (0usize, 0.0);
    let mut last: Vec<f64> = bench.cycle.tensions_n().to_vec();
    while bench.time_s() < begin + duration {
        let now = bench.time_s() + h - begin;
        bench.place(&scenario.obstacles, now, lookahead)?;
        bench.target = Some(target(&scenario.task, now, now + bench.cycle.lead_s()));
        let output = bench.step(request.take());
        let tip = bench.truth.tip();
        let mut error = f64::NAN;
        if let Task::Tip { path, .. } = &scenario.task {
            error = (tip.position - Vector3::from(path.pose_at(now.max(0.0)).0)).norm();
        }
        let u = bench.cycle.tensions_n();
        let change = u.iter().zip(&last).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / u.len() as f64;
        last.copy_from_slice(u);
        bench.truth.frames_into(&mut r, &mut t);
        let measured = body.measure(&r, &t, bench.obstacles.now());
        shown.distance = measured.along_arm.iter().copied().fold(shown.distance, |a, d| a.min(d / length));
        if now >= 0.0 {
            shown.error.0 += error / length;
            count += 1;
            squares += change;
            let estimate = (bench.cycle.estimated_tip() - tip.position).norm();
            shown.estimate_error = shown.estimate_error.max(estimate / length);
            if error / length > shown.error.1 {
                shown.error.1 = error / length;
                shown.worst_s = now;
            }
        }
        trace(&mut bench, now, error);
        if output.mode != Mode::Tracking {
            let why = bench.cycle.supervisor().latch().first.map(|l| l.fault.to_string());
            shown.failed = Some(format!("{:?} at {now:.2} s: {}", output.mode, why.unwrap_or_default()));
            break;
        }
        if let Some(why) = &bench.broken {
            shown.failed = Some(format!("plant {why}"));
            break;
        }
    }
    shown.error.0 /= count.max(1) as f64;
    let scale = Scale::of(&config.arm);
    shown.tension_rate = bench.tension_rate_max_nps / (scale.tension_n * scale.omega_radps);
    shown.roughness = (squares / count.max(1) as f64).sqrt() / config.arm.tension_n_max;
    if let Task::Shape { curvatures_1pm, .. } = &scenario.task {
        let largest = curvatures_1pm.iter().fold(0.0f64, |a, k| a.max(k.abs()));
        let off = bench.truth.curvatures().iter().zip(curvatures_1pm).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        shown.curvature_error = off / largest;
        shown.error = (f64::NAN, f64::NAN);
    }
    Ok(shown)
}

/// What a task wants at its time `now`, and `ahead` (s).
pub fn target(task: &Task, now: f64, ahead: f64) -> TargetInput {
    match task {
        Task::Tip { path, .. } => {
            let at = |t: f64| {
                let (position, quaternion) = path.pose_at(t.max(0.0));
                Target::Tip {
                    position_m: position.into(),
                    quaternion: Vector4::from(quaternion),
                    velocity_mps: Vector3::zeros(),
                    angular_velocity_radps: Vector3::zeros(),
                }
            };
            TargetInput { now: at(now), ahead: Some(at(ahead)), weight: 0.0, sequence: 1, fresh: true }
        }
        Task::Shape { curvatures_1pm, .. } => {
            let mut k = [0.0; CURVATURES_MAX];
            k[..curvatures_1pm.len()].copy_from_slice(curvatures_1pm);
            let now = Target::Shape { curvatures_1pm: k, rates_1pms: [0.0; CURVATURES_MAX] };
            TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true }
        }
    }
}
