//! Claims about stopping: whatever is wrong around the daemon, the order arrives, and what is wrong is told in words.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "daemon_support/mod.rs"]
mod support;

use rustix::fs::{FlockOperation, flock};
use sinew::daemon::operator::{Said, Word};
use sinew::ipc::payload::RequestKind;
use std::fs::File;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use support::*;

/// What nobody waits longer for, on however busy a machine.
const HANG: Duration = Duration::from_secs(20);
/// A user that is nobody's here.
const STRANGER: u32 = 54_321;
/// Another one, the daemon's in some tests.
const ROBOT: u32 = 54_322;

fn is_root(what: &str) -> bool {
    let root = rustix::process::geteuid().is_root();
    if !root {
        eprintln!("{what}: not tested, it needs root");
    }
    root
}

/// Runs a command to its end within [`HANG`].
fn finish(mut command: Command) -> (Option<i32>, String) {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let deadline = Instant::now() + HANG;
    while child.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            let _ = child.kill();
            panic!("{command:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let out = child.wait_with_output().unwrap();
    (out.status.code(), format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr)))
}

/// A command of an operator, as some user.
fn as_user(place: &Place, uid: u32, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = place.sinew(arguments);
    command.uid(uid).gid(uid);
    finish(command)
}

/// An arm that holds is told to stop while something is wrong: the order is carried out, and the drives are off.
fn stops_while(place: &Place, wrong: impl FnOnce(&Place)) {
    let _plant = Plant::start(place, false, &[]);
    let daemon = place.daemon(&[]);
    place.arm();
    wrong(place);
    let (code, said) = finish(place.sinew(&["stop"]));
    assert_eq!((code, said.trim()), (Some(0), "stop: stopping"));
    place.until("disarmed", |s| s.mode == "disarmed" && s.drives.enabled == 0);
    let (code, said) = finish(place.sinew(&["status"]));
    assert!(code == Some(0) && said.contains("disarmed"), "{said}");
    daemon.kill();
}

fn in_shared_memory(place: &Place) -> Vec<PathBuf> {
    let entries = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.path());
    entries.filter(|p| p.file_name().unwrap().to_string_lossy().starts_with(place.prefix())).collect()
}

#[test]
fn a_stop_needs_none_of_the_files_in_shared_memory() {
    let place = Place::shipped();
    stops_while(&place, |place| {
        let files = in_shared_memory(place);
        assert!(files.len() > 5, "{files:?}");
        files.iter().for_each(|file| std::fs::remove_file(file).unwrap());
        let _ = std::fs::remove_dir_all(place.folder.path().join("ipc"));
    });
}

#[test]
fn locks_that_others_hold_keep_nobody_from_anything() {
    let place = Place::shipped();
    let folder = File::open("/dev/shm").unwrap();
    let turn = place.run.join("turn");
    std::fs::create_dir(&place.run).unwrap();
    let own = File::create(&turn).unwrap();
    flock(&folder, FlockOperation::LockExclusive).unwrap();
    flock(&own, FlockOperation::LockExclusive).unwrap();
    // The daemon starts, clients come and go, and the arm stops.
    stops_while(&place, |place| assert!(place.request(RequestKind::Hold).is_accepted()));
    assert_eq!(std::fs::metadata(&turn).unwrap().mode() & 0o7, 0o4, "as this test made it");
}

#[test]
fn what_a_process_left_unfinished_in_shared_memory_is_removed() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let daemon = place.daemon(&[]);
    let management =
        in_shared_memory(&place).into_iter().find(|p| p.to_string_lossy().ends_with(".global_mgmt")).unwrap();
    let (terminated, said) = daemon.terminate();
    assert!(terminated.success(), "{said}");
    // As left by a process that died between making it and giving it a size, at the domain's next start.
    File::create(&management).unwrap();
    let daemon = place.daemon(&[]);
    assert!(std::fs::metadata(&management).unwrap().len() > 0, "made anew");
    File::create(&management).unwrap().set_permissions(std::fs::Permissions::from_mode(0o200)).unwrap();
    let (code, said) = finish(place.sinew(&["obstacles", "list"]));
    assert!(code == Some(0) && said.contains("no obstacles"), "{said}");
    drop(daemon);
}

