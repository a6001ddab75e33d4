//! Coefficients and vector updates of the generalised-alpha method (Arnold and Bruls 2007), equation (10), and of the
//! backward Euler method in the same form.

use crate::model::{Rates, State};

/// Coefficients of the method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scheme {
    /// `alpha_m = (2 rho - 1)/(rho + 1)`.
    pub alpha_m: f64,
    /// `alpha_f = rho/(rho + 1)`.
    pub alpha_f: f64,
    /// `gamma = 1/2 + alpha_f - alpha_m`.
    pub gamma: f64,
    /// `phi = (gamma + 1/2)^2 / 4`; 1 for backward Euler.
    pub phi: f64,
    /// Share of the auxiliary acceleration that a step starts from: 1; 0 for backward Euler, which carries none.
    carried: f64,
}

impl Scheme {
    /// Coefficients for `rho_inf` in 0..=1.
    pub fn new(rho_inf: f64) -> Self {
        let alpha_m = (2.0 * rho_inf - 1.0) / (rho_inf + 1.0);
        let alpha_f = rho_inf / (rho_inf + 1.0);
        let gamma = 0.5 + alpha_f - alpha_m;
        Self { alpha_m, alpha_f, gamma, phi: 0.25 * (gamma + 0.5).powi(2), carried: 1.0 }
    }

    /// Backward Euler: `q_k = q_{k-1} + eta q'_k`, `q'_k = q'_{k-1} + eta q''_k`, and nothing of the accelerations before.
    ///
    /// The scheme of a planner whose period is shorter than its lookahead. Such a step is a prediction, made again every
    /// period. Generalised-alpha carries the acceleration it starts from over the whole lookahead and lets a mode of
    /// `omega eta >> 1` end at rates of `omega eta` times those that it had; weights on rates then fight velocities that
    /// never come, and the loop is unstable unless the material damps strongly (`docs/DESIGN.md`, prediction).
    pub const fn backward_euler() -> Self {
        Self { alpha_m: 0.0, alpha_f: 0.0, gamma: 1.0, phi: 1.0, carried: 0.0 }
    }

    /// `dq'/dq = gamma/(eta phi)`, `dq''/dq = (1 - alpha_m)/(eta^2 phi (1 - alpha_f))` for a step of `eta` seconds.
    pub fn rates(&self, eta: f64) -> Rates {
        Rates {
            cg: self.gamma / (eta * self.phi),
            cb: (1.0 - self.alpha_m) / (eta * eta * self.phi * (1.0 - self.alpha_f)),
        }
    }

    /// Start of a step of `eta` seconds: `q'' = 0`, the rest by (10); multipliers are carried over.
    pub fn predict(&self, eta: f64, previous: &State, next: &mut State) {
        next.lambda.copy_from_slice(&previous.lambda);
        for k in 0..previous.q.len() {
            let a0 = self.carried * previous.a[k];
            let a1 = (self.alpha_f * previous.qdd[k] - self.alpha_m * a0) / (1.0 - self.alpha_m);
            next.qdd[k] = 0.0;
            next.a[k] = a1;
            next.q[k] = previous.q[k] + eta * previous.qd[k] + eta * eta * ((0.5 - self.phi) * a0 + self.phi * a1);
            next.qd[k] = previous.qd[k] + eta * ((1.0 - self.gamma) * a0 + self.gamma * a1);
        }
    }

    /// End of a step: the auxiliary acceleration that belongs to `next.qdd`.
    pub fn finish(&self, previous: &State, next: &mut State) {
        for k in 0..previous.q.len() {
            next.a[k] = ((1.0 - self.alpha_f) * next.qdd[k] + self.alpha_f * previous.qdd[k]
                - self.alpha_m * previous.a[k])
                / (1.0 - self.alpha_m);
        }
    }
}
