//! `[planner]`: reading and checking the planner's settings, for the daemon and for scenarios.
//!
//! The two have different defaults for good reason: a scenario reproduces the paper's open loop (hard distance
//! constraint, Newton to convergence, no time budget), the daemon a receding horizon on hardware.

use super::planner::{BarrierConfig, BodyModel, PlannerConfig, SwarmConfig, WarningBranch};
use super::reader::Section;
use super::scale::Scale;
use super::schema::{Key, Kind, Length, Range, TableSpec};

/// Names of the branches in files.
pub(super) const WARNINGS: &[&str] = &["swarm", "seeded", "complementarity", "standard_swarm"];

/// The branch of a name out of [`WARNINGS`].
pub(super) fn warning(name: &str) -> WarningBranch {
    match name {
        "swarm" => WarningBranch::Swarm,
        "complementarity" => WarningBranch::Complementarity,
        "standard_swarm" => WarningBranch::StandardSwarm,
        _ => WarningBranch::Seeded,
    }
}

const LEAD: Kind = Kind::Float(Range::closed(0.0, 10.0));
const POSITIVE_SECONDS: Kind = Kind::Float(Range::above(0.0, 10.0));

const fn shared(newton: &'static str, clearance: &'static str, swarm: &'static TableSpec) -> [Key; 11] {
    [
        Key::optional(
            "lookahead_s",
            POSITIVE_SECONDS,
            "s",
            "0.078 / omega, in two digits or whole periods, at least 5",
            "Lookahead eta: the implicit step that is planned.",
        ),
        Key::default(
            "newton_iterations_max",
            Kind::Integer(1, 1000),
            "",
            newton,
            "Most Newton iterations of the outer loop per step.",
        ),
        Key::default(
            "newton_tolerance",
            Kind::Float(Range::above(0.0, 1.0)),
            "m, 1",
            "1e-8",
            "The outer loop stops when the norm of the coordinates' correction is below this.",
        ),
        Key::default(
            "warning",
            Kind::Choice(WARNINGS),
            "",
            "\"seeded\"",
            "What plans near obstacles: the paper's swarm; the swarm with the complementarity solution among its seeds; that solution alone; the standard swarm for comparison.",
        ),
        Key::default("avoidance", Kind::Bool, "", "true", "`false` plans without regard to obstacles."),
        Key::default(
            "body",
            Kind::Choice(&["arm", "points"]),
            "",
            "\"arm\"",
            "Where distances are measured from: the backbone's whole curve, or the paper's points on it.",
        ),
        Key::optional(
            "clearance_m",
            Kind::Float(Range::closed(0.0, 1.0)),
            "m",
            clearance,
            "d_s as a clearance between surfaces; the paper's d_s is the ball's radius plus this.",
        ),
        Key::optional(
            "warning_distance_m",
            Kind::Float(Range::above(0.0, 1.0)),
            "m",
            "0.0036 L",
            "d_w: margin on top of the clearance inside which the warning branch plans; at least the barrier's activation.",
        ),
        Key::optional(
            "warning_hysteresis_m",
            Kind::Float(Range::closed(0.0, 1.0)),
            "m",
            "0.0018 L",
            "Extra margin that must be regained before the safe branch plans again.",
        ),
        Key::optional(
            "budget_s",
            POSITIVE_SECONDS,
            "s",
            "work counts only (scenario); what the period leaves (daemon)",
            "Time budget of one planning step, from its own beginning: inputs and observer come before it.",
        ),
        Key::optional("swarm", Kind::Table(swarm), "", "its defaults", "The particle swarm."),
    ]
}

const DAEMON: [Key; 11] = shared("2", "0.0018 L", &SWARM);
const SCENARIO: [Key; 11] = shared("30", "0", &SCENARIO_SWARM);

macro_rules! with_shared {
    ($shared:expr, $($key:expr),+ $(,)?) => {
        &[
            $shared[0], $shared[1], $shared[2], $shared[3], $shared[4], $shared[5], $shared[6], $shared[7], $shared[8],
            $shared[9], $shared[10], $($key),+
        ]
    };
}

/// `[planner]` of the daemon.
pub static PLANNER: TableSpec = TableSpec {
    header: "[planner]",
    name: "planner",
    about: "The combined planner, as the daemon runs it: a receding horizon with a barrier. L is the arm's length, omega the first angular frequency of the straight arm. The period is `[loop]`'s.",
    keys: with_shared!(
        DAEMON,
        Key::optional(
            "lead_s",
            LEAD,
            "s",
            "computed from the weights",
            "Lead added to the target's sampling time, against the lag of the rate weights."
        ),
        Key::optional(
            "body_radius_m",
            Kind::Float(Range::closed(0.0, 1.0)),
            "m",
            "the largest disk's radius",
            "The body's radius around the backbone."
        ),
        Key::default(
            "barrier",
            Kind::Bool,
            "",
            "true",
            "Approach obstacles by the discrete barrier `d_next - d_s >= (1 - gamma) (d - d_s)`; `false` leaves the hard constraint, on which the arm bounces."
        ),
        BARRIER_GAMMA,
        BARRIER_ACTIVATION,
    ),
};

