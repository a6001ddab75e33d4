//! What the handles of one bus share: the controller's state as its error frames told it, and who does what when a socket is
//! lost.

use super::berth::Berths;
use crate::can::BusState;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// State of the controller, common to all handles of one `open`.
#[derive(Default)]
pub(super) struct Controller {
    /// A `BusState` without `Down`, which belongs to the link: 0 active .. 3 bus-off.
    state: AtomicU32,
    /// Transmit and receive error counter as last reported.
    pub(super) errors: AtomicU32,
    /// How often it went bus-off: each handle empties its queue when this has changed, whoever was told of it.
    pub(super) bus_offs: AtomicU32,
    /// Handles that have received, and so may wait for the kernel's network lock.
    pub(super) receivers: AtomicU32,
    /// A handle that only sends has left something in its berth.
    pub(super) asked: AtomicBool,
    pub(super) berths: Berths,
}

impl Controller {
    pub(super) fn state(&self) -> BusState {
        match self.state.load(Ordering::Acquire) {
            0 => BusState::ErrorActive,
            1 => BusState::ErrorWarning,
            2 => BusState::ErrorPassive,
            _ => BusState::BusOff,
        }
    }

    pub(super) fn set_state(&self, state: BusState) {
        let word = match state {
            BusState::ErrorActive | BusState::Down => 0,
            BusState::ErrorWarning => 1,
            BusState::ErrorPassive => 2,
            BusState::BusOff => 3,
        };
        self.state.store(word, Ordering::Release);
    }
}
