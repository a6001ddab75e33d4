//! SDO client: one transfer at a time with one server, as a state machine that is handed frames and the time.
//!
//! Enters: what shall be read or written, the server's frames, the time. Leaves: requests, and how the transfer ended.
//! It must never take an answer for that to another request: what does not fit the request outstanding in command
//! specifier, object and toggle bit is ignored and counted. An answer names only its object, so after a time-out, the
//! same object shall not be asked again before the server has been silent for a while ([`SdoClient::is_quiet`]).

use super::sdo::{AbortCode, Request, Response, Start, TRANSFER_LEN_MAX, expedited, segment};
use thiserror::Error;

/// Why a transfer failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SdoError {
    /// The server aborted.
    #[error("aborted by the node: {0}")]
    Aborted(AbortCode),
    /// The client aborted, because the server broke the protocol.
    #[error("aborted by the client: {0}")]
    Protocol(AbortCode),
    /// No response in time.
    #[error("no response within {timeout_ms} ms")]
    Timeout {
        /// Time waited for each response (ms).
        timeout_ms: u32,
    },
}

/// How a transfer stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing happened yet.
    Pending,
    /// The value that was read, empty for a write.
    Done(Vec<u8>),
    /// Failed.
    Failed(SdoError),
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Step {
    Idle,
    /// Initiate download sent.
    Download,
    /// Segment sent; `at` bytes were sent before it, `sent` including it.
    DownloadSegment {
        sent: usize,
        toggle: bool,
    },
    /// Initiate upload sent.
    Upload,
    /// Segment requested.
    UploadSegment {
        toggle: bool,
        announced: Option<u32>,
    },
}

/// The client's state. Allocates for the value; set-up only.
#[derive(Debug, Clone)]
pub struct SdoClient {
    step: Step,
    index: u16,
    sub: u8,
    data: Vec<u8>,
    /// Length that the object read has, where the caller knows it (bytes).
    expected: Option<usize>,
    timeout_ns: u64,
    deadline_ns: u64,
    /// Quiet from here on, unless a late answer comes.
    quiet_ns: u64,
    /// Quiet from here on, whatever comes.
    quiet_at_last_ns: u64,
    ignored: u64,
}

/// How many time-outs the silence is waited for that follows one.
const QUIET_TIMEOUTS_MAX: u64 = 10;

impl SdoClient {
    /// Idle; `timeout_ns` is granted for each response.
    pub fn new(timeout_ns: u64) -> Self {
        Self {
            step: Step::Idle,
            index: 0,
            sub: 0,
            data: Vec::new(),
            expected: None,
            timeout_ns,
            deadline_ns: 0,
            quiet_ns: 0,
            quiet_at_last_ns: 0,
            ignored: 0,
        }
    }

    /// Responses ignored, as they did not belong to the request outstanding.
    pub fn ignored(&self) -> u64 {
        self.ignored
    }

    /// False after a time-out, until the server has said nothing for as long as it is granted for a response; in any case
    /// true after ten times as long.
    pub fn is_quiet(&self, now_ns: u64) -> bool {
        now_ns >= self.quiet_ns.min(self.quiet_at_last_ns)
    }

    /// True while a transfer runs.
    pub fn is_busy(&self) -> bool {
        self.step != Step::Idle
    }

    /// Starts a read and returns the payload to send; a running transfer is forgotten. Of a server that does not indicate
    /// how many of an expedited answer's four bytes count, all four are taken.
    pub fn upload(&mut self, index: u16, sub: u8, now_ns: u64) -> [u8; 8] {
        self.begin(Step::Upload, index, sub, now_ns);
        Request::Upload { index, sub }.encode()
    }

    /// As [`Self::upload`], of an object that has this many bytes: so many are taken of an answer that does not indicate its
    /// size (e = 1, s = 0; CiA 301, 7.2.4.3.6), for what stands behind them is no part of the value.
    pub fn upload_sized(&mut self, index: u16, sub: u8, len: usize, now_ns: u64) -> [u8; 8] {
        let request = self.upload(index, sub, now_ns);
        self.expected = Some(len);
        request
    }

