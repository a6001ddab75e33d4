//! The SDO script of one drive: what is checked, written and read back before it may become operational.

use super::config::{MasterConfig, ObjectWrite};
use super::fault::Fault;
use super::layout::Layout;
use super::objects as o;
use crate::canopen::cob::TPDO;
use crate::canopen::pdo::{COB_INVALID, COB_NO_RTR, Mapped};
use crate::canopen::sdo::AbortCode;
use crate::canopen::sdo_client::{Outcome, SdoClient, SdoError};

/// One step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// Read and compare; `tries` readings may differ before it is a fault.
    Check {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Bytes that the object must have.
        len: usize,
        /// Value expected.
        expected: u32,
        /// Bits compared.
        mask: u32,
        /// Readings granted.
        tries: u32,
    },
    /// Write, then read back unless it is the first half of a procedure whose end is read back.
    Write {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Bytes.
        data: Vec<u8>,
        /// Bits compared on reading back.
        mask: u32,
        /// Absence of the object is accepted.
        optional: bool,
    },
    /// Read the rated torque (mN m).
    RatedTorque,
}

/// The whole script of the drive with this index; empty without such a drive.
pub fn script(config: &MasterConfig, index: usize) -> Vec<Step> {
    let Some(drive) = config.drives.get(index) else { return Vec::new() };
    let mut steps = Vec::with_capacity(64);
    let check = |index, sub, len, expected, mask| Step::Check { index, sub, len, expected, mask, tries: 1 };
    let write =
        |index, sub, data: &[u8]| Step::Write { index, sub, data: data.to_vec(), mask: u32::MAX, optional: false };
    let optional =
        |index, sub, data: &[u8]| Step::Write { index, sub, data: data.to_vec(), mask: u32::MAX, optional: true };

    steps.push(check(o::DEVICE_TYPE, 0, 4, 402, 0xffff));
    let id = drive.identity;
    for (sub, expected) in (1..).zip([id.vendor, id.product, id.revision, id.serial]) {
        if let Some(expected) = expected {
            steps.push(check(o::IDENTITY, sub, 4, expected, u32::MAX));
        }
    }
    steps.push(check(o::SUPPORTED_MODES, 0, 4, o::SUPPORTS_CST, o::SUPPORTS_CST));
    steps.push(Step::RatedTorque);

    steps.push(write(o::HEARTBEAT_PRODUCER, 0, &config.drive_heartbeat_ms.to_le_bytes()));
    let consumed = u32::from(config.node.get()) << 16 | u32::from(config.heartbeat_timeout_ms);
    steps.push(write(o::HEARTBEAT_CONSUMER, 1, &consumed.to_le_bytes()));
    // After a communication error the node stays operational, so that its fault is still seen in TPDO 1; what the
    // power stage does is 6007's business.
    steps.push(optional(o::ERROR_BEHAVIOUR, 1, &[1]));
    steps.push(write(o::ABORT_CONNECTION, 0, &drive.abort_connection.to_le_bytes()));
    steps.push(optional(o::CYCLE_PERIOD, 0, &config.cycle_us.to_le_bytes()));

    let layout = config.layout(drive.bus);
    let (rank, count) = config.rank(index);
    let (rpdo, rpdo_mapping) = layout.rpdo(drive.node, rank, count);
    if layout == Layout::Packed {
        // First, for it decides how long a mapping may be. The classic format is what a reset left behind.
        steps.push(write(o::PDO_FORMAT, 0, &[o::PDO_FORMAT_FD_BRS]));
    }
    let tpdo = u32::from(drive.node.cob(TPDO)) | COB_NO_RTR;
    pdo(&mut steps, o::RPDO_COMMUNICATION, o::RPDO_MAPPING, u32::from(rpdo), &rpdo_mapping);
    pdo(&mut steps, o::TPDO_COMMUNICATION, o::TPDO_MAPPING, tpdo, &o::TPDO1);
    // Written at 0, too: a drive may have kept another value over the reset.
    steps.push(Step::Write {
        index: o::RPDO_COMMUNICATION,
        sub: o::EVENT_TIMER,
        data: config.rpdo_timeout_ms.to_le_bytes().to_vec(),
        mask: u32::MAX,
        optional: config.rpdo_timeout_optional,
    });

    steps.push(write(o::MAX_TORQUE, 0, &drive.torque_permille_max.to_le_bytes()));
    steps.push(write(o::TARGET_TORQUE, 0, &0i16.to_le_bytes()));
    steps.push(write(o::MODE, 0, &o::MODE_CST.to_le_bytes()));
    // A drive may need some of its own cycles until the display follows.
    steps.push(Step::Check {
        index: o::MODE_DISPLAY,
        sub: 0,
        len: 1,
        expected: u32::from(o::MODE_CST.unsigned_abs()),
        mask: 0xff,
        tries: 20,
    });
    for w in &drive.writes {
        let (index, sub, optional) = (w.index, w.sub, w.optional);
        steps.push(Step::Write { index, sub, data: w.data.clone(), mask: u32::MAX, optional });
    }
    steps
}

