//! `sinew arm-info`.

mod picture;

use super::stability::{Shown, look, margins_in_words, random_places};
use super::{Outcome, complain, print_text};
use clap::Args;
use comfy_table::Table;
use miette::miette;
use sinew::config::{ARMS, ArmConfig, Config, DriveConfig, Routing, Scale};
use sinew::control::{Settings, doubts, weights_in_words};
use sinew::daemon;
use sinew::estimator::CableSpace;
use sinew::integrator::{Mode, Stepper, equilibrium, modes};
use sinew::model::{Arm, State};
use sinew::posture::RestingArm;
use sinew::report::{force_at_tip, slice, tip_per_newton};
use sinew::stability::{Differs, Place};
use std::path::{Path, PathBuf};

/// Modes shown.
const MODES: usize = 10;
/// Random poses at which the closed loop is looked at.
const POSES: u64 = 10;
/// Step of a cable's length, over the arm's, that the observer was measured with.
const ENCODER_STEP: f64 = 1e-5;

/// Arguments of `sinew arm-info`.
#[derive(Debug, Args)]
pub(crate) struct ArmInfo {
    /// File with the table `[arm]`, or an arm of the library: rao-2021, ...
    arm: String,
    /// Draw the arm, and where its tip reaches, to this file (.svg), or to one of the arm's name in this folder.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Look at the closed loop, too, at rest and at ten random poses, with margins: some minutes.
    #[arg(long)]
    margins: bool,
}

impl ArmInfo {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let arm = find(&self.arm)?;
        let config = Config::of_arm(&arm, None)?;
        let model = Arm::new(&arm);
        let least = vec![arm.tension_n_min; arm.cable_count()];
        let mut stepper = Stepper::new(&model);
        let mut state = State::at_rest(model.straight());
        let rests = equilibrium(&model, &mut stepper, &least, &mut state).is_ok();
        let straight = model.tip(&model.straight(), &state.qd).position;
        let scale = Scale::of(&arm);

        let length_m = scale.length_m;
        let mut table = Table::new();
        table.load_style(comfy_table::presets::NOTHING);
        let mut row = |label: &str, value: String| {
            table.add_row([label, &value]);
        };
        let routing = if arm.routing == Routing::Local { "local" } else { "through" };
        let (segments, nodes) = (arm.segments.len(), arm.node_count());
        row("arm", format!("{}, {segments} segments, {nodes} nodes, {length_m:.4} m", arm.name));
        row(
            "cables",
            format!("{}, routed {routing}, {} to {} N", arm.cable_count(), arm.tension_n_min, arm.tension_n_max),
        );
        row("mass that moves", format!("{:.4} kg", model.nodes.iter().map(|node| node.mass).sum::<f64>()));
        if rests {
            let sag = (model.tip(&state.q, &state.qd).position - straight).norm();
            row(
                "sag of the tip at rest",
                format!("{:.1} mm, {:.1} % of the length", 1e3 * sag, 100.0 * sag / length_m),
            );
        } else {
            row("sag of the tip at rest", "no equilibrium was found under the least tensions".to_owned());
        }
        for (segment, bend) in most_bends(&arm).into_iter().enumerate() {
            row(
                &format!("segment {}", segment + 1),
                format!("bends by {:.0} degrees at most, by one cable alone", bend.to_degrees()),
            );
        }
        let reach = slice(&arm);
        row(
            "reach in a plane",
            format!(
                "{:.3} m to either side, {:.3} m from the straight arm's tip",
                reach.across_m, reach.from_straight_m
            ),
        );
        let (force_n, weakest) = force_at_tip(&arm);
        let weak = weakest + 1;
        row("force across the straight tip", format!("{force_n:.2} N at most; segment {weak} gives way first"));
        row(
            "speed of the tip",
            format!(
                "{:.3} m/s on a way, {:.3} m/s from what comes nearer; let go from its farthest bend about {:.1} m/s",
                config.governor.speed_mps,
                config.governor.evasion_mps,
                scale.omega_radps * reach.from_straight_m
            ),
        );
        let sensitivity = tip_per_newton(&model, &state, &least);
        if let Some(moved) = &sensitivity {
            let words: Vec<String> = moved.iter().map(|m| format!("{:.3}", 1e3 * m)).collect();
            row("tip moved by 1 N of a cable", format!("{} mm, segment by segment", words.join(", ")));
        }
        let encoders = Encoders::of(&arm, &model, &config);
        row("encoders", encoders.in_words(length_m));
        let found = modes(&model, &state, &least).unwrap_or_default();
        for (index, mode) in found.iter().take(MODES).enumerate() {
            row(&format!("mode {}", index + 1), in_words(mode));
        }
        row(
            "suggested",
            format!(
                "period {} ms, lookahead {} ms",
                three_digits(1e3 * config.timing.period_s),
                three_digits(1e3 * config.planner.lookahead_s)
            ),
        );
        let loads = daemon::bus_loads(&config);
        for load in &loads {
            row(
                &format!("load of one classic bus {}", load.name),
                format!(
                    "{:.1} % with worst-case stuffing, at most {:.0} %; shortest period {:.2} ms",
                    100.0 * load.share,
                    100.0 * load.limit,
                    1e3 * load.period_s_min
                ),
            );
        }
        for line in config.computed() {
            table.add_row([line.label, line.value]);
        }
        let settings = Settings::new(&config);
        for (key, value) in weights_in_words(&settings) {
            table.add_row([key, &value]);
        }
        print_text(&format!("{}\n", table.trim_fmt()))?;
        let mut warnings: Vec<String> = config.warnings();
        warnings.extend(doubts(&settings));
        if found.first().is_some_and(|mode| mode.square < 0.0) {
            warnings.push(
                "the arm does not stand by itself: at rest under the least tensions it falls to a side (mode 1); start it from \
                 a bent equilibrium"
                    .to_owned(),
            );
        }
        warnings.extend(overloaded(&arm, &model));
        warnings.extend(encoders.warning(length_m));
        for load in loads.iter().filter(|load| load.share > load.limit) {
            warnings.push(format!(
                "the bus is loaded to {:.0} %, more than {:.0} %: take more buses, CAN FD, or loop.period_s = {}",
                100.0 * load.share,
                100.0 * load.limit,
                three_digits(load.period_s_min)
            ));
        }
        if let Some(path) = &self.svg {
            let file = picture::file(path, &arm.name);
            picture::draw(&file, &arm, &model, rests.then_some(&state), &reach)?;
            print_text(&format!("picture  {}\n", file.display()))?;
        }
        if self.margins {
            warnings.extend(closed_loop(&config)?);
        }
        for warning in warnings {
            complain(format_args!("sinew arm-info: warning: {warning}"));
        }
        Ok(Outcome::Done)
    }
}