#[test]
fn the_socket_of_a_killed_daemon_is_no_daemon_and_in_nobodys_way() {
    let place = Place::shipped();
    place.daemon(&[]).kill();
    let (code, said) = finish(place.sinew(&["stop"]));
    assert!(code == Some(1) && said.contains("no daemon running"), "{said}");
    let _daemon = place.daemon(&[]);
    let again = finish(place.sinew(&["run"]));
    assert!(again.0 == Some(2) && again.1.contains("already running"), "{again:?}");
}

#[test]
fn users_who_may_not_are_told_and_change_nothing() {
    if !is_root("users") {
        return;
    }
    let place = Place::new(|file, text| {
        let access = format!("\n[access]\nstop = [\"@{ROBOT}\"]\nsee = [\"{STRANGER}\"]\n");
        if file == "drives.toml" { text + &access } else { text }
    });
    place.open_to_all();
    let _plant = Plant::start(&place, false, &[]);
    let _daemon = place.daemon(&[]);
    place.arm();
    for word in ["stop", "hold", "disarm"] {
        let (code, said) = as_user(&place, STRANGER, &[word]);
        assert!(code == Some(1) && said.contains(&format!("may not ask for {word}")), "{said}");
    }
    assert_eq!(as_user(&place, STRANGER, &["status"]).0, Some(0));
    for request in [vec!["arm"], vec!["home"], vec!["obstacles", "inject", "--for", "0.1"]] {
        let (code, said) = as_user(&place, STRANGER, &request);
        assert!(code == Some(1) && said.contains("may not ask for"), "{said}");
    }
    assert_eq!(place.status().unwrap().mode, "holding");
    let (code, said) = as_user(&place, ROBOT, &["status"]);
    assert!(code == Some(1) && said.contains("may not ask for status"), "{said}");
    let (code, said) = as_user(&place, ROBOT, &["stop"]);
    assert_eq!(code, Some(0), "{said}");
    place.until("disarmed", |s| s.mode == "disarmed");
}

