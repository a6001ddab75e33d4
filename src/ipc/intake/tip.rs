//! The measured tip: newest wins, one source at a time.

use super::encoders::admit;
use super::{InputLimits, SourceLog, check};
use crate::ipc::payload::{RejectCause, SourceHealth, SourceReport, Tip};

/// The newest valid measurement.
#[derive(Debug, Clone, Default)]
pub struct TipTable {
    log: SourceLog,
    latest: Tip,
}

impl TipTable {
    /// Takes over a message of a port (0: not known) if it is valid. Does not allocate.
    ///
    /// While the source in use is fresh, no other one may take its place; a stale one is replaced by the next that comes.
    ///
    /// # Errors
    /// The cause for which it was rejected; already counted.
    pub fn accept_from(
        &mut self,
        message: &Tip,
        publisher: u128,
        now_ns: u64,
        limits: &InputLimits,
    ) -> Result<(), RejectCause> {
        let checked = admit(&mut self.log, &message.header, publisher, now_ns, limits)
            .and_then(|()| check::coordinates(&message.position_m));
        self.log.settle(checked, &message.header, publisher)?;
        self.latest = *message;
        Ok(())
    }

    /// The newest valid measurement, unless it is stale.
    pub fn fresh(&self, now_ns: u64, limits: &InputLimits) -> Option<&Tip> {
        (self.log.health(now_ns, limits) == SourceHealth::Fresh).then_some(&self.latest)
    }

    /// The record for `State::tip_report`.
    pub fn report(&self, now_ns: u64, limits: &InputLimits) -> SourceReport {
        self.log.report(now_ns, limits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ipc::payload::Header;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn a_measurement_counts_while_it_is_fresh_and_what_is_no_position_never_does() {
        let (limits, mut table) = (InputLimits::default(), TipTable::default());
        let message = |source, sequence, capture_ns, x| Tip {
            header: Header::new(source, sequence, capture_ns),
            position_m: [x, 0.0, -2.0],
        };
        assert!(table.fresh(SECOND, &limits).is_none());
        table.accept_from(&message(3, 0, SECOND, 0.1), 7, SECOND, &limits).unwrap();
        assert_eq!(table.fresh(SECOND, &limits).unwrap().position_m[0], 0.1);
        for (x, cause) in [(f64::NAN, RejectCause::NotFinite), (1e6, RejectCause::Dimensions)] {
            assert_eq!(table.accept_from(&message(3, 1, SECOND + 1, x), 7, SECOND + 1, &limits), Err(cause));
        }
        // Another source waits until the first one is silent.
        let other = message(4, 0, SECOND + 2, 0.2);
        assert_eq!(table.accept_from(&other, 8, SECOND + 2, &limits), Err(RejectCause::TooManySources));
        let later = SECOND + 110_000_000;
        assert!(table.fresh(later, &limits).is_none());
        table.accept_from(&message(4, 1, later, 0.2), 8, later, &limits).unwrap();
        assert_eq!(table.fresh(later, &limits).unwrap().position_m[0], 0.2);
        let report = table.report(later, &limits);
        assert_eq!((report.source_id, report.accepted, report.rejected_total()), (4, 2, 3));
    }
}
