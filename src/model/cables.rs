//! Cables: straight from hole to hole, `length = sum |r_j + R_j h - r_i - R_i x|`, `x = h + L_con e_x`.
//!
//! `G = -(d length / dq)^T`, and `G u` depends on q: its derivative `-u d^2 length / dq^2` belongs to the tangent.
//!
//! With `D(h) = d(R(p) h)/dp` and a direction e, two identities of the homogeneous rotation keep the work per cable
//! small (quaternion products, e and h as pure quaternions):
//! `D(h)^T e = -2 e (p h)` and `D(h)^T D(h) = 4 (|p|^2 |h|^2 I - (p h)(p h)^T)`. Whatever is quadratic in the hole
//! alone is summed over an element's cables as moments of the holes and multiplied out once.

use super::arm::{Element, HolePass};
use super::legs::{FORCE, Sums};
use crate::math::quaternion::{rotation, rotation_form, rotation_jacobians};
use crate::math::simd::{Columns, Scalars};
use nalgebra::{Matrix3, Matrix3x4, Matrix4, Vector3, Vector4};

/// Positions, rotations and their derivatives at the two ends of an element, computed once for all its cables.
pub(super) struct Span {
    /// From hole to hole where both are at the disks' centres, and how that changes with `h_y` and `h_z`.
    centre: Vector3<f64>,
    across: [Vector3<f64>; 2],
    /// `dR e_k/dp`.
    pub(super) jacobians: [[Matrix3x4<f64>; 3]; 2],
    /// `p e_k`.
    product: [[Vector4<f64>; 3]; 2],
    norm_squared: [f64; 2],
    connector: f64,
}

/// Some cables in one element (one number each in `V`): direction, length, and where its derivative acts.
pub(super) struct Legs<V> {
    /// Unit vector from the hole in disk i to the hole in disk j.
    pub(super) direction: [V; 3],
    /// Distance between the holes (m).
    pub(super) length: V,
    /// `D_i^T e` and `D_j^T e`: what a unit tension does to the quaternions; the length's derivative is minus the first
    /// and plus the second.
    pub(super) forces: [[V; 4]; 2],
}

/// [`Legs`] of one cable.
pub(super) struct Leg {
    pub(super) direction: Vector3<f64>,
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
    /// `sum u e`, the force on the position of disk i; on that of disk j its negative.
    pub(super) pull: Vector3<f64>,
    /// `sum u D_i^T e`, `sum u D_j^T e`.
    pub(super) turn: [Vector4<f64>; 2],
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
fn pull_on<W: Columns>(w: W, e: &[W::Value; 3], q: &[W::Value; 4]) -> [W::Value; 4] {
    let (minus, plus) = (w.splat(-2.0), w.splat(2.0));
    let [x, y, z] = [w.multiply(e[0], minus), w.multiply(e[1], minus), w.multiply(e[2], minus)];
    let [mx, my, mz] = [w.multiply(e[0], plus), w.multiply(e[1], plus), w.multiply(e[2], plus)];
    [
        dot3(w, [mx, my, mz], [q[1], q[2], q[3]]),
        dot3(w, [x, y, mz], [q[0], q[3], q[2]]),
        dot3(w, [y, z, mx], [q[0], q[1], q[3]]),
        dot3(w, [z, x, my], [q[0], q[2], q[1]]),
    ]
}

#[inline(always)]
fn dot3<W: Columns>(w: W, a: [W::Value; 3], b: [W::Value; 3]) -> W::Value {
    w.multiply_add(a[0], b[0], w.multiply_add(a[1], b[1], w.multiply(a[2], b[2])))
}

/// `c + a_y y + a_z z` of a hole at `y`, `z`.
#[inline(always)]
fn at<W: Columns>(w: W, c: f64, a: [f64; 2], hole: [W::Value; 2]) -> W::Value {
    w.multiply_add(w.splat(a[0]), hole[0], w.multiply_add(w.splat(a[1]), hole[1], w.splat(c)))
}

/// `p (x e_x + h)`.
#[inline(always)]
fn product_at<W: Columns>(w: W, p: &[Vector4<f64>; 3], x: f64, hole: [W::Value; 2]) -> [W::Value; 4] {
    let [px, py, pz] = p;
    [
        at(w, px[0] * x, [py[0], pz[0]], hole),
        at(w, px[1] * x, [py[1], pz[1]], hole),
        at(w, px[2] * x, [py[2], pz[2]], hole),
        at(w, px[3] * x, [py[3], pz[3]], hole),
    ]
}

impl Span {
    #[inline(always)]
    pub(super) fn new(e: &Element, ri: &Vector3<f64>, pi: &Vector4<f64>, rj: &Vector3<f64>, pj: &Vector4<f64>) -> Self {
        let (si, sj) = (rotation(pi), rotation(pj));
        Self {
            centre: rj - ri - si.column(0) * e.connector,
            across: [sj.column(1) - si.column(1), sj.column(2) - si.column(2)],
            jacobians: [rotation_jacobians(pi), rotation_jacobians(pj)],
            product: [axis_products(pi), axis_products(pj)],
            norm_squared: [pi.norm_squared(), pj.norm_squared()],
            connector: e.connector,
        }
    }

