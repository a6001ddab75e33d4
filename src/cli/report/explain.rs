//! `sinew explain`: an instant of a recording in words. The words are those of the log, of `sinew status` and of the alarms.

use super::clock::Clock;
use super::context::Context;
use super::record::Tick;
use super::told;
use crate::cli::{Outcome, print_text};
use clap::Args;
use miette::miette;
use sinew::control::{Limit, Settings, likely_cause};
use sinew::daemon::alarms;
use sinew::daemon::status::fault_status;
use sinew::daemon::words::{EventClass, event_in_words, fault_of, mode_cause};
use sinew::ipc::payload::{PlannerBranch, PlannerStatus, SourceHealth, SupervisorState, TargetMode};
use sinew::recording::{Happened, last_ns, read_between};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// How far before the instant a state may lie (ns).
const WINDOW_NS: u64 = 2_000_000_000;
/// Requests that are told.
const REQUESTS: usize = 3;
/// Width of the names of lines.
const NAME: usize = 10;

/// Arguments of `sinew explain`.
#[derive(Debug, Args)]
pub(crate) struct Explain {
    /// Recording of `run --record`, `demo --keep` or `plan --out`.
    file: PathBuf,
    /// Time of the loop (s), as `sinew report` has it; default: the end.
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    at: Option<f64>,
}

impl Explain {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let context = Context::read(&self.file)?;
        let clock = clock(&self.file)?;
        let end_ns = last_ns(&self.file).map_err(told)?.unwrap_or(0);
        let end_s = clock.of_log(end_ns);
        let at_s = self.at.unwrap_or(end_s);
        // A time that is printed is rounded, and may lie just beyond.
        if !(clock.begin_s() - 0.01..=end_s + 0.01).contains(&at_s) {
            return Err(miette!("--at {at_s}: {} holds {:.3} s to {end_s:.3} s", self.file.display(), clock.begin_s()));
        }
        // To the next microsecond: times in the file are whole nanoseconds, those of people are not.
        let until_ns = clock.log_ns(at_s.max(clock.begin_s())).saturating_add(1000);
        let mut tick: Option<Tick> = None;
        read_between(&self.file, &["state"], (until_ns.saturating_sub(WINDOW_NS), until_ns), |message| {
            tick = Some(message.decode()?);
            Ok(ControlFlow::Continue(()))
        })
        .map_err(told)?;
        let tick = tick.ok_or_else(|| miette!("there is no state within 2 s before {at_s} s"))?;
        let mut events: Vec<Happened> = Vec::new();
        read_between(&self.file, &["events"], (0, until_ns), |message| {
            events.push(message.decode()?);
            Ok(ControlFlow::Continue(()))
        })
        .map_err(told)?;
        print_text(&Told { context: &context, clock, tick: &tick, events: &events }.text())?;
        Ok(Outcome::Done)
    }
}

/// The clock by the first state.
fn clock(path: &Path) -> miette::Result<Clock> {
    let mut clock = None;
    let read = read_between(path, &["state"], (0, u64::MAX), |message| {
        let tick: Tick = message.decode()?;
        clock = Some(Clock::new(tick.time_s, tick.header.capture_ns, message.time_ns));
        Ok(ControlFlow::Break(()))
    });
    read.map_err(told)?;
    clock.ok_or_else(|| miette!("{}: there is no state in it", path.display()))
}

/// What is told of an instant.
struct Told<'a> {
    context: &'a Context,
    clock: Clock,
    tick: &'a Tick,
    events: &'a [Happened],
}

