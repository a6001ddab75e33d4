//! `[plant]`: how the simulated arm differs from the controller's model of it.
//!
//! Enters: TOML files. Leaves: checked settings; the arm, the drives and the services come from the controller's own
//! tables. It reads through the same registry as the daemon's configuration and refuses in the same words.

use crate::truth::TruthSettings;
use serde::Serialize;
use sinew::config::reader::{self, Section};
use sinew::config::schema::{Key, Kind, Range, TableSpec};
use sinew::config::{Config, ConfigError, TABLES};
use std::path::PathBuf;

/// What makes the plant's time pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// One period of the loop per SYNC, as fast as it computes.
    Lockstep,
    /// The clock.
    Realtime,
}

/// How the plant differs from the controller's model. The defaults are those of the closed-loop study (design,
/// section 6).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlantConfig {
    /// How the true arm differs.
    #[serde(flatten)]
    pub truth: TruthSettings,
    /// What makes time pass.
    pub pace: Pace,
}

/// `[plant]`.
pub static PLANT: TableSpec = TableSpec {
    header: "[plant]",
    name: "plant",
    about: "How the simulated arm differs from the controller's model of it. `[arm]`, `[drives]` and `[ipc]` are read from the controller's files; the daemon lets this table pass.",
    keys: &[
        Key::default(
            "mesh_refinement",
            Kind::Integer(1, 10),
            "",
            "2",
            "Elements per element of `[arm]`; at most 50 elements per segment result.",
        ),
        Key::optional(
            "step_s",
            Kind::Float(Range::closed(1e-5, 0.1)),
            "s",
            "a part of the period: at most 0.005 s and a two-hundredth of the arm's first period",
            "Integration step; one period of the loop is a whole multiple of it, or equal to it where it is shorter.",
        ),
        Key::default(
            "stiffness_factor",
            Kind::Float(Range::closed(0.1, 10.0)),
            "",
            "0.95",
            "Plant's EI and GJ over `[arm]`'s.",
        ),
        Key::default(
            "damping_factor",
            Kind::Float(Range::closed(0.0, 10.0)),
            "",
            "1.2",
            "Plant's damping over `[arm]`'s.",
        ),
        Key::default(
            "disk_mass_factor",
            Kind::Float(Range::closed(0.1, 10.0)),
            "",
            "1.05",
            "Plant's disk mass over `[arm]`'s.",
        ),
        Key::default(
            "tension_error_max",
            Kind::Float(Range::closed(0.0, 0.5)),
            "",
            "0.03",
            "Each cable's tension is off by a constant factor within 1 +- this, drawn from the seed.",
        ),
        Key::optional(
            "encoder_step_m",
            Kind::Float(Range::closed(0.0, 0.01)),
            "m",
            "7.3e-6 of the arm's length",
            "Resolution of cable lengths; 0 leaves only the drives' counts.",
        ),
        Key::default(
            "encoder_noise_m",
            Kind::Float(Range::closed(0.0, 0.01)),
            "m",
            "0.0",
            "Standard deviation of noise on cable lengths before they are rounded.",
        ),
        Key::default(
            "capstan_friction",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "0.0",
            "Friction coefficient mu of the cables along their route, exp(-mu angle).",
        ),
        Key::default("latency_ticks", Kind::Integer(0, 20), "ticks", "0", "Ticks by which commands take effect late."),
        Key::default(
            "extra_payload_kg",
            Kind::Float(Range::closed(0.0, 100.0)),
            "kg",
            "0.0",
            "Point mass at the tip that the controller does not know.",
        ),
        Key::default("seed", Kind::Integer(0, i64::MAX), "", "1", "Seed of tension errors and noise."),
        Key::default(
            "pace",
            Kind::Choice(&["lockstep", "realtime"]),
            "",
            "\"realtime\"",
            "`lockstep`: one period per SYNC, as fast as it computes; `realtime`: the clock.",
        ),
    ],
};

impl PlantConfig {
    /// Reads the plant's settings and, from the same files, the controller's configuration.
    ///
    /// A `[plant]` that is absent has its defaults.
    ///
    /// # Errors
    /// Everything wrong in the files, as [`ConfigError`].
    pub fn load(paths: &[PathBuf]) -> Result<(Self, Config), ConfigError> {
        reader::read_files(paths, &known_tables(), build)
    }

    /// The same from texts in memory: pairs of a name, which stands for the file in messages, and its content.
    ///
    /// # Errors
    /// As [`PlantConfig::load`].
    pub fn parse(texts: Vec<(String, String)>) -> Result<(Self, Config), ConfigError> {
        reader::read(texts, &known_tables(), build)
    }
}

fn known_tables() -> Vec<&'static TableSpec> {
    TABLES.iter().copied().chain([&PLANT]).collect()
}

fn build(document: &reader::Document<'_>) -> (PlantConfig, Config) {
    let config = Config::build(document);
    let plant = read(&document.table_or_defaults(&PLANT), &config);
    (plant, config)
}

