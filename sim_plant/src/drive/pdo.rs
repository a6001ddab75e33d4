//! PDOs of the simulated drive: what objects 1400 to 1403, 1600 to 1603, 1800 to 1803 and 1A00 to 1A03 mean.
//!
//! Changing a mapping follows CiA 301, 7.5.2.36: the PDO is made invalid (bit 31 of its COB-ID), the number of entries
//! is set to 0, the entries are written, the number is set, the PDO is made valid. Any other order is refused.
//!
//! An RPDO may be shared with other nodes: what is theirs is mapped by the indices of data types as dummies (0002 to
//! 0007). Object 2002 says whether PDOs are classic frames of at most 8 bytes or CAN FD frames of at most 64.

use super::objects::{MAPPED_MAX, PDOS};
use sinew_hal::can::{DATA_LEN_MAX, Kind};
use sinew_hal::canopen::dictionary::{Access, DataType, ObjectDictionary};
use sinew_hal::canopen::pdo::{COB_INVALID, Mapped, Mapping};
use sinew_hal::canopen::sdo::AbortCode;
use sinew_hal::cia402::objects as o;

/// Direction seen from the drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// RPDO.
    Receive,
    /// TPDO.
    Transmit,
}

/// One PDO as configured; a copy of what the dictionary says, so that frames are served without looking it up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Pdo {
    /// Identifier, `None` when the PDO is off.
    pub cob: Option<u16>,
    /// 0 acyclic synchronous, 1..=240 every n-th SYNC, 254 and 255 event-driven.
    pub transmission: u8,
    /// Least time between two event-driven transmissions (ns).
    pub inhibit_ns: u64,
    /// Longest time between two event-driven transmissions, or between two receptions (ns), 0: none.
    pub event_ns: u64,
    /// What lies where.
    pub mapping: Mapping,
}

impl Pdo {
    /// True for types 0 to 240.
    pub fn is_synchronous(&self) -> bool {
        self.transmission <= 240
    }

    /// Reads the n-th PDO (from 0) out of the dictionary.
    pub fn of(dictionary: &ObjectDictionary, direction: Direction, n: u16) -> Self {
        let (communication, mapping) = bases(direction);
        let cob = dictionary.int(communication + n, 1);
        let count = dictionary.int(mapping + n, 0).clamp(0, i64::from(MAPPED_MAX)) as u8;
        let entries: Vec<_> = (1..=count).map(|s| entry(dictionary, mapping + n, s)).collect();
        Self {
            cob: (cob & i64::from(COB_INVALID) == 0).then_some((cob & 0x7ff) as u16),
            transmission: dictionary.int(communication + n, 2) as u8,
            inhibit_ns: dictionary.int(communication + n, 3).unsigned_abs() * 100_000,
            event_ns: dictionary.int(communication + n, o::EVENT_TIMER).unsigned_abs() * 1_000_000,
            mapping: Mapping::new(&entries, DATA_LEN_MAX).unwrap_or_default(),
        }
    }
}

fn bases(direction: Direction) -> (u16, u16) {
    match direction {
        Direction::Receive => (o::RPDO_COMMUNICATION, o::RPDO_MAPPING),
        Direction::Transmit => (o::TPDO_COMMUNICATION, o::TPDO_MAPPING),
    }
}

fn entry(dictionary: &ObjectDictionary, mapping: u16, sub: u8) -> Mapped {
    Mapped::decode(dictionary.int(mapping, sub) as u32)
}

/// Direction and number (from 0) of the PDO whose communication parameters (`true`) or mapping (`false`) this index is.
pub fn parameter(index: u16) -> Option<(Direction, u16, bool)> {
    [(Direction::Receive, true), (Direction::Receive, false), (Direction::Transmit, true), (Direction::Transmit, false)]
        .into_iter()
        .find_map(|(direction, communication)| {
            let (c, m) = bases(direction);
            let base = if communication { c } else { m };
            (base..base + PDOS).contains(&index).then(|| (direction, index - base, communication))
        })
}

/// Identifiers that CiA 301 reserves (table 42).
fn restricted(cob: u32) -> bool {
    matches!(cob, 0..=0x7f | 0x80 | 0x101..=0x180 | 0x581..=0x5ff | 0x601..=0x67f | 0x6e0..=0x6ff | 0x701..=0x7ff)
}

/// Most bytes of a classic frame.
const CLASSIC_MAX: usize = 8;

