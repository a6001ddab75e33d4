use super::server::{Desk, OperatorSocket};
use super::*;
use crate::config::{AccessConfig, Who};
use crate::daemon::DaemonError;
use crate::ipc::payload::{Obstacle, RefusalReason, RejectCause, SupervisorState};
use crate::ipc::{BySocket, ChannelCapacity, ControlInputs, ControlOutputs, IoEnds, Reply, ToSocket, channels};
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::UnixListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

const WAIT: Duration = Duration::from_secs(20);
const OPEN: AccessConfig = AccessConfig { stop: None, see: None, command: Vec::new(), publish: Vec::new() };

/// A desk whose control thread's ends are in the test's hands.
struct Bench {
    address: Address,
    _place: tempfile::TempDir,
    inputs: ControlInputs,
    outputs: ControlOutputs,
    io: IoEnds,
    status: Receiver<UnixStream>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

fn address(place: &tempfile::TempDir) -> Address {
    Address::new(&Domain::new("operator-test", "/nowhere/"), "arm", Some(place.path()))
}

impl Bench {
    fn new() -> Self {
        let place = tempfile::tempdir().unwrap();
        let address = address(&place);
        let (inputs, outputs, io, direct) = channels(24, 4, &[], ChannelCapacity::default());
        let (to, status) = sync_channel(4);
        let desk = Desk::new(OperatorSocket::bind(&address, &OPEN).unwrap(), direct, to, Vec::new());
        let stop = Arc::new(AtomicBool::new(false));
        let thread = Some(std::thread::spawn({
            let stop = stop.clone();
            move || desk.run(&stop)
        }));
        Self { address, _place: place, inputs, outputs, io, status, stop, thread }
    }

    fn asks(&self, word: Word) -> JoinHandle<Said> {
        let address = self.address.clone();
        std::thread::spawn(move || address.ask(word, WAIT).unwrap())
    }

    /// Answers the next command as the control thread does.
    fn answer(&mut self, refused: Option<RefusalReason>) -> RequestKind {
        let deadline = Instant::now() + WAIT;
        let command = loop {
            if let Some(command) = self.inputs.next_command() {
                break command;
            }
            assert!(Instant::now() < deadline, "no command came");
            std::thread::yield_now();
        };
        let state = SupervisorState::Stopping;
        let accepted = Reply::accepted(&command, state);
        self.outputs.reply(refused.map_or(accepted, |reason| Reply::refused(&command, state, reason)));
        command.kind
    }

    /// The next word for the I/O thread.
    fn for_io(&mut self) -> BySocket {
        let deadline = Instant::now() + WAIT;
        loop {
            if let Ok(what) = self.io.by_socket.pop() {
                return what;
            }
            assert!(Instant::now() < deadline, "nothing came");
            std::thread::yield_now();
        }
    }

