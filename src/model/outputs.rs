//! What the planner steers and what reports show: tip pose and twist, average curvatures, tangents, curve frames.

use super::arm::Arm;
use super::elastic;
use super::terms::ends;
use crate::math::quaternion::{body_rate, tangent};
use nalgebra::{Vector3, Vector4};

/// Tip pose and twist.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outputs {
    /// Position (m, base frame).
    pub position: Vector3<f64>,
    /// Quaternion (body to base).
    pub quaternion: Vector4<f64>,
    /// Velocity (m/s, base frame).
    pub velocity: Vector3<f64>,
    /// Angular velocity (rad/s, body frame).
    pub angular_velocity: Vector3<f64>,
}

/// Rows of [`Arm::curvature_sensitivity`] for nodes i and i+1 (2x4 each; y, z).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvatureSensitivity {
    /// Of the curvatures.
    pub k: [nalgebra::Matrix2x4<f64>; 2],
    /// Of their rates.
    pub kd: [nalgebra::Matrix2x4<f64>; 2],
}

impl Arm {
    /// Pose and twist of the last node.
    pub fn tip(&self, q: &[f64], qd: &[f64]) -> Outputs {
        let n = self.node_count();
        let ((position, quaternion), (velocity, pd)) = (self.pose(q, n), self.rate(qd, n));
        Outputs { position, quaternion, velocity, angular_velocity: 2.0 * (body_rate(&quaternion) * pd) }
    }

    /// Average curvatures (1/m) and rates (1/(m s)) about local y and z: `(y, z)` segment by segment, 2 per segment.
    pub fn curvatures_into(&self, q: &[f64], qd: &[f64], curvatures: &mut [f64], rates: &mut [f64]) {
        curvatures.fill(0.0);
        rates.fill(0.0);
        for (s, range) in self.segment_elements.iter().enumerate() {
            let share = 1.0 / range.len() as f64;
            for i in range.clone() {
                let (k, kd) = self.element_curvature(q, qd, i);
                for c in 0..2 {
                    curvatures[2 * s + c] += share * k[1 + c];
                    rates[2 * s + c] += share * kd[1 + c];
                }
            }
        }
    }

    /// Curvature (1/m) and rate of element `i`: torsion, y, z.
    pub fn element_curvature(&self, q: &[f64], qd: &[f64], i: usize) -> (Vector3<f64>, Vector3<f64>) {
        elastic::curvature(self.strain, &self.elements[i], &ends(self, q, qd, i).0)
    }

    /// Contribution of element `i` to its segment's average curvatures (y, z) and their rates, as rows on the
    /// quaternion corrections of its two nodes; rates follow the coordinates with `cg`.
    pub fn curvature_sensitivity(&self, q: &[f64], qd: &[f64], i: usize, cg: f64) -> CurvatureSensitivity {
        let (ends, sign) = ends(self, q, qd, i);
        let (k, kd) = elastic::curvature_jacobian(self.strain, &self.elements[i], &ends, cg);
        let share = 1.0 / self.segment_elements[self.elements[i].segment].len() as f64;
        let rows = |m: [nalgebra::Matrix3x4<f64>; 2]| {
            [m[0].fixed_rows::<2>(1) * share, m[1].fixed_rows::<2>(1) * (share * sign)]
        };
        CurvatureSensitivity { k: rows(k), kd: rows(kd) }
    }

    /// Positions and tangents of nodes 0..=N (m, 1; base frame), for the collision module.
    pub fn frames_into(&self, q: &[f64], positions: &mut [Vector3<f64>], tangents: &mut [Vector3<f64>]) {
        for i in 0..=self.node_count() {
            let (r, p) = self.pose(q, i);
            positions[i] = r;
            tangents[i] = tangent(&p);
        }
    }
}
