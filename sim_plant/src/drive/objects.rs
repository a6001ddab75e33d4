//! The object dictionary of the simulated drive as a table; `sim_plant/eds/sinew_drive.eds` says the same.

use sinew_hal::canopen::dictionary::{Access, DataType, Description, Kind, ObjectDictionary, Value};
use sinew_hal::cia402::objects as o;

use Access::{Const, Ro, Rw, Rww};
use DataType::{I8, I16, I32, U8, U16, U32, VisibleString};

/// Number of receive and of transmit PDOs.
pub const PDOS: u16 = 4;
/// Entries of a mapping: what the packed layout needs at its fullest, two of its own beside 15 dummies.
pub const MAPPED_MAX: u8 = 17;
/// Length of the error history (object 1003).
pub const HISTORY: u8 = 8;
/// Heartbeats that can be consumed (object 1016).
pub const CONSUMERS: u8 = 2;
/// Product code of the simulated drive ("SINW"). The vendor id is 0: sinew has none from CiA.
pub const PRODUCT: u32 = 0x5349_4e57;
/// Revision of the simulated drive.
pub const REVISION: u32 = 0x0001_0000;
/// Device type: servo drive (2) of profile 402.
pub const DEVICE_TYPE: u32 = 0x0002_0192;
/// Label, a string to be written by the user.
pub const LABEL: u16 = 0x2001;
/// Encoder counts per motor revolution, as record 608F has it (power-up value).
pub const ENCODER_COUNTS_PER_REV: i64 = 65_536;

/// What distinguishes one drive from another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nameplate {
    /// Serial number (1018:04).
    pub serial: u32,
    /// Rated torque (mN m), 6076.
    pub rated_torque_mnm: u32,
}

impl Default for Nameplate {
    fn default() -> Self {
        Self { serial: 1, rated_torque_mnm: 5000 }
    }
}

struct Table(ObjectDictionary);

impl Table {
    fn head(&mut self, index: u16, name: &str, kind: Kind) {
        self.0.object(index, name, kind);
    }

    #[allow(clippy::too_many_arguments)] // one line of the table
    fn value(&mut self, index: u16, sub: u8, name: &str, t: DataType, a: Access, mappable: bool, default: Value) {
        let limits = limits(index, sub);
        let name = name.into();
        self.0.add(Description { index, sub, name, data_type: t, access: a, mappable, default, limits });
    }

    /// A single value.
    fn var(&mut self, index: u16, name: &str, t: DataType, a: Access, mappable: bool, default: i64) {
        self.head(index, name, Kind::Variable);
        self.value(index, 0, name, t, a, mappable, Value::Int(default));
    }

    fn text(&mut self, index: u16, name: &str, a: Access, default: &str) {
        self.head(index, name, Kind::Variable);
        self.value(index, 0, name, VisibleString, a, false, Value::Text(default.into()));
    }

    /// Sub 0 and the listed sub-indices of an array or record.
    fn group(&mut self, index: u16, name: &str, kind: Kind, subs: &[(u8, &str, DataType, Access, Value)]) {
        self.head(index, name, kind);
        let highest = subs.iter().map(|s| s.0).max().unwrap_or(0);
        self.value(index, 0, "Highest sub-index supported", U8, Const, false, Value::Int(highest.into()));
        for (sub, name, t, a, default) in subs {
            self.value(index, *sub, name, *t, *a, false, default.clone());
        }
    }
}

/// Permitted values where the type allows more.
fn limits(index: u16, sub: u8) -> Option<(i64, i64)> {
    match (index, sub) {
        (o::ERROR_FIELD, 0) => Some((0, 0)),
        (o::ERROR_BEHAVIOUR, 1) => Some((0, 2)),
        (o::ABORT_CONNECTION, 0) => Some((0, 3)),
        // Ten times the rated torque, as far as sinew's configuration lets a drive go; 6072 limits what is applied.
        (o::GUARD, 2) => Some((-10_000, 10_000)),
        (o::GUARD, 3) => Some((0, 1)),
        (o::PDO_FORMAT, 0) => Some((o::PDO_FORMAT_CLASSIC.into(), o::PDO_FORMAT_FD_BRS.into())),
        (0x1600..=0x1603 | 0x1a00..=0x1a03, 0) => Some((0, i64::from(MAPPED_MAX))),
        _ => None,
    }
}

