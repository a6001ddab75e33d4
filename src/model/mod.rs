//! Equation (1) of the paper: the dynamics of a cable-driven multisegment arm, with its full analytic tangent.
//!
//! Enters: an [`crate::config::ArmConfig`] once, then coordinates, rates, multipliers and tensions. Leaves: residual,
//! tangent, input matrix, lengths, poses, curvatures. It never integrates, never decides, and after [`Arm::new`] it
//! never allocates. `NOTATION.md` beside this file lists the letters.
//!
//! `arm` is fixed after set-up, `state` changes each step, `linearize` fills the scratch that solvers own. One file per
//! term of the equation: `inertia`, `elastic`, `chord`, `cables`; their formulas are written for any number of elements side
//! by side. `terms` evaluates them one by one for a single state, `linearize` all together with their tangent.

mod arm;
mod cables;
mod chord;
mod elastic;
mod inertia;
mod input;
mod legs;
mod linearize;
mod outputs;
mod state;
mod terms;

pub use arm::{Arm, Element, HolePass, Node};
pub use linearize::{Linearization, Rates};
pub use outputs::{CurvatureSensitivity, Outputs};
pub use state::State;
pub use terms::Motion;