    /// Starts a write and returns the payload to send: expedited up to four bytes, else segmented.
    pub fn download(&mut self, index: u16, sub: u8, data: &[u8], now_ns: u64) -> [u8; 8] {
        self.begin(Step::Download, index, sub, now_ns);
        self.data.extend_from_slice(data);
        let start = if (1..=4).contains(&data.len()) {
            expedited(data)
        } else {
            Start::Segmented(u32::try_from(data.len()).ok())
        };
        Request::Download { index, sub, start }.encode()
    }

    fn begin(&mut self, step: Step, index: u16, sub: u8, now_ns: u64) {
        (self.step, self.index, self.sub) = (step, index, sub);
        self.data.clear();
        self.expected = None;
        self.deadline_ns = now_ns + self.timeout_ns;
    }

    /// Handles the payload of a response frame; the second value is a payload to send.
    pub fn on_response(&mut self, payload: &[u8], now_ns: u64) -> (Outcome, Option<[u8; 8]>) {
        let response = Response::decode(payload).filter(|response| self.is_expected(response));
        let Some(response) = response else {
            self.ignored += 1;
            self.quiet_ns = now_ns + self.timeout_ns;
            return (Outcome::Pending, None);
        };
        if let Response::Abort { code, .. } = response {
            self.step = Step::Idle;
            return (Outcome::Failed(SdoError::Aborted(code)), None);
        }
        match self.advance(response) {
            Ok(None) => {
                self.step = Step::Idle;
                (Outcome::Done(std::mem::take(&mut self.data)), None)
            }
            Ok(Some(next)) => {
                self.deadline_ns = now_ns + self.timeout_ns;
                (Outcome::Pending, Some(next.encode()))
            }
            Err(code) => {
                self.step = Step::Idle;
                let abort = Request::Abort { index: self.index, sub: self.sub, code };
                (Outcome::Failed(SdoError::Protocol(code)), Some(abort.encode()))
            }
        }
    }

    /// Next request, or `None` when the transfer is complete.
    fn advance(&mut self, response: Response) -> Result<Option<Request>, AbortCode> {
        match (self.step.clone(), response) {
            (Step::Download, Response::Download { .. }) => {
                if (1..=4).contains(&self.data.len()) {
                    self.data.clear();
                    return Ok(None);
                }
                Ok(Some(self.send_segment(0, false)))
            }
            (Step::DownloadSegment { sent, toggle }, Response::DownloadSegment(_)) => {
                if sent >= self.data.len() {
                    self.data.clear();
                    return Ok(None);
                }
                Ok(Some(self.send_segment(sent, !toggle)))
            }
            (Step::Upload, Response::Upload { start: Start::Expedited(len, bytes), .. }) => {
                let len = len.or(self.expected).unwrap_or(bytes.len()).min(bytes.len());
                self.data.extend_from_slice(&bytes[..len]);
                Ok(None)
            }
            (Step::Upload, Response::Upload { start: Start::Segmented(announced), .. }) => {
                if announced.is_some_and(|n| n as usize > TRANSFER_LEN_MAX) {
                    return Err(AbortCode::OUT_OF_MEMORY);
                }
                self.step = Step::UploadSegment { toggle: false, announced };
                Ok(Some(Request::UploadSegment(false)))
            }
            (Step::UploadSegment { toggle, announced }, Response::UploadSegment(s)) => {
                self.data.extend_from_slice(&s.data[..s.len]);
                if self.data.len() > TRANSFER_LEN_MAX {
                    return Err(AbortCode::OUT_OF_MEMORY);
                }
                if !s.last {
                    self.step = Step::UploadSegment { toggle: !toggle, announced };
                    return Ok(Some(Request::UploadSegment(!toggle)));
                }
                match announced {
                    Some(n) if n as usize != self.data.len() => Err(AbortCode::LENGTH),
                    _ => Ok(None),
                }
            }
            _ => Err(AbortCode::COMMAND), // what is not expected does not come here
        }
    }

