//! What viewers are shown: the arm, its target and the obstacles as `foxglove.SceneUpdate`, frames as
//! `foxglove.FrameTransforms`, events in words as `foxglove.Log`, and, a third as often, the picture as
//! `foxglove.PointCloud`, in protobuf with the schemas of the crate `foxglove`.
//!
//! Enters: the encoded messages of a recording, on its thread. Leaves: messages for viewers, at most so many a second of
//! recorded time, each whole: whoever jumps to a time finds everything in the last one.

use super::cdr::{Fields, schema};
use super::decode::Decoder;
use super::shapes::{add_with_growth, unit};
use crate::config::{ArmConfig, CableNames};
use crate::ipc::Event;
use crate::ipc::payload::{Obstacles, State, SupervisorState, TargetMode};
use foxglove::Encode;
use foxglove::messages::{
    Color, CylinderPrimitive, FrameTransform, FrameTransforms, KeyValuePair, LinePrimitive, Log, Point3, PointCloud,
    Pose, Quaternion, SceneEntity, SceneEntityDeletion, SceneUpdate, SpherePrimitive, TextPrimitive, Timestamp,
    Vector3 as Vector,
};
use foxglove::messages::{line_primitive, log, scene_entity_deletion};
use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;

/// How grave an event is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Ordinary work.
    Info,
    /// The arm waits, holds or refuses.
    Warning,
    /// A fault.
    Error,
}

/// An event as a recording has it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Happened {
    /// Time of the loop (ns).
    pub time_ns: u64,
    /// Tick.
    pub tick: u64,
    /// Code of its kind.
    pub code: u32,
    /// Number that belongs to it, by code.
    pub detail: u32,
    /// Bits that belong to it.
    pub flags: u32,
    /// Number that belongs to it; NaN where there is none.
    pub value: f64,
    /// Another one.
    pub second: f64,
    /// What happened, in fixed words.
    pub text: String,
}

/// An event in the words of an arm.
pub type Words = fn(&Happened, &CableNames) -> (Severity, String);

/// A topic for viewers, in the order of their channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topic {
    Scene,
    Transforms,
    Log,
    Points,
}

impl Topic {
    pub(super) const ALL: [Self; 4] = [Self::Scene, Self::Transforms, Self::Log, Self::Points];

    /// Last part of its name.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Transforms => "transforms",
            Self::Log => "log",
            Self::Points => "points",
        }
    }

    pub(super) fn schema(self) -> Option<foxglove::Schema> {
        match self {
            Self::Scene => SceneUpdate::get_schema(),
            Self::Transforms => FrameTransforms::get_schema(),
            Self::Log => Log::get_schema(),
            Self::Points => PointCloud::get_schema(),
        }
    }
}

/// What stands at a node of the arm.
#[derive(Debug, Clone, Copy)]
struct Disk {
    radius_m: f64,
    thickness_m: f64,
    /// Segment (0-based).
    segment: usize,
    /// Whether the segment ends here.
    ends: bool,
}

/// What does not change in what viewers are shown: the arm, and the names of things.
#[derive(Debug, Clone)]
pub struct Viewer {
    arm: String,
    base: ([f64; 3], [f64; 4]),
    length_m: f64,
    backbone_radius_m: f64,
    disks: Vec<Disk>,
    cables: CableNames,
    period_ns: u64,
    names: BTreeMap<(u32, u32), String>,
    words: Option<Words>,
}

impl Viewer {
    /// Of an arm, as so many pictures a second of recorded time; `None` for 0.
    pub fn new(arm: &ArmConfig, pictures_1ps: u32) -> Option<Self> {
        let period_ns = 1_000_000_000_u64.checked_div(u64::from(pictures_1ps))?;
        let of = |(segment, s): (usize, &crate::config::SegmentConfig)| {
            let (taper, elements) = (s.taper.disk_radius.clone(), s.elements);
            let (radius_m, thickness_m) = (s.disk_radius_m, s.disk_thickness_m);
            (1..=elements).map(move |place| Disk {
                radius_m: radius_m * taper.at(place as f64 / elements as f64, 1.0),
                thickness_m,
                segment,
                ends: place == elements,
            })
        };
        Some(Self {
            arm: arm.name.clone(),
            base: (arm.base_position_m, arm.base_quaternion),
            length_m: arm.length_m(),
            backbone_radius_m: arm.segments.iter().map(|s| s.backbone_radius_m).fold(0.0, f64::max),
            disks: arm.segments.iter().enumerate().flat_map(of).collect(),
            cables: arm.cable_names(),
            period_ns,
            names: BTreeMap::new(),
            words: None,
        })
    }

