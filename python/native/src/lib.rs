//! The library's model and planner for Python, over numpy arrays.
//!
//! Enters: an arm or a scenario as text, tensions as arrays. Leaves: dictionaries of arrays in SI units, whose first axis
//! is time or the place in a batch. `sinew_arm` gives them types and names; nothing here is meant to be called directly.

mod design;
mod motion;
mod planned;

use pyo3::prelude::*;

#[pymodule]
fn sinew_arm_native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(design::arm_text, module)?)?;
    module.add_function(wrap_pyfunction!(design::scenario_text, module)?)?;
    module.add_function(wrap_pyfunction!(design::toml_to_json, module)?)?;
    module.add_function(wrap_pyfunction!(design::json_to_toml, module)?)?;
    module.add_function(wrap_pyfunction!(design::describe, module)?)?;
    module.add_function(wrap_pyfunction!(motion::equilibria, module)?)?;
    module.add_function(wrap_pyfunction!(motion::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(planned::plan, module)?)
}
