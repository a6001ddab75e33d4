//! What a demo is made of: one configuration file for all, names of its own for bus and shared memory, the programs.

use super::{Branch, Demo, complain, is_tip};
use miette::{IntoDiagnostic, WrapErr, miette};
use sinew::config::{BUILTIN_FILES, Config, ScenarioConfig, arm_text_of, simulated_drives};
use sinew::ipc::Domain;
use sinew::scenario::Course;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Source id of the obstacle client.
const OBSTACLE_SOURCE: u32 = 1;
/// Source id of the task client.
const TASK_SOURCE: u32 = 2;
/// The built-in files that make a whole configuration.
const FILES: [&str; 4] = ["arm.toml", "controller.toml", "drives.toml", "plant.toml"];

/// Everything that the demo's parts need to know.
pub(super) struct Setup {
    pub(super) scenario: ScenarioConfig,
    pub(super) config: Config,
    pub(super) duration_s: f64,
    pub(super) seed: u64,
    pub(super) domain: Domain,
    /// This program.
    pub(super) sinew: PathBuf,
    /// `sim_plant`.
    pub(super) plant: PathBuf,
    /// Elements of the true arm per element of the controller's.
    pub(super) mesh_refinement: usize,
    /// Ticks by which commands take effect late.
    pub(super) latency_ticks: u64,
    fast: bool,
    scenario_argument: String,
    start_tensions: Vec<f64>,
    faults: Vec<String>,
    /// Faults on the wire: drives need not get every command.
    pub(super) wire: Vec<String>,
    buses: Vec<String>,
    prefix: String,
    folder: PathBuf,
    /// Deletes the folder where it is not to be kept.
    temporary: tempfile::TempDir,
}

impl Setup {
    pub(super) fn new(demo: &Demo) -> miette::Result<Self> {
        let scenario = ScenarioConfig::find(&demo.scenario)?;
        refuse_without_effect(demo, &scenario)?;
        let duration_s = duration_s(demo, &scenario)?;
        let sinew = std::env::current_exe().into_diagnostic()?;
        let plant = find_plant(&sinew)?;
        let temporary = tempfile::Builder::new().prefix("sinew-demo-").tempdir().into_diagnostic()?;
        let folder = match &demo.keep {
            Some(folder) => {
                let made = std::fs::create_dir_all(folder).and_then(|()| folder.canonicalize());
                made.into_diagnostic()
                    .wrap_err_with(|| format!("--keep {}: the directory cannot be made", folder.display()))?
            }
            None => temporary.path().to_owned(),
        };
        if let Some(kept) = ["daemon.mcap", "truth.mcap"].map(|name| folder.join(name)).iter().find(|f| f.exists()) {
            return Err(miette!("--keep: {} is there already; give another directory", kept.display()));
        }
        let process = std::process::id();
        let prefix = format!("sinewdemo{process}_");
        let root = temporary.path().join("ipc/");
        let mut tables = tables(&demo.config, &demo.scenario, &scenario)?;
        let buses = isolate(&mut tables, process, &prefix, &root, &demo.can)?;
        adapt(&mut tables, demo, &scenario);
        let file = folder.join("demo.toml");
        std::fs::write(&file, toml::to_string(&tables).into_diagnostic()?)
            .into_diagnostic()
            .wrap_err_with(|| format!("{} cannot be written", file.display()))?;
        let config = Config::load(&[file])?;
        let (_, start_tensions) = Course::new(&scenario)
            .start(&config.arm)
            .into_diagnostic()
            .wrap_err_with(|| format!("scenario {} has no start with this arm", scenario.name))?;
        let plant_table = tables.get("plant").and_then(Value::as_table);
        let refinement = plant_table.and_then(|t| t.get("mesh_refinement")).and_then(Value::as_integer);
        let latency = plant_table.and_then(|t| t.get("latency_ticks")).and_then(Value::as_integer);
        let scenario_argument = match Path::new(&demo.scenario).canonicalize() {
            Ok(path) if path.is_file() => path.display().to_string(),
            _ => demo.scenario.clone(),
        };
        Ok(Self {
            duration_s,
            seed: demo.seed,
            domain: Domain::new(prefix.clone(), root),
            sinew,
            plant,
            // The key's default, `sim_plant`'s configuration has it.
            mesh_refinement: refinement.and_then(|n| usize::try_from(n).ok()).unwrap_or(2),
            latency_ticks: latency.and_then(|n| u64::try_from(n).ok()).unwrap_or(0),
            fast: demo.fast,
            scenario_argument,
            start_tensions,
            faults: demo.fault.clone(),
            wire: demo.wire.clone(),
            buses,
            prefix,
            folder,
            temporary,
            scenario,
            config,
        })
    }

    /// Leaves recordings and logs behind, since somebody is told to look at them.
    pub(super) fn keep(&mut self) {
        self.temporary.disable_cleanup(true);
    }

