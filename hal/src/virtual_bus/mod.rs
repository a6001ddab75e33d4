//! A CAN bus in user space: the same frames between processes over shared memory, for machines without CAN.
//!
//! Enters and leaves: [`Frame`]s, through a ring of 4096 slots in `/dev/shm/sinew-bus-<name>` that everybody maps.
//! A sender draws a ticket (the total order of the wire), fills that slot and publishes it; each handle has its own
//! cursor. There is no lock on this path and nobody to wait for:
//! - a receiver that falls a whole ring behind skips to the oldest frame there is and counts what it lost;
//! - a sender killed between ticket and publication leaves a gap. A receiver that meets one waits [`GAP_GRACE_NS`] and
//!   then declares the slot abandoned, for all receivers alike, so that either everybody sees a frame or nobody does.
//!   A sender that was only slow finds its slot abandoned and draws another ticket;
//! - a receiver that waits sleeps in a futex; a publication without sleepers makes no system call.
//!
//! As with SocketCAN (`CAN_RAW_RECV_OWN_MSGS` off) a handle does not hear its own frames, and every other handle does,
//! also a [`duplicate`](CanBus::duplicate) in the same process. The bus itself always carries FD, like a vcan of MTU 72;
//! a handle opened without `fd` neither sends nor hears FD frames.
//!
//! A role that only one process can have on a wire (master, drives) is [claimed](claim) beside the frames.
//!
//! Must never: block a sender, allocate after `open`, or trust a byte of the shared memory.

mod layout;
mod mapping;
#[cfg(test)]
mod tests;

use std::io;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{Ordering, fence};
use std::time::Duration;

use rustix::thread::futex;
use thiserror::Error;

use crate::can::{BusCounters, BusState, CanBus, Filter, FilterSet, Frame, Kind, ReceiveError, Received, SendError};
use crate::clock::{monotonic_ns, timespec};
use layout::{SLOTS, Stage, sequence};
use mapping::Mapping;

/// How long a receiver waits for a ticket that is drawn but not published (ns).
pub const GAP_GRACE_NS: u64 = 1_000_000;

/// Tickets that one `send` draws before it gives up; each failure means that receivers gave up on it meanwhile.
const TICKETS_MAX: u32 = 8;

/// Longest name of a bus.
const NAME_LEN_MAX: usize = 128;

/// Why a virtual bus did not open.
#[derive(Debug, Error)]
pub enum OpenVirtualError {
    /// The name cannot be part of a file name.
    #[error("virtual bus name {0:?}: expected 1 to 128 of A-Z a-z 0-9 . _ -, not beginning with a dot")]
    Name(String),
    /// The shared file cannot be opened, locked or mapped.
    #[error("virtual bus file {path}: {source}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// Somebody has the role on it that was wanted.
    #[error("virtual bus {name:?}: a process that {role} is already running; give this one a bus of another name")]
    Claimed {
        /// The bus's name.
        name: String,
        /// What the other process does.
        role: &'static str,
    },
    /// Another version of this program is using a bus of that name.
    #[error("virtual bus file {path} is in use with layout version {version}, expected {expected}", path = path.display())]
    Layout {
        /// The file.
        path: PathBuf,
        /// Version found; 0 if it is no bus at all.
        version: u32,
        /// Version of this program.
        expected: u32,
    },
}

/// What only one process on a bus can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Commands the drives.
    Master,
    /// Stands for the drives.
    Drives,
}

impl Role {
    const fn text(self) -> &'static str {
        match self {
            Self::Master => "commands its drives",
            Self::Drives => "stands for its drives",
        }
    }
}

/// A role on a bus, for as long as this lives: the kernel takes it back even from a process that was killed.
pub struct Claim {
    _mapping: Mapping,
}

/// Takes a role on the bus of this name, making the bus if nobody has it open. On a wire two masters would command the
/// same drives, and two drives answer to one node id; here the second one is told.
///
/// # Errors
/// Another process, or another claim of this one, has the role; otherwise as [`VirtualBus::open`].
pub fn claim(name: &str, role: Role) -> Result<Claim, OpenVirtualError> {
    let path = path_of(name)?;
    let mapping = Mapping::open(&path)?;
    match mapping.claim(role as u8) {
        Ok(true) => Ok(Claim { _mapping: mapping }),
        Ok(false) => Err(OpenVirtualError::Claimed { name: name.into(), role: role.text() }),
        Err(source) => Err(OpenVirtualError::File { path, source }),
    }
}

