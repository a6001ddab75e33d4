//! A daemon, a plant and their clients, isolated by the names of bus and shared memory; nothing is left behind.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)] // each test binary uses its own part

use sim_plant::config::PlantConfig;
use sim_plant::fault::{FaultSpec, Schedule};
use sim_plant::rig::{Rig, Start};
use sim_plant::server::{Served, Server};
use sim_plant::trace::Trace;
use sim_plant::wire::WireFault;
use sinew::config::{BUILTIN_FILES, Config};
use sinew::daemon::operator::{Address, OperatorError};
use sinew::daemon::status::{StatusReport, ask};
use sinew::ipc::payload::{Obstacles, RequestKind, Response, State, SupervisorState, Target};
use sinew::ipc::{Client, Domain, SourcePublisher};
use sinew_hal::virtual_bus::remove_stale;
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest that anything may take on a busy machine.
pub const WAIT: Duration = Duration::from_secs(60);

/// Files, names and processes of one test.
pub struct Place {
    pub folder: tempfile::TempDir,
    pub bus: String,
    prefix: String,
    pub files: Vec<PathBuf>,
    pub domain: Domain,
    /// Folder of the daemon's socket.
    pub run: PathBuf,
    /// A plant and a daemon in real time need the machine for themselves.
    _turn: MutexGuard<'static, ()>,
}

impl Place {
    /// With the shipped configuration; `change` edits its texts, file by file.
    pub fn new(change: impl Fn(&str, String) -> String) -> Self {
        static TURN: Mutex<()> = Mutex::new(());
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let (bus, prefix) = (format!("dt-{name}"), format!("sinewdt{name}_"));
        let folder = tempfile::tempdir().unwrap();
        let root = format!("{}/ipc/", folder.path().display());
        let run = folder.path().join("run");
        let mut files = Vec::new();
        for (file, text) in BUILTIN_FILES
            .iter()
            .filter(|(f, _)| ["arm.toml", "controller.toml", "drives.toml", "plant.toml"].contains(f))
        {
            let mut text = text.replace("\"sinew0\"", &format!("\"{bus}\""));
            // Outcomes are claimed here, not reaction times: the machine may be busy with other tests.
            text = text
                .replace("encoder_silent_s = 0.05", "encoder_silent_s = 2.0")
                .replace("heartbeat_timeout_s = 0.15", "heartbeat_timeout_s = 3.0")
                .replace("sync_timeout_s = 0.1", "sync_timeout_s = 3.0")
                // Nobody publishes obstacles in most tests, and faults end in the ramp; those of other things say so.
                .replace("[obstacles]\n", "[obstacles]\narm_unknown = true\n")
                .replace("[drives.defaults]\n", "[drives.defaults]\nsafe_hold = \"ramp\"\n")
                .replace("[loop]\n", "[loop]\npriority = 0\noverruns_hold = 1000\noverruns_fault = 10000\n");
            if *file == "plant.toml" {
                text = text.replace("mesh_refinement = 2", "mesh_refinement = 1");
            }
            let path = folder.path().join(file);
            std::fs::write(&path, change(file, text)).unwrap();
            files.push(path);
        }
        let ipc = folder.path().join("ipc.toml");
        let places = format!("prefix = \"{prefix}\"\nroot_path = \"{root}\"\nrun_path = \"{}\"\n", run.display());
        std::fs::write(&ipc, format!("[ipc]\n{places}")).unwrap();
        files.push(ipc);
        let domain = Domain::new(prefix.clone(), root);
        Self { folder, bus, prefix, files, domain, run, _turn: turn }
    }

    pub fn shipped() -> Self {
        Self::new(|_, text| text)
    }

    pub fn config(&self) -> Config {
        Config::load(&self.files).unwrap()
    }

