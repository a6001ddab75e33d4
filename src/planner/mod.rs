//! Problem (15) and its two subspaces: what tensions to apply next.
//!
//! Enters: a state, the last tensions, a goal, obstacles now and at the end of the lookahead, a random source, a
//! deadline. Leaves: tensions inside their box, always, the state planned with them, and a report. It never talks to
//! anything, never looks at a clock by itself, and after [`Planner::new`] never allocates.

mod combined;
pub mod complementarity;
mod deadline;
mod problem;
mod start;
pub mod swarm;

pub use combined::{Branch, Inputs, PAIRS_MAX, Planner, Report, Status};
pub use deadline::Deadline;
pub use problem::{Goal, Quadratic};
pub use start::{StartError, tip_start};
