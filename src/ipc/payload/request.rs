//! What an operator asks for, and the answer.

use super::{Header, RefusalReason, RequestKind, SupervisorState, Target, Verdict};
use iceoryx2::prelude::ZeroCopySend;

/// Bytes of [`Response::text`].
pub const RESPONSE_TEXT: usize = 128;

/// Least share of the configured speed that may be asked for: 0 would be a hold that says nothing.
pub const SPEED_SCALE_MIN: f64 = 0.01;

/// Whether a share of the configured speed may be asked for.
pub fn is_speed_scale(scale: f64) -> bool {
    (SPEED_SCALE_MIN..=1.0).contains(&scale)
}

/// What an accepted speed means, for people.
pub fn speed_text(state: SupervisorState, scale: f64) -> String {
    let until = if scale < 1.0 { " until the arm is disarmed" } else { "" };
    format!("{}, at {} % of the configured speed{until}", state.text(), (1e4 * scale).round() / 100.0)
}

/// A request.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Request.v1")]
pub struct Request {
    /// Header.
    pub header: Header,
    /// [`RequestKind`].
    pub kind: u32,
    /// 0.
    pub reserved: u32,
    /// For [`RequestKind::SetTarget`]; otherwise ignored.
    pub target: Target,
    /// For [`RequestKind::Speed`]: speed over the configured one, [`SPEED_SCALE_MIN`] to 1; otherwise ignored.
    pub speed_scale: f64,
}

impl Request {
    /// A request without a target.
    pub fn new(kind: RequestKind) -> Self {
        Self { kind: kind.wire(), ..Self::default() }
    }

    /// A request for a share of the configured speed.
    pub fn speed(scale: f64) -> Self {
        Self { speed_scale: scale, ..Self::new(RequestKind::Speed) }
    }
}

impl Default for Request {
    fn default() -> Self {
        Self {
            header: Header::default(),
            kind: RequestKind::Status.wire(),
            reserved: 0,
            target: Target::default(),
            speed_scale: 1.0,
        }
    }
}

/// The answer to a request.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Response.v1")]
pub struct Response {
    /// Header; `sequence` is the request's.
    pub header: Header,
    /// [`Verdict`].
    pub verdict: u32,
    /// [`RefusalReason`].
    pub reason: u32,
    /// A number that belongs to the reason (e.g. the `RejectCause` of a bad target); 0 otherwise.
    pub detail: u32,
    /// [`SupervisorState`] after the request.
    pub supervisor: u32,
    /// Fault code, as in `State`.
    pub fault_code: u32,
    /// Detail of the fault, as in `State`.
    pub fault_detail: u32,
    /// Explanation for people, UTF-8, filled up with zeros.
    pub text: [u8; RESPONSE_TEXT],
}

impl Response {
    /// Writes the text, cut at a character boundary where it is too long.
    pub fn set_text(&mut self, text: &str) {
        let mut end = text.len().min(RESPONSE_TEXT);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        self.text = [0; RESPONSE_TEXT];
        self.text[..end].copy_from_slice(&text.as_bytes()[..end]);
    }

    /// The text; what is not UTF-8 is left out.
    pub fn text(&self) -> &str {
        let end = self.text.iter().position(|&b| b == 0).unwrap_or(RESPONSE_TEXT);
        match std::str::from_utf8(&self.text[..end]) {
            Ok(text) => text,
            Err(e) => std::str::from_utf8(&self.text[..e.valid_up_to()]).unwrap_or(""),
        }
    }

    /// Whether the request was accepted.
    pub fn is_accepted(&self) -> bool {
        self.verdict == Verdict::Accepted.wire()
    }
}

impl Default for Response {
    fn default() -> Self {
        Self {
            header: Header::default(),
            verdict: Verdict::Accepted.wire(),
            reason: RefusalReason::None.wire(),
            detail: 0,
            supervisor: SupervisorState::Disarmed.wire(),
            fault_code: 0,
            fault_detail: 0,
            text: [0; RESPONSE_TEXT],
        }
    }
}
