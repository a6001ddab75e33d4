//! A recording as frames: any part of it, at most so many, read by its index.
//!
//! Enters: a file, a range of times. Leaves: frames, evenly over the range. Of a range of a few seconds every record is there;
//! of a longer one some, whose times of stages and distances are their own and not the worst of those between them.

use super::frame::{Frame, Worst};
use serde::Deserialize;
use sinew::config::CableNames;
use sinew::ipc::payload::{
    AlarmRecord, FLAG_LEAVING, Header, Obstacle, ObstacleDistance, ObstacleKind, Obstacles, REJECT_CAUSES,
    SourceReport, State, TickTiming,
};
use sinew::recording::{IndexedFile, RawMessage, RecordingError};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

/// Bytes that are read in a piece at most; a longer range is looked into at as many places as there are frames.
const PIECE: u64 = 96 << 20;
/// How long before a record the obstacles that belong to it may be (ns).
const BEFORE_NS: u64 = 250_000_000;
/// How long after a place the next record may be (ns).
const AFTER_NS: u64 = 2_000_000_000;
/// Obstacle sets that may come between two records: one of each source.
const SETS: usize = 16;

/// A recording that is looked at.
#[derive(Debug)]
pub(super) struct Recorded {
    file: IndexedFile,
    names: CableNames,
    /// Times of the file's first record: in the file (ns), and since the loop began (s).
    origin: (u64, f64),
    /// Bytes that are read in a piece.
    piece: u64,
}

impl Recorded {
    /// Opens a file.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut file = IndexedFile::open(path)?;
        let mut origin = None;
        file.between(&["state"], 0..u64::MAX, |message| {
            origin = Some((message.time_ns, state(message)?.time_s));
            Ok(ControlFlow::Break(()))
        })?;
        let nothing = || RecordingError::Message { topic: "state".into(), why: "there is none".into() };
        Ok(Self { file, names: CableNames::new([]), origin: origin.ok_or_else(nothing)?, piece: PIECE })
    }

    /// Name of its arm.
    pub(super) fn arm(&self) -> &str {
        self.file.arm().unwrap_or("unknown")
    }

    /// Gives the cables the names of the arm.
    pub(super) fn name(&mut self, names: CableNames) {
        self.names = names;
    }

    /// Times of the first and of the last record, since the loop began (s).
    pub(super) fn span_s(&self) -> [f64; 2] {
        [self.origin.1, self.seconds(self.file.span_ns()[1])]
    }

    fn seconds(&self, time_ns: u64) -> f64 {
        self.origin.1 + time_ns.saturating_sub(self.origin.0) as f64 * 1e-9
    }

    fn ns(&self, time_s: f64) -> u64 {
        self.origin.0.saturating_add((1e9 * (time_s - self.origin.1).max(0.0)) as u64)
    }

    /// At most `most` frames of a range of times (s).
    pub(super) fn frames(&mut self, [from_s, to_s]: [f64; 2], most: usize) -> Result<Vec<Frame>, RecordingError> {
        let (from, to) = (self.ns(from_s), self.ns(to_s).saturating_add(1));
        let most = most.clamp(2, 4000);
        let step = (to.saturating_sub(from) / most as u64).max(1);
        if self.file.bytes(&(from..to)) <= self.piece {
            return self.read(from..to, step, most);
        }
        let mut frames: Vec<Frame> = Vec::with_capacity(most);
        for place in 0..most as u64 {
            let at = from + place * step;
            if let Some(frame) = self.read(at..at.saturating_add(AFTER_NS).min(to), u64::MAX, 1)?.pop()
                && frames.last().is_none_or(|last| !last.is_at(&frame))
            {
                frames.push(frame);
            }
        }
        Ok(frames)
    }

    /// The first record of a range, and then one whenever `step` (ns) have passed.
    fn read(&mut self, range: std::ops::Range<u64>, step: u64, most: usize) -> Result<Vec<Frame>, RecordingError> {
        let Self { file, names, .. } = self;
        let mut frames = Vec::new();
        let mut waiting: Vec<Obstacles> = Vec::new();
        let mut sets: BTreeMap<u32, Obstacles> = BTreeMap::new();
        let mut next = range.start;
        let topics = ["state", "obstacles"];
        file.between(&topics, range.start.saturating_sub(BEFORE_NS)..range.end, |message| {
            if !message.topic.ends_with("/state") {
                // What is long before the record that is taken next says nothing of it.
                if message.time_ns.saturating_add(BEFORE_NS) >= next {
                    waiting.push(obstacles(message)?);
                    if waiting.len() > SETS {
                        take_over(&mut waiting, &mut sets);
                    }
                }
                return Ok(ControlFlow::Continue(()));
            }
            if message.time_ns < next {
                return Ok(ControlFlow::Continue(()));
            }
            next = next.saturating_add(step).max(message.time_ns.saturating_add(step / 2));
            take_over(&mut waiting, &mut sets);
            let state = state(message)?;
            let mut worst = Worst::default();
            worst.note(&state);
            frames.push(Frame::new(&state, &worst, &sets, names));
            Ok(if frames.len() < most { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })
        })?;
        Ok(frames)
    }
}