/// Whether a process has a role on the bus of this name. Where that cannot be told, it has not.
pub fn is_claimed(name: &str, role: Role) -> bool {
    path_of(name).is_ok_and(|path| mapping::is_claimed(&path, role as u8).unwrap_or(false))
}

/// A handle on a virtual bus.
pub struct VirtualBus {
    shared: Arc<Mapping>,
    participant: u64,
    fd: bool,
    filters: FilterSet,
    cursor: u64,
    /// Tickets below this one were drawn at `gap_since_ns` at the latest.
    gap_head: u64,
    gap_since_ns: u64,
    /// State that `receive` has reported.
    state_seen: BusState,
    counters: BusCounters,
}

/// The file behind a name.
///
/// # Errors
/// The name is no file name.
pub fn path_of(name: &str) -> Result<PathBuf, OpenVirtualError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    if name.is_empty() || name.len() > NAME_LEN_MAX || name.starts_with('.') || !name.chars().all(allowed) {
        return Err(OpenVirtualError::Name(name.into()));
    }
    Ok(Path::new("/dev/shm").join(format!("sinew-bus-{name}")))
}

/// Removes what a killed process left of a bus; false if there was nothing or somebody uses it.
///
/// # Errors
/// The name, or the operating system.
pub fn remove_stale(name: &str) -> Result<bool, OpenVirtualError> {
    let path = path_of(name)?;
    mapping::remove_stale(&path).map_err(|source| OpenVirtualError::File { path, source })
}

impl VirtualBus {
    /// Joins the bus of this name, making it if nobody has it open. Hears what is sent from now on.
    ///
    /// # Errors
    /// [`OpenVirtualError`].
    pub fn open(name: &str, fd: bool) -> Result<Self, OpenVirtualError> {
        Ok(Self::on(Arc::new(Mapping::open(&path_of(name)?)?), fd))
    }

    fn on(shared: Arc<Mapping>, fd: bool) -> Self {
        let header = shared.header();
        let participant = header.participants.fetch_add(1, Ordering::Relaxed);
        let cursor = header.head.load(Ordering::Acquire);
        let state_seen = BusState::ErrorActive;
        Self {
            participant,
            fd,
            filters: FilterSet::default(),
            cursor,
            gap_head: cursor,
            gap_since_ns: 0,
            state_seen,
            counters: BusCounters::default(),
            shared,
        }
    }

    /// Puts the whole bus, for everybody, into a state; what tests and demonstrations of faults use.
    pub fn set_state(&self, state: BusState) {
        self.shared.header().state.store(layout::state_word(state), Ordering::SeqCst);
        self.wake_all();
    }

    /// Announces a change to whoever sleeps.
    fn wake_all(&self) {
        let wake = &self.shared.header().wake;
        // One atomic step counts the event up and takes the sleepers' mark away: a receiver that marked itself before
        // is woken, one that does so after sees the new count.
        let mut old = wake.load(Ordering::SeqCst);
        while let Err(now) =
            wake.compare_exchange_weak(old, (old & !1).wrapping_add(2), Ordering::SeqCst, Ordering::SeqCst)
        {
            old = now;
        }
        if old & 1 == 1 {
            // Waking cannot fail on mapped memory, and there would be nothing to do about it.
            let _ = futex::wake(wake, futex::Flags::empty(), i32::MAX as u32);
        }
    }

    /// Draws a ticket, fills its slot and publishes it; false if receivers abandoned the ticket meanwhile.
    fn publish(&self, words: &layout::Words) -> bool {
        let ticket = self.shared.header().head.fetch_add(1, Ordering::AcqRel);
        let slot = self.shared.slot(ticket);
        // Before the mark: a sender that loses its processor while it writes may come back a whole ring later and damage
        // another's frame, which its checksum tells. A clock that is a system call would be where that happens.
        let time_ns = monotonic_ns();
        let writing = sequence(ticket, Stage::Writing);
        let mut old = slot.sequence.load(Ordering::Acquire);
        loop {
            if old >= writing {
                return false;
            }
            match slot.sequence.compare_exchange_weak(old, writing, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => break,
                Err(now) => old = now,
            }
        }
        // No store to the content may become visible before the mark "being written".
        fence(Ordering::Release);
        slot.sender.store(self.participant, Ordering::Relaxed);
        slot.time_ns.store(time_ns, Ordering::Relaxed);
        slot.head.store(words.head, Ordering::Relaxed);
        for (to, from) in slot.data.iter().zip(words.data) {
            to.store(from, Ordering::Relaxed);
        }
        slot.checksum.store(layout::checksum(ticket, self.participant, time_ns, words), Ordering::Relaxed);
        let published = sequence(ticket, Stage::Published);
        slot.sequence.compare_exchange(writing, published, Ordering::Release, Ordering::Relaxed).is_ok()
    }