/// `[planner]` of a scenario.
pub static SCENARIO_PLANNER: TableSpec = TableSpec {
    header: "[planner] (scenario)",
    name: "planner",
    about: "The combined planner in an open-loop run; the defaults are the paper's setting.",
    keys: with_shared!(
        SCENARIO,
        Key::default("lead_s", LEAD, "s", "0.0", "Lead added to the target's sampling time; the paper has none."),
        Key::optional(
            "period_s",
            POSITIVE_SECONDS,
            "s",
            "the lookahead",
            "Step of the open-loop run: each plan reaches over the lookahead and is carried out for this long by the model, with the weights on changes scaled by lookahead/period. The lookahead must be a whole multiple of it."
        ),
        Key::default(
            "body_radius_m",
            Kind::Float(Range::closed(0.0, 1.0)),
            "m",
            "0.0",
            "The body's radius around the backbone; 0 reproduces the paper."
        ),
        Key::default(
            "barrier",
            Kind::Bool,
            "",
            "false",
            "Approach obstacles by the discrete barrier; `false` is the paper's hard constraint."
        ),
        BARRIER_GAMMA,
        BARRIER_ACTIVATION,
    ),
};

const BARRIER_GAMMA: Key = Key::default(
    "barrier_gamma",
    Kind::Float(Range::above(0.0, 1.0)),
    "",
    "0.3",
    "Share of the remaining distance that one lookahead may use up; 0.2 to 0.3 is smooth, 0.1 infeasible in the tip example.",
);
const BARRIER_ACTIVATION: Key = Key::optional(
    "barrier_activation_m",
    Kind::Float(Range::above(0.0, 10.0)),
    "m",
    "0.0545 L",
    "Surface distance above the clearance from which the barrier acts.",
);

const fn swarm_keys() -> [Key; 11] {
    let pair = Kind::Floats(Length::Exactly(2), Range::closed(0.0, 4.0));
    let particles = Kind::Integer(0, 10_000);
    [
        Key::default("particles_normal", particles, "", "30", "delta_1: particles from N(u_{k-1}, sigma^2)."),
        Key::default("particles_uniform", particles, "", "10", "delta_2: particles from U(u_min, u_max)."),
        Key::optional(
            "sigma_n",
            Kind::Float(Range::above(0.0, 1e4)),
            "N",
            "0.0091 of the largest tension",
            "sigma: the paper gives none; 2 N of 220 N, where tensions change by some 0.1 N to a few N per step in its examples.",
        ),
        Key::default(
            "chaotic_min",
            particles,
            "",
            "2",
            "phi_1: fewest particles moved by the logistic map, when all are feasible.",
        ),
        Key::default(
            "chaotic_max",
            particles,
            "",
            "8",
            "phi_2: most particles moved by the logistic map, when none is feasible; at most the number of particles.",
        ),
        Key::default(
            "inertia",
            pair,
            "",
            "[0.9, 0.4]",
            "Inertia weight of (29) at the first and the last sweep, linear between: the usual schedule of the literature.",
        ),
        Key::default(
            "acceleration",
            pair,
            "",
            "[2.0, 2.0]",
            "Acceleration coefficients of (29) towards a particle's own and the swarm's best position: the original algorithm's.",
        ),
        Key::default("sweeps_max", Kind::Integer(1, 100_000), "", "60", "Most sweeps per call."),
        Key::default(
            "stall_sweeps",
            Kind::Integer(1, 100_000),
            "",
            "15",
            "Sweeps without an improvement that counts, after which it stops.",
        ),
        Key::default(
            "tolerance",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "1e-6",
            "Relative improvement that counts.",
        ),
        Key::default("penalty", Kind::Float(Range::above(0.0, 1e20)), "", "1e12", "Penalty factor nu of (28)."),
    ]
}

const SWARM_KEYS: [Key; 11] = swarm_keys();

static SWARM: TableSpec = TableSpec {
    header: "[planner.swarm]",
    name: "swarm",
    about: "The particle swarm, Algorithm 1, (27)-(36).",
    keys: &SWARM_KEYS,
};

static SCENARIO_SWARM: TableSpec = TableSpec {
    header: "[planner.swarm] (scenario)",
    name: "swarm",
    about: "The particle swarm; the same keys and defaults as the daemon's.",
    keys: &SWARM_KEYS,
};

