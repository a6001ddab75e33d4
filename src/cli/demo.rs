//! `sinew demo`: a scenario in closed loop, every part a process of its own.
//!
//! Enters: a scenario and a few choices. Leaves: the same table or JSON object as `sinew plan`, judged by the true arm
//! and not by the controller's own estimate. It only starts, watches and stops: plant, obstacle client, task client and
//! daemon know each other by the bus and by shared memory alone, in a domain of their own. However it ends (done, Ctrl-C,
//! a child's crash, its own), no process and no file in shared memory is left.

mod children;
mod judge;
mod setup;
mod wire;

use super::scenario_client::approach_s;
use super::view::DEFAULT_PORT;
use super::{Outcome, complain, print_json, print_text, report};
use children::{Children, Ended};
use clap::{Args, ValueEnum};
use miette::{IntoDiagnostic, miette};
use setup::Setup;
use sinew::config::Task;
use sinew::control::{Settings, doubts};
use sinew::ipc::payload::{PlannerBranch, RequestKind, State, SupervisorState};
use sinew::ipc::{Client, IpcError, NewestSubscriber};
use sinew::report::{figures_table, summary_table};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How often the demo looks at its children and at the arm.
const LOOK: Duration = Duration::from_millis(20);
/// Time granted to start, from the first process to the arm that tracks.
const START: Duration = Duration::from_secs(60);
/// Time granted to each step of stopping before harder means. Where each is a tick of lockstep, it is arm time, and real
/// time without a tick: an emulated processor takes a minute for what is half a second of the arm's.
const STOP: Duration = Duration::from_secs(10);

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Branch {
    /// The paper's particle swarm alone.
    Swarm,
    /// The swarm with the complementarity solution among its seeds.
    Seeded,
    /// The extended complementarity problem alone.
    Complementarity,
}

/// Arguments of `sinew demo`.
#[derive(Debug, Args)]
pub(crate) struct Demo {
    /// `tip`, `shape`, another built-in scenario, or a scenario file.
    scenario: String,
    /// In lockstep, as fast as it computes; otherwise in real time.
    #[arg(long)]
    fast: bool,
    /// Print one JSON object and nothing else to standard output.
    #[arg(long)]
    json: bool,
    /// Seed of the plant's errors and of the planner's swarm.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Seconds of the scenario to run; default: all.
    #[arg(long, value_name = "S", value_parser = super::positive_seconds)]
    duration: Option<f64>,
    /// What plans near obstacles; default: the configuration's.
    #[arg(long)]
    warning: Option<Branch>,
    /// Configuration files with all tables in place of the built-in ones; bus and shared memory stay the demo's own.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    config: Vec<PathBuf>,
    /// Run over these CAN interfaces of the kernel (vcan0, say), one for each bus of the configuration in its order. No
    /// drives but the simulated ones may be on them.
    #[arg(long, value_delimiter = ',', value_name = "INTERFACE,...")]
    can: Vec<String>,
    /// Keep configuration, recordings and logs in this directory.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Serve a page that shows the run, as `sinew view` does, at this port of 127.0.0.1 (0: a free one), and say where.
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = DEFAULT_PORT)]
    view: Option<u16>,
    /// Report what happened as a page; it takes its times from the loop's beginning.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Kill the obstacle client (SIGKILL) at this time of the scenario.
    #[arg(long, value_name = "S", value_parser = super::positive_seconds)]
    kill_obstacle_client_at: Option<f64>,
    /// Break something in the plant: stick|jump|silence|trip|dead|reboot|pull|press:CABLE[:METRES or NEWTONS][@SECONDS
    /// since the drives came up].
    #[arg(long, value_name = "FAULT")]
    fault: Vec<String>,
    /// Let frames between daemon and drives go wrong: KIND[:FRAMES[.NODE]][=PROBABILITY][@FROM[-TO]], e.g. drop=0.01 for
    /// a loss of 1 % both ways; see `sim_plant --help` and hal/FAULTS.md.
    #[arg(long, value_name = "FAULT", value_delimiter = ',')]
    wire: Vec<String>,
}

/// How the run itself ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ending {
    /// The scenario's time is over.
    Done,
    /// A signal.
    Interrupted,
    /// A fault is latched, or somebody told the arm to stop.
    Stopped,
}

