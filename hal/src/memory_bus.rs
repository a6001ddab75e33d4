//! A bus in memory, for tests and fuzz targets of what speaks over one: no process, no clock, no loss.
//!
//! Enters and leaves: frames. A frame goes into the queues of all handles but the sender's, at once and in order, with the
//! time stamp 0. Queues grow without a bound, so this is nothing for a machine.

use crate::can::{BusCounters, BusState, CanBus, Filter, Frame, Id, ReceiveError, Received, SendError};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Whether the bus does not take a data frame with this identifier.
pub type Refusal = fn(u16) -> bool;

#[derive(Default)]
struct Shared {
    queues: Vec<VecDeque<Received>>,
    refused: Option<Refusal>,
}

/// A handle of a bus in memory.
pub struct MemoryBus {
    shared: Arc<Mutex<Shared>>,
    me: usize,
}

impl Default for MemoryBus {
    fn default() -> Self {
        let shared = Shared { queues: vec![VecDeque::new()], refused: None };
        Self { shared: Arc::new(Mutex::new(shared)), me: 0 }
    }
}

impl MemoryBus {
    /// Another handle; it hears what is sent from now on.
    #[must_use]
    pub fn handle(&self) -> Self {
        let mut shared = self.lock();
        shared.queues.push(VecDeque::new());
        Self { shared: self.shared.clone(), me: shared.queues.len() - 1 }
    }

    /// Frames that wait for this handle.
    pub fn waiting(&self) -> usize {
        self.lock().queues[self.me].len()
    }

    /// From now on the bus is too full for these frames, whoever sends them.
    pub fn refuse(&self, which: Option<Refusal>) {
        self.lock().refused = which;
    }

    /// Queues of plain data are as good after a panic elsewhere as before.
    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CanBus for MemoryBus {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let mut shared = self.lock();
        if let (Id::Standard(id), Some(refused)) = (frame.id(), shared.refused)
            && refused(id)
        {
            return Err(SendError::Full);
        }
        for (handle, queue) in shared.queues.iter_mut().enumerate() {
            if handle != self.me {
                queue.push_back(Received { frame: *frame, time_ns: 0 });
            }
        }
        Ok(())
    }

    /// Never waits: nobody could send meanwhile in the single thread that this is for.
    fn receive(&mut self, _: Duration) -> Result<Option<Received>, ReceiveError> {
        Ok(self.lock().queues[self.me].pop_front())
    }

    fn state(&self) -> BusState {
        BusState::ErrorActive
    }

    /// Counts nothing.
    fn counters(&self) -> BusCounters {
        BusCounters::default()
    }

    /// Filters nothing.
    fn set_filters(&mut self, _: &[Filter]) -> Result<(), ReceiveError> {
        Ok(())
    }

    fn duplicate(&self) -> std::io::Result<Box<dyn CanBus>> {
        Ok(Box::new(self.handle()))
    }
}
