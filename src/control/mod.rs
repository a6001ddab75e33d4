//! The controller of one tick, as a pure function of its inputs.
//!
//! Enters: the newest encoder readings, prepared obstacle sets, a target, the drives' state, an operator's request, a
//! random source and a deadline. Leaves: tensions that are finite and inside their box whatever happened before, a
//! command to the drives, an answer to the request, and a record of the tick. It must never look at a clock, talk to
//! anything, allocate after [`Cycle::new`], format a string in a tick, or replace a value that is not a number in
//! silence.
//!
//! [`cycle`] calls the parts in order: [`guard`] judges the encoders, an [`Estimator`] follows the arm, [`supervision`]
//! watches motion, tensions and cables, [`supervisor`] decides on the mode from faults, requests and progress, the planner plans, and [`guard`] has the last
//! look at the tensions. Faults (the machine must change its mode; codes below 100) and limits (the machine acts within
//! a bound; codes from 100) are kept apart in [`fault`]; what happened is kept in a ring of `Copy` events in [`event`].
//!
//! The order on the control thread, with [`Budget`] for the times and a triple buffer slot that holds an
//! [`ObstaclePair`]: place the obstacles; sample the target now and [`Cycle::lead_s`] ahead; [`Cycle::tick`]; send
//! [`Cycle::tensions_n`]; [`Cycle::report`]; hand the [`Record`] and the events over.

pub mod budget;
mod causes;
pub mod cycle;
pub mod estimator;
pub mod event;
pub mod fault;
mod fault_parts;
mod fault_words;
mod follower;
pub mod friction;
pub mod governor;
pub mod guard;
pub mod obstacles;
pub mod overruns;
mod pace;
mod path;
pub mod ramp;
mod reach;
pub mod record;
pub mod settings;
mod steering;
pub mod supervision;
pub mod supervisor;
pub mod target;
mod tip_offset;
mod tip_sensor;

pub use budget::{Budget, Phase, StopWatch};
pub use causes::{doubts, likely_cause};
pub use cycle::{Cycle, Plan, STAY_LOOKAHEADS, TickInputs, TickOutput};
pub use estimator::{Estimate, Estimator, EstimatorFailure};
pub use event::{Event, EventKind, EventRing};
pub use fault::{Fault, FaultLatch, FaultList, Latched, Limit, Limits};
pub use fault_parts::{Class, Subject};
pub use fault_words::cause_text;
pub use friction::FrictionCompensation;
pub use guard::{EncoderReadings, TensionVerdict};
pub use obstacles::{ObstacleDemand, ObstaclePair};
pub use reach::Reach;
pub use record::{Distance, Record, Timing};
pub use settings::Settings;
pub use steering::{Steering, weights_in_words};
pub use supervisor::{Answer, Cause, DrivesCommand, DrivesInput, DrivesPhase, Mode, Refusal, Request, Supervisor};
pub use target::{Target, TargetInput};
pub use tip_sensor::{TipReading, TipSensor};

/// Most cables of an arm: the width of every array of a record.
pub const CABLES_MAX: usize = 96;
/// Most average curvatures: two for each of sixteen segments.
pub const CURVATURES_MAX: usize = 32;
/// Most nodes in a record; a longer arm is recorded with a stride.
pub const NODES_MAX: usize = 64;

/// A set of cables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CableMask(pub u128);

impl CableMask {
    /// The first `count` cables.
    pub const fn first(count: usize) -> Self {
        if count >= 128 { Self(u128::MAX) } else { Self((1 << count) - 1) }
    }

    /// Whether the cable is in the set.
    pub const fn contains(self, cable: usize) -> bool {
        cable < 128 && self.0 >> cable & 1 == 1
    }

    /// Adds a cable.
    pub const fn insert(&mut self, cable: usize) {
        if cable < 128 {
            self.0 |= 1 << cable;
        }
    }

    /// Takes a cable out.
    pub const fn remove(&mut self, cable: usize) {
        if cable < 128 {
            self.0 &= !(1 << cable);
        }
    }
}