    /// The next frame for this handle, if there is one. Looks at no more than two rings' worth of slots.
    fn next(&mut self) -> Next {
        for _ in 0..2 * SLOTS {
            let head = self.shared.header().head.load(Ordering::Acquire);
            let behind = head.wrapping_sub(self.cursor);
            if behind == 0 {
                return Next::Empty;
            }
            if behind > u64::MAX / 2 {
                // The order went back: only damage does that. Start from what there is.
                self.counters.lost = self.counters.lost.saturating_add(1);
                self.cursor = head;
                return Next::Empty;
            }
            if behind > SLOTS {
                self.counters.lost = self.counters.lost.saturating_add(behind - SLOTS);
                self.cursor = head.wrapping_sub(SLOTS);
            }
            let (ticket, published) = (self.cursor, sequence(self.cursor, Stage::Published));
            let sequence_now = self.shared.slot(ticket).sequence.load(Ordering::Acquire);
            if sequence_now < published {
                match self.gap(ticket, head, sequence_now) {
                    Some(until_ns) => return Next::Pending { until_ns },
                    None => continue,
                }
            }
            self.cursor = self.cursor.wrapping_add(1);
            if sequence_now == sequence(ticket, Stage::Abandoned) {
                self.counters.errors = self.counters.errors.saturating_add(1);
                continue;
            }
            match self.read(ticket, published) {
                Ok(Some(received)) => {
                    self.counters.received = self.counters.received.saturating_add(1);
                    return Next::Frame(received);
                }
                Ok(None) => {}
                Err(Unreadable::Overtaken) => self.counters.lost = self.counters.lost.saturating_add(1),
                Err(Unreadable::Damaged) => self.counters.errors = self.counters.errors.saturating_add(1),
            }
        }
        Next::Empty
    }

    /// A ticket drawn but not published: waits for the sender (`Some` until when), or gives it up (`None`: look again).
    fn gap(&mut self, ticket: u64, head: u64, sequence_now: u64) -> Option<u64> {
        let now_ns = monotonic_ns();
        if !(1..=SLOTS).contains(&self.gap_head.wrapping_sub(ticket)) {
            (self.gap_head, self.gap_since_ns) = (head, now_ns);
        }
        let until_ns = self.gap_since_ns.saturating_add(GAP_GRACE_NS);
        if now_ns < until_ns {
            return Some(until_ns);
        }
        let abandoned = sequence(ticket, Stage::Abandoned);
        // If this fails the sender has just come to life, or another receiver was first: either way look again.
        let _ = self.shared.slot(ticket).sequence.compare_exchange(
            sequence_now,
            abandoned,
            Ordering::AcqRel,
            Ordering::Relaxed,
        );
        None
    }

    /// The content of a published slot; `None` if it is not for this handle.
    fn read(&self, ticket: u64, published: u64) -> Result<Option<Received>, Unreadable> {
        let slot = self.shared.slot(ticket);
        let sender = slot.sender.load(Ordering::Relaxed);
        let time_ns = slot.time_ns.load(Ordering::Relaxed);
        let mut words = layout::Words { head: slot.head.load(Ordering::Relaxed), data: [0; 8] };
        for (to, from) in words.data.iter_mut().zip(&slot.data) {
            *to = from.load(Ordering::Relaxed);
        }
        let checksum = slot.checksum.load(Ordering::Relaxed);
        // The loads above happen before the sequence is looked at again.
        fence(Ordering::Acquire);
        if slot.sequence.load(Ordering::Relaxed) != published {
            return Err(Unreadable::Overtaken);
        }
        if checksum != layout::checksum(ticket, sender, time_ns, &words) {
            return Err(Unreadable::Damaged);
        }
        if sender == self.participant {
            return Ok(None);
        }
        let frame = layout::decode(&words).ok_or(Unreadable::Damaged)?;
        let wanted = self.filters.passes(frame.id()) && (self.fd || !matches!(frame.kind(), Kind::Fd { .. }));
        Ok(wanted.then_some(Received { frame, time_ns }))
    }

