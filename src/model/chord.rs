//! Chord constraints: an element is inextensible and unshearable.
//!
//! Simpson: `psi = r_j - r_i - L_con t_i - (l/6)(t_i + 4 t_m + t_j)`, `t_m = t(s)/s.s`, `s = p_i + p_j`; trapezoid:
//! `psi = r_j - r_i - L_con t_i - (l/2)(t_i + t_j)`. The trapezoid shortens the chord three times too much (design 12).

use super::arm::{Arm, Element};
use crate::config::ChordRule;
use crate::math::quaternion::{rotation_jacobians, tangent, tangent_form};
use nalgebra::{Matrix3x4, Matrix4, Vector3, Vector4};

impl Arm {
    /// The chord that the rule gives between two quaternions of an element (m, base frame).
    #[inline(always)]
    pub(super) fn chord_vector(&self, e: &Element, pi: &Vector4<f64>, pj: &Vector4<f64>) -> Vector3<f64> {
        let l = e.length;
        match self.chord {
            ChordRule::Trapezoid => (l / 2.0) * (tangent(pi) + tangent(pj)),
            ChordRule::Simpson => {
                let s = pi + pj;
                (l / 6.0) * (tangent(pi) + (4.0 / s.norm_squared()) * tangent(&s) + tangent(pj))
            }
        }
    }
}

/// `dpsi/dp_i`, `dpsi/dp_j`; `dpsi/dr_i = -I`, `dpsi/dr_j = I`.
#[inline(always)]
pub(super) fn jacobian(
    rule: ChordRule,
    e: &Element,
    pi: &Vector4<f64>,
    pj: &Vector4<f64>,
    di: &Matrix3x4<f64>,
    dj: &Matrix3x4<f64>,
) -> (Matrix3x4<f64>, Matrix3x4<f64>) {
    let l = e.length;
    match rule {
        ChordRule::Trapezoid => (-(e.connector + l / 2.0) * di, -(l / 2.0) * dj),
        ChordRule::Simpson => {
            let s = pi + pj;
            let n = s.norm_squared();
            let dm = (rotation_jacobians(&s)[0] - tangent(&s) * (2.0 / n) * s.transpose()) * (4.0 * l / 6.0 / n);
            (-(e.connector + l / 6.0) * di - dm, -(l / 6.0) * dj - dm)
        }
    }
}

/// `d^2 (mu . psi)` in the blocks `ii`, `ij = ji`, `jj` of the two quaternions.
#[inline(always)]
pub(super) fn hessian(
    rule: ChordRule,
    e: &Element,
    pi: &Vector4<f64>,
    pj: &Vector4<f64>,
    mu: &Vector3<f64>,
) -> [Matrix4<f64>; 3] {
    let m = tangent_form(mu);
    let l = e.length;
    match rule {
        ChordRule::Trapezoid => [m * (-2.0 * (e.connector + l / 2.0)), Matrix4::zeros(), m * -l],
        ChordRule::Simpson => {
            let s = pi + pj;
            let n = s.norm_squared();
            let ms = m * s;
            let f = s.dot(&ms) / n;
            let g = (2.0 / n) * (ms - f * s);
            let sg = s * g.transpose();
            let mut mid = m - sg - sg.transpose();
            for k in 0..4 {
                mid[(k, k)] -= f;
            }
            mid *= -(4.0 * l / 6.0) * (2.0 / n);
            [m * (-2.0 * (e.connector + l / 6.0)) + mid, mid, m * (-2.0 * l / 6.0) + mid]
        }
    }
}

/// `d^2 psi / dt^2` at zero acceleration: the second directional derivative along the rates (base frame).
pub(super) fn convective(rule: ChordRule, e: &Element, p: [&Vector4<f64>; 2], pd: [&Vector4<f64>; 2]) -> Vector3<f64> {
    let mut acc = Vector3::zeros();
    for k in 0..3 {
        let [ii, ij, jj] = hessian(rule, e, p[0], p[1], &Vector3::ith(k, 1.0));
        acc[k] = pd[0].dot(&(ii * pd[0])) + 2.0 * pd[0].dot(&(ij * pd[1])) + pd[1].dot(&(jj * pd[1]));
    }
    acc
}
