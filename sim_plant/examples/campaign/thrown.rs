//! Balls that fly at the arm, appear beside it or inside it, while it holds. One line each.

use crate::{Args, World, each_seed};
use nalgebra::{Vector3, Vector4};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sim_plant::bench::Bench;
use sinew::collision::{Body, BodyGeometry, Shape};
use sinew::config::{BodyModel, ScenarioConfig, ShapeConfig};
use sinew::control::obstacles::Placement;
use sinew::control::{Mode, Request, Settings, Target, TargetInput};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

/// What the balls do.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Way {
    /// Fly at the arm, through it and away.
    Fly,
    /// Appear beside it and stay.
    Beside,
    /// Appear inside it and stay.
    Inside,
}

/// A campaign's settings.
pub struct Thrown {
    pub way: Way,
    /// Radius (m).
    pub radius: f64,
    /// Speed (m/s) of one that flies, distance (m) of one that appears beside.
    pub amount: f64,
    /// Hold the posture, not the tip.
    pub posture: bool,
    /// From the straight arm, not the paper's start.
    pub straight: bool,
    /// A line per tick on this file.
    pub trace: Option<PathBuf>,
}

/// How far away a ball begins to fly (m).
const FROM_M: f64 = 1.5;

struct Met {
    least: (f64, f64),
    speed: f64,
    tip: f64,
    end: f64,
    touched: f64,
    rate: f64,
    failed: Option<String>,
}

pub fn run(args: &Args, thrown: &Thrown) {
    println!("seed  least_mm at_s  touched_mps  vmax_mps  tip_mm  end_mm  rate_nps");
    let all = each_seed(args, |seed| {
        let met = one(args, thrown, seed);
        println!(
            "{seed:4} {:9.2} {:5.2} {:8.3} {:8.3} {:8.1} {:8.2} {:8.1} {}",
            1e3 * met.least.0,
            met.least.1,
            met.touched,
            met.speed,
            1e3 * met.tip,
            1e3 * met.end,
            met.rate,
            met.failed.as_deref().unwrap_or("")
        );
        met
    });
    let safe = all.iter().filter(|m| m.failed.is_none() && m.least.0 > 0.0).count();
    let fastest = all.iter().map(|m| m.speed).fold(0.0, f64::max);
    let deepest = all.iter().map(|m| m.least.0).fold(f64::INFINITY, f64::min);
    println!(
        "{safe} of {} without contact or fault; least {:.1} mm, fastest {fastest:.3} m/s",
        all.len(),
        1e3 * deepest
    );
}

