//! Distances between the arm and its obstacles.
//!
//! Enters: positions `r` and tangents `t` of the nodes 0..=N, a set of convex obstacles, a reach. Leaves: every pair
//! within reach as a distance, a normal and the fixed weights of a body point (so that the planner can linearise it),
//! the smallest distance per obstacle, the safe/warning decision (17), the penalty (27). It must never allocate or
//! panic in an evaluation, lose a NaN, or know quaternions, tensions or time.
//!
//! - [`BodyGeometry::from_arm`], [`Body::new`]: the arm, with the model `points` (the paper's potential collision
//!   points) or `arm` (the whole centre line), and a radius.
//! - [`Shape::new`], [`Obstacle::new`], [`ObstacleSet`]: the obstacles; [`pose`] from position and quaternion;
//!   `extrapolate` moves all by their velocities.
//! - [`Body::find`] gives [`Found`]: rows of [`Proximity`], minima, counts. [`Body::measure`] gives the surface
//!   distances for reports.
//! - [`ObstacleSet::moved_distances_into`]: the distances of moved body points, for particle swarms.
//! - [`WarningState`] is (17) with hysteresis; [`required_distance`] the barrier; [`penalty`] is (27), with
//!   [`Obstacle::penalty_length`].
//!
//! The closest point is searched on the curve itself and not on capsules between nodes, which miss the bent backbone by
//! up to 6 mm.

mod body;
mod curve;
mod hull;
mod obstacles;
mod penalty;
mod proximity;
mod shape;
mod warning;

pub use body::{BodyGeometry, BodyPoint, ElementGeometry};
pub use hull::HULL_POINTS_MAX;
pub use obstacles::{OBSTACLES_MAX, Obstacle, ObstacleError, ObstacleSet, SetFull, pose};
pub use penalty::{LENGTH_OTHER_M, penalty};
pub use proximity::{Body, CHORD_DEVIATION_M, Found, Measured, Proximity, ROWS_MAX};
pub use shape::{Shape, ShapeError};
pub use warning::{WarningState, required_distance};
