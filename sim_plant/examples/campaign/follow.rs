//! A scenario in the closed loop, as `sinew demo` runs it, without bus and processes.

use crate::{Args, World, each_seed};
use nalgebra::{Vector3, Vector4};
use sim_plant::bench::{Bench, TipMeter};
use sim_plant::follow::target;
use sinew::collision::{Body, BodyGeometry};
use sinew::config::{BodyModel, ScenarioConfig, Task};
use sinew::control::{Mode, Request, Settings};
use std::io::Write;
use std::path::Path;

/// Time at the start of the task before it is judged (s).
const APPROACH_S: f64 = 20.0;

pub fn run(args: &Args, name: &str, duration: Option<f64>, trace: Option<&Path>) {
    each_seed(args, |seed| {
        let line = one(args, name, duration, trace, seed);
        println!("{seed:4} {line}");
    });
}

fn one(args: &Args, name: &str, duration: Option<f64>, trace: Option<&Path>, seed: u64) -> String {
    let World { mut config, truth } = args.world(seed);
    let scenario = ScenarioConfig::find(name).unwrap_or_else(|error| panic!("{error}"));
    config.planner.avoidance = scenario.planner.avoidance;
    let tip = matches!(scenario.task, Task::Tip { .. });
    let mut bench = match tip {
        true => Bench::at_start_of(&scenario, &config, &truth).expect("a start"),
        false => Bench::new(&config, &Settings::new(&config), &truth),
    };
    bench.tip_sensor = args.tip_sensor.map(TipMeter::tracker);
    bench.insert(&scenario.obstacles).expect("obstacles");
    if let Err(why) = bench.arm(60.0) {
        return format!("not armed: {why}");
    }
    let lookahead = config.planner.lookahead_s;
    let h = config.timing.period_s;
    let nodes = bench.truth.config().node_count() + 1;
    let (mut r, mut t) = (vec![Vector3::zeros(); nodes], vec![Vector3::zeros(); nodes]);
    let geometry = BodyGeometry::from_arm(bench.truth.config());
    let mut body = Body::with_capacity(&geometry, BodyModel::Arm, 0.0, 16);
    let duration = duration.unwrap_or(scenario.duration_s);
    let begin = bench.time_s() + APPROACH_S;
    let mut request = Some(Request::Track);
    let mut trace = trace.map(|p| std::io::BufWriter::new(std::fs::File::create(p).unwrap()));
    let (mut sum, mut count, mut worst, mut least, mut rough) = (0.0, 0usize, (0.0f64, 0.0), (f64::INFINITY, 0.0), 0.0);
    let (mut estimate_worst, mut turn_worst) = (0.0f64, 0.0f64);
    let (mut inside, mut three_sigma) = (0usize, 0.0f64);
    let mut last: Vec<f64> = bench.cycle.tensions_n().to_vec();
    let mut failed = String::new();
    let mut speed = 0.0f64;
    let mut before = bench.truth.tip().position;
    while bench.time_s() < begin + duration {
        let now = bench.time_s() + h - begin;
        bench.place(&scenario.obstacles, now, lookahead).expect("obstacles that were inserted");
        let ahead_s = now + bench.cycle.lead_s();
        bench.target = Some(target(&scenario.task, now, ahead_s));
        // A shape starts with its run: its path is the approach.
        if !tip && now < 0.0 {
            bench.target = None;
            bench.step(None);
            continue;
        }
        let output = bench.step(request.take());
        let tip_now = bench.truth.tip();
        speed = speed.max((tip_now.position - before).norm() / h);
        before = tip_now.position;
        let estimate = (bench.cycle.estimated_tip() - tip_now.position).norm();
        let u = bench.cycle.tensions_n();
        let change = u.iter().zip(&last).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / u.len() as f64;
        last.copy_from_slice(u);
        let mut error = 0.0;
        if let Task::Tip { path, .. } = &scenario.task {
            let (p, q) = path.pose_at(now.max(0.0));
            error = (tip_now.position - Vector3::from(p)).norm();
            let q = Vector4::from(q);
            let turn = (tip_now.quaternion - q).norm().min((tip_now.quaternion + q).norm());
            if now >= 0.0 {
                turn_worst = turn_worst.max(turn);
            }
        }
        bench.truth.frames_into(&mut r, &mut t);
        let measured = body.measure(&r, &t, bench.obstacles.now());
        let distance = measured.along_arm.iter().copied().fold(f64::INFINITY, f64::min);
        if distance < least.0 {
            least = (distance, now);
        }
        if now >= 0.0 {
            sum += error;
            count += 1;
            rough += change;
            estimate_worst = estimate_worst.max(estimate);
            let sigma = bench.cycle.governor().covariance().element_sigma_m().last().copied().unwrap_or(0.0);
            inside += usize::from(estimate <= 3.0 * sigma);
            three_sigma += 3.0 * sigma;
            if error > worst.0 {
                worst = (error, now);
            }
        }
        if let Some(file) = &mut trace {
            let k: Vec<f64> = bench.record().curvature_1pm[..8].to_vec();
            let g = bench.cycle.governor();
            let kk = bench.truth.curvatures();
            let extra: Vec<String> =
                (0..8).map(|i| format!("{:.4},{:.4},{:.4},{:.5}", g.command()[i], k[i], kk[i], g.swing()[i])).collect();
            let mut ref_error = 0.0;
            if let Task::Tip { path, .. } = &scenario.task {
                ref_error = (g.reference_tip() - Vector3::from(path.pose_at(ahead_s.max(0.0)).0)).norm();
            }
            let extra = format!("{ref_error:.5},{},{}", g.met().held_back, g.met().given_up) + "," + &extra.join(",");
            writeln!(
                file,
                "{now:.3},{error:.5},{estimate:.5},{distance:.5},{:.4},{:.4},{:.4},{extra}",
                change.sqrt(),
                (bench.cycle.estimated_tip() - tip_now.position).norm(),
                bench.cycle.governor().met().distance_min
            )
            .unwrap();
        }
        if output.mode != Mode::Tracking {
            let why = bench.cycle.supervisor().latch().first.map(|l| l.fault.to_string());
            failed = format!("{:?} at {now:.2} s: {}", output.mode, why.unwrap_or_default());
            break;
        }
        if let Some(why) = &bench.broken {
            failed = format!("plant {why}");
            break;
        }
    }
    let n = count.max(1) as f64;
    let mut curvature = f64::NAN;
    if let Task::Shape { curvatures_1pm, .. } = &scenario.task {
        curvature = bench.truth.curvatures().iter().zip(curvatures_1pm).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    }
    format!(
        "tip mean {:.2} max {:.2} mm @{:.1}, estimate {:.2} mm ({:.2} % within 3 sigma of {:.1} mm), turn {:.4}, distance {:.2} mm @{:.1}, rough {:.3} N, rate {:.1} N/s, speed {:.3} m/s, curvature {:.4} {failed}",
        1e3 * sum / n,
        1e3 * worst.0,
        worst.1,
        1e3 * estimate_worst,
        100.0 * inside as f64 / n,
        1e3 * three_sigma / n,
        turn_worst,
        1e3 * least.0,
        least.1,
        (rough / n).sqrt(),
        bench.tension_rate_max_nps,
        speed,
        curvature
    )
}
