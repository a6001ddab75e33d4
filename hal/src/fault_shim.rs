//! A bus that goes wrong on purpose, and the same way every time.
//!
//! Enters: a bus, a plan of faults for each direction, a seed. Leaves: a [`CanBus`] whose frames are dropped, delayed (by
//! frames or by time), duplicated, reordered and corrupted. Each frame draws the same number of random values whatever
//! becomes of it, so a change of one probability does not move the other faults.
//! Must never: allocate after creation, or lose a frame other than by its plan (the counts say what was done).

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use thiserror::Error;

use crate::can::{
    BusCounters, BusState, CanBus, Filter, FilterSet, Frame, Id, Kind, ReceiveError, Received, SendError,
};
use crate::clock::Clock;

/// Frames that one direction holds back or has ready at most; a frame beyond that passes untouched.
pub const HELD_MAX: usize = 1024;

/// How long a delayed frame is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delay {
    /// Until so many later frames have passed; if none come it stays.
    Frames(u32),
    /// By the shim's clock.
    Time(Duration),
}

/// What is done to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// It vanishes; the sender is told that it was sent.
    Drop,
    /// It comes later than it should.
    Delay(Delay),
    /// It comes twice.
    Duplicate,
    /// It changes places with the next one.
    Reorder,
    /// One bit of its payload is flipped; a frame without payload vanishes.
    Corrupt,
}

/// A fault at a known place: every frame of `ids` whose number in its direction (from 0, all frames counted) is in
/// `frames`.
#[derive(Debug, Clone, PartialEq)]
pub struct Scripted {
    /// Numbers.
    pub frames: Range<u64>,
    /// Identifiers; the default means all.
    pub ids: FilterSet,
    /// What happens.
    pub fault: Fault,
}

/// Faults of one direction. The first script entry that fits a frame decides, otherwise chance; of several faults that
/// chance gives to one frame, the first in the order of the fields below is taken.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultPlan {
    /// Probability of [`Fault::Drop`].
    pub drop: f64,
    /// Probability of [`Fault::Corrupt`].
    pub corrupt: f64,
    /// Probability of [`Fault::Duplicate`].
    pub duplicate: f64,
    /// Probability of [`Fault::Reorder`].
    pub reorder: f64,
    /// Probability of [`Fault::Delay`], by `delay_by`.
    pub delay: f64,
    /// How long.
    pub delay_by: Delay,
    /// Identifiers that chance applies to; the default means all.
    pub ids: FilterSet,
    /// Faults at known places.
    pub script: Vec<Scripted>,
}

impl Default for FaultPlan {
    /// No faults.
    fn default() -> Self {
        Self {
            drop: 0.0,
            corrupt: 0.0,
            duplicate: 0.0,
            reorder: 0.0,
            delay: 0.0,
            delay_by: Delay::Frames(1),
            ids: FilterSet::default(),
            script: Vec::new(),
        }
    }
}

impl FaultPlan {
    fn check(&self) -> Result<(), FaultPlanError> {
        let probabilities = [
            ("drop", self.drop),
            ("corrupt", self.corrupt),
            ("duplicate", self.duplicate),
            ("reorder", self.reorder),
            ("delay", self.delay),
        ];
        match probabilities.iter().find(|(_, p)| !(0.0..=1.0).contains(p)) {
            Some(&(fault, found)) => Err(FaultPlanError { fault, found }),
            None => Ok(()),
        }
    }
}

/// A plan that makes no sense.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("probability of {fault}: {found}, expected 0 to 1")]
pub struct FaultPlanError {
    /// Field of the plan.
    pub fault: &'static str,
    /// Value found.
    pub found: f64,
}

/// What was done to the frames of one direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FaultCounts {
    /// Frames that came in.
    pub seen: u64,
    /// Dropped.
    pub dropped: u64,
    /// Corrupted.
    pub corrupted: u64,
    /// Duplicated.
    pub duplicated: u64,
    /// Reordered.
    pub reordered: u64,
    /// Delayed.
    pub delayed: u64,
    /// Passed untouched because too many were held, or refused by the bus when their delay was over.
    pub overflowed: u64,
}

/// When a held frame goes on.
#[derive(Debug, Clone, Copy)]
enum Release {
    AtFrame(u64),
    AtTime(u64),
}

