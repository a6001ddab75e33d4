//! The master of many drives: boot-up, configuration, enabling, disabling, fault reset, supervision.
//!
//! A state machine that is polled: [`Master::on_frame`] for each frame received, [`Master::poll`] for time. Neither
//! waits. It sends on handles of its own; the control thread has the [`CycleWriter`]. As long as the writer has not
//! been taken, the master itself sends cycles of zero torque, so that state changes, which travel in RPDO 1 and count
//! from the next SYNC on, happen without a control loop.
//!
//! Enters: frames, the time, the goal. Leaves: frames, faults as data, the state of each drive ([`DriveStatus`]). It must
//! never wait or decide by a clock that it reads itself.

mod goal;
mod status;

pub use status::{DriveStatus, Goal, Phase, Progress};

use goal::{indices, reached};
use status::Slot;

use super::config::{DRIVES_MAX, MasterConfig, Order, SetupError};
use super::cyclic::{Address, CycleWriter, Decoder, Shared};
use super::fault::{DriveFault, Fault};
use super::objects::{TORQUE_DEMAND, decode_tpdo1};
use super::read_back::{ReadBack, Task};
use super::script::{Advance, Runner};
use super::state::State;
use crate::can::{CanBus, Frame, Received};
use crate::canopen::cob::{SDO_REQUEST, frame};
use crate::canopen::{Emergency, Message, NmtCommand, NmtState};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Faults kept; older ones are dropped first and counted.
pub const FAULTS_MAX: usize = 512;
/// Emergency objects kept of each drive.
pub const EMERGENCIES_MAX: usize = 16;
/// Frames served by one [`Master::pump`], so that it has an end on a busy bus.
const FRAMES_PER_PUMP: usize = 1024;

/// Frames that wait for a bus that takes none: more than all drives of one together want to be told at once. Older ones
/// are dropped first and counted.
const OUTBOX_MAX: usize = 4 * DRIVES_MAX;

/// Boot-ups accepted between the reset and the end of configuration.
const BOOTS_MAX: u32 = 3;

/// The master.
pub struct Master {
    config: MasterConfig,
    buses: Vec<Box<dyn CanBus>>,
    /// By bus: what it has not taken yet. The queue of the handle is not used: what lies there could not be given up.
    outbox: Vec<VecDeque<Frame>>,
    outbox_dropped: Vec<u64>,
    slots: Vec<Slot>,
    addresses: Vec<Address>,
    shared: Arc<Shared>,
    writer: Option<CycleWriter>,
    zeros: Vec<i16>,
    read_back: Option<ReadBack>,
    goal: Goal,
    faults: VecDeque<DriveFault>,
    faults_dropped: u64,
    heartbeat_due_ns: u64,
    heartbeats: u64,
    cycle_due_ns: u64,
    started: bool,
}

impl Master {
    /// A master on the buses given; nothing is sent before [`Self::start`].
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn new(config: MasterConfig, buses: Vec<Box<dyn CanBus>>) -> Result<Self, SetupError> {
        config.check(buses.len())?;
        let addresses: Vec<_> = config
            .drives
            .iter()
            .enumerate()
            .map(|(i, d)| Address {
                bus: d.bus,
                node: d.node,
                rank: config.rank(i).0,
                torque_permille_max: i16::try_from(d.torque_permille_max).unwrap_or(i16::MAX),
            })
            .collect();
        let shared = Arc::new(Shared::new(addresses.len(), buses.len()));
        let handles: Result<Vec<_>, _> = buses.iter().map(|b| b.duplicate()).collect();
        let handles = handles.map_err(|e| SetupError::Duplicate(e.raw_os_error().unwrap_or(0)))?;
        let layouts = (0..buses.len()).map(|bus| config.layout(bus)).collect();
        let cycle_us = config.cycle_us as f32;
        let follows = config.drives.iter().any(|drive| drive.safe_torque_follows);
        let share = if follows { cycle_us / (config.mean_time_us as f32 + cycle_us) } else { 0.0 };
        let writer = CycleWriter::new(handles, addresses.clone(), layouts, share, shared.clone());
        Ok(Self {
            outbox: buses.iter().map(|_| VecDeque::with_capacity(OUTBOX_MAX)).collect(),
            outbox_dropped: vec![0; buses.len()],
            slots: addresses.iter().map(|_| Slot::new()).collect(),
            zeros: vec![0; addresses.len()],
            writer: Some(writer),
            read_back: ReadBack::new(&config),
            goal: Goal::Disabled,
            faults: VecDeque::new(),
            faults_dropped: 0,
            heartbeat_due_ns: 0,
            heartbeats: 0,
            cycle_due_ns: 0,
            started: false,
            config,
            buses,
            addresses,
            shared,
        })
    }

