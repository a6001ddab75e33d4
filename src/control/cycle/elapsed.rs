//! By how many periods the estimate advances in a tick, where ticks were left out.
//!
//! The estimate stands at the time of the readings. In a loop that keeps its time both move on by a period a tick, however
//! old the readings always are, and nothing is measured, so that their jitter does not enter. After ticks left out the
//! readings tell how far to go: encoders that are read at the loop's own SYNC stood still with it, and the first tick
//! afterwards finds a reading from before the pause; what is read by itself is as fresh as ever. Periods that the readings
//! do not cover are owed until they do.

/// Longest time that an estimate advances by at once (ns): the planner's usual step, with which the model is known to work.
/// What is beyond is given up. A loop that was away for longer has lost its drives, too (`drives.sync_timeout_s`).
const LONGEST_NS: u64 = 100_000_000;

/// The time between two estimates, in periods.
#[derive(Debug, Clone)]
pub(super) struct Elapsed {
    period_ns: u64,
    last_ns: Option<u64>,
    /// Whole periods that readings were old in the last tick that nothing preceded.
    usual_age: u64,
    owed: u64,
}

impl Elapsed {
    pub(super) fn new(period_ns: u64) -> Self {
        Self { period_ns: period_ns.max(1), last_ns: None, usual_age: 0, owed: 0 }
    }

    /// A tick at `now_ns` with readings of `capture_ns`: periods, at least one, from the last estimate to this one.
    pub(super) fn advance(&mut self, now_ns: u64, capture_ns: u64) -> u32 {
        let since_ns = self.last_ns.replace(now_ns).map_or(0, |last_ns| now_ns.saturating_sub(last_ns));
        let passed = ((since_ns + self.period_ns / 2) / self.period_ns).max(1);
        let age = now_ns.saturating_sub(capture_ns) / self.period_ns;
        let due = self.owed + passed;
        if due == 1 {
            self.usual_age = age;
            return 1;
        }
        let periods = due.saturating_sub(age.saturating_sub(self.usual_age)).max(1);
        self.owed = due - periods;
        periods.min((LONGEST_NS / self.period_ns).max(1)) as u32
    }

    /// There is no estimate that could be behind.
    pub(super) fn settle(&mut self) {
        self.owed = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: u64 = 1_000;

    fn running(ages: u64) -> Elapsed {
        let mut e = Elapsed::new(T);
        assert!((10..20).all(|k| e.advance(k * T, k * T - ages) == 1));
        e
    }

    #[test]
    fn a_loop_in_time_advances_by_a_period_a_tick_however_the_readings_age() {
        let mut e = Elapsed::new(T);
        for k in 1..100 {
            assert_eq!(e.advance(k * T, (k * T).saturating_sub(37 * k % (5 * T))), 1);
        }
        // No reading at all.
        assert_eq!(e.advance(100 * T, 0), 1);
    }

    #[test]
    fn readings_that_stood_still_with_the_loop_are_caught_up_with_when_they_move_on() {
        // Read at the SYNC of the tick before, which left 300 ns after its beginning.
        let mut e = running(700);
        // Tick 19 was the last; 20 to 25 are left out.
        assert_eq!(e.advance(26 * T, 19 * T + 300), 1, "what the last SYNC brought is a period on");
        assert_eq!(e.advance(27 * T, 26 * T + 300), 7);
        assert_eq!(e.advance(28 * T, 27 * T + 300), 1);
        assert_eq!(e.owed, 0);
    }

    #[test]
    fn readings_that_go_on_by_themselves_are_followed_at_once() {
        let mut e = running(200);
        assert_eq!(e.advance(26 * T, 26 * T - 150), 7);
        assert_eq!(e.advance(27 * T, 27 * T - 250), 1);
        assert_eq!(e.owed, 0);
    }

    #[test]
    fn readings_that_are_always_some_periods_old_are_no_pause() {
        let mut e = running(2_400);
        assert_eq!(e.advance(26 * T, 26 * T - 2_300), 7);
        let mut e = running(1_600);
        // Tick 18's answers, then 19's, then 26's.
        assert_eq!(e.advance(26 * T, 18 * T + 400), 1);
        assert_eq!(e.advance(27 * T, 19 * T + 400), 1);
        assert_eq!(e.advance(28 * T, 26 * T + 400), 7);
        assert_eq!(e.owed, 0);
    }

    #[test]
    fn a_pause_with_readings_missing_behind_it_is_made_up_for_when_they_come() {
        let mut e = running(700);
        assert_eq!(e.advance(26 * T, 19 * T + 300), 1);
        assert_eq!(e.advance(27 * T, 19 * T + 300), 1, "nothing new");
        assert_eq!(e.advance(28 * T, 27 * T + 300), 7, "8 periods since the reading before, one of them gone already");
        let mut e = running(700);
        e.advance(26 * T, 19 * T + 300);
        e.settle();
        assert_eq!(e.advance(27 * T, 26 * T + 300), 1, "without an estimate there is nothing to make up for");
    }

    #[test]
    fn a_pause_beyond_a_tenth_of_a_second_is_made_up_for_as_far_as_one_step_goes() {
        let ms = 1_000_000;
        let mut e = Elapsed::new(10 * ms);
        assert!((1..20).all(|k| e.advance(10 * k * ms, 10 * k * ms) == 1));
        assert_eq!(e.advance(2_000 * ms, 2_000 * ms), 10);
        assert_eq!(e.advance(2_010 * ms, 2_010 * ms), 1);
    }
}
