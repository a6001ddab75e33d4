//! The plant on its buses: frames in and out, and what makes time pass.
//!
//! Enters: frames. Leaves: frames, the trace. It must never wait for anybody but the clock or a SYNC.
//!
//! **Lockstep.** Every SYNC (with several buses: one on each) is one period: synchronous targets take effect, the arm
//! advances by the period, and the answers to SYNC k carry the state *after* that step, measured at the end of period k.
//! So a controller that computes for tick k + 1 with the answers to SYNC k has no latency. Hardware, and real time below,
//! measure at the SYNC itself, which is one tick of latency. The drives' clock is the number of SYNCs times the period:
//! heartbeats and SYNC guards count simulated time, and a run is the same bit for bit however fast it computes.
//! A controller that dies stops that clock; so after [`SILENCE`] of real time without a SYNC it goes on with the computer's
//! until the next SYNC, and the guards find out. Not so while a process is known to be the controller, which a virtual bus
//! can tell: one that is stopped, or has no processor, has not died. A period ends with a TIME object on every bus, after all answers: whoever
//! waits for answers in lockstep knows by it that no more will come.
//!
//! **Faults on the wire** ([`crate::wire`]) lie between the bus and the drives. The clock of lockstep is no frame that
//! could be lost: a SYNC that the drives do not get moves the arm all the same, and no fault touches TIME.
//!
//! **Real time.** The arm advances in fixed steps at absolute deadlines. An encoder is read at the SYNC: the last step's
//! length, carried on at the last step's rate. A step that begins more than a step late is counted. Physics that falls
//! behind by more than [`BEHIND_MAX`] gives the difference up, which is counted too: a backlog is not replayed. The
//! drives' guards run on real time.

use crate::config::{Pace, PlantConfig};
use crate::drive::{Drive, DriveBank, Nameplate};
use crate::fault::{FaultKind, Schedule};
use crate::rig::{DriveAction, Rig};
use crate::trace::Trace;
use crate::wire::{WireFault, WireFaults};
use sinew::config::{BusKind, Config};
use sinew::integrator::StepError;
use sinew::recording::RecordingError;
use sinew_hal::bus_config::{self, BusSpec, OpenError};
use sinew_hal::can::{CanBus, Frame, Id, Received, SendError};
use sinew_hal::canopen::cob::{NodeIdError, SYNC, time_frame};
use sinew_hal::canopen::emcy::{code, register};
use sinew_hal::canopen::{Message, NodeId};
use sinew_hal::cia402::state::State;
use sinew_hal::clock::{Clock, Lockstep, Monotonic, Naps, monotonic_ns, seconds_to_ns};
use sinew_hal::fault_shim::FaultShim;
use sinew_hal::realtime;
use sinew_hal::virtual_bus::{Role, is_claimed};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Real time without a SYNC after which the clock of a plant in lockstep follows the computer's. Longer than a controller
/// waits for a client that has died (5 s), or that loss would look like the controller's own.
pub const SILENCE: Duration = Duration::from_secs(10);
/// Physics further behind than this gives the difference up.
pub const BEHIND_MAX: Duration = Duration::from_millis(250);
/// Interval at which is asked whether the controller lives (ns).
const LIVES_NS: u64 = 500_000_000;
/// Longest wait on a bus: how soon a request to stop is seen.
const WAIT_MAX: Duration = Duration::from_millis(20);
/// Longest wait on one of several buses.
const TURN: Duration = Duration::from_micros(100);
/// SCHED_FIFO priority in real time, far below the controller's.
const PRIORITY: u8 = 10;
/// Frames that wait for a full transmit queue.
const OUTBOX_MAX: usize = 4096;

