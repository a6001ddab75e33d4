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
use crate::math::quaternion::{axes, axis_jacobians, pure_times, rotation_form};
use crate::math::simd::{Columns, Number, inner};
use nalgebra::{Vector3, Vector4};

/// Both ends of an element, or of several side by side: what all cables there need.
pub(super) struct Span<V> {
    /// From hole to hole where both are at the disks' centres, and how that changes with `h_y` and `h_z`.
    centre: [V; 3],
    across: [[V; 3]; 2],
    /// Local y and z of both disks.
    axes: [[[V; 3]; 2]; 2],
    p: [[V; 4]; 2],
    /// `-2 p e_k`.
    product: [[[V; 4]; 3]; 2],
    connector: V,
}

/// A cable in an element, or in several: direction, length, and where its derivative acts.
pub(super) struct Leg<V> {
    /// Unit vector from the hole in disk i to the hole in disk j.
    pub(super) direction: [V; 3],
    /// Distance between the holes (m).
    pub(super) length: V,
    /// One over it (1/m).
    pub(super) inverse: V,
    /// `D_i^T e` and `D_j^T e`: what a unit tension does to the quaternions; the length's derivative is minus the first
    /// and plus the second.
    pub(super) forces: [[V; 4]; 2],
}

/// Tangent blocks of `-G u` summed over the cables of an element.
pub(super) struct Stiffness<V> {
    /// `sum u P`, `P = (I - e e^T)/length`: blocks r_i r_i and r_j r_j; its negative is r_i r_j.
    pub(super) rr: [[V; 3]; 3],
    /// `sum u P D_i`, `sum u P D_j`.
    pub(super) rp: [[[V; 4]; 3]; 2],
    /// Quaternion blocks ii, ij, jj.
    pub(super) pp: [[[V; 4]; 4]; 3],
    /// `sum u e`, the force on the position of disk i; on that of disk j its negative.
    pub(super) pull: [V; 3],
    /// `sum u D_i^T e`, `sum u D_j^T e`.
    pub(super) turn: [[V; 4]; 2],
}