    /// With the name of an obstacle of a source.
    #[must_use]
    pub fn naming(mut self, source_id: u32, obstacle_id: u32, name: &str) -> Self {
        self.names.insert((source_id, obstacle_id), name.to_owned());
        self
    }

    /// With words for events, which are then written as a log.
    #[must_use]
    pub fn telling(mut self, words: Words) -> Self {
        self.words = Some(words);
        self
    }

    fn name(&self, source_id: u32, obstacle_id: u32) -> String {
        let known = self.names.get(&(source_id, obstacle_id));
        known.cloned().unwrap_or_else(|| format!("obstacle {obstacle_id} of source {source_id}"))
    }
}

#[derive(Deserialize)]
struct SeenHeader {
    capture_ns: u64,
}

#[derive(Deserialize)]
struct SeenNode {
    position_m: [f64; 3],
    quaternion: [f64; 4],
}

#[derive(Deserialize)]
struct SeenDistance {
    source_id: u32,
    obstacle_id: u32,
    surface_distance_m: f64,
    growth_m: f64,
}

#[derive(Deserialize)]
struct SeenSource {
    source_id: u32,
}

/// What of a state is drawn.
#[derive(Deserialize)]
struct SeenState {
    header: SeenHeader,
    supervisor: u32,
    fault_code: u32,
    target_mode: u32,
    target_position_m: [f64; 3],
    target_quaternion: [f64; 4],
    node_stride: u32,
    nodes: Vec<SeenNode>,
    distances: Vec<SeenDistance>,
    obstacle_sources: Vec<SeenSource>,
}

/// An obstacle of a set.
#[derive(Deserialize)]
pub(super) struct SeenObstacle {
    id: u32,
    pub(super) kind: u32,
    position_m: [f64; 3],
    pub(super) quaternion: [f64; 4],
    velocity_mps: [f64; 3],
    pub(super) dimensions_m: [f64; 3],
    pub(super) vertices_m: Vec<f64>,
}

#[derive(Deserialize)]
struct SeenSet {
    header: SeenHeader,
    obstacles: Vec<SeenObstacle>,
}

/// Makes a recording's messages for viewers, one file long.
pub(super) struct Shown {
    viewer: Viewer,
    states: Decoder,
    sets: Decoder,
    events: Decoder,
    /// Last set of each source, as it came.
    newest: BTreeMap<u32, Vec<u8>>,
    /// What viewers know by now.
    drawn: BTreeSet<String>,
    due_ns: Option<u64>,
    pictures: u64,
}

/// Pictures for each one in points.
const PER_CLOUD: u64 = 3;

/// A message for viewers.
type Made = (Topic, Vec<u8>);

impl Shown {
    pub(super) fn new(viewer: Viewer) -> Result<Self, String> {
        fn of<T: Fields>() -> Result<Decoder, String> {
            Decoder::new(&schema::<T>())
        }
        let (states, sets, events) = (of::<State>()?, of::<Obstacles>()?, of::<Event>()?);
        Ok(Self {
            viewer,
            states,
            sets,
            events,
            newest: BTreeMap::new(),
            drawn: BTreeSet::new(),
            due_ns: None,
            pictures: 0,
        })
    }

    pub(super) fn obstacles(&mut self, data: &[u8]) {
        // Behind the encapsulation and the schema's version.
        let source = data.get(8..12).and_then(|bytes| bytes.try_into().ok()).map(u32::from_le_bytes);
        let Some(source) = source else { return };
        let kept = self.newest.entry(source).or_default();
        kept.clear();
        kept.extend_from_slice(data);
    }