#[derive(Debug, Clone, Copy)]
struct Held {
    received: Received,
    held_since_ns: u64,
    release: Release,
}

/// One direction.
struct Line {
    plans: Vec<FaultPlan>,
    rng: Xoshiro256PlusPlus,
    held: Vec<Held>,
    /// Ready to go on. Always emptied before the next frame is taken in, so its capacity suffices.
    ready: VecDeque<Received>,
    counts: FaultCounts,
    /// What is held by time waits for [`FaultShim::watch`]'s frame.
    gated: bool,
}

impl Line {
    fn new(rng: Xoshiro256PlusPlus) -> Self {
        let held = Vec::with_capacity(HELD_MAX);
        // Each frame that comes in adds itself, perhaps twice, and all that are held can follow it.
        let ready = VecDeque::with_capacity(2 * HELD_MAX + 2);
        Self { plans: Vec::new(), rng, held, ready, counts: FaultCounts::default(), gated: false }
    }

    /// The fate of the next frame, and a random number for its details.
    fn draw(&mut self, number: u64, frame: &Frame) -> (Option<Fault>, u32) {
        let mut fate = None;
        for p in &self.plans {
            let chances = [
                (p.drop, Fault::Drop),
                (p.corrupt, Fault::Corrupt),
                (p.duplicate, Fault::Duplicate),
                (p.reorder, Fault::Reorder),
                (p.delay, Fault::Delay(p.delay_by)),
            ]
            .map(|(probability, fault)| (self.rng.random::<f64>() < probability).then_some(fault));
            let scripted = p.script.iter().find(|s| s.frames.contains(&number) && s.ids.passes(frame.id()));
            let fault = match scripted {
                Some(scripted) => Some(scripted.fault),
                None if p.ids.passes(frame.id()) => chances.into_iter().flatten().next(),
                None => None,
            };
            fate = fate.or(fault);
        }
        let detail = self.rng.random();
        (fate, detail)
    }

    /// Takes a frame in; whatever is to go on now is then in `ready`.
    fn take(&mut self, received: Received, now_ns: u64) {
        let number = self.counts.seen;
        self.counts.seen += 1;
        let (mut fault, detail) = self.draw(number, &received.frame);
        if matches!(fault, Some(Fault::Delay(_) | Fault::Reorder)) && self.held.len() == HELD_MAX {
            self.counts.overflowed += 1;
            fault = None;
        }
        let mut hold = |release| self.held.push(Held { received, held_since_ns: now_ns, release });
        match fault {
            None => self.ready.push_back(received),
            Some(Fault::Drop) => self.counts.dropped += 1,
            Some(Fault::Corrupt) => match corrupted(&received.frame, detail) {
                Some(frame) => {
                    self.counts.corrupted += 1;
                    self.ready.push_back(Received { frame, ..received });
                }
                None => self.counts.dropped += 1,
            },
            Some(Fault::Duplicate) => {
                self.counts.duplicated += 1;
                self.ready.extend([received, received]);
            }
            Some(Fault::Reorder) => {
                self.counts.reordered += 1;
                hold(Release::AtFrame(number + 1));
            }
            Some(Fault::Delay(Delay::Frames(n))) => {
                self.counts.delayed += 1;
                hold(Release::AtFrame(number + u64::from(n)));
            }
            Some(Fault::Delay(Delay::Time(d))) => {
                self.counts.delayed += 1;
                let d = u64::try_from(d.as_nanos()).unwrap_or(u64::MAX);
                hold(Release::AtTime(now_ns.saturating_add(d)));
            }
        }
        self.release_due(now_ns, !self.gated);
    }

    /// Moves what is due from `held` to `ready`, oldest first.
    fn release(&mut self, now_ns: u64) {
        self.release_due(now_ns, true);
    }

    fn release_due(&mut self, now_ns: u64, timed: bool) {
        let last = self.counts.seen.wrapping_sub(1);
        let ready = &mut self.ready;
        self.held.retain(|h| {
            let due = match h.release {
                Release::AtFrame(n) => self.counts.seen > 0 && last >= n,
                Release::AtTime(t) => timed && now_ns >= t,
            };
            // Bounded by the capacity reserved: the rest waits for the caller to take what is ready.
            if !due || ready.len() == ready.capacity() {
                return true;
            }
            let late_ns = now_ns.saturating_sub(h.held_since_ns);
            ready.push_back(Received { time_ns: h.received.time_ns.saturating_add(late_ns), ..h.received });
            false
        });
    }

