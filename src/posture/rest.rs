//! The arm at rest with given mean curvatures, and how its tip follows them.
//!
//! Newton on the static equations `f - B (u + T m) = 0`, `kappa(q) = kappa_d` in coordinates, multipliers and the bending
//! moments `m` that cables of the segments can give. One iteration is one linearisation, one factorisation and a panel of
//! two columns a segment.

use crate::estimator::CableSpace;
use crate::integrator::Stepper;
use crate::math::block_tridiagonal::{BLOCK, COORDINATES};
use crate::math::chain::Singular;
use crate::math::dense;
use crate::math::quaternion::{body_rate, conjugate, product};
use crate::model::{Arm, Motion, Rates, State};
use nalgebra::{Vector3, Vector4};

/// Rows of a tip's pose: position (base frame), rotation (tip frame; roll about the tangent first).
pub const POSE: usize = 6;

/// What cables can give to a side that none of them pulls to, over what one of them gives to its own: more than nothing, so
/// that a load is a number.
const LEAST_SHARE: f64 = 0.02;

/// An arm at rest. [`RestingArm::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct RestingArm {
    arm: Arm,
    stepper: Stepper,
    space: CableSpace,
    state: State,
    /// Bending moments beside the tensions (N m), two per segment.
    moments: Vec<f64>,
    effective: Vec<f64>,
    /// `V = B T` and `S^-1 V`, row-major 7N x 2 per segment.
    v: Vec<f64>,
    dense: Vec<usize>,
    /// `S^-1 (B u - f)`, coordinates of the correction without other moments, 11N.
    dx: Vec<f64>,
    curvatures: Vec<f64>,
    rates: Vec<f64>,
    /// Mean curvatures after the correction without other moments (1/m).
    reached: Vec<f64>,
    /// `d kappa / d m`, and its inverse.
    compliance: Vec<f64>,
    inverse: Vec<f64>,
    step: Vec<f64>,
    jacobian: Vec<f64>,
    tip: (Vector3<f64>, Vector4<f64>),
    tip_step: [f64; POSE],
}

impl RestingArm {
    /// Straight, without moments. Allocates.
    pub fn new(arm: &Arm) -> Self {
        let (n, nc, count) = (arm.node_count(), arm.cable_count(), 2 * arm.segment_count());
        let state = State::at_rest(arm.straight());
        Self {
            stepper: Stepper::new(arm),
            space: CableSpace::new(arm),
            moments: vec![0.0; count],
            effective: vec![0.0; nc],
            v: vec![0.0; COORDINATES * n * count],
            dense: vec![0; n],
            dx: vec![0.0; BLOCK * n],
            curvatures: vec![0.0; count],
            rates: vec![0.0; count],
            reached: vec![0.0; count],
            compliance: vec![0.0; count * count],
            inverse: vec![0.0; count * count],
            step: vec![0.0; count],
            jacobian: vec![0.0; POSE * count],
            tip: arm.pose(&state.q, n),
            tip_step: [0.0; POSE],
            state,
            arm: arm.clone(),
        }
    }

    /// Whether cables move this bend (of two per segment).
    pub fn is_moved(&self, bend: usize) -> bool {
        self.space.is_observable(bend ^ 1)
    }

    /// Its model.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Takes over what friction leaves of the tensions at each passage, see [`Arm::take_shares`].
    pub fn take_shares(&mut self, shares: &[f64]) {
        self.arm.take_shares(shares);
    }

    /// Coordinates, at rest.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Bending moments (N m) that hold it beside the tensions, two per segment.
    pub fn moments(&self) -> &[f64] {
        &self.moments
    }

    /// Mean curvatures of the state (1/m), `(y, z)` segment by segment.
    pub fn curvatures(&self) -> &[f64] {
        &self.curvatures
    }

    /// Pose of the tip: position (m, base frame) and quaternion (body to base).
    pub fn tip(&self) -> (Vector3<f64>, Vector4<f64>) {
        self.tip
    }

