//! A record of the loop as the page draws and plots it.
//!
//! Enters: a record, what the obstacle sources said last. Leaves: what people look at, as JSON; numbers that are not known
//! are null. Lengths in m, times of stages in us.

use serde::Serialize;
use sinew::config::CableNames;
use sinew::control::Limit;
use sinew::daemon::status::{FaultStatus, fault_status};
use sinew::ipc::payload::{ObstacleDistance, ObstacleKind, Obstacles, SourceHealth, SourceReport, State, TickTiming};
use std::collections::BTreeMap;

/// Time over which an obstacle is moved on by its velocity (s); a source that is silent for longer is in the alarms.
const AHEAD_MAX_S: f64 = 1.0;

#[derive(Debug, Serialize)]
pub(super) struct Frame {
    /// Time since the loop began (s), and its tick.
    t: f64,
    tick: u64,
    mode: u32,
    planner: u32,
    branch: u32,
    /// Position and quaternion `[w x y z]` of each node, one after the other.
    nodes: Vec<f32>,
    /// Node i is the arm's node `(i + 1) stride - 1`, the last one the tip.
    stride: u32,
    tip: [f64; 3],
    target: Option<Goal>,
    error_m: Option<f32>,
    quaternion_error: Option<f32>,
    curvature_error_1pm: Option<f32>,
    /// Tensions commanded and measured (N).
    command_n: Vec<f32>,
    measured_n: Vec<f32>,
    obstacles: Vec<Seen>,
    /// Smallest distance since the frame before, to surfaces and to what they are grown to.
    nearest_m: Option<f32>,
    nearest_grown_m: Option<f32>,
    /// The longest since the frame before.
    stages_us: Stages,
    left_out: u64,
    records_dropped: u64,
    speed: f32,
    swing_m: f32,
    limits: Vec<u32>,
    fault: Option<FaultStatus>,
    /// Code, subject, and time (s) since which it is on.
    alarms: Vec<(u32, u32, f64)>,
    sources: Vec<Source>,
}

#[derive(Debug, Serialize)]
struct Goal {
    position_m: [f32; 3],
    quaternion: [f32; 4],
}

/// An obstacle, as it was seen and as the loop takes it.
#[derive(Debug, Serialize)]
struct Seen {
    source: u32,
    id: u32,
    kind: &'static str,
    position_m: [f32; 3],
    quaternion: [f32; 4],
    dimensions_m: [f32; 3],
    #[serde(skip_serializing_if = "Vec::is_empty")]
    vertices_m: Vec<[f32; 3]>,
    /// Distance from the arm's surface; null for one that the loop does not know (yet, or any more).
    distance_m: Option<f32>,
    growth_m: f32,
}

#[derive(Debug, Serialize)]
struct Source {
    name: &'static str,
    id: u32,
    health: u32,
    age_s: Option<f64>,
    accepted: u64,
    rejected: u64,
}

#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Stages {
    wakeup: f32,
    input: f32,
    estimate: f32,
    plan: f32,
    guard: f32,
    send: f32,
    cycle: f32,
}

/// What was worst in the ticks that were seen since the frame before.
#[derive(Debug, Default)]
pub(super) struct Worst {
    /// Of the tick that took longest.
    slowest: Option<TickTiming>,
    nearest_m: Option<f64>,
    nearest_grown_m: Option<f64>,
}

impl Worst {
    /// Takes a record into account.
    pub(super) fn note(&mut self, state: &State) {
        if self.slowest.is_none_or(|slowest| state.timing.cycle_ns >= slowest.cycle_ns) {
            self.slowest = Some(state.timing);
        }
        for d in used_distances(state).iter().filter(|d| d.surface_distance_m.is_finite()) {
            let least = |known: Option<f64>, found: f64| Some(known.map_or(found, |known| known.min(found)));
            self.nearest_m = least(self.nearest_m, d.surface_distance_m);
            self.nearest_grown_m = least(self.nearest_grown_m, d.surface_distance_m - d.growth_m);
        }
    }
}