    /// Where configuration, recordings and logs are.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The truth, tick by tick.
    pub(super) fn trace(&self) -> PathBuf {
        self.folder.join("truth.mcap")
    }

    /// The daemon's records.
    pub(super) fn records(&self) -> PathBuf {
        self.folder.join("daemon.mcap")
    }

    fn path(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }

    pub(super) fn plant_arguments(&self) -> Vec<String> {
        let mut arguments = strings(&["--config", &self.path("demo.toml"), "--trace", &self.path("truth.mcap")]);
        arguments.extend(strings(&["--seed", &self.seed.to_string(), "--start-scenario", &self.scenario_argument]));
        if self.fast {
            arguments.push("--lockstep".into());
        }
        for fault in &self.faults {
            arguments.extend(strings(&["--fault", fault]));
        }
        for fault in &self.wire {
            arguments.extend(strings(&["--wire", fault]));
        }
        arguments
    }

    pub(super) fn daemon_arguments(&self) -> Vec<String> {
        let tensions: Vec<String> = self.start_tensions.iter().map(f64::to_string).collect();
        let mut arguments =
            strings(&["run", "--config", &self.path("demo.toml"), "--record", &self.path("daemon.mcap")]);
        arguments.extend(strings(&["--seed", &self.seed.to_string(), "--arm-on-start", "--track-on-start"]));
        arguments.push(format!("--start-tensions={}", tensions.join(",")));
        if self.fast {
            arguments.extend(strings(&["--lockstep", "--await-target"]));
            arguments.extend(strings(&["--await-obstacles", &OBSTACLE_SOURCE.to_string()]));
        }
        arguments
    }

    pub(super) fn view_arguments(&self, port: u16) -> Vec<String> {
        strings(&["view", "--config", &self.path("demo.toml"), "--port", &port.to_string()])
    }

    pub(super) fn client_arguments(&self, role: &str) -> Vec<String> {
        let source = if role == "task" { TASK_SOURCE } else { OBSTACLE_SOURCE };
        let mut arguments = strings(&["client", role, "--scenario", &self.scenario_argument]);
        arguments.extend(strings(&["--arm", &self.config.ipc.arm, "--source", &source.to_string()]));
        if self.fast {
            arguments.push("--lockstep".into());
        }
        arguments
    }

