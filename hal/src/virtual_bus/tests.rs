//! Claims about the ring that need a hand inside it: dead senders, damaged memory.

use std::sync::atomic::AtomicU32;

use proptest::prelude::*;

use super::*;
use crate::can::Id;

/// A bus of its own per test, also when tests run at once.
fn unique(name: &str) -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    format!("unit-{name}-{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed))
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::classic(Id::Standard(id), data).unwrap()
}

const WAIT: Duration = Duration::from_secs(10);

#[test]
fn a_sender_that_dies_after_drawing_its_ticket_blocks_nobody() {
    let name = unique("dead");
    let mut a = VirtualBus::open(&name, false).unwrap();
    let mut b = VirtualBus::open(&name, false).unwrap();
    let mut c = VirtualBus::open(&name, false).unwrap();
    a.shared.header().head.fetch_add(1, Ordering::AcqRel);
    a.send(&frame(1, &[1])).unwrap();
    // A second one died while writing.
    let ticket = a.shared.header().head.fetch_add(1, Ordering::AcqRel);
    a.shared.slot(ticket).sequence.store(sequence(ticket, Stage::Writing), Ordering::Release);
    a.send(&frame(2, &[2])).unwrap();
    for handle in [&mut b, &mut c] {
        assert_eq!(handle.receive(WAIT).unwrap().unwrap().frame, frame(1, &[1]));
        assert_eq!(handle.receive(WAIT).unwrap().unwrap().frame, frame(2, &[2]));
        assert_eq!(handle.counters().errors, 2);
        assert_eq!(handle.counters().lost, 0);
    }
}

#[test]
fn a_poll_does_not_wait_for_a_dead_sender_either() {
    let mut a = VirtualBus::open(&unique("poll"), false).unwrap();
    let mut b = a.duplicate().unwrap();
    a.shared.header().head.fetch_add(1, Ordering::AcqRel);
    a.send(&frame(1, &[])).unwrap();
    assert_eq!(b.receive(Duration::ZERO), Ok(None));
    std::thread::sleep(Duration::from_nanos(2 * GAP_GRACE_NS));
    assert_eq!(b.receive(Duration::ZERO).unwrap().unwrap().frame, frame(1, &[]));
}

#[test]
fn a_sender_whose_ticket_was_abandoned_sends_with_another_one() {
    let mut a = VirtualBus::open(&unique("late"), false).unwrap();
    let mut b = a.duplicate().unwrap();
    let ticket = a.shared.header().head.load(Ordering::Acquire);
    a.shared.slot(ticket).sequence.store(sequence(ticket, Stage::Abandoned), Ordering::Release);
    a.send(&frame(5, &[5])).unwrap();
    assert_eq!(a.shared.header().head.load(Ordering::Acquire), ticket + 2);
    assert_eq!(b.receive(WAIT).unwrap().unwrap().frame, frame(5, &[5]));
}

#[test]
fn a_receiver_a_ring_behind_keeps_the_newest_frames_and_counts_the_rest() {
    let mut a = VirtualBus::open(&unique("slow"), false).unwrap();
    let mut b = a.duplicate().unwrap();
    let sent = SLOTS + 100;
    for i in 0..sent {
        a.send(&frame(1, &(i as u32).to_le_bytes())).unwrap();
    }
    let mut got = Vec::new();
    while let Some(r) = b.receive(Duration::ZERO).unwrap() {
        got.push(u64::from(u32::from_le_bytes(r.frame.data().try_into().unwrap())));
    }
    assert_eq!(got, (100..sent).collect::<Vec<_>>());
    assert_eq!(b.counters().lost, 100);
}

#[test]
fn a_frame_torn_between_two_senders_is_not_delivered() {
    let mut a = VirtualBus::open(&unique("torn"), false).unwrap();
    let mut b = a.duplicate().unwrap();
    a.send(&frame(1, &[1; 8])).unwrap();
    a.shared.slot(SLOTS).data[0].store(2, Ordering::Relaxed);
    assert_eq!(b.receive(Duration::ZERO), Ok(None));
    assert_eq!(b.counters().errors, 1);
}

