//! `sinew leash`: ties a program's life to that of its parent, then becomes the program.
//!
//! The kernel sends SIGTERM when the parent ends, however it ends; the wish survives the change of program. Between the
//! parent's fork and this wish the parent may have gone: then its id is another's, and the program is not started.

use super::Outcome;
use clap::Args;
use miette::{IntoDiagnostic, WrapErr, miette};
use std::ffi::OsString;
use std::os::unix::process::CommandExt;

/// Arguments of `sinew leash`.
#[derive(Debug, Args)]
pub(crate) struct Leash {
    /// Process id of the parent.
    parent: u32,
    /// Program and its arguments.
    #[arg(last = true, required = true)]
    command: Vec<OsString>,
}

impl Leash {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM)).into_diagnostic()?;
        let parent = rustix::process::getppid().map_or(0, |pid| pid.as_raw_nonzero().get().unsigned_abs());
        if parent != self.parent {
            return Err(miette!("the parent has gone"));
        }
        let Some((program, arguments)) = self.command.split_first() else { return Err(miette!("no program")) };
        // Comes back only if it failed.
        Err(std::process::Command::new(program).args(arguments).exec())
            .into_diagnostic()
            .wrap_err_with(|| format!("{}", program.display()))
    }
}
