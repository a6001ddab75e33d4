//! Bending and torsion of one element with stiffness-proportional damping.
//!
//! Strain from `c = p_i* p_j`, bilinear in the two quaternions: `kappa = 2 vec(c)/l`, or the rotation vector of `c`
//! over `l`. With `m = l J^T K (kappa + beta kappa')`, `J = dkappa/dc`, both the elastic force `dE/dq` and the damping
//! force are `A^T m`, `A = dc/dq`, so one pass gives both and their tangent.

use super::arm::Element;
use crate::config::StrainRule;
use crate::math::quaternion::{add_right, body_rate_rows, conjugate, left, product, right, times_pure};
use crate::math::simd::{Columns, Number, inner};
use nalgebra::{Matrix3x4, Matrix4, Vector3, Vector4};

/// The two quaternions of an element and their rates, `p_j` already in the hemisphere of `p_i`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ends {
    pub(super) pi: Vector4<f64>,
    pub(super) pj: Vector4<f64>,
    pub(super) pdi: Vector4<f64>,
    pub(super) pdj: Vector4<f64>,
}

/// `kappa` (1/m) and `kappa'` (1/(m s)) of an element; components torsion, y, z.
pub(super) fn curvature(rule: StrainRule, e: &Element, ends: &Ends) -> (Vector3<f64>, Vector3<f64>) {
    let c = product(&conjugate(&ends.pi), &ends.pj);
    let cd = product(&conjugate(&ends.pdi), &ends.pj) + product(&conjugate(&ends.pi), &ends.pdj);
    let (kappa, j) = strain(rule, e.length, &c);
    (kappa, j * cd)
}

/// `d kappa/dp` and `d kappa'/dp + cg d kappa'/dp'` for both quaternions (3x4 each).
pub(super) fn curvature_jacobian(
    rule: StrainRule,
    e: &Element,
    ends: &Ends,
    cg: f64,
) -> ([Matrix3x4<f64>; 2], [Matrix3x4<f64>; 2]) {
    let c = product(&conjugate(&ends.pi), &ends.pj);
    let (_, j) = strain(rule, e.length, &c);
    let a = [with_conjugate(&right(&ends.pj)), left(&conjugate(&ends.pi))];
    let ad = [with_conjugate(&right(&ends.pdj)), left(&conjugate(&ends.pdi))];
    // kappa' = J c': J depends on c for the logarithm only.
    let mut of_c = cg * j;
    if rule == StrainRule::Logarithm {
        let cd = product(&conjugate(&ends.pdi), &ends.pj) + product(&conjugate(&ends.pi), &ends.pdj);
        of_c += rate_jacobian(e.length, &c, &cd);
    }
    ([j * a[0], j * a[1]], [of_c * a[0] + j * ad[0], of_c * a[1] + j * ad[1]])
}

/// `d(J c')/dc` of the logarithm at fixed `c'`.
fn rate_jacobian(l: f64, c: &Vector4<f64>, cd: &Vector4<f64>) -> Matrix3x4<f64> {
    let mut dj = Matrix3x4::zeros();
    for k in 0..3 {
        dj.set_row(k, &(hessian(l, c, &Vector3::ith(k, 1.0)) * cd).transpose());
    }
    dj
}

/// Elastic energy (J).
pub(super) fn energy(rule: StrainRule, e: &Element, ends: &Ends) -> f64 {
    let (kappa, _) = curvature(rule, e, ends);
    0.5 * e.length * kappa.dot(&e.stiffness.component_mul(&kappa))
}

/// Forces on `p_i` and `p_j`: elastic and damping apart.
pub(super) struct Forces {
    pub(super) elastic: [Vector4<f64>; 2],
    pub(super) damping: [Vector4<f64>; 2],
}

/// Elastic and damping forces.
pub(super) fn forces(rule: StrainRule, e: &Element, ends: &Ends) -> Forces {
    let c = product(&conjugate(&ends.pi), &ends.pj);
    let cd = product(&conjugate(&ends.pdi), &ends.pj) + product(&conjugate(&ends.pi), &ends.pdj);
    let (kappa, j) = strain(rule, e.length, &c);
    let m = e.length * (j.transpose() * e.stiffness.component_mul(&kappa));
    let md = (e.damping * e.length) * (j.transpose() * e.stiffness.component_mul(&(j * cd)));
    // A_j^T m = left(p_i) m and A_i^T m = C (right(p_j)^T m) = p_j m*.
    let on = |m: &Vector4<f64>| [product(&ends.pj, &conjugate(m)), product(&ends.pi, m)];
    Forces { elastic: on(&m), damping: on(&md) }
}

