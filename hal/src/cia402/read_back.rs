//! Reading back what a drive was told, while it operates: one object at a time over all drives, every second one a limit of
//! torque. In turns with it, and as often, the safe torques are written that follow the torques sent, where drives have such:
//! what drives are told of one motion at instants far apart makes an arm swing that is left alone.
//!
//! Enters: the scripts of all drives, responses, the time, safe torques. Leaves: requests, and what was changed. A drive that
//! does not answer is no finding: its heartbeat and its feedback tell more, and sooner. It must never have more than one
//! request outstanding over all buses.

use super::config::MasterConfig;
use super::fault::Fault;
use super::objects as o;
use super::script::{Step, script};
use crate::canopen::sdo_client::{Outcome, SdoClient};

/// An object with what it must hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Object {
    index: u16,
    sub: u8,
    len: usize,
    value: u32,
    mask: u32,
}

/// The reader of all drives' objects. Allocates when it is made.
#[derive(Debug)]
pub(super) struct ReadBack {
    /// By drive: its limit of torque, then the others.
    objects: Vec<Vec<Object>>,
    /// Between two requests (ns).
    period_ns: u64,
    timeout_ns: u64,
    due_ns: u64,
    client: SdoClient,
    /// The drive asked, and what it must hold; nothing where it was written to.
    asked: Option<(usize, Option<Object>)>,
    drive: usize,
    round: usize,
    reads: bool,
    /// Drives whose safe torque is kept up to date.
    follow: Vec<usize>,
    /// The next of them, and whether it is their turn.
    next: usize,
    turn: bool,
}

/// Time between two safe torques where nothing is read back (ns).
const FOLLOW_NS: u64 = 20_000_000;

/// What there is to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Task {
    None,
    /// Send this to the drive's SDO server.
    Send(usize, [u8; 8]),
    /// The drive's object was changed.
    Changed(usize, Fault),
}

impl ReadBack {
    /// `None` where nothing is to be read back or kept up to date.
    pub(super) fn new(config: &MasterConfig) -> Option<Self> {
        let read_ns = u64::from(config.read_back_us) * 1000;
        let timeout_ns = u64::from(config.sdo_timeout_ms) * 1_000_000;
        let drives = config.drives.iter().enumerate();
        let follow: Vec<usize> = drives.filter(|(_, drive)| drive.safe_torque_follows).map(|(i, _)| i).collect();
        let reads = read_ns > 0;
        (reads || !follow.is_empty()).then(|| Self {
            objects: (0..config.drives.len())
                .map(|drive| objects(&script(config, drive), follow.contains(&drive)))
                .collect(),
            period_ns: match (reads, follow.is_empty()) {
                (true, true) => read_ns,
                (true, false) => read_ns / 2,
                (false, _) => FOLLOW_NS,
            },
            reads,
            follow,
            next: 0,
            turn: true,
            timeout_ns,
            due_ns: 0,
            client: SdoClient::new(timeout_ns),
            asked: None,
            drive: 0,
            round: 0,
        })
    }

    /// Begins anew with the first drive; what is outstanding is given up.
    pub(super) fn restart(&mut self) {
        (self.asked, self.drive, self.round, self.due_ns) = (None, 0, 0, 0);
        self.client = SdoClient::new(self.timeout_ns);
    }

    /// Time: the next request, if one is due. `ready` tells which drives operate, `absent` which objects they have not,
    /// `safe` the safe torque that a drive is to have (per mille).
    pub(super) fn poll(
        &mut self,
        now_ns: u64,
        ready: impl Fn(usize) -> bool,
        absent: impl Fn(usize, u16, u8) -> bool,
        safe: impl Fn(usize) -> i16,
    ) -> Task {
        if let Some((drive, _)) = self.asked {
            let (outcome, send) = self.client.poll(now_ns);
            if let Outcome::Failed(_) = outcome {
                self.asked = None;
            }
            return send.map_or(Task::None, |payload| Task::Send(drive, payload));
        }
        if now_ns < self.due_ns || !self.client.is_quiet(now_ns) || self.objects.is_empty() {
            return Task::None;
        }
        self.due_ns = now_ns + self.period_ns;
        self.turn = !self.turn || !self.reads;
        if let (true, Some(&drive)) = (self.turn, self.follow.get(self.next)) {
            self.next = (self.next + 1) % self.follow.len();
            if !ready(drive) {
                return Task::None;
            }
            self.asked = Some((drive, None));
            let payload = self.client.download(o::GUARD, o::GUARD_TORQUE, &safe(drive).to_le_bytes(), now_ns);
            return Task::Send(drive, payload);
        }
        let drive = self.drive;
        self.drive = (drive + 1) % self.objects.len();
        let round = self.round;
        if self.drive == 0 {
            self.round += 1;
        }
        let all = &self.objects[drive];
        let others = all.len().saturating_sub(1).max(1);
        let object = match round % 2 {
            0 => all.first(),
            _ => all.get(1 + (round / 2) % others),
        };
        match object {
            Some(&object) if ready(drive) && !absent(drive, object.index, object.sub) => {
                self.asked = Some((drive, Some(object)));
                Task::Send(drive, self.client.upload_sized(object.index, object.sub, object.len, now_ns))
            }
            _ => Task::None,
        }
    }

