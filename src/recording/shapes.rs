//! Obstacles as the primitives of `foxglove.SceneEntity`.

use super::viewer::{SeenObstacle, color, pose, size};
use crate::ipc::payload::ObstacleKind;
use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, Point3, SceneEntity, SpherePrimitive, TriangleListPrimitive,
};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::transformation::try_convex_hull;

/// Edge and thickness of what is drawn of a half-space (m, over the arm's length).
const PLANE: [f64; 2] = [3.0, 0.002];

/// Adds an obstacle, grown by so much (m), at a position to an entity.
pub(super) fn add(
    entity: &mut SceneEntity,
    obstacle: &SeenObstacle,
    at: Vector3<f64>,
    growth_m: f64,
    length_m: f64,
    color: Color,
) {
    let turn = unit(obstacle.quaternion);
    let [a, b, c] = obstacle.dimensions_m;
    match ObstacleKind::from_wire(obstacle.kind) {
        Some(ObstacleKind::Ball) => entity.spheres.push(ball(at, a + growth_m, color)),
        Some(ObstacleKind::Capsule) => {
            let radius_m = b + growth_m;
            let half = turn * Vector3::new(0.0, 0.0, a);
            entity.spheres.extend([at + half, at - half].map(|end| ball(end, radius_m, color)));
            entity.cylinders.push(CylinderPrimitive {
                pose: Some(pose(at, turn)),
                size: Some(size([2.0 * radius_m, 2.0 * radius_m, 2.0 * a])),
                bottom_scale: 1.0,
                top_scale: 1.0,
                color: Some(color),
            });
        }
        // The corners of what is grown are round; a box around them is what is drawn.
        Some(ObstacleKind::Box) => entity.cubes.push(cube(at, turn, [a, b, c].map(|h| 2.0 * (h + growth_m)), color)),
        Some(ObstacleKind::HalfSpace) => {
            let [edge, thickness] = PLANE.map(|share| share * length_m);
            let below = turn * Vector3::new(0.0, 0.0, growth_m - 0.5 * thickness);
            entity.cubes.push(cube(at + below, turn, [edge, edge, thickness], color));
        }
        Some(ObstacleKind::Hull) => entity.triangles.extend(hull(&obstacle.vertices_m, at, turn, growth_m, color)),
        None => {}
    }
}

fn ball(at: Vector3<f64>, radius_m: f64, color: Color) -> SpherePrimitive {
    SpherePrimitive {
        pose: Some(pose(at, UnitQuaternion::identity())),
        size: Some(size([2.0 * radius_m; 3])),
        color: Some(color),
    }
}

fn cube(at: Vector3<f64>, turn: UnitQuaternion<f64>, edges_m: [f64; 3], color: Color) -> CubePrimitive {
    CubePrimitive { pose: Some(pose(at, turn)), size: Some(size(edges_m)), color: Some(color) }
}

/// The faces of a hull, its vertices moved away from their middle by the growth; `None` where they span no body.
fn hull(
    flat: &[f64],
    at: Vector3<f64>,
    turn: UnitQuaternion<f64>,
    growth_m: f64,
    color: Color,
) -> Option<TriangleListPrimitive> {
    let points: Vec<Vector> = flat.chunks_exact(3).map(|p| Vector::new(p[0], p[1], p[2])).collect();
    let (points, faces) = try_convex_hull(&points).ok()?;
    let middle = points.iter().fold(Vector::ZERO, |sum, p| sum + *p) / points.len().max(1) as f64;
    let point = |p: &Vector| {
        let away = (*p - middle).normalize_or_zero();
        let p = *p + away * growth_m;
        Point3 { x: p.x, y: p.y, z: p.z }
    };
    Some(TriangleListPrimitive {
        pose: Some(pose(at, turn)),
        points: points.iter().map(point).collect(),
        color: Some(color),
        colors: Vec::new(),
        indices: faces.into_iter().flatten().collect(),
    })
}

pub(super) fn unit([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9).unwrap_or_default()
}

/// What is drawn of an obstacle, and of how much it was grown.
pub(super) const SOLID: [f64; 4] = [0.95, 0.55, 0.2, 0.9];
/// See [`SOLID`].
pub(super) const GROWN: [f64; 4] = [0.95, 0.55, 0.2, 0.2];

/// Adds an obstacle, and how far it was grown.
pub(super) fn add_with_growth(
    entity: &mut SceneEntity,
    obstacle: &SeenObstacle,
    at: Vector3<f64>,
    growth_m: f64,
    length_m: f64,
) {
    add(entity, obstacle, at, 0.0, length_m, color(SOLID));
    if growth_m > 1e-4 * length_m {
        add(entity, obstacle, at, growth_m, length_m, color(GROWN));
    }
}
