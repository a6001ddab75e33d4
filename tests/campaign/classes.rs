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
    /// Other users have roles in it: [`CAMERA`] may publish obstacles.
    pub roles: bool,
    /// Where the daemon records to.
    pub record: Option<Disk>,
    /// Time for the outcome beyond the usual (s).
    pub waits_s: f64,
    pub does: fn(&mut Trial),
}

const fn class(name: &'static str, expect: Expect, does: fn(&mut Trial)) -> Class {
    Class { name, expect, root: false, drives: &[], wire: &[], roles: false, record: None, waits_s: 0.0, does }
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

/// What a recording is written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disk {
    /// A folder of the trial.
    Folder,
    /// A disk of a megabyte.
    Small,
}

/// A user that may publish obstacles where there are roles.
pub const CAMERA: u32 = 54_323;
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
    class("shared memory full", Expect::Safe, fill_shared_memory),
    class("client in another time namespace", Expect::Safe, other_time),
    // Disks.
    Class { record: Some(Disk::Folder), ..class("folder of the recording removed", Expect::GoesOn, remove_recording) },
    Class { record: Some(Disk::Small), ..by_root("disk of the recording full", Expect::GoesOn, nothing) },
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
    by_root("stranger gives a target", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "\"$SINEW\" target --pose 1,0,-1,1,0,0,0; echo 'target {\"position_m\":[1,0,0],\"quaternion\":[1,0,0,0]}' | talk",
        );
    }),
    by_root("stranger publishes over the socket", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "for w in 'obstacles 181' 'obstacles 77' 'targets 12'; do printf 'publish %s\\n{}\\n{}\\n' \"$w\" | talk; done",
        );
    }),
    by_root("stranger presses the emergency stop", Expect::GoesOn, |t| {
        strangers(t, &["emergency-stop", "clear", "home", "disarm"]);
    }),
    by_root("stranger holds connections open", Expect::GoesOn, |t| {
        stranger_script(t, "for i in $(seq 60); do (sleep 1 | talk) & done; wait");
    }),
    by_root("stranger sends rubbish", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "for i in $(seq 10); do head -c 300000 /dev/urandom | talk; yes stop | head -c 200000 | talk; done",
        );
    }),
    by_root("stranger runs a daemon of the same arm", Expect::GoesOn, |t| {
        stranger_script(t, "timeout 2 \"$SINEW\" run");
    }),
    by_root("stranger runs a plant on the same bus", Expect::GoesOn, |t| {
        stranger_script(t, "timeout 1 sh -c 'exec \"$SINEW\" demo tip --fast --duration 0.1 --can $BUS'");
    }),
    by_root("stranger makes folders and links in the way", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "mkdir \"$FOLDER/run/other\" \"$FOLDER/ipc\"; ln -s /etc/passwd /dev/shm/${PREFIX}z.data; mkdir /dev/shm/${PREFIX}d; \
             mkfifo /dev/shm/${PREFIX}f.data; mv \"$SOCKET\" /tmp",
        );
    }),
    by_root("stranger changes limits and scheduling", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "renice 19 -p $DAEMON; prlimit --pid $DAEMON --nofile=3; taskset -p 1 $DAEMON; chrt -i -p 0 $DAEMON; \
             echo 15 > /proc/$DAEMON/oom_score_adj; cat /proc/$DAEMON/mem /proc/$DAEMON/fd/*",
        );
    }),
    by_root("stranger takes names of sockets", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "timeout 1 python3 -c \"import socket,time;s=[socket.socket(socket.AF_UNIX) for _ in range(9)];[x.bind(chr(0)+n) for x,n in \
             zip(s,['sinew','sinew-paper','sinew/paper','sinew/paper/control','paper','control','sinew0','iox2_','sinew-run'])];time.sleep(1)\"",
        );
    }),
    by_root("stranger with a domain of his own", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "own=$(mktemp -d); export SINEW_IPC_PREFIX=$PREFIX SINEW_IPC_ROOT=$own/; \"$SINEW\" obstacles list; rm -rf \"$own\"",
        );
    }),
    by_root("stranger kills and stops clients", Expect::GoesOn, |t| {
        stranger_script(
            t,
            "for p in $(ls /proc | grep '^[0-9]*$'); do [ $p = $$ ] || kill -STOP $p; [ $p = $$ ] || kill -KILL $p; done",
        );
    }),
    by_root("stranger fills the process table", Expect::Safe, |t| {
        stranger_script(t, "ulimit -p 200; for i in $(seq 150); do sleep 1 & done; wait");
    }),
    Class { roles: true, ..by_root("a camera oversteps", Expect::GoesOn, oversteps) },
    Class { roles: true, ..by_root("a camera of another user is killed", Expect::Holds, camera_by_socket) },
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

fn strangers(t: &mut Trial, words: &[&str]) {
    t.place.open_to_all();
    for word in words {
        let mut command = t.place.sinew(&[word]);
        let child = command.uid(STRANGER).gid(STRANGER).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        assert_ne!(t.keep(child).wait().unwrap().code(), Some(0), "{word}");
    }
}

