//! `sinew`: the command line. Exit codes: 0 done, 1 the run ended in a fault or contact, 2 unusable arguments or
//! configuration, 70 a defect of this program (a thread panicked; 101 where it was the main thread).

use clap::Parser;
use std::io::IsTerminal;
use std::process::ExitCode;

mod cli;

fn main() -> ExitCode {
    let arguments = cli::Arguments::parse();
    let filter = match std::env::var("SINEW_LOG") {
        Ok(text) if !text.is_empty() => match text.parse::<tracing_subscriber::EnvFilter>() {
            Ok(filter) => filter,
            Err(error) => {
                cli::complain(format_args!("SINEW_LOG={text}: {error}; expected e.g. info or sinew::daemon=debug"));
                return cli::Outcome::Unusable.into();
            }
        },
        // Of iceoryx2 nothing: its lines are pages of internals, and what matters comes as an error of sinew's own.
        _ => tracing_subscriber::EnvFilter::new("warn,iceoryx2_bb_loggers=off"),
    };
    tracing_subscriber::fmt()
        .with_env_filter(filter)
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