#[test]
fn every_ticket_is_received_lost_or_abandoned_and_no_frame_is_ever_mixed() {
    const EACH: u64 = 60_000;
    let hub = VirtualBus::open(&unique("storm"), true).unwrap();
    let start = hub.shared.header().head.load(Ordering::Acquire);
    // One receiver keeps up as it can, one is lapped again and again.
    let receivers: Vec<_> = [0, 20]
        .map(|pause_ms| {
            let mut bus = VirtualBus::on(Arc::clone(&hub.shared), true);
            std::thread::spawn(move || {
                let mut last = [None; 3];
                let mut ended = 0;
                // The senders' last frames can be lost here as any other; then they have been silent for long enough.
                while ended < 3 {
                    let Some(r) = bus.receive(Duration::from_secs(2)).unwrap() else { break };
                    let Id::Extended(id) = r.frame.id() else { panic!("{:?}", r.frame) };
                    let words: Vec<u64> =
                        r.frame.data().chunks_exact(8).map(|c| u64::from_ne_bytes(c.try_into().unwrap())).collect();
                    assert!(words.iter().all(|&w| w == words[0]), "{:?}", r.frame);
                    let before = last[id as usize].replace(words[0]);
                    assert!(before.is_none_or(|b| b < words[0]), "{before:?} then {}", words[0]);
                    ended += u32::from(words[0] == EACH - 1);
                    if pause_ms > 0 && words[0].is_multiple_of(1000) {
                        std::thread::sleep(Duration::from_millis(pause_ms));
                    }
                }
                (bus.cursor, bus.counters())
            })
        })
        .into();
    let senders: Vec<_> = (0..3)
        .map(|s| {
            let mut bus = VirtualBus::on(Arc::clone(&hub.shared), true);
            std::thread::spawn(move || {
                for i in 0..EACH {
                    let data: Vec<u8> = (0..8).flat_map(|_| i.to_ne_bytes()).collect();
                    let f = Frame::new(Id::Extended(s), Kind::Fd { bit_rate_switch: true }, &data).unwrap();
                    while bus.send(&f).is_err() {}
                }
                bus.counters().sent
            })
        })
        .collect();
    let sent: u64 = senders.into_iter().map(|s| s.join().unwrap()).sum();
    assert_eq!(sent, 3 * EACH);
    let tickets = hub.shared.header().head.load(Ordering::Acquire) - start;
    assert!(tickets >= sent);
    let [fast, slow] = [0, 1].map(|_| ()).map({
        let mut receivers = receivers.into_iter();
        move |()| receivers.next().unwrap().join().unwrap()
    });
    for (cursor, c) in [fast, slow] {
        assert_eq!(c.received + c.lost + c.errors, cursor - start, "{c:?}");
        assert!(c.errors <= tickets - sent, "{c:?}: a frame was damaged");
    }
    assert!(slow.1.lost > SLOTS, "the slow receiver was never lapped");
}

#[test]
fn a_file_of_another_layout_in_use_is_refused_and_an_unused_one_taken_over() {
    use std::os::unix::fs::FileExt;
    let name = unique("layout");
    let path = path_of(&name).unwrap();
    let held = VirtualBus::open(&name, false).unwrap();
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    file.write_all_at(&99_u32.to_ne_bytes(), 8).unwrap();
    match VirtualBus::open(&name, false) {
        Err(OpenVirtualError::Layout { version: 99, expected: layout::VERSION, .. }) => {}
        other => panic!("{:?}", other.map(|_| ()).map_err(|e| e.to_string())),
    }
    drop(held);
    assert!(!path.exists());
    std::fs::write(&path, b"not a bus at all").unwrap();
    let taken = VirtualBus::open(&name, false).unwrap();
    drop(taken);
    assert!(!path.exists());
}

#[test]
fn names_that_are_no_file_names_are_refused() {
    for name in ["", ".", "..", "a/b", "a b", ".hidden", "\u{e9}", &"x".repeat(129)] {
        assert!(matches!(VirtualBus::open(name, false), Err(OpenVirtualError::Name(_))), "{name:?}");
    }
}

#[test]
fn stale_files_are_removed_and_used_ones_left_alone() {
    let name = unique("stale");
    assert!(!remove_stale(&name).unwrap());
    let held = VirtualBus::open(&name, false).unwrap();
    assert!(!remove_stale(&name).unwrap());
    drop(held);
    std::fs::write(path_of(&name).unwrap(), b"left behind").unwrap();
    assert!(remove_stale(&name).unwrap());
    assert!(!path_of(&name).unwrap().exists());
}

