//! What lies in the shared file, byte for byte.
//!
//! Everything is atomic, so every pattern of bits is a valid value and a concurrent write is never undefined behaviour.
//! Nothing read from here is trusted: a frame is checked (checksum with its place in the order, then the frame's own
//! rules) and no number is used as an index or a length without a bound.
//!
//! ```text
//! 0     magic u64 | version u32 | slots u32 | slot bytes u32 | 0 u32
//! 64    head u64        next ticket: the total order of the wire
//! 128   wake u32        futex: bit 0 = somebody sleeps, the rest counts publications
//! 192   state u32       0 active, 1 warning, 2 passive, 3 bus-off, 4 down
//! 196   (reserved)
//! 200   participants u64
//! 4096  slots, 128 bytes each: sequence u64 | sender u64 | time u64 | head word u64 | 8 data words u64 | checksum u64
//! ```
//! A slot's sequence is `4 ticket + stage`: 1 being written, 2 published, 3 abandoned.

use std::sync::atomic::{AtomicU32, AtomicU64};

use crate::can::{BusState, DATA_LEN_MAX, Frame, Id, Kind};

/// "sinewbus" in ASCII, little endian.
pub(super) const MAGIC: u64 = u64::from_le_bytes(*b"sinewbus");
/// Changes with every change of the layout.
pub(super) const VERSION: u32 = 1;
/// Frames that the ring holds: 50 cycles of 24 drives with 3 frames each.
pub(super) const SLOTS: u64 = 4096;
/// Offset of the first slot.
pub(super) const SLOTS_OFFSET: usize = 4096;
/// Size of the file.
pub(super) const FILE_LEN: usize = SLOTS_OFFSET + SLOTS as usize * size_of::<Slot>();
/// Words of a payload.
const DATA_WORDS: usize = DATA_LEN_MAX / 8;

/// Fixed part of the file. Groups sit on cache lines of their own.
#[repr(C)]
pub(super) struct Header {
    magic: AtomicU64,
    version: AtomicU32,
    slots: AtomicU32,
    slot_bytes: AtomicU32,
    _pad0: [AtomicU32; 11],
    pub(super) head: AtomicU64,
    _pad1: [AtomicU64; 7],
    pub(super) wake: AtomicU32,
    _pad2: [AtomicU32; 15],
    pub(super) state: AtomicU32,
    _pad3: AtomicU32,
    pub(super) participants: AtomicU64,
}

/// One frame on the wire.
#[repr(C, align(128))]
pub(super) struct Slot {
    pub(super) sequence: AtomicU64,
    pub(super) sender: AtomicU64,
    pub(super) time_ns: AtomicU64,
    pub(super) head: AtomicU64,
    pub(super) data: [AtomicU64; DATA_WORDS],
    pub(super) checksum: AtomicU64,
}

const _: () = {
    assert!(size_of::<Slot>() == 128);
    assert!(size_of::<Header>() <= SLOTS_OFFSET);
    assert!(std::mem::offset_of!(Header, head) == 64);
    assert!(std::mem::offset_of!(Header, wake) == 128);
    assert!(std::mem::offset_of!(Header, state) == 192);
    assert!(std::mem::offset_of!(Header, participants) == 200);
    assert!(SLOTS.is_power_of_two());
};

/// Bytes of a fresh file's beginning. Tickets start at `SLOTS`, so that a slot's initial sequence of zero is below all.
pub(super) fn initial_header() -> [u8; 208] {
    let mut b = [0; 208];
    b[0..8].copy_from_slice(&MAGIC.to_ne_bytes());
    b[8..12].copy_from_slice(&VERSION.to_ne_bytes());
    b[12..16].copy_from_slice(&(SLOTS as u32).to_ne_bytes());
    b[16..20].copy_from_slice(&(size_of::<Slot>() as u32).to_ne_bytes());
    b[64..72].copy_from_slice(&SLOTS.to_ne_bytes());
    b
}

