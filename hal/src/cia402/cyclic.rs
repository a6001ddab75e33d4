//! The cyclic traffic: torques out on the control thread, feedback in on the receive thread.
//!
//! Neither side allocates, blocks or formats after it is made. They share one counter, the number of the cycle, and the
//! controlwords that the master's slow side sets.

use super::layout::{Layout, SLOT_BYTES, packed_frame};
use super::objects::{decode_tpdo1, encode_rpdo1};
use crate::can::{CanBus, DATA_LEN_MAX, Frame, FrameError, Id, Kind, Received, SendError};
use crate::canopen::NodeId;
use crate::canopen::cob::{self, RPDO, SYNC, TPDO};
use crate::clock::monotonic_ns;
use std::sync::Arc;
use std::sync::atomic::{AtomicI16, AtomicU16, AtomicU64, Ordering};

/// A set of drives by index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct DriveMask(pub u128);

impl DriveMask {
    /// The first `count` drives.
    pub const fn first(count: usize) -> Self {
        Self(if count >= 128 { u128::MAX } else { (1 << count) - 1 })
    }

    /// Adds a drive.
    pub fn insert(&mut self, drive: usize) {
        self.0 |= 1u128.checked_shl(drive as u32).unwrap_or(0);
    }

    /// True if the drive is in it.
    pub fn contains(self, drive: usize) -> bool {
        self.0.checked_shr(drive as u32).unwrap_or(0) & 1 != 0
    }

    /// True without a drive.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The indices in it, ascending.
    pub fn iter(self) -> impl Iterator<Item = usize> {
        (0..128).filter(move |&d| self.contains(d))
    }
}

/// Cycles whose beginning is remembered: the receive thread may be late by so many, less one that is being written.
const BEGINNINGS: u64 = 64;

/// What control thread, receive thread and master share.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) controlwords: Box<[AtomicU16]>,
    /// Torques of the last moments without what was swinging, by drive (per mille).
    pub(crate) mean_torques: Box<[AtomicI16]>,
    /// The newest cycle.
    pub(crate) cycle: AtomicU64,
    /// When the newest cycles began (CLOCK_MONOTONIC, ns), each at its number modulo the length.
    begun_ns: [AtomicU64; BEGINNINGS as usize],
    /// Frames of cycles that a bus did not take, or not before the next cycle, by bus.
    pub(crate) unsent: Box<[AtomicU64]>,
}

impl Shared {
    pub(crate) fn new(drives: usize, buses: usize) -> Self {
        Self {
            controlwords: (0..drives).map(|_| AtomicU16::new(0)).collect(),
            mean_torques: (0..drives).map(|_| AtomicI16::new(0)).collect(),
            cycle: AtomicU64::new(0),
            begun_ns: std::array::from_fn(|_| AtomicU64::new(0)),
            unsent: (0..buses).map(|_| AtomicU64::new(0)).collect(),
        }
    }

    fn slot(&self, cycle: u64) -> &AtomicU64 {
        &self.begun_ns[(cycle % BEGINNINGS) as usize]
    }

    /// The next cycle, which begins now; for its only sender.
    fn begin(&self, now_ns: u64) -> u64 {
        let cycle = self.cycle.load(Ordering::Acquire) + 1;
        self.slot(cycle).store(now_ns, Ordering::Release);
        self.cycle.store(cycle, Ordering::Release);
        cycle
    }

    /// The newest cycle that had begun at a time, which is that of a SYNC received then, however late it is read; the
    /// newest of all if none had, of a bus whose times are no CLOCK_MONOTONIC.
    fn cycle_at(&self, time_ns: u64) -> u64 {
        let newest = self.cycle.load(Ordering::Acquire);
        // The slot after the newest may be being written.
        let oldest = newest.saturating_sub(BEGINNINGS - 2).max(1);
        let begun = |cycle: &u64| self.slot(*cycle).load(Ordering::Acquire) <= time_ns;
        (oldest..=newest).rev().find(begun).unwrap_or(newest)
    }
}

/// Where a drive is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Address {
    pub(crate) bus: usize,
    pub(crate) node: NodeId,
    /// Among the drives of its bus.
    pub(crate) rank: usize,
    pub(crate) torque_permille_max: i16,
}

/// What a cycle's sending came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CycleReport {
    /// Number of the cycle, from 1.
    pub cycle: u64,
    /// Drives whose RPDO was not taken by their bus: they keep the torque of the cycle before. In the packed layout that
    /// is all drives of the bus or none.
    pub not_sent: DriveMask,
    /// Drives whose torque was cut to their limit.
    pub limited: DriveMask,
    /// Buses (bit by index) whose SYNC was not taken: all drives there keep their torque.
    pub sync_not_sent: u32,
    /// Frames of the cycle before that still waited for their bus, and were dropped for this one's.
    pub superseded: usize,
    /// The first refusal.
    pub error: Option<SendError>,
}

