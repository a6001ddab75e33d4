//! Problem (15) on the affine map (11): outputs (16), (41), (45) and the cost as a quadratic of the tensions.

use crate::integrator::AffineMap;
use crate::math::block_tridiagonal::COORDINATES;
use crate::math::simd::add_scaled;
use crate::model::{Arm, Rates, State};
use nalgebra::{Vector3, Vector4};
use pulp::{Arch, Simd, WithSimd};

/// Desired outputs with their weights Q.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal<'a> {
    /// (41)-(42): the tip's coordinates, with rates of all nodes wanted at zero.
    Tip {
        /// Position (m, base frame).
        position: Vector3<f64>,
        /// Quaternion (body to base); either sign.
        quaternion: Vector4<f64>,
        /// Weight on position (per m^2) and quaternion.
        pose: f64,
        /// Weight on the tip's rates.
        rate: f64,
        /// Weight on the other nodes' rates.
        damping: f64,
    },
    /// (45)-(46): average curvatures of the segments, with rates wanted at zero.
    Shape {
        /// Curvatures (1/m), `(y, z)` segment by segment.
        curvatures: &'a [f64],
        /// Weight on curvatures.
        weight: f64,
        /// Weight on their rates over that (s^2); 1 in the paper.
        rate: f64,
    },
}

impl Goal<'_> {
    /// The quaternion in the hemisphere of the tip's, so that the error is the short way round.
    fn near(quaternion: &Vector4<f64>, tip: &Vector4<f64>) -> Vector4<f64> {
        if quaternion.dot(tip) < 0.0 { -quaternion } else { *quaternion }
    }

    /// `(y - yd)^T Q (y - yd)` at a state.
    pub fn error_cost(&self, arm: &Arm, state: &State, scratch: &mut [f64]) -> f64 {
        match *self {
            Self::Tip { position, quaternion, pose, rate, damping } => {
                let n = arm.node_count();
                let (r, p) = arm.pose(&state.q, n);
                let error = (r - position).norm_squared() + (p - Self::near(&quaternion, &p)).norm_squared();
                let sum = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
                let (others, tip) = state.qd.split_at(7 * (n - 1));
                pose * error + rate * sum(tip) + damping * sum(others)
            }
            Self::Shape { curvatures, weight, rate } => {
                let (k, kd) = scratch.split_at_mut(curvatures.len());
                arm.curvatures_into(&state.q, &state.qd, k, &mut kd[..curvatures.len()]);
                let error: f64 = k.iter().zip(curvatures).map(|(k, d)| (k - d).powi(2)).sum();
                weight * (error + rate * kd[..curvatures.len()].iter().map(|x| x * x).sum::<f64>())
            }
        }
    }
}

/// `J(u) = u^T A u + 2 b^T u + c` on the affine map, (15a).
#[derive(Debug, Clone)]
pub struct Quadratic {
    /// `A = S_y^T Q S_y + R + W`, row-major.
    pub a: Vec<f64>,
    /// `b = S_y^T Q e_0 - W u_{k-1}`.
    pub b: Vec<f64>,
    /// Constant part.
    pub c: f64,
    /// Sensitivities of the mean curvatures, then of their rates; rows x cables.
    rows: Vec<f64>,
    errors: Vec<f64>,
    /// Weight and slope of each row that the quadratic sums over.
    weights: Vec<f64>,
    slopes: Vec<f64>,
}

impl Quadratic {
    /// Room for an arm. Allocates.
    pub fn new(arm: &Arm) -> Self {
        let (nc, outputs) = (arm.cable_count(), 4 * arm.segment_count());
        Self {
            a: vec![0.0; nc * nc],
            b: vec![0.0; nc],
            c: 0.0,
            rows: vec![0.0; outputs * nc],
            errors: vec![0.0; outputs],
            weights: vec![0.0; (COORDINATES * arm.node_count()).max(outputs)],
            slopes: vec![0.0; (COORDINATES * arm.node_count()).max(outputs)],
        }
    }

