//! The simulated arm and its drives.