    /// The earliest time at which a held frame is due by the clock.
    fn next_time_ns(&self) -> Option<u64> {
        self.held.iter().filter_map(|h| if let Release::AtTime(t) = h.release { Some(t) } else { None }).min()
    }
}

/// One bit of the payload flipped, or nothing to flip.
fn corrupted(frame: &Frame, detail: u32) -> Option<Frame> {
    if frame.data().is_empty() || frame.kind() == Kind::Remote {
        return None;
    }
    let mut data = [0; crate::can::DATA_LEN_MAX];
    let data = &mut data[..frame.data().len()];
    data.copy_from_slice(frame.data());
    let bit = detail as usize % (8 * data.len());
    data[bit / 8] ^= 1 << (bit % 8);
    Frame::new(frame.id(), frame.kind(), data).ok()
}

/// A bus with faults.
pub struct FaultShim<B> {
    bus: B,
    outgoing: Line,
    incoming: Line,
    seed: u64,
    clock: Arc<dyn Clock>,
    /// Identifier whose frames are counted before anything is done to them.
    watched: Option<Id>,
    watched_count: u64,
    /// Duplicates made by this handle and its duplicates, so that each has faults of its own.
    duplicates: Arc<AtomicU64>,
}

/// How often a frame delayed by a clock that may be no real time is looked for while a receive waits.
const CLOCK_POLL: Duration = Duration::from_micros(200);

impl<B: CanBus> FaultShim<B> {
    /// Puts faults in front of a bus: `outgoing` to what is sent through it, `incoming` to what it receives.
    ///
    /// # Errors
    /// A probability outside 0 to 1.
    pub fn new(
        bus: B,
        outgoing: FaultPlan,
        incoming: FaultPlan,
        seed: u64,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, FaultPlanError> {
        let mut shim = Self::clean(bus, seed, clock);
        shim.set_plans(&[outgoing], &[incoming])?;
        Ok(shim)
    }

    /// A shim that does nothing until it is given plans.
    pub fn clean(bus: B, seed: u64, clock: Arc<dyn Clock>) -> Self {
        let first = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut second = first.clone();
        second.jump();
        Self {
            bus,
            outgoing: Line::new(first),
            incoming: Line::new(second),
            seed,
            clock,
            watched: None,
            watched_count: 0,
            duplicates: Arc::default(),
        }
    }

    /// Other plans from the next frame on, as many as wanted (each has identifiers of its own; the first that does
    /// something to a frame decides). What is held or ready goes on as it was meant to, counts and random numbers go on,
    /// and `frames` of scripts are still counted from the shim's beginning. Allocates.
    ///
    /// # Errors
    /// A probability outside 0 to 1; the plans stay as they were.
    pub fn set_plans(&mut self, outgoing: &[FaultPlan], incoming: &[FaultPlan]) -> Result<(), FaultPlanError> {
        outgoing.iter().chain(incoming).try_for_each(FaultPlan::check)?;
        self.outgoing.plans = outgoing.to_vec();
        self.incoming.plans = incoming.to_vec();
        Ok(())
    }

    /// Draws from this seed on: what follows depends on the frames from here on, not on those before.
    pub fn reseed(&mut self, seed: u64) {
        self.seed = seed;
        self.outgoing.rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        self.incoming.rng = self.outgoing.rng.clone();
        self.incoming.rng.jump();
    }

    /// Counts the frames of this identifier that come in, before anything is done to them: a simulation whose time goes
    /// by a frame needs to know of it although the simulated nodes do not get it. A receive returns with nothing as soon
    /// as one came; what it left behind is [`Self::next_ready`]. Frames that are held by time then go on just before a
    /// watched one comes in, and out with [`Self::send_due`]: who waits for whom no longer decides their place.
    pub fn watch(&mut self, id: Id) {
        self.watched = Some(id);
        self.incoming.gated = true;
    }

    /// Hands on held frames whose time has come.
    ///
    /// # Errors
    /// The bus's, for the first frame that it refused.
    pub fn send_due(&mut self) -> Result<(), SendError> {
        self.outgoing.release(self.clock.now_ns());
        self.send_ready()
    }

    /// The next received frame that has been through the faults, without looking for another one on the bus.
    pub fn next_ready(&mut self) -> Option<Received> {
        self.incoming.ready.pop_front()
    }

    /// Watched frames so far.
    pub fn watched(&self) -> u64 {
        self.watched_count
    }

    /// What was done to sent and to received frames.
    pub fn counts(&self) -> (FaultCounts, FaultCounts) {
        (self.outgoing.counts, self.incoming.counts)
    }

    /// The bus behind the faults.
    pub fn inner(&self) -> &B {
        &self.bus
    }

    /// The same, for frames that no fault shall touch.
    pub fn inner_mut(&mut self) -> &mut B {
        &mut self.bus
    }

    /// Hands on what is ready to be sent; an error is the bus's, for the first frame that it refused.
    fn send_ready(&mut self) -> Result<(), SendError> {
        let mut result = Ok(());
        while let Some(received) = self.outgoing.ready.pop_front() {
            if let Err(e) = self.bus.send(&received.frame) {
                self.outgoing.counts.overflowed += 1;
                result = result.and(Err(e));
            }
        }
        result
    }
}

impl<B: CanBus> CanBus for FaultShim<B> {
    /// As the bus behind. A frame that chance drops or holds is reported as sent, unless the bus is down.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let state = self.bus.state();
        if !state.carries_frames() {
            return Err(SendError::Bus(state));
        }
        let now_ns = self.clock.now_ns();
        self.outgoing.take(Received { frame: *frame, time_ns: now_ns }, now_ns);
        self.send_ready()
    }