    /// Builds the quadratic at an iterate `state` with its affine map; `tension` is R's diagonal entry, `change` W's
    /// diagonal. Does not allocate.
    pub fn build(
        &mut self,
        arm: &Arm,
        state: &State,
        rates: Rates,
        map: &AffineMap,
        goal: &Goal<'_>,
        tension: f64,
        change: &[f64],
        u_previous: &[f64],
    ) {
        let nc = map.cables;
        self.a.fill(0.0);
        self.b.fill(0.0);
        self.c = 0.0;
        self.weights.fill(0.0);
        match *goal {
            Goal::Tip { position, quaternion, pose, rate, damping } => {
                let n = arm.node_count();
                let (r, p) = arm.pose(&state.q, n);
                let near = Goal::near(&quaternion, &p);
                for i in 0..n {
                    let tip = i + 1 == n;
                    let rate_weight = if tip { rate } else { damping };
                    for c in 0..7 {
                        let row = COORDINATES * i + c;
                        // The coordinate's and its rate's corrections are one row: dq' = cg dq.
                        let e_rate = state.qd[7 * i + c] + rates.cg * map.x0[row];
                        self.weights[row] = rates.cg * rates.cg * rate_weight;
                        self.slopes[row] = rates.cg * rate_weight * e_rate;
                        self.c += rate_weight * e_rate * e_rate;
                        if tip {
                            let e = map.x0[row] + if c < 3 { r[c] - position[c] } else { p[c - 3] - near[c - 3] };
                            self.weights[row] += pose;
                            self.slopes[row] += pose * e;
                            self.c += pose * e * e;
                        }
                    }
                }
                Arch::new().dispatch(Gram {
                    a: &mut self.a,
                    b: &mut self.b,
                    rows: &map.x1,
                    weights: &self.weights,
                    slopes: &self.slopes,
                });
            }
            Goal::Shape { curvatures, weight, rate } => {
                let outputs = curvatures.len();
                self.curvature_rows(arm, state, rates, map);
                self.errors[..outputs].iter_mut().zip(curvatures).for_each(|(k, d)| *k -= d);
                self.weights[..outputs].fill(weight);
                self.weights[outputs..2 * outputs].fill(weight * rate);
                for ((slope, e), w) in self.slopes.iter_mut().zip(&self.errors).zip(&self.weights[..2 * outputs]) {
                    *slope = w * e;
                    self.c += w * e * e;
                }
                Arch::new().dispatch(Gram {
                    a: &mut self.a,
                    b: &mut self.b,
                    rows: &self.rows,
                    weights: &self.weights[..2 * outputs],
                    slopes: &self.slopes,
                });
            }
        }
        for i in 0..nc {
            self.a[i * nc + i] += tension + change[i];
            self.b[i] -= change[i] * u_previous[i];
            self.c += change[i] * u_previous[i] * u_previous[i];
        }
    }

    /// Mean curvatures and their rates at the iterate, after the correction without tensions, to `errors`; what tensions
    /// do to them, to `rows`.
    fn curvature_rows(&mut self, arm: &Arm, state: &State, rates: Rates, map: &AffineMap) {
        let (nc, outputs) = (map.cables, 2 * arm.segment_count());
        let (k, kd) = self.errors.split_at_mut(outputs);
        arm.curvatures_into(&state.q, &state.qd, k, kd);
        self.rows.fill(0.0);
        let (rows_k, rows_d) = self.rows.split_at_mut(outputs * nc);
        for (i, element) in arm.elements.iter().enumerate() {
            let sensitivity = arm.curvature_sensitivity(&state.q, &state.qd, i, rates.cg);
            for (node, k_rows, d_rows) in
                [(i, sensitivity.k[0], sensitivity.kd[0]), (i + 1, sensitivity.k[1], sensitivity.kd[1])]
            {
                if node == 0 {
                    continue;
                }
                for o in 0..2 {
                    let out = 2 * element.segment + o;
                    for c in 0..4 {
                        let row = COORDINATES * (node - 1) + 3 + c;
                        let (fk, fd) = (k_rows[(o, c)], d_rows[(o, c)]);
                        k[out] += fk * map.x0[row];
                        kd[out] += fd * map.x0[row];
                        for (j, x) in map.row(row).iter().enumerate() {
                            rows_k[out * nc + j] += fk * x;
                            rows_d[out * nc + j] += fd * x;
                        }
                    }
                }
            }
        }
    }

    /// False where the goal, the state or the tensions it was built from were not finite.
    pub fn is_finite(&self) -> bool {
        self.c.is_finite() && self.b.iter().chain(&self.a).all(|v| v.is_finite())
    }

    /// `J(u)` on the affine map.
    pub fn cost(&self, u: &[f64]) -> f64 {
        let n = u.len();
        let mut s = self.c;
        for i in 0..n {
            let row: f64 = self.a[i * n..(i + 1) * n].iter().zip(u).map(|(a, u)| a * u).sum();
            s += u[i] * (row + 2.0 * self.b[i]);
        }
        s
    }
}

/// `a += sum w_r s_r s_r^T`, `b += sum v_r s_r` over the rows `s_r` of a matrix, row by row of weights and slopes; rows of
/// weight zero cost nothing. Only whole vectors at and behind the diagonal are summed, then mirrored.
struct Gram<'a> {
    a: &'a mut [f64],
    b: &'a mut [f64],
    rows: &'a [f64],
    weights: &'a [f64],
    slopes: &'a [f64],
}

