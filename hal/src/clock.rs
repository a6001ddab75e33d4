//! Time as an argument: what sleeps and what is stamped asks a [`Clock`], never the operating system.
//!
//! Enters: absolute times in nanoseconds. Leaves: the same. Two clocks: [`Monotonic`] is CLOCK_MONOTONIC with
//! `clock_nanosleep` to absolute deadlines (a late wake-up does not shift the next one); [`Lockstep`] is moved by whoever
//! owns the simulation, so that a run is reproducible bit for bit and as fast as it computes.
//! Must never: read the wall clock, which can be set back while the loop runs.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::io::Errno;
use rustix::thread::ClockId;
use rustix::time::Timespec;

/// A time in nanoseconds, to the nearest; 0 for what is negative or no number.
pub fn seconds_to_ns(seconds: f64) -> u64 {
    (1e9 * seconds).round() as u64
}

/// CLOCK_MONOTONIC now (ns). Does not allocate; about 25 ns through the vDSO.
pub fn monotonic_ns() -> u64 {
    read(libc::CLOCK_MONOTONIC)
}

/// CLOCK_REALTIME now (ns since the epoch); only for the conversion of stamps that the kernel gives in it.
pub(crate) fn realtime_ns() -> u64 {
    read(libc::CLOCK_REALTIME)
}

/// The C library's call and not rustix's, which allocates at its first use on kernels before 6.4 to find the vDSO.
fn read(clock: libc::clockid_t) -> u64 {
    let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the pointer is to a live structure. It cannot fail: both clocks exist on every Linux.
    unsafe { libc::clock_gettime(clock, &raw mut t) };
    to_ns(t.tv_sec, t.tv_nsec)
}

#[allow(clippy::cast_sign_loss)] // clamped to zero first; the kernel gives no negative times here
fn to_ns(seconds: i64, nanoseconds: i64) -> u64 {
    (seconds.max(0) as u64).saturating_mul(1_000_000_000).saturating_add(nanoseconds.max(0) as u64)
}

/// A time in ns as the kernel's structure; times beyond what it can hold become its largest.
#[allow(clippy::cast_possible_wrap)] // u64::MAX / 1e9 is far below i64::MAX, and the rest is below 1e9
pub(crate) fn timespec(ns: u64) -> Timespec {
    Timespec { tv_sec: (ns / 1_000_000_000) as _, tv_nsec: (ns % 1_000_000_000) as _ }
}

/// Where a loop gets its time from.
pub trait Clock: Send + Sync {
    /// Now (ns, arbitrary origin, never goes back). Does not allocate.
    fn now_ns(&self) -> u64;

    /// Sleeps until `deadline_ns` (same origin); returns at once if it has passed. Does not allocate.
    fn sleep_until(&self, deadline_ns: u64);
}

/// CLOCK_MONOTONIC.
#[derive(Debug, Clone, Copy, Default)]
pub struct Monotonic;

impl Clock for Monotonic {
    fn now_ns(&self) -> u64 {
        monotonic_ns()
    }

    fn sleep_until(&self, deadline_ns: u64) {
        let deadline = timespec(deadline_ns);
        // An absolute sleep interrupted by a signal is simply repeated; any other error cannot happen with a valid time.
        while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &deadline) == Err(Errno::INTR) {}
    }
}

/// Longest that [`Naps`] looks again at once, and its shortest and longest nap (ns).
const LOOK_NS: u64 = 200_000;
const NAP_NS: u64 = 20_000;
const NAP_NS_MAX: u64 = 5_000_000;
/// A nap is this part of the wait so far.
const NAP_PART: u64 = 32;

/// How to wait in real time for another thread or process that cannot wake the one who waits: by looking again, at first
/// at once, then after naps that grow with the wait. That makes no wait much longer, and keeps no processor from who
/// computes what is waited for: an emulated or busy machine may need it. Does not allocate.
#[derive(Debug, Clone, Copy)]
pub struct Naps {
    since_ns: u64,
}

impl Naps {
    /// A wait that begins now.
    #[must_use]
    pub fn begin() -> Self {
        Self { since_ns: monotonic_ns() }
    }

