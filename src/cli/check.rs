//! `sinew check`.

use super::Outcome;
use clap::Args;
use comfy_table::Table;
use sinew::config::Config;
use sinew::daemon;
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
        let mut table = Table::new();
        table.load_style(comfy_table::presets::NOTHING);
        for line in config.summary() {
            table.add_row([line.label, line.value]);
        }
        for load in daemon::bus_loads(&config) {
            let value = format!(
                "{:.1} % with worst-case stuffing, at most {:.0} %; shortest period {:.2} ms",
                100.0 * load.share,
                100.0 * load.limit,
                1e3 * load.period_s_min
            );
            table.add_row([format!("load {}", load.name), value]);
        }
        println!("{}", table.trim_fmt());
        match daemon::check(&config) {
            Ok(_) => Ok(Outcome::Done),
            Err(error) => {
                eprintln!("sinew check: {error}");
                Ok(Outcome::Unusable)
            }
        }
    }
}
