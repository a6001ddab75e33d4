//! One source's clock, sequence and counters.

use super::{InputLimits, elapsed_s};
use crate::ipc::payload::{Header, NO_TICK, REJECT_CAUSES, RejectCause, SCHEMA_VERSION, SourceHealth, SourceReport};
use sinew_hal::clock::seconds_to_ns;

/// Messages too old on arrival by which it shows that their source lives: several clients of one id may have died.
const TOO_OLD_MIN: u64 = 4;

/// What is known about a source: its last accepted header, and what was accepted and rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SourceLog {
    /// Source id.
    pub source_id: u32,
    /// Header of the last accepted message; `None` before the first one and after the source left.
    pub last: Option<Header>,
    /// Messages accepted.
    pub accepted: u64,
    /// Messages rejected, by cause.
    pub rejected: [u64; REJECT_CAUSES],
    /// Whether all that came since there was content last was rejected: somebody is there, and is not understood.
    pub refused: bool,
    /// Port whose messages are accepted under this id; 0 if it is not known.
    pub publisher: u128,
    /// Whether that port, or its process, has been found to be gone. What it said holds on.
    pub gone: bool,
    /// Tick (lockstep) for which a message came last that was refused.
    pub refused_for: Option<u64>,
}

impl SourceLog {
    /// A source that was not heard yet.
    pub const fn new(source_id: u32) -> Self {
        Self {
            source_id,
            last: None,
            accepted: 0,
            rejected: [0; REJECT_CAUSES],
            refused: false,
            publisher: 0,
            gone: false,
            refused_for: None,
        }
    }

    /// Checks version, time and sequence of a header; changes nothing.
    ///
    /// # Errors
    /// The cause to count: schema, future, too old on first sight, backwards, sequence.
    pub fn check(&self, header: &Header, now_ns: u64, limits: &InputLimits) -> Result<(), RejectCause> {
        if header.schema_version != SCHEMA_VERSION {
            return Err(RejectCause::Schema);
        }
        if header.capture_ns > now_ns.saturating_add(seconds_to_ns(limits.future_tolerance_s)) {
            return Err(RejectCause::Future);
        }
        let Some(last) = &self.last else {
            // The history of a service keeps the last message of a client that died long ago. That is no source.
            let too_old = elapsed_s(header.capture_ns, now_ns) > limits.hold_after_s;
            return if too_old { Err(RejectCause::TooOld) } else { Ok(()) };
        };
        if header.capture_ns < last.capture_ns {
            return Err(RejectCause::Backwards);
        }
        // A restarted source begins at 0, but that message may have been replaced by the next before it was taken, or
        // refused. While the old life is fresh, a lower number is a message that was overtaken.
        let restarted = header.capture_ns > last.capture_ns
            && (header.sequence == 0 || self.health(now_ns, limits) != SourceHealth::Fresh);
        if header.sequence <= last.sequence && !restarted {
            return Err(RejectCause::Sequence);
        }
        Ok(())
    }

    /// Counts a message of a port as it was judged, and gives the verdict back.
    ///
    /// # Errors
    /// The cause for which it was rejected.
    pub fn settle(
        &mut self,
        checked: Result<(), RejectCause>,
        header: &Header,
        publisher: u128,
    ) -> Result<(), RejectCause> {
        match checked {
            Ok(()) => {
                self.accept(header);
                self.publisher = publisher;
            }
            Err(cause) => self.refuse(cause, header),
        }
        checked
    }

    /// Counts an accepted message.
    pub fn accept(&mut self, header: &Header) {
        self.last = Some(*header);
        self.accepted += 1;
        (self.refused, self.gone) = (false, false);
    }

    /// The port that has this source's id, if it is another one than this and not known to be gone.
    pub fn taken_by(&self, publisher: u128) -> Option<u128> {
        let other = self.last.is_some() && !self.gone && ![0, publisher].contains(&self.publisher);
        (other && publisher != 0).then_some(self.publisher)
    }

    /// Whether the source is waited for in vain (lockstep): it spoke, and its port is gone since.
    pub fn is_gone(&self) -> bool {
        self.gone
    }

    /// Whether what the source had to say for `tick` or later is here (lockstep). What was refused has come, too: it is not
    /// said again, and who waited for it would wait for ever.
    pub fn has_come_for(&self, tick: u64) -> bool {
        let newest = [self.last.map(|header| header.tick), self.refused_for];
        newest.into_iter().flatten().any(|came| came >= tick && came != NO_TICK)
    }

    /// Counts a message of the source that is rejected for what it says.
    pub fn refuse(&mut self, cause: RejectCause, header: &Header) {
        // Another that claims to be it has not spoken for it.
        if cause != RejectCause::TooManySources {
            self.refused_for = Some(header.tick);
        }
        self.reject(cause);
    }

    /// Counts a rejected message, or entry of one.
    pub fn reject(&mut self, cause: RejectCause) {
        let count = &mut self.rejected[cause.wire() as usize];
        *count += 1;
        // What a client that died long ago said last comes once, from the history of the service; whoever lives comes again.
        let alive = cause != RejectCause::TooOld || *count >= TOO_OLD_MIN;
        self.refused |= self.last.is_none() && alive;
    }