/// Why the plant ended, or did not begin.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// A bus.
    #[error("bus {name}: {source}")]
    Bus {
        /// Its name in `[drives]`.
        name: String,
        /// Why it did not open.
        source: OpenError,
    },
    /// A node id.
    #[error(transparent)]
    Node(#[from] NodeIdError),
    /// The physics.
    #[error("the simulated arm diverged at {at_s:.3} s: {source}")]
    Diverged {
        /// Simulated time (s).
        at_s: f64,
        /// Cause.
        source: StepError,
    },
    /// The trace.
    #[error(transparent)]
    Trace(#[from] RecordingError),
}

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Served {
    /// SYNCs served.
    pub syncs: u64,
    /// Steps of the physics.
    pub steps: u64,
    /// Steps that began more than a step late (real time).
    pub late: u64,
    /// Simulated time given up because the physics was too far behind (ns).
    pub given_up_ns: u64,
    /// Frames dropped because a bus refused them for too long.
    pub dropped: u64,
    /// Records that the trace did not keep (real time).
    pub untraced: u64,
    /// Frames that a fault on the wire hit.
    pub disturbed: u64,
    /// Periods since the first drive was enabled, that one counted; 0 if none was.
    pub periods_enabled: u64,
}

/// What is left of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Voice {
    Whole,
    /// No process data.
    Silent,
    /// Nothing.
    Dead,
}

/// What a bus had in lockstep.
enum Heard {
    Nothing,
    Frame,
    Sync,
}

struct Wire {
    bus: FaultShim<Box<dyn CanBus>>,
    bank: DriveBank,
    /// Cable of each of the bank's drives.
    cables: Vec<usize>,
    outbox: VecDeque<Frame>,
    /// The controller sent SYNC for this period, and the drives got so many.
    synced: Option<u32>,
    /// SYNCs that came after their period; drives get them with the next one.
    late_syncs: u32,
    /// The period is over, and TIME has not been sent yet.
    over: bool,
}

/// The plant.
pub struct Server {
    wires: Vec<Wire>,
    /// Bus and place in its bank of each cable's drive.
    places: Vec<(usize, usize)>,
    voices: Vec<Voice>,
    rig: Rig,
    schedule: Schedule,
    wire_faults: WireFaults,
    wire_seed: u64,
    wires_seeded: bool,
    /// The shims' time in lockstep.
    clock: Arc<Lockstep>,
    trace: Option<Trace>,
    pace: Pace,
    period_s: f64,
    step_s: f64,
    /// Time of the drives (ns).
    now_ns: u64,
    actions: Vec<DriveAction>,
    served: Served,
    virtual_buses: Vec<String>,
    /// Whether the controller lived when it was asked for last, and when that was (ns).
    lives: (bool, u64),
}

impl Server {
    /// Opens the buses and powers the drives; each announces itself as soon as the server runs.
    ///
    /// # Errors
    /// A bus does not open.
    pub fn open(
        config: &Config,
        plant: &PlantConfig,
        rig: Rig,
        schedule: Schedule,
        trace: Option<Trace>,
    ) -> Result<Self, ServerError> {
        let now_ns = match plant.pace {
            Pace::Lockstep => 0,
            Pace::Realtime => monotonic_ns(),
        };
        let clock = Arc::new(Lockstep::new(now_ns));
        let mut wires = Vec::with_capacity(config.drives.buses.len());
        let mut places = vec![(0, 0); config.drives.drives.len()];
        for (index, bus) in config.drives.buses.iter().enumerate() {
            let kind = match bus.kind {
                BusKind::Virtual => bus_config::BusKind::Virtual,
                BusKind::Socketcan => bus_config::BusKind::Socketcan,
            };
            let spec = BusSpec { fd: bus.fd, ..BusSpec::new(kind, &bus.interface) };
            let handle =
                bus_config::open(&spec).map_err(|source| ServerError::Bus { name: bus.name.clone(), source })?;
            let (mut drives, mut cables) = (Vec::new(), Vec::new());
            for (cable, drive) in config.drives.drives.iter().enumerate().filter(|(_, d)| d.bus == index) {
                let nameplate = Nameplate {
                    serial: cable as u32 + 1,
                    rated_torque_mnm: (1000.0 * drive.rated_torque_nm).round() as u32,
                };
                places[cable] = (index, drives.len());
                cables.push(cable);
                drives.push(Drive::new(NodeId::new(drive.node_id)?, nameplate, now_ns));
            }
            let outbox = VecDeque::with_capacity(256);
            let mut bus = match plant.pace {
                Pace::Lockstep => FaultShim::clean(handle, 0, clock.clone() as Arc<dyn Clock>),
                Pace::Realtime => FaultShim::clean(handle, 0, Arc::new(Monotonic)),
            };
            if plant.pace == Pace::Lockstep {
                bus.watch(Id::Standard(SYNC));
            }
            wires.push(Wire {
                bus,
                bank: DriveBank::new(drives),
                cables,
                outbox,
                synced: None,
                late_syncs: 0,
                over: false,
            });
        }
        let cables = places.len();
        Ok(Self {
            wires,
            places,
            voices: vec![Voice::Whole; cables],
            rig,
            schedule,
            wire_faults: WireFaults::default(),
            wire_seed: 0,
            wires_seeded: false,
            clock,
            trace,
            pace: plant.pace,
            period_s: config.timing.period_s,
            step_s: plant.truth.step_s.min(config.timing.period_s),
            now_ns,
            actions: vec![DriveAction { enabled: false, torque_permille: 0 }; cables],
            served: Served::default(),
            virtual_buses: {
                let virtual_buses = config.drives.buses.iter().filter(|bus| bus.kind == BusKind::Virtual);
                virtual_buses.map(|bus| bus.interface.clone()).collect()
            },
            lives: (false, 0),
        })
    }