fn take_over(waiting: &mut Vec<Obstacles>, sets: &mut BTreeMap<u32, Obstacles>) {
    for set in waiting.drain(..) {
        match set.flags & FLAG_LEAVING {
            0 => drop(sets.insert(set.header.source_id, set)),
            _ => drop(sets.remove(&set.header.source_id)),
        }
    }
}

/// A number that may be none.
type Maybe = Option<f64>;

fn number(x: Maybe) -> f64 {
    x.unwrap_or(f64::NAN)
}

fn numbers<const N: usize>(values: [Maybe; N]) -> [f64; N] {
    values.map(number)
}

#[derive(Deserialize)]
struct HeaderOf {
    source_id: u32,
    sequence: u64,
    capture_ns: u64,
    tick: u64,
}

impl HeaderOf {
    fn header(&self) -> Header {
        Header { tick: self.tick, ..Header::new(self.source_id, self.sequence, self.capture_ns) }
    }
}

#[derive(Deserialize)]
struct NodeOf {
    position_m: [Maybe; 3],
    quaternion: [Maybe; 4],
}

#[derive(Deserialize)]
struct DistanceOf {
    source_id: u32,
    obstacle_id: u32,
    surface_distance_m: Maybe,
    growth_m: Maybe,
}

#[derive(Default, Deserialize)]
struct SourceOf {
    source_id: u32,
    health: u32,
    age_s: Maybe,
    accepted: u64,
    rejected: Vec<u64>,
}

impl SourceOf {
    fn report(&self) -> SourceReport {
        let mut rejected = [0; REJECT_CAUSES];
        rejected.iter_mut().zip(&self.rejected).for_each(|(place, count)| *place = *count);
        SourceReport {
            source_id: self.source_id,
            health: self.health,
            age_s: self.age_s.unwrap_or(f64::INFINITY),
            accepted: self.accepted,
            rejected,
            ..SourceReport::default()
        }
    }
}

#[derive(Deserialize)]
struct TimingOf {
    wakeup_ns: u64,
    input_ns: u64,
    estimate_ns: u64,
    plan_ns: u64,
    guard_ns: u64,
    send_ns: u64,
    cycle_ns: u64,
}

#[derive(Deserialize)]
struct AlarmOf {
    code: u32,
    subject: u32,
    since_ns: u64,
}

/// What of a record is shown.
#[derive(Deserialize)]
struct StateOf {
    header: HeaderOf,
    time_s: f64,
    supervisor: u32,
    fault_code: u32,
    fault_detail: u32,
    planner_status: u32,
    planner_branch: u32,
    tension_command_n: Vec<Maybe>,
    tension_measured_n: Vec<Maybe>,
    tip_position_m: [Maybe; 3],
    target_position_m: [Maybe; 3],
    target_quaternion: [Maybe; 4],
    tip_error_m: Maybe,
    quaternion_error: Maybe,
    curvature_error_1pm: Maybe,
    node_stride: u32,
    nodes: Vec<NodeOf>,
    distances: Vec<DistanceOf>,
    obstacle_sources: Vec<SourceOf>,
    target_report: SourceOf,
    encoder_report: SourceOf,
    /// Recordings of before have none.
    #[serde(default)]
    tip_report: SourceOf,
    ticks_missed: u64,
    records_dropped: u64,
    timing: TimingOf,
    limits: u64,
    swing_m: Maybe,
    speed_scale: Maybe,
    fault_values: Vec<Maybe>,
    fault_flags: u32,
    alarms: Vec<AlarmOf>,
}

