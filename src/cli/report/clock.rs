//! Times of a recording: seconds of the loop, as `status` and this report count them, and times of day.

use sinew::recording::utc_text;

/// Lays the clocks of a recording beside each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Clock {
    /// Time of the loop (s) of a state ...
    time_s: f64,
    /// ... its capture time (ns) ...
    capture_ns: u64,
    /// ... and its time in the file (ns).
    log_ns: u64,
}

impl Clock {
    pub(super) const fn new(time_s: f64, capture_ns: u64, log_ns: u64) -> Self {
        Self { time_s, capture_ns, log_ns }
    }

    /// Seconds of the loop of a capture time.
    pub(super) fn seconds(&self, capture_ns: u64) -> f64 {
        self.time_s + (i128::from(capture_ns) - i128::from(self.capture_ns)) as f64 * 1e-9
    }

    /// Time in the file (ns) of a time of the loop (s).
    pub(super) fn log_ns(&self, time_s: f64) -> u64 {
        let ns = i128::from(self.log_ns) + ((time_s - self.time_s) * 1e9).round() as i128;
        u64::try_from(ns.max(0)).unwrap_or(u64::MAX)
    }

    /// Seconds of the loop of a time in the file (ns).
    pub(super) fn of_log(&self, log_ns: u64) -> f64 {
        self.time_s + (i128::from(log_ns) - i128::from(self.log_ns)) as f64 * 1e-9
    }

    /// Seconds of the loop of the state that it was made from: the first one.
    pub(super) const fn begin_s(&self) -> f64 {
        self.time_s
    }

    /// Time of day in UTC; `None` in lockstep, whose time is the loop's own.
    pub(super) fn utc(&self, time_s: f64) -> Option<String> {
        // 2001: no loop has run for that long.
        let seconds = self.log_ns(time_s) / 1_000_000_000;
        (seconds > 1_000_000_000).then(|| utc_text(seconds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_meet_at_a_state() {
        let clock = Clock::new(2.5, 7_000_000_000, 1_709_251_199_000_000_000);
        assert_eq!(clock.seconds(6_000_000_000), 1.5);
        assert_eq!(clock.log_ns(3.5), 1_709_251_200_000_000_000);
        assert_eq!(clock.utc(2.5).as_deref(), Some("20240229T235959Z"));
        assert_eq!(Clock::new(0.0, 0, 0).utc(100.0), None);
        assert_eq!(Clock::new(1.0, 0, 0).log_ns(0.5), 0);
    }
}
