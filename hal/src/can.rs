//! A CAN bus as everything above it sees it: frames out, frames with a receive time in, the state of the bus.
//!
//! Enters and leaves: [`Frame`]s. One trait, [`CanBus`], two backends (SocketCAN, a user-space virtual bus), one
//! conformance suite. Nothing here blocks longer than it is told to, and nothing allocates after `open`.

use thiserror::Error;

/// Largest payload of a CAN FD frame (bytes).
pub const DATA_LEN_MAX: usize = 64;

/// Identifier of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Id {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

/// What a frame is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Classic data frame, at most 8 bytes.
    Classic,
    /// Classic remote request; `len` is the requested length.
    Remote,
    /// CAN FD data frame, at most 64 bytes.
    Fd {
        /// Payload sent at the higher bit rate.
        bit_rate_switch: bool,
    },
}

/// One frame; `Copy`, no heap.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    id: Id,
    kind: Kind,
    len: u8,
    data: [u8; DATA_LEN_MAX],
}

/// A frame that cannot exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FrameError {
    /// The identifier does not fit its kind.
    #[error("identifier {0:#x} is above {1:#x}")]
    Id(u32, u32),
    /// The payload does not fit the kind of frame.
    #[error("{len} bytes do not fit a frame of at most {max}")]
    Length {
        /// Bytes given.
        len: usize,
        /// Most bytes of this kind.
        max: usize,
    },
}

impl Frame {
    /// A classic data frame.
    ///
    /// # Errors
    /// Identifier out of range, or more than 8 bytes.
    pub fn classic(id: Id, data: &[u8]) -> Result<Self, FrameError> {
        Self::new(id, Kind::Classic, data)
    }

    /// A frame of any kind. FD payloads are padded with zeros to the next length that the wire has
    /// (0..=8, 12, 16, 20, 24, 32, 48, 64).
    ///
    /// # Errors
    /// Identifier out of range, or too many bytes for the kind.
    pub fn new(id: Id, kind: Kind, data: &[u8]) -> Result<Self, FrameError> {
        match id {
            Id::Standard(i) if i > 0x7ff => return Err(FrameError::Id(u32::from(i), 0x7ff)),
            Id::Extended(i) if i > 0x1fff_ffff => return Err(FrameError::Id(i, 0x1fff_ffff)),
            _ => {}
        }
        let max = if matches!(kind, Kind::Fd { .. }) { DATA_LEN_MAX } else { 8 };
        if data.len() > max {
            return Err(FrameError::Length { len: data.len(), max });
        }
        let mut bytes = [0; DATA_LEN_MAX];
        if kind != Kind::Remote {
            bytes[..data.len()].copy_from_slice(data);
        }
        let len = if matches!(kind, Kind::Fd { .. }) { fd_length(data.len()) } else { data.len() };
        #[allow(clippy::cast_possible_truncation)] // at most 64
        Ok(Self { id, kind, len: len as u8, data: bytes })
    }

    /// Identifier.
    pub fn id(&self) -> Id {
        self.id
    }

    /// Kind.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Payload; empty for a remote request.
    pub fn data(&self) -> &[u8] {
        if self.kind == Kind::Remote { &[] } else { &self.data[..usize::from(self.len)] }
    }

    /// Length code in bytes, also of a remote request.
    pub fn len(&self) -> usize {
        usize::from(self.len)
    }

    /// True for a payload of no bytes.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.id {
            Id::Standard(i) => write!(f, "{i:03X}")?,
            Id::Extended(i) => write!(f, "{i:08X}")?,
        }
        match self.kind {
            Kind::Classic => write!(f, "#")?,
            Kind::Remote => write!(f, "#R{}", self.len)?,
            Kind::Fd { bit_rate_switch } => write!(f, "##{}", u8::from(bit_rate_switch))?,
        }
        self.data().iter().try_for_each(|b| write!(f, "{b:02X}"))
    }
}

/// The next payload length that CAN FD has.
fn fd_length(len: usize) -> usize {
    [8, 12, 16, 20, 24, 32, 48, 64].into_iter().find(|&l| l >= len && len > 8).unwrap_or(len)
}

/// A frame with the time at which it was received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received {
    /// The frame.
    pub frame: Frame,
    /// CLOCK_MONOTONIC at reception (ns), from the kernel where it gives one.
    pub time_ns: u64,
}

/// Health of the bus as the controller reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BusState {
    /// Error counters below 96.
    #[default]
    ErrorActive,
    /// An error counter reached 96.
    ErrorWarning,
    /// An error counter reached 128.
    ErrorPassive,
    /// The controller has left the bus.
    BusOff,
    /// The interface is down or gone.
    Down,
}

impl BusState {
    /// False when nothing can be sent or received: bus-off and down.
    pub fn carries_frames(self) -> bool {
        !matches!(self, Self::BusOff | Self::Down)
    }
}

/// Why a frame was not sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SendError {
    /// The transmit queue is full (ENOBUFS, EAGAIN); the frame was not taken.
    #[error("transmit queue full")]
    Full,
    /// The bus cannot take frames now.
    #[error("bus is {0:?}")]
    Bus(BusState),
    /// The bus or interface does not carry this kind of frame (FD on a classic bus).
    #[error("frame kind not carried by this bus")]
    Unsupported,
    /// Any other error of the operating system.
    #[error("operating system error {0}")]
    Os(i32),
}

