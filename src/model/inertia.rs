//! Inertia of a node: `M q''`, the gyroscopic part of `V q'`, and the mass-proportional damping.
//!
//! Kinetic energy `m |r'|^2 / 2 + w.J.w / 2`, `w = 2 L(p) p'`; so `M_p = 4 L(p)^T J L(p)` and the gyroscopic rows are
//! `8 L(p')^T J L(p) p'`. `L` is linear and `L(p) x = -L(x) p`, which gives every derivative as a product.

use super::arm::Node;
use crate::math::quaternion::{body_rate, right};
use nalgebra::{Matrix3x4, Matrix4, Vector3, Vector4};

/// `4 L(p)^T J L(p) x`.
#[inline(always)]
pub(super) fn mass_times(node: &Node, p: &Vector4<f64>, x: &Vector4<f64>) -> Vector4<f64> {
    let l = body_rate(p);
    4.0 * (l.transpose() * node.inertia.component_mul(&(l * x)))
}

/// `8 L(p')^T J L(p) p'`.
#[inline(always)]
pub(super) fn gyroscopic(node: &Node, p: &Vector4<f64>, pd: &Vector4<f64>) -> Vector4<f64> {
    8.0 * (body_rate(pd).transpose() * node.inertia.component_mul(&(body_rate(p) * pd)))
}

/// Quaternion block of `d(M q'' + C + alpha M q')/dq + cg d/dq' + cb d/dq''`.
#[inline(always)]
pub(super) fn tangent(
    node: &Node,
    p: &Vector4<f64>,
    pd: &Vector4<f64>,
    pdd: &Vector4<f64>,
    alpha: f64,
    cg: f64,
    cb: f64,
) -> Matrix4<f64> {
    let j = &node.inertia;
    let (l, ld) = (body_rate(p), body_rate(pd));
    let x = pdd + alpha * pd;
    let lx = body_rate(&x);
    // d(4 L^T J L x)/dp with dL^T v = dp * (0, v) = right(v) dp and dL x = -L(x) dp; d(8 L(p')^T J L(p) p')/dp and /dp'.
    let c = cb + alpha * cg;
    let (mut b, mut bd) = (Matrix3x4::zeros(), Matrix3x4::zeros());
    for s in 0..4 {
        for r in 0..3 {
            b[(r, s)] = 4.0 * j[r] * (c * l[(r, s)] - lx[(r, s)]);
            bd[(r, s)] = 8.0 * j[r] * (cg * l[(r, s)] - ld[(r, s)]);
        }
    }
    let v = j.component_mul(&(4.0 * (l * x) + (8.0 * cg) * (l * pd)));
    let mut a = right(&pure(&v));
    for s in 0..4 {
        for r in 0..4 {
            for k in 0..3 {
                a[(r, s)] += l[(k, r)] * b[(k, s)] + ld[(k, r)] * bd[(k, s)];
            }
        }
    }
    a
}

#[inline(always)]
fn pure(v: &Vector3<f64>) -> Vector4<f64> {
    Vector4::new(0.0, v[0], v[1], v[2])
}
