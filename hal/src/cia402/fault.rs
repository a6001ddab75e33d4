//! Everything that can go wrong with a drive, as data; words are made by `Display`, outside of any loop.

use super::state::State;
use crate::canopen::sdo_client::SdoError;
use crate::canopen::{Emergency, NmtState, NodeId};
use thiserror::Error;

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum Fault {
    /// No boot-up after the reset.
    #[error("no boot-up within {timeout_ms} ms after the reset: is it powered, wired, and of this node id?")]
    NoBootUp {
        /// Time waited (ms).
        timeout_ms: u32,
    },
    /// An object does not hold what it must.
    #[error("object {index:04X}:{sub:02X} is {found:#x}, expected {expected:#x}{}", mask_words(*.mask))]
    Value {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value expected.
        expected: u32,
        /// Value found.
        found: u32,
        /// Bits compared.
        mask: u32,
    },
    /// An object no longer holds what was written at the start.
    #[error("object {index:04X}:{sub:02X} was {expected:#x} and is {found:#x}: another node has written to the drive")]
    Changed {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value written.
        expected: u32,
        /// Value found.
        found: u32,
    },
    /// A value of another length than the object should have.
    #[error("object {index:04X}:{sub:02X} has {found} bytes, expected {expected}")]
    Length {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Bytes expected.
        expected: usize,
        /// Bytes found.
        found: usize,
    },
    /// A transfer failed.
    #[error("{} object {index:04X}:{sub:02X}: {error}", if *.write { "writing" } else { "reading" })]
    Sdo {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// True for a download.
        write: bool,
        /// Why.
        error: SdoError,
    },
    /// Another NMT state than commanded.
    #[error("NMT state is {found:?}, expected {expected:?}")]
    Nmt {
        /// State commanded.
        expected: NmtState,
        /// State in the heartbeat, `None` if none came.
        found: Option<NmtState>,
    },
    /// The drive started anew by itself.
    #[error("the drive restarted by itself; it has lost its configuration")]
    Rebooted,
    /// No heartbeat.
    #[error("no heartbeat for {timeout_ms} ms")]
    HeartbeatLost {
        /// Time waited (ms).
        timeout_ms: u16,
    },
    /// The drive reported an error.
    #[error("emergency {:04X} ({}), error register {:02X}", .0.code, .0.words(), .0.register)]
    Emergency(Emergency),
    /// A transition of the power state machine did not happen.
    #[error("still \"{found}\" after {timeout_ms} ms, wanted \"{wanted}\" (statusword {statusword:04X})")]
    Transition {
        /// State wanted next.
        wanted: State,
        /// State found.
        found: State,
        /// Last statusword.
        statusword: u16,
        /// Time waited (ms).
        timeout_ms: u32,
    },
    /// No statusword at all.
    #[error("no statusword within {timeout_ms} ms: TPDO 1 does not arrive")]
    NoFeedback {
        /// Time waited (ms).
        timeout_ms: u32,
    },
    /// The drive left "operation enabled" uncommanded.
    #[error("left \"operation enabled\" for \"{found}\" (statusword {statusword:04X})")]
    LeftOperation {
        /// State found.
        found: State,
        /// Last statusword.
        statusword: u16,
    },
}

fn mask_words(mask: u32) -> String {
    if mask == u32::MAX { String::new() } else { format!(" in the bits {mask:#x}") }
}

/// A fault with its place and time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the drive at bus {bus}, node {node}: {fault}")]
pub struct DriveFault {
    /// Index of the drive, which is its cable's.
    pub drive: usize,
    /// Bus index.
    pub bus: usize,
    /// Node id.
    pub node: NodeId,
    /// Time of detection (ns).
    pub time_ns: u64,
    /// What happened.
    pub fault: Fault,
}
