//! The closed-loop study of design section 6: observers against a plant that differs from their model.
//!
//! `cargo run --release -p sim_plant --example observers -- --scenario tip --seeds 5 --duration 100`
//!
//! Observer, planner in receding use and plant run in one process, without bus and without clock: what is measured is
//! the method, not the machine. Every run is deterministic from its seed.
#![allow(clippy::print_stdout)] // a command that prints its result
#![allow(clippy::unwrap_used, clippy::expect_used)] // a study stops where it cannot go on

mod closed_loop;
mod scenario;
mod settings;
mod table;

use clap::{Parser, ValueEnum};
use closed_loop::{Case, Outcome};
use scenario::ScenarioName;
use settings::Choice;
use sinew::config::WarningBranch;
use std::sync::Mutex;

/// Which branch plans near obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Warning {
    /// Complementarity solution among the swarm's seeds.
    Seeded,
    /// Complementarity alone.
    Complementarity,
    /// Swarm alone.
    Swarm,
}

/// Which observer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Spring and damper in cable space.
    Passive,
}

/// Closed-loop study of the observers.
#[derive(Debug, Clone, Parser)]
struct Arguments {
    #[arg(long, value_enum, default_value = "tip")]
    scenario: ScenarioName,
    /// Seeds 1..=N.
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// Length of the runs along the path (s).
    #[arg(long, default_value_t = 100.0)]
    duration: f64,
    /// Length of the short runs: hold, free, friction, latency, half (s).
    #[arg(long, default_value_t = 30.0)]
    short: f64,
    /// Rows to run.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "hold,free,obstacles,friction,latency,half")]
    rows: Vec<Case>,
    /// Observers to run.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "passive")]
    observers: Vec<Kind>,
    #[arg(long, default_value_t = 0.01)]
    period: f64,
    #[arg(long, default_value_t = 0.1)]
    lookahead: f64,
    #[arg(long, default_value_t = 2)]
    iterations: usize,
    /// Clearance between surfaces (m).
    #[arg(long, default_value_t = 0.01)]
    clearance: f64,
    /// Barrier's gamma per lookahead; 0 for none.
    #[arg(long, default_value_t = 0.3)]
    gamma: f64,
    /// Barrier's activation (m).
    #[arg(long, default_value_t = 0.15)]
    activation: f64,
    #[arg(long, value_enum, default_value = "seeded")]
    warning: Warning,
    /// Distances at the paper's points instead of along the arm.
    #[arg(long)]
    points: bool,
    /// Lead (s); the lag that follows from the weights where absent.
    #[arg(long)]
    lead: Option<f64>,
    #[arg(long, default_value_t = 2.0)]
    stiffness_ratio: f64,
    #[arg(long, default_value_t = 2.0)]
    damping: f64,
    #[arg(long, default_value_t = 0.3)]
    filter: f64,
    #[arg(long, default_value_t = 0.4)]
    disturbance_time: f64,
    /// Largest rate of a tension (N/s).
    #[arg(long)]
    rate_max: Option<f64>,
    #[arg(long, default_value_t = 0.0)]
    mu: f64,
    #[arg(long, default_value_t = 2e-3)]
    mu_speed: f64,
    #[arg(long, default_value_t = 0.05)]
    mu_time: f64,
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Print a line for every run.
    #[arg(long)]
    each: bool,
    /// Write a trace of the run with obstacles (t, tip error, distances, estimate's error) as CSV to this file.
    #[arg(long)]
    trace: Option<std::path::PathBuf>,
}

impl Arguments {
    fn choice(&self) -> Choice {
        Choice {
            scenario: self.scenario,
            duration: self.duration,
            short: self.short,
            period: self.period,
            lookahead: self.lookahead,
            iterations: self.iterations,
            clearance: self.clearance,
            gamma: self.gamma,
            activation: self.activation,
            warning: match self.warning {
                Warning::Seeded => WarningBranch::Seeded,
                Warning::Complementarity => WarningBranch::Complementarity,
                Warning::Swarm => WarningBranch::Swarm,
            },
            points: self.points,
            lead: self.lead,
            stiffness_ratio: self.stiffness_ratio,
            damping: self.damping,
            filter: self.filter,
            disturbance_time: self.disturbance_time,
            rate_max: self.rate_max,
            friction: sinew::config::FrictionConfig { coefficient: self.mu, speed_mps: self.mu_speed, time_s: self.mu_time },
            trace: self.trace.clone(),
        }
    }
}

fn main() {
    let arguments = Arguments::parse();
    let mut jobs = Vec::new();
    for &kind in &arguments.observers {
        for &case in &arguments.rows {
            for seed in arguments.first_seed..arguments.first_seed + arguments.seeds {
                jobs.push((kind, case, seed));
            }
        }
    }
    jobs.reverse();
    let (jobs, done) = (Mutex::new(jobs), Mutex::new(Vec::<(Kind, Case, u64, Outcome)>::new()));
    std::thread::scope(|scope| {
        for _ in 0..arguments.threads.max(1) {
            scope.spawn(|| {
                loop {
                    let Some((kind, case, seed)) = jobs.lock().unwrap().pop() else { return };
                    let outcome = closed_loop::run(&arguments.choice().settings(), case, seed);
                    if arguments.each {
                        println!("{kind:?} {case:?} seed {seed}: {}", outcome.line());
                    }
                    done.lock().unwrap().push((kind, case, seed, outcome));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap();
    done.sort_by_key(|(kind, case, seed, _)| (*kind as u8, *case as u8, *seed));
    table::print(&arguments, &done);
}