/// What encoders show of the arm.
struct Encoders {
    /// Coarsest step of a cable's length (m).
    step_m: f64,
    /// What the steps leave of the tip, root mean square (m).
    tip_m: f64,
}

impl Encoders {
    fn of(arm: &ArmConfig, model: &Arm, config: &Config) -> Self {
        let step_m = config.drives.drives.iter().map(DriveConfig::length_per_count_m).fold(0.0, f64::max);
        let space = CableSpace::new(model);
        // A length is off by up to half a step, evenly: its variance, through the bend angles, at the tip's lever.
        let variance = step_m * step_m / 12.0;
        let mut behind_m = 0.0;
        let mut square = 0.0;
        for (s, segment) in arm.segments.iter().enumerate().rev() {
            let lever_m = behind_m + 0.5 * segment.length_m;
            for angle in [2 * s, 2 * s + 1] {
                let gain: f64 = (0..model.cable_count()).map(|c| space.row(c)[angle].powi(2)).sum();
                square += variance * gain * lever_m * lever_m;
            }
            behind_m += segment.length_m + if s > 0 { arm.segments[s - 1].connector_length_m } else { 0.0 };
        }
        Self { step_m, tip_m: square.sqrt() }
    }

    fn in_words(&self, length_m: f64) -> String {
        format!(
            "a count of a simulated drive is {} um of cable, which leaves {} um of the tip; the observer wants at most {} um of \
             cable",
            three_digits(1e6 * self.step_m),
            three_digits(1e6 * self.tip_m),
            three_digits(1e6 * ENCODER_STEP * length_m)
        )
    }

    fn warning(&self, length_m: f64) -> Option<String> {
        let factor = self.step_m / (ENCODER_STEP * length_m);
        (factor > 1.0).then(|| {
            format!(
                "an encoder's count is {factor:.1} times what the observer wants: take drives.defaults.counts_per_turn or \
                 gear_ratio {factor:.1} times as large, or smaller drums"
            )
        })
    }
}

