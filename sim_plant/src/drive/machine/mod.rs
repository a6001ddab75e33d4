//! The drive: NMT slave, SDO server, PDOs, heartbeats, emergency objects, power state machine, torque.

mod access;
mod traffic;

use super::objects::{CONSUMERS, HISTORY, Nameplate, dictionary};
use super::pdo;
use access::Objects;
use sinew_hal::can::{Frame, Id, Kind};
use sinew_hal::canopen::cob::{self, NodeId};
use sinew_hal::canopen::emcy::{code, register};
use sinew_hal::canopen::sdo_server::SdoServer;
use sinew_hal::canopen::{Emergency, Message, NmtCommand, NmtState, ObjectDictionary};
use sinew_hal::cia402::objects as o;
use sinew_hal::cia402::state::{Command, FOLLOWS_TARGET, INTERNAL_LIMIT, REMOTE, State, VOLTAGE_ENABLED};
use std::collections::VecDeque;
use traffic::Traffic;

/// Bit of the statusword that shows the emergency stop.
const EMERGENCY_STOP: u16 = 1 << 14;

/// A consumed heartbeat (object 1016).
#[derive(Debug, Clone, Copy, Default)]
struct Consumer {
    node: u8,
    timeout_ns: u64,
    /// Time of the last heartbeat; monitoring starts with the first one (CiA 301).
    last_ns: Option<u64>,
    lost: bool,
}

/// A simulated drive on one node.
#[derive(Debug, Clone)]
pub struct Drive {
    node: NodeId,
    dictionary: ObjectDictionary,
    sdo: SdoServer,
    out: VecDeque<Frame>,
    nmt: NmtState,
    state: State,
    controlword: u16,
    traffic: Traffic,
    heartbeat_due_ns: Option<u64>,
    consumers: [Consumer; CONSUMERS as usize],
    sync_ns: Option<u64>,
    sync_lost: bool,
    /// Torque applied (per mille); fractional, for slopes.
    torque: f64,
    /// Where the torque goes in fault reaction and fault (per mille).
    fault_torque: f64,
    now_ns: u64,
    syncs: u64,
    /// The emergency stop at its input is pressed.
    pressed: bool,
}

impl Drive {
    /// A drive that has just been powered: it announces itself with the first [`Self::poll`] or frame.
    pub fn new(node: NodeId, nameplate: Nameplate, now_ns: u64) -> Self {
        let mut drive = Self {
            node,
            dictionary: dictionary(node.get(), nameplate),
            sdo: SdoServer::new(),
            out: VecDeque::with_capacity(16),
            nmt: NmtState::BootUp,
            state: State::NotReadyToSwitchOn,
            controlword: 0,
            traffic: Traffic::default(),
            heartbeat_due_ns: None,
            consumers: Default::default(),
            sync_ns: None,
            sync_lost: false,
            torque: 0.0,
            fault_torque: 0.0,
            now_ns,
            syncs: 0,
            pressed: false,
        };
        drive.restart(0x1000..=0x9fff);
        drive
    }

    /// Node id.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// NMT state.
    pub fn nmt(&self) -> NmtState {
        self.nmt
    }

    /// State of the power drive system.
    pub fn state(&self) -> State {
        self.state
    }

    /// The live dictionary.
    pub fn dictionary(&self) -> &ObjectDictionary {
        &self.dictionary
    }

    /// Torque that the motor applies now (per mille of rated torque, positive pulls).
    pub fn torque_permille(&self) -> i16 {
        self.torque.round() as i16
    }

    /// SYNCs served since power-up.
    pub fn syncs(&self) -> u64 {
        self.syncs
    }

    /// What the plant measures: position (counts), velocity (counts/s), torque (per mille of rated torque). It is sent
    /// with the next SYNC.
    pub fn set_feedback(&mut self, position_counts: i32, velocity_cps: i32, torque_permille: i16) {
        self.dictionary.set_int(o::POSITION, 0, position_counts.into());
        self.dictionary.set_int(o::VELOCITY, 0, velocity_cps.into());
        self.dictionary.set_int(o::TORQUE, 0, torque_permille.into());
    }