/// Off, empty, new entries, count, on: the order that CiA 301 prescribes for changing a mapping.
fn pdo(steps: &mut Vec<Step>, communication: u16, mapping: u16, cob: u32, entries: &[Mapped]) {
    let mut write = |index, sub, data: Vec<u8>, mask| {
        steps.push(Step::Write { index, sub, data, mask, optional: false });
    };
    // Bit 30 is not compared: drives without remote requests may show either.
    let cob_mask = COB_INVALID | 0x1fff_ffff;
    write(communication, 1, (cob | COB_INVALID).to_le_bytes().to_vec(), COB_INVALID);
    write(communication, 2, vec![1], u32::MAX);
    write(mapping, 0, vec![0], u32::MAX);
    for (sub, e) in (1..).zip(entries) {
        write(mapping, sub, e.encode().to_le_bytes().to_vec(), u32::MAX);
    }
    write(mapping, 0, vec![entries.len() as u8], u32::MAX);
    write(communication, 1, cob.to_le_bytes().to_vec(), cob_mask);
}

/// What running the script leads to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Advance {
    /// Send this payload to the node's SDO server.
    Send([u8; 8]),
    /// Wait for a response or for time to pass.
    Wait,
    /// All steps are done.
    Done,
    /// The drive is unusable.
    Failed(Fault, Option<[u8; 8]>),
}

/// A script in progress. Allocates; set-up only.
#[derive(Debug, Clone)]
pub struct Runner {
    steps: Vec<Step>,
    at: usize,
    client: SdoClient,
    reading_back: bool,
    retries: u32,
    retries_max: u32,
    tries: u32,
    /// A transfer timed out; it is repeated when the server has nothing more to say.
    settling: bool,
    /// Rated torque that must be found (mN m).
    rated_expected: Option<u32>,
    /// Rated torque found (mN m).
    pub rated_torque_mnm: Option<u32>,
    /// Optional objects that the drive has not.
    pub absent: Vec<(u16, u8)>,
}

impl Runner {
    /// The script of the drive with this index, at its first step.
    pub fn new(config: &MasterConfig, index: usize) -> Self {
        Self {
            steps: script(config, index),
            at: 0,
            client: SdoClient::new(u64::from(config.sdo_timeout_ms) * 1_000_000),
            reading_back: false,
            retries: 0,
            retries_max: config.sdo_retries,
            tries: 0,
            settling: false,
            rated_expected: config.drives.get(index).and_then(|d| d.rated_torque_mnm),
            rated_torque_mnm: None,
            absent: Vec::new(),
        }
    }

    /// Asks the drive with this index whether it gives torque: done if not.
    pub fn asking(config: &MasterConfig, index: usize) -> Self {
        let asked = Step::Check { index: o::TORQUE_DEMAND, sub: 0, len: 2, expected: 0, mask: 0xffff, tries: 1 };
        Self { steps: vec![asked], retries_max: 0, ..Self::new(config, index) }
    }

    /// Tells the drive with this index to let go of its torque.
    pub fn releasing(config: &MasterConfig, index: usize) -> Self {
        let writes = config.drives.get(index).map_or(&[][..], |drive| &drive.release);
        let step = |w: &ObjectWrite| {
            let (index, sub, optional) = (w.index, w.sub, w.optional);
            Step::Write { index, sub, data: w.data.clone(), mask: u32::MAX, optional }
        };
        Self { steps: writes.iter().map(step).collect(), ..Self::new(config, index) }
    }

    /// Steps done and steps in all.
    pub fn progress(&self) -> (usize, usize) {
        (self.at, self.steps.len())
    }

    /// Responses that did not belong to the request outstanding, late ones for example.
    pub fn ignored(&self) -> u64 {
        self.client.ignored()
    }

    /// Starts the present step.
    pub fn start(&mut self, now_ns: u64) -> Advance {
        match self.steps.get(self.at) {
            None => Advance::Done,
            Some(Step::Write { index, sub, data, .. }) if !self.reading_back => {
                Advance::Send(self.client.download(*index, *sub, data, now_ns))
            }
            Some(Step::Write { index, sub, data, .. }) => {
                Advance::Send(self.client.upload_sized(*index, *sub, data.len(), now_ns))
            }
            Some(Step::Check { index, sub, len, .. }) => {
                Advance::Send(self.client.upload_sized(*index, *sub, *len, now_ns))
            }
            Some(Step::RatedTorque) => Advance::Send(self.client.upload_sized(o::RATED_TORQUE, 0, 4, now_ns)),
        }
    }

    /// Handles the payload of a response.
    pub fn on_response(&mut self, payload: &[u8], now_ns: u64) -> Advance {
        let (outcome, send) = self.client.on_response(payload, now_ns);
        self.follow(outcome, send, now_ns)
    }

    /// Time-outs.
    pub fn poll(&mut self, now_ns: u64) -> Advance {
        if self.settling {
            if !self.client.is_quiet(now_ns) {
                return Advance::Wait;
            }
            self.settling = false;
            return self.start(now_ns);
        }
        let (outcome, send) = self.client.poll(now_ns);
        self.follow(outcome, send, now_ns)
    }

