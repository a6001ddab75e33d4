//! The arm at rest: what pose its tip has at given mean curvatures, and which curvatures reach a pose.
//!
//! Enters: the arm once; then curvatures, poses, tensions. Leaves: equilibria, their sensitivities, reference curvatures.
//! It never looks at a clock and after its constructors never allocates.
//!
//! Mean curvatures are what cables measure and move, two per segment: force and motion at the same place. Whatever swings
//! beside them (torsion, bending inside a segment) cannot be driven unstable through them. The closed loop therefore
//! steers curvatures, and knows the tip as the equilibrium's function of them.

mod inverse;
mod reference;
mod rest;
mod search;

pub use inverse::{Inverse, InverseSettings, Outcome, pose_weights};
pub use reference::{Met, Reference, ReferenceSettings, Surroundings, Wanted, segment_lengths};
pub use rest::{POSE, RestingArm, pose_error};
pub use search::Search;
