//! How much of a bus a set of periodic frames takes in the worst case.
//!
//! Enters: shapes of frames and how often each is sent. Leaves: bits, time, share of the bus, highest cycle frequency.
//! A frame's length on the wire depends on its content through bit stuffing, so the worst content counts:
//! - classic frames by the bound of Davis, Burns, Bril, Lukkien, *Controller Area Network (CAN) schedulability analysis:
//!   refuted, revisited and revised* (2007), eq. 1: of `g + 8n` stuffed bits (g = 34, with extended identifiers 54) every
//!   fourth after the first can be followed by a stuff bit. The fixed bits and the checksum keep real frames 2 or 3 bits
//!   below it (the tests find the longest that exist);
//! - CAN FD frames exactly: stuffing ends with the payload there, the checksum has stuff bits at fixed places
//!   (ISO 11898-1:2015), so the worst content follows from a walk over the few states of the stuffing rule. A stuff bit
//!   in the arbitration phase costs more than one at the higher rate, and the walk weighs them by time.
//!
//! Each length includes the three bits of intermission. A frame of the CAN FD kind at a single rate is the same without
//! the switch.
//! Must never: promise more than the wire carries; where a bit belongs to both phases it counts at the slower rate.

use crate::can::Kind;

/// Bit rates of a bus (bit/s); `data` is that of the switched phase of CAN FD frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BitRates {
    /// Arbitration phase, and all of a classic frame.
    pub nominal: u32,
    /// Data phase.
    pub data: u32,
}

impl BitRates {
    /// A classic bus.
    pub fn classic(nominal: u32) -> Self {
        Self { nominal, data: nominal }
    }
}

/// What of a frame decides about its length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// 29-bit identifier.
    pub extended: bool,
    /// Kind.
    pub kind: Kind,
    /// Payload (bytes); rounded up to a length that CAN FD has, cut to 8 for classic frames. A remote request has none.
    pub len: usize,
}

impl Shape {
    /// A classic data frame with an 11-bit identifier.
    pub fn classic(len: usize) -> Self {
        Self { extended: false, kind: Kind::Classic, len }
    }

    /// A CAN FD frame with an 11-bit identifier and bit-rate switch.
    pub fn fd(len: usize) -> Self {
        Self { extended: false, kind: Kind::Fd { bit_rate_switch: true }, len }
    }

    /// Worst-case bits on the wire, at rates as given (they decide where CAN FD's stuff bits cost most).
    pub fn bits(&self, rates: BitRates) -> Bits {
        match self.kind {
            Kind::Classic => classic_bits(self.extended, self.len.min(8) as u32),
            Kind::Remote => classic_bits(self.extended, 0),
            Kind::Fd { bit_rate_switch } => fd_bits(self.extended, bit_rate_switch, self.len, rates),
        }
    }
}

/// Bits on the wire by phase, intermission included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bits {
    /// At the nominal rate.
    pub nominal: u32,
    /// At the data rate.
    pub data: u32,
}

impl Bits {
    /// Time on the wire (s).
    pub fn time_s(&self, rates: BitRates) -> f64 {
        f64::from(self.nominal) / f64::from(rates.nominal) + f64::from(self.data) / f64::from(rates.data)
    }
}

/// How often a frame is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rate {
    /// So many in each cycle.
    PerCycle(f64),
    /// So many in a second, whatever the cycle (heartbeats).
    PerSecond(f64),
}

/// The traffic of a bus, summed up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    rates: BitRates,
    /// Time on the wire in each cycle (s).
    cycle_s: f64,
    /// Share of the bus that does not depend on the cycle.
    background: f64,
}

impl Load {
    /// No traffic yet.
    pub fn new(rates: BitRates) -> Self {
        Self { rates, cycle_s: 0.0, background: 0.0 }
    }

    /// The same with one more kind of frame.
    #[must_use]
    pub fn with(mut self, shape: Shape, rate: Rate) -> Self {
        let time_s = shape.bits(self.rates).time_s(self.rates);
        match rate {
            Rate::PerCycle(n) => self.cycle_s += n * time_s,
            Rate::PerSecond(n) => self.background += n * time_s,
        }
        self
    }

    /// Time on the wire in each cycle (s).
    pub fn cycle_s(&self) -> f64 {
        self.cycle_s
    }

    /// Share of the bus at a cycle frequency; above 1 it cannot be carried.
    pub fn share(&self, cycle_hz: f64) -> f64 {
        self.cycle_s * cycle_hz + self.background
    }

    /// Highest cycle frequency (Hz) at which the share stays at `share_max`; zero if the background alone exceeds it,
    /// infinite without cyclic frames.
    pub fn ceiling_hz(&self, share_max: f64) -> f64 {
        ((share_max - self.background) / self.cycle_s).max(0.0)
    }
}

/// Bits of a classic frame that are not stuffed: CRC delimiter, acknowledge slot and delimiter, end of frame (7),
/// intermission (3).
const CLASSIC_TAIL: u32 = 13;

