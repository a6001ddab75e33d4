//! Study of the supervision: drives that lie, and runs in which none does.
//!
//! `cargo run --release -p sim_plant --example lies -- lies` falsifies one cable after another and tells how long after it
//! began to move, or to pull, its drive was named; `-- healthy` moves sound arms whose model is wrong in all ways that are allowed, and
//! tells how near to a finding each came; `-- swing` sets arms swinging and lays what the supervision says beside the truth.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a tool: what fails ends it

use clap::{Parser, ValueEnum};
use nalgebra::{Vector3, Vector4};
use sim_plant::bench::{Bench, Lie};
use sim_plant::poses;
use sim_plant::truth::TruthSettings;
use sinew::config::{Config, ScenarioConfig, SupervisionAnswer, Task};
use sinew::control::supervision::Swing;
use sinew::control::{Fault, Mode, Request, Settings, Target, TargetInput};

#[derive(Parser)]
struct Args {
    what: What,
    /// First seed of the motions.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of seeds.
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// Seconds of motion.
    #[arg(long, default_value_t = 40.0)]
    duration: f64,
    /// This cable alone (from 0).
    #[arg(long)]
    cable: Option<usize>,
    /// Only lies, or healthy arms, whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// Evidence, tick by tick.
    #[arg(long)]
    trace: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    Lies,
    Healthy,
    Swing,
}

/// Seconds at each pose before the next is asked for.
const POSE_S: f64 = 8.0;
/// A cable moves when it is this much longer or shorter than it was (m); a wrong pull is off when it is by this (N).
const MOVED_M: f64 = 0.002;
const OFF_N: f64 = 20.0;

/// What a run showed.
#[derive(Default)]
struct Shown {
    fault: Option<Fault>,
    mode: String,
    /// From the beginning of the cable's motion or pull to the end (s).
    after_s: f64,
    evidence: [f64; 2],
    /// Swing of the true tip and of the estimate (m), largest of each, and least share shown while the true one is beyond 20 mm.
    swing: (f64, f64, f64),
    speed_mps: f64,
    /// Ticks in which the true tip swings by more than 20 mm and nothing says so.
    unsaid: usize,
    said: usize,
}

fn tip_target(position_m: Vector3<f64>, quaternion: Vector4<f64>) -> TargetInput {
    let zero = Vector3::zeros();
    let now = Target::Tip { position_m, quaternion, velocity_mps: zero, angular_velocity_radps: zero };
    TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true }
}

fn run(
    config: &Config,
    truth: &TruthSettings,
    lie: Option<(usize, Lie)>,
    path: Option<&ScenarioConfig>,
    args: &Args,
    seed: u64,
) -> Shown {
    let settings = Settings::new(config);
    let mut bench = Bench::new(config, &settings, truth);
    if let Some((cable, lie)) = lie {
        bench.lies[cable] = lie;
    }
    let mut shown = Shown::default();
    if let Err(why) = bench.arm(60.0) {
        shown.mode = format!("not armed: {why}");
        shown.fault = bench.cycle.supervisor().latch().first.map(|l| l.fault);
        return shown;
    }
    let begin = bench.time_s();
    let home = bench.truth.true_lengths().to_vec();
    let mut moved_at = None;
    let mut request = Some(Request::Track);
    let ahead = (bench.cycle.lead_s() / config.timing.period_s).round() as usize;
    let mut truly = Swing::new(ahead);
    let mut pose = (u64::MAX, None);
    shown.swing.2 = f64::INFINITY;
    while bench.time_s() < begin + args.duration {
        let t = bench.time_s() - begin;
        let target = match path.map(|s| &s.task) {
            Some(Task::Tip { path, .. }) => {
                let (p, q) = path.pose_at((t - 20.0).max(0.0));
                tip_target(p.into(), Vector4::from(q))
            }
            _ => {
                let k = (t / POSE_S) as u64;
                if pose.0 != k {
                    pose = (k, Some(poses::random(config, 1000 * seed + k)));
                }
                let p = pose.1.as_ref().unwrap();
                tip_target(p.position, p.quaternion)
            }
        };
        bench.target = Some(target);
        let output = bench.step(request.take());
        let tip = bench.truth.tip().position;
        let moves = lie.is_some_and(|(cable, lie)| {
            let pulled_in = home[cable] - bench.truth.true_lengths()[cable];
            let off_n = (lie.pull - 1.0).abs() * bench.cycle.tensions_n()[cable];
            match (lie.shows == 1.0, lie.slip == 0.0) {
                (true, true) => off_n > OFF_N,
                (true, false) => pulled_in > MOVED_M,
                _ => pulled_in.abs() > MOVED_M,
            }
        });
        if moved_at.is_none() && moves {
            moved_at = Some(bench.time_s());
        }
        let h = config.timing.period_s;
        let reference = bench.cycle.governor().reference_tip();
        let (true_m, _) = truly.follow(h, &tip, None, &reference);
        let said_m = bench.cycle.supervision().swing_m();
        shown.swing.0 = shown.swing.0.max(true_m);
        shown.swing.1 = shown.swing.1.max(said_m);
        if true_m > 0.02 {
            shown.swing.2 = shown.swing.2.min(said_m / true_m);
            if said_m > config.supervision.swing_m { shown.said += 1 } else { shown.unsaid += 1 }
        }
        let evidence = bench.cycle.supervision().evidence();
        shown.evidence = [0, 1].map(|i| shown.evidence[i].max(evidence[i]));
        let record = bench.record();
        shown.speed_mps = shown.speed_mps.max(Vector3::from(record.tip_velocity_mps).norm());
        if args.trace {
            let beside: Vec<String> = record.disturbance_nm[..8].iter().map(|b| format!("{b:.3}")).collect();
            println!(
                "{t:.2} {:.3} {:.3} true {:.2} said {:.2} mm {}",
                evidence[0],
                evidence[1],
                1e3 * true_m,
                1e3 * said_m,
                beside.join(" ")
            );
        }
        if output.mode == Mode::Faulted {
            shown.fault = bench.cycle.supervisor().latch().first.map(|l| l.fault);
            break;
        }
        if let Some(why) = &bench.broken {
            shown.mode = format!("plant {why}");
            break;
        }
    }
    shown.after_s = moved_at.map_or(f64::NAN, |at| bench.time_s() - at);
    if shown.mode.is_empty() {
        shown.mode = format!("{:?}", bench.cycle.mode());
    }
    shown
}