    /// Lets frames go wrong, from the moment on at which the first drive is enabled.
    #[must_use]
    pub fn with_wire_faults(mut self, faults: Vec<WireFault>, seed: u64) -> Self {
        (self.wire_faults, self.wire_seed) = (WireFaults::new(faults), seed);
        self
    }

    /// A further handle on the first bus, for a server of it.
    ///
    /// # Errors
    /// The operating system.
    pub fn bus_handle(&self) -> std::io::Result<Box<dyn CanBus>> {
        let wire = self.wires.first().ok_or_else(|| std::io::Error::other("no bus"))?;
        wire.bus.inner().duplicate()
    }

    /// Serves the buses until `stop` is set, and completes the trace.
    ///
    /// # Errors
    /// The physics diverged, or the trace cannot be written; what there is of it stays readable.
    pub fn run(mut self, stop: &AtomicBool) -> Result<Served, ServerError> {
        let ended = match self.pace {
            Pace::Lockstep => self.lockstep(stop),
            Pace::Realtime => self.realtime(stop),
        };
        let finished = self.trace.take().map_or(Ok(0), Trace::finish);
        ended?;
        self.served.untraced = finished?;
        for wire in &self.wires {
            let (out, into) = wire.bus.counts();
            for c in [out, into] {
                self.served.disturbed += c.dropped + c.corrupted + c.duplicated + c.reordered + c.delayed;
            }
        }
        let enabled_s = self.rig.since_enabled_s().unwrap_or(0.0);
        self.served.periods_enabled = (enabled_s / self.period_s).round() as u64;
        Ok(self.served)
    }

    fn lockstep(&mut self, stop: &AtomicBool) -> Result<(), ServerError> {
        let mut heard_ns = monotonic_ns();
        let mut idle = Naps::begin();
        self.give_feedback(0.0);
        self.record()?;
        while !stop.load(Ordering::Relaxed) {
            self.poll_drives();
            let mut busy = false;
            // Nothing is due between two frames.
            let wait = if self.wires.len() == 1 { WAIT_MAX } else { TURN.max(idle.length()) };
            for index in 0..self.wires.len() {
                // A SYNC ends the turn: where they have piled up, one of each bus is a period, not each of this one.
                loop {
                    match self.hear(index, wait, &mut busy) {
                        Heard::Nothing => break,
                        Heard::Frame => {}
                        Heard::Sync => {
                            heard_ns = monotonic_ns();
                            self.on_lockstep_sync(index)?;
                            break;
                        }
                    }
                }
            }
            if busy {
                idle = Naps::begin();
            }
            // One period at a time, so that a SYNC that comes after all is served between two of them.
            let silence_ns = monotonic_ns().saturating_sub(heard_ns);
            if silence_ns > SILENCE.as_nanos() as u64 && !self.controller_lives() {
                heard_ns += seconds_to_ns(self.period_s);
                self.period()?;
            }
        }
        Ok(())
    }

    /// Asked at most twice a second.
    fn controller_lives(&mut self) -> bool {
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(self.lives.1) > LIVES_NS {
            let claimed = self.virtual_buses.iter().any(|bus| is_claimed(bus, Role::Master));
            self.lives = (claimed, now_ns);
        }
        self.lives.0
    }

