//! Arms and scenarios as texts, and what of them Python needs to know.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sinew::config::{ARMS, ArmConfig, BUILTIN_FILES, ConfigError, SCENARIOS};
use sinew::model::Arm;
use std::path::Path;

/// A refused configuration with everything wrong in it, a line each.
pub(crate) fn refused(error: &ConfigError) -> PyErr {
    let mut text = error.to_string();
    for problem in &error.problems {
        let place = problem.place.as_ref().map(|place| format!("{place}: ")).unwrap_or_default();
        text += &format!("\n  {place}{}", problem.message);
        if !problem.help.is_empty() {
            text += &format!(" ({})", problem.help);
        }
    }
    PyValueError::new_err(text)
}

fn find<'a>(files: &[(&str, &'a str)], name: &str) -> Option<&'a str> {
    files.iter().find(|(file, _)| *file == name).map(|(_, text)| *text)
}

/// Text of an arm of the library, `paper` among them.
#[pyfunction]
pub(crate) fn arm_text(name: &str) -> PyResult<&'static str> {
    let found = if name == "paper" { find(BUILTIN_FILES, "arm.toml") } else { find(ARMS, &format!("{name}/arm.toml")) };
    found.ok_or_else(|| {
        let library = ARMS.iter().filter_map(|(file, _)| file.strip_suffix("/arm.toml"));
        let names: Vec<&str> = std::iter::once("paper").chain(library).collect();
        PyValueError::new_err(format!("no arm `{name}`: neither a file nor one of the library: {}", names.join(", ")))
    })
}

/// Text of a built-in scenario.
#[pyfunction]
pub(crate) fn scenario_text(name: &str) -> PyResult<&'static str> {
    find(SCENARIOS, name).or_else(|| find(ARMS, &format!("{name}.toml"))).ok_or_else(|| {
        let library = ARMS.iter().filter_map(|(file, _)| file.strip_suffix(".toml"));
        let names: Vec<&str> =
            SCENARIOS.iter().map(|(file, _)| *file).chain(library.filter(|file| !file.ends_with("/arm"))).collect();
        PyValueError::new_err(format!("no scenario `{name}`: neither a file nor a built-in one: {}", names.join(", ")))
    })
}

/// TOML as JSON.
#[pyfunction]
pub(crate) fn toml_to_json(text: &str) -> PyResult<String> {
    let table: toml::Table = text.parse().map_err(|e| PyValueError::new_err(format!("no TOML: {e}")))?;
    serde_json::to_string(&table).map_err(|e| PyValueError::new_err(e.to_string()))
}

/// JSON as TOML.
#[pyfunction]
pub(crate) fn json_to_toml(text: &str) -> PyResult<String> {
    let value: toml::Table = serde_json::from_str(text).map_err(|e| PyValueError::new_err(e.to_string()))?;
    toml::to_string(&value).map_err(|e| PyValueError::new_err(e.to_string()))
}

/// Reads an arm; `name` stands for its file in messages.
pub(crate) fn arm(name: &str, text: &str) -> PyResult<ArmConfig> {
    ArmConfig::parse(name, text).map_err(|error| refused(&error))
}

/// Sizes and bounds of an arm as JSON.
#[pyfunction]
pub(crate) fn describe(name: &str, text: &str) -> PyResult<String> {
    let config = arm(name, text)?;
    let model = Arm::new(&config);
    let description = serde_json::json!({
        "name": config.name,
        "length_m": config.length_m(),
        "segments": model.segment_count(),
        "cables": model.cable_count(),
        "nodes": model.node_count() + 1,
        "cable_segment": model.cable_segment,
        "segment_length_m": (0..model.segment_count()).map(|s| model.segment_length(s)).collect::<Vec<_>>(),
        "tension_n_min": config.tension_n_min,
        "tension_n_max": config.tension_maxima_n(),
    });
    Ok(description.to_string())
}

/// The scenario of a file, or of a text whose `arm` is relative to the folder of `name`.
pub(crate) fn scenario(name: &str, text: &str) -> PyResult<sinew::config::ScenarioConfig> {
    let place = if find(ARMS, &format!("{name}.toml")).is_some() && !Path::new(name).is_file() {
        format!("config/arms/{name}.toml")
    } else {
        name.to_owned()
    };
    sinew::config::ScenarioConfig::parse(&place, text).map_err(|error| refused(&error))
}