    /// `d tip / d kappa` of the last linearisation, row-major 6 x 2 per segment: position (m per 1/m, base frame), then
    /// rotation (rad per 1/m, tip frame).
    pub fn jacobian(&self) -> &[f64] {
        &self.jacobian
    }

    /// Starts anew from a constant-curvature chain.
    pub fn restart(&mut self, curvatures: &[f64]) {
        self.arm.bent_into(curvatures, &mut self.state.q);
        self.state.lambda.fill(0.0);
        self.moments.fill(0.0);
        self.measure();
    }

    /// Starts anew from another's shape and moments, of the same arm.
    pub fn copy_from(&mut self, other: &Self) {
        self.state.copy_from(&other.state);
        self.moments.copy_from_slice(&other.moments);
        self.measure();
    }

    /// Starts anew from the shape of a motion.
    pub fn take_shape(&mut self, q: &[f64], lambda: &[f64]) {
        self.state.q.copy_from_slice(q);
        self.state.lambda.copy_from_slice(lambda);
        self.moments.fill(0.0);
        self.measure();
    }

    fn measure(&mut self) {
        self.arm.curvatures_into(&self.state.q, &self.state.qd, &mut self.curvatures, &mut self.rates);
        self.tip = self.arm.pose(&self.state.q, self.arm.node_count());
    }

    /// Linearises the static equations at the present shape under tensions `u` (N): what a change of moments does to
    /// curvatures and tip.
    ///
    /// # Errors
    /// The tangent is singular: the arm is at an instability, or not in a shape.
    pub fn linearize(&mut self, u: &[f64]) -> Result<(), Singular> {
        let count = self.moments.len();
        self.effective.copy_from_slice(u);
        self.space.add_tensions(&self.moments, &mut self.effective);
        self.stepper.linearize(&self.arm, &Motion::from(&self.state), &self.effective, Rates::STATIC)?;
        self.stepper.linearization.input_times_into(&self.arm, self.space.matrix(), count, &mut self.v);
        self.stepper.factor.solve_panel_in_place(count, &self.dense, &mut self.v);
        self.dx.copy_from_slice(self.stepper.correction());
        self.reached.copy_from_slice(&self.curvatures);
        self.compliance.fill(0.0);
        for (i, element) in self.arm.elements.iter().enumerate() {
            let rows = self.arm.curvature_sensitivity(&self.state.q, &self.state.qd, i, 0.0).k;
            for (node, rows) in [(i, rows[0]), (i + 1, rows[1])] {
                if node == 0 {
                    continue;
                }
                for o in 0..2 {
                    let out = 2 * element.segment + o;
                    for c in 0..4 {
                        let at = 3 + c;
                        self.reached[out] += rows[(o, c)] * self.dx[BLOCK * (node - 1) + at];
                        let panel = &self.v[(COORDINATES * (node - 1) + at) * count..][..count];
                        let to = &mut self.compliance[out * count..(out + 1) * count];
                        to.iter_mut().zip(panel).for_each(|(to, v)| *to += rows[(o, c)] * v);
                    }
                }
            }
        }
        self.inverse.fill(0.0);
        for i in 0..count {
            self.inverse[i * count + i] = 1.0;
            if !self.space.is_observable(i) {
                // No cable gives this moment: the bend about its axis is what the equilibrium makes it. Holes off on y bend
                // about z, so moments and curvatures of a segment stand crosswise.
                let bend = i ^ 1;
                self.compliance[bend * count..(bend + 1) * count].fill(0.0);
                self.compliance[bend * count + i] = 1.0;
            }
        }
        if !dense::solve_panel_in_place(count, count, &mut self.compliance, &mut self.inverse) {
            return Err(Singular(0));
        }
        let n = self.arm.node_count();
        let rotation = 2.0 * body_rate(&self.tip.1);
        let last = &self.dx[BLOCK * (n - 1)..];
        let turn = rotation * Vector4::new(last[3], last[4], last[5], last[6]);
        self.tip_step = [last[0], last[1], last[2], turn[0], turn[1], turn[2]];
        // d tip / d m, then by the curvatures.
        self.jacobian.fill(0.0);
        for k in 0..count {
            let column = |c: usize| self.v[(COORDINATES * (n - 1) + c) * count + k];
            let turn = rotation * Vector4::new(column(3), column(4), column(5), column(6));
            let rows = [column(0), column(1), column(2), turn[0], turn[1], turn[2]];
            for (r, x) in rows.into_iter().enumerate() {
                let to = &mut self.jacobian[r * count..(r + 1) * count];
                to.iter_mut().zip(&self.inverse[k * count..(k + 1) * count]).for_each(|(to, c)| *to += x * c);
            }
        }
        Ok(())
    }