fn stranger_script(t: &mut Trial, script: &str) {
    t.place.open_to_all();
    let wrapper = t.place.folder.path().join("sinew-of-a-stranger");
    let files: Vec<String> = t.place.files.iter().map(|f| f.display().to_string()).collect();
    let text = format!("#!/bin/sh\nexec {} \"$@\" --config {}\n", t.place.program().display(), files.join(" "));
    // Says what it reads to the arm's socket.
    let script = format!(
        "talk() {{ python3 -c 'import os,socket,sys\ns=socket.socket(socket.AF_UNIX)\ns.connect(os.environ[\"SOCKET\"])\n\
         try: s.sendall(sys.stdin.buffer.read()); s.settimeout(1); s.recv(9999)\nexcept OSError: pass'; }}\n\"$SINEW\" --version || exit 99\n{script}"
    );
    std::fs::write(&wrapper, text).unwrap();
    std::fs::set_permissions(&wrapper, std::fs::Permissions::from_mode(0o755)).unwrap();
    let socket = std::fs::read_dir(t.place.run.join("paper")).unwrap().flatten().next().unwrap().path();
    let mut command = Command::new("sh");
    command.args(["-c", &script]).env("SINEW", wrapper).env("PREFIX", t.place.prefix()).env("BUS", &t.place.bus);
    command.env("SOCKET", socket).env("FOLDER", t.place.folder.path()).env("DAEMON", t.daemon.id().to_string());
    command.uid(STRANGER).gid(STRANGER).stdout(Stdio::null()).stderr(Stdio::null());
    let child = command.spawn().unwrap();
    let code = t.keep(child).wait().unwrap().code();
    assert_ne!(code, Some(99), "the stranger cannot even run the program");
}

/// What a user who may publish obstacles does beyond that.
fn oversteps(t: &mut Trial) {
    t.place.open_to_all();
    let tries: [&[&str]; 7] = [
        &["stop"],
        &["arm"],
        &["track"],
        &["clear"],
        &["target", "--pose", "1,0,-1,1,0,0,0"],
        &["emergency-stop"],
        &["status"],
    ];
    for words in tries {
        let mut command = t.place.sinew(words);
        command.uid(CAMERA).gid(CAMERA).stdout(Stdio::null()).stderr(Stdio::null());
        assert_ne!(t.keep(command.spawn().unwrap()).wait().unwrap().code(), Some(0), "{words:?}");
    }
    // Under the id of the daemon's own camera, which has it, and under one of its own, which it leaves in order.
    for (source, code) in [("181", 1), ("77", 0)] {
        let mut command = t.place.sinew(&["obstacles", "inject", "--for", "0.5", "--source", source]);
        command.uid(CAMERA).gid(CAMERA).stdout(Stdio::null()).stderr(Stdio::null());
        assert_eq!(t.keep(command.spawn().unwrap()).wait().unwrap().code(), Some(code), "{source}");
    }
}

fn camera_by_socket(t: &mut Trial) {
    t.place.open_to_all();
    let mut command = t.place.sinew(&["obstacles", "inject", "--ball", "0.3,0.1,-1,0.05", "--source", "77"]);
    command.uid(CAMERA).gid(CAMERA).stdout(Stdio::null()).stderr(Stdio::null());
    let camera = command.spawn().unwrap();
    let camera = t.keep(camera);
    std::thread::sleep(Duration::from_millis(500));
    camera.kill().unwrap();
    camera.wait().unwrap();
    std::thread::sleep(Duration::from_millis(1100));
}

/// Fills /dev/shm where it is the campaign's own (`tests/campaign/run` mounts it), for as long as the trial lasts.
fn fill_shared_memory(t: &mut Trial) {
    if std::env::var_os("SINEW_CAMPAIGN_OWN_SHM").is_none() {
        return;
    }
    let path = t.place.filler();
    let mut file = File::create(&path).unwrap();
    let block = vec![1; 1 << 20];
    while file.write_all(&block).is_ok() {}
    t.helper(&["obstacles", "list"]);
    t.pause(100, 500);
    // The rest of the trial needs what it makes anew.
    std::fs::remove_file(path).unwrap();
}

fn other_time(t: &mut Trial) {
    let program = t.place.sinew(&["obstacles", "inject", "--source", "77", "--for", "0.5"]);
    let mut command = Command::new("unshare");
    command.args(["--time", "--monotonic", "5000000", "--fork"]).arg(program.get_program()).args(program.get_args());
    let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let _ = t.keep(child).wait();
}

fn remove_recording(t: &mut Trial) {
    std::fs::remove_dir_all(t.place.folder.path().join("recordings")).unwrap();
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
    let beyond = RequestKind::ALL.iter().map(|kind| kind.wire()).max().unwrap() + 1;
    for kind in [0, beyond, 77, u32::MAX] {
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
