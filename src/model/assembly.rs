//! The terms of (1), their sum (7), and the total tangent S of (14) in block-tridiagonal form.

use super::arm::Arm;
use super::cables::{Span, Stiffness};
use super::elastic::{self, Ends};
use super::legs::{LegGroup, Sums, WIDE};
use super::{chord, inertia};
use crate::math::block_tridiagonal::{BLOCK, Block, BlockTridiagonal};
use crate::math::quaternion::{body_rate, rotation_jacobians, tangent};
use crate::math::simd::{Columns, Lanes, Scalars};
use nalgebra::{Matrix3, Matrix3x4, Vector3, Vector4};
use pulp::{Arch, Simd, WithSimd};

/// Coordinates, rates, accelerations (7N each) and multipliers (4N) at which the equations are evaluated.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// `q`.
    pub q: &'a [f64],
    /// `q'`.
    pub qd: &'a [f64],
    /// `q''`.
    pub qdd: &'a [f64],
    /// `lambda`.
    pub lambda: &'a [f64],
}

impl<'a> From<&'a super::State> for Motion<'a> {
    fn from(s: &'a super::State) -> Self {
        Self { q: &s.q, qd: &s.qd, qdd: &s.qdd, lambda: &s.lambda }
    }
}

/// How rates and accelerations follow the coordinates in one step: `dq'/dq = cg`, `dq''/dq = cb`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// 1/s.
    pub cg: f64,
    /// 1/s^2.
    pub cb: f64,
}

impl Rates {
    /// Statics: coordinates alone.
    pub const STATIC: Self = Self { cg: 0.0, cb: 0.0 };
}

/// `S`, `f`, `B u` and `B` at one iterate, multipliers scaled (see NOTATION).
#[derive(Debug, Clone)]
pub struct Linearization {
    /// Total tangent (14), with `-d(G u)/dq`.
    pub tangent: BlockTridiagonal,
    /// `f` of (7), 11N: without the cables' forces.
    pub f: Vec<f64>,
    /// `B u` at the tensions that it was made at, 11N; rows of the multipliers are zero.
    pub pull: Vec<f64>,
    /// Scaling of the multipliers: `lambda = scale * (their unknown)`.
    pub scale: f64,
    /// What `B` is made of: legs of each element's cables, and whether its end's quaternion was flipped.
    pub(super) legs: Vec<LegGroup>,
    pub(super) sign: Vec<f64>,
}

impl Linearization {
    /// Room for an arm. Allocates.
    pub fn new(arm: &Arm) -> Self {
        let n = arm.node_count();
        Self {
            tangent: BlockTridiagonal::zeros(n),
            f: vec![0.0; BLOCK * n],
            pull: vec![0.0; BLOCK * n],
            scale: 1.0,
            legs: vec![LegGroup::ZERO; arm.holes.len()],
            sign: vec![1.0; n],
        }
    }
}

/// Quaternions of an element's ends with `p_j` flipped into the hemisphere of `p_i`; `sign` tells whether.
#[inline(always)]
pub(super) fn ends(arm: &Arm, q: &[f64], qd: &[f64], i: usize) -> (Ends, f64) {
    let (pi, pj) = (arm.pose(q, i).1, arm.pose(q, i + 1).1);
    let (pdi, pdj) = (arm.rate(qd, i).1, arm.rate(qd, i + 1).1);
    let sign = if pi.dot(&pj) < 0.0 { -1.0 } else { 1.0 };
    (Ends { pi, pj: sign * pj, pdi, pdj: sign * pdj }, sign)
}

#[inline(always)]
fn add3(out: &mut [f64], at: usize, v: &Vector3<f64>, f: f64) {
    for k in 0..3 {
        out[at + k] += f * v[k];
    }
}

#[inline(always)]
fn add4(out: &mut [f64], at: usize, v: &Vector4<f64>, f: f64) {
    for k in 0..4 {
        out[at + k] += f * v[k];
    }
}

#[inline(always)]
fn vector4(s: &[f64], at: usize) -> Vector4<f64> {
    Vector4::new(s[at], s[at + 1], s[at + 2], s[at + 3])
}