/// Bending and torsion of an element, or of several side by side.
pub(super) struct Bending<V> {
    /// Forces on `p_i` and `p_j`, elastic and damping together.
    pub(super) force: [[V; 4]; 2],
    /// Blocks `[ii, ij, ji, jj]` of their tangent, rates weighted with `cg`.
    pub(super) tangent: [[[V; 4]; 4]; 4],
}

impl Bending<f64> {
    /// By any rule.
    pub(super) fn of(rule: StrainRule, e: &Element, ends: &Ends, cg: f64) -> Self {
        let Forces { elastic, damping } = forces(rule, e, ends);
        let tangent = tangent(rule, e, ends, cg);
        Self { force: [0, 1].map(|k| (elastic[k] + damping[k]).into()), tangent: tangent.map(|m| m.transpose().into()) }
    }
}

impl<V: Number> Bending<V> {
    /// Where the curvature is linear in `c`: `kappa = 2 vec(c)/l`, so only `vec(c)` matters, and
    /// `vec(p_i* p_j) = L(p_i) p_j = -L(p_j) p_i` makes the derivatives 3x4. Both quaternions (`p_j` in the hemisphere of
    /// `p_i`) and their rates, `[GJ, EI, EI]`, damping (s) and length (m).
    #[inline(always)]
    pub(super) fn by_vector_part<W: Columns<Value = V>>(
        w: W,
        p: [[V; 4]; 2],
        pd: [[V; 4]; 2],
        stiffness: [V; 3],
        damping: V,
        length: V,
        cg: f64,
    ) -> Self {
        let zero = w.splat(0.0);
        let (mut a, mut ad) =
            ([body_rate_rows(p[1]), body_rate_rows(p[0])], [body_rate_rows(pd[1]), body_rate_rows(pd[0])]);
        for r in 0..3 {
            for c in 0..4 {
                a[0][r][c] = -a[0][r][c];
                ad[0][r][c] = -ad[0][r][c];
            }
        }
        let four_over_length = length.inverse() * 4.0;
        let mut d = [[[zero; 4]; 3]; 2];
        let mut m = [zero; 3];
        for r in 0..3 {
            // l J^T K J on the elastic part, beta l J^T K J on the damping part.
            let k = stiffness[r] * four_over_length;
            let kd = k * damping;
            let total = k + kd * cg;
            let (c, cd) = (inner(&a[1][r], &p[1]), inner(&ad[1][r], &p[1]) + inner(&a[1][r], &pd[1]));
            m[r] = k.multiply_add(c, kd * cd);
            for end in 0..2 {
                for c in 0..4 {
                    d[end][r][c] = total.multiply_add(a[end][r][c], kd * ad[end][r][c]);
                }
            }
        }
        let mut tangent = [[[zero; 4]; 4]; 4];
        for end in 0..2 {
            for c in 0..4 {
                let d = [d[end][0][c], d[end][1][c], d[end][2][c]];
                for q in 0..4 {
                    tangent[end][q][c] = inner(&[a[0][0][q], a[0][1][q], a[0][2][q]], &d);
                    tangent[2 + end][q][c] = inner(&[a[1][0][q], a[1][1][q], a[1][2][q]], &d);
                }
            }
        }
        let back = [-m[0], -m[1], -m[2]];
        add_right(back, &mut tangent[1]);
        add_right(m, &mut tangent[2]);
        Self { force: [times_pure(p[1], back), times_pure(p[0], m)], tangent }
    }
}

/// 4x4 blocks `[ii, ij, ji, jj]` of the tangent of both forces, rates weighted with `cg`.
fn tangent(rule: StrainRule, e: &Element, ends: &Ends, cg: f64) -> [Matrix4<f64>; 4] {
    let c = product(&conjugate(&ends.pi), &ends.pj);
    let cd = product(&conjugate(&ends.pdi), &ends.pj) + product(&conjugate(&ends.pi), &ends.pdj);
    let (kappa, j) = strain(rule, e.length, &c);
    let (lk, bl) = (e.length, e.damping * e.length);
    let kj = Matrix3x4::from_fn(|r, s| e.stiffness[r] * j[(r, s)]);
    let (force, force_d) = (e.stiffness.component_mul(&kappa), e.stiffness.component_mul(&(j * cd)));
    let jkj = j.transpose() * kj;
    let mut kc = lk * jkj;
    let kd = bl * jkj;
    if rule == StrainRule::Logarithm {
        kc += lk * hessian(e.length, &c, &force) + bl * hessian(e.length, &c, &force_d);
        kc += bl * (kj.transpose() * rate_jacobian(e.length, &c, &cd));
    }
    let m = j.transpose() * (lk * force + bl * force_d);
    let (ai, aj) = (with_conjugate(&right(&ends.pj)), left(&conjugate(&ends.pi)));
    let (adi, adj) = (with_conjugate(&right(&ends.pdj)), left(&conjugate(&ends.pdi)));
    let total = kc + cg * kd;
    let (di, dj) = (total * ai + kd * adi, total * aj + kd * adj);
    // A depends on q: d(A_j^T m)/dp_i = right(m).
    let mixed = right(&m);
    [ai.transpose() * di, ai.transpose() * dj + mixed.transpose(), aj.transpose() * di + mixed, aj.transpose() * dj]
}

