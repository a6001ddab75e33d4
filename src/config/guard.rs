//! `[guard]`: the last look at tensions before they leave, and at encoders before they are believed.

use super::reader::Section;
use super::scale::Scale;
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
    about: "The last look at tensions before they leave and at encoders before they are believed. L is the arm's length. Finiteness and the arm's tension box are always tested.",
    keys: &[
        Key::optional(
            "tension_rate_npsmax",
            Kind::Float(Range::above(0.0, 1e7)),
            "N/s",
            "no limit",
            "Change of a tension from tick to tick beyond which the guard limits it.",
        ),
        Key::optional(
            "box_tolerance_n",
            Kind::Float(Range::closed(0.0, 1.0)),
            "N",
            "5e-12 of the largest tension",
            "Excess over the tension box that rounding may cause; more is a fault.",
        ),
        Key::optional(
            "encoder_jump_m",
            Kind::Float(Range::above(0.0, 1.0)),
            "m",
            "0.0036 L",
            "Change of a cable's length between two readings beyond which the encoder has jumped.",
        ),
        Key::default(
            "encoder_stuck_s",
            Kind::Float(Range::above(0.0, 60.0)),
            "s",
            "0.5",
            "Time for which a reading may stay the same while the model moves its cable.",
        ),
        Key::optional(
            "encoder_stuck_motion_m",
            Kind::Float(Range::above(0.0, 1.0)),
            "m",
            "0.00073 L",
            "Motion of the model's cable in that time that a sound encoder must show.",
        ),
        Key::optional(
            "encoder_silent_s",
            Kind::Float(Range::above(0.0, 10.0)),
            "s",
            "0.05 s, at least 5 periods",
            "Age of a reading beyond which the encoder is silent; at least two periods.",
        ),
    ],
};

/// Rounding of a tension over the largest; over the arm's length: a jump of a cable's length, and the motion that a sound
/// encoder must show.
const ROUNDING: f64 = 5e-12;
const JUMP: f64 = 0.01 / 2.75;
const STUCK_MOTION: f64 = 0.002 / 2.75;
/// Age of a reading beyond which the encoder is silent (s), and the least in periods.
const SILENT_S: f64 = 0.05;
const SILENT_PERIODS: f64 = 5.0;

/// Reads `[guard]` for an arm and the loop's period (s).
pub(super) fn read(table: &Section<'_>, scale: &Scale, period_s: f64) -> GuardConfig {
    GuardConfig {
        tension_rate_npsmax: table.float_opt("tension_rate_npsmax").unwrap_or(f64::INFINITY),
        box_tolerance_n: table.float_opt("box_tolerance_n").unwrap_or(ROUNDING * scale.tension_n),
        encoder_jump_m: table.float_opt("encoder_jump_m").unwrap_or(JUMP * scale.length_m),
        encoder_stuck_s: table.float("encoder_stuck_s"),
        encoder_stuck_motion_m: table.float_opt("encoder_stuck_motion_m").unwrap_or(STUCK_MOTION * scale.length_m),
        encoder_silent_s: table.float_opt("encoder_silent_s").unwrap_or(SILENT_S.max(SILENT_PERIODS * period_s)),
    }
}