fn state(message: &RawMessage<'_>) -> Result<State, RecordingError> {
    let r: StateOf = message.decode()?;
    let t = &r.timing;
    let mut s = State {
        header: r.header.header(),
        time_s: r.time_s,
        supervisor: r.supervisor,
        fault_code: r.fault_code,
        fault_detail: r.fault_detail,
        planner_status: r.planner_status,
        planner_branch: r.planner_branch,
        cable_count: r.tension_command_n.len() as u32,
        node_count: r.nodes.len() as u32,
        node_stride: r.node_stride,
        distance_count: r.distances.len() as u32,
        tip_position_m: numbers(r.tip_position_m),
        target_position_m: numbers(r.target_position_m),
        target_quaternion: numbers(r.target_quaternion),
        tip_error_m: number(r.tip_error_m),
        quaternion_error: number(r.quaternion_error),
        curvature_error_1pm: number(r.curvature_error_1pm),
        target_report: r.target_report.report(),
        encoder_report: r.encoder_report.report(),
        tip_report: r.tip_report.report(),
        ticks_missed: r.ticks_missed,
        records_dropped: r.records_dropped,
        timing: TickTiming {
            wakeup_ns: t.wakeup_ns,
            input_ns: t.input_ns,
            estimate_ns: t.estimate_ns,
            plan_ns: t.plan_ns,
            guard_ns: t.guard_ns,
            send_ns: t.send_ns,
            cycle_ns: t.cycle_ns,
        },
        limits: r.limits,
        swing_m: number(r.swing_m),
        speed_scale: number(r.speed_scale),
        fault_flags: r.fault_flags,
        alarm_count: r.alarms.len() as u32,
        ..State::default()
    };
    s.tension_command_n.iter_mut().zip(r.tension_command_n).for_each(|(place, x)| *place = number(x));
    s.tension_measured_n.iter_mut().zip(r.tension_measured_n).for_each(|(place, x)| *place = number(x));
    s.fault_values.iter_mut().zip(r.fault_values).for_each(|(place, x)| *place = number(x));
    for (i, node) in r.nodes.into_iter().enumerate().take(s.node_position_m.len()) {
        (s.node_position_m[i], s.node_quaternion[i]) = (numbers(node.position_m), numbers(node.quaternion));
    }
    for (place, d) in s.distances.iter_mut().zip(r.distances) {
        *place = ObstacleDistance {
            source_id: d.source_id,
            obstacle_id: d.obstacle_id,
            surface_distance_m: number(d.surface_distance_m),
            growth_m: number(d.growth_m),
        };
    }
    s.obstacle_sources.iter_mut().zip(&r.obstacle_sources).for_each(|(place, source)| *place = source.report());
    for (place, a) in s.alarms.iter_mut().zip(r.alarms) {
        *place = AlarmRecord { code: a.code, subject: a.subject, since_ns: a.since_ns };
    }
    Ok(s)
}

#[derive(Deserialize)]
struct ObstacleOf {
    id: u32,
    kind: u32,
    position_m: [Maybe; 3],
    quaternion: [Maybe; 4],
    velocity_mps: [Maybe; 3],
    dimensions_m: [Maybe; 3],
    vertices_m: Vec<Maybe>,
}

#[derive(Deserialize)]
struct ObstaclesOf {
    header: HeaderOf,
    flags: u32,
    obstacles: Vec<ObstacleOf>,
}

