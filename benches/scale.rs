//! Cost over the arm's size and its surroundings: nodes 5 to 200, cables 6 to 96, obstacles 0 to 256.
//!
//! Medians of repeated runs. Over nodes (24 cables) every part is linear: the tangent is block-tridiagonal, its factor
//! takes one pass from base to tip. Over cables the panel `S^-1 B` is nodes x cables, the reduced problem cables^2 and
//! its Newton cables^3, all inherent: every tension moves every node, and the reduced Hessian is dense. Over obstacles
//! the search is linear in those near enough that a bounding ball does not dismiss them, and what is planned with is
//! bounded by the pairs that are kept.
//!
//! `cargo bench --bench scale` (about half a minute after building) writes `benches/results/scale-nodes.svg`,
//! `scale-cables.svg`, `scale-obstacles.svg` and `scale.csv`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a bench may panic and print

#[path = "plot/mod.rs"]
mod plot;
mod scene;

use nalgebra::Vector3;
use plot::Line;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::ObstacleSet;
use sinew::config::{ArmConfig, BodyModel, Config, WarningBranch};
use sinew::estimator::Observer;
use sinew::integrator::{AffineMap, Scheme, Stepper};
use sinew::model::{Arm, Motion, State};
use sinew::planner::{Inputs, Planner};
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Segments with their elements and cables.
fn arm_config(elements: &[usize], cables: usize) -> ArmConfig {
    let mut config = ArmConfig::paper();
    let mut segment = config.segments[0].clone();
    segment.length_m = 2.6 / elements.len() as f64;
    let step = std::f64::consts::TAU / cables as f64;
    segment.hole_angles_rad = (0..cables).map(|c| step * (c as f64 + 0.5)).collect();
    config.segments = elements
        .iter()
        .map(|n| {
            let mut segment = segment.clone();
            segment.elements = *n;
            segment
        })
        .collect();
    config.segments[elements.len() - 1].connector_length_m = 0.0;
    config
}

/// `nodes` over four segments, as evenly as it goes.
fn over_four(nodes: usize) -> [usize; 4] {
    std::array::from_fn(|s| (nodes + s) / 4)
}

/// Median time (us) of one call, over runs for about 60 ms.
fn time(mut f: impl FnMut()) -> f64 {
    f();
    let until = Instant::now() + Duration::from_millis(60);
    let mut times = Vec::new();
    while times.len() < 5 || Instant::now() < until {
        let begin = Instant::now();
        f();
        times.push(begin.elapsed().as_nanos() as f64 / 1e3);
    }
    times.sort_unstable_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Parts that are timed for every arm.
const PARTS: [&str; 5] = ["assembly", "factorisation", "panel", "observer update", "safe plan (two iterations)"];

fn parts(config: &ArmConfig) -> [f64; 5] {
    let arm = Arm::new(config);
    let bend: Vec<f64> = (0..2 * arm.segment_count()).map(|k| 0.4 * (k as f64 * 1.3).sin()).collect();
    let state = State::at_rest(arm.bent(&bend));
    let u: Vec<f64> = (0..arm.cable_count()).map(|c| 10.0 + 5.0 * (c as f64 * 0.9).sin()).collect();
    let rates = Scheme::new(config.rho_inf).rates(0.1);
    let (mut stepper, mut map) = (Stepper::new(&arm), AffineMap::new(&arm));
    stepper.linearize(&arm, &Motion::from(&state), &u, rates).unwrap();
    let assembly = time(|| arm.linearize(black_box(&Motion::from(&state)), &u, rates, &mut stepper.linearization));
    let factor = time(|| stepper.factor.factor(black_box(&stepper.linearization.tangent)).unwrap());
    let panel = time(|| stepper.affine_map_into(&arm, black_box(&mut map)));
    let mut lengths = vec![0.0; arm.cable_count()];
    arm.cable_lengths_into(&state.q, &mut lengths);
    let mut observer = Observer::new(config, &Config::builtin().observer, 0.01);
    observer.resume(&state);
    let observe = time(|| {
        black_box(observer.update(&u, &lengths));
    });
    let plan = plan_time(config, &state, &u, &ObstacleSet::new());
    [assembly, factor, panel, observe, plan]
}

fn plan_time(config: &ArmConfig, state: &State, u: &[f64], obstacles: &ObstacleSet) -> f64 {
    let arm = Arm::new(config);
    let mut settings = scene::receding(WarningBranch::Seeded);
    settings.swarm.sweeps_max = 3;
    let mut planner = Planner::new(config, &settings, 1.0, &vec![1e4; arm.segment_count()]);
    let goal = scene::goal(&arm, state);
    let inputs =
        Inputs { state, u_previous: u, disturbance: &[], led_to: None, goal, now: obstacles, ahead: obstacles };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    time(|| {
        planner.forget();
        black_box(planner.plan(black_box(&inputs), &mut rng, &mut || false));
    })
}

/// Slope of a line in the logarithmic chart from `from` on: 1 where cost is proportional.
fn exponent(points: &[(f64, f64)], from: f64) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().filter(|p| p.0 >= from).map(|p| (p.0.ln(), p.1.ln())).collect();
    let n = logs.len() as f64;
    let (x, y) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>() / logs.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>()
}

