//! `[observer]`: the state estimate from cable lengths (design, section 6).

use super::arm::ArmConfig;
use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Range, TableSpec};
use serde::Serialize;

/// Settings of the observer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObserverConfig {
    /// Spring K of the correction as a multiple of EI/L.
    pub stiffness_ratio: f64,
    /// Damper over spring, D/K (s).
    pub damping_s: f64,
    /// Time constant tau_f of the Maxwell damper (s).
    pub filter_time_s: f64,
    /// Time constant T_b of the disturbance estimate (s).
    pub disturbance_time_s: f64,
    /// Damping of the observer's model over the arm's.
    pub model_damping_ratio: f64,
    /// Spectral radius of the observer's integrator.
    pub rho_inf: f64,
    /// The estimate has settled when every entry of z is below this (rad) ...
    pub settle_innovation_rad: f64,
    /// ... and every bend angle's rate below this (rad/s) ...
    pub settle_rate_radps: f64,
    /// ... for this long (s).
    pub settle_time_s: f64,
    /// Time after which an estimate that has not settled is a fault (s).
    pub settle_timeout_s: f64,
    /// |z| beyond this is a fault (rad).
    pub innovation_bound_rad: f64,
    /// |z| growing by this within `innovation_window_s` is a fault (rad).
    pub innovation_growth_rad: f64,
    /// Window of the growth test (s).
    pub innovation_window_s: f64,
    /// Ticks from a measurement until the tensions answering it act beyond the ordinary one-tick cycle;
    /// compensated by model steps with the tensions already sent.
    pub latency_ticks: usize,
    /// Standard deviation of a measured bend angle as a share of it, and of the bend to the side of it.
    pub scale_sigma: f64,
    /// As named.
    pub side_sigma: f64,
    /// Standard deviation of a measured bend angle that does not depend on it (rad).
    pub bend_sigma_rad: f64,
    /// Standard deviation of the tip's position by swinging, over the swing that there may be (peak to peak).
    pub swing_sigma: f64,
    /// Standard deviations of the estimated position by which obstacles are kept away beside the clearance.
    pub margin_sigmas: f64,
}

/// `[observer]`.
pub static OBSERVER: TableSpec = TableSpec {
    header: "[observer]",
    name: "observer",
    about: "The state estimate from cable lengths. `z` are the bend angles that model and measurement differ by, two per segment; omega is the first angular frequency of the straight arm.",
    keys: &[
        Key::default(
            "stiffness_ratio",
            Kind::Float(Range::above(0.0, 10.0)),
            "EI/L",
            "1.75",
            "Spring K of the correction; 1 to 3 matches the arm's impedance, much more leaves torsion undamped.",
        ),
        Key::optional(
            "damping_s",
            Kind::Float(Range::above(0.0, 1e3)),
            "s",
            "1.57 / omega",
            "Damper over spring, D/K.",
        ),
        Key::optional(
            "filter_time_s",
            Kind::Float(Range::above(0.0, 100.0)),
            "s",
            "0.078 / omega",
            "Time constant of the Maxwell damper, in place of measured rates.",
        ),
        Key::optional(
            "disturbance_time_s",
            Kind::Float(Range::above(0.0, 1e3)),
            "s",
            "0.78 / omega",
            "Time constant of the disturbance estimate; much faster keeps a bent arm swinging.",
        ),
        Key::optional(
            "model_damping_ratio",
            Kind::Float(Range::closed(1.0, 100.0)),
            "",
            "5 % damping of the first mode, 1 to 5",
            "Damping of the observer's model over the arm's: cables do not see torsion, and an error of it would swing on.",
        ),
        Key::default(
            "rho_inf",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "0.0",
            "Spectral radius of the observer's integrator: encoder steps excite the highest modes, which it has to forget.",
        ),
        Key::default(
            "settle_innovation_rad",
            Kind::Float(Range::above(0.0, 1.0)),
            "rad",
            "0.01",
            "The estimate has settled when every entry of z is below this ...",
        ),
        Key::optional(
            "settle_rate_radps",
            Kind::Float(Range::above(0.0, 10.0)),
            "rad/s",
            "0.0128 omega",
            "... and every bend angle's rate below this ...",
        ),
        Key::optional(
            "settle_time_s",
            Kind::Float(Range::closed(0.0, 60.0)),
            "s",
            "0.39 / omega, 0.1 to 5 s",
            "... for this long.",
        ),
        Key::optional(
            "settle_timeout_s",
            Kind::Float(Range::above(0.0, 600.0)),
            "s",
            "0.31 of the first mode's decay time, 20 to 600 s",
            "Time after which an estimate that has not settled is a fault; longer than `settle_time_s`.",
        ),
        Key::default(
            "innovation_bound_rad",
            Kind::Float(Range::above(0.0, 3.0)),
            "rad",
            "0.3",
            "An entry of z beyond this is a fault: encoder, broken or slack cable.",
        ),
        Key::default(
            "innovation_growth_rad",
            Kind::Float(Range::above(0.0, 3.0)),
            "rad",
            "0.15",
            "An entry of z growing by this within the window is a fault.",
        ),
        Key::default(
            "innovation_window_s",
            Kind::Float(Range::above(0.0, 10.0)),
            "s",
            "0.1",
            "Window of the growth test.",
        ),
        Key::default(
            "latency_ticks",
            Kind::Integer(0, 20),
            "ticks",
            "0",
            "Ticks between a measurement and the effect of its answer beyond the ordinary cycle; compensated by model steps.",
        ),
        Key::default(
            "scale_sigma",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "0.002",
            "Standard deviation of a measured bend as a share of it: disks, holes, drums. What the estimate may be off, `sinew status` shows, and obstacles are kept away for.",
        ),
        Key::default(
            "side_sigma",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "0.001",
            "... of the bend to the side, as a share of the bend: torsion turns the plane that a segment bends in.",
        ),
        Key::default(
            "bend_sigma_rad",
            Kind::Float(Range::closed(0.0, 1.0)),
            "rad",
            "5e-4",
            "... that does not depend on the bend: encoder steps, play of the cables in their holes.",
        ),
        Key::default(
            "swing_sigma",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "0.1",
            "... of the tip's position by swinging, over the swing that there may be, peak to peak.",
        ),
        Key::default(
            "margin_sigmas",
            Kind::Float(Range::closed(0.0, 10.0)),
            "",
            "3.0",
            "So many standard deviations of the estimated position are kept from obstacles beside `planner.clearance_m`.",
        ),
    ],
};

