//! A recording, read once, as what a report tells: series in buckets, spans, events, statistics.

use super::buckets::{Bounds, Grid, Series};
use super::clock::Clock;
use super::context::Context;
use super::record::{Source, Tick};
use super::spans::{Row, Rows};
use super::statistics::Statistics;
use super::told;
use serde::Serialize;
use sinew::control::Limit;
use sinew::daemon::FIRST_SYNC;
use sinew::daemon::words::{EventClass, event_in_words, fault_of, mode_cause};
use sinew::ipc::payload::{SourceHealth, SupervisorState};
use sinew::recording::{FileEnd, Happened, Severity, read_raw};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

/// Most events that are listed, and most changes of the mode.
const EVENTS: usize = 2000;
/// Most obstacles and sources with a line of their own.
const LINES: usize = 12;
/// Width of the first buckets without a period (s).
const WIDTH_S: f64 = 1e-3;

/// A line of the list of events.
#[derive(Debug, Serialize)]
pub(super) struct Line {
    /// Time (s).
    pub(super) at_s: f64,
    pub(super) severity: &'static str,
    pub(super) text: String,
    /// What clears it, of a fault.
    pub(super) remedy: Option<&'static str>,
}

/// The arm in one mode.
#[derive(Debug, Serialize)]
pub(super) struct Mode {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) name: &'static str,
    /// Why it began, where an event says so.
    pub(super) why: Option<String>,
    #[serde(skip)]
    tick: u64,
    #[serde(skip)]
    supervisor: u32,
}

/// A line of a plot.
#[derive(Debug, Serialize)]
pub(super) struct Curve {
    name: String,
    #[serde(flatten)]
    bounds: Bounds,
}

/// A plot.
#[derive(Debug, Serialize)]
pub(super) struct Plot {
    title: &'static str,
    unit: &'static str,
    /// What to know about it.
    note: String,
    curves: Vec<Curve>,
}

/// All that a report tells.
#[derive(Debug, Serialize)]
pub(super) struct Story {
    pub(super) grid: Grid,
    pub(super) to_s: f64,
    pub(super) modes: Vec<Mode>,
    pub(super) rows: Vec<Row>,
    pub(super) events: Vec<Line>,
    /// Events for which there was no room.
    pub(super) events_left_out: u64,
    pub(super) plots: Vec<Plot>,
    pub(super) statistics: Vec<(String, String)>,
    /// Time of day of the beginning, in UTC.
    pub(super) began_utc: Option<String>,
    /// Whether the file ends as it should.
    pub(super) whole: bool,
}

/// Curves by plot, then by name in the order of a key.
type Curves = BTreeMap<(Chart, u64), (String, Series)>;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Chart {
    Error,
    Attitude,
    Curvature,
    Distance,
    Tension,
    Deviation,
    Position,
    Time,
    Missed,
    Planner,
    Swing,
    Speed,
    Age,
}

impl Chart {
    const ALL: [Self; 13] = [
        Self::Error,
        Self::Attitude,
        Self::Curvature,
        Self::Distance,
        Self::Tension,
        Self::Deviation,
        Self::Position,
        Self::Time,
        Self::Missed,
        Self::Planner,
        Self::Swing,
        Self::Speed,
        Self::Age,
    ];

    const fn title(self) -> (&'static str, &'static str) {
        match self {
            Self::Error => ("Tip: distance from the target", "mm"),
            Self::Attitude => ("Tip: quaternion error", ""),
            Self::Curvature => ("Shape: largest error of a mean curvature", "1/m"),
            Self::Distance => ("Distances between the surfaces of arm and obstacles", "mm"),
            Self::Tension => ("Tensions commanded", "N"),
            Self::Deviation => ("Tensions: measured less commanded", "N"),
            Self::Position => ("Tip and target", "m"),
            Self::Time => ("Times of a tick", "us"),
            Self::Missed => ("Deadlines missed by ticks that were left out, since the loop began", ""),
            Self::Planner => ("Planner: iterations and sweeps", ""),
            Self::Swing => ("Swing of the tip, peak to peak", "mm"),
            Self::Speed => ("Speed over the configured one", "%"),
            Self::Age => ("Age of what the sources saw", "s"),
        }
    }
}

