//! A new socket for a handle that only sends, made by one that receives.
//!
//! Opening, binding and closing a CAN socket takes the kernel's network lock (RTNL), behind which a thread may wait for
//! whoever configures an interface just then. A control thread that sends must not; so it leaves the old socket to a
//! handle of the same bus that receives and may wait, and takes the new one from it. Each side only tries the lock
//! between them: who does not get it comes back with its next call.
//!
//! Enters: wishes, sockets. Leaves: sockets. It must never make the sender wait or close a socket in its stead.

use socketcan::CanSocket;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError, Weak};

/// What a handle and those who help it share.
#[derive(Default)]
pub(super) struct Berth(Mutex<Content>);

#[derive(Default)]
struct Content {
    /// The handle's filters, as the kernel has them.
    filters: Vec<[u32; 2]>,
    wanted: bool,
    fresh: Option<CanSocket>,
    spent: Option<CanSocket>,
}

impl Berth {
    /// With room for so many filters.
    pub(super) fn new(filters: &[[u32; 2]], capacity: usize) -> Self {
        let mut room = Vec::with_capacity(capacity);
        room.extend_from_slice(filters);
        Self(Mutex::new(Content { filters: room, ..Content::default() }))
    }

    /// Waits for whoever has it; for set-up, and for handles that may.
    fn content(&self) -> MutexGuard<'_, Content> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn try_content(&self) -> Option<MutexGuard<'_, Content>> {
        match self.0.try_lock() {
            Ok(content) => Some(content),
            Err(TryLockError::Poisoned(e)) => Some(e.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Calls with the filters. May wait.
    pub(super) fn with_filters<T>(&self, call: impl FnOnce(&mut Vec<[u32; 2]>) -> T) -> T {
        call(&mut self.content().filters)
    }

    /// Exchanges the socket for the one that is ready, and otherwise asks for one; true if it was exchanged. Neither
    /// waits nor calls the system.
    pub(super) fn exchange(&self, socket: &mut CanSocket) -> bool {
        let Some(mut content) = self.try_content() else { return false };
        let Some(fresh) = content.fresh.take() else {
            content.wanted = true;
            return false;
        };
        // No old one is left there: it was taken away before this one was laid down.
        content.spent = Some(std::mem::replace(socket, fresh));
        true
    }

    /// The handle has helped itself.
    pub(super) fn forget(&self) {
        let mut content = self.content();
        (content.wanted, content.fresh) = (false, None);
    }

    /// Closes the socket left here, and lays one here if it is wanted; false if that did not work yet.
    fn serve(&self, open: impl FnOnce(&[[u32; 2]]) -> Option<CanSocket>) -> bool {
        let Some(mut content) = self.try_content() else { return false };
        content.spent = None;
        if content.wanted {
            content.fresh = open(&content.filters);
            content.wanted = content.fresh.is_none();
        }
        !content.wanted
    }
}

/// The berths of all handles of one bus.
#[derive(Default)]
pub(super) struct Berths(Mutex<Vec<Weak<Berth>>>);

impl Berths {
    pub(super) fn add(&self, berth: &Arc<Berth>) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|b| b.strong_count() > 0);
        all.push(Arc::downgrade(berth));
    }

    /// Helps everybody who has asked; false if somebody has to wait on. May wait itself; does not allocate.
    pub(super) fn serve(&self, mut open: impl FnMut(&[[u32; 2]]) -> Option<CanSocket>) -> bool {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut served = true;
        for berth in all.iter().filter_map(Weak::upgrade) {
            served &= berth.serve(&mut open);
        }
        served
    }
}
