//! Claims about the shim: what it does to which frames, and that a seed decides.

use super::*;
use crate::clock::{Lockstep, Monotonic};
use crate::memory_bus::MemoryBus;

fn frame(i: u16) -> Frame {
    Frame::classic(Id::Standard(0x200 + i % 8), &i.to_le_bytes()).unwrap()
}

/// The shim, and the handle at the other end of its bus.
fn shim(outgoing: FaultPlan, incoming: FaultPlan, seed: u64) -> (FaultShim<MemoryBus>, MemoryBus) {
    let far = MemoryBus::default();
    (FaultShim::new(far.handle(), outgoing, incoming, seed, Arc::new(Monotonic)).unwrap(), far)
}

/// What waits on a bus.
fn heard(bus: &mut impl CanBus) -> Vec<Frame> {
    std::iter::from_fn(|| bus.receive(Duration::ZERO).unwrap()).map(|received| received.frame).collect()
}

fn numbers(frames: impl IntoIterator<Item = Frame>) -> Vec<u16> {
    frames.into_iter().map(|f| u16::from_le_bytes(f.data().try_into().unwrap())).collect()
}

/// Sends frames 0..n and lists what reaches the bus.
fn through(plan: FaultPlan, seed: u64, n: u16) -> (Vec<u16>, FaultCounts) {
    let (mut s, mut far) = shim(plan, FaultPlan::default(), seed);
    (0..n).for_each(|i| s.send(&frame(i)).unwrap());
    (numbers(heard(&mut far)), s.outgoing.counts)
}

#[test]
fn without_faults_it_is_a_wire() {
    assert_eq!(through(FaultPlan::default(), 1, 100).0, (0..100).collect::<Vec<_>>());
}

#[test]
fn the_same_seed_gives_the_same_faults_and_another_one_others() {
    let plan = FaultPlan { drop: 0.1, corrupt: 0.1, duplicate: 0.1, reorder: 0.1, delay: 0.1, ..FaultPlan::default() };
    assert_eq!(through(plan.clone(), 7, 1000), through(plan.clone(), 7, 1000));
    assert_ne!(through(plan.clone(), 7, 1000).0, through(plan, 8, 1000).0);
}

#[test]
fn frames_are_lost_as_often_as_the_plan_says_and_no_others() {
    let n = 20_000;
    let (got, counts) = through(FaultPlan { drop: 0.05, ..FaultPlan::default() }, 3, n);
    assert_eq!(got.len() as u64 + counts.dropped, u64::from(n));
    // Five standard deviations of a binomial count.
    let sigma = (f64::from(n) * 0.05 * 0.95).sqrt();
    assert!((counts.dropped as f64 - 0.05 * f64::from(n)).abs() < 5.0 * sigma, "{counts:?}");
}

#[test]
fn a_probability_of_one_hits_every_frame() {
    let all = |p: FaultPlan| through(p, 1, 6).0;
    let none = FaultPlan::default();
    assert_eq!(all(FaultPlan { drop: 1.0, ..none.clone() }), []);
    assert_eq!(all(FaultPlan { duplicate: 1.0, ..none.clone() }), [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]);
    let corrupt = all(FaultPlan { corrupt: 1.0, ..none.clone() });
    assert!((0..6_u16).zip(&corrupt).all(|(a, b)| (a ^ b).count_ones() == 1), "{corrupt:?}");
    assert_eq!(all(FaultPlan { delay: 1.0, delay_by: Delay::Frames(2), ..none }), [0, 1, 2, 3]);
}

#[test]
fn one_fault_does_not_move_another() {
    let (drop_only, _) = through(FaultPlan { drop: 0.2, ..FaultPlan::default() }, 5, 500);
    let (both, _) = through(FaultPlan { drop: 0.2, duplicate: 0.3, ..FaultPlan::default() }, 5, 500);
    let mut once = both;
    once.dedup();
    assert_eq!(once, drop_only);
}

#[test]
fn a_script_hits_exactly_its_frames_and_identifiers() {
    let only = FilterSet::new(&[Filter { value: 0x203, mask: 0x7ff }]);
    let script = vec![
        Scripted { frames: 2..5, ids: FilterSet::default(), fault: Fault::Drop },
        Scripted { frames: 8..24, ids: only, fault: Fault::Drop },
        Scripted { frames: 6..7, ids: FilterSet::default(), fault: Fault::Reorder },
        Scripted { frames: 24..25, ids: FilterSet::default(), fault: Fault::Delay(Delay::Frames(3)) },
    ];
    let (got, counts) = through(FaultPlan { script, ..FaultPlan::default() }, 1, 30);
    let expected = [0, 1, 5, 7, 6, 8, 9, 10, 12, 13, 14, 15, 16, 17, 18, 20, 21, 22, 23, 25, 26, 27, 24, 28, 29];
    assert_eq!(got, expected);
    assert_eq!((counts.dropped, counts.reordered, counts.delayed), (5, 1, 1));
}