fn main() {
    let args = Args::parse();
    match args.what {
        What::Lies => lies(&args),
        What::Healthy => healthy(&args, false),
        What::Swing => healthy(&args, true),
    }
}

fn lies(args: &Args) {
    let config = Config::builtin();
    let tip = ScenarioConfig::find("tip").unwrap();
    let kinds = [
        ("backwards", Lie::BACKWARDS),
        ("torque backwards", Lie { pull: 0.0, ..Lie::NONE }),
        ("counts x4", Lie { shows: 4.0, ..Lie::NONE }),
        ("counts /4", Lie { shows: 0.25, ..Lie::NONE }),
        ("slips 50 %", Lie { slip: 0.5, ..Lie::NONE }),
        ("rated torque x2", Lie { pull: 2.0, ..Lie::NONE }),
        ("rated torque /2", Lie { pull: 0.5, ..Lie::NONE }),
        ("gear x2", Lie::gear(2.0)),
        ("gear /2", Lie::gear(0.5)),
    ];
    for (name, lie) in kinds.iter().filter(|(name, _)| name.contains(&args.only)) {
        let (mut named, mut wrongly, mut other, mut never, mut idle, mut times) = (0, 0, 0, 0, 0, Vec::new());
        for seed in args.seed..args.seed + args.seeds {
            let cables: Vec<usize> = args.cable.map_or_else(|| (0..24).step_by(5).collect(), |c| vec![c]);
            for (cable, path) in cables.into_iter().flat_map(|c| [(c, None), (c, Some(&tip))]) {
                let shown = run(&config, &TruthSettings::study(seed), Some((cable, *lie)), path, args, seed);
                let blamed = match shown.fault {
                    Some(Fault::CableLength { cable, .. } | Fault::CablePull { cable, .. }) => Some(usize::from(cable)),
                    _ => None,
                };
                match (blamed, shown.fault) {
                    (Some(c), _) if c == cable => {
                        named += 1;
                        times.push(shown.after_s);
                    }
                    (Some(_), _) => wrongly += 1,
                    (None, Some(_)) => other += 1,
                    // It did nothing by which it could be known.
                    (None, None) if shown.after_s.is_nan() => idle += 1,
                    (None, None) => never += 1,
                }
                if blamed != Some(cable) && !shown.after_s.is_nan() || args.cable.is_some() {
                    let fault = shown.fault.map_or_else(|| shown.mode.clone(), |f| f.to_string());
                    println!(
                        "    seed {seed} cable {cable}: {fault} after {:.2} s, evidence {:.2}",
                        shown.after_s, shown.evidence[1]
                    );
                }
            }
        }
        // Named before it was off by as much.
        times.iter_mut().for_each(|t: &mut f64| *t = if t.is_nan() { 0.0 } else { *t });
        times.sort_by(f64::total_cmp);
        let at =
            |share: f64| times.get((share * (times.len().max(1) - 1) as f64) as usize).copied().unwrap_or(f64::NAN);
        println!(
            "{name:18} named {named}, another cable {wrongly}, another fault {other}, never {never} (idle {idle}); after {:.2} s in the median, {:.2} s at most",
            at(0.5),
            at(1.0)
        );
    }
}

