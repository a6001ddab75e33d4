//! `[weights]`: the cost's weights in the daemon, whose targets come from shared memory.

use super::reader::Section;
use super::schema::{Key, Kind, Length, Range, TableSpec};
use serde::Serialize;

/// Weights of (15) for both kinds of target. `W` is meant for period = lookahead; the planner scales it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WeightsConfig {
    /// For tip targets, (42).
    pub tip: TipWeights,
    /// For shape targets, (46).
    pub shape: ShapeWeights,
}

/// Weights for tip targets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TipWeights {
    /// R = r I.
    pub tension: f64,
    /// Diagonal of W per segment.
    pub tension_change: Vec<f64>,
    /// Tip position and quaternion.
    pub pose: f64,
    /// Their rates.
    pub rate: f64,
    /// Rates of all other nodes.
    pub damping: f64,
}

/// Weights for shape targets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShapeWeights {
    /// R = r I.
    pub tension: f64,
    /// Diagonal of W per segment.
    pub tension_change: Vec<f64>,
    /// Curvatures and their rates.
    pub curvature: f64,
}

pub(super) const WEIGHT: Kind = Kind::Float(Range::closed(0.0, 1e20));
pub(super) const POSITIVE_WEIGHT: Kind = Kind::Float(Range::above(0.0, 1e20));
/// W per segment.
pub(super) const SEGMENT_WEIGHTS: Kind = Kind::Floats(Length::Between(1, 8), Range::closed(0.0, 1e20));

/// `[weights]`.
pub static WEIGHTS: TableSpec = TableSpec {
    header: "[weights]",
    name: "weights",
    about: "Weights of the cost (15) in the daemon; the defaults are the paper's. `W` is meant for period = lookahead and is scaled by lookahead/period. The loop steers mean curvatures with the weights `tension`, `tension_change`, `pose` and `rate` of `[weights.tip]`, for every kind of target.",
    keys: &[
        Key::optional("tip", Kind::Table(&TIP), "", "its defaults", "For tip targets."),
        Key::optional("shape", Kind::Table(&SHAPE), "", "its defaults", "For shape targets."),
    ],
};

static TIP: TableSpec = TableSpec {
    header: "[weights.tip]",
    name: "tip",
    about: "Weights for tip targets, (42).",
    keys: &[
        Key::default("tension", POSITIVE_WEIGHT, "1/N^2", "1.0", "R = r I."),
        Key::optional(
            "tension_change",
            SEGMENT_WEIGHTS,
            "1/N^2",
            "1e4, 2e4, 3e4, ...",
            "Diagonal of W, one number per segment.",
        ),
        Key::default("pose", POSITIVE_WEIGHT, "1/m^2, 1", "5e12", "Tip position and quaternion."),
        Key::default("rate", WEIGHT, "s^2/m^2, s^2", "5e10", "Their rates."),
        Key::default("damping", WEIGHT, "s^2/m^2, s^2", "1e8", "Rates of all other nodes; not used by the loop."),
    ],
};

static SHAPE: TableSpec = TableSpec {
    header: "[weights.shape]",
    name: "shape",
    about: "Weights for shape targets, (46) at its end; not used by the loop, which steers every target with `[weights.tip]`.",
    keys: &[
        Key::default("tension", POSITIVE_WEIGHT, "1/N^2", "1.0", "R = r I."),
        Key::optional(
            "tension_change",
            SEGMENT_WEIGHTS,
            "1/N^2",
            "2e6 for every segment",
            "Diagonal of W, one number per segment.",
        ),
        Key::default("curvature", POSITIVE_WEIGHT, "m^2", "1e10", "Mean curvatures and their rates."),
    ],
};

/// Reads `[weights]` for an arm of so many segments.
pub(super) fn read(table: &Section<'_>, segments: usize) -> WeightsConfig {
    let tip = table.table("tip");
    let shape = table.table("shape");
    let tip_change = change(&tip, segments, |s| 1e4 * (s + 1) as f64);
    let shape_change = change(&shape, segments, |_| 2e6);
    WeightsConfig {
        tip: TipWeights {
            tension: tip.float("tension"),
            tension_change: tip_change,
            pose: tip.float("pose"),
            rate: tip.float("rate"),
            damping: tip.float("damping"),
        },
        shape: ShapeWeights {
            tension: shape.float("tension"),
            tension_change: shape_change,
            curvature: shape.float("curvature"),
        },
    }
}

fn change(table: &Section<'_>, segments: usize, default: impl Fn(usize) -> f64) -> Vec<f64> {
    let weights = table.floats_opt("tension_change").unwrap_or_else(|| (0..segments).map(default).collect());
    refuse_other_length(table, "tension_change", weights.len(), segments, "one per segment");
    weights
}

/// Refuses an array whose length does not fit the arm.
pub(super) fn refuse_other_length(table: &Section<'_>, key: &'static str, found: usize, wanted: usize, what: &str) {
    if found != wanted && table.is_clean() {
        let message = format!("{found} entries for an arm that needs {wanted}");
        table.refuse(key, message, &format!("permitted: exactly {wanted} numbers, {what}"));
    }
}
