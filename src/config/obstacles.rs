//! `[obstacles]`: how far perception is believed.

use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Length, Range, TableSpec};
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
    /// Most that an obstacle grows by age (m).
    pub growth_m_max: f64,
    /// What the arm does when a source is expired and its obstacles have grown that far.
    pub lost: LostAction,
    /// k: obstacles are grown by k standard deviations of their position.
    pub sigma_multiple: f64,
    /// Most obstacles of all sources together, at most 64.
    pub capacity: usize,
    /// How far a capture time may lie in the future (s) before the set is rejected.
    pub future_tolerance_s: f64,
    /// True if the arm may only track while at least one perception client publishes.
    pub require_source: bool,
    /// Sources that must be there for motion, at most eight.
    pub required: Vec<u32>,
    /// True if the arm may be armed while obstacles are not known.
    pub arm_unknown: bool,
}

/// What the arm does when nobody knows any more where obstacles are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LostAction {
    /// Goes on holding.
    Hold,
    /// Ramps its tensions down and disarms.
    Stop,
}

/// `[obstacles]`.
pub static OBSTACLES: TableSpec = TableSpec {
    header: "[obstacles]",
    name: "obstacles",
    about: "How far obstacle estimates are believed (L is the arm's length): they grow with uncertainty and age, and in the end the arm holds.",
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
        Key::optional(
            "growth_mps",
            Kind::Float(Range::closed(0.0, 10.0)),
            "m/s",
            "0.018 L per second",
            "Growth per second of age beyond `stale_after_s`; beyond `hold_after_s` by the obstacle's speed as well, for it is \
             no longer moved.",
        ),
        Key::optional(
            "growth_m_max",
            Kind::Float(Range::closed(0.0, 10.0)),
            "m",
            "0.11 L",
            "Most that an obstacle grows by age.",
        ),
        Key::default(
            "lost",
            Kind::Choice(&["hold", "stop"]),
            "",
            "\"hold\"",
            "What the arm does when a source is expired and its obstacles have grown by `growth_m_max`: go on holding, or \
             stop.",
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
        Key::default(
            "required",
            Kind::Integers(Length::Between(0, 8), 0, u32::MAX as i64),
            "",
            "[]",
            "Source ids that must be there for motion: absent, refused or crowded out, the arm holds. Their places are kept.",
        ),
        Key::default(
            "arm_unknown",
            Kind::Bool,
            "",
            "false",
            "Arm although obstacles are not known: no client publishes (`require_source`), or one of `required` is absent. The \
             way to the start posture is then taken without them.",
        ),
    ],
};

/// Growth of an obstacle by age (1/s) and the most of it, over the arm's length.
const GROWTH_1PS: f64 = 0.05 / 2.75;
const GROWTH_MAX: f64 = 0.3 / 2.75;

/// Reads `[obstacles]` for an arm.
pub(super) fn read(table: &Section<'_>, scale: &Scale) -> ObstaclePolicyConfig {
    let config = ObstaclePolicyConfig {
        stale_after_s: table.float("stale_after_s"),
        hold_after_s: table.float("hold_after_s"),
        growth_mps: table.float_opt("growth_mps").unwrap_or(GROWTH_1PS * scale.length_m),
        sigma_multiple: table.float("sigma_multiple"),
        capacity: table.count("capacity"),
        future_tolerance_s: table.float("future_tolerance_s"),
        growth_m_max: table.float_opt("growth_m_max").unwrap_or(GROWTH_MAX * scale.length_m),
        lost: if table.choice("lost") == "stop" { LostAction::Stop } else { LostAction::Hold },
        require_source: table.boolean("require_source"),
        arm_unknown: table.boolean("arm_unknown"),
        required: table.integers("required").into_iter().filter_map(|id| u32::try_from(id).ok()).collect(),
    };
    if config.hold_after_s < config.stale_after_s {
        let help = format!("permitted: {} s (`stale_after_s`) to 600 s", config.stale_after_s);
        table.refuse("hold_after_s", "shorter than `stale_after_s`", &help);
    }
    config
}
