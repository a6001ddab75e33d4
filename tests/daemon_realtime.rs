//! Claims about real time as a service manager and an operator see it: rights, readiness, watchdog.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "daemon_support/mod.rs"]
mod support;

use sinew::config::Config;
use sinew::daemon::{Daemon as Inner, Ending, Heart, Options};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use support::*;

/// The shipped priority again, which the other tests of the daemon do without.
fn place(more: &'static str) -> Place {
    Place::new(move |_, text| text.replace("priority = 0\n", more))
}

/// `sinew run` as a process that may have neither priority nor locked memory, whoever runs the test.
fn without_rights(place: &Place) -> Command {
    let mut command = Command::new("prlimit");
    command.args(["--rtprio=0:0", "--memlock=1048576:1048576"]);
    if rustix::process::geteuid().is_root() {
        // Root without capabilities owns its files and may nothing else.
        command.args(["setpriv", "--bounding-set=-all", "--inh-caps=-all"]);
    }
    command.arg(env!("CARGO_BIN_EXE_sinew")).args(["run", "--config"]).args(&place.files);
    command.env_remove("SINEW_IPC_PREFIX").env_remove("SINEW_IPC_ROOT").stderr(Stdio::piped());
    command
}

#[test]
fn rights_that_are_missing_are_said_once_with_their_remedy_and_the_loop_runs_on() {
    let place = place("");
    let mut daemon = Daemon { child: without_rights(&place).spawn().unwrap() };
    let report = place.until("ticks", |s| s.ticks > 20);
    assert_eq!(report.realtime_refused.len(), 2, "{:?}", report.realtime_refused);
    let control = report.threads.iter().find(|t| t.name == "sinew-control").unwrap();
    assert_eq!(control.scheduling, "normal");
    let (_, said) = place.operate(&["status"]);
    assert!(said.contains("degraded: real-time priority refused"), "{said}");
    rustix::process::kill_process(rustix::process::Pid::from_child(&daemon.child), rustix::process::Signal::TERM)
        .unwrap();
    let (status, said) = daemon.finish();
    assert_eq!(status.code(), Some(0), "{said}");
    for once in ["locked memory refused", "real-time priority refused", "LimitMEMLOCK=infinity", "LimitRTPRIO=80"] {
        assert_eq!(said.matches(once).count(), 1, "{once}: {said}");
    }
}

#[test]
fn a_loop_that_requires_real_time_refuses_to_start_without_it_and_leaves_nothing() {
    let place = place("require_realtime = true\n");
    let mut daemon = Daemon { child: without_rights(&place).spawn().unwrap() };
    let (status, said) = daemon.finish();
    assert_eq!(status.code(), Some(2), "{said}");
    assert!(said.contains("real time is required, but: locked memory refused"), "{said}");
    assert!(said.contains("real-time priority refused") && said.contains("LimitRTPRIO=80"), "{said}");
    place.assert_clean();
}

/// Whether a process holds a file open.
fn holds(process: u32, file: &Path) -> bool {
    let open = std::fs::read_dir(format!("/proc/{process}/fd")).unwrap();
    open.flatten().any(|entry| std::fs::read_link(entry.path()).is_ok_and(|path| path == file))
}

#[test]
fn wake_up_latency_is_bounded_in_real_time_only_and_a_refusal_is_that_of_a_right() {
    let file = Path::new("/dev/cpu_dma_latency");
    // Nothing else of real time is asked for, so that nothing else can be refused.
    let place = place("priority = 0\nlock_memory = false\nwake_latency_s = 0.005\nrequire_realtime = true\n");
    let may = std::fs::OpenOptions::new().write(true).open(file);
    if let Err(error) = may {
        let (status, said) = Daemon { child: place.sinew(&["run"]).stderr(Stdio::piped()).spawn().unwrap() }.finish();
        assert_eq!(status.code(), Some(2), "{said}");
        let refusal = format!("real time is required, but: wake-up latency refused ({error}): /dev/cpu_dma_latency ");
        assert!(said.contains(&refusal), "{said}");
    } else {
        let daemon = place.daemon(&[]);
        assert!(holds(daemon.child.id(), file));
        let bound = std::fs::read(file).unwrap()[..].try_into().map(i32::from_ne_bytes).unwrap();
        assert!((0..=5000).contains(&bound), "{bound} us");
        assert_eq!(place.status().unwrap().realtime_refused, [""; 0]);
    }
    let lockstep = place.daemon(&["--lockstep"]);
    assert!(!holds(lockstep.child.id(), file));
}