    /// What a receive that found nothing says.
    fn nothing(&self) -> Result<Option<Received>, ReceiveError> {
        let state = self.state();
        if state.carries_frames() { Ok(None) } else { Err(ReceiveError::Bus(state)) }
    }

    /// `Err` if the bus has gone down and this handle has not said so yet; remembers the state.
    fn report_change(&mut self) -> Result<(), ReceiveError> {
        let state = self.state();
        if state == self.state_seen {
            return Ok(());
        }
        self.state_seen = state;
        if state != BusState::ErrorActive {
            self.counters.errors = self.counters.errors.saturating_add(1);
        }
        state.carries_frames().then_some(()).ok_or(ReceiveError::Bus(state))
    }
}

/// What lies at a handle's cursor.
enum Next {
    Frame(Received),
    Empty,
    /// A sender has drawn the ticket and not published it.
    Pending {
        until_ns: u64,
    },
}

/// Why a slot gave nothing.
enum Unreadable {
    /// Written again meanwhile.
    Overtaken,
    /// Not what a sender writes.
    Damaged,
}

impl CanBus for VirtualBus {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let state = self.state();
        if !state.carries_frames() {
            return Err(SendError::Bus(state));
        }
        if matches!(frame.kind(), Kind::Fd { .. }) && !self.fd {
            return Err(SendError::Unsupported);
        }
        let words = layout::encode(frame);
        for _ in 0..TICKETS_MAX {
            if self.publish(&words) {
                self.wake_all();
                self.counters.sent = self.counters.sent.saturating_add(1);
                return Ok(());
            }
        }
        self.counters.refused = self.counters.refused.saturating_add(1);
        Err(SendError::Full)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, ReceiveError> {
        if let Next::Frame(received) = self.next() {
            return Ok(Some(received));
        }
        if timeout.is_zero() {
            // A poll leaves no mark, which would cost the next sender a system call.
            self.report_change()?;
            return self.nothing();
        }
        let deadline_ns = monotonic_ns().saturating_add(u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX));
        loop {
            // Mark first, then look: whatever comes after the look changes the word, and the sleep ends at once.
            let word = self.shared.header().wake.fetch_or(1, Ordering::SeqCst) | 1;
            let until_ns = match self.next() {
                Next::Frame(received) => return Ok(Some(received)),
                Next::Empty => deadline_ns,
                Next::Pending { until_ns } => until_ns.min(deadline_ns),
            };
            self.report_change()?;
            if monotonic_ns() >= deadline_ns {
                return self.nothing();
            }
            match futex::wait_bitset(
                &self.shared.header().wake,
                futex::Flags::empty(),
                word,
                Some(&timespec(until_ns)),
                NonZeroU32::MAX,
            ) {
                // Woken, changed before sleeping, a signal, or time: each is decided by looking again.
                Ok(()) | Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR | rustix::io::Errno::TIMEDOUT) => {}
                Err(e) => return Err(ReceiveError::Os(e.raw_os_error())),
            }
        }
    }

    fn state(&self) -> BusState {
        layout::state_from(self.shared.header().state.load(Ordering::Acquire))
    }

    fn counters(&self) -> BusCounters {
        self.counters
    }

    fn set_filters(&mut self, filters: &[Filter]) -> Result<(), ReceiveError> {
        self.filters = FilterSet::new(filters);
        Ok(())
    }

    fn duplicate(&self) -> io::Result<Box<dyn CanBus>> {
        let mut other = Self::on(Arc::clone(&self.shared), self.fd);
        other.filters = self.filters.clone();
        Ok(Box::new(other))
    }
}

/// The door of the fuzz target: any words of a slot are a frame that encodes to them, or nothing.
#[cfg(fuzzing)]
pub fn fuzz_decode(bytes: &[u8]) {
    let mut words = bytes.chunks_exact(8).map(|b| u64::from_ne_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]));
    let head = words.next().unwrap_or(0);
    let words = layout::Words { head, data: std::array::from_fn(|_| words.next().unwrap_or(0)) };
    if let Some(frame) = layout::decode(&words) {
        assert_eq!(layout::encode(&frame), words);
    }
}
