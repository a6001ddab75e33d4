//! Cables: straight from hole to hole, `length = sum |r_j + R_j h - r_i - R_i x|`, `x = h + L_con e_x`.
//!
//! `G = -(d length / dq)^T`, and `G u` depends on q: its derivative `-u d^2 length / dq^2` belongs to the tangent.
//!
//! With `D(h) = d(R(p) h)/dp` and a direction e, two identities of the homogeneous rotation keep the work per cable
//! small (quaternion products, e and h as pure quaternions):
//! `D(h)^T e = -2 e (p h)` and `D(h)^T D(h) = 4 (|p|^2 |h|^2 I - (p h)(p h)^T)`. Whatever is quadratic in the hole
//! alone is summed over an element's cables as moments of the holes and multiplied out once.

use super::arm::{Element, HolePass};
use crate::math::quaternion::{rotation, rotation_form, rotation_jacobians};
use nalgebra::{Matrix3, Matrix3x4, Matrix4, Vector3, Vector4};

/// Positions, rotations and their derivatives at the two ends of an element, computed once for all its cables.
pub(super) struct Span {
    chord: Vector3<f64>,
    rotation: [Matrix3<f64>; 2],
    /// `dR e_k/dp`.
    pub(super) jacobians: [[Matrix3x4<f64>; 3]; 2],
    /// `p e_k`.
    product: [[Vector4<f64>; 3]; 2],
    norm_squared: [f64; 2],
    connector: f64,
}

/// One cable in one element: direction, length, and where its derivative acts.
pub(super) struct Leg {
    /// Unit vector from the hole in disk i to the hole in disk j.
    pub(super) direction: Vector3<f64>,
    /// Distance between the holes (m).
    pub(super) length: f64,
    /// `D_i^T e` and `D_j^T e`: what a unit tension does to the quaternions; the length's derivative is minus the first
    /// and plus the second.
    pub(super) forces: [Vector4<f64>; 2],
}

/// Tangent blocks of `-G u` summed over the cables of an element.
pub(super) struct Stiffness {
    /// `sum u P`, `P = (I - e e^T)/length`: blocks r_i r_i and r_j r_j; its negative is r_i r_j.
    pub(super) rr: Matrix3<f64>,
    /// `sum u P D_i`, `sum u P D_j`.
    pub(super) rp: [Matrix3x4<f64>; 2],
    /// Quaternion blocks ii, ij, jj.
    pub(super) pp: [Matrix4<f64>; 3],
    /// `sum w [1, h_y, h_z, h_y^2, h_y h_z, h_z^2]`, `w = u/length`.
    moments: [f64; 6],
    /// `sum u e [1, h_y, h_z]`.
    pull: [Vector3<f64>; 3],
}

/// `p e_k` for the three axes.
#[inline(always)]
#[rustfmt::skip]
fn axis_products(p: &Vector4<f64>) -> [Vector4<f64>; 3] {
    let (w, x, y, z) = (p[0], p[1], p[2], p[3]);
    [Vector4::new(-x, w, z, -y), Vector4::new(-y, -z, w, x), Vector4::new(-z, y, -x, w)]
}

/// `-2 e q` for a pure e.
#[inline(always)]
fn pull_on(e: &Vector3<f64>, q: &Vector4<f64>) -> Vector4<f64> {
    let (x, y, z) = (-2.0 * e[0], -2.0 * e[1], -2.0 * e[2]);
    Vector4::new(
        -(x * q[1] + y * q[2] + z * q[3]),
        x * q[0] + y * q[3] - z * q[2],
        y * q[0] + z * q[1] - x * q[3],
        z * q[0] + x * q[2] - y * q[1],
    )
}

impl Span {
    #[inline(always)]
    pub(super) fn new(e: &Element, ri: &Vector3<f64>, pi: &Vector4<f64>, rj: &Vector3<f64>, pj: &Vector4<f64>) -> Self {
        Self {
            chord: rj - ri,
            rotation: [rotation(pi), rotation(pj)],
            jacobians: [rotation_jacobians(pi), rotation_jacobians(pj)],
            product: [axis_products(pi), axis_products(pj)],
            norm_squared: [pi.norm_squared(), pj.norm_squared()],
            connector: e.connector,
        }
    }

    #[inline(always)]
    fn vector(&self, hole: &Vector3<f64>) -> Vector3<f64> {
        let [ri, rj] = &self.rotation;
        let mut d = self.chord;
        for k in 0..3 {
            d[k] +=
                hole[1] * (rj[(k, 1)] - ri[(k, 1)]) + hole[2] * (rj[(k, 2)] - ri[(k, 2)]) - self.connector * ri[(k, 0)];
        }
        d
    }

    /// Distance between the holes (m).
    pub(super) fn length(&self, pass: &HolePass) -> f64 {
        self.vector(&pass.hole).norm()
    }

