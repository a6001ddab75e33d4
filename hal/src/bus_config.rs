//! Which bus, and how: a plain description in, a [`CanBus`] or the reason why not out.
//!
//! Must never: guess. A reason names the interface, what was found and what mends it.

use std::io;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::can::CanBus;
use crate::socketcan_bus::SocketCanBus;
use crate::virtual_bus::{OpenVirtualError, VirtualBus};

/// Backend of a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BusKind {
    /// The kernel's CAN sockets.
    Socketcan,
    /// Shared memory between processes.
    Virtual,
}

/// What to do when the bus is lost (link down, interface gone, bus-off).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Restart {
    /// Nothing: the bus stays lost until it is opened anew.
    Never,
    /// Open the interface again, first after `first`, then at twice the interval each time up to `longest`.
    Reopen {
        /// First interval.
        first: Duration,
        /// Longest interval.
        longest: Duration,
        /// At bus-off also take the interface down and up, which restarts the controller; needs CAP_NET_ADMIN. Without
        /// it, bus-off ends when the kernel restarts the controller (`ip link set can0 type can restart-ms 100`).
        cycle_interface: bool,
    },
}

impl Default for Restart {
    /// 10 ms, 20 ms, ... 1 s; the interface is left to the administrator.
    fn default() -> Self {
        Self::Reopen { first: Duration::from_millis(10), longest: Duration::from_secs(1), cycle_interface: false }
    }
}

/// Description of one bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BusSpec {
    /// Backend.
    pub kind: BusKind,
    /// Interface (`can0`) or name of the virtual bus.
    pub name: String,
    /// Send and receive CAN FD frames as well.
    pub fd: bool,
    /// Frames that wait in this process while the kernel's transmit queue is full; 0 refuses at once. The virtual bus
    /// never makes a sender wait and has no use for it.
    pub queue_length: usize,
    /// Most frames that one handle gives to the bus at once, in every cycle. An interface whose transmit queue is shorter is
    /// refused: what does not fit would leave with the next cycle, or never. 0: not looked at. The virtual bus has no
    /// such queue.
    pub burst: usize,
    /// What to do when the bus is lost; the virtual bus comes back by itself.
    pub restart: Restart,
}

impl BusSpec {
    /// A classic bus with a queue of 64 frames, bursts of any length and the default restart.
    pub fn new(kind: BusKind, name: impl Into<String>) -> Self {
        Self { kind, name: name.into(), fd: false, queue_length: 64, burst: 0, restart: Restart::default() }
    }
}

/// Why a bus did not open.
#[derive(Debug, Error)]
pub enum OpenError {
    /// No CAN sockets in this kernel.
    #[error(
        "this kernel has no CAN sockets (wanted interface {interface}): load the modules can and can-raw, or use a virtual bus"
    )]
    NoCan {
        /// Interface wanted.
        interface: String,
    },
    /// No such interface.
    #[error(
        "CAN interface {interface} does not exist: see `ip link`; a virtual one is made by `ip link add {interface} type vcan`"
    )]
    Missing {
        /// Interface wanted.
        interface: String,
    },
    /// An interface of another kind.
    #[error("interface {interface} is not a CAN interface (hardware type {found}, expected 280)")]
    NotCan {
        /// Interface wanted.
        interface: String,
        /// ARPHRD number found.
        found: u16,
    },
    /// The interface is down.
    #[error("CAN interface {interface} is down: `ip link set {interface} up`")]
    Down {
        /// Interface wanted.
        interface: String,
    },
    /// CAN FD wanted on a classic interface.
    #[error(
        "CAN FD wanted, but CAN interface {interface} has an MTU of {found} (expected 72): `ip link set {interface} mtu 72`"
    )]
    Mtu {
        /// Interface wanted.
        interface: String,
        /// MTU found (bytes).
        found: u32,
    },
    /// The interface's transmit queue cannot take what is sent in a cycle.
    #[error(
        "the transmit queue of CAN interface {interface} holds {found} frames, and {burst} are sent at once in every cycle: `ip link set {interface} txqueuelen {remedy}`"
    )]
    ShortQueue {
        /// Interface wanted.
        interface: String,
        /// Frames that it holds.
        found: usize,
        /// Frames of a cycle.
        burst: usize,
        /// Length that has room to spare.
        remedy: usize,
    },
    /// Not allowed.
    #[error("no permission for CAN interface {interface}: run with CAP_NET_RAW or as a user who may open CAN sockets")]
    Permission {
        /// Interface wanted.
        interface: String,
    },
    /// Not an interface name.
    #[error("interface name {0:?}: expected 1 to 15 bytes without spaces and slashes")]
    Name(String),
    /// Any other error.
    #[error("CAN interface {interface}: {step}: {source}")]
    Os {
        /// Interface wanted.
        interface: String,
        /// What was being done.
        step: &'static str,
        /// What the operating system said.
        source: io::Error,
    },
    /// The virtual bus's own reasons.
    #[error(transparent)]
    Virtual(#[from] OpenVirtualError),
}

/// Opens the bus described.
///
/// # Errors
/// [`OpenError`], always with what mends it.
pub fn open(spec: &BusSpec) -> Result<Box<dyn CanBus>, OpenError> {
    Ok(match spec.kind {
        BusKind::Socketcan => Box::new(SocketCanBus::open(spec)?),
        BusKind::Virtual => Box::new(VirtualBus::open(&spec.name, spec.fd)?),
    })
}
