//! The last look at tensions before they leave, at encoders before they are believed, at the innovation always.
//!
//! Enters: readings, planned tensions, the observer's innovation. Leaves: verdicts as data, readings that may be used,
//! tensions that may be sent. It never lets a NaN pass and never plans: a minimum tension is held by the planner's box
//! (shifting), not by clipping here.

mod encoders;
mod innovation;
mod tension;

pub use encoders::{EncoderGuard, EncoderReadings};
pub use innovation::InnovationGuard;
pub use tension::{Floor, TensionGuard, TensionVerdict};
