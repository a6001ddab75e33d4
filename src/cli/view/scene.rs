//! What of an arm does not move, as the page draws it.
//!
//! Enters: the configuration. Leaves: radii, holes and bounds, as JSON. The page adds the nodes' poses of each frame to it.

use serde::Serialize;
use sinew::config::{ARMS, ArmConfig, Config};
use sinew::control::Limit;
use sinew::ipc::payload::{AlarmCode, PlannerBranch, PlannerStatus, SourceHealth, SupervisorState};
use sinew::model::Arm;
use std::collections::BTreeMap;

/// The arm and the bounds that it is held in.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Scene {
    /// Name of the arm.
    arm: String,
    /// Where its geometry is from, in words; null where it is not known and the nodes alone are drawn.
    source: Option<String>,
    geometry: Option<Geometry>,
    words: Words,
    /// What is looked at; null for a running daemon.
    recording: Option<Recording>,
}

/// A file, and the times of its first and last record (s).
#[derive(Debug, Clone, Serialize)]
struct Recording {
    file: String,
    span_s: [f64; 2],
}

/// Everything in the base frame or in the frame of a node, whose x axis is the backbone's tangent.
#[derive(Debug, Clone, Serialize)]
struct Geometry {
    /// Position (m) and quaternion `[w x y z]` of the base.
    base_position_m: [f64; 3],
    base_quaternion: [f64; 4],
    gravity_mps2: [f64; 3],
    /// From base to tip (m).
    length_m: f64,
    period_s: f64,
    /// Least distance that the planner keeps (m).
    clearance_m: f64,
    disks: Vec<Disk>,
    elements: Vec<Element>,
    cables: Vec<Cable>,
}

/// The disk at a node; the first is at the end of element 0.
#[derive(Debug, Clone, Serialize)]
struct Disk {
    segment: usize,
    radius_m: f64,
    thickness_m: f64,
}

#[derive(Debug, Clone, Serialize)]
struct Element {
    /// Length of the elastic part (m), and of the rigid connector before it.
    length_m: f64,
    connector_m: f64,
    backbone_radius_m: f64,
}

#[derive(Debug, Clone, Serialize)]
struct Cable {
    name: String,
    segment: usize,
    /// Least and largest tension (N).
    tension_n: [f64; 2],
    /// First node that it passes; 0 is the base.
    from: usize,
    /// Its hole at that node and at each one after it, along local y and z (m).
    holes_m: Vec<[f64; 2]>,
}

/// What the numbers of a frame mean.
#[derive(Debug, Clone, Serialize)]
struct Words {
    modes: Vec<&'static str>,
    health: Vec<&'static str>,
    planner: Vec<&'static str>,
    branch: Vec<&'static str>,
    limits: BTreeMap<u32, &'static str>,
    alarms: BTreeMap<u32, &'static str>,
}

impl Words {
    fn new() -> Self {
        Self {
            modes: SupervisorState::ALL.iter().map(|c| c.text()).collect(),
            health: SourceHealth::ALL.iter().map(|c| c.text()).collect(),
            planner: PlannerStatus::ALL.iter().map(|c| c.text()).collect(),
            branch: PlannerBranch::ALL.iter().map(|c| c.text()).collect(),
            limits: Limit::ALL.iter().map(|limit| (limit.code(), limit.text())).collect(),
            alarms: AlarmCode::ALL.iter().map(|alarm| (alarm.wire(), alarm.text())).collect(),
        }
    }
}

impl Scene {
    /// Of a configuration that was given.
    pub(super) fn of(config: &Config) -> Self {
        Self {
            arm: config.ipc.arm.clone(),
            source: Some("the configuration".into()),
            geometry: Some(Geometry::of(config)),
            words: Words::new(),
            recording: None,
        }
    }