fn any_frame() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![(0..0x800_u16).prop_map(Id::Standard), (0..0x2000_0000_u32).prop_map(Id::Extended)];
    let kind = prop_oneof![
        Just(Kind::Classic),
        Just(Kind::Remote),
        any::<bool>().prop_map(|bit_rate_switch| Kind::Fd { bit_rate_switch })
    ];
    (id, kind, prop::collection::vec(any::<u8>(), 0..=64)).prop_map(|(id, kind, mut data)| {
        if !matches!(kind, Kind::Fd { .. }) {
            data.truncate(8);
        }
        Frame::new(id, kind, &data).unwrap()
    })
}

proptest! {
    #[test]
    fn every_frame_survives_its_encoding(f in any_frame()) {
        prop_assert_eq!(layout::decode(&layout::encode(&f)), Some(f));
    }

    #[test]
    fn arbitrary_words_decode_to_a_frame_that_encodes_to_them_or_to_none(head: u64, data: [u64; 8], sparse: bool) {
        let words = layout::Words { head: if sparse { head & 0x0000_ff03_ffff_ffff } else { head }, data };
        if let Some(f) = layout::decode(&words) {
            prop_assert_eq!(layout::encode(&f), words);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn damaged_shared_memory_is_never_a_panic(
        offsets in prop::collection::vec((any::<prop::sample::Index>(), any::<u64>()), 1..64),
        head in prop_oneof![Just(None), any::<u64>().prop_map(Some), (0..3 * SLOTS).prop_map(Some)],
        state in prop_oneof![9 => Just(0_u32), 1 => any::<u32>()],
        seal: bool,
    ) {
        use std::os::unix::fs::FileExt;
        let name = unique("damage");
        let mut a = VirtualBus::open(&name, true).unwrap();
        let mut b = a.duplicate().unwrap();
        for i in 0..40_u16 {
            a.send(&frame(i, &[1, 2, 3])).unwrap();
        }
        let file = std::fs::OpenOptions::new().write(true).open(path_of(&name).unwrap()).unwrap();
        for (index, word) in &offsets {
            // Half of the damage goes to the header and to the slots in use.
            let words = if word % 2 == 0 { layout::FILE_LEN / 8 } else { (layout::SLOTS_OFFSET + 50 * 128) / 8 };
            file.write_all_at(&word.to_ne_bytes(), 8 * index.index(words) as u64).unwrap();
        }
        if seal {
            // Damage with a right checksum must be refused by the frame's own rules.
            let slot = a.shared.slot(SLOTS);
            let words = layout::Words { head: offsets[0].1, data: [offsets[0].1; 8] };
            slot.head.store(words.head, Ordering::Relaxed);
            slot.data.iter().for_each(|w| w.store(words.data[0], Ordering::Relaxed));
            let sum = layout::checksum(SLOTS, 7, 7, &words);
            slot.sender.store(7, Ordering::Relaxed);
            slot.time_ns.store(7, Ordering::Relaxed);
            slot.checksum.store(sum, Ordering::Relaxed);
        }
        if let Some(head) = head {
            a.shared.header().head.store(head, Ordering::Release);
        }
        a.shared.header().state.store(state, Ordering::Release);
        for _ in 0..50 {
            let _ = b.receive(Duration::ZERO);
            let _ = a.receive(Duration::from_micros(50));
            let _ = a.send(&frame(3, &[]));
            let _ = b.send(&frame(4, &[]));
        }
        prop_assert!(b.counters().received <= 200);
    }
}

#[test]
fn a_role_is_seen_by_others_as_long_as_it_is_held() {
    let name = unique("claimed");
    assert!(!is_claimed(&name, Role::Drives), "there is no bus");
    let claim = claim(&name, Role::Drives).unwrap();
    assert!(is_claimed(&name, Role::Drives) && !is_claimed(&name, Role::Master));
    drop(claim);
    let _bus = VirtualBus::open(&name, false).unwrap();
    assert!(!is_claimed(&name, Role::Drives));
}

#[test]
fn a_file_that_others_may_write_or_a_link_is_no_bus() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let name = unique("foreign");
    let path = path_of(&name).unwrap();
    std::fs::write(&path, "").unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o666)).unwrap();
    let refused = VirtualBus::open(&name, false).err().unwrap().to_string();
    std::fs::remove_file(&path).unwrap();
    assert!(refused.contains("everybody may write to it (mode 666)"), "{refused}");
    let precious = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(precious.path(), "precious").unwrap();
    symlink(precious.path(), &path).unwrap();
    let refused = VirtualBus::open(&name, false).is_err();
    std::fs::remove_file(&path).unwrap();
    assert!(refused);
    assert_eq!(std::fs::read_to_string(precious.path()).unwrap(), "precious");
}
