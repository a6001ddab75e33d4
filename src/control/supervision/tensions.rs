//! What a drive measures against what it was told: for longer than a time beyond a band is a drive that does not obey.

/// Ticks that a command and its measurement may take beside the declared latency.
const WAY_TICKS: usize = 3;
/// Most commands that are remembered.
const WAY_MAX: usize = 24;

/// A drive that does not obey.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrongTension {
    /// Cable (0-based).
    pub cable: u16,
    /// Tension measured beyond those commanded (N).
    pub error_n: f64,
}

/// The check of all drives. [`TensionCheck::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct TensionCheck {
    limit_n: f64,
    time_s: f64,
    /// Commands of the last ticks, the oldest overwritten first.
    commands: Vec<Vec<f64>>,
    next: usize,
    known: usize,
    since_s: Vec<f64>,
}

impl TensionCheck {
    /// For so many cables, a band (N) and the time for which it may be left (s). Allocates.
    pub fn new(cables: usize, limit_n: f64, time_s: f64, latency_ticks: usize) -> Self {
        let ticks = (WAY_TICKS + latency_ticks).min(WAY_MAX);
        Self {
            limit_n,
            time_s,
            commands: vec![vec![0.0; cables]; ticks],
            next: 0,
            known: 0,
            since_s: vec![0.0; cables],
        }
    }

    /// Forgets what was commanded.
    pub fn restart(&mut self) {
        (self.next, self.known) = (0, 0);
        self.since_s.fill(0.0);
    }

    /// One tick of `h` seconds: tensions told in the tick before (N), tensions measured (N, empty for none, NaN where not
    /// valid). A measurement may answer any of the last commands. The drive that is farthest off. Does not allocate.
    pub fn check(&mut self, h: f64, commanded_n: &[f64], measured_n: &[f64]) -> Option<WrongTension> {
        self.commands[self.next].copy_from_slice(commanded_n);
        self.next = (self.next + 1) % self.commands.len();
        self.known = (self.known + 1).min(self.commands.len());
        if self.known < self.commands.len() {
            return None;
        }
        let mut worst: Option<WrongTension> = None;
        for (cable, (&measured, since_s)) in measured_n.iter().zip(&mut self.since_s).enumerate() {
            let told = self.commands.iter().map(|told| told[cable]);
            let (low, high) = told.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), u| (a.min(u), b.max(u)));
            let error_n = (measured - high).max(0.0) - (low - measured).max(0.0);
            *since_s = if error_n.abs() > self.limit_n { *since_s + h } else { 0.0 };
            if *since_s > self.time_s && worst.is_none_or(|w| error_n.abs() > w.error_n.abs()) {
                worst = Some(WrongTension { cable: cable as u16, error_n });
            }
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 0.01;

    /// First tick of 100 in which a drive is named: commands by tick, measurements by the commands.
    fn named(
        told: impl Fn(usize) -> f64,
        measured: impl Fn(&dyn Fn(usize) -> f64, usize) -> f64,
    ) -> Option<(usize, WrongTension)> {
        let mut check = TensionCheck::new(2, 5.0, 0.1, 0);
        (0..100).find_map(|k| {
            let found = check.check(H, &[40.0, told(k)], &[40.0, measured(&told, k)])?;
            Some((k, found))
        })
    }

    #[test]
    fn a_drive_that_follows_late_by_its_way_obeys() {
        // 400 N/s, and a measurement that is two ticks old.
        assert_eq!(named(|k| 4.0 * k as f64, |told, k| told(k.saturating_sub(2)) + 4.9), None);
        assert_eq!(
            named(|_| 40.0, |_, k| if k.is_multiple_of(10) { 90.0 } else { 40.0 }),
            None,
            "for too short a time"
        );
        assert_eq!(named(|_| 40.0, |_, _| f64::NAN), None, "nothing measured, nothing known");
    }

    #[test]
    fn a_drive_that_pulls_more_or_less_than_told_is_named_within_its_time() {
        for error in [-6.0, 6.0, 7646.0] {
            let (k, found) = named(|_| 40.0, |_, k| if k < 50 { 40.0 } else { 40.0 + error }).expect("named");
            assert_eq!((found.cable, found.error_n), (1, error));
            assert!((59..=62).contains(&k), "{k}");
        }
    }
}
