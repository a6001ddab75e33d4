//! `sinew stability`.

use super::{Outcome, arm_info, complain, print_json, print_text, progress_bar};
use clap::Args;
use comfy_table::Table;
use miette::miette;
use nalgebra::{Vector3, Vector4};
use serde::Serialize;
use sinew::config::{ArmConfig, Config};
use sinew::stability::{
    Differs, Held, LoopMode, Margin, Margins, Place, Spectrum, StabilityError, margins, random_posture,
};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Arguments of `sinew stability`.
#[derive(Debug, Args)]
pub(crate) struct Stability {
    /// File with the table `[arm]`, or an arm of the library: rao-2021, ...; everything else is computed from it.
    #[arg(long, value_name = "ARM", conflicts_with = "config")]
    arm: Option<String>,
    /// Configuration files; without them those of the demonstrations.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    config: Vec<PathBuf>,
    /// Pose of the tip that is held: position (m) and quaternion. May be given again.
    #[arg(long, value_name = "X,Y,Z,QW,QX,QY,QZ", allow_hyphen_values = true, value_parser = numbers)]
    pose: Vec<Numbers>,
    /// Mean curvatures (1/m) that are held, (y, z) segment by segment. May be given again.
    #[arg(long, value_name = "KY,KZ,...", allow_hyphen_values = true, value_parser = numbers)]
    shape: Vec<Numbers>,
    /// At rest, and at so many random poses.
    #[arg(long, value_name = "N", default_value_t = 0)]
    poses: u64,
    /// Seed of the first random pose.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Period of the loop (s), in place of the configured one.
    #[arg(long, value_name = "S", value_parser = super::positive_seconds)]
    period: Option<f64>,
    /// Damping beta (s) of the arm and of its model, in place of the file's.
    #[arg(long, value_name = "S", value_parser = super::positive_seconds)]
    beta: Option<f64>,
    /// Damping of the true arm over the model's.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = factor)]
    damping: f64,
    /// Stiffness of the true arm over the model's.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = factor)]
    stiffness: f64,
    /// Tension at the cables over the commanded one.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = factor)]
    tension: f64,
    /// Ticks by which tensions come later than configured.
    #[arg(long, value_name = "TICKS", default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=100))]
    delay: u16,
    /// Look for margins, too: how far tension, damping, stiffness and delay may be off. A minute for each place.
    #[arg(long)]
    margins: bool,
    /// One JSON object in place of tables.
    #[arg(long)]
    json: bool,
}

type Numbers = Vec<f64>;

fn numbers(text: &str) -> Result<Numbers, String> {
    let number = |word: &str| match word.trim().parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        _ => Err(format!("`{word}` is not a number")),
    };
    text.split(',').map(number).collect()
}

fn factor(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if (0.001..=1000.0).contains(&x) => Ok(x),
        _ => Err("expected a factor from 0.001 to 1000".to_owned()),
    }
}

/// What a place showed.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Shown {
    /// In words.
    pub(super) place: String,
    /// Whether no mode grows; null where it could not be told.
    pub(super) stable: Option<bool>,
    /// Why it could not.
    pub(super) error: Option<String>,
    pub(super) modulus: Option<f64>,
    pub(super) growth_1ps: Option<f64>,
    pub(super) growth_limit_1ps: Option<f64>,
    pub(super) modes: Vec<LoopMode>,
    pub(super) margins: Option<Margins>,
}

#[derive(Debug, Serialize)]
struct Report<'a> {
    arm: &'a str,
    period_s: f64,
    damping: f64,
    stiffness: f64,
    tension: f64,
    delay_ticks: usize,
    stable: bool,
    places: &'a [Shown],
}

impl Stability {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let config = self.configuration()?;
        let places = self.places(&config)?;
        let differs = Differs {
            damping: self.damping,
            stiffness: self.stiffness,
            pull: self.tension,
            late_ticks: self.delay.into(),
        };
        let shown = look(&config, &places, &differs, self.margins);
        let stable = shown.iter().all(|s| s.stable == Some(true));
        if self.json {
            print_json(&Report {
                arm: &config.arm.name,
                period_s: config.timing.period_s,
                damping: self.damping,
                stiffness: self.stiffness,
                tension: self.tension,
                delay_ticks: self.delay.into(),
                stable,
                places: &shown,
            })?;
        } else {
            print_text(&text(&config, &shown))?;
        }
        for (place, error) in shown.iter().filter_map(|s| s.error.as_ref().map(|error| (&s.place, error))) {
            complain(format_args!("sinew stability: {place}: {error}"));
        }
        Ok(if shown.iter().any(|s| s.error.is_some()) {
            Outcome::Unusable
        } else if stable {
            Outcome::Done
        } else {
            Outcome::Failed
        })
    }

    fn configuration(&self) -> miette::Result<Config> {
        let change = |arm: &mut ArmConfig| {
            if let Some(beta) = self.beta {
                arm.segments.iter_mut().for_each(|s| s.damping_stiffness_s = beta);
            }
        };
        let mut config = match &self.arm {
            Some(name) => {
                let mut arm = arm_info::find(name)?;
                change(&mut arm);
                Config::of_arm(&arm, self.period)?
            }
            None => Config::load_changed(&self.config, change)?,
        };
        if let Some(period_s) = self.period {
            (config.timing.period_s, config.planner.period_s) = (period_s, period_s);
        }
        Ok(config)
    }

    fn places(&self, config: &Config) -> miette::Result<Vec<(String, Place)>> {
        let mut places = Vec::new();
        if self.poses > 0 || (self.pose.is_empty() && self.shape.is_empty()) {
            places.push(("at rest".to_owned(), Place::Rest));
        }
        for pose in &self.pose {
            let [x, y, z, w, a, b, c] = pose[..] else {
                return Err(miette!("--pose takes 7 numbers, position and quaternion, not {}", pose.len()));
            };
            let quaternion = Vector4::new(w, a, b, c);
            if quaternion.norm() < 1e-6 {
                return Err(miette!("--pose {x},{y},{z},...: the quaternion has no direction"));
            }
            let place =
                Place::Pose { position: Vector3::new(x, y, z), quaternion: quaternion.normalize(), curvatures: None };
            places.push((format!("tip at ({x}, {y}, {z})"), place));
        }
        for shape in &self.shape {
            let words: Vec<String> = shape.iter().map(f64::to_string).collect();
            places.push((format!("shape ({})", words.join(", ")), Place::Shape(shape.clone())));
        }
        places.extend(random_places(config, self.seed, self.poses));
        Ok(places)
    }
}

