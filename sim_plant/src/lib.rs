//! The simulated arm and its drives.

pub mod config;
pub mod drive;
pub mod truth;
