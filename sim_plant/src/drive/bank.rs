//! Many simulated drives on one bus handle.

use super::machine::Drive;
use sinew_hal::can::{CanBus, Frame, ReceiveError, SendError};
use sinew_hal::canopen::Message;
use std::collections::VecDeque;
use std::time::Duration;

/// Frames that wait for a full transmit queue: more than any burst of 128 drives; older ones are dropped first, as a
/// controller that overwrites its mailboxes would.
const OUTBOX_MAX: usize = 4096;

/// Why [`DriveBank::pump`] returned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pumped {
    /// A SYNC was served: targets are latched, feedback of the last [`Drive::set_feedback`] is on its way. A plant in
    /// lockstep now advances by one period.
    Sync {
        /// Receive time of the SYNC (ns).
        time_ns: u64,
    },
    /// No frame came within the time allowed.
    Idle,
    /// The bus did not take or give frames; the drives' timers went on all the same.
    Bus(ReceiveError),
}

/// Drives that share one bus handle.
pub struct DriveBank {
    drives: Vec<Drive>,
    outbox: VecDeque<Frame>,
    dropped: u64,
}

impl DriveBank {
    /// The drives, in the order in which they will be addressed; at power-up each announces itself.
    pub fn new(drives: Vec<Drive>) -> Self {
        Self { drives, outbox: VecDeque::with_capacity(256), dropped: 0 }
    }

    /// The drives.
    pub fn drives(&self) -> &[Drive] {
        &self.drives
    }

    /// The drives, to give feedback or to injure them.
    pub fn drives_mut(&mut self) -> &mut [Drive] {
        &mut self.drives
    }

    /// Frames dropped because the bus refused them for too long.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Serves one frame without a bus; true if it was a SYNC. Frames to send gather in [`Self::pop`].
    pub fn on_frame(&mut self, frame: &Frame, now_ns: u64) -> bool {
        for d in &mut self.drives {
            d.on_frame(frame, now_ns);
        }
        self.collect();
        Message::of(frame) == Some(Message::Sync)
    }

    /// Runs every drive's timers.
    pub fn poll(&mut self, now_ns: u64) {
        for d in &mut self.drives {
            d.poll(now_ns);
        }
        self.collect();
    }

    fn collect(&mut self) {
        for d in &mut self.drives {
            while let Some(f) = d.pop() {
                if self.outbox.len() == OUTBOX_MAX {
                    self.outbox.pop_front();
                    self.dropped += 1;
                }
                self.outbox.push_back(f);
            }
        }
    }

    /// Next frame to send.
    pub fn pop(&mut self) -> Option<Frame> {
        self.outbox.pop_front()
    }

    /// Sends what waits; stops at a full queue.
    fn flush(&mut self, bus: &mut dyn CanBus) {
        while let Some(f) = self.outbox.front() {
            match bus.send(f) {
                Ok(()) => {}
                Err(SendError::Full) => return,
                // The bus is off or down: a real controller loses such frames too.
                Err(_) => self.dropped += 1,
            }
            self.outbox.pop_front();
        }
    }

    /// Serves frames until a SYNC was served or none came for `wait`. `now_ns` is asked before each step, so that the
    /// clock may be real or the plant's own.
    pub fn pump(&mut self, bus: &mut dyn CanBus, wait: Duration, now_ns: &mut dyn FnMut() -> u64) -> Pumped {
        loop {
            self.poll(now_ns());
            self.flush(bus);
            match bus.receive(wait) {
                Ok(Some(received)) => {
                    let now = now_ns();
                    let is_sync = self.on_frame(&received.frame, now);
                    self.flush(bus);
                    if is_sync {
                        return Pumped::Sync { time_ns: received.time_ns };
                    }
                }
                Ok(None) => {
                    self.poll(now_ns());
                    self.flush(bus);
                    return Pumped::Idle;
                }
                Err(e) => return Pumped::Bus(e),
            }
        }
    }
}