/// `-2 p e_k` for the three axes.
#[inline(always)]
#[rustfmt::skip]
fn axis_products<V: Number>([w, x, y, z]: [V; 4]) -> [[V; 4]; 3] {
    let (w, x, y, z) = (w * -2.0, x * -2.0, y * -2.0, z * -2.0);
    [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
}

/// `a_0 x_0 + a_1 x_1 + a_2 x_2`, each of N numbers.
#[inline(always)]
fn combine<V: Number, const N: usize>(a: [V; 3], x: &[[V; N]; 3]) -> [V; N] {
    let mut sum = x[0];
    for k in 0..N {
        sum[k] = a[0].multiply_add(x[0][k], a[1].multiply_add(x[1][k], a[2] * x[2][k]));
    }
    sum
}

#[inline(always)]
fn plus<V: Number>(mut a: [V; 4], b: [V; 4]) -> [V; 4] {
    for k in 0..4 {
        a[k] = a[k] + b[k];
    }
    a
}

impl Span<f64> {
    /// Of one element.
    pub(super) fn of(e: &Element, ri: Vector3<f64>, pi: Vector4<f64>, rj: Vector3<f64>, pj: Vector4<f64>) -> Self {
        Self::new(e.connector, [ri.into(), rj.into()], [pi.into(), pj.into()])
    }

    /// Distance between the holes (m).
    pub(super) fn length(&self, pass: &HolePass) -> f64 {
        self.pass(pass).length
    }

    /// The cable of a passage.
    pub(super) fn pass(&self, pass: &HolePass) -> Leg<f64> {
        if pass.hole == pass.end {
            self.leg(pass.hole[1], pass.hole[2])
        } else {
            self.leg_between([[pass.hole[1], pass.hole[2]], [pass.end[1], pass.end[2]]])
        }
    }
}

impl<V: Number> Span<V> {
    /// From the connector's length (m), positions (m) and quaternions.
    #[inline(always)]
    pub(super) fn new(connector: V, r: [[V; 3]; 2], p: [[V; 4]; 2]) -> Self {
        let (i, j) = (axes(p[0]), axes(p[1]));
        let (mut centre, mut across) = (r[0], [r[0]; 2]);
        for k in 0..3 {
            centre[k] = r[1][k] - r[0][k] - connector * i[0][k];
            across[0][k] = j[1][k] - i[1][k];
            across[1][k] = j[2][k] - i[2][k];
        }
        let axes = [[i[1], i[2]], [j[1], j[2]]];
        Self { centre, across, axes, p, product: [axis_products(p[0]), axis_products(p[1])], connector }
    }

    /// The cable through the holes at `y`, `z`.
    #[inline(always)]
    pub(super) fn leg(&self, y: V, z: V) -> Leg<V> {
        let [ay, az] = &self.across;
        let mut d = self.centre;
        for k in 0..3 {
            d[k] = ay[k].multiply_add(y, az[k].multiply_add(z, d[k]));
        }
        self.along(d, [[y, z]; 2])
    }

    /// The cable through the holes `[y, z]` of disk i and of disk j.
    #[inline(always)]
    pub(super) fn leg_between(&self, holes: [[V; 2]; 2]) -> Leg<V> {
        let [[iy, iz], [jy, jz]] = &self.axes;
        let mut d = self.centre;
        for k in 0..3 {
            d[k] = jy[k].multiply_add(holes[1][0], jz[k].multiply_add(holes[1][1], d[k]));
            d[k] = d[k] - iy[k].multiply_add(holes[0][0], iz[k] * holes[0][1]);
        }
        self.along(d, holes)
    }

    /// The cable along `d` from hole to hole.
    #[inline(always)]
    fn along(&self, d: [V; 3], [[y, z], [y_end, z_end]]: [[V; 2]; 2]) -> Leg<V> {
        let length = inner(&d, &d).square_root();
        let inverse = length.inverse();
        let direction = [d[0] * inverse, d[1] * inverse, d[2] * inverse];
        let (i, [_, jy, jz]) = (combine([self.connector, y, z], &self.product[0]), &self.product[1]);
        let mut j = *jy;
        for k in 0..4 {
            j[k] = jy[k].multiply_add(y_end, jz[k] * z_end);
        }
        Leg { direction, length, inverse, forces: [pure_times(direction, i), pure_times(direction, j)] }
    }
}

impl<V: Number> Stiffness<V> {
    /// From the sums over the cables: what each gives by its direction, `-w [e; a_i; a_j] [e; a_i; a_j]^T`, what the
    /// moments of the holes give, and the rotations' second derivatives.
    #[inline(always)]
    pub(super) fn new<W: Columns<Value = V>>(vectors: W, span: &Span<V>, sums: &Sums<V>) -> Self {
        let zero = vectors.splat(0.0);
        let g = &sums.gram;
        let (w, [[y, z], [y_end, z_end]]) = (sums.weight, sums.first);
        let [[[yy, yz], [_, zz]], between, ends] = sums.second;
        let (con, product) = (span.connector, &span.product);
        let (u, [[uy, uz], [uy_end, uz_end]]) = (sums.pull, sums.pull_at);
        let ux = [con * u[0], con * u[1], con * u[2]];
        let (ji, jj) = (axis_jacobians(span.p[0]), axis_jacobians(span.p[1]));
        let mut k = Self {
            rr: [[zero; 3]; 3],
            rp: [[[zero; 4]; 3]; 2],
            pp: [[[zero; 4]; 4]; 3],
            pull: u,
            turn: [
                plus(pure_times(ux, product[0][0]), plus(pure_times(uy, product[0][1]), pure_times(uz, product[0][2]))),
                plus(pure_times(uy_end, product[1][1]), pure_times(uz_end, product[1][2])),
            ],
        };
        let [i, j] = FORCE;
        // Moments about all axes, of which disk i's connector fills the first.
        let first = [con * w, y, z];
        for r in 0..3 {
            for c in 0..3 {
                k.rr[r][c] = -g[r.min(c)][r.max(c)];
            }
            k.rr[r][r] = k.rr[r][r] + w;
            for c in 0..4 {
                k.rp[0][r][c] = inner(&first, &[ji[0][r][c], ji[1][r][c], ji[2][r][c]]) - g[r][i + c];
                k.rp[1][r][c] = y_end.multiply_add(jj[1][r][c], z_end * jj[2][r][c]) - g[r][j + c];
            }
        }
        let (cy, cz) = (con * y, con * z);
        let second = [[con * first[0], cy, cz], [cy, yy, yz], [cz, yz, zz]];
        // Those of disk i's holes, connector included, with disk j's.
        let mixed = [[con * y_end, con * z_end], between[0], between[1]];
        // D_i^T D_j with the connector in the hole of disk i alone.
        let mut cross = [[zero; 4]; 4];
        for axis in 0..3 {
            for r in 0..3 {
                for c in 0..4 {
                    let t = mixed[axis][0].multiply_add(jj[1][r][c], mixed[axis][1] * jj[2][r][c]);
                    for q in 0..4 {
                        cross[q][c] = ji[axis][r][q].multiply_add(t, cross[q][c]);
                    }
                }
            }
        }
        for r in 0..4 {
            for c in 0..4 {
                k.pp[0][r][c] = -g[i + r.min(c)][i + r.max(c)];
                k.pp[1][r][c] = g[i + r][j + c] - cross[r][c];
                k.pp[2][r][c] = -g[j + r.min(c)][j + r.max(c)];
            }
        }
        // D^T D of one end: 4 |p|^2 tr(second) less the products.
        for axis in 0..3 {
            let q = combine(second[axis], &product[0]);
            for r in 0..4 {
                for c in 0..4 {
                    k.pp[0][r][c] = (-product[0][axis][r]).multiply_add(q[c], k.pp[0][r][c]);
                }
            }
        }
        for axis in 1..3 {
            for c in 0..4 {
                let of_axis = ends[axis - 1];
                let q = of_axis[0].multiply_add(product[1][1][c], of_axis[1] * product[1][2][c]);
                for r in 0..4 {
                    k.pp[2][r][c] = (-product[1][axis][r]).multiply_add(q, k.pp[2][r][c]);
                }
            }
        }
        let trace = [
            (second[0][0] + (yy + zz)) * inner(&span.p[0], &span.p[0]),
            (ends[0][0] + ends[1][1]) * inner(&span.p[1], &span.p[1]),
        ];
        let (of_i, of_j) = (rotation_form([ux, uy, uz]), rotation_form([[zero; 3], uy_end, uz_end]));
        for r in 0..4 {
            k.pp[0][r][r] = k.pp[0][r][r] + trace[0] * 4.0;
            k.pp[2][r][r] = k.pp[2][r][r] + trace[1] * 4.0;
            for c in 0..4 {
                k.pp[0][r][c] = k.pp[0][r][c] - of_i[r][c] * 2.0;
                k.pp[2][r][c] = k.pp[2][r][c] + of_j[r][c] * 2.0;
            }
        }
        k
    }
}
