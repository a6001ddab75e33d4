//! A scenario once per variation: penalty factors (figure 4), swarms and their sizes (figure 16).

use super::run::{Run, RunError};
use crate::config::{ScenarioConfig, SweepRun, WarningBranch};
use crate::planner::Planner;
use crate::report::Summary;
use serde::Serialize;

/// One variation's outcome.
#[derive(Debug, Clone, Serialize)]
pub struct SweepRow {
    /// Its label.
    pub label: String,
    /// The run, or the window of it that was varied.
    #[serde(flatten)]
    pub summary: Summary,
    /// Cost (15a) over that of the exact local optimum from the same state, mean of the steps in the window.
    pub cost_ratio_mean: Option<f64>,
    /// The same, largest.
    pub cost_ratio_max: Option<f64>,
}

/// Runs all variations. `progress` hears of every step: variation, step, steps of it.
///
/// Where a variation has a window, the complementarity branch plans outside it, so that all variations enter the
/// window in the same state; the statistics are of the window alone.
///
/// # Errors
/// As [`Run::new`] and [`Run::step`].
pub fn sweep(
    scenario: &ScenarioConfig,
    seed: u64,
    clock: &mut dyn FnMut() -> u64,
    progress: &mut dyn FnMut(usize, u64, u64),
) -> Result<Vec<SweepRow>, RunError> {
    let mut rows = Vec::with_capacity(scenario.sweep.len());
    for (index, variation) in scenario.sweep.iter().enumerate() {
        let varied = vary(scenario, variation);
        let own_branch = varied.planner.warning;
        let mut run = Run::new(&varied, seed)?;
        let mut exact_config = run.planner().config().clone();
        exact_config.warning = WarningBranch::Complementarity;
        let (tension, change) = run.course().tension_weights()?;
        let mut exact = Planner::new(&varied.arm, &exact_config, tension, &change);
        let mut collector = run.collector();
        let (mut ratio_sum, mut ratio_max, mut judged) = (0.0, 0.0f64, 0u64);
        for k in 1..=run.total() {
            let t = k as f64 * varied.planner.period_s;
            // Half a step of slack: window ends are multiples of the step only up to rounding.
            let slack = 0.5 * varied.planner.period_s;
            let inside = variation.window_s.is_none_or(|[from, to]| t > from - slack && t < to + slack);
            run.set_warning(if inside { own_branch } else { WarningBranch::Complementarity });
            let optimum = (inside && variation.window_s.is_some()).then(|| run.probe(&mut exact).cost);
            let step = run.step(clock)?;
            if inside {
                run.collect(&step, &mut collector);
                if let Some(optimum) = optimum {
                    let ratio = step.report.cost / optimum;
                    ratio_sum += ratio;
                    ratio_max = ratio_max.max(ratio);
                    judged += 1;
                }
            }
            progress(index, k, run.total());
        }
        let planner = &varied.planner;
        rows.push(SweepRow {
            label: variation.label.clone(),
            summary: collector.summary(&varied.name, seed, planner.period_s, planner.lookahead_s, false),
            cost_ratio_mean: (judged > 0).then(|| ratio_sum / judged as f64),
            cost_ratio_max: (judged > 0).then_some(ratio_max),
        });
    }
    Ok(rows)
}

fn vary(scenario: &ScenarioConfig, variation: &SweepRun) -> ScenarioConfig {
    let mut varied = scenario.clone();
    let planner = &mut varied.planner;
    if let Some(penalty) = variation.penalty {
        planner.swarm.penalty = penalty;
    }
    if let Some(particles) = variation.particles {
        // The scenario's shares of normal and uniform particles are kept.
        let all = planner.swarm.particles_normal + planner.swarm.particles_uniform;
        let normal = (particles * planner.swarm.particles_normal + all / 2) / all.max(1);
        planner.swarm.particles_normal = normal;
        planner.swarm.particles_uniform = particles - normal;
        planner.swarm.chaotic_max = planner.swarm.chaotic_max.min(particles);
        planner.swarm.chaotic_min = planner.swarm.chaotic_min.min(planner.swarm.chaotic_max);
    }
    if let Some(warning) = variation.warning {
        planner.warning = warning;
    }
    varied
}

/// The variations side by side.
pub fn sweep_table(rows: &[SweepRow]) -> String {
    let mut table = crate::report::plain_table(&[
        "variation",
        "Newton mean",
        "Newton max",
        "not converged",
        "cost / optimum, mean",
        "largest",
        "least distance at the points",
        "along the arm",
        "evaluations per second",
    ]);
    for row in rows {
        let s = &row.summary;
        let newton = s.newton.warning;
        let least = |f: &dyn Fn(&crate::report::ObstacleSummary) -> f64| {
            let d = s.obstacles.iter().map(f).fold(f64::INFINITY, f64::min);
            if d.is_finite() { format!("{:.3} mm", 1e3 * d) } else { "-".into() }
        };
        let ratio = |x: Option<f64>| x.map_or("-".into(), |x| format!("{x:.4}"));
        table.add_row([
            row.label.clone(),
            newton.map_or("-".into(), |n| format!("{:.1}", n.mean)),
            newton.map_or("-".into(), |n| n.max.to_string()),
            s.not_converged.map_or("-".into(), |n| n.to_string()),
            ratio(row.cost_ratio_mean),
            ratio(row.cost_ratio_max),
            least(&|o| o.points.surface_distance_min_m),
            least(&|o| o.surface_distance_min_m),
            s.swarm.and_then(|w| w.evaluations_per_s).map_or("-".into(), |rate| format!("{:.2} million", rate / 1e6)),
        ]);
    }
    table.to_string()
}