impl Told<'_> {
    fn text(&self) -> String {
        let utc = self.clock.utc(self.tick.time_s).map_or_else(String::new, |utc| format!(" ({utc})"));
        let arm = self.context.arm();
        let mut text = format!("arm {arm} at {:.3} s{utc}, tick {}\n\n", self.tick.time_s, self.tick.header.tick);
        for (name, lines) in [
            ("mode", self.mode()),
            ("fault", self.fault()),
            ("wrong", self.alarms()),
            ("limits", self.limits()),
            ("asked", self.requests()),
            ("target", self.target()),
            ("obstacles", self.obstacles()),
            ("tensions", self.tensions()),
            ("planner", self.planner()),
        ] {
            for (place, line) in lines.iter().enumerate() {
                let name = if place == 0 { name } else { "" };
                text += &format!("{name:NAME$}  {line}\n");
            }
        }
        text
    }

    fn mode(&self) -> Vec<String> {
        let mode = SupervisorState::from_wire(self.tick.supervisor);
        let name = self.context.mode(self.tick.supervisor);
        if !self.context.is_loop() {
            return vec![name.to_owned()];
        }
        let last = self.events.iter().rev().find(|e| matches!(EventClass::of(e.code), EventClass::Mode(_)));
        let begun = last.filter(|event| EventClass::of(event.code) == mode.map_or(EventClass::Other, EventClass::Mode));
        let Some(event) = begun else {
            return vec![format!("{name}, since before the first event of this file")];
        };
        let since = self.clock.seconds(event.time_ns);
        let why = mode_cause(event.detail).map_or_else(String::new, |why| format!(": {why}"));
        vec![format!("{name} since {since:.3} s{why}")]
    }

    fn fault(&self) -> Vec<String> {
        let state = self.tick.state();
        let Some(status) = fault_status(&state, &self.context.cables) else { return vec!["none".into()] };
        let first = self.events.iter().rev().find(|event| event.code == status.code);
        let since = first.map_or_else(String::new, |e| format!(" at {:.3} s", self.clock.seconds(e.time_ns)));
        let mut lines = vec![format!("{}{since} (code {})", status.what, status.code)];
        lines.push(format!("to clear it: {}", status.clears));
        let settings = self.context.config().map(|config| Settings::new(&config));
        if let (Some(settings), Some(fault)) = (settings, first.and_then(fault_of)) {
            lines.extend(likely_cause(&fault, &settings).map(|cause| format!("likely cause: {cause}")));
        }
        lines
    }

    fn alarms(&self) -> Vec<String> {
        let state = self.tick.state();
        // A plan and a plant's trace have no sources that could be missing.
        let required = if self.context.is_loop() { self.context.required() } else { Vec::new() };
        let line = |a: &alarms::Alarm| {
            let since = self.clock.seconds(a.since_ns);
            let since = if since < self.tick.time_s { format!(" since {since:.3} s") } else { String::new() };
            format!("{}: {}{since}; it does: {}; what clears it: {}", a.about, a.what, a.does, a.clears)
        };
        alarms::of_state(&state, &required).iter().map(line).collect()
    }

    fn limits(&self) -> Vec<String> {
        let acts = |limit: &Limit| self.tick.limits >> (limit.code() - 100) & 1 == 1;
        let list: Vec<&str> = Limit::ALL.into_iter().filter(acts).map(Limit::text).collect();
        vec![if list.is_empty() { "none acts".into() } else { list.join("; ") }]
    }

    fn requests(&self) -> Vec<String> {
        if !self.context.is_loop() {
            return Vec::new();
        }
        let asked = |event: &&Happened| matches!(EventClass::of(event.code), EventClass::Request(_));
        let mut last: Vec<&Happened> = self.events.iter().rev().filter(asked).take(REQUESTS).collect();
        last.reverse();
        let line = |event: &&Happened| {
            let (_, words) = event_in_words(event, &self.context.cables);
            format!("{:.3} s, {words}", self.clock.seconds(event.time_ns))
        };
        if last.is_empty() { vec!["nothing, so far".into()] } else { last.iter().map(line).collect() }
    }

    fn target(&self) -> Vec<String> {
        let t = self.tick;
        let mm = |m: f64| 1e3 * m;
        let what = match TargetMode::from_wire(t.target_mode) {
            None => return vec!["none".into()],
            Some(TargetMode::Tip) => {
                let [x, y, z] = t.target_position_m;
                format!("tip to ({x:.3}, {y:.3}, {z:.3}) m, {:.1} mm away", mm(t.tip_error_m))
            }
            Some(TargetMode::Shape) => {
                format!("shape, largest error of a curvature {:.4} 1/m", t.curvature_error_1pm)
            }
        };
        let health = SourceHealth::from_wire(t.target_report.health);
        let source = match health {
            None | Some(SourceHealth::Absent) => String::new(),
            Some(health) => {
                format!(
                    ", by source {}, {}, {:.3} s old",
                    t.target_report.source_id,
                    health.text(),
                    t.target_report.age_s
                )
            }
        };
        let speed =
            if t.speed_scale < 1.0 { format!(", at {:.0} % of the speed", 1e2 * t.speed_scale) } else { String::new() };
        vec![format!("{what}{source}{speed}")]
    }

    fn obstacles(&self) -> Vec<String> {
        let near = match self.tick.nearest() {
            None => "none is known".to_owned(),
            Some(d) => format!(
                "{} known, the nearest is {} at {:.1} mm{}",
                self.tick.distances.len(),
                self.context.obstacle(d.source_id, d.obstacle_id),
                1e3 * d.surface_distance_m,
                if d.growth_m > 0.0 { format!(", grown by {:.1} mm", 1e3 * d.growth_m) } else { String::new() },
            ),
        };
        let source = |s: &super::record::Source| {
            let health = SourceHealth::from_wire(s.health).map_or("unknown", SourceHealth::text);
            format!("source {}: {health}, {:.3} s old", s.source_id, s.age_s)
        };
        std::iter::once(near).chain(self.tick.obstacle_sources.iter().map(source)).collect()
    }

    fn tensions(&self) -> Vec<String> {
        let commanded = &self.tick.tension_command_n;
        let most = (0..commanded.len()).max_by(|a, b| commanded[*a].total_cmp(&commanded[*b]));
        let least = (0..commanded.len()).min_by(|a, b| commanded[*a].total_cmp(&commanded[*b]));
        let of = |place: usize| format!("{:.2} N (cable {})", commanded[place], self.context.cable(place));
        match (least, most) {
            (Some(least), Some(most)) => vec![format!("{} to {}", of(least), of(most))],
            _ => Vec::new(),
        }
    }

    fn planner(&self) -> Vec<String> {
        let t = self.tick;
        let status = PlannerStatus::from_wire(t.planner_status).map_or("unknown", PlannerStatus::text);
        let branch = PlannerBranch::from_wire(t.planner_branch).map_or("unknown", PlannerBranch::text);
        let mut lines = vec![format!(
            "{status}, branch {branch}, {} iterations, {:.0} us",
            t.newton_iterations,
            t.timing.plan_ns as f64 * 1e-3
        )];
        if self.context.is_loop() {
            let cycle_us = t.timing.cycle_ns as f64 * 1e-3;
            lines.push(format!("the tick took {cycle_us:.0} us; {} ticks were left out so far", t.ticks_missed));
        }
        lines
    }
}
