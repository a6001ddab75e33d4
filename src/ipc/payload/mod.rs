//! What lies in shared memory, byte by byte (`../PAYLOADS.md`).
//!
//! Every payload is `repr(C)`, of fixed size, without padding and little-endian by the machines it runs on, so that C
//! and Python (`ctypes.Structure`) describe it with a list of fields. It starts with a [`Header`]. Enumerations are
//! plain `u32` here, because a client can write any number; `codes` gives them their meanings.
//!
//! Enters: nothing. Leaves: types. They hold no pointer and never own memory.

mod codes;
mod encoders;
#[cfg(test)]
mod layout;
mod obstacles;
mod request;
mod state;
mod target;
mod tip;

pub use codes::*;
pub use encoders::*;
pub use obstacles::*;
pub use request::*;
pub use state::*;
pub use target::*;
pub use tip::*;

use iceoryx2::prelude::ZeroCopySend;

/// Version of all payloads; part of their type names, so that another version is refused on opening a service.
pub const SCHEMA_VERSION: u32 = 1;
/// Most cables of an arm.
pub const MAX_CABLES: usize = 96;
/// Most segments of an arm.
pub const MAX_SEGMENTS: usize = 16;
/// Average curvatures: two per segment.
pub const MAX_CURVATURES: usize = 2 * MAX_SEGMENTS;
/// Most nodes in [`State`]; an arm with more sends every `node_stride`-th.
pub const MAX_NODES: usize = 64;
/// Most obstacles of one set.
pub const MAX_OBSTACLES: usize = 64;
/// Most hull vertices of one set, shared by its hulls.
pub const MAX_VERTICES: usize = 256;
/// Most obstacle sources.
pub const MAX_SOURCES: usize = 8;
/// Most obstacles of all sources together.
pub const MAX_TRACKED: usize = 256;
/// Most alarms in [`State`].
pub const MAX_ALARMS: usize = 32;
/// Places for counters of [`RejectCause`].
pub const REJECT_CAUSES: usize = 16;

/// `Header::tick` of an input that belongs to no tick (anything but lockstep).
pub const NO_TICK: u64 = u64::MAX;

/// First 32 bytes of every payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Header.v1")]
pub struct Header {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Who sends: chosen by the sender, stable over its restarts; 0 for the daemon.
    pub source_id: u32,
    /// Increases with every message of a source; a restarted source begins at 0 again, with a newer capture time.
    pub sequence: u64,
    /// CLOCK_MONOTONIC (ns) when the content was measured, not when it was sent.
    pub capture_ns: u64,
    /// Lockstep: the tick that this input is for; [`NO_TICK`] otherwise. In [`State`]: the tick that it reports.
    pub tick: u64,
}

impl Header {
    /// A header of this version, outside lockstep.
    pub const fn new(source_id: u32, sequence: u64, capture_ns: u64) -> Self {
        Self { schema_version: SCHEMA_VERSION, source_id, sequence, capture_ns, tick: NO_TICK }
    }

    /// The same header for a tick in lockstep.
    #[must_use]
    pub const fn for_tick(mut self, tick: u64) -> Self {
        self.tick = tick;
        self
    }
}

impl Default for Header {
    fn default() -> Self {
        Self::new(0, 0, 0)
    }
}
