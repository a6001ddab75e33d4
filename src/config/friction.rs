//! `[friction]`: friction of the cables along their route, as far as the controller makes up for it.

use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// What the controller knows of its cables' friction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrictionConfig {
    /// Capstan coefficient mu of `exp(-mu angle)`; 0 for no compensation.
    pub coefficient: f64,
    /// Planned rate of a cable (m/s) at which three quarters of the friction is made up for.
    pub speed_mps: f64,
    /// Time constant with which the compensation follows a reversal (s).
    pub time_s: f64,
}

impl FrictionConfig {
    /// No compensation.
    pub const NONE: Self = Self { coefficient: 0.0, speed_mps: 3e-3, time_s: 0.05 };
}

/// `[friction]`.
pub static FRICTION: TableSpec = TableSpec {
    header: "[friction]",
    name: "friction",
    about: "Friction of the cables along their route (capstan): a cable's tension falls by `exp(-coefficient angle)` over the bend that it has passed where it is pulled in, and rises so where it pays out. Commands are divided by that factor's mean along the route.",
    keys: &[
        Key::default(
            "coefficient",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "0.0",
            "Friction coefficient mu; 0 for no compensation. Too much of it makes the arm hunt, too little is made up for by the observer.",
        ),
        Key::optional(
            "speed_mps",
            Kind::Float(Range::closed(1e-7, 1.0)),
            "m/s",
            "0.0011 L per second",
            "Planned rate of a cable at which three quarters of the friction is made up for.",
        ),
        Key::default(
            "time_s",
            Kind::Float(Range::closed(0.0, 10.0)),
            "s",
            "0.05",
            "Time constant with which the compensation follows a reversal.",
        ),
    ],
};

/// Planned rate of a cable at which most of the friction is made up for, over the arm's length (1/s).
const SPEED_1PS: f64 = 0.003 / 2.75;

/// Reads `[friction]` for an arm.
pub(super) fn read(table: &Section<'_>, scale: &Scale) -> FrictionConfig {
    FrictionConfig {
        coefficient: table.float("coefficient"),
        speed_mps: table.float_opt("speed_mps").unwrap_or(SPEED_1PS * scale.length_m),
        time_s: table.float("time_s"),
    }
}
