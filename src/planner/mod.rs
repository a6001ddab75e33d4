//! Problem (15) and its two subspaces: what tensions to apply next.
//!
//! Enters: a state, the last tensions, a goal, obstacles now and at the end of the lookahead, a random source, a
//! deadline. Leaves: tensions inside their box, always, the state planned with them, and a report. It never talks to
//! anything, never looks at a clock by itself, and after [`Planner::new`] never allocates.

mod combined;
pub mod complementarity;
mod deadline;
mod problem;
mod sensitivity;
mod start;
pub mod swarm;

pub use combined::{Branch, Inputs, LedTo, PAIRS_MAX, Planner, Report, Status};
pub use deadline::Deadline;
pub use problem::{Goal, Quadratic};
pub use sensitivity::sensitivity;
pub use start::{StartError, tip_start};

use crate::config::PlannerConfig;
use crate::integrator::Scheme;

/// The scheme by which a planner predicts: generalised-alpha where its step is carried out as it was planned, as in the
/// paper; backward Euler where it is planned anew before it has ended.
pub fn prediction(config: &PlannerConfig, rho_inf: f64) -> Scheme {
    if config.period_s < config.lookahead_s { Scheme::backward_euler() } else { Scheme::new(rho_inf) }
}
