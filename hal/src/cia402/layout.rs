//! How the cyclic traffic of a bus lies in its frames: an RPDO for each drive, or one RPDO for all of them.
//!
//! Enters: which drives share a bus, and in which order. Leaves: identifiers, mappings and payloads of the PDOs, and the
//! load that they are. It must never let a drive's place depend on anything but its rank among the drives of its bus.
//!
//! | layout | SYNC (0x080) | RPDO 1 | TPDO 1 (0x180 + node) |
//! |---|---|---|---|
//! | [`Layout::Classic`] | classic, 0 bytes | classic, 4 bytes, 0x200 + node: one for each drive | classic, 8 bytes |
//! | [`Layout::Packed`] | classic, 0 bytes | FD with bit-rate switch, 0x200: one for all drives | FD with bit-rate switch, 8 bytes |
//!
//! **The packed RPDO.** The drive of rank k on its bus (its place among them in the list of cables, from 0) has bytes
//! 4k to 4k + 3, little-endian, the same four as in its classic RPDO 1:
//!
//! | byte | content |
//! |---|---|
//! | 4k, 4k + 1 | controlword (6040), UNSIGNED16 |
//! | 4k + 2, 4k + 3 | target torque (6071), INTEGER16, per mille of rated torque |
//!
//! What a CAN FD frame is longer than 4 bytes for each drive (its lengths are 0 to 8, 12, 16, 20, 24, 32, 48, 64) is
//! zero. So 16 drives fit a bus ([`PACKED_DRIVES_MAX`]), and six of them take a frame of 24 bytes. TPDO 1 has the same
//! bytes in both layouts: statusword (6041), position (6064), torque (6077).
//!
//! **What of it is standard.** PDOs of up to 64 bytes with bit-rate switch, communication and mapping parameters as they
//! were, at most 64 entries in a mapping: CiA 1301 (CANopen FD; CiA, *CANopen FD under development*, 2015). That several
//! nodes consume one PDO: the producer-consumer model of CiA 301, 7.2.2. That a node maps what is not its own by data type
//! indices as a dummy: CiA 301, 7.5.2.36; each foreign slot and each group of four padding bytes is one UNSIGNED32
//! (entry 0x00070020), so that every node's mapping is exactly as long as the frame and none has to report an RPDO that
//! is too long (emergency code 0x8220).
//!
//! **What of it is sinew's choice.** The identifier 0x200, which is that of RPDO 1 of "node 0" and free in the predefined
//! connection set. That PDOs alone are CAN FD frames, while NMT, SYNC, SDO, heartbeat and emergency objects stay classic
//! frames as in CiA 301: CiA 1301 has FD frames only, and USDO in the place of SDO, which no drive bought today needs for
//! a faster cycle. And object 2002, by which a drive is told to send its PDOs as FD frames ([`PDO_FORMAT`]).
//!
//! A lost packed frame costs all drives of the bus that cycle's torques, where a lost classic one costs one drive's; in
//! both cases SYNC makes them go on with those of the cycle before.
//!
//! [`PDO_FORMAT`]: super::objects::PDO_FORMAT

use super::objects::{RPDO1, TPDO1};
use crate::can::{DATA_LEN_MAX, Frame, FrameError, Id, Kind};
use crate::canopen::cob::RPDO;
use crate::canopen::{Mapped, NodeId};
use crate::load::{BitRates, Load, Rate, Shape};

/// Identifier of the RPDO that all drives of a packed bus consume.
pub const PACKED_RPDO: u16 = RPDO;
/// Bytes of one drive in it.
pub const SLOT_BYTES: usize = 4;
/// Most drives of a packed bus.
pub const PACKED_DRIVES_MAX: usize = DATA_LEN_MAX / SLOT_BYTES;
/// The place of what belongs to another drive: a dummy of type UNSIGNED32.
pub const FOREIGN_SLOT: Mapped = Mapped::new(0x0007, 0, 32);

/// Layout of a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Layout {
    /// Classic frames, one RPDO for each drive.
    #[default]
    Classic,
    /// CAN FD frames with bit-rate switch, one RPDO for all drives.
    Packed,
}

impl Layout {
    /// Most drives of one bus.
    pub const fn drives_max(self) -> usize {
        match self {
            Self::Classic => super::config::DRIVES_MAX,
            Self::Packed => PACKED_DRIVES_MAX,
        }
    }

    /// Identifier and mapping of RPDO 1 of the drive with this rank among the `count` drives of its bus. Allocates.
    pub fn rpdo(self, node: NodeId, rank: usize, count: usize) -> (u16, Vec<Mapped>) {
        match self {
            Self::Classic => (node.cob(RPDO), RPDO1.to_vec()),
            Self::Packed => {
                let slots = packed_len(count) / SLOT_BYTES;
                let own = |slot| if slot == rank { RPDO1.to_vec() } else { vec![FOREIGN_SLOT] };
                (PACKED_RPDO, (0..slots).flat_map(own).collect())
            }
        }
    }

    /// Frames that the master gives to a bus of so many drives at once in every cycle: the RPDOs and SYNC.
    pub const fn burst(self, drives: usize) -> usize {
        match self {
            Self::Classic => drives + 1,
            Self::Packed if drives == 0 => 1,
            Self::Packed => 2,
        }
    }

