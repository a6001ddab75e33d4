//! The arm's own motion under given tensions: at rest, and over time.

use super::design;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyArithmeticError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sinew::integrator::{Scheme, Stepper, consistent_start, equilibrium};
use sinew::model::{Arm, State};

/// Most Newton iterations of a step.
const ITERATIONS_MAX: usize = 30;
/// Steps between two looks at the signals of Python.
const STEPS_BETWEEN_LOOKS: usize = 64;
/// Numbers of a node: position.
const SPACE: usize = 3;

/// What an arm looked like, one look after the other.
pub(crate) struct Shown {
    nodes: usize,
    pub(crate) count: usize,
    node_position: Vec<f64>,
    tip_position: Vec<f64>,
    tip_quaternion: Vec<f64>,
    tip_velocity: Vec<f64>,
    curvature: Vec<f64>,
    scratch: [Vec<f64>; 2],
}

impl Shown {
    pub(crate) fn new(arm: &Arm) -> Self {
        let curvatures = vec![0.0; 2 * arm.segment_count()];
        Self {
            nodes: arm.node_count() + 1,
            count: 0,
            node_position: Vec::new(),
            tip_position: Vec::new(),
            tip_quaternion: Vec::new(),
            tip_velocity: Vec::new(),
            curvature: Vec::new(),
            scratch: [curvatures.clone(), curvatures],
        }
    }

    pub(crate) fn add(&mut self, arm: &Arm, state: &State) {
        for i in 0..self.nodes {
            self.node_position.extend_from_slice(arm.pose(&state.q, i).0.as_slice());
        }
        let tip = arm.tip(&state.q, &state.qd);
        self.tip_position.extend_from_slice(tip.position.as_slice());
        self.tip_quaternion.extend_from_slice(tip.quaternion.as_slice());
        self.tip_velocity.extend_from_slice(tip.velocity.as_slice());
        let [curvatures, rates] = &mut self.scratch;
        arm.curvatures_into(&state.q, &state.qd, curvatures, rates);
        self.curvature.extend_from_slice(curvatures);
        self.count += 1;
    }

    /// Where no equilibrium was found: numbers that are none.
    fn add_none(&mut self) {
        let columns = [
            (&mut self.node_position, SPACE * self.nodes),
            (&mut self.tip_position, SPACE),
            (&mut self.tip_quaternion, 4),
            (&mut self.tip_velocity, SPACE),
            (&mut self.curvature, self.scratch[0].len()),
        ];
        for (values, width) in columns {
            values.extend(std::iter::repeat_n(f64::NAN, width));
        }
        self.count += 1;
    }

    pub(crate) fn into_dict<'py>(self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (rows, curvatures) = (self.count, self.scratch[0].len());
        let dict = PyDict::new(py);
        dict.set_item("node_position_m", self.node_position.into_pyarray(py).reshape([rows, self.nodes, SPACE])?)?;
        dict.set_item("tip_position_m", table(py, self.tip_position, rows, SPACE)?)?;
        dict.set_item("tip_quaternion", table(py, self.tip_quaternion, rows, 4)?)?;
        dict.set_item("tip_velocity_mps", table(py, self.tip_velocity, rows, SPACE)?)?;
        dict.set_item("curvature_1pm", table(py, self.curvature, rows, curvatures)?)?;
        Ok(dict)
    }
}

/// An array of rows.
pub(crate) fn table(
    py: Python<'_>,
    values: Vec<f64>,
    rows: usize,
    columns: usize,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    values.into_pyarray(py).reshape([rows, columns])
}

fn expect(what: &str, found: usize, wanted: usize) -> PyResult<()> {
    if found == wanted {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("{what}: {found} numbers, expected {wanted}")))
}

