//! Targets, weights and obstacles of a scenario as functions of time.
//!
//! Enters: a scenario's types and a time (s). Leaves: positions (m), quaternions, velocities (m/s), weights. Nothing
//! here allocates or keeps state, so a run can ask for any time in any order.

use super::scenario::{Motion, Task, TipPath, Waypoint};
use std::f64::consts::PI;

/// A point's position (m) or velocity (m/s), base frame.
type Vector = [f64; 3];

impl TipPath {
    /// Desired position (m) and unit quaternion `[w x y z]` of the tip at time `t` (s), (38)-(40).
    ///
    /// Before its beginning a path stands at its first pose, after its end at its last.
    pub fn pose_at(&self, t: f64) -> (Vector, [f64; 4]) {
        match self {
            Self::Lemniscate { scale_m, height_m, duration_s, quaternion } => {
                let (theta, _) = lemniscate_angle(t, *duration_s);
                let rho = scale_m * (2.0 * theta).cos();
                ([rho * theta.cos(), rho * theta.sin(), *height_m], *quaternion)
            }
            Self::Waypoints(points) => match locate(points, t, |point| point.time_s) {
                Location::None => ([0.0; 3], [1.0, 0.0, 0.0, 0.0]),
                Location::At(index) => (points[index].position_m, points[index].quaternion),
                Location::Between(index, share) => {
                    let (from, to) = (&points[index], &points[index + 1]);
                    (mix(from.position_m, to.position_m, share), slerp(from.quaternion, to.quaternion, share))
                }
            },
        }
    }

    /// Velocity of the desired position (m/s); at a kink that of the piece that ends there, zero outside the path.
    pub fn velocity_at(&self, t: f64) -> Vector {
        match self {
            Self::Lemniscate { scale_m, duration_s, .. } => {
                let (theta, rate) = lemniscate_angle(t, *duration_s);
                let rho = scale_m * (2.0 * theta).cos();
                let rho_rate = -2.0 * scale_m * (2.0 * theta).sin();
                let (sin, cos) = theta.sin_cos();
                [(rho_rate * cos - rho * sin) * rate, (rho_rate * sin + rho * cos) * rate, 0.0]
            }
            Self::Waypoints(points) => match locate(points, t, |point| point.time_s) {
                Location::Between(index, _) => {
                    let (from, to): (&Waypoint, &Waypoint) = (&points[index], &points[index + 1]);
                    rate(from.position_m, to.position_m, to.time_s - from.time_s)
                }
                _ => [0.0; 3],
            },
        }
    }
}

/// theta of (39) and its rate (1/s), for a curve stretched to `duration_s`.
///
/// theta jumps at a quarter of the curve, where rho = 0, so the position does not.
fn lemniscate_angle(t: f64, duration_s: f64) -> (f64, f64) {
    let stretch = 100.0 / duration_s;
    // Time on the paper's clock.
    let s = t * stretch;
    let clamped = s.clamp(0.0, 100.0);
    let slope = PI / 100.0;
    let (theta, rate) = if clamped <= 25.0 {
        (slope * clamped, slope)
    } else if clamped <= 50.0 {
        (-slope * (clamped - 25.0) + 5.0 * PI / 4.0, -slope)
    } else if clamped <= 75.0 {
        (-slope * (clamped - 50.0) + PI, -slope)
    } else {
        (slope * (clamped - 75.0) + 7.0 * PI / 4.0, slope)
    };
    (theta, if (0.0..=100.0).contains(&s) { rate * stretch } else { 0.0 })
}

impl Motion {
    /// Position of the obstacle's origin at time `t` (m).
    pub fn position_at(&self, t: f64) -> Vector {
        match self {
            Self::Linear { position_m, velocity_mps } => std::array::from_fn(|i| position_m[i] + velocity_mps[i] * t),
            Self::Circle { centre_m, radius_m, phase_rad, rate_radps, acceleration_radps2 } => {
                let (sin, cos) = (phase_rad + rate_radps * t + acceleration_radps2 * t * t).sin_cos();
                [centre_m[0] + radius_m * cos, centre_m[1] + radius_m * sin, centre_m[2]]
            }
            Self::Waypoints(points) => match locate(points, t, |point| point.0) {
                Location::None => [0.0; 3],
                Location::At(index) => points[index].1,
                Location::Between(index, share) => mix(points[index].1, points[index + 1].1, share),
            },
        }
    }

