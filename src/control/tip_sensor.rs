//! What a measured tip says about the estimate.
//!
//! Cables tell mean bends; where the tip is follows by the model, and is off by what the model does not know (a scale of the
//! bends, friction along a segment, a load's sag) and by what swings beside the cables. A sensor at the tip sees both. The
//! difference of measured and estimated tip, each at the time of the measurement, is no error of following: it does not answer
//! to what the loop does at once, so taking its slow part off the target closes no loop that could swing. The fast part is the
//! swing that the estimate lacks.

use crate::config::TipSensorConfig;
use nalgebra::Vector3;

/// Beyond how many time constants without a measurement what was learnt has faded by `1/e`.
const FADES: f64 = 10.0;

/// A measured position of the tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipReading {
    /// Position (m, base frame).
    pub position_m: Vector3<f64>,
    /// When it was measured (ns, the loop's clock).
    pub capture_ns: u64,
}

/// The tip sensor of one arm. [`TipSensor::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct TipSensor {
    settings: TipSensorConfig,
    /// Estimated tips of the last ticks (ns, m), the oldest overwritten first.
    estimates: Vec<(u64, Vector3<f64>)>,
    next: usize,
    known: usize,
    /// Capture time of the newest measurement that was used (ns).
    used_ns: Option<u64>,
    /// Newest difference of measured and estimated tip (m), while it is fresh.
    difference: Option<Vector3<f64>>,
    bias: Vector3<f64>,
    doubted_m: Option<f64>,
}

impl TipSensor {
    /// With the time between two ticks (s). Allocates.
    pub fn new(settings: &TipSensorConfig, period_s: f64) -> Self {
        // Estimates are as old as their encoder readings: a tick or two.
        let ticks = (settings.stale_after_s / period_s).ceil() as usize + 3;
        Self {
            settings: *settings,
            estimates: vec![(0, Vector3::zeros()); ticks],
            next: 0,
            known: 0,
            used_ns: None,
            difference: None,
            bias: Vector3::zeros(),
            doubted_m: None,
        }
    }

    /// One tick of `h` seconds: the estimated tip (m) at `estimate_ns`, the newest measurement, and the present time (ns).
    pub fn follow(&mut self, h: f64, tip: &Vector3<f64>, estimate_ns: u64, reading: Option<&TipReading>, now_ns: u64) {
        self.estimates[self.next] = (estimate_ns, *tip);
        self.next = (self.next + 1) % self.estimates.len();
        self.known = (self.known + 1).min(self.estimates.len());
        let fresh = |capture_ns: u64| now_ns.saturating_sub(capture_ns) as f64 <= 1e9 * self.settings.stale_after_s;
        let reading = reading.filter(|reading| fresh(reading.capture_ns));
        let Some(reading) = reading else {
            (self.difference, self.doubted_m) = (None, None);
            self.bias *= 1.0 - h / (FADES * self.settings.time_s + h);
            return;
        };
        if self.used_ns == Some(reading.capture_ns) {
            return;
        }
        let Some(estimated) = self.at(reading.capture_ns) else { return };
        let difference = reading.position_m - estimated;
        let size = difference.norm();
        if size.is_nan() || size > self.settings.error_m {
            (self.difference, self.doubted_m) = (None, Some(size));
            return;
        }
        // As long as it has been since the last one, but for one that was lost for a while.
        let since_s = self.used_ns.map_or(h, |used_ns| 1e-9 * reading.capture_ns.saturating_sub(used_ns) as f64);
        let since_s = since_s.min(self.settings.stale_after_s);
        self.bias += since_s / (self.settings.time_s + since_s) * (difference - self.bias);
        (self.used_ns, self.difference, self.doubted_m) = (Some(reading.capture_ns), Some(difference), None);
    }

    /// The estimated tip at a time (m); `None` where it is not remembered.
    fn at(&self, time_ns: u64) -> Option<Vector3<f64>> {
        let count = self.estimates.len();
        let of = |back: usize| self.estimates[(self.next + count - 1 - back) % count];
        let (newest_ns, newest) = of(0);
        // A measurement may be newer than the encoders' by some ticks: the newest estimate is the best there is.
        if time_ns >= newest_ns {
            return Some(newest);
        }
        (1..self.known).find_map(|back| {
            let ((early_ns, early), (late_ns, late)) = (of(back), of(back - 1));
            (early_ns <= time_ns).then(|| {
                let share = (time_ns - early_ns) as f64 / late_ns.saturating_sub(early_ns).max(1) as f64;
                early + share * (late - early)
            })
        })
    }

