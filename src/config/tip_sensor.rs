//! `[tip_sensor]`: what is believed of a measured tip, where something measures it.

use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// How a measured position of the tip is used.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TipSensorConfig {
    /// Time constant (s) with which what the estimate is off by is taken over.
    pub time_s: f64,
    /// Farthest that the estimate may be off (m); what is measured beyond it is not believed.
    pub error_m: f64,
    /// A measurement that is older (s) is none.
    pub stale_after_s: f64,
}

/// Time constant over `1 / omega_1`: 10 s on the paper's arm, slow against the torsion of a bent arm (0.18 Hz).
const TIME: f64 = 7.84;
/// Farthest that the estimate may be off, over the arm's length: 55 mm on the paper's arm.
const ERROR: f64 = 0.02;

/// `[tip_sensor]`.
pub static TIP_SENSOR: TableSpec = TableSpec {
    header: "[tip_sensor]",
    name: "tip_sensor",
    about: "A measured position of the tip (camera, electromagnetic tracker, laser tracker), where a client publishes one on `sinew/<arm>/tip`. Without one nothing changes. What lasts of its difference from the estimate is taken off the tip targets, and the swing that is supervised is the measured one.",
    keys: &[
        Key::optional(
            "time_s",
            Kind::Float(Range::closed(0.01, 600.0)),
            "s",
            "7.84 / omega1",
            "Time constant with which the difference of measured and estimated tip is taken over.",
        ),
        Key::optional(
            "error_m",
            Kind::Float(Range::closed(1e-6, 10.0)),
            "m",
            "0.02 L",
            "Farthest that the estimated tip may be off. A measurement farther away is not used, and said.",
        ),
        Key::default(
            "stale_after_s",
            Kind::Float(Range::closed(0.001, 10.0)),
            "s",
            "0.2",
            "A measurement older than this is none.",
        ),
    ],
};

/// Reads `[tip_sensor]` for an arm.
pub(super) fn read(table: &Section<'_>, scale: &Scale) -> TipSensorConfig {
    let usual = TipSensorConfig::of(scale);
    TipSensorConfig {
        time_s: table.float_opt("time_s").unwrap_or(usual.time_s),
        error_m: table.float_opt("error_m").unwrap_or(usual.error_m),
        stale_after_s: table.float("stale_after_s"),
    }
}

impl TipSensorConfig {
    /// The defaults of an arm.
    pub fn of(scale: &Scale) -> Self {
        Self { time_s: scale.time_s(TIME), error_m: ERROR * scale.length_m, stale_after_s: 0.2 }
    }
}
