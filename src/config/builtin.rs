//! The files of `config/` inside the binary, so that an installed program works without a checkout.

use super::Config;
use super::arm::ArmConfig;
use super::error::{ConfigError, Problem};

/// Name and text of every file of `config/` that a program may need.
pub static BUILTIN_FILES: &[(&str, &str)] = &[
    ("arm.toml", include_str!("../../config/arm.toml")),
    ("controller.toml", include_str!("../../config/controller.toml")),
    ("drives.toml", include_str!("../../config/drives.toml")),
    ("drives-4-buses.toml", include_str!("../../config/drives-4-buses.toml")),
    ("drives-4-fd-buses.toml", include_str!("../../config/drives-4-fd-buses.toml")),
    ("plant.toml", include_str!("../../config/plant.toml")),
];

/// Name and text of every built-in scenario.
pub static SCENARIOS: &[(&str, &str)] = &[
    ("tip", include_str!("../../config/scenarios/tip.toml")),
    ("tip-no-avoidance", include_str!("../../config/scenarios/tip-no-avoidance.toml")),
    ("shape", include_str!("../../config/scenarios/shape.toml")),
    ("shape-no-avoidance", include_str!("../../config/scenarios/shape-no-avoidance.toml")),
    ("penalty-sweep", include_str!("../../config/scenarios/penalty-sweep.toml")),
    ("swarm-comparison", include_str!("../../config/scenarios/swarm-comparison.toml")),
];

/// Text of the built-in scenario of this name.
pub(super) fn scenario(name: &str) -> Option<&'static str> {
    SCENARIOS.iter().find(|(scenario, _)| *scenario == name).map(|(_, text)| *text)
}

/// What to say when there is neither such a file nor such a built-in scenario.
pub(super) fn no_such_scenario(name: &str) -> ConfigError {
    let names: Vec<_> = SCENARIOS.iter().map(|(scenario, _)| *scenario).collect();
    ConfigError {
        subject: name.to_owned(),
        problems: vec![Problem {
            place: None,
            message: format!("no scenario `{name}`: neither a file of this path nor a built-in one of this name"),
            label: String::new(),
            help: format!("built-in scenarios: {}", names.join(", ")),
        }],
    }
}

/// Texts of the built-in files that make a configuration, with one of the files of drives.
pub fn builtin_texts(drives: &str) -> Vec<(String, String)> {
    let texts = BUILTIN_FILES.iter().filter(|(name, _)| ["arm.toml", "controller.toml", drives].contains(name));
    texts.map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
}

impl Config {
    /// The demonstrations' configuration: arm and controller of the built-in files, 24 drives on one virtual bus.
    ///
    /// # Panics
    /// Never in a program that passed its tests: the files are part of the binary.
    #[expect(clippy::expect_used, reason = "the texts are constants of the program, read by a test")]
    pub fn builtin() -> Self {
        Self::parse(builtin_texts("drives.toml")).expect("the built-in configuration is valid")
    }
}

impl ArmConfig {
    /// The arm of the paper's examples (design section 12): `config/arm.toml`, built in.
    ///
    /// # Panics
    /// Never in a program that passed its tests: the file is part of the binary.
    #[expect(clippy::expect_used, reason = "the text is a constant of the program, read by a test")]
    pub fn paper() -> Self {
        let (name, text) = BUILTIN_FILES[0];
        Self::parse(&format!("config/{name} (built in)"), text).expect("the built-in arm is valid")
    }
}
