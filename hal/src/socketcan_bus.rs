//! The kernel's CAN sockets (SocketCAN): classic and FD, error frames, loss of the bus and the return from it.
//!
//! Enters and leaves: [`Frame`]s, received ones with the kernel's time of arrival moved to CLOCK_MONOTONIC. In the first
//! milliseconds after the first socket on a machine asks for stamps the kernel does not make them yet: a frame that came
//! then carries the time at which it was read.
//! - Sending never blocks. While the kernel's transmit queue is full (ENOBUFS, EAGAIN) frames wait in a bounded queue of
//!   this handle, in order, and go out at its next call of any method that sends or receives; when that queue is full
//!   as well, the frame is refused. Losing the bus empties the queue, and so does [`CanBus::discard_waiting`]: an old command
//!   must not come out of it later.
//! - Error frames become [`BusState`] and counters, and never reach the caller as frames. The controller's state is
//!   shared by a handle and its duplicates, so that one that only sends learns what one that receives was told.
//! - A socket whose interface went down or vanished is replaced by a new one as [`Restart`] says. That takes the kernel's
//!   network lock, and so does closing the old one: a handle that has never received leaves both to one of its
//!   duplicates that has, and until that has been called, says that the bus is down (`berth`). Where none receives, it
//!   does so itself.
//!
//! Must never: block longer than it is told, allocate after `open`, send what is older than the loss of the bus.

mod berth;
mod controller;
mod socket;
#[cfg(test)]
mod tests;
mod wire;

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags};
use socketcan::CanSocket;

use crate::bus_config::{BusKind, BusSpec, OpenError, Restart};
use crate::can::{BusCounters, BusState, CanBus, Filter, Frame, Kind, ReceiveError, Received, SendError};
use crate::clock::{Clock, Monotonic, monotonic_ns, realtime_ns, timespec};
use berth::Berth;
use controller::Controller;
use socket::{FILTERS_MAX, InterfaceName, Refusal};
pub use wire::ErrorReport;
use wire::{Datagram, FD_LEN};

/// How often a full transmit queue is tried again while a receive waits (ns); one frame of 1 Mbit/s takes 130 us.
const RETRY_NS: u64 = 200_000;
/// Time in which three clocks are read undisturbed (ns), and how often it is tried.
const CLOCK_READ_NS: u64 = 10_000;
const CLOCK_READS_MAX: u32 = 4;
/// How often it is tried to help a handle that only sends (ns).
const SERVE_NS: u64 = 5_000_000;
/// Error frames taken in one poll, so that a storm of them does not hold the caller.
const ERROR_FRAMES_MAX: u32 = 64;

/// Frames that other handles send at the same time as a burst: a heartbeat, and one more.
const OTHERS: usize = 2;
/// Length that is advised for a transmit queue which is too short: enough for any cycle of one bus.
const QUEUE_ADVISED: usize = 128;

type OpenSocket = fn(InterfaceName, bool) -> Result<CanSocket, Refusal>;

/// A handle on a CAN interface.
pub struct SocketCanBus {
    name: InterfaceName,
    fd: bool,
    restart: Restart,
    open_socket: OpenSocket,
    socket: CanSocket,
    /// The interface went down or vanished. What the socket received before can still be read, and the next socket
    /// replaces it.
    link_lost: bool,
    controller: Arc<Controller>,
    berth: Arc<Berth>,
    /// It is one of the controller's receivers.
    receives: bool,
    queue: Queue,
    /// Times bus-off for which the queue was emptied.
    bus_offs_seen: u32,
    /// Times bus-off when the link was lost.
    bus_offs_at_loss: u32,
    /// State that `receive` has reported.
    state_seen: BusState,
    /// Next attempt at recovery, and the interval after it (ns).
    retry_at_ns: u64,
    backoff_ns: u64,
    /// Next attempt to help others (ns).
    serve_at_ns: u64,
    /// The kernel's count of dropped frames at the last look.
    dropped: u32,
    counters: BusCounters,
}

impl SocketCanBus {
    /// Opens an interface.
    ///
    /// # Errors
    /// [`OpenError`]: no CAN in the kernel, interface missing, down, of the wrong MTU or kind, no permission.
    pub fn open(spec: &BusSpec) -> Result<Self, OpenError> {
        let name = InterfaceName::new(&spec.name)?;
        let socket = socket::open(name, spec.fd).map_err(|r| r.into_error(name))?;
        if spec.burst > 0 {
            check_queue(name, socket::transmit_queue(&socket, name).map_err(|r| r.into_error(name))?, spec.burst)?;
        }
        Ok(Self::with_socket(name, spec, socket, socket::open))
    }

