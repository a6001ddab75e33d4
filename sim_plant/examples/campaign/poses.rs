//! Static poses: from rest by a step of the target, then watched.

use crate::{Args, World, each_seed};
use nalgebra::{Vector3, Vector4};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sim_plant::bench::Bench;
use sinew::config::Config;
use sinew::control::{CURVATURES_MAX, Mode, Request, Settings, Target, TargetInput};
use sinew::model::Arm;
use sinew::posture::RestingArm;
use std::io::Write;
use std::path::Path;

/// Largest bend angle of a segment of a random posture (rad).
const BEND_MAX_RAD: f64 = 1.3;

/// A pose with the posture that it was made from.
pub struct Pose {
    pub position: Vector3<f64>,
    pub quaternion: Vector4<f64>,
    pub curvatures: Vec<f64>,
}

/// The pose of the model's equilibrium at random mean curvatures.
pub fn random(config: &Config, seed: u64) -> Pose {
    let arm = Arm::new(&config.arm);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let u = vec![config.arm.tension_n_min; arm.cable_count()];
    loop {
        let curvatures: Vec<f64> = config
            .arm
            .segments
            .iter()
            .flat_map(|s| {
                // Evenly over the disc of bends.
                let bend = BEND_MAX_RAD * rng.random_range(0.0f64..1.0).sqrt();
                let side = rng.random_range(0.0..std::f64::consts::TAU);
                [bend * side.cos() / s.length_m, bend * side.sin() / s.length_m]
            })
            .collect();
        let mut rest = RestingArm::new(&arm);
        let mut norm = f64::NAN;
        for k in 1..=24 {
            let share = (f64::from(k) / 16.0).min(1.0);
            let wanted: Vec<f64> = curvatures.iter().map(|c| share * c).collect();
            if rest.linearize(&u).is_err() {
                norm = f64::NAN;
                break;
            }
            norm = rest.advance(&wanted);
        }
        if norm < 1e-8 {
            let (position, quaternion) = rest.tip();
            return Pose { position, quaternion, curvatures };
        }
    }
}

/// What a pose showed, all by the true arm (SI).
#[derive(Debug, Clone, Default)]
pub struct Shown {
    pub seed: u64,
    pub path_s: f64,
    pub error: f64,
    pub peak_to_peak: f64,
    pub estimate_error: f64,
    pub speed_max: f64,
    pub tension_max: f64,
    pub saturated: f64,
    pub curvature_error: f64,
    pub reach: f64,
    pub failed: Option<String>,
    pub roughness: f64,
    /// Swing of the first and the last third of the time watched (m), and the growth between them (1/s).
    pub growth: f64,
}