/// The dictionary of node `node` at power-up.
pub fn dictionary(node: u8, nameplate: Nameplate) -> ObjectDictionary {
    let mut t = Table(ObjectDictionary::new(node));
    communication(&mut t, nameplate);
    for n in 0..PDOS {
        pdo(&mut t, n);
    }
    t.group(
        o::GUARD,
        "Communication guard",
        Kind::Record,
        &[
            (1, "SYNC timeout in microseconds, 0 is off", U32, Rw, Value::Int(0)),
            (2, "Safe torque in per mille of rated torque", I16, Rw, Value::Int(0)),
            (3, "1 keeps the torque in place of the safe one", U8, Rw, Value::Int(0)),
        ],
    );
    t.text(LABEL, "Label of the drive", Rw, "unlabelled");
    let classic = o::PDO_FORMAT_CLASSIC.into();
    t.var(o::PDO_FORMAT, "PDO frames: 0 classic, 1 FD, 2 FD with bit-rate switch", U8, Rw, false, classic);
    profile(&mut t, nameplate);
    t.0
}

fn communication(t: &mut Table, nameplate: Nameplate) {
    let int = |v: u32| Value::Int(v.into());
    t.var(o::DEVICE_TYPE, "Device type", U32, Const, false, DEVICE_TYPE.into());
    t.var(o::ERROR_REGISTER, "Error register", U8, Ro, true, 0);
    t.head(o::ERROR_FIELD, "Pre-defined error field", Kind::Array);
    t.value(o::ERROR_FIELD, 0, "Number of errors", U8, Rw, false, Value::Int(0));
    for sub in 1..=HISTORY {
        t.value(o::ERROR_FIELD, sub, &format!("Standard error field {sub}"), U32, Ro, false, Value::Int(0));
    }
    t.var(o::COB_SYNC, "COB-ID SYNC message", U32, Const, false, 0x80);
    t.var(o::CYCLE_PERIOD, "Communication cycle period", U32, Rw, false, 0);
    t.text(0x1008, "Manufacturer device name", Const, "sinew simulated cable drive");
    t.text(0x1009, "Manufacturer hardware version", Const, "none");
    t.text(0x100a, "Manufacturer software version", Const, env!("CARGO_PKG_VERSION"));
    t.head(0x1014, "COB-ID EMCY", Kind::Variable);
    t.value(0x1014, 0, "COB-ID EMCY", U32, Const, false, Value::NodeIdPlus(0x80));
    t.group(
        o::HEARTBEAT_CONSUMER,
        "Consumer heartbeat time",
        Kind::Array,
        &[
            (1, "Consumer heartbeat time 1", U32, Rw, Value::Int(0)),
            (2, "Consumer heartbeat time 2", U32, Rw, Value::Int(0)),
        ],
    );
    t.var(o::HEARTBEAT_PRODUCER, "Producer heartbeat time", U16, Rw, false, 0);
    t.group(
        o::IDENTITY,
        "Identity object",
        Kind::Record,
        &[
            (1, "Vendor-ID", U32, Const, int(0)),
            (2, "Product code", U32, Const, int(PRODUCT)),
            (3, "Revision number", U32, Const, int(REVISION)),
            (4, "Serial number", U32, Const, int(nameplate.serial)),
        ],
    );
    t.group(o::ERROR_BEHAVIOUR, "Error behavior", Kind::Array, &[(1, "Communication error", U8, Rw, Value::Int(0))]);
    t.group(
        0x1200,
        "SDO server parameter",
        Kind::Record,
        &[
            (1, "COB-ID client to server", U32, Const, Value::NodeIdPlus(0x600)),
            (2, "COB-ID server to client", U32, Const, Value::NodeIdPlus(0x580)),
        ],
    );
}

