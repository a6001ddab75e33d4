//! `sinew check`.

use super::{Outcome, complain, print_text};
use clap::Args;
use comfy_table::Table;
use sinew::config::{Config, safe_hold_in_words};
use sinew::control::{Settings, doubts, weights_in_words};
use sinew::daemon;
use std::path::{Path, PathBuf};

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
        // What the environment says precedes what the files say, here as where the daemon runs.
        let [(_, prefix), (_, root)] = daemon::domain(&config).env();
        table.add_row(["shared memory", &format!("prefix {}, root {}", prefix.display(), root.display())]);
        for load in daemon::bus_loads(&config) {
            let value = format!(
                "{:.1} % with worst-case stuffing, at most {:.0} %; shortest period {:.2} ms",
                100.0 * load.share,
                100.0 * load.limit,
                1e3 * load.period_s_min
            );
            table.add_row([format!("load {}", load.name), value]);
        }
        for line in config.computed() {
            table.add_row([line.label, line.value]);
        }
        for (key, value) in weights_in_words(&Settings::new(&config)) {
            table.add_row([key, &value]);
        }
        table.add_row(["drives.defaults.safe_hold", &safe_hold_in_words(&config.drives.drives)]);
        for protection in &config.drives.accept_without {
            table.add_row(["accepted without", protection.name()]);
        }
        for file in self.config.iter().filter(|file| holds_plant(file)) {
            let value = format!("[plant] of {} is sim_plant's, which checks it when it starts", file.display());
            table.add_row(["not checked", &value]);
        }
        print_text(&format!("{}\n", table.trim_fmt()))?;
        let doubts = doubts(&Settings::new(&config));
        for warning in config.warnings().into_iter().chain(doubts).chain(absent_processor(&config)) {
            complain(format_args!("sinew check: warning: {warning}"));
        }
        match daemon::check(&config) {
            Ok(_) => Ok(Outcome::Done),
            Err(error) => {
                complain(format_args!("sinew check: {error}"));
                Ok(Outcome::Unusable)
            }
        }
    }
}

/// Whether a file that has been read before holds the table that is not the daemon's.
fn holds_plant(file: &Path) -> bool {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.parse::<toml::Table>().is_ok_and(|tables| tables.contains_key("plant"))
}

/// The control thread's processor, where this machine does not have it. The configuration may be another machine's.
fn absent_processor(config: &Config) -> Option<String> {
    let processors = Path::new("/sys/devices/system/cpu");
    let cpu = config.timing.cpu?;
    let is_absent = processors.is_dir() && !processors.join(format!("cpu{cpu}")).exists();
    let then = if config.timing.require_realtime { "does not start here" } else { "runs here without it" };
    is_absent.then(|| format!("loop.cpu = {cpu}: this machine has no such processor; the daemon {then}"))
}
