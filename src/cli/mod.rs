//! Commands of `sinew`; each file is one.

mod check;
mod plan;
mod record;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Real-time controller service for cable-driven multisegment continuum arms.
#[derive(Debug, Parser)]
#[command(name = "sinew", version, about)]
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
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::from(0),
            Outcome::Failed => Self::from(1),
            Outcome::Unusable => Self::from(2),
        }
    }
}

/// Runs a command.
pub(crate) fn run(arguments: Arguments) -> miette::Result<Outcome> {
    match arguments.command {
        Command::Plan(plan) => plan.run(),
        Command::Check(check) => check.run(),
    }
}

/// A bar on standard error, silent where that is not a terminal.
pub(crate) fn progress_bar(length: u64, what: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}")
        .unwrap_or_else(|_| indicatif::ProgressStyle::default_bar());
    indicatif::ProgressBar::new(length).with_style(style).with_message(what.to_owned())
}
