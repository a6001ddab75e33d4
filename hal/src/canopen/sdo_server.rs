//! SDO server: one request in, at most one response out; no timer of its own, for a client that vanishes is simply
//! overtaken by its next initiate request.

use super::sdo::{AbortCode, Request, Response, Segment, Start, TRANSFER_LEN_MAX, expedited, segment};

/// The objects behind a server.
pub trait ObjectAccess {
    /// The object's value in little-endian bytes.
    ///
    /// # Errors
    /// The abort code to answer with.
    fn read(&mut self, index: u16, sub: u8) -> Result<Vec<u8>, AbortCode>;

    /// Sets the object's value from little-endian bytes.
    ///
    /// # Errors
    /// The abort code to answer with.
    fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode>;

    /// Refuses a segmented write before its data arrive.
    ///
    /// # Errors
    /// The abort code to answer with.
    fn check_write(&mut self, index: u16, sub: u8) -> Result<(), AbortCode>;

    /// Bytes that the object has, where that is fixed: so many are taken of an expedited write that does not indicate its
    /// size (e = 1, s = 0; CiA 301, 7.2.4.3.3), otherwise all four.
    fn length(&self, index: u16, sub: u8) -> Option<usize>;
}

#[derive(Debug, Clone, Default)]
enum Transfer {
    #[default]
    Idle,
    Upload {
        index: u16,
        sub: u8,
        data: Vec<u8>,
        at: usize,
        toggle: bool,
    },
    Download {
        index: u16,
        sub: u8,
        data: Vec<u8>,
        announced: Option<u32>,
        toggle: bool,
    },
}

/// The server's state. A transfer allocates; it belongs to set-up and to the simulated drive, not to a control thread.
#[derive(Debug, Clone, Default)]
pub struct SdoServer {
    transfer: Transfer,
}

impl SdoServer {
    /// Idle.
    pub fn new() -> Self {
        Self::default()
    }

    /// Handles the payload of one request frame. `None`: nothing is answered (not eight bytes, or an abort).
    pub fn on_request(&mut self, data: &[u8], objects: &mut impl ObjectAccess) -> Option<[u8; 8]> {
        let request = Request::decode(data)?;
        let (index, sub) = self.multiplexer(&request);
        match self.handle(request, objects) {
            Ok(response) => response.map(|r| r.encode()),
            Err(code) => {
                self.transfer = Transfer::Idle;
                Some(Response::Abort { index, sub, code }.encode())
            }
        }
    }

    /// What an abort of this request has to name: segments carry no index, the running transfer does.
    fn multiplexer(&self, request: &Request) -> (u16, u8) {
        match (*request, &self.transfer) {
            (
                Request::Download { index, sub, .. }
                | Request::Upload { index, sub }
                | Request::Abort { index, sub, .. }
                | Request::Unknown { index, sub },
                _,
            ) => (index, sub),
            (_, &Transfer::Upload { index, sub, .. } | &Transfer::Download { index, sub, .. }) => (index, sub),
            (_, Transfer::Idle) => (0, 0),
        }
    }

    fn handle(&mut self, request: Request, objects: &mut impl ObjectAccess) -> Result<Option<Response>, AbortCode> {
        match request {
            Request::Abort { .. } => {
                self.transfer = Transfer::Idle;
                Ok(None)
            }
            Request::Unknown { .. } => Err(AbortCode::COMMAND),
            Request::Upload { index, sub } => {
                self.transfer = Transfer::Idle;
                let data = objects.read(index, sub)?;
                if data.is_empty() {
                    return Err(AbortCode::NO_DATA);
                }
                let start = if data.len() <= 4 {
                    expedited(&data)
                } else {
                    let start = Start::Segmented(u32::try_from(data.len()).ok());
                    self.transfer = Transfer::Upload { index, sub, data, at: 0, toggle: false };
                    start
                };
                Ok(Some(Response::Upload { index, sub, start }))
            }
            Request::UploadSegment(toggle) => self.upload_segment(toggle).map(Some),
            Request::Download { index, sub, start } => {
                self.transfer = Transfer::Idle;
                match start {
                    Start::Expedited(len, bytes) => {
                        let len = len.or_else(|| objects.length(index, sub)).unwrap_or(bytes.len()).min(bytes.len());
                        objects.write(index, sub, &bytes[..len])?;
                    }
                    Start::Segmented(announced) => {
                        objects.check_write(index, sub)?;
                        if announced.is_some_and(|n| n as usize > TRANSFER_LEN_MAX) {
                            return Err(AbortCode::OUT_OF_MEMORY);
                        }
                        self.transfer = Transfer::Download { index, sub, data: Vec::new(), announced, toggle: false };
                    }
                }
                Ok(Some(Response::Download { index, sub }))
            }
            Request::DownloadSegment(s) => self.download_segment(&s, objects).map(Some),
        }
    }

    fn upload_segment(&mut self, requested: bool) -> Result<Response, AbortCode> {
        let Transfer::Upload { data, at, toggle, .. } = &mut self.transfer else { return Err(AbortCode::COMMAND) };
        if requested != *toggle {
            return Err(AbortCode::TOGGLE);
        }
        let s = segment(data, *at, *toggle);
        *at += s.len;
        *toggle = !*toggle;
        if s.last {
            self.transfer = Transfer::Idle;
        }
        Ok(Response::UploadSegment(s))
    }

    fn download_segment(&mut self, s: &Segment, objects: &mut impl ObjectAccess) -> Result<Response, AbortCode> {
        let Transfer::Download { index, sub, data, announced, toggle } = &mut self.transfer else {
            return Err(AbortCode::COMMAND);
        };
        if s.toggle != *toggle {
            return Err(AbortCode::TOGGLE);
        }
        data.extend_from_slice(&s.data[..s.len]);
        if data.len() > TRANSFER_LEN_MAX {
            return Err(AbortCode::OUT_OF_MEMORY);
        }
        *toggle = !*toggle;
        if s.last {
            match announced.map(|n| (n as usize).cmp(&data.len())) {
                Some(std::cmp::Ordering::Less) => return Err(AbortCode::TOO_LONG),
                Some(std::cmp::Ordering::Greater) => return Err(AbortCode::TOO_SHORT),
                _ => objects.write(*index, *sub, data)?,
            }
            self.transfer = Transfer::Idle;
        }
        Ok(Response::DownloadSegment(s.toggle))
    }
}