#[inline(always)]
fn vector3(s: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(s[at], s[at + 1], s[at + 2])
}

// Single terms, added into vectors of 7N (or 4N) numbers. The residual is their sum; golden data check each.
impl Arm {
    /// Adds `M(q) q''`.
    pub fn add_inertia(&self, q: &[f64], qdd: &[f64], out: &mut [f64]) {
        for (k, node) in self.nodes.iter().enumerate() {
            let (p, a) = (vector4(q, 7 * k + 3), vector4(qdd, 7 * k + 3));
            add3(out, 7 * k, &vector3(qdd, 7 * k), node.mass);
            add4(out, 7 * k + 3, &inertia::mass_times(node, &p, &a), 1.0);
        }
    }

    /// Adds the gyroscopic forces.
    pub fn add_gyroscopic(&self, q: &[f64], qd: &[f64], out: &mut [f64]) {
        for (k, node) in self.nodes.iter().enumerate() {
            add4(out, 7 * k + 3, &inertia::gyroscopic(node, &vector4(q, 7 * k + 3), &vector4(qd, 7 * k + 3)), 1.0);
        }
    }

    /// Adds the damping forces, stiffness- and mass-proportional.
    pub fn add_damping(&self, q: &[f64], qd: &[f64], out: &mut [f64]) {
        self.add_element_forces(q, qd, out, false, true);
        self.add_mass_damping(q, qd, out);
    }

    fn add_mass_damping(&self, q: &[f64], qd: &[f64], out: &mut [f64]) {
        if self.damping_mass != 0.0 {
            for (k, node) in self.nodes.iter().enumerate() {
                let (p, v) = (vector4(q, 7 * k + 3), vector4(qd, 7 * k + 3));
                add3(out, 7 * k, &vector3(qd, 7 * k), self.damping_mass * node.mass);
                add4(out, 7 * k + 3, &inertia::mass_times(node, &p, &v), self.damping_mass);
            }
        }
    }

    /// Adds `dE/dq`.
    pub fn add_elastic(&self, q: &[f64], out: &mut [f64]) {
        self.add_element_forces(q, q, out, true, false);
    }

    fn add_element_forces(&self, q: &[f64], qd: &[f64], out: &mut [f64], elastic: bool, damping: bool) {
        for (i, e) in self.elements.iter().enumerate() {
            let (ends, sign) = ends(self, q, qd, i);
            let forces = elastic::forces(self.strain, e, &ends);
            for (on, [fi, fj]) in [(elastic, &forces.elastic), (damping, &forces.damping)] {
                if on {
                    if i > 0 {
                        add4(out, 7 * (i - 1) + 3, fi, 1.0);
                    }
                    add4(out, 7 * i + 3, fj, sign);
                }
            }
        }
    }

    /// Adds `dV_g/dq` of gravity.
    pub fn add_gravity(&self, out: &mut [f64]) {
        for (k, node) in self.nodes.iter().enumerate() {
            add3(out, 7 * k, &self.gravity, -node.mass);
        }
    }

    /// Writes the constraints `psi` (4N).
    pub fn constraints_into(&self, q: &[f64], psi: &mut [f64]) {
        for (i, e) in self.elements.iter().enumerate() {
            let (ends, _) = ends(self, q, q, i);
            let (ri, rj) = (self.pose(q, i).0, self.pose(q, i + 1).0);
            let c = rj - ri - e.connector * tangent(&ends.pi) - self.chord_vector(e, &ends.pi, &ends.pj);
            psi[4 * i..4 * i + 3].copy_from_slice(c.as_slice());
            psi[4 * i + 3] = ends.pj.norm_squared() - 1.0;
        }
    }