    /// The tip's error against a pose, as position (m, base frame) and rotation (rad, tip frame), which the last
    /// linearisation expects at mean curvatures `kappa`: `e(kappa) = e_0 + J (kappa - kappa_0)`. Writes `e_0` and
    /// `kappa_0`.
    pub fn error_into(
        &self,
        position: &Vector3<f64>,
        quaternion: &Vector4<f64>,
        error: &mut [f64; POSE],
        origin: &mut [f64],
    ) {
        let e = pose_error(&self.tip, position, quaternion);
        for r in 0..POSE {
            error[r] = e[r] + self.tip_step[r];
        }
        origin.copy_from_slice(&self.reached);
    }

    /// Mean curvatures (1/m) at which the last linearisation has its origin: those of the present shape but for the part that
    /// the static equations still lack.
    pub fn origin(&self) -> &[f64] {
        &self.reached
    }

    /// Coordinate `row` (of 7N) by the last linearisation: its correction at [`RestingArm::origin`], and its derivative by
    /// the curvatures to `out`.
    pub fn coordinate_into(&self, row: usize, out: &mut [f64]) -> f64 {
        let count = out.len();
        out.fill(0.0);
        for (k, v) in self.v[row * count..(row + 1) * count].iter().enumerate() {
            out.iter_mut().zip(&self.inverse[k * count..(k + 1) * count]).for_each(|(to, c)| *to += v * c);
        }
        self.dx[row / COORDINATES * BLOCK + row % COORDINATES]
    }

    /// Load of a segment's cables: the bending moment that they have to give at the present mean curvatures, by the last
    /// linearisation, over the most that tensions from 0 to `range_n` (N) can give that way. Above 1 no tensions hold the
    /// posture. Its derivative by the curvatures (m) to `out`.
    ///
    /// What the cables can give is a polygon whose sides are parallel to their holes' directions (a zonotope), so the side
    /// that is nearest decides.
    pub fn load_into(&self, segment: usize, range_n: f64, out: &mut [f64]) -> f64 {
        let count = out.len();
        out.fill(0.0);
        let moment = |k: usize| {
            let row = &self.inverse[k * count..(k + 1) * count];
            let rest = row.iter().zip(self.curvatures.iter().zip(&self.reached));
            self.moments[k] + rest.map(|(c, (kappa, o))| c * (kappa - o)).sum::<f64>()
        };
        let own = || (0..self.arm.cable_count()).filter(|c| self.arm.cable_segment[*c] == segment);
        let hole = |c: usize| [self.space.lever(c)[2 * segment], self.space.lever(c)[2 * segment + 1]];
        // Of cables that run through several segments, what is left for this one's own.
        let mut given = [0.0; 2];
        for c in own() {
            let tension: f64 = (0..count).map(|k| self.space.row(c)[k] * moment(k)).sum();
            let h = hole(c);
            given[0] += tension * h[0];
            given[1] += tension * h[1];
        }
        let (mut load, mut side, mut most) = (0.0f64, [0.0; 2], 1.0);
        for c in own() {
            let h = hole(c);
            // Across the hole's direction a side of the polygon; along it, too, where the cables are in one line or on one side.
            for n in [[-h[1], h[0]], [h[1], -h[0]], h, [-h[0], -h[1]]] {
                let least = LEAST_SHARE * range_n * n[0].hypot(n[1]) * h[0].hypot(h[1]);
                let sum = own().map(|d| (n[0] * hole(d)[0] + n[1] * hole(d)[1]).max(0.0)).sum::<f64>();
                let can = (range_n * sum).max(least);
                let needs = n[0] * given[0] + n[1] * given[1];
                if needs / can > load {
                    (load, side, most) = (needs / can, n, can);
                }
            }
        }
        for c in own() {
            let h = hole(c);
            let f = (side[0] * h[0] + side[1] * h[1]) / most;
            for k in 0..count {
                let g = f * self.space.row(c)[k];
                out.iter_mut().zip(&self.inverse[k * count..(k + 1) * count]).for_each(|(to, c)| *to += g * c);
            }
        }
        load
    }