#[test]
fn whom_access_names_may_do_that_and_no_more() {
    if !is_root("roles") {
        return;
    }
    let (commander, camera) = (ROBOT, STRANGER);
    let place = Place::new(|file, text| {
        let access = format!("\n[access]\ncommand = [\"{commander}\"]\npublish = [\"@{camera}=7\"]\n");
        let text = text.replace("[obstacles]\n", "[obstacles]\nrequired = [7]\n");
        if file == "drives.toml" { text + &access } else { text }
    });
    assert_eq!(place.config().obstacles.required, [7]);
    place.open_to_all();
    let _plant = Plant::start(&place, false, &[]);
    let _daemon = place.daemon(&[]);
    place.until("drives ready", |s| s.drives.ready == s.drives.count && s.drives.count > 0);
    let commands = |request: &[&str]| as_user(&place, commander, request);
    let deadline = Instant::now() + WAIT;
    while commands(&["arm"]).0 != Some(0) {
        assert!(Instant::now() < deadline, "{:?}", commands(&["arm"]));
    }
    place.until("holding", |s| s.mode == "holding");
    let pose = ["target", "--pose", "0.05,0,-2.72,0.70710678,0,0.70710678,0"];
    assert_eq!(commands(&pose), (Some(0), "target: holding\n".into()));
    // The source that must be there is not.
    let (code, said) = commands(&["track"]);
    assert!(code == Some(1) && said.contains("obstacles are unknown"), "{said}");
    let mut sees = place.sinew(&["obstacles", "inject", "--ball", "0.4,0,-1,0.1", "--source", "7"]);
    let seen = Running(sees.uid(camera).gid(camera).stderr(Stdio::null()).spawn().unwrap());
    place.until("the camera", |s| s.obstacles.iter().any(|o| o.id == 7 && o.health == "fresh"));
    assert_eq!(commands(&["track"]), (Some(0), "track: tracking\n".into()));
    for (user, request, refused) in [
        (camera, vec!["stop"], "may not ask for stop"),
        (camera, vec!["track"], "may not ask for track"),
        (camera, vec!["status"], "may not ask for status"),
        (camera, pose.to_vec(), "may not ask for target"),
        (camera, vec!["obstacles", "inject", "--source", "8"], "may not ask for publish obstacles 8"),
        (commander, vec!["obstacles", "inject", "--source", "7"], "may not ask for publish obstacles 7"),
        (STRANGER + 5, vec!["stop"], "may not ask for anything"),
    ] {
        let (code, said) = as_user(&place, user, &request);
        assert!(code == Some(1) && said.contains(refused), "{request:?}: {said}");
    }
    let (code, said) = commands(&["obstacles", "list", "--json"]);
    assert!(code == Some(0) && said.contains("\"source\":7"), "{said}");
    assert_eq!(place.status().unwrap().mode, "tracking");
    // Another process under its id, be it the daemon's own user's: nobody knows which of them sees what is there.
    let (code, said) = finish(place.sinew(&["obstacles", "inject", "--source", "7", "--for", "5"]));
    assert!(code == Some(1) && said.contains("another process"), "{said}");
    place.until("contested", |s| s.mode == "holding");
    place.until("alone again", |s| s.obstacles.iter().any(|o| o.id == 7 && o.health == "fresh"));
    assert_eq!(commands(&["track"]).0, Some(0));
    drop(seen);
    let report = place.until("the camera is gone", |s| s.mode == "holding");
    let alarm = report.alarms.iter().find(|a| a.about == "obstacles 7");
    assert!(alarm.is_some_and(|a| a.clears.contains("obstacles.required")), "{:?}", report.alarms);
    assert_eq!(commands(&["stop"]).0, Some(0));
    place.until("disarmed", |s| s.mode == "disarmed");
}

#[test]
fn root_stops_the_daemon_of_an_ordinary_user_and_is_no_burden_to_it() {
    if !is_root("root's own commands") {
        return;
    }
    let place = Place::shipped();
    place.open_to_all();
    chown(place.folder.path(), Some(ROBOT), Some(ROBOT)).unwrap();
    let mut command = place.sinew(&["run"]);
    let child = command.uid(ROBOT).gid(ROBOT).stderr(Stdio::piped()).spawn().unwrap();
    let daemon = Daemon { child };
    place.until("a first tick", |s| s.ticks > 10);
    // Over shared memory as that user, over the socket as root.
    let sees = vec!["obstacles", "list", "--json"];
    for request in [vec!["home"], sees.clone(), vec!["hold"], sees, vec!["obstacles", "inject", "--for", "0.3"]] {
        let (code, said) = finish(place.sinew(&request));
        assert!(code.is_some() && !said.contains("belongs to"), "{request:?}: {said}");
    }
    for file in in_shared_memory(&place) {
        let owner = std::fs::metadata(&file).map(|there| there.uid());
        assert!(owner.is_err() || owner.is_ok_and(|uid| uid == ROBOT), "{} is of {STRANGER}", file.display());
    }
    let (code, said) = finish(place.sinew(&["stop"]));
    assert!(code == Some(1) && said.contains("`sinew arm` first") || code == Some(0), "{said}");
    let (status, said) = daemon.terminate();
    assert!(status.success(), "{said}");
    place.domain.sweep();
}

