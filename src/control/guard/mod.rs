//! The last look at tensions before they leave, and at encoders before they are believed.
//!
//! Enters: readings, planned tensions. Leaves: verdicts as data, readings that may be used, tensions that may be sent. It
//! never lets a NaN pass and never plans: a minimum tension is held by the planner's box (shifting), not by clipping here.

mod encoders;
mod tension;

pub use encoders::{EncoderGuard, EncoderReadings, Watch};
pub use tension::{Floor, TensionGuard, TensionVerdict};
