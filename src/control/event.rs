//! What happened, in a fixed ring: `Copy` events, written in the loop, put into words elsewhere.

use super::fault::{Fault, Limit};
use super::supervisor::{Answer, Cause, Mode};

/// Places of the ring: a second of an event per tick at 100 Hz, and more than any real second has.
pub const EVENTS: usize = 128;

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EventKind {
    /// The mode changed.
    Mode {
        /// Before.
        from: Mode,
        /// After.
        to: Mode,
        /// Why.
        cause: Cause,
    },
    /// A fault of a kind that was not latched yet.
    Fault(Fault),
    /// A request was answered.
    Request(Answer),
    /// A limit began to act.
    LimitOn(Limit),
    /// A limit no longer acts.
    LimitOff(Limit),
}

/// An event with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// Tick.
    pub tick: u64,
    /// Time of that tick (ns).
    pub now_ns: u64,
    /// What.
    pub kind: EventKind,
}

/// The ring; when it is full the oldest event is dropped and counted.
#[derive(Debug, Clone)]
pub struct EventRing {
    events: [Option<Event>; EVENTS],
    start: usize,
    count: usize,
    /// Events that were overwritten before anyone took them.
    pub dropped: u64,
}

impl Default for EventRing {
    fn default() -> Self {
        Self { events: [None; EVENTS], start: 0, count: 0, dropped: 0 }
    }
}

impl EventRing {
    /// Adds an event. Does not allocate.
    pub fn push(&mut self, event: Event) {
        if self.count == EVENTS {
            self.start = (self.start + 1) % EVENTS;
            self.count -= 1;
            self.dropped += 1;
        }
        self.events[(self.start + self.count) % EVENTS] = Some(event);
        self.count += 1;
    }

    /// Takes the oldest event. Does not allocate.
    pub fn pop(&mut self) -> Option<Event> {
        if self.count == 0 {
            return None;
        }
        let event = self.events[self.start].take();
        self.start = (self.start + 1) % EVENTS;
        self.count -= 1;
        event
    }

    /// Events that wait.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_ring_drops_the_oldest_and_counts_it() {
        let mut ring = EventRing::default();
        let event = |tick| Event { tick, now_ns: 0, kind: EventKind::LimitOn(Limit::Relaxed) };
        (0..EVENTS as u64 + 5).for_each(|t| ring.push(event(t)));
        assert_eq!((ring.len(), ring.dropped), (EVENTS, 5));
        let ticks: Vec<u64> = std::iter::from_fn(|| ring.pop()).map(|e| e.tick).collect();
        assert_eq!(ticks, (5..EVENTS as u64 + 5).collect::<Vec<_>>());
        assert!(ring.is_empty());
    }
}
