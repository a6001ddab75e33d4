//! A scenario planned in open loop, as `sinew plan` does.

use super::design;
use super::motion::{Shown, table};
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sinew::config::WarningBranch;
use sinew::planner::{Branch, Status};
use sinew::scenario::{Run, RunError};
use std::time::Instant;

/// Steps between two looks at the signals of Python.
const STEPS_BETWEEN_LOOKS: u64 = 16;

fn warning_branch(name: &str) -> PyResult<WarningBranch> {
    match name {
        "swarm" => Ok(WarningBranch::Swarm),
        "seeded" => Ok(WarningBranch::Seeded),
        "complementarity" => Ok(WarningBranch::Complementarity),
        _ => Err(PyValueError::new_err(format!("warning: `{name}`, expected swarm, seeded or complementarity"))),
    }
}

#[derive(Default)]
struct Columns {
    times: Vec<f64>,
    tensions: Vec<f64>,
    distances: Vec<f64>,
    costs: Vec<f64>,
    plan: Vec<f64>,
    iterations: Vec<u64>,
    converged: Vec<bool>,
    near: Vec<bool>,
}

/// Plans a scenario from its beginning to `steps`, or to its end. A row for each step; where the motion diverged, those
/// before, and why.
#[pyfunction]
#[pyo3(signature = (name, text, seed, warning, steps))]
pub(crate) fn plan<'py>(
    py: Python<'py>,
    name: &str,
    text: &str,
    seed: Option<u64>,
    warning: Option<&str>,
    steps: Option<u64>,
) -> PyResult<Bound<'py, PyDict>> {
    let mut scenario = design::scenario(name, text)?;
    if !scenario.sweep.is_empty() {
        let count = scenario.sweep.len();
        return Err(PyValueError::new_err(format!(
            "scenario {name} is a series of {count} variations, plan one of them"
        )));
    }
    if let Some(warning) = warning {
        scenario.planner.warning = warning_branch(warning)?;
    }
    let seed = seed.unwrap_or(scenario.seed);
    let (run, columns, shown, diverged) = py.detach(|| {
        let mut run = Run::new(&scenario, seed).map_err(|e| PyValueError::new_err(format!("{name}: {e}")))?;
        let total = steps.map_or(run.total(), |steps| steps.min(run.total()));
        let begin = Instant::now();
        let mut clock = || begin.elapsed().as_nanos() as u64;
        let (mut columns, mut shown, mut diverged) = (Columns::default(), Shown::new(&run.planner().arm), None);
        while run.steps() < total {
            let step = match run.step(&mut clock) {
                Ok(step) => step,
                Err(error @ RunError::Diverged(_)) => {
                    diverged = Some(error.to_string());
                    break;
                }
                Err(error) => return Err(PyValueError::new_err(error.to_string())),
            };
            columns.times.push(step.time_s);
            columns.tensions.extend_from_slice(run.tensions());
            columns.distances.extend_from_slice(run.distances().0);
            columns.costs.push(step.report.cost);
            columns.plan.push(step.plan_ns as f64 * 1e-9);
            columns.iterations.push(step.report.iterations as u64);
            columns.converged.push(step.report.status == Status::Converged);
            columns.near.push(step.report.branch != Branch::Safe);
            shown.add(&run.planner().arm, run.state());
            if run.steps().is_multiple_of(STEPS_BETWEEN_LOOKS) {
                Python::attach(|py| py.check_signals())?;
            }
        }
        Ok::<_, PyErr>((run, columns, shown, diverged))
    })?;
    let rows = columns.times.len();
    let obstacles: Vec<&str> = run.course().scenario().obstacles.iter().map(|o| o.id.as_str()).collect();
    let dict = shown.into_dict(py)?;
    dict.set_item("times_s", PyArray1::from_vec(py, columns.times))?;
    dict.set_item("tension_n", table(py, columns.tensions, rows, run.tensions().len())?)?;
    dict.set_item("distance_m", table(py, columns.distances, rows, obstacles.len())?)?;
    dict.set_item("obstacles", obstacles)?;
    dict.set_item("cost", PyArray1::from_vec(py, columns.costs))?;
    dict.set_item("plan_s", PyArray1::from_vec(py, columns.plan))?;
    dict.set_item("iterations", PyArray1::from_vec(py, columns.iterations))?;
    dict.set_item("converged", PyArray1::from_vec(py, columns.converged))?;
    dict.set_item("near_obstacles", PyArray1::from_vec(py, columns.near))?;
    dict.set_item("diverged", diverged)?;
    dict.set_item("seed", seed)?;
    Ok(dict)
}
