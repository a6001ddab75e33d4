//! What the cycle needs of an observer; the real one is `sinew::estimator`, tests use the model itself.

use crate::model::State;

/// What an update found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Largest |z| (rad): the bend angles by which model and measurement differ.
    pub innovation_max_rad: f64,
    /// Innovation and rates have stayed small for the configured time.
    pub settled: bool,
}

/// Why an observer could not do its step; the cycle turns it into a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EstimatorFailure {
    /// No shape at rest fits the measured lengths.
    #[error("no shape of the arm at rest fits the measured cable lengths")]
    NoStart,
    /// The model's step was singular or diverged.
    #[error("the model's step failed")]
    Step,
}

/// Follows the arm from cable lengths. Nothing but construction may allocate.
pub trait Estimator {
    /// Starts at rest from measured lengths (m) under tensions (N), one per cable.
    ///
    /// # Errors
    /// [`EstimatorFailure::NoStart`].
    fn start(&mut self, lengths_m: &[f64], tensions_n: &[f64]) -> Result<(), EstimatorFailure>;

    /// Advances by one period to the time of `lengths_m` (m), with the tensions (N) that acted since the last update.
    ///
    /// # Errors
    /// [`EstimatorFailure::Step`].
    fn update(&mut self, applied_n: &[f64], lengths_m: &[f64]) -> Result<Estimate, EstimatorFailure>;

    /// The estimate at the time for which the next tensions are planned.
    fn state(&self) -> &State;

    /// Tensions (N) that act beside the commanded ones; empty for none.
    fn disturbance_n(&self) -> &[f64];

    /// Innovation z (rad), (y, z) segment by segment, for the record; may be empty.
    fn innovation_rad(&self) -> &[f64] {
        &[]
    }

    /// Disturbance as moments beta (N m), (y, z) segment by segment, for the record; may be empty.
    fn disturbance_nm(&self) -> &[f64] {
        &[]
    }
}