    fn with_socket(name: InterfaceName, spec: &BusSpec, socket: CanSocket, open_socket: OpenSocket) -> Self {
        let berth = Arc::new(Berth::new(&[], FILTERS_MAX));
        Self::of_family(name, spec, socket, open_socket, Arc::default(), berth)
    }

    fn of_family(
        name: InterfaceName,
        spec: &BusSpec,
        socket: CanSocket,
        open_socket: OpenSocket,
        controller: Arc<Controller>,
        berth: Arc<Berth>,
    ) -> Self {
        controller.berths.add(&berth);
        Self {
            name,
            fd: spec.fd,
            restart: spec.restart,
            open_socket,
            socket,
            link_lost: false,
            berth,
            receives: false,
            queue: Queue::new(spec.queue_length),
            bus_offs_seen: controller.bus_offs.load(Ordering::Acquire),
            bus_offs_at_loss: 0,
            controller,
            state_seen: BusState::ErrorActive,
            retry_at_ns: 0,
            backoff_ns: 0,
            serve_at_ns: 0,
            dropped: 0,
            counters: BusCounters::default(),
        }
    }

    /// Transmit and receive error counter of the controller, as last reported by an error frame.
    pub fn error_counters(&self) -> (u8, u8) {
        let [tx, rx, ..] = self.controller.errors.load(Ordering::Relaxed).to_le_bytes();
        (tx, rx)
    }

    /// Frames that wait in this handle for room in the kernel's transmit queue.
    pub fn queued(&self) -> usize {
        self.queue.used
    }

    /// The interface is down or gone: plans the first attempt to come back.
    fn lose_link(&mut self) {
        self.link_lost = true;
        self.bus_offs_at_loss = self.controller.bus_offs.load(Ordering::Acquire);
        self.discard_queue();
        self.plan_first_attempt();
    }

    /// How many frames were in it; from now on they count as refused.
    fn discard_queue(&mut self) -> usize {
        let waiting = self.queue.used;
        self.counters.refused = self.counters.refused.saturating_add(waiting as u64);
        self.counters.sent = self.counters.sent.saturating_sub(waiting as u64);
        self.queue.clear();
        waiting
    }

    fn plan_first_attempt(&mut self) {
        if let Restart::Reopen { first, .. } = self.restart {
            self.backoff_ns = nanoseconds(first);
            self.retry_at_ns = monotonic_ns().saturating_add(self.backoff_ns);
        }
    }

    /// What is due on the way back from a lost bus, and what waits for the kernel. Does not block, unless this handle is one
    /// that may.
    fn maintain(&mut self) {
        self.notice_bus_off();
        if let Restart::Reopen { longest, cycle_interface, .. } = self.restart
            && !self.state().carries_frames()
        {
            if !self.receives && self.controller.receivers.load(Ordering::Acquire) > 0 {
                self.leave_to_a_receiver();
            } else if monotonic_ns() >= self.retry_at_ns {
                self.backoff_ns = self.backoff_ns.saturating_mul(2).clamp(1, nanoseconds(longest).max(1));
                self.retry_at_ns = monotonic_ns().saturating_add(self.backoff_ns);
                // At bus-off the link is still there. If it may not be cycled, the kernel's own restart remains.
                if self.link_lost || cycle_interface && socket::cycle(&self.socket, self.name).is_ok() {
                    self.reopen();
                }
            }
        }
        if self.state().carries_frames() {
            self.empty_queue();
        }
    }

    /// Asks for a new socket, or goes on with the one that is ready. The controller's state is the receiver's business.
    fn leave_to_a_receiver(&mut self) {
        if self.link_lost {
            if self.berth.exchange(&mut self.socket) {
                (self.link_lost, self.dropped) = (false, 0);
            }
            self.controller.asked.store(true, Ordering::Release);
        }
    }

    /// Helps handles of the same bus that only send. Blocks for as long as the kernel's network lock is taken.
    fn serve_senders(&mut self) {
        if self.link_lost || monotonic_ns() < self.serve_at_ns || !self.controller.asked.swap(false, Ordering::AcqRel) {
            return;
        }
        let open = |filters: &[[u32; 2]]| open_filtered(self.open_socket, self.name, self.fd, filters).ok();
        if !self.controller.berths.serve(open) {
            self.controller.asked.store(true, Ordering::Release);
            self.serve_at_ns = monotonic_ns().saturating_add(SERVE_NS);
        }
    }

