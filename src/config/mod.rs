//! Configuration: files to checked types.
//!
//! Enters: TOML files. Leaves: types whose every value is inside its documented range, or an error that shows file,
//! line, key, value and range. It never starts anything, and nothing below it reads a file.

mod arm;
mod planner;
mod scenario;

pub use arm::*;
pub use planner::*;
pub use scenario::*;
