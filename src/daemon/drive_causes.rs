//! Why a drive cannot be used: the numbers under which the supervisor and the records know it. Their words are
//! [`crate::control::cause_text`]'s.
//!
//! Enters: what the master finds. Leaves: a cause for each. It must never give two things one number: those that the
//! master names are small, emergency codes of CiA 301 are 0x1000 and above.

use sinew_hal::cia402::Fault;

pub(super) const NO_EMERGENCY: u32 = 0;
pub(super) const NOT_USABLE: u32 = 1;
const NO_BOOT_UP: u32 = 2;
const WRONG_NMT_STATE: u32 = 3;
const RESTARTED: u32 = 4;
pub(super) const HEARTBEAT_LOST: u32 = 5;
const NO_TRANSITION: u32 = 6;
pub(super) const NO_FEEDBACK: u32 = 7;
const LEFT_OPERATION: u32 = 8;
pub(super) const NODE_ID_TAKEN: u32 = 9;
pub(super) const CHANGED: u32 = crate::control::Fault::CHANGED;

pub(super) fn cause_of(fault: &Fault) -> u32 {
    match fault {
        Fault::Value { .. } | Fault::Length { .. } | Fault::Sdo { .. } => NOT_USABLE,
        Fault::NoBootUp { .. } => NO_BOOT_UP,
        Fault::Nmt { .. } => WRONG_NMT_STATE,
        Fault::Rebooted => RESTARTED,
        Fault::HeartbeatLost { .. } => HEARTBEAT_LOST,
        Fault::Transition { .. } => NO_TRANSITION,
        Fault::NoFeedback { .. } => NO_FEEDBACK,
        Fault::LeftOperation { .. } => LEFT_OPERATION,
        Fault::Changed { .. } => CHANGED,
        Fault::Emergency(e) => u32::from(e.code),
    }
}

/// What is remembered of a drive beside what the master knows.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Memory {
    /// Heartbeat lost and not back.
    pub(super) lost: bool,
    /// It answers no SYNC, although it was operational; what is ordered would not reach it either.
    pub(super) mute: bool,
    /// It was up once, so that silence means something.
    pub(super) seen: bool,
    /// Last emergency code.
    pub(super) emergency: Option<u32>,
    /// A cause that stays until a reset, although the drive's state no longer shows it.
    pub(super) sticky: Option<u32>,
}