    /// Presses or releases the emergency stop at the drive's input: bit 14 of the statusword, which is the manufacturer's. The
    /// drive itself does nothing about it.
    pub fn press(&mut self, pressed: bool) {
        self.pressed = pressed;
        self.refresh_state_objects();
    }

    /// Next frame to send.
    pub fn pop(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    /// Power off and on: everything is forgotten.
    pub fn power_cycle(&mut self, now_ns: u64) {
        self.now_ns = now_ns;
        self.out.clear();
        self.restart(0x1000..=0x9fff);
    }

    /// A fault of the device itself (over-current, sensor, ...): power is cut at once, that of the reaction to another fault
    /// too.
    pub fn trip(&mut self, error_code: u16, error_register: u8, now_ns: u64) {
        self.now_ns = now_ns;
        (self.torque, self.fault_torque) = (0.0, 0.0);
        self.fault(error_code, error_register, 0.0, [0; 5]);
        // In a reaction that was under way: it has ended.
        self.slope(0);
        self.refresh_state_objects();
    }

    /// Start after power-up or reset of the indices given.
    fn restart(&mut self, indices: std::ops::RangeInclusive<u16>) {
        let application = *indices.end() > 0x1fff;
        self.dictionary.reset(indices);
        self.nmt = NmtState::BootUp;
        self.sdo = SdoServer::new();
        self.traffic = Traffic::default();
        self.consumers = Default::default();
        self.sync_ns = None;
        self.sync_lost = false;
        self.heartbeat_due_ns = None;
        if application {
            self.state = State::SwitchOnDisabled;
            self.controlword = 0;
            self.torque = 0.0;
            self.fault_torque = 0.0;
        }
        self.traffic.load(&self.dictionary);
        self.refresh_state_objects();
    }

    /// Boot-up, heartbeat, monitoring, slopes, event timers.
    pub fn poll(&mut self, now_ns: u64) {
        let elapsed_ns = now_ns.saturating_sub(self.now_ns);
        self.now_ns = self.now_ns.max(now_ns);
        if self.nmt == NmtState::BootUp {
            self.out.push_back(NmtState::BootUp.heartbeat(self.node));
            self.nmt = NmtState::PreOperational;
        }
        self.monitor();
        self.slope(elapsed_ns);
        self.produce_heartbeat();
        self.refresh_state_objects();
        self.event_driven();
    }

    fn produce_heartbeat(&mut self) {
        let period_ns = self.dictionary.int(o::HEARTBEAT_PRODUCER, 0).unsigned_abs() * 1_000_000;
        if period_ns == 0 {
            self.heartbeat_due_ns = None;
            return;
        }
        let due = *self.heartbeat_due_ns.get_or_insert(self.now_ns);
        if self.now_ns >= due {
            self.out.push_back(self.nmt.heartbeat(self.node));
            // Late by more than a period: no backlog is sent.
            self.heartbeat_due_ns = Some((due + period_ns).max(self.now_ns + period_ns / 2));
        }
    }

    /// Heartbeats, SYNC and RPDOs that should have come.
    fn monitor(&mut self) {
        for i in 0..self.consumers.len() {
            let c = self.consumers[i];
            let late = c.last_ns.is_some_and(|t| self.now_ns.saturating_sub(t) > c.timeout_ns);
            if late && !c.lost {
                self.consumers[i].lost = true;
                match self.dictionary.int(o::ERROR_BEHAVIOUR, 1) {
                    0 if self.nmt == NmtState::Operational => self.leave_operational(NmtState::PreOperational),
                    2 => self.leave_operational(NmtState::Stopped),
                    _ => {}
                }
                self.abort_connection(code::HEARTBEAT, [c.node, 0, 0, 0, 0]);
            }
        }
        let timeout_ns = self.dictionary.int(o::GUARD, 1).unsigned_abs() * 1000;
        let late = self.sync_ns.is_some_and(|t| self.now_ns.saturating_sub(t) > timeout_ns);
        let powered = matches!(self.state, State::OperationEnabled | State::QuickStopActive);
        if timeout_ns != 0 && late && powered && !self.sync_lost {
            self.sync_lost = true;
            self.abort_connection(code::SYNC_TIMEOUT, [0; 5]);
        }
        self.monitor_rpdos(powered);
    }

    /// What object 6007 wants when the connection is gone. The emergency object is sent in any case.
    fn abort_connection(&mut self, error_code: u16, data: [u8; 5]) {
        let keeps = self.dictionary.int(o::GUARD, o::GUARD_KEEPS) != 0;
        let safe = if keeps { self.torque } else { self.within_limit(o::GUARD, o::GUARD_TORQUE) };
        match self.dictionary.int(o::ABORT_CONNECTION, 0) {
            1 => return self.fault(error_code, register::COMMUNICATION, safe, data),
            2 => self.command(Command::DisableVoltage),
            3 => self.command(Command::QuickStop),
            _ => {}
        }
        self.report(error_code, register::COMMUNICATION, data);
    }

    /// Enters the fault reaction, whose end is the latched fault. In a fault already, only the first cause is latched.
    fn fault(&mut self, error_code: u16, error_register: u8, torque: f64, data: [u8; 5]) {
        if matches!(self.state, State::Fault | State::FaultReactionActive) {
            self.report(error_code, error_register, data);
            return;
        }
        let powered = matches!(self.state, State::OperationEnabled | State::QuickStopActive);
        self.state = State::FaultReactionActive;
        self.fault_torque = if powered { torque } else { 0.0 };
        self.traffic.drop_waiting();
        self.dictionary.set_int(o::ERROR_CODE, 0, error_code.into());
        self.slope(0);
        self.refresh_state_objects();
        self.report(error_code, error_register, data);
    }

    /// Emergency object, error register, history.
    fn report(&mut self, error_code: u16, error_register: u8, data: [u8; 5]) {
        let all = self.dictionary.int(o::ERROR_REGISTER, 0) as u8 | error_register | register::GENERIC;
        self.dictionary.set_int(o::ERROR_REGISTER, 0, all.into());
        let count = (self.dictionary.int(o::ERROR_FIELD, 0) + 1).min(HISTORY.into());
        for sub in (2..=count as u8).rev() {
            let older = self.dictionary.int(o::ERROR_FIELD, sub - 1);
            self.dictionary.set_int(o::ERROR_FIELD, sub, older);
        }
        self.dictionary.set_int(o::ERROR_FIELD, 1, error_code.into());
        self.dictionary.set_int(o::ERROR_FIELD, 0, count);
        self.emergency(error_code, all, data);
    }

    fn emergency(&mut self, error_code: u16, error_register: u8, data: [u8; 5]) {
        if self.nmt != NmtState::Stopped {
            self.out.push_back(Emergency { code: error_code, register: error_register, data }.encode(self.node));
        }
    }

    /// A cause that would raise the fault again at once.
    fn cause_persists(&self) -> bool {
        self.sync_lost || self.traffic.misses_targets() || self.consumers.iter().any(|c| c.lost)
    }

    fn on_controlword(&mut self, word: u16) {
        let before = std::mem::replace(&mut self.controlword, word);
        if let Some(command) = Command::decode(before, word) {
            self.command(command);
        }
    }

    fn command(&mut self, command: Command) {
        if command == Command::FaultReset && self.state == State::Fault {
            if self.cause_persists() {
                return;
            }
            self.dictionary.set_int(o::ERROR_REGISTER, 0, 0);
            self.dictionary.set_int(o::ERROR_CODE, 0, 0);
            self.emergency(code::RESET, 0, [0; 5]);
        }
        let holds = self.dictionary.int(o::QUICK_STOP_OPTION, 0) >= 5;
        let Some(next) = self.state.after(command, holds) else { return };
        if self.state != State::OperationEnabled && next == State::OperationEnabled {
            // The guard counts from here: a SYNC older than its timeout is a fault at the next look.
            self.sync_lost = false;
        }
        self.state = next;
        self.slope(0);
    }

    /// Moves the torque; `elapsed_ns` since the last call.
    fn slope(&mut self, elapsed_ns: u64) {
        let (goal, sloped) = match self.state {
            State::OperationEnabled => (self.target(), false),
            State::QuickStopActive => (0.0, self.dictionary.int(o::QUICK_STOP_OPTION, 0) != 0),
            State::FaultReactionActive | State::Fault => (self.fault_torque, true),
            _ => (0.0, false),
        };
        let slope = self.dictionary.int(o::TORQUE_SLOPE, 0) as f64;
        if sloped && slope > 0.0 {
            let step = slope * elapsed_ns as f64 * 1e-9;
            self.torque += (goal - self.torque).clamp(-step, step);
        } else {
            self.torque = goal;
        }
        let arrived = self.torque == goal;
        match self.state {
            State::FaultReactionActive if arrived => self.state = State::Fault,
            State::QuickStopActive if arrived && self.dictionary.int(o::QUICK_STOP_OPTION, 0) < 5 => {
                self.state = State::SwitchOnDisabled;
            }
            _ => {}
        }
    }

    /// Target torque within the limit (per mille); 0 without a torque mode.
    fn target(&self) -> f64 {
        if self.dictionary.int(o::MODE, 0) != i64::from(o::MODE_CST) {
            return 0.0;
        }
        self.within_limit(o::TARGET_TORQUE, 0)
    }

    /// A torque of the dictionary within the limit (per mille).
    fn within_limit(&self, index: u16, sub: u8) -> f64 {
        let limit = self.dictionary.int(o::MAX_TORQUE, 0);
        self.dictionary.int(index, sub).clamp(-limit, limit) as f64
    }

    fn refresh_state_objects(&mut self) {
        let mode = self.dictionary.int(o::MODE, 0);
        let following = self.state == State::OperationEnabled && mode == i64::from(o::MODE_CST);
        let mut word = self.state.statusword() | REMOTE;
        if matches!(self.state, State::SwitchedOn | State::OperationEnabled | State::QuickStopActive) {
            word |= VOLTAGE_ENABLED;
        }
        if following {
            word |= FOLLOWS_TARGET;
            if self.target() != self.dictionary.int(o::TARGET_TORQUE, 0) as f64 {
                word |= INTERNAL_LIMIT;
            }
        }
        if self.pressed {
            word |= EMERGENCY_STOP;
        }
        self.dictionary.set_int(o::STATUSWORD, 0, word.into());
        self.dictionary.set_int(o::MODE_DISPLAY, 0, mode);
        self.dictionary.set_int(o::TORQUE_DEMAND, 0, self.torque.round() as i64);
    }

    /// Serves one frame of the bus; foreign ones are ignored.
    pub fn on_frame(&mut self, frame: &Frame, now_ns: u64) {
        self.poll(now_ns);
        let Id::Standard(id) = frame.id() else { return };
        if frame.kind() == Kind::Remote {
            return;
        }
        match Message::of(frame) {
            Some(Message::Nmt) => {
                if let Some((command, to)) = NmtCommand::decode(frame.data())
                    && to.is_none_or(|n| n == self.node)
                {
                    self.on_nmt(command);
                }
            }
            Some(Message::Sync) if self.nmt == NmtState::Operational => self.on_sync(),
            Some(Message::SdoRequest(n)) if n == self.node && self.nmt != NmtState::Stopped => {
                self.on_sdo(frame.data());
            }
            Some(Message::Heartbeat(n)) => self.on_heartbeat(n),
            _ => {}
        }
        if self.nmt == NmtState::Operational {
            for n in self.traffic.consumers(id) {
                self.on_rpdo(n, frame);
            }
        }
        self.refresh_state_objects();
        self.event_driven();
    }

    fn on_nmt(&mut self, command: NmtCommand) {
        match command {
            NmtCommand::Start => {
                if self.nmt != NmtState::Operational {
                    self.nmt = NmtState::Operational;
                    self.sync_ns = None;
                    self.traffic.begin();
                }
            }
            NmtCommand::Stop => self.leave_operational(NmtState::Stopped),
            NmtCommand::EnterPreOperational => self.leave_operational(NmtState::PreOperational),
            NmtCommand::ResetNode => {
                self.restart(0x1000..=0x9fff);
                self.poll(self.now_ns);
            }
            NmtCommand::ResetCommunication => {
                self.leave_operational(NmtState::PreOperational);
                self.restart(0x1000..=0x1fff);
                self.poll(self.now_ns);
            }
        }
    }

    /// Without PDOs a drive that follows a target would hold its last one for ever: the connection is aborted.
    fn leave_operational(&mut self, to: NmtState) {
        let was = std::mem::replace(&mut self.nmt, to);
        self.sync_ns = None;
        self.traffic.end();
        if was == NmtState::Operational && self.state == State::OperationEnabled {
            // Reported before stopped takes effect: a stopped node sends no emergency objects.
            self.nmt = if to == NmtState::Stopped { NmtState::PreOperational } else { to };
            self.abort_connection(code::GENERIC_COMMUNICATION, [0; 5]);
            self.nmt = to;
        }
    }

    fn on_heartbeat(&mut self, node: NodeId) {
        for c in self.consumers.iter_mut().filter(|c| c.node == node.get() && c.timeout_ns != 0) {
            c.last_ns = Some(self.now_ns);
            c.lost = false;
        }
    }

    fn on_sdo(&mut self, data: &[u8]) {
        let mut objects = Objects { dictionary: &mut self.dictionary, written: None };
        let response = self.sdo.on_request(data, &mut objects);
        let written = objects.written;
        if let Some((index, sub)) = written {
            self.on_written(index, sub);
        }
        if let Some(payload) = response
            && let Ok(f) = cob::frame(self.node.cob(cob::SDO_RESPONSE), &payload)
        {
            self.out.push_back(f);
        }
    }

    /// What a write by SDO sets in motion.
    fn on_written(&mut self, index: u16, sub: u8) {
        match index {
            o::CONTROLWORD => {
                let word = self.dictionary.int(o::CONTROLWORD, 0) as u16;
                self.on_controlword(word);
            }
            o::TARGET_TORQUE | o::MAX_TORQUE | o::MODE => self.slope(0),
            o::HEARTBEAT_PRODUCER => self.heartbeat_due_ns = Some(self.now_ns),
            o::HEARTBEAT_CONSUMER => {
                let value = self.dictionary.int(index, sub);
                let consumer = &mut self.consumers[usize::from(sub.clamp(1, CONSUMERS)) - 1];
                let timeout_ns = (value & 0xffff).unsigned_abs() * 1_000_000;
                let node = (value >> 16 & 0xff) as u8;
                *consumer =
                    Consumer { node, timeout_ns: if node == 0 { 0 } else { timeout_ns }, ..Consumer::default() };
            }
            o::GUARD => {
                if self.dictionary.int(o::GUARD, o::GUARD_SYNC) == 0 {
                    self.sync_lost = false;
                }
                let lets_go = sub == o::GUARD_KEEPS && self.dictionary.int(o::GUARD, o::GUARD_KEEPS) == 0;
                if lets_go && self.fault_torque != 0.0 {
                    self.fault_torque = self.within_limit(o::GUARD, o::GUARD_TORQUE);
                }
            }
            // The history is cleared by writing 0 to its count.
            o::ERROR_FIELD => (1..=HISTORY).for_each(|s| self.dictionary.set_int(o::ERROR_FIELD, s, 0)),
            _ if pdo::parameter(index).is_some() => {
                self.traffic.load(&self.dictionary);
                self.traffic.drop_waiting();
            }
            _ => {}
        }
        self.refresh_state_objects();
    }
}
