//! Those who stay at the socket and publish: obstacles or targets, a line for each.
//!
//! Never waits for them. Of each at most a line is taken in a millisecond; who sends faster waits, and who does not read
//! what became of it does not hear it.

use super::Said;
use super::lines::{PointLine, SetLine};
use super::server::tell;
use crate::ipc::payload::RejectCause;
use crate::ipc::{BySocket, SocketPort};
use std::io::{self, Read};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

/// Longest line: a full set takes a third of it.
const LINE_BYTES_MAX: usize = 128 << 10;
/// Shortest time between two lines of one stream.
const PAUSE: Duration = Duration::from_millis(1);

/// What somebody publishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    Obstacles,
    Targets,
}

/// Somebody who publishes.
#[derive(Debug)]
pub(super) struct Stream {
    pub(super) stream: UnixStream,
    pub(super) port: SocketPort,
    pub(super) source_id: u32,
    content: Content,
    sequence: u64,
    text: Vec<u8>,
    next: Instant,
    /// What was told of the last line: told is what changes.
    told: Option<Result<(), String>>,
}

/// What a look at a stream found.
pub(super) enum Found {
    Nothing,
    /// For the I/O thread.
    Line(BySocket),
    /// It is over.
    End,
}

impl Stream {
    /// `rest` is what followed the first line already.
    pub(super) fn new(stream: UnixStream, port: SocketPort, source_id: u32, content: Content, rest: &[u8]) -> Self {
        let (text, next) = (rest.to_vec(), Instant::now());
        Self { stream, port, source_id, content, sequence: 0, text, next, told: None }
    }

    /// Whether it is time to look for its next line.
    pub(super) fn is_due(&self) -> bool {
        self.next <= Instant::now()
    }

    /// The next line, if it is there.
    pub(super) fn look(&mut self) -> Found {
        if !self.is_due() {
            return Found::Nothing;
        }
        let mut ended = false;
        if !self.text.contains(&b'\n') {
            let mut part = [0; 16 << 10];
            match self.stream.read(&mut part) {
                Ok(0) => ended = true,
                Ok(count) => self.text.extend_from_slice(&part[..count]),
                Err(e) if [io::ErrorKind::WouldBlock, io::ErrorKind::Interrupted].contains(&e.kind()) => {}
                Err(_) => return Found::End,
            }
        }
        let Some(end) = self.text.iter().position(|byte| *byte == b'\n') else {
            if self.text.len() > LINE_BYTES_MAX {
                tell(&self.stream, &Said::Refused(format!("a line of more than {LINE_BYTES_MAX} bytes")));
                return Found::End;
            }
            return if ended { Found::End } else { Found::Nothing };
        };
        self.next = Instant::now() + PAUSE;
        let line: Vec<u8> = self.text.drain(..=end).collect();
        let line = line.trim_ascii();
        if line.is_empty() {
            return Found::Nothing;
        }
        match self.read(line) {
            Ok(what) => {
                self.sequence += 1;
                Found::Line(what)
            }
            Err(why) => {
                self.tell(Err(why));
                Found::Nothing
            }
        }
    }

    fn read(&self, line: &[u8]) -> Result<BySocket, String> {
        let words = |error: serde_json::Error| format!("not understood: {error}");
        Ok(match self.content {
            Content::Obstacles => {
                let line: SetLine = serde_json::from_slice(line).map_err(words)?;
                BySocket::Obstacles(self.port, line.set(self.source_id, self.sequence)?)
            }
            Content::Targets => {
                let line: PointLine = serde_json::from_slice(line).map_err(words)?;
                BySocket::Target(self.port, line.point(self.source_id, self.sequence)?)
            }
        })
    }

    /// What became of a line.
    pub(super) fn hear(&mut self, fate: Result<(), RejectCause>) {
        self.tell(fate.map_err(|cause| cause.text().to_owned()));
    }

    pub(super) fn tell(&mut self, fate: Result<(), String>) {
        if self.told.as_ref() != Some(&fate) {
            match &fate {
                Ok(()) => tell(&self.stream, &Said::Taken),
                Err(why) => tell(&self.stream, &Said::Refused(why.clone())),
            }
            self.told = Some(fate);
        }
    }
}
