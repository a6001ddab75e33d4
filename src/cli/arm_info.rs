//! `sinew arm-info`.

use super::{Outcome, complain, print_text};
use clap::Args;
use comfy_table::Table;
use miette::miette;
use sinew::config::{ARMS, ArmConfig, Config, Routing, Scale};
use sinew::control::{Settings, doubts, weights_in_words};
use sinew::integrator::{Mode, Stepper, equilibrium, modes};
use sinew::model::{Arm, State};
use std::path::Path;

/// Modes shown.
const MODES: usize = 10;

/// Arguments of `sinew arm-info`.
#[derive(Debug, Args)]
pub(crate) struct ArmInfo {
    /// File with the table `[arm]`, or an arm of the library: rao-2021, ...
    arm: String,
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

        let mut table = Table::new();
        table.load_style(comfy_table::presets::NOTHING);
        let mut row = |label: &str, value: String| {
            table.add_row([label, &value]);
        };
        let routing = if arm.routing == Routing::Local { "local" } else { "through" };
        row(
            "arm",
            format!(
                "{}, {} segments, {} nodes, {:.4} m",
                arm.name,
                arm.segments.len(),
                arm.node_count(),
                scale.length_m
            ),
        );
        row(
            "cables",
            format!("{}, routed {routing}, {} to {} N", arm.cable_count(), arm.tension_n_min, arm.tension_n_max),
        );
        row("mass that moves", format!("{:.4} kg", model.nodes.iter().map(|node| node.mass).sum::<f64>()));
        if rests {
            let sag = (model.tip(&state.q, &state.qd).position - straight).norm();
            row(
                "sag of the tip at rest",
                format!("{:.1} mm, {:.1} % of the length", 1e3 * sag, 100.0 * sag / scale.length_m),
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
        let found = modes(&model, &state, &least).unwrap_or_default();
        for (index, mode) in found.iter().take(MODES).enumerate() {
            row(&format!("mode {}", index + 1), in_words(mode));
        }
        for line in config.computed() {
            table.add_row([line.label, line.value]);
        }
        let settings = Settings::new(&config);
        for (key, value) in weights_in_words(&settings) {
            table.add_row([key, &value]);
        }
        print_text(&format!("{}\n", table.trim_fmt()))?;
        let falls = found.first().is_some_and(|mode| mode.square < 0.0).then(|| {
            "the arm does not stand by itself: at rest under the least tensions it falls to a side (mode 1); start it from a bent \
             equilibrium"
                .to_owned()
        });
        for warning in config.warnings().into_iter().chain(doubts(&settings)).chain(falls) {
            complain(format_args!("sinew arm-info: warning: {warning}"));
        }
        Ok(Outcome::Done)
    }
}

fn find(name: &str) -> miette::Result<ArmConfig> {
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
    let kind = if mode.torsion > 0.5 { "torsion" } else { "bending" };
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