#[test]
fn received_frames_suffer_the_other_plan() {
    let (mut s, mut far) = shim(FaultPlan::default(), FaultPlan { duplicate: 1.0, ..FaultPlan::default() }, 1);
    (0..3).for_each(|i| far.send(&frame(i)).unwrap());
    assert_eq!(numbers(heard(&mut s)), [0, 0, 1, 1, 2, 2]);
}

#[test]
fn a_delay_by_time_ends_when_the_clock_says_so() {
    let clock = Arc::new(Lockstep::new(1000));
    let plan = FaultPlan { delay: 1.0, delay_by: Delay::Time(Duration::from_nanos(500)), ..FaultPlan::default() };
    let mut far = MemoryBus::default();
    let mut s = FaultShim::new(far.handle(), FaultPlan::default(), plan, 1, clock.clone()).unwrap();
    far.send(&frame(9)).unwrap();
    assert_eq!(s.receive(Duration::ZERO), Ok(None));
    clock.advance_to(1499);
    assert_eq!(s.receive(Duration::ZERO), Ok(None));
    clock.advance_to(1500);
    // The bus in memory stamps with 0, and the frame came 500 ns late.
    assert_eq!(s.receive(Duration::ZERO), Ok(Some(Received { frame: frame(9), time_ns: 500 })));
}

#[test]
fn watched_frames_are_counted_whatever_becomes_of_them() {
    let (mut s, mut far) = shim(FaultPlan::default(), FaultPlan { drop: 1.0, ..FaultPlan::default() }, 1);
    s.watch(Id::Standard(0x203));
    (0..16).for_each(|i| far.send(&frame(i)).unwrap());
    // Each of the two ends a receive, and nothing passes.
    assert_eq!((s.receive(Duration::from_secs(9)), s.watched(), s.inner().waiting()), (Ok(None), 1, 12));
    assert_eq!((s.receive(Duration::from_secs(9)), s.watched(), s.inner().waiting()), (Ok(None), 2, 4));
}

#[test]
fn what_is_late_by_time_comes_in_just_before_a_watched_frame() {
    let clock = Arc::new(Lockstep::new(0));
    let mut far = MemoryBus::default();
    let mut s = FaultShim::clean(far.handle(), 1, clock.clone());
    s.watch(Id::Standard(0x203));
    let late = FaultPlan { delay: 1.0, delay_by: Delay::Time(Duration::from_nanos(5)), ..FaultPlan::default() };
    s.set_plans(&[], &[late]).unwrap();
    far.send(&frame(0)).unwrap();
    assert_eq!(s.receive(Duration::ZERO), Ok(None));
    s.set_plans(&[], &[]).unwrap();
    clock.advance_to(5);
    (1..4).for_each(|i| far.send(&frame(i)).unwrap());
    let got = heard(&mut s);
    assert_eq!((s.watched(), numbers(got)), (1, vec![1, 2]));
    assert_eq!(numbers(std::iter::from_fn(|| s.next_ready()).map(|r| r.frame)), [0, 3]);
}

#[test]
fn plans_change_between_two_frames_and_a_seed_begins_anew() {
    let faulty = FaultPlan { drop: 0.5, ..FaultPlan::default() };
    let run = |before: u16| {
        let (mut s, mut far) = shim(FaultPlan::default(), FaultPlan::default(), 1);
        (0..before).for_each(|i| s.send(&frame(i)).unwrap());
        assert_eq!(heard(&mut far).len(), usize::from(before), "no faults yet");
        s.set_plans(std::slice::from_ref(&faulty), &[]).unwrap();
        s.reseed(5);
        (0..100).for_each(|i| s.send(&frame(i)).unwrap());
        numbers(heard(&mut far))
    };
    assert_eq!(run(0), run(33));
    assert!((20..80).contains(&run(0).len()));
    let (mut s, _far) = shim(FaultPlan::default(), FaultPlan::default(), 1);
    assert!(s.set_plans(&[FaultPlan { drop: 2.0, ..faulty }], &[]).is_err());
}

#[test]
fn a_frame_without_payload_cannot_be_corrupted_and_vanishes() {
    let (mut s, far) = shim(FaultPlan { corrupt: 1.0, ..FaultPlan::default() }, FaultPlan::default(), 1);
    s.send(&Frame::classic(Id::Standard(0x80), &[]).unwrap()).unwrap();
    assert_eq!(far.waiting(), 0);
    assert_eq!(s.counts().0.dropped, 1);
}

#[test]
fn too_many_held_frames_pass_untouched() {
    let plan = FaultPlan { delay: 1.0, delay_by: Delay::Frames(u32::MAX), ..FaultPlan::default() };
    let (got, counts) = through(plan, 1, HELD_MAX as u16 + 10);
    assert_eq!((got.len(), counts.overflowed), (10, 10));
}

#[test]
fn impossible_probabilities_are_refused() {
    for found in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
        let plan = FaultPlan { reorder: found, ..FaultPlan::default() };
        let e = FaultShim::new(MemoryBus::default(), FaultPlan::default(), plan, 1, Arc::new(Monotonic)).err().unwrap();
        assert_eq!(e.fault, "reorder");
    }
}