    /// Of an arm whose name alone is known, with the configuration that the program has of that name.
    pub(super) fn named(arm: &str) -> (Self, Option<Config>) {
        let config = built_in(arm);
        let scene = Self {
            arm: arm.to_owned(),
            source: config.as_ref().map(|_| format!("the built-in arm `{arm}`")),
            geometry: config.as_ref().map(Geometry::of),
            words: Words::new(),
            recording: None,
        };
        (scene, config)
    }

    /// The same of a recording.
    pub(super) fn recorded(mut self, file: String, span_s: [f64; 2]) -> Self {
        self.recording = Some(Recording { file, span_s });
        self
    }
}

/// The built-in arm of a name.
fn built_in(name: &str) -> Option<Config> {
    let paper = Config::builtin();
    if paper.ipc.arm == name {
        return Some(paper);
    }
    let files = ARMS.iter().filter(|(file, _)| file.ends_with("/arm.toml"));
    let mut arms = files.filter_map(|(file, text)| ArmConfig::parse(file, text).ok());
    let arm = arms.find(|arm| arm.name == name)?;
    Config::of_arm(&arm, None).ok()
}

impl Geometry {
    fn of(config: &Config) -> Self {
        let (arm, model) = (&config.arm, Arm::new(&config.arm));
        let mut place = vec![0; arm.segments.len()];
        let disks = model.nodes.iter().map(|node| {
            let segment = &arm.segments[node.segment];
            place[node.segment] += 1;
            let share = place[node.segment] as f64 / segment.elements as f64;
            Disk {
                segment: node.segment,
                radius_m: segment.disk_radius_m * segment.taper.disk_radius.at(share, 1.0),
                thickness_m: segment.disk_thickness_m,
            }
        });
        let disks = disks.collect();
        let elements = model.elements.iter().map(|element| Element {
            length_m: element.length,
            connector_m: element.connector,
            backbone_radius_m: arm.segments[element.segment].backbone_radius_m,
        });
        let elements = elements.collect();
        let (names, maxima) = (arm.cable_names(), arm.tension_maxima_n());
        let cables = (0..model.cable_count()).map(|cable| {
            let mut passes = model.passes.iter().filter(|pass| pass.cable == cable);
            let mut holes_m: Vec<[f64; 2]> = passes.clone().map(|pass| [pass.hole.y, pass.hole.z]).collect();
            holes_m.extend(passes.next_back().map(|pass| [pass.end.y, pass.end.z]));
            Cable {
                name: names.words(cable),
                segment: model.cable_segment[cable],
                tension_n: [arm.tension_n_min, maxima[cable]],
                from: model.cable_elements[cable].start,
                holes_m,
            }
        });
        let cables = cables.collect();
        Self {
            base_position_m: arm.base_position_m,
            base_quaternion: arm.base_quaternion,
            gravity_mps2: arm.gravity_mps2,
            length_m: arm.length_m(),
            period_s: config.timing.period_s,
            clearance_m: config.planner.clearance_m,
            disks,
            elements,
            cables,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_arm_has_a_scene_whose_cables_run_from_hole_to_hole() {
        for (file, text) in ARMS.iter().filter(|(file, _)| file.ends_with("/arm.toml")) {
            let arm = ArmConfig::parse(file, text).unwrap();
            let (scene, config) = Scene::named(&arm.name);
            assert_eq!(config.unwrap().arm.name, arm.name);
            let geometry = scene.geometry.unwrap();
            assert_eq!((geometry.disks.len(), geometry.cables.len()), (arm.node_count(), arm.cable_count()), "{file}");
            for cable in &geometry.cables {
                let last = cable.from + cable.holes_m.len() - 1;
                assert!(last <= arm.node_count() && geometry.disks[last - 1].segment == cable.segment, "{file}");
                for (node, [y, z]) in (cable.from..).zip(&cable.holes_m).skip(1) {
                    let disk = geometry.disks[node - 1].radius_m;
                    assert!(y.hypot(*z) < 1.5 * disk, "{file}: a hole at {} m of a disk of {disk} m", y.hypot(*z));
                }
            }
        }
        assert!(Scene::named("nobody's").0.geometry.is_none());
    }
}