    pub(super) fn event(&self, time_ns: u64, data: &[u8]) -> Result<Option<Made>, String> {
        let Some(words) = self.viewer.words else { return Ok(None) };
        let (severity, message) = words(&self.events.decode(data)?, &self.viewer.cables);
        let level = match severity {
            Severity::Info => log::Level::Info,
            Severity::Warning => log::Level::Warning,
            Severity::Error => log::Level::Error,
        };
        let name = format!("sinew {}", self.viewer.arm);
        let log = Log { timestamp: stamp(time_ns), level: level as i32, message, name, file: String::new(), line: 0 };
        made(Topic::Log, &log).map(Some)
    }

    /// What a state shows, where a picture is due.
    pub(super) fn state(&mut self, time_ns: u64, data: &[u8]) -> Result<Vec<Made>, String> {
        if self.due_ns.is_some_and(|due_ns| time_ns < due_ns) {
            return Ok(Vec::new());
        }
        // In step with the first one, however the ticks fall.
        let period_ns = self.viewer.period_ns;
        self.due_ns = Some(match self.due_ns {
            Some(due_ns) if time_ns < due_ns.saturating_add(period_ns) => due_ns + period_ns,
            _ => time_ns.saturating_add(period_ns),
        });
        let state: SeenState = self.states.decode(data)?;
        let transforms = self.transforms(time_ns, &state);
        let scene = self.scene(time_ns, &state)?;
        let mut list = vec![made(Topic::Transforms, &transforms)?, made(Topic::Scene, &scene)?];
        if self.pictures.is_multiple_of(PER_CLOUD) {
            list.push(made(Topic::Points, &super::cloud::of_scene(&scene, &self.viewer.arm))?);
        }
        self.pictures += 1;
        Ok(list)
    }

    fn frame(&self, part: &str) -> String {
        format!("{}/{part}", self.viewer.arm)
    }

    fn disk(&self, state: &SeenState, index: usize) -> Option<Disk> {
        let last = index + 1 == state.nodes.len();
        let place = (index + 1) * state.node_stride.max(1) as usize;
        self.viewer.disks.get(place.wrapping_sub(1)).or(self.viewer.disks.last().filter(|_| last)).copied()
    }

    fn transforms(&self, time_ns: u64, state: &SeenState) -> FrameTransforms {
        let transform = |part: &str, position: [f64; 3], quaternion: [f64; 4]| FrameTransform {
            timestamp: stamp(time_ns),
            parent_frame_id: self.viewer.arm.clone(),
            child_frame_id: self.frame(part),
            translation: Some(size(position)),
            rotation: Some(rotation(unit(quaternion))),
        };
        let (position, quaternion) = self.viewer.base;
        let mut transforms = vec![transform("base", position, quaternion)];
        for (index, node) in state.nodes.iter().enumerate() {
            let Some(disk) = self.disk(state, index) else { continue };
            if disk.ends && index + 1 < state.nodes.len() {
                transforms.push(transform(&format!("segment {}", disk.segment + 1), node.position_m, node.quaternion));
            }
        }
        transforms.extend(state.nodes.last().map(|tip| transform("tip", tip.position_m, tip.quaternion)));
        if state.target_mode == TargetMode::Tip.wire() && state.target_position_m.iter().all(|x| x.is_finite()) {
            transforms.push(transform("target", state.target_position_m, state.target_quaternion));
        }
        FrameTransforms { transforms }
    }