    /// Lets other users read the configuration and run the programs, which may lie where nobody else gets to.
    pub fn open_to_all(&self) {
        let open = |path: &Path, mode| std::fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
        open(self.folder.path(), 0o755);
        self.files.iter().for_each(|file| open(file, 0o644));
        let reachable = self.folder.path().join("bin");
        std::fs::create_dir_all(&reachable).unwrap();
        open(&reachable, 0o755);
        let built = Path::new(env!("CARGO_BIN_EXE_sinew")).parent().unwrap();
        for program in ["sinew", "sim_plant"] {
            let (from, to) = (built.join(program), reachable.join(program));
            if from.exists() && !to.exists() {
                std::fs::hard_link(&from, &to).or_else(|_| std::fs::copy(&from, &to).map(drop)).unwrap();
            }
        }
    }

    /// The program, after [`Place::open_to_all`] where everybody gets to.
    pub fn program(&self) -> PathBuf {
        let reachable = self.folder.path().join("bin/sinew");
        if reachable.exists() { reachable } else { env!("CARGO_BIN_EXE_sinew").into() }
    }

    /// The program with arguments and the configuration.
    pub fn sinew(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(self.program());
        command.env_remove("SINEW_IPC_PREFIX").env_remove("SINEW_IPC_ROOT").env_remove("SINEW_RUN_DIR");
        command.args(arguments).arg("--config").args(&self.files);
        command
    }

    /// Runs a command of an operator; exit code and everything that it said.
    pub fn operate(&self, arguments: &[&str]) -> (Option<i32>, String) {
        let out = self.sinew(arguments).output().unwrap();
        let text = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
        (out.status.code(), text)
    }

    pub fn daemon(&self, arguments: &[&str]) -> Daemon {
        let mut all = vec!["run"];
        all.extend(arguments);
        let child = self.sinew(&all).stderr(Stdio::piped()).spawn().unwrap();
        let mut daemon = Daemon { child };
        let deadline = Instant::now() + WAIT;
        while self.status().is_none() {
            if daemon.child.try_wait().unwrap().is_some() || Instant::now() > deadline {
                let _ = daemon.child.kill();
                panic!("the daemon did not start: {:?}", daemon.finish());
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        daemon
    }

    pub fn client(&self) -> Client {
        Client::wait_for_daemon(&self.domain, "paper", WAIT).unwrap()
    }

    /// Prefix of its files in shared memory.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// A file with which a test fills shared memory.
    pub fn filler(&self) -> PathBuf {
        PathBuf::from(format!("/dev/shm/{}filler", self.prefix))
    }

    /// Where the daemon listens.
    pub fn address(&self) -> Address {
        Address::new(&self.domain, "paper", Some(&self.run))
    }

    pub fn status(&self) -> Option<StatusReport> {
        let deadline = Instant::now() + WAIT;
        loop {
            match ask(&self.address()) {
                Ok(report) => return report,
                // The main thread has no priority: on a busy machine its answer may take longer than `ask` waits.
                Err(OperatorError::Timeout { .. }) if Instant::now() < deadline => {}
                // Ending, it hangs up on those who still wait.
                Err(OperatorError::Garbled { .. } | OperatorError::Io { .. }) if Instant::now() < deadline => {}
                Err(error) => panic!("status: {error}"),
            }
        }
    }

    /// Waits until the status meets a condition.
    pub fn until(&self, what: &str, condition: impl Fn(&StatusReport) -> bool) -> StatusReport {
        let deadline = Instant::now() + WAIT;
        loop {
            match self.status() {
                Some(report) if condition(&report) => return report,
                report if Instant::now() > deadline => panic!("{what}: {report:#?}"),
                _ => std::thread::sleep(Duration::from_millis(20)),
            }
        }
    }

    pub fn request(&self, kind: RequestKind) -> Response {
        self.client().ask(kind, WAIT).unwrap()
    }

    /// Arms, until the arm holds.
    pub fn arm(&self) {
        self.until("drives ready", |s| {
            s.drives.ready == s.drives.count && s.drives.fault.is_none() && s.drives.count > 0
        });
        let deadline = Instant::now() + WAIT;
        while !self.request(RequestKind::Arm).is_accepted() {
            assert!(Instant::now() < deadline, "never accepted: {:#?}", self.status());
            std::thread::sleep(Duration::from_millis(50));
        }
        self.until("holding", |s| s.mode == "holding");
    }

    fn leftovers(&self) -> Vec<PathBuf> {
        let shm = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.path());
        let ours = |p: &PathBuf| {
            let name = p.file_name().unwrap().to_string_lossy().into_owned();
            name.starts_with(&self.prefix) || name.contains(&self.bus)
        };
        let mut found: Vec<_> = shm.filter(ours).collect();
        found.extend(self.folder.path().join("ipc").exists().then(|| self.folder.path().join("ipc")));
        found
    }

    /// After an ordered end nothing is left.
    pub fn assert_clean(&self) {
        assert_eq!(self.leftovers(), Vec::<PathBuf>::new());
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        // What a test killed could not clean up; whoever comes last does.
        self.domain.sweep();
        let _ = remove_stale(&self.bus);
        if !std::thread::panicking() {
            self.assert_clean();
        }
    }
}

/// A daemon as a process.
pub struct Daemon {
    pub child: Child,
}

impl Daemon {
    pub fn terminate(mut self) -> (ExitStatus, String) {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
        self.finish()
    }