    /// There is no content any more: the source left, or was forgotten.
    pub fn forget(&mut self) {
        (self.last, self.refused, self.gone, self.refused_for) = (None, false, false, None);
    }

    /// Age of the newest content (s); infinite if there is none, 0 if it is from the tolerated future.
    pub fn age_s(&self, now_ns: u64) -> f64 {
        self.last.map_or(f64::INFINITY, |h| elapsed_s(h.capture_ns, now_ns).max(0.0))
    }

    /// Health of the source.
    pub fn health(&self, now_ns: u64, limits: &InputLimits) -> SourceHealth {
        if self.last.is_none() {
            return if self.refused { SourceHealth::Refused } else { SourceHealth::Absent };
        }
        let age_s = self.age_s(now_ns);
        if age_s > limits.hold_after_s {
            SourceHealth::Expired
        } else if age_s > limits.stale_after_s {
            SourceHealth::Stale
        } else {
            SourceHealth::Fresh
        }
    }

    /// The record for `State`.
    pub fn report(&self, now_ns: u64, limits: &InputLimits) -> SourceReport {
        SourceReport {
            source_id: self.source_id,
            health: self.health(now_ns, limits).wire(),
            sequence: self.last.map_or(0, |h| h.sequence),
            age_s: self.age_s(now_ns),
            accepted: self.accepted,
            rejected: self.rejected,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const LIMITS: InputLimits = InputLimits {
        stale_after_s: 0.1,
        hold_after_s: 0.5,
        growth_mps: 0.2,
        growth_m_max: 1.0,
        sigma_multiple: 3.0,
        future_tolerance_s: 0.005,
    };

    fn heard(sequence: u64, capture_ns: u64) -> SourceLog {
        let mut log = SourceLog::new(7);
        log.accept(&Header::new(7, sequence, capture_ns));
        log
    }

    #[test]
    fn time_travel_is_refused() {
        let log = heard(5, SECOND);
        let check = |sequence, capture_ns, now_ns| log.check(&Header::new(7, sequence, capture_ns), now_ns, &LIMITS);
        assert_eq!(check(6, SECOND + 5_000_000, SECOND), Ok(()));
        assert_eq!(check(6, SECOND + 5_000_001, SECOND), Err(RejectCause::Future));
        assert_eq!(check(6, SECOND - 1, SECOND), Err(RejectCause::Backwards));
        assert_eq!(check(6, u64::MAX, SECOND), Err(RejectCause::Future));
    }

    #[test]
    fn a_repeated_sequence_is_refused_and_a_restart_is_not() {
        let log = heard(5, SECOND);
        let check =
            |sequence, capture_ns| log.check(&Header::new(7, sequence, capture_ns), SECOND + SECOND / 10, &LIMITS);
        assert_eq!(check(5, SECOND + 1), Err(RejectCause::Sequence));
        assert_eq!(check(4, SECOND + 1), Err(RejectCause::Sequence));
        assert_eq!(check(0, SECOND), Err(RejectCause::Sequence));
        assert_eq!(check(0, SECOND + 1), Ok(()));
        assert_eq!(check(6, SECOND), Ok(()));
    }

    #[test]
    fn a_restart_whose_first_message_was_not_seen_is_taken_as_soon_as_the_old_life_is_stale() {
        let log = heard(5, SECOND);
        let stale_ns = SECOND + 100_000_001;
        let check = |sequence, capture_ns, now_ns| log.check(&Header::new(7, sequence, capture_ns), now_ns, &LIMITS);
        assert_eq!(check(1, stale_ns - 1, stale_ns - 1), Err(RejectCause::Sequence), "fresh still");
        assert_eq!(check(1, stale_ns, stale_ns), Ok(()));
        assert_eq!(check(5, stale_ns, stale_ns), Ok(()));
        // The old life's own messages are no restart, however late they come.
        assert_eq!(check(5, SECOND, stale_ns), Err(RejectCause::Sequence));
        assert_eq!(check(4, SECOND - 1, stale_ns), Err(RejectCause::Backwards));
    }

    #[test]
    fn the_message_of_a_client_long_dead_makes_no_source() {
        let log = SourceLog::new(7);
        assert_eq!(log.check(&Header::new(7, 3, SECOND), 2 * SECOND, &LIMITS), Err(RejectCause::TooOld));
        assert_eq!(log.check(&Header::new(7, 3, SECOND), SECOND + SECOND / 2, &LIMITS), Ok(()));
    }

    #[test]
    fn another_schema_version_is_refused() {
        let mut header = Header::new(7, 0, SECOND);
        header.schema_version += 1;
        assert_eq!(SourceLog::new(7).check(&header, SECOND, &LIMITS), Err(RejectCause::Schema));
    }

    #[test]
    fn health_follows_age() {
        let log = heard(0, SECOND);
        assert_eq!(SourceLog::new(7).health(SECOND, &LIMITS), SourceHealth::Absent);
        assert_eq!(log.health(SECOND, &LIMITS), SourceHealth::Fresh);
        assert_eq!(log.health(SECOND + 101_000_000, &LIMITS), SourceHealth::Stale);
        assert_eq!(log.health(SECOND + 501_000_000, &LIMITS), SourceHealth::Expired);
    }
}
