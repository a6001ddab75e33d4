//! The closed-loop study of design section 6: observers against a plant that differs from their model.
//!
//! `cargo run --release -p sim_plant --example observers -- --scenario tip --seeds 5`
//!
//! What it printed, and beside what, is in `README.md` of this folder.
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
    /// The model alone, no measurement and no lead: what an observer has to be better than.
    OpenLoop,
    /// Spring and damper in cable space, with the gains of the command line (the shipped ones by default).
    Passive,
    /// The same with K = EI/L and T_b = 2 s.
    Slow,
    /// The same with K = 3 EI/L and T_b = 1 s.
    Fast,
}

impl Kind {
    fn title(self, arguments: &Arguments) -> String {
        let passive = |k: f64, t: f64| format!("passive, K = {k} EI/L, T_b = {t} s");
        match self {
            Self::OpenLoop => "open loop, no lead".into(),
            Self::Passive => passive(arguments.stiffness_ratio, arguments.disturbance_time),
            Self::Slow => passive(1.0, 2.0),
            Self::Fast => passive(3.0, 1.0),
        }
    }
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
    /// Length of the short runs: hold, free, latency (s).
    #[arg(long, default_value_t = 30.0)]
    short: f64,
    /// Rows to run.
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "hold,free,obstacles,wide,friction,compensated,latency,half"
    )]
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
    /// Clearance between surfaces (m) of the row `obstacles`; `wide` has 10 mm, as the demo.
    #[arg(long, default_value_t = 0.005)]
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
    /// Friction coefficient that the controller makes up for in the row `compensated`; the plant's is 0.1.
    #[arg(long, default_value_t = 0.1)]
    compensation: f64,
    /// Ticks of latency of the row `latency`, compensated.
    #[arg(long, default_value_t = 1)]
    latency: usize,
    /// Runs at a time.
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Print a line for every run.
    #[arg(long)]
    each: bool,
    /// Write a trace (t, tip error, distance, estimate's error, |z|, warning, relaxed, change, KKT residual) as CSV to this
    /// file; meant for one row with one seed.
    #[arg(long)]
    trace: Option<std::path::PathBuf>,
}

impl Arguments {
    fn choice(&self, kind: Kind) -> Choice {
        let (stiffness_ratio, disturbance_time) = match kind {
            Kind::OpenLoop | Kind::Passive => (self.stiffness_ratio, self.disturbance_time),
            Kind::Slow => (1.0, 2.0),
            Kind::Fast => (3.0, 1.0),
        };
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
            lead: if kind == Kind::OpenLoop { Some(0.0) } else { self.lead },
            open_loop: kind == Kind::OpenLoop,
            stiffness_ratio,
            damping: self.damping,
            filter: self.filter,
            disturbance_time,
            rate_max: self.rate_max,
            compensation: self.compensation,
            latency: self.latency,
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
    let (count, begin) = (jobs.len(), std::time::Instant::now());
    let (jobs, done) = (Mutex::new(jobs), Mutex::new(Vec::<(Kind, Case, u64, Outcome)>::new()));
    std::thread::scope(|scope| {
        for _ in 0..arguments.threads.max(1) {
            scope.spawn(|| {
                loop {
                    let Some((kind, case, seed)) = jobs.lock().unwrap().pop() else { return };
                    let outcome = closed_loop::run(&arguments.choice(kind).settings(), case, seed);
                    if arguments.each {
                        println!("{kind:?} {case:?} seed {seed}: {}", outcome.line());
                    }
                    let mut done = done.lock().unwrap();
                    done.push((kind, case, seed, outcome));
                    let spent = begin.elapsed().as_secs_f64();
                    eprintln!("{:3} of {count} runs, {spent:.0} s: {kind:?} {case:?}, seed {seed}", done.len());
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap();
    done.sort_by_key(|(kind, case, seed, _)| (*kind as u8, *case as u8, *seed));
    table::print(&arguments, &done);
}
