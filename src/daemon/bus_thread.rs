//! The bus thread: what the buses return becomes encoder states in shared memory; what the supervisor wants of the
//! drives becomes their state machines.
//!
//! Enters: frames of every bus, the control thread's wish. Leaves: `encoders` in shared memory, the drives' state for
//! the control thread, statistics of the buses. It must never send torques: that is the control thread's business.

use super::drive_causes::{
    CHANGED, HEARTBEAT_LOST, Memory, NO_EMERGENCY, NO_FEEDBACK, NODE_ID_TAKEN, NOT_USABLE, cause_of,
};
use super::drive_faults::{Gathered, lacking};
use super::link::{DrivesEnd, LoopTime, Progress};
use super::status::{BusStatus, DriveStatus, Shared};
use crate::config::{BusConfig, BusKind, CableNames, Config};
use crate::control::{DrivesInput, DrivesPhase, cause_text};
use crate::ipc::SourcePublisher;
use crate::ipc::payload::{EncoderSource, Encoders};
use sinew_hal::can::{CanBus, Received};
use sinew_hal::canopen::emcy::code::RPDO_TIMEOUT;
use sinew_hal::canopen::{Message, NodeId};
use sinew_hal::cia402::{CycleWriter, Decoder, DriveMask, Event, Fault, Goal, Master, Phase, State};
use sinew_hal::clock::{Naps, monotonic_ns};
use sinew_hal::load::{BitRates, Shape};
use sinew_hal::motor_bank::MotorBank;
use sinew_hal::virtual_bus::{Role, is_claimed};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Source id of the encoder states.
pub const ENCODER_SOURCE_ID: u32 = 1;
/// How long one bus is listened to while the others wait.
const TURN: Duration = Duration::from_micros(100);
/// The same where there is no other.
const TURN_ALONE: Duration = Duration::from_millis(1);
/// Frames taken from one bus before the next has its turn.
const FRAMES_PER_TURN: usize = 128;
/// Pause between two attempts to bring drives up (ns).
const RETRY_NS: u64 = 1_000_000_000;
/// In lockstep: real time without a frame after which what is missing is given up (ns), unless the process that stands for
/// the drives is known to live: then nothing but its end ends the waiting. Long, for whoever is silent may have no processor,
/// or an emulated one.
const SILENCE_NS: u64 = 4_000_000_000;
/// Silence that shows that all answers have come (ns).
const QUIET_NS: u64 = 50_000_000;
/// Time that drives are given for their answers to a SYNC at any period (ns): two dozen frames on a shared bus take a good
/// part of a millisecond.
const ANSWERS_NS: u64 = 2_000_000;
/// Heartbeats under the master's own node id, above those that it sent, that show another node.
const OWN_HEARTBEATS: u64 = 2;
/// Interval at which is asked whether the plant lives (ns).
const LIVES_NS: u64 = 500_000_000;
/// Interval of the statistics (ns).
const STATISTICS_NS: u64 = 500_000_000;

/// One bus as this thread listens to it.
struct Line {
    bus: Box<dyn CanBus>,
    rates: BitRates,
    busy_s: f64,
    /// Share of the time in which frames were on the wire, as last measured.
    load: f64,
    frames: u64,
    /// Lockstep: the newest cycle that the plant has said to be over.
    over: u64,
    /// Heartbeats under the master's own node id.
    own_heartbeats: u64,
}

