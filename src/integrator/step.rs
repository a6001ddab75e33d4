//! One implicit step: Newton on `x = [q; lambda]`, and the affine map `x = zeta1 + zeta2 u` (11), (13).

use super::scheme::Scheme;
use crate::math::block_tridiagonal::{BLOCK, COORDINATES};
use crate::math::chain::{Factor, Singular};
use crate::model::{Arm, Linearization, Motion, Rates, State};

/// The correction of an iterate's coordinates as a function of the tensions: `dq(u) = x0 + x1 u`.
#[derive(Debug, Clone)]
pub struct AffineMap {
    /// Coordinates of `-S^-1 f`, 7N.
    pub x0: Vec<f64>,
    /// Coordinates of `S^-1 B`, row-major 7N x cables.
    pub x1: Vec<f64>,
    /// Number of cables.
    pub cables: usize,
    /// First cable that acts on a node or behind it.
    first: Vec<usize>,
}

/// How a step ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepReport {
    /// Newton iterations used.
    pub iterations: usize,
    /// Norm of the last correction of q.
    pub correction: f64,
    /// Whether the correction fell below the tolerance, or the next one would (see [`Stepper::step`]).
    pub converged: bool,
}

/// Why a step could not be computed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum StepError {
    /// The tangent is singular or not finite.
    #[error(transparent)]
    Singular(#[from] Singular),
    /// The iterates left the finite numbers.
    #[error("the iteration diverged")]
    Diverged,
}

/// Scratch of the integrator for one arm; made once.
#[derive(Debug, Clone)]
pub struct Stepper {
    /// Tangent, left side and input matrix of the last linearisation.
    pub linearization: Linearization,
    /// Factorisation of the tangent.
    pub factor: Factor,
    dx: Vec<f64>,
    force: Vec<f64>,
}

/// Stop of the Newton iteration: `|dq| < TOLERANCE` (design section 12).
pub const TOLERANCE: f64 = 1e-8;

impl Stepper {
    /// Room for an arm. Allocates.
    pub fn new(arm: &Arm) -> Self {
        Self {
            linearization: Linearization::new(arm),
            factor: Factor::new(arm.node_count()),
            dx: vec![0.0; BLOCK * arm.node_count()],
            force: vec![0.0; COORDINATES * arm.node_count()],
        }
    }

    /// Linearises at a motion and tensions and factors the tangent. Does not allocate.
    ///
    /// # Errors
    /// The tangent is singular.
    pub fn linearize(&mut self, arm: &Arm, motion: &Motion<'_>, u: &[f64], rates: Rates) -> Result<(), Singular> {
        self.linearization.scale = multiplier_scale(arm, rates);
        arm.linearize(motion, u, rates, &mut self.linearization);
        self.factor.factor(&self.linearization.tangent)
    }

    /// The affine map at the last linearisation. Does not allocate.
    pub fn affine_map_into(&mut self, arm: &Arm, map: &mut AffineMap) {
        for (x, f) in self.dx.iter_mut().zip(&self.linearization.f) {
            *x = -f;
        }
        self.factor.solve_in_place(&mut self.dx);
        for (x, dx) in map.x0.chunks_exact_mut(COORDINATES).zip(self.dx.chunks_exact(BLOCK)) {
            x.copy_from_slice(&dx[..COORDINATES]);
        }
        self.linearization.input_into(arm, &mut map.x1);
        self.factor.solve_panel_in_place(map.cables, &map.first, &mut map.x1);
    }

    /// Adds a correction `dx` (11N, multipliers scaled) to a state and returns the norm of its coordinates' part.
    pub fn apply(&self, dx: &[f64], rates: Rates, state: &mut State) -> f64 {
        let scale = self.linearization.scale;
        let mut norm = 0.0;
        for i in 0..state.q.len() / 7 {
            for c in 0..7 {
                let d = dx[BLOCK * i + c];
                norm += d * d;
                state.q[7 * i + c] += d;
                state.qd[7 * i + c] += rates.cg * d;
                state.qdd[7 * i + c] += rates.cb * d;
            }
            for c in 0..4 {
                state.lambda[4 * i + c] += scale * dx[BLOCK * i + 7 + c];
            }
        }
        norm.sqrt()
    }

    /// The Newton correction (11N, multipliers scaled) at the last linearisation and its tensions: `S dx = -f + B u`. Does
    /// not allocate.
    pub(crate) fn correction(&mut self) -> &mut Vec<f64> {
        let Linearization { f, pull, .. } = &self.linearization;
        for ((x, pull), f) in self.dx.iter_mut().zip(pull).zip(f) {
            *x = pull - f;
        }
        self.factor.solve_in_place(&mut self.dx);
        &mut self.dx
    }