#[test]
fn what_others_made_beforehand_is_not_used_and_told() {
    if !is_root("folders of others") {
        return;
    }
    // The root path of shared memory, and the folder of the socket.
    for (folder, key) in [("ipc", "ipc.root_path"), ("run", "run")] {
        let place = Place::shipped();
        let path = place.folder.path().join(folder);
        std::fs::create_dir(&path).unwrap();
        chown(&path, Some(STRANGER), Some(STRANGER)).unwrap();
        let (code, said) = finish(place.sinew(&["run"]));
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains(&format!("belongs to user {STRANGER}")) && said.contains(key), "{said}");
        std::fs::remove_dir(&path).unwrap();
        // A link to something of one's own is none either.
        let target = place.folder.path().join("target");
        std::fs::create_dir(&target).unwrap();
        symlink(&target, &path).unwrap();
        let (code, said) = finish(place.sinew(&["run"]));
        assert!(code == Some(2) && said.contains("symbolic link"), "{said}");
        std::fs::remove_file(&path).unwrap();
    }
    // A virtual bus: of somebody else, and a link that would overwrite what it points to.
    let place = Place::shipped();
    let bus = Path::new("/dev/shm").join(format!("sinew-bus-{}", place.bus));
    std::fs::write(&bus, "").unwrap();
    chown(&bus, Some(STRANGER), Some(STRANGER)).unwrap();
    let (code, said) = finish(place.sinew(&["run"]));
    assert!(code == Some(2) && said.contains(&format!("belongs to user {STRANGER}")), "{said}");
    std::fs::remove_file(&bus).unwrap();
    let precious = place.folder.path().join("precious");
    std::fs::write(&precious, "precious").unwrap();
    symlink(&precious, &bus).unwrap();
    let (code, said) = finish(place.sinew(&["run"]));
    assert_eq!(code, Some(2), "{said}");
    assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
    std::fs::remove_file(&bus).unwrap();
}

/// Runs a script with a /dev/shm of so many bytes of its own.
fn with_shared_memory(size: &str, script: &str) -> (Option<i32>, String) {
    let mut command = Command::new("unshare");
    let mounted = format!("mount -t tmpfs -o size={size} tmpfs /dev/shm && {script}");
    command.args(["--mount", "--propagation", "private", "sh", "-c", &mounted]);
    finish(command)
}

#[test]
fn full_shared_memory_is_told_in_words() {
    if !is_root("full shared memory") || with_shared_memory("1m", "true").0 != Some(0) {
        return;
    }
    let place = Place::shipped();
    let words: Vec<String> = place.files.iter().map(|file| file.display().to_string()).collect();
    let run = format!("exec {} run --config {}", env!("CARGO_BIN_EXE_sinew"), words.join(" "));
    let (code, said) = with_shared_memory("1m", &run);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("/dev/shm is full") && said.contains("df /dev/shm"), "{said}");
}

#[test]
fn the_socket_answers_while_the_loop_and_every_other_thread_of_it_is_busy_with_nothing() {
    // Without a plant, without clients: in lockstep the loop waits for its drives, and an order is answered all the same.
    let place = Place::shipped();
    let mut command = place.sinew(&["run", "--lockstep"]);
    let daemon = Daemon { child: command.stderr(Stdio::piped()).spawn().unwrap() };
    place.until("there", |s| s.ticks == 0);
    match place.address().ask(Word::Stop, HANG).unwrap() {
        Said::Answer(answer) => assert!(!answer.accepted, "{answer:?}"),
        other => panic!("{other:?}"),
    }
    let (status, said) = daemon.terminate();
    assert!(status.code().is_some(), "{said}");
}

