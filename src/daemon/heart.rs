//! The service manager's view of the loop: ready, alive, stopping (`sd_notify`); silent where there is no manager.
//!
//! Enters: the number of ticks done, now and then. Leaves: `READY=1` with the first tick, `WATCHDOG=1` as long as ticks
//! end, `STOPPING=1`. It must never be fed by anything but ticks: a control thread that hangs stops the pings, whatever
//! else still runs, and the service manager starts the daemon over.

use sd_notify::NotifyState;
use std::time::{Duration, Instant};

/// Tells the service manager that the loop lives. Belongs to the main thread.
#[derive(Debug)]
pub struct Heart {
    watchdog: Option<Duration>,
    ticks: u64,
    pinged: Instant,
    ready: bool,
    stopping: bool,
}

impl Default for Heart {
    fn default() -> Self {
        Self::new()
    }
}

impl Heart {
    /// With the watchdog's time from the environment (`WATCHDOG_USEC`), where the manager has set one.
    pub fn new() -> Self {
        let watchdog = sd_notify::watchdog_enabled();
        Self { watchdog, ticks: 0, pinged: Instant::now(), ready: false, stopping: false }
    }

    /// `ticks` are those done so far; to be called several times within the watchdog's time.
    pub fn beat(&mut self, ticks: u64, stopping: bool) {
        if stopping && !self.stopping {
            self.stopping = true;
            tell(NotifyState::Stopping);
        }
        if ticks == self.ticks {
            return;
        }
        self.ticks = ticks;
        if !self.ready {
            self.ready = true;
            tell(NotifyState::Ready);
        }
        // A third: one ping may be late and the next still in time; systemd advises half.
        if let Some(watchdog) = self.watchdog
            && self.pinged.elapsed() > watchdog / 3
        {
            self.pinged = Instant::now();
            tell(NotifyState::Watchdog);
        }
    }
}

fn tell(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::debug!(%error, "service manager not told");
    }
}