/// Everything that the bus thread owns.
pub(crate) struct BusThread {
    lines: Vec<Line>,
    master: Master,
    decoder: Decoder,
    bank: MotorBank,
    link: DrivesEnd,
    publisher: SourcePublisher<Encoders>,
    message: Box<Encoders>,
    counts: Vec<i32>,
    lengths: Vec<f64>,
    memory: Vec<Memory>,
    node_to_drive: Vec<(usize, u8)>,
    master_node: NodeId,
    time: LoopTime,
    period_ns: u64,
    /// Cycle whose answers belong to tick 0 (lockstep).
    base_cycle: u64,
    /// Cycle whose feedback was published last.
    published: u64,
    /// CLOCK_MONOTONIC at the first tick of lockstep (ns): the master's clock goes on from there.
    epoch_ns: u64,
    failed_since_ns: Option<u64>,
    input: DrivesInput,
    /// Lockstep: drives that did not answer in time and are not waited for until they do.
    given_up: DriveMask,
    /// Cycle that the last published reading of each drive answered.
    taken: Vec<u64>,
    /// Drives ready and enabled.
    counts_up: (usize, usize),
    /// Cycles without an answer after which a drive's state is unknown.
    mute_cycles: u64,
    /// Virtual buses, whose drives are a process that can be asked for; empty where a bus is none.
    virtual_buses: Vec<String>,
    /// Bit of the statusword that is the input of an emergency stop, and whether it is pressed at 0.
    emergency_bit: Option<(u8, bool)>,
    /// What drives lack, as it was told last.
    lack: BTreeMap<String, usize>,
    /// What is wrong with drives, for the log.
    gathered: Gathered,
    cables: CableNames,
    /// The bus on which another node was heard under the master's id.
    id_taken_on: Option<usize>,
    /// Whether it lived when it was asked for last, and when that was (ns).
    lives: (bool, u64),
    shared: Arc<Shared>,
    statistics_ns: u64,
    /// The loop's time at the last statistics (ns).
    statistics_loop_ns: u64,
}

impl BusThread {
    /// Puts it together; `buses` are handles of their own. The master has not been started.
    pub(crate) fn new(
        config: &Config,
        master: Master,
        bank: MotorBank,
        buses: Vec<Box<dyn CanBus>>,
        link: DrivesEnd,
        publisher: SourcePublisher<Encoders>,
        time: LoopTime,
        shared: Arc<Shared>,
    ) -> Self {
        let cables = config.arm.cable_count();
        let line = |(bus, settings): (Box<dyn CanBus>, &BusConfig)| Line {
            bus,
            rates: BitRates { nominal: settings.bitrate_bps, data: settings.data_bitrate_bps },
            busy_s: 0.0,
            load: 0.0,
            frames: 0,
            over: 0,
            own_heartbeats: 0,
        };
        Self {
            lines: buses.into_iter().zip(&config.drives.buses).map(line).collect(),
            decoder: master.decoder(),
            master_node: master.config().node,
            master,
            bank,
            link,
            publisher,
            message: Box::default(),
            counts: vec![0; cables],
            lengths: vec![0.0; cables],
            memory: vec![Memory::default(); cables],
            node_to_drive: config.drives.drives.iter().map(|d| (d.bus, d.node_id)).collect(),
            time,
            period_ns: super::tick::period_ns(config),
            base_cycle: 0,
            published: 0,
            epoch_ns: 0,
            failed_since_ns: None,
            input: DrivesInput::default(),
            given_up: DriveMask::default(),
            taken: vec![0; config.drives.drives.len()],
            counts_up: (0, 0),
            mute_cycles: (config.drives.heartbeat_timeout_s / config.timing.period_s).ceil() as u64,
            virtual_buses: match config.drives.buses.iter().all(|bus| bus.kind == BusKind::Virtual) {
                true => config.drives.buses.iter().map(|bus| bus.interface.clone()).collect(),
                false => Vec::new(),
            },
            emergency_bit: config.drives.emergency_stop_bit.map(|bit| (bit, config.drives.emergency_stop_low)),
            lack: BTreeMap::new(),
            gathered: Gathered::new(config.arm.cable_names()),
            cables: config.arm.cable_names(),
            id_taken_on: None,
            lives: (false, 0),
            shared,
            statistics_ns: 0,
            statistics_loop_ns: 0,
        }
    }

