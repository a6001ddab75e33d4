//! PDO mapping (CiA 301, 7.5.2.36): which objects lie where in a PDO.

use thiserror::Error;

/// Most entries of one mapping (sub-indices 01 to 40 of its object).
pub const ENTRIES_MAX: usize = 64;
/// COB-ID bit: the PDO does not exist.
pub const COB_INVALID: u32 = 1 << 31;
/// COB-ID bit: no remote request is answered (transmit PDOs).
pub const COB_NO_RTR: u32 = 1 << 30;

/// One object in a PDO.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Mapped {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Length (bits).
    pub bits: u8,
}

impl Mapped {
    /// An entry.
    pub const fn new(index: u16, sub: u8, bits: u8) -> Self {
        Self { index, sub, bits }
    }

    /// Value of the mapping object.
    pub const fn encode(self) -> u32 {
        (self.index as u32) << 16 | (self.sub as u32) << 8 | self.bits as u32
    }

    /// From the value of the mapping object.
    pub const fn decode(value: u32) -> Self {
        Self { index: (value >> 16) as u16, sub: (value >> 8) as u8, bits: value as u8 }
    }

    /// Length (bytes).
    pub const fn bytes(self) -> usize {
        self.bits as usize / 8
    }
}

/// A mapping that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum MappingError {
    /// Too many entries.
    #[error("{0} entries, at most 64 are possible")]
    Count(usize),
    /// More than the frame carries.
    #[error("{bits} bits, but the frame has {bytes_max} bytes")]
    Length {
        /// Bits mapped.
        bits: u32,
        /// Bytes of the frame.
        bytes_max: usize,
    },
    /// An entry that is not whole bytes, or empty.
    #[error("entry {0:08X} is not of one to eight whole bytes")]
    Granularity(u32),
}

/// The objects of one PDO in the order of its bytes; `Copy`, no heap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mapping {
    entries: [Mapped; ENTRIES_MAX],
    count: usize,
}

impl Default for Mapping {
    /// No entries.
    fn default() -> Self {
        Self { entries: [Mapped::default(); ENTRIES_MAX], count: 0 }
    }
}

impl Mapping {
    /// Checks count, granularity and total length; a classic frame has at most 8 bytes, a CAN FD frame 64.
    ///
    /// # Errors
    /// [`MappingError`].
    pub fn new(entries: &[Mapped], bytes_max: usize) -> Result<Self, MappingError> {
        if entries.len() > ENTRIES_MAX {
            return Err(MappingError::Count(entries.len()));
        }
        if let Some(e) = entries.iter().find(|e| e.bits == 0 || e.bits % 8 != 0 || e.bits > 64) {
            return Err(MappingError::Granularity(e.encode()));
        }
        let bits: u32 = entries.iter().map(|e| u32::from(e.bits)).sum();
        if bits as usize > 8 * bytes_max {
            return Err(MappingError::Length { bits, bytes_max });
        }
        let mut all = [Mapped::default(); ENTRIES_MAX];
        all[..entries.len()].copy_from_slice(entries);
        Ok(Self { entries: all, count: entries.len() })
    }

    /// The entries.
    pub fn entries(&self) -> &[Mapped] {
        &self.entries[..self.count]
    }

    /// Length of the PDO (bytes).
    pub fn len(&self) -> usize {
        self.entries().iter().map(|e| e.bytes()).sum()
    }

    /// True without entries.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Splits a payload: each entry with its little-endian bytes. `None` if the payload is shorter than the mapping; a
    /// longer one is allowed and its rest ignored (CiA 301).
    pub fn split<'a>(&'a self, data: &'a [u8]) -> Option<impl Iterator<Item = (Mapped, &'a [u8])> + 'a> {
        if data.len() < self.len() {
            return None;
        }
        Some(self.entries().iter().scan(0usize, move |at, &e| {
            let part = data.get(*at..*at + e.bytes())?;
            *at += e.bytes();
            Some((e, part))
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn entries_round_trip(value: u32) {
            prop_assert_eq!(Mapped::decode(value).encode(), value);
        }

        #[test]
        fn splitting_arbitrary_payloads_conserves_the_bytes(
            bytes in proptest::collection::vec(1u8..=8, 0..70), fd: bool, data in proptest::collection::vec(any::<u8>(), 0..65)
        ) {
            let entries: Vec<_> = bytes.iter().enumerate().map(|(i, b)| Mapped::new(0x2000 + i as u16, 0, b * 8)).collect();
            let total: usize = bytes.iter().map(|&b| usize::from(b)).sum();
            let bytes_max = if fd { 64 } else { 8 };
            match Mapping::new(&entries, bytes_max) {
                Err(_) => prop_assert!(total > bytes_max || entries.len() > 64),
                Ok(m) => match m.split(&data) {
                    None => prop_assert!(data.len() < total),
                    Some(parts) => {
                        let joined: Vec<u8> = parts.flat_map(|(_, p)| p.to_vec()).collect();
                        prop_assert_eq!(&joined[..], &data[..total]);
                    }
                },
            }
        }
    }

    #[test]
    fn partial_bytes_are_refused() {
        assert_eq!(Mapping::new(&[Mapped::new(0x6040, 0, 12)], 8), Err(MappingError::Granularity(0x6040_000c)));
    }
}
