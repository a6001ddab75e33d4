//! What the master knows of each drive, and the sum of it.

use super::super::script::Runner;
use super::super::state::State;
use crate::canopen::{Emergency, NmtState};
use std::collections::VecDeque;

/// Where the drives are to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Goal {
    /// "Switch on disabled": no power.
    #[default]
    Disabled,
    /// "Operation enabled": torque.
    Enabled,
    /// Quick stop of what is enabled; the rest as disabled.
    QuickStop,
}

/// How far a drive's communication is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Not started, or waiting for its turn.
    Waiting,
    /// Asked whether it gives torque, and told to let go of it.
    Releasing,
    /// Reset; boot-up awaited.
    Booting,
    /// The SDO script runs.
    Configuring,
    /// Told to become operational.
    Starting,
    /// Operational; follows the goal.
    Ready,
    /// Unusable until the next start; the fault list says why.
    Failed,
}

/// What the master knows of a drive.
#[derive(Debug, Clone)]
pub struct DriveStatus {
    /// How far its communication is.
    pub phase: Phase,
    /// Last NMT state that it reported.
    pub nmt: Option<NmtState>,
    /// Last statusword of TPDO 1, `None` before the first.
    pub statusword: Option<u16>,
    /// Steps of the script done, and in all.
    pub steps: (usize, usize),
    /// SDO responses during configuration that were late, doubled or of something else, and ignored.
    pub sdo_ignored: u64,
    /// Rated torque (mN m), object 6076.
    pub rated_torque_mnm: Option<u32>,
    /// Error register of its last emergency object.
    pub error_register: u8,
    /// Its emergency objects with receive time (ns), newest last.
    pub emergencies: VecDeque<(u64, Emergency)>,
    /// Optional objects that it has not.
    pub absent: Vec<(u16, u8)>,
}

impl DriveStatus {
    /// State of the power state machine.
    pub fn state(&self) -> Option<State> {
        self.statusword.and_then(State::from_statusword)
    }
}

/// Sum over all drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Progress {
    /// Number of drives.
    pub drives: usize,
    /// Waiting, letting go, booting, configuring or starting.
    pub starting: usize,
    /// Operational.
    pub ready: usize,
    /// In "operation enabled".
    pub enabled: usize,
    /// In "fault" or its reaction.
    pub faulted: usize,
    /// Unusable.
    pub failed: usize,
    /// All drives are operational and where the goal wants them.
    pub at_goal: bool,
    /// Script steps done, over all drives.
    pub steps_done: usize,
    /// Script steps in all, as far as known.
    pub steps: usize,
}

pub(super) struct Slot {
    pub(super) status: DriveStatus,
    pub(super) runner: Option<Runner>,
    /// Since when the present phase, or the present wish for a transition, lasts (ns).
    pub(super) since_ns: u64,
    pub(super) heartbeat_ns: Option<u64>,
    pub(super) heartbeat_lost: bool,
    /// When the last statusword came (ns), and in which cycle.
    pub(super) feedback_ns: u64,
    pub(super) feedback_cycle: u64,
    /// State wanted next.
    pub(super) wanted: Option<State>,
    /// Transitions were given up until the goal is set anew.
    pub(super) stuck: bool,
    /// It reached "operation enabled" under the present goal.
    pub(super) was_enabled: bool,
    /// Boot-ups since the start.
    pub(super) boots: u32,
    /// Fault reset under way: cycle at which bit 7 was last changed.
    pub(super) resetting: Option<u64>,
}

impl Slot {
    pub(super) fn new() -> Self {
        Self {
            status: DriveStatus {
                phase: Phase::Waiting,
                nmt: None,
                statusword: None,
                steps: (0, 0),
                sdo_ignored: 0,
                rated_torque_mnm: None,
                error_register: 0,
                emergencies: VecDeque::new(),
                absent: Vec::new(),
            },
            runner: None,
            since_ns: 0,
            heartbeat_ns: None,
            heartbeat_lost: false,
            feedback_ns: 0,
            feedback_cycle: 0,
            wanted: None,
            stuck: false,
            was_enabled: false,
            boots: 0,
            resetting: None,
        }
    }
}
