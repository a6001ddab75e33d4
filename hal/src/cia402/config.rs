//! What the master needs to know of the drives and of time.

use super::layout::Layout;
use super::objects as o;
use crate::canopen::NodeId;
use thiserror::Error;

/// Most drives of one master: the width of [`super::DriveMask`].
pub const DRIVES_MAX: usize = 128;

/// Identity that a drive must show (object 1018); `None` accepts anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Identity {
    /// Vendor, 1018:01.
    pub vendor: Option<u32>,
    /// Product code, 1018:02.
    pub product: Option<u32>,
    /// Revision, 1018:03.
    pub revision: Option<u32>,
    /// Serial number, 1018:04.
    pub serial: Option<u32>,
}

/// A value that is written by SDO at start and read back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ObjectWrite {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Little-endian bytes.
    pub data: Vec<u8>,
    /// A drive without this object is accepted, and the fact noted.
    pub optional: bool,
}

impl ObjectWrite {
    /// What lets go of a torque that sinew's simulated drive keeps: it goes to the safe torque (per mille of rated torque) at
    /// this slope (per mille a second).
    pub fn sinew_release(safe_torque_permille: i16, slope: u32) -> [Self; 3] {
        let write = |index, sub, data| Self { index, sub, data, optional: false };
        [
            write(o::TORQUE_SLOPE, 0, slope.to_le_bytes().to_vec()),
            write(o::GUARD, o::GUARD_TORQUE, safe_torque_permille.to_le_bytes().to_vec()),
            write(o::GUARD, o::GUARD_KEEPS, vec![0]),
        ]
    }

    /// The guard of sinew's simulated drive: SYNC timeout (us, 0 off), safe torque (per mille of rated torque), and whether
    /// the torque that acts when the master falls silent is kept in its place.
    pub fn sinew_guard(sync_timeout_us: u32, safe_torque_permille: i16, keeps: bool) -> [Self; 3] {
        let write = |sub, data| Self { index: o::GUARD, sub, data, optional: false };
        [
            write(o::GUARD_SYNC, sync_timeout_us.to_le_bytes().to_vec()),
            write(o::GUARD_TORQUE, safe_torque_permille.to_le_bytes().to_vec()),
            write(o::GUARD_KEEPS, vec![u8::from(keeps)]),
        ]
    }
}

/// One drive; its place in the list is its cable's index.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveSetup {
    /// Which of the master's buses.
    pub bus: usize,
    /// Node id on it.
    pub node: NodeId,
    /// Identity to be checked.
    pub identity: Identity,
    /// Rated torque that 6076 must show (mN m), if known.
    pub rated_torque_mnm: Option<u32>,
    /// Largest torque (per mille of rated torque), written to 6072 and enforced by the master too.
    pub torque_permille_max: u16,
    /// What it does when the connection is lost, object 6007.
    pub abort_connection: i16,
    /// Its safe torque (2000:02 of sinew's simulated drive) follows the torques that it is sent.
    pub safe_torque_follows: bool,
    /// Further objects, written last.
    pub writes: Vec<ObjectWrite>,
    /// What lets go, slowly, of a torque that the drive keeps without a master: written before it is reset, if it still gives
    /// torque. None: it is reset at once.
    pub release: Vec<ObjectWrite>,
}

impl DriveSetup {
    /// A drive of any identity, torque up to its rated torque.
    pub fn new(bus: usize, node: NodeId) -> Self {
        Self {
            bus,
            node,
            identity: Identity::default(),
            rated_torque_mnm: None,
            torque_permille_max: 1000,
            abort_connection: 1,
            safe_torque_follows: false,
            writes: Vec::new(),
            release: Vec::new(),
        }
    }
}

/// Whether drives go through a procedure together or each after the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// All at once.
    #[default]
    Parallel,
    /// One after the other, in the order of the list.
    OneByOne,
    /// One after the other, from the end of the list.
    OneByOneReversed,
}

/// The master's settings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MasterConfig {
    /// Drives in the order of cables, at most 128.
    pub drives: Vec<DriveSetup>,
    /// Layout of each bus; a bus beyond the end of the list has the classic one.
    pub layouts: Vec<Layout>,
    /// The master's own node id, under which its heartbeat runs.
    pub node: NodeId,
    /// Period of the master's heartbeat (ms).
    pub heartbeat_ms: u16,
    /// After this time without it the drives go safe (ms), object 1016.
    pub heartbeat_timeout_ms: u16,
    /// Period of each drive's heartbeat (ms), object 1017.
    pub drive_heartbeat_ms: u16,
    /// After this time without it a drive counts as lost (ms).
    pub drive_heartbeat_timeout_ms: u16,
    /// After this time without RPDO 1 the drives go safe (ms), its event timer 1400:05; 0: never. The monitoring starts
    /// with the first RPDO (CiA 301, 7.5.2.35).
    pub rpdo_timeout_ms: u16,
    /// Whether a drive without that object is accepted.
    pub rpdo_timeout_optional: bool,
    /// Period of SYNC (us), object 1006.
    pub cycle_us: u32,
    /// Time granted to each SDO response (ms).
    pub sdo_timeout_ms: u32,
    /// Repetitions of a transfer after a time-out.
    pub sdo_retries: u32,
    /// Time between two objects that are read back in operation (us); 0: none are.
    pub read_back_us: u32,
    /// Time constant of the mean of the torques sent, which safe torques follow (us).
    pub mean_time_us: u32,
    /// Time that a drive is given to let go of a torque that it kept without a master, before it is reset (ms).
    pub release_ms: u32,
    /// Time granted from reset to boot-up (ms).
    pub boot_timeout_ms: u32,
    /// Time granted to each transition of the NMT and power state machines (ms).
    pub transition_timeout_ms: u32,
    /// Order of boot-up and configuration.
    pub order_of_start: Order,
    /// Order of enabling.
    pub order_of_enabling: Order,
    /// Order of disabling.
    pub order_of_disabling: Order,
}

