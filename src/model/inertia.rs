//! Inertia of a node: `M q''`, the gyroscopic part of `V q'`, and the mass-proportional damping.
//!
//! Kinetic energy `m |r'|^2 / 2 + w.J.w / 2`, `w = 2 L(p) p'`; so `M_p = 4 L(p)^T J L(p)` and the gyroscopic rows are
//! `8 L(p')^T J L(p) p'`. `L` is linear and `L(p) x = -L(x) p`, which gives every derivative as a product.

use super::arm::Node;
use crate::math::quaternion::{body_rate, right};
use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// `4 L(p)^T J L(p) x`.
pub(super) fn mass_times(node: &Node, p: &Vector4<f64>, x: &Vector4<f64>) -> Vector4<f64> {
    let l = body_rate(p);
    4.0 * (l.transpose() * node.inertia.component_mul(&(l * x)))
}

/// `8 L(p')^T J L(p) p'`.
pub(super) fn gyroscopic(node: &Node, p: &Vector4<f64>, pd: &Vector4<f64>) -> Vector4<f64> {
    8.0 * (body_rate(pd).transpose() * node.inertia.component_mul(&(body_rate(p) * pd)))
}

/// Quaternion block of `d(M q'' + C + alpha M q')/dq + cg d/dq' + cb d/dq''`.
pub(super) fn tangent(
    node: &Node,
    p: &Vector4<f64>,
    pd: &Vector4<f64>,
    pdd: &Vector4<f64>,
    alpha: f64,
    cg: f64,
    cb: f64,
) -> Matrix4<f64> {
    let j = Matrix3::from_diagonal(&node.inertia);
    let (l, ld) = (body_rate(p), body_rate(pd));
    let x = pdd + alpha * pd;
    let jl = j * l;
    // d(4 L^T J L x)/dp with dL^T v = dp * (0, v) = right(v) dp and dL x = -L(x) dp.
    let mut a = 4.0 * (right(&pure(&(jl * x))) - l.transpose() * (j * body_rate(&x)));
    a += (4.0 * (cb + alpha * cg)) * (l.transpose() * jl);
    // d(8 L(p')^T J L(p) p')/dp and /dp'.
    a -= 8.0 * (ld.transpose() * (j * ld));
    a += (8.0 * cg) * (right(&pure(&(jl * pd))) + ld.transpose() * jl);
    a
}

fn pure(v: &Vector3<f64>) -> Vector4<f64> {
    Vector4::new(0.0, v[0], v[1], v[2])
}
