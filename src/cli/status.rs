//! `sinew status`.

use super::Outcome;
use super::client::Which;
use clap::Args;
use comfy_table::{Table, presets};
use miette::IntoDiagnostic;
use sinew::daemon::operator::OperatorError;
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
        let found = self.which.find()?;
        let no_daemon = || OperatorError::NoDaemon(sinew::ipc::IpcError::NoDaemon { arm: found.arm.clone() });
        let report = match ask(&found.address).and_then(|report| report.ok_or_else(no_daemon)) {
            Ok(report) => report,
            Err(error) => return Ok(super::client::not_connected(&error)),
        };
        if self.json {
            super::print_text(&format!("{}\n", serde_json::to_string(&report).into_diagnostic()?))?;
        } else {
            super::print_text(&text(&report))?;
        }
        Ok(if report.fault.is_some() { Outcome::Failed } else { Outcome::Done })
    }
}

/// Stages in the order in which they happen.
const STAGES: [&str; 8] = ["wakeup", "input", "estimate", "plan", "guard", "send", "cycle", "report"];

fn text(r: &StatusReport) -> String {
    let mut out = String::new();
    let mut line = |text: String| {
        out.push_str(&text);
        out.push('\n');
    };
    line(format!("arm {}: {}", r.arm, r.mode));
    if let Some(fault) = &r.fault {
        line(format!("fault {}: {}", fault.code, fault.what));
        line(format!("  what clears it: {}", fault.clears));
    }
    // Those that have a line of their own have it.
    for alarm in r.alarms.iter().filter(|alarm| !["fault", "real time"].contains(&alarm.about.as_str())) {
        line(format!("alarm ({}): {}, since {}", alarm.about, alarm.what, alarm.since_utc));
        line(format!("  what it does: {}; what clears it: {}", alarm.does, alarm.clears));
    }
    let t = &r.tip;
    let [x, y, z] = t.position_m;
    let bound = t
        .three_sigma_m
        .map_or_else(|| "not known how well".into(), |b| format!("known to {:.1} mm (3 sigma)", 1e3 * b));
    line(format!("tip: ({x:.4}, {y:.4}, {z:.4}) m, {bound}"));
    if let Some([x, y, z]) = t.measured_m {
        let bias_mm = 1e3 * t.bias_m.iter().map(|b| b * b).sum::<f64>().sqrt();
        line(format!(
            "  measured at ({x:.4}, {y:.4}, {z:.4}) m; the estimate is {bias_mm:.1} mm off, as far as that lasts"
        ));
    }
    t.error_m.iter().for_each(|e| line(format!("  {:.1} mm from its target", 1e3 * e)));
    t.curvature_error_1pm.iter().for_each(|e| line(format!("  mean curvatures within {e:.4} 1/m of their target")));
    t.nearest_m.iter().for_each(|d| line(format!("  nearest obstacle: {:.1} mm", 1e3 * d)));
    line(format!("tensions: {:.1} to {:.1} N", t.tension_n[0], t.tension_n[1]));
    let until = if r.speed_scale < 1.0 { ", until the arm is disarmed or `sinew speed 100%`" } else { "" };
    line(format!("speed: {} % of the configured{until}", (1e4 * r.speed_scale).round() / 100.0));
    let clock = if r.lockstep { "lockstep" } else { "real time" };
    line(format!(
        "loop: {} ticks of {} ms ({clock}); deadlines missed: {} ({} left out, {} overran); {} records dropped",
        r.ticks,
        1e3 * r.period_s,
        r.missed,
        r.left_out,
        r.overran,
        r.records_dropped
    ));
    if let Some(dropped) = r.recording_dropped {
        line(format!("recording: {dropped} messages dropped"));
    }
    r.realtime_refused.iter().for_each(|refused| line(format!("degraded: {refused}")));
    let d = &r.drives;
    line(format!(
        "drives: {} of {} ready, {} enabled; without the daemon: {}",
        d.ready, d.count, d.enabled, r.safe_hold
    ));
    d.fault.iter().for_each(|fault| line(format!("  {fault}")));

    let mut buses = table();
    buses.set_header(["bus", "state", "load computed", "measured", "limit", "frames", "lost", "unsent"]);
    for b in &r.buses {
        buses.add_row([
            b.name.clone(),
            b.state.clone(),
            format!("{:.1} %", 100.0 * b.load_computed),
            format!("{:.1} %", 100.0 * b.load_measured),
            format!("{:.0} %", 100.0 * b.load_limit),
            b.frames.to_string(),
            b.lost.to_string(),
            b.unsent.to_string(),
        ]);
    }
    line(buses.to_string());

    let mut sources = table();
    sources.set_header(["source", "id", "health", "age (ms)", "accepted", "rejected"]);
    let rows = [("encoders", &r.encoders), ("target", &r.target)];
    let tip = r.tip_sensor.iter().map(|source| ("tip sensor", source));
    for (name, source) in rows.into_iter().chain(tip).chain(r.obstacles.iter().map(|source| ("obstacles", source))) {
        sources.add_row(row(name, source));
    }
    line(sources.to_string());
    if r.obstacle_sources_refused > 0 {
        line(format!("{} obstacle sets of further sources refused: all places are taken", r.obstacle_sources_refused));
    }

    let mut times = table();
    times.set_header(["branch", "stage", "p50 (us)", "p99", "p99.9", "max", "ticks"]);
    for (branch, stages) in &r.time_us {
        for (stage, p) in STAGES.iter().filter_map(|stage| stages.get_key_value(*stage)) {
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
    line(times.to_string());

    let mut threads = table();
    threads.set_header(["thread", "scheduling", "cpus", "ran (s)", "waited (s)", "page faults", "preempted", "slept"]);
    for t in &r.threads {
        threads.add_row([
            t.name.clone(),
            t.scheduling.clone(),
            t.cpus.clone(),
            format!("{:.2}", t.run_s),
            format!("{:.2}", t.wait_s),
            (t.faults_minor + t.faults_major).to_string(),
            t.switches_involuntary.to_string(),
            t.switches_voluntary.to_string(),
        ]);
    }
    line(threads.to_string());
    out
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

fn table() -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    table
}