impl Demo {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, stop.clone()).into_diagnostic()?;
        }
        // Not after all of the run.
        self.report.as_deref().map_or(Ok(()), report::refuse_other)?;
        let mut setup = Setup::new(&self)?;
        let mut children = Children::new(&setup);
        let ended = self.go(&setup, &mut children, &stop);
        let stopped = children.stop_all(&setup);
        setup.sweep();
        if ended.is_err() || stopped.is_err() {
            setup.keep();
        }
        let ending = ended?;
        match stopped {
            // What ended the run comes first: a daemon that does not go is no reason to hide it.
            Err(error) if ending == Ending::Stopped => complain(format_args!("{error}")),
            other => other?,
        }
        if let Some(out) = &self.report {
            report::write(&setup.records(), out)?;
        }
        let judged = judge::judge(&setup, self.fast)?;
        let summary = &judged.summary;
        if self.json {
            print_json(summary)?;
        } else {
            print_text(&format!("{}\n{}\n", summary_table(summary), figures_table(&setup.scenario.figures, summary)))?;
        }
        match ending {
            Ending::Interrupted => {
                complain(format_args!("interrupted after {:.1} s of {} s", judged.reached_s, setup.duration_s));
                Ok(Outcome::Failed)
            }
            Ending::Stopped => {
                let why = if summary.faults.is_empty() { "on request" } else { "by a fault" };
                complain(format_args!("stopped {why} after {:.1} s of {} s", judged.reached_s, setup.duration_s));
                if !summary.faults.is_empty() {
                    for doubt in doubts(&Settings::new(&setup.config)) {
                        complain(format_args!("likely cause: {doubt}"));
                    }
                }
                Ok(Outcome::Failed)
            }
            Ending::Done => {
                let held = &judged.held;
                if held.for_s > 0.0 {
                    let end = if held.at_end { ", and did to the end" } else { "" };
                    complain(format_args!("the arm held for {:.2} s, first at {:.2} s{end}", held.for_s, held.from_s));
                }
                if !self.json {
                    self.tell_of_pages();
                }
                // A hold is what is declared for a killed client; else the arm was to follow its path.
                let given_up = held.at_end && self.kill_obstacle_client_at.is_none();
                let failed = judged.contact || !summary.faults.is_empty() || given_up;
                Ok(if failed { Outcome::Failed } else { Outcome::Done })
            }
        }
    }

    /// Where what happened is to be seen.
    fn tell_of_pages(&self) {
        match &self.report {
            Some(out) => complain(format_args!("what happened, and why: {}", out.display())),
            None => complain("for a page that shows what happened and why: add --report FILE.html"),
        }
        if self.view.is_none() {
            complain("to watch the run in a browser: add --view");
        }
    }

    fn go(&self, setup: &Setup, children: &mut Children, stop: &AtomicBool) -> miette::Result<Ending> {
        let begin = Instant::now();
        children.start_plant(setup, stop)?;
        children.start_daemon(setup)?;
        if let Some(port) = self.view {
            complain(format_args!("the arm is shown at {}", children.start_view(setup, port)?));
        }
        // They wait for the daemon by themselves, and in lockstep its first tick waits for them.
        children.start_clients(setup)?;
        let mut client = loop {
            match Client::connect(&setup.domain, &setup.config.ipc.arm) {
                Ok(client) => break client,
                Err(IpcError::NoDaemon { .. }) if begin.elapsed() < START => {}
                Err(error) => return Err(error).into_diagnostic(),
            }
            children.check()?;
            if stop.load(Ordering::Relaxed) {
                return Ok(Ending::Interrupted);
            }
            std::thread::sleep(LOOK);
        };
        let states = client.states().into_diagnostic()?;
        let ending = self.watch(setup, children, &states, stop, begin)?;
        if ending != Ending::Stopped {
            stop_arm(&mut client, &states, children)?;
        }
        Ok(ending)
    }

    fn watch(
        &self,
        setup: &Setup,
        children: &mut Children,
        states: &NewestSubscriber<State>,
        stop: &AtomicBool,
        begin: Instant,
    ) -> miette::Result<Ending> {
        let bar = super::progress_bar((1e3 * setup.duration_s) as u64, &setup.scenario.name);
        bar.set_style(
            indicatif::ProgressStyle::with_template("{prefix} {wide_bar} {msg} {elapsed}/{eta}")
                .unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()),
        );
        bar.set_prefix(setup.scenario.name.clone());
        let (mut origin_ns, mut kill_at_s) = (None, self.kill_obstacle_client_at);
        let mut most_n = 0.0f64;
        let mut heard = Instant::now();
        let ending = loop {
            if stop.load(Ordering::Relaxed) {
                break Ending::Interrupted;
            }
            children.check()?;
            let mut newest = None;
            while let Some(state) = states.receive().into_diagnostic()? {
                newest = Some(state);
            }
            let Some(state) = newest else {
                if origin_ns.is_none() && heard.elapsed() > START {
                    return Err(miette!(
                        "the loop does not begin after {} s; its drives may not come up: see daemon.log in {}",
                        START.as_secs(),
                        setup.folder().display()
                    ));
                }
                std::thread::sleep(LOOK / 4);
                continue;
            };
            heard = Instant::now();
            // Somebody else may tell the arm to stop, and it does not start again by itself.
            let told_to_stop = [SupervisorState::Stopping, SupervisorState::Disarmed].map(SupervisorState::wire);
            if state.fault_code != 0 || origin_ns.is_some() && told_to_stop.contains(&state.supervisor) {
                break Ending::Stopped;
            }
            let is_tracking = state.supervisor == SupervisorState::Tracking.wire();
            if is_tracking && origin_ns.is_none() {
                origin_ns = Some(state.header.capture_ns);
                bar.reset_elapsed();
            }
            most_n = state.tension_command_n.iter().fold(most_n, |a, u| a.max(*u));
            bar.set_message(line(&state, most_n));
            match origin_ns {
                None if begin.elapsed() > START && (!self.fast || state.time_s > START.as_secs_f64()) => {
                    return Err(miette!(
                        "the arm does not track after {} s: it is {}; logs in {}",
                        START.as_secs(),
                        SupervisorState::from_wire(state.supervisor).map_or("unknown", SupervisorState::text),
                        setup.folder().display()
                    ));
                }
                None => {}
                Some(origin) => {
                    let t_s =
                        state.header.capture_ns.saturating_sub(origin) as f64 * 1e-9 - approach_s(&setup.scenario.task);
                    bar.set_position((1e3 * t_s.max(0.0)) as u64);
                    if kill_at_s.is_some_and(|at| t_s >= at) {
                        kill_at_s = None;
                        bar.println(format!("{t_s:.1} s: obstacle client killed"));
                        children.kill_obstacle_client()?;
                    }
                    // A little more: the first record that was seen here need not be the first that tracked.
                    if t_s >= setup.duration_s + 0.1 {
                        break Ending::Done;
                    }
                }
            }
            std::thread::sleep(LOOK / 4);
        };
        bar.finish_and_clear();
        Ok(ending)
    }
}

