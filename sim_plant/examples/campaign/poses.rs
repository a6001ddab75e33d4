//! Static poses, one line each.

use crate::{Args, World, each_seed};
use nalgebra::{Vector3, Vector4};
use sim_plant::bench::{Bench, TipMeter};
use sim_plant::poses::{Pose, Shown, random, show};
use sinew::config::Config;
use sinew::control::Settings;
use std::io::{BufWriter, Write};
use std::path::Path;

pub(crate) fn run(args: &Args, watch: f64, shapes: bool, chain: bool, pose: &[f64], trace: Option<&Path>) {
    println!(
        "seed  path_s  error_mm  p2p_mm  est_mm  3sigma within_%  vmax  umax  sat  dkappa  reach_mm  rough rate_nps growth"
    );
    let line = |s: &Shown| {
        println!(
            "{:4} {:7.2} {:8.2} {:7.2} {:7.2} {:7.2} {:8.2} {:6.3} {:5.0} {:3} {:.4} {:6.2} {:.3} {:7.1} {:7.3} {}",
            s.seed,
            s.path_s,
            1e3 * s.error,
            1e3 * s.peak_to_peak,
            1e3 * s.estimate_error,
            1e3 * s.three_sigma,
            100.0 * s.within,
            s.speed_max,
            s.tension_max,
            s.saturated,
            s.curvature_error,
            1e3 * s.reach,
            s.roughness,
            s.tension_rate_max,
            s.growth,
            s.failed.as_deref().unwrap_or("")
        );
    };
    let make = |seed: u64| {
        let World { config, truth } = args.world(seed);
        let settings = Settings::new(&config);
        let mut bench = Bench::new(&config, &settings, &truth);
        bench.tip_sensor = args.tip_sensor.map(TipMeter::tracker);
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
        let mut file = trace.map(|path| BufWriter::new(std::fs::File::create(path).expect("the trace's file")));
        let out = file.as_mut().map(|file| file as &mut dyn Write);
        let mut shown = show(bench, &wanted, shapes, watch, out).expect("the trace");
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
