//! Whether the arm reaches a tip target, and by how much it does not.

use crate::posture::{POSE, RestingArm, pose_error};
use nalgebra::{Vector3, Vector4};

/// What an attitude error counts as beside one of the position, over the length that the inverse statics take for it.
const ATTITUDE_SHARE: f64 = 1.0 / 3.0;
/// What a posture's load beyond what its cables can give counts as, over the reach.
const OVERLOAD: f64 = 100.0;

/// How near the arm gets to a tip target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Whether that counts as out of reach.
    pub is_out: bool,
    /// Distance of the nearest point from the target (m).
    pub miss_m: f64,
    /// Attitude error there, roll about the tip's tangent left out (rad).
    pub miss_rad: f64,
    /// Load of the cables there; above 1 the posture needs more than they may pull.
    pub load: f64,
    /// Where the tip is there (m, base frame).
    pub nearest_m: Vector3<f64>,
}

impl Reach {
    /// Of an equilibrium with the load of its cables; `reach_m` and `attitude_length_m` are `[governor]`'s.
    pub fn of(
        rest: &RestingArm,
        load: f64,
        target: &(Vector3<f64>, Vector4<f64>),
        reach_m: f64,
        attitude_length_m: f64,
    ) -> Self {
        let e: [f64; POSE] = pose_error(&rest.tip(), &target.0, &target.1);
        let mut reach = Self {
            is_out: false,
            miss_m: Vector3::new(e[0], e[1], e[2]).norm(),
            miss_rad: e[4].hypot(e[5]),
            load,
            nearest_m: rest.tip().0,
        };
        reach.is_out = reach.error_m(reach_m, attitude_length_m) >= reach_m;
        reach
    }

    /// All of it as an error of the position (m).
    pub fn error_m(&self, reach_m: f64, attitude_length_m: f64) -> f64 {
        let over = OVERLOAD * reach_m * (self.load - 1.0).max(0.0);
        self.miss_m + ATTITUDE_SHARE * attitude_length_m * self.miss_rad + over
    }
}