    /// Whether a response answers the request outstanding. What does not is late, of a transfer given up, or doubled on
    /// its way; waiting on is right whichever it is, and what never comes is a time-out.
    fn is_expected(&self, response: &Response) -> bool {
        let ours = (self.index, self.sub);
        match (&self.step, *response) {
            (Step::Idle, _) => false,
            (Step::Upload, Response::Upload { index, sub, .. }) => (index, sub) == ours,
            (Step::Download, Response::Download { index, sub }) => (index, sub) == ours,
            (Step::UploadSegment { toggle, .. }, Response::UploadSegment(s)) => s.toggle == *toggle,
            (Step::DownloadSegment { toggle, .. }, Response::DownloadSegment(t)) => t == *toggle,
            // A server that has lost the transfer, by a restart for one, cannot name its object.
            (Step::UploadSegment { .. } | Step::DownloadSegment { .. }, Response::Abort { index: 0, sub: 0, .. }) => {
                true
            }
            (_, Response::Abort { index, sub, .. }) => (index, sub) == ours,
            _ => false,
        }
    }

    fn send_segment(&mut self, at: usize, toggle: bool) -> Request {
        let s = segment(&self.data, at, toggle);
        self.step = Step::DownloadSegment { sent: at + s.len, toggle };
        Request::DownloadSegment(s)
    }

