//! The virtual bus between processes that come, go and are killed.
//!
//! The test program starts itself again with `SINEW_BUS_CHILD` naming a part to play.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a helper that fails is a test that fails

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use sinew_hal::can::{CanBus, Frame, Id};
use sinew_hal::virtual_bus::{Role, VirtualBus, claim, path_of};

const WAIT: Duration = Duration::from_secs(20);

fn frame(id: u16, number: u32) -> Frame {
    Frame::classic(Id::Standard(id), &number.to_le_bytes()).unwrap()
}

fn bus_name(test: &str) -> String {
    format!("processes-{test}-{}", std::process::id())
}

/// Starts this program again to run only `child`, in the part given.
fn start(part: &str, bus: &str) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child", "--nocapture", "--test-threads=1"])
        .env("SINEW_BUS_CHILD", part)
        .env("SINEW_BUS_NAME", bus)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Waits until a child says that it is ready; keep what it returns, or the child's further output fails.
fn ready(child: &mut Child) -> impl Iterator<Item = String> + use<> {
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.any(|l| l.contains("ready")), "the child ended early");
    lines
}

/// Not a claim: the parts that the other tests' children play.
#[test]
fn child() {
    let Ok(part) = std::env::var("SINEW_BUS_CHILD") else { return };
    let name = std::env::var("SINEW_BUS_NAME").unwrap();
    let mut bus = VirtualBus::open(&name, false).unwrap();
    println!("ready");
    match part.as_str() {
        // It is killed long before the end, which only keeps it from outliving a test that was itself killed.
        "flood" => (0..100_000_000).for_each(|i| bus.send(&frame(1, i)).unwrap_or_default()),
        "sleep" => assert_eq!(bus.receive(WAIT), Ok(None)),
        "echo" => {
            while let Ok(Some(r)) = bus.receive(WAIT) {
                if r.frame.id() == Id::Standard(0x7ff) {
                    return;
                }
                bus.send(&r.frame).unwrap();
            }
        }
        "master" => {
            let _claim = claim(&name, Role::Master).unwrap();
            println!("claimed");
            assert_eq!(bus.receive(WAIT), Ok(None));
        }
        "open-and-close" => {
            drop(bus);
            for _ in 0..200 {
                drop(VirtualBus::open(&name, false).unwrap());
            }
        }
        other => panic!("{other}"),
    }
}

#[test]
fn frames_go_from_one_process_to_another_and_back() {
    let name = bus_name("echo");
    let mut bus = VirtualBus::open(&name, false).unwrap();
    let mut child = start("echo", &name);
    let _output = ready(&mut child);
    for i in 0..2000 {
        bus.send(&frame(5, i)).unwrap();
        assert_eq!(bus.receive(WAIT).unwrap().unwrap().frame, frame(5, i));
    }
    bus.send(&frame(0x7ff, 0)).unwrap();
    assert!(child.wait().unwrap().success());
    drop(bus);
    assert!(!path_of(&name).unwrap().exists(), "the last handle did not remove the file");
}

#[test]
fn senders_killed_at_any_moment_block_nobody_and_damage_no_frame() {
    let name = bus_name("kill");
    let mut sender = VirtualBus::open(&name, false).unwrap();
    let mut receiver = VirtualBus::open(&name, false).unwrap();
    for round in 0..20 {
        let mut child = start("flood", &name);
        let _output = ready(&mut child);
        std::thread::sleep(Duration::from_micros(3000 + 137 * round));
        child.kill().unwrap();
        child.wait().unwrap();
        // Everything of the dead sender that is still in the ring, then ours: the order holds, nothing hangs.
        sender.send(&frame(2, round as u32)).unwrap();
        let mut last = None;
        loop {
            let f = receiver.receive(WAIT).unwrap().expect("the receiver hangs on a dead sender").frame;
            let number = u32::from_le_bytes(f.data().try_into().unwrap());
            if f.id() == Id::Standard(2) {
                assert_eq!(number, round as u32);
                break;
            }
            assert!(last.is_none_or(|l| number > l), "{number} after {last:?}");
            last = Some(number);
        }
        while sender.receive(Duration::ZERO).unwrap().is_some() {}
    }
    drop((sender, receiver));
    assert!(!path_of(&name).unwrap().exists());
}

#[test]
fn a_killed_receiver_leaves_the_bus_usable() {
    let name = bus_name("receiver");
    let mut sender = VirtualBus::open(&name, false).unwrap();
    let mut other = VirtualBus::open(&name, false).unwrap();
    let mut child = start("sleep", &name);
    let _output = ready(&mut child);
    std::thread::sleep(Duration::from_millis(20));
    child.kill().unwrap();
    child.wait().unwrap();
    sender.send(&frame(3, 4)).unwrap();
    assert_eq!(other.receive(WAIT).unwrap().unwrap().frame, frame(3, 4));
}

#[test]
fn the_file_of_a_killed_process_is_taken_over_by_the_next() {
    let name = bus_name("stale");
    let path: PathBuf = path_of(&name).unwrap();
    let mut child = start("flood", &name);
    let _output = ready(&mut child);
    std::thread::sleep(Duration::from_millis(5));
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(path.exists(), "a killed process cannot have removed it");
    let mut a = VirtualBus::open(&name, false).unwrap();
    let mut b = VirtualBus::open(&name, false).unwrap();
    a.send(&frame(1, 1)).unwrap();
    assert_eq!(b.receive(WAIT).unwrap().unwrap().frame, frame(1, 1));
    drop((a, b));
    assert!(!path.exists());
}

#[test]
fn processes_that_open_and_close_at_once_never_get_in_each_others_way() {
    let name = bus_name("rush");
    let children: Vec<_> = (0..4).map(|_| start("open-and-close", &name)).collect();
    for child in children {
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    }
    assert!(!path_of(&name).unwrap().exists(), "the last handle did not remove the file");
}

#[test]
fn a_bus_has_one_master_at_a_time_and_a_killed_one_is_none() {
    let name = bus_name("claim");
    let mut child = start("master", &name);
    let mut output = ready(&mut child);
    assert!(output.any(|line| line.contains("claimed")));
    let refused = claim(&name, Role::Master).err().expect("there is a master").to_string();
    assert!(refused.contains(&name) && refused.contains("commands its drives is already running"), "{refused}");
    // The other role is another's, and using the bus needs none.
    let drives = claim(&name, Role::Drives).unwrap();
    assert!(claim(&name, Role::Drives).is_err());
    drop(drives);
    assert!(claim(&name, Role::Drives).is_ok());
    VirtualBus::open(&name, false).unwrap().send(&frame(1, 1)).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(claim(&name, Role::Master).is_ok());
    assert!(!path_of(&name).unwrap().exists());
}
