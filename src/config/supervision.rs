//! `[supervision]`: what the arm is watched for while it moves and holds, and what is done about it.

use super::arm::ArmConfig;
use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// What is done about something that is not as it should be; each includes those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SupervisionAnswer {
    /// It is said: a limit in the record, an alarm, a line of the log.
    Warn,
    /// The reference moves at a quarter of its pace as well.
    Slow,
    /// The arm leaves its target and holds.
    Hold,
    /// A fault: the arm stops.
    Stop,
}

impl SupervisionAnswer {
    const NAMES: [&'static str; 4] = ["warn", "slow", "hold", "stop"];

    fn read(table: &Section<'_>, key: &'static str) -> Self {
        match table.choice(key) {
            "warn" => Self::Warn,
            "slow" => Self::Slow,
            "hold" => Self::Hold,
            _ => Self::Stop,
        }
    }
}

/// Limits of what is watched, and the answers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SupervisionConfig {
    /// Speed of the tip (m/s), and the answer to more.
    pub tip_speed_mps: f64,
    /// As named.
    pub tip_speed_answer: SupervisionAnswer,
    /// Rate of a segment's bend angle (rad/s), and the answer to more.
    pub bend_rate_radps: f64,
    /// As named.
    pub bend_rate_answer: SupervisionAnswer,
    /// Time for which speed or rate must be exceeded (s).
    pub motion_time_s: f64,
    /// Swing of the tip, peak to peak (m), and the answer to more.
    pub swing_m: f64,
    /// As named.
    pub swing_answer: SupervisionAnswer,
    /// Time for which a tension may stay at its upper limit (s), and the answer to more.
    pub saturation_s: f64,
    /// As named.
    pub saturation_answer: SupervisionAnswer,
    /// Difference of a tension measured by its drive and the one commanded (N), for longer than the time.
    pub tension_error_n: f64,
    /// Time for which it may be exceeded (s).
    pub tension_error_s: f64,
    /// The answer to more.
    pub tension_error_answer: SupervisionAnswer,
    /// Difference of a cable's length and what the other cables of its segment say (m).
    pub length_error_m: f64,
    /// By how much a cable may pull more than commanded, or be told more than it pulls, as a share, by what the arm does.
    pub pull_error: f64,
    /// The answer to a cable whose drive shows or pulls another amount than it says.
    pub cable_answer: SupervisionAnswer,
}

impl SupervisionConfig {
    /// The same limits, none of which is answered by more than a word.
    #[must_use]
    pub fn warning(self) -> Self {
        let warn = SupervisionAnswer::Warn;
        Self {
            tip_speed_answer: warn,
            bend_rate_answer: warn,
            swing_answer: warn,
            saturation_answer: warn,
            tension_error_answer: warn,
            cable_answer: warn,
            ..self
        }
    }
}

/// Defaults: a speed over length and first angular frequency, a rate over that frequency, lengths over the arm's, a tension
/// over the range of tensions.
const TIP_SPEED: f64 = 0.319;
const BEND_RATE: f64 = 3.83;
const SWING: f64 = 0.0085;
const LENGTH_ERROR: f64 = 3e-4;
const TENSION_ERROR: f64 = 0.05;

const LENGTH: Kind = Kind::Float(Range::above(0.0, 100.0));
const TIME: Kind = Kind::Float(Range::above(0.0, 600.0));
const ANSWER: Kind = Kind::Choice(&SupervisionAnswer::NAMES);

