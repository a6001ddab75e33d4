//! SDO on the wire (CiA 301, 7.2.4.3): abort codes, and requests and responses as enumerations of what eight bytes say.
//!
//! Block transfer is not offered; a block request is answered with "invalid command specifier", as CiA 301 wants.

/// Longest value that is transferred (bytes): more is refused as out of memory, so that a peer cannot make us grow.
pub const TRANSFER_LEN_MAX: usize = 1024;

/// Why a transfer was aborted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct AbortCode(pub u32);

#[allow(missing_docs)] // the words below are the documentation
impl AbortCode {
    pub const TOGGLE: Self = Self(0x0503_0000);
    pub const TIMEOUT: Self = Self(0x0504_0000);
    pub const COMMAND: Self = Self(0x0504_0001);
    pub const OUT_OF_MEMORY: Self = Self(0x0504_0005);
    pub const UNSUPPORTED_ACCESS: Self = Self(0x0601_0000);
    pub const WRITE_ONLY: Self = Self(0x0601_0001);
    pub const READ_ONLY: Self = Self(0x0601_0002);
    pub const NO_OBJECT: Self = Self(0x0602_0000);
    pub const NOT_MAPPABLE: Self = Self(0x0604_0041);
    pub const PDO_LENGTH: Self = Self(0x0604_0042);
    pub const PARAMETER: Self = Self(0x0604_0043);
    pub const LENGTH: Self = Self(0x0607_0010);
    pub const TOO_LONG: Self = Self(0x0607_0012);
    pub const TOO_SHORT: Self = Self(0x0607_0013);
    pub const NO_SUB_INDEX: Self = Self(0x0609_0011);
    pub const VALUE_RANGE: Self = Self(0x0609_0030);
    pub const VALUE_HIGH: Self = Self(0x0609_0031);
    pub const VALUE_LOW: Self = Self(0x0609_0032);
    pub const GENERAL: Self = Self(0x0800_0000);
    pub const DEVICE_STATE: Self = Self(0x0800_0022);
    pub const NO_DATA: Self = Self(0x0800_0024);

    /// The code in words.
    pub const fn words(self) -> &'static str {
        match self.0 {
            0x0503_0000 => "toggle bit not alternated",
            0x0504_0000 => "SDO protocol timed out",
            0x0504_0001 => "command specifier not valid or unknown",
            0x0504_0002 => "invalid block size",
            0x0504_0003 => "invalid sequence number",
            0x0504_0004 => "CRC error",
            0x0504_0005 => "out of memory",
            0x0601_0000 => "unsupported access to an object",
            0x0601_0001 => "attempt to read a write-only object",
            0x0601_0002 => "attempt to write a read-only object",
            0x0602_0000 => "object does not exist",
            0x0604_0041 => "object cannot be mapped to the PDO",
            0x0604_0042 => "objects to be mapped would exceed the PDO's length",
            0x0604_0043 => "general parameter incompatibility",
            0x0604_0047 => "general internal incompatibility in the device",
            0x0606_0000 => "hardware error",
            0x0607_0010 => "data type does not match, length of the parameter does not match",
            0x0607_0012 => "data type does not match, parameter too long",
            0x0607_0013 => "data type does not match, parameter too short",
            0x0609_0011 => "sub-index does not exist",
            0x0609_0030 => "invalid value of the parameter",
            0x0609_0031 => "value of the parameter too high",
            0x0609_0032 => "value of the parameter too low",
            0x0609_0036 => "maximum is less than minimum",
            0x060a_0023 => "resource not available: SDO connection",
            0x0800_0000 => "general error",
            0x0800_0020 => "data cannot be transferred or stored",
            0x0800_0021 => "data cannot be transferred or stored because of local control",
            0x0800_0022 => "data cannot be transferred or stored because of the present device state",
            0x0800_0023 => "object dictionary not present",
            0x0800_0024 => "no data available",
            _ => "abort code not defined by CiA 301",
        }
    }
}

impl std::fmt::Display for AbortCode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({:08X})", self.words(), self.0)
    }
}

/// One segment of a transfer: up to seven bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// Alternates from segment to segment, beginning with false.
    pub toggle: bool,
    /// Bytes that count, 0..=7.
    pub len: usize,
    /// The bytes.
    pub data: [u8; 7],
    /// No more segments follow.
    pub last: bool,
}

/// Value or announced length with which a transfer starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// The whole value: length (None: not indicated, four bytes are sent) and bytes.
    Expedited(Option<usize>, [u8; 4]),
    /// Segments follow; the total length where it is indicated.
    Segmented(Option<u32>),
}

/// From client to server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // index and sub-index
pub enum Request {
    /// Write an object.
    Download { index: u16, sub: u8, start: Start },
    /// A segment of a write.
    DownloadSegment(Segment),
    /// Read an object.
    Upload { index: u16, sub: u8 },
    /// Ask for the next segment of a read; carries the toggle bit.
    UploadSegment(bool),
    /// Abort.
    Abort { index: u16, sub: u8, code: AbortCode },
    /// Anything else (block transfer included).
    Unknown { index: u16, sub: u8 },
}

/// From server to client.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // index and sub-index
pub enum Response {
    /// A write was accepted, or its segments are awaited.
    Download { index: u16, sub: u8 },
    /// A segment of a write was taken; carries the toggle bit.
    DownloadSegment(bool),
    /// A read begins, or is complete.
    Upload { index: u16, sub: u8, start: Start },
    /// A segment of a read.
    UploadSegment(Segment),
    /// Abort.
    Abort { index: u16, sub: u8, code: AbortCode },
}

