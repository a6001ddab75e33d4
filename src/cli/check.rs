//! `sinew check`.

use super::Outcome;
use clap::Args;
use sinew::config::Config;
use std::path::PathBuf;

/// Arguments of `sinew check`.
#[derive(Debug, Args)]
pub(crate) struct Check {
    /// Configuration files; together they hold all tables.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    config: Vec<PathBuf>,
}

impl Check {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let config = Config::load(&self.config)?;
        for line in config.summary() {
            println!("{line:?}");
        }
        Ok(Outcome::Done)
    }
}
