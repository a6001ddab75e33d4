//! The drive's PDOs at work: targets in, feedback out, both at the beat of SYNC unless configured otherwise; and the
//! deadline of each RPDO, its event timer (CiA 301, 7.5.2.35), that says when targets are missing.

use super::super::objects::PDOS;
use super::super::pdo::{self, Direction, Pdo};
use super::Drive;
use sinew_hal::can::{Frame, Id};
use sinew_hal::canopen::emcy::{code, register};
use sinew_hal::canopen::{NmtState, ObjectDictionary};
use sinew_hal::cia402::objects as o;

/// PDOs as configured, and what of them is under way.
#[derive(Debug, Clone, Default)]
pub(super) struct Traffic {
    rpdo: [Pdo; PDOS as usize],
    tpdo: [Pdo; PDOS as usize],
    /// A synchronous RPDO that waits for SYNC.
    waiting: [Option<Frame>; PDOS as usize],
    /// SYNCs since the last transmission, time of it, and what was sent.
    sent: [(u8, u64, Vec<u8>); PDOS as usize],
    /// Time of the last reception: the deadline of an RPDO counts from the first one after it was configured (CiA 301).
    heard_ns: [Option<u64>; PDOS as usize],
    /// Deadlines that were missed with torque on; each until that RPDO comes.
    missed: [bool; PDOS as usize],
    length_wrong: bool,
}

impl Traffic {
    /// Reads the parameters anew.
    pub(super) fn load(&mut self, dictionary: &ObjectDictionary) {
        for n in 0..PDOS {
            let rpdo = Pdo::of(dictionary, Direction::Receive, n);
            if self.rpdo[usize::from(n)] != rpdo {
                self.rpdo[usize::from(n)] = rpdo;
                (self.heard_ns[usize::from(n)], self.missed[usize::from(n)]) = (None, false);
            }
            self.tpdo[usize::from(n)] = Pdo::of(dictionary, Direction::Transmit, n);
        }
    }

    /// Drops targets that have not taken effect.
    pub(super) fn drop_waiting(&mut self) {
        self.waiting = Default::default();
    }

    /// Start of operation: nothing waits, nothing was sent.
    pub(super) fn begin(&mut self) {
        self.end();
        self.sent = Default::default();
    }

    /// End of operation: targets that have not taken effect are dropped, and none are expected.
    pub(super) fn end(&mut self) {
        self.drop_waiting();
        self.heard_ns = Default::default();
        self.missed = Default::default();
    }

    /// True while targets are missing.
    pub(super) fn misses_targets(&self) -> bool {
        self.missed.contains(&true)
    }

    /// RPDOs with this identifier.
    pub(super) fn consumers(&self, id: u16) -> impl Iterator<Item = usize> + use<> {
        let consumes: [bool; PDOS as usize] = std::array::from_fn(|n| self.rpdo[n].cob == Some(id));
        (0..usize::from(PDOS)).filter(move |&n| consumes[n])
    }
}

impl Drive {
    /// An RPDO: kept until SYNC, or applied at once.
    pub(super) fn on_rpdo(&mut self, n: usize, frame: &Frame) {
        let pdo = self.traffic.rpdo[n];
        let len = frame.data().len();
        if len < pdo.mapping.len() {
            if !self.traffic.length_wrong {
                self.traffic.length_wrong = true;
                self.report(code::PDO_LENGTH, register::COMMUNICATION, [n as u8 + 1, len as u8, 0, 0, 0]);
            }
            return;
        }
        self.traffic.length_wrong = false;
        (self.traffic.heard_ns[n], self.traffic.missed[n]) = (Some(self.now_ns), false);
        if pdo.is_synchronous() {
            self.traffic.waiting[n] = Some(*frame);
        } else {
            self.apply_rpdo(n, frame);
        }
    }

    /// RPDOs that should have come. As with SYNC, what is missing without torque needs no reaction.
    pub(super) fn monitor_rpdos(&mut self, powered: bool) {
        for n in 0..usize::from(PDOS) {
            let (pdo, heard_ns) = (&self.traffic.rpdo[n], self.traffic.heard_ns[n]);
            let late = heard_ns.is_some_and(|t| self.now_ns.saturating_sub(t) > pdo.event_ns);
            if powered && pdo.cob.is_some() && pdo.event_ns != 0 && late && !self.traffic.missed[n] {
                self.traffic.missed[n] = true;
                self.abort_connection(code::RPDO_TIMEOUT, [n as u8 + 1, 0, 0, 0, 0]);
            }
        }
    }