fn one(args: &Args, thrown: &Thrown, seed: u64) -> Met {
    let World { config, truth } = args.world(seed);
    let mut bench = match thrown.straight {
        true => Bench::new(&config, &Settings::new(&config), &truth),
        false => {
            let scenario = ScenarioConfig::find("tip").expect("built in");
            Bench::at_start_of(&scenario, &config, &truth).expect("the paper's start")
        }
    };
    let mut met =
        Met { least: (f64::INFINITY, 0.0), speed: 0.0, tip: 0.0, end: 0.0, touched: 0.0, rate: 0.0, failed: None };
    if let Err(why) = bench.arm(60.0) {
        met.failed = Some(why);
        return met;
    }
    let h = config.timing.period_s;
    let lookahead = config.planner.lookahead_s;
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let nodes = bench.truth.config().node_count() + 1;
    let (mut r, mut t) = (vec![Vector3::zeros(); nodes], vec![Vector3::zeros(); nodes]);
    bench.truth.frames_into(&mut r, &mut t);
    // A place on the body outside the first third, and a direction across it.
    let place = (nodes as f64 * rng.random_range(0.35..1.0)) as usize;
    let direction = loop {
        let v: Vector3<f64> = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        if v.norm() < 1.0 && v.norm() > 0.1 {
            break v.normalize();
        }
    };
    let across = direction - direction.dot(&t[place]) * t[place];
    let at = r[place];
    let (from, velocity) = match thrown.way {
        Way::Fly => (at - FROM_M * direction, thrown.amount * direction),
        Way::Beside => (at + (thrown.radius + thrown.amount) * across.normalize(), Vector3::zeros()),
        Way::Inside => (at + 0.3 * thrown.radius * across.normalize(), Vector3::zeros()),
    };
    let speed = velocity.norm();
    let duration = if speed > 0.0 { (2.0 * FROM_M / speed).min(60.0) + 10.0 } else { 30.0 };
    let shape = Shape::new(&ShapeConfig::Ball { radius_m: thrown.radius }).expect("a ball");
    let mut body = Body::with_capacity(&BodyGeometry::from_arm(bench.truth.config()), BodyModel::Arm, 0.0, 16);
    let tip = bench.truth.tip();
    if !thrown.posture {
        let position_m = bench.cycle.estimated_tip();
        let record = bench.record();
        let quaternion = Vector4::from(record.tip_quaternion);
        let now = Target::Tip {
            position_m,
            quaternion,
            velocity_mps: Vector3::zeros(),
            angular_velocity_radps: Vector3::zeros(),
        };
        bench.target = Some(TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true });
    }
    let mut request = (!thrown.posture).then_some(Request::Track);
    let begin = bench.time_s();
    let mut before = r.clone();
    let mut inside = false;
    let mut met_now = f64::INFINITY;
    let mut trace = thrown.trace.as_ref().map(|p| BufWriter::new(File::create(p).expect("the trace's file")));
    for k in 0..(duration / h) as usize {
        let now = bench.time_s() + h - begin;
        // One that appears does so once the arm has been still for a second.
        if k == if speed > 0.0 { 0 } else { (1.0 / h) as usize } {
            bench.obstacles.insert(1, &shape).expect("a ball");
        }
        if !bench.obstacles.now().is_empty() {
            let placement = Placement {
                position_now_m: (from + now * velocity).into(),
                position_ahead_m: (from + (now + lookahead) * velocity).into(),
                quaternion: [1.0, 0.0, 0.0, 0.0],
                growth_m: 0.0,
            };
            bench.obstacles.place(0, &placement).expect("placed");
        }
        let output = bench.step(request.take());
        bench.truth.frames_into(&mut r, &mut t);
        for (a, b) in r.iter().zip(&before) {
            met.speed = met.speed.max((a - b).norm() / h);
        }
        let ball = from + now * velocity;
        if !bench.obstacles.now().is_empty() {
            let measured = body.measure(&r, &t, bench.obstacles.now());
            let distance = measured.along_arm.first().copied().unwrap_or(f64::INFINITY);
            met_now = distance;
            if distance < met.least.0 {
                met.least = (distance, now);
            }
            if distance < 0.0 && !inside {
                inside = true;
                // How fast they meet.
                let nearest =
                    (0..nodes).min_by(|a, b| (r[*a] - ball).norm().total_cmp(&(r[*b] - ball).norm())).unwrap_or(0);
                met.touched = ((r[nearest] - before[nearest]) / h - velocity).norm();
            }
        }
        if let Some(file) = &mut trace {
            let branch = bench.record().plan.map(|p| p.branch);
            let g = bench.cycle.governor();
            let fastest = r.iter().zip(&before).map(|(a, b)| (a - b).norm() / h).fold(0.0, f64::max);
            let numbers = |v: &[f64]| v.iter().map(|x| format!("{x:.3}")).collect::<Vec<_>>().join(" ");
            let reference = (g.reference_tip() - tip.position).norm();
            let (met, u) = (*g.met(), bench.cycle.tensions_n());
            writeln!(
                file,
                "{now:.2} v {fastest:.3} tip {:.4} ref {reference:.4} d {:.4} rd {:.4} held {} given {} load {:.2} {branch:?} | {} | {} | {}",
                (bench.truth.tip().position - tip.position).norm(),
                met_now,
                met.distance_min,
                met.held_back,
                met.given_up,
                met.load_max,
                numbers(g.reference()),
                numbers(&bench.truth.curvatures()),
                numbers(u),
            )
            .expect("the trace");
        }
        before.copy_from_slice(&r);
        let off = (bench.truth.tip().position - tip.position).norm();
        met.tip = met.tip.max(off);
        met.end = off;
        if !matches!(output.mode, Mode::Tracking | Mode::Holding) {
            let why = bench.cycle.supervisor().latch().first.map(|l| l.fault.to_string());
            met.failed = Some(format!("{:?} at {now:.2} s: {}", output.mode, why.unwrap_or_default()));
            break;
        }
        if let Some(why) = &bench.broken {
            met.failed = Some(format!("plant {why}"));
            break;
        }
    }
    met.rate = bench.tension_rate_max_nps;
    met
}