    /// The settings.
    pub fn config(&self) -> &MasterConfig {
        &self.config
    }

    /// A decoder of the drives' feedback, for the receive thread.
    pub fn decoder(&self) -> Decoder {
        Decoder::new(&self.addresses, self.buses.len(), self.shared.clone())
    }

    /// Hands the sending of cycles over, and begins to read back what the drives hold; from then on SYNC is the caller's duty, and the drives' SYNC timeout its
    /// deadline. `None` if it was taken before.
    pub fn take_writer(&mut self) -> Option<CycleWriter> {
        if let Some(read_back) = &mut self.read_back {
            read_back.restart();
        }
        self.writer.take()
    }

    /// Takes the sending of cycles back: zero torque from the next [`Self::poll`] on.
    pub fn return_writer(&mut self, writer: CycleWriter) {
        self.writer = Some(writer);
    }

    /// Starts from scratch: every drive is reset, configured and made operational. The goal becomes disabled. What a bus
    /// has not taken of the start before is given up: a drive that hears again must not be reset once for each.
    pub fn start(&mut self, now_ns: u64) {
        for (outbox, dropped) in self.outbox.iter_mut().zip(&mut self.outbox_dropped) {
            *dropped += outbox.len() as u64;
            outbox.clear();
        }
        self.goal = Goal::Disabled;
        if let Some(read_back) = &mut self.read_back {
            read_back.restart();
        }
        self.started = true;
        self.heartbeat_due_ns = now_ns;
        self.cycle_due_ns = now_ns;
        for i in 0..self.slots.len() {
            self.slots[i] = Slot::new();
            self.slots[i].since_ns = now_ns;
            self.shared.controlwords[i].store(0, Ordering::Release);
        }
    }

    /// Sets where the drives are to be. Drives that got stuck or dropped out under the goal before are tried anew.
    pub fn set_goal(&mut self, goal: Goal, now_ns: u64) {
        self.goal = goal;
        for s in &mut self.slots {
            s.stuck = false;
            s.was_enabled = false;
            s.wanted = None;
            s.since_ns = now_ns;
        }
    }

    /// The goal.
    pub fn goal(&self) -> Goal {
        self.goal
    }

    /// Resets the latched fault of every drive that has one; the goal becomes disabled.
    pub fn reset_faults(&mut self, now_ns: u64) {
        self.set_goal(Goal::Disabled, now_ns);
        let cycle = self.shared.cycle.load(Ordering::Acquire);
        for (i, s) in self.slots.iter_mut().enumerate() {
            if s.status.phase == Phase::Ready && s.status.state() == Some(State::Fault) {
                self.shared.controlwords[i].store(0, Ordering::Release);
                s.resetting = Some(cycle);
            }
        }
    }

    /// Heartbeats of its own that it has given to each bus, since it was made. Whoever hears more of them on a bus hears
    /// another node with the same id.
    pub fn heartbeats(&self) -> u64 {
        self.heartbeats
    }