    fn says(&self, text: &[u8]) -> String {
        let mut stream = open(&self.address.path_in(self._place.path())).unwrap();
        stream.set_read_timeout(Some(WAIT)).unwrap();
        stream.write_all(text).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(ended.is_none_or(|e| e.is_ok()) || std::thread::panicking());
    }
}

#[test]
fn an_order_reaches_the_control_thread_and_its_answer_comes_back() {
    let mut bench = Bench::new();
    for (word, kind) in
        [(Word::Stop, RequestKind::Stop), (Word::Hold, RequestKind::Hold), (Word::Disarm, RequestKind::Disarm)]
    {
        let asking = bench.asks(word);
        assert_eq!(bench.answer(None), kind);
        let Said::Answer(answer) = asking.join().unwrap() else { panic!("no answer") };
        assert!(answer.accepted && answer.response().is_accepted(), "{answer:?}");
        assert_eq!((answer.asked.as_str(), answer.text.as_str()), (word.text(), "stopping"));
    }
    let asking = bench.asks(Word::Speed(0.25));
    assert_eq!(bench.answer(None), RequestKind::Speed);
    let Said::Answer(answer) = asking.join().unwrap() else { panic!("no answer") };
    assert_eq!(answer.text, "stopping, at 25 % of the configured speed until the arm is disarmed");
    let asking = bench.asks(Word::Hold);
    bench.answer(Some(RefusalReason::Faulted));
    let Said::Answer(answer) = asking.join().unwrap() else { panic!("no answer") };
    assert!(!answer.response().is_accepted());
    assert!(answer.text.contains("sinew clear"), "{answer:?}");
}

#[test]
fn a_report_is_made_by_somebody_else_and_orders_do_not_wait_for_it() {
    let mut bench = Bench::new();
    let _reports = [bench.asks(Word::Status), bench.asks(Word::Status)];
    let asking = bench.asks(Word::Stop);
    assert_eq!(bench.answer(None), RequestKind::Stop);
    assert!(matches!(asking.join().unwrap(), Said::Answer(_)), "while nobody makes reports");
    for _ in 0..2 {
        let mut stream = bench.status.recv_timeout(WAIT).unwrap();
        stream.write_all(br#"{"refused":"later"}"#).unwrap();
    }
}

#[test]
fn what_moves_the_arm_goes_through_the_io_thread_and_so_does_a_target() {
    let mut bench = Bench::new();
    for (word, kind) in
        [(Word::Arm, RequestKind::Arm), (Word::Track, RequestKind::Track), (Word::Clear, RequestKind::Clear)]
    {
        let asking = bench.asks(word);
        let BySocket::Ask(ticket, request) = bench.for_io() else { panic!("no request") };
        assert_eq!(request.kind, kind.wire());
        bench.io.to_socket.push(ToSocket::Answer(ticket, Response::default())).unwrap();
        let Said::Answer(answer) = asking.join().unwrap() else { panic!("no answer") };
        assert!(answer.accepted && answer.asked == word.text(), "{answer:?}");
    }
    let address = bench.address.clone();
    let target = Target { position_m: [0.1, 0.2, -2.0], ..Target::default() };
    let asking = std::thread::spawn(move || address.set_target(&target, WAIT).unwrap());
    let BySocket::Ask(ticket, request) = bench.for_io() else { panic!("no request") };
    assert_eq!((request.kind, request.target.position_m), (RequestKind::SetTarget.wire(), [0.1, 0.2, -2.0]));
    bench.io.to_socket.push(ToSocket::Answer(ticket, Response::default())).unwrap();
    assert!(matches!(asking.join().unwrap(), Said::Answer(Answer { accepted: true, .. })));
    assert!(bench.says(b"target {\"position_m\":[0,0]}\n").contains("target: "));
}

#[test]
fn whoever_publishes_is_heard_line_by_line_and_told_what_changes() {
    let mut bench = Bench::new();
    let mut publisher = bench.address.publisher(7, WAIT).unwrap();
    let heard = |publisher: &mut SocketPublisher| {
        let deadline = Instant::now() + WAIT;
        loop {
            if let Some(heard) = publisher.heard().unwrap() {
                return heard;
            }
            assert!(Instant::now() < deadline, "nothing was said");
            std::thread::yield_now();
        }
    };
    let mut set = Obstacles::default();
    assert!(set.push(Obstacle::ball(3, [1.0, 0.0, -1.0], 0.2)));
    let mut ports = Vec::new();
    for (sequence, fate) in [Ok(()), Ok(()), Err(RejectCause::Future), Ok(())].into_iter().enumerate() {
        publisher.publish(&set).unwrap();
        let BySocket::Obstacles(port, got) = bench.for_io() else { panic!("no set") };
        assert_eq!((got.header.source_id, got.header.sequence), (7, sequence as u64));
        assert_eq!(got.used(), set.used());
        ports.push(port);
        bench.io.to_socket.push(ToSocket::Fate(port, fate)).unwrap();
        match (sequence, fate) {
            (1, _) => {}
            (_, Ok(())) => assert_eq!(heard(&mut publisher), Ok(())),
            (_, Err(cause)) => assert_eq!(heard(&mut publisher), Err(cause.text().to_owned())),
        }
    }
    ports.dedup();
    assert_eq!(ports.len(), 1);
    // Rubbish is told and ends nothing; a line without an end ends all.
    publisher.line.stream.set_nonblocking(false).unwrap();
    publisher.line.stream.write_all(b"{\"obstacles\": 5}\n").unwrap();
    publisher.line.stream.set_nonblocking(true).unwrap();
    assert!(heard(&mut publisher).unwrap_err().contains("not understood"));
    publisher.publish(&set).unwrap();
    assert!(matches!(bench.for_io(), BySocket::Obstacles(..)));
    publisher.line.stream.set_nonblocking(false).unwrap();
    let _ = publisher.line.stream.write_all(&[b' '; 200 << 10]);
    assert!(matches!(bench.for_io(), BySocket::Gone(port) if port == ports[0]));
    for bad in ["publish obstacles\n", "publish obstacles x\n", "publish balls 7\n"] {
        assert!(bench.says(bad.as_bytes()).contains("expected a line"), "{bad}");
    }
}

#[test]
fn nobody_takes_the_places_of_all_who_publish() {
    let mut bench = Bench::new();
    let mut streams: Vec<_> = (0..16).map(|id| bench.address.publisher(id, WAIT).unwrap()).collect();
    for stream in &mut streams {
        stream.publish(&Obstacles::default()).unwrap();
        assert!(matches!(bench.for_io(), BySocket::Obstacles(..)));
    }
    assert!(bench.says(b"publish obstacles 99\n").contains("all places"));
    // Orders have places of their own, and so have sources that must be there.
    let asking = bench.asks(Word::Status);
    let mut stream = bench.status.recv_timeout(WAIT).unwrap();
    stream.write_all(br#"{"refused":"later"}"#).unwrap();
    drop(stream);
    assert!(matches!(asking.join().unwrap(), Said::Refused(_)));
}

#[test]
fn a_control_thread_that_does_not_answer_is_told_as_such() {
    let bench = Bench::new();
    let Said::Answer(answer) = bench.address.ask(Word::Stop, WAIT).unwrap() else { panic!("no answer") };
    assert_eq!((answer.accepted, answer.reason), (false, RefusalReason::NoAnswer.wire()));
}

#[test]
fn words_come_by_hand_too_and_what_is_none_is_told() {
    let mut bench = Bench::new();
    for bad in [b"halt\n".as_slice(), b"stop it\n", &[b'x'; 5000], b"\n", b"stop\0\n", &[0xff; 4096]] {
        assert!(bench.says(bad).contains("expected a line"), "{bad:?}");
    }
    let path = bench.address.path_in(bench._place.path());
    let by_hand = std::thread::spawn(move || {
        let mut stream = open(&path).unwrap();
        stream.set_read_timeout(Some(WAIT)).unwrap();
        stream.write_all(b" stop \r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    });
    assert_eq!(bench.answer(None), RequestKind::Stop);
    assert!(by_hand.join().unwrap().contains(r#""accepted":true"#));
}

#[test]
fn a_speed_is_a_share_or_per_cent_and_anything_else_is_told_with_what_is_permitted() {
    for (text, scale) in [("50%", 0.5), ("0.5", 0.5), ("1%", 0.01), (" 100 % ", 1.0), ("1", 1.0), ("12.5%", 0.125)] {
        assert_eq!(parse_speed(text), Ok(scale), "{text}");
        assert_eq!(Word::parse(&Word::Speed(scale).line()), Some(Ok(Word::Speed(scale))));
    }
    for bad in ["0", "0%", "0.5%", "101%", "1.01", "-0.5", "50", "half", "", "%", "nan", "inf", "1e400", "0.5 0.5"] {
        let why = parse_speed(bad).unwrap_err();
        assert!(why.contains(bad) && why.contains("1% to 100%"), "{why}");
    }
    let mut bench = Bench::new();
    for bad in [b"speed 150%\n".as_slice(), b"speed\n", b"speed fast\n", b"speed NaN\n"] {
        let said = bench.says(bad);
        assert!(said.contains("refused") && said.contains("expected"), "{said}");
    }
    assert!(bench.inputs.next_command().is_none(), "nothing of it reaches the control thread");
}

#[test]
fn those_who_say_nothing_keep_nobody_out() {
    let mut bench = Bench::new();
    let path = bench.address.path_in(bench._place.path());
    let silent: Vec<_> = (0..200).map(|_| open(&path).unwrap()).collect();
    let asking = bench.asks(Word::Stop);
    assert_eq!(bench.answer(None), RequestKind::Stop);
    assert!(matches!(asking.join().unwrap(), Said::Answer(Answer { accepted: true, .. })));
    drop(silent);
}

#[test]
fn the_socket_is_there_once_and_gone_afterwards_and_what_a_killed_daemon_left_is_replaced() {
    let place = tempfile::tempdir().unwrap();
    let address = address(&place);
    let path = address.path_in(place.path());
    fs::create_dir(path.parent().unwrap()).unwrap();
    // As after SIGKILL: a file that nobody listens on.
    drop(UnixListener::bind(&path).unwrap());
    assert!(matches!(address.ask(Word::Status, WAIT), Err(OperatorError::NoDaemon(_))));
    let socket = OperatorSocket::bind(&address, &OPEN).unwrap();
    assert!(matches!(OperatorSocket::bind(&address, &OPEN), Err(DaemonError::Ipc(IpcError::AlreadyRunning { .. }))));
    assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o660, "for the own group");
    drop(socket);
    assert!(!path.exists() && !path.parent().unwrap().exists());
    let nobody = AccessConfig { stop: Some(Vec::new()), see: Some(Vec::new()), ..OPEN };
    let socket = OperatorSocket::bind(&address, &nobody).unwrap();
    assert_eq!(fs::metadata(socket.path()).unwrap().mode() & 0o777, 0o600);
    drop(socket);
    let unknown = AccessConfig { stop: Some(vec![Who::Group("no-such-group".into())]), ..OPEN };
    let error = OperatorSocket::bind(&address, &unknown).unwrap_err().to_string();
    assert!(error.contains("[access] stop") && error.contains("no-such-group"), "{error}");
}

#[test]
fn a_folder_that_others_can_write_to_is_neither_listened_in_nor_believed() {
    let place = tempfile::tempdir().unwrap();
    let address = address(&place);
    let socket = OperatorSocket::bind(&address, &OPEN).unwrap();
    fs::set_permissions(place.path(), fs::Permissions::from_mode(0o777)).unwrap();
    let error = address.ask(Word::Stop, WAIT).unwrap_err().to_string();
    assert!(error.contains("others may write"), "{error}");
    drop(socket);
    let error = OperatorSocket::bind(&address, &OPEN).unwrap_err().to_string();
    assert!(error.contains("others may write"), "{error}");
}

#[test]
fn domains_and_arms_have_sockets_of_their_own() {
    let run = Path::new("/run/x");
    let path = |domain: &Domain, arm| Address::new(domain, arm, Some(run)).path_in(run);
    assert_eq!(path(&Domain::default(), "paper"), Path::new("/run/x/paper/control"));
    let (a, b) = (Domain::new("a_", "/tmp/r/"), Domain::new("b_", "/tmp/r/"));
    assert_ne!(path(&a, "paper"), path(&b, "paper"));
    // The longest that a configuration permits fits into the address of a socket (108 bytes).
    let longest = Path::new("/").join("r".repeat(47));
    let path = Address::new(&a, &"n".repeat(32), Some(&longest)).path_in(&longest);
    assert!(path.as_os_str().len() < 108, "{}", path.display());
}
