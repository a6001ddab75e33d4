//! What a recording says of its run: arm, names, settings, and its clock.

use super::told;
use serde_json::Value;
use sinew::config::{CableNames, Config};
use sinew::ipc::payload::SupervisorState;
use sinew::recording::{CONFIGURATION, Facts, SETTINGS, SOFTWARE, facts};
use std::path::Path;

/// What a recording says of its run.
pub(super) struct Context {
    pub(super) facts: Facts,
    /// Every setting as it came out; null in a recording that has none.
    pub(super) settings: Value,
    pub(super) cables: CableNames,
}

impl Context {
    pub(super) fn read(path: &Path) -> miette::Result<Self> {
        let facts = facts(path).map_err(told)?;
        let settings: Value =
            facts.attachments.get(SETTINGS).and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let holes = |segment: &Value| segment["hole_angles_rad"].as_array().map_or(0, Vec::len);
        let segments = settings["arm"]["segments"].as_array();
        let cables = CableNames::new(segments.into_iter().flatten().map(holes).collect::<Vec<_>>());
        Ok(Self { facts, settings, cables })
    }

    pub(super) fn fact(&self, name: &str) -> Option<&str> {
        self.facts.metadata.get(name).map(String::as_str)
    }

    pub(super) fn arm(&self) -> &str {
        self.fact("arm").unwrap_or("unknown")
    }

    /// Whether a loop wrote it, and no plan and no plant.
    pub(super) fn is_loop(&self) -> bool {
        self.fact("lockstep").is_some()
    }

    /// Whether a loop wrote it that kept time by the clock.
    pub(super) fn is_timed(&self) -> bool {
        self.fact("lockstep") == Some("false")
    }

    /// A mode in a word; what no loop wrote has none.
    pub(super) fn mode(&self, supervisor: u32) -> &'static str {
        match SupervisorState::from_wire(supervisor).filter(|_| self.is_loop()) {
            Some(mode) => mode.text(),
            None if self.is_loop() => "unknown",
            None => "without a loop",
        }
    }

    /// The loop's period (s); `None` where nothing says it.
    pub(super) fn period_s(&self) -> Option<f64> {
        let stated = self.fact("period_s").and_then(|text| text.parse().ok());
        stated.or_else(|| self.settings["planner"]["period_s"].as_f64())
    }

    /// The configuration, where it is attached and this version understands it.
    pub(super) fn config(&self) -> Option<Config> {
        let text = self.facts.attachments.get(CONFIGURATION)?;
        Config::parse(vec![(CONFIGURATION.to_owned(), text.clone())]).ok()
    }

    /// Sources of obstacles that must be there.
    pub(super) fn required(&self) -> Vec<u32> {
        let list = self.settings["obstacles"]["required"].as_array();
        list.into_iter().flatten().filter_map(|id| u32::try_from(id.as_u64()?).ok()).collect()
    }

    /// What wrote it, in a line.
    pub(super) fn software(&self) -> String {
        let attached = self.facts.attachments.get(SOFTWARE);
        let software: Value = attached.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let text = |key: &str| software[key].as_str().unwrap_or("?").to_owned();
        match attached {
            Some(_) => format!("{} {}, {} on {}", text("name"), text("version"), text("system"), text("processor")),
            None => format!("sinew {}", self.fact("sinew_version").unwrap_or("of an unknown version")),
        }
    }

    /// Name of an obstacle: the scenario's where a plan has one.
    pub(super) fn obstacle(&self, source_id: u32, obstacle_id: u32) -> String {
        let place = (obstacle_id as usize).wrapping_sub(1);
        let named = self.settings["obstacles"].get(place).and_then(|obstacle| obstacle["id"].as_str());
        match named.filter(|_| source_id == 0) {
            Some(name) => format!("obstacle {name}"),
            None => format!("obstacle {obstacle_id} of source {source_id}"),
        }
    }

    /// A cable in words.
    pub(super) fn cable(&self, place: usize) -> String {
        self.cables.of(place).map_or_else(|| format!("{}", place + 1), |name| name.to_string())
    }
}