    /// Lockstep: brings the drives up in real time, then sends the one cycle whose answers are the encoders of tick 0.
    /// The sender of cycles, or how many drives were operational when the time was over.
    ///
    /// Meanwhile the master sends cycles of zero torque, for the clock of a plant in lockstep goes by SYNC. Nothing moves
    /// in it before drives are enabled, so it does not matter how many there are.
    pub(crate) fn bring_up(&mut self, within: Duration, progress: &Progress) -> Result<CycleWriter, usize> {
        let begun_ns = monotonic_ns();
        self.master.start(begun_ns);
        loop {
            let now_ns = monotonic_ns();
            self.listen(now_ns, Duration::ZERO);
            let state = self.master.poll(now_ns);
            self.note_faults(now_ns);
            if state.ready == state.drives {
                break;
            }
            let late = now_ns.saturating_sub(begun_ns) > within.as_nanos() as u64 && !self.plant_lives();
            if late || progress.stop.load(Ordering::Acquire) {
                return Err(state.ready);
            }
            self.retry(now_ns, state.failed);
            self.statistics(now_ns);
        }
        // Answers to the master's own cycles must not be taken for those to the next one.
        let Some(mut writer) = self.master.take_writer() else { return Err(0) };
        let mut quiet_since_ns = monotonic_ns();
        while monotonic_ns().saturating_sub(quiet_since_ns) < QUIET_NS {
            if self.listen(monotonic_ns(), Duration::ZERO).frames > 0 {
                quiet_since_ns = monotonic_ns();
            }
        }
        self.epoch_ns = monotonic_ns();
        self.published = self.decoder.cycle();
        self.update_input();
        self.base_cycle = writer.write_cycle(&[]).cycle;
        Ok(writer)
    }

    /// Number of drives.
    pub(crate) fn drive_count(&self) -> usize {
        self.memory.len()
    }

    /// Starts the drives (real time).
    pub(crate) fn start(&mut self) {
        self.master.start(monotonic_ns());
    }

    /// Runs until told to end.
    pub(crate) fn run(mut self, progress: &Progress) {
        let mut silence = Naps::begin();
        while !progress.bus_stop.load(Ordering::Acquire) {
            let real_ns = monotonic_ns();
            // In lockstep nothing is due between two frames.
            let heard = self.listen(real_ns, if self.time.is_lockstep() { silence.length() } else { Duration::ZERO });
            if heard.frames > 0 {
                silence = Naps::begin();
            }
            if self.time.is_lockstep() {
                let stops = progress.stop.load(Ordering::Acquire);
                self.lockstep(heard.cycle, silence.waited_ns(), stops);
            } else {
                self.follow(monotonic_ns());
                self.publish_late(real_ns);
            }
            self.statistics(real_ns);
        }
        self.gathered.due(u64::MAX).iter().for_each(|line| tracing::warn!("{line}"));
    }

    /// Real time: the wish, the drives, the state.
    fn follow(&mut self, now_ns: u64) {
        self.obey(now_ns);
        let state = self.master.poll(now_ns);
        self.note_faults(now_ns);
        if self.link.is_disarmed() {
            self.retry(now_ns, state.failed);
        }
        self.update_input();
    }

    /// Lockstep: everything happens at the end of a cycle, which is the plant's mark, or the last answer to a SYNC where
    /// drives are alone, so that a run does not depend on when this thread was scheduled; the state is there before the
    /// encoders that release the tick.
    fn lockstep(&mut self, complete: Option<u64>, silent_ns: u64, stops: bool) {
        let cycle = match complete {
            // A late answer can complete a cycle that was given up: its tick has been.
            Some(cycle) if cycle <= self.published => return,
            Some(cycle) => cycle,
            // Somebody does not answer any more: what there is goes out, and the guard has its say.
            None if silent_ns > SILENCE_NS
                && self.published < self.decoder.cycle()
                && (stops || !self.plant_lives()) =>
            {
                self.decoder.cycle()
            }
            None => return,
        };
        let tick = cycle.saturating_sub(self.base_cycle);
        let now_ns = self.epoch_ns + tick * self.period_ns;
        self.follow(now_ns);
        if complete.is_none() {
            self.given_up = self.decoder.missing();
        }
        if complete.is_none() && self.decoder.missing() == self.all() {
            self.input.phase = DrivesPhase::Off;
            self.input.bus_lost = Some(0);
            self.link.write(self.input);
        }
        let missing = self.decoder.missing();
        self.publish(cycle, tick * self.period_ns, Some(tick), missing);
    }