impl MasterConfig {
    /// Defaults for the drives given: heartbeats of 50 ms with time-outs of 200 ms (four may be missed in a row but
    /// not five), SDO 100 ms twice repeated, nothing read back, torques averaged over
    /// 0.5 s, boot-up 5 s, transitions 1 s. RPDOs are not monitored, for how long they may
    /// be missing depends on who sends them.
    pub fn new(drives: Vec<DriveSetup>, node: NodeId, cycle_us: u32) -> Self {
        Self {
            drives,
            layouts: Vec::new(),
            node,
            heartbeat_ms: 50,
            heartbeat_timeout_ms: 200,
            drive_heartbeat_ms: 50,
            drive_heartbeat_timeout_ms: 200,
            rpdo_timeout_ms: 0,
            rpdo_timeout_optional: true,
            cycle_us,
            sdo_timeout_ms: 100,
            sdo_retries: 2,
            read_back_us: 0,
            mean_time_us: 500_000,
            release_ms: 0,
            boot_timeout_ms: 5000,
            transition_timeout_ms: 1000,
            order_of_start: Order::Parallel,
            order_of_enabling: Order::Parallel,
            order_of_disabling: Order::Parallel,
        }
    }

    /// Layout of a bus.
    pub fn layout(&self, bus: usize) -> Layout {
        self.layouts.get(bus).copied().unwrap_or_default()
    }

    /// Rank of a drive among the drives of its bus, and how many these are.
    pub(crate) fn rank(&self, drive: usize) -> (usize, usize) {
        let Some(own) = self.drives.get(drive) else { return (0, 0) };
        let on_its_bus = |drives: &[DriveSetup]| drives.iter().filter(|d| d.bus == own.bus).count();
        (on_its_bus(&self.drives[..drive]), on_its_bus(&self.drives))
    }

    /// Checks what can be checked before a frame is sent.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn check(&self, buses: usize) -> Result<(), SetupError> {
        if self.drives.is_empty() || self.drives.len() > DRIVES_MAX {
            return Err(SetupError::Count(self.drives.len()));
        }
        for (i, d) in self.drives.iter().enumerate() {
            if d.bus >= buses {
                return Err(SetupError::Bus { drive: i, bus: d.bus, buses });
            }
            if d.node == self.node {
                return Err(SetupError::MastersNode { drive: i, node: d.node });
            }
            if let Some(j) = self.drives[..i].iter().position(|e| (e.bus, e.node) == (d.bus, d.node)) {
                return Err(SetupError::Twice { first: j, second: i, bus: d.bus, node: d.node });
            }
        }
        for bus in 0..buses {
            let (found, most) = (self.drives.iter().filter(|d| d.bus == bus).count(), self.layout(bus).drives_max());
            if found > most {
                return Err(SetupError::Full { bus, found, most });
            }
        }
        for (name, period, timeout) in [
            ("master's heartbeat", self.heartbeat_ms, self.heartbeat_timeout_ms),
            ("drives' heartbeat", self.drive_heartbeat_ms, self.drive_heartbeat_timeout_ms),
        ] {
            if period == 0 || timeout <= period {
                return Err(SetupError::Heartbeat { name, period, timeout });
            }
        }
        if self.cycle_us == 0 {
            return Err(SetupError::Cycle);
        }
        // Shorter than two cycles, a single lost RPDO, which SYNC bridges, would stop the drive.
        let timeout_ms = self.rpdo_timeout_ms;
        if timeout_ms != 0 && u64::from(timeout_ms) * 1000 < 2 * u64::from(self.cycle_us) {
            return Err(SetupError::RpdoTimeout { timeout_ms, cycle_us: self.cycle_us });
        }
        Ok(())
    }
}

/// Settings that cannot work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs)] // the messages say it
pub enum SetupError {
    #[error("{0} drives; 1 to 128 are possible")]
    Count(usize),
    #[error("drive {drive} is on bus {bus}, but there are {buses} buses")]
    Bus { drive: usize, bus: usize, buses: usize },
    #[error("drive {drive} has the master's own node id {node}")]
    MastersNode { drive: usize, node: NodeId },
    #[error("drives {first} and {second} both have node id {node} on bus {bus}")]
    Twice { first: usize, second: usize, bus: usize, node: NodeId },
    #[error("bus {bus} has {found} drives, but its layout has places for {most}")]
    Full { bus: usize, found: usize, most: usize },
    #[error("{name}: period {period} ms must be above 0 and below its time-out of {timeout} ms")]
    Heartbeat { name: &'static str, period: u16, timeout: u16 },
    #[error("the cycle must be longer than 0 us")]
    Cycle,
    #[error("RPDO time-out of {timeout_ms} ms is shorter than two cycles of {cycle_us} us")]
    RpdoTimeout { timeout_ms: u16, cycle_us: u32 },
    #[error("a bus handle could not be duplicated, operating system error {0}")]
    Duplicate(i32),
}
