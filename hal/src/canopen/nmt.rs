//! Network management: commands, states, and the heartbeat that reports them (CiA 301, 7.2.8 and 7.3.2).

use super::cob::{HEARTBEAT, NMT, NodeId, node_frame};
use crate::can::{Frame, Id};

/// A command to one node or to all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum NmtCommand {
    /// Enter operational: PDOs flow.
    Start,
    /// Enter stopped: nothing but NMT and heartbeat.
    Stop,
    /// Enter pre-operational: SDO, no PDO.
    EnterPreOperational,
    /// Restart the application; all objects take their start-up values.
    ResetNode,
    /// Restart the communication; objects 1000 to 1FFF take their start-up values.
    ResetCommunication,
}

impl NmtCommand {
    /// Command specifier on the wire.
    pub const fn code(self) -> u8 {
        match self {
            Self::Start => 1,
            Self::Stop => 2,
            Self::EnterPreOperational => 128,
            Self::ResetNode => 129,
            Self::ResetCommunication => 130,
        }
    }

    /// The frame; `None` addresses every node.
    pub fn encode(self, node: Option<NodeId>) -> Frame {
        let data = [self.code(), node.map_or(0, NodeId::get)];
        Frame::classic(Id::Standard(NMT), &data).unwrap_or_else(|_| unreachable!("two bytes on identifier 0"))
    }

    /// The command and its addressee (`None`: all nodes) from the payload of an NMT frame; `None` for another length,
    /// an unknown specifier, or an impossible node.
    pub fn decode(data: &[u8]) -> Option<(Self, Option<NodeId>)> {
        let &[code, node] = data else { return None };
        let command = match code {
            1 => Self::Start,
            2 => Self::Stop,
            128 => Self::EnterPreOperational,
            129 => Self::ResetNode,
            130 => Self::ResetCommunication,
            _ => return None,
        };
        let node = if node == 0 { None } else { Some(NodeId::new(node).ok()?) };
        Some((command, node))
    }
}

/// State of a node as its heartbeat tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum NmtState {
    /// Boot-up: sent once, on entering pre-operational after a start or reset.
    BootUp,
    /// Stopped.
    Stopped,
    /// Operational.
    Operational,
    /// Pre-operational.
    PreOperational,
}

impl NmtState {
    /// Value in the heartbeat.
    pub const fn code(self) -> u8 {
        match self {
            Self::BootUp => 0,
            Self::Stopped => 4,
            Self::Operational => 5,
            Self::PreOperational => 127,
        }
    }

    /// From the payload of a heartbeat. Its bit 7 is reserved and 0 (CiA 301, 7.2.8.3.2.2): with it set it is an answer of the
    /// obsolete node guarding, which nobody asked for, or spoilt.
    pub fn decode(data: &[u8]) -> Option<Self> {
        let &[code] = data else { return None };
        Some(match code {
            0 => Self::BootUp,
            4 => Self::Stopped,
            5 => Self::Operational,
            127 => Self::PreOperational,
            _ => return None,
        })
    }

    /// The heartbeat of `node` in this state.
    pub fn heartbeat(self, node: NodeId) -> Frame {
        node_frame(HEARTBEAT, node, &[self.code(), 0, 0, 0, 0, 0, 0, 0], 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn commands_round_trip() {
        use NmtCommand::*;
        for c in [Start, Stop, EnterPreOperational, ResetNode, ResetCommunication] {
            for node in [None, NodeId::new(1).ok(), NodeId::new(127).ok()] {
                assert_eq!(NmtCommand::decode(c.encode(node).data()), Some((c, node)));
            }
        }
        assert_eq!(NmtCommand::decode(&[1, 128]), None);
        assert_eq!(NmtCommand::decode(&[3, 1]), None);
        assert_eq!(NmtCommand::decode(&[1]), None);
    }

    #[test]
    fn heartbeats_round_trip() {
        use NmtState::*;
        let n = NodeId::new(9).unwrap();
        for s in [BootUp, Stopped, Operational, PreOperational] {
            let f = s.heartbeat(n);
            assert_eq!(f.id(), Id::Standard(0x709));
            assert_eq!(NmtState::decode(f.data()), Some(s));
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_do_not_panic(data in proptest::collection::vec(any::<u8>(), 0..9)) {
            let _ = NmtCommand::decode(&data);
            let _ = NmtState::decode(&data);
        }
    }
}