    /// What is known of each drive, in the order of cables.
    pub fn status(&self) -> impl ExactSizeIterator<Item = &DriveStatus> {
        self.slots.iter().map(|s| &s.status)
    }

    /// Frames of cycles (RPDOs and SYNC) that the bus did not take since the master was made, whoever sent the cycles. In
    /// the packed layout one frame stands for all drives of the bus. 0 for a bus that there is not.
    pub fn unsent(&self, bus: usize) -> u64 {
        self.shared.unsent.get(bus).map_or(0, |n| n.load(Ordering::Relaxed))
    }

    /// Frames of the master's own (NMT, SDO, heartbeat) that were given up because the bus did not take them in time. 0 for
    /// a bus that there is not.
    pub fn given_up(&self, bus: usize) -> u64 {
        self.outbox_dropped.get(bus).copied().unwrap_or(0)
    }

    /// Faults since the last call, oldest first.
    pub fn take_faults(&mut self) -> Vec<DriveFault> {
        self.faults.drain(..).collect()
    }

    /// Faults dropped because nobody took them.
    pub fn faults_dropped(&self) -> u64 {
        self.faults_dropped
    }

    fn fault(&mut self, drive: usize, time_ns: u64, fault: Fault) {
        let Address { bus, node, .. } = self.addresses[drive];
        if self.faults.len() == FAULTS_MAX {
            self.faults.pop_front();
            self.faults_dropped += 1;
        }
        self.faults.push_back(DriveFault { drive, bus, node, time_ns, fault });
    }

    fn fail(&mut self, drive: usize, time_ns: u64, fault: Fault) {
        self.slots[drive].status.phase = Phase::Failed;
        self.slots[drive].runner = None;
        self.shared.controlwords[drive].store(0, Ordering::Release);
        self.fault(drive, time_ns, fault);
    }

    fn send(&mut self, bus: usize, frame: Frame) {
        if self.outbox[bus].len() == OUTBOX_MAX {
            self.outbox[bus].pop_front();
            self.outbox_dropped[bus] += 1;
        }
        self.outbox[bus].push_back(frame);
    }

    fn send_sdo(&mut self, drive: usize, payload: &[u8; 8]) {
        let Address { bus, node, .. } = self.addresses[drive];
        if let Ok(f) = frame(node.cob(SDO_REQUEST), payload) {
            self.send(bus, f);
        }
    }

    /// Receives what waits on the master's own handles, without waiting, then polls. For callers without a receive
    /// thread.
    pub fn pump(&mut self, now_ns: u64) -> Progress {
        for bus in 0..self.buses.len() {
            for _ in 0..FRAMES_PER_PUMP {
                match self.buses[bus].receive(std::time::Duration::ZERO) {
                    Ok(Some(received)) => self.on_frame(bus, &received, now_ns),
                    _ => break,
                }
            }
        }
        self.poll(now_ns)
    }

    /// Handles one frame received on the given bus.
    pub fn on_frame(&mut self, bus: usize, received: &Received, now_ns: u64) {
        let Some(message) = Message::of(&received.frame) else { return };
        let node = match message {
            Message::Heartbeat(n) | Message::SdoResponse(n) | Message::Emergency(n) | Message::Tpdo(1, n) => n,
            _ => return,
        };
        let Some(i) = self.addresses.iter().position(|a| a.bus == bus && a.node == node) else { return };
        let data = received.frame.data();
        match message {
            Message::Heartbeat(_) => self.on_heartbeat(i, NmtState::decode(data), now_ns),
            Message::SdoResponse(_) => {
                if let Some(mut runner) = self.slots[i].runner.take() {
                    let advance = runner.on_response(data, now_ns);
                    self.slots[i].runner = Some(runner);
                    self.advance(i, advance, now_ns);
                } else if let Some(read_back) = &mut self.read_back {
                    let task = read_back.on_response(i, data, now_ns);
                    self.carry_out(task, now_ns);
                }
            }
            Message::Emergency(_) => {
                if let Some(e) = Emergency::decode(data) {
                    self.on_emergency(i, e, received.time_ns);
                }
            }
            _ => {
                if let Some((word, ..)) = decode_tpdo1(data) {
                    let slot = &mut self.slots[i];
                    slot.status.statusword = Some(word);
                    (slot.feedback_ns, slot.feedback_cycle) = (now_ns, self.shared.cycle.load(Ordering::Acquire));
                }
            }
        }
    }