    #[inline(always)]
    pub(super) fn leg(&self, pass: &HolePass) -> Leg {
        let h = &pass.hole;
        let d = self.vector(h);
        let length = d.norm();
        let direction = d / length;
        let at = |p: &[Vector4<f64>; 3], x: f64| p[1] * h[1] + p[2] * h[2] + p[0] * x;
        let forces = [
            pull_on(&direction, &at(&self.product[0], self.connector)),
            pull_on(&direction, &at(&self.product[1], 0.0)),
        ];
        Leg { direction, length, forces }
    }
}

impl Stiffness {
    #[inline(always)]
    pub(super) fn zeros() -> Self {
        Self {
            rr: Matrix3::zeros(),
            rp: [Matrix3x4::zeros(); 2],
            pp: [Matrix4::zeros(); 3],
            moments: [0.0; 6],
            pull: [Vector3::zeros(); 3],
        }
    }

    /// Adds what one cable gives by its direction, `-w [e; a_i; a_j] [e; a_i; a_j]^T`, and the moments of its hole.
    #[inline(always)]
    pub(super) fn add(&mut self, tension: f64, pass: &HolePass, leg: &Leg) {
        let w = tension / leg.length;
        let e = &leg.direction;
        let [ai, aj] = &leg.forces;
        let (we, wi, wj) = (e * w, ai * w, aj * w);
        for c in 0..3 {
            for r in 0..3 {
                self.rr[(r, c)] -= e[r] * we[c];
            }
        }
        for c in 0..4 {
            for r in 0..3 {
                self.rp[0][(r, c)] -= e[r] * wi[c];
                self.rp[1][(r, c)] -= e[r] * wj[c];
            }
            for r in 0..4 {
                self.pp[0][(r, c)] -= ai[r] * wi[c];
                self.pp[1][(r, c)] += ai[r] * wj[c];
                self.pp[2][(r, c)] -= aj[r] * wj[c];
            }
        }
        let (y, z) = (pass.hole[1], pass.hole[2]);
        let (wy, wz) = (w * y, w * z);
        for (m, v) in self.moments.iter_mut().zip([w, wy, wz, wy * y, wy * z, wz * z]) {
            *m += v;
        }
        let u = e * tension;
        self.pull[0] += u;
        self.pull[1] += u * y;
        self.pull[2] += u * z;
    }

    /// Adds what the moments give: the rest of `u D^T P D`, and the rotations' second derivatives.
    #[inline(always)]
    pub(super) fn finish(&mut self, span: &Span) {
        let [w, y, z, yy, yz, zz] = self.moments;
        let con = span.connector;
        let ([ji, jj], [pi, pj]) = (&span.jacobians, &span.product);
        for k in 0..3 {
            self.rr[(k, k)] += w;
        }
        self.rp[0] += ji[0] * (con * w) + ji[1] * y + ji[2] * z;
        self.rp[1] += jj[1] * y + jj[2] * z;
        // D_i^T D_j with the connector in the hole of disk i alone.
        let toward = [jj[1] * (con * y) + jj[2] * (con * z), jj[1] * yy + jj[2] * yz, jj[1] * yz + jj[2] * zz];
        for (k, t) in toward.iter().enumerate() {
            if k > 0 || con != 0.0 {
                for c in 0..4 {
                    for r in 0..4 {
                        self.pp[1][(r, c)] -=
                            ji[k][(0, r)] * t[(0, c)] + ji[k][(1, r)] * t[(1, c)] + ji[k][(2, r)] * t[(2, c)];
                    }
                }
            }
        }
        // D^T D of one end: moments about all axes, of which the connector fills the first.
        let moments = [[con * con * w, con * y, con * z], [con * y, yy, yz], [con * z, yz, zz]];
        for (block, p, n, first) in
            [(0, pi, span.norm_squared[0], usize::from(con == 0.0)), (2, pj, span.norm_squared[1], 1)]
        {
            let mut trace = 0.0;
            for k in first..3 {
                trace += moments[k][k];
                let mut q = Vector4::zeros();
                for l in first..3 {
                    q += p[l] * (4.0 * moments[k][l]);
                }
                for c in 0..4 {
                    for r in 0..4 {
                        self.pp[block][(r, c)] -= p[k][r] * q[c];
                    }
                }
            }
            for k in 0..4 {
                self.pp[block][(k, k)] += 4.0 * n * trace;
            }
        }
        let [u, uy, uz] = &self.pull;
        self.pp[0] -= 2.0 * rotation_form(&Matrix3::from_columns(&[u * con, *uy, *uz]));
        self.pp[2] += 2.0 * rotation_form(&Matrix3::from_columns(&[Vector3::zeros(), *uy, *uz]));
    }
}
