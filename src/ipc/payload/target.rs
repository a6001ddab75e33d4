//! Where the arm shall go.

use super::{Header, MAX_CURVATURES, TargetMode};
use iceoryx2::prelude::ZeroCopySend;

/// One point of the desired motion.
///
/// A client that streams a path sends points ahead of time (`valid_from_ns` in the future by at least the planner's
/// lookahead and lead); the daemon interpolates between the points it has. A single point with `valid_from_ns` 0 is a
/// set-point: valid at once, and held.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Target.v1")]
pub struct Target {
    /// Header.
    pub header: Header,
    /// CLOCK_MONOTONIC (ns) at which the arm shall be there; 0: at once.
    pub valid_from_ns: u64,
    /// [`TargetMode`].
    pub mode: u32,
    /// Shape mode: number of segments; must be the arm's. Tip mode: 0.
    pub segment_count: u32,
    /// Tip position (m), base frame.
    pub position_m: [f64; 3],
    /// Tip's unit quaternion `[w x y z]`, tip to base.
    pub quaternion: [f64; 4],
    /// Tip velocity (m/s), base frame.
    pub velocity_mps: [f64; 3],
    /// Tip angular velocity (rad/s), base frame.
    pub angular_velocity_radps: [f64; 3],
    /// Average curvatures (1/m), (y, z) segment by segment.
    pub curvature_1pm: [f64; MAX_CURVATURES],
    /// Their rates (1/(m s)).
    pub curvature_rate_1pms: [f64; MAX_CURVATURES],
    /// Weight that the client gives its task; recorded. It does not change the motion, whose pace is the governor's. 0: none.
    pub weight: f64,
}

impl Default for Target {
    fn default() -> Self {
        Self {
            header: Header::default(),
            valid_from_ns: 0,
            mode: TargetMode::Tip.wire(),
            segment_count: 0,
            position_m: [0.0; 3],
            quaternion: [1.0, 0.0, 0.0, 0.0],
            velocity_mps: [0.0; 3],
            angular_velocity_radps: [0.0; 3],
            curvature_1pm: [0.0; MAX_CURVATURES],
            curvature_rate_1pms: [0.0; MAX_CURVATURES],
            weight: 0.0,
        }
    }
}
