//! Encoder states: newest wins, one source at a time.

use super::{InputLimits, SourceLog, check};
use crate::ipc::payload::{EncoderSource, Encoders, RejectCause, SourceHealth, SourceReport};

/// The newest valid encoder state.
#[derive(Debug, Clone)]
pub struct EncoderTable {
    cable_count: usize,
    log: SourceLog,
    latest: Encoders,
}

impl EncoderTable {
    /// A table for an arm with this many cables, in which nothing was heard.
    pub fn new(cable_count: usize) -> Self {
        Self { cable_count, log: SourceLog::default(), latest: Encoders::default() }
    }

    /// Takes over a message if it is valid. Does not allocate.
    ///
    /// While the source in use is fresh, no other one may take its place; a stale one is replaced by the next that comes.
    ///
    /// # Errors
    /// The cause for which it was rejected; already counted.
    pub fn accept(&mut self, message: &Encoders, now_ns: u64, limits: &InputLimits) -> Result<(), RejectCause> {
        self.accept_from(message, 0, now_ns, limits)
    }

    /// The same of a port (0: not known), to which the source's id belongs until the source is not fresh any more.
    ///
    /// # Errors
    /// As [`Self::accept`].
    pub fn accept_from(
        &mut self,
        message: &Encoders,
        publisher: u128,
        now_ns: u64,
        limits: &InputLimits,
    ) -> Result<(), RejectCause> {
        let checked =
            admit(&mut self.log, &message.header, publisher, now_ns, limits).and_then(|()| self.validate(message));
        self.log.settle(checked, &message.header, publisher)?;
        self.latest = *message;
        self.drop_bad_entries();
        Ok(())
    }

    fn validate(&self, message: &Encoders) -> Result<(), RejectCause> {
        if message.cable_count as usize != self.cable_count {
            return Err(RejectCause::WrongCount);
        }
        EncoderSource::from_wire(message.source).ok_or(RejectCause::UnknownKind).map(drop)
    }

    /// A reading that cannot be is none, and is counted; the other cables' are as good as before.
    fn drop_bad_entries(&mut self) {
        let Self { latest, log, .. } = self;
        for cable in 0..self.cable_count {
            let bit = !(1 << (cable % 64));
            if latest.is_length_valid(cable)
                && let Err(cause) = check::lengths(&latest.length_m[cable..=cable])
            {
                latest.length_valid[cable / 64] &= bit;
                log.reject(cause);
            }
            if latest.is_tension_valid(cable)
                && let Err(cause) = check::finite(&latest.tension_n[cable..=cable])
            {
                latest.tension_valid[cable / 64] &= bit;
                log.reject(cause);
            }
        }
    }

    /// The newest valid message; `None` before the first one.
    pub fn latest(&self) -> Option<&Encoders> {
        self.log.last.is_some().then_some(&self.latest)
    }

    /// Age of the newest message (s); infinite before the first one.
    pub fn age_s(&self, now_ns: u64) -> f64 {
        self.log.age_s(now_ns)
    }

    /// Health of the source in use.
    pub fn health(&self, now_ns: u64, limits: &InputLimits) -> SourceHealth {
        self.log.health(now_ns, limits)
    }

    /// The record for `State::encoder_report`.
    pub fn report(&self, now_ns: u64, limits: &InputLimits) -> SourceReport {
        self.log.report(now_ns, limits)
    }

    /// Whether the encoders of `tick` or later are here (lockstep).
    pub fn is_ready_for(&self, tick: u64) -> bool {
        self.log.has_come_for(tick)
    }
}

