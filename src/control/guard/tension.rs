//! Tensions: finite, inside the box, limited in their change.

use crate::config::{ArmConfig, GuardConfig};
use crate::control::fault::Fault;

/// What is the least tension that may leave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Floor {
    /// The arm's box.
    Box,
    /// Zero: the cables are being tightened for the first time.
    Zero,
}

/// What the guard found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TensionVerdict {
    /// Why the tensions were not sent as they were; the output then repeats the last ones.
    pub fault: Option<Fault>,
    /// Cables whose change was limited.
    pub limited: u32,
}

/// The last check before sending.
#[derive(Debug, Clone)]
pub struct TensionGuard {
    low_n: f64,
    /// Per cable.
    high_n: Vec<f64>,
    tolerance_n: f64,
    change_n_max: f64,
}

impl TensionGuard {
    /// For an arm's box and a period (s).
    pub fn new(arm: &ArmConfig, config: &GuardConfig, period_s: f64) -> Self {
        Self {
            low_n: arm.tension_n_min,
            high_n: arm.tension_maxima_n(),
            tolerance_n: config.box_tolerance_n,
            change_n_max: config.tension_rate_npsmax * period_s,
        }
    }

    /// Judges `proposed` (N) against the tensions `sent` last and writes what may leave to `out`, which is finite, at
    /// least zero and at most the box's upper end in every case. Does not allocate.
    ///
    /// In order: every value finite, every value inside the box but for rounding, else a fault and `out` repeats `sent`;
    /// then the box by clamping off the rounding, then the change per tick by limiting it.
    pub fn check(&self, proposed: &[f64], sent: &[f64], floor: Floor, out: &mut [f64]) -> TensionVerdict {
        let low = match floor {
            Floor::Box => self.low_n,
            Floor::Zero => 0.0,
        };
        let fault = proposed.iter().enumerate().find_map(|(cable, &u)| {
            let cable = cable as u16;
            if !u.is_finite() {
                Some(Fault::TensionNotFinite { cable })
            } else if u < low - self.tolerance_n || u > self.high_n[usize::from(cable)] + self.tolerance_n {
                Some(Fault::TensionOutside { cable, tension_n: u })
            } else {
                None
            }
        });
        let mut limited = 0;
        for (((out, &u), &last), &high) in out.iter_mut().zip(proposed).zip(sent).zip(&self.high_n) {
            // `sent` was an `out`; only its very first value comes from elsewhere.
            let last = if last.is_finite() { last.clamp(0.0, high) } else { low };
            *out = if fault.is_some() {
                last
            } else {
                let inside = u.clamp(low, high);
                let change = (inside - last).clamp(-self.change_n_max, self.change_n_max);
                // Not `last + change` throughout: an unlimited change must arrive exactly.
                if last + change == inside || (inside - last).abs() <= self.change_n_max {
                    inside
                } else {
                    limited += 1;
                    last + change
                }
            };
        }
        TensionVerdict { fault, limited }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(rate: f64) -> TensionGuard {
        TensionGuard { low_n: 5.0, high_n: vec![220.0; 3], tolerance_n: 1e-9, change_n_max: rate }
    }

    fn check(g: &TensionGuard, proposed: [f64; 3], sent: [f64; 3]) -> (TensionVerdict, [f64; 3]) {
        let mut out = [f64::NAN; 3];
        let verdict = g.check(&proposed, &sent, Floor::Box, &mut out);
        (verdict, out)
    }

    #[test]
    fn tensions_inside_the_box_pass_unchanged() {
        let (verdict, out) = check(&guard(f64::INFINITY), [5.0, 100.0, 220.0], [5.0; 3]);
        assert_eq!(verdict, TensionVerdict { fault: None, limited: 0 });
        assert_eq!(out, [5.0, 100.0, 220.0]);
    }

    #[test]
    fn what_is_not_a_number_never_passes() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (verdict, out) = check(&guard(10.0), [50.0, bad, 60.0], [40.0, 41.0, 42.0]);
            assert_eq!(verdict.fault, Some(Fault::TensionNotFinite { cable: 1 }));
            assert_eq!(out, [40.0, 41.0, 42.0], "the last ones are repeated");
        }
        let (_, out) = check(&guard(10.0), [f64::NAN; 3], [f64::NAN; 3]);
        assert_eq!(out, [5.0; 3], "and where there are none, the least");
    }

    #[test]
    fn rounding_is_clamped_off_and_more_than_rounding_is_a_fault() {
        let (verdict, out) = check(&guard(f64::INFINITY), [5.0 - 5e-10, 220.0 + 5e-10, 100.0], [50.0; 3]);
        assert_eq!((verdict.fault, out), (None, [5.0, 220.0, 100.0]));
        let (verdict, out) = check(&guard(f64::INFINITY), [100.0, 220.0 + 2e-9, 100.0], [50.0; 3]);
        assert!(matches!(verdict.fault, Some(Fault::TensionOutside { cable: 1, .. })));
        assert_eq!(out, [50.0; 3]);
        let (verdict, _) = check(&guard(f64::INFINITY), [100.0, 100.0, 4.9], [50.0; 3]);
        assert!(matches!(verdict.fault, Some(Fault::TensionOutside { cable: 2, .. })));
    }

    #[test]
    fn a_change_beyond_the_rate_is_limited_and_counted() {
        let (verdict, out) = check(&guard(2.0), [60.0, 49.0, 10.0], [50.0; 3]);
        assert_eq!(verdict, TensionVerdict { fault: None, limited: 2 });
        assert_eq!(out, [52.0, 49.0, 48.0]);
    }

    #[test]
    fn tightening_from_zero_passes_below_the_box() {
        let mut out = [f64::NAN; 1];
        assert!(guard(f64::INFINITY).check(&[1.0], &[0.0], Floor::Zero, &mut out).fault.is_none());
        assert_eq!(out, [1.0]);
        assert!(guard(f64::INFINITY).check(&[-1.0], &[0.0], Floor::Zero, &mut out).fault.is_some());
    }
}