#[test]
fn a_full_disk_ends_the_recording_and_not_the_arm_and_is_told_at_the_end() {
    if !is_root("a full disk") || with_shared_memory("1m", "true").0 != Some(0) {
        return;
    }
    let place = Place::new(|file, text| match file {
        "drives.toml" => text + "\n[recording]\nfree_mib = 0\n",
        _ => text,
    });
    let disk = place.folder.path().join("disk");
    std::fs::create_dir(&disk).unwrap();
    let _plant = Plant::start(&place, false, &[]);
    let files: Vec<String> = place.files.iter().map(|file| file.display().to_string()).collect();
    let (program, disk) = (env!("CARGO_BIN_EXE_sinew"), disk.display());
    let run = format!("exec {program} run --record {disk} --config {}", files.join(" "));
    let script = format!("mount -t tmpfs -o size=1m tmpfs {disk} && {run}");
    let mut command = Command::new("unshare");
    command.args(["--mount", "--propagation", "private", "sh", "-c", &script]).stderr(Stdio::piped());
    let daemon = Daemon { child: command.spawn().unwrap() };
    let recording = |s: &sinew::daemon::status::StatusReport| s.alarms.iter().any(|a| a.about == "recording");
    place.until("the disk is full", recording);
    place.arm();
    let (status, said) = daemon.terminate();
    assert_eq!(status.code(), Some(2), "{said}");
    assert!(said.contains("recording ended early"), "{said}");
}

#[test]
fn whoever_injects_learns_whether_it_is_taken() {
    let place = Place::shipped();
    let _plant = Plant::start(&place, false, &[]);
    let _daemon = place.daemon(&[]);
    place.until("a first tick", |s| s.ticks > 0);
    let (code, said) = finish(place.sinew(&["obstacles", "inject", "--ball", "0,0,0,1e5", "--for", "10"]));
    assert!(code == Some(1) && said.contains("dimension out of range"), "{said}");
    // A camera that sees nothing, and a ball under the same id.
    let camera = Running(place.sinew(&["obstacles", "inject"]).spawn().unwrap());
    place.until("the camera", |s| s.obstacles.iter().any(|o| o.health == "fresh"));
    let (code, said) = finish(place.sinew(&["obstacles", "inject", "--ball", "0.3,0,-1,0.1", "--for", "10"]));
    assert!(code == Some(1) && said.contains("--source 182"), "{said}");
    let beside = ["obstacles", "inject", "--ball", "0.3,0,-1,0.1", "--for", "1", "--source", "182"];
    let (code, said) = finish(place.sinew(&beside));
    assert!(code == Some(0) && said.contains("are taken"), "{said}");
    drop(camera);
}

#[test]
fn no_thread_left_is_told_and_nothing_panics() {
    if !is_root("limits of processes") {
        return;
    }
    let place = Place::shipped();
    place.open_to_all();
    chown(place.folder.path(), Some(ROBOT), Some(ROBOT)).unwrap();
    let files: Vec<String> = place.files.iter().map(|file| file.display().to_string()).collect();
    for threads in 1..=8 {
        let run = format!(
            "ulimit -u {threads}; exec {} run --ticks 3 --config {}",
            place.program().display(),
            files.join(" ")
        );
        let mut command = Command::new("bash");
        command.args(["-c", &run]).uid(ROBOT).gid(ROBOT);
        let (code, said) = finish(command);
        assert!(!said.contains("panicked"), "{threads}: {said}");
        assert!(code == Some(0) || code == Some(2) && said.contains("os error 11"), "{threads}: {code:?}: {said}");
    }
    place.domain.sweep();
}

#[test]
fn too_few_open_files_are_told_as_such() {
    let place = Place::shipped();
    let files: Vec<String> = place.files.iter().map(|file| file.display().to_string()).collect();
    for limit in [8, 14, 24, 32, 40] {
        let run = format!("ulimit -n {limit}; exec {} run --config {}", env!("CARGO_BIN_EXE_sinew"), files.join(" "));
        let mut command = Command::new("sh");
        command.args(["-c", &run]);
        let (code, said) = finish(command);
        assert_eq!(code, Some(2), "{limit}: {said}");
        assert!(said.contains("ulimit -n") || said.contains("os error 24"), "{limit}: {said}");
        assert!(said.len() < 1000, "{limit}: {} bytes", said.len());
        // A start that fails half way for want of descriptors cannot remove everything.
        in_shared_memory(&place).iter().for_each(|file| std::fs::remove_file(file).unwrap());
        let _ = std::fs::remove_dir_all(place.folder.path().join("ipc"));
    }
}