    fn flush(&mut self) -> usize {
        self.bus.flush()
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, ReceiveError> {
        let deadline_ns =
            crate::clock::monotonic_ns().saturating_add(u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX));
        loop {
            let now_ns = self.clock.now_ns();
            if self.watched.is_none() {
                // There is nobody to tell about a refusal now; it is counted.
                let _ = self.send_due();
                self.incoming.release(now_ns);
            }
            if let Some(received) = self.incoming.ready.pop_front() {
                return Ok(Some(received));
            }
            let left = Duration::from_nanos(deadline_ns.saturating_sub(crate::clock::monotonic_ns()));
            let timed = self.watched.is_none()
                && (self.outgoing.next_time_ns().is_some() || self.incoming.next_time_ns().is_some());
            match self.bus.receive(if timed { left.min(CLOCK_POLL) } else { left })? {
                Some(received) => {
                    let watched = self.watched == Some(received.frame.id());
                    if watched {
                        self.incoming.release(self.clock.now_ns());
                    }
                    self.incoming.take(received, self.clock.now_ns());
                    if watched {
                        self.watched_count += 1;
                        return Ok(None);
                    }
                }
                None if left.is_zero() => return Ok(None),
                None => {}
            }
        }
    }

    /// Those of the bus behind: what the shim holds is on the wire already, and late there.
    fn discard_waiting(&mut self) -> usize {
        self.bus.discard_waiting()
    }

    fn state(&self) -> BusState {
        self.bus.state()
    }

    fn counters(&self) -> BusCounters {
        self.bus.counters()
    }

    fn set_filters(&mut self, filters: &[Filter]) -> Result<(), ReceiveError> {
        self.bus.set_filters(filters)
    }

    /// A handle with the same plans and a seed that follows from this one's.
    fn duplicate(&self) -> std::io::Result<Box<dyn CanBus>> {
        let number = self.duplicates.fetch_add(1, Ordering::Relaxed) + 1;
        let seed = self.seed.wrapping_add(number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let mut shim = FaultShim::clean(self.bus.duplicate()?, seed, Arc::clone(&self.clock));
        shim.set_plans(&self.outgoing.plans, &self.incoming.plans).map_err(std::io::Error::other)?;
        shim.duplicates = Arc::clone(&self.duplicates);
        shim.watched = self.watched;
        shim.incoming.gated = self.incoming.gated;
        Ok(Box::new(shim))
    }
}

#[cfg(test)]
mod tests;