/// What the arm is doing, in a line.
fn line(state: &State, most_n: f64) -> String {
    let mode = SupervisorState::from_wire(state.supervisor).map_or("?", SupervisorState::text);
    let branch = PlannerBranch::from_wire(state.planner_branch).map_or("?", PlannerBranch::text);
    let error = if state.tip_error_m.is_finite() {
        format!("tip {:4.1} mm", 1e3 * state.tip_error_m)
    } else if state.curvature_error_1pm.is_finite() {
        format!("curvature {:.3} 1/m", state.curvature_error_1pm)
    } else {
        "-".to_owned()
    };
    let used = (state.distance_count as usize).min(state.distances.len());
    let least = state.distances[..used].iter().map(|d| d.surface_distance_m).fold(f64::INFINITY, f64::min);
    let nearest = if least.is_finite() { format!("nearest {:5.1} mm", 1e3 * least) } else { "no obstacle".to_owned() };
    format!("{:6.2} s {mode}, {error}, {nearest}, at most {most_n:.0} N, {branch}", state.time_s)
}

/// Brings the arm to rest and the drives off, as an operator would.
fn stop_arm(client: &mut Client, states: &NewestSubscriber<State>, children: &mut Children) -> miette::Result<()> {
    // A daemon that does not answer is stopped by its signal, which does the same.
    if let Err(error) = client.ask(RequestKind::Stop, STOP) {
        tracing::warn!(%error, "stop request");
        return Ok(());
    }
    let (mut heard, mut since_s) = (Instant::now(), None);
    while heard.elapsed() < STOP {
        children.check()?;
        match states.receive().into_diagnostic()? {
            Some(state) if state.supervisor == SupervisorState::Disarmed.wire() => return Ok(()),
            Some(state) if state.fault_code != 0 => return Ok(()),
            Some(state) if state.time_s - *since_s.get_or_insert(state.time_s) > STOP.as_secs_f64() => return Ok(()),
            Some(_) => heard = Instant::now(),
            None => std::thread::sleep(LOOK / 10),
        }
    }
    Ok(())
}

impl Ended {
    /// What to tell about a child that ended by itself.
    fn report(&self) -> miette::Report {
        let mut text = format!("{} ended by itself: {}", self.name, self.status);
        if !self.tail.is_empty() {
            text.push_str("\nits last words:\n");
            text.push_str(&self.tail);
        }
        miette!("{text}")
    }
}

/// Whether the scenario's task is a tip path.
fn is_tip(task: &Task) -> bool {
    matches!(task, Task::Tip { .. })
}