    /// Another handle may have read the error frame, and this one had none of its own to read.
    fn notice_bus_off(&mut self) {
        let bus_offs = self.controller.bus_offs.load(Ordering::Acquire);
        if bus_offs != self.bus_offs_seen {
            self.bus_offs_seen = bus_offs;
            self.discard_queue();
            self.plan_first_attempt();
        }
    }

    fn reopen(&mut self) {
        let open = |filters: &mut Vec<_>| open_filtered(self.open_socket, self.name, self.fd, filters);
        let Ok(socket) = self.berth.with_filters(open) else { return };
        self.berth.forget();
        // The controller has been started anew. A handle that is late must not hide what another has read since.
        if !self.link_lost || self.controller.bus_offs.load(Ordering::Acquire) == self.bus_offs_at_loss {
            self.controller.set_state(BusState::ErrorActive);
        }
        (self.socket, self.link_lost, self.dropped) = (socket, false, 0);
    }

    /// Hands waiting frames to the kernel as far as it takes them.
    fn empty_queue(&mut self) {
        while let Some(frame) = self.queue.front().copied() {
            match self.transmit(&frame) {
                Ok(()) => self.queue.pop(),
                Err(libc::ENOBUFS | libc::EAGAIN) => return,
                Err(e) if is_link_loss(e) => return self.lose_link(),
                // A frame that the kernel refuses for itself must not block those behind it.
                Err(_) => {
                    self.queue.pop();
                    self.counters.sent = self.counters.sent.saturating_sub(1);
                    self.counters.refused = self.counters.refused.saturating_add(1);
                }
            }
        }
    }

    fn transmit(&self, frame: &Frame) -> Result<(), i32> {
        let mut bytes = [0; FD_LEN];
        let len = wire::encode(frame, &mut bytes);
        socket::send(&self.socket, &bytes[..len])
    }

    /// Takes one datagram.
    fn take(&mut self) -> Taken {
        let mut bytes = [0; FD_LEN];
        let arrival = match socket::receive(&self.socket, &mut bytes) {
            Ok(arrival) => arrival,
            Err(libc::EAGAIN) => return Taken::Nothing,
            Err(e) if is_link_loss(e) => {
                if self.link_lost {
                    return Taken::Nothing;
                }
                // The kernel reports the loss before the frames that it has already queued.
                self.lose_link();
                return Taken::Again;
            }
            Err(e) => return Taken::Failed(e),
        };
        if let Some(dropped) = arrival.dropped {
            let more = u64::from(dropped.wrapping_sub(self.dropped));
            self.counters.lost = self.counters.lost.saturating_add(more);
            self.dropped = dropped;
        }
        match bytes.get(..arrival.len).map_or(Datagram::Invalid, wire::decode) {
            Datagram::Frame(frame) => {
                if !arrival.local && self.controller.state() == BusState::BusOff {
                    // A frame from the wire: the controller is back, whether or not anybody said so.
                    self.controller.set_state(BusState::ErrorActive);
                }
                self.counters.received = self.counters.received.saturating_add(1);
                let time_ns = arrival.stamp_real_ns.map_or_else(monotonic_ns, |stamp_ns| {
                    let (real_ns, now_ns) = both_clocks();
                    wire::to_monotonic(stamp_ns, real_ns, now_ns)
                });
                Taken::Frame(Received { frame, time_ns })
            }
            Datagram::Error(report) => {
                self.note(report);
                Taken::Other
            }
            Datagram::Invalid => {
                self.counters.errors = self.counters.errors.saturating_add(1);
                Taken::Other
            }
        }
    }

    fn note(&mut self, report: ErrorReport) {
        self.counters.errors = self.counters.errors.saturating_add(1);
        if report.overflow {
            self.counters.lost = self.counters.lost.saturating_add(1);
        }
        if let Some((tx, rx)) = report.counters {
            self.controller.errors.store(u32::from_le_bytes([tx, rx, 0, 0]), Ordering::Relaxed);
        }
        if let Some(state) = report.state {
            let before = self.controller.state();
            self.controller.set_state(state);
            if state == BusState::BusOff && before != BusState::BusOff {
                self.controller.bus_offs.fetch_add(1, Ordering::AcqRel);
                self.notice_bus_off();
            }
        }
    }

    /// `Err` if the bus was lost and this handle has not said so yet; remembers the state.
    fn report_change(&mut self) -> Result<(), ReceiveError> {
        let state = self.state();
        let changed = std::mem::replace(&mut self.state_seen, state) != state;
        if changed && !state.carries_frames() { Err(ReceiveError::Bus(state)) } else { Ok(()) }
    }