static STALL: AtomicBool = AtomicBool::new(false);
static STALLED: AtomicBool = AtomicBool::new(false);

/// On the control thread: hangs while it is told to.
fn stall(tick: &mut dyn FnMut()) {
    while STALL.load(Ordering::Acquire) {
        STALLED.store(true, Ordering::Release);
        std::thread::sleep(Duration::from_millis(1));
    }
    tick();
}

const FILES: &str = "SINEW_TEST_STALL_FILES";

/// The daemon in a process of its own, for the service manager's socket is told by the environment.
#[test]
fn the_daemon_that_hangs_on_command() {
    let Some(files) = std::env::var_os(FILES) else { return };
    let files: Vec<PathBuf> = std::env::split_paths(&files).collect();
    let folder = files[0].parent().unwrap().to_owned();
    let options = Options { around_tick: Some(stall), ..Options::default() };
    let daemon = Inner::start(&Config::load(&files).unwrap(), &options).unwrap();
    let (stop, mut heart) = (AtomicBool::new(false), Heart::new());
    let ended = daemon.wait(&stop, |ticks| {
        STALL.store(folder.join("stall").exists(), Ordering::Release);
        if STALLED.swap(false, Ordering::AcqRel) {
            std::fs::write(folder.join("stalled"), "").unwrap();
        }
        stop.store(folder.join("stop").exists(), Ordering::Release);
        heart.beat(ticks, stop.load(Ordering::Acquire));
    });
    assert_eq!(ended.unwrap(), Ending::Stopped);
}

/// The next message of the service, `None` if there is none within the time.
fn next(socket: &UnixDatagram, within: Duration) -> Option<String> {
    socket.set_read_timeout(Some(within)).unwrap();
    let mut bytes = [0; 256];
    let length = socket.recv(&mut bytes).ok()?;
    Some(String::from_utf8_lossy(&bytes[..length]).trim().to_owned())
}

