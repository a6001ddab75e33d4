//! Whether the estimate has settled, and how its innovation develops. Data for the supervisor; no decision here.

use crate::config::ObserverConfig;

/// Settling and innovation tests of one observer.
#[derive(Debug, Clone)]
pub(super) struct Health {
    settle_innovation: f64,
    settle_rate: f64,
    settle_ticks: u64,
    bound: f64,
    growth: f64,
    /// Ticks in a row below both settle limits.
    quiet: u64,
    /// Innovations of the window, oldest overwritten first.
    window: Vec<f64>,
    next: usize,
}

/// Result of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Checked {
    pub(super) settled: bool,
    pub(super) growth: f64,
    pub(super) beyond_bound: bool,
    pub(super) growing: bool,
}

impl Health {
    /// Allocates.
    pub(super) fn new(config: &ObserverConfig, period_s: f64) -> Self {
        let window = (config.innovation_window_s / period_s).ceil().max(1.0) as usize;
        Self {
            settle_innovation: config.settle_innovation_rad,
            settle_rate: config.settle_rate_radps,
            settle_ticks: (config.settle_time_s / period_s).ceil() as u64,
            bound: config.innovation_bound_rad,
            growth: config.innovation_growth_rad,
            quiet: 0,
            window: vec![f64::INFINITY; window],
            next: 0,
        }
    }

    /// Forgets the past: nothing has grown, nothing has settled.
    pub(super) fn reset(&mut self) {
        self.quiet = 0;
        self.window.fill(f64::INFINITY);
        self.next = 0;
    }

    /// Ticks left out: the window is one of time, and of theirs nothing is known.
    pub(super) fn skip(&mut self, ticks: u32) {
        for _ in 0..self.window.len().min(ticks as usize) {
            self.window[self.next] = f64::INFINITY;
            self.next = (self.next + 1) % self.window.len();
        }
    }

    /// One tick's largest |z| (rad) and largest bend rate (rad/s). NaN settles nothing and is beyond every bound.
    pub(super) fn check(&mut self, innovation: f64, rate: f64) -> Checked {
        let quiet = innovation < self.settle_innovation && rate < self.settle_rate;
        self.quiet = if quiet { self.quiet + 1 } else { 0 };
        let least = self.window.iter().copied().fold(innovation, f64::min);
        self.window[self.next] = innovation;
        self.next = (self.next + 1) % self.window.len();
        let growth = innovation - least;
        Checked {
            settled: quiet && self.quiet >= self.settle_ticks,
            growth,
            // NaN is a finding.
            beyond_bound: innovation.is_nan() || innovation > self.bound,
            growing: growth.is_nan() || growth > self.growth,
        }
    }
}