/// Segments whose cables do not hold the straight arm up.
fn overloaded(arm: &ArmConfig, model: &Arm) -> Vec<String> {
    let least = vec![arm.tension_n_min; arm.cable_count()];
    let mut rest = RestingArm::new(model);
    let straight = vec![0.0; 2 * arm.segments.len()];
    let mut norm = f64::NAN;
    for _ in 0..10 {
        if rest.linearize(&least).is_err() {
            return Vec::new();
        }
        norm = rest.advance(&straight);
    }
    if norm.is_nan() || norm > 1e-6 * arm.length_m() || rest.linearize(&least).is_err() {
        return Vec::new();
    }
    let mut scratch = straight;
    let segments = arm.segments.iter().enumerate();
    segments
        .filter_map(|(s, segment)| {
            let range_n = arm.segment_tension_n_max(segment) - arm.tension_n_min;
            let load = rest.load_into(s, range_n, &mut scratch);
            (load > 1.0).then(|| {
                format!(
                    "segment {}: its cables cannot hold the straight arm up, which takes {load:.1} times what they give: \
                     tension_n_max = {:.0} N would",
                    s + 1,
                    arm.tension_n_min + load * range_n
                )
            })
        })
        .collect()
}

/// The closed loop at rest and at random poses; what is wrong with it.
fn closed_loop(config: &Config) -> miette::Result<Vec<String>> {
    let mut places = vec![("at rest".to_owned(), Place::Rest)];
    places.extend(random_places(config, 1, POSES));
    let shown = look(config, &places, &Differs::NONE, true);
    let mut out = String::from("\nclosed loop\n");
    let mut warnings = Vec::new();
    for one in &shown {
        let Shown { place, stable, growth_1ps, margins, modes, error, .. } = one;
        let growth = growth_1ps.unwrap_or(f64::NAN);
        match (stable, error) {
            (Some(true), None) => out += &format!("{place}: stable, slowest mode {growth:.3} 1/s\n"),
            (Some(_), None) => {
                out += &format!("{place}: NOT STABLE, grows by {growth:.3} 1/s\n");
                let mode =
                    modes.first().map_or(String::new(), |m| format!("{:.3} Hz, {}", m.frequency_hz, m.in_words()));
                warnings.push(format!(
                    "{place}: the closed loop is not stable ({mode}); `sinew stability` tells more; a larger \
                     weights.tip.change_ratio or observer.disturbance_time_s may do"
                ));
            }
            (_, error) => {
                let why = error.clone().unwrap_or_default();
                out += &format!("{place}: {why}\n");
                warnings.push(format!("{place}: {why}"));
            }
        }
        for line in margins.iter().flat_map(margins_in_words) {
            out += &format!("  {line}\n");
        }
    }
    print_text(&out)?;
    Ok(warnings)
}

/// A number in three digits.
fn three_digits(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return x.to_string();
    }
    let digits = (2 - x.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{x:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

pub(super) fn find(name: &str) -> miette::Result<ArmConfig> {
    if Path::new(name).is_file() {
        return Ok(ArmConfig::load(Path::new(name))?);
    }
    let arms = || ARMS.iter().filter_map(|(file, text)| file.strip_suffix("/arm.toml").map(|arm| (arm, text)));
    match arms().find(|(arm, _)| *arm == name) {
        Some((arm, text)) => Ok(ArmConfig::parse(&format!("config/arms/{arm}/arm.toml (built in)"), text)?),
        None => Err(miette!(
            help = format!("arms of the library: {}", arms().map(|(arm, _)| arm).collect::<Vec<_>>().join(", ")),
            "no arm {name}: neither a file of this path nor one of the library"
        )),
    }
}

/// Bend angle (rad) of each segment under the largest tension of one cable, as a beam of constant curvature.
fn most_bends(arm: &ArmConfig) -> Vec<f64> {
    let bend = |s: &sinew::config::SegmentConfig| {
        (arm.segment_tension_n_max(s) - arm.tension_n_min) * s.hole_radius_m * s.length_m / s.bending_stiffness_nm2
    };
    arm.segments.iter().map(bend).collect()
}

fn in_words(mode: &Mode) -> String {
    let kind = match (mode.torsion > 0.5, mode.resting_points) {
        (true, 0) => "torsion".to_owned(),
        (false, 0) => "bending to one side".to_owned(),
        (false, 1) => "bending like an S".to_owned(),
        (true, points) => format!("torsion with {points} resting points"),
        (false, points) => format!("bending with {points} resting points"),
    };
    if mode.square < 0.0 {
        return format!("not stable: grows by a factor of e in {:.3} s, {kind}", 1.0 / (-mode.square).sqrt());
    }
    let [x, y, z] = <[f64; 3]>::from(mode.tip);
    let omega = mode.omega_radps();
    format!(
        "{:.3} Hz, {:.1} % of critical damping, {kind} ({:.0} % twist), tip along ({x:.2}, {y:.2}, {z:.2})",
        omega / std::f64::consts::TAU,
        100.0 * mode.damping_ratio,
        100.0 * mode.torsion
    )
}
