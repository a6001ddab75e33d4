//! The object dictionary of a slave as data: what an EDS file describes, with live values.
//!
//! Enters: a table of descriptions, then reads and writes by index and sub-index as little-endian bytes. Leaves: bytes
//! or the abort code that CiA 301 prescribes. It knows types, access and ranges, and nothing of what objects mean.

use super::sdo::AbortCode;
use std::collections::BTreeMap;

/// Type of an object (CiA 301, table 44).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DataType {
    /// 8 bits, signed.
    I8,
    /// 16 bits, signed.
    I16,
    /// 32 bits, signed.
    I32,
    /// 8 bits, unsigned.
    U8,
    /// 16 bits, unsigned.
    U16,
    /// 32 bits, unsigned.
    U32,
    /// Characters, of any length up to the server's limit.
    VisibleString,
}

impl DataType {
    /// Index of the type, as an EDS file has it.
    pub const fn code(self) -> u16 {
        match self {
            Self::I8 => 2,
            Self::I16 => 3,
            Self::I32 => 4,
            Self::U8 => 5,
            Self::U16 => 6,
            Self::U32 => 7,
            Self::VisibleString => 9,
        }
    }

    /// Length (bytes); `None` for a string.
    pub const fn size(self) -> Option<usize> {
        match self {
            Self::I8 | Self::U8 => Some(1),
            Self::I16 | Self::U16 => Some(2),
            Self::I32 | Self::U32 => Some(4),
            Self::VisibleString => None,
        }
    }

    /// Smallest and largest value of an integer type.
    pub const fn range(self) -> (i64, i64) {
        match self {
            Self::I8 => (i8::MIN as i64, i8::MAX as i64),
            Self::I16 => (i16::MIN as i64, i16::MAX as i64),
            Self::I32 => (i32::MIN as i64, i32::MAX as i64),
            Self::U8 => (0, u8::MAX as i64),
            Self::U16 => (0, u16::MAX as i64),
            Self::U32 => (0, u32::MAX as i64),
            Self::VisibleString => (0, 0),
        }
    }

    /// Little-endian bytes of an integer, or `None` if it is not of this type.
    pub fn encode(self, value: i64) -> Option<Vec<u8>> {
        let (low, high) = self.range();
        let len = self.size()?;
        (low..=high).contains(&value).then(|| value.to_le_bytes()[..len].to_vec())
    }

    /// Integer from exactly as many little-endian bytes as the type has.
    pub fn decode(self, data: &[u8]) -> Option<i64> {
        if self.size() != Some(data.len()) {
            return None;
        }
        let negative = self.range().0 < 0 && data.last().is_some_and(|b| b & 0x80 != 0);
        let mut bytes = if negative { [0xff; 8] } else { [0; 8] };
        bytes[..data.len()].copy_from_slice(data);
        Some(i64::from_le_bytes(bytes))
    }
}

/// Who may do what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Access {
    /// Never changes.
    Const,
    /// Read.
    Ro,
    /// Read and write.
    Rw,
    /// Read and write, may be mapped into an RPDO only.
    Rww,
    /// Read and write, may be mapped into a TPDO only.
    Rwr,
}

impl Access {
    /// Word in an EDS file.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Const => "const",
            Self::Ro => "ro",
            Self::Rw => "rw",
            Self::Rww => "rww",
            Self::Rwr => "rwr",
        }
    }

    /// True if a write is allowed.
    pub const fn writable(self) -> bool {
        !matches!(self, Self::Const | Self::Ro)
    }
}

/// A value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Value {
    /// Of an integer type.
    Int(i64),
    /// The node id plus a number, resolved when the dictionary is made (`$NODEID+...` in an EDS file).
    NodeIdPlus(i64),
    /// Of a string type.
    Text(String),
}

/// Description of one value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Description {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Name.
    pub name: String,
    /// Type.
    pub data_type: DataType,
    /// Access.
    pub access: Access,
    /// May be mapped into a PDO.
    pub mappable: bool,
    /// Value at start and after reset.
    pub default: Value,
    /// Permitted values where narrower than the type.
    pub limits: Option<(i64, i64)>,
}

