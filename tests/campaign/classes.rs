//! What can go wrong, by name, with the outcome that is declared for it.

use super::Trial;
use rand::RngExt;
use rustix::fs::{FlockOperation, flock};
use rustix::process::{Pid, Signal, kill_process};
use sinew::daemon::operator::Word;
use sinew::ipc::monotonic_ns;
use sinew::ipc::payload::{FLAG_LEAVING, Obstacle, Obstacles, Request, RequestKind, Target};
use std::fs::File;
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// What a class leads to, before a stop is ordered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Expect {
    /// The arm goes on as if nothing was.
    GoesOn,
    /// It holds.
    Holds,
    /// A fault is latched.
    Faults,
    /// The stop was ordered by the class itself.
    Stops,
    /// There is no daemon any more, and the drives' guards have taken over.
    Gone,
    /// Any of these, by the moment; but nothing of what must never be.
    Safe,
}

/// A kind of fault.
pub struct Class {
    pub name: &'static str,
    pub expect: Expect,
    /// Needs other users or mounts.
    pub root: bool,
    /// Faults of the plant's drives.
    pub drives: &'static [&'static str],
    /// Faults on the wire.
    pub wire: &'static [&'static str],
    /// Time for the outcome beyond the usual (s).
    pub waits_s: f64,
    pub does: fn(&mut Trial),
}

const fn class(name: &'static str, expect: Expect, does: fn(&mut Trial)) -> Class {
    Class { name, expect, root: false, drives: &[], wire: &[], waits_s: 0.0, does }
}

const fn late(name: &'static str, expect: Expect, does: fn(&mut Trial)) -> Class {
    Class { waits_s: 1.3, ..class(name, expect, does) }
}

const fn by_root(name: &'static str, expect: Expect, does: fn(&mut Trial)) -> Class {
    Class { root: true, ..class(name, expect, does) }
}

