//! `[obstacles]`: how far perception is believed.

use super::reader::Section;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// Treatment of obstacle estimates over their age and uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObstaclePolicyConfig {
    /// Age of a source's newest set beyond which it is stale (s): its obstacles grow.
    pub stale_after_s: f64,
    /// Age beyond which the arm holds (s); at least `stale_after_s`.
    pub hold_after_s: f64,
    /// Growth of every obstacle per second of age beyond `stale_after_s` (m/s).
    pub growth_mps: f64,
    /// k: obstacles are grown by k standard deviations of their position.
    pub sigma_multiple: f64,
    /// Most obstacles of all sources together, at most 64.
    pub capacity: usize,
    /// How far a capture time may lie in the future (s) before the set is rejected.
    pub future_tolerance_s: f64,
    /// True if the arm may only track while at least one perception client publishes.
    pub require_source: bool,
}

/// `[obstacles]`.
pub static OBSTACLES: TableSpec = TableSpec {
    header: "[obstacles]",
    name: "obstacles",
    about: "How far obstacle estimates are believed: they grow with uncertainty and age, and in the end the arm holds.",
    keys: &[
        Key::default(
            "stale_after_s",
            Kind::Float(Range::above(0.0, 60.0)),
            "s",
            "0.2",
            "Age of a source's newest set beyond which its obstacles grow.",
        ),
        Key::default(
            "hold_after_s",
            Kind::Float(Range::above(0.0, 600.0)),
            "s",
            "1.0",
            "Age beyond which the arm holds; at least `stale_after_s`.",
        ),
        Key::default(
            "growth_mps",
            Kind::Float(Range::closed(0.0, 10.0)),
            "m/s",
            "0.05",
            "Growth per second of age beyond `stale_after_s`.",
        ),
        Key::default(
            "sigma_multiple",
            Kind::Float(Range::closed(0.0, 10.0)),
            "",
            "3.0",
            "Obstacles are grown by this many standard deviations of their position.",
        ),
        Key::default("capacity", Kind::Integer(1, 64), "", "64", "Most obstacles of all sources together."),
        Key::default(
            "future_tolerance_s",
            Kind::Float(Range::closed(0.0, 1.0)),
            "s",
            "0.001",
            "How far a capture time may lie in the future before the set is rejected.",
        ),
        Key::default(
            "require_source",
            Kind::Bool,
            "",
            "true",
            "Track only while a perception client publishes; an empty set is one, no client is none.",
        ),
    ],
};

/// Reads `[obstacles]`.
pub(super) fn read(table: &Section<'_>) -> ObstaclePolicyConfig {
    let config = ObstaclePolicyConfig {
        stale_after_s: table.float("stale_after_s"),
        hold_after_s: table.float("hold_after_s"),
        growth_mps: table.float("growth_mps"),
        sigma_multiple: table.float("sigma_multiple"),
        capacity: table.count("capacity"),
        future_tolerance_s: table.float("future_tolerance_s"),
        require_source: table.boolean("require_source"),
    };
    if config.hold_after_s < config.stale_after_s {
        let help = format!("permitted: {} s (`stale_after_s`) to 600 s", config.stale_after_s);
        table.refuse("hold_after_s", "shorter than `stale_after_s`", &help);
    }
    config
}