    /// Takes the next frame of a bus in, for the drives.
    fn hear(&mut self, index: usize, wait: Duration, busy: &mut bool) -> Heard {
        let before = self.wires[index].bus.watched();
        let frame = self.receive(index, wait, busy).map(|received| received.frame);
        // The controller's SYNC is the clock; whether the drives get it is another matter.
        let sync = self.wires[index].bus.watched() > before;
        *busy |= sync;
        let heard = frame.is_some();
        match frame {
            // Doubled or late: in a period that is over it would race the next one's frames.
            Some(frame) if is_sync(&frame) => self.wires[index].late_syncs += 1,
            Some(frame) => {
                self.wires[index].bank.on_frame(&frame, self.now_ns);
                self.flush();
            }
            None => {}
        }
        match (sync, heard) {
            (true, _) => Heard::Sync,
            (false, true) => Heard::Frame,
            (false, false) => Heard::Nothing,
        }
    }

    fn on_lockstep_sync(&mut self, index: usize) -> Result<(), ServerError> {
        if self.wires[index].synced.is_some() {
            self.hear_the_others();
            // Another bus missed its SYNC: its drives keep their targets, and time goes on.
            self.finish_sync()?;
        }
        self.latch(index);
        if self.wires.iter().all(|wire| wire.synced.is_some()) { self.finish_sync() } else { Ok(()) }
    }

    /// Looks once more at the buses without a SYNC: it was sent before the one that has just come on another bus, so it is
    /// there unless it was lost. This process may have been away since it looked at them.
    fn hear_the_others(&mut self) {
        for index in 0..self.wires.len() {
            while self.wires[index].synced.is_none() {
                match self.hear(index, Duration::ZERO, &mut true) {
                    Heard::Nothing => break,
                    Heard::Frame => {}
                    Heard::Sync => self.latch(index),
                }
            }
        }
    }

    /// The first half of a SYNC on a bus.
    fn latch(&mut self, index: usize) {
        let now_ns = self.now_ns;
        let wire = &mut self.wires[index];
        // What is ready up to the SYNC itself, if it passed, belongs to this period.
        let mut heard = std::mem::take(&mut wire.late_syncs);
        while let Some(received) = wire.bus.next_ready() {
            if is_sync(&received.frame) {
                heard += 1;
                break;
            }
            wire.bank.on_frame(&received.frame, now_ns);
        }
        wire.synced = Some(heard);
        if heard > 0 {
            wire.bank.drives_mut().iter_mut().for_each(|drive| drive.latch_sync(now_ns));
        }
    }

    fn finish_sync(&mut self) -> Result<(), ServerError> {
        self.served.syncs += 1;
        self.period()?;
        let now_ns = self.now_ns;
        for wire in &mut self.wires {
            let heard = wire.synced.take().unwrap_or(0);
            for _ in 0..heard {
                wire.bank.drives_mut().iter_mut().for_each(|drive| drive.answer_sync(now_ns));
            }
            wire.over = true;
        }
        self.poll_drives();
        Ok(())
    }

    /// A period of lockstep: arm, clock, feedback, trace.
    fn period(&mut self) -> Result<(), ServerError> {
        self.break_what_is_due();
        self.advance(self.period_s)?;
        self.now_ns += seconds_to_ns(self.period_s);
        self.clock.advance_to(self.now_ns);
        self.disturb_wires();
        self.give_feedback(0.0);
        self.record()
    }

    fn realtime(&mut self, stop: &AtomicBool) -> Result<(), ServerError> {
        // In the place of hardware: before whatever else runs, behind the controller. Not granted, it is late more often.
        realtime::enter(&realtime::Request {
            priority: Some(PRIORITY),
            cpus: Vec::new(),
            lock_memory: false,
            prefault_stack: 0,
            flush_denormals: false,
        });
        let mut reached_ns = monotonic_ns();
        self.now_ns = reached_ns;
        self.record()?;
        while !stop.load(Ordering::Relaxed) {
            // Read before the buses: what they hold afterwards is newer.
            let looked_ns = monotonic_ns();
            let turn = if self.wires.len() == 1 { WAIT_MAX } else { TURN };
            let wait = Duration::from_nanos((reached_ns + self.step_ns()).saturating_sub(looked_ns)).min(turn);
            let mut busy = false;
            for index in 0..self.wires.len() {
                while let Some(received) = self.receive(index, wait, &mut busy) {
                    // In the order of the wire, at the time of the wire: a plant that was kept from its processor finds
                    // its drives' frames before it finds their time-outs, as a drive with a processor of its own does.
                    self.now_ns = self.now_ns.max(received.time_ns.min(monotonic_ns()));
                    reached_ns = self.advance_to(reached_ns, self.now_ns)?;
                    if Message::of(&received.frame) == Some(Message::Sync) {
                        self.served.syncs += u64::from(index == 0);
                        let ahead_ns = self.now_ns.saturating_sub(reached_ns).min(self.step_ns());
                        self.give_feedback(ahead_ns as f64 * 1e-9);
                    }
                    self.wires[index].bank.on_frame(&received.frame, self.now_ns);
                    self.flush();
                }
            }
            if !busy {
                self.now_ns = self.now_ns.max(looked_ns);
                let before_ns = reached_ns;
                reached_ns = self.advance_to(reached_ns, self.now_ns)?;
                if reached_ns > before_ns {
                    // For who reads objects by SDO; a SYNC reads the encoders anew.
                    self.give_feedback(0.0);
                }
                self.poll_drives();
            }
        }
        Ok(())
    }

