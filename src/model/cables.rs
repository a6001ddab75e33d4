//! Cables: straight from hole to hole, `length = sum |r_j + R_j h - r_i - R_i x|`, `x = h + L_con e_x`.
//!
//! `G = -(d length / dq)^T`, and `G u` depends on q: its derivative `-u d^2 length / dq^2` belongs to the tangent.

use super::arm::{Element, HolePass};
use crate::math::quaternion::{rotation, rotation_form, rotation_jacobians};
use nalgebra::{Matrix3, Matrix3x4, Matrix4, Vector3, Vector4};

/// Positions, rotations and their derivatives at the two ends of an element, computed once for all its cables.
pub(super) struct Span {
    pub(super) chord: Vector3<f64>,
    pub(super) rotation: [Matrix3<f64>; 2],
    pub(super) jacobians: [[Matrix3x4<f64>; 3]; 2],
    pub(super) connector: f64,
}

/// One cable in one element: direction, length, and where its derivative acts.
pub(super) struct Leg {
    /// Unit vector from the hole in disk i to the hole in disk j.
    pub(super) direction: Vector3<f64>,
    /// Distance between the holes (m).
    pub(super) length: f64,
    /// `-d/dp_i` and `d/dp_j` of the vector between the holes (3x4).
    pub(super) jacobians: [Matrix3x4<f64>; 2],
}

/// Tangent blocks of `-G u` summed over the cables of an element.
pub(super) struct Stiffness {
    /// `sum u P`, `P = (I - e e^T)/length`: blocks r_i r_i and r_j r_j; its negative is r_i r_j.
    pub(super) rr: Matrix3<f64>,
    /// `sum u P D_i`, `sum u P D_j`.
    pub(super) rp: [Matrix3x4<f64>; 2],
    /// Quaternion blocks ii, ij, jj.
    pub(super) pp: [Matrix4<f64>; 3],
}

impl Span {
    pub(super) fn new(e: &Element, ri: &Vector3<f64>, pi: &Vector4<f64>, rj: &Vector3<f64>, pj: &Vector4<f64>) -> Self {
        Self {
            chord: rj - ri,
            rotation: [rotation(pi), rotation(pj)],
            jacobians: [rotation_jacobians(pi), rotation_jacobians(pj)],
            connector: e.connector,
        }
    }

    fn vector(&self, hole: &Vector3<f64>) -> Vector3<f64> {
        let x = Vector3::new(self.connector, hole[1], hole[2]);
        self.chord + self.rotation[1] * hole - self.rotation[0] * x
    }

    /// Distance between the holes (m).
    pub(super) fn length(&self, pass: &HolePass) -> f64 {
        self.vector(&pass.hole).norm()
    }

    pub(super) fn leg(&self, pass: &HolePass) -> Leg {
        let h = &pass.hole;
        let d = self.vector(h);
        let length = d.norm();
        let at = |j: &[Matrix3x4<f64>; 3], x: f64| j[1] * h[1] + j[2] * h[2] + j[0] * x;
        Leg {
            direction: d / length,
            length,
            jacobians: [at(&self.jacobians[0], self.connector), at(&self.jacobians[1], 0.0)],
        }
    }
}

impl Stiffness {
    pub(super) fn zeros() -> Self {
        Self { rr: Matrix3::zeros(), rp: [Matrix3x4::zeros(); 2], pp: [Matrix4::zeros(); 3] }
    }

    /// Adds the part `u D^T P D` of one cable, and gathers `u e h^T` for [`Stiffness::finish`].
    pub(super) fn add(
        &mut self,
        tension: f64,
        pass: &HolePass,
        leg: &Leg,
        connector: f64,
        gather: &mut [Matrix3<f64>; 2],
    ) {
        let e = &leg.direction;
        let p = (Matrix3::identity() - e * e.transpose()) * (tension / leg.length);
        let [di, dj] = &leg.jacobians;
        let (pdi, pdj) = (p * di, p * dj);
        self.rr += p;
        self.rp[0] += pdi;
        self.rp[1] += pdj;
        self.pp[0] += di.transpose() * pdi;
        self.pp[1] -= di.transpose() * pdj;
        self.pp[2] += dj.transpose() * pdj;
        let ue = e * tension;
        gather[0] += ue * Vector3::new(connector, pass.hole[1], pass.hole[2]).transpose();
        gather[1] += ue * pass.hole.transpose();
    }

    /// Adds the part of the rotations' second derivatives.
    pub(super) fn finish(&mut self, gather: &[Matrix3<f64>; 2]) {
        self.pp[0] -= 2.0 * rotation_form(&gather[0]);
        self.pp[2] += 2.0 * rotation_form(&gather[1]);
    }
}