    /// How long it has lasted (ns).
    pub fn waited_ns(&self) -> u64 {
        monotonic_ns().saturating_sub(self.since_ns)
    }

    /// How long the next nap is; zero at first.
    pub fn length(&self) -> Duration {
        let waited_ns = self.waited_ns();
        if waited_ns < LOOK_NS {
            return Duration::ZERO;
        }
        Duration::from_nanos((waited_ns / NAP_PART).clamp(NAP_NS, NAP_NS_MAX))
    }

    /// Leaves the processor until the next look.
    pub fn nap(&self) {
        match self.length() {
            Duration::ZERO => std::thread::yield_now(),
            length => std::thread::sleep(length),
        }
    }
}

/// A clock that stands still until it is told otherwise.
#[derive(Debug, Default)]
pub struct Lockstep {
    now_ns: Mutex<u64>,
    moved: Condvar,
}

impl Lockstep {
    /// A clock that shows `start_ns`.
    pub fn new(start_ns: u64) -> Self {
        Self { now_ns: Mutex::new(start_ns), moved: Condvar::new() }
    }

    /// Moves the clock to `now_ns` and wakes every sleeper whose deadline that reaches. An earlier time is ignored:
    /// the clock never goes back.
    pub fn advance_to(&self, now_ns: u64) {
        let mut now = self.lock();
        *now = now_ns.max(*now);
        self.moved.notify_all();
    }

    /// Moves the clock forward.
    pub fn advance_by(&self, step_ns: u64) {
        let mut now = self.lock();
        *now = now.saturating_add(step_ns);
        self.moved.notify_all();
    }

    /// A panic elsewhere cannot leave a plain number half written, so a poisoned lock is as good as any.
    fn lock(&self) -> MutexGuard<'_, u64> {
        self.now_ns.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Clock for Lockstep {
    fn now_ns(&self) -> u64 {
        *self.lock()
    }

    fn sleep_until(&self, deadline_ns: u64) {
        let mut now = self.lock();
        while *now < deadline_ns {
            now = self.moved.wait(now).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn naps_grow_with_the_wait_up_to_the_longest() {
        let after = |waited_ns: u64| Naps { since_ns: monotonic_ns() - waited_ns }.length();
        assert!(after(64_000_000) >= Duration::from_millis(2));
        assert_eq!(after(1_000_000_000), Duration::from_nanos(NAP_NS_MAX));
        let waits = Naps::begin();
        while waits.length() == Duration::ZERO {
            waits.nap();
        }
        assert!(waits.waited_ns() >= LOOK_NS && waits.length() >= Duration::from_nanos(NAP_NS));
    }

    #[test]
    fn a_monotonic_sleep_never_ends_before_its_deadline() {
        for step in [0, 1_000, 200_000, 3_000_000] {
            let deadline = Monotonic.now_ns() + step;
            Monotonic.sleep_until(deadline);
            assert!(Monotonic.now_ns() >= deadline);
        }
        Monotonic.sleep_until(0);
    }

    #[test]
    fn a_lockstep_sleeper_wakes_exactly_when_the_clock_reaches_its_deadline() {
        let clock = Arc::new(Lockstep::new(100));
        clock.sleep_until(100);
        let sleeper = {
            let clock = Arc::clone(&clock);
            std::thread::spawn(move || {
                clock.sleep_until(250);
                clock.now_ns()
            })
        };
        clock.advance_to(249);
        assert_eq!(clock.now_ns(), 249);
        assert!(!sleeper.is_finished());
        clock.advance_by(1);
        assert_eq!(sleeper.join().unwrap(), 250);
        clock.advance_to(10);
        assert_eq!(clock.now_ns(), 250, "the clock went back");
    }

    #[test]
    fn times_survive_the_kernels_structure() {
        for ns in [0, 1, 999_999_999, 1_000_000_000, 1_000_000_001, u64::MAX] {
            let t = timespec(ns);
            assert_eq!(to_ns(t.tv_sec, t.tv_nsec), ns);
        }
    }
}