fn multiplexer(b: &[u8; 8]) -> (u16, u8) {
    (u16::from_le_bytes([b[1], b[2]]), b[3])
}

fn with_multiplexer(command: u8, index: u16, sub: u8, tail: [u8; 4]) -> [u8; 8] {
    let [i0, i1] = index.to_le_bytes();
    [command, i0, i1, sub, tail[0], tail[1], tail[2], tail[3]]
}

fn start_of(b: &[u8; 8]) -> Start {
    let tail = [b[4], b[5], b[6], b[7]];
    let sized = b[0] & 1 != 0;
    if b[0] & 2 != 0 {
        Start::Expedited(sized.then(|| 4 - usize::from(b[0] >> 2 & 3)), tail)
    } else {
        Start::Segmented(sized.then(|| u32::from_le_bytes(tail)))
    }
}

fn start_bits(start: Start) -> (u8, [u8; 4]) {
    match start {
        Start::Expedited(Some(len), data) => (3 | (4 - len.clamp(1, 4) as u8) << 2, data),
        Start::Expedited(None, data) => (2, data),
        Start::Segmented(Some(len)) => (1, len.to_le_bytes()),
        Start::Segmented(None) => (0, [0; 4]),
    }
}

fn segment_of(b: &[u8; 8]) -> Segment {
    let mut data = [0; 7];
    data.copy_from_slice(&b[1..]);
    Segment { toggle: b[0] & 0x10 != 0, len: 7 - usize::from(b[0] >> 1 & 7), data, last: b[0] & 1 != 0 }
}

fn segment_bytes(specifier: u8, s: &Segment) -> [u8; 8] {
    let mut b = [0; 8];
    b[0] = specifier | u8::from(s.toggle) << 4 | (7 - s.len.min(7) as u8) << 1 | u8::from(s.last);
    b[1..].copy_from_slice(&s.data);
    b
}

/// The payload as eight bytes; CiA 301 knows no other length.
fn eight(data: &[u8]) -> Option<&[u8; 8]> {
    data.try_into().ok()
}

impl Request {
    /// From the payload; `None` unless it has eight bytes.
    pub fn decode(data: &[u8]) -> Option<Self> {
        let b = eight(data)?;
        let (index, sub) = multiplexer(b);
        Some(match b[0] >> 5 {
            0 => Self::DownloadSegment(segment_of(b)),
            1 => Self::Download { index, sub, start: start_of(b) },
            2 => Self::Upload { index, sub },
            3 => Self::UploadSegment(b[0] & 0x10 != 0),
            4 => Self::Abort { index, sub, code: AbortCode(u32::from_le_bytes([b[4], b[5], b[6], b[7]])) },
            _ => Self::Unknown { index, sub },
        })
    }

    /// The payload.
    pub fn encode(&self) -> [u8; 8] {
        match *self {
            Self::DownloadSegment(s) => segment_bytes(0, &s),
            Self::Download { index, sub, start } => {
                let (bits, tail) = start_bits(start);
                with_multiplexer(0x20 | bits, index, sub, tail)
            }
            Self::Upload { index, sub } => with_multiplexer(0x40, index, sub, [0; 4]),
            Self::UploadSegment(toggle) => [0x60 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0],
            Self::Abort { index, sub, code } => with_multiplexer(0x80, index, sub, code.0.to_le_bytes()),
            Self::Unknown { index, sub } => with_multiplexer(0xe0, index, sub, [0; 4]),
        }
    }
}

impl Response {
    /// From the payload; `None` unless it has eight bytes and a known specifier.
    pub fn decode(data: &[u8]) -> Option<Self> {
        let b = eight(data)?;
        let (index, sub) = multiplexer(b);
        Some(match b[0] >> 5 {
            0 => Self::UploadSegment(segment_of(b)),
            1 => Self::DownloadSegment(b[0] & 0x10 != 0),
            2 => Self::Upload { index, sub, start: start_of(b) },
            3 => Self::Download { index, sub },
            4 => Self::Abort { index, sub, code: AbortCode(u32::from_le_bytes([b[4], b[5], b[6], b[7]])) },
            _ => return None,
        })
    }

    /// The payload.
    pub fn encode(&self) -> [u8; 8] {
        match *self {
            Self::UploadSegment(s) => segment_bytes(0, &s),
            Self::DownloadSegment(toggle) => [0x20 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0],
            Self::Upload { index, sub, start } => {
                let (bits, tail) = start_bits(start);
                with_multiplexer(0x40 | bits, index, sub, tail)
            }
            Self::Download { index, sub } => with_multiplexer(0x60, index, sub, [0; 4]),
            Self::Abort { index, sub, code } => with_multiplexer(0x80, index, sub, code.0.to_le_bytes()),
        }
    }
}

/// Bytes of an expedited transfer.
pub(crate) fn expedited(data: &[u8]) -> Start {
    let mut tail = [0; 4];
    tail[..data.len().min(4)].copy_from_slice(&data[..data.len().min(4)]);
    Start::Expedited(Some(data.len().min(4)), tail)
}

/// The next segment of `data` from `at` on.
pub(crate) fn segment(data: &[u8], at: usize, toggle: bool) -> Segment {
    let rest = data.get(at..).unwrap_or(&[]);
    let len = rest.len().min(7);
    let mut bytes = [0; 7];
    bytes[..len].copy_from_slice(&rest[..len]);
    Segment { toggle, len, data: bytes, last: rest.len() <= 7 }
}
