//! `sinew status`.

use super::Outcome;
use super::client::Which;
use clap::Args;
use comfy_table::Table;
use miette::IntoDiagnostic;
use sinew::daemon::domain_name;
use sinew::daemon::status::{SourceStatus, StatusReport, ask};

/// Arguments of `sinew status`.
#[derive(Debug, Args)]
pub(crate) struct Status {
    #[command(flatten)]
    which: Which,
    /// One JSON object instead of tables.
    #[arg(long)]
    json: bool,
}

impl Status {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let (domain, arm) = self.which.find()?;
        let Some(report) = ask(&domain_name(&domain), &arm).into_diagnostic()? else {
            eprintln!("sinew: {}", sinew::ipc::IpcError::NoDaemon { arm });
            return Ok(Outcome::Failed);
        };
        if self.json {
            println!("{}", serde_json::to_string(&report).into_diagnostic()?);
        } else {
            print(&report);
        }
        Ok(if report.fault.is_some() { Outcome::Failed } else { Outcome::Done })
    }
}

fn print(r: &StatusReport) {
    println!("arm {}: {}", r.arm, r.mode);
    if let Some(fault) = &r.fault {
        println!("fault {}: {}", fault.code, fault.what);
        println!("  what clears it: {}", fault.clears);
    }
    let clock = if r.lockstep { "lockstep" } else { "real time" };
    println!(
        "loop: {} ticks of {} ms ({clock}), {} missed, {} records dropped",
        r.ticks,
        1e3 * r.period_s,
        r.missed,
        r.records_dropped
    );
    if let Some(dropped) = r.recording_dropped {
        println!("recording: {dropped} messages dropped");
    }
    r.realtime_refused.iter().for_each(|refused| println!("degraded: {refused}"));
    let d = &r.drives;
    println!("drives: {} of {} ready, {} enabled", d.ready, d.count, d.enabled);
    d.fault.iter().for_each(|fault| println!("  {fault}"));

    let mut buses = Table::new();
    buses.set_header(["bus", "state", "load computed", "measured", "limit", "frames", "lost"]);
    for b in &r.buses {
        buses.add_row([
            b.name.clone(),
            b.state.clone(),
            format!("{:.1} %", 100.0 * b.load_computed),
            format!("{:.1} %", 100.0 * b.load_measured),
            format!("{:.0} %", 100.0 * b.load_limit),
            b.frames.to_string(),
            b.lost.to_string(),
        ]);
    }
    println!("{buses}");

    let mut sources = Table::new();
    sources.set_header(["source", "id", "health", "age (ms)", "accepted", "rejected"]);
    let rows = [("encoders", &r.encoders), ("target", &r.target)];
    for (name, source) in rows.into_iter().chain(r.obstacles.iter().map(|source| ("obstacles", source))) {
        sources.add_row(row(name, source));
    }
    println!("{sources}");
    if r.obstacle_sources_refused > 0 {
        println!("{} obstacle sets of further sources refused: all places are taken", r.obstacle_sources_refused);
    }

    let mut times = Table::new();
    times.set_header(["branch", "stage", "p50 (us)", "p99", "p99.9", "max", "ticks"]);
    for (branch, stages) in &r.time_us {
        for (stage, p) in stages {
            let us = |v: f64| format!("{v:.1}");
            times.add_row([
                branch.clone(),
                stage.clone(),
                us(p.p50),
                us(p.p99),
                us(p.p999),
                us(p.max),
                p.count.to_string(),
            ]);
        }
    }
    println!("{times}");
}

fn row(name: &str, s: &SourceStatus) -> [String; 6] {
    let rejected: Vec<String> = s.rejected.iter().map(|(cause, count)| format!("{count} x {cause}")).collect();
    [
        name.to_owned(),
        s.id.to_string(),
        s.health.clone(),
        s.age_s.map_or_else(|| "-".to_owned(), |age| format!("{:.1}", 1e3 * age)),
        s.accepted.to_string(),
        if rejected.is_empty() { "-".to_owned() } else { rejected.join(", ") },
    ]
}