/// `a diag(1, -1, -1, -1)`.
fn with_conjugate(a: &Matrix4<f64>) -> Matrix4<f64> {
    let mut a = *a;
    for k in 1..4 {
        a.column_mut(k).neg_mut();
    }
    a
}

/// `kappa(c)` and `dkappa/dc`.
fn strain(rule: StrainRule, l: f64, c: &Vector4<f64>) -> (Vector3<f64>, Matrix3x4<f64>) {
    let v = Vector3::new(c[1], c[2], c[3]);
    match rule {
        StrainRule::VectorPart => {
            let f = 2.0 / l;
            #[rustfmt::skip]
            let j = Matrix3x4::new(
                0.0, f, 0.0, 0.0,
                0.0, 0.0, f, 0.0,
                0.0, 0.0, 0.0, f,
            );
            (f * v, j)
        }
        StrainRule::Logarithm => {
            let a = Angle::of(c);
            let mut j = Matrix3x4::zeros();
            for k in 0..3 {
                j[(k, 0)] = a.w * v[k] / l;
                for m in 0..3 {
                    j[(k, m + 1)] = 2.0 * a.s * v[k] * v[m] / l;
                }
                j[(k, k + 1)] += a.g / l;
            }
            (v * (a.g / l), j)
        }
    }
}

/// `sum_k m_k d^2 kappa_k / dc^2` of the logarithm.
fn hessian(l: f64, c: &Vector4<f64>, m: &Vector3<f64>) -> Matrix4<f64> {
    let v = Vector3::new(c[1], c[2], c[3]);
    let a = Angle::of(c);
    let mu = m.dot(&v);
    let mut h = Matrix4::zeros();
    h[(0, 0)] = a.ww * mu;
    for k in 0..3 {
        let x = 2.0 * a.ws * v[k] * mu + a.w * m[k];
        h[(0, k + 1)] = x;
        h[(k + 1, 0)] = x;
        for n in 0..3 {
            h[(k + 1, n + 1)] = 4.0 * a.ss * mu * v[k] * v[n] + 2.0 * a.s * (v[k] * m[n] + m[k] * v[n]);
        }
        h[(k + 1, k + 1)] += 2.0 * a.s * mu;
    }
    h / l
}

/// `g(w, s) = 2 atan2(sqrt s, w) / sqrt s`, the factor that makes the vector part a rotation vector, with its first
/// and second derivatives.
struct Angle {
    g: f64,
    w: f64,
    s: f64,
    ww: f64,
    ws: f64,
    ss: f64,
}

impl Angle {
    fn of(c: &Vector4<f64>) -> Self {
        let w = c[0];
        let s = c[1] * c[1] + c[2] * c[2] + c[3] * c[3];
        let r2 = w * w + s;
        let (g, gs, gss);
        // Below, the closed form of g_ss loses about eps/x^2; the series' first dropped term is x^5.
        let x = s / (w * w);
        if w > 0.0 && x < 1e-3 {
            let f = 2.0 / w;
            g = f * (1.0 + x * (-1.0 / 3.0 + x * (1.0 / 5.0 + x * (-1.0 / 7.0 + x * (1.0 / 9.0 - x / 11.0)))));
            gs = f / (w * w)
                * (-1.0 / 3.0
                    + x * (2.0 / 5.0 + x * (-3.0 / 7.0 + x * (4.0 / 9.0 + x * (-5.0 / 11.0 + x * 6.0 / 13.0)))));
            gss = f / (w * w * w * w)
                * (2.0 / 5.0
                    + x * (-6.0 / 7.0 + x * (12.0 / 9.0 + x * (-20.0 / 11.0 + x * (30.0 / 13.0 - x * 42.0 / 15.0)))));
        } else {
            let n = s.sqrt();
            g = 2.0 * n.atan2(w) / n;
            gs = (2.0 * w / r2 - g) / (2.0 * s);
            gss = ((-2.0 * w / (r2 * r2) - gs) * s - (2.0 * w / r2 - g)) / (2.0 * s * s);
        }
        Self { g, w: -2.0 / r2, s: gs, ww: 4.0 * w / (r2 * r2), ws: 2.0 / (r2 * r2), ss: gss }
    }
}