/// Reads a recording.
pub(super) struct Reader<'a> {
    context: &'a Context,
    period_s: Option<f64>,
    clock: Option<Clock>,
    grid: Grid,
    curves: Curves,
    obstacles: Vec<(u32, u32)>,
    obstacles_left_out: bool,
    rows: Rows,
    modes: Vec<Mode>,
    modes_left_out: bool,
    /// Causes of modes, by tick and mode.
    causes: BTreeMap<(u64, u32), u32>,
    happened: Vec<Happened>,
    events_left_out: u64,
    statistics: Statistics,
    last_s: f64,
}

impl<'a> Reader<'a> {
    pub(super) fn new(context: &'a Context) -> Self {
        let period_s = context.period_s();
        Self {
            context,
            period_s,
            clock: None,
            grid: Grid::new(0.0, period_s.unwrap_or(WIDTH_S)),
            curves: Curves::new(),
            obstacles: Vec::new(),
            obstacles_left_out: false,
            rows: Rows::default(),
            modes: Vec::new(),
            modes_left_out: false,
            causes: BTreeMap::new(),
            happened: Vec::new(),
            events_left_out: 0,
            statistics: Statistics::new(context.is_loop(), period_s.filter(|_| context.is_timed())),
            last_s: 0.0,
        }
    }

    /// Reads all of it.
    pub(super) fn read(mut self, path: &Path) -> miette::Result<Story> {
        let end = read_raw(path, |message| {
            match message.topic.rsplit('/').next() {
                Some("state") => self.tick(&message.decode()?, message.time_ns),
                Some("events") => self.event(message.decode()?),
                _ => {}
            }
            Ok(ControlFlow::Continue(()))
        });
        let end = end.map_err(told)?;
        Ok(self.finish(end))
    }

    fn tick(&mut self, tick: &Tick, log_ns: u64) {
        let t = tick.time_s;
        if self.clock.is_none() {
            self.clock = Some(Clock::new(t, tick.header.capture_ns, log_ns));
            self.grid.from_s = t;
        }
        let period_s = match self.period_s {
            Some(period_s) => period_s,
            None => (t - self.last_s).clamp(0.0, 1.0),
        };
        self.last_s = t;
        self.statistics.add(tick);
        self.mode(tick, period_s);
        self.spans(tick, period_s);
        self.plot(tick);
    }

    fn mode(&mut self, tick: &Tick, period_s: f64) {
        let to_s = tick.time_s + period_s;
        let full = self.modes.len() == EVENTS;
        match self.modes.last_mut() {
            Some(last) if last.supervisor == tick.supervisor => last.to_s = to_s,
            _ if full => self.modes_left_out = true,
            _ => self.modes.push(Mode {
                from_s: tick.time_s,
                to_s,
                name: self.context.mode(tick.supervisor),
                why: None,
                tick: tick.header.tick,
                supervisor: tick.supervisor,
            }),
        }
    }