    /// Sleeps until something may have changed, at most until `deadline_ns`.
    fn wait(&self, now_ns: u64, deadline_ns: u64) -> Result<(), ReceiveError> {
        let mut until_ns = deadline_ns;
        if self.queue.used > 0 {
            until_ns = until_ns.min(now_ns.saturating_add(RETRY_NS));
        }
        if !self.state().carries_frames() && self.restart != Restart::Never {
            until_ns = until_ns.min(self.retry_at_ns.max(now_ns + 1));
        }
        if !self.link_lost && self.controller.asked.load(Ordering::Acquire) {
            until_ns = until_ns.min(self.serve_at_ns.max(now_ns + 1));
        }
        if self.link_lost {
            Monotonic.sleep_until(until_ns);
            return Ok(());
        }
        let left = timespec(until_ns.saturating_sub(now_ns));
        match rustix::event::poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&left)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(e) => Err(ReceiveError::Os(e.raw_os_error())),
        }
    }
}

/// What `take` found.
enum Taken {
    Frame(Received),
    /// Something that is not for the caller.
    Other,
    /// Frames may follow.
    Again,
    Nothing,
    Failed(i32),
}

/// Whether the interface's transmit queue takes a burst while other handles send as well. Drivers make it ten frames long
/// (`alloc_candev`), and what their hardware holds beside it is not known here.
fn check_queue(name: InterfaceName, found: usize, burst: usize) -> Result<(), OpenError> {
    let wanted = burst + OTHERS;
    let remedy = wanted.next_power_of_two().max(QUEUE_ADVISED);
    let interface = name.as_str();
    if found < burst {
        return Err(OpenError::ShortQueue { interface: interface.to_owned(), found, burst, remedy });
    }
    if found < wanted {
        tracing::warn!(
            "the transmit queue of CAN interface {interface} holds {found} frames, and {burst} are sent at once in every \
             cycle, beside heartbeats: `ip link set {interface} txqueuelen {remedy}` makes room"
        );
    }
    Ok(())
}

/// CLOCK_REALTIME and CLOCK_MONOTONIC at one instant. Who loses the processor between the two reads reads again: otherwise a
/// SYNC would seem to be older than its cycle.
fn both_clocks() -> (u64, u64) {
    let mut pair = (0, 0);
    for _ in 0..CLOCK_READS_MAX {
        let before_ns = monotonic_ns();
        pair = (realtime_ns(), monotonic_ns());
        if pair.1.saturating_sub(before_ns) < CLOCK_READ_NS {
            break;
        }
    }
    pair
}

fn is_link_loss(e: i32) -> bool {
    matches!(e, libc::ENETDOWN | libc::ENODEV | libc::ENXIO)
}

fn nanoseconds(d: Duration) -> u64 {
    u64::try_from(d.as_nanos()).unwrap_or(u64::MAX)
}

