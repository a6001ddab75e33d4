//! What a run achieved: statistics collected tick by tick, the summary that `--json` prints, the table for people.
//!
//! Enters: per tick the time, tensions, state, distances, planner report. Leaves: a [`Summary`] and its table beside
//! the paper's figures. It never influences a run, and runs outside the control thread.

mod collect;
mod summary;
mod table;

pub use collect::{Collector, Tick, tip_error};
pub use summary::{
    Approach, Count, Interval, Loop, Newton, ObstacleSummary, Percentiles, Saturation, Summary, Tensions, Times,
    TipError,
};
pub use table::{figures_table, plain_table, summary_table};