    /// Receives what waits, on all buses. Where nothing does, each bus has its turn, for as long as `wait` if that is
    /// longer.
    fn listen(&mut self, now_ns: u64, wait: Duration) -> Heard {
        let turn = if self.lines.len() == 1 { TURN_ALONE } else { TURN }.max(wait);
        let mut heard = Heard::default();
        for index in 0..self.lines.len() {
            let mut wait = turn;
            for _ in 0..FRAMES_PER_TURN {
                let line = &mut self.lines[index];
                let Ok(Some(received)) = line.bus.receive(wait) else { break };
                let frame = &received.frame;
                let extended = matches!(frame.id(), sinew_hal::can::Id::Extended(_));
                let shape = Shape { extended, kind: frame.kind(), len: frame.len() };
                line.busy_s += shape.bits(line.rates).time_s(line.rates);
                line.frames += 1;
                heard.frames += 1;
                heard.cycle = self.on_frame(index, &received, now_ns).or(heard.cycle);
                if heard.cycle.is_some() {
                    break;
                }
                // Once something has come, the rest of it is there or on the next turn.
                wait = Duration::ZERO;
            }
        }
        heard
    }

    /// One frame; the cycle that it completed.
    fn on_frame(&mut self, bus: usize, received: &Received, now_ns: u64) -> Option<u64> {
        let lockstep = self.time.is_lockstep() && self.epoch_ns != 0;
        let now_ns = if lockstep { self.epoch_ns + self.time.now_ns() } else { now_ns };
        self.master.on_frame(bus, received, now_ns);
        let message = Message::of(&received.frame);
        if message == Some(Message::Heartbeat(self.master_node)) {
            self.lines[bus].own_heartbeats += 1;
            // This handle hears the master's own too.
            if self.lines[bus].own_heartbeats > self.master.heartbeats() + OWN_HEARTBEATS && self.id_taken_on.is_none()
            {
                let node = self.master_node.get();
                tracing::error!(
                    bus,
                    node,
                    "another node has sinew's own node id: its heartbeats would keep drives alive"
                );
                self.id_taken_on = Some(bus);
            }
        }
        if let Some(Message::Heartbeat(node)) = message
            && let Some(drive) = self.node_to_drive.iter().position(|d| *d == (bus, node.get()))
        {
            self.memory[drive].lost = false;
            self.memory[drive].seen = true;
        }
        if self.time.is_lockstep() && message == Some(Message::Time) {
            // Nothing more comes of this cycle: what is missing is missing, as it is at a tick's deadline in real time.
            // Which one is said by the SYNC before it on the same bus: on another one the next may have begun.
            let cycle = self.decoder.cycle();
            self.lines[bus].over = self.decoder.bus_cycle(bus);
            let over = cycle > self.published && self.lines.iter().all(|line| line.over == cycle);
            return (lockstep && over).then_some(cycle);
        }
        let sync_before_ns = self.decoder.sync_ns();
        match self.decoder.on_frame(bus, received) {
            Event::Complete { cycle, sync_ns } => {
                self.given_up = DriveMask::default();
                if !self.time.is_lockstep() {
                    self.publish(cycle, sync_ns, None, DriveMask::default());
                }
                (!self.is_marked()).then_some(cycle)
            }
            // The next SYNC is here: who has not answered by now did not answer this one.
            Event::Incomplete { cycle, missing }
                if !self.time.is_lockstep() && cycle > self.published && missing != self.all() =>
            {
                self.publish(cycle, sync_before_ns, None, missing);
                None
            }
            Event::Feedback(drive) if lockstep => {
                self.given_up.0 &= !(1 << drive);
                let cycle = self.decoder.cycle();
                // Whoever was given up is not waited for tick by tick.
                let all = cycle > self.published && self.decoder.missing().0 & !self.given_up.0 == 0;
                (all && !self.is_marked()).then_some(cycle)
            }
            _ => None,
        }
    }

