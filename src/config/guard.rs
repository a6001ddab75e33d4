//! `[guard]`: the last look at tensions before they leave, and at encoders before they are believed.

use super::reader::Section;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// Limits of the guard. Finiteness and the tension box of the arm are always tested and have no settings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GuardConfig {
    /// Change of a tension from tick to tick beyond which it is limited (N/s); infinite for no limit.
    pub tension_rate_npsmax: f64,
    /// Excess over the tension box that rounding may cause (N); more is a fault.
    pub box_tolerance_n: f64,
    /// Change of a cable's length between two readings beyond which the encoder has jumped (m).
    pub encoder_jump_m: f64,
    /// Time for which a reading may stay exactly the same while the model moves its cable (s).
    pub encoder_stuck_s: f64,
    /// Motion of the model's cable over `encoder_stuck_s` that a sound encoder must show (m).
    pub encoder_stuck_motion_m: f64,
    /// Age of a reading beyond which the encoder is silent (s).
    pub encoder_silent_s: f64,
}

/// `[guard]`.
pub static GUARD: TableSpec = TableSpec {
    header: "[guard]",
    name: "guard",
    about: "The last look at tensions before they leave and at encoders before they are believed. Finiteness and the arm's tension box are always tested.",
    keys: &[
        Key::optional(
            "tension_rate_npsmax",
            Kind::Float(Range::above(0.0, 1e7)),
            "N/s",
            "no limit",
            "Change of a tension from tick to tick beyond which the guard limits it.",
        ),
        Key::default(
            "box_tolerance_n",
            Kind::Float(Range::closed(0.0, 1.0)),
            "N",
            "1e-9",
            "Excess over the tension box that rounding may cause; more is a fault.",
        ),
        Key::default(
            "encoder_jump_m",
            Kind::Float(Range::above(0.0, 1.0)),
            "m",
            "0.01",
            "Change of a cable's length between two readings beyond which the encoder has jumped.",
        ),
        Key::default(
            "encoder_stuck_s",
            Kind::Float(Range::above(0.0, 60.0)),
            "s",
            "0.5",
            "Time for which a reading may stay the same while the model moves its cable.",
        ),
        Key::default(
            "encoder_stuck_motion_m",
            Kind::Float(Range::above(0.0, 1.0)),
            "m",
            "0.002",
            "Motion of the model's cable in that time that a sound encoder must show.",
        ),
        Key::default(
            "encoder_silent_s",
            Kind::Float(Range::above(0.0, 10.0)),
            "s",
            "0.05",
            "Age of a reading beyond which the encoder is silent; at least two periods.",
        ),
    ],
};

/// Reads `[guard]`.
pub(super) fn read(table: &Section<'_>) -> GuardConfig {
    GuardConfig {
        tension_rate_npsmax: table.float_opt("tension_rate_npsmax").unwrap_or(f64::INFINITY),
        box_tolerance_n: table.float("box_tolerance_n"),
        encoder_jump_m: table.float("encoder_jump_m"),
        encoder_stuck_s: table.float("encoder_stuck_s"),
        encoder_stuck_motion_m: table.float("encoder_stuck_motion_m"),
        encoder_silent_s: table.float("encoder_silent_s"),
    }
}