/// The arm at rest under each row of tensions (N), from a chain of constant curvatures (1/m), which chooses the branch.
/// Rows without an equilibrium are NaN.
#[pyfunction]
pub(crate) fn equilibria<'py>(
    py: Python<'py>,
    name: &str,
    text: &str,
    tensions: PyReadonlyArray2<'py, f64>,
    guess: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let arm = Arm::new(&design::arm(name, text)?);
    let (tensions, guess) = (tensions.as_array().to_owned(), guess.as_array().to_vec());
    expect("tensions in a row", tensions.ncols(), arm.cable_count())?;
    expect("guess", guess.len(), 2 * arm.segment_count())?;
    let shown = py.detach(|| {
        let mut shown = Shown::new(&arm);
        let mut stepper = Stepper::new(&arm);
        for row in tensions.rows() {
            let mut state = State::at_rest(arm.bent(&guess));
            match equilibrium(&arm, &mut stepper, &row.to_vec(), &mut state) {
                Ok(_) => shown.add(&arm, &state),
                Err(_) => shown.add_none(),
            }
            if shown.count.is_multiple_of(STEPS_BETWEEN_LOOKS) {
                Python::attach(|py| py.check_signals())?;
            }
        }
        Ok::<_, PyErr>(shown)
    })?;
    shown.into_dict(py)
}

/// The motion under a row of tensions (N) for each step of `step_s`, from the equilibrium under `start` (N).
#[pyfunction]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    name: &str,
    text: &str,
    start: PyReadonlyArray1<'py, f64>,
    guess: PyReadonlyArray1<'py, f64>,
    tensions: PyReadonlyArray2<'py, f64>,
    step_s: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let config = design::arm(name, text)?;
    let arm = Arm::new(&config);
    let (start, guess) = (start.as_array().to_vec(), guess.as_array().to_vec());
    let tensions = tensions.as_array().to_owned();
    expect("start tensions", start.len(), arm.cable_count())?;
    expect("guess", guess.len(), 2 * arm.segment_count())?;
    expect("tensions in a row", tensions.ncols(), arm.cable_count())?;
    if !(step_s > 0.0 && step_s.is_finite()) {
        return Err(PyValueError::new_err(format!("step_s: {step_s}, expected a positive number of seconds")));
    }
    if !start.iter().chain(tensions.iter()).all(|u| u.is_finite()) {
        return Err(PyValueError::new_err("tensions: NaN or infinite"));
    }
    let shown = py.detach(|| {
        let failed = |at: usize, why: String| {
            PyArithmeticError::new_err(format!(
                "the motion could not be computed at {:.6} s: {why}",
                at as f64 * step_s
            ))
        };
        let mut stepper = Stepper::new(&arm);
        let scheme = Scheme::new(config.rho_inf);
        let mut state = State::at_rest(arm.bent(&guess));
        equilibrium(&arm, &mut stepper, &start, &mut state).map_err(|e| failed(0, e.to_string()))?;
        consistent_start(&arm, &mut stepper, &start, &mut state).map_err(|e| failed(0, e.to_string()))?;
        let mut next = state.clone();
        let mut shown = Shown::new(&arm);
        shown.add(&arm, &state);
        for (k, row) in tensions.rows().into_iter().enumerate() {
            let report = stepper
                .step(&arm, &scheme, step_s, &state, &row.to_vec(), ITERATIONS_MAX, &mut next)
                .map_err(|e| failed(k, e.to_string()))?;
            if !report.converged && report.correction > 1e-6 {
                return Err(failed(k, "no convergence; take a smaller step".into()));
            }
            std::mem::swap(&mut state, &mut next);
            shown.add(&arm, &state);
            if k.is_multiple_of(STEPS_BETWEEN_LOOKS) {
                Python::attach(|py| py.check_signals())?;
            }
        }
        Ok::<_, PyErr>(shown)
    })?;
    let times: Vec<f64> = (0..shown.count).map(|k| k as f64 * step_s).collect();
    let dict = shown.into_dict(py)?;
    dict.set_item("times_s", PyArray1::from_vec(py, times))?;
    Ok(dict)
}