/// The n-th (from 0) receive and transmit PDO: the first pair is mapped for cyclic synchronous torque from power-up on,
/// the others are off and empty.
fn pdo(t: &mut Table, n: u16) {
    let off: i64 = if n == 0 { 0 } else { 1 << 31 };
    let base = i64::from(n) * 0x100;
    let rpdo_cob = Value::NodeIdPlus(off + 0x200 + base);
    let tpdo_cob = Value::NodeIdPlus(off + (1 << 30) + 0x180 + base);
    let number = n + 1;
    t.group(
        o::RPDO_COMMUNICATION + n,
        &format!("RPDO {number} communication parameter"),
        Kind::Record,
        &[
            (1, "COB-ID used by RPDO", U32, Rw, rpdo_cob),
            (2, "Transmission type", U8, Rw, Value::Int(1)),
            (o::EVENT_TIMER, "Event timer", U16, Rw, Value::Int(0)),
        ],
    );
    t.group(
        o::TPDO_COMMUNICATION + n,
        &format!("TPDO {number} communication parameter"),
        Kind::Record,
        &[
            (1, "COB-ID used by TPDO", U32, Rw, tpdo_cob),
            (2, "Transmission type", U8, Rw, Value::Int(1)),
            (3, "Inhibit time", U16, Rw, Value::Int(0)),
            (o::EVENT_TIMER, "Event timer", U16, Rw, Value::Int(0)),
        ],
    );
    let mut mapping = |index: u16, kind: &str, entries: &[u32]| {
        t.head(index, &format!("{kind} {number} mapping parameter"), Kind::Record);
        let count = Value::Int(i64::try_from(entries.len()).unwrap_or(0));
        t.value(index, 0, "Number of mapped objects", U8, Rw, false, count);
        for sub in 1..=MAPPED_MAX {
            let value = entries.get(usize::from(sub) - 1).copied().unwrap_or(0);
            t.value(index, sub, &format!("Mapped object {sub}"), U32, Rw, false, Value::Int(value.into()));
        }
    };
    let first = |entries: &[u32]| if n == 0 { entries.to_vec() } else { Vec::new() };
    mapping(o::RPDO_MAPPING + n, "RPDO", &first(&o::RPDO1.map(|m| m.encode())));
    mapping(o::TPDO_MAPPING + n, "TPDO", &first(&o::TPDO1.map(|m| m.encode())));
}

fn profile(t: &mut Table, nameplate: Nameplate) {
    t.var(o::ABORT_CONNECTION, "Abort connection option code", I16, Rw, false, 1);
    t.var(o::ERROR_CODE, "Error code", U16, Ro, true, 0);
    t.var(o::CONTROLWORD, "Controlword", U16, Rww, true, 0);
    t.var(o::STATUSWORD, "Statusword", U16, Ro, true, 0);
    t.var(o::QUICK_STOP_OPTION, "Quick stop option code", I16, Rw, false, 2);
    t.var(o::MODE, "Modes of operation", I8, Rww, true, 0);
    t.var(o::MODE_DISPLAY, "Modes of operation display", I8, Ro, true, 0);
    t.var(o::POSITION, "Position actual value", I32, Ro, true, 0);
    t.var(o::VELOCITY, "Velocity actual value", I32, Ro, true, 0);
    t.var(o::TARGET_TORQUE, "Target torque", I16, Rww, true, 0);
    t.var(o::MAX_TORQUE, "Max torque", U16, Rw, false, 1000);
    t.var(o::TORQUE_DEMAND, "Torque demand", I16, Ro, true, 0);
    t.var(o::RATED_TORQUE, "Motor rated torque", U32, Const, false, nameplate.rated_torque_mnm.into());
    t.var(o::TORQUE, "Torque actual value", I16, Ro, true, 0);
    t.var(o::TORQUE_SLOPE, "Torque slope", U32, Rw, false, 10_000);
    t.group(
        0x608f,
        "Position encoder resolution",
        Kind::Array,
        &[
            (1, "Encoder increments", U32, Const, Value::Int(ENCODER_COUNTS_PER_REV)),
            (2, "Motor revolutions", U32, Const, Value::Int(1)),
        ],
    );
    t.var(o::SUPPORTED_MODES, "Supported drive modes", U32, Const, false, o::SUPPORTS_CST.into());
}