    fn scene(&mut self, time_ns: u64, state: &SeenState) -> Result<SceneUpdate, String> {
        let mut entities = vec![self.arm(time_ns, state)];
        // What has no words for events has no modes.
        entities.extend(self.viewer.words.map(|_| self.words(time_ns, state)));
        if state.target_mode == TargetMode::Tip.wire() && state.target_position_m.iter().all(|x| x.is_finite()) {
            entities.push(self.target(time_ns, state));
        }
        // One that was forgotten is gone; the planner's own obstacles have no source.
        let heard = |source: u32| source == 0 || state.obstacle_sources.iter().any(|s| s.source_id == source);
        for (source, data) in self.newest.iter().filter(|(source, _)| heard(**source)) {
            let set: SeenSet = self.sets.decode(data)?;
            let age_s = state.header.capture_ns.saturating_sub(set.header.capture_ns) as f64 * 1e-9;
            for obstacle in &set.obstacles {
                entities.push(self.obstacle(time_ns, state, *source, obstacle, age_s));
            }
        }
        let drawn: BTreeSet<String> = entities.iter().map(|entity| entity.id.clone()).collect();
        let gone = |id: &String| SceneEntityDeletion {
            timestamp: stamp(time_ns),
            r#type: scene_entity_deletion::Type::MatchingId as i32,
            id: id.clone(),
        };
        let deletions = self.drawn.difference(&drawn).map(gone).collect();
        self.drawn = drawn;
        Ok(SceneUpdate { deletions, entities })
    }

    fn entity(&self, time_ns: u64, id: String) -> SceneEntity {
        SceneEntity { timestamp: stamp(time_ns), frame_id: self.viewer.arm.clone(), id, ..SceneEntity::default() }
    }

    fn arm(&self, time_ns: u64, state: &SeenState) -> SceneEntity {
        let mut entity = self.entity(time_ns, "arm".into());
        let (base, base_quaternion) = self.viewer.base;
        let points = std::iter::once(base).chain(state.nodes.iter().map(|node| node.position_m));
        let backbone = color([0.35, 0.38, 0.42, 1.0]);
        entity.lines.push(LinePrimitive {
            r#type: line_primitive::Type::LineStrip as i32,
            pose: Some(pose(Vector3::zeros(), UnitQuaternion::identity())),
            thickness: (2.0 * self.viewer.backbone_radius_m).max(0.002 * self.viewer.length_m),
            scale_invariant: false,
            points: points.map(|[x, y, z]| Point3 { x, y, z }).collect(),
            color: Some(backbone),
            colors: Vec::new(),
            indices: Vec::new(),
        });
        let faulted = state.fault_code != 0;
        let shade = |segment: usize| match (faulted, segment % 2) {
            (true, _) => color([0.85, 0.15, 0.15, 0.9]),
            (false, 0) => color([0.25, 0.5, 0.8, 0.9]),
            (false, _) => color([0.45, 0.7, 0.9, 0.9]),
        };
        // A cylinder stands along its own z, the backbone along a node's x.
        let lay = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2);
        let mut disk = |position_m: [f64; 3], quaternion: [f64; 4], disk: Disk, color: Color| {
            entity.cylinders.push(CylinderPrimitive {
                pose: Some(pose(position_m.into(), unit(quaternion) * lay)),
                size: Some(size([2.0 * disk.radius_m, 2.0 * disk.radius_m, disk.thickness_m])),
                bottom_scale: 1.0,
                top_scale: 1.0,
                color: Some(color),
            });
        };
        // The base is a disk like the first one, twice as thick.
        if let Some(first) = self.viewer.disks.first() {
            let plate = Disk { thickness_m: 2.0 * first.thickness_m, ..*first };
            disk(base, base_quaternion, plate, backbone);
        }
        for (index, node) in state.nodes.iter().enumerate() {
            if let Some(there) = self.disk(state, index) {
                disk(node.position_m, node.quaternion, there, shade(there.segment));
            }
        }
        entity
    }

    fn words(&self, time_ns: u64, state: &SeenState) -> SceneEntity {
        let mut entity = self.entity(time_ns, "mode".into());
        let mode = SupervisorState::from_wire(state.supervisor).map_or("unknown", SupervisorState::text);
        let (base, _) = self.viewer.base;
        let beside = Vector3::from(base) + Vector3::new(0.0, 0.0, 0.12 * self.viewer.length_m);
        entity.texts.push(self.text(format!("{}: {mode}", self.viewer.arm), beside, [0.9, 0.9, 0.9, 1.0]));
        entity
    }

    fn text(&self, text: String, at: Vector3<f64>, shade: [f64; 4]) -> TextPrimitive {
        TextPrimitive {
            pose: Some(pose(at, UnitQuaternion::identity())),
            billboard: true,
            font_size: 0.025 * self.viewer.length_m,
            scale_invariant: false,
            color: Some(color(shade)),
            text,
        }
    }

    fn target(&self, time_ns: u64, state: &SeenState) -> SceneEntity {
        let mut entity = self.entity(time_ns, "target".into());
        let radius_m = 0.01 * self.viewer.length_m;
        let green = color([0.2, 0.8, 0.3, 0.8]);
        let (at, turn) = (Vector3::from(state.target_position_m), unit(state.target_quaternion));
        entity.spheres.push(SpherePrimitive {
            pose: Some(pose(at, UnitQuaternion::identity())),
            size: Some(size([2.0 * radius_m; 3])),
            color: Some(green),
        });
        // Where the tip is to point.
        let ahead = turn * Vector3::new(6.0 * radius_m, 0.0, 0.0);
        entity.lines.push(LinePrimitive {
            r#type: line_primitive::Type::LineStrip as i32,
            pose: Some(pose(at, UnitQuaternion::identity())),
            thickness: 0.4 * radius_m,
            scale_invariant: false,
            points: vec![Point3 { x: 0.0, y: 0.0, z: 0.0 }, Point3 { x: ahead.x, y: ahead.y, z: ahead.z }],
            color: Some(green),
            colors: Vec::new(),
            indices: Vec::new(),
        });
        entity
    }

    fn obstacle(&self, time_ns: u64, state: &SeenState, source: u32, o: &SeenObstacle, age_s: f64) -> SceneEntity {
        let mut entity = self.entity(time_ns, format!("obstacle {source}/{}", o.id));
        let known = state.distances.iter().find(|d| (d.source_id, d.obstacle_id) == (source, o.id));
        let at = Vector3::from(o.position_m) + age_s * Vector3::from(o.velocity_mps);
        let name = self.viewer.name(source, o.id);
        add_with_growth(&mut entity, o, at, known.map_or(0.0, |d| d.growth_m), self.viewer.length_m);
        let note = |key: &str, value: String| KeyValuePair { key: key.into(), value };
        entity.metadata = vec![note("name", name.clone())];
        let mut label = name;
        if let Some(distance) = known.map(|d| d.surface_distance_m).filter(|d| d.is_finite()) {
            label = format!("{label}, {:.0} mm", 1e3 * distance);
            entity.metadata.push(note("surface_distance_m", format!("{distance}")));
        }
        entity.texts.push(self.text(label, at, [1.0, 0.85, 0.6, 1.0]));
        entity
    }
}

