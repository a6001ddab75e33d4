//! What `sinew check` says about a configuration that was accepted.
//!
//! Enters: a checked configuration. Leaves: lines of label and value, ready for a table, and warnings. The buses' load is
//! computed where their protocol is known and is not part of it.

use super::computed::short;
use super::{BodyModel, BusKind, BusLayout, Config, Routing, ScenarioConfig, SegmentConfig, Task};

/// One line of a summary.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SummaryLine {
    /// What it is about.
    pub label: String,
    /// What holds.
    pub value: String,
}

pub(super) fn line(label: &str, value: String) -> SummaryLine {
    SummaryLine { label: label.to_owned(), value }
}

/// What cables at these angles (rad) around a segment's axis cannot do, in words; `None` where they bend it to every side.
fn cannot_bend(angles: &[f64]) -> Option<String> {
    let turn = std::f64::consts::TAU;
    let mut sorted: Vec<f64> = angles.iter().map(|a| a.rem_euclid(turn)).collect();
    sorted.sort_by(f64::total_cmp);
    let next = |i: usize| if i + 1 < sorted.len() { sorted[i + 1] } else { sorted[0] + turn };
    let gaps: Vec<f64> = (0..sorted.len()).map(|i| next(i) - sorted[i]).collect();
    let widest = gaps.iter().copied().fold(0.0, f64::max);
    let half = turn / 2.0;
    let in_line = angles.iter().all(|a| ((a - angles[0]).sin()).abs() < 1e-3);
    let degrees = |a: f64| a.to_degrees().rem_euclid(360.0).round();
    if in_line && widest > half + 1e-3 {
        let at = degrees(angles[0]);
        return Some(format!(
            "cables at {at} degrees alone bend it to that side only; it springs back by its own stiffness, and what bends it \
             sideways is not controlled"
        ));
    }
    if in_line {
        let at = degrees(angles[0]);
        return Some(format!(
            "cables at {at} and {} degrees bend it in one plane; what bends it out of it is not controlled",
            degrees(angles[0] + half)
        ));
    }
    (widest > half + 1e-3).then(|| {
        let from = gaps.iter().position(|gap| *gap == widest).map_or(0.0, |i| sorted[i]);
        format!(
            "no cable from {} to {} degrees: it is not bent to that side but by its own stiffness",
            degrees(from),
            degrees(from + widest)
        )
    })
}

/// What cables that end before a segment's end cannot do; `None` where those left bend it to every side, or all end there.
fn bends_part(segment: &SegmentConfig) -> Option<String> {
    let reach = |c: usize| segment.cable_elements(c);
    let cables = 0..segment.hole_angles_rad.len();
    let last = cables.clone().map(reach).filter(|disk| *disk < segment.elements).max()?;
    let left: Vec<f64> = cables.filter(|c| reach(*c) == segment.elements).map(|c| segment.hole_angles_rad[c]).collect();
    let beyond = format!("beyond disk {last} of {}", segment.elements);
    if left.is_empty() {
        return Some(format!("{beyond} none of its cables bends it; that part follows by its own stiffness"));
    }
    cannot_bend(&left).map(|what| format!("{beyond} {what}"))
}

/// What cables that wind around a segment do beside bending it.
fn twists(segment: &SegmentConfig, index: usize) -> Option<String> {
    let turn = |x: f64| segment.route.turn.at(index as f64 + x, 0.0);
    let wound = (turn(1.0) - turn(0.0)).to_degrees();
    (wound.abs() > 1.0).then(|| {
        format!(
            "its cables wind by {wound:.0} degrees, so they twist it as well; twist is neither steered nor measured"
        )
    })
}

impl Config {
    /// What is permitted, and will hardly do what it is there for.
    pub fn warnings(&self) -> Vec<String> {
        let segments = self.arm.segments.iter().enumerate();
        let said = |(index, segment): (usize, &SegmentConfig)| {
            let all = [cannot_bend(&segment.hole_angles_rad), bends_part(segment), twists(segment, index)];
            all.into_iter().flatten().map(move |what| format!("segment {}: {what}", index + 1))
        };
        segments.flat_map(said).collect()
    }