/// Does a file's beginning announce this layout? `Err` carries the version found where only that differs.
pub(super) fn check_header(b: &[u8; 24]) -> Result<(), Option<u32>> {
    let word = |i: usize| u32::from_ne_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
    if b[0..8] != MAGIC.to_ne_bytes() {
        return Err(None);
    }
    if word(8) != VERSION || word(12) != SLOTS as u32 || word(16) as usize != size_of::<Slot>() {
        return Err(Some(word(8)));
    }
    Ok(())
}

/// Stage of a slot.
#[derive(Clone, Copy)]
pub(super) enum Stage {
    Writing = 1,
    Published = 2,
    Abandoned = 3,
}

/// Sequence number of a ticket's slot in a stage. Wraps: with a damaged header it is wrong, never a panic.
pub(super) fn sequence(ticket: u64, stage: Stage) -> u64 {
    ticket.wrapping_mul(4).wrapping_add(stage as u64)
}

/// A frame as words: header word, payload.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Words {
    pub(super) head: u64,
    pub(super) data: [u64; DATA_WORDS],
}

/// Identifier (bits 0..29), extended (31), kind (32..40), length (40..48).
pub(super) fn encode(frame: &Frame) -> Words {
    let id = match frame.id() {
        Id::Standard(i) => u64::from(i),
        Id::Extended(i) => u64::from(i) | 1 << 31,
    };
    let kind = match frame.kind() {
        Kind::Classic => 0,
        Kind::Remote => 1,
        Kind::Fd { bit_rate_switch: false } => 2,
        Kind::Fd { bit_rate_switch: true } => 3,
    };
    let mut bytes = [0; DATA_LEN_MAX];
    bytes[..frame.data().len()].copy_from_slice(frame.data());
    let mut data = [0; DATA_WORDS];
    for (word, eight) in data.iter_mut().zip(bytes.chunks_exact(8)) {
        *word = u64::from_ne_bytes([eight[0], eight[1], eight[2], eight[3], eight[4], eight[5], eight[6], eight[7]]);
    }
    Words { head: id | kind << 32 | (frame.len() as u64) << 40, data }
}

/// The frame of these words; `None` for anything that no frame encodes to.
pub(super) fn decode(words: &Words) -> Option<Frame> {
    let raw = words.head as u32 & 0x1fff_ffff;
    let id = if words.head >> 31 & 1 == 1 { Id::Extended(raw) } else { Id::Standard(u16::try_from(raw).ok()?) };
    let kind = match words.head >> 32 & 0xff {
        0 => Kind::Classic,
        1 => Kind::Remote,
        2 => Kind::Fd { bit_rate_switch: false },
        3 => Kind::Fd { bit_rate_switch: true },
        _ => return None,
    };
    let mut bytes = [0; DATA_LEN_MAX];
    for (eight, word) in bytes.chunks_exact_mut(8).zip(words.data) {
        eight.copy_from_slice(&word.to_ne_bytes());
    }
    let len = (words.head >> 40 & 0xff) as usize;
    let frame = Frame::new(id, kind, bytes.get(..len)?).ok()?;
    (encode(&frame) == *words).then_some(frame)
}

/// Binds a slot's content to its place in the order, so that a frame torn between two writers is recognised.
pub(super) fn checksum(ticket: u64, sender: u64, time_ns: u64, words: &Words) -> u64 {
    let mix = |h: u64, w: u64| (h ^ w).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
    let h = [ticket, sender, time_ns, words.head].into_iter().fold(MAGIC, mix);
    words.data.iter().copied().fold(h, mix)
}

/// The state word; unknown values read as down.
pub(super) fn state_from(word: u32) -> BusState {
    match word {
        0 => BusState::ErrorActive,
        1 => BusState::ErrorWarning,
        2 => BusState::ErrorPassive,
        3 => BusState::BusOff,
        _ => BusState::Down,
    }
}

/// The inverse of [`state_from`].
pub(super) fn state_word(state: BusState) -> u32 {
    match state {
        BusState::ErrorActive => 0,
        BusState::ErrorWarning => 1,
        BusState::ErrorPassive => 2,
        BusState::BusOff => 3,
        BusState::Down => 4,
    }
}