    fn follow(&mut self, outcome: Outcome, send: Option<[u8; 8]>, now_ns: u64) -> Advance {
        match outcome {
            Outcome::Pending => send.map_or(Advance::Wait, Advance::Send),
            Outcome::Done(value) => match self.judge(&value) {
                Ok(()) => self.start(now_ns),
                Err(fault) => Advance::Failed(fault, None),
            },
            Outcome::Failed(error) => self.on_error(error, send, now_ns),
        }
    }

    fn on_error(&mut self, error: SdoError, send: Option<[u8; 8]>, now_ns: u64) -> Advance {
        if matches!(error, SdoError::Timeout { .. }) && self.retries < self.retries_max {
            self.retries += 1;
            // The server is told, and what it still answers is waited out: an answer names its object only, and a late one
            // would be taken for that to the repetition, and that one for the answer to what follows.
            self.settling = true;
            return send.map_or(Advance::Wait, Advance::Send);
        }
        let absent = matches!(error, SdoError::Aborted(AbortCode::NO_OBJECT | AbortCode::NO_SUB_INDEX));
        let (index, sub, write) = match &self.steps[self.at.min(self.steps.len() - 1)] {
            Step::Write { index, sub, optional: true, .. } if absent => {
                self.absent.push((*index, *sub));
                self.next();
                return self.start(now_ns);
            }
            Step::Write { index, sub, .. } => (*index, *sub, !self.reading_back),
            Step::Check { index, sub, .. } => (*index, *sub, false),
            Step::RatedTorque => (o::RATED_TORQUE, 0, false),
        };
        Advance::Failed(Fault::Sdo { index, sub, write, error }, send)
    }

    fn next(&mut self) {
        self.at += 1;
        self.reading_back = false;
        self.retries = 0;
        self.tries = 0;
    }

    /// Judges a completed transfer and moves on.
    fn judge(&mut self, value: &[u8]) -> Result<(), Fault> {
        let Some(step) = self.steps.get(self.at) else { return Ok(()) };
        match *step {
            Step::Write { .. } if !self.reading_back => {
                self.reading_back = true;
                self.retries = 0;
                return Ok(());
            }
            Step::Write { index, sub, ref data, mask, .. } => {
                if data.len() > 4 {
                    // Compared byte by byte; only the first difference can be named in a word.
                    if value.len() != data.len() {
                        return Err(Fault::Length { index, sub, expected: data.len(), found: value.len() });
                    }
                    if let Some((a, b)) = data.iter().zip(value).find(|(a, b)| a != b) {
                        let (expected, found) = (u32::from(*a), u32::from(*b));
                        return Err(Fault::Value { index, sub, expected, found, mask: 0xff });
                    }
                } else {
                    compare(index, sub, data.len(), word(data), value, mask)?;
                }
            }
            Step::Check { index, sub, len, expected, mask, tries } => {
                if let Err(fault) = compare(index, sub, len, expected, value, mask) {
                    self.tries += 1;
                    return if self.tries < tries { Ok(()) } else { Err(fault) };
                }
            }
            Step::RatedTorque => {
                let expected = self.rated_expected.unwrap_or_else(|| word(value));
                compare(o::RATED_TORQUE, 0, 4, expected, value, u32::MAX)?;
                if word(value) == 0 {
                    let (index, sub) = (o::RATED_TORQUE, 0);
                    return Err(Fault::Value { index, sub, expected: 1, found: 0, mask: u32::MAX });
                }
                self.rated_torque_mnm = Some(word(value));
            }
        }
        self.next();
        Ok(())
    }
}

fn word(data: &[u8]) -> u32 {
    data.iter().take(4).rev().fold(0, |w, &b| w << 8 | u32::from(b))
}

fn compare(index: u16, sub: u8, len: usize, expected: u32, value: &[u8], mask: u32) -> Result<(), Fault> {
    // Some servers answer a short object with all four bytes of the frame.
    let value = if value.len() == 4 && len < 4 { &value[..len] } else { value };
    if value.len() != len {
        return Err(Fault::Length { index, sub, expected: len, found: value.len() });
    }
    let found = word(value);
    if (found ^ expected) & mask == 0 { Ok(()) } else { Err(Fault::Value { index, sub, expected, found, mask }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_object_that_comes_with_all_four_bytes_of_its_frame_is_understood() {
        assert_eq!(compare(0x6061, 0, 1, 10, &[10, 0, 0, 0], 0xff), Ok(()));
        assert_eq!(compare(0x6072, 0, 2, 942, &[0xae, 3, 0xff, 0xff], u32::MAX), Ok(()));
        assert!(compare(0x6072, 0, 2, 942, &[0xaf, 3, 0, 0], u32::MAX).is_err(), "another value");
        assert!(compare(0x6072, 0, 2, 942, &[0xae, 3, 0], u32::MAX).is_err(), "a length that nobody has");
        assert!(compare(0x6076, 0, 4, 942, &[0xae, 3], u32::MAX).is_err(), "too short");
    }
}
