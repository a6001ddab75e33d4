//! Where the arm's tip is led beside its target, so that what the reference does not know cancels.
//!
//! A reference that moves is an equilibrium, the arm on its way is none: it lags, sags by its inertia, and bends inside
//! its segments. The estimate shows it. What lasts of it is taken off the target, by a first-order low-pass that is slow
//! against everything that swings: across the motion from the first tick on, along it once the motion has lasted, for an arm
//! that sets off swings along its way. Where the configuration says itself how far the arm is led (`lead_s`), what is left
//! along the motion is what was asked for, and stays. A tip that stands keeps what it had.

use nalgebra::Vector3;

/// The offset of one arm's tip (m, base frame).
#[derive(Debug, Clone)]
pub struct TipOffset {
    time_s: f64,
    along_after_s: Option<f64>,
    most_m: f64,
    beside: Vector3<f64>,
    offset: Vector3<f64>,
    /// Time for which the target has moved (s).
    moves_s: f64,
}

impl TipOffset {
    /// With the time constant of the low-pass (s), the time (s) that a motion must have lasted for what lags along it to be
    /// taken off (`None`: never), and the farthest that a target is moved (m).
    pub fn new(time_s: f64, along_after_s: Option<f64>, most_m: f64) -> Self {
        Self { time_s, along_after_s, most_m, beside: Vector3::zeros(), offset: Vector3::zeros(), moves_s: 0.0 }
    }

    /// The estimated tip beside the reference's of as long ago as the reference is ahead of the arm (m).
    pub fn see(&mut self, beside: Vector3<f64>) {
        self.beside = beside;
    }

    /// One tick of `h` seconds in which the target goes this way (m).
    pub fn follow(&mut self, h: f64, way: &Vector3<f64>) {
        let Some(along) = way.try_normalize(0.0) else {
            self.moves_s = 0.0;
            return;
        };
        self.moves_s += h;
        let mut lasting = self.beside;
        if self.along_after_s.is_none_or(|after_s| self.moves_s <= after_s) {
            lasting -= along * along.dot(&self.beside);
        }
        self.offset += h / (self.time_s + h) * (lasting - self.offset);
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

    /// What it takes off after a time, of a tip that moves along z beside which the arm is (m).
    fn after(seconds: f64, along_after_s: Option<f64>, beside: impl Fn(f64) -> Vector3<f64>) -> Vector3<f64> {
        let mut offset = TipOffset::new(4.0, along_after_s, 0.01);
        for k in 0..(seconds / H) as usize {
            offset.see(beside(k as f64 * H));
            offset.follow(H, &Vector3::new(0.0, 0.0, 1e-4));
        }
        -offset.lead(&Vector3::zeros())
    }

    #[test]
    fn what_lasts_is_taken_off_the_target_and_what_swings_is_not() {
        let lasting = Vector3::new(0.003, 0.0, -0.005);
        let learnt = after(30.0, Some(2.0), |_| lasting);
        assert!((learnt - lasting).norm() < 1e-5, "{learnt}");
        let swing = |t: f64| Vector3::new(0.01 * (std::f64::consts::TAU * 0.26 * t).sin(), 0.0, 0.0);
        assert!(after(30.0, Some(2.0), swing).norm() < 0.0017);
    }

    #[test]
    fn what_lags_along_the_motion_is_left_to_a_lead_that_was_asked_for() {
        let learnt = after(30.0, None, |_| Vector3::new(0.003, 0.0, -0.005));
        assert!((learnt - Vector3::new(0.003, 0.0, 0.0)).norm() < 1e-5, "{learnt}");
        // As it is at first for every motion.
        assert!(after(1.9, Some(2.0), |_| Vector3::new(0.003, 0.0, -0.005)).z == 0.0);
        assert!(after(2.5, Some(2.0), |_| Vector3::new(0.003, 0.0, -0.005)).z < 0.0);
    }

    #[test]
    fn a_tip_that_stands_keeps_its_offset() {
        let mut offset = TipOffset::new(4.0, Some(2.0), 0.01);
        offset.see(Vector3::new(0.003, 0.0, 0.0));
        (0..600).for_each(|_| offset.follow(H, &Vector3::new(0.0, 0.0, 1e-4)));
        let learnt = offset.lead(&Vector3::zeros());
        assert!(learnt.x < -0.0015);
        (0..600).for_each(|_| offset.follow(H, &Vector3::zeros()));
        assert_eq!(offset.lead(&Vector3::zeros()), learnt);
    }

    #[test]
    fn an_arm_that_is_kept_from_its_reference_is_not_pulled_farther_than_that() {
        assert!((after(60.0, Some(2.0), |_| Vector3::new(0.2, 0.0, 0.0)).norm() - 0.01).abs() < 1e-9);
    }
}
