//! `sinew run`: the daemon.

use super::{Outcome, complain, log};
use clap::Args;
use miette::IntoDiagnostic;
use rustix::process::Signal;
use sinew::config::{BusKind, Config};
use sinew::daemon::{AutoRequests, Daemon, DaemonError, Ending, Heart, LockstepOptions, Options};
use sinew_hal::bus_error;
use sinew_hal::realtime::leave_processor;
use sinew_hal::virtual_bus::{Claim, Role, claim};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Arguments of `sinew run`.
#[derive(Debug, Args)]
pub(crate) struct Run {
    /// Configuration files; together they hold all tables.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    config: Vec<PathBuf>,
    /// Write everything as an MCAP recording: a file that is not there yet, or a folder, in which it is named by arm and
    /// start time. `[recording]` bounds it.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Seed of the planner's random numbers.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Time by ticks: as fast as the plant and the clients answer, the same bit for bit for the same seed.
    #[arg(long)]
    lockstep: bool,
    /// Lockstep: obstacle source that sends a set for every tick.
    #[arg(long, value_name = "SOURCE", num_args = 1.., value_delimiter = ',', requires = "lockstep")]
    await_obstacles: Vec<u32>,
    /// Lockstep: a task client sends a target for every tick.
    #[arg(long, requires = "lockstep")]
    await_target: bool,
    /// Lockstep: real time after which a source that does not deliver is no longer waited for (s).
    #[arg(long, value_name = "SECONDS", requires = "lockstep", value_parser = super::positive_seconds)]
    await_timeout: Option<f64>,
    /// Arm as soon as the drives are ready, once.
    #[arg(long)]
    arm_on_start: bool,
    /// Track as soon as the arm holds and there is a target, once.
    #[arg(long)]
    track_on_start: bool,
    /// Stop in order when so many ticks are done.
    #[arg(long, value_name = "N")]
    ticks: Option<u64>,
    /// Tensions (N), one per cable, to which arming brings the cables; default: the arm's least ones.
    #[arg(long, value_name = "N", num_args = 1.., value_delimiter = ',')]
    start_tensions: Option<Vec<f64>>,
}

impl Run {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            // The second one ends the process at once; the drives then take themselves to the safe torque.
            signal_hook::flag::register_conditional_shutdown(signal, 1, stop.clone()).into_diagnostic()?;
            signal_hook::flag::register(signal, stop.clone()).into_diagnostic()?;
        }
        // A file that is too long for a limit of the process (`ulimit -f`) is an error of the recording, not the end.
        signal_hook::flag::register(Signal::XFSZ.as_raw(), Arc::default()).into_diagnostic()?;
        bus_error::say_and_exit(70).into_diagnostic()?;
        let config = Config::load(&self.config)?;
        let lockstep = self.lockstep.then(|| LockstepOptions {
            obstacles: self.await_obstacles,
            target: self.await_target,
            timeout: self.await_timeout.map(Duration::from_secs_f64),
        });
        let options = Options {
            lockstep,
            configuration: self.record.is_some().then(|| one_text(&self.config)),
            record: self.record,
            seed: self.seed,
            auto: AutoRequests { arm: self.arm_on_start, track: self.track_on_start },
            ticks: self.ticks,
            around_tick: None,
            start_tensions_n: self.start_tensions,
        };
        if let (Some(cpu), None) = (config.timing.cpu, &options.lockstep) {
            // As the daemon does for its threads: the log's starts before them.
            leave_processor(cpu);
        }
        let mut log = match log::Queue::start() {
            Ok(log) => log,
            Err(error) => {
                complain(format_args!("sinew run: no thread can be started: {error}; see `ulimit -u`"));
                return Ok(Outcome::Unusable);
            }
        };
        let virtual_buses = config.drives.buses.iter().filter(|bus| bus.kind == BusKind::Virtual);
        let claims: Result<Vec<Claim>, _> = virtual_buses.map(|bus| claim(&bus.interface, Role::Master)).collect();
        // Before the daemon's first word on the bus, which resets the drives; held to the end.
        let _claims = match claims {
            Ok(claims) => claims,
            Err(error) => {
                complain(format_args!("sinew run: {error}"));
                return Ok(Outcome::Unusable);
            }
        };
        let daemon = match Daemon::start(&config, &options) {
            Ok(daemon) => daemon,
            Err(error) => {
                complain(format_args!("sinew run: {error}"));
                return Ok(if is_defect(&error) { Outcome::Defect } else { Outcome::Unusable });
            }
        };
        let (arm, period_ms) = (&config.ipc.arm, 1e3 * config.timing.period_s);
        complain(format_args!("sinew: arm \"{arm}\", {period_ms} ms period; stop with Ctrl-C"));
        let mut heart = Heart::new();
        let beat = |ticks| {
            heart.beat(ticks, stop.load(Ordering::Relaxed));
            log.tell();
        };
        match daemon.wait(&stop, beat) {
            Ok(Ending::Stopped) => Ok(Outcome::Done),
            Ok(Ending::Faulted) => {
                complain("sinew: stopped with a fault latched");
                Ok(Outcome::Failed)
            }
            Err(error) => {
                complain(format_args!("sinew run: {error}"));
                Ok(match error {
                    DaemonError::RecordingEnded => Outcome::Unusable,
                    error if is_defect(&error) => Outcome::Defect,
                    _ => Outcome::Failed,
                })
            }
        }
    }
}

/// Files with a table each, or several, as one that can be loaded again. They have just been read; one that is gone by now is
/// left out.
fn one_text(paths: &[PathBuf]) -> String {
    let part = |path: &PathBuf| Some(format!("# {}\n{}\n", path.display(), std::fs::read_to_string(path).ok()?));
    paths.iter().filter_map(part).collect()
}

/// A defect is worth a new start by the service manager, what a person must look at is not.
fn is_defect(error: &DaemonError) -> bool {
    matches!(error, DaemonError::Panic { .. })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::ExitCode;

    #[test]
    fn a_panic_has_an_exit_code_that_the_unit_starts_over() {
        assert!(is_defect(&DaemonError::Panic { name: "sinew-bus" }));
        assert!(!is_defect(&DaemonError::NoDrives { waited_s: 30.0, ready: 0, drives: 24 }));
        assert_eq!(format!("{:?}", ExitCode::from(Outcome::Defect)), format!("{:?}", ExitCode::from(70)));
        // The unit names the codes that are for people; 70 is none of them.
        let unit = include_str!("../../config/sinew.service");
        assert!(unit.contains("\nRestart=on-failure\n") && unit.contains("\nRestartPreventExitStatus=1 2\n"));
    }
}