    /// Real time: a cycle that is not complete half a period after its SYNC goes out as it is; with short periods the
    /// next SYNC comes first.
    fn publish_late(&mut self, now_ns: u64) {
        let (cycle, sync_ns) = (self.decoder.cycle(), self.decoder.sync_ns());
        let missing = self.decoder.missing();
        let late = now_ns.saturating_sub(sync_ns) > (self.period_ns / 2).max(ANSWERS_NS);
        if cycle > self.published && missing != self.all() && late {
            self.publish(cycle, sync_ns, None, missing);
        }
    }

    /// Lockstep: whether there is a plant that says when a period is over. Then nothing else ends a cycle, not even the
    /// last answer: the mark would come into the next one and end that before its time.
    fn is_marked(&self) -> bool {
        self.lines.iter().any(|line| line.over > 0)
    }

    /// Whether a process is known to stand for the drives. One that is stopped, or has no processor, lives.
    fn plant_lives(&mut self) -> bool {
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(self.lives.1) > LIVES_NS {
            let claimed = self.virtual_buses.iter().all(|bus| is_claimed(bus, Role::Drives));
            self.lives = (claimed && !self.virtual_buses.is_empty(), now_ns);
        }
        self.lives.0
    }

    /// All drives.
    fn all(&self) -> DriveMask {
        DriveMask::first(self.memory.len())
    }

    /// Of those who did not answer a cycle, who has told nothing new for [`ANSWERS_NS`] either. At short periods a bus that
    /// is served after the others may answer every cycle just after the next one began: it is late, not silent.
    fn silent(&self, cycle: u64, missing: DriveMask) -> DriveMask {
        let mut silent = DriveMask::default();
        for drive in missing.iter().take_while(|drive| *drive < self.taken.len()) {
            let answered = self.decoder.feedback()[drive].cycle;
            let late_ns = cycle.saturating_sub(answered).saturating_mul(self.period_ns);
            if answered <= self.taken[drive] || late_ns > ANSWERS_NS {
                silent.insert(drive);
            }
        }
        silent
    }

    /// Publishes the feedback of a cycle; drives that did not answer have no valid entry.
    fn publish(&mut self, cycle: u64, capture_ns: u64, tick: Option<u64>, missing: DriveMask) {
        let missing = if tick.is_some() { missing } else { self.silent(cycle, missing) };
        for (taken, feedback) in self.taken.iter_mut().zip(self.decoder.feedback()) {
            *taken = feedback.cycle;
        }
        for (count, feedback) in self.counts.iter_mut().zip(self.decoder.feedback()) {
            *count = feedback.position_counts;
        }
        if self.bank.decode_lengths_into(&self.counts, &mut self.lengths).is_err() {
            return; // one number per drive, by construction
        }
        let cables = self.lengths.len();
        let message = &mut *self.message;
        message.source = EncoderSource::Drives.wire();
        message.set_all_valid(cables);
        message.length_m[..cables].copy_from_slice(&self.lengths);
        for (cable, (channel, feedback)) in self.bank.channels().iter().zip(self.decoder.feedback()).enumerate() {
            message.tension_n[cable] = channel.decode_tension(feedback.torque_permille);
        }
        for cable in missing.iter().take_while(|cable| *cable < cables) {
            message.length_valid[cable / 64] &= !(1 << (cable % 64));
            message.tension_valid[cable / 64] &= !(1 << (cable % 64));
        }
        let published = match tick {
            Some(tick) => self.publisher.publish_for_tick(message, capture_ns, tick),
            None => self.publisher.publish(message, capture_ns),
        };
        self.published = cycle;
        if let Err(error) = published {
            // Not heard, it is an encoder that is silent: the guard's business.
            tracing::warn!(%error, "encoders not published");
        }
    }

