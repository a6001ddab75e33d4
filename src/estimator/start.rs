//! The first estimate: an arm at rest, from lengths and tensions.
//!
//! A constant-curvature chain that has the measured bend angles (Gauss-Newton on two curvatures per segment), then
//! Newton on the static equations with those bend angles held and the disturbance moments `beta` unknown. A static
//! solve for the tensions alone, from the straight arm, finds other branches of the equilibrium.

use super::passive::Observer;
use crate::math::block_tridiagonal::{BLOCK, COORDINATES};
use crate::math::dense;
use crate::model::{Motion, Rates};

/// Why no first estimate was found.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum StartError {
    /// Tensions or a valid length are not finite, or their number is wrong.
    #[error("the start needs one finite tension and one length per cable")]
    Input,
    /// Gauss-Newton did not reach the measured bend angles.
    #[error("no constant-curvature shape has these cable lengths: the bend angles stay {innovation_rad:.4} rad away")]
    Shape {
        /// Largest remaining |z| (rad).
        innovation_rad: f64,
    },
    /// The static equations could not be solved at the shape.
    #[error("the static equations are singular at the shape that the cable lengths give")]
    Statics,
}

/// Largest remaining bend angle of the chain that is accepted (rad).
const SHAPE_TOLERANCE_RAD: f64 = 1e-9;
const SHAPE_ITERATIONS_MAX: usize = 30;
/// Beyond this (1/m) no arm is bent: a look has lost its way.
const CURVATURE_MAX_1PM: f64 = 1e4;
const STATIC_ITERATIONS_MAX: usize = 12;
/// Newton's static corrections above this norm are not trusted beyond the first (m, 1).
const CORRECTION_MAX: f64 = 0.5;

impl Observer {
    /// Starts at rest under tensions `u` (N) with the measured `lengths` (m); one that is not finite does not count. Does
    /// not allocate: the control thread starts it at every arming.
    ///
    /// # Errors
    /// [`StartError`]; the estimate is then not usable.
    pub fn start(&mut self, lengths: &[f64], u: &[f64]) -> Result<(), StartError> {
        let nc = self.arm.cable_count();
        if lengths.len() != nc || u.len() != nc || u.iter().any(|u| !u.is_finite()) {
            return Err(StartError::Input);
        }
        self.reset();
        self.space.select(|c| lengths[c].is_finite());
        self.shape(lengths)?;
        self.statics(lengths, u)?;
        for sent in &mut self.sent {
            sent.copy_from_slice(u);
        }
        self.settle_prediction();
        Ok(())
    }

    /// Takes over the shape that the `lengths` (m) show of an arm at rest whose segments are bent evenly: for whoever looks
    /// while nothing is estimated. One step from the last look, so that a shape is there after a few ticks, in the time of
    /// a fraction of one; false, and nothing has changed, where the lengths show none. Does not allocate.
    pub fn look(&mut self, lengths: &[f64]) -> bool {
        if lengths.len() != self.arm.cable_count() || lengths.iter().any(|length| !length.is_finite()) {
            return false;
        }
        self.space.select(|_| true);
        self.kept.copy_from_slice(&self.state.q);
        let stepped = self.shape_step(lengths);
        if stepped.is_err() || self.curvatures[0].iter().any(|k| !k.is_finite() || k.abs() > CURVATURE_MAX_1PM) {
            self.curvatures[0].fill(0.0);
            self.state.q.copy_from_slice(&self.kept);
            return false;
        }
        self.take_shape();
        true
    }

    /// Gauss-Newton on the curvatures; leaves the chain in `state`, at rest.
    fn shape(&mut self, lengths: &[f64]) -> Result<(), StartError> {
        self.curvatures[0].fill(0.0);
        let mut innovation = f64::INFINITY;
        for _ in 0..SHAPE_ITERATIONS_MAX {
            innovation = self.shape_step(lengths)?;
            if innovation < SHAPE_TOLERANCE_RAD {
                break;
            }
        }
        if innovation.is_nan() || innovation >= 1e-6 {
            return Err(StartError::Shape { innovation_rad: innovation });
        }
        self.take_shape();
        self.w.fill(0.0);
        Ok(())
    }

    fn take_shape(&mut self) {
        self.arm.bent_into(&self.curvatures[0], &mut self.state.q);
        for v in [&mut self.state.qd, &mut self.state.qdd, &mut self.state.a, &mut self.state.lambda] {
            v.fill(0.0);
        }
    }

