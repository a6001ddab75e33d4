//! Real-time controller service for cable-driven multisegment continuum arms.
//!
//! Data flows one way: `config` -> `model` -> `integrator` -> `planner` -> `control` -> `hal`.

pub mod collision;
pub mod config;
pub mod control;
pub mod daemon;
pub mod estimator;
pub mod integrator;
pub mod ipc;
pub mod math;
pub mod model;
pub mod planner;
pub mod posture;
pub mod recording;
pub mod report;
pub mod scenario;
pub mod stability;

/// Makes the claims of unit tests about allocation able to fail.
#[cfg(test)]
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
