//! What the commands that talk to a running daemon have in common.

use super::{Outcome, complain, print_text};
use clap::Args;
use miette::{IntoDiagnostic, WrapErr};
use rustix::process::{Gid, Uid, geteuid};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};
use sinew::config::Config;
use sinew::control::Fault;
use sinew::daemon;
use sinew::daemon::operator::Address;
use sinew::ipc::payload::{RefusalReason, Response};
use sinew::ipc::{Client, Domain, IpcError};
use sinew_hal::bus_error;
use sinew_hal::peer::{group_of, user_text};
use std::path::PathBuf;
use std::time::Duration;

/// Which daemon.
#[derive(Debug, Args)]
pub(crate) struct Which {
    /// Name of the arm (`arm.name`).
    #[arg(long, default_value = "paper", conflicts_with = "config")]
    arm: String,
    /// The daemon's configuration files, in place of `--arm`, where `[ipc]` is not the default.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    config: Vec<PathBuf>,
}

/// Longest wait for an answer.
pub(crate) const ANSWER: Duration = Duration::from_secs(5);

impl Which {
    /// Names and places of the daemon.
    pub(crate) fn find(&self) -> miette::Result<Found> {
        if self.config.is_empty() {
            let (domain, arm) = (Domain::from_env(), self.arm.clone());
            domain.check().into_diagnostic()?;
            return Ok(Found { address: Address::new(&domain, &arm, None), domain, arm });
        }
        let config = Config::load(&self.config)?;
        daemon::domain(&config).check().into_diagnostic()?;
        Ok(Found { address: daemon::address(&config), domain: daemon::domain(&config), arm: config.ipc.arm })
    }

    /// The daemon's configuration, where its files were given.
    pub(crate) fn config(&self) -> miette::Result<Option<Config>> {
        if self.config.is_empty() { Ok(None) } else { Ok(Some(Config::load(&self.config)?)) }
    }

    /// The daemon, where its shared memory is another user's and this one is not root: then all goes over the socket.
    pub(crate) fn foreign(&self) -> miette::Result<Option<Found>> {
        let found = self.find()?;
        let uid = geteuid();
        let owner = if uid.is_root() { None } else { found.address.owner() };
        Ok(owner.filter(|owner| *owner != uid.as_raw()).map(|_| found))
    }

    /// Connects to the daemon's shared memory, which belongs to its user alone: root becomes that user first, for what
    /// root makes there the daemon cannot open.
    pub(crate) fn connect(&self) -> miette::Result<Result<Client, IpcError>> {
        let Found { address, domain, arm } = self.find()?;
        // For the last word where there is no room left in shared memory.
        bus_error::say_and_exit(2).into_diagnostic()?;
        if geteuid().is_root()
            && let Some(uid) = address.owner().filter(|uid| *uid != 0)
        {
            become_user(uid).into_diagnostic().wrap_err_with(|| format!("becoming user {}", user_text(uid)))?;
        }
        Ok(Client::connect(&domain, &arm))
    }
}

/// Names and places of a daemon.
#[derive(Debug)]
pub(crate) struct Found {
    /// Its socket.
    pub(crate) address: Address,
    /// Its shared memory.
    pub(crate) domain: Domain,
    /// Its arm.
    pub(crate) arm: String,
}

/// For good. The commands have one thread when they come here.
fn become_user(uid: u32) -> std::io::Result<()> {
    let (uid, gid) = (Uid::from_raw(uid), Gid::from_raw(group_of(uid)));
    set_thread_groups(&[gid])?;
    set_thread_res_gid(gid, gid, gid)?;
    set_thread_res_uid(uid, uid, uid)?;
    Ok(())
}

/// Says why there is no connection.
pub(crate) fn not_connected(error: &dyn std::error::Error) -> Outcome {
    complain(format_args!("sinew: {error}"));
    Outcome::Failed
}

/// Says how the daemon answered.
pub(crate) fn say(asked: &str, response: &Response) -> miette::Result<Outcome> {
    if response.is_accepted() {
        print_text(&format!("{asked}: {}\n", response.text()))?;
        return Ok(Outcome::Done);
    }
    let reason = RefusalReason::from_wire(response.reason);
    let why = match reason {
        // The text names the cause.
        Some(RefusalReason::BadTarget) | None => response.text(),
        Some(reason) => daemon::refusal_text(reason, response.detail),
    };
    complain(format_args!("{asked} refused: {why}"));
    if let Some(fault) = Fault::EXAMPLES.iter().find(|fault| fault.code() == response.fault_code) {
        complain(format_args!("fault {}: {}; {}", fault.code(), fault.what(), fault.remedy()));
    }
    Ok(Outcome::Failed)
}

/// A list of numbers separated by commas, as an argument.
pub(crate) fn numbers(text: &str) -> Result<Vec<f64>, String> {
    text.split(',')
        .map(|part| {
            let number: f64 = part.trim().parse().map_err(|_| format!("`{part}` is not a number"))?;
            if number.is_finite() { Ok(number) } else { Err(format!("`{part}` is not finite")) }
        })
        .collect()
}

/// The time of the newest record (ns), which is also right in lockstep; the clock's where none came.
pub(crate) fn loop_time_ns(client: &Client) -> miette::Result<u64> {
    let newest = client.states().into_diagnostic()?.wait(Duration::from_secs(2)).into_diagnostic()?;
    Ok(newest.map_or_else(sinew::ipc::monotonic_ns, |state| state.header.capture_ns))
}
