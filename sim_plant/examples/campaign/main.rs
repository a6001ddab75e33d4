//! Campaigns of the closed loop, judged by the true arm: static poses, shapes, and the paper's examples.
//!
//! `cargo run --release -p sim_plant --example campaign -- --help`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a tool: what fails ends it

mod arms;
mod follow;
mod poses;
mod stops;
mod thrown;

use clap::{Parser, Subcommand};
use sim_plant::truth::TruthSettings;
use sinew::config::{BUILTIN_FILES, Config, ObserverConfig};
use std::path::PathBuf;

#[derive(Parser)]
struct Args {
    #[command(subcommand)]
    what: What,
    /// Configuration files in place of the built-in ones.
    #[arg(long, global = true, num_args = 1..)]
    config: Vec<PathBuf>,
    /// Period of the loop (s).
    #[arg(long, global = true)]
    period: Option<f64>,
    /// Damping beta of the arm (s), in place of the file's.
    #[arg(long, global = true)]
    beta: Option<f64>,
    /// Damping of the true arm over the model's.
    #[arg(long, global = true)]
    damping: Option<f64>,
    /// Friction coefficient of the true cables.
    #[arg(long, global = true, default_value_t = 0.0)]
    friction: f64,
    /// Friction coefficient that the controller makes up for.
    #[arg(long, global = true, default_value_t = 0.0)]
    compensation: f64,
    /// Latency of the true arm in ticks, and what the controller is told.
    #[arg(long, global = true, default_value_t = 0)]
    latency: usize,
    /// A sensor of the tip with this standard deviation (m): 50 measurements a second, 30 ms old.
    #[arg(long, global = true)]
    tip_sensor: Option<f64>,
    /// Settings to change, for studies: `tb=1.0`, ...
    #[arg(long, global = true)]
    set: Vec<String>,
    /// First seed.
    #[arg(long, global = true, default_value_t = 1)]
    seed: u64,
    /// Number of seeds.
    #[arg(long, global = true, default_value_t = 1)]
    seeds: u64,
    /// Processes at once.
    #[arg(long, global = true, default_value_t = 1)]
    jobs: usize,
}

#[derive(Subcommand)]
enum What {
    /// Random poses of the tip, each from rest by a step of the target.
    Poses {
        /// Seconds watched after the path's end.
        #[arg(long, default_value_t = 15.0)]
        watch: f64,
        /// Shapes in place of tip poses.
        #[arg(long)]
        shapes: bool,
        /// Each pose from the one before, not from the straight arm.
        #[arg(long)]
        chain: bool,
        /// This pose (position, quaternion) alone.
        #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
        pose: Vec<f64>,
        /// A line per tick of the true arm on this file.
        #[arg(long)]
        trace: Option<PathBuf>,
    },
    /// The paper's examples.
    Follow {
        /// Built-in scenario or file.
        scenario: String,
        /// Length of the run (s), in place of the scenario's.
        #[arg(long)]
        duration: Option<f64>,
        /// A line per tick on this file.
        #[arg(long)]
        trace: Option<PathBuf>,
    },
    /// A scenario that is stopped or cut off at seeded instants: one line each, and one for all.
    Stops {
        /// Built-in scenario or file.
        scenario: String,
        /// `stop`, `sigterm`, `kill` (the daemon is dead), `bus` (one of four, or all), `fault` (a drive trips, an encoder is
        /// silent or jumps, ticks are late).
        #[arg(long, value_delimiter = ',', default_value = "stop,sigterm,kill,bus,fault",
            value_parser = ["stop", "sigterm", "kill", "bus", "fault"])]
        kinds: Vec<String>,
        /// Gravity (m/s^2) along -z, known to the controller, in place of the arm's.
        #[arg(long)]
        gravity: Option<f64>,
        /// `safe_hold` of all drives, in place of the configuration's.
        #[arg(long, value_parser = ["hold", "rest", "ramp", "brake"])]
        hold: Option<String>,
        /// Latest instant (s), in place of the scenario's length.
        #[arg(long)]
        duration: Option<f64>,
        /// A line per tick from the end on, of the last run, to this file.
        #[arg(long)]
        trace: Option<PathBuf>,
    },
    /// Balls at an arm that holds.
    Thrown {
        /// What they do.
        way: thrown::Way,
        /// Radius (m).
        #[arg(long, default_value_t = 0.1)]
        radius: f64,
        /// Speed (m/s) of one that flies, distance (m) of one that appears beside the arm.
        #[arg(long, default_value_t = 0.03)]
        amount: f64,
        /// Hold the posture, not the tip.
        #[arg(long)]
        posture: bool,
        /// From the straight arm, not the paper's start.
        #[arg(long)]
        straight: bool,
        /// A line per tick on this file.
        #[arg(long)]
        trace: Option<PathBuf>,
    },
    /// Scenarios with arms of their own, by the defaults that each arm's file gives: one line each, in % of the length.
    Arms {
        /// Scenario files.
        #[arg(required = true)]
        scenarios: Vec<PathBuf>,
        /// Each with arm and scene so many times as large.
        #[arg(long, value_delimiter = ',', default_value = "1")]
        scales: Vec<f64>,
        /// Length of the run (s), in place of the scenario's.
        #[arg(long)]
        duration: Option<f64>,
        /// A line per tick on this file.
        #[arg(long)]
        trace: Option<PathBuf>,
    },
}