    /// Velocity of the obstacle's origin at time `t` (m/s); at a kink that of the piece that ends there.
    pub fn velocity_at(&self, t: f64) -> Vector {
        match self {
            Self::Linear { velocity_mps, .. } => *velocity_mps,
            Self::Circle { radius_m, phase_rad, rate_radps, acceleration_radps2, .. } => {
                let (sin, cos) = (phase_rad + rate_radps * t + acceleration_radps2 * t * t).sin_cos();
                let rate = rate_radps + 2.0 * acceleration_radps2 * t;
                [-radius_m * sin * rate, radius_m * cos * rate, 0.0]
            }
            Self::Waypoints(points) => match locate(points, t, |point| point.0) {
                Location::Between(index, _) => {
                    let (from, to) = (&points[index], &points[index + 1]);
                    rate(from.1, to.1, to.0 - from.0)
                }
                _ => [0.0; 3],
            },
        }
    }
}

impl Task {
    /// Weight on curvatures and their rates at time `t`, (46); `None` for a tip task, whose weights are constant.
    pub fn shape_weight_at(&self, t: f64) -> Option<f64> {
        match self {
            Self::Tip { .. } => None,
            Self::Shape { weight_end, weight_slope, end_s, .. } => {
                let left = (end_s - t).clamp(0.0, *end_s);
                Some(weight_end - weight_slope * left * left)
            }
        }
    }
}

/// Where a time lies among points in rising order of time.
enum Location {
    /// There are no points.
    None,
    /// At this point, or beyond the end that it is.
    At(usize),
    /// In the piece after this point, at this share (0, 1] of it.
    Between(usize, f64),
}

fn locate<T>(points: &[T], t: f64, time: impl Fn(&T) -> f64) -> Location {
    let after = points.partition_point(|point| time(point) < t);
    match (after, points.len()) {
        (_, 0) => Location::None,
        (0, _) => Location::At(0),
        (after, count) if after == count => Location::At(count - 1),
        (after, _) => {
            let (from, to) = (time(&points[after - 1]), time(&points[after]));
            Location::Between(after - 1, (t - from) / (to - from))
        }
    }
}

fn mix(from: Vector, to: Vector, share: f64) -> Vector {
    std::array::from_fn(|i| from[i] + share * (to[i] - from[i]))
}

fn rate(from: Vector, to: Vector, duration_s: f64) -> Vector {
    std::array::from_fn(|i| (to[i] - from[i]) / duration_s)
}

