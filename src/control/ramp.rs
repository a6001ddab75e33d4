//! Straight-line ramp of all tensions to given values.

/// A ramp; made once, started again and again without allocation.
#[derive(Debug, Clone)]
pub struct Ramp {
    from: Vec<f64>,
    duration_ns: f64,
    begin_ns: Option<u64>,
}

impl Ramp {
    /// A ramp for so many cables over `duration_s`. Allocates.
    pub fn new(cables: usize, duration_s: f64) -> Self {
        Self { from: vec![0.0; cables], duration_ns: duration_s * 1e9, begin_ns: None }
    }

    /// Begins at `begin_ns` from the tensions `from` (N), unless it runs already.
    pub fn begin(&mut self, from: &[f64], begin_ns: u64) {
        if self.begin_ns.is_none() {
            self.from.copy_from_slice(from);
            self.begin_ns = Some(begin_ns);
        }
    }

    /// Ends it, so that the next [`Self::begin`] starts anew.
    pub fn end(&mut self) {
        self.begin_ns = None;
    }

    /// Whether it runs or has arrived and was not ended.
    pub fn is_begun(&self) -> bool {
        self.begin_ns.is_some()
    }

    /// Share of the way at `now_ns`, 0 to 1; 1 where it was never begun, for nothing is left to ramp.
    pub fn share(&self, now_ns: u64) -> f64 {
        self.begin_ns.map_or(1.0, |begin| (now_ns.saturating_sub(begin) as f64 / self.duration_ns).clamp(0.0, 1.0))
    }

    /// Tensions (N) at `now_ns` on the way to `to` (N): monotone in time for each cable, exactly `to` at the end.
    pub fn tensions_into(&self, to: &[f64], now_ns: u64, out: &mut [f64]) {
        let share = self.share(now_ns);
        for ((out, from), to) in out.iter_mut().zip(&self.from).zip(to) {
            *out = if share >= 1.0 { *to } else { from + share * (to - from) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_monotone_and_arrives_exactly_at_its_end() {
        let mut ramp = Ramp::new(3, 0.5);
        ramp.begin(&[220.0, 5.0, 0.1], 1_000);
        ramp.begin(&[1.0, 1.0, 1.0], 2_000);
        let (to, mut last, mut out) = ([5.0; 3], [220.0, 5.0, 0.1], [0.0; 3]);
        for step in 0..=50u64 {
            ramp.tensions_into(&to, 1_000 + step * 10_000_000, &mut out);
            assert!(out[0] <= last[0] && out[1] == 5.0 && out[2] >= last[2], "step {step}: {out:?}");
            assert_eq!(out == to, step == 50, "step {step}: {out:?}");
            last = out;
        }
        assert_eq!(ramp.share(0), 0.0, "a clock that went back does not run past the start");
    }
}