    /// One step of the above; the largest |z| before it (rad), below the tolerance without a step. Leaves the state's
    /// coordinates anywhere.
    fn shape_step(&mut self, lengths: &[f64]) -> Result<f64, StartError> {
        let n = self.space.angle_count();
        self.arm.bent_into(&self.curvatures[0], &mut self.state.q);
        self.arm.cable_lengths_into(&self.state.q, &mut self.length);
        self.space.angles_into(&self.length, lengths, &mut self.z);
        let innovation = self.z.iter().fold(0.0, |a: f64, z| a.max(z.abs()));
        if innovation < SHAPE_TOLERANCE_RAD {
            return Ok(innovation);
        }
        for k in 0..n {
            let h = 1e-6;
            self.curvatures[0][k] += h;
            self.arm.bent_into(&self.curvatures[0], &mut self.state.q);
            self.curvatures[0][k] -= h;
            self.arm.cable_lengths_into(&self.state.q, &mut self.length);
            self.space.angles_into(&self.length, lengths, &mut self.w);
            for i in 0..n {
                self.small_a[i * n + k] = (self.w[i] - self.z[i]) / h;
            }
        }
        // A segment whose cables are all silent keeps its curvature: unit row.
        for i in 0..n {
            if self.small_a[i * n..(i + 1) * n].iter().all(|j| *j == 0.0) {
                self.small_a[i * n + (i ^ 1)] = 1.0;
            }
        }
        if !dense::solve_in_place(n, &mut self.small_a, &mut self.z) {
            return Err(StartError::Shape { innovation_rad: innovation });
        }
        self.curvatures[0].iter_mut().zip(&self.z).for_each(|(k, d)| *k -= d);
        Ok(innovation)
    }

    /// Newton on `f - B (u + T beta) = 0`, `z = 0` in (q, lambda, beta). The first step gives beta; the others only
    /// refine the distribution of curvature inside the segments.
    fn statics(&mut self, lengths: &[f64], u: &[f64]) -> Result<(), StartError> {
        let n = self.space.angle_count();
        for iteration in 0..STATIC_ITERATIONS_MAX {
            self.effective.copy_from_slice(u);
            self.space.add_tensions(&self.beta, &mut self.effective);
            self.arm.cable_lengths_into(&self.state.q, &mut self.length);
            self.space.angles_into(&self.length, lengths, &mut self.z);
            let motion = Motion::from(&self.state);
            if self.stepper.linearize(&self.arm, &motion, &self.effective, Rates::STATIC).is_err() {
                return Err(StartError::Statics);
            }
            self.moment_panel();
            let dx = self.stepper.correction();
            // z falls by V^T dx: V^T (dx + S^-1 V dbeta) = z.
            let rows = self.v.len() / n;
            for i in 0..n {
                let along: f64 =
                    (0..rows).map(|r| self.v[r * n + i] * dx[r / COORDINATES * BLOCK + r % COORDINATES]).sum();
                self.small_b[i] = self.z[i] - along;
                for k in 0..n {
                    self.small_a[i * n + k] = (0..rows).map(|r| self.v[r * n + i] * self.sv[r * n + k]).sum::<f64>();
                }
                // Not observable: its beta stays.
                if (0..n).all(|k| self.small_a[i * n + k] == 0.0) {
                    self.small_a[i * n + i] = 1.0;
                }
            }
            if !dense::solve_in_place(n, &mut self.small_a, &mut self.small_b) {
                return Err(StartError::Statics);
            }
            self.space.add_tensions(&self.small_b, &mut self.effective);
            let dx = self.stepper.correction_for(&self.arm, &self.effective);
            let norm = dx.chunks_exact(BLOCK).flat_map(|node| &node[..COORDINATES]).map(|x| x * x).sum::<f64>().sqrt();
            if !norm.is_finite() {
                return Err(StartError::Statics);
            }
            if norm > CORRECTION_MAX {
                // Far from an equilibrium: keep the chain and the moments of one linear step.
                if iteration == 0 {
                    self.beta.iter_mut().zip(&self.small_b).for_each(|(b, d)| *b += d);
                }
                return Ok(());
            }
            self.beta.iter_mut().zip(&self.small_b).for_each(|(b, d)| *b += d);
            self.dx.copy_from_slice(dx);
            self.stepper.apply(&self.dx, Rates::STATIC, &mut self.state);
            if norm < 1e-10 {
                break;
            }
        }
        Ok(())
    }
}
