//! Quaternions `[w x y z]` (Hamilton, body to base) as the bilinear and quadratic forms that the model differentiates.
//!
//! Enters: quaternions as 4-vectors, not necessarily of unit length: the model's rotation `R(p)` is the homogeneous
//! polynomial form, so its columns scale with `|p|^2` and every derivative below is exact off the unit sphere too.
//! A library's unit quaternion would normalise, and with it lose the derivatives that the constraint `p.p = 1` needs.

use super::simd::{Number, inner};
use nalgebra::{Matrix3, Matrix3x4, Matrix4, SMatrix, Vector3, Vector4};

/// Quaternion `[w x y z]`.
pub type Quaternion = Vector4<f64>;

/// Conjugate.
#[inline(always)]
pub fn conjugate(p: &Quaternion) -> Quaternion {
    Quaternion::new(p[0], -p[1], -p[2], -p[3])
}

/// Matrix of the left product: `a * x = left(a) x`.
#[inline(always)]
#[rustfmt::skip]
pub fn left(a: &Quaternion) -> Matrix4<f64> {
    let (w, x, y, z) = (a[0], a[1], a[2], a[3]);
    Matrix4::new(
        w, -x, -y, -z,
        x,  w, -z,  y,
        y,  z,  w, -x,
        z, -y,  x,  w,
    )
}

/// Matrix of the right product: `x * a = right(a) x`.
#[inline(always)]
#[rustfmt::skip]
pub fn right(a: &Quaternion) -> Matrix4<f64> {
    let (w, x, y, z) = (a[0], a[1], a[2], a[3]);
    Matrix4::new(
        w, -x, -y, -z,
        x,  w,  z, -y,
        y, -z,  w,  x,
        z,  y, -x,  w,
    )
}

/// Product `a * b`.
#[inline(always)]
#[rustfmt::skip]
pub fn product(a: &Quaternion, b: &Quaternion) -> Quaternion {
    Quaternion::new(
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )
}

/// `L(p)` with `L(p) x = vec(p* x)`: the body angular velocity is `2 L(p) p'`. Bilinear with `L(p) x = -L(x) p`.
#[inline(always)]
pub fn body_rate(p: &Quaternion) -> Matrix3x4<f64> {
    matrix(body_rate_rows((*p).into()))
}

/// Rotation matrix in homogeneous form (body to base); a rotation times `|p|^2`.
#[inline(always)]
pub fn rotation(p: &Quaternion) -> Matrix3<f64> {
    let [x, y, z] = axes((*p).into());
    Matrix3::from_columns(&[x.into(), y.into(), z.into()])
}

/// Derivatives of the three columns of [`rotation`]: `d (R(p) e_k) / dp`, each 3x4.
#[inline(always)]
pub fn rotation_jacobians(p: &Quaternion) -> [Matrix3x4<f64>; 3] {
    let [x, y, z] = axis_jacobians((*p).into());
    [matrix(x), matrix(y), matrix(z)]
}

/// Tangent `R(p) e_x` (homogeneous).
#[inline(always)]
pub fn tangent(p: &Quaternion) -> Vector3<f64> {
    axes((*p).into())[0].into()
}

/// A matrix from its rows.
#[inline(always)]
pub(crate) fn matrix<const R: usize, const C: usize>(rows: [[f64; C]; R]) -> SMatrix<f64, R, C> {
    SMatrix::from_fn(|r, c| rows[r][c])
}

// The forms below are in plain arrays of any `Number`, matrices as rows: the model evaluates them for several elements at
// once. What is above gives them for single quaternions.

/// Rows of [`body_rate`].
#[inline(always)]
#[rustfmt::skip]
pub(crate) fn body_rate_rows<V: Number>([w, x, y, z]: [V; 4]) -> [[V; 4]; 3] {
    [
        [-x,  w,  z, -y],
        [-y, -z,  w,  x],
        [-z,  y, -x,  w],
    ]
}

/// `vec(p* x)`.
#[inline(always)]
pub(crate) fn body_rate_times<V: Number>(p: [V; 4], x: [V; 4]) -> [V; 3] {
    let rows = body_rate_rows(p);
    [inner(&rows[0], &x), inner(&rows[1], &x), inner(&rows[2], &x)]
}