    /// The Newton correction (11N, multipliers scaled) at the last linearisation for other tensions `u` (m, N) than its own.
    /// Does not allocate.
    pub fn correction_for(&mut self, arm: &Arm, u: &[f64]) -> &mut Vec<f64> {
        self.linearization.force_into(arm, u, &mut self.force);
        let rows = self.dx.chunks_exact_mut(BLOCK).zip(self.linearization.f.chunks_exact(BLOCK));
        for ((x, f), force) in rows.zip(self.force.chunks_exact(COORDINATES)) {
            for c in 0..BLOCK {
                x[c] = if c < COORDINATES { force[c] - f[c] } else { -f[c] };
            }
        }
        self.factor.solve_in_place(&mut self.dx);
        &mut self.dx
    }

    /// Moves a state by [`Stepper::correction_for`] and returns the norm of its coordinates' part. Does not allocate.
    pub fn advance(&mut self, arm: &Arm, u: &[f64], rates: Rates, state: &mut State) -> f64 {
        self.correction_for(arm, u);
        self.apply(&self.dx, rates, state)
    }

    /// Integrates one step of `eta` seconds with constant tensions at its end. Does not allocate.
    ///
    /// `next` receives the state; it is left at the last iterate when the iteration limit is reached, which the
    /// report tells.
    ///
    /// It stops at a correction `|dq|` below 1e-8, or where the next one is sure to be: Newton's corrections
    /// square, so the one after `d1` and `d2` is about `d2^3/d1^2`. Where that is a tenth of the tolerance, the iterate is
    /// already better than the tolerance asks, and an iteration that only confirms it (a third of a step's time) is left
    /// out.
    ///
    /// # Errors
    /// Singular tangent or divergence.
    pub fn step(
        &mut self,
        arm: &Arm,
        scheme: &Scheme,
        eta: f64,
        previous: &State,
        u: &[f64],
        iterations_max: usize,
        next: &mut State,
    ) -> Result<StepReport, StepError> {
        let rates = scheme.rates(eta);
        scheme.predict(eta, previous, next);
        let mut report = StepReport { iterations: 0, correction: f64::INFINITY, converged: false };
        while report.iterations < iterations_max && !report.converged {
            self.linearize(arm, &Motion::from(&*next), u, rates)?;
            self.correction();
            let before = report.correction;
            report.correction = self.apply(&self.dx, rates, next);
            report.iterations += 1;
            if !report.correction.is_finite() || report.correction > 1e3 {
                return Err(StepError::Diverged);
            }
            let squares = before.is_finite()
                && report.correction < 0.1 * before
                && report.correction.powi(3) < 0.1 * TOLERANCE * before * before;
            report.converged = report.correction < TOLERANCE || squares;
        }
        scheme.finish(previous, next);
        Ok(report)
    }
}

impl AffineMap {
    /// Room for an arm. Allocates.
    pub fn new(arm: &Arm) -> Self {
        let (n, cables) = (COORDINATES * arm.node_count(), arm.cable_count());
        // Node i is the end of element i, and a cable's last element ends at the last node that it pulls at.
        let first = (0..arm.node_count())
            .map(|i| (0..cables).find(|&c| arm.cable_elements[c].end > i).unwrap_or(cables))
            .collect();
        Self { x0: vec![0.0; n], x1: vec![0.0; n * cables], cables, first }
    }

    /// Row `r` of `x1`.
    pub fn row(&self, r: usize) -> &[f64] {
        &self.x1[r * self.cables..(r + 1) * self.cables]
    }
}

/// Size of the tangent's coordinate blocks: inertia `m cb` against bending `EI/l^3 (1 + beta cg)`. With the
/// multipliers' rows and columns multiplied by it, the condition number stays near 1e3 for steps of 2 to 100 ms
/// (2e13 without, design section 12).
fn multiplier_scale(arm: &Arm, rates: Rates) -> f64 {
    let inertia = arm.nodes.iter().map(|n| n.mass).fold(0.0, f64::max) * rates.cb;
    let bending = arm
        .elements
        .iter()
        .map(|e| e.stiffness[1] / e.length.powi(3) * (1.0 + e.damping * rates.cg))
        .fold(0.0, f64::max);
    inertia + bending
}