/// What an index is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// One value at sub-index 0.
    Variable,
    /// Values of one type.
    Array,
    /// Values of several types.
    Record,
}

/// Name and kind of an index.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Object {
    /// Name.
    pub name: String,
    /// Kind.
    pub kind: Kind,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Entry {
    description: Description,
    live: Value,
}

/// Live dictionary of one node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ObjectDictionary {
    node: u8,
    objects: BTreeMap<u16, Object>,
    entries: BTreeMap<(u16, u8), Entry>,
}

impl ObjectDictionary {
    /// An empty dictionary of the given node.
    pub fn new(node: u8) -> Self {
        Self { node, objects: BTreeMap::new(), entries: BTreeMap::new() }
    }

    /// Declares an index.
    pub fn object(&mut self, index: u16, name: &str, kind: Kind) {
        self.objects.insert(index, Object { name: name.into(), kind });
    }

    /// Adds a value under a declared index; it takes its default.
    pub fn add(&mut self, description: Description) {
        let live = self.resolve(&description.default);
        self.entries.insert((description.index, description.sub), Entry { description, live });
    }

    fn resolve(&self, value: &Value) -> Value {
        match value {
            Value::NodeIdPlus(n) => Value::Int(i64::from(self.node) + n),
            v => v.clone(),
        }
    }

    /// Indices with name and kind, ascending.
    pub fn objects(&self) -> impl Iterator<Item = (u16, &Object)> {
        self.objects.iter().map(|(&i, o)| (i, o))
    }

    /// Descriptions, ascending by index and sub-index.
    pub fn descriptions(&self) -> impl Iterator<Item = &Description> {
        self.entries.values().map(|e| &e.description)
    }

    /// Description of one value.
    pub fn description(&self, index: u16, sub: u8) -> Option<&Description> {
        self.entries.get(&(index, sub)).map(|e| &e.description)
    }

    /// Takes the defaults back for every index in the range.
    pub fn reset(&mut self, indices: std::ops::RangeInclusive<u16>) {
        let node = self.node;
        for entry in self.entries.range_mut((*indices.start(), 0)..=(*indices.end(), 255)).map(|(_, e)| e) {
            entry.live = match &entry.description.default {
                Value::NodeIdPlus(n) => Value::Int(i64::from(node) + n),
                v => v.clone(),
            };
        }
    }

    fn entry(&self, index: u16, sub: u8) -> Result<&Entry, AbortCode> {
        self.entries.get(&(index, sub)).ok_or(if self.objects.contains_key(&index) {
            AbortCode::NO_SUB_INDEX
        } else {
            AbortCode::NO_OBJECT
        })
    }

    /// Live integer; 0 for an absent object or a string. For the device's own use.
    pub fn int(&self, index: u16, sub: u8) -> i64 {
        match self.entries.get(&(index, sub)).map(|e| &e.live) {
            Some(Value::Int(v)) => *v,
            _ => 0,
        }
    }

    /// Sets a live integer past access and limits, saturating at the type's range. For the device's own use; an absent
    /// object is ignored.
    pub fn set_int(&mut self, index: u16, sub: u8, value: i64) {
        if let Some(e) = self.entries.get_mut(&(index, sub)) {
            let (low, high) = e.description.data_type.range();
            e.live = Value::Int(value.clamp(low, high));
        }
    }

    /// Bytes as an SDO upload or a PDO carries them.
    ///
    /// # Errors
    /// Object or sub-index does not exist.
    pub fn read(&self, index: u16, sub: u8) -> Result<Vec<u8>, AbortCode> {
        let e = self.entry(index, sub)?;
        Ok(match &e.live {
            Value::Int(v) | Value::NodeIdPlus(v) => {
                v.to_le_bytes()[..e.description.data_type.size().unwrap_or(0)].to_vec()
            }
            Value::Text(t) => t.clone().into_bytes(),
        })
    }

    /// The checks of a write without its data: the object exists and may be written.
    ///
    /// # Errors
    /// Abort code.
    pub fn check_write(&self, index: u16, sub: u8) -> Result<(), AbortCode> {
        if self.entry(index, sub)?.description.access.writable() { Ok(()) } else { Err(AbortCode::READ_ONLY) }
    }

