//! Node identifiers and the predefined connection set of CiA 301: which identifier carries what.

use crate::can::{Frame, FrameError, Id, Kind};
use thiserror::Error;

/// Identifier of a node, 1 to 127.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId(u8);

/// A number that names no node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("node id {0} is not within 1..=127")]
pub struct NodeIdError(pub u8);

impl NodeId {
    /// Checks the range.
    ///
    /// # Errors
    /// [`NodeIdError`] outside of 1..=127.
    pub const fn new(id: u8) -> Result<Self, NodeIdError> {
        if id >= 1 && id <= 127 { Ok(Self(id)) } else { Err(NodeIdError(id)) }
    }

    /// The number.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The identifier of this node's object with the given function code base (for example [`HEARTBEAT`]).
    pub const fn cob(self, base: u16) -> u16 {
        base + self.0 as u16
    }
}

impl std::fmt::Display for NodeId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// NMT commands.
pub const NMT: u16 = 0x000;
/// SYNC.
pub const SYNC: u16 = 0x080;
/// Emergency objects, plus node id.
pub const EMCY: u16 = 0x080;
/// TIME: milliseconds since midnight (28 bits) and days. A simulated plant in lockstep sends it at the end of each of its
/// periods, after all answers: then nothing more is to be waited for.
pub const TIME: u16 = 0x100;
/// First transmit PDO, plus node id; the n-th is `TPDO + 0x100 (n - 1)`.
pub const TPDO: u16 = 0x180;
/// First receive PDO, plus node id; the n-th is `RPDO + 0x100 (n - 1)`.
pub const RPDO: u16 = 0x200;
/// SDO, server to client, plus node id.
pub const SDO_RESPONSE: u16 = 0x580;
/// SDO, client to server, plus node id.
pub const SDO_REQUEST: u16 = 0x600;
/// Heartbeat and boot-up, plus node id.
pub const HEARTBEAT: u16 = 0x700;

/// What a frame is by the predefined connection set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Message {
    /// An NMT command.
    Nmt,
    /// The SYNC object.
    Sync,
    /// The TIME object.
    Time,
    /// An emergency object of a node.
    Emergency(NodeId),
    /// A transmit PDO of a node, numbered from 1.
    Tpdo(u8, NodeId),
    /// A receive PDO of a node, numbered from 1.
    Rpdo(u8, NodeId),
    /// An SDO response of a node.
    SdoResponse(NodeId),
    /// An SDO request to a node.
    SdoRequest(NodeId),
    /// Heartbeat or boot-up of a node.
    Heartbeat(NodeId),
}

impl Message {
    /// Classifies a standard data frame; `None` for extended identifiers, remote requests, and identifiers outside of
    /// the set.
    pub fn of(frame: &Frame) -> Option<Self> {
        let Id::Standard(id) = frame.id() else { return None };
        if frame.kind() == Kind::Remote {
            return None;
        }
        if id == NMT {
            return Some(Self::Nmt);
        }
        if id == SYNC {
            return Some(Self::Sync);
        }
        if id == TIME {
            return Some(Self::Time);
        }
        let node = NodeId::new((id & 0x7f) as u8).ok()?;
        Some(match id & 0x780 {
            EMCY => Self::Emergency(node),
            base @ (0x180 | 0x280 | 0x380 | 0x480) => Self::Tpdo((base >> 8) as u8, node),
            base @ (0x200 | 0x300 | 0x400 | 0x500) => Self::Rpdo((base >> 8) as u8 - 1, node),
            SDO_RESPONSE => Self::SdoResponse(node),
            SDO_REQUEST => Self::SdoRequest(node),
            HEARTBEAT => Self::Heartbeat(node),
            _ => return None,
        })
    }
}

/// The TIME object of a clock that began at midnight of day 0 (1984-01-01), at `time_ns`; it wraps after 65,536 days.
pub fn time_frame(time_ns: u64) -> Frame {
    const DAY_MS: u64 = 86_400_000;
    let ms = time_ns / 1_000_000;
    let [m0, m1, m2, m3, ..] = (ms % DAY_MS).to_le_bytes();
    let [d0, d1, ..] = (ms / DAY_MS).to_le_bytes();
    frame(TIME, &[m0, m1, m2, m3, d0, d1]).unwrap_or_else(|_| unreachable_frame())
}

/// A classic frame with a standard identifier.
///
/// # Errors
/// Identifier above 0x7ff or more than 8 bytes.
pub fn frame(cob: u16, data: &[u8]) -> Result<Frame, FrameError> {
    Frame::classic(Id::Standard(cob), data)
}

/// A frame of eight bytes on one of a node's own identifiers: it always exists, `base` being one of this module's.
pub(crate) fn node_frame(base: u16, node: NodeId, data: &[u8; 8], len: usize) -> Frame {
    let id = Id::Standard(node.cob(base) & 0x7ff);
    // Cannot fail: the identifier is masked to 11 bits and the length is at most eight.
    Frame::classic(id, &data[..len.min(8)]).unwrap_or_else(|_| unreachable_frame())
}

#[cold]
fn unreachable_frame() -> Frame {
    unreachable!("a masked identifier and at most eight bytes are always a frame")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_predefined_connection_set_is_recognised() {
        let n = NodeId::new(5).unwrap();
        let of = |id: u16| Message::of(&frame(id, &[]).unwrap());
        assert_eq!(of(0), Some(Message::Nmt));
        assert_eq!(of(0x80), Some(Message::Sync));
        assert_eq!(of(0x100), Some(Message::Time));
        assert_eq!(of(0x101), None);
        assert_eq!(of(0x85), Some(Message::Emergency(n)));
        assert_eq!(of(0x185), Some(Message::Tpdo(1, n)));
        assert_eq!(of(0x485), Some(Message::Tpdo(4, n)));
        assert_eq!(of(0x205), Some(Message::Rpdo(1, n)));
        assert_eq!(of(0x505), Some(Message::Rpdo(4, n)));
        assert_eq!(of(0x585), Some(Message::SdoResponse(n)));
        assert_eq!(of(0x605), Some(Message::SdoRequest(n)));
        assert_eq!(of(0x705), Some(Message::Heartbeat(n)));
        assert_eq!(of(0x180), None);
        assert_eq!(of(0x685), None);
    }

    #[test]
    fn time_is_six_bytes_of_milliseconds_and_days() {
        let f = time_frame((86_400_000 * 3 + 0x0102_0304) * 1_000_000 + 999_999);
        assert_eq!((f.id(), f.data()), (Id::Standard(0x100), &[4, 3, 2, 1, 3, 0][..]));
    }

    #[test]
    fn node_ids_are_bounded() {
        assert!(NodeId::new(0).is_err());
        assert!(NodeId::new(128).is_err());
        assert_eq!(NodeId::new(127).unwrap().cob(HEARTBEAT), 0x77f);
    }
}