    /// Adds `psi_q^T lambda`.
    pub fn add_constraint_forces(&self, q: &[f64], lambda: &[f64], out: &mut [f64]) {
        for (i, e) in self.elements.iter().enumerate() {
            let (ends, sign) = ends(self, q, q, i);
            let mu = vector3(lambda, 4 * i);
            let (di, dj) = self.chord_jacobian(e, &ends);
            if i > 0 {
                add3(out, 7 * (i - 1), &mu, -1.0);
                add4(out, 7 * (i - 1) + 3, &(di.transpose() * mu), 1.0);
            }
            add3(out, 7 * i, &mu, 1.0);
            add4(out, 7 * i + 3, &(dj.transpose() * mu + 2.0 * lambda[4 * i + 3] * ends.pj), sign);
        }
    }

    fn chord_jacobian(&self, e: &super::Element, ends: &Ends) -> (Matrix3x4<f64>, Matrix3x4<f64>) {
        let (di, dj) = (rotation_jacobians(&ends.pi)[0], rotation_jacobians(&ends.pj)[0]);
        chord::jacobian(self.chord, e, &ends.pi, &ends.pj, &di, &dj)
    }

    /// Writes `-d^2 psi` along the rates (4N): the right side of `psi_q q'' = ...` that keeps `psi'' = 0`.
    pub fn constraint_acceleration_into(&self, q: &[f64], qd: &[f64], out: &mut [f64]) {
        for (i, e) in self.elements.iter().enumerate() {
            let (ends, _) = ends(self, q, qd, i);
            let c = chord::convective(self.chord, e, [&ends.pi, &ends.pj], [&ends.pdi, &ends.pdj]);
            out[4 * i..4 * i + 3].copy_from_slice((-c).as_slice());
            out[4 * i + 3] = -2.0 * ends.pdj.norm_squared();
        }
    }

    /// Writes `psi_q v` (4N) for rates `v` (7N).
    pub fn constraint_rate_into(&self, q: &[f64], v: &[f64], out: &mut [f64]) {
        for (i, e) in self.elements.iter().enumerate() {
            let (ends, _) = ends(self, q, v, i);
            let (di, dj) = self.chord_jacobian(e, &ends);
            let (vi, vj) = (self.rate(v, i).0, self.rate(v, i + 1).0);
            let c = vj - vi + di * ends.pdi + dj * ends.pdj;
            out[4 * i..4 * i + 3].copy_from_slice(c.as_slice());
            out[4 * i + 3] = 2.0 * ends.pj.dot(&ends.pdj);
        }
    }

    fn span(&self, q: &[f64], i: usize) -> Span {
        let ((ri, pi), (rj, pj)) = (self.pose(q, i), self.pose(q, i + 1));
        Span::new(&self.elements[i], &ri, &pi, &rj, &pj)
    }

    /// Cable lengths (m), one per cable.
    pub fn cable_lengths_into(&self, q: &[f64], lengths: &mut [f64]) {
        lengths.copy_from_slice(&self.cable_constant);
        for (i, e) in self.elements.iter().enumerate() {
            let span = self.span(q, i);
            for pass in &self.passes[e.passes.clone()] {
                lengths[pass.cable] += span.length(pass);
            }
        }
    }

    /// Cable rates (m/s) for rates `qd`.
    pub fn cable_rates_into(&self, q: &[f64], qd: &[f64], rates: &mut [f64]) {
        rates.fill(0.0);
        for (i, e) in self.elements.iter().enumerate() {
            let span = self.span(q, i);
            let ((vi, wi), (vj, wj)) = (self.rate(qd, i), self.rate(qd, i + 1));
            for pass in &self.passes[e.passes.clone()] {
                let leg = span.leg(pass);
                let [fi, fj] = &leg.forces;
                rates[pass.cable] += leg.direction.dot(&(vj - vi)) + fj.dot(&wj) - fi.dot(&wi);
            }
        }
    }

    /// Writes `G = -(d length/dq)^T`, row-major 7N x cables.
    pub fn cable_input_into(&self, q: &[f64], g: &mut [f64]) {
        g.fill(0.0);
        let nc = self.cable_count();
        for (i, e) in self.elements.iter().enumerate() {
            let span = self.span(q, i);
            for pass in &self.passes[e.passes.clone()] {
                let leg = span.leg(pass);
                let mut column = |node: usize, force: &Vector4<f64>, sign: f64| {
                    let g = &mut g[7 * node * nc + pass.cable..];
                    for k in 0..3 {
                        g[k * nc] += sign * leg.direction[k];
                    }
                    for k in 0..4 {
                        g[(3 + k) * nc] += sign * force[k];
                    }
                };
                if i > 0 {
                    column(i - 1, &leg.forces[0], 1.0);
                }
                column(i, &leg.forces[1], -1.0);
            }
        }
    }