    fn spans(&mut self, tick: &Tick, period_s: f64) {
        let mut now: Vec<(&'static str, String)> = Vec::new();
        if tick.fault_code != 0 {
            now.push(("fault", format!("fault {}", tick.fault_code)));
        }
        let acts = |limit: &Limit| tick.limits >> (limit.code() - 100) & 1 == 1;
        now.extend(Limit::ALL.into_iter().filter(acts).map(|limit| ("limit", limit.text().to_owned())));
        let mut source = |about: &dyn Fn() -> String, source: &Source| {
            let silent = [SourceHealth::Stale, SourceHealth::Expired, SourceHealth::Refused];
            if let Some(health) = silent.into_iter().find(|health| health.wire() == source.health) {
                now.push(("source", format!("{}: {}", about(), health.text())));
            }
        };
        for s in &tick.obstacle_sources {
            source(&|| format!("obstacles of source {}", s.source_id), s);
        }
        source(&|| "target".to_owned(), &tick.target_report);
        source(&|| "encoders".to_owned(), &tick.encoder_report);
        source(&|| "tip sensor".to_owned(), &tick.tip_report);
        self.rows.at(tick.time_s, period_s, &now);
    }

    fn plot(&mut self, tick: &Tick) {
        let place = self.grid.place(tick.time_s);
        self.add(place, Chart::Error, 0, 1e3 * tick.tip_error_m, || "distance".into());
        self.add(place, Chart::Attitude, 0, tick.quaternion_error, || "error".into());
        self.add(place, Chart::Curvature, 0, tick.curvature_error_1pm, || "error".into());
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let key = 2 * axis as u64;
            self.add(place, Chart::Position, key, tick.tip_position_m[axis], || format!("tip {name}"));
            self.add(place, Chart::Position, key + 1, tick.target_position_m[axis], || format!("target {name}"));
        }
        if let Some(nearest) = tick.nearest() {
            self.add(place, Chart::Distance, 0, 1e3 * nearest.surface_distance_m, || "nearest of all".into());
        }
        let context = self.context;
        for d in &tick.distances {
            let id = (d.source_id, d.obstacle_id);
            let known = self.obstacles.iter().position(|known| *known == id);
            let index = match known {
                Some(index) => index,
                None if self.obstacles.len() == LINES => {
                    self.obstacles_left_out = true;
                    continue;
                }
                None => {
                    self.obstacles.push(id);
                    self.obstacles.len() - 1
                }
            };
            let name = || context.obstacle(id.0, id.1);
            self.add(place, Chart::Distance, 1 + index as u64, 1e3 * d.surface_distance_m, name);
        }
        for (cable, tension_n) in tick.tension_command_n.iter().enumerate() {
            self.add(place, Chart::Tension, cable as u64, *tension_n, || context.cable(cable));
        }
        for (measured_n, commanded_n) in tick.tension_measured_n.iter().zip(&tick.tension_command_n) {
            self.add(place, Chart::Deviation, 0, measured_n - commanded_n, || "all cables".into());
        }
        let t = &tick.timing;
        let times = [("cycle", t.cycle_ns), ("plan", t.plan_ns), ("estimate", t.estimate_ns), ("wake-up", t.wakeup_ns)];
        // In lockstep nothing wakes up at a time.
        let shown = if context.is_timed() { times.len() } else { times.len() - 1 };
        for (key, (name, ns)) in (0..).zip(times).take(shown).filter(|(_, (_, ns))| *ns > 0) {
            self.add(place, Chart::Time, key, ns as f64 * 1e-3, || name.into());
        }
        if context.is_timed() {
            self.add(place, Chart::Missed, 0, tick.ticks_missed as f64, || "ticks left out".into());
        }
        self.add(place, Chart::Planner, 0, f64::from(tick.newton_iterations), || "Newton iterations".into());
        if tick.swarm_sweeps > 0 || self.curves.contains_key(&(Chart::Planner, 1)) {
            self.add(place, Chart::Planner, 1, f64::from(tick.swarm_sweeps), || "sweeps of the swarm".into());
        }
        self.add(place, Chart::Swing, 0, 1e3 * tick.swing_m, || "swing".into());
        self.add(place, Chart::Speed, 0, 1e2 * tick.speed_scale, || "asked for".into());
        for s in tick.obstacle_sources.iter().take(LINES) {
            let name = || format!("obstacles of source {}", s.source_id);
            self.add(place, Chart::Age, u64::from(s.source_id), s.age_s, name);
        }
        self.add(place, Chart::Age, 1 << 32, tick.target_report.age_s, || "target".into());
        self.add(place, Chart::Age, (1 << 32) + 1, tick.encoder_report.age_s, || "encoders".into());
        if tick.tip_report.accepted > 0 {
            self.add(place, Chart::Age, (1 << 32) + 2, tick.tip_report.age_s, || "tip sensor".into());
        }
    }