/// The RPDO that all drives of a packed bus share, as it grows.
struct Packed {
    slots: [u8; DATA_LEN_MAX],
    used: usize,
    drives: DriveMask,
}

/// Sends torques; belongs to the control thread.
pub struct CycleWriter {
    buses: Vec<Box<dyn CanBus>>,
    drives: Vec<Address>,
    /// By bus; `None` where each drive has an RPDO of its own.
    packed: Vec<Option<Packed>>,
    /// Mean torque of each drive (per mille), and the share by which a cycle moves it; 0 where nobody asks for it.
    means: Vec<f32>,
    share: f32,
    shared: Arc<Shared>,
}

impl CycleWriter {
    /// `layouts` by bus; the share of a cycle in the mean torques.
    pub(crate) fn new(
        buses: Vec<Box<dyn CanBus>>,
        drives: Vec<Address>,
        layouts: Vec<Layout>,
        share: f32,
        shared: Arc<Shared>,
    ) -> Self {
        let packed = |(bus, layout)| {
            let mut all = Packed { slots: [0; DATA_LEN_MAX], used: 0, drives: DriveMask::default() };
            for (i, d) in drives.iter().enumerate().filter(|(_, d)| d.bus == bus) {
                all.drives.insert(i);
                all.used = all.used.max((d.rank + 1) * SLOT_BYTES);
            }
            (layout == Layout::Packed && all.used > 0).then_some(all)
        };
        let packed = layouts.into_iter().enumerate().map(packed).collect();
        Self { buses, means: vec![0.0; drives.len()], drives, packed, share, shared }
    }

    /// Number of drives.
    pub fn drive_count(&self) -> usize {
        self.drives.len()
    }

    /// Sends every drive its controlword and torque (per mille of rated torque, positive pulls), then SYNC on every
    /// bus. A drive for which no torque is given gets 0. Allocates nothing and does not block.
    ///
    /// What is left of the cycle before is dropped first: torques are of use while they are the newest, and a bus that falls
    /// behind must not replay old ones in order. A bus that never takes a whole cycle gets no SYNC then, and its drives go
    /// safe.
    pub fn write_cycle(&mut self, torques_permille: &[i16]) -> CycleReport {
        // Counted before SYNC leaves, so that the receive side never sees a SYNC whose number is not there yet.
        let cycle = self.shared.begin(monotonic_ns());
        let mut report = CycleReport { cycle, ..CycleReport::default() };
        for (bus, line) in self.buses.iter_mut().enumerate() {
            let left = line.discard_waiting();
            report.superseded += left;
            if left > 0
                && let Some(unsent) = self.shared.unsent.get(bus)
            {
                unsent.fetch_add(left as u64, Ordering::Relaxed);
            }
        }
        for i in 0..self.drives.len() {
            let d = self.drives[i];
            let wanted = torques_permille.get(i).copied().unwrap_or(0);
            let torque = wanted.clamp(-d.torque_permille_max, d.torque_permille_max);
            if torque != wanted {
                report.limited.insert(i);
            }
            if self.share > 0.0 {
                self.means[i] += self.share * (f32::from(torque) - self.means[i]);
                self.shared.mean_torques[i].store(self.means[i].round() as i16, Ordering::Release);
            }
            let word = self.shared.controlwords[i].load(Ordering::Acquire);
            let slot = encode_rpdo1(word, torque);
            if let Some(Some(packed)) = self.packed.get_mut(d.bus) {
                packed.slots[d.rank * SLOT_BYTES..][..SLOT_BYTES].copy_from_slice(&slot);
            } else if let Err(e) = self.send(d.bus, cob::frame(d.node.cob(RPDO), &slot)) {
                report.not_sent.insert(i);
                report.error.get_or_insert(e);
            }
        }
        for bus in 0..self.buses.len() {
            if let Some(Some(packed)) = self.packed.get(bus) {
                let (frame, drives) = (packed_frame(&packed.slots[..packed.used]), packed.drives);
                if let Err(e) = self.send(bus, frame) {
                    report.not_sent.0 |= drives.0;
                    report.error.get_or_insert(e);
                }
            }
        }
        for bus in 0..self.buses.len() {
            if let Err(e) = self.send(bus, cob::frame(SYNC, &[])) {
                report.sync_not_sent |= 1u32.checked_shl(bus as u32).unwrap_or(0);
                report.error.get_or_insert(e);
            }
        }
        report
    }

    fn send(&mut self, bus: usize, frame: Result<Frame, FrameError>) -> Result<(), SendError> {
        let line = self.buses.get_mut(bus).ok_or(SendError::Unsupported)?;
        let sent = frame.map_err(|_| SendError::Unsupported).and_then(|frame| line.send(&frame));
        if sent.is_err()
            && let Some(unsent) = self.shared.unsent.get(bus)
        {
            unsent.fetch_add(1, Ordering::Relaxed);
        }
        sent
    }
}