    pub fn finish(&mut self) -> (ExitStatus, String) {
        use std::io::Read;
        let mut text = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
        (self.child.wait().unwrap(), text)
    }

    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // In order, if it can still be; only a test that says so kills it.
        let pid = rustix::process::Pid::from_child(&self.child);
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        let deadline = Instant::now() + Duration::from_secs(30);
        while matches!(self.child.try_wait(), Ok(None)) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A client as a process; killed at the end.
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The plant on a thread of this process.
pub struct Plant {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Served>>,
}

impl Plant {
    /// Serves before this returns: its buses are open.
    pub fn start(place: &Place, lockstep: bool, faults: &[&str]) -> Self {
        Self::start_on(place, lockstep, faults, &[])
    }

    /// The same with faults on the wire.
    pub fn start_on(place: &Place, lockstep: bool, faults: &[&str], wire: &[&str]) -> Self {
        Self::launch(place, lockstep, faults, wire, None)
    }

    /// In real time, with the true arm written to a file.
    pub fn start_traced(place: &Place, faults: &[&str], wire: &[&str], trace: &std::path::Path) -> Self {
        Self::launch(place, false, faults, wire, Some(trace))
    }

    fn launch(place: &Place, lockstep: bool, faults: &[&str], wire: &[&str], trace: Option<&std::path::Path>) -> Self {
        let (mut settings, config) = PlantConfig::load(&place.files).unwrap();
        settings.truth.seed = 7;
        if lockstep {
            settings.pace = sim_plant::config::Pace::Lockstep;
        }
        let faults: Vec<FaultSpec> = faults.iter().map(|f| f.parse().unwrap()).collect();
        let schedule = Schedule::new(&faults, &config.arm.cable_names(), settings.truth.seed).unwrap();
        let rig = Rig::new(&config, &settings, &Start::straight(&config.arm), 0).unwrap();
        let wire: Vec<WireFault> = wire.iter().map(|f| f.parse().unwrap()).collect();
        let seed = settings.truth.seed;
        let trace = trace.map(|path| Trace::create(path, "paper", &rig, settings.pace, seed).unwrap());
        let server = Server::open(&config, &settings, rig, schedule, trace).unwrap().with_wire_faults(wire, seed);
        let stop = Arc::new(AtomicBool::new(false));
        let flag = stop.clone();
        let thread = std::thread::spawn(move || server.run(&flag).unwrap());
        Self { stop, thread: Some(thread) }
    }

