//! The path on which what a step of the target left fades: a quintic for each mean curvature (Flash and Hogan 1985), and the
//! time in which it keeps to the limits.

use crate::config::GovernorConfig;
use crate::model::Arm;
use nalgebra::Vector3;

/// Samples along a path for its length.
const SAMPLES: usize = 16;
/// Peak rate, acceleration and where a quintic from rest to rest has them: 15/8 and 10/sqrt(3).
const PEAK_RATE: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.774;
/// Time over which the speed of a motion is looked at (s).
const SPEED_S: f64 = 1e-3;

/// A path `e(t)` from an offset to zero. [`Path::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Path {
    /// Coefficients over time/duration, six per curvature.
    offset: Vec<[f64; 6]>,
    duration_s: f64,
    time_s: f64,
}

impl Path {
    /// One that is over, of so many curvatures. Allocates.
    pub fn new(count: usize) -> Self {
        Self { offset: vec![[0.0; 6]; count], duration_s: 0.0, time_s: 0.0 }
    }

    /// One that is over.
    pub fn end(&mut self) {
        self.offset.fill([0.0; 6]);
        (self.duration_s, self.time_s) = (0.0, 0.0);
    }

    /// Begins with `(offset, rate, acceleration)` of each curvature, by the clock, and fades within `duration_s` of its own time,
    /// which goes by at `pace` (of the clock's).
    pub fn begin(&mut self, duration_s: f64, pace: f64, from: impl Iterator<Item = (f64, f64, f64)>) {
        let clock_s = duration_s / pace;
        for (c, (offset, rate, acceleration)) in self.offset.iter_mut().zip(from) {
            let (c0, c1, c2) = (offset, rate * clock_s, 0.5 * acceleration * clock_s * clock_s);
            *c = [
                c0,
                c1,
                c2,
                -10.0 * c0 - 6.0 * c1 - 3.0 * c2,
                15.0 * c0 + 8.0 * c1 + 3.0 * c2,
                -6.0 * c0 - 3.0 * c1 - c2,
            ];
        }
        (self.duration_s, self.time_s) = (duration_s, 0.0);
    }

    /// Whether it is not over.
    pub fn is_under_way(&self) -> bool {
        self.time_s < self.duration_s
    }

    /// What is left of it (s of its own time).
    pub fn remaining_s(&self) -> f64 {
        self.duration_s - self.time_s
    }

    /// Its own time goes on (s).
    pub fn advance(&mut self, by_s: f64) {
        self.time_s = (self.time_s + by_s).min(self.duration_s);
    }

    /// Goes to its end.
    pub fn give_up(&mut self) {
        self.time_s = self.duration_s;
    }

    /// Offset and acceleration (by its own time) of a curvature.
    pub fn at(&self, curvature: usize) -> (f64, f64) {
        let x = if self.duration_s > 0.0 { self.time_s / self.duration_s } else { 1.0 };
        if x >= 1.0 {
            return (0.0, 0.0);
        }
        let t = self.duration_s.max(1e-9);
        let c = &self.offset[curvature];
        (
            c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5])))),
            (2.0 * c[2] + x * (6.0 * c[3] + x * (12.0 * c[4] + x * 20.0 * c[5]))) / (t * t),
        )
    }
}

/// How far a way in curvatures moves an arm, as a chain of constant curvatures. [`Way::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Way {
    arm: Arm,
    /// Length of the segment of each curvature (m).
    length: Vec<f64>,
    q: Vec<f64>,
    chain: Vec<f64>,
    joints: Vec<Vector3<f64>>,
    before: Vec<Vector3<f64>>,
}

impl Way {
    /// Of an arm with the length of the segment of each curvature (m). Allocates.
    pub fn new(arm: &Arm, length: &[f64]) -> Self {
        let joints = vec![Vector3::zeros(); arm.segment_count()];
        Self {
            q: arm.straight(),
            chain: vec![0.0; length.len()],
            length: length.to_vec(),
            before: joints.clone(),
            joints,
            arm: arm.clone(),
        }
    }

    /// Largest bend angle between two postures (rad).
    pub fn bend_between(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).zip(&self.length).map(|((a, b), l)| (a - b).abs() * l).fold(0.0, f64::max)
    }

    /// Speed of the tip (m/s) at mean curvatures (1/m) that change at `rate` (1/m/s).
    pub fn speed(&mut self, kappa: &[f64], rate: &[f64]) -> f64 {
        self.place(kappa, rate, 0.0);
        let before = self.joints[self.joints.len() - 1];
        self.place(kappa, rate, SPEED_S);
        (self.joints[self.joints.len() - 1] - before).norm() / SPEED_S
    }

    /// Time (s) in which the way between two postures (1/m) keeps to the limits, begun at `speed` (m/s).
    pub fn duration_s(&mut self, from: &[f64], to: &[f64], speed: f64, s: &GovernorConfig) -> f64 {
        let mut fastest = 0.0f64;
        self.place_between(from, to, 0.0);
        self.before.copy_from_slice(&self.joints);
        for k in 1..=SAMPLES {
            self.place_between(from, to, k as f64 / SAMPLES as f64);
            for (joint, before) in self.joints.iter().zip(&mut self.before) {
                fastest = fastest.max((joint - *before).norm() * SAMPLES as f64);
                *before = *joint;
            }
        }
        (PEAK_RATE * fastest / s.speed_mps)
            .max((PEAK_ACCELERATION * fastest / s.acceleration_mps2).sqrt())
            .max(PEAK_RATE * self.bend_between(from, to) / s.bend_rate_radps)
            .max(4.0 * speed / s.acceleration_mps2)
            .max(0.1)
    }

    fn place(&mut self, kappa: &[f64], rate: &[f64], after_s: f64) {
        self.chain.iter_mut().zip(kappa.iter().zip(rate)).for_each(|(c, (k, rate))| *c = k + after_s * rate);
        self.place_joints();
    }

    fn place_between(&mut self, from: &[f64], to: &[f64], share: f64) {
        self.chain.iter_mut().zip(from.iter().zip(to)).for_each(|(c, (from, to))| *c = from + share * (to - from));
        self.place_joints();
    }

    fn place_joints(&mut self) {
        self.arm.bent_into(&self.chain, &mut self.q);
        for (joint, range) in self.joints.iter_mut().zip(&self.arm.segment_elements) {
            *joint = self.arm.pose(&self.q, range.end).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_begins_as_it_is_told_and_ends_at_rest() {
        let mut path = Path::new(1);
        assert!(!path.is_under_way());
        for pace in [1.0, 0.25] {
            let (offset, rate, acceleration) = (0.4, -0.3, 0.2);
            path.begin(2.0, pace, std::iter::once((offset, rate, acceleration)));
            assert!(path.is_under_way() && path.at(0).0 == offset);
            // By the clock, to second order.
            let h = 1e-4;
            path.advance(pace * h);
            let change = (path.at(0).0 - offset) / h - 0.5 * acceleration * h;
            assert!((change - rate).abs() < 1e-6, "{change} at pace {pace}");
            path.advance(path.remaining_s() - 1e-6);
            let (e, e2) = path.at(0);
            assert!(e.abs() < 1e-12 && e2.abs() < 1e-4, "{e} {e2}");
            path.advance(1.0);
            assert_eq!((path.at(0), path.is_under_way()), ((0.0, 0.0), false));
        }
    }
}