fn used_distances(state: &State) -> &[ObstacleDistance] {
    &state.distances[..(state.distance_count as usize).min(state.distances.len())]
}

fn known(x: f64) -> Option<f32> {
    x.is_finite().then_some(x as f32)
}

impl Frame {
    /// Whether both are of the same tick.
    pub(super) const fn is_at(&self, other: &Self) -> bool {
        self.tick == other.tick
    }

    /// Of the newest record; `worst` is that of all since the last frame, `sets` the last one of each source.
    pub(super) fn new(state: &State, worst: &Worst, sets: &BTreeMap<u32, Obstacles>, names: &CableNames) -> Self {
        let nodes = (state.node_count as usize).min(state.node_position_m.len());
        let cables = (state.cable_count as usize).min(state.tension_command_n.len());
        let pose = |i: usize| state.node_position_m[i].into_iter().chain(state.node_quaternion[i]).map(|x| x as f32);
        let has_target = state.target_position_m.iter().all(|x| x.is_finite());
        let alarms = state.alarms.iter().take(state.alarm_count as usize);
        let since_s = |ns: u64| state.time_s - state.header.capture_ns.saturating_sub(ns) as f64 * 1e-9;
        let obstacle_sources = state.obstacle_sources.iter().filter(|s| is_used(s)).map(|s| source("obstacles", s));
        let inputs = [("encoders", &state.encoder_report), ("target", &state.target_report)];
        let tip = is_used(&state.tip_report).then_some(("tip sensor", &state.tip_report));
        Self {
            t: state.time_s,
            tick: state.header.tick,
            mode: state.supervisor,
            planner: state.planner_status,
            branch: state.planner_branch,
            nodes: (0..nodes).flat_map(pose).collect(),
            stride: state.node_stride,
            tip: state.tip_position_m,
            target: has_target.then(|| Goal {
                position_m: state.target_position_m.map(|x| x as f32),
                quaternion: state.target_quaternion.map(|x| x as f32),
            }),
            error_m: known(state.tip_error_m),
            quaternion_error: known(state.quaternion_error),
            curvature_error_1pm: known(state.curvature_error_1pm),
            command_n: state.tension_command_n[..cables].iter().map(|u| *u as f32).collect(),
            measured_n: state.tension_measured_n[..cables].iter().map(|u| *u as f32).collect(),
            obstacles: sets.values().flat_map(|set| set.used().iter().map(|o| seen(o, set, state))).collect(),
            nearest_m: worst.nearest_m.and_then(known),
            nearest_grown_m: worst.nearest_grown_m.and_then(known),
            stages_us: worst.slowest.map_or_else(Stages::default, Stages::of),
            left_out: state.ticks_missed,
            records_dropped: state.records_dropped,
            speed: state.speed_scale as f32,
            swing_m: state.swing_m as f32,
            limits: Limit::ALL.iter().map(|l| l.code()).filter(|c| state.limits >> (c - 100) & 1 == 1).collect(),
            fault: fault_status(state, names),
            alarms: alarms.map(|a| (a.code, a.subject, since_s(a.since_ns))).collect(),
            sources: inputs
                .into_iter()
                .chain(tip)
                .map(|(name, report)| source(name, report))
                .chain(obstacle_sources)
                .collect(),
        }
    }
}

impl Stages {
    fn of(t: TickTiming) -> Self {
        let us = |ns: u64| (ns as f64 * 1e-3) as f32;
        Self {
            wakeup: us(t.wakeup_ns),
            input: us(t.input_ns),
            estimate: us(t.estimate_ns),
            plan: us(t.plan_ns),
            guard: us(t.guard_ns),
            send: us(t.send_ns),
            cycle: us(t.cycle_ns),
        }
    }
}