    /// Time-out: the failure and the abort to send. The next transfer should wait until [`Self::is_quiet`].
    pub fn poll(&mut self, now_ns: u64) -> (Outcome, Option<[u8; 8]>) {
        if self.step == Step::Idle || now_ns < self.deadline_ns {
            return (Outcome::Pending, None);
        }
        self.step = Step::Idle;
        self.quiet_ns = now_ns + self.timeout_ns;
        self.quiet_at_last_ns = now_ns + QUIET_TIMEOUTS_MAX * self.timeout_ns;
        let abort = Request::Abort { index: self.index, sub: self.sub, code: AbortCode::TIMEOUT };
        #[allow(clippy::cast_possible_truncation)] // milliseconds of a time-out
        let timeout_ms = (self.timeout_ns / 1_000_000) as u32;
        (Outcome::Failed(SdoError::Timeout { timeout_ms }), Some(abort.encode()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::sdo::Segment;
    use super::super::sdo_server::{ObjectAccess, SdoServer};
    use super::*;
    use proptest::prelude::*;

    /// One object, 2000:01, of any bytes; 2000:02 is read-only.
    struct One(Vec<u8>);

    impl ObjectAccess for One {
        fn read(&mut self, index: u16, sub: u8) -> Result<Vec<u8>, AbortCode> {
            match (index, sub) {
                (0x2000, 1) => Ok(self.0.clone()),
                (0x2000, _) => Err(AbortCode::NO_SUB_INDEX),
                _ => Err(AbortCode::NO_OBJECT),
            }
        }
        fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
            self.check_write(index, sub)?;
            self.0 = data.to_vec();
            Ok(())
        }
        fn check_write(&mut self, index: u16, sub: u8) -> Result<(), AbortCode> {
            match (index, sub) {
                (0x2000, 1) => Ok(()),
                (0x2000, 2) => Err(AbortCode::READ_ONLY),
                _ => Err(AbortCode::NO_OBJECT),
            }
        }
        fn length(&self, _: u16, _: u8) -> Option<usize> {
            None
        }
    }

    fn run(client: &mut SdoClient, server: &mut SdoServer, objects: &mut One, first: [u8; 8]) -> Outcome {
        let mut next = Some(first);
        for _ in 0..400 {
            let Some(response) = next.and_then(|p| server.on_request(&p, objects)) else { break };
            let (outcome, reply) = client.on_response(&response, 0);
            if outcome != Outcome::Pending {
                return outcome;
            }
            next = reply;
        }
        Outcome::Pending
    }

    #[test]
    fn an_answer_without_its_size_is_as_long_as_the_object_is_known_to_be() {
        let answer = Response::Upload { index: 0x6061, sub: 0, start: Start::Expedited(None, [10, 1, 2, 3]) }.encode();
        let mut c = SdoClient::new(1000);
        let _ = c.upload_sized(0x6061, 0, 1, 0);
        assert_eq!(c.on_response(&answer, 0).0, Outcome::Done(vec![10]));
        // One that is longer cannot have come so: its four bytes are no such value.
        let _ = c.upload_sized(0x6061, 0, 8, 0);
        assert_eq!(c.on_response(&answer, 0).0, Outcome::Done(vec![10, 1, 2, 3]));
        let _ = c.upload(0x6061, 0, 0);
        assert_eq!(c.on_response(&answer, 0).0, Outcome::Done(vec![10, 1, 2, 3]));
        // What the server indicates counts, whatever was expected.
        let sized = Response::Upload { index: 0x6061, sub: 0, start: expedited(&[10, 1]) }.encode();
        let _ = c.upload_sized(0x6061, 0, 1, 0);
        assert_eq!(c.on_response(&sized, 0).0, Outcome::Done(vec![10, 1]));
    }

    proptest! {
        #[test]
        fn every_length_survives_writing_and_reading_back(value in proptest::collection::vec(any::<u8>(), 1..300)) {
            let (mut c, mut s, mut o) = (SdoClient::new(1000), SdoServer::new(), One(vec![]));
            let first = c.download(0x2000, 1, &value, 0);
            prop_assert_eq!(run(&mut c, &mut s, &mut o, first), Outcome::Done(vec![]));
            prop_assert_eq!(&o.0, &value);
            let first = c.upload(0x2000, 1, 0);
            prop_assert_eq!(run(&mut c, &mut s, &mut o, first), Outcome::Done(value));
        }

        #[test]
        fn arbitrary_frames_panic_neither_side(frames in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..9), 0..60)) {
            let (mut c, mut s, mut o) = (SdoClient::new(1000), SdoServer::new(), One(vec![1; 30]));
            for (i, f) in frames.iter().enumerate() {
                if i % 7 == 0 { let _ = c.upload(0x2000, 1, 0); }
                if i % 7 == 3 { let _ = c.download(0x2000, 1, &[7; 20], 0); }
                let _ = s.on_request(f, &mut o);
                let _ = c.on_response(f, 0);
            }
        }

        /// A server that answers in order, but late, often later than the client waits; a client that tries again when
        /// it is quiet. Each transfer ends with its own value or with a time-out, never with a broken protocol or with
        /// the answer to another request.
        #[test]
        fn late_answers_are_never_taken_for_those_to_another_request(
            lengths in proptest::collection::vec(1usize..20, 1..8),
            delays in proptest::collection::vec(prop_oneof![3 => 0u64..900, 1 => 900u64..2500], 1..60),
        ) {
            let (mut c, mut s, mut o) = (SdoClient::new(1000), SdoServer::new(), One(vec![0]));
            let mut delays = delays.iter().copied().cycle();
            let (mut now, mut busy_until) = (0u64, 0u64);
            // Requests on their way to the server, each with the time at which it will be answered.
            let mut inbox: std::collections::VecDeque<(u64, [u8; 8])> = Default::default();
            for (n, len) in lengths.iter().enumerate() {
                for write in [true, false] {
                    let value: Vec<u8> = (0..*len).map(|i| (n * 31 + i) as u8).collect();
                    for _ in 0..20 {
                        let first = if write { c.download(0x2000, 1, &value, now) } else { c.upload(0x2000, 1, now) };
                        let mut next = Some(first);
                        let outcome = loop {
                            if let Some(request) = next.take() {
                                busy_until = busy_until.max(now) + delays.next().unwrap();
                                inbox.push_back((busy_until, request));
                            }
                            now += 10;
                            let mut outcome = Outcome::Pending;
                            while outcome == Outcome::Pending && inbox.front().is_some_and(|(due, _)| *due <= now) {
                                let (_, request) = inbox.pop_front().unwrap();
                                if let Some(answer) = s.on_request(&request, &mut o) {
                                    let (ended, more) = c.on_response(&answer, now);
                                    outcome = ended;
                                    if let Some(request) = more {
                                        busy_until = busy_until.max(now) + delays.next().unwrap();
                                        inbox.push_back((busy_until, request));
                                    }
                                }
                            }
                            if outcome == Outcome::Pending {
                                let (ended, abort) = c.poll(now);
                                (outcome, next) = (ended, abort);
                            }
                            if outcome != Outcome::Pending {
                                if let Some(abort) = next.take() {
                                    busy_until = busy_until.max(now);
                                    inbox.push_back((busy_until, abort));
                                }
                                break outcome;
                            }
                        };
                        match outcome {
                            Outcome::Done(found) => {
                                prop_assert_eq!(&found, if write { &[][..] } else { &o.0 });
                                prop_assert!(!write || o.0 == value);
                                break;
                            }
                            Outcome::Failed(error) => prop_assert!(matches!(error, SdoError::Timeout { .. }), "{error:?}"),
                            Outcome::Pending => unreachable!(),
                        }
                        // Until it is quiet; what is under way meanwhile arrives.
                        while !c.is_quiet(now) || !inbox.is_empty() {
                            now += 10;
                            while inbox.front().is_some_and(|(due, _)| *due <= now) {
                                let (_, request) = inbox.pop_front().unwrap();
                                if let Some(answer) = s.on_request(&request, &mut o) {
                                    prop_assert_eq!(c.on_response(&answer, now), (Outcome::Pending, None));
                                }
                            }
                        }
                    }
                }
            }
        }

        #[test]
        fn requests_and_responses_round_trip(bytes: [u8; 8]) {
            if let Some(r) = Request::decode(&bytes) {
                prop_assert_eq!(Request::decode(&r.encode()), Some(r));
            }
            if let Some(r) = Response::decode(&bytes) {
                prop_assert_eq!(Response::decode(&r.encode()), Some(r));
            }
        }
    }