fn classic_bits(extended: bool, len: u32) -> Bits {
    let stuffed = if extended { 54 } else { 34 } + 8 * len;
    Bits { nominal: stuffed + (stuffed - 1) / 4 + CLASSIC_TAIL, data: 0 }
}

/// A bit before stuffing: fixed, or of the sender's choice.
#[derive(Clone, Copy)]
enum Bit {
    Fixed(bool),
    Free,
}

/// The nominal part of an FD frame that is stuffed: from the start of frame to the bit-rate switch, which is `brs`.
fn fd_arbitration(extended: bool, brs: bool) -> impl Iterator<Item = Bit> {
    use Bit::{Fixed, Free};
    let free = |n| std::iter::repeat_n(Free, n);
    // Start of frame and base identifier; SRR, IDE and the rest of a long one; RRS (and IDE), FDF, res, BRS.
    let middle = if extended { (2, 18) } else { (0, 0) };
    let ide = if extended { 0 } else { 1 };
    std::iter::once(Fixed(false))
        .chain(free(11))
        .chain(std::iter::repeat_n(Fixed(true), middle.0))
        .chain(free(middle.1))
        .chain(std::iter::repeat_n(Fixed(false), 1 + ide))
        .chain([Fixed(true), Fixed(false), Fixed(brs)])
}

/// The payload lengths above 8 bytes, from length code 9 on.
const FD_LENGTHS: [usize; 7] = [12, 16, 20, 24, 32, 48, 64];

fn fd_bits(extended: bool, brs: bool, len: usize, rates: BitRates) -> Bits {
    let (code, len) = match FD_LENGTHS.iter().position(|&l| l >= len) {
        _ if len <= 8 => (len, len),
        Some(i) => (9 + i, FD_LENGTHS[i]),
        None => (15, 64),
    };
    // The error state indicator is the sender's, hence free; then the length code.
    let data_phase = std::iter::once(Bit::Free)
        .chain((0..4).rev().map(move |i| Bit::Fixed(code >> i & 1 == 1)))
        .chain(std::iter::repeat_n(Bit::Free, 8 * len));
    let arbitration = fd_arbitration(extended, brs).count() as u32;
    // Bit times in units that make both whole numbers.
    let weight = if brs { (u64::from(rates.data), u64::from(rates.nominal)) } else { (1, 1) };
    let stuff = worst_stuffing(fd_arbitration(extended, brs).chain(data_phase), arbitration, weight);
    // Stuff count (4), CRC of 17 or 21 bits, a fixed stuff bit before and after every fourth.
    let crc = if len <= 16 { 21 } else { 25_u32 };
    let nominal = arbitration + stuff.nominal + CLASSIC_TAIL;
    let data = 5 + 8 * len as u32 + stuff.data + crc + crc.div_ceil(4);
    if brs { Bits { nominal, data } } else { Bits { nominal: nominal + data, data: 0 } }
}

/// The most that stuff bits can cost in a row of bits, of which the first `nominal` are in the slower phase. After five
/// equal bits comes a stuff bit of the other value, which counts as the first of the next run; none comes after the
/// last bit (there a fixed one follows). A state of the walk is the last bit and the length of its run.
fn worst_stuffing(bits: impl Iterator<Item = Bit>, nominal: u32, weight: (u64, u64)) -> Bits {
    let cost = |b: &Bits| u64::from(b.nominal) * weight.0 + u64::from(b.data) * weight.1;
    let better = |slot: &mut Option<Bits>, new: Bits| {
        if slot.as_ref().is_none_or(|old| cost(old) < cost(&new)) {
            *slot = Some(new);
        }
    };
    // Best stuffing by [last bit][run - 1]; a run of five is still without its stuff bit.
    let mut best: [[Option<Bits>; 5]; 2] = [[None; 5]; 2];
    for (i, bit) in bits.enumerate() {
        let mut next: [[Option<Bits>; 5]; 2] = [[None; 5]; 2];
        for value in [false, true] {
            if matches!(bit, Bit::Fixed(fixed) if fixed != value) {
                continue;
            }
            if i == 0 {
                next[usize::from(value)][0] = Some(Bits::default());
                continue;
            }
            for last in [false, true] {
                for run in 1..=5 {
                    let Some(mut stuff) = best[usize::from(last)][run - 1] else { continue };
                    let (last, run) = if run == 5 {
                        // The stuff bit comes before this bit, at the rate of the bit that completed the run.
                        if i as u32 <= nominal {
                            stuff.nominal += 1
                        } else {
                            stuff.data += 1
                        }
                        (!last, 1)
                    } else {
                        (last, run)
                    };
                    let run = if value == last { run + 1 } else { 1 };
                    better(&mut next[usize::from(value)][run - 1], stuff);
                }
            }
        }
        best = next;
    }
    best.into_iter().flatten().flatten().max_by_key(cost).unwrap_or_default()
}

#[cfg(test)]
mod tests;