    /// Integer that the bytes would write, checked for access, length and limits; nothing is changed.
    ///
    /// # Errors
    /// Abort code; [`AbortCode::LENGTH`] and its kin for a wrong number of bytes.
    pub fn check_int(&self, index: u16, sub: u8, data: &[u8]) -> Result<i64, AbortCode> {
        self.check_write(index, sub)?;
        let d = &self.entry(index, sub)?.description;
        let len = d.data_type.size().unwrap_or(0);
        let value = d.data_type.decode(data).ok_or(match data.len().cmp(&len) {
            std::cmp::Ordering::Greater => AbortCode::TOO_LONG,
            std::cmp::Ordering::Less => AbortCode::TOO_SHORT,
            std::cmp::Ordering::Equal => AbortCode::LENGTH,
        })?;
        match d.limits {
            Some((low, _)) if value < low => Err(AbortCode::VALUE_LOW),
            Some((_, high)) if value > high => Err(AbortCode::VALUE_HIGH),
            _ => Ok(value),
        }
    }

    /// Writes bytes with all checks.
    ///
    /// # Errors
    /// Abort code.
    pub fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        self.check_write(index, sub)?;
        let live = match self.entry(index, sub)?.description.data_type {
            DataType::VisibleString => {
                let text = std::str::from_utf8(data).map_err(|_| AbortCode::VALUE_RANGE)?;
                if !text.chars().all(|c| c.is_ascii_graphic() || c == ' ') {
                    return Err(AbortCode::VALUE_RANGE);
                }
                Value::Text(text.into())
            }
            _ => Value::Int(self.check_int(index, sub, data)?),
        };
        if let Some(e) = self.entries.get_mut(&(index, sub)) {
            e.live = live;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TYPES: [DataType; 6] =
        [DataType::I8, DataType::I16, DataType::I32, DataType::U8, DataType::U16, DataType::U32];

    proptest! {
        #[test]
        fn integers_round_trip(which in 0usize..6, value: i64) {
            let t = TYPES[which];
            let (low, high) = t.range();
            match t.encode(value) {
                Some(b) => prop_assert_eq!(t.decode(&b), Some(value)),
                None => prop_assert!(value < low || value > high),
            }
            let inside = low + value.rem_euclid(high - low + 1);
            prop_assert_eq!(t.decode(&t.encode(inside).unwrap()), Some(inside));
        }
    }

    #[test]
    fn access_length_and_limits_are_checked() {
        let mut d = ObjectDictionary::new(4);
        d.object(0x6071, "x", Kind::Variable);
        let base = Description {
            index: 0x6071,
            sub: 0,
            name: "x".into(),
            data_type: DataType::I16,
            access: Access::Rw,
            mappable: true,
            default: Value::Int(0),
            limits: Some((-10, 10)),
        };
        d.add(base.clone());
        d.add(Description { sub: 1, access: Access::Ro, default: Value::NodeIdPlus(0x80), ..base });
        assert_eq!(d.write(0x6071, 0, &[11, 0]), Err(AbortCode::VALUE_HIGH));
        assert_eq!(d.write(0x6071, 0, &(-11i16).to_le_bytes()), Err(AbortCode::VALUE_LOW));
        assert_eq!(d.write(0x6071, 0, &[1]), Err(AbortCode::TOO_SHORT));
        assert_eq!(d.write(0x6071, 0, &[1, 0, 0]), Err(AbortCode::TOO_LONG));
        assert_eq!(d.write(0x6071, 1, &[1, 0]), Err(AbortCode::READ_ONLY));
        assert_eq!(d.write(0x6071, 2, &[1, 0]), Err(AbortCode::NO_SUB_INDEX));
        assert_eq!(d.write(0x6072, 0, &[1, 0]), Err(AbortCode::NO_OBJECT));
        assert_eq!(d.write(0x6071, 0, &(-10i16).to_le_bytes()), Ok(()));
        assert_eq!((d.int(0x6071, 0), d.int(0x6071, 1)), (-10, 0x84));
        d.reset(0x6000..=0x6fff);
        assert_eq!(d.int(0x6071, 0), 0);
    }
}