const fn wire(name: &'static str, expect: Expect, wire: &'static [&'static str]) -> Class {
    Class { wire, waits_s: 2.5, ..class(name, expect, nothing) }
}

const fn drive(name: &'static str, expect: Expect, drives: &'static [&'static str]) -> Class {
    Class { drives, waits_s: 2.5, ..class(name, expect, nothing) }
}

/// A user that is nobody's.
const STRANGER: u32 = 54_321;

pub static CLASSES: &[Class] = &[
    class("nothing", Expect::GoesOn, nothing),
    // Processes.
    class("daemon killed", Expect::Gone, |t| signal_daemon(t, Signal::KILL)),
    class("daemon terminated", Expect::Stops, |t| signal_daemon(t, Signal::TERM)),
    class("daemon interrupted", Expect::Stops, |t| signal_daemon(t, Signal::INT)),
    class("daemon stopped for 100 ms", Expect::Safe, |t| freeze_daemon(t, 100)),
    class("daemon stopped for 1 s", Expect::Safe, |t| freeze_daemon(t, 1000)),
    class("daemon hit by SIGXFSZ", Expect::GoesOn, |t| signal_daemon(t, Signal::XFSZ)),
    late("camera killed", Expect::Holds, |t| signal_camera(t, Signal::KILL)),
    late("camera stopped", Expect::Holds, |t| signal_camera(t, Signal::STOP)),
    class("camera stopped for 300 ms", Expect::GoesOn, camera_pauses),
    late("camera ends in order", Expect::Holds, |t| signal_camera(t, Signal::TERM)),
    late("task client ends", Expect::Holds, Trial::end_task),
    class("clients killed while they connect", Expect::GoesOn, clients_killed),
    class("clients stopped while they connect", Expect::GoesOn, clients_stopped),
    class("a second daemon", Expect::GoesOn, second_daemon),
    // Shared memory.
    late("files in shared memory removed", Expect::Safe, remove_files),
    class("folder of shared memory removed", Expect::GoesOn, remove_root),
    class("lock of /dev/shm held", Expect::GoesOn, hold_shm),
    class("turn held by a stopped process", Expect::GoesOn, hold_turn),
    class("unfinished files in shared memory", Expect::GoesOn, unfinished_files),
    class("a segment cut short", Expect::Safe, cut_management),
    class("links in shared memory", Expect::GoesOn, links),
    // Users.
    by_root("stranger asks over the socket", Expect::GoesOn, |t| strangers(t, &["stop", "hold", "disarm", "status"])),
    by_root("stranger asks over shared memory", Expect::GoesOn, |t| strangers(t, &["arm", "track", "home", "clear"])),
    by_root("stranger injects", Expect::GoesOn, |t| stranger_script(t, "exec \"$SINEW\" obstacles inject --for 1")),
    by_root("stranger floods the socket", Expect::GoesOn, |t| {
        stranger_script(t, "for i in $(seq 100); do \"$SINEW\" stop; done");
    }),
    by_root("stranger makes files of our prefix", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "for i in a b c; do : > /dev/shm/${PREFIX}$i.data; : > /dev/shm/${PREFIX}$i.node_monitor; done",
        );
    }),
    by_root("stranger cuts files of shared memory", Expect::GoesOn, |t| {
        stranger_script(t, "for f in /dev/shm/${PREFIX}*; do case $f in *global_mgmt) ;; *) : > $f;; esac; done");
    }),
    by_root("stranger removes files", Expect::GoesOn, |t| {
        stranger_script(t, "rm -f /dev/shm/${PREFIX}* \"$SOCKET\" \"$FOLDER\"/ipc/nodes/*");
    }),
    by_root("stranger removes the virtual bus", Expect::GoesOn, |t| {
        stranger_script(t, "rm -f /dev/shm/sinew-bus-$BUS; : > /dev/shm/sinew-bus-$BUS");
    }),
    by_root("stranger takes the locks", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "flock /dev/shm sleep 2 & flock \"$FOLDER/run\" sleep 2 & flock \"$FOLDER/run/turn\" sleep 2",
        );
    }),
    by_root("stranger sends signals", Expect::GoesOn, |t| {
        stranger_script(t, "for s in TERM KILL STOP INT XFSZ; do kill -$s $DAEMON; done");
    }),
    by_root("stranger burns the processors", Expect::Safe, |t| {
        stranger_script(t, "for i in 1 2 3 4 5 6 7 8; do timeout 1 sh -c 'while :; do :; done' & done");
    }),
    by_root("root's clients", Expect::GoesOn, roots_clients),
    // Load.
    class("16 busy threads", Expect::Safe, busy),
    class("flood of status", Expect::GoesOn, |t| flood(t, b"status\n", 300)),
    class("flood of hold", Expect::Safe, |t| flood(t, b"hold\n", 300)),
    class("flood of rubbish on the socket", Expect::GoesOn, |t| flood(t, &[0xff; 300], 300)),
    class("silent connections", Expect::GoesOn, |t| flood(t, b"", 300)),
    class("flood of requests", Expect::Safe, flood_of_requests),
    // The wire.
    wire("1 % of frames lost", Expect::Safe, &["drop=0.01@3"]),
    wire("10 % of frames lost", Expect::Safe, &["drop=0.1@3"]),
    wire("frames doubled", Expect::Safe, &["duplicate=0.2@3"]),
    wire("frames corrupted", Expect::Safe, &["corrupt=0.01@3"]),
    wire("frames in another order", Expect::Safe, &["reorder=0.1@3"]),
    wire("SYNC lost for 200 ms", Expect::Safe, &["drop:sync@3-3.2"]),
    wire("torques lost for 2 s", Expect::Safe, &["drop:rpdo@3-5"]),
    wire("heartbeats lost", Expect::Safe, &["drop:heartbeat@3"]),
    wire("the master is not heard", Expect::Safe, &["drop:master@3"]),
    // Drives.
    drive("a drive trips", Expect::Faults, &["trip:5@3"]),
    drive("a drive dies", Expect::Faults, &["dead:5@3"]),
    drive("a drive is silent", Expect::Safe, &["silence:5@3"]),
    drive("a drive restarts", Expect::Faults, &["reboot:5@3"]),
    drive("an encoder sticks", Expect::Safe, &["stick:5@3"]),
    drive("an encoder jumps", Expect::Safe, &["jump:5:0.02@3"]),
    class("another node with the master's id", Expect::Faults, same_node_id),
    // Sources.
    class("source with stamps of the wall clock", Expect::Holds, |t| {
        source(t, |_, k| (1_700_000_000_000_000_000 + k, ball()))
    }),
    class("source with a radius of 0", Expect::Holds, |t| {
        source(t, |now, _| (now, Obstacle::ball(1, [0.3, 0.0, -1.0], 0.0)))
    }),
    class("source with NaN", Expect::Holds, |t| {
        source(t, |now, _| (now, Obstacle::ball(1, [f64::NAN, 0.0, -1.0], 0.1)))
    }),
    class("source from the past", Expect::Holds, |t| source(t, |now, _| (now - 60_000_000_000, ball()))),
    class("nine sources", Expect::Holds, nine_sources),
    class("another process under the camera's id", Expect::GoesOn, impostor),
    class("a thousand sets a second", Expect::Safe, fast_source),
    class("source that comes and leaves", Expect::GoesOn, coming_and_leaving),
    class("ball that appears on the arm", Expect::Safe, |t| {
        source(t, |now, _| (now, Obstacle::ball(1, [0.0, 0.0, -1.5], 0.05)))
    }),
    // Requests.
    class("unknown requests", Expect::GoesOn, unknown_requests),
    class("target that is no number", Expect::GoesOn, bad_target),
    class("disarm while it moves", Expect::Stops, |t| order(t, Word::Disarm)),
    class("hold while it moves", Expect::Holds, |t| order(t, Word::Hold)),
    class("all requests in any order", Expect::Safe, any_requests),
];

