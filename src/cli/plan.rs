//! `sinew plan`.

use super::record::PlanRecording;
use super::{Outcome, complain, print_json, print_text, progress_bar};
use clap::{Args, ValueEnum};
use miette::{IntoDiagnostic, WrapErr, bail, miette};
use sinew::config::{BodyModel, ScenarioConfig, WarningBranch};
use sinew::recording::RecordingError;
use sinew::report::{figures_table, summary_table};
use sinew::scenario::{Run, RunError, sweep, sweep_table};
use std::path::PathBuf;
use std::time::Instant;

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Branch {
    /// The paper's particle swarm alone.
    Swarm,
    /// The swarm with the complementarity solution among its seeds.
    Seeded,
    /// The extended complementarity problem alone.
    Complementarity,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Body {
    /// The paper's potential collision points.
    Points,
    /// The whole arm.
    Arm,
}

/// Arguments of `sinew plan`.
#[derive(Debug, Args)]
pub(crate) struct Plan {
    /// Name of a built-in scenario (tip, tip-no-avoidance, shape, shape-no-avoidance, penalty-sweep, swarm-comparison) or a
    /// scenario file.
    scenario: String,
    /// What plans near obstacles; default: the scenario's.
    #[arg(long)]
    warning: Option<Branch>,
    /// What distances are measured from; default: the scenario's.
    #[arg(long)]
    body: Option<Body>,
    /// Seed of the swarm; default: the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// Print one JSON object and nothing else to standard output.
    #[arg(long)]
    json: bool,
    /// Write the whole time series as an MCAP recording.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl Plan {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let mut scenario = ScenarioConfig::find(&self.scenario)?;
        if let Some(warning) = self.warning {
            scenario.planner.warning = match warning {
                Branch::Swarm => WarningBranch::Swarm,
                Branch::Seeded => WarningBranch::Seeded,
                Branch::Complementarity => WarningBranch::Complementarity,
            };
        }
        if let Some(body) = self.body {
            scenario.planner.body = match body {
                Body::Points => BodyModel::Points,
                Body::Arm => BodyModel::Arm,
            };
        }
        if self.warning.is_some() && !scenario.planner.avoidance {
            bail!("--warning has no effect: {} avoids nothing", scenario.name);
        }
        let seed = self.seed.unwrap_or(scenario.seed);
        if scenario.sweep.is_empty() { self.single(&scenario, seed) } else { self.all(&scenario, seed) }
    }

    fn single(&self, scenario: &ScenarioConfig, seed: u64) -> miette::Result<Outcome> {
        let mut run = Run::new(scenario, seed).into_diagnostic().wrap_err_with(|| self.scenario.clone())?;
        let mut collector = run.collector();
        let mut recording =
            self.out.as_deref().map(|path| PlanRecording::create(path, &run)).transpose().map_err(unrecorded)?;
        let bar = progress_bar(run.total(), &scenario.name);
        let begin = Instant::now();
        let mut clock = || begin.elapsed().as_nanos() as u64;
        let mut failed = None;
        while run.steps() < run.total() {
            match run.step(&mut clock) {
                Ok(step) => {
                    run.collect(&step, &mut collector);
                    if let Some(recording) = &mut recording {
                        recording.write(&run, &step).map_err(unrecorded)?;
                    }
                }
                Err(error) => {
                    collector.add_fault(error.to_string());
                    failed = Some(error);
                    break;
                }
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        failed.iter().for_each(|error| complain(ended(&self.scenario, error)));
        if let Some(recording) = recording {
            recording.finish().map_err(unrecorded)?;
        }
        let (period_s, lookahead_s) = (scenario.planner.period_s, scenario.planner.lookahead_s);
        let summary = collector.summary(&scenario.name, seed, period_s, lookahead_s, false);
        if self.json {
            print_json(&summary)?;
        } else {
            print_text(&format!("{}\n{}\n", summary_table(&summary), figures_table(&scenario.figures, &summary)))?;
        }
        let planner = &scenario.planner;
        let contact = planner.avoidance && collector.contact(planner.body, contact_tolerance(planner.warning));
        Ok(if failed.is_some() || contact { Outcome::Failed } else { Outcome::Done })
    }

    fn all(&self, scenario: &ScenarioConfig, seed: u64) -> miette::Result<Outcome> {
        if self.out.is_some() {
            bail!("--out records one run; {} has {} variations", scenario.name, scenario.sweep.len());
        }
        if self.warning.is_some() && scenario.sweep.iter().any(|variation| variation.warning.is_some()) {
            bail!("--warning has no effect: the variations of {} say what plans near obstacles", scenario.name);
        }
        let bar = progress_bar(0, &scenario.name);
        let begin = Instant::now();
        let swept = sweep(scenario, seed, &mut || begin.elapsed().as_nanos() as u64, &mut |index, step, steps| {
            bar.set_length(steps * scenario.sweep.len() as u64);
            bar.set_position(index as u64 * steps + step);
        });
        bar.finish_and_clear();
        let rows = match swept {
            Err(error @ RunError::Diverged(_)) => {
                complain(ended(&self.scenario, &error));
                return Ok(Outcome::Failed);
            }
            rows => rows.into_diagnostic().wrap_err_with(|| self.scenario.clone())?,
        };
        if self.json {
            print_json(&serde_json::json!({ "scenario": scenario.name, "seed": seed, "runs": rows }))?;
        } else {
            let mut text = format!("{}\n", sweep_table(&rows));
            for f in &scenario.figures {
                text.push_str(&format!("{}: paper: {}; reference: {}\n", f.quantity, f.paper, f.reference));
            }
            print_text(&text)?;
        }
        Ok(Outcome::Done)
    }
}

/// Which scenario ended early, and why.
fn ended(scenario: &str, error: &RunError) -> String {
    format!("sinew plan: {scenario}: {error}")
}

/// In a line: the error names its cause itself.
fn unrecorded(error: RecordingError) -> miette::Report {
    miette!("--out: {error}")
}

/// How deep a plan may lie inside an obstacle before it is a contact (m): the solver's tolerance, or the softness of the
/// penalty where nothing but the swarm keeps the distance.
fn contact_tolerance(warning: WarningBranch) -> f64 {
    match warning {
        WarningBranch::Seeded | WarningBranch::Complementarity => 1e-6,
        WarningBranch::Swarm | WarningBranch::StandardSwarm => 0.5e-3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_that_diverged_is_told_with_its_file() {
        let text = ended("my/scenario.toml", &RunError::Diverged(1.5));
        assert_eq!(text, "sinew plan: my/scenario.toml: the motion diverged at 1.5 s");
    }
}