fn obstacles(message: &RawMessage<'_>) -> Result<Obstacles, RecordingError> {
    let r: ObstaclesOf = message.decode()?;
    let mut set = Obstacles { header: r.header.header(), flags: r.flags, ..Obstacles::default() };
    for o in r.obstacles {
        let kind = ObstacleKind::from_wire(o.kind).unwrap_or(ObstacleKind::Ball);
        let obstacle = Obstacle {
            kind: o.kind,
            quaternion: numbers(o.quaternion),
            velocity_mps: numbers(o.velocity_mps),
            ..Obstacle::new(o.id, kind, numbers(o.position_m), numbers(o.dimensions_m))
        };
        let vertices: Vec<[f64; 3]> = o.vertices_m.as_chunks::<3>().0.iter().map(|v| numbers(*v)).collect();
        // A set that was recorded had room for them.
        let _ = if vertices.is_empty() { set.push(obstacle) } else { set.push_hull(obstacle, &vertices) };
    }
    Ok(set)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sinew::recording::{About, Recording};

    /// 20 s at 1 kHz from 5 s after the loop's begin on, with a tip and an obstacle that move.
    fn recorded(folder: &Path) -> Recorded {
        let path = folder.join("run.mcap");
        let mut file = Recording::create(&path, &About::new("paper")).unwrap();
        for tick in 5_000..25_000u64 {
            let time_ns = 1_000_000 * tick;
            let (header, time_s) = (Header { tick, ..Header::new(0, tick, time_ns) }, 1e-3 * tick as f64);
            let mut state = State { header, time_s, tip_position_m: [time_s, 0.0, -1.0], ..State::default() };
            state.set_nodes(3, |i| [i as f64, 0.0, time_s], |_| [1.0, 0.0, 0.0, 0.0]);
            (state.cable_count, state.distance_count) = (2, 1);
            state.tension_command_n[1] = 7.0;
            state.tension_measured_n[1] = f64::NAN;
            state.distances[0] =
                ObstacleDistance { source_id: 3, obstacle_id: 1, surface_distance_m: 0.5, growth_m: 0.1 };
            if tick % 25 == 0 {
                let mut set = Obstacles { header: Header::new(3, tick, time_ns), ..Obstacles::default() };
                let ball = Obstacle::ball(1, [0.0, time_s, 0.0], 0.1);
                assert!(set.push(Obstacle { velocity_mps: [0.0, 1.0, 0.0], ..ball }));
                file.obstacles(time_ns, &set).unwrap();
            }
            file.state(time_ns, &state).unwrap();
        }
        drop(file.finish().unwrap());
        Recorded::open(&path).unwrap()
    }

    #[test]
    fn frames_are_the_records_of_their_times_read_through_or_looked_up() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorded = recorded(folder.path());
        let [first, last] = recorded.span_s();
        assert_eq!((recorded.arm(), first), ("paper", 5.0));
        assert!((last - 24.999).abs() < 1e-9);
        for piece in [PIECE, 1] {
            recorded.piece = piece;
            for (from, to, most, count) in [(5.0, 24.999, 100, 100), (12.0, 12.0495, 1000, 50), (24.9, 30.0, 10, 1)] {
                let frames = recorded.frames([from, to], most).unwrap();
                assert!(frames.len() == count || count == 1 && !frames.is_empty(), "{piece} {from}: {}", frames.len());
                let json = serde_json::to_value(&frames).unwrap();
                for (i, frame) in json.as_array().unwrap().iter().enumerate() {
                    let t = frame["t"].as_f64().unwrap();
                    let wanted = from + (to - from) * i as f64 / most.min(count) as f64;
                    assert!(
                        count == 1 || (t - wanted).abs() < 0.01 * (to - from) + 1.1e-3,
                        "{piece}: {t} for {wanted}"
                    );
                    assert_eq!(frame["tip"][0].as_f64(), Some(t));
                    assert_eq!(frame["nodes"].as_array().unwrap().len(), 21);
                    assert_eq!((&frame["command_n"][1], frame["measured_n"][1].is_null()), (&7.0.into(), true));
                    let y = frame["obstacles"][0]["position_m"][1].as_f64().unwrap();
                    assert!((y - t).abs() < 1e-3, "{piece}: an obstacle at {y} at {t}");
                    assert_eq!(frame["obstacles"][0]["distance_m"].as_f64(), Some(0.5));
                }
            }
        }
    }
}
