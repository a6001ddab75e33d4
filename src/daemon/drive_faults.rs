//! What the master finds wrong with drives, told once: equal messages of many drives are one line.
//!
//! Enters: the master's faults. Leaves: lines of the log. A cause that hits all drives (no SYNC, no torques) reaches the
//! log drive by drive within milliseconds; told is it a moment later, together.

use crate::config::CableNames;
use sinew_hal::cia402::objects::{EVENT_TIMER, GUARD, RPDO_COMMUNICATION, TORQUE_SLOPE};
use sinew_hal::cia402::{DriveFault, Fault};

/// How long equal messages are gathered (ns).
const GATHER_NS: u64 = 100_000_000;
/// Cables that a line names.
const NAMED_MAX: usize = 3;

/// Messages that wait for their likes.
#[derive(Debug)]
pub(super) struct Gathered {
    cables: CableNames,
    waiting: Vec<(u64, Fault, Vec<DriveFault>)>,
}

impl Gathered {
    pub(super) fn new(cables: CableNames) -> Self {
        Self { cables, waiting: Vec::new() }
    }

    pub(super) fn add(&mut self, now_ns: u64, fault: &DriveFault) {
        match self.waiting.iter_mut().find(|(_, kind, _)| *kind == fault.fault) {
            Some((.., drives)) => drives.push(*fault),
            None => self.waiting.push((now_ns, fault.fault, vec![*fault])),
        }
    }

    /// The lines for which it is time.
    pub(super) fn due(&mut self, now_ns: u64) -> Vec<String> {
        let (due, waiting) = std::mem::take(&mut self.waiting)
            .into_iter()
            .partition(|(since_ns, ..)| now_ns.saturating_sub(*since_ns) >= GATHER_NS);
        self.waiting = waiting;
        let due: Vec<(u64, Fault, Vec<DriveFault>)> = due;
        due.iter().map(|(_, fault, drives)| self.line(fault, drives)).collect()
    }

    fn line(&self, fault: &Fault, drives: &[DriveFault]) -> String {
        if let [one] = drives {
            return format!("{} (bus {}, node {}): {fault}", self.cables.words(one.drive), one.bus, one.node);
        }
        let mut places: Vec<usize> = drives.iter().map(|drive| drive.drive).collect();
        places.sort_unstable();
        places.dedup();
        let name = |place: &usize| self.cables.of(*place).map_or_else(|| place.to_string(), |name| name.to_string());
        let named: Vec<String> = places.iter().take(NAMED_MAX).map(name).collect();
        let more = if places.len() > NAMED_MAX { ", ..." } else { "" };
        format!("{} drives (cables {}{more}): {fault}", places.len(), named.join("; "))
    }
}

/// What an object that a drive lacks would protect against.
pub(super) fn lacking((index, sub): (u16, u8)) -> String {
    let what = match (index, sub) {
        (RPDO_COMMUNICATION, EVENT_TIMER) => "the time-out of torques, ",
        (GUARD, _) => "the guard of SYNC, ",
        (TORQUE_SLOPE, _) => "the slope of torque, ",
        _ => "",
    };
    format!("{what}{index:04x}:{sub:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use sinew_hal::canopen::NodeId;

    #[test]
    fn equal_messages_of_many_drives_are_one_line() {
        let mut gathered = Gathered::new(CableNames::new([6; 4]));
        let fault = |drive: usize, fault| DriveFault {
            drive,
            bus: 0,
            node: NodeId::new(drive as u8 + 1).unwrap(),
            time_ns: 0,
            fault,
        };
        let lost = Fault::HeartbeatLost { timeout_ms: 150 };
        (0..24).for_each(|drive| gathered.add(1_000_000 * drive as u64, &fault(drive, lost)));
        gathered.add(0, &fault(7, Fault::Rebooted));
        assert!(gathered.due(99_999_999).is_empty());
        let lines = gathered.due(100_000_000);
        assert_eq!(lines[0], "24 drives (cables 1,1; 1,2; 1,3, ...): no heartbeat for 150 ms");
        assert_eq!(lines[1], "cable 2,2 (bus 0, node 8): the drive restarted by itself; it has lost its configuration");
        assert!(lines.len() == 2 && gathered.due(1_000_000_000).is_empty(), "each once");
    }
}
