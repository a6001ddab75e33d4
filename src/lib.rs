//! Real-time controller service for cable-driven multisegment continuum arms.
//!
//! Data flows one way: `config` -> `model` -> `integrator` -> `planner` -> `control` -> `hal`.

pub mod config;
pub mod ipc;
pub mod recording;
