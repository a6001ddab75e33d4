//! Static poses: from rest by a step of the target, then watched. What a pose showed is told by the true arm.

use crate::bench::Bench;
use nalgebra::{Vector3, Vector4};
use sinew::config::Config;
use sinew::control::{CURVATURES_MAX, Mode, Request, Target, TargetInput};
use sinew::stability::random_posture;
use std::io::{self, Write};

/// A pose with the posture that it was made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// Position of the tip (m, base frame).
    pub position: Vector3<f64>,
    /// Quaternion (body to base).
    pub quaternion: Vector4<f64>,
    /// Mean curvatures (1/m).
    pub curvatures: Vec<f64>,
}

/// The pose of the model's equilibrium at random mean curvatures.
pub fn random(config: &Config, seed: u64) -> Pose {
    let (curvatures, (position, quaternion)) = random_posture(config, seed);
    Pose { position, quaternion, curvatures }
}

/// What a pose showed, all by the true arm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Shown {
    /// Of the pose and of the plant.
    pub seed: u64,
    /// Length of the path (s).
    pub path_s: f64,
    /// Largest error of the position (m).
    pub error: f64,
    /// Motion of the tip, peak to peak (m).
    pub peak_to_peak: f64,
    /// Largest error of the estimated position (m).
    pub estimate_error: f64,
    /// Share of all ticks, on the way too, in which that is within three standard deviations of the estimate.
    pub within: f64,
    /// Three standard deviations at the end (m).
    pub three_sigma: f64,
    /// Largest speed of the tip (m/s), on the way too.
    pub speed_max: f64,
    /// Largest tension (N), on the way too.
    pub tension_max: f64,
    /// Largest change of a tension per second (N/s), since the arm was armed.
    pub tension_rate_max: f64,
    /// Tensions at their bound at the end.
    pub saturated: usize,
    /// Largest error of a mean curvature at the end (1/m).
    pub curvature_error: f64,
    /// Distance of the reference's posture from the pose (m).
    pub reach: f64,
    /// Why it ended early.
    pub failed: Option<String>,
    /// Root mean square of the change of a tension a tick (N).
    pub roughness: f64,
    /// Growth of the motion from the first to the last third of the time watched (1/s).
    pub growth: f64,
}

/// Largest standard deviation of the tip's estimated position (m).
fn governor_sigma(bench: &Bench) -> f64 {
    bench.cycle.governor().covariance().element_sigma_m().last().copied().unwrap_or(0.0)
}

fn target_at(pose: &Pose, shape: bool) -> TargetInput {
    let now = if shape {
        let mut curvatures_1pm = [0.0; CURVATURES_MAX];
        curvatures_1pm[..pose.curvatures.len()].copy_from_slice(&pose.curvatures);
        Target::Shape { curvatures_1pm, rates_1pms: [0.0; CURVATURES_MAX] }
    } else {
        Target::Tip {
            position_m: pose.position,
            quaternion: pose.quaternion,
            velocity_mps: Vector3::zeros(),
            angular_velocity_radps: Vector3::zeros(),
        }
    };
    TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true }
}

/// Steps the target of an armed arm to a pose, or to its posture (`shape`), waits for the end of the path, and watches from 5 s
/// later on for `watch` seconds. `trace` receives a line a tick: time, true tip, errors of the estimate and of the tip, largest
/// tension, its change, the reference's curvatures.
///
/// # Errors
/// The trace could not be written.
pub fn show(
    bench: &mut Bench,
    pose: &Pose,
    shape: bool,
    watch: f64,
    mut trace: Option<&mut dyn Write>,
) -> io::Result<Shown> {
    let mut shown = Shown::default();
    bench.target = Some(target_at(pose, shape));
    let mut request = (bench.cycle.mode() != Mode::Tracking).then_some(Request::Track);
    let begin = bench.time_s();
    let mut tip = bench.truth.tip().position;
    let mut last_u: Vec<f64> = bench.cycle.tensions_n().to_vec();
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let (mut end, mut squares, mut count, mut within) = (None, 0.0, 0usize, 0usize);
    let mut thirds = [(Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)); 3];
    loop {
        let before = bench.time_s();
        let output = bench.step(request.take());
        let h = bench.time_s() - before;
        let t = bench.time_s() - begin;
        let now = bench.truth.tip().position;
        shown.speed_max = shown.speed_max.max((now - tip).norm() / h);
        tip = now;
        let governor = bench.cycle.governor();
        if end.is_none() && !governor.is_solving() && governor.remaining_s() <= 0.0 && t > 0.5 {
            end = Some(t);
            shown.path_s = t;
        }
        let u = bench.cycle.tensions_n();
        let change = u.iter().zip(&last_u).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / u.len() as f64;
        squares += change;
        count += 1;
        last_u.copy_from_slice(u);
        shown.tension_max = u.iter().copied().fold(shown.tension_max, f64::max);
        let estimate = (bench.cycle.estimated_tip() - now).norm();
        let sigma = governor_sigma(bench);
        within += usize::from(estimate <= 3.0 * sigma);
        shown.three_sigma = 3.0 * sigma;
        if let Some(file) = &mut trace {
            let largest = last_u.iter().copied().fold(0.0, f64::max);
            write!(file, "{t:.3},{:.5},{:.5},{:.5},{estimate:.5},", now[0], now[1], now[2])?;
            write!(file, "{:.5},{largest:.3},{:.4}", (now - pose.position).norm(), change.sqrt())?;
            bench.cycle.governor().reference().iter().try_for_each(|k| write!(file, ",{k:.6}"))?;
            writeln!(file)?;
        }
        if let Some(end) = end
            && t > end + 5.0
        {
            let third = &mut thirds[(((t - end - 5.0) / watch * 3.0) as usize).min(2)];
            *third = (third.0.inf(&now), third.1.sup(&now));
            low = low.inf(&now);
            high = high.sup(&now);
            shown.error = shown.error.max((now - pose.position).norm());
            shown.estimate_error = shown.estimate_error.max(estimate);
            if t > end + 5.0 + watch {
                break;
            }
        }
        if output.mode != Mode::Tracking {
            let why = bench.cycle.supervisor().latch().first.map(|l| l.fault.to_string());
            shown.failed = Some(format!("{:?} at {t:.2} s: {}", output.mode, why.unwrap_or_default()));
            break;
        }
        if let Some(why) = &bench.broken {
            shown.failed = Some(format!("plant {why}"));
            break;
        }
        if t > 120.0 && end.is_none() {
            shown.failed = Some(format!("the path did not end (blocked: {})", bench.cycle.governor().is_blocked()));
            break;
        }
    }
    shown.within = within as f64 / count.max(1) as f64;
    shown.peak_to_peak = (high - low).norm();
    let swing = |k: usize| (thirds[k].1 - thirds[k].0).norm();
    shown.growth = (swing(2) / swing(0)).ln() / (watch * 2.0 / 3.0);
    shown.roughness = (squares / count.max(1) as f64).sqrt();
    let k = bench.truth.curvatures();
    shown.curvature_error = k.iter().zip(&pose.curvatures).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    shown.tension_rate_max = bench.tension_rate_max_nps;
    shown.reach = bench.cycle.governor().reach().map_or(f64::NAN, |reach| reach.miss_m);
    shown.saturated = last_u.iter().filter(|u| **u > 0.999 * bench.truth.config().tension_n_max).count();
    Ok(shown)
}