    /// The swing of an arm beside its equilibrium, seen from this one: with `s` the displacements of the nodes `q` (7N) from
    /// where they would rest at their own mean curvatures `kappa` (1/m), and `Phi` the displacements by the curvatures,
    /// writes `Phi^T M Phi` (kg m^4, row-major) and `Phi^T M s` (kg m^3), M the nodes' masses. By the last linearisation.
    pub fn swing_into(&self, q: &[f64], kappa: &[f64], inertia: &mut [f64], swing: &mut [f64], scratch: &mut [f64]) {
        let count = kappa.len();
        inertia.fill(0.0);
        swing.fill(0.0);
        for (node, mass) in self.arm.nodes.iter().map(|n| n.mass).enumerate() {
            for row in COORDINATES * node..COORDINATES * node + 3 {
                let shift = self.coordinate_into(row, scratch);
                let moved: f64 =
                    scratch.iter().zip(kappa.iter().zip(&self.reached)).map(|(s, (k, o))| s * (k - o)).sum();
                let s = q[row] - (self.state.q[row] + shift + moved);
                for i in 0..count {
                    let f = mass * scratch[i];
                    swing[i] += f * s;
                    for j in 0..=i {
                        inertia[i * count + j] += f * scratch[j];
                    }
                }
            }
        }
        for i in 0..count {
            for j in 0..i {
                inertia[j * count + i] = inertia[i * count + j];
            }
        }
    }

    /// Moves to mean curvatures `kappa` (1/m) by the last linearisation; returns the norm of the coordinates' correction.
    pub fn advance(&mut self, kappa: &[f64]) -> f64 {
        let count = self.moments.len();
        for i in 0..count {
            let row = &self.inverse[i * count..(i + 1) * count];
            self.step[i] = row.iter().zip(kappa.iter().zip(&self.reached)).map(|(c, (k, r))| c * (k - r)).sum();
        }
        self.moments.iter_mut().zip(&self.step).for_each(|(m, d)| *m += d);
        self.space.add_tensions(&self.step, &mut self.effective);
        let norm = self.stepper.advance(&self.arm, &self.effective, Rates::STATIC, &mut self.state);
        self.measure();
        norm
    }
}

/// Error of a pose against a wanted one: position (m, base frame) and rotation vector (rad, the pose's own frame), the
/// short way round.
pub fn pose_error(
    at: &(Vector3<f64>, Vector4<f64>),
    position: &Vector3<f64>,
    quaternion: &Vector4<f64>,
) -> [f64; POSE] {
    let dr = at.0 - position;
    // Wanted to actual, seen from the actual frame to first order.
    let d = product(&conjugate(quaternion), &at.1);
    let sign = if d[0] < 0.0 { -1.0 } else { 1.0 };
    let v = Vector3::new(d[1], d[2], d[3]) * sign;
    let sine = v.norm();
    let angle = if sine > 1e-9 { 2.0 * sine.atan2(d[0].abs()) / sine } else { 2.0 };
    let turn = v * angle;
    [dr[0], dr[1], dr[2], turn[0], turn[1], turn[2]]
}
