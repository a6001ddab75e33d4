//! Reading of the golden files (format: `tests/golden/FORMULAS.md`).
#![allow(dead_code)] // each test binary uses its own part

pub mod arms;
pub mod planning;
pub mod settings;

use serde_json::Value;
use sinew::config::{ArmConfig, ChordRule, Routing, StrainRule};
use std::path::{Path, PathBuf};

/// Directory of the golden files.
pub fn golden_dir() -> PathBuf {
    std::env::var_os("SINEW_GOLDEN_DIR")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden")), PathBuf::from)
}

/// All golden files that hold `key` at the top, with their names. Where the directory of `SINEW_GOLDEN_DIR` has none of
/// this format, the project's own are read, so that a test always judges something; panics if there is none at all.
pub fn golden_files(key: &str) -> Vec<(String, Value)> {
    let own = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden"));
    for dir in [golden_dir(), own] {
        let found = files_with(&dir, key);
        if !found.is_empty() {
            return found;
        }
    }
    panic!("no golden file with `{key}` in {}", golden_dir().display());
}

fn files_with(dir: &Path, key: &str) -> Vec<(String, Value)> {
    let mut found = Vec::new();
    let mut names: Vec<_> = std::fs::read_dir(dir)
        .unwrap_or_else(|e| panic!("{}: {e}", dir.display()))
        .map(|f| f.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "json"))
        .collect();
    names.sort();
    for path in names {
        let text = std::fs::read_to_string(&path).unwrap();
        let value: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        if value.get(key).is_some() {
            found.push((path.file_name().unwrap().to_string_lossy().into_owned(), value));
        }
    }
    found
}

/// Numbers of an array.
pub fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap_or_else(|| panic!("not an array: {v}")).iter().map(|x| x.as_f64().unwrap()).collect()
}

/// One number.
pub fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or_else(|| panic!("not a number: {v}"))
}

/// The arm that a file's `params` describe.
pub fn arm_config(params: &Value) -> ArmConfig {
    let f = |k: &str| number(&params[k]);
    let count = |k: &str| params[k].as_u64().unwrap() as usize;
    let mut arm = ArmConfig::paper();
    let template = arm.segments[0].clone();
    let offsets = numbers(&params["cab_off_deg"]);
    let segments = count("n_seg");
    arm.segments = (0..segments)
        .map(|s| {
            let mut seg = template.clone();
            seg.length_m = f("L_seg");
            seg.elements = count("n_e");
            seg.bending_stiffness_nm2 = f("EI");
            seg.torsional_stiffness_nm2 = f("EI") * f("GJ_over_EI");
            seg.damping_stiffness_s = f("beta");
            seg.disk_mass_kg = f("m_disk");
            seg.disk_radius_m = f("r_disk");
            seg.disk_thickness_m = f("h_disk");
            seg.backbone_mass_kgpm = f("m_backbone");
            let last = s + 1 == segments;
            seg.connector_length_m = if last { 0.0 } else { f("L_con") };
            seg.connector_mass_kg = if last { 0.0 } else { f("m_con") };
            seg.hole_radius_m = f("rho_c");
            let n = count("n_cab");
            seg.hole_angles_rad =
                (0..n).map(|c| (f("cab0_deg") + offsets[s] + 360.0 / n as f64 * c as f64).to_radians()).collect();
            seg
        })
        .collect();
    let choice = |k: &str| params[k].as_str().unwrap().to_owned();
    arm.routing = if choice("routing") == "through" { Routing::Through } else { Routing::Local };
    arm.chord = if choice("chord") == "trap" { ChordRule::Trapezoid } else { ChordRule::Simpson };
    arm.strain = if choice("kappa") == "log" { StrainRule::Logarithm } else { StrainRule::VectorPart };
    arm.damping_mass_1ps = f("alpha_m");
    arm.gravity_mps2 = numbers(&params["gravity"]).try_into().unwrap();
    arm.base_quaternion = numbers(&params["base_p"]).try_into().unwrap();
    arm.rho_inf = f("rho_inf");
    arm.tension_n_max = f("u_max");
    arm
}

/// Largest difference over the largest entry of the expectation (or over 1e-12 for a zero vector).
pub fn relative_error(got: &[f64], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let scale = want.iter().fold(0.0f64, |a, x| a.max(x.abs()));
    let diff =
        got.iter().zip(want).fold(0.0f64, |a, (x, y)| if (x - y).is_nan() { f64::NAN } else { a.max((x - y).abs()) });
    if scale == 0.0 { diff } else { diff / scale }
}

/// Asserts [`relative_error`] at most `limit`.
#[track_caller]
pub fn assert_close(what: &str, got: &[f64], want: &[f64], limit: f64) {
    let e = relative_error(got, want);
    assert!(e <= limit, "{what}: relative error {e:.3e} above {limit:.1e}");
}
