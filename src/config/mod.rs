//! Configuration: files to checked types.
//!
//! Enters: TOML files. Leaves: types whose every value is inside its documented range, or an error that shows file,
//! line, key, value and range. It never starts anything, and nothing below it reads a file.
//!
//! Every key is registered once, in [`schema`] terms, beside the type that it fills; [`reader`] checks files against
//! that registry and `config/README.md` is generated from it. `serde` only writes these types: a derived reader stops at
//! the first mistake and cannot say what would be permitted.

mod access;
mod arm;
mod arm_file;
mod builtin;
mod cable;
mod check;
mod computed;
mod document;
mod drives;
pub mod error;
mod friction;
mod governor;
mod guard;
mod ipc;
mod motion;
mod observer;
mod obstacles;
mod planner;
mod planner_file;
mod profile;
pub mod reader;
mod recording;
mod safe_hold;
mod scale;
mod scenario;
mod scenario_file;
pub mod schema;
mod stations;
mod supervision;
mod target;
mod timing;
mod tip_sensor;
mod weights;

pub use access::{ACCESS, AccessConfig, Who};
pub use arm::*;
pub use arm_file::ARM;
pub use builtin::{ARMS, BUILTIN_FILES, SCENARIOS, builtin_texts, simulated_drives};
pub use cable::{CableName, CableNames};
pub use check::SummaryLine;
pub use drives::{
    BusConfig, BusKind, BusLayout, DRIVES, DriveConfig, DrivesConfig, PACKED_DRIVES_MAX, Protection, SIMULATED_DRIVE,
};
pub use error::ConfigError;
pub use friction::{FRICTION, FrictionConfig};
pub use governor::{GOVERNOR, GovernorConfig, OutOfReach};
pub use guard::{GUARD, GuardConfig};
pub use ipc::{IPC, IpcConfig};
pub use observer::{OBSERVER, ObserverConfig};
pub use obstacles::{LostAction, OBSTACLES, ObstaclePolicyConfig};
pub use planner::*;
pub use planner_file::{PLANNER, SCENARIO_PLANNER};
pub use profile::Profile;
pub use recording::{RECORDING, RecordingConfig};
pub use safe_hold::{SafeHold, in_words as safe_hold_in_words};
pub use scale::Scale;
pub use scenario::*;
pub use scenario_file::{SCENARIO, arm_of, arm_text_of};
pub use supervision::{SUPERVISION, SupervisionAnswer, SupervisionConfig};
pub use target::{TARGET, TargetPolicyConfig};
pub use timing::{LOOP, LoopConfig};
pub use tip_sensor::{TIP_SENSOR, TipSensorConfig};
pub use weights::{ShapeWeights, TipWeights, WEIGHTS, WeightsConfig};

use reader::Document;
use schema::TableSpec;
use serde::Serialize;
use std::path::PathBuf;

/// Stands for the table of the simulated plant, which its own program reads: the daemon lets it pass, so that one set
/// of files can be given to both.
static PLANT: TableSpec = TableSpec { header: "[plant]", name: "plant", about: "The simulated plant.", keys: &[] };

/// What the daemon's files may hold: its own tables, and the plant's.
static KNOWN_TABLES: &[&TableSpec] = &[
    &ARM,
    &LOOP,
    &PLANNER,
    &WEIGHTS,
    &OBSERVER,
    &FRICTION,
    &TIP_SENSOR,
    &GOVERNOR,
    &GUARD,
    &SUPERVISION,
    &OBSTACLES,
    &TARGET,
    &DRIVES,
    &IPC,
    &ACCESS,
    &RECORDING,
    &PLANT,
];

/// All top-level tables of the daemon's files.
pub static TABLES: &[&TableSpec] = KNOWN_TABLES.split_at(KNOWN_TABLES.len() - 1).0;

/// Everything that the daemon needs to know.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Config {
    /// `[arm]`.
    pub arm: ArmConfig,
    /// `[loop]`.
    pub timing: LoopConfig,
    /// `[planner]`; its period is the loop's.
    pub planner: PlannerConfig,
    /// `[weights]`.
    pub weights: WeightsConfig,
    /// `[observer]`.
    pub observer: ObserverConfig,
    /// `[friction]`.
    pub friction: FrictionConfig,
    /// `[tip_sensor]`.
    pub tip_sensor: TipSensorConfig,
    /// `[governor]`.
    pub governor: GovernorConfig,
    /// `[guard]`.
    pub guard: GuardConfig,
    /// `[supervision]`.
    pub supervision: SupervisionConfig,
    /// `[obstacles]`.
    pub obstacles: ObstaclePolicyConfig,
    /// `[target]`.
    pub target: TargetPolicyConfig,
    /// `[drives]`.
    pub drives: DrivesConfig,
    /// `[ipc]`.
    pub ipc: IpcConfig,
    /// `[access]`.
    pub access: AccessConfig,
    /// `[recording]`.
    pub recording: RecordingConfig,
}

