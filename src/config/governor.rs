//! `[governor]`: how fast the arm may be moved by targets, however they are given, and how it gives way.

use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// What becomes of a tip target that the arm does not reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OutOfReach {
    /// The nearest pose is approached.
    Approach,
    /// The arm holds where it is.
    Refuse,
}

/// Limits of the reference that the arm follows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GovernorConfig {
    /// Speed of any joint between segments and of the tip (m/s) on the way to a target.
    pub speed_mps: f64,
    /// Their acceleration on the way to a target that stepped (m/s^2).
    pub acceleration_mps2: f64,
    /// Rate of a segment's bend angle (rad/s).
    pub bend_rate_radps: f64,
    /// Turning of the tip (rad/s).
    pub turn_rate_radps: f64,
    /// Speed with which any point of the arm gives way to an obstacle (m/s).
    pub evasion_mps: f64,
    /// Acceleration with which it does (m/s^2).
    pub evasion_mps2: f64,
    /// Share of the distance to an obstacle, above the clearance, that may be used up per second (1/s).
    pub approach_1ps: f64,
    /// A pose counts as reached within this (m).
    pub reach_m: f64,
    /// What becomes of a tip target that is not reached.
    pub out_of_reach: OutOfReach,
    /// An attitude error of 1 rad counts as a position error of this (m).
    pub attitude_length_m: f64,
    /// Rate at which swinging is answered (1/s); 0 for not at all.
    pub swing_damping_1ps: f64,
}

/// Defaults over the arm's length and the first angular frequency omega: speed and acceleration (L omega, L omega^2), rates
/// of bends (omega); and what a quick arm is not moved faster than, for whoever stands beside it (L/s, L/s^2, rad/s).
const SPEED: (f64, f64) = (0.051, 0.15);
const ACCELERATION: (f64, f64) = (0.0293, 0.3);
const BEND_RATE: (f64, f64) = (0.383, 1.2);
const EVASION: (f64, f64) = (0.255, 1.0);
const EVASION_ACCELERATION: (f64, f64) = (0.814, 5.0);
/// Share of the distance to an obstacle per time, and of the swing that is answered, over the frequency.
const APPROACH: (f64, f64) = (0.638, 1.0);
const SWING: f64 = 1.28;
/// Reach and attitude's length over the arm's.
const REACH: f64 = 0.004;
const ATTITUDE: f64 = 0.11;

const LENGTH: Kind = Kind::Float(Range::above(0.0, 100.0));
const RATE: Kind = Kind::Float(Range::above(0.0, 100.0));

/// `[governor]`.
pub static GOVERNOR: TableSpec = TableSpec {
    header: "[governor]",
    name: "governor",
    about: "What stands between a target and the arm: no target, however given, moves the arm faster than this. L is the arm's length, omega the first angular frequency of the straight arm. A step of the target becomes a smooth path in the arm's bends; where the way is blocked the arm waits.",
    keys: &[
        Key::optional(
            "speed_mps",
            RATE,
            "m/s",
            "0.051 L omega, at most 0.15 L per second",
            "Speed of the tip, and of the joints between segments.",
        ),
        Key::optional(
            "acceleration_mps2",
            RATE,
            "m/s^2",
            "0.0293 L omega^2, at most 0.3 L per second squared",
            "Their acceleration on the way to a target that stepped.",
        ),
        Key::optional("bend_rate_radps", RATE, "rad/s", "0.383 omega, at most 1.2", "Rate of a segment's bend angle."),
        Key::optional("turn_rate_radps", RATE, "rad/s", "0.383 omega, at most 1.2", "Turning of the tip."),
        Key::optional(
            "evasion_mps",
            RATE,
            "m/s",
            "0.255 L omega, at most L per second",
            "Speed of any point of the arm while it gives way to an obstacle that comes nearer. One that comes faster is met.",
        ),
        Key::optional(
            "evasion_mps2",
            RATE,
            "m/s^2",
            "0.814 L omega^2, at most 5 L per second squared",
            "Acceleration of any point of the arm while it gives way to an obstacle.",
        ),
        Key::optional(
            "approach_1ps",
            RATE,
            "1/s",
            "0.638 omega, at most 1",
            "Share of the distance to an obstacle, above the clearance, that may be used up per second.",
        ),
        Key::optional(
            "reach_m",
            LENGTH,
            "m",
            "0.004 L",
            "A target whose position the arm misses by more is out of reach, and `status` says by how much; an attitude error of 1 rad counts as a third of `attitude_length_m`.",
        ),
        Key::default(
            "out_of_reach",
            Kind::Choice(&["approach", "refuse"]),
            "",
            "\"approach\"",
            "What becomes of a tip target out of reach. `approach`: the arm goes to the nearest pose; `refuse`: it holds where it is, until it is told to track again.",
        ),
        Key::optional(
            "attitude_length_m",
            LENGTH,
            "m",
            "0.11 L",
            "An attitude error of 1 rad counts as a position error of this, where both cannot be had.",
        ),
        Key::optional(
            "swing_damping_1ps",
            Kind::Float(Range::closed(0.0, 100.0)),
            "1/s",
            "1.28 omega",
            "Rate at which swinging that the cables do not show directly (torsion, bending inside a segment) is answered; 0 leaves it to the material.",
        ),
    ],
};

/// Reads `[governor]` for an arm.
pub(super) fn read(table: &Section<'_>, scale: &Scale) -> GovernorConfig {
    let (length_m, omega) = (scale.length_m, scale.omega_radps);
    let pace = |(share, most): (f64, f64)| (share * omega).min(most);
    GovernorConfig {
        speed_mps: table.float_opt("speed_mps").unwrap_or(pace(SPEED) * length_m),
        acceleration_mps2: table
            .float_opt("acceleration_mps2")
            .unwrap_or((ACCELERATION.0 * omega * omega).min(ACCELERATION.1) * length_m),
        bend_rate_radps: table.float_opt("bend_rate_radps").unwrap_or(pace(BEND_RATE)),
        turn_rate_radps: table.float_opt("turn_rate_radps").unwrap_or(pace(BEND_RATE)),
        evasion_mps: table.float_opt("evasion_mps").unwrap_or(pace(EVASION) * length_m),
        evasion_mps2: table
            .float_opt("evasion_mps2")
            .unwrap_or((EVASION_ACCELERATION.0 * omega * omega).min(EVASION_ACCELERATION.1) * length_m),
        approach_1ps: table.float_opt("approach_1ps").unwrap_or(pace(APPROACH)),
        out_of_reach: if table.choice("out_of_reach") == "refuse" { OutOfReach::Refuse } else { OutOfReach::Approach },
        reach_m: table.float_opt("reach_m").unwrap_or(REACH * length_m),
        attitude_length_m: table.float_opt("attitude_length_m").unwrap_or(ATTITUDE * length_m),
        swing_damping_1ps: table.float_opt("swing_damping_1ps").unwrap_or(SWING * omega),
    }
}