    /// Carries out what the supervisor wants.
    fn obey(&mut self, now_ns: u64) {
        if self.link.take_reset() {
            let unusable = self.master.status().any(|s| s.phase == Phase::Failed);
            // What was changed from outside is set anew.
            let changed = self.memory.iter().any(|m| m.sticky == Some(CHANGED));
            self.memory.iter_mut().for_each(|m| (m.sticky, m.emergency) = (None, None));
            // A drive that keeps its torque in fault is let go of slowly, which a start does.
            if unusable || changed || self.master.may_hold() || self.memory.iter().any(|m| m.lost) {
                self.master.start(now_ns);
            } else {
                self.master.reset_faults(now_ns);
            }
        }
        let goal = if self.link.wants_torque() { Goal::Enabled } else { Goal::Disabled };
        if goal != self.master.goal() {
            self.master.set_goal(goal, now_ns);
        }
    }

    /// Takes over the master's faults, and says each once.
    fn note_faults(&mut self, now_ns: u64) {
        self.gathered.due(now_ns).iter().for_each(|line| tracing::warn!("{line}"));
        for fault in self.master.take_faults() {
            self.gathered.add(now_ns, &fault);
            let memory = &mut self.memory[fault.drive];
            match fault.fault {
                // What follows the first is its consequence as a rule.
                Fault::Emergency(e) => {
                    memory.emergency.get_or_insert(u32::from(e.code));
                    // A drive need not go into fault for it, but one that does not get its torques must not be used.
                    if e.code == RPDO_TIMEOUT {
                        memory.sticky = Some(u32::from(e.code));
                    }
                }
                Fault::HeartbeatLost { .. } => memory.lost = true,
                other => memory.sticky = Some(cause_of(&other)),
            }
        }
    }

    /// Starts over, a while after a drive was found unusable and while nothing moves.
    fn retry(&mut self, now_ns: u64, failed: usize) {
        if failed == 0 {
            self.failed_since_ns = None;
            return;
        }
        let since_ns = *self.failed_since_ns.get_or_insert(now_ns);
        if now_ns.saturating_sub(since_ns) > RETRY_NS {
            self.failed_since_ns = None;
            self.memory.iter_mut().for_each(|m| (m.sticky, m.emergency) = (None, None));
            self.master.start(now_ns);
        }
    }

    /// What the control thread sees.
    fn update_input(&mut self) {
        let (mut enabled, mut powered, mut ready, mut fault) = (0, 0, 0, None);
        let cycle = self.decoder.cycle();
        let drives = self.master.status().zip(&mut self.memory).zip(self.decoder.feedback()).enumerate();
        for (cable, ((status, memory), feedback)) in drives {
            let state = status.state();
            let up = status.phase == Phase::Ready && !memory.lost;
            // What it said last is no longer known to be true.
            let mute = up && status.statusword.is_some() && cycle.saturating_sub(feedback.cycle) > self.mute_cycles;
            memory.mute = mute;
            let state = state.filter(|_| up && !mute);
            let faulted = matches!(state, Some(State::Fault | State::FaultReactionActive));
            enabled += usize::from(state == Some(State::OperationEnabled));
            powered += usize::from(matches!(
                state,
                Some(State::ReadyToSwitchOn | State::SwitchedOn | State::OperationEnabled | State::QuickStopActive)
            ));
            let cause = if memory.lost {
                Some(HEARTBEAT_LOST)
            } else if status.phase == Phase::Failed {
                Some(memory.sticky.unwrap_or(NOT_USABLE))
            } else if mute {
                Some(NO_FEEDBACK)
            } else if faulted {
                Some(memory.emergency.or(memory.sticky).unwrap_or(NO_EMERGENCY))
            } else {
                memory.sticky
            };
            ready += usize::from(up && cause.is_none() && status.statusword.is_some());
            fault = fault.or(cause.map(|cause| (cable as u16, cause)));
        }
        if self.id_taken_on.is_some() {
            fault = fault.or(Some((0, NODE_ID_TAKEN)));
        }
        let count = self.memory.len();
        // Off only when the last one has gone all the way: an ordered stop waits for that.
        let phase = match (enabled, powered) {
            (_, 0) => DrivesPhase::Off,
            (n, _) if n == count => DrivesPhase::Enabled,
            _ => DrivesPhase::Changing,
        };
        self.counts_up = (ready, enabled);
        let bus_lost = (0..self.lines.len()).find(|bus| self.is_lost(*bus)).map(|bus| bus as u16);
        let ready = ready == count && self.id_taken_on.is_none();
        self.input = DrivesInput { phase, ready, fault, bus_lost, emergency_stop: self.emergency_stop() };
        self.link.write(self.input);
    }