    /// Adds `factor * G(q) u`.
    pub fn add_cable_forces(&self, q: &[f64], u: &[f64], factor: f64, out: &mut [f64]) {
        for (i, e) in self.elements.iter().enumerate() {
            let span = self.span(q, i);
            for pass in &self.passes[e.passes.clone()] {
                let f = factor * u[pass.cable];
                if f == 0.0 {
                    continue;
                }
                let leg = span.leg(pass);
                if i > 0 {
                    add3(out, 7 * (i - 1), &leg.direction, f);
                    add4(out, 7 * (i - 1) + 3, &leg.forces[0], f);
                }
                add3(out, 7 * i, &leg.direction, -f);
                add4(out, 7 * i + 3, &leg.forces[1], -f);
            }
        }
    }

    /// Elastic energy (J).
    pub fn elastic_energy(&self, q: &[f64]) -> f64 {
        self.elements.iter().enumerate().map(|(i, e)| elastic::energy(self.strain, e, &ends(self, q, q, i).0)).sum()
    }

    /// Kinetic energy (J).
    pub fn kinetic_energy(&self, q: &[f64], qd: &[f64]) -> f64 {
        (0..self.node_count())
            .map(|k| {
                let (p, v) = (vector4(q, 7 * k + 3), vector4(qd, 7 * k + 3));
                let node = &self.nodes[k];
                0.5 * (node.mass * vector3(qd, 7 * k).norm_squared() + v.dot(&inertia::mass_times(node, &p, &v)))
            })
            .sum()
    }

    /// Potential of gravity (J).
    pub fn gravity_energy(&self, q: &[f64]) -> f64 {
        self.nodes.iter().enumerate().map(|(k, n)| -n.mass * self.gravity.dot(&vector3(q, 7 * k))).sum()
    }

    /// Upper 7N rows of `f` (7): everything but the cables.
    pub fn add_left_side(&self, m: &Motion<'_>, out: &mut [f64]) {
        self.add_inertia(m.q, m.qdd, out);
        self.add_gyroscopic(m.q, m.qd, out);
        self.add_element_forces(m.q, m.qd, out, true, true);
        self.add_mass_damping(m.q, m.qd, out);
        self.add_gravity(out);
        self.add_constraint_forces(m.q, m.lambda, out);
    }

    /// Residual `g` (6) with its constraint rows: upper part 7N, lower part 4N.
    pub fn residual_into(&self, m: &Motion<'_>, u: &[f64], upper: &mut [f64], lower: &mut [f64]) {
        upper.fill(0.0);
        self.add_left_side(m, upper);
        self.add_cable_forces(m.q, u, -1.0, upper);
        self.constraints_into(m.q, lower);
    }

    /// `S` at (x, u), `f` at x, `B u` and `B` at q, scaled by `out.scale`. Does not allocate.
    ///
    /// The tangent holds `-d(G u)/dq`, so `S dx = -(f - B u)` is the exact Newton step at the tensions `u`, and
    /// `dx(u') = S^-1 (-f + B u')` is (11) for any other.
    pub fn linearize(&self, m: &Motion<'_>, u: &[f64], rates: Rates, out: &mut Linearization) {
        Arch::new().dispatch(Linearizing { arm: self, motion: m, u, rates, out });
    }

