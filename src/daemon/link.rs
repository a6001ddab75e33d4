//! Between the control thread and the bus thread, beside the cables' own data: what the drives do, what they shall do.
//! Wait-free on both sides.

use crate::control::{DrivesCommand, DrivesInput};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, AtomicU64, Ordering};
use triple_buffer::{Input, Output, triple_buffer};

/// What the control thread wants of the drives.
#[derive(Debug, Default)]
struct Wanted {
    on: AtomicBool,
    resets: AtomicU32,
    disarmed: AtomicBool,
}

/// The control thread's end.
#[derive(Debug)]
pub(crate) struct DrivesLink {
    input: Output<DrivesInput>,
    wanted: Arc<Wanted>,
}

/// The bus thread's end.
#[derive(Debug)]
pub(crate) struct DrivesEnd {
    input: Input<DrivesInput>,
    wanted: Arc<Wanted>,
    resets_seen: u32,
}

/// Both ends.
pub(crate) fn drives_link() -> (DrivesLink, DrivesEnd) {
    let (to, from) = triple_buffer(&DrivesInput::default());
    let wanted = Arc::new(Wanted { disarmed: AtomicBool::new(true), ..Wanted::default() });
    (DrivesLink { input: from, wanted: wanted.clone() }, DrivesEnd { input: to, wanted, resets_seen: 0 })
}

impl DrivesLink {
    /// The drives' newest state.
    pub(crate) fn read(&mut self) -> DrivesInput {
        *self.input.read()
    }

    /// Hands over a tick's command; it counts from the feedback of the SYNC that follows.
    pub(crate) fn command(&self, command: DrivesCommand, disarmed: bool) {
        self.wanted.on.store(command == DrivesCommand::On, Ordering::Release);
        self.wanted.disarmed.store(disarmed, Ordering::Release);
        if command == DrivesCommand::Reset {
            self.reset();
        }
    }

    /// Asks for a reset of the drives' faults.
    pub(crate) fn reset(&self) {
        self.wanted.resets.fetch_add(1, Ordering::AcqRel);
    }
}

impl DrivesEnd {
    pub(crate) fn write(&mut self, input: DrivesInput) {
        self.input.write(input);
    }

    /// Whether the drives shall give torque.
    pub(crate) fn wants_torque(&self) -> bool {
        self.wanted.on.load(Ordering::Acquire)
    }

    /// Whether nothing is under way, so that drives may be started over.
    pub(crate) fn is_disarmed(&self) -> bool {
        self.wanted.disarmed.load(Ordering::Acquire)
    }

    /// Whether faults shall be reset; true once for each time that it was commanded.
    pub(crate) fn take_reset(&mut self) -> bool {
        let resets = self.wanted.resets.load(Ordering::Acquire);
        std::mem::replace(&mut self.resets_seen, resets) != resets
    }
}

/// Where the loop's time comes from, as the threads beside the control thread need it.
#[derive(Debug, Clone)]
pub(crate) enum LoopTime {
    /// CLOCK_MONOTONIC.
    Clock,
    /// Ticks times the period, moved by the control thread.
    Lockstep(Arc<AtomicU64>),
}

impl LoopTime {
    pub(crate) fn new(lockstep: bool) -> Self {
        if lockstep { Self::Lockstep(Arc::default()) } else { Self::Clock }
    }

    pub(crate) fn now_ns(&self) -> u64 {
        match self {
            Self::Clock => sinew_hal::clock::monotonic_ns(),
            Self::Lockstep(now) => now.load(Ordering::Acquire),
        }
    }

    /// Moves a lockstep clock.
    pub(crate) fn advance_to(&self, now_ns: u64) {
        if let Self::Lockstep(now) = self {
            now.store(now_ns, Ordering::Release);
        }
    }

    pub(crate) fn is_lockstep(&self) -> bool {
        matches!(self, Self::Lockstep(_))
    }
}

/// What all threads look at to know whether to go on.
#[derive(Debug, Default)]
pub(crate) struct Progress {
    /// Ramp down, disarm, end.
    pub(crate) stop: AtomicBool,
    /// Ticks done.
    pub(crate) ticks: AtomicU64,
    /// 1: the control thread has ended; 2: in a fault.
    ended: AtomicU8,
    /// The bus thread has ended, by itself or not: no encoders will come.
    pub(crate) bus_gone: AtomicBool,
    /// The bus thread may end.
    pub(crate) bus_stop: AtomicBool,
    /// The I/O thread may end.
    pub(crate) io_stop: AtomicBool,
    /// The operator thread may end.
    pub(crate) operator_stop: AtomicBool,
}

impl Progress {
    pub(crate) fn end(&self, faulted: bool) {
        self.ended.store(1 + u8::from(faulted), Ordering::Release);
    }

    /// `None` while the control thread runs; then whether it ended in a fault.
    pub(crate) fn ended(&self) -> Option<bool> {
        match self.ended.load(Ordering::Acquire) {
            0 => None,
            n => Some(n == 2),
        }
    }
}
