//! `sinew`: the command line. Exit codes: 0 done, 1 the run ended in a fault or contact, 2 unusable arguments or
//! configuration, 70 a defect of this program (a thread panicked; 101 where it was the main thread).

use clap::Parser;
use std::io::IsTerminal;
use std::process::ExitCode;

mod cli;

fn main() -> ExitCode {
    let arguments = cli::Arguments::parse();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_env("SINEW_LOG")
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn")),
        )
        .with_writer(cli::log::writer)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    match cli::run(arguments) {
        Ok(outcome) => outcome.into(),
        Err(error) => {
            cli::complain(format_args!("{error:?}"));
            cli::Outcome::Unusable.into()
        }
    }
}
