//! Targets, and how far ahead they are sampled.

use super::CURVATURES_MAX;
use crate::integrator::Scheme;
use crate::math::quaternion::{from_rotation_vector, product};
use nalgebra::{Vector3, Vector4};

/// Longest computed lag that a target is extrapolated over (s): beyond it a twist says nothing about the path, and the
/// shape task's own 20 s would throw a moving target across the workspace. `lead_s` in the configuration may be longer.
pub const LAG_S_MAX: f64 = 1.0;

/// A desired output with its rates.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "the control thread copies it and never allocates")]
pub enum Target {
    /// Pose of the tip.
    Tip {
        /// Position (m, base frame).
        position_m: Vector3<f64>,
        /// Unit quaternion `[w x y z]`, tip to base; either sign.
        quaternion: Vector4<f64>,
        /// Velocity (m/s, base frame).
        velocity_mps: Vector3<f64>,
        /// Angular velocity (rad/s, base frame).
        angular_velocity_radps: Vector3<f64>,
    },
    /// Average curvatures of the segments, (y, z) segment by segment; as many as the arm has.
    Shape {
        /// Curvatures (1/m).
        curvatures_1pm: [f64; CURVATURES_MAX],
        /// Their rates (1/(m s)).
        rates_1pms: [f64; CURVATURES_MAX],
    },
}

impl Target {
    /// The target `dt_s` later at its present rates: a straight line, a turn about a fixed axis.
    pub fn extrapolated(&self, dt_s: f64) -> Self {
        match *self {
            Self::Tip { position_m, quaternion, velocity_mps, angular_velocity_radps } => Self::Tip {
                position_m: position_m + dt_s * velocity_mps,
                // The angular velocity is in the base frame, so its rotation comes from the left.
                quaternion: product(&from_rotation_vector(&(dt_s * angular_velocity_radps)), &quaternion).normalize(),
                velocity_mps,
                angular_velocity_radps,
            },
            Self::Shape { mut curvatures_1pm, rates_1pms } => {
                curvatures_1pm.iter_mut().zip(&rates_1pms).for_each(|(k, rate)| *k += dt_s * rate);
                Self::Shape { curvatures_1pm, rates_1pms }
            }
        }
    }

    /// Whether every number is finite and the quaternion has a direction.
    pub fn is_finite(&self) -> bool {
        let all = |v: &[f64]| v.iter().all(|x| x.is_finite());
        match self {
            Self::Tip { position_m, quaternion, velocity_mps, angular_velocity_radps } => {
                all(position_m.as_slice())
                    && all(quaternion.as_slice())
                    && quaternion.norm_squared() > 0.25
                    && all(velocity_mps.as_slice())
                    && all(angular_velocity_radps.as_slice())
            }
            Self::Shape { curvatures_1pm, rates_1pms } => all(curvatures_1pm) && all(rates_1pms),
        }
    }

    /// Whether it is a tip pose.
    pub const fn is_tip(&self) -> bool {
        matches!(self, Self::Tip { .. })
    }
}

/// The target of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetInput {
    /// At the tick's time: what the record compares with, and what is extrapolated.
    pub now: Target,
    /// At the tick's time plus [`super::Cycle::lead_s`], where the client has told that much of its path; otherwise
    /// `now` is extrapolated by its rates.
    pub ahead: Option<Target>,
    /// Weight that the client gives its task, for the record. The loop's pace is the governor's: a posture that weighs less
    /// than the changes of the tensions would be followed by a loop that lags, and swings.
    pub weight: f64,
    /// Sequence number of the point in use, for the record.
    pub sequence: u64,
    /// Whether it is young enough to be followed; a target that is not leads to a hold.
    pub fresh: bool,
}

impl TargetInput {
    /// Whether every number is finite, quaternions have a direction, and the weight is none below 0.
    pub fn is_sound(&self) -> bool {
        self.now.is_finite()
            && self.ahead.is_none_or(|ahead| ahead.is_finite())
            && self.weight.is_finite()
            && self.weight >= 0.0
    }
}

/// Time constant (s) of the lag that rate weights give a planned motion: with one implicit step of `eta` seconds whose
/// rates are wanted at zero, the outputs follow like a first-order lag of `(rate / pose) gamma / (phi eta)`.
pub fn lag_s(weight_rate: f64, weight_pose: f64, scheme: &Scheme, eta: f64) -> f64 {
    let lag = weight_rate / weight_pose * scheme.gamma / (scheme.phi * eta);
    if lag.is_finite() { lag.clamp(0.0, LAG_S_MAX) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn the_lag_of_the_papers_tip_weights_is_a_fifth_of_a_second() {
        let lag = lag_s(5e10, 5e12, &Scheme::new(0.8), 0.1);
        assert!((lag - 0.198).abs() < 1e-3, "{lag}");
        assert_eq!(lag_s(0.0, 5e12, &Scheme::new(0.8), 0.1), 0.0);
    }

    #[test]
    fn a_lag_of_the_shape_weights_is_not_extrapolated_over() {
        assert_eq!(lag_s(1e10, 1e10, &Scheme::new(0.8), 0.1), LAG_S_MAX);
        assert_eq!(lag_s(1.0, 0.0, &Scheme::new(0.8), 0.1), 0.0, "no pose weight, no lag to speak of");
    }

    #[test]
    fn a_tip_target_moves_along_its_twist_in_the_base_frame() {
        // A quarter turn about base z, from an attitude that is not the identity.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let start = Target::Tip {
            position_m: Vector3::new(1.0, 2.0, 3.0),
            quaternion: Vector4::new(half, half, 0.0, 0.0),
            velocity_mps: Vector3::new(0.0, -0.5, 0.1),
            angular_velocity_radps: Vector3::new(0.0, 0.0, FRAC_PI_2 / 2.0),
        };
        let Target::Tip { position_m, quaternion, .. } = start.extrapolated(2.0) else { unreachable!() };
        assert!((position_m - Vector3::new(1.0, 1.0, 3.2)).norm() < 1e-15);
        // q_z(90 deg) * q_x(90 deg) = 1/2 [1, 1, 1, 1].
        assert!((quaternion - Vector4::repeat(0.5)).norm() < 1e-12, "{quaternion}");
    }

    #[test]
    fn a_shape_target_moves_at_its_rates() {
        let start = Target::Shape { curvatures_1pm: [1.0; CURVATURES_MAX], rates_1pms: [-0.5; CURVATURES_MAX] };
        let Target::Shape { curvatures_1pm, .. } = start.extrapolated(0.4) else { unreachable!() };
        assert!(curvatures_1pm.iter().all(|k| (k - 0.8).abs() < 1e-15));
    }
}
