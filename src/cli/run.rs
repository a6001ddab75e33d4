//! `sinew run`: the daemon.

use super::{Outcome, complain};
use clap::Args;
use miette::IntoDiagnostic;
use sinew::config::{BusKind, Config};
use sinew::daemon::{AutoRequests, Daemon, Ending, Heart, LockstepOptions, Options};
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
    /// Write everything as an MCAP recording.
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
        let config = Config::load(&self.config)?;
        let lockstep = self.lockstep.then(|| LockstepOptions {
            obstacles: self.await_obstacles,
            target: self.await_target,
            timeout: self.await_timeout.map(Duration::from_secs_f64),
        });
        let options = Options {
            lockstep,
            record: self.record,
            seed: self.seed,
            auto: AutoRequests { arm: self.arm_on_start, track: self.track_on_start },
            ticks: self.ticks,
            around_tick: None,
            start_tensions_n: self.start_tensions,
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
                return Ok(Outcome::Unusable);
            }
        };
        let period_ms = 1e3 * config.timing.period_s;
        complain(format_args!("sinew: arm \"{}\", {period_ms} ms period; stop with Ctrl-C", config.ipc.arm));
        let mut heart = Heart::new();
        match daemon.wait(&stop, |ticks| heart.beat(ticks, stop.load(Ordering::Relaxed))) {
            Ok(Ending::Stopped) => Ok(Outcome::Done),
            Ok(Ending::Faulted) => {
                complain("sinew: stopped with a fault latched");
                Ok(Outcome::Failed)
            }
            Err(error) => {
                complain(format_args!("sinew run: {error}"));
                Ok(Outcome::Failed)
            }
        }
    }
}