impl WithSimd for Gram<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { a, b, rows, weights, slopes } = self;
        let n = b.len();
        let mut group = [0usize; GROUP];
        let mut filled = 0;
        for (r, w) in weights.iter().enumerate() {
            if *w == 0.0 {
                continue;
            }
            add_scaled(simd, slopes[r], &rows[r * n..(r + 1) * n], b);
            group[filled] = r;
            filled += 1;
            if filled == GROUP {
                add_group(simd, rows, weights, &group, n, a);
                filled = 0;
            }
        }
        for r in &group[..filled] {
            let row = &rows[r * n..(r + 1) * n];
            for i in 0..n {
                let first = i / FIRST * FIRST;
                add_scaled(simd, weights[*r] * row[i], &row[first..], &mut a[i * n + first..(i + 1) * n]);
            }
        }
        for i in 0..n {
            for j in 0..i {
                a[i * n + j] = a[j * n + i];
            }
        }
    }
}

/// Rows that are added at once: each entry of `a` is then read and written once for all of them.
const GROUP: usize = 4;
/// Rows of `a` that are added to at once: each number of a row is then read once for both.
const PAIR: usize = 2;
/// Sums begin at a multiple of this at or before the diagonal: whole vectors where their number allows.
const FIRST: usize = 4;

/// Adds a group of rows to `a`, from the diagonal on.
#[inline(always)]
fn add_group<S: Simd>(simd: S, rows: &[f64], weights: &[f64], group: &[usize; GROUP], n: usize, a: &mut [f64]) {
    let x = [
        &rows[group[0] * n..][..n],
        &rows[group[1] * n..][..n],
        &rows[group[2] * n..][..n],
        &rows[group[3] * n..][..n],
    ];
    let w = [weights[group[0]], weights[group[1]], weights[group[2]], weights[group[3]]];
    let mut i = 0;
    while i + PAIR <= n {
        let at = i / FIRST * FIRST;
        let (upper, lower) = a[i * n..(i + PAIR) * n].split_at_mut(n);
        let heads = [
            S::as_simd_f64s(&x[0][at..]),
            S::as_simd_f64s(&x[1][at..]),
            S::as_simd_f64s(&x[2][at..]),
            S::as_simd_f64s(&x[3][at..]),
        ];
        let ((upper, upper_end), (lower, lower_end)) =
            (S::as_mut_simd_f64s(&mut upper[at..]), S::as_mut_simd_f64s(&mut lower[at..]));
        let x_at = [[x[0][i], x[0][i + 1]], [x[1][i], x[1][i + 1]], [x[2][i], x[2][i + 1]], [x[3][i], x[3][i + 1]]];
        let (mut f, mut g) = ([simd.splat_f64s(0.0); GROUP], [simd.splat_f64s(0.0); GROUP]);
        for k in 0..GROUP {
            (f[k], g[k]) = (simd.splat_f64s(w[k] * x_at[k][0]), simd.splat_f64s(w[k] * x_at[k][1]));
        }
        for v in 0..upper.len() {
            let (mut above, mut below) = (upper[v], lower[v]);
            for k in 0..GROUP {
                let x = heads[k].0[v];
                above = simd.mul_add_e_f64s(f[k], x, above);
                below = simd.mul_add_e_f64s(g[k], x, below);
            }
            (upper[v], lower[v]) = (above, below);
        }
        for c in 0..upper_end.len() {
            for k in 0..GROUP {
                let x = heads[k].1[c];
                upper_end[c] += w[k] * x_at[k][0] * x;
                lower_end[c] += w[k] * x_at[k][1] * x;
            }
        }
        i += PAIR;
    }
    // An odd number leaves the last entry.
    if i < n {
        for k in 0..GROUP {
            a[i * n + i] += w[k] * x[k][i] * x[k][i];
        }
    }
}

/// `u^T R u + du^T W du`.
pub fn tension_cost(tension: f64, change: &[f64], u: &[f64], u_previous: &[f64]) -> f64 {
    u.iter().zip(u_previous).zip(change).map(|((u, v), w)| tension * u * u + w * (u - v).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_rows_are_those_of_the_formula_for_every_number_of_cables_and_rows() {
        for n in [1, 2, 3, 5, 6, 7, 12, 24, 25] {
            for count in [0, 1, 3, 4, 9] {
                let rows: Vec<f64> = (0..count * n).map(|k| (k as f64 * 0.7).sin()).collect();
                // Every third row has no weight.
                let weights: Vec<f64> = (0..count).map(|r| ((r + 1) % 3) as f64).collect();
                let slopes: Vec<f64> = weights.iter().map(|w| 2.0 * w).collect();
                let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n]);
                let gram = Gram { a: &mut a, b: &mut b, rows: &rows, weights: &weights, slopes: &slopes };
                Arch::new().dispatch(gram);
                for i in 0..n {
                    let linear: f64 = (0..count).map(|r| slopes[r] * rows[r * n + i]).sum();
                    assert!((b[i] - linear).abs() < 1e-13, "{n} {count}");
                    for j in 0..n {
                        let want: f64 = (0..count).map(|r| weights[r] * rows[r * n + i] * rows[r * n + j]).sum();
                        assert!((a[i * n + j] - want).abs() < 1e-13, "{n} cables, {count} rows: {i} {j}");
                        assert_eq!(a[i * n + j], a[j * n + i]);
                    }
                }
            }
        }
    }
}
