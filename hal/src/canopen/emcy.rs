//! Emergency objects (CiA 301, 7.2.7): error code, error register, five bytes of the manufacturer's own.

use super::cob::{EMCY, NodeId, node_frame};
use crate::can::Frame;

/// Error codes that sinew's simulated drive sends and that its master puts into words.
pub mod code {
    /// Error reset, or no error.
    pub const RESET: u16 = 0x0000;
    /// Generic error.
    pub const GENERIC: u16 = 0x1000;
    /// Continuous over-current.
    pub const OVER_CURRENT: u16 = 0x2310;
    /// Excess drive temperature.
    pub const DRIVE_TEMPERATURE: u16 = 0x4310;
    /// Internal software.
    pub const SOFTWARE: u16 = 0x6100;
    /// Position sensor.
    pub const POSITION_SENSOR: u16 = 0x7320;
    /// Communication, generic: the node was taken out of operational with torque on.
    pub const GENERIC_COMMUNICATION: u16 = 0x8100;
    /// Life guard or heartbeat error.
    pub const HEARTBEAT: u16 = 0x8130;
    /// Recovered from bus-off.
    pub const BUS_OFF_RECOVERED: u16 = 0x8140;
    /// PDO not processed: its length is wrong.
    pub const PDO_LENGTH: u16 = 0x8210;
    /// RPDO time-out: an RPDO did not arrive within the event timer of its communication parameters (140x:05).
    pub const RPDO_TIMEOUT: u16 = 0x8250;
    /// SYNC did not arrive within the time that the drive expects it in (manufacturer's use of class 81).
    pub const SYNC_TIMEOUT: u16 = 0x81ff;
}

/// Bits of the error register (object 1001).
pub mod register {
    /// Any error at all.
    pub const GENERIC: u8 = 0x01;
    /// Current.
    pub const CURRENT: u8 = 0x02;
    /// Temperature.
    pub const TEMPERATURE: u8 = 0x08;
    /// Communication.
    pub const COMMUNICATION: u8 = 0x10;
    /// Device profile specific.
    pub const PROFILE: u8 = 0x20;
    /// Manufacturer specific.
    pub const MANUFACTURER: u8 = 0x80;
}

/// One emergency object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Emergency {
    /// Error code; 00xx reports that errors are gone.
    pub code: u16,
    /// Error register, object 1001.
    pub register: u8,
    /// Manufacturer's field.
    pub data: [u8; 5],
}

impl Emergency {
    /// From the payload of an emergency frame; `None` unless it has eight bytes.
    pub fn decode(data: &[u8]) -> Option<Self> {
        let &[c0, c1, register, d0, d1, d2, d3, d4] = data else { return None };
        Some(Self { code: u16::from_le_bytes([c0, c1]), register, data: [d0, d1, d2, d3, d4] })
    }

    /// The frame that `node` sends.
    pub fn encode(&self, node: NodeId) -> Frame {
        let [c0, c1] = self.code.to_le_bytes();
        let [d0, d1, d2, d3, d4] = self.data;
        node_frame(EMCY, node, &[c0, c1, self.register, d0, d1, d2, d3, d4], 8)
    }

    /// True if it reports the end of errors.
    pub fn is_reset(&self) -> bool {
        self.code & 0xff00 == 0
    }

    /// The code in words: the exact code where it is known, else its class.
    pub fn words(&self) -> &'static str {
        match self.code {
            code::OVER_CURRENT => "continuous over-current",
            code::DRIVE_TEMPERATURE => "excess drive temperature",
            code::POSITION_SENSOR => "position sensor",
            code::GENERIC_COMMUNICATION => "taken out of operational with torque on",
            code::HEARTBEAT => "heartbeat of the master lost",
            code::BUS_OFF_RECOVERED => "recovered from bus-off",
            code::PDO_LENGTH => "PDO not processed, wrong length",
            code::RPDO_TIMEOUT => "torques did not arrive in time",
            code::SYNC_TIMEOUT => "SYNC did not arrive in time",
            c => match c >> 8 {
                0x00 => "error reset or no error",
                0x10 => "generic error",
                0x20..=0x2f => "current",
                0x30..=0x3f => "voltage",
                0x40..=0x4f => "temperature",
                0x50 => "device hardware",
                0x60..=0x6f => "device software",
                0x70 => "additional modules",
                0x80..=0x82 => "monitoring or communication",
                0x90 => "external error",
                0xf0 => "additional functions",
                0xff => "device specific",
                _ => "unknown class of error",
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn round_trip(code: u16, register: u8, data: [u8; 5]) {
            let e = Emergency { code, register, data };
            let f = e.encode(NodeId::new(3).unwrap());
            prop_assert_eq!(Emergency::decode(f.data()), Some(e));
            prop_assert!(!e.words().is_empty());
        }

        #[test]
        fn only_eight_bytes_are_an_emergency(data in proptest::collection::vec(any::<u8>(), 0..65)) {
            prop_assert_eq!(Emergency::decode(&data).is_some(), data.len() == 8);
        }
    }
}