    /// Takes over an RPDO's values. The controlword comes last, so that a torque in the same PDO is already there when
    /// the state changes.
    fn apply_rpdo(&mut self, n: usize, frame: &Frame) {
        let mapping = self.traffic.rpdo[n].mapping;
        let Some(parts) = mapping.split(frame.data()) else { return };
        let mut controlword = None;
        for (entry, bytes) in parts {
            // A value out of its range is ignored, as an SDO write would be refused; a dummy is no object at all.
            let Ok(value) = self.dictionary.check_int(entry.index, entry.sub, bytes) else { continue };
            if entry.index == o::MODE && value != 0 && value != i64::from(o::MODE_CST) {
                continue;
            }
            self.dictionary.set_int(entry.index, entry.sub, value);
            if entry.index == o::CONTROLWORD {
                controlword = Some(value as u16);
            }
        }
        if let Some(word) = controlword {
            self.on_controlword(word);
        }
        self.slope(0);
    }

    /// SYNC: waiting targets take effect, then the state as it now is is sent.
    pub(super) fn on_sync(&mut self) {
        self.latch();
        self.answer();
    }

    /// First half of a SYNC on its own, for a plant in lockstep: waiting targets take effect. The plant then advances by
    /// a period, and [`Self::answer_sync`] sends what it measured at the end of it.
    pub fn latch_sync(&mut self, now_ns: u64) {
        self.poll(now_ns);
        if self.nmt == NmtState::Operational {
            self.latch();
            self.refresh_state_objects();
        }
    }

    /// Second half of a SYNC: synchronous TPDOs with the feedback as it now is.
    pub fn answer_sync(&mut self, now_ns: u64) {
        self.poll(now_ns);
        if self.nmt == NmtState::Operational {
            self.answer();
            self.event_driven();
        }
    }

    fn latch(&mut self) {
        self.syncs += 1;
        self.sync_ns = Some(self.now_ns);
        self.sync_lost = false;
        for n in 0..usize::from(PDOS) {
            if let Some(frame) = self.traffic.waiting[n].take() {
                self.apply_rpdo(n, &frame);
            }
        }
    }

    fn answer(&mut self) {
        self.refresh_state_objects();
        for n in 0..usize::from(PDOS) {
            let pdo = self.traffic.tpdo[n];
            if pdo.cob.is_none() || !pdo.is_synchronous() {
                continue;
            }
            let payload = self.payload(n);
            let (count, _, last) = &mut self.traffic.sent[n];
            *count = count.saturating_add(1);
            let due = if pdo.transmission == 0 { *last != payload } else { *count >= pdo.transmission };
            if due {
                self.transmit(n, payload);
            }
        }
    }

    fn payload(&self, n: usize) -> Vec<u8> {
        let entries = self.traffic.tpdo[n].mapping;
        entries.entries().iter().flat_map(|e| self.dictionary.read(e.index, e.sub).unwrap_or_default()).collect()
    }

    fn transmit(&mut self, n: usize, payload: Vec<u8>) {
        let kind = pdo::frame_kind(&self.dictionary);
        if let Some(cob) = self.traffic.tpdo[n].cob
            && let Ok(f) = Frame::new(Id::Standard(cob), kind, &payload)
        {
            self.out.push_back(f);
        }
        self.traffic.sent[n] = (0, self.now_ns, payload);
    }

    /// Event-driven TPDOs: on a change, at the earliest after the inhibit time, at the latest after the event timer.
    pub(super) fn event_driven(&mut self) {
        if self.nmt != NmtState::Operational {
            return;
        }
        for n in 0..usize::from(PDOS) {
            let pdo = self.traffic.tpdo[n];
            if pdo.cob.is_none() || pdo.is_synchronous() {
                continue;
            }
            let payload = self.payload(n);
            let since = self.now_ns.saturating_sub(self.traffic.sent[n].1);
            let changed =
                self.traffic.sent[n].2 != payload && (since >= pdo.inhibit_ns || self.traffic.sent[n].2.is_empty());
            if changed || (pdo.event_ns != 0 && since >= pdo.event_ns) {
                self.transmit(n, payload);
            }
        }
    }
}
