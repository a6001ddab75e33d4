//! What is published over the socket: a line of JSON for each set of obstacles or point of the desired motion.
//!
//! Names, shapes and units are those of the payloads of shared memory (`src/ipc/PAYLOADS.md`); what a line leaves out has
//! its default there. Without `capture_ns` the content is as old as the moment at which the daemon takes it.

use crate::ipc::payload::{FLAG_LEAVING, Header, NO_TICK, Obstacle, ObstacleKind, Obstacles, Target, TargetMode};
use serde::{Deserialize, Serialize};

/// A set of obstacles.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct SetLine {
    capture_ns: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    tick: Option<u64>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    leaving: bool,
    obstacles: Vec<ObstacleLine>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    vertices_m: Vec<[f64; 3]>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ObstacleLine {
    id: u32,
    kind: String,
    position_m: [f64; 3],
    #[serde(default = "unrotated")]
    quaternion: [f64; 4],
    #[serde(default)]
    velocity_mps: [f64; 3],
    dimensions_m: [f64; 3],
    #[serde(default)]
    covariance_m2: [f64; 6],
    #[serde(default)]
    hull_offset: u32,
    #[serde(default)]
    hull_count: u32,
}

const fn unrotated() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

impl SetLine {
    /// The line of a set.
    pub(super) fn of(set: &Obstacles) -> Self {
        let kind = |wire| ObstacleKind::from_wire(wire).map_or("unknown", ObstacleKind::text);
        let line = |o: &Obstacle| ObstacleLine {
            id: o.id,
            kind: kind(o.kind).into(),
            position_m: o.position_m,
            quaternion: o.quaternion,
            velocity_mps: o.velocity_mps,
            dimensions_m: o.dimensions_m,
            covariance_m2: o.covariance_m2,
            hull_offset: o.hull_offset,
            hull_count: o.hull_count,
        };
        Self {
            capture_ns: set.header.capture_ns,
            tick: (set.header.tick != NO_TICK).then_some(set.header.tick),
            leaving: set.flags & FLAG_LEAVING != 0,
            obstacles: set.used().iter().map(line).collect(),
            vertices_m: set.vertices_m.iter().take(set.vertex_count as usize).copied().collect(),
        }
    }

    /// The set, under an id and a number; why not, in words.
    pub(super) fn set(&self, source_id: u32, sequence: u64) -> Result<Box<Obstacles>, String> {
        let mut set = Box::<Obstacles>::default();
        set.header = header(source_id, sequence, self.capture_ns, self.tick);
        set.flags = if self.leaving { FLAG_LEAVING } else { 0 };
        let (vertices, most) = (self.vertices_m.len(), set.vertices_m.len());
        match set.vertices_m.get_mut(..vertices) {
            Some(places) => places.copy_from_slice(&self.vertices_m),
            None => return Err(format!("vertices_m: {vertices} vertices, at most {most}")),
        }
        set.vertex_count = vertices as u32;
        for o in &self.obstacles {
            let kind = ObstacleKind::ALL.iter().find(|kind| kind.text() == o.kind).ok_or_else(|| {
                let all: Vec<&str> = ObstacleKind::ALL.iter().map(|kind| kind.text()).collect();
                format!("kind: \"{}\", expected one of {}", o.kind, all.join(", "))
            })?;
            let obstacle = Obstacle {
                quaternion: o.quaternion,
                velocity_mps: o.velocity_mps,
                covariance_m2: o.covariance_m2,
                hull_offset: o.hull_offset,
                hull_count: o.hull_count,
                ..Obstacle::new(o.id, *kind, o.position_m, o.dimensions_m)
            };
            if !set.push(obstacle) {
                return Err(format!("obstacles: {}, at most {}", self.obstacles.len(), set.obstacles.len()));
            }
        }
        Ok(set)
    }
}

/// A point of the desired motion: a pose with `position_m` and `quaternion`, or a shape with `curvature_1pm`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct PointLine {
    capture_ns: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    tick: Option<u64>,
    valid_from_ns: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    position_m: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    quaternion: Option<[f64; 4]>,
    velocity_mps: [f64; 3],
    angular_velocity_radps: [f64; 3],
    #[serde(skip_serializing_if = "Vec::is_empty")]
    curvature_1pm: Vec<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    curvature_rate_1pms: Vec<f64>,
    weight: f64,
}

impl PointLine {
    /// The line of a point.
    pub(super) fn of(target: &Target) -> Self {
        let shape = target.mode == TargetMode::Shape.wire();
        let count = if shape { 2 * target.segment_count as usize } else { 0 };
        let part = |values: &[f64]| values.iter().take(count).copied().collect();
        Self {
            capture_ns: target.header.capture_ns,
            tick: (target.header.tick != NO_TICK).then_some(target.header.tick),
            valid_from_ns: target.valid_from_ns,
            position_m: (!shape).then_some(target.position_m),
            quaternion: (!shape).then_some(target.quaternion),
            velocity_mps: target.velocity_mps,
            angular_velocity_radps: target.angular_velocity_radps,
            curvature_1pm: part(&target.curvature_1pm),
            curvature_rate_1pms: part(&target.curvature_rate_1pms),
            weight: target.weight,
        }
    }