    #[test]
    fn aborts_carry_their_reason() {
        let (mut c, mut s, mut o) = (SdoClient::new(1000), SdoServer::new(), One(vec![]));
        for (index, sub, code) in [(0x2000, 2, AbortCode::READ_ONLY), (0x3000, 0, AbortCode::NO_OBJECT)] {
            for value in [&[1u8, 2][..], &[0; 20]] {
                let first = c.download(index, sub, value, 0);
                assert_eq!(run(&mut c, &mut s, &mut o, first), Outcome::Failed(SdoError::Aborted(code)));
            }
        }
        assert!(AbortCode::READ_ONLY.to_string().contains("read-only"));
    }

    #[test]
    fn a_repeated_segment_aborts_with_the_toggle_code() {
        let (mut s, mut o) = (SdoServer::new(), One(vec![9; 30]));
        let up = |t| Request::UploadSegment(t).encode();
        assert!(s.on_request(&Request::Upload { index: 0x2000, sub: 1 }.encode(), &mut o).is_some());
        assert!(s.on_request(&up(false), &mut o).is_some());
        let again = s.on_request(&up(false), &mut o).unwrap();
        let expected = Response::Abort { index: 0x2000, sub: 1, code: AbortCode::TOGGLE };
        assert_eq!(Response::decode(&again), Some(expected));
    }

    #[test]
    fn silence_times_out_and_aborts() {
        let mut c = SdoClient::new(5_000_000);
        let _ = c.upload(0x1000, 0, 100);
        assert_eq!(c.poll(5_000_099), (Outcome::Pending, None));
        let (outcome, abort) = c.poll(5_000_100);
        assert_eq!(outcome, Outcome::Failed(SdoError::Timeout { timeout_ms: 5 }));
        assert_eq!(abort.unwrap()[0], 0x80);
        assert!(!c.is_busy());
    }

