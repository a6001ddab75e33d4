//! Inertia of a node: `M q''`, the gyroscopic part of `V q'`, and the mass-proportional damping.
//!
//! Kinetic energy `m |r'|^2 / 2 + w.J.w / 2`, `w = 2 L(p) p'`; so `M_p = 4 L(p)^T J L(p)` and the gyroscopic rows are
//! `8 L(p')^T J L(p) p'`. `L` is linear and `L(p) x = -L(x) p`, which gives every derivative as a product.

use crate::math::quaternion::{add_right, body_rate_rows, body_rate_times, times_pure};
use crate::math::simd::{Number, inner};

/// `4 L(p)^T J L(p) x` for principal inertias `j`.
#[inline(always)]
pub(super) fn mass_times<V: Number>(j: [V; 3], p: [V; 4], x: [V; 4]) -> [V; 4] {
    let l = body_rate_times(p, x);
    times_pure(p, [j[0] * l[0] * 4.0, j[1] * l[1] * 4.0, j[2] * l[2] * 4.0])
}

/// `8 L(p')^T J L(p) p'`.
#[inline(always)]
pub(super) fn gyroscopic<V: Number>(j: [V; 3], p: [V; 4], pd: [V; 4]) -> [V; 4] {
    let l = body_rate_times(p, pd);
    times_pure(pd, [j[0] * l[0] * 8.0, j[1] * l[1] * 8.0, j[2] * l[2] * 8.0])
}

/// Adds the quaternion block of `d(M q'' + C + alpha M q')/dq + cg d/dq' + cb d/dq''`; `x = p'' + alpha p'`,
/// `c = cb + alpha cg`.
#[inline(always)]
pub(super) fn add_tangent<V: Number>(
    j: [V; 3],
    p: [V; 4],
    pd: [V; 4],
    x: [V; 4],
    c: f64,
    cg: f64,
    a: &mut [[V; 4]; 4],
) {
    let (l, ld, lx) = (body_rate_rows(p), body_rate_rows(pd), body_rate_rows(x));
    // d(4 L^T J L x)/dp with dL^T v = dp * (0, v) = right(v) dp and dL x = -L(x) dp; d(8 L(p')^T J L(p) p')/dp and /dp'.
    for k in 0..3 {
        let (j4, j8) = (j[k] * 4.0, j[k] * 8.0);
        for s in 0..4 {
            let (b, bd) = (j4 * (l[k][s] * c - lx[k][s]), j8 * (l[k][s] * cg - ld[k][s]));
            for r in 0..4 {
                a[r][s] = l[k][r].multiply_add(b, ld[k][r].multiply_add(bd, a[r][s]));
            }
        }
    }
    let mut v = j;
    for k in 0..3 {
        v[k] = j[k] * (inner(&l[k], &x) * 4.0 + inner(&l[k], &pd) * (8.0 * cg));
    }
    add_right(v, a);
}