impl CanBus for SocketCanBus {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if matches!(frame.kind(), Kind::Fd { .. }) && !self.fd {
            return Err(SendError::Unsupported);
        }
        self.maintain();
        if !self.state().carries_frames() {
            return Err(SendError::Bus(self.state()));
        }
        let result = if self.queue.used > 0 { Err(libc::EAGAIN) } else { self.transmit(frame) };
        match result {
            Ok(()) => {}
            Err(libc::ENOBUFS | libc::EAGAIN) => {
                if !self.queue.push(frame) {
                    self.counters.refused = self.counters.refused.saturating_add(1);
                    return Err(SendError::Full);
                }
            }
            Err(e) if is_link_loss(e) => {
                self.lose_link();
                return Err(SendError::Bus(BusState::Down));
            }
            Err(libc::EINVAL | libc::EMSGSIZE) => return Err(SendError::Unsupported),
            Err(e) => return Err(SendError::Os(e)),
        }
        self.counters.sent = self.counters.sent.saturating_add(1);
        Ok(())
    }

    fn flush(&mut self) -> usize {
        self.maintain();
        self.queue.used
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, ReceiveError> {
        let deadline_ns = monotonic_ns().saturating_add(nanoseconds(timeout));
        if !self.receives {
            self.receives = true;
            self.controller.receivers.fetch_add(1, Ordering::AcqRel);
        }
        let mut others = 0;
        loop {
            self.maintain();
            self.serve_senders();
            match self.take() {
                Taken::Frame(received) => return Ok(Some(received)),
                Taken::Failed(e) => return Err(ReceiveError::Os(e)),
                Taken::Again => continue,
                Taken::Other => {
                    others += 1;
                    self.report_change()?;
                    if others < ERROR_FRAMES_MAX {
                        continue;
                    }
                }
                Taken::Nothing => self.report_change()?,
            }
            let now_ns = monotonic_ns();
            if now_ns >= deadline_ns {
                let state = self.state();
                return if state.carries_frames() { Ok(None) } else { Err(ReceiveError::Bus(state)) };
            }
            others = 0;
            self.wait(now_ns, deadline_ns)?;
        }
    }

    fn discard_waiting(&mut self) -> usize {
        self.discard_queue()
    }

    fn state(&self) -> BusState {
        if self.link_lost { BusState::Down } else { self.controller.state() }
    }

    fn counters(&self) -> BusCounters {
        self.counters
    }

    fn set_filters(&mut self, filters: &[Filter]) -> Result<(), ReceiveError> {
        if filters.len() > FILTERS_MAX {
            return Err(ReceiveError::Os(libc::EINVAL));
        }
        // The mask covers the mark of extended frames, so that no filter passes one; remote requests pass as data do.
        let of_kernel = |f: &Filter| [f.value & libc::CAN_SFF_MASK, f.mask & libc::CAN_SFF_MASK | libc::CAN_EFF_FLAG];
        let everything = [[0, 0]];
        let set = self.berth.with_filters(|own| {
            own.clear();
            own.extend(filters.iter().map(of_kernel));
            socket::set_filters(&self.socket, if own.is_empty() { &everything[..] } else { own })
        });
        match set {
            // Installed when the interface comes back.
            Err(_) if self.link_lost => Ok(()),
            result => result.map_err(|e| ReceiveError::Os(e.raw_os_error().unwrap_or(libc::EIO))),
        }
    }

    fn duplicate(&self) -> io::Result<Box<dyn CanBus>> {
        Ok(Box::new(self.another()?))
    }
}

impl SocketCanBus {
    fn another(&self) -> io::Result<Self> {
        let (socket, berth) = self.berth.with_filters(|filters| {
            let socket = open_filtered(self.open_socket, self.name, self.fd, filters)
                .map_err(|r| io::Error::other(r.into_error(self.name)))?;
            io::Result::Ok((socket, Arc::new(Berth::new(filters, FILTERS_MAX))))
        })?;
        let spec = BusSpec {
            fd: self.fd,
            restart: self.restart,
            queue_length: self.queue.frames.len(),
            ..BusSpec::new(BusKind::Socketcan, self.name.as_str())
        };
        Ok(Self::of_family(self.name, &spec, socket, self.open_socket, Arc::clone(&self.controller), berth))
    }
}

impl Drop for SocketCanBus {
    fn drop(&mut self) {
        if self.receives {
            self.controller.receivers.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

/// A socket with these filters, or with none. Does not allocate.
fn open_filtered(open: OpenSocket, name: InterfaceName, fd: bool, filters: &[[u32; 2]]) -> Result<CanSocket, Refusal> {
    let socket = open(name, fd)?;
    if !filters.is_empty() {
        socket::set_filters(&socket, filters).map_err(|e| Refusal::from_io("CAN_RAW_FILTER", &e))?;
    }
    Ok(socket)
}

/// A bounded queue of frames, first in first out.
struct Queue {
    frames: Box<[Option<Frame>]>,
    first: usize,
    used: usize,
}

impl Queue {
    fn new(capacity: usize) -> Self {
        Self { frames: vec![None; capacity].into_boxed_slice(), first: 0, used: 0 }
    }

    fn front(&self) -> Option<&Frame> {
        if self.used == 0 { None } else { self.frames[self.first].as_ref() }
    }

    fn pop(&mut self) {
        if self.used > 0 {
            self.first = (self.first + 1) % self.frames.len();
            self.used -= 1;
        }
    }

    /// False if it is full.
    fn push(&mut self, frame: &Frame) -> bool {
        if self.used == self.frames.len() {
            return false;
        }
        let at = (self.first + self.used) % self.frames.len();
        self.frames[at] = Some(*frame);
        self.used += 1;
        true
    }

    fn clear(&mut self) {
        (self.first, self.used) = (0, 0);
    }
}

/// The door of the fuzz target: any datagram is a frame that survives the way back, or none.
#[cfg(fuzzing)]
pub fn fuzz_decode(bytes: &[u8]) {
    if let wire::Datagram::Frame(frame) = wire::decode(bytes) {
        let mut out = [0; wire::FD_LEN];
        let len = wire::encode(&frame, &mut out);
        assert!(matches!(wire::decode(&out[..len]), wire::Datagram::Frame(again) if again == frame));
    }
}