fn read(table: &Section<'_>, config: &Config) -> PlantConfig {
    let study = TruthSettings::study_of(config, 1);
    let truth = TruthSettings {
        mesh_refinement: table.count("mesh_refinement"),
        step_s: table.float_opt("step_s").unwrap_or(study.step_s),
        stiffness_factor: table.float("stiffness_factor"),
        damping_factor: table.float("damping_factor"),
        disk_mass_factor: table.float("disk_mass_factor"),
        tension_error_max: table.float("tension_error_max"),
        encoder_step_m: table.float_opt("encoder_step_m").unwrap_or(study.encoder_step_m),
        encoder_noise_m: table.float("encoder_noise_m"),
        capstan_friction: table.float("capstan_friction"),
        latency_ticks: table.count("latency_ticks"),
        extra_payload_kg: table.float("extra_payload_kg"),
        seed: table.integer("seed").unsigned_abs(),
    };
    let pace = if table.choice("pace") == "lockstep" { Pace::Lockstep } else { Pace::Realtime };
    let plant = PlantConfig { truth, pace };
    if !table.is_clean() {
        return plant;
    }
    let period_s = config.timing.period_s;
    let steps = period_s / plant.truth.step_s;
    if steps >= 1.0 && (steps - steps.round()).abs() > 1e-6 {
        let help = format!("permitted: {period_s} s (the loop's period) divided by 1, 2, 3, ...");
        table.refuse("step_s", "the loop's period is no whole multiple of it", &help);
    }
    let elements = config.arm.segments.iter().map(|segment| segment.elements).max().unwrap_or(0);
    if elements * plant.truth.mesh_refinement > 50 {
        let help =
            format!("permitted: 1 to {}, so that a segment has at most 50 elements", (50 / elements.max(1)).max(1));
        table.refuse("mesh_refinement", "too many elements in a segment", &help);
    }
    plant
}

#[cfg(test)]
mod tests {
    use super::*;
    use sinew::config::{BUILTIN_FILES, builtin_texts};

    fn texts(plant: &str) -> Vec<(String, String)> {
        let mut texts = builtin_texts("drives.toml");
        texts.push(("plant.toml".into(), plant.into()));
        texts
    }

    fn refusal(plant: &str) -> String {
        PlantConfig::parse(texts(plant)).expect_err("must be refused").report()
    }

    #[test]
    fn the_shipped_plant_is_the_default_and_that_of_the_study() {
        let shipped = BUILTIN_FILES.iter().find(|(name, _)| *name == "plant.toml").unwrap().1;
        let (plant, _) = PlantConfig::parse(texts(shipped)).unwrap();
        let mut bare = PlantConfig::parse(texts("")).unwrap().0;
        // Computed from the arm's length, which is a sum.
        assert!((bare.truth.encoder_step_m / plant.truth.encoder_step_m - 1.0).abs() < 1e-12);
        bare.truth.encoder_step_m = plant.truth.encoder_step_m;
        assert_eq!(plant, bare);
        assert_eq!(plant.truth, TruthSettings::study(1));
    }

    #[test]
    fn an_unknown_key_is_refused_with_a_suggestion() {
        let report = refusal("[plant]\nstiffnes_factor = 1.0\n");
        for part in ["plant.toml:2:1", "unknown key `plant.stiffnes_factor`", "did you mean `stiffness_factor`"] {
            assert!(report.contains(part), "{part} is not in\n{report}");
        }
    }

    #[test]
    fn a_step_that_does_not_divide_the_period_is_refused() {
        let report = refusal("[plant]\nstep_s = 0.003\n");
        for part in ["plant.toml:2:10", "plant.step_s", "0.003", "0.01 s (the loop's period) divided by"] {
            assert!(report.contains(part), "{part} is not in\n{report}");
        }
    }

    #[test]
    fn a_refinement_beyond_what_the_model_takes_is_refused() {
        let arm = BUILTIN_FILES[0].1.replace("elements = 5", "elements = 30");
        let mut files = texts("[plant]\nmesh_refinement = 2\n");
        files[0].1 = arm;
        let report = PlantConfig::parse(files).expect_err("must be refused").report();
        for part in ["plant.toml:2:19", "plant.mesh_refinement", "permitted: 1 to 1"] {
            assert!(report.contains(part), "{part} is not in\n{report}");
        }
    }

    /// `SINEW_WRITE_REFERENCE=1 cargo test -p sim_plant config_readme` rewrites the page after a key has changed.
    #[test]
    fn config_readme_documents_the_plant_as_the_registry_has_it() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/README.md");
        let page = std::fs::read_to_string(path).unwrap();
        let (before, rest) = page.split_once("<!-- begin plant -->\n").unwrap();
        let (found, after) = rest.split_once("<!-- end plant -->").unwrap();
        let wanted = format!("\n{}", PLANT.markdown());
        if std::env::var_os("SINEW_WRITE_REFERENCE").is_some() {
            std::fs::write(path, format!("{before}<!-- begin plant -->\n{wanted}<!-- end plant -->{after}")).unwrap();
            return;
        }
        assert_eq!(found, wanted, "config/README.md differs from the registry");
    }
}
