//! The simulated arm and its drives.

pub mod drive;
pub mod truth;