/// Times over the inverse of the first angular frequency: damper over spring, its filter, the disturbance's estimate,
/// settling; and the rate at which it has settled, over the frequency.
const DAMPING: f64 = 1.57;
const FILTER: f64 = 0.078;
const DISTURBANCE: f64 = 0.78;
const SETTLE: f64 = 0.39;
const SETTLE_S: (f64, f64) = (0.1, 5.0);
const SETTLE_RATE: f64 = 0.0128;
/// Damping ratio of the first mode in the observer's model, and the range of its damping over the arm's.
const MODEL_DAMPING: f64 = 0.049;
const MODEL_DAMPING_RATIO: (f64, f64) = (1.0, 5.0);
/// Time-out of settling over the decay time of the first mode, and its range (s).
const TIMEOUT: f64 = 0.31;
const TIMEOUT_S: (f64, f64) = (20.0, 600.0);

/// Rate (1/s) at which the first mode decays, to which all segments contribute.
fn first_decay(arm: &ArmConfig, scale: &Scale) -> f64 {
    let beta = arm.segments.iter().map(|s| s.damping_stiffness_s * s.length_m).sum::<f64>() / scale.length_m;
    0.5 * (beta * scale.omega_radps * scale.omega_radps + arm.damping_mass_1ps)
}

impl ObserverConfig {
    /// `model_damping_ratio` of an arm whose configuration has none: what gives the first mode 5 % of critical damping, and
    /// no more than five times the arm's: with ten, an arm that has a 25th of the damping that its file says diverges.
    pub fn default_model_damping_ratio(arm: &ArmConfig) -> f64 {
        model_damping_ratio(arm, &Scale::of(arm))
    }
}

fn model_damping_ratio(arm: &ArmConfig, scale: &Scale) -> f64 {
    clamp(MODEL_DAMPING * scale.omega_radps / first_decay(arm, scale), MODEL_DAMPING_RATIO)
}

fn clamp(x: f64, (low, high): (f64, f64)) -> f64 {
    x.clamp(low, high)
}

/// Reads `[observer]` for an arm.
pub(super) fn read(table: &Section<'_>, arm: &ArmConfig, scale: &Scale) -> ObserverConfig {
    let decay = first_decay(arm, scale);
    let config = ObserverConfig {
        stiffness_ratio: table.float("stiffness_ratio"),
        damping_s: table.float_opt("damping_s").unwrap_or(scale.time_s(DAMPING)),
        filter_time_s: table.float_opt("filter_time_s").unwrap_or(scale.time_s(FILTER)),
        disturbance_time_s: table.float_opt("disturbance_time_s").unwrap_or(scale.time_s(DISTURBANCE)),
        model_damping_ratio: table.float_opt("model_damping_ratio").unwrap_or_else(|| model_damping_ratio(arm, scale)),
        rho_inf: table.float("rho_inf"),
        settle_innovation_rad: table.float("settle_innovation_rad"),
        settle_rate_radps: table.float_opt("settle_rate_radps").unwrap_or(SETTLE_RATE * scale.omega_radps),
        settle_time_s: table.float_opt("settle_time_s").unwrap_or(clamp(scale.time_s(SETTLE), SETTLE_S)),
        settle_timeout_s: table.float_opt("settle_timeout_s").unwrap_or(clamp(TIMEOUT / decay, TIMEOUT_S)),
        innovation_bound_rad: table.float("innovation_bound_rad"),
        innovation_growth_rad: table.float("innovation_growth_rad"),
        innovation_window_s: table.float("innovation_window_s"),
        latency_ticks: table.count("latency_ticks"),
        scale_sigma: table.float("scale_sigma"),
        side_sigma: table.float("side_sigma"),
        bend_sigma_rad: table.float("bend_sigma_rad"),
        swing_sigma: table.float("swing_sigma"),
        margin_sigmas: table.float("margin_sigmas"),
    };
    if config.settle_timeout_s <= config.settle_time_s {
        let help = format!("permitted: > {} s (`settle_time_s`) and <= 600 s", config.settle_time_s);
        table.refuse("settle_timeout_s", "not longer than `settle_time_s`", &help);
    }
    config
}
