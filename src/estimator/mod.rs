//! The state estimate: what the arm is doing, from cable lengths and the tensions that were sent (design section 6).
//!
//! Enters: the arm and the observer's settings once; then, each tick, the tensions of the tick and the measured cable
//! lengths with the cables that have none. Leaves: a state on which all constraints hold, the disturbance as tensions,
//! and the innovation as data. It never decides (whether an innovation is a fault is for control to say), never reads
//! a clock, and after [`Observer::new`] it never allocates.
//!
//! The estimate is the dynamic model itself, driven by the same tensions, with a correction that acts like cables do:
//! a spring and a Maxwell damper between the lengths of the model and of the arm. Springs and dampers only take energy
//! out of the estimate's error, whatever the arm is made of, so the observer inherits the model's stability instead of
//! competing with it; a Kalman filter diverged with cable friction. Its old weakness, torsion, which cables do not see
//! and which swung on in the model, is met by more damping in the observer's model than the arm has (`passive`). With
//! that it comes near the Kalman filter's accuracy.
//!
//! - `cable_space`: lengths to bend angles, two per segment, and back.
//! - `passive`: the observer.
//! - `start`: the first estimate, from lengths and tensions at rest.
//! - `covariance`: how well the estimate knows where the arm is.
//! - `health`: settling and innovation tests.
//! - `memory`: what a loop carries from tick to tick, for who linearises it.

mod cable_space;
mod covariance;
mod health;
mod memory;
mod passive;
mod start;

pub use cable_space::CableSpace;
pub use covariance::PositionCovariance;
pub use memory::Kept;
pub use passive::{Observer, Update};
pub use start::StartError;
