//! The same picture as points, for viewers that draw clouds of points and no scenes (Rerun).

use super::viewer::rotation_of;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{Color, PackedElementField, PointCloud, Pose, SceneUpdate, Vector3 as Vector};
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::{PI, TAU};

/// Points of a ball, and of each end of a cylinder.
const BALL: u32 = 32;
/// See [`BALL`].
const RIM: u32 = 6;
/// Bytes of a point: three coordinates as `f32`, four of its colour.
const STRIDE: u32 = 16;

/// Surfaces of a scene as points. What is drawn to be looked through is left out.
pub(super) fn of_scene(scene: &SceneUpdate, frame: &str) -> PointCloud {
    let mut points = Points::default();
    for entity in &scene.entities {
        for s in entity.spheres.iter().filter(|s| is_solid(s.color)) {
            points.of(s.pose, s.size, s.color, (0..BALL).map(on_ball));
        }
        for c in entity.cylinders.iter().filter(|c| is_solid(c.color)) {
            points.of(c.pose, c.size, c.color, (0..2 * RIM).map(on_rims));
        }
        for c in entity.cubes.iter().filter(|c| is_solid(c.color)) {
            points.of(c.pose, c.size, c.color, (0..27).filter(|k| *k != 13).map(on_cube));
        }
        for t in entity.triangles.iter().filter(|t| is_solid(t.color)) {
            points.of(t.pose, None, t.color, t.points.iter().map(|p| Vector3::new(p.x, p.y, p.z)));
        }
        for l in &entity.lines {
            points.of(l.pose, None, l.color, l.points.iter().map(|p| Vector3::new(p.x, p.y, p.z)));
        }
    }
    let field = |name: &str, offset: u32, kind: NumericType| PackedElementField {
        name: name.into(),
        offset,
        r#type: kind as i32,
    };
    let (number, byte) = (NumericType::Float32, NumericType::Uint8);
    PointCloud {
        timestamp: scene.entities.first().and_then(|entity| entity.timestamp),
        frame_id: frame.to_owned(),
        pose: Some(super::viewer::pose(Vector3::zeros(), UnitQuaternion::identity())),
        point_stride: STRIDE,
        fields: vec![
            field("x", 0, number),
            field("y", 4, number),
            field("z", 8, number),
            field("red", 12, byte),
            field("green", 13, byte),
            field("blue", 14, byte),
            field("alpha", 15, byte),
        ],
        data: points.data.into(),
    }
}

fn is_solid(color: Option<Color>) -> bool {
    color.is_some_and(|color| color.a > 0.5)
}

#[derive(Default)]
struct Points {
    data: Vec<u8>,
}

impl Points {
    /// Adds points of a body of edge 1, or, without a size, points as they are.
    fn of(
        &mut self,
        pose: Option<Pose>,
        size: Option<Vector>,
        color: Option<Color>,
        points: impl Iterator<Item = Vector3<f64>>,
    ) {
        let (at, turn) = rotation_of(pose);
        let size = size.map_or(Vector3::repeat(1.0), |s| Vector3::new(s.x, s.y, s.z));
        let color = color.map_or([255; 4], |c| [c.r, c.g, c.b, c.a].map(|part| (255.0 * part).round() as u8));
        for point in points {
            let p = at + turn * point.component_mul(&size);
            [p.x, p.y, p.z].iter().for_each(|x| self.data.extend_from_slice(&(*x as f32).to_le_bytes()));
            self.data.extend_from_slice(&color);
        }
    }
}

/// Evenly spread (Fibonacci's spiral), diameter 1.
fn on_ball(k: u32) -> Vector3<f64> {
    let z = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(BALL);
    let (across, angle) = ((1.0 - z * z).sqrt(), f64::from(k) * PI * (3.0 - 5f64.sqrt()));
    0.5 * Vector3::new(across * angle.cos(), across * angle.sin(), z)
}

/// The rims of a cylinder of diameter and height 1.
fn on_rims(k: u32) -> Vector3<f64> {
    let angle = TAU * f64::from(k % RIM) / f64::from(RIM);
    Vector3::new(0.5 * angle.cos(), 0.5 * angle.sin(), if k < RIM { -0.5 } else { 0.5 })
}

/// Corners and middles of edges and faces of a cube of edge 1.
fn on_cube(k: u32) -> Vector3<f64> {
    let [a, b, c] = [k % 3, k / 3 % 3, k / 9].map(|place| 0.5 * f64::from(place) - 0.5);
    Vector3::new(a, b, c)
}

#[cfg(test)]
mod tests {
    use super::super::viewer::{color, pose, size};
    use super::*;
    use foxglove::messages::{CylinderPrimitive, SceneEntity, SpherePrimitive};

    #[test]
    fn points_lie_on_the_surfaces() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.5 * PI);
        let shades = [color([1.0, 0.0, 0.0, 0.9]), color([0.0, 0.0, 1.0, 0.2])];
        let ball = |shade: Color| SpherePrimitive {
            pose: Some(pose(Vector3::new(1.0, 2.0, 3.0), turn)),
            size: Some(size([0.4; 3])),
            color: Some(shade),
        };
        let cylinder = CylinderPrimitive {
            pose: Some(pose(Vector3::new(10.0, 0.0, 0.0), turn)),
            size: Some(size([2.0, 2.0, 0.5])),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color: Some(shades[0]),
        };
        let entity =
            SceneEntity { spheres: shades.map(ball).to_vec(), cylinders: vec![cylinder], ..SceneEntity::default() };
        let cloud = of_scene(&SceneUpdate { deletions: Vec::new(), entities: vec![entity] }, "arm");
        let points: Vec<Vector3<f64>> = cloud
            .data
            .chunks(STRIDE as usize)
            .map(|p| Vector3::from_fn(|k, _| f64::from(f32::from_le_bytes(p[4 * k..4 * k + 4].try_into().unwrap()))))
            .collect();
        assert_eq!(points.len() as u32, BALL + 2 * RIM, "what is looked through is left out");
        for (k, p) in points.iter().enumerate() {
            if (k as u32) < BALL {
                assert!(((p - Vector3::new(1.0, 2.0, 3.0)).norm() - 0.2).abs() < 1e-6);
            } else {
                // Its axis lies along x.
                assert!(((p.x - 10.0).abs() - 0.25).abs() < 1e-5, "{p}");
                assert!((p.yz().norm() - 1.0).abs() < 1e-5, "{p}");
            }
        }
        assert_eq!(&cloud.data[12..16], [255, 0, 0, 230]);
    }
}
