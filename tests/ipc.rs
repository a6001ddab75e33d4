//! Claims about shared memory, with real services and real processes.
// The lint's exception for tests does not reach the helpers of an integration test.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use sinew::ipc::intake::{InputLimits, ObstacleDemand, TrackedSet};
use sinew::ipc::payload::{
    Encoders, Header, Obstacle, Obstacles, RefusalReason, RejectCause, Request, RequestKind, State, SupervisorState,
    Target,
};
use sinew::ipc::{
    ChannelCapacity, Client, Command as OperatorCommand, ControlInputs, ControlOutputs, DaemonPorts, Domain, IoLimits,
    IoThread, IpcError, LockstepSources, Pace, Reply, Tap, channels, monotonic_ns,
};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Once};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const ARM: &str = "test-arm";
const WAIT: Duration = Duration::from_secs(10);

/// A domain of its own that must be empty at the end.
struct Isolated {
    domain: Domain,
    prefix: String,
    root: tempfile::TempDir,
}

impl Isolated {
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let prefix = format!("sinewtest{}_{}_", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let root = tempfile::tempdir().unwrap();
        let domain = Domain::new(prefix.clone(), format!("{}/", root.path().display()));
        Self { domain, prefix, root }
    }

    fn leftovers(&self) -> Vec<PathBuf> {
        let mut found = files_below(self.root.path());
        let shm = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.path());
        found.extend(shm.filter(|p| p.file_name().unwrap().to_string_lossy().starts_with(&self.prefix)));
        found
    }
}

impl Drop for Isolated {
    fn drop(&mut self) {
        // Processes that the test killed could not clean up behind themselves; whoever comes last does.
        self.domain.sweep();
        if !std::thread::panicking() {
            assert_eq!(self.leftovers(), Vec::<PathBuf>::new());
        }
    }
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries.flatten().flat_map(|e| if e.path().is_dir() { files_below(&e.path()) } else { vec![e.path()] }).collect()
}

/// The daemon's I/O side with the control thread's ends in the test's hands.
struct Daemon {
    inputs: ControlInputs,
    outputs: ControlOutputs,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

fn limits() -> IoLimits {
    // Generous, because the machine may be busy; staleness itself is tested without a clock.
    let generous = InputLimits { stale_after_s: 5.0, hold_after_s: 10.0, ..InputLimits::default() };
    IoLimits { obstacles: generous, target: generous, encoders: generous, tip: generous }
}

impl Daemon {
    fn start(domain: &Domain, pace: Pace) -> Self {
        Self::start_with(domain, pace, (), monotonic_ns)
    }

    fn start_with(
        domain: &Domain,
        pace: Pace,
        tap: impl Tap + 'static,
        now: impl Fn() -> u64 + Send + 'static,
    ) -> Self {
        let ports = DaemonPorts::create(domain, ARM).unwrap();
        let (inputs, outputs, ends, _) = channels(24, 4, &[], ChannelCapacity::default());
        let stop = Arc::new(AtomicBool::new(false));
        let flag = stop.clone();
        let thread = std::thread::spawn(move || IoThread::new(ports, ends, limits(), tap).run(pace, &flag, now));
        Self { inputs, outputs, stop, thread: Some(thread) }
    }