    #[inline(always)]
    fn linearize_node(&self, m: &Motion<'_>, rates: Rates, k: usize, out: &mut Linearization) {
        let node = &self.nodes[k];
        let (at, row) = (7 * k, BLOCK * k);
        let (p, pd, pdd) = (vector4(m.q, at + 3), vector4(m.qd, at + 3), vector4(m.qdd, at + 3));
        let alpha = self.damping_mass;
        for c in 0..3 {
            out.f[row + c] += node.mass * (m.qdd[at + c] + alpha * m.qd[at + c] - self.gravity[c]);
        }
        let force = inertia::mass_times(node, &p, &(pdd + alpha * pd)) + inertia::gyroscopic(node, &p, &pd);
        add4(&mut out.f, row + 3, &force, 1.0);
        let block = &mut out.tangent.diagonal[k];
        for c in 0..3 {
            block[(c, c)] += node.mass * (rates.cb + alpha * rates.cg);
        }
        let t = inertia::tangent(node, &p, &pd, &pdd, alpha, rates.cg, rates.cb);
        block.add(3, 3, &t, 1.0);
        // Norm constraint.
        let mu = m.lambda[4 * k + 3];
        add4(&mut out.f, row + 3, &p, 2.0 * mu);
        out.f[row + 10] = (p.norm_squared() - 1.0) * out.scale;
        for c in 0..4 {
            block[(3 + c, 3 + c)] += 2.0 * mu;
            block[(3 + c, 10)] = 2.0 * p[c] * out.scale;
            block[(10, 3 + c)] = 2.0 * p[c] * out.scale;
        }
    }

    #[inline(always)]
    fn linearize_element<W: Columns>(
        &self,
        w: W,
        m: &Motion<'_>,
        u: &[f64],
        rates: Rates,
        i: usize,
        s: f64,
        out: &mut Linearization,
    ) {
        let e = &self.elements[i];
        let (ends, sign) = ends(self, m.q, m.qd, i);
        let (ri, rj) = (self.pose(m.q, i).0, self.pose(m.q, i + 1).0);
        let mu = vector3(m.lambda, 4 * i);
        let span = Span::new(e, &ri, &ends.pi, &rj, &ends.pj);
        let (di, dj) = chord::jacobian(self.chord, e, &ends.pi, &ends.pj, &span.jacobians[0][0], &span.jacobians[1][0]);

        // f
        let elastic = elastic::terms(self.strain, e, &ends, rates.cg);
        let row_j = BLOCK * i;
        if i > 0 {
            let row_i = row_j - BLOCK;
            add3(&mut out.f, row_i, &mu, -1.0);
            add4(&mut out.f, row_i + 3, &(elastic.force[0] + di.tr_mul(&mu)), 1.0);
        }
        add3(&mut out.f, row_j, &mu, 1.0);
        add4(&mut out.f, row_j + 3, &(elastic.force[1] + dj.tr_mul(&mu)), sign);
        let psi = rj - ri - e.connector * tangent(&ends.pi) - self.chord_vector(e, &ends.pi, &ends.pj);
        add3(&mut out.f, row_j + 7, &psi, s);

        // S
        let [mut ii, mut ij, mut ji, mut jj] = elastic.tangent;
        let [cii, cij, cjj] = chord::hessian(self.chord, e, &ends.pi, &ends.pj, &mu);
        ii += cii;
        ij += cij;
        ji += cij;
        jj += cjj;
        let (holes, legs) = (&self.holes[e.groups.clone()], &mut out.legs[e.groups.clone()]);
        LegGroup::fill(w, &span, holes, &u[self.cables(e)], legs);
        out.sign[i] = sign;
        let k = Stiffness::new(&span, &Sums::of(w, holes, legs));
        if i > 0 {
            add3(&mut out.pull, row_j - BLOCK, &k.pull, 1.0);
            add4(&mut out.pull, row_j - BLOCK + 3, &k.turn[0], 1.0);
        }
        add3(&mut out.pull, row_j, &k.pull, -1.0);
        add4(&mut out.pull, row_j + 3, &k.turn[1], -sign);
        ii += k.pp[0];
        ij += k.pp[1];
        ji += k.pp[1].transpose();
        jj += k.pp[2];

        let d = &mut out.tangent.diagonal[i];
        d.add(0, 0, &k.rr, 1.0);
        d.add(0, 3, &k.rp[1], sign);
        d.add(3, 0, &k.rp[1].transpose(), sign);
        d.add(3, 3, &jj, 1.0);
        for c in 0..3 {
            d[(c, 7 + c)] += s;
            d[(7 + c, c)] += s;
        }
        d.add(7, 3, &dj, s * sign);
        d.add(3, 7, &dj.transpose(), s * sign);
        if i > 0 {
            let d = &mut out.tangent.diagonal[i - 1];
            d.add(0, 0, &k.rr, 1.0);
            d.add(0, 3, &k.rp[0], 1.0);
            d.add(3, 0, &k.rp[0].transpose(), 1.0);
            d.add(3, 3, &ii, 1.0);
            // Every number of these two that is not zero is written here, and only here.
            let lower = &mut out.tangent.lower[i];
            lower.set(0, 0, &k.rr, -1.0);
            lower.set(0, 3, &k.rp[0], -1.0);
            lower.set(3, 0, &k.rp[1].transpose(), -sign);
            lower.set(3, 3, &ji, sign);
            for c in 0..3 {
                lower[(7 + c, c)] = -s;
            }
            lower.set(7, 3, &di, s);
            let upper = &mut out.tangent.upper[i - 1];
            upper.set(0, 0, &k.rr, -1.0);
            upper.set(3, 0, &k.rp[0].transpose(), -1.0);
            upper.set(0, 3, &k.rp[1], -sign);
            upper.set(3, 3, &ij, sign);
            for c in 0..3 {
                upper[(c, 7 + c)] = -s;
            }
            upper.set(3, 7, &di.transpose(), s);
        }
    }
}