fn target(pose: &Pose, shape: bool) -> TargetInput {
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

pub fn show(bench: &mut Bench, pose: &Pose, shape: bool, watch: f64, trace: Option<&Path>) -> Shown {
    let mut shown = Shown::default();
    bench.target = Some(target(pose, shape));
    let mut trace = trace.map(|p| std::io::BufWriter::new(std::fs::File::create(p).unwrap()));
    let mut request = (bench.cycle.mode() != Mode::Tracking).then_some(Request::Track);
    let begin = bench.time_s();
    let mut tip = bench.truth.tip().position;
    let mut last_u: Vec<f64> = bench.cycle.tensions_n().to_vec();
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let (mut end, mut squares, mut count) = (None, 0.0, 0usize);
    let mut thirds = [(Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)); 3];
    let mut h = 0.0;
    loop {
        let before = bench.time_s();
        let output = bench.step(request.take());
        h = bench.time_s() - before + 0.0 * h;
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
        let state = bench.cycle.estimated_tip();
        let estimate = (bench.cycle.estimated_tip() - now).norm();
        if let Some(file) = &mut trace {
            let r = bench.cycle.governor().reference().to_vec();
            writeln!(
                file,
                "{t:.3},{:.5},{:.5},{:.5},{:.5},{:.5},{:.5},{:.3},{:.3},{:.4},{:?}",
                now[0],
                now[1],
                now[2],
                estimate,
                (state - pose.position).norm(),
                (now - pose.position).norm(),
                last_u.iter().copied().fold(0.0, f64::max),
                bench.cycle.governor().met().distance_min,
                change.sqrt(),
                r
            )
            .unwrap();
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
    shown.peak_to_peak = (high - low).norm();
    let swing = |k: usize| (thirds[k].1 - thirds[k].0).norm();
    shown.growth = (swing(2) / swing(0)).ln() / (watch * 2.0 / 3.0);
    shown.roughness = (squares / count.max(1) as f64).sqrt();
    let k = bench.truth.curvatures();
    shown.curvature_error = k.iter().zip(&pose.curvatures).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    shown.reach = bench.cycle.governor().outcome().map_or(f64::NAN, |o| o.position_m);
    shown.saturated = last_u.iter().filter(|u| **u > 0.999 * bench.truth.config().tension_n_max).count() as f64;
    shown
}

pub fn run(args: &Args, watch: f64, shapes: bool, chain: bool, pose: &[f64], trace: Option<&Path>) {
    println!("seed  path_s  error_mm  p2p_mm  est_mm  vmax  umax  sat  dkappa  reach_mm  rough growth");
    let line = |s: &Shown| {
        println!(
            "{:4} {:7.2} {:8.2} {:7.2} {:7.2} {:6.3} {:5.0} {:3} {:.4} {:6.2} {:.3} {:7.3} {}",
            s.seed,
            s.path_s,
            1e3 * s.error,
            1e3 * s.peak_to_peak,
            1e3 * s.estimate_error,
            s.speed_max,
            s.tension_max,
            s.saturated,
            s.curvature_error,
            1e3 * s.reach,
            s.roughness,
            s.growth,
            s.failed.as_deref().unwrap_or("")
        );
    };
    let make = |seed: u64| {
        let World { config, truth } = args.world(seed);
        let settings = Settings::new(&config);
        let mut bench = Bench::new(&config, &settings, &truth);
        let armed = bench.arm(60.0);
        (config, bench, armed)
    };
    let one = |bench: &mut Bench, config: &Config, seed: u64| {
        let wanted = match pose {
            [x, y, z, w, a, b, c] => Pose {
                position: Vector3::new(*x, *y, *z),
                quaternion: Vector4::new(*w, *a, *b, *c).normalize(),
                curvatures: vec![0.0; 2 * config.arm.segments.len()],
            },
            _ => random(config, seed),
        };
        let mut shown = show(bench, &wanted, shapes, watch, trace);
        shown.seed = seed;
        line(&shown);
        shown
    };
    let all: Vec<Shown> = if chain {
        let (config, mut bench, armed) = make(args.seed);
        armed.expect("armed");
        let mut all = Vec::new();
        for seed in args.seed..args.seed + args.seeds {
            all.push(one(&mut bench, &config, seed));
            if all.last().is_some_and(|s| s.failed.is_some()) {
                break;
            }
        }
        all
    } else {
        each_seed(args, |seed| {
            let (config, mut bench, armed) = make(seed);
            if let Err(why) = armed {
                println!("{seed:4} not armed: {why}");
                return Shown { seed, failed: Some(why), ..Shown::default() };
            }
            one(&mut bench, &config, seed)
        })
    };
    let good: Vec<&Shown> = all.iter().filter(|s| s.failed.is_none()).collect();
    let sorted = |f: &dyn Fn(&Shown) -> f64| {
        let mut v: Vec<f64> = good.iter().map(|s| f(s)).collect();
        v.sort_by(f64::total_cmp);
        v
    };
    let (errors, swings) = (sorted(&|s| s.error), sorted(&|s| s.peak_to_peak));
    if let (Some(e), Some(p)) = (errors.last(), swings.last()) {
        println!(
            "{} of {} without a fault; error median {:.2} worst {:.2} mm; peak to peak median {:.2} worst {:.2} mm; {} of {} within 3 mm",
            good.len(),
            all.len(),
            1e3 * errors[errors.len() / 2],
            1e3 * e,
            1e3 * swings[swings.len() / 2],
            1e3 * p,
            swings.iter().filter(|p| **p < 3e-3).count(),
            all.len()
        );
    }
}