    fn add(&mut self, place: usize, chart: Chart, key: u64, value: f64, name: impl FnOnce() -> String) {
        if value.is_finite() {
            let (_, series) = self.curves.entry((chart, key)).or_insert_with(|| (name(), Series::default()));
            series.add(&self.grid, place, value);
        }
    }

    fn event(&mut self, event: Happened) {
        match EventClass::of(event.code) {
            EventClass::Mode(to) => {
                if self.causes.len() < EVENTS {
                    self.causes.insert((event.tick, to.wire()), event.detail);
                }
                return;
            }
            EventClass::LimitOff(_) => return,
            // For those who lay two recordings beside each other.
            EventClass::Other if event.code == FIRST_SYNC => return,
            // Ordinary work has its row, and may come with every tick.
            EventClass::LimitOn(_) if event_in_words(&event, &self.context.cables).0 == Severity::Info => return,
            _ => {}
        }
        if self.happened.len() < EVENTS {
            self.happened.push(event);
        } else {
            self.events_left_out += 1;
        }
    }

    fn finish(mut self, end: FileEnd) -> Story {
        let (context, clock) = (self.context, self.clock.unwrap_or(Clock::new(0.0, 0, 0)));
        for mode in &mut self.modes {
            mode.why = self.causes.get(&(mode.tick, mode.supervisor)).and_then(|code| mode_cause(*code));
        }
        let line = |event: &Happened| {
            let (severity, text) = event_in_words(event, &context.cables);
            let severity = match severity {
                Severity::Info => "info",
                Severity::Warning => "warning",
                Severity::Error => "error",
            };
            let is_fault = EventClass::of(event.code) == EventClass::Fault;
            let remedy = fault_of(event).filter(|_| is_fault).map(|fault| fault.remedy());
            Line { at_s: clock.seconds(event.time_ns), severity, text, remedy }
        };
        let mut events: Vec<Line> = self.happened.iter().map(line).collect();
        events.extend(self.modes.iter().map(|mode| Line {
            at_s: mode.from_s,
            severity: if mode.supervisor == SupervisorState::Faulted.wire() { "error" } else { "info" },
            text: format!("mode: {}{}", mode.name, mode.why.iter().map(|why| format!(" ({why})")).collect::<String>()),
            remedy: None,
        }));
        events.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let mut notes: BTreeMap<Chart, String> = BTreeMap::new();
        if self.obstacles_left_out {
            notes.insert(Chart::Distance, format!("The first {LINES} obstacles have a line of their own."));
        }
        let arm = &context.settings["arm"];
        if let (Some(least), Some(most)) = (arm["tension_n_min"].as_f64(), arm["tension_n_max"].as_f64()) {
            notes.insert(Chart::Tension, format!("Permitted: {least} N to {most} N, unless a segment has its own."));
        }
        if let (Some(period_s), true) = (self.period_s, context.is_timed()) {
            notes.insert(Chart::Time, format!("The period is {} us.", 1e6 * period_s));
        } else if context.is_loop() {
            notes.insert(Chart::Time, "In lockstep no tick is due at a time.".into());
        }
        let grid = self.grid;
        let mut charts: BTreeMap<Chart, Vec<Curve>> = BTreeMap::new();
        for ((chart, _), (name, series)) in self.curves {
            if !series.is_empty() {
                charts.entry(chart).or_default().push(Curve { name, bounds: series.finish(&grid) });
            }
        }
        let plots = Chart::ALL.into_iter().filter_map(|chart| {
            let curves = charts.remove(&chart)?;
            let (title, unit) = chart.title();
            Some(Plot { title, unit, note: notes.remove(&chart).unwrap_or_default(), curves })
        });
        Story {
            to_s: self.modes.last().map_or(0.0, |mode| mode.to_s.max(self.last_s)),
            plots: plots.collect(),
            grid,
            statistics: self.statistics.lines(context, &self.modes),
            began_utc: clock.utc(grid.from_s),
            modes: self.modes,
            rows: self.rows.finish(),
            events,
            events_left_out: self.events_left_out + u64::from(self.modes_left_out),
            whole: end == FileEnd::Whole,
        }
    }
}
