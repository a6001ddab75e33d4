//! The terms of (1) one by one, and their sum (7).

use super::arm::{Arm, Element};
use super::cables::Span;
use super::chord::{self, Chord};
use super::elastic::{self, Ends};
use super::inertia;
use crate::math::block_tridiagonal::BlockTridiagonal;
use crate::math::quaternion::body_rate;
use nalgebra::{Matrix3, Matrix3x4, Vector3, Vector4};

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
            let (p, a) = (vector4(q, 7 * k + 3).into(), vector4(qdd, 7 * k + 3).into());
            add3(out, 7 * k, &vector3(qdd, 7 * k), node.mass);
            add4(out, 7 * k + 3, &inertia::mass_times(node.inertia.into(), p, a).into(), 1.0);
        }
    }

    /// Adds the gyroscopic forces.
    pub fn add_gyroscopic(&self, q: &[f64], qd: &[f64], out: &mut [f64]) {
        for (k, node) in self.nodes.iter().enumerate() {
            let (p, v) = (vector4(q, 7 * k + 3).into(), vector4(qd, 7 * k + 3).into());
            add4(out, 7 * k + 3, &inertia::gyroscopic(node.inertia.into(), p, v).into(), 1.0);
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
                let (p, v) = (vector4(q, 7 * k + 3).into(), vector4(qd, 7 * k + 3).into());
                add3(out, 7 * k, &vector3(qd, 7 * k), self.damping_mass * node.mass);
                add4(out, 7 * k + 3, &inertia::mass_times(node.inertia.into(), p, v).into(), self.damping_mass);
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
            let c = rj - ri - self.chord_vector(e, &ends.pi, &ends.pj);
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

    /// From a node to the next one as the chord's rule gives it between their quaternions, the connector's length included
    /// (m, base frame).
    pub(super) fn chord_vector(&self, e: &Element, pi: &Vector4<f64>, pj: &Vector4<f64>) -> Vector3<f64> {
        Chord::of(self.chord, e, pi, pj, Vector3::zeros()).vector.into()
    }

    fn chord_jacobian(&self, e: &Element, ends: &Ends) -> (Matrix3x4<f64>, Matrix3x4<f64>) {
        Chord::of(self.chord, e, &ends.pi, &ends.pj, Vector3::zeros()).jacobians()
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

    fn span(&self, q: &[f64], i: usize) -> Span<f64> {
        let ((ri, pi), (rj, pj)) = (self.pose(q, i), self.pose(q, i + 1));
        Span::of(&self.elements[i], ri, pi, rj, pj)
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
                let leg = span.pass(pass);
                let [fi, fj] = leg.forces.map(Vector4::from);
                rates[pass.cable] += Vector3::from(leg.direction).dot(&(vj - vi)) + fj.dot(&wj) - fi.dot(&wi);
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
                let leg = span.pass(pass);
                let mut column = |node: usize, force: &[f64; 4], sign: f64| {
                    let sign = sign * pass.share;
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
                let f = factor * pass.share * u[pass.cable];
                if f == 0.0 {
                    continue;
                }
                let leg = span.pass(pass);
                let (direction, [fi, fj]) = (Vector3::from(leg.direction), leg.forces.map(Vector4::from));
                if i > 0 {
                    add3(out, 7 * (i - 1), &direction, f);
                    add4(out, 7 * (i - 1) + 3, &fi, f);
                }
                add3(out, 7 * i, &direction, -f);
                add4(out, 7 * i + 3, &fj, -f);
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
                let turned = Vector4::from(inertia::mass_times(node.inertia.into(), p.into(), v.into()));
                0.5 * (node.mass * vector3(qd, 7 * k).norm_squared() + v.dot(&turned))
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
