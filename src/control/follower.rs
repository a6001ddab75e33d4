//! How the tip of a reference goes after a target that moves: with bounded speed and acceleration.
//!
//! Where the target is faster than the limit, or sets off at once, it is left alone and caught up with. What is lacking
//! is made up for as fast as can be braked from (`sqrt(2 a d)`), and within some ticks where it is little; a target
//! that keeps to the limits is followed without a lag.

use crate::math::quaternion::{conjugate, from_rotation_vector, product};
use nalgebra::{Vector3, Vector4};

/// Ticks within which a small gap is made up for.
const SOFT_TICKS: f64 = 2.0;
/// Share of the acceleration that braking counts on: the rest is for what a tick comes late.
const BRAKE: f64 = 0.5;

/// Limits of a motion: `[rate, acceleration]`.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Of the position (m/s, m/s^2).
    pub position: [f64; 2],
    /// Of the attitude (rad/s, rad/s^2).
    pub attitude: [f64; 2],
}

/// A pose that follows. All vectors of positions are in the base frame, those of turning in the tip's.
#[derive(Debug, Clone)]
pub struct Follower {
    pose: (Vector3<f64>, Vector4<f64>),
    before: (Vector3<f64>, Vector4<f64>),
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
}

impl Default for Follower {
    fn default() -> Self {
        let pose = (Vector3::zeros(), Vector4::new(1.0, 0.0, 0.0, 0.0));
        Self { pose, before: pose, velocity: Vector3::zeros(), spin: Vector3::zeros() }
    }
}

impl Follower {
    /// Where it is (m, unit quaternion).
    pub const fn pose(&self) -> &(Vector3<f64>, Vector4<f64>) {
        &self.pose
    }

    /// Where it was a tick ago.
    pub const fn before(&self) -> &(Vector3<f64>, Vector4<f64>) {
        &self.before
    }

    /// Is somewhere at once, at rest.
    pub fn place(&mut self, pose: (Vector3<f64>, Vector4<f64>)) {
        *self = Self { pose, before: pose, ..Self::default() };
    }

    /// What it lacks of a target (m, rad) beyond the way that it needs to take on the target's velocity.
    pub fn lacks(&self, target: &(Vector3<f64>, Vector4<f64>), moved: &Moved, h: f64, limits: &Limits) -> (f64, f64) {
        let beyond = |gap: Vector3<f64>, change: Vector3<f64>, [_, most]: [f64; 2]| {
            gap.norm() - change.norm_squared() / (BRAKE * most)
        };
        (
            beyond(target.0 - self.pose.0, moved.way / h - self.velocity, limits.position),
            beyond(rotation_between(&self.pose.1, &target.1), moved.turn / h - self.spin, limits.attitude),
        )
    }

    /// One tick of `h` seconds after a target that has just moved by so much.
    pub fn follow(&mut self, h: f64, target: &(Vector3<f64>, Vector4<f64>), moved: &Moved, limits: &Limits) {
        self.before = self.pose;
        // From where it was: the target's own way of this tick is in its velocity.
        let gap = target.0 - moved.way - self.pose.0;
        let turn = rotation_between(&self.pose.1, &target.1) - moved.turn;
        after(h, &mut self.velocity, gap, moved.way / h, limits.position);
        after(h, &mut self.spin, turn, moved.turn / h, limits.attitude);
        self.pose.0 += h * self.velocity;
        self.pose.1 = product(&self.pose.1, &from_rotation_vector(&(h * self.spin))).normalize();
    }
}

/// What a target has moved by in a tick.
#[derive(Debug, Clone, Copy)]
pub struct Moved {
    /// Way (m, base frame).
    pub way: Vector3<f64>,
    /// Rotation vector (rad).
    pub turn: Vector3<f64>,
}

impl Moved {
    /// Between two poses.
    pub fn between(from: &(Vector3<f64>, Vector4<f64>), to: &(Vector3<f64>, Vector4<f64>)) -> Self {
        Self { way: to.0 - from.0, turn: rotation_between(&from.1, &to.1) }
    }
}

/// Changes a rate towards that of a target, and what makes up for the gap to it.
fn after(h: f64, rate: &mut Vector3<f64>, gap: Vector3<f64>, target: Vector3<f64>, [most, acceleration]: [f64; 2]) {
    let size = gap.norm();
    let mut wanted = target;
    if size > 0.0 {
        wanted += gap * ((2.0 * BRAKE * acceleration * size).sqrt().min(size / (SOFT_TICKS * h)) / size);
    }
    let within = |v: Vector3<f64>, most: f64| if v.norm() > most { v * (most / v.norm()) } else { v };
    *rate += within(within(wanted, most) - *rate, acceleration * h);
}

/// Rotation vector (rad, frame of `a`) that takes attitude `a` to `b` the short way.
fn rotation_between(a: &Vector4<f64>, b: &Vector4<f64>) -> Vector3<f64> {
    let d = product(&conjugate(a), b);
    let sign = if d[0] < 0.0 { -1.0 } else { 1.0 };
    let v = Vector3::new(d[1], d[2], d[3]) * sign;
    let sine = v.norm();
    v * if sine > 1e-9 { 2.0 * sine.atan2(d[0].abs()) / sine } else { 2.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 0.01;
    const LIMITS: Limits = Limits { position: [0.1, 0.2], attitude: [0.3, 0.6] };

    /// Follows a path along x for a time; largest speed, largest acceleration, what it lacks at the end.
    fn run(seconds: f64, path: impl Fn(f64) -> f64) -> (f64, f64, f64) {
        let at = |t: f64| (Vector3::new(path(t), 0.0, 0.0), from_rotation_vector(&Vector3::new(0.0, path(t), 0.0)));
        let mut follower = Follower::default();
        follower.place(at(0.0));
        let (mut fastest, mut hardest) = (0.0f64, 0.0f64);
        let count = (seconds / H) as usize;
        for k in 1..=count {
            let (t, velocity) = (k as f64 * H, follower.velocity);
            follower.follow(H, &at(t), &Moved::between(&at(t - H), &at(t)), &LIMITS);
            fastest = fastest.max(follower.velocity.norm());
            hardest = hardest.max((follower.velocity - velocity).norm() / H);
        }
        let end = at(count as f64 * H);
        (fastest, hardest, (end.0 - follower.pose.0).norm() + rotation_between(&follower.pose.1, &end.1).norm())
    }

    #[test]
    fn a_target_that_sets_off_at_once_is_caught_up_with_at_the_limits() {
        for speed in [0.01, 0.05, 0.09] {
            let (fastest, hardest, lacks) = run(3.0, |t| speed * t);
            assert!(fastest <= 0.1 + 1e-12 && hardest <= 0.2 + 1e-9, "{fastest} {hardest}");
            assert!(lacks < 1e-4 * speed, "{lacks}");
        }
    }

    #[test]
    fn a_target_that_runs_or_stops_at_once_is_not_overtaken() {
        let (fastest, hardest, _) = run(5.0, |t| t);
        assert!(fastest <= 0.1 + 1e-12 && hardest <= 0.2 + 1e-9, "{fastest} {hardest}");
        let (_, hardest, lacks) = run(8.0, |t| 0.09 * t.min(2.0));
        assert!(hardest <= 0.2 + 1e-9 && lacks < 1e-4, "{hardest} {lacks}");
    }

    #[test]
    fn a_path_within_the_limits_is_followed_without_a_lag() {
        let (_, _, lacks) = run(6.0, |t| 0.05 * (1.0 - (0.8 * t).cos()));
        assert!(lacks < 4e-5, "{lacks}");
    }
}
