//! `[target]`: how long a task client's target is followed without it.

use super::reader::Section;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// Treatment of targets over their age.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TargetPolicyConfig {
    /// Time beyond its last point for which a moving target goes on at its rates (s); then it stands still.
    pub stale_after_s: f64,
    /// Time beyond the last point of a moving target after which the arm holds (s); at least `stale_after_s`.
    pub hold_after_s: f64,
    /// How far a capture time may lie in the future (s) before the target is rejected.
    pub future_tolerance_s: f64,
}

/// `[target]`.
pub static TARGET: TableSpec = TableSpec {
    header: "[target]",
    name: "target",
    about: "How long a moving target is followed when its client falls silent. One that stands still is kept.",
    keys: &[
        Key::default(
            "stale_after_s",
            Kind::Float(Range::above(0.0, 10.0)),
            "s",
            "0.2",
            "Time beyond its last point for which a moving target goes on at its rates; then it stands still.",
        ),
        Key::default(
            "hold_after_s",
            Kind::Float(Range::above(0.0, 600.0)),
            "s",
            "1.0",
            "Time beyond the last point of a moving target after which the arm holds; at least `stale_after_s`. A client's \
             first message must not be older.",
        ),
        Key::default(
            "future_tolerance_s",
            Kind::Float(Range::closed(0.0, 1.0)),
            "s",
            "0.001",
            "How far a capture time may lie in the future before the target is rejected.",
        ),
    ],
};

/// Reads `[target]`.
pub(super) fn read(table: &Section<'_>) -> TargetPolicyConfig {
    let config = TargetPolicyConfig {
        stale_after_s: table.float("stale_after_s"),
        hold_after_s: table.float("hold_after_s"),
        future_tolerance_s: table.float("future_tolerance_s"),
    };
    if config.hold_after_s < config.stale_after_s {
        let help = format!("permitted: {} s (`stale_after_s`) to 600 s", config.stale_after_s);
        table.refuse("hold_after_s", "shorter than `stale_after_s`", &help);
    }
    config
}