fn nothing(_: &mut Trial) {}

fn signal(child: &Child, signal: Signal) {
    let _ = kill_process(Pid::from_child(child), signal);
}

fn signal_daemon(t: &mut Trial, what: Signal) {
    signal(&t.daemon, what);
    if what == Signal::KILL {
        t.daemon.wait().unwrap();
    }
}

fn freeze_daemon(t: &mut Trial, ms: u64) {
    signal(&t.daemon, Signal::STOP);
    std::thread::sleep(Duration::from_millis(ms));
    signal(&t.daemon, Signal::CONT);
}

fn signal_camera(t: &mut Trial, what: Signal) {
    if let Some(camera) = &t.camera {
        signal(camera, what);
    }
}

fn camera_pauses(t: &mut Trial) {
    signal_camera(t, Signal::STOP);
    std::thread::sleep(Duration::from_millis(300));
    signal_camera(t, Signal::CONT);
}

fn clients_killed(t: &mut Trial) {
    for _ in 0..10 {
        t.helper(&["obstacles", "list"]);
        t.pause(1, 40);
        let client = t.helpers.last_mut().unwrap();
        let _ = client.kill();
        client.wait().unwrap();
    }
}

fn clients_stopped(t: &mut Trial) {
    for _ in 0..5 {
        t.helper(&["obstacles", "list"]);
        t.pause(1, 40);
        signal(t.helpers.last().unwrap(), Signal::STOP);
    }
}

fn second_daemon(t: &mut Trial) {
    let child = t.helper(&["run"]);
    assert_eq!(child.wait().unwrap().code(), Some(2));
}

fn shared_files(t: &Trial) -> Vec<PathBuf> {
    let entries = std::fs::read_dir("/dev/shm").unwrap().flatten();
    entries.filter(|e| e.file_name().to_string_lossy().starts_with(t.place.prefix())).map(|e| e.path()).collect()
}

fn remove_files(t: &mut Trial) {
    shared_files(t).iter().for_each(|file| drop(std::fs::remove_file(file)));
}

fn remove_root(t: &mut Trial) {
    std::fs::remove_dir_all(t.place.folder.path().join("ipc")).unwrap();
}

fn hold_shm(t: &mut Trial) {
    let child = Command::new("flock").args(["/dev/shm", "sleep", "30"]).spawn().unwrap();
    t.keep(child);
    t.pause(20, 100);
    t.helper(&["obstacles", "list"]);
}

fn hold_turn(t: &mut Trial) {
    let turn = sinew::ipc::run_dir(None).unwrap_or_else(|| PathBuf::from("/run/sinew")).join("turn");
    let Ok(file) = File::open(turn) else { return };
    flock(&file, FlockOperation::NonBlockingLockExclusive).ok();
    let _ = t.place.client();
}