/// [`Arm::linearize`] with the processor's vectors: everything below it is inlined, so the compiler may use them.
struct Linearizing<'a> {
    arm: &'a Arm,
    motion: &'a Motion<'a>,
    u: &'a [f64],
    rates: Rates,
    out: &'a mut Linearization,
}

impl WithSimd for Linearizing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { arm, motion, u, rates, out } = self;
        let (n, scale) = (arm.node_count(), out.scale);
        out.tangent.diagonal.fill(Block::ZERO);
        out.f.fill(0.0);
        out.pull.fill(0.0);
        for k in 0..n {
            arm.linearize_node(motion, rates, k, out);
        }
        for i in 0..n {
            // Vectors that do not divide a group would read past it.
            if WIDE.is_multiple_of(S::F64_LANES) {
                arm.linearize_element(Lanes(simd), motion, u, rates, i, scale, out);
            } else {
                arm.linearize_element(Scalars, motion, u, rates, i, scale, out);
            }
        }
    }
}

impl Arm {
    /// `[M, psi_q^T; psi_q, 0]` with the multipliers scaled: what ties accelerations and multipliers together.
    pub fn mass_into(&self, q: &[f64], scale: f64, out: &mut BlockTridiagonal) {
        out.clear();
        for (i, e) in self.elements.iter().enumerate() {
            let (ends, sign) = ends(self, q, q, i);
            let (di, dj) = self.chord_jacobian(e, &ends);
            let d = &mut out.diagonal[i];
            d.add(0, 0, &(Matrix3::identity() * self.nodes[i].mass), 1.0);
            let l = body_rate(&ends.pj);
            d.add(3, 3, &(4.0 * (l.transpose() * Matrix3::from_diagonal(&self.nodes[i].inertia) * l)), 1.0);
            for c in 0..3 {
                d[(c, 7 + c)] += scale;
                d[(7 + c, c)] += scale;
            }
            d.add(7, 3, &dj, scale * sign);
            d.add(3, 7, &dj.transpose(), scale * sign);
            for c in 0..4 {
                d[(3 + c, 10)] = 2.0 * sign * ends.pj[c] * scale;
                d[(10, 3 + c)] = 2.0 * sign * ends.pj[c] * scale;
            }
            if i > 0 {
                for c in 0..3 {
                    out.lower[i][(7 + c, c)] -= scale;
                    out.upper[i - 1][(c, 7 + c)] -= scale;
                }
                out.lower[i].add(7, 3, &di, scale);
                out.upper[i - 1].add(3, 7, &di.transpose(), scale);
            }
        }
    }
}
