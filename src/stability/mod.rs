//! Whether the closed loop is stable where the arm is held, in which modes it moves, and by how much the arm may differ.
//!
//! Enters: a configuration, where the arm is to be held, how the true arm differs from its model. Leaves: the modes of the
//! map of one tick, and margins. It runs the controller's own [`crate::control::Cycle`] against an arm of the library's own
//! integrator and never talks to anything.
//!
//! - `plant`: the true arm.
//! - `held`: arm and controller together, at rest at a pose or shape. A loop that is not stable cannot come to rest by itself,
//!   so the arm is led: at each tick it is put into its equilibrium at the governor's reference and the observer starts anew.
//!   What rests so is a fixed point of the real loop, and its damping and delays do not matter to it.
//! - `spectrum`: the tick's derivative there. A tick is run from the fixed point moved to either side along a direction of
//!   all that arm and controller remember; the difference is the derivative along it. Arnoldi's method builds a basis from
//!   such products, and faer finds the eigenvalues of the small matrix that is left.
//! - `modes`: what an eigenvector moves.
//! - `margins`: how far one property of the true arm may be from its model's.
//!
//! The least tensions are not part of it: a cable at its least tension answers to one side only, and a loop that swings
//! lifts it off within a period. So all cables are held a little above.

mod held;
mod margins;
mod modes;
mod plant;
mod posture;
mod spectrum;

pub use held::{Held, Place};
pub use margins::{Margin, Margins, Property, margins};
pub use modes::LoopMode;
pub use plant::{Differs, Plant};
pub use posture::{random_posture, reach};
pub use spectrum::Spectrum;

use crate::config::Config;

/// Why a loop could not be looked at.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StabilityError {
    /// No posture of the arm reaches the pose.
    #[error("the pose is out of reach: the nearest posture that was found is {:.1} mm from it", 1e3 * .0)]
    OutOfReach(f64),
    /// Curvatures are not as many as the arm has, or not finite.
    #[error("a shape of this arm has {wanted} finite curvatures, two for each segment, not {given}")]
    Shape {
        /// Curvatures given.
        given: usize,
        /// Two for each segment.
        wanted: usize,
    },
    /// The cables cannot hold it.
    #[error("no tensions hold the posture: a cable would need {needed_n:.0} N and has {most_n:.0} N")]
    Tension {
        /// Largest tension needed (N).
        needed_n: f64,
        /// Its cable's largest one (N).
        most_n: f64,
    },
    /// The arm has no equilibrium there.
    #[error("the arm does not rest there: {0}")]
    NoRest(String),
    /// The controller would not hold the arm.
    #[error("the controller does not come to hold the arm: {0}")]
    NotHeld(String),
    /// A tick from beside the fixed point failed.
    #[error("the map of a tick could not be found: {0}")]
    NoMap(String),
}

/// Growth (1/s), over the arm's first angular frequency, from which a mode counts as growing: what the differences leave of a
/// mode that neither grows nor fades.
const GROWS: f64 = 0.005;

/// Growth (1/s) from which a mode of this arm's loop is not stable.
pub fn growth_limit_1ps(config: &Config) -> f64 {
    GROWS * crate::config::Scale::of(&config.arm).omega_radps
}
