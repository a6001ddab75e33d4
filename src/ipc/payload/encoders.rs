//! Measured cable lengths and tensions.

use super::{Header, MAX_CABLES};
use iceoryx2::prelude::ZeroCopySend;

/// Cable lengths and tensions, all captured at the header's time.
///
/// Lengths are what the model's `cable_lengths` gives for the same configuration: metres of cable between its entry and
/// its anchor, zero offset and drum radius already applied.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Encoders.v1")]
pub struct Encoders {
    /// Header.
    pub header: Header,
    /// Number of cables that follow; must be the arm's.
    pub cable_count: u32,
    /// [`super::EncoderSource`].
    pub source: u32,
    /// Bit c of word c/64: the length of cable c is valid.
    pub length_valid: [u64; 2],
    /// Bit c of word c/64: the tension of cable c is valid.
    pub tension_valid: [u64; 2],
    /// Lengths (m), base to tip, cable by cable within a segment.
    pub length_m: [f64; MAX_CABLES],
    /// Tensions (N).
    pub tension_n: [f64; MAX_CABLES],
}

impl Encoders {
    /// Whether the length of a cable is marked valid; false beyond the capacity.
    pub fn is_length_valid(&self, cable: usize) -> bool {
        bit(&self.length_valid, cable)
    }

    /// Whether the tension of a cable is marked valid; false beyond the capacity.
    pub fn is_tension_valid(&self, cable: usize) -> bool {
        bit(&self.tension_valid, cable)
    }

    /// Marks the first `count` cables valid, in lengths and tensions, and sets the count.
    pub fn set_all_valid(&mut self, count: usize) {
        let count = count.min(MAX_CABLES);
        let mask = ones(count);
        self.cable_count = count as u32;
        self.length_valid = mask;
        self.tension_valid = mask;
    }
}

/// Mask with the lowest `count` bits set.
pub(crate) fn ones(count: usize) -> [u64; 2] {
    let word = |n: usize| if n >= 64 { u64::MAX } else { (1_u64 << n) - 1 };
    [word(count), word(count.saturating_sub(64))]
}

fn bit(words: &[u64; 2], index: usize) -> bool {
    index < MAX_CABLES && words[index / 64] >> (index % 64) & 1 == 1
}

impl Default for Encoders {
    fn default() -> Self {
        Self {
            header: Header::default(),
            cable_count: 0,
            source: super::EncoderSource::Drives.wire(),
            length_valid: [0; 2],
            tension_valid: [0; 2],
            length_m: [0.0; MAX_CABLES],
            tension_n: [0.0; MAX_CABLES],
        }
    }
}
