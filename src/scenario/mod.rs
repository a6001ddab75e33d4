//! A scenario in open loop: the planner's own model is the arm. With a period as long as the lookahead, as in the paper, the
//! planned state is the next one; with a shorter one each plan is carried out for a period only and made anew from there.
//!
//! Enters: a checked scenario, a seed, a clock for the reported times. Leaves: one [`Step`] after the other, and
//! statistics. It never sleeps and never talks to a bus: the closed loop is the daemon's.

mod goals;
mod run;
mod sweep;

pub use goals::{Course, CourseError};
pub use run::{Run, RunError, Step};
pub use sweep::{SweepRow, sweep, sweep_table};
