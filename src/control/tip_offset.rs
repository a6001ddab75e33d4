//! Where the arm's tip is led beside its target, so that what the reference does not know cancels.
//!
//! A reference that moves is an equilibrium, the arm on its way is none: it lags, sags by its inertia, and bends inside
//! its segments. The estimate shows it. What lasts of it is taken off the target, by a first-order low-pass
//! that is slow against everything that swings. A tip that stands keeps what it had, and one that sets off swings first.

use nalgebra::Vector3;

/// The offset of one arm's tip (m, base frame).
#[derive(Debug, Clone)]
pub struct TipOffset {
    time_s: f64,
    wait_s: f64,
    most_m: f64,
    beside: Vector3<f64>,
    offset: Vector3<f64>,
    /// Time for which it has moved (s).
    moves_s: f64,
}

impl TipOffset {
    /// With the time constant of the low-pass (s), the time (s) that a motion has to settle, and the farthest that a target is
    /// moved (m).
    pub fn new(time_s: f64, wait_s: f64, most_m: f64) -> Self {
        Self { time_s, wait_s, most_m, beside: Vector3::zeros(), offset: Vector3::zeros(), moves_s: 0.0 }
    }

    /// The estimated tip beside the reference's of as long ago as the reference is ahead of the arm (m).
    pub fn see(&mut self, beside: Vector3<f64>) {
        self.beside = beside;
    }

    /// One tick of `h` seconds in which the target moves, or stands.
    pub fn follow(&mut self, h: f64, moves: bool) {
        self.moves_s = if moves { self.moves_s + h } else { 0.0 };
        if self.moves_s <= self.wait_s {
            return;
        }
        self.offset += h / (self.time_s + h) * (self.beside - self.offset);
        let size = self.offset.norm();
        if size > self.most_m {
            self.offset *= self.most_m / size;
        }
    }

    /// Where to lead the tip for it to be at `target` (m).
    pub fn lead(&self, target: &Vector3<f64>) -> Vector3<f64> {
        target - self.offset
    }

    /// Forgets what was.
    pub fn restart(&mut self) {
        (self.offset, self.moves_s) = (Vector3::zeros(), 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 0.01;

    fn after(seconds: f64, beside: impl Fn(f64) -> f64) -> f64 {
        let mut offset = TipOffset::new(4.0, 2.0, 0.01);
        for k in 0..(seconds / H) as usize {
            offset.see(Vector3::new(beside(k as f64 * H), 0.0, 0.0));
            offset.follow(H, true);
        }
        -offset.lead(&Vector3::zeros()).x
    }

    #[test]
    fn what_lasts_is_taken_off_the_target_and_what_swings_is_not() {
        assert!((after(30.0, |_| 0.003) - 0.003).abs() < 1e-5);
        let swing = |t: f64| 0.01 * (std::f64::consts::TAU * 0.26 * t).sin();
        assert!(after(30.0, swing).abs() < 0.0017);
    }

    #[test]
    fn a_tip_that_stands_keeps_its_offset_and_one_that_sets_off_waits() {
        assert_eq!(after(1.9, |_| 0.003), 0.0);
        let mut offset = TipOffset::new(4.0, 2.0, 0.01);
        offset.see(Vector3::new(0.003, 0.0, 0.0));
        let mut run = |seconds: f64, moves: bool| {
            (0..(seconds / H) as usize).for_each(|_| offset.follow(H, moves));
            offset.lead(&Vector3::zeros()).x
        };
        let learnt = run(6.0, true);
        assert!(learnt < -0.0015);
        assert_eq!((run(9.0, false), run(1.9, true)), (learnt, learnt));
    }

    #[test]
    fn an_arm_that_is_kept_from_its_reference_is_not_pulled_farther_than_that() {
        assert!((after(60.0, |_| 0.2) - 0.01).abs() < 1e-9);
    }
}