    fn step_ns(&self) -> u64 {
        seconds_to_ns(self.step_s)
    }

    /// Real time: the steps that are due at a time; the time reached.
    fn advance_to(&mut self, mut reached_ns: u64, to_ns: u64) -> Result<u64, ServerError> {
        let step_ns = self.step_ns();
        let per_record = (self.period_s / self.step_s).round().max(1.0) as u64;
        while reached_ns + step_ns <= to_ns {
            let now_ns = monotonic_ns();
            let behind_ns = now_ns.saturating_sub(reached_ns);
            if behind_ns > BEHIND_MAX.as_nanos() as u64 {
                self.served.given_up_ns += behind_ns - step_ns;
                reached_ns = now_ns - step_ns;
            }
            self.served.late += u64::from(behind_ns >= 2 * step_ns);
            reached_ns += step_ns;
            self.break_what_is_due();
            self.advance(self.step_s)?;
            self.disturb_wires();
            if self.served.steps.is_multiple_of(per_record) {
                self.record_at(reached_ns)?;
            }
        }
        Ok(reached_ns)
    }

    /// The next frame of a bus. Waits only if no bus had one in this round.
    fn receive(&mut self, index: usize, wait: Duration, busy: &mut bool) -> Option<Received> {
        let wait = if *busy { Duration::ZERO } else { wait };
        // A bus that is down comes back by itself; meanwhile `receive` waits its time, and drives hear nothing.
        let received = self.wires[index].bus.receive(wait).ok().flatten()?;
        *busy = true;
        Some(received)
    }

    fn poll_drives(&mut self) {
        for wire in &mut self.wires {
            wire.bank.poll(self.now_ns);
        }
        self.flush();
    }

    /// Advances the arm with the torques as they are.
    fn advance(&mut self, dt_s: f64) -> Result<(), ServerError> {
        for (cable, &(bus, place)) in self.places.iter().enumerate() {
            let drive = &self.wires[bus].bank.drives()[place];
            self.actions[cable] = match self.voices[cable] {
                Voice::Dead => DriveAction { enabled: false, torque_permille: 0 },
                _ => DriveAction {
                    enabled: drive.state() == State::OperationEnabled,
                    torque_permille: drive.torque_permille(),
                },
            };
        }
        self.served.steps += 1;
        let at_s = self.rig.time_s();
        self.rig.advance(&self.actions, dt_s).map_err(|source| ServerError::Diverged { at_s, source })
    }

    fn give_feedback(&mut self, ahead_s: f64) {
        for wire in &mut self.wires {
            for (drive, &cable) in wire.bank.drives_mut().iter_mut().zip(&wire.cables) {
                let (counts, rate) = self.rig.encoder(cable, ahead_s);
                drive.set_feedback(counts, rate, self.rig.torque(cable, drive.torque_permille()));
            }
        }
    }