/// Last feedback of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Feedback {
    /// Statusword.
    pub statusword: u16,
    /// Position (counts).
    pub position_counts: i32,
    /// Torque (per mille of rated torque).
    pub torque_permille: i16,
    /// Receive time (ns), 0 before the first.
    pub time_ns: u64,
    /// Cycle to whose SYNC it answers.
    pub cycle: u64,
}

/// What a frame meant to the decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// Nothing of the cyclic traffic, or a duplicate.
    None,
    /// A SYNC opened a cycle whose predecessor is complete, or came once more on another bus.
    Sync,
    /// A SYNC opened a cycle although these drives had not answered the one before.
    Incomplete {
        /// The cycle before.
        cycle: u64,
        /// Drives that did not answer.
        missing: DriveMask,
    },
    /// Feedback of one drive.
    Feedback(usize),
    /// Feedback of the last drive that was missing: the set is complete.
    Complete {
        /// The cycle.
        cycle: u64,
        /// Receive time of its first SYNC (ns).
        sync_ns: u64,
    },
    /// A TPDO of a drive that is too short.
    Malformed(usize),
}

/// Collects feedback; belongs to the receive thread. Its bus handle must see the SYNCs that the control thread's handle
/// sends, as another handle of the same bus does.
#[derive(Debug, Clone)]
pub struct Decoder {
    /// Drive by bus and node, 255: none.
    by_node: Vec<[u8; 128]>,
    feedback: Vec<Feedback>,
    /// Cycle to which answers on each bus belong.
    bus_cycle: Vec<u64>,
    all: DriveMask,
    seen: DriveMask,
    cycle: u64,
    sync_ns: u64,
    shared: Arc<Shared>,
}

impl Decoder {
    pub(crate) fn new(drives: &[Address], buses: usize, shared: Arc<Shared>) -> Self {
        let mut by_node = vec![[255; 128]; buses];
        for (i, d) in drives.iter().enumerate() {
            by_node[d.bus][usize::from(d.node.get())] = i as u8;
        }
        Self {
            by_node,
            feedback: vec![Feedback::default(); drives.len()],
            bus_cycle: vec![0; buses],
            all: DriveMask::first(drives.len()),
            seen: DriveMask::default(),
            cycle: 0,
            sync_ns: 0,
            shared,
        }
    }

    /// Last feedback of each drive, in the order of cables.
    pub fn feedback(&self) -> &[Feedback] {
        &self.feedback
    }

    /// The cycle being collected, 0 before the first.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// The cycle of the last SYNC on one bus, 0 before the first and for a bus that there is not: while another bus has
    /// the next one already, it is the older of both.
    pub fn bus_cycle(&self, bus: usize) -> u64 {
        self.bus_cycle.get(bus).copied().unwrap_or(0)
    }

    /// Receive time of the first SYNC of this cycle (ns).
    pub fn sync_ns(&self) -> u64 {
        self.sync_ns
    }

    /// Drives that have not answered this cycle's SYNC.
    pub fn missing(&self) -> DriveMask {
        DriveMask(self.all.0 & !self.seen.0)
    }

    /// Handles one frame received on the given bus. Allocates nothing.
    pub fn on_frame(&mut self, bus: usize, received: &Received) -> Event {
        let Id::Standard(id) = received.frame.id() else { return Event::None };
        if bus >= self.by_node.len() || received.frame.kind() == Kind::Remote {
            return Event::None;
        }
        if id == SYNC {
            return self.on_sync(bus, received.time_ns);
        }
        if id & 0x780 != TPDO {
            return Event::None;
        }
        let drive = usize::from(self.by_node[bus][usize::from(id & 0x7f)]);
        let Some(feedback) = self.feedback.get_mut(drive) else { return Event::None };
        let Some((statusword, position_counts, torque_permille)) = decode_tpdo1(received.frame.data()) else {
            return Event::Malformed(drive);
        };
        let cycle = self.bus_cycle[bus];
        let time_ns = received.time_ns;
        *feedback = Feedback { statusword, position_counts, torque_permille, time_ns, cycle };
        if cycle != self.cycle || cycle == 0 {
            return Event::Feedback(drive);
        }
        let before = self.seen;
        self.seen.insert(drive);
        if self.seen == self.all && before != self.all {
            return Event::Complete { cycle, sync_ns: self.sync_ns };
        }
        Event::Feedback(drive)
    }