    fn on_emergency(&mut self, i: usize, e: Emergency, time_ns: u64) {
        let status = &mut self.slots[i].status;
        status.error_register = e.register;
        if status.emergencies.len() == EMERGENCIES_MAX {
            status.emergencies.pop_front();
        }
        status.emergencies.push_back((time_ns, e));
        if !e.is_reset() {
            self.fault(i, time_ns, Fault::Emergency(e));
        }
    }

    fn on_heartbeat(&mut self, i: usize, state: Option<NmtState>, now_ns: u64) {
        let Some(state) = state else { return };
        let slot = &mut self.slots[i];
        slot.status.nmt = Some(state);
        slot.heartbeat_ns = Some(now_ns);
        slot.heartbeat_lost = false;
        match (slot.status.phase, state) {
            // The boot-up of a power-up may come just before that of the reset: the script then starts over, though not
            // for ever.
            (Phase::Booting | Phase::Configuring | Phase::Starting, NmtState::BootUp) if slot.boots < BOOTS_MAX => {
                slot.boots += 1;
                slot.status.phase = Phase::Configuring;
                slot.heartbeat_ns = None;
                let mut runner = Runner::new(&self.config, i);
                let first = runner.start(now_ns);
                self.slots[i].runner = Some(runner);
                self.advance(i, first, now_ns);
            }
            (Phase::Configuring | Phase::Starting | Phase::Ready, NmtState::BootUp) => {
                self.fail(i, now_ns, Fault::Rebooted);
            }
            (Phase::Starting, NmtState::Operational) => {
                slot.status.phase = Phase::Ready;
                slot.since_ns = now_ns;
            }
            (Phase::Ready, NmtState::PreOperational | NmtState::Stopped) => {
                self.fail(i, now_ns, Fault::Nmt { expected: NmtState::Operational, found: Some(state) });
            }
            _ => {}
        }
    }

    fn advance(&mut self, i: usize, advance: Advance, now_ns: u64) {
        if let Some(r) = &self.slots[i].runner {
            (self.slots[i].status.steps, self.slots[i].status.sdo_ignored) = (r.progress(), r.ignored());
        }
        if self.slots[i].status.phase == Phase::Releasing {
            return self.release(i, advance, now_ns);
        }
        match advance {
            Advance::Send(payload) => self.send_sdo(i, &payload),
            Advance::Wait => {}
            Advance::Failed(fault, abort) => {
                if let Some(payload) = abort {
                    self.send_sdo(i, &payload);
                }
                self.fail(i, now_ns, fault);
            }
            Advance::Done => {
                let slot = &mut self.slots[i];
                if let Some(r) = slot.runner.take() {
                    slot.status.rated_torque_mnm = r.rated_torque_mnm;
                    slot.status.absent = r.absent;
                }
                slot.status.phase = Phase::Starting;
                slot.since_ns = now_ns;
                let Address { bus, node, .. } = self.addresses[i];
                self.send(bus, NmtCommand::Start.encode(Some(node)));
            }
        }
    }