    /// A response of a drive.
    pub(super) fn on_response(&mut self, drive: usize, payload: &[u8], now_ns: u64) -> Task {
        let Some((asked, object)) = self.asked.filter(|(asked, _)| *asked == drive) else { return Task::None };
        let (outcome, send) = self.client.on_response(payload, now_ns);
        match outcome {
            Outcome::Pending => {}
            Outcome::Failed(_) => self.asked = None,
            Outcome::Done(value) => {
                self.asked = None;
                let Some(object) = object else { return Task::None };
                let found = word(&value);
                let width = if object.len < 4 { (1 << (8 * object.len)) - 1 } else { u32::MAX };
                if (found ^ object.value) & object.mask & width != 0 {
                    let Object { index, sub, value: expected, .. } = object;
                    return Task::Changed(asked, Fault::Changed { index, sub, expected, found: found & width });
                }
            }
        }
        send.map_or(Task::None, |payload| Task::Send(asked, payload))
    }
}

/// What a script leaves in a drive, as far as it fits a frame and nothing else changes it, as the safe torque that `follows`.
fn objects(steps: &[Step], follows: bool) -> Vec<Object> {
    let mut objects: Vec<Object> = Vec::new();
    for step in steps {
        let Step::Write { index, sub, data, mask, .. } = step else { continue };
        let changes = *index == o::TARGET_TORQUE || follows && (*index, *sub) == (o::GUARD, o::GUARD_TORQUE);
        if changes || data.len() > 4 {
            continue;
        }
        let object = Object { index: *index, sub: *sub, len: data.len(), value: word(data), mask: *mask };
        match objects.iter_mut().find(|known| (known.index, known.sub) == (*index, *sub)) {
            // The last one counts: mappings are switched off and on again.
            Some(known) => *known = object,
            None => objects.push(object),
        }
    }
    if let Some(limit) = objects.iter().position(|object| object.index == o::MAX_TORQUE) {
        objects.swap(0, limit);
    }
    objects
}

fn word(data: &[u8]) -> u32 {
    data.iter().take(4).rev().fold(0, |w, &b| w << 8 | u32::from(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canopen::NodeId;
    use crate::cia402::DriveSetup;

    #[test]
    fn the_limit_of_torque_comes_first_and_what_the_loop_itself_changes_not_at_all() {
        let node = |n| NodeId::new(n).unwrap();
        let config = MasterConfig::new(vec![DriveSetup::new(0, node(5))], node(127), 10_000);
        let objects = objects(&script(&config, 0), false);
        assert_eq!((objects[0].index, objects[0].value), (o::MAX_TORQUE, 1000));
        assert!(objects.iter().all(|object| object.index != o::TARGET_TORQUE));
        let cob = objects.iter().find(|object| (object.index, object.sub) == (o::RPDO_COMMUNICATION, 1)).unwrap();
        assert_eq!(cob.value, 0x205, "as it is in the end, not while the mapping is changed");
    }

    #[test]
    fn safe_torques_are_written_in_turns_with_what_is_read_and_not_compared() {
        let node = |n| NodeId::new(n).unwrap();
        let mut drives: Vec<DriveSetup> = (5..8).map(|n| DriveSetup::new(0, node(n))).collect();
        for drive in &mut drives[1..] {
            drive.safe_torque_follows = true;
            drive.writes = crate::cia402::ObjectWrite::sinew_guard(0, 0, false).to_vec();
        }
        let mut config = MasterConfig::new(drives, node(127), 10_000);
        config.read_back_us = 20_000;
        let mut read_back = ReadBack::new(&config).unwrap();
        let compared = read_back.objects[1].iter().any(|object| (object.index, object.sub) == (o::GUARD, 2));
        assert!(!compared);
        let mut written = Vec::new();
        for k in 0..8u64 {
            let now_ns = k * 10_000_000;
            let task = read_back.poll(now_ns, |_| true, |_, _, _| false, |drive| 100 * drive as i16 + k as i16);
            let Task::Send(drive, payload) = task else { panic!("{task:?}") };
            // A download names index and sub, and is answered by them alone.
            if payload[0] >> 5 == 1 {
                assert_eq!(payload[1..4], [0x00, 0x20, 2]);
                written.push((drive, i16::from_le_bytes([payload[4], payload[5]])));
                let answer = [0x60, payload[1], payload[2], payload[3], 0, 0, 0, 0];
                assert_eq!(read_back.on_response(drive, &answer, now_ns), Task::None);
            } else {
                read_back.asked = None;
                read_back.client = SdoClient::new(1);
            }
        }
        assert_eq!(written, [(1, 101), (2, 203), (1, 105), (2, 207)]);
    }
}