    /// Distance between the holes (m).
    #[inline(always)]
    pub(super) fn length(&self, pass: &HolePass) -> f64 {
        (self.centre + self.across[0] * pass.hole[1] + self.across[1] * pass.hole[2]).norm()
    }

    #[inline(always)]
    pub(super) fn leg(&self, pass: &HolePass) -> Leg {
        let Legs { direction, forces, .. } = self.legs(Scalars, pass.hole[1], pass.hole[2]);
        Leg { direction: direction.into(), forces: forces.map(Vector4::from) }
    }

    /// Legs of the cables through the holes at `y`, `z`.
    #[inline(always)]
    pub(super) fn legs<W: Columns>(&self, w: W, y: W::Value, z: W::Value) -> Legs<W::Value> {
        let hole = [y, z];
        let ([ay, az], c) = (&self.across, &self.centre);
        let d =
            [at(w, c[0], [ay[0], az[0]], hole), at(w, c[1], [ay[1], az[1]], hole), at(w, c[2], [ay[2], az[2]], hole)];
        let length = w.square_root(dot3(w, d, d));
        let inverse = w.divide(w.splat(1.0), length);
        let direction = [w.multiply(d[0], inverse), w.multiply(d[1], inverse), w.multiply(d[2], inverse)];
        let pi = product_at(w, &self.product[0], self.connector, hole);
        let pj = product_at(w, &self.product[1], 0.0, hole);
        Legs { direction, length, forces: [pull_on(w, &direction, &pi), pull_on(w, &direction, &pj)] }
    }
}

impl Stiffness {
    /// From the sums over the cables: what each gives by its direction, `-w [e; a_i; a_j] [e; a_i; a_j]^T`, what the
    /// moments of the holes give, and the rotations' second derivatives.
    #[inline(always)]
    pub(super) fn new(span: &Span, sums: &Sums) -> Self {
        let g = &sums.gram;
        let [w, y, z, yy, yz, zz] = sums.moments;
        let con = span.connector;
        let ([ji, jj], [pi, pj]) = (&span.jacobians, &span.product);
        let [u, uy, uz] = sums.pull.map(Vector3::from);
        let mut k = Self {
            rr: Matrix3::zeros(),
            rp: [Matrix3x4::zeros(); 2],
            pp: [Matrix4::zeros(); 3],
            pull: u,
            turn: [
                ji[0].tr_mul(&u) * con + ji[1].tr_mul(&uy) + ji[2].tr_mul(&uz),
                jj[1].tr_mul(&uy) + jj[2].tr_mul(&uz),
            ],
        };
        let [i, j] = FORCE;
        for c in 0..3 {
            for r in 0..3 {
                k.rr[(r, c)] = -g[r.min(c)][r.max(c)];
            }
            k.rr[(c, c)] += w;
        }
        for c in 0..4 {
            for r in 0..3 {
                k.rp[0][(r, c)] = -g[r][i + c];
                k.rp[1][(r, c)] = -g[r][j + c];
            }
            for r in 0..4 {
                k.pp[0][(r, c)] = -g[i + r.min(c)][i + r.max(c)];
                k.pp[1][(r, c)] = g[i + r][j + c];
                k.pp[2][(r, c)] = -g[j + r.min(c)][j + r.max(c)];
            }
        }
        k.rp[0] += ji[0] * (con * w) + ji[1] * y + ji[2] * z;
        k.rp[1] += jj[1] * y + jj[2] * z;
        // D_i^T D_j with the connector in the hole of disk i alone.
        let toward = [jj[1] * (con * y) + jj[2] * (con * z), jj[1] * yy + jj[2] * yz, jj[1] * yz + jj[2] * zz];
        for (axis, t) in toward.iter().enumerate() {
            if axis > 0 || con != 0.0 {
                for c in 0..4 {
                    for r in 0..4 {
                        k.pp[1][(r, c)] -=
                            ji[axis][(0, r)] * t[(0, c)] + ji[axis][(1, r)] * t[(1, c)] + ji[axis][(2, r)] * t[(2, c)];
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
            for axis in first..3 {
                trace += moments[axis][axis];
                let mut q = Vector4::zeros();
                for l in first..3 {
                    q += p[l] * (4.0 * moments[axis][l]);
                }
                for c in 0..4 {
                    for r in 0..4 {
                        k.pp[block][(r, c)] -= p[axis][r] * q[c];
                    }
                }
            }
            for c in 0..4 {
                k.pp[block][(c, c)] += 4.0 * n * trace;
            }
        }
        k.pp[0] -= 2.0 * rotation_form(&Matrix3::from_columns(&[u * con, uy, uz]));
        k.pp[2] += 2.0 * rotation_form(&Matrix3::from_columns(&[Vector3::zeros(), uy, uz]));
        k
    }
}