/// `L(p)^T v`, which is `p v` of the pure quaternion v.
#[inline(always)]
pub(crate) fn times_pure<V: Number>([w, x, y, z]: [V; 4], [a, b, c]: [V; 3]) -> [V; 4] {
    [
        inner(&[-x, -y, -z], &[a, b, c]),
        inner(&[w, y, -z], &[a, c, b]),
        inner(&[w, z, -x], &[b, a, c]),
        inner(&[w, x, -y], &[c, b, a]),
    ]
}

/// `v p` of the pure quaternion v.
#[inline(always)]
pub(crate) fn pure_times<V: Number>([a, b, c]: [V; 3], [w, x, y, z]: [V; 4]) -> [V; 4] {
    [
        inner(&[-a, -b, -c], &[x, y, z]),
        inner(&[a, b, -c], &[w, z, y]),
        inner(&[b, c, -a], &[w, x, z]),
        inner(&[c, a, -b], &[w, y, x]),
    ]
}

/// Adds the matrix of the right product with a pure quaternion: `x v = right(v) x`.
#[inline(always)]
pub(crate) fn add_right<V: Number>([x, y, z]: [V; 3], a: &mut [[V; 4]; 4]) {
    let v = [x, y, z];
    for k in 0..3 {
        a[k + 1][0] = a[k + 1][0] + v[k];
        a[0][k + 1] = a[0][k + 1] - v[k];
    }
    a[1][2] = a[1][2] + z;
    a[2][1] = a[2][1] - z;
    a[2][3] = a[2][3] + x;
    a[3][2] = a[3][2] - x;
    a[3][1] = a[3][1] + y;
    a[1][3] = a[1][3] - y;
}

/// Columns of [`rotation`].
#[inline(always)]
pub(crate) fn axes<V: Number>([w, x, y, z]: [V; 4]) -> [[V; 3]; 3] {
    let (ww, xx, yy, zz) = (w * w, x * x, y * y, z * z);
    let (wx, wy, wz, xy, xz, yz) = (w * x, w * y, w * z, x * y, x * z, y * z);
    [
        [ww + xx - yy - zz, (xy + wz) * 2.0, (xz - wy) * 2.0],
        [(xy - wz) * 2.0, ww - xx + yy - zz, (yz + wx) * 2.0],
        [(xz + wy) * 2.0, (yz - wx) * 2.0, ww - xx - yy + zz],
    ]
}

/// Rows of [`rotation_jacobians`].
#[inline(always)]
#[rustfmt::skip]
pub(crate) fn axis_jacobians<V: Number>([w, x, y, z]: [V; 4]) -> [[[V; 4]; 3]; 3] {
    let (w, x, y, z) = (w * 2.0, x * 2.0, y * 2.0, z * 2.0);
    [
        [
            [ w, x, -y, -z],
            [ z, y,  x,  w],
            [-y, z, -w,  x],
        ],
        [
            [-z,  y, x, -w],
            [ w, -x, y, -z],
            [ x,  w, z,  y],
        ],
        [
            [ y,  z,  w, x],
            [-x, -w,  z, y],
            [ w, -x, -y, z],
        ],
    ]
}

/// The symmetric form `S(W)` with `p^T S(W) p = tr(W^T R(p))`, from the columns of W; so `e . R(p) h = p^T S(e h^T) p`
/// (Davenport's K matrix).
#[inline(always)]
#[rustfmt::skip]
pub(crate) fn rotation_form<V: Number>([x, y, z]: [[V; 3]; 3]) -> [[V; 4]; 4] {
    let (a, b, c) = (y[2] - z[1], z[0] - x[2], x[1] - y[0]);
    let (xx, yy, zz) = (x[0], y[1], z[2]);
    let (xy, xz, yz) = (y[0] + x[1], z[0] + x[2], z[1] + y[2]);
    [
        [xx + yy + zz, a, b, c],
        [a, xx - yy - zz, xy, xz],
        [b, xy, yy - xx - zz, yz],
        [c, xz, yz, zz - xx - yy],
    ]
}