fn swarm(table: &Section<'_>, scale: &Scale) -> SwarmConfig {
    let config = SwarmConfig {
        particles_normal: table.count("particles_normal"),
        particles_uniform: table.count("particles_uniform"),
        sigma_n: table.float_opt("sigma_n").unwrap_or(SIGMA * scale.tension_n),
        chaotic_min: table.count("chaotic_min"),
        chaotic_max: table.count("chaotic_max"),
        inertia: table.vector("inertia"),
        acceleration: table.vector("acceleration"),
        sweeps_max: table.count("sweeps_max"),
        stall_sweeps: table.count("stall_sweeps"),
        tolerance: table.float("tolerance"),
        penalty: table.float("penalty"),
    };
    let particles = config.particles_normal + config.particles_uniform;
    if particles == 0 {
        table.refuse("particles_uniform", "no particles at all", "permitted: 1 to 10000 where `particles_normal` is 0");
    } else if config.chaotic_max > particles {
        table.refuse("chaotic_max", "more than there are particles", &format!("permitted: 0 to {particles}"));
    }
    if config.chaotic_min > config.chaotic_max {
        table.refuse("chaotic_min", "more than `chaotic_max`", &format!("permitted: 0 to {}", config.chaotic_max));
    }
    config
}

/// Lookahead over the inverse of the first angular frequency: 0.1 s on the paper's arm.
const LOOKAHEAD: f64 = 0.0784;
/// Lengths over the arm's, and what they are on the paper's of 2.75 m: clearance in closed loop, margin of the warning
/// subspace, its hysteresis, reach of the barrier.
const CLEARANCE: f64 = 0.005 / 2.75;
const WARNING: f64 = 0.01 / 2.75;
const HYSTERESIS: f64 = 0.005 / 2.75;
const ACTIVATION: f64 = 0.15 / 2.75;
/// Spread of the swarm's normal particles over the largest tension: 2 N of 220 N.
const SIGMA: f64 = 2.0 / 220.0;

/// Least periods of a lookahead: a loop that plans for the next tick alone takes in it all of what an obstacle asks for, and
/// jerks.
const PERIODS_MIN: f64 = 5.0;

/// Lookahead (s) of an arm, in two digits, as far as nothing else is said.
pub(super) fn lookahead_s(scale: &Scale) -> f64 {
    let exact = scale.time_s(LOOKAHEAD);
    let digits = 1 - exact.log10().floor() as i32;
    if digits >= 0 { (exact * 10f64.powi(digits)).round() / 10f64.powi(digits) } else { exact.round() }
}

/// Reads a planner's table for an arm. `given_s` is its lookahead where the file gives one, `period_s` the loop's, `None` in
/// a scenario; `disk_radius_m` the largest of the arm.
pub(super) fn read(
    table: &Section<'_>,
    given_s: Option<f64>,
    period_s: Option<f64>,
    scale: &Scale,
    disk_radius_m: f64,
) -> PlannerConfig {
    let daemon = period_s.is_some();
    let lookahead_s = given_s.unwrap_or_else(|| {
        let natural = lookahead_s(scale);
        period_s.map_or(natural, |period| period * (natural / period).round().max(PERIODS_MIN))
    });
    let period_key = if period_s.is_some() { "lookahead_s" } else { "period_s" };
    let period_s = period_s.unwrap_or_else(|| table.float_opt("period_s").unwrap_or(lookahead_s));
    if !is_whole_multiple(lookahead_s, period_s) && lookahead_s.is_finite() && period_s.is_finite() {
        let message = format!("lookahead {lookahead_s} s is no whole multiple of the period {period_s} s");
        table.refuse(period_key, message, "permitted: lookahead = period times 1, 2, 3, ... up to 1000");
    }
    let body_radius_m = table.float_opt("body_radius_m").unwrap_or(disk_radius_m);
    let activation_m = table.float_opt("barrier_activation_m");
    let barrier = if table.boolean("barrier") {
        Some(BarrierConfig {
            gamma: table.float("barrier_gamma"),
            activation_m: activation_m.unwrap_or(ACTIVATION * scale.length_m),
        })
    } else {
        None
    };
    let warning_distance_m = table.float_opt("warning_distance_m").unwrap_or(WARNING * scale.length_m);
    let clearance = if daemon { CLEARANCE * scale.length_m } else { 0.0 };
    PlannerConfig {
        lookahead_s,
        period_s,
        newton_iterations_max: table.count("newton_iterations_max"),
        newton_tolerance: table.float("newton_tolerance"),
        warning: warning(table.choice("warning")),
        avoidance: table.boolean("avoidance"),
        body: if table.choice("body") == "points" { BodyModel::Points } else { BodyModel::Arm },
        body_radius_m,
        clearance_m: table.float_opt("clearance_m").unwrap_or(clearance),
        warning_distance_m,
        warning_hysteresis_m: table.float_opt("warning_hysteresis_m").unwrap_or(HYSTERESIS * scale.length_m),
        barrier,
        swarm: swarm(&table.table("swarm"), scale),
        budget_s: table.float_opt("budget_s"),
        lead_s: table.float_opt("lead_s"),
    }
}

/// True if `whole / part` is 1 to 1000 within 1e-6.
fn is_whole_multiple(whole: f64, part: f64) -> bool {
    let ratio = whole / part;
    (0.5..1000.5).contains(&ratio) && (ratio - ratio.round()).abs() <= 1e-6
}