    fn break_what_is_due(&mut self) {
        let Some(since_s) = self.rig.since_enabled_s() else { return };
        while let Some((cable, kind)) = self.schedule.due(since_s) {
            tracing::warn!(cable = cable + 1, ?kind, at_s = since_s, "fault by command");
            self.rig.break_drum(cable, kind);
            let (bus, place) = self.places[cable];
            match kind {
                FaultKind::Silence => self.voices[cable] = Voice::Silent,
                FaultKind::Dead => self.voices[cable] = Voice::Dead,
                FaultKind::Trip => {
                    let now_ns = self.now_ns;
                    if let Some(drive) = self.wires[bus].bank.drives_mut().get_mut(place) {
                        drive.trip(code::OVER_CURRENT, register::CURRENT, now_ns);
                    }
                }
                FaultKind::Reboot => {
                    let now_ns = self.now_ns;
                    if let Some(drive) = self.wires[bus].bank.drives_mut().get_mut(place) {
                        drive.power_cycle(now_ns);
                    }
                }
                FaultKind::Press => {
                    if let Some(drive) = self.wires[bus].bank.drives_mut().get_mut(place) {
                        drive.press(true);
                    }
                }
                FaultKind::Stick | FaultKind::Jump(_) | FaultKind::Pull(_) => {}
            }
        }
    }

    /// Sets the shims to the faults of this time: for the answers of the period that has ended, and for what the
    /// controller sends in the next one.
    fn disturb_wires(&mut self) {
        if self.wire_faults.is_empty() {
            return;
        }
        let Some(since_s) = self.rig.since_enabled_s() else { return };
        let first = !std::mem::replace(&mut self.wires_seeded, true);
        if !self.wire_faults.advance_to(since_s) && !first {
            return;
        }
        let period = Duration::from_secs_f64(self.period_s);
        for (index, wire) in self.wires.iter_mut().enumerate() {
            if first {
                // Frames before this one are as many as the start happened to need.
                wire.bus.reseed(self.wire_seed.wrapping_add(index as u64));
            }
            let nodes: Vec<u8> = wire.bank.drives().iter().map(|drive| drive.node().get()).collect();
            let plans = self.wire_faults.plans(&nodes, period);
            if let Err(error) = wire.bus.set_plans(&plans, &plans) {
                tracing::warn!(%error, "faults on the wire"); // the probabilities were checked when they were read
            }
        }
    }

    fn record(&mut self) -> Result<(), ServerError> {
        self.record_at(self.now_ns)
    }

    fn record_at(&mut self, time_ns: u64) -> Result<(), ServerError> {
        if let Some(trace) = &mut self.trace {
            trace.add(&self.rig, time_ns, self.served.syncs);
            if self.pace == Pace::Lockstep && trace.dropped() > 0 {
                // The disk has refused; it says why at the end of the file.
                self.trace.take().map_or(Ok(0), Trace::finish)?;
            }
        }
        Ok(())
    }

    /// Sends what waits; stops at a full queue.
    fn flush(&mut self) {
        for wire in &mut self.wires {
            while let Some(frame) = wire.bank.pop() {
                let sender = wire.bank.drives().iter().position(|d| is_from(&frame, d.node()));
                let voice = sender.map_or(Voice::Whole, |place| self.voices[wire.cables[place]]);
                if voice == Voice::Dead || voice == Voice::Silent && is_process_data(&frame) {
                    continue;
                }
                if wire.outbox.len() == OUTBOX_MAX {
                    wire.outbox.pop_front();
                    self.served.dropped += 1;
                }
                wire.outbox.push_back(frame);
            }
            while let Some(frame) = wire.outbox.front() {
                match wire.bus.send(frame) {
                    Ok(()) => {}
                    Err(SendError::Full) => break,
                    // The bus is off or down: a real controller loses such frames too.
                    Err(_) => self.served.dropped += 1,
                }
                wire.outbox.pop_front();
            }
            if wire.over && wire.outbox.is_empty() {
                let _ = wire.bus.send_due(); // refused frames are counted by the shim
                // Refused by a queue that is full: with the next look.
                wire.over = wire.bus.inner_mut().send(&time_frame(self.now_ns)) == Err(SendError::Full);
            }
        }
    }
}

fn is_sync(frame: &Frame) -> bool {
    Message::of(frame) == Some(Message::Sync)
}

fn is_from(frame: &Frame, node: NodeId) -> bool {
    matches!(frame.id(), Id::Standard(id) if id & 0x7f == u16::from(node.get()))
}

fn is_process_data(frame: &Frame) -> bool {
    matches!(frame.id(), Id::Standard(id) if matches!(id & 0x780, 0x180 | 0x280 | 0x380 | 0x480))
}
