//! The files of `config/` inside the binary, so that an installed program works without a checkout.

use super::Config;
use super::arm::ArmConfig;
use super::drives::RATED_NM_MIN;
use super::error::{ConfigError, Problem};
use std::path::Path;

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

/// Name and text of every file of the library of arms, `config/arms/`: an arm each, and scenarios for it.
pub static ARMS: &[(&str, &str)] = &[
    ("dong-2017/arm.toml", include_str!("../../config/arms/dong-2017/arm.toml")),
    ("dong-2017/shape.toml", include_str!("../../config/arms/dong-2017/shape.toml")),
    ("dong-2017/tip.toml", include_str!("../../config/arms/dong-2017/tip.toml")),
    ("feizi-sheath/arm.toml", include_str!("../../config/arms/feizi-sheath/arm.toml")),
    ("feizi-sheath/shape.toml", include_str!("../../config/arms/feizi-sheath/shape.toml")),
    ("feizi-sheath/tip.toml", include_str!("../../config/arms/feizi-sheath/tip.toml")),
    ("festo-bha/arm.toml", include_str!("../../config/arms/festo-bha/arm.toml")),
    ("festo-bha/shape.toml", include_str!("../../config/arms/festo-bha/shape.toml")),
    ("festo-bha/tip.toml", include_str!("../../config/arms/festo-bha/tip.toml")),
    ("lab-two-sections/arm.toml", include_str!("../../config/arms/lab-two-sections/arm.toml")),
    ("lab-two-sections/tip.toml", include_str!("../../config/arms/lab-two-sections/tip.toml")),
    ("oc-snake-arm/arm.toml", include_str!("../../config/arms/oc-snake-arm/arm.toml")),
    ("oc-snake-arm/shape.toml", include_str!("../../config/arms/oc-snake-arm/shape.toml")),
    ("oc-snake-arm/tip.toml", include_str!("../../config/arms/oc-snake-arm/tip.toml")),
    ("rao-2021/arm.toml", include_str!("../../config/arms/rao-2021/arm.toml")),
    ("rao-2021/shape.toml", include_str!("../../config/arms/rao-2021/shape.toml")),
    ("rao-2021/tip.toml", include_str!("../../config/arms/rao-2021/tip.toml")),
    ("renda-2018/arm.toml", include_str!("../../config/arms/renda-2018/arm.toml")),
    ("renda-2018/shape.toml", include_str!("../../config/arms/renda-2018/shape.toml")),
    ("renda-2018/tip.toml", include_str!("../../config/arms/renda-2018/tip.toml")),
    ("rucker-webster-2011/arm.toml", include_str!("../../config/arms/rucker-webster-2011/arm.toml")),
    ("rucker-webster-2011/shape.toml", include_str!("../../config/arms/rucker-webster-2011/shape.toml")),
    ("rucker-webster-2011/tip.toml", include_str!("../../config/arms/rucker-webster-2011/tip.toml")),
    ("sofa-trunk/arm.toml", include_str!("../../config/arms/sofa-trunk/arm.toml")),
    ("sofa-trunk/shape.toml", include_str!("../../config/arms/sofa-trunk/shape.toml")),
    ("till-2019/arm.toml", include_str!("../../config/arms/till-2019/arm.toml")),
    ("till-2019/shape.toml", include_str!("../../config/arms/till-2019/shape.toml")),
    ("till-2019/tip.toml", include_str!("../../config/arms/till-2019/tip.toml")),
    ("tummers-2023/arm.toml", include_str!("../../config/arms/tummers-2023/arm.toml")),
    ("tummers-2023/shape.toml", include_str!("../../config/arms/tummers-2023/shape.toml")),
    ("tummers-2023/tip.toml", include_str!("../../config/arms/tummers-2023/tip.toml")),
];

/// Path and text of the built-in scenario of this name: `tip`, or of an arm of the library `rao-2021/tip`.
pub(super) fn scenario(name: &str) -> Option<(String, &'static str)> {
    let own = SCENARIOS.iter().find(|(scenario, _)| *scenario == name);
    let arms = || ARMS.iter().find(|(file, _)| file.strip_suffix(".toml") == Some(name) && !file.ends_with("arm.toml"));
    own.map(|(_, text)| (format!("config/scenarios/{name}.toml (built in)"), *text))
        .or_else(|| arms().map(|(file, text)| (format!("config/arms/{file} (built in)"), *text)))
}

/// Text of a file of the library of arms, by its path as built-in scenarios name it.
pub(super) fn arm_text(path: &Path) -> Option<&'static str> {
    let name = path.strip_prefix("config/arms").ok()?;
    ARMS.iter().find(|(file, _)| Path::new(file) == name).map(|(_, text)| *text)
}

/// What to say when there is neither such a file nor such a built-in scenario.
pub(super) fn no_such_scenario(name: &str) -> ConfigError {
    let library = ARMS.iter().filter(|(file, _)| !file.ends_with("arm.toml"));
    let names: Vec<_> = SCENARIOS
        .iter()
        .map(|(scenario, _)| *scenario)
        .chain(library.filter_map(|(file, _)| file.strip_suffix(".toml")))
        .collect();
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

/// `[drives]` of an arm that is simulated: one drive for each cable, on one virtual bus, in the order of the cables. The drums
/// have 0.03 of the arm's length as radius, and the drives pull a little more than the largest tension. Gears are no higher than
/// that the rated torque is one of those that object 6076 can show, in whole mN m.
pub fn simulated_drives(arm: &ArmConfig) -> String {
    let drum_m = 0.03 * arm.length_m();
    let drum_nm = 1.06 * arm.tension_n_max * drum_m;
    let gear = (drum_nm / RATED_NM_MIN).min(10.0);
    // As many a turn of the drum, whatever the gear, as far as an encoder counts.
    let counts = (40_960.0 / gear).ceil().min(1e8);
    let torque_nm = (drum_nm / gear).max(RATED_NM_MIN);
    format!(
        "[drives]\nsafe_tension_n = {:?}\n\n[[drives.buses]]\nname = \"bus0\"\nkind = \"virtual\"\ninterface = \"sinew0\"\n\n\
         [drives.defaults]\ndrum_radius_m = {drum_m:?}\ngear_ratio = {gear:?}\nrated_torque_nm = {torque_nm:?}\n\
         torque_nm_max = {torque_nm:?}\ncounts_per_turn = {counts}\nvendor_id = 0\nproduct_code = 0x53494e57\n",
        arm.tension_n_min
    )
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
