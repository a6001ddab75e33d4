//! What a run achieved: statistics collected tick by tick, the summary that `--json` prints, the table for people.
//!
//! Enters: per tick the time, tensions, state, distances, planner report. Leaves: a [`Summary`] and its table beside
//! the paper's figures. `abilities` tells what an arm can do before any run. It never influences a run, and runs outside the control thread.

mod abilities;
mod collect;
mod summary;
mod table;

pub use abilities::{Slice, force_at_tip, slice, tip_per_newton};
pub use collect::{Collector, Tick, tip_error};
pub use summary::{
    Approach, Count, Interval, Loop, Newton, ObstacleSummary, Percentiles, Saturation, Summary, Tensions, Times,
    TipError,
};
pub use table::{figures_table, plain_table, summary_table};
