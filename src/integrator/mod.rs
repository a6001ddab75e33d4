//! Equations (9)-(14): the generalised-alpha method for index-3 DAEs, statics, consistent starts.
//!
//! Enters: an arm, a state, tensions. Leaves: the next state, and the affine map (11) on which the planner optimises.
//! It never chooses tensions, and a step never allocates.

mod modes;
mod scheme;
mod statics;
mod step;

pub(crate) use modes::free_motions;
pub use modes::{Mode, modes};
pub use scheme::Scheme;
pub use statics::{StaticsError, consistent_start, equilibrium};
pub use step::{AffineMap, StepError, StepReport, Stepper};