/// Spherical interpolation between unit quaternions, the short way round.
fn slerp(from: [f64; 4], to: [f64; 4], share: f64) -> [f64; 4] {
    let dot: f64 = from.iter().zip(&to).map(|(a, b)| a * b).sum();
    let to = if dot < 0.0 { to.map(|x| -x) } else { to };
    let angle = dot.abs().min(1.0).acos();
    // Below this angle sin(angle) divides badly and the straight line is exact to 1e-16.
    let (a, b) = if angle < 1e-8 {
        (1.0 - share, share)
    } else {
        (((1.0 - share) * angle).sin() / angle.sin(), (share * angle).sin() / angle.sin())
    };
    let mixed: [f64; 4] = std::array::from_fn(|i| a * from[i] + b * to[i]);
    let norm = mixed.iter().map(|x| x * x).sum::<f64>().sqrt();
    mixed.map(|x| x / norm)
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTING_DOWN: [f64; 4] = [std::f64::consts::FRAC_1_SQRT_2, 0.0, std::f64::consts::FRAC_1_SQRT_2, 0.0];

    fn lemniscate(duration_s: f64) -> TipPath {
        TipPath::Lemniscate { scale_m: 0.6, height_m: -2.4, duration_s, quaternion: POINTING_DOWN }
    }

    fn close(found: Vector, expected: Vector, tolerance: f64) {
        for i in 0..3 {
            assert!((found[i] - expected[i]).abs() <= tolerance, "{found:?} is not {expected:?}");
        }
    }

    #[test]
    fn lemniscate_passes_through_hand_computed_points() {
        let path = lemniscate(100.0);
        // theta = 0, pi/8 (rho = 0.6 cos 45), pi/4 (rho = 0), 9 pi/8, pi, 3 pi/4 (rho = 0), 15 pi/8, 2 pi.
        let r = 0.6 * 0.5f64.sqrt();
        let (c, s) = ((PI / 8.0).cos(), (PI / 8.0).sin());
        for (t, x, y) in [
            (0.0, 0.6, 0.0),
            (12.5, r * c, r * s),
            (25.0, 0.0, 0.0),
            (37.5, -r * c, -r * s),
            (50.0, -0.6, 0.0),
            (62.5, -r * c, r * s),
            (75.0, 0.0, 0.0),
            (87.5, r * c, -r * s),
            (100.0, 0.6, 0.0),
        ] {
            let (position, quaternion) = path.pose_at(t);
            close(position, [x, y, -2.4], 1e-15);
            assert_eq!(quaternion, POINTING_DOWN);
        }
    }

    #[test]
    fn lemniscate_has_no_jump_where_its_angle_jumps() {
        let path = lemniscate(100.0);
        for t in [25.0, 50.0, 75.0] {
            close(path.pose_at(t - 1e-9).0, path.pose_at(t + 1e-9).0, 1e-9);
        }
    }

    #[test]
    fn a_stretched_lemniscate_is_the_same_curve_at_another_pace() {
        for t in [3.0, 30.0, 60.0, 90.0] {
            close(lemniscate(250.0).pose_at(2.5 * t).0, lemniscate(100.0).pose_at(t).0, 1e-12);
        }
        close(lemniscate(250.0).velocity_at(75.0), lemniscate(100.0).velocity_at(30.0).map(|v| v / 2.5), 1e-12);
    }

    #[test]
    fn velocities_are_the_derivatives_of_positions() {
        let circle = Motion::Circle {
            centre_m: [0.4, -0.15, -1.68],
            radius_m: 0.32,
            phase_rad: 0.2,
            rate_radps: 7.0 * PI / 600.0,
            acceleration_radps2: PI / 6000.0,
        };
        let path = lemniscate(100.0);
        let h = 1e-5;
        for t in [0.3, 12.0, 33.0, 61.0, 99.0] {
            let slope =
                |plus: Vector, minus: Vector| -> Vector { std::array::from_fn(|i| (plus[i] - minus[i]) / (2.0 * h)) };
            close(circle.velocity_at(t), slope(circle.position_at(t + h), circle.position_at(t - h)), 1e-9);
            close(path.velocity_at(t), slope(path.pose_at(t + h).0, path.pose_at(t - h).0), 1e-9);
        }
    }

    #[test]
    fn a_path_is_held_outside_its_time() {
        let path = lemniscate(100.0);
        assert_eq!(path.pose_at(-1.0), path.pose_at(0.0));
        assert_eq!(path.pose_at(140.0), path.pose_at(100.0));
        assert_eq!(path.velocity_at(140.0), [0.0; 3]);
    }

    #[test]
    fn the_papers_second_obstacle_is_where_43_puts_it() {
        let motion = Motion::Circle {
            centre_m: [0.40, -0.15, -1.68],
            radius_m: 0.32,
            phase_rad: 0.0,
            rate_radps: 7.0 * PI / 600.0,
            acceleration_radps2: PI / 6000.0,
        };
        let t = 82.6;
        let w = PI * t / 6000.0 + 7.0 * PI / 600.0;
        close(motion.position_at(t), [0.40 + 0.32 * (w * t).cos(), -0.15 + 0.32 * (w * t).sin(), -1.68], 1e-13);
    }

    #[test]
    fn waypoints_are_joined_by_straight_lines_and_turns_the_short_way() {
        let point = |time_s: f64, x: f64, quaternion| Waypoint { time_s, position_m: [x, 0.0, 1.0], quaternion };
        // A quarter turn about x, its end given with the opposite sign: the same attitude.
        let end = [-(PI / 4.0).cos(), -(PI / 4.0).sin(), 0.0, 0.0];
        let path =
            TipPath::Waypoints(vec![point(1.0, 0.0, [1.0, 0.0, 0.0, 0.0]), point(3.0, 4.0, end), point(4.0, 4.0, end)]);
        let (position, quaternion) = path.pose_at(1.5);
        close(position, [1.0, 0.0, 1.0], 1e-15);
        assert!((quaternion[0] - (PI / 16.0).cos()).abs() < 1e-15 && (quaternion[1] - (PI / 16.0).sin()).abs() < 1e-15);
        assert_eq!(path.velocity_at(2.0), [2.0, 0.0, 0.0]);
        assert_eq!(path.velocity_at(3.5), [0.0; 3]);
        assert_eq!(path.pose_at(9.0).0, [4.0, 0.0, 1.0]);

        let motion = Motion::Waypoints(vec![(0.0, [0.0; 3]), (2.0, [1.0, 2.0, 3.0])]);
        assert_eq!(motion.position_at(1.0), [0.5, 1.0, 1.5]);
        assert_eq!(motion.velocity_at(1.0), [0.5, 1.0, 1.5]);
        assert_eq!(motion.position_at(5.0), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn the_shape_weight_grows_as_46_says() {
        let task = Task::Shape { curvatures_1pm: vec![0.0; 8], weight_end: 1e10, weight_slope: 9.99e5, end_s: 100.0 };
        for (t, weight) in [(0.0, 1e7), (50.0, 1e10 - 9.99e5 * 2500.0), (100.0, 1e10), (130.0, 1e10)] {
            assert!((task.shape_weight_at(t).unwrap() - weight).abs() <= 1e-6 * weight);
        }
    }
}