    fn on_sync(&mut self, bus: usize, time_ns: u64) -> Event {
        // By the time at which it came: when this thread is late, the control thread may be a cycle ahead already, and
        // answers to two SYNCs would be taken for one reading.
        let cycle = self.shared.cycle_at(time_ns).max(self.bus_cycle[bus]);
        self.bus_cycle[bus] = cycle;
        if cycle <= self.cycle {
            return Event::Sync; // of another bus, which is later than the one that opened the cycle
        }
        let (before, missing) = (self.cycle, self.missing());
        self.cycle = cycle;
        self.seen = DriveMask::default();
        self.sync_ns = time_ns;
        if before != 0 && !missing.is_empty() { Event::Incomplete { cycle: before, missing } } else { Event::Sync }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DriveSetup, Master, MasterConfig};
    use super::*;
    use crate::memory_bus::MemoryBus;

    fn node(n: u8) -> NodeId {
        NodeId::new(n).unwrap()
    }

    /// A writer and a decoder of one drive on each of two buses, and the times at which so many cycles had been sent.
    fn sent(cycles: u64) -> (Decoder, Vec<u64>) {
        let config = MasterConfig::new((0..2).map(|bus| DriveSetup::new(bus, node(5))).collect(), node(127), 10_000);
        let buses = (0..2).map(|_| Box::new(MemoryBus::default()) as Box<dyn CanBus>).collect();
        let mut master = Master::new(config, buses).unwrap();
        let mut writer = master.take_writer().unwrap();
        let send = |cycle| {
            assert_eq!(writer.write_cycle(&[]).cycle, cycle);
            let now_ns = monotonic_ns();
            while monotonic_ns() == now_ns {}
            now_ns
        };
        (master.decoder(), (1..=cycles).map(send).collect())
    }

    fn at(time_ns: u64, frame: Result<Frame, FrameError>) -> Received {
        Received { frame: frame.unwrap(), time_ns }
    }

    fn sync(time_ns: u64) -> Received {
        at(time_ns, cob::frame(SYNC, &[]))
    }

    fn answer(time_ns: u64) -> Received {
        at(time_ns, cob::frame(node(5).cob(TPDO), &[0; 8]))
    }

    #[test]
    fn a_sync_that_is_read_late_opens_the_cycle_in_which_it_was_sent() {
        // Four cycles have gone out before the receive thread reads the first.
        let (mut decoder, times) = sent(4);
        for (cycle, &time_ns) in (1..).zip(&times) {
            for bus in 0..2 {
                assert_eq!(decoder.on_frame(bus, &sync(time_ns)), Event::Sync);
                assert_eq!((decoder.cycle(), decoder.bus_cycle(bus), decoder.sync_ns()), (cycle, cycle, time_ns));
            }
            assert_eq!(decoder.on_frame(0, &answer(time_ns)), Event::Feedback(0));
            let complete = Event::Complete { cycle, sync_ns: time_ns };
            assert_eq!(decoder.on_frame(1, &answer(time_ns)), complete);
            assert!(decoder.feedback().iter().all(|f| f.cycle == cycle));
        }
    }

    #[test]
    fn a_bus_that_is_read_after_another_has_its_own_cycle_until_its_sync_comes() {
        let (mut decoder, times) = sent(2);
        decoder.on_frame(0, &sync(times[0]));
        decoder.on_frame(0, &answer(times[0]));
        let mut second = DriveMask::default();
        second.insert(1);
        let incomplete = Event::Incomplete { cycle: 1, missing: second };
        assert_eq!(decoder.on_frame(0, &sync(times[1])), incomplete);
        // Only now the first SYNC of the other bus: its answer is of the first cycle and completes nothing.
        assert_eq!(decoder.on_frame(1, &sync(times[0])), Event::Sync);
        assert_eq!((decoder.cycle(), decoder.bus_cycle(1)), (2, 1));
        assert_eq!(decoder.on_frame(1, &answer(times[0])), Event::Feedback(1));
        assert_eq!(decoder.feedback()[1].cycle, 1);
        decoder.on_frame(0, &answer(times[1]));
        decoder.on_frame(1, &sync(times[1]));
        assert_eq!(decoder.on_frame(1, &answer(times[1])), Event::Complete { cycle: 2, sync_ns: times[1] });
    }

    #[test]
    fn without_a_time_of_this_clock_the_newest_cycle_counts() {
        let (mut decoder, times) = sent(200);
        decoder.on_frame(0, &sync(0));
        assert_eq!(decoder.cycle(), 200);
        // As far back as is remembered.
        let (mut decoder, times_too) = sent(200);
        decoder.on_frame(0, &sync(times_too[200 - 63]));
        assert_eq!(decoder.cycle(), 200 - 62);
        // A stamp that goes back does not take the bus back.
        decoder.on_frame(0, &sync(times_too[199]));
        decoder.on_frame(0, &sync(times_too[150]));
        assert_eq!((decoder.cycle(), decoder.bus_cycle(0), times.len()), (200, 200, 200));
    }
}