fn made<T: Encode>(topic: Topic, message: &T) -> Result<Made, String> {
    let mut data = Vec::with_capacity(message.encoded_len().unwrap_or(0));
    message.encode(&mut data).map_err(|e| e.to_string())?;
    Ok((topic, data))
}

fn stamp(time_ns: u64) -> Option<Timestamp> {
    let seconds = u32::try_from(time_ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new_checked(seconds, (time_ns % 1_000_000_000) as u32)
}

pub(super) fn color([r, g, b, a]: [f64; 4]) -> Color {
    Color { r, g, b, a }
}

pub(super) fn size([x, y, z]: [f64; 3]) -> Vector {
    Vector { x, y, z }
}

fn rotation(turn: UnitQuaternion<f64>) -> Quaternion {
    Quaternion { x: turn.i, y: turn.j, z: turn.k, w: turn.w }
}

/// Place and turn of a pose; the origin's without one.
pub(super) fn rotation_of(pose: Option<Pose>) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let Pose { position, orientation } = pose.unwrap_or_default();
    let at = position.map_or(Vector3::zeros(), |p| Vector3::new(p.x, p.y, p.z));
    (at, orientation.map_or_else(UnitQuaternion::identity, |q| unit([q.w, q.x, q.y, q.z])))
}

pub(super) fn pose(at: Vector3<f64>, turn: UnitQuaternion<f64>) -> Pose {
    Pose { position: Some(size(at.into())), orientation: Some(rotation(turn)) }
}