/// Why nothing was received although no time-out passed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ReceiveError {
    /// The bus is down or bus-off.
    #[error("bus is {0:?}")]
    Bus(BusState),
    /// Any other error of the operating system.
    #[error("operating system error {0}")]
    Os(i32),
}

/// Counters since `open`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BusCounters {
    /// Frames handed to the bus.
    pub sent: u64,
    /// Frames received.
    pub received: u64,
    /// Frames that the receiver lost because it was too slow.
    pub lost: u64,
    /// Sends refused because the queue was full.
    pub refused: u64,
    /// Error frames.
    pub errors: u64,
}

/// Receive filter: a standard frame passes when `id & mask == value & mask`; no filter at all passes everything.
/// Several filters pass what any of them passes. No filter passes an extended frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Filter {
    /// Value compared.
    pub value: u32,
    /// Bits compared.
    pub mask: u32,
}

/// A set of [`Filter`]s worked out beforehand: one bit per standard identifier, so that a test is one look-up.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilterSet {
    /// `None` passes everything.
    standard: Option<[u64; 32]>,
}

impl Default for FilterSet {
    /// Passes everything.
    fn default() -> Self {
        Self { standard: None }
    }
}

impl FilterSet {
    /// The set of these filters. Does not allocate.
    pub fn new(filters: &[Filter]) -> Self {
        if filters.is_empty() {
            return Self::default();
        }
        let mut bits = [0_u64; 32];
        for id in 0..0x800_u32 {
            if filters.iter().any(|f| id & f.mask & 0x7ff == f.value & f.mask & 0x7ff) {
                bits[id as usize / 64] |= 1 << (id % 64);
            }
        }
        Self { standard: Some(bits) }
    }

    /// Does a frame of this identifier pass?
    pub fn passes(&self, id: Id) -> bool {
        match (&self.standard, id) {
            (None, _) => true,
            (Some(bits), Id::Standard(id)) => {
                bits.get(usize::from(id) / 64).is_some_and(|word| word >> (id % 64) & 1 == 1)
            }
            (Some(_), Id::Extended(_)) => false,
        }
    }
}

/// One handle on one CAN bus.
///
/// A frame sent by one handle reaches every other handle of the same bus in the order of sending, and not the sender.
/// A [`duplicate`](CanBus::duplicate) is another handle: it hears what the first one sends.
/// After `open` (of a backend) no method but `duplicate` allocates.
pub trait CanBus: Send {
    /// Hands a frame to the bus without blocking.
    ///
    /// # Errors
    /// [`SendError`]; the frame was then not taken.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError>;

    /// Hands frames that wait in this handle for room on to the bus, as far as it takes them, without blocking; how many
    /// still wait. A handle without a queue of its own has none.
    fn flush(&mut self) -> usize {
        0
    }

    /// Waits at most `timeout` for a frame; zero polls. `Ok(None)` when the time passed.
    ///
    /// Frames that arrived before the bus went down are delivered first. Then the first call reports the change at
    /// once, and every further one waits its `timeout` for the bus to come back before it says so again: a loop of
    /// receives does not spin on a dead bus.
    ///
    /// # Errors
    /// [`ReceiveError`].
    fn receive(&mut self, timeout: std::time::Duration) -> Result<Option<Received>, ReceiveError>;

    /// Drops the frames that this handle has taken and that still wait in it for the bus; how many there were. What an
    /// operating system or a controller has taken over is out of reach. Does not block.
    fn discard_waiting(&mut self) -> usize {
        0
    }

    /// State of the bus as last seen.
    fn state(&self) -> BusState;

    /// Counters of this handle.
    fn counters(&self) -> BusCounters;

    /// Sets the receive filters; an empty slice passes everything.
    ///
    /// # Errors
    /// Operating system error.
    fn set_filters(&mut self, filters: &[Filter]) -> Result<(), ReceiveError>;

    /// Another handle on the same bus (a receiver and a sender are often two threads).
    ///
    /// # Errors
    /// Operating system error.
    fn duplicate(&self) -> std::io::Result<Box<dyn CanBus>>;
}

impl<B: CanBus + ?Sized> CanBus for Box<B> {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        (**self).send(frame)
    }

    fn flush(&mut self) -> usize {
        (**self).flush()
    }

    fn receive(&mut self, timeout: std::time::Duration) -> Result<Option<Received>, ReceiveError> {
        (**self).receive(timeout)
    }

    fn discard_waiting(&mut self) -> usize {
        (**self).discard_waiting()
    }

    fn state(&self) -> BusState {
        (**self).state()
    }

    fn counters(&self) -> BusCounters {
        (**self).counters()
    }

    fn set_filters(&mut self, filters: &[Filter]) -> Result<(), ReceiveError> {
        (**self).set_filters(filters)
    }

    fn duplicate(&self) -> std::io::Result<Box<dyn CanBus>> {
        (**self).duplicate()
    }
}
