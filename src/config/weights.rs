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
    /// R = r I; `None` for a ten-thousandth of the least of W.
    pub tension: Option<f64>,
    /// Diagonal of W per segment; `None` for `change_ratio` times what the arm answers with.
    pub tension_change: Option<Vec<f64>>,
    /// Diagonal of W over that of `S^T Q S`, S what the outputs answer a tension with over the lookahead.
    pub change_ratio: f64,
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
pub(super) const SEGMENT_WEIGHTS: Kind = Kind::Floats(Length::Between(1, 16), Range::closed(0.0, 1e20));

/// `[weights]`.
pub static WEIGHTS: TableSpec = TableSpec {
    header: "[weights]",
    name: "weights",
    about: "Weights of the cost (15) in the daemon; the defaults are computed from the arm. `W` is meant for period = lookahead and is scaled by lookahead/period. The loop steers mean curvatures with the weights `tension`, `tension_change`, `pose` and `rate` of `[weights.tip]`, for every kind of target.",
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
        Key::optional("tension", POSITIVE_WEIGHT, "1/N^2", "1e-4 of the least `tension_change`", "R = r I."),
        Key::optional(
            "tension_change",
            SEGMENT_WEIGHTS,
            "1/N^2",
            "`change_ratio` of the arm's own",
            "Diagonal of W, one number per segment.",
        ),
        Key::optional(
            "change_ratio",
            Kind::Float(Range::above(0.0, 1e6)),
            "",
            "1e-3; of N > 4 segments (4/N)^2 of it",
            "Where `tension_change` is absent: W over the diagonal of S^T Q S, which says how strongly a segment's bends answer its cables within the lookahead.",
        ),
        Key::default("pose", POSITIVE_WEIGHT, "1/m^2, 1", "5e12", "Tip position and quaternion."),
        Key::optional(
            "rate",
            WEIGHT,
            "s^2/m^2, s^2",
            "`pose` times the lookahead squared",
            "Their rates: the loop follows with a lag of rate / (pose lookahead).",
        ),
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

/// `change_ratio` of up to four segments.
const CHANGE_RATIO: f64 = 1e-3;

/// `change_ratio` of an arm of so many segments whose configuration has none. The more segments, the less a bend of the whole
/// arm answers beside one of a single segment, which the diagonal of `S^T Q S` is about: held back as much, it comes too
/// late, and the arm swings up.
fn change_ratio(segments: usize) -> f64 {
    CHANGE_RATIO * (4.0 / segments.max(4) as f64).powi(2)
}

/// Reads `[weights]` for an arm of so many segments and a lookahead (s).
pub(super) fn read(table: &Section<'_>, segments: usize, lookahead_s: f64) -> WeightsConfig {
    let tip = table.table("tip");
    let shape = table.table("shape");
    let pose = tip.float("pose");
    WeightsConfig {
        tip: TipWeights {
            tension: tip.float_opt("tension"),
            tension_change: change(&tip, segments),
            change_ratio: tip.float_opt("change_ratio").unwrap_or_else(|| change_ratio(segments)),
            pose,
            rate: tip.float_opt("rate").unwrap_or(pose * lookahead_s * lookahead_s),
            damping: tip.float("damping"),
        },
        shape: ShapeWeights {
            tension: shape.float("tension"),
            tension_change: change(&shape, segments).unwrap_or_else(|| vec![2e6; segments]),
            curvature: shape.float("curvature"),
        },
    }
}

fn change(table: &Section<'_>, segments: usize) -> Option<Vec<f64>> {
    let weights = table.floats_opt("tension_change")?;
    refuse_other_length(table, "tension_change", weights.len(), segments, "one per segment");
    Some(weights)
}

/// Refuses an array whose length does not fit the arm.
pub(super) fn refuse_other_length(table: &Section<'_>, key: &'static str, found: usize, wanted: usize, what: &str) {
    if found != wanted && table.is_clean() {
        let message = format!("{found} entries for an arm that needs {wanted}");
        table.refuse(key, message, &format!("permitted: exactly {wanted} numbers, {what}"));
    }
}