    /// The first drive whose emergency stop is pressed. What a drive said last counts until it says something else.
    fn emergency_stop(&self) -> Option<u16> {
        let (bit, low) = self.emergency_bit?;
        let pressed = |word: u16| (word >> bit & 1 == 0) == low;
        self.master.status().position(|s| s.statusword.is_some_and(pressed)).map(|cable| cable as u16)
    }

    /// The bus carries nothing, or none of its drives that were there is heard or answers SYNC.
    fn is_lost(&self, bus: usize) -> bool {
        if !self.lines[bus].bus.state().carries_frames() {
            return true;
        }
        let mut drives = self.node_to_drive.iter().zip(&self.memory).filter(|(d, m)| d.0 == bus && m.seen).peekable();
        drives.peek().is_some() && drives.all(|(_, m)| m.lost || m.mute)
    }

    /// Statistics for `sinew status`, twice a second.
    fn statistics(&mut self, real_ns: u64) {
        let elapsed_ns = real_ns.saturating_sub(self.statistics_ns);
        if elapsed_ns < STATISTICS_NS {
            return;
        }
        self.statistics_ns = real_ns;
        // In lockstep the wire's time is the loop's, however long a tick takes to compute, and of that too a measurement
        // takes so long. Before the first tick it stands, and the load is that of bringing the drives up.
        let loop_ns = self.time.now_ns();
        let wire_ns = match self.time.is_lockstep() && loop_ns > 0 {
            true => loop_ns.saturating_sub(self.statistics_loop_ns),
            false => elapsed_ns,
        };
        let measured = wire_ns >= STATISTICS_NS;
        if measured {
            self.statistics_loop_ns = loop_ns;
        }
        let line = |(bus, line): (usize, &mut Line)| {
            if measured {
                line.load = std::mem::take(&mut line.busy_s) / (1e-9 * wire_ns as f64);
            }
            BusStatus {
                load_measured: line.load,
                state: format!("{:?}", line.bus.state()),
                frames: line.frames,
                lost: line.bus.counters().lost,
                unsent: self.master.unsent(bus),
            }
        };
        let buses = self.lines.iter_mut().enumerate().map(line).collect();
        let mut lack = BTreeMap::new();
        for status in self.master.status() {
            status.absent.iter().for_each(|object| *lack.entry(lacking(*object)).or_insert(0) += 1);
        }
        if lack != self.lack {
            lack.iter().for_each(|(what, drives)| tracing::warn!(drives, "drives lack {what}"));
            self.lack.clone_from(&lack);
        }
        let first = self.input.fault;
        let drives = DriveStatus {
            count: self.memory.len(),
            ready: self.counts_up.0,
            enabled: self.counts_up.1,
            lack,
            fault: first.map(|(cable, cause)| {
                let (bus, node) = self.node_to_drive[usize::from(cable)];
                match self.id_taken_on {
                    Some(bus) if cause == NODE_ID_TAKEN => format!("bus {bus}: {}", cause_text(cause)),
                    _ => format!(
                        "{} (bus {bus}, node {node}): {}",
                        self.cables.words(usize::from(cable)),
                        cause_text(cause)
                    ),
                }
            }),
        };
        self.shared.set_wires(buses, drives);
    }
}

/// What a round of listening brought.
#[derive(Debug, Clone, Copy, Default)]
struct Heard {
    frames: usize,
    cycle: Option<u64>,
}