    /// Load of a bus at these rates with this many drives: in each cycle one SYNC, the RPDOs and one TPDO of each drive;
    /// beside that the heartbeats of the drives and of the master, each of this period (s).
    pub fn load(self, rates: BitRates, drives: usize, heartbeat_s: f64) -> Load {
        let bytes = |entries: &[Mapped]| entries.iter().map(|m| m.bytes()).sum();
        let (rpdo, tpdo) = match self {
            Self::Classic => (Shape::classic(bytes(&RPDO1)), Shape::classic(bytes(&TPDO1))),
            Self::Packed => (Shape::fd(packed_len(drives)), Shape::fd(bytes(&TPDO1))),
        };
        Load::new(rates)
            .with(Shape::classic(0), Rate::PerCycle(1.0))
            .with(rpdo, Rate::PerCycle((self.burst(drives) - 1) as f64))
            .with(tpdo, Rate::PerCycle(drives as f64))
            .with(Shape::classic(1), Rate::PerSecond((drives + 1) as f64 / heartbeat_s))
    }
}

/// Length of the packed RPDO of so many drives (bytes), padding included; 64 for more than fit.
pub fn packed_len(drives: usize) -> usize {
    let used = (SLOT_BYTES * drives).min(DATA_LEN_MAX);
    packed_frame(&[0; DATA_LEN_MAX][..used]).map_or(DATA_LEN_MAX, |f| f.len())
}

/// The packed RPDO with these slots. Does not allocate.
///
/// # Errors
/// More than 64 bytes.
pub fn packed_frame(slots: &[u8]) -> Result<Frame, FrameError> {
    Frame::new(Id::Standard(PACKED_RPDO), Kind::Fd { bit_rate_switch: true }, slots)
}

#[cfg(test)]
mod tests {
    use super::super::objects::{CONTROLWORD, TARGET_TORQUE};
    use super::*;

    fn node(n: u8) -> NodeId {
        NodeId::new(n).unwrap()
    }

    #[test]
    fn every_mapping_is_as_long_as_the_frame_and_the_own_slots_tile_it() {
        for count in 1..=PACKED_DRIVES_MAX {
            let mut owners = [0; DATA_LEN_MAX];
            for rank in 0..count {
                let (cob, mapping) = Layout::Packed.rpdo(node(1 + rank as u8), rank, count);
                assert_eq!(cob, 0x200);
                let mut at = 0;
                for m in &mapping {
                    if m.index >= 0x1000 {
                        owners[at..at + m.bytes()].iter_mut().for_each(|n| *n += 1);
                        let offset = if m.index == CONTROLWORD { 0 } else { 2 };
                        assert!(matches!(m.index, CONTROLWORD | TARGET_TORQUE));
                        assert_eq!(at, 4 * rank + offset);
                    }
                    at += m.bytes();
                }
                assert_eq!(at, packed_len(count), "{count} drives, rank {rank}");
                assert!(mapping.len() <= 17);
            }
            assert!(owners[..4 * count].iter().all(|n| *n == 1) && owners[4 * count..].iter().all(|n| *n == 0));
        }
    }

    #[test]
    fn padding_reaches_the_next_length_that_the_wire_has() {
        let lengths: Vec<usize> = (1..=16).map(packed_len).collect();
        assert_eq!(lengths, [4, 8, 12, 16, 20, 24, 32, 32, 48, 48, 48, 48, 64, 64, 64, 64]);
    }

    const FD: BitRates = BitRates { nominal: 1_000_000, data: 5_000_000 };

    #[test]
    fn six_packed_drives_carry_a_kilohertz_and_classic_ones_do_not() {
        let packed = Layout::Packed.load(FD, 6, 0.05);
        // SYNC 55 us; one FD frame of 24 bytes and six of 8 bytes, each some 33 us of arbitration and the rest at 5 Mbit/s.
        assert!((0.40e-3..0.52e-3).contains(&packed.cycle_s()), "{packed:?}");
        assert!(packed.share(1000.0) < 0.7, "{packed:?}");
        assert!(packed.ceiling_hz(1.0) > 1600.0, "{packed:?}");
        let classic = BitRates::classic(1_000_000);
        assert!(Layout::Classic.load(classic, 6, 0.05).share(1000.0) > 1.0);
        assert!(Layout::Classic.load(classic, 24, 0.05).share(1000.0) > 5.0);
    }

    #[test]
    fn the_load_is_the_sum_of_its_frames_counted_by_hand() {
        // By the definitions of `Shape`: what the layout adds is which frames there are.
        let us = |shape: Shape| shape.bits(FD).time_s(FD);
        let by_hand = us(Shape::classic(0)) + us(Shape::fd(24)) + 6.0 * us(Shape::fd(8));
        let load = Layout::Packed.load(FD, 6, 0.05);
        assert!((load.cycle_s() - by_hand).abs() < 1e-12);
        let beats = 7.0 / 0.05 * us(Shape::classic(1));
        assert!((load.share(1000.0) - 1000.0 * by_hand - beats).abs() < 1e-12);
        // No drives, no frame for them.
        assert!((Layout::Packed.load(FD, 0, 0.05).cycle_s() - us(Shape::classic(0))).abs() < 1e-12);
    }
}