    /// Time: heartbeat, cycles (while the writer is here), time-outs, the next step of each drive. Does not wait.
    pub fn poll(&mut self, now_ns: u64) -> Progress {
        if self.started {
            self.produce_heartbeat(now_ns);
            self.boot(now_ns);
            for i in 0..self.slots.len() {
                self.supervise(i, now_ns);
            }
            self.follow_goal(now_ns);
            if let (Some(read_back), None) = (&mut self.read_back, &self.writer) {
                let ready = |i: usize| self.slots[i].status.phase == Phase::Ready;
                let absent = |i: usize, index, sub| self.slots[i].status.absent.contains(&(index, sub));
                let safe = |i: usize| self.shared.mean_torques[i].load(Ordering::Acquire);
                let task = read_back.poll(now_ns, ready, absent, safe);
                self.carry_out(task, now_ns);
            }
            self.flush();
            self.produce_cycle(now_ns);
        }
        self.flush();
        self.progress()
    }

    fn carry_out(&mut self, task: Task, now_ns: u64) {
        match task {
            Task::None => {}
            Task::Send(drive, payload) => self.send_sdo(drive, &payload),
            Task::Changed(drive, fault) => self.fault(drive, now_ns, fault),
        }
    }

    fn flush(&mut self) {
        for (bus, outbox) in self.buses.iter_mut().zip(&mut self.outbox) {
            while let Some(f) = outbox.front() {
                if bus.flush() > 0 {
                    break;
                }
                match bus.send(f) {
                    Err(crate::can::SendError::Full) => break,
                    // What a bus that is down refuses would be stale when it is back: time-outs take care of it.
                    Ok(()) | Err(_) => outbox.pop_front(),
                };
            }
        }
    }

    fn produce_heartbeat(&mut self, now_ns: u64) {
        if now_ns >= self.heartbeat_due_ns {
            self.heartbeat_due_ns = now_ns + u64::from(self.config.heartbeat_ms) * 1_000_000;
            self.heartbeats += 1;
            let beat = NmtState::Operational.heartbeat(self.config.node);
            for bus in 0..self.buses.len() {
                // One that still waits says the same.
                if !self.outbox[bus].contains(&beat) {
                    self.send(bus, beat);
                }
            }
        }
    }

    fn produce_cycle(&mut self, now_ns: u64) {
        // Not before somebody can answer: a drive in configuration has nothing to do with SYNC.
        let any = self.slots.iter().any(|s| matches!(s.status.phase, Phase::Starting | Phase::Ready));
        if let Some(writer) = &mut self.writer
            && any
            && now_ns >= self.cycle_due_ns
        {
            let period_ns = u64::from(self.config.cycle_us) * 1000;
            self.cycle_due_ns = (self.cycle_due_ns + period_ns).max(now_ns + period_ns / 2);
            let _ = writer.write_cycle(&self.zeros); // what is lost is repeated with the next cycle
        }
    }

    /// Resets the drives whose turn it is.
    fn boot(&mut self, now_ns: u64) {
        for i in indices(self.config.order_of_start, self.slots.len()) {
            match self.slots[i].status.phase {
                Phase::Waiting if self.config.drives[i].release.is_empty() => self.reset_node(i, now_ns),
                Phase::Waiting => {
                    let mut runner = Runner::asking(&self.config, i);
                    let first = runner.start(now_ns);
                    let slot = &mut self.slots[i];
                    (slot.status.phase, slot.since_ns, slot.runner) = (Phase::Releasing, now_ns, Some(runner));
                    self.advance(i, first, now_ns);
                }
                Phase::Ready | Phase::Failed => continue,
                _ => {}
            }
            if self.config.order_of_start != Order::Parallel {
                break;
            }
        }
    }

    fn reset_node(&mut self, i: usize, now_ns: u64) {
        let slot = &mut self.slots[i];
        (slot.status.phase, slot.since_ns, slot.runner) = (Phase::Booting, now_ns, None);
        let Address { bus, node, .. } = self.addresses[i];
        self.send(bus, NmtCommand::ResetNode.encode(Some(node)));
    }

