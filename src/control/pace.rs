//! How fast the reference goes on, over the configured speed: what supervision asks for, and what an operator does.
//!
//! Each is taken on in its own way, and the smaller of both counts. Supervision answers to something: its pace is taken on
//! within some tenths of a second. An operator's scale has time: a change of it is a change of speed, which keeps to the
//! acceleration of a path.

use crate::config::GovernorConfig;

/// Time constant with which another pace is taken on (s).
const PACE_S: f64 = 0.3;
/// Steepest slope of a critically damped step, times its time constant: 1/e.
const STEEPEST: f64 = 0.368;

/// Pace and scale of a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Pace {
    pace: f64,
    pace_wanted: f64,
    scale: f64,
    scale_rate_1ps: f64,
    scale_wanted: f64,
    /// Time constant with which another scale is taken on (s).
    scale_s: f64,
}

impl Pace {
    /// At full speed.
    pub fn new(settings: &GovernorConfig) -> Self {
        let scale_s = (STEEPEST * settings.speed_mps / settings.acceleration_mps2).max(PACE_S);
        Self { pace: 1.0, pace_wanted: 1.0, scale: 1.0, scale_rate_1ps: 0.0, scale_wanted: 1.0, scale_s }
    }

    /// What supervision asks for.
    pub fn set_pace(&mut self, pace: f64) {
        self.pace_wanted = pace;
    }

    /// What an operator asks for.
    pub fn set_scale(&mut self, scale: f64) {
        self.scale_wanted = scale;
    }

    /// An arm at rest has no speed to change: the operator's scale counts from here on.
    pub fn restart(&mut self) {
        (self.scale, self.scale_rate_1ps) = (self.scale_wanted, 0.0);
    }

    /// One tick of `h` seconds.
    pub fn advance(&mut self, h: f64) {
        self.pace += h / (PACE_S + h) * (self.pace_wanted - self.pace);
        // Implicit, so that a scale passes its goal at no period.
        let s = h / self.scale_s;
        let pull = s / self.scale_s * (self.scale_wanted - self.scale);
        self.scale_rate_1ps = (self.scale_rate_1ps + pull) / (1.0 + 2.0 * s + s * s);
        self.scale += h * self.scale_rate_1ps;
    }

    /// Speed over the configured one.
    pub fn now(&self) -> f64 {
        self.pace.min(self.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn run(pace: &mut Pace, h: f64, seconds: f64) -> (f64, f64) {
        let (mut steepest, mut least, mut before) = (0.0f64, f64::INFINITY, pace.now());
        for _ in 0..(seconds / h) as usize {
            pace.advance(h);
            steepest = steepest.max((pace.now() - before).abs() / h);
            before = pace.now();
            least = least.min(before);
        }
        (steepest, least)
    }

    #[test]
    fn a_scale_is_taken_on_at_no_more_than_the_acceleration_of_a_path() {
        let settings = Config::builtin().governor;
        for h in [0.001, 0.01, 0.1, 1.0] {
            let mut pace = Pace::new(&settings);
            pace.set_scale(0.01);
            let (steepest, least) = run(&mut pace, h, 30.0);
            assert!(steepest * settings.speed_mps <= settings.acceleration_mps2, "{steepest} 1/s at {h} s");
            assert!(least >= 0.01 - 1e-12 && (pace.now() - 0.01).abs() < 1e-6, "{least}, {}", pace.now());
        }
    }

    #[test]
    fn the_smaller_of_both_counts() {
        let mut pace = Pace::new(&Config::builtin().governor);
        pace.set_scale(0.5);
        pace.set_pace(0.25);
        run(&mut pace, 0.01, 20.0);
        assert!((pace.now() - 0.25).abs() < 1e-6);
        pace.set_pace(1.0);
        run(&mut pace, 0.01, 20.0);
        assert!((pace.now() - 0.5).abs() < 1e-6);
        pace.set_pace(0.75);
        run(&mut pace, 0.01, 20.0);
        assert!((pace.now() - 0.5).abs() < 1e-6);
    }
}
