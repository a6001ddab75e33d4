//! The planning problem.
pub mod complementarity;
