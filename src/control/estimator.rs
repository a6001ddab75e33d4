//! What the cycle needs of an observer; the real one is [`crate::estimator::Observer`], tests use the model itself.

use crate::estimator::Observer;
use crate::model::State;

/// What an update found.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Estimate {
    /// Largest |z| (rad): the bend angles by which model and measurement differ.
    pub innovation_max_rad: f64,
    /// Its growth within the configured window (rad).
    pub innovation_growth_rad: f64,
    /// The largest |z| is beyond its bound.
    pub beyond_bound: bool,
    /// The growth is beyond its limit.
    pub growing: bool,
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

    /// Advances by so many periods, one but after ticks left out, to the time of `lengths_m` (m); one that is not finite is
    /// no reading. `sent_n` are the tensions (N) sent in the tick before, zero where the drives gave no torque.
    ///
    /// # Errors
    /// [`EstimatorFailure::Step`].
    fn update(&mut self, sent_n: &[f64], lengths_m: &[f64], periods: u32) -> Result<Estimate, EstimatorFailure>;

    /// Takes over, for the record alone, the shape that the lengths (m) show of an arm at rest; false where they show none.
    /// For ticks in which nothing is estimated.
    fn look(&mut self, _lengths_m: &[f64]) -> bool {
        false
    }

    /// Takes over what friction leaves of the tensions at each passage, see [`crate::model::Arm::take_shares`].
    fn take_shares(&mut self, _shares: &[f64]) {}

    /// The estimate at the time of the newest reading.
    fn state(&self) -> &State;

    /// The estimate at the time when tensions sent now begin to act: what is planned from.
    fn predicted(&self) -> &State {
        self.state()
    }

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

    /// Correction w as moments (N m), (y, z) segment by segment: with the disturbance what acts beside the tensions; may be
    /// empty.
    fn correction_nm(&self) -> &[f64] {
        &[]
    }
}

impl Estimator for Observer {
    fn start(&mut self, lengths_m: &[f64], tensions_n: &[f64]) -> Result<(), EstimatorFailure> {
        Self::start(self, lengths_m, tensions_n).map_err(|_| EstimatorFailure::NoStart)
    }

    fn update(&mut self, sent_n: &[f64], lengths_m: &[f64], periods: u32) -> Result<Estimate, EstimatorFailure> {
        let update = Self::update_over(self, sent_n, lengths_m, periods);
        if update.failed {
            return Err(EstimatorFailure::Step);
        }
        Ok(Estimate {
            innovation_max_rad: update.innovation_max,
            innovation_growth_rad: update.innovation_growth,
            beyond_bound: update.beyond_bound,
            growing: update.growing,
            settled: update.settled,
        })
    }

    fn look(&mut self, lengths_m: &[f64]) -> bool {
        Self::look(self, lengths_m)
    }

    fn take_shares(&mut self, shares: &[f64]) {
        Self::take_shares(self, shares);
    }

    fn state(&self) -> &State {
        Self::state(self)
    }

    fn predicted(&self) -> &State {
        Self::predicted(self)
    }

    fn disturbance_n(&self) -> &[f64] {
        Self::disturbance(self)
    }

    fn innovation_rad(&self) -> &[f64] {
        Self::innovation(self)
    }

    fn disturbance_nm(&self) -> &[f64] {
        Self::disturbance_moments(self)
    }

    fn correction_nm(&self) -> &[f64] {
        Self::correction_moments(self)
    }
}