/// What a run starts from.
pub(crate) struct World {
    pub(crate) config: Config,
    pub(crate) truth: TruthSettings,
}

impl Args {
    fn world(&self, seed: u64) -> World {
        let config = if self.config.is_empty() {
            Config::builtin()
        } else {
            let mut files = self.config.clone();
            files.dedup();
            Config::load(&files).unwrap_or_else(|error| panic!("{error}"))
        };
        self.adapted(config, seed)
    }

    /// The same with a configuration given.
    fn adapted(&self, mut config: Config, seed: u64) -> World {
        if let Some(period) = self.period {
            config.timing.period_s = period;
            config.planner.period_s = period;
        }
        if let Some(beta) = self.beta {
            config.arm.segments.iter_mut().for_each(|s| s.damping_stiffness_s = beta);
            config.observer.model_damping_ratio = ObserverConfig::default_model_damping_ratio(&config.arm);
        }
        config.friction.coefficient = self.compensation;
        config.observer.latency_ticks = self.latency;
        let mut truth = TruthSettings::study(seed);
        truth.step_s = truth.step_s.min(config.timing.period_s);
        truth.capstan_friction = self.friction;
        truth.latency_ticks = self.latency;
        for pair in &self.set {
            let (key, value) = pair.split_once('=').expect("--set key=value");
            let value: f64 = value.parse().expect("a number");
            match key {
                "tb" => config.observer.disturbance_time_s = value,
                "k" => config.observer.stiffness_ratio = value,
                "d" => config.observer.damping_s = value,
                "tauf" => config.observer.filter_time_s = value,
                "mdr" => config.observer.model_damping_ratio = value,
                "rate" => config.weights.tip.rate = value,
                "pose" => config.weights.tip.pose = value,
                "eta" => config.planner.lookahead_s = value,
                "lead" => config.planner.lead_s = Some(value),
                "its" => config.planner.newton_iterations_max = value as usize,
                "evasion" => config.governor.evasion_mps = value,
                "evasion2" => config.governor.evasion_mps2 = value,
                "approach" => config.governor.approach_1ps = value,
                "w" => config.weights.tip.tension_change.iter_mut().flatten().for_each(|w| *w *= value),
                "c" => config.weights.tip.change_ratio = value,
                "ra" => config.weights.tip.rate = value * config.weights.tip.pose * config.planner.lookahead_s.powi(2),
                "swing" => config.governor.swing_damping_1ps = value,
                "speed" => config.governor.speed_mps = value * config.arm.length_m(),
                "mesh" => truth.mesh_refinement = value as usize,
                "ei" => truth.stiffness_factor = value,
                "te" => truth.tension_error_max = value,
                "mass" => truth.disk_mass_factor = value,
                "enc" => truth.encoder_step_m = value,
                _ => panic!("no key {key}"),
            }
        }
        if let Some(damping) = self.damping {
            truth.damping_factor = damping;
        }
        World { config, truth }
    }
}

fn main() {
    let args = Args::parse();
    assert!(BUILTIN_FILES.len() > 1);
    match &args.what {
        What::Poses { watch, shapes, chain, pose, trace } => {
            poses::run(&args, *watch, *shapes, *chain, pose, trace.as_deref());
        }
        What::Thrown { way, radius, amount, posture, straight, trace } => {
            let (way, radius, amount, posture, straight) = (*way, *radius, *amount, *posture, *straight);
            thrown::run(&args, &thrown::Thrown { way, radius, amount, posture, straight, trace: trace.clone() });
        }
        What::Follow { scenario, duration, trace } => {
            follow::run(&args, scenario, *duration, trace.as_deref());
        }
        What::Stops { scenario, kinds, gravity, hold, duration, trace } => {
            let (gravity, hold, duration_s) = (*gravity, hold.as_deref(), *duration);
            stops::run(&args, &stops::Stops { scenario, kinds, gravity, hold, duration_s, trace: trace.as_deref() });
        }
        What::Arms { scenarios, scales, duration, trace } => {
            arms::run(&args, scenarios, scales, *duration, trace.as_deref());
        }
    }
}

/// Runs `work` for every seed on `jobs` threads; results in the order of seeds, printed as they come.
pub(crate) fn each_seed<T: Send>(args: &Args, work: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let next = std::sync::atomic::AtomicU64::new(0);
    let results = std::sync::Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..args.jobs.max(1) {
            scope.spawn(|| {
                loop {
                    let k = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if k >= args.seeds {
                        break;
                    }
                    let result = work(args.seed + k);
                    results.lock().unwrap().push((k, result));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap();
    results.sort_by_key(|(k, _)| *k);
    results.into_iter().map(|(_, r)| r).collect()
}