/// Version, time and sequence of a message where only one source counts at a time.
pub(super) fn admit(
    log: &mut SourceLog,
    header: &crate::ipc::payload::Header,
    publisher: u128,
    now_ns: u64,
    limits: &InputLimits,
) -> Result<(), RejectCause> {
    let takes_over = log.last.is_none() || log.health(now_ns, limits) != SourceHealth::Fresh;
    if log.taken_by(publisher).is_some() && !takes_over {
        return Err(RejectCause::TooManySources);
    }
    if header.source_id == log.source_id {
        return log.check(header, now_ns, limits);
    }
    if !takes_over {
        return Err(RejectCause::TooManySources);
    }
    // The counters stay: they belong to the service, not to the source.
    let fresh = SourceLog { source_id: header.source_id, last: None, ..*log };
    fresh.check(header, now_ns, limits)?;
    *log = fresh;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ipc::payload::Header;

    const SECOND: u64 = 1_000_000_000;
    const NOW: u64 = 100 * SECOND;

    fn message(source: u32, sequence: u64, capture_ns: u64) -> Encoders {
        let mut m = Encoders { header: Header::new(source, sequence, capture_ns), ..Encoders::default() };
        m.set_all_valid(24);
        m.length_m = [0.65; 96];
        m
    }

    fn limits() -> InputLimits {
        InputLimits::default()
    }

    fn refused(cause: RejectCause, change: impl Fn(&mut Encoders)) {
        let mut table = EncoderTable::new(24);
        let good = message(1, 0, NOW);
        table.accept(&good, NOW, &limits()).unwrap();
        let mut bad = message(1, 1, NOW);
        change(&mut bad);
        assert_eq!(table.accept(&bad, NOW, &limits()), Err(cause));
        assert_eq!(table.report(NOW, &limits()).rejected[cause.wire() as usize], 1);
        assert_eq!(table.latest(), Some(&good), "the last valid state stays");
    }

    #[test]
    fn malformed_states_are_refused_one_by_one() {
        refused(RejectCause::WrongCount, |m| m.cable_count = 23);
        refused(RejectCause::WrongCount, |m| m.cable_count = u32::MAX);
        refused(RejectCause::UnknownKind, |m| m.source = 0);
        refused(RejectCause::Future, |m| m.header.capture_ns = NOW + SECOND);
        refused(RejectCause::Backwards, |m| m.header.capture_ns = NOW - 1);
        refused(RejectCause::Sequence, |m| m.header.sequence = 0);
        refused(RejectCause::Schema, |m| m.header.schema_version = 0);
    }

    #[test]
    fn a_reading_that_cannot_be_blinds_its_own_cable_and_no_other() {
        for (cause, length_m) in [(RejectCause::NotFinite, f64::NAN), (RejectCause::Dimensions, -0.1)] {
            let mut table = EncoderTable::new(24);
            let mut m = message(1, 0, NOW);
            m.length_m[3] = length_m;
            m.tension_n[5] = f64::INFINITY;
            table.accept(&m, NOW, &limits()).unwrap();
            let latest = table.latest().unwrap();
            assert!((0..24).all(|cable| latest.is_length_valid(cable) == (cable != 3)));
            assert!((0..24).all(|cable| latest.is_tension_valid(cable) == (cable != 5)));
            let report = table.report(NOW, &limits());
            assert!(report.rejected[cause.wire() as usize] >= 1 && report.rejected_total() == 2);
        }
    }

    #[test]
    fn what_is_marked_invalid_or_beyond_the_count_is_not_looked_at() {
        let mut m = message(1, 0, NOW);
        m.length_m[40] = f64::NAN;
        m.length_m[5] = f64::NAN;
        m.length_valid[0] &= !(1 << 5);
        EncoderTable::new(24).accept(&m, NOW, &limits()).unwrap();
    }

    #[test]
    fn another_source_takes_over_only_from_a_stale_one() {
        let mut table = EncoderTable::new(24);
        table.accept(&message(1, 50, NOW), NOW, &limits()).unwrap();
        assert_eq!(table.accept(&message(2, 0, NOW), NOW, &limits()), Err(RejectCause::TooManySources));
        let later = NOW + SECOND / 5;
        table.accept(&message(2, 0, later), later, &limits()).unwrap();
        assert_eq!(table.latest().unwrap().header.source_id, 2);
        assert_eq!(table.report(later, &limits()).rejected_total(), 1, "counters stay");
    }

    #[test]
    fn masks_have_as_many_bits_as_cables() {
        for count in [0, 1, 63, 64, 65, 96, 200] {
            let mut m = Encoders::default();
            m.set_all_valid(count);
            assert_eq!((0..300).filter(|&c| m.is_length_valid(c)).count(), count.min(96));
        }
    }
}