/// [`rotation_form`] of `W = e e_x^T`: `e . t(p) = p^T S p`.
#[inline(always)]
#[rustfmt::skip]
pub(crate) fn tangent_form<V: Number>([x, y, z]: [V; 3], zero: V) -> [[V; 4]; 4] {
    [
        [x, zero, -z, y],
        [zero, x, y, z],
        [-z, y, -x, zero],
        [y, z, zero, -x],
    ]
}

/// Rotation vector to quaternion.
pub fn from_rotation_vector(v: &Vector3<f64>) -> Quaternion {
    let angle = v.norm();
    let s = if angle < 1e-8 { 0.5 - angle * angle / 48.0 } else { (angle / 2.0).sin() / angle };
    Quaternion::new((angle / 2.0).cos(), s * v[0], s * v[1], s * v[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    const P: [f64; 4] = [0.7, -0.3, 0.5, 0.9];
    const A: [f64; 4] = [-0.2, 0.8, 0.1, 0.4];

    fn close(a: &[f64], b: &[f64]) {
        assert_eq!(a.len(), b.len());
        for (x, y) in a.iter().zip(b) {
            assert!((x - y).abs() < 1e-13, "{x} {y}");
        }
    }

    #[test]
    fn products_agree_with_their_matrices() {
        let (p, a) = (Quaternion::from(P), Quaternion::from(A));
        close((left(&p) * a).as_slice(), product(&p, &a).as_slice());
        close((right(&a) * p).as_slice(), product(&p, &a).as_slice());
        close((body_rate(&p) * a).as_slice(), &product(&conjugate(&p), &a).as_slice()[1..]);
        close((body_rate(&p) * a).as_slice(), (-(body_rate(&a) * p)).as_slice());
        close(&body_rate_times(P, A), (body_rate(&p) * a).as_slice());
        let v = [A[1], A[2], A[3]];
        let pure = Quaternion::new(0.0, v[0], v[1], v[2]);
        close(&times_pure(P, v), product(&p, &pure).as_slice());
        close(&times_pure(P, v), (body_rate(&p).transpose() * Vector3::from(v)).as_slice());
        close(&pure_times(v, P), product(&pure, &p).as_slice());
        let mut of_right = [[0.0; 4]; 4];
        add_right(v, &mut of_right);
        close(matrix(of_right).as_slice(), right(&pure).as_slice());
    }

    #[test]
    fn rotation_is_the_sandwich_product_and_its_forms_agree() {
        let p = Quaternion::from(P);
        let (h, e) = (Vector3::new(0.3, -1.1, 0.7), Vector3::new(2.0, 0.4, -0.9));
        let sandwich = product(&product(&p, &Quaternion::new(0.0, h[0], h[1], h[2])), &conjugate(&p));
        close((rotation(&p) * h).as_slice(), &sandwich.as_slice()[1..]);
        close(tangent(&p).as_slice(), rotation(&p).column(0).as_slice());
        let form = matrix(rotation_form([0, 1, 2].map(|k| (e * h[k]).into())));
        close(&[(form * p).dot(&p)], &[e.dot(&(rotation(&p) * h))]);
        close(&[(matrix(tangent_form(e.into(), 0.0)) * p).dot(&p)], &[e.dot(&tangent(&p))]);
        // R is quadratic and homogeneous, so dR/dp p = 2 R.
        for (k, d) in rotation_jacobians(&p).iter().enumerate() {
            close((d * p).as_slice(), (2.0 * rotation(&p).column(k)).as_slice());
            for i in 0..4 {
                let dp = 1e-6 * Quaternion::ith(i, 1.0);
                let fd = (rotation(&(p + dp)).column(k) - rotation(&(p - dp)).column(k)) / 2e-6;
                assert!((fd - d.column(i)).norm() < 1e-8);
            }
        }
    }

    #[test]
    fn rotation_vector_gives_its_angle() {
        let p = from_rotation_vector(&Vector3::new(0.0, 0.3, 0.0));
        close(p.as_slice(), &[0.15f64.cos(), 0.0, 0.15f64.sin(), 0.0]);
        assert!((from_rotation_vector(&Vector3::new(1e-9, 0.0, 0.0))[1] - 5e-10).abs() < 1e-20);
    }
}