    /// What a drive that may keep a torque answered: without torque, or silent, it is reset; with one it is told to let go,
    /// and reset when its time is over ([`Self::supervise`]).
    fn release(&mut self, i: usize, advance: Advance, now_ns: u64) {
        match advance {
            Advance::Send(payload) => self.send_sdo(i, &payload),
            Advance::Wait => {}
            Advance::Done if self.slots[i].status.steps.1 > 1 => self.slots[i].runner = None,
            Advance::Failed(Fault::Value { index: TORQUE_DEMAND, .. }, _) => {
                let mut runner = Runner::releasing(&self.config, i);
                let first = runner.start(now_ns);
                self.slots[i].status.steps = runner.progress();
                self.slots[i].runner = Some(runner);
                if let Advance::Send(payload) = first {
                    self.send_sdo(i, &payload);
                }
            }
            Advance::Failed(_, abort) => {
                if let Some(payload) = abort {
                    self.send_sdo(i, &payload);
                }
                self.reset_node(i, now_ns);
            }
            Advance::Done => self.reset_node(i, now_ns),
        }
    }

    /// Whether a drive in fault may keep a torque, of which a reset alone would let go at once.
    pub fn may_hold(&self) -> bool {
        let faulted = |s: &Slot| s.status.state() == Some(State::Fault);
        self.slots.iter().zip(&self.config.drives).any(|(s, drive)| faulted(s) && !drive.release.is_empty())
    }

    /// Time-outs of one drive.
    fn supervise(&mut self, i: usize, now_ns: u64) {
        let waited_ns = now_ns.saturating_sub(self.slots[i].since_ns);
        let over = |ms: u32| waited_ns > u64::from(ms) * 1_000_000;
        match self.slots[i].status.phase {
            Phase::Booting if over(self.config.boot_timeout_ms) => {
                self.fail(i, now_ns, Fault::NoBootUp { timeout_ms: self.config.boot_timeout_ms });
            }
            Phase::Releasing if self.slots[i].runner.is_none() && over(self.config.release_ms) => {
                self.reset_node(i, now_ns);
            }
            Phase::Configuring | Phase::Releasing => {
                if let Some(mut runner) = self.slots[i].runner.take() {
                    let advance = runner.poll(now_ns);
                    self.slots[i].runner = Some(runner);
                    self.advance(i, advance, now_ns);
                }
            }
            Phase::Starting if over(self.config.transition_timeout_ms) => {
                let found = self.slots[i].status.nmt;
                self.fail(i, now_ns, Fault::Nmt { expected: NmtState::Operational, found });
            }
            _ => {}
        }
        let slot = &mut self.slots[i];
        let timeout_ms = self.config.drive_heartbeat_timeout_ms;
        let silent = slot.heartbeat_ns.is_some_and(|t| now_ns.saturating_sub(t) > u64::from(timeout_ms) * 1_000_000);
        if slot.status.phase == Phase::Ready && silent && !slot.heartbeat_lost {
            slot.heartbeat_lost = true;
            self.fault(i, now_ns, Fault::HeartbeatLost { timeout_ms });
        }
    }

    fn progress(&self) -> Progress {
        let mut p = Progress { drives: self.slots.len(), ..Progress::default() };
        let mut at_goal = true;
        for s in &self.slots {
            p.steps_done += s.status.steps.0;
            p.steps += s.status.steps.1;
            match s.status.phase {
                Phase::Ready => {
                    p.ready += 1;
                    let state = s.status.state();
                    p.enabled += usize::from(state == Some(State::OperationEnabled));
                    p.faulted += usize::from(matches!(state, Some(State::Fault | State::FaultReactionActive)));
                    at_goal &= state.is_some_and(|state| reached(self.goal, state)) && s.resetting.is_none();
                }
                Phase::Failed => {
                    p.failed += 1;
                    at_goal = false;
                }
                _ => {
                    p.starting += 1;
                    at_goal = false;
                }
            }
        }
        p.at_goal = at_goal;
        p
    }
}
