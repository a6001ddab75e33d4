//! Equation (1) of the paper: the dynamics of a cable-driven multisegment arm, with its full analytic tangent.
//!
//! Enters: an [`crate::config::ArmConfig`] once, then coordinates, rates, multipliers and tensions. Leaves: residual,
//! tangent, input matrix, lengths, poses, curvatures. It never integrates, never decides, and after [`Arm::new`] it
//! never allocates. `NOTATION.md` beside this file lists the letters.
//!
//! `arm` is fixed after set-up, `state` changes each step, `assembly` fills the scratch that solvers own. One file per
//! term of the equation: `inertia`, `elastic`, `chord`, `cables` (with `legs`, all cables of an element at once).

mod arm;
mod assembly;
mod cables;
mod chord;
mod elastic;
mod inertia;
mod input;
mod legs;
mod linearize;
mod outputs;
mod state;

pub use arm::{Arm, Element, HolePass, Node};
pub use assembly::Motion;
pub use linearize::{Linearization, Rates};
pub use outputs::{CurvatureSensitivity, Outputs};
pub use state::State;
