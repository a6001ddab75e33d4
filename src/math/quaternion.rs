//! Quaternions `[w x y z]` (Hamilton, body to base) as the bilinear and quadratic forms that the model differentiates.
//!
//! Enters: quaternions as 4-vectors, not necessarily of unit length: the model's rotation `R(p)` is the homogeneous
//! polynomial form, so its columns scale with `|p|^2` and every derivative below is exact off the unit sphere too.
//! A library's unit quaternion would normalise, and with it lose the derivatives that the constraint `p.p = 1` needs.

use nalgebra::{Matrix3, Matrix3x4, Matrix4, Vector3, Vector4};

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
#[rustfmt::skip]
pub fn body_rate(p: &Quaternion) -> Matrix3x4<f64> {
    let (w, x, y, z) = (p[0], p[1], p[2], p[3]);
    Matrix3x4::new(
        -x,  w,  z, -y,
        -y, -z,  w,  x,
        -z,  y, -x,  w,
    )
}

/// Rotation matrix in homogeneous form (body to base); a rotation times `|p|^2`.
#[inline(always)]
#[rustfmt::skip]
pub fn rotation(p: &Quaternion) -> Matrix3<f64> {
    let (w, x, y, z) = (p[0], p[1], p[2], p[3]);
    Matrix3::new(
        w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z,
    )
}

/// Derivatives of the three columns of [`rotation`]: `d (R(p) e_k) / dp`, each 3x4.
#[inline(always)]
#[rustfmt::skip]
pub fn rotation_jacobians(p: &Quaternion) -> [Matrix3x4<f64>; 3] {
    let (w, x, y, z) = (2.0 * p[0], 2.0 * p[1], 2.0 * p[2], 2.0 * p[3]);
    [
        Matrix3x4::new(
             w, x, -y, -z,
             z, y,  x,  w,
            -y, z, -w,  x,
        ),
        Matrix3x4::new(
            -z,  y, x, -w,
             w, -x, y, -z,
             x,  w, z,  y,
        ),
        Matrix3x4::new(
             y,  z,  w, x,
            -x, -w,  z, y,
             w, -x, -y, z,
        ),
    ]
}

/// Tangent `R(p) e_x` (homogeneous).
#[inline(always)]
pub fn tangent(p: &Quaternion) -> Vector3<f64> {
    let (w, x, y, z) = (p[0], p[1], p[2], p[3]);
    Vector3::new(w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
}

/// The symmetric form `S(W)` with `p^T S(W) p = tr(W^T R(p))`; so `e . R(p) h = p^T S(e h^T) p` (Davenport's K matrix).
#[inline(always)]
#[rustfmt::skip]
pub fn rotation_form(w: &Matrix3<f64>) -> Matrix4<f64> {
    let (a, b, c) = (w[(2, 1)] - w[(1, 2)], w[(0, 2)] - w[(2, 0)], w[(1, 0)] - w[(0, 1)]);
    let (xx, yy, zz) = (w[(0, 0)], w[(1, 1)], w[(2, 2)]);
    let (xy, xz, yz) = (w[(0, 1)] + w[(1, 0)], w[(0, 2)] + w[(2, 0)], w[(1, 2)] + w[(2, 1)]);
    Matrix4::new(
        xx + yy + zz, a, b, c,
        a, xx - yy - zz, xy, xz,
        b, xy, yy - xx - zz, yz,
        c, xz, yz, zz - xx - yy,
    )
}

/// [`rotation_form`] of `W = e e_x^T`: `e . t(p) = p^T S p`.
#[inline(always)]
#[rustfmt::skip]
pub fn tangent_form(e: &Vector3<f64>) -> Matrix4<f64> {
    let (x, y, z) = (e[0], e[1], e[2]);
    Matrix4::new(
        x, 0.0, -z, y,
        0.0, x, y, z,
        -z, y, -x, 0.0,
        y, z, 0.0, -x,
    )
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
    }

    #[test]
    fn rotation_is_the_sandwich_product_and_its_forms_agree() {
        let p = Quaternion::from(P);
        let (h, e) = (Vector3::new(0.3, -1.1, 0.7), Vector3::new(2.0, 0.4, -0.9));
        let sandwich = product(&product(&p, &Quaternion::new(0.0, h[0], h[1], h[2])), &conjugate(&p));
        close((rotation(&p) * h).as_slice(), &sandwich.as_slice()[1..]);
        close(tangent(&p).as_slice(), rotation(&p).column(0).as_slice());
        close(&[(rotation_form(&(e * h.transpose())) * p).dot(&p)], &[e.dot(&(rotation(&p) * h))]);
        close(&[(tangent_form(&e) * p).dot(&p)], &[e.dot(&tangent(&p))]);
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