/// Frames in which PDOs travel, object 2002.
pub fn frame_kind(dictionary: &ObjectDictionary) -> Kind {
    match dictionary.int(o::PDO_FORMAT, 0) {
        f if f == i64::from(o::PDO_FORMAT_FD) => Kind::Fd { bit_rate_switch: false },
        f if f == i64::from(o::PDO_FORMAT_FD_BRS) => Kind::Fd { bit_rate_switch: true },
        _ => Kind::Classic,
    }
}

/// Checks a write to object 2002: classic frames do not carry a longer mapping.
///
/// # Errors
/// [`AbortCode::PDO_LENGTH`].
pub fn check_format(dictionary: &ObjectDictionary, value: i64) -> Result<(), AbortCode> {
    let too_long = |direction| (0..PDOS).any(|n| Pdo::of(dictionary, direction, n).mapping.len() > CLASSIC_MAX);
    let classic = value == i64::from(o::PDO_FORMAT_CLASSIC);
    if classic && (too_long(Direction::Receive) || too_long(Direction::Transmit)) {
        return Err(AbortCode::PDO_LENGTH);
    }
    Ok(())
}

/// Checks a write to a PDO parameter beyond type, access and limits.
///
/// # Errors
/// The abort code that CiA 301 prescribes.
pub fn check(dictionary: &ObjectDictionary, index: u16, sub: u8, value: i64) -> Result<(), AbortCode> {
    let Some((direction, n, communication)) = parameter(index) else { return Ok(()) };
    let (communication_base, mapping_base) = bases(direction);
    let cob = dictionary.int(communication_base + n, 1) as u32;
    let valid = cob & COB_INVALID == 0;
    match (communication, sub) {
        (true, 1) => {
            let new = value as u32;
            let wanted_valid = new & COB_INVALID == 0;
            let id = new & 0x1fff_ffff;
            if new & 1 << 29 != 0 || id > 0x7ff || (wanted_valid && restricted(id)) {
                return Err(AbortCode::VALUE_RANGE); // 29 bits are not supported
            }
            if valid && wanted_valid && (cob ^ new) & 0x1fff_ffff != 0 {
                return Err(AbortCode::VALUE_RANGE); // an identifier changes only while the PDO is off
            }
            Ok(())
        }
        (true, 2) if (241..=253).contains(&value) => Err(AbortCode::VALUE_RANGE),
        (true, 3) if valid => Err(AbortCode::DEVICE_STATE),
        (true, _) => Ok(()),
        (false, _) if valid => Err(AbortCode::DEVICE_STATE),
        (false, 0) => {
            let count = value.clamp(0, i64::from(MAPPED_MAX)) as u8;
            let entries: Vec<_> = (1..=count).map(|s| entry(dictionary, mapping_base + n, s)).collect();
            for e in &entries {
                check_entry(dictionary, direction, *e)?;
            }
            let bytes_max = if frame_kind(dictionary) == Kind::Classic { CLASSIC_MAX } else { DATA_LEN_MAX };
            Mapping::new(&entries, bytes_max).map(|_| ()).map_err(|_| AbortCode::PDO_LENGTH)
        }
        (false, _) if dictionary.int(mapping_base + n, 0) != 0 => Err(AbortCode::UNSUPPORTED_ACCESS),
        (false, _) if value == 0 => Ok(()),
        (false, _) => check_entry(dictionary, direction, Mapped::decode(value as u32)),
    }
}

/// Length (bytes) of the type at this index, if it may stand for what belongs to another node. BOOLEAN (0001) is of one
/// bit and would need a finer granularity than bytes.
fn dummy_size(index: u16) -> Option<usize> {
    [DataType::I8, DataType::I16, DataType::I32, DataType::U8, DataType::U16, DataType::U32]
        .into_iter()
        .find(|t| t.code() == index)
        .and_then(DataType::size)
}

fn check_entry(dictionary: &ObjectDictionary, direction: Direction, e: Mapped) -> Result<(), AbortCode> {
    if let Some(size) = dummy_size(e.index) {
        let fits = direction == Direction::Receive && e.sub == 0 && size == e.bytes() && e.bits.is_multiple_of(8);
        return if fits { Ok(()) } else { Err(AbortCode::NOT_MAPPABLE) };
    }
    let d = dictionary.description(e.index, e.sub).ok_or(AbortCode::NO_OBJECT)?;
    let access = match direction {
        Direction::Receive => matches!(d.access, Access::Rw | Access::Rww),
        Direction::Transmit => d.access != Access::Rww,
    };
    if !d.mappable || !access || d.data_type.size() != Some(e.bytes()) || !e.bits.is_multiple_of(8) {
        return Err(AbortCode::NOT_MAPPABLE);
    }
    Ok(())
}