    /// Summary of the arm, the loop, the planner, the observer, the buses and their drives.
    pub fn summary(&self) -> Vec<SummaryLine> {
        let arm = &self.arm;
        let length = arm.length_m();
        let routing = if arm.routing == Routing::Local { "local" } else { "through" };
        let mut lines = vec![
            line(
                "arm",
                format!("{}: {} segments, {} elements, {length:.3} m", arm.name, arm.segments.len(), arm.node_count()),
            ),
            line(
                "cables",
                format!("{}, routed {routing}, {} to {} N", arm.cable_count(), arm.tension_n_min, arm.tension_n_max),
            ),
        ];
        let timing = &self.timing;
        let scheduling = match (timing.priority, timing.cpu) {
            (0, _) => "normal scheduling".to_owned(),
            (priority, Some(cpu)) => format!("SCHED_FIFO {priority} on processor {cpu}"),
            (priority, None) => format!("SCHED_FIFO {priority}"),
        };
        let wake =
            timing.wake_latency_s.map_or_else(String::new, |s| format!(", wake-up latency at most {:.0} us", 1e6 * s));
        lines.push(line(
            "period",
            format!("{} ms ({:.0} Hz), {scheduling}{wake}", short(1e3 * timing.period_s), 1.0 / timing.period_s),
        ));
        lines.push(line(
            "missed deadlines",
            format!(
                "hold up to {}, then ramp {} s, fault at {}",
                timing.overruns_hold, timing.ramp_s, timing.overruns_fault
            ),
        ));
        let planner = &self.planner;
        let body = match planner.body {
            BodyModel::Arm => format!("whole arm, radius {} mm", short(1e3 * planner.body_radius_m)),
            BodyModel::Points => "points".to_owned(),
        };
        lines.push(line(
            "planner",
            format!(
                "lookahead {} s, {} Newton iterations, near obstacles {}",
                short(planner.lookahead_s),
                planner.newton_iterations_max,
                planner.warning.name()
            ),
        ));
        let barrier = planner.barrier.map_or("no barrier".to_owned(), |barrier| format!("barrier {}", barrier.gamma));
        lines.push(line("obstacles", format!("{body}, clearance {} mm, {barrier}", short(1e3 * planner.clearance_m))));
        let observer = &self.observer;
        lines.push(line(
            "observer",
            format!(
                "K = {} EI/L, T_b = {} s, latency {} ticks",
                observer.stiffness_ratio,
                short(observer.disturbance_time_s),
                observer.latency_ticks
            ),
        ));
        if self.friction.coefficient > 0.0 {
            lines.push(line("friction", format!("mu = {} made up for", self.friction.coefficient)));
        }
        for (index, bus) in self.drives.buses.iter().enumerate() {
            let nodes: Vec<u8> =
                self.drives.drives.iter().filter(|drive| drive.bus == index).map(|drive| drive.node_id).collect();
            let range = match (nodes.iter().min(), nodes.iter().max()) {
                (Some(least), Some(most)) => format!("{} drives, nodes {least} to {most}", nodes.len()),
                _ => "no drives".to_owned(),
            };
            let kind = if bus.kind == BusKind::Virtual { "virtual" } else { "SocketCAN" };
            let rate = if bus.fd {
                let layout = if bus.layout == BusLayout::Packed { ", packed" } else { "" };
                format!("FD {} / {} kbit/s{layout}", bus.bitrate_bps / 1000, bus.data_bitrate_bps / 1000)
            } else {
                format!("{} kbit/s", bus.bitrate_bps / 1000)
            };
            let limit = 100.0 * bus.load_limit;
            lines.push(line(
                &format!("bus {}", bus.name),
                format!("{kind} {}, {rate}, {range}, load at most {limit:.0} %", bus.interface),
            ));
        }
        lines.push(line("services", format!("sinew/{}/...", self.ipc.arm)));
        lines
    }
}

impl ScenarioConfig {
    /// Summary of a scenario.
    pub fn summary(&self) -> Vec<SummaryLine> {
        let task = match &self.task {
            Task::Tip { .. } => "tip pose",
            Task::Shape { .. } => "mean curvatures",
        };
        let arm = format!("{}: {} segments, {} cables", self.arm.name, self.arm.segments.len(), self.arm.cable_count());
        vec![
            line("scenario", self.name.clone()),
            line("arm", arm),
            line("task", format!("{task}, {} s, {} obstacles", self.duration_s, self.obstacles.len())),
            line("step", format!("{} s, lookahead {} s", self.planner.period_s, self.planner.lookahead_s)),
        ]
    }
}