fn is_used(report: &SourceReport) -> bool {
    report.health != SourceHealth::Absent.wire() || report.source_id != 0 || report.rejected_total() > 0
}

fn source(name: &'static str, report: &SourceReport) -> Source {
    Source {
        name,
        id: report.source_id,
        health: report.health,
        age_s: report.age_s.is_finite().then_some(report.age_s),
        accepted: report.accepted,
        rejected: report.rejected_total(),
    }
}

/// Where it is at the record's time.
fn seen(obstacle: &sinew::ipc::payload::Obstacle, set: &Obstacles, state: &State) -> Seen {
    let (source, id) = (set.header.source_id, obstacle.id);
    let ahead_s = state.header.capture_ns.saturating_sub(set.header.capture_ns) as f64 * 1e-9;
    let ahead_s = ahead_s.min(AHEAD_MAX_S);
    let loops = used_distances(state).iter().find(|d| (d.source_id, d.obstacle_id) == (source, id));
    let from = obstacle.hull_offset as usize;
    let vertices = set.vertices_m.get(from..from.saturating_add(obstacle.hull_count as usize)).unwrap_or(&[]);
    let position = |i: usize| (obstacle.position_m[i] + obstacle.velocity_mps[i] * ahead_s) as f32;
    Seen {
        source,
        id,
        kind: ObstacleKind::from_wire(obstacle.kind).map_or("unknown", ObstacleKind::text),
        position_m: [position(0), position(1), position(2)],
        quaternion: obstacle.quaternion.map(|x| x as f32),
        dimensions_m: obstacle.dimensions_m.map(|x| x as f32),
        vertices_m: vertices.iter().map(|v| v.map(|x| x as f32)).collect(),
        distance_m: loops.and_then(|d| known(d.surface_distance_m)),
        growth_m: loops.map_or(0.0, |d| d.growth_m as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sinew::ipc::payload::{Header, Obstacle};

    #[test]
    fn a_frame_has_the_worst_of_its_ticks_and_obstacles_where_they_are_at_its_time() {
        let mut state = State { header: Header::new(0, 9, 2_500_000_000), time_s: 1.5, ..State::default() };
        let mut worst = Worst::default();
        for (cycle_ns, distance) in [(400_000, 0.3), (900_000, 0.2), (100_000, 0.25)] {
            state.timing = TickTiming { cycle_ns, plan_ns: cycle_ns / 2, ..TickTiming::default() };
            state.distance_count = 1;
            state.distances[0] =
                ObstacleDistance { source_id: 3, obstacle_id: 1, surface_distance_m: distance, growth_m: 0.01 };
            worst.note(&state);
        }
        let mut set = Obstacles { header: Header::new(3, 0, 2_000_000_000), ..Obstacles::default() };
        let moving = Obstacle { velocity_mps: [2.0, 0.0, 0.0], ..Obstacle::ball(1, [1.0, 0.0, 0.0], 0.1) };
        assert!(set.push(moving) && set.push(Obstacle::ball(2, [0.0; 3], 0.1)));
        let names = CableNames::new([3]);
        let frame = Frame::new(&state, &worst, &BTreeMap::from([(3, set)]), &names);
        assert_eq!((frame.stages_us.cycle, frame.stages_us.plan), (900.0, 450.0));
        assert_eq!((frame.nearest_m, frame.obstacles[0].distance_m), (Some(0.2), Some(0.25)));
        assert_eq!(frame.nearest_grown_m, Some((0.2f64 - 0.01) as f32));
        assert!((frame.obstacles[0].position_m[0] - 2.0).abs() < 1e-6);
        assert_eq!(frame.obstacles[1].distance_m, None, "the loop does not know it");
        assert!(frame.target.is_none() && frame.error_m.is_none());
        let text = serde_json::to_string(&frame).unwrap();
        assert!(text.contains("\"error_m\":null"), "{text}");
    }
}