    /// What lasts of measured less estimated tip (m, base frame).
    pub const fn bias_m(&self) -> Vector3<f64> {
        self.bias
    }

    /// Measured less estimated tip of the newest measurement (m); `None` where none is fresh or believed.
    pub const fn difference_m(&self) -> Option<Vector3<f64>> {
        self.difference
    }

    /// How far a fresh measurement is from the estimate (m) that is not believed.
    pub const fn doubted_m(&self) -> Option<f64> {
        self.doubted_m
    }

    /// Forgets what was: where the estimate begins anew.
    pub fn restart(&mut self) {
        (self.known, self.used_ns, self.difference, self.doubted_m) = (0, None, None, None);
        self.bias = Vector3::zeros();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 0.01;
    const TICK_NS: u64 = 10_000_000;
    const SETTINGS: TipSensorConfig = TipSensorConfig { time_s: 1.0, error_m: 0.05, stale_after_s: 0.2 };

    fn way(t_ns: u64) -> Vector3<f64> {
        Vector3::new(1e-9 * t_ns as f64, 0.0, 0.0)
    }

    #[test]
    fn what_lasts_is_learnt_of_an_arm_on_its_way_from_measurements_that_come_late_and_seldom() {
        let off = Vector3::new(0.0, 0.01, -0.002);
        let mut sensor = TipSensor::new(&SETTINGS, H);
        for tick in 10..1010_u64 {
            let now_ns = tick * TICK_NS;
            // 20 a second, 73 ms old; the estimate is a tick old.
            let capture_ns = (now_ns - 73_000_000) / 50_000_000 * 50_000_000;
            let reading = TipReading { position_m: way(capture_ns) + off, capture_ns };
            sensor.follow(
                H,
                &way(now_ns - TICK_NS),
                now_ns - TICK_NS,
                (capture_ns > 100_000_000).then_some(&reading),
                now_ns,
            );
        }
        assert!((sensor.difference_m().unwrap() - off).norm() < 1e-9, "{:?}", sensor.difference_m());
        assert!((sensor.bias_m() - off).norm() < 1e-5, "{}", sensor.bias_m());
    }

    #[test]
    fn a_measurement_that_cannot_be_is_doubted_and_one_that_stays_away_fades() {
        let mut sensor = TipSensor::new(&SETTINGS, H);
        let at = |sensor: &mut TipSensor, tick: u64, y: Option<f64>| {
            let now_ns = tick * TICK_NS;
            let reading = y.map(|y| TipReading { position_m: Vector3::new(0.0, y, 0.0), capture_ns: now_ns });
            sensor.follow(H, &Vector3::zeros(), now_ns, reading.as_ref(), now_ns);
        };
        (1..1000).for_each(|tick| at(&mut sensor, tick, Some(0.02)));
        let learnt = sensor.bias_m().y;
        assert!((learnt - 0.02).abs() < 1e-4);
        at(&mut sensor, 1000, Some(0.3));
        assert!((sensor.doubted_m().unwrap() - 0.3).abs() < 1e-12 && sensor.difference_m().is_none());
        at(&mut sensor, 1001, Some(f64::NAN));
        assert!(sensor.doubted_m().unwrap().is_nan());
        assert_eq!(sensor.bias_m().y, learnt);
        at(&mut sensor, 1002, None);
        assert_eq!((sensor.doubted_m(), sensor.difference_m()), (None, None));
        (1003..2002).for_each(|tick| at(&mut sensor, tick, None));
        assert!((sensor.bias_m().y / learnt / (-1.0_f64).exp() - 1.0).abs() < 0.01, "{}", sensor.bias_m());
        sensor.restart();
        assert_eq!(sensor.bias_m(), Vector3::zeros());
    }

    #[test]
    fn the_same_measurement_counts_once_and_an_old_one_not_at_all() {
        let mut sensor = TipSensor::new(&SETTINGS, H);
        let reading = TipReading { position_m: Vector3::new(0.0, 0.02, 0.0), capture_ns: 100 * TICK_NS };
        (100..121).for_each(|tick| sensor.follow(H, &Vector3::zeros(), tick * TICK_NS, Some(&reading), tick * TICK_NS));
        let once = H / (1.0 + H) * 0.02;
        assert!((sensor.bias_m().y - once).abs() < 1e-12 && sensor.difference_m().is_some());
        sensor.follow(H, &Vector3::zeros(), 121 * TICK_NS, Some(&reading), 121 * TICK_NS);
        assert!(sensor.difference_m().is_none(), "210 ms old");
    }
}