/// So many random poses from a seed on.
pub(super) fn random_places(config: &Config, seed: u64, count: u64) -> Vec<(String, Place)> {
    let place = |seed: u64| {
        let (curvatures, (position, quaternion)) = random_posture(config, seed);
        let [x, y, z] = position.into();
        let words = format!("pose {seed}, tip at ({x:.3}, {y:.3}, {z:.3})");
        (words, Place::Pose { position, quaternion, curvatures: Some(curvatures) })
    };
    (seed..seed + count).map(place).collect()
}

/// Looks at every place, as many at once as there are processors; a bar on a terminal's standard error.
pub(super) fn look(config: &Config, places: &[(String, Place)], differs: &Differs, with_margins: bool) -> Vec<Shown> {
    let bar = progress_bar(places.len() as u64, "places");
    let (next, shown) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let jobs = std::thread::available_parallelism().map_or(1, usize::from).min(places.len());
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some((words, place)) = places.get(index) else { break };
                    let one = look_at(config, words, place, differs, with_margins, &bar);
                    bar.inc(1);
                    shown.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((index, one));
                }
            });
        }
    });
    bar.finish_and_clear();
    let mut shown = shown.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    shown.sort_by_key(|(index, _)| *index);
    shown.into_iter().map(|(_, one)| one).collect()
}

fn look_at(
    config: &Config,
    words: &str,
    place: &Place,
    differs: &Differs,
    with_margins: bool,
    bar: &indicatif::ProgressBar,
) -> Shown {
    let mut shown = Shown {
        place: words.to_owned(),
        stable: None,
        error: None,
        modulus: None,
        growth_1ps: None,
        growth_limit_1ps: None,
        modes: Vec::new(),
        margins: None,
    };
    let mut told = || -> Result<(), StabilityError> {
        let held = Held::at(config, place)?.with(differs)?;
        let spectrum = Spectrum::of(config, &held)?;
        shown.stable = Some(spectrum.is_stable());
        shown.modulus = Some(spectrum.modulus());
        shown.growth_1ps = Some(spectrum.growth_1ps());
        shown.growth_limit_1ps = Some(spectrum.limit_1ps);
        if with_margins && spectrum.is_stable() {
            shown.margins = Some(margins(config, &held, &mut || bar.tick())?);
        }
        shown.modes = spectrum.modes;
        Ok(())
    };
    if let Err(error) = told() {
        shown.error = Some(error.to_string());
    }
    shown
}

fn text(config: &Config, shown: &[Shown]) -> String {
    let mut out = format!("{}, period {} s\n", config.arm.name, config.timing.period_s);
    for one in shown {
        let verdict = match (one.stable, one.growth_1ps) {
            (Some(true), Some(growth)) => format!("stable, slowest mode {growth:.3} 1/s"),
            (Some(false), Some(growth)) => format!("NOT STABLE, grows by {growth:.3} 1/s"),
            _ => "not known".to_owned(),
        };
        let modulus = one.modulus.map_or(String::new(), |m| format!(", largest modulus {m:.6}"));
        out += &format!("\n{}: {verdict}{modulus}\n", one.place);
        if !one.modes.is_empty() {
            let mut table = Table::new();
            table.load_style(comfy_table::presets::NOTHING);
            table.add_row(["  Hz", "damping", "1/s", "what moves"]);
            for mode in &one.modes {
                table.add_row([
                    format!("  {:.3}", mode.frequency_hz),
                    if mode.frequency_hz > 0.0 {
                        format!("{:.1} %", 100.0 * mode.damping_ratio)
                    } else {
                        "-".to_owned()
                    },
                    format!("{:.3}", mode.growth_1ps),
                    mode.in_words(),
                ]);
            }
            out += &format!("{}\n", table.trim_fmt());
        }
        if let Some(margins) = &one.margins {
            for line in margins_in_words(margins) {
                out += &format!("  margin: {line}\n");
            }
        }
    }
    out
}

/// Margins, a line each.
pub(super) fn margins_in_words(margins: &Margins) -> Vec<String> {
    let one = |name: &str, m: &Margin| {
        let side = |bound: Option<f64>, good: f64| match bound {
            Some(bad) => format!("{good:.2} (not at {bad:.2})"),
            None => format!("{good:.2} and beyond"),
        };
        let (least, greatest) = (side(m.unstable_below, m.least), side(m.unstable_above, m.greatest));
        format!("true {name} from {least} to {greatest} times the model's")
    };
    let ticks = margins.delay_ticks;
    let beyond = margins.unstable_delay_ticks.map_or("and beyond".to_owned(), |bad| format!("(not at {bad})"));
    vec![
        one("tension", &margins.tension),
        one("damping", &margins.damping),
        one("stiffness", &margins.stiffness),
        format!("tensions up to {ticks} ticks later than configured {beyond}: {:.1} ms", 1e3 * margins.delay_s),
    ]
}
