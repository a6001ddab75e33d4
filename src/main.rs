//! `sinew`: the command line. Exit codes: 0 done, 1 the run ended in a fault or contact, 2 unusable arguments or
//! configuration.
#![allow(clippy::print_stdout)] // the one place whose output is for people and pipes

use clap::Parser;
use std::process::ExitCode;

mod cli;

fn main() -> ExitCode {
    let arguments = cli::Arguments::parse();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_env("SINEW_LOG")
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn")),
        )
        .with_writer(std::io::stderr)
        .init();
    match cli::run(arguments) {
        Ok(outcome) => outcome.into(),
        Err(error) => {
            cli::complain(format_args!("{error:?}"));
            cli::Outcome::Unusable.into()
        }
    }
}