#[test]
fn the_watchdog_is_fed_by_ticks_alone_and_a_control_thread_that_hangs_stops_it() {
    let place = Place::shipped();
    let folder = place.folder.path();
    let socket = UnixDatagram::bind(folder.join("notify")).unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "the_daemon_that_hangs_on_command", "--nocapture"])
        .env(FILES, std::env::join_paths(&place.files).unwrap())
        .env("NOTIFY_SOCKET", folder.join("notify"))
        // Three pings within it: one each 100 ms.
        .env("WATCHDOG_USEC", "300000")
        .env_remove("WATCHDOG_PID")
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let expect = |what: &str| {
        let deadline = Instant::now() + WAIT;
        while next(&socket, WAIT).unwrap_or_default() != what {
            assert!(Instant::now() < deadline, "{what} never came");
        }
    };
    expect("READY=1");
    expect("WATCHDOG=1");
    expect("WATCHDOG=1");

    let wait_for = |path: &Path| {
        let deadline = Instant::now() + WAIT;
        while !path.exists() {
            assert!(Instant::now() < deadline, "no {}", path.display());
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    std::fs::write(folder.join("stall"), "").unwrap();
    wait_for(&folder.join("stalled"));
    // What was on its way may still come; then there is silence, although the rest of the daemon lives.
    while next(&socket, Duration::from_millis(400)).is_some() {}
    assert_eq!(next(&socket, Duration::from_secs(1)), None);
    let during = place.status().expect("the main thread answers");
    std::fs::remove_file(folder.join("stall")).unwrap();
    expect("WATCHDOG=1");
    // Ticks that were due meanwhile are left out and counted, not replayed.
    let after = place.until("missed ticks", |s| s.left_out > during.left_out);
    assert!(after.left_out >= 50, "a second and more without a tick of 10 ms: {}", after.left_out);

    std::fs::write(folder.join("stop"), "").unwrap();
    expect("STOPPING=1");
    assert!(child.wait().unwrap().success());
}

#[test]
fn the_service_unit_gives_what_the_daemon_asks_for() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let unit = std::fs::read_to_string(root.join("config/sinew.service")).unwrap();
    let value = |key: &str| {
        let lines: Vec<&str> = unit.lines().filter_map(|l| l.strip_prefix(key)?.strip_prefix('=')).collect();
        assert_eq!(lines.len(), 1, "{key} is there once");
        lines[0]
    };
    let seconds = |key: &str| value(key).parse::<f64>().unwrap();
    // The files of the command line exist under the same names here, and are a configuration.
    let (program, arguments) = value("ExecStart").split_once(" run --config ").unwrap();
    assert!(program.ends_with("/sinew"));
    let files: Vec<PathBuf> =
        arguments.split(' ').map(|file| root.join("config").join(Path::new(file).file_name().unwrap())).collect();
    let config = Config::load(&files).unwrap();

    assert_eq!((value("Type"), value("NotifyAccess")), ("notify", "main"));
    assert!(value("LimitRTPRIO").parse::<u8>().unwrap() >= config.timing.priority);
    assert_eq!(value("LimitMEMLOCK"), "infinity");
    // The rule that lets the unit's user bound the wake-up latency; the unit lets that one device through.
    let rule = format!(r#"KERNEL=="cpu_dma_latency", GROUP="{}", MODE="0660""#, value("User"));
    assert!(unit.lines().any(|line| line.trim_start_matches(['#', ' ']) == rule), "{rule}");
    // The daemon's threads leave `loop.cpu` by themselves; without it, all of them would share what is named here.
    assert_eq!(config.timing.cpu, None);
    assert!(!unit.lines().any(|line| line.starts_with("CPUAffinity=")));
    assert_eq!((value("DevicePolicy"), value("DeviceAllow")), ("closed", "/dev/cpu_dma_latency rw"));
    // What would take away what it needs: devices, scheduling, CAN, shared memory with its clients.
    for shut in ["PrivateDevices=", "RestrictRealtime=", "PrivateNetwork=", "PrivateIPC=", "PrivateUsers="] {
        assert!(!unit.lines().any(|line| line.starts_with(shut)), "{shut}");
    }
    assert_eq!(value("RestrictAddressFamilies"), "AF_UNIX AF_CAN");
    // The arm's socket, and iceoryx2's files where clients outside of the unit's own /tmp find them.
    assert_eq!((value("RuntimeDirectory"), value("RuntimeDirectoryMode")), ("sinew", "0755"));
    assert!(value("Environment").starts_with("SINEW_IPC_ROOT=/run/sinew/"));
    // The main thread looks every 50 ms and pings at a third of the time.
    assert!(seconds("WatchdogSec") / 3.0 >= 0.1);
    // A hang that is noticed later than the drives notice it is no danger to the arm.
    assert!(seconds("WatchdogSec") > config.drives.sync_timeout_s);
    // Ramp, drives one by one, and the limit at which the daemon gives the ordered stop up by itself.
    let timing = &config.timing;
    assert!(seconds("TimeoutStopSec") > timing.stop_timeout_s + timing.release_s.max(timing.ramp_s) + 10.0);
    // Exit codes 1 and 2 are for people; 70 and 101, defects, are not among them.
    assert_eq!((value("Restart"), value("RestartPreventExitStatus")), ("on-failure", "1 2"));
}
