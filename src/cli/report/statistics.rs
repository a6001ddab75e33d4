//! Numbers of a whole recording.

use super::context::Context;
use super::record::Tick;
use super::story::Mode;
use hdrhistogram::Histogram;
use sinew::daemon::overran;
use sinew::ipc::payload::{PlannerStatus, SupervisorState};
use sinew_hal::clock::seconds_to_ns;
use std::collections::BTreeMap;

/// Digits of a time's percentiles.
const DIGITS: u8 = 3;
/// Longer ones count as that long (ns).
const MOST_NS: u64 = 100_000_000_000;

/// Collected tick by tick.
pub(super) struct Statistics {
    /// Whether a loop wrote it; a plan follows its target all along.
    is_loop: bool,
    /// Of a loop that keeps time (s).
    period_s: Option<f64>,
    ticks: u64,
    first: Option<(u64, f64, u64)>,
    last: (u64, f64, u64),
    records_dropped: u64,
    overran: u64,
    /// Sum, count and largest of the tip's error while it follows (m).
    error_m: (f64, u64, f64),
    curvature_error_1pm: Option<f64>,
    /// Least distance (m), the obstacle, when (s).
    nearest: Option<(f64, (u32, u32), f64)>,
    tension_n: (f64, f64),
    status: BTreeMap<&'static str, u64>,
    cycle_ns: Option<Histogram<u64>>,
    plan_ns: Option<Histogram<u64>>,
}

impl Statistics {
    pub(super) fn new(is_loop: bool, period_s: Option<f64>) -> Self {
        Self {
            is_loop,
            period_s,
            ticks: 0,
            first: None,
            last: (0, 0.0, 0),
            records_dropped: 0,
            overran: 0,
            error_m: (0.0, 0, 0.0),
            curvature_error_1pm: None,
            nearest: None,
            tension_n: (f64::INFINITY, f64::NEG_INFINITY),
            status: BTreeMap::new(),
            cycle_ns: Histogram::new_with_max(MOST_NS, DIGITS).ok(),
            plan_ns: Histogram::new_with_max(MOST_NS, DIGITS).ok(),
        }
    }

    pub(super) fn add(&mut self, tick: &Tick) {
        let now = (tick.header.tick, tick.time_s, tick.ticks_missed);
        self.first.get_or_insert(now);
        (self.last, self.ticks, self.records_dropped) = (now, self.ticks + 1, tick.records_dropped);
        if let Some(period_s) = self.period_s {
            let t = &tick.timing;
            self.overran += u64::from(overran(t.wakeup_ns, t.cycle_ns, seconds_to_ns(period_s)));
        }
        let follows = !self.is_loop || tick.supervisor == SupervisorState::Tracking.wire();
        if follows && tick.tip_error_m.is_finite() {
            let (sum, count, most) = self.error_m;
            self.error_m = (sum + tick.tip_error_m, count + 1, most.max(tick.tip_error_m));
        }
        if follows && tick.curvature_error_1pm.is_finite() {
            self.curvature_error_1pm = Some(tick.curvature_error_1pm);
        }
        if let Some(d) = tick.nearest()
            && self.nearest.is_none_or(|(least, ..)| d.surface_distance_m < least)
        {
            self.nearest = Some((d.surface_distance_m, (d.source_id, d.obstacle_id), tick.time_s));
        }
        let (least, most) = self.tension_n;
        let fold = |from: f64, with: fn(f64, f64) -> f64| tick.tension_command_n.iter().copied().fold(from, with);
        self.tension_n = (fold(least, f64::min), fold(most, f64::max));
        let status = PlannerStatus::from_wire(tick.planner_status).map_or("unknown", PlannerStatus::text);
        *self.status.entry(status).or_default() += 1;
        for (histogram, ns) in [(&mut self.cycle_ns, tick.timing.cycle_ns), (&mut self.plan_ns, tick.timing.plan_ns)] {
            if let Some(histogram) = histogram.as_mut().filter(|_| ns > 0) {
                histogram.saturating_record(ns);
            }
        }
    }

    /// Names and values, in words.
    pub(super) fn lines(&self, context: &Context, modes: &[Mode]) -> Vec<(String, String)> {
        let mut lines: Vec<(String, String)> = Vec::new();
        let mut line = |name: &str, value: String| lines.push((name.to_owned(), value));
        let (first_tick, first_s, first_missed) = self.first.unwrap_or_default();
        let (last_tick, last_s, last_missed) = self.last;
        line("Time", format!("{first_s:.3} s to {last_s:.3} s, ticks {first_tick} to {last_tick}"));
        line("Records", format!("{} states; {} messages of the run found no room", self.ticks, self.records_dropped));
        let mut shares: BTreeMap<&str, f64> = BTreeMap::new();
        for mode in modes {
            *shares.entry(mode.name).or_default() += mode.to_s - mode.from_s;
        }
        let shares: Vec<String> = shares.iter().map(|(name, s)| format!("{name} {s:.2} s")).collect();
        line("Modes", shares.join(", "));
        let (sum, count, most) = self.error_m;
        if count > 0 {
            let mean = sum / count as f64;
            line("Tip error while tracking", format!("mean {:.2} mm, largest {:.2} mm", 1e3 * mean, 1e3 * most));
        }
        if let Some(error) = self.curvature_error_1pm {
            line("Curvature error, last", format!("{error:.4} 1/m"));
        }
        if let Some((least, (source, obstacle), at_s)) = self.nearest {
            let name = context.obstacle(source, obstacle);
            line("Least distance", format!("{:.1} mm, to {name}, at {at_s:.2} s", 1e3 * least));
        }
        if self.tension_n.0.is_finite() {
            line("Tensions commanded", format!("{:.2} N to {:.2} N", self.tension_n.0, self.tension_n.1));
        }
        if let Some(period_s) = self.period_s {
            let left_out = last_missed.saturating_sub(first_missed);
            let missed =
                format!("{left_out} ticks left out, {} overran their period of {} ms", self.overran, 1e3 * period_s);
            line("Deadlines", missed);
        }
        for (name, histogram) in [("Time of a tick", &self.cycle_ns), ("Time of planning", &self.plan_ns)] {
            if let Some(h) = histogram.as_ref().filter(|h| !h.is_empty()) {
                let us = |ns: u64| ns as f64 * 1e-3;
                let [p50, p99, p999] = [0.5, 0.99, 0.999].map(|q| us(h.value_at_quantile(q)));
                let text =
                    format!("median {p50:.0} us, 99 % {p99:.0} us, 99.9 % {p999:.0} us, most {:.0} us", us(h.max()));
                line(name, text);
            }
        }
        let status: Vec<String> = self.status.iter().map(|(name, ticks)| format!("{name} {ticks}")).collect();
        line("Plans, by how they ended", status.join(", "));
        lines
    }
}