    /// The point, under an id and a number; why not, in words.
    pub(super) fn point(&self, source_id: u32, sequence: u64) -> Result<Box<Target>, String> {
        let mut target = Box::<Target>::default();
        target.header = header(source_id, sequence, self.capture_ns, self.tick);
        target.valid_from_ns = self.valid_from_ns;
        target.weight = self.weight;
        match (self.position_m, self.quaternion, self.curvature_1pm.len()) {
            (Some(position), Some(quaternion), 0) => {
                target.mode = TargetMode::Tip.wire();
                (target.position_m, target.quaternion) = (position, quaternion);
                target.velocity_mps = self.velocity_mps;
                target.angular_velocity_radps = self.angular_velocity_radps;
            }
            (None, None, count) if count > 0 && count.is_multiple_of(2) && count <= target.curvature_1pm.len() => {
                target.mode = TargetMode::Shape.wire();
                target.segment_count = (count / 2) as u32;
                target.curvature_1pm[..count].copy_from_slice(&self.curvature_1pm);
                match self.curvature_rate_1pms.len() {
                    0 => {}
                    rates if rates == count => {
                        target.curvature_rate_1pms[..count].copy_from_slice(&self.curvature_rate_1pms);
                    }
                    rates => return Err(format!("curvature_rate_1pms: {rates} numbers, expected {count}")),
                }
            }
            _ => return Err("expected position_m and quaternion, or curvature_1pm, two for each segment".into()),
        }
        Ok(target)
    }
}

fn header(source_id: u32, sequence: u64, capture_ns: u64, tick: Option<u64>) -> Header {
    Header::new(source_id, sequence, capture_ns).for_tick(tick.unwrap_or(NO_TICK))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_and_a_point_are_the_same_behind_their_lines() {
        let header = Header::new(7, 3, 55).for_tick(9);
        let mut set = Obstacles { header, flags: FLAG_LEAVING, ..Obstacles::default() };
        assert!(set.push(Obstacle { velocity_mps: [0.1, 0.2, 0.3], ..Obstacle::ball(4, [1.0, 2.0, 3.0], 0.5) }));
        let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!(set.push_hull(Obstacle { id: 5, ..Obstacle::default() }, &corners));
        let text = serde_json::to_string(&SetLine::of(&set)).unwrap();
        assert_eq!(*serde_json::from_str::<SetLine>(&text).unwrap().set(7, 3).unwrap(), set);

        let header = Header::new(7, 3, 55);
        let pose = Target { header, position_m: [0.1, 0.0, -2.0], valid_from_ns: 77, ..Target::default() };
        let mut shape = Target { mode: TargetMode::Shape.wire(), segment_count: 2, weight: 3.0, ..pose };
        (shape.position_m, shape.curvature_1pm[3]) = (Target::default().position_m, -0.5);
        for target in [pose, shape] {
            let text = serde_json::to_string(&PointLine::of(&target)).unwrap();
            assert_eq!(*serde_json::from_str::<PointLine>(&text).unwrap().point(7, 3).unwrap(), target, "{text}");
        }
    }

    #[test]
    fn an_empty_line_is_an_empty_set_and_what_is_wrong_is_named() {
        let set =
            |text: &str| serde_json::from_str::<SetLine>(text).map_err(|e| e.to_string()).and_then(|l| l.set(1, 0));
        assert_eq!(set("{}").unwrap().count, 0);
        let ball = |kind: &str| format!(r#"{{"id":1,"kind":"{kind}","position_m":[0,0,0],"dimensions_m":[1,0,0]}}"#);
        assert!(set(&format!(r#"{{"obstacles":[{}]}}"#, ball("bal"))).unwrap_err().contains("kind: \"bal\""));
        let many = vec![ball("ball"); 65].join(",");
        assert!(set(&format!(r#"{{"obstacles":[{many}]}}"#)).unwrap_err().contains("at most 64"));
        assert!(set(r#"{"obstacle":[]}"#).unwrap_err().contains("obstacle"));
        let point =
            |text: &str| serde_json::from_str::<PointLine>(text).map_err(|e| e.to_string()).and_then(|l| l.point(1, 0));
        assert!(point("{}").unwrap_err().contains("position_m"));
        assert!(point(r#"{"curvature_1pm":[1]}"#).unwrap_err().contains("curvature_1pm"));
        assert!(point(r#"{"curvature_1pm":[1,2],"curvature_rate_1pms":[1]}"#).unwrap_err().contains("expected 2"));
    }
}