    /// Answers every command as `reply` says, until a request made meanwhile has its response.
    fn while_answering<T: Send>(
        &mut self,
        reply: impl Fn(&OperatorCommand) -> Reply,
        request: impl FnOnce() -> T + Send,
    ) -> T {
        std::thread::scope(|scope| {
            let asking = scope.spawn(request);
            while !asking.is_finished() {
                if let Some(command) = self.inputs.next_command() {
                    assert!(self.outputs.reply(reply(&command)));
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            asking.join().unwrap()
        })
    }

    /// Waits until the control thread's view meets a condition.
    fn until(&mut self, what: &str, condition: impl Fn(&ControlInputs) -> bool) {
        let deadline = Instant::now() + WAIT;
        loop {
            self.inputs.update();
            if condition(&self.inputs) {
                return;
            }
            assert!(Instant::now() < deadline, "waited in vain for: {what}");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn sources(inputs: &ControlInputs) -> Vec<u32> {
        let mut tracked = TrackedSet::new();
        inputs.obstacles().track_into(monotonic_ns(), 0.1, &limits().obstacles, &mut tracked);
        let mut sources: Vec<u32> = tracked.as_slice().iter().map(|o| o.source_id).collect();
        sources.sort_unstable();
        sources
    }

    fn report(&mut self) -> State {
        self.inputs.update();
        let mut state = State::default();
        self.inputs.obstacles().report_into(monotonic_ns(), &limits().obstacles, &mut state);
        state
    }

    fn stop(mut self) {
        self.stop.store(true, Ordering::Release);
        self.thread.take().unwrap().join().unwrap();
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
    }
}

fn ball_set(id: u32) -> Obstacles {
    let mut set = Obstacles::default();
    assert!(set.push(Obstacle::ball(id, [0.4, 0.1, -1.2], 0.1)));
    set
}

/// Path of a compiled example, beside this test's own program; built first where only this test was.
fn example(name: &str) -> PathBuf {
    static BUILD: Once = Once::new();
    let test = std::env::current_exe().unwrap();
    let profile = test.parent().unwrap().parent().unwrap();
    BUILD.call_once(|| {
        let mut build = Command::new(env!("CARGO"));
        build.args(["build", "--quiet", "--examples", "--target-dir"]).arg(profile.parent().unwrap());
        if profile.ends_with("release") {
            build.arg("--release");
        }
        assert!(build.current_dir(env!("CARGO_MANIFEST_DIR")).status().unwrap().success());
    });
    profile.join("examples").join(name)
}

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Asks a process to end, and waits until it has: killed while it cleans up, it would leave its files.
fn terminate(mut process: Running) {
    let status = Command::new("kill").args(["-TERM", &process.0.id().to_string()]).status().unwrap();
    assert!(status.success());
    let deadline = Instant::now() + WAIT;
    while process.0.try_wait().unwrap().is_none() {
        assert!(Instant::now() < deadline, "it does not end");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn spawn_rust_client(domain: &Domain, source: u32, rate: f64) -> Running {
    let mut command = Command::new(example("obstacle_client"));
    command.args(["--arm", ARM, "--source", &source.to_string(), "--rate", &rate.to_string()]);
    Running(command.envs(domain.env()).stdout(Stdio::null()).spawn().unwrap())
}

#[test]
fn inputs_reach_the_control_thread_and_records_come_back() {
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let client = Client::connect(&isolated.domain, ARM).unwrap();

    // A publisher that is gone before the subscriber looks takes its message along: they live to the end.
    let mut obstacles = client.obstacles(7).unwrap();
    obstacles.publish(&mut ball_set(3), monotonic_ns()).unwrap();
    let mut target = Target { position_m: [0.1, 0.2, -2.4], ..Target::default() };
    let mut targets = client.targets(1).unwrap();
    targets.publish(&mut target, monotonic_ns()).unwrap();
    let mut encoders = Encoders { length_m: [0.65; 96], ..Encoders::default() };
    encoders.set_all_valid(24);
    let mut encoder_source = client.encoders(1).unwrap();
    encoder_source.publish(&mut encoders, monotonic_ns()).unwrap();

    daemon.until("obstacles", |i| Daemon::sources(i) == [7]);
    daemon.until("target", |i| {
        i.target().sample(monotonic_ns(), &limits().target).is_some_and(|s| s.position_m == [0.1, 0.2, -2.4])
    });
    daemon.until("encoders", |i| i.encoders().latest().is_some_and(|e| e.length_m[23] == 0.65));

    let states = client.states().unwrap();
    let mut state = State { header: Header::new(0, 1, monotonic_ns()), cable_count: 24, ..State::default() };
    state.tension_command_n[23] = 42.0;
    assert!(daemon.outputs.record(&mut state));
    let seen = states.wait(WAIT).unwrap().expect("a record");
    assert_eq!((seen.header.sequence, seen.tension_command_n[23]), (1, 42.0));
    daemon.stop();
}

#[test]
fn nothing_is_left_behind() {
    let isolated = Isolated::new();
    {
        let daemon = Daemon::start(&isolated.domain, Pace::default());
        let client = Client::connect(&isolated.domain, ARM).unwrap();
        let mut publisher = client.obstacles(7).unwrap();
        // The port outlives its client.
        drop(client);
        publisher.publish(&mut ball_set(3), monotonic_ns()).unwrap();
        assert!(!isolated.leftovers().is_empty(), "the check sees the files of a running daemon");
        daemon.stop();
    }
    assert_eq!(isolated.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn without_a_daemon_the_client_says_so() {
    let isolated = Isolated::new();
    let error = Client::connect(&isolated.domain, ARM).unwrap_err();
    assert!(matches!(error, IpcError::NoDaemon { .. }), "{error}");
    assert!(error.to_string().contains("no daemon running for arm \"test-arm\""), "{error}");

    // Also when another client keeps the services alive.
    let daemon = Daemon::start(&isolated.domain, Pace::default());
    let mut old = Client::connect(&isolated.domain, ARM).unwrap();
    daemon.stop();
    assert!(matches!(Client::connect(&isolated.domain, ARM), Err(IpcError::NoDaemon { .. })));
    assert!(matches!(old.ask(RequestKind::Status, WAIT), Err(IpcError::NoDaemon { .. })));
    // And that client goes on with the next daemon.
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let mut publisher = old.obstacles(7).unwrap();
    publisher.publish(&mut ball_set(1), monotonic_ns()).unwrap();
    daemon.until("obstacles of the old client", |i| Daemon::sources(i) == [7]);
    daemon.stop();
}

#[test]
fn a_second_daemon_for_the_same_arm_is_refused() {
    let isolated = Isolated::new();
    let daemon = Daemon::start(&isolated.domain, Pace::default());
    let error = DaemonPorts::create(&isolated.domain, ARM).unwrap_err();
    assert!(matches!(error, IpcError::AlreadyRunning { .. }), "{error}");
    DaemonPorts::create(&isolated.domain, "another-arm").expect("another arm is another daemon");
    daemon.stop();
}

#[test]
fn requests_are_answered_by_the_control_thread() {
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let domain = isolated.domain.clone();
    let operator = std::thread::spawn(move || {
        let mut client = Client::connect(&domain, ARM).unwrap();
        let arm = client.ask(RequestKind::Arm, WAIT).unwrap();
        let track = client.ask(RequestKind::Track, WAIT).unwrap();
        let unknown = client.request(Request { kind: 99, ..Request::default() }, WAIT).unwrap();
        let bad = Target { position_m: [f64::NAN; 3], ..Target::default() };
        let bad = client.set_target(5, bad, WAIT).unwrap();
        for scale in [0.0, 0.009, 1.001, -0.5, f64::NAN, f64::INFINITY] {
            let refused = client.request(Request::speed(scale), WAIT).unwrap();
            assert_eq!(refused.reason, RefusalReason::BadSpeed.wire(), "{scale}");
            assert_eq!(refused.text(), "the speed is not between 1 % and 100 %");
        }
        let slow = client.request(Request::speed(0.5), WAIT).unwrap();
        (arm, track, unknown, bad, slow)
    });
    let mut seen: Vec<OperatorCommand> = Vec::new();
    let deadline = Instant::now() + WAIT;
    while seen.len() < 3 && Instant::now() < deadline {
        if let Some(command) = daemon.inputs.next_command() {
            seen.push(command);
            daemon.outputs.reply(match command.kind {
                RequestKind::Arm | RequestKind::Speed => Reply::accepted(&command, SupervisorState::Holding),
                _ => Reply::refused(&command, SupervisorState::Holding, RefusalReason::NoTarget),
            });
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let (arm, track, unknown, bad, slow) = operator.join().unwrap();
    let kinds: Vec<_> = seen.iter().map(|c| c.kind).collect();
    assert_eq!(kinds, [RequestKind::Arm, RequestKind::Track, RequestKind::Speed]);
    assert_eq!(seen[2].speed_scale, 0.5);
    assert!(slow.is_accepted() && slow.text() == "holding, at 50 % of the configured speed until the arm is disarmed");
    assert!(arm.is_accepted() && arm.supervisor == SupervisorState::Holding.wire() && arm.header.sequence == 0);
    assert!(!track.is_accepted() && track.reason == RefusalReason::NoTarget.wire());
    assert_eq!((track.text(), track.header.sequence), ("no fresh target", 1));
    assert_eq!((unknown.reason, unknown.detail), (RefusalReason::UnknownRequest.wire(), 99));
    assert_eq!((bad.reason, bad.detail), (RefusalReason::BadTarget.wire(), RejectCause::NotFinite.wire()));
    assert_eq!(bad.text(), "the target was refused: NaN or infinite number");
    daemon.stop();
}

/// Notes what was forgotten.
struct Forgotten(Arc<Mutex<Vec<u32>>>);

impl Tap for Forgotten {
    fn forgotten(&mut self, source_id: u32) {
        self.0.lock().unwrap().push(source_id);
    }
}

#[test]
fn a_clear_that_is_refused_forgets_the_expired_sources_all_the_same() {
    let isolated = Isolated::new();
    // A clock that stands still, so that nothing expires before its time.
    let (forgotten, time_ns) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicU64::new(1_000_000_000)));
    let clock = time_ns.clone();
    let now = move || clock.load(Ordering::Acquire);
    let mut daemon = Daemon::start_with(&isolated.domain, Pace::default(), Forgotten(forgotten.clone()), now.clone());
    let mut client = Client::connect(&isolated.domain, ARM).unwrap();
    let (mut dead, mut alive) = (client.obstacles(7).unwrap(), client.obstacles(9).unwrap());
    dead.publish(&mut ball_set(1), now()).unwrap();
    daemon.until("the first source", |i| Daemon::sources(i) == [7]);
    // An hour later the one is long gone, and another one speaks.
    time_ns.store(3_600_000_000_000, Ordering::Release);
    alive.publish(&mut ball_set(1), now()).unwrap();
    daemon.until("both", |i| Daemon::sources(i) == [7, 9]);
    let demand = |daemon: &mut Daemon| {
        daemon.inputs.update();
        daemon.inputs.obstacles().demand(now(), &limits().obstacles)
    };
    assert_eq!(demand(&mut daemon), ObstacleDemand::Hold { source_id: 7 });

    let refuse =
        |command: &OperatorCommand| Reply::refused(command, SupervisorState::Holding, RefusalReason::WrongState);
    let mut ask = |daemon: &mut Daemon, kind| daemon.while_answering(refuse, || client.ask(kind, WAIT).unwrap());
    assert!(!ask(&mut daemon, RequestKind::Track).is_accepted());
    assert_eq!(demand(&mut daemon), ObstacleDemand::Hold { source_id: 7 }, "only clear forgets");
    assert!(!ask(&mut daemon, RequestKind::Clear).is_accepted());
    assert_eq!(*forgotten.lock().unwrap(), [7]);
    assert_eq!(demand(&mut daemon), ObstacleDemand::Proceed);
    assert_eq!(Daemon::sources(&daemon.inputs), [9]);
    dead.publish(&mut ball_set(1), now()).unwrap();
    daemon.until("its return", |i| Daemon::sources(i) == [7, 9]);
    daemon.stop();
}

#[test]
fn a_target_given_before_arming_stays_and_a_stop_or_a_fault_takes_it() {
    for end in [SupervisorState::Disarmed, SupervisorState::Faulted] {
        let isolated = Isolated::new();
        let mut daemon = Daemon::start(&isolated.domain, Pace::default());
        let mut client = Client::connect(&isolated.domain, ARM).unwrap();
        let states = client.states().unwrap();
        let mut tick = 0;
        let mut pass = |daemon: &mut Daemon, supervisor: SupervisorState| {
            let header = Header { tick, ..Header::new(0, tick, monotonic_ns()) };
            assert!(daemon.outputs.record(&mut State { header, supervisor: supervisor.wire(), ..State::default() }));
            // Once a record is out, whatever it made the I/O thread do is done.
            while states.wait(WAIT).unwrap().expect("a record").header.tick < tick {}
            tick += 1;
            daemon.inputs.update();
            daemon.inputs.target().sample(monotonic_ns(), &limits().target).map(|s| s.position_m[0])
        };
        let target = |x: f64| Target { position_m: [x, 0.2, -2.4], ..Target::default() };

        let give = |daemon: &mut Daemon, client: &mut Client, x: f64| {
            let accept = |command: &OperatorCommand| Reply::accepted(command, SupervisorState::Disarmed);
            let response = daemon.while_answering(accept, || client.set_target(5, target(x), WAIT).unwrap());
            assert!(response.is_accepted());
        };
        assert_eq!(pass(&mut daemon, SupervisorState::Disarmed), None);
        give(&mut daemon, &mut client, 0.1);
        use SupervisorState::{Arming, Disarmed, Holding, Stopping, Tracking};
        for armed in [Disarmed, Arming, Holding, Tracking, Holding, Stopping] {
            assert_eq!(pass(&mut daemon, armed), Some(0.1), "{armed:?}");
        }
        assert_eq!(pass(&mut daemon, end), None, "{end:?} after an armed mode");
        give(&mut daemon, &mut client, 0.3);
        for next in [end, Disarmed, Arming, Holding] {
            assert_eq!(pass(&mut daemon, next), Some(0.3), "given anew, {next:?}");
        }
        daemon.stop();
    }
}

#[test]
fn a_control_thread_that_does_not_answer_is_reported() {
    let isolated = Isolated::new();
    let daemon = Daemon::start(&isolated.domain, Pace::default());
    let mut client = Client::connect(&isolated.domain, ARM).unwrap();
    let response = client.ask(RequestKind::Stop, WAIT).unwrap();
    assert_eq!(response.reason, RefusalReason::NoAnswer.wire());
    daemon.stop();
}

#[test]
fn rejected_sets_are_counted_and_reported() {
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let client = Client::connect(&isolated.domain, ARM).unwrap();
    let mut publisher = client.obstacles(7).unwrap();
    let mut bad = ball_set(1);
    bad.obstacles[0].position_m[1] = f64::NAN;
    publisher.publish(&mut bad, monotonic_ns()).unwrap();
    let report = |d: &mut Daemon| d.report().obstacle_sources[0];
    let deadline = Instant::now() + WAIT;
    while report(&mut daemon).rejected_total() == 0 {
        assert!(Instant::now() < deadline, "no rejection was reported");
        std::thread::sleep(Duration::from_millis(1));
    }
    let found = report(&mut daemon);
    assert_eq!(found.source_id, 7);
    assert_eq!(found.rejected[RejectCause::NotFinite.wire() as usize], 1);
    let demand = daemon.inputs.obstacles().demand(monotonic_ns(), &limits().obstacles);
    assert_eq!(demand, ObstacleDemand::Hold { source_id: 7 }, "somebody sees something, and nobody knows what");
    daemon.stop();
}

#[test]
fn a_source_id_belongs_to_the_port_that_has_it_until_that_is_gone() {
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let camera = spawn_rust_client(&isolated.domain, 7, 200.0);
    daemon.until("the camera", |inputs| inputs.obstacles().log(7).is_some_and(|log| log.accepted > 0));
    // Another process under the same id is refused, however new what it says.
    let client = Client::connect(&isolated.domain, ARM).unwrap();
    let mut impostor = client.obstacles(7).unwrap();
    let rejected = |d: &mut Daemon| {
        d.inputs.update();
        d.inputs.obstacles().log(7).unwrap().rejected[RejectCause::TooManySources.wire() as usize]
    };
    let deadline = Instant::now() + WAIT;
    while rejected(&mut daemon) < 3 {
        assert!(Instant::now() < deadline, "never refused");
        impostor.publish(&mut Obstacles::default(), monotonic_ns()).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(Daemon::sources(&daemon.inputs).first(), Some(&7), "what the camera sees stays");
    // Killed, it is gone, and the id is free; also for a second port of the process that has it now.
    drop(camera);
    let accepted = |d: &Daemon| d.inputs.obstacles().log(7).unwrap().accepted;
    for mut heir in [impostor, client.obstacles(7).unwrap()] {
        let before = accepted(&daemon);
        let deadline = Instant::now() + WAIT;
        while accepted(&daemon) < before + 3 {
            assert!(Instant::now() < deadline, "the heir is not heard");
            heir.publish(&mut ball_set(1), monotonic_ns()).unwrap();
            std::thread::sleep(Duration::from_millis(5));
            daemon.inputs.update();
        }
    }
    daemon.stop();
}

#[test]
fn a_payload_of_another_size_is_refused_on_opening() {
    use iceoryx2::prelude::*;
    #[derive(Debug, Clone, Copy, ZeroCopySend)]
    #[repr(C)]
    #[type_name("sinew.Obstacles.v0")]
    struct Old {
        header: u64,
    }
    let isolated = Isolated::new();
    let mut config = Config::default();
    config.global.prefix = FileName::new(isolated.prefix.as_bytes()).unwrap();
    config
        .global
        .set_root_path(&iceoryx2::prelude::Path::new(isolated.root.path().to_str().unwrap().as_bytes()).unwrap());
    let node = NodeBuilder::new().config(&config).create::<ipc::Service>().unwrap();
    let name = ServiceName::new(&format!("sinew/{ARM}/obstacles")).unwrap();
    let _old = node.service_builder(&name).publish_subscribe::<Old>().create().unwrap();
    let error = DaemonPorts::create(&isolated.domain, ARM).unwrap_err();
    assert!(matches!(error, IpcError::IncompatiblePayload { .. }), "{error}");
}

#[test]
fn a_client_killed_while_publishing_does_not_stop_the_next() {
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let mut before = 0;
    for round in 0..3 {
        // As fast as it can, so that the kill falls into a publication as likely as not.
        let mut client = spawn_rust_client(&isolated.domain, 7, 1e9);
        let deadline = Instant::now() + WAIT;
        while daemon.report().obstacle_sources[0].accepted < before + 100 {
            assert!(Instant::now() < deadline, "client {round} was not heard");
            std::thread::sleep(Duration::from_millis(1));
        }
        client.0.kill().unwrap();
        client.0.wait().unwrap();
        before = daemon.report().obstacle_sources[0].accepted;
    }
    assert_eq!(Daemon::sources(&daemon.inputs), [7], "killed, its last obstacles stay");
    daemon.stop();
    // The dead left their files; the next process cleans them up.
    assert!(matches!(Client::connect(&isolated.domain, ARM), Err(IpcError::NoDaemon { .. })));
    assert_eq!(isolated.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_client_that_ends_in_order_is_not_missed() {
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let client = spawn_rust_client(&isolated.domain, 7, 200.0);
    daemon.until("the client", |i| Daemon::sources(i) == [7]);
    terminate(client);
    daemon.until("its farewell", |i| Daemon::sources(i).is_empty());
    daemon.stop();
}

#[test]
fn the_viewer_shows_the_records() {
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let mut command = Command::new(example("state_viewer"));
    command.args(["--arm", ARM, "--lines", "3", "--rate", "100"]).envs(isolated.domain.env());
    let mut viewer = Running(command.stdout(Stdio::piped()).spawn().unwrap());
    let mut state = State { supervisor: SupervisorState::Tracking.wire(), tip_error_m: 1.5e-3, ..State::default() };
    let deadline = Instant::now() + WAIT;
    while viewer.0.try_wait().unwrap().is_none() {
        assert!(Instant::now() < deadline, "the viewer saw no three records");
        daemon.outputs.record(&mut state);
        std::thread::sleep(Duration::from_millis(5));
    }
    let mut text = String::new();
    std::io::Read::read_to_string(viewer.0.stdout.as_mut().unwrap(), &mut text).unwrap();
    assert_eq!(text.lines().filter(|l| l.contains("tracking") && l.contains("1.50 mm")).count(), 3, "{text}");
    daemon.stop();
}

#[test]
fn lockstep_delivers_every_sample_in_order() {
    const TICKS: u64 = 300;
    const OBSTACLE_SOURCE: u32 = 4;
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::Lockstep);
    let domain = isolated.domain.clone();
    // The plant: answers the record of tick k - 1 with the inputs of tick k.
    let plant = std::thread::spawn(move || {
        let client = Client::connect(&domain, ARM).unwrap();
        let states = client.states().unwrap();
        let mut encoders = client.encoders(1).unwrap();
        let mut obstacles = client.obstacles(OBSTACLE_SOURCE).unwrap();
        let mut message = Encoders { length_m: [0.65; 96], ..Encoders::default() };
        message.set_all_valid(24);
        for tick in 0..TICKS {
            if tick > 0 {
                let state = states.wait(WAIT).unwrap().expect("the record of the tick before");
                assert_eq!(state.header.tick, tick - 1, "no record is lost");
            }
            message.length_m[0] = 0.1 + tick as f64;
            encoders.publish_for_tick(&mut message, monotonic_ns(), tick).unwrap();
            obstacles.publish_for_tick(&mut ball_set(tick as u32), monotonic_ns(), tick).unwrap();
        }
    });
    let sources = LockstepSources { encoders: true, target: false, obstacles: vec![OBSTACLE_SOURCE] };
    let mut tracked = TrackedSet::new();
    for tick in 0..TICKS {
        daemon.until("the inputs of the tick", |i| i.is_ready_for(tick, &sources));
        let encoders = daemon.inputs.encoders().latest().unwrap();
        assert_eq!((encoders.header.tick, encoders.length_m[0]), (tick, 0.1 + tick as f64));
        daemon.inputs.obstacles().track_into(0, 0.0, &limits().obstacles, &mut tracked);
        assert_eq!(tracked.as_slice()[0].id, tick as u32);
        let mut state = State { header: Header::new(0, tick, 0).for_tick(tick), ..State::default() };
        assert!(daemon.outputs.record(&mut state));
    }
    plant.join().unwrap();
    daemon.stop();
}

/// Interpreter with the packages of the interoperability tests, made on first use below the target folder.
fn python() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let environment = std::env::current_exe().unwrap().ancestors().nth(3).unwrap().join("python-env");
    let script = root.join("tests/support/python_env.sh");
    let output = Command::new("bash").arg(script).arg(environment).output().unwrap();
    assert!(
        output.status.success(),
        "the Python part of this test could not be set up:\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    PathBuf::from(String::from_utf8(output.stdout).unwrap().trim())
}

#[test]
fn rust_and_python_feed_a_daemon_at_the_same_time() {
    let python = python();
    let isolated = Isolated::new();
    let mut daemon = Daemon::start(&isolated.domain, Pace::default());
    let rust = spawn_rust_client(&isolated.domain, 1, 200.0);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/obstacle_client.py");
    let mut command = Command::new(python);
    command.arg(script).args(["--arm", ARM, "--source", "2", "--rate", "200", "--sigma", "0.01"]);
    let python = Running(command.envs(isolated.domain.env()).stdout(Stdio::null()).spawn().unwrap());
    daemon.until("both sources", |i| Daemon::sources(i) == [1, 2]);

    // Both go on: a hundred more of each.
    let accepted = |d: &mut Daemon| {
        let mut both = [0; 2];
        for report in d.report().obstacle_sources {
            if let 1 | 2 = report.source_id {
                assert_eq!(report.rejected_total(), 0, "{report:?}");
                both[report.source_id as usize - 1] = report.accepted;
            }
        }
        both
    };
    let start = accepted(&mut daemon);
    let deadline = Instant::now() + 3 * WAIT;
    while accepted(&mut daemon).iter().zip(start).any(|(now, then)| now - then < 100) {
        assert!(Instant::now() < deadline, "{start:?} then {:?}", accepted(&mut daemon));
        std::thread::sleep(Duration::from_millis(5));
    }
    // The content is what Python wrote: three sigma of 0.01 m, on the circle around (0.40, -0.15, -1.68).
    let mut tracked = TrackedSet::new();
    daemon.inputs.obstacles().track_into(monotonic_ns(), 0.0, &limits().obstacles, &mut tracked);
    let ball = tracked.as_slice().iter().find(|o| o.source_id == 2).unwrap();
    assert!((ball.growth_m - 0.03).abs() < 1e-12);
    assert_eq!((ball.dimensions_m[0], ball.position_m[2]), (0.1, -1.68));
    let [x, y, _] = ball.position_m;
    assert!(((x - 0.40).hypot(y + 0.15) - 0.32).abs() < 1e-3);
    // Python leaves in order too.
    terminate(python);
    daemon.until("the farewell of Python", |i| Daemon::sources(i) == [1]);
    drop(rust);
    daemon.stop();
}
