//! Commands of `sinew`; each file is one.

mod arm_info;
mod check;
mod client;
mod demo;
mod leash;
pub(crate) mod log;
mod obstacles;
mod plan;
mod record;
mod report;
mod requests;
mod run;
mod scenario_client;
mod stability;
mod status;
mod view;

use clap::{Parser, Subcommand};
use miette::{IntoDiagnostic, WrapErr};
use serde::Serialize;
use sinew::daemon::operator::Word;
use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

/// What scripts go by; src/report/SCRIPTS.md tells more.
const ENDINGS: &str = "\
Exit codes:
  0  done
  1  the run ended in a fault, in contact or before its time; not stable;
     the daemon refused, has a fault latched or is not there
  2  unusable arguments, configuration or files, or a part that broke
 70  a defect of the daemon, which a service manager may start over
`plan` ends with 0 wherever the arm is without avoidance (tip-no-avoidance,
shape-no-avoidance) and in a series (penalty-sweep, swarm-comparison).

Environment:
  SINEW_LOG  what is logged to standard error: error, warn (default), info,
             debug, trace, or by module: sinew::daemon=debug";

/// Real-time controller service for cable-driven multisegment continuum arms.
#[derive(Debug, Parser)]
#[command(name = "sinew", version, about, after_help = ENDINGS)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plan a scenario in open loop, as in the paper: the model is the arm, one step per lookahead.
    Plan(plan::Plan),
    /// Read a configuration, refuse whatever can be refused, and show what it means.
    Check(check::Check),
    /// Show an arm by its file alone: mass, sag, modes, what its cables can bend, and every setting computed from it.
    ArmInfo(arm_info::ArmInfo),
    /// Show whether the closed loop is stable where it holds the arm, in which modes it moves, and its margins.
    Stability(stability::Stability),
    /// Run the daemon of an arm.
    Run(run::Run),
    /// Show a running daemon: mode, faults, times, buses, sources, rights.
    Status(status::Status),
    /// Show a running arm, or a recording, in a browser: in 3D, with plots, alarms and sources. It reads only.
    View(view::View),
    /// Bring the drives up and hold the pose.
    Arm(requests::Ask),
    /// Take the torque off the drives at once, in order.
    Disarm(requests::Ask),
    /// Hold the present pose.
    Hold(requests::Ask),
    /// Follow the target.
    Track(requests::Ask),
    /// Ramp the tensions down, then disarm.
    Stop(requests::Ask),
    /// Press the operator's emergency stop: the arm stops, and may not be armed until it is released.
    ///
    /// It is a state of the daemon and no safety function: it needs the daemon, its processor and the bus.
    EmergencyStop(requests::EmergencyStop),
    /// Release a latched fault whose cause is gone; forget sources of obstacles that have expired.
    ///
    /// A source that expired holds the arm until it is back. One that is gone for good is forgotten by this request in every
    /// mode, also where it is refused because no fault is latched; its obstacles are then no longer avoided.
    Clear(requests::Ask),
    /// Go to the home pose.
    Home(requests::Ask),
    /// Move at a share of the configured speed, 1% to 100%.
    ///
    /// It counts on every way to a target and back, smoothly from where the arm is. Giving way to obstacles, and a stop, keep
    /// their own speed. It is kept until another is given; whenever the arm is disarmed it is 100% again.
    Speed(requests::Speed),
    /// Give one target, which is kept until another comes.
    Target(requests::TargetArguments),
    /// Inject an obstacle by hand, or list those that the loop knows.
    Obstacles(obstacles::ObstaclesArguments),
    /// Run a scenario in closed loop against the simulated plant, every part a process of its own.
    Demo(demo::Demo),
    /// Report a recording as a page: what was asked, what happened and why, plots, statistics, the configuration.
    Report(report::Report),
    /// Tell in words what an arm did at a time of a recording, and why.
    Explain(report::Explain),
    /// A scenario's obstacles or task, as a client of a running daemon.
    #[command(hide = true)]
    Client(scenario_client::Client),
    /// Run a program that ends when its parent ends.
    #[command(hide = true)]
    Leash(leash::Leash),
}

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done.
    Done,
    /// The run ended in a fault or contact.
    Failed,
    /// Unusable arguments or configuration.
    Unusable,
    /// A defect of this program ended it.
    Defect,
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::from(0),
            Outcome::Failed => Self::from(1),
            Outcome::Unusable => Self::from(2),
            // EX_SOFTWARE of sysexits.
            Outcome::Defect => Self::from(70),
        }
    }
}

/// Runs a command.
pub(crate) fn run(arguments: Arguments) -> miette::Result<Outcome> {
    match arguments.command {
        Command::Plan(plan) => plan.run(),
        Command::Check(check) => check.run(),
        Command::ArmInfo(info) => info.run(),
        Command::Stability(stability) => stability.run(),
        Command::Demo(demo) => demo.run(),
        Command::Report(report) => report.run(),
        Command::Explain(explain) => explain.run(),
        Command::Client(client) => client.run(),
        Command::Leash(leash) => leash.run(),
        Command::Run(run) => run.run(),
        Command::Status(status) => status.run(),
        Command::View(view) => view.run(),
        Command::Arm(ask) => ask.run(Word::Arm),
        Command::Disarm(ask) => ask.run(Word::Disarm),
        Command::Hold(ask) => ask.run(Word::Hold),
        Command::Track(ask) => ask.run(Word::Track),
        Command::Stop(ask) => ask.run(Word::Stop),
        Command::EmergencyStop(stop) => stop.run(),
        Command::Clear(ask) => ask.run(Word::Clear),
        Command::Home(ask) => ask.run(Word::Home),
        Command::Speed(speed) => speed.run(),
        Command::Target(target) => target.run(),
        Command::Obstacles(obstacles) => obstacles.run(),
    }
}

/// A bar on standard error, silent where that is not a terminal.
pub(crate) fn progress_bar(length: u64, what: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}")
        .unwrap_or_else(|_| indicatif::ProgressStyle::default_bar());
    indicatif::ProgressBar::new(length).with_style(style).with_message(what.to_owned())
}

/// A duration above zero, as an argument.
pub(crate) fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds.is_finite() && seconds > 0.0 && seconds < 1e9 => Ok(seconds),
        _ => Err("expected a time above 0 s and below 1e9 s".to_owned()),
    }
}

/// Writes to standard output. A reader that has gone (`| head`) is no error.
pub(crate) fn print_text(text: &str) -> miette::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).into_diagnostic().wrap_err("standard output"),
        _ => Ok(()),
    }
}

/// Writes one JSON object to standard output.
pub(crate) fn print_json<T: Serialize>(value: &T) -> miette::Result<()> {
    print_text(&format!("{}\n", serde_json::to_string_pretty(value).into_diagnostic()?))
}

/// Writes a line to standard error, in order with the log and whatever its level; where it is closed there is nobody left
/// to tell.
pub(crate) fn complain(line: impl Display) {
    // As one piece: the log's queue takes every piece for a line.
    let _ = log::writer().write_all(format!("{line}\n").as_bytes());
}