fn sweep(what: &str, sizes: &[(usize, ArmConfig)], rows: &mut Vec<String>) {
    let mut lines: Vec<Line> = PARTS.iter().map(|p| Line { name: (*p).to_owned(), points: Vec::new() }).collect();
    for (size, config) in sizes {
        let times = parts(config);
        for ((line, part), t) in lines.iter_mut().zip(PARTS).zip(times) {
            line.points.push((*size as f64, t));
            rows.push(format!("{what},{size},{part},{t:.2}"));
        }
    }
    for line in &mut lines {
        let power = exponent(&line.points, 20.0);
        println!(
            "{what:8} {:28} {:8.1} .. {:8.1} us, grows as {what}^{power:.2}",
            line.name,
            line.points[0].1,
            line.points[line.points.len() - 1].1
        );
        line.name = format!("{} (^{power:.2})", line.name);
    }
    let title = format!("Time over {what} (exponent from 20 on in brackets)");
    plot::chart(&format!("scale-{what}.svg"), &title, what, "median time (us)", &lines).unwrap();
}

fn main() {
    let machine = plot::machine().unwrap();
    let mut rows = Vec::new();
    let nodes: Vec<(usize, ArmConfig)> =
        [5, 10, 20, 40, 60, 100, 140, 200].iter().map(|&n| (n, arm_config(&over_four(n), 6))).collect();
    sweep("nodes", &nodes, &mut rows);
    // 24 nodes each.
    let cables: Vec<(usize, ArmConfig)> = [(2, 3), (4, 3), (4, 6), (8, 6), (8, 9), (8, 12)]
        .iter()
        .map(|&(segments, each)| (segments * each, arm_config(&vec![24 / segments; segments], each)))
        .collect();
    sweep("cables", &cables, &mut rows);

    let config = ArmConfig::paper();
    let arm = Arm::new(&config);
    let state = State::at_rest(arm.bent(&[0.3, 0.2, -0.2, 0.1, 0.2, -0.3, 0.1, 0.2]));
    let u = vec![10.0; arm.cable_count()];
    let mut lines = [
        Line { name: "plan (two iterations, three sweeps each)".to_owned(), points: Vec::new() },
        Line { name: "search for pairs".to_owned(), points: Vec::new() },
    ];
    let geometry = sinew::collision::BodyGeometry::from_arm(&config);
    let mut body = sinew::collision::Body::new(&geometry, BodyModel::Arm, 0.0);
    let (mut r, mut t) = (vec![Vector3::zeros(); arm.node_count() + 1], vec![Vector3::zeros(); arm.node_count() + 1]);
    arm.frames_into(&state.q, &mut r, &mut t);
    for count in [0usize, 1, 2, 4, 8, 16, 32, 64, 128, 256] {
        // The first two within the warning distance, each further one 1 cm farther away.
        let gap_m = |k: usize| if k < 2 { 0.03 } else { 0.03 + 0.01 * k as f64 };
        let set = scene::balls(&arm, &state, count, gap_m);
        let plan = plan_time(&config, &state, &u, &set);
        let search = time(|| {
            black_box(body.find(&r, &t, black_box(&set), 0.215).minimum);
        });
        let pairs = body.found().rows.len();
        println!("obstacles {count:4}: plan {plan:8.1} us, search {search:7.2} us, {pairs} pairs within reach");
        rows.push(format!("obstacles,{count},plan,{plan:.2}"));
        rows.push(format!("obstacles,{count},search,{search:.2}"));
        // No place for zero on a logarithmic axis: it stands at one half.
        let x = if count == 0 { 0.5 } else { count as f64 };
        lines[0].points.push((x, plan));
        lines[1].points.push((x, search));
    }
    plot::chart("scale-obstacles.svg", "Time over obstacles (none at 0.5)", "obstacles", "median time (us)", &lines)
        .unwrap();
    plot::write_csv("scale.csv", &machine, "sweep,size,part,median_us", &rows).unwrap();
}