fn unfinished_files(t: &mut Trial) {
    for name in ["a.data", "b.connection", "c.dynamic"] {
        File::create(format!("/dev/shm/{}{name}", t.place.prefix())).unwrap();
    }
    let _ = t.place.client();
}

fn cut_management(t: &mut Trial) {
    let file = shared_files(t).into_iter().find(|f| f.to_string_lossy().ends_with(".global_mgmt"));
    File::create(file.unwrap()).unwrap();
    t.helper(&["obstacles", "list"]);
}

fn links(t: &mut Trial) {
    let precious = t.place.folder.path().join("precious");
    std::fs::write(&precious, "precious").unwrap();
    for name in ["x.data", "y.global_mgmt"] {
        symlink(&precious, format!("/dev/shm/{}{name}", t.place.prefix())).unwrap();
    }
    let _ = t.place.client();
    assert_eq!(std::fs::read_to_string(precious).unwrap(), "precious");
}

fn open_to_all(t: &Trial) {
    std::fs::set_permissions(t.place.folder.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    for file in &t.place.files {
        std::fs::set_permissions(file, std::fs::Permissions::from_mode(0o644)).unwrap();
    }
}

fn strangers(t: &mut Trial, words: &[&str]) {
    open_to_all(t);
    for word in words {
        let mut command = t.place.sinew(&[word]);
        let child = command.uid(STRANGER).gid(STRANGER).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        assert_ne!(t.keep(child).wait().unwrap().code(), Some(0), "{word}");
    }
}

fn stranger_script(t: &mut Trial, script: &str) {
    open_to_all(t);
    let wrapper = t.place.folder.path().join("sinew-of-a-stranger");
    let files: Vec<String> = t.place.files.iter().map(|f| f.display().to_string()).collect();
    let text = format!("#!/bin/sh\nexec {} \"$@\" --config {}\n", env!("CARGO_BIN_EXE_sinew"), files.join(" "));
    std::fs::write(&wrapper, text).unwrap();
    std::fs::set_permissions(&wrapper, std::fs::Permissions::from_mode(0o755)).unwrap();
    let socket = std::fs::read_dir(t.place.run.join("paper")).unwrap().flatten().next().unwrap().path();
    let mut command = Command::new("sh");
    command.args(["-c", script]).env("SINEW", wrapper).env("PREFIX", t.place.prefix()).env("BUS", &t.place.bus);
    command.env("SOCKET", socket).env("FOLDER", t.place.folder.path()).env("DAEMON", t.daemon.id().to_string());
    command.uid(STRANGER).gid(STRANGER).stdout(Stdio::null()).stderr(Stdio::null());
    let child = command.spawn().unwrap();
    t.keep(child).wait().unwrap();
}

fn roots_clients(t: &mut Trial) {
    for request in [["obstacles", "list"], ["status", "--json"], ["obstacles", "list"]] {
        t.helper(&request).wait().unwrap();
    }
    // A file of another owner beside the daemon's.
    let file = format!("/dev/shm/{}other.data", t.place.prefix());
    File::create(&file).unwrap();
    chown(&file, Some(STRANGER), None).unwrap();
    t.helper(&["obstacles", "list"]).wait().unwrap();
}

fn busy(_: &mut Trial) {
    let until = Instant::now() + Duration::from_secs(1);
    let threads: Vec<_> = (0..16).map(|_| std::thread::spawn(move || while Instant::now() < until {})).collect();
    threads.into_iter().for_each(|thread| thread.join().unwrap());
}

/// Many connections at once that say something, or nothing, and stay.
fn flood(t: &mut Trial, text: &[u8], count: usize) {
    let socket = std::fs::read_dir(t.place.run.join("paper")).unwrap().flatten().next().unwrap().path();
    let mut open = Vec::new();
    for _ in 0..count {
        if let Ok(mut stream) = UnixStream::connect(&socket) {
            let _ = stream.write_all(text);
            open.push(stream);
        }
    }
    t.pause(10, 50);
}

fn flood_of_requests(t: &mut Trial) {
    let mut client = t.place.client();
    for _ in 0..500 {
        let _ = client.ask(RequestKind::Status, Duration::from_secs(5));
    }
    let _ = client.ask(RequestKind::Track, Duration::from_secs(5));
}

fn same_node_id(t: &mut Trial) {
    use sinew_hal::can::{CanBus, Frame, Id};
    let mut bus = sinew_hal::virtual_bus::VirtualBus::open(&t.place.bus, false).unwrap();
    let beat = Frame::classic(Id::Standard(0x700 + 127), &[5]).unwrap();
    for _ in 0..10 {
        bus.send(&beat).unwrap();
    }
}

fn ball() -> Obstacle {
    Obstacle::ball(1, [0.3, 0.1, -1.0], 0.05)
}

/// A source that sends sets of one obstacle for a while, stamped as it pleases.
fn source(t: &mut Trial, what: impl Fn(u64, u64) -> (u64, Obstacle)) {
    let client = t.place.client();
    let mut publisher = client.obstacles(77).unwrap();
    for k in 0..12 {
        let (capture_ns, obstacle) = what(monotonic_ns(), k);
        let mut set = Obstacles::default();
        assert!(set.push(obstacle));
        publisher.publish(&mut set, capture_ns).unwrap();
        t.pause(5, 10);
    }
}

fn nine_sources(t: &mut Trial) {
    let client = t.place.client();
    let mut publishers: Vec<_> = (100..109).map(|id| client.obstacles(id).unwrap()).collect();
    for _ in 0..30 {
        for publisher in &mut publishers {
            publisher.publish(&mut Obstacles::default(), monotonic_ns()).unwrap();
        }
        t.pause(10, 20);
    }
    // They stay until the arm was looked at.
    std::mem::forget(publishers);
    std::mem::forget(client);
}

fn impostor(t: &mut Trial) {
    let client = t.place.client();
    let mut publisher = client.obstacles(0x0b5).unwrap();
    for _ in 0..20 {
        publisher.publish(&mut Obstacles::default(), monotonic_ns()).unwrap();
        t.pause(5, 10);
    }
}

fn fast_source(t: &mut Trial) {
    let client = t.place.client();
    let mut publisher = client.obstacles(77).unwrap();
    let until = Instant::now() + Duration::from_millis(500);
    while Instant::now() < until {
        let mut set = Obstacles::default();
        assert!(set.push(ball()));
        publisher.publish(&mut set, monotonic_ns()).unwrap();
        std::thread::sleep(Duration::from_millis(1));
    }
    leave(&mut publisher);
}

fn leave(publisher: &mut sinew::ipc::SourcePublisher<Obstacles>) {
    let mut set = Obstacles { flags: FLAG_LEAVING, ..Obstacles::default() };
    publisher.publish(&mut set, monotonic_ns()).unwrap();
    std::thread::sleep(Duration::from_millis(20));
}

fn coming_and_leaving(t: &mut Trial) {
    let client = t.place.client();
    for id in 200..210 {
        let mut publisher = client.obstacles(id).unwrap();
        publisher.publish(&mut Obstacles::default(), monotonic_ns()).unwrap();
        t.pause(5, 15);
        leave(&mut publisher);
    }
}

fn unknown_requests(t: &mut Trial) {
    let mut client = t.place.client();
    for kind in [0, 10, 77, u32::MAX] {
        let request = Request { kind, ..Request::new(RequestKind::Status) };
        assert!(!client.request(request, Duration::from_secs(5)).unwrap().is_accepted());
    }
}

fn bad_target(t: &mut Trial) {
    let mut client = t.place.client();
    let target = Target { position_m: [f64::NAN; 3], ..Target::default() };
    assert!(!client.set_target(99, target, Duration::from_secs(5)).unwrap().is_accepted());
}

fn order(t: &mut Trial, word: Word) {
    t.place.address().ask(word, Duration::from_secs(5)).unwrap();
}

fn any_requests(t: &mut Trial) {
    let mut client = t.place.client();
    for _ in 0..20 {
        let kind = RequestKind::ALL[t.rng.random_range(0..RequestKind::ALL.len())];
        let _ = client.ask(kind, Duration::from_secs(5));
        t.pause(1, 50);
    }
}