    /// Removes what killed processes left behind; all of it carries names that only this demo has.
    pub(super) fn sweep(&self) {
        self.domain.sweep();
        for bus in &self.buses {
            if let Err(error) = sinew_hal::virtual_bus::remove_stale(bus) {
                tracing::warn!(%error, bus, "bus left behind");
            }
        }
        let Ok(entries) = std::fs::read_dir("/dev/shm") else { return };
        for entry in entries.flatten() {
            if entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
}

impl Drop for Setup {
    fn drop(&mut self) {
        self.sweep();
    }
}

/// A choice that would change nothing is a mistake of whoever made it.
fn refuse_without_effect(demo: &Demo, scenario: &ScenarioConfig) -> miette::Result<()> {
    let name = &scenario.name;
    if !scenario.sweep.is_empty() {
        return Err(miette!(
            help = format!("`sinew plan {name}` runs it; the demo runs one scenario, e.g. tip"),
            "{name} is a series of {} variations",
            scenario.sweep.len()
        ));
    }
    if demo.warning.is_some() && !scenario.planner.avoidance {
        return Err(miette!("--warning has no effect: {name} avoids nothing"));
    }
    Ok(())
}

/// Seconds of the scenario that run.
fn duration_s(demo: &Demo, scenario: &ScenarioConfig) -> miette::Result<f64> {
    let whole_s = scenario.duration_s;
    let asked_s = demo.duration.unwrap_or(whole_s);
    if asked_s > whole_s {
        complain(format_args!("--duration {asked_s}: {} ends after {whole_s} s", scenario.name));
    }
    let duration_s = asked_s.min(whole_s);
    match demo.kill_obstacle_client_at {
        Some(at_s) if at_s >= duration_s => {
            Err(miette!("--kill-obstacle-client-at {at_s}: the run ends before, after {duration_s} s"))
        }
        _ => Ok(duration_s),
    }
}

fn strings(parts: &[&str]) -> Vec<String> {
    parts.iter().map(|&part| part.to_owned()).collect()
}

/// `sim_plant` beside this program, or one folder up: tests run in `deps/`.
fn find_plant(sinew: &Path) -> miette::Result<PathBuf> {
    let beside = sinew.parent().unwrap_or(Path::new("."));
    let places = [beside.join("sim_plant"), beside.join("../sim_plant")];
    places.into_iter().find(|place| place.is_file()).ok_or_else(|| {
        let release = if beside.ends_with("release") { " --release" } else { "" };
        miette!(
            help = format!("build it with `cargo build{release} -p sim_plant`"),
            "the simulated plant `sim_plant` is not beside this program ({})",
            beside.display()
        )
    })
}

/// All tables of the files given; without files those of the scenario's own arm, from which everything else is computed, or
/// the built-in ones.
fn tables(files: &[PathBuf], name: &str, scenario: &ScenarioConfig) -> miette::Result<Table> {
    let mut all = Table::new();
    let texts: Vec<String> = if files.is_empty()
        && let Some(arm) = arm_text_of(name)
    {
        vec![arm, simulated_drives(&scenario.arm)]
    } else if files.is_empty() {
        let built_in = BUILTIN_FILES.iter().filter(|(name, _)| FILES.contains(name));
        built_in.map(|(_, text)| (*text).to_owned()).collect()
    } else {
        // Refused here with file and line; what is put together below has neither.
        Config::load(files)?;
        let read = |path: &PathBuf| {
            std::fs::read_to_string(path).into_diagnostic().wrap_err_with(|| path.display().to_string())
        };
        files.iter().map(read).collect::<miette::Result<_>>()?
    };
    for text in texts {
        all.extend(text.parse::<Table>().into_diagnostic()?);
    }
    Ok(all)
}

/// Shared memory and buses of the demo's own, or the interfaces given; the names of its own buses.
fn isolate(
    tables: &mut Table,
    process: u32,
    prefix: &str,
    root: &Path,
    interfaces: &[String],
) -> miette::Result<Vec<String>> {
    let mut names = Vec::new();
    let buses = table(tables, "drives").get_mut("buses").and_then(Value::as_array_mut);
    let buses: Vec<&mut Table> = buses.into_iter().flatten().filter_map(Value::as_table_mut).collect();
    if !interfaces.is_empty() && interfaces.len() != buses.len() {
        return Err(miette!(
            help = "name one interface for each bus, or give a --config with as many [[drives.buses]]",
            "--can names {} interface(s), the configuration has {} bus(es)",
            interfaces.len(),
            buses.len()
        ));
    }
    for (index, bus) in buses.into_iter().enumerate() {
        if let Some(interface) = interfaces.get(index) {
            bus.insert("kind".into(), "socketcan".into());
            bus.insert("interface".into(), interface.clone().into());
            continue;
        }
        let name = format!("dm{process}-{index}");
        bus.insert("kind".into(), "virtual".into());
        bus.insert("interface".into(), name.clone().into());
        names.push(name);
    }
    let ipc = table(tables, "ipc");
    ipc.insert("prefix".into(), prefix.into());
    ipc.insert("root_path".into(), root.display().to_string().into());
    Ok(names)
}

/// What the scenario and the command line ask for.
fn adapt(tables: &mut Table, demo: &Demo, scenario: &ScenarioConfig) {
    let planner = table(tables, "planner");
    planner.insert("avoidance".into(), scenario.planner.avoidance.into());
    if demo.config.is_empty() {
        // What of the arm may not touch is the scenario's to say, to which its obstacles are placed.
        planner.insert("body_radius_m".into(), scenario.planner.body_radius_m.into());
    }
    if let Some(warning) = demo.warning {
        let name = match warning {
            Branch::Swarm => "swarm",
            Branch::Seeded => "seeded",
            Branch::Complementarity => "complementarity",
        };
        planner.insert("warning".into(), name.into());
    }
    if demo.config.is_empty() && arm_text_of(&demo.scenario).is_none() {
        // Weights and penalty belong to the paper's example, not to the machine.
        table(planner, "swarm").insert("penalty".into(), scenario.planner.swarm.penalty.into());
        let kind = if is_tip(&scenario.task) { "tip" } else { "shape" };
        let weights = table(table(tables, "weights"), kind);
        if let (Some(tension), Some(change)) = (scenario.weight_tension, &scenario.weight_tension_change) {
            weights.insert("tension".into(), tension.into());
            weights.insert("tension_change".into(), change.clone().into());
        }
        match &scenario.task {
            sinew::config::Task::Tip { weight_pose, weight_rate, weight_damping, .. } => {
                weights.insert("pose".into(), (*weight_pose).into());
                weights.insert("rate".into(), (*weight_rate).into());
                weights.insert("damping".into(), (*weight_damping).into());
            }
            sinew::config::Task::Shape { weight_end, .. } => {
                weights.insert("curvature".into(), (*weight_end).into());
            }
        }
    }
    if !demo.fast {
        // Encoders are read at the SYNC that carries the tensions: a tick old when the next one computes.
        table(tables, "observer").entry("latency_ticks").or_insert(Value::Integer(1));
    }
}

/// The table of this name, made if it is not there.
fn table<'a>(tables: &'a mut Table, name: &str) -> &'a mut Table {
    let entry = tables.entry(name).or_insert_with(|| Value::Table(Table::new()));
    if !entry.is_table() {
        *entry = Value::Table(Table::new());
    }
    match entry {
        Value::Table(table) => table,
        _ => unreachable!("just made one"),
    }
}