/// `[supervision]`.
pub static SUPERVISION: TableSpec = TableSpec {
    header: "[supervision]",
    name: "supervision",
    about: "What the arm is watched for while it holds or moves. Each has a limit and an answer: \"warn\" says it (record, alarm, log), \"slow\" also lets the reference move at a quarter of its pace, \"hold\" leaves the target, \"stop\" is a fault. L is the arm's length, omega the first angular frequency of the straight arm.",
    keys: &[
        Key::optional(
            "tip_speed_mps",
            LENGTH,
            "m/s",
            "0.319 L omega",
            "Speed of the tip; the reference has `governor.speed_mps`, evasion and swinging come on top.",
        ),
        Key::default("tip_speed_answer", ANSWER, "", "\"stop\"", "The answer to more."),
        Key::optional(
            "bend_rate_radps",
            Kind::Float(Range::above(0.0, 1e3)),
            "rad/s",
            "3.83 omega",
            "Rate of a segment's bend angle.",
        ),
        Key::default("bend_rate_answer", ANSWER, "", "\"stop\"", "The answer to more."),
        Key::default("motion_time_s", TIME, "s", "0.05", "Time for which speed or rate must be exceeded."),
        Key::optional(
            "swing_m",
            LENGTH,
            "m",
            "0.0085 L",
            "Swing of the tip beside its motion that there may be, peak to peak; the estimate shows at least a fourth of one that lasts.",
        ),
        Key::default("swing_answer", ANSWER, "", "\"warn\"", "The answer to more."),
        Key::default(
            "saturation_s",
            TIME,
            "s",
            "5.0",
            "Time for which a tension may stay at `tension_n_max` while the arm holds or moves.",
        ),
        Key::default("saturation_answer", ANSWER, "", "\"warn\"", "The answer to more."),
        Key::optional(
            "tension_error_n",
            Kind::Float(Range::above(0.0, 1e6)),
            "N",
            "0.05 of the range of tensions, and the step on the wire",
            "Difference of the tension that a drive measures (6077) and the one commanded.",
        ),
        Key::default("tension_error_s", TIME, "s", "0.1", "Time for which it may be exceeded; at least two periods."),
        Key::default("tension_error_answer", ANSWER, "", "\"stop\"", "The answer to more."),
        Key::optional(
            "length_error_m",
            LENGTH,
            "m",
            "0.0003 L",
            "Difference of a cable's length and what the other cables of its segment say: counts, gear, drum, sign, a cable that slips. More than its stretch under `tension_n_max`.",
        ),
        Key::default(
            "pull_error",
            Kind::Float(Range::above(0.0, 10.0)),
            "",
            "0.5",
            "Share by which a cable may pull more than it is told, or be told more than it pulls, by what the arm does: rated torque, gear, drum, sign.",
        ),
        Key::default(
            "cable_answer",
            ANSWER,
            "",
            "\"stop\"",
            "The answer to a cable whose drive shows or pulls another amount than it says.",
        ),
    ],
};

/// Reads `[supervision]` for an arm, a period of the loop (s) and the coarsest step of a tension on the wire (N).
pub(super) fn read(table: &Section<'_>, arm: &ArmConfig, period_s: f64, step_n: f64) -> SupervisionConfig {
    let scale = Scale::of(arm);
    let length_m = scale.length_m;
    let range_n = arm.tension_n_max - arm.tension_n_min;
    let config = SupervisionConfig {
        tip_speed_mps: table.float_opt("tip_speed_mps").unwrap_or(TIP_SPEED * length_m * scale.omega_radps),
        tip_speed_answer: SupervisionAnswer::read(table, "tip_speed_answer"),
        bend_rate_radps: table.float_opt("bend_rate_radps").unwrap_or(BEND_RATE * scale.omega_radps),
        bend_rate_answer: SupervisionAnswer::read(table, "bend_rate_answer"),
        motion_time_s: table.float("motion_time_s"),
        swing_m: table.float_opt("swing_m").unwrap_or(SWING * length_m),
        swing_answer: SupervisionAnswer::read(table, "swing_answer"),
        saturation_s: table.float("saturation_s"),
        saturation_answer: SupervisionAnswer::read(table, "saturation_answer"),
        tension_error_n: table.float_opt("tension_error_n").unwrap_or(TENSION_ERROR * range_n + step_n),
        tension_error_s: table.float("tension_error_s"),
        tension_error_answer: SupervisionAnswer::read(table, "tension_error_answer"),
        length_error_m: table.float_opt("length_error_m").unwrap_or(LENGTH_ERROR * length_m),
        pull_error: table.float("pull_error"),
        cable_answer: SupervisionAnswer::read(table, "cable_answer"),
    };
    if config.tension_error_s < 2.0 * period_s {
        let help = format!("permitted: {} s (two periods of the loop) to 600 s", 2.0 * period_s);
        table.refuse("tension_error_s", "shorter than two periods of the loop", &help);
    }
    config
}
