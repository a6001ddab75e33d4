use super::server::{Desk, OperatorSocket};
use super::*;
use crate::config::{AccessConfig, Who};
use crate::daemon::DaemonError;
use crate::ipc::payload::{RefusalReason, SupervisorState};
use crate::ipc::{ChannelCapacity, ControlInputs, ControlOutputs, Reply, channels};
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::UnixListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

const WAIT: Duration = Duration::from_secs(20);
const OPEN: AccessConfig = AccessConfig { stop: None, see: None };

/// A desk whose control thread's ends are in the test's hands.
struct Bench {
    address: Address,
    _place: tempfile::TempDir,
    inputs: ControlInputs,
    outputs: ControlOutputs,
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
        let (inputs, outputs, _, direct) = channels(24, 4, &[], ChannelCapacity::default());
        let (to, status) = sync_channel(4);
        let desk = Desk::new(OperatorSocket::bind(&address, &OPEN).unwrap(), direct, to);
        let stop = Arc::new(AtomicBool::new(false));
        let thread = Some(std::thread::spawn({
            let stop = stop.clone();
            move || desk.run(&stop)
        }));
        Self { address, _place: place, inputs, outputs, status, stop, thread }
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
fn a_control_thread_that_does_not_answer_is_told_as_such() {
    let bench = Bench::new();
    let Said::Answer(answer) = bench.address.ask(Word::Stop, WAIT).unwrap() else { panic!("no answer") };
    assert_eq!((answer.accepted, answer.reason), (false, RefusalReason::NoAnswer.wire()));
}

#[test]
fn words_come_by_hand_too_and_what_is_none_is_told() {
    let mut bench = Bench::new();
    for bad in [b"halt\n".as_slice(), b"stop it\n", &[b'x'; 200], b"\n", b"stop\0\n", &[0xff; 64]] {
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
        assert_eq!(Word::parse(Word::Speed(scale).line().as_bytes()), Ok(Word::Speed(scale)));
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
    let nobody = AccessConfig { stop: Some(Vec::new()), see: Some(Vec::new()) };
    let socket = OperatorSocket::bind(&address, &nobody).unwrap();
    assert_eq!(fs::metadata(socket.path()).unwrap().mode() & 0o777, 0o600);
    drop(socket);
    let unknown = AccessConfig { stop: Some(vec![Who::Group("no-such-group".into())]), see: None };
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