impl Config {
    /// Reads the daemon's configuration from files that hold a table each, several, or all.
    ///
    /// `[arm]` and `[drives]` must be there; another table that is absent has its defaults.
    ///
    /// # Errors
    /// Everything wrong in the files, a table in two files or in none, as [`ConfigError`].
    pub fn load(paths: &[PathBuf]) -> Result<Self, ConfigError> {
        reader::read_files(paths, KNOWN_TABLES, Self::build)
    }

    /// The same with the arm changed before anything is computed from it; without files the built-in ones.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn load_changed(paths: &[PathBuf], change: impl Fn(&mut ArmConfig)) -> Result<Self, ConfigError> {
        let build = |document: &Document<'_>| {
            let mut arm = arm_file::arm(document);
            change(&mut arm);
            Self::build_for(document, arm)
        };
        if paths.is_empty() {
            return reader::read(builtin_texts("drives.toml"), KNOWN_TABLES, build);
        }
        reader::read_files(paths, KNOWN_TABLES, build)
    }

    /// The same from texts in memory: pairs of a name, which stands for the file in messages, and its content.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(texts: Vec<(String, String)>) -> Result<Self, ConfigError> {
        reader::read(texts, KNOWN_TABLES, Self::build)
    }

    /// What an arm alone gives: everything is computed from it, and a simulated drive on one virtual bus pulls each cable. A
    /// period (s) that is given overrides the arm's.
    ///
    /// # Errors
    /// The arm is none that a file could describe, or the period is not permitted.
    pub fn of_arm(arm: &ArmConfig, period_s: Option<f64>) -> Result<Self, ConfigError> {
        let mut texts = vec![(format!("drives of {}", arm.name), builtin::simulated_drives(arm))];
        if let Some(period_s) = period_s {
            texts.push((format!("period of {}", arm.name), format!("[loop]\nperiod_s = {period_s:?}\n")));
        }
        reader::read(texts, KNOWN_TABLES, |document| Self::build_for(document, arm.clone()))
    }

    /// Builds the configuration from an opened document, for programs whose files hold further tables.
    pub fn build(document: &Document<'_>) -> Self {
        Self::build_for(document, arm_file::arm(document))
    }

    fn build_for(document: &Document<'_>, mut arm: ArmConfig) -> Self {
        let scale = Scale::of(&arm);
        if arm.tension_rate_npsmax.is_infinite() {
            // In closed loop alone: a scenario's plan is the paper's, without one.
            arm.tension_rate_npsmax = scale.tension_rate_npsmax();
        }
        let disk_radius_m = arm.disk_radius_m();
        let planner_table = document.table_or_defaults(&PLANNER);
        let given_s = planner_table.float_opt("lookahead_s");
        let lookahead_s = given_s.unwrap_or_else(|| planner_file::lookahead_s(&scale));
        let timing = timing::read(&document.table_or_defaults(&LOOP), &scale, lookahead_s);
        let planner = planner_file::read(&planner_table, given_s, Some(timing.period_s), &scale, disk_radius_m);
        let weights = weights::read(&document.table_or_defaults(&WEIGHTS), arm.segments.len(), planner.lookahead_s);
        let observer = observer::read(&document.table_or_defaults(&OBSERVER), &arm, &scale);
        let friction = friction::read(&document.table_or_defaults(&FRICTION), &scale);
        let tip_sensor = tip_sensor::read(&document.table_or_defaults(&TIP_SENSOR), &scale);
        let governor = governor::read(&document.table_or_defaults(&GOVERNOR), &scale);
        let guard_table = document.table_or_defaults(&GUARD);
        let guard = guard::read(&guard_table, &scale, timing.period_s);
        if guard.encoder_silent_s < 2.0 * timing.period_s {
            let help = format!("permitted: {} s (two periods of the loop) to 10 s", 2.0 * timing.period_s);
            guard_table.refuse("encoder_silent_s", "shorter than two periods of the loop", &help);
        }
        let obstacles = obstacles::read(&document.table_or_defaults(&OBSTACLES), &scale);
        let target = target::read(&document.table_or_defaults(&TARGET));
        let drives = drives::read(&document.table(&DRIVES), &arm, Some(timing.period_s));
        let step_n = drives.drives.iter().map(DriveConfig::tension_step_n).fold(0.0, f64::max);
        let supervision = supervision::read(&document.table_or_defaults(&SUPERVISION), &arm, timing.period_s, step_n);
        let ipc = ipc::read(&document.table_or_defaults(&IPC), &arm.name);
        let recording = recording::read(&document.table_or_defaults(&RECORDING));
        let access = access::read(&document.table_or_defaults(&ACCESS));
        if let Some(budget) = planner.budget_s
            && budget > timing.period_s - timing.reserve_s
        {
            let most = timing.period_s - timing.reserve_s;
            planner_table.refuse("budget_s", "more than the period leaves", &format!("permitted: > 0 and <= {most} s"));
        }
        Self {
            arm,
            timing,
            planner,
            weights,
            observer,
            friction,
            tip_sensor,
            governor,
            guard,
            supervision,
            obstacles,
            target,
            drives,
            ipc,
            access,
            recording,
        }
    }
}