fn healthy(args: &Args, swing: bool) {
    fn study(seed: u64) -> TruthSettings {
        TruthSettings::study(seed)
    }
    let light = |beta: f64| {
        let mut config = Config::builtin();
        config.arm.segments.iter_mut().for_each(|s| s.damping_stiffness_s = beta);
        config
    };
    let friction = |compensation: f64| {
        let mut config = Config::builtin();
        config.friction.coefficient = compensation;
        config
    };
    let latency = || {
        let mut config = Config::builtin();
        config.observer.latency_ticks = 1;
        config
    };
    let gravity = || {
        let mut config = Config::builtin();
        config.arm.gravity_mps2 = [0.0, 0.0, -9.81];
        config
    };
    let swings = || {
        let mut config = Config::builtin();
        config.observer.disturbance_time_s = 0.35;
        config.observer.filter_time_s = 0.4;
        config.governor.swing_damping_1ps = 0.0;
        config.governor.speed_mps *= 3.0;
        config.governor.acceleration_mps2 *= 10.0;
        config
    };
    type Sound = (&'static str, Config, fn(u64) -> TruthSettings);
    let runs: Vec<Sound> = vec![
        ("as shipped", Config::builtin(), study),
        ("friction 0.1, made up 0.05", friction(0.05), |s| TruthSettings { capstan_friction: 0.1, ..study(s) }),
        ("friction 0.1, made up 0.15", friction(0.15), |s| TruthSettings { capstan_friction: 0.1, ..study(s) }),
        ("friction 0.1, none made up", friction(0.0), |s| TruthSettings { capstan_friction: 0.1, ..study(s) }),
        ("EI +5 %", Config::builtin(), |s| TruthSettings { stiffness_factor: 1.05, ..study(s) }),
        ("damping x25", light(0.002), |s| TruthSettings { damping_factor: 25.0, ..study(s) }),
        ("damping /25", Config::builtin(), |s| TruthSettings { damping_factor: 0.04, ..study(s) }),
        ("latency of a tick", latency(), |s| TruthSettings { latency_ticks: 1, ..study(s) }),
        ("gravity", gravity(), study),
        ("gravity, 0.2 kg more", gravity(), |s| TruthSettings { extra_payload_kg: 0.2, ..study(s) }),
        ("swings, damping /25", swings(), |s| TruthSettings { damping_factor: 0.04, ..study(s) }),
        ("swings, damping /100", swings(), |s| TruthSettings { damping_factor: 0.01, ..study(s) }),
    ];
    let tip = ScenarioConfig::find("tip").unwrap();
    for (name, mut config, truth) in runs {
        if !name.contains(&args.only) || swing != name.starts_with("swings") && args.only.is_empty() {
            continue;
        }
        let s = &mut config.supervision;
        (s.cable_answer, s.tip_speed_answer, s.bend_rate_answer) =
            (SupervisionAnswer::Warn, SupervisionAnswer::Warn, SupervisionAnswer::Warn);
        s.swing_answer = SupervisionAnswer::Warn;
        for seed in args.seed..args.seed + args.seeds {
            for path in [None, Some(&tip)] {
                let shown = run(&config, &truth(seed), None, path, args, seed);
                println!(
                    "{name:26} seed {seed} {:5} evidence {:.2} {:.2}, swing {:.1} mm, said {:.1} mm (share {:.2}; {} ticks said, {} not), \
                     speed {:.3} m/s, {} {}",
                    if path.is_some() { "tip" } else { "poses" },
                    shown.evidence[0],
                    shown.evidence[1],
                    1e3 * shown.swing.0,
                    1e3 * shown.swing.1,
                    shown.swing.2,
                    shown.said,
                    shown.unsaid,
                    shown.speed_mps,
                    shown.mode,
                    shown.fault.map_or_else(String::new, |f| f.to_string()),
                );
            }
        }
    }
}
