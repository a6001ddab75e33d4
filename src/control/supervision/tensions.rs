//! What a drive measures against what it was told: for longer than a time beyond a band is a drive that does not obey.

/// Ticks that a command and its measurement may take beside the declared latency.
const WAY_TICKS: usize = 3;
/// Most ticks of the declared way.
const WAY_MAX: usize = 24;
/// Oldest measurement that is compared (ticks): older ones tell nothing of what the drive does now.
const AGE_MAX: usize = 64;

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
    /// Commands that a measurement may answer.
    way: usize,
    /// Commands of the last ticks, the oldest overwritten first.
    commands: Vec<Vec<f64>>,
    next: usize,
    known: usize,
    since_s: Vec<f64>,
}

impl TensionCheck {
    /// For so many cables, a band (N) and the time for which it may be left (s). Allocates.
    pub fn new(cables: usize, limit_n: f64, time_s: f64, latency_ticks: usize) -> Self {
        let way = (WAY_TICKS + latency_ticks).min(WAY_MAX);
        Self {
            limit_n,
            time_s,
            way,
            // What is not a whole number of ticks old lies between two commands.
            commands: vec![vec![0.0; cables]; way + AGE_MAX + 1],
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
    /// valid) and for how many ticks they have been known to their drives. Such a measurement may answer any of the commands
    /// that were the last ones then. The drive that is farthest off. Does not allocate.
    pub fn check(&mut self, h: f64, commanded_n: &[f64], measured_n: &[f64], age_ticks: f64) -> Option<WrongTension> {
        let ring = self.commands.len();
        self.commands[self.next].copy_from_slice(commanded_n);
        self.next = (self.next + 1) % ring;
        self.known = (self.known + 1).min(ring);
        // A whole number of ticks but for the clock's rounding.
        let (first, last) = ((age_ticks + 1e-3).max(0.0).floor(), (age_ticks - 1e-3).max(0.0).ceil());
        if !age_ticks.is_finite() || first > AGE_MAX as f64 || last as usize + self.way > self.known {
            return None;
        }
        let answered = first as usize..last as usize + self.way;
        let mut worst: Option<WrongTension> = None;
        for (cable, (&measured, since_s)) in measured_n.iter().zip(&mut self.since_s).enumerate() {
            let told = answered.clone().map(|age| self.commands[(self.next + ring - 1 - age) % ring][cable]);
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
            let found = check.check(H, &[40.0, told(k)], &[40.0, measured(&told, k)], 0.0)?;
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

    #[test]
    fn an_old_measurement_is_compared_with_the_commands_of_its_own_time() {
        // 400 N/s: 20 ticks later the drive was told 80 N more.
        let late = |age_ticks: f64, error: f64| {
            let mut check = TensionCheck::new(1, 5.0, 0.1, 0);
            (0..100).any(|k| {
                let told = |k: usize| 4.0 * k as f64;
                check.check(H, &[told(k)], &[told(k.saturating_sub(20)) + error], age_ticks).is_some()
            })
        };
        assert!(!late(20.0, 0.0) && !late(19.4, 0.0));
        assert!(late(0.0, 0.0), "it does not follow");
        assert!(late(20.0, 9.0) && late(20.0, -30.0), "it obeys no better for being heard late");
        assert!(!late(100.0, 900.0) && !late(f64::NAN, 900.0), "from before anything is remembered of");
    }
}