    #[test]
    fn after_a_time_out_it_is_quiet_when_nothing_came_for_as_long_or_at_the_latest_after_ten_times_that() {
        let mut c = SdoClient::new(1000);
        assert!(c.is_quiet(0));
        let _ = c.upload(0x1000, 0, 0);
        assert!(c.poll(1000).1.is_some());
        assert!(!c.is_quiet(1999) && c.is_quiet(2000));
        let late = Response::Upload { index: 0x1000, sub: 0, start: Start::Expedited(Some(4), [1; 4]) }.encode();
        assert_eq!(c.on_response(&late, 1500), (Outcome::Pending, None));
        assert!(!c.is_quiet(2499) && c.is_quiet(2500));
        (0..100).for_each(|i| drop(c.on_response(&late, 2000 + 100 * i)));
        assert!(!c.is_quiet(10_999) && c.is_quiet(11_000));
        assert_eq!(c.ignored(), 101);
    }

    #[test]
    fn what_does_not_answer_the_request_outstanding_is_ignored_and_counted() {
        let mut c = SdoClient::new(1000);
        let upload = |index, start| Response::Upload { index, sub: 0, start };
        let one = Start::Expedited(Some(1), [1, 0, 0, 0]);
        let abort = |index, code| Response::Abort { index, sub: 0, code };
        let s = |toggle, last| Segment { toggle, len: 1, data: [9; 7], last };
        let refuses = |c: &mut SdoClient, responses: &[Response]| {
            for r in responses {
                let before = c.ignored();
                assert_eq!(c.on_response(&r.encode(), 1), (Outcome::Pending, None), "{r:?}");
                assert_eq!((c.ignored(), c.is_busy()), (before + 1, true), "{r:?}");
            }
        };
        let other = [abort(0x1000, AbortCode::TIMEOUT), abort(0, AbortCode::COMMAND), upload(0x1000, one)];
        let segments = [Response::UploadSegment(s(false, true)), Response::DownloadSegment(false)];
        let download = Response::Download { index: 0x6041, sub: 0 };
        let _ = c.upload(0x6041, 0, 0);
        refuses(&mut c, &other);
        refuses(&mut c, &segments);
        refuses(&mut c, &[download]);
        // Segmented: the first segment's toggle bit is 0.
        assert!(c.on_response(&upload(0x6041, Start::Segmented(None)).encode(), 1).1.is_some());
        refuses(&mut c, &[upload(0x6041, one), Response::UploadSegment(s(true, true)), download, other[0]]);
        assert!(c.on_response(&Response::UploadSegment(s(false, false)).encode(), 1).1.is_some());
        refuses(&mut c, &[Response::UploadSegment(s(false, true))]);
        let last = Response::UploadSegment(s(true, true)).encode();
        assert_eq!(c.on_response(&last, 1), (Outcome::Done(vec![9, 9]), None));
        // A server that was restarted in between.
        let _ = c.upload(0x6041, 0, 0);
        let _ = c.on_response(&upload(0x6041, Start::Segmented(None)).encode(), 1);
        let lost = c.on_response(&abort(0, AbortCode::COMMAND).encode(), 1).0;
        assert_eq!(lost, Outcome::Failed(SdoError::Aborted(AbortCode::COMMAND)));
    }

    #[test]
    fn a_late_answer_to_another_object_is_ignored() {
        let mut c = SdoClient::new(1000);
        let _ = c.upload(0x6041, 0, 0);
        let late = Response::Upload { index: 0x1000, sub: 0, start: Start::Expedited(Some(4), [1; 4]) };
        assert_eq!(c.on_response(&late.encode(), 1), (Outcome::Pending, None));
        assert!(c.is_busy());
    }
}