    /// Ends it; what happened.
    pub fn stop(mut self) -> Served {
        self.stop.store(true, Ordering::Release);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Plant {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let ended = thread.join();
            assert!(ended.is_ok() || std::thread::panicking(), "the plant panicked");
        }
    }
}

/// A perception and task client that keeps to the ticks of a run in lockstep, and remembers the tensions as bits.
pub struct TickClient {
    obstacles: SourcePublisher<Obstacles>,
    targets: SourcePublisher<Target>,
    states: sinew::ipc::NewestSubscriber<State>,
    period_ns: u64,
    _client: Client,
}

/// Source id of the obstacles in lockstep.
pub const SOURCE: u32 = 11;

impl TickClient {
    pub fn new(place: &Place) -> Self {
        let client = place.client();
        let (obstacles, targets, states) =
            (client.obstacles(SOURCE).unwrap(), client.targets(12).unwrap(), client.states().unwrap());
        let period_ns = (1e9 * place.config().timing.period_s) as u64;
        Self { obstacles, targets, states, period_ns, _client: client }
    }

    /// Runs until a record satisfies `last`; every record in order.
    pub fn run(&mut self, last: impl Fn(&State) -> bool, mut each: impl FnMut(&State)) {
        self.send(0);
        loop {
            let state = self.states.wait(WAIT).unwrap().expect("the daemon no longer ticks");
            each(&state);
            if last(&state) {
                return;
            }
            self.send(state.header.tick + 1);
        }
    }

    /// Keeps to the ticks on a thread of its own, until the ticker is dropped.
    pub fn spawn(mut self) -> Ticker {
        let stop = Arc::new(AtomicBool::new(false));
        let flag = stop.clone();
        let thread = std::thread::spawn(move || {
            self.send(0);
            while !flag.load(Ordering::Acquire) {
                if let Some(state) = self.states.wait(Duration::from_millis(100)).unwrap() {
                    self.send(state.header.tick + 1);
                }
            }
        });
        Ticker { stop, thread: Some(thread) }
    }

    fn send(&mut self, tick: u64) {
        let time_ns = tick * self.period_ns;
        let t = time_ns as f64 * 1e-9;
        // A ball that comes near the tip and goes again, and a tip that swings slowly around the straight pose.
        let mut set = Obstacles::default();
        let ball = sinew::ipc::payload::Obstacle {
            velocity_mps: [-0.05 * (0.5 * t).sin(), 0.0, 0.0],
            ..sinew::ipc::payload::Obstacle::ball(1, [0.28 + 0.1 * (0.5 * t).cos(), 0.05, -2.1], 0.1)
        };
        assert!(set.push(ball));
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let mut target = Target {
            position_m: [0.08 * (0.4 * t).sin(), 0.05, -2.72],
            quaternion: [half, 0.0, half, 0.0],
            velocity_mps: [0.032 * (0.4 * t).cos(), 0.0, 0.0],
            ..Target::default()
        };
        self.obstacles.publish_for_tick(&mut set, time_ns, tick).unwrap();
        self.targets.publish_for_tick(&mut target, time_ns, tick).unwrap();
    }
}

/// A client that keeps to the ticks meanwhile.
pub struct Ticker {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Ticker {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(ended.is_none_or(|e| e.is_ok()) || std::thread::panicking(), "the client panicked");
    }
}

/// Tensions of a run in lockstep, as bits, tick by tick.
pub fn lockstep_run(place: &Place, seed: &str, ticks: u64) -> Vec<Vec<u64>> {
    let _plant = Plant::start(place, true, &[]);
    let mut daemon = place.daemon(&[
        "--lockstep",
        "--seed",
        seed,
        "--arm-on-start",
        "--track-on-start",
        "--await-obstacles",
        "11",
        "--await-target",
        "--ticks",
        &ticks.to_string(),
    ]);
    let mut client = TickClient::new(place);
    let (mut tensions, mut tracked) = (Vec::new(), false);
    client.run(
        |state| state.header.tick + 1 == ticks,
        |state: &State| {
            assert_eq!(state.header.tick, tensions.len() as u64, "no tick is left out");
            assert_eq!(state.fault_code, 0, "at tick {}", state.header.tick);
            tracked |= state.supervisor == SupervisorState::Tracking.wire();
            tensions.push(state.tension_command_n[..24].iter().map(|t| t.to_bits()).collect());
        },
    );
    assert!(tracked);
    drop(client);
    let (status, said) = daemon.finish();
    assert_eq!(status.code(), Some(0), "{said}");
    tensions
}
