//! The innovation: beyond its bound, or growing, it is a fault and not a shrug (design, section 6).

use crate::config::ObserverConfig;
use crate::control::fault::Fault;

/// Watches the largest |z| over a window.
#[derive(Debug, Clone)]
pub struct InnovationGuard {
    bound_rad: f64,
    growth_rad: f64,
    /// Values of the last window, in a ring.
    window: Vec<f64>,
    next: usize,
    count: usize,
}

impl InnovationGuard {
    /// With the observer's limits and the loop's period (s). Allocates.
    pub fn new(config: &ObserverConfig, period_s: f64) -> Self {
        let ticks = ((config.innovation_window_s / period_s).ceil() as usize).max(1);
        Self {
            bound_rad: config.innovation_bound_rad,
            growth_rad: config.innovation_growth_rad,
            window: vec![0.0; ticks],
            next: 0,
            count: 0,
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        (self.next, self.count) = (0, 0);
    }

    /// Judges the innovation of a tick. Does not allocate.
    ///
    /// A fault where it is not a number, beyond the bound, or more than the growth above the least value of the window.
    pub fn check(&mut self, innovation_rad: f64) -> Option<Fault> {
        if !innovation_rad.is_finite() {
            return Some(Fault::EstimateLost);
        }
        let least = self.window[..self.count].iter().copied().fold(innovation_rad, f64::min);
        self.window[self.next] = innovation_rad;
        self.next = (self.next + 1) % self.window.len();
        self.count = (self.count + 1).min(self.window.len());
        if innovation_rad > self.bound_rad {
            Some(Fault::InnovationBound { innovation_rad })
        } else if innovation_rad - least > self.growth_rad {
            Some(Fault::InnovationGrowth { growth_rad: innovation_rad - least })
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard() -> InnovationGuard {
        InnovationGuard { bound_rad: 0.3, growth_rad: 0.15, window: vec![0.0; 10], next: 0, count: 0 }
    }

    #[test]
    fn an_innovation_beyond_its_bound_is_a_fault() {
        let mut g = guard();
        assert_eq!(g.check(0.3), None);
        assert_eq!(g.check(0.31), Some(Fault::InnovationBound { innovation_rad: 0.31 }));
        assert_eq!(g.check(f64::NAN), Some(Fault::EstimateLost));
    }

    #[test]
    fn growth_within_the_window_is_a_fault_and_the_same_growth_over_a_longer_time_is_not() {
        let mut quick = guard();
        let first = (0..10).find_map(|k| quick.check(0.02 * f64::from(k)));
        assert!(matches!(first, Some(Fault::InnovationGrowth { .. })), "{first:?}");
        let mut slow = guard();
        assert_eq!((0..25).find_map(|k| slow.check(0.01 * f64::from(k))), None);
    }

    #[test]
    fn a_reset_forgets_the_past() {
        let mut g = guard();
        assert_eq!(g.check(0.0), None);
        g.reset();
        assert_eq!(g.check(0.2), None);
    }
}
