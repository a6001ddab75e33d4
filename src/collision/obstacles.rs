//! The set of obstacles: fixed capacity, poses that move without allocation.

use nalgebra::{Isometry3, Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::proximity::Proximity;
use super::shape::Shape;

/// Most obstacles of a set.
pub const OBSTACLES_MAX: usize = 64;

/// Why a pose, velocity or growth was refused; the obstacle keeps what it had.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ObstacleError {
    /// A coordinate is NaN or infinite.
    #[error("the obstacle's pose is not finite")]
    Pose,
    /// A velocity is NaN or infinite.
    #[error("the obstacle's velocity is not finite")]
    Velocity,
    /// A growth is NaN, infinite or negative.
    #[error("the obstacle's growth must be finite and not negative")]
    Growth,
    /// No obstacle at that index.
    #[error("no obstacle has the index {0}")]
    Index(usize),
}

/// The set is full; the obstacle comes back.
#[derive(Debug, thiserror::Error)]
#[error("the obstacle set is full: it holds {OBSTACLES_MAX} obstacles unless it was made for another number")]
pub struct SetFull(pub Box<Obstacle>);

/// Pose from a position (m, base frame) and a quaternion `[w x y z]` (obstacle to base), which is normalised.
///
/// # Errors
/// [`ObstacleError::Pose`] where a number is not finite or the quaternion's norm is not between 0.5 and 2.
pub fn pose(position_m: [f64; 3], quaternion: [f64; 4]) -> Result<Isometry3<f64>, ObstacleError> {
    let [w, x, y, z] = quaternion;
    let q = Quaternion::new(w, x, y, z);
    if !(0.5..=2.0).contains(&q.norm()) || position_m.iter().any(|c| !c.is_finite()) {
        return Err(ObstacleError::Pose);
    }
    Ok(Isometry3::from_parts(position_m.into(), UnitQuaternion::new_normalize(q)))
}

/// One obstacle: a shape at a pose in the base frame.
#[derive(Debug, Clone)]
pub struct Obstacle {
    id: u64,
    shape: Shape,
    /// Bounding ball of the shape in its own frame.
    bound: (Vector3<f64>, f64),
    rotation: Matrix3<f64>,
    /// As measured.
    measured: Vector3<f64>,
    velocity: Vector3<f64>,
    /// Extrapolated: what distances are taken from.
    position: Vector3<f64>,
    growth: f64,
}

impl Obstacle {
    /// A resting obstacle without growth. Does not allocate.
    ///
    /// # Errors
    /// [`ObstacleError::Pose`] where the pose is not finite.
    pub fn new(id: u64, shape: Shape, pose: &Isometry3<f64>) -> Result<Self, ObstacleError> {
        let bound = shape.bounding_ball();
        let zero = Vector3::zeros();
        let rotation = Matrix3::identity();
        let mut made = Self { id, shape, bound, rotation, measured: zero, velocity: zero, position: zero, growth: 0.0 };
        made.set_pose(pose)?;
        Ok(made)
    }

    /// Identifier, as the sender chose it.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Shape.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Extrapolated position of the shape's origin (m, base frame).
    pub fn position(&self) -> Vector3<f64> {
        self.position
    }

    /// Velocity of the origin (m/s, base frame).
    pub fn velocity(&self) -> Vector3<f64> {
        self.velocity
    }

    /// Radius by which the obstacle is grown for its uncertainty (m).
    pub fn growth(&self) -> f64 {
        self.growth
    }

    /// The penalty's length r of design section 4: the ball's radius, or 0.1 m for another shape.
    pub fn penalty_length(&self) -> f64 {
        self.shape.ball_radius().unwrap_or(super::penalty::LENGTH_OTHER_M)
    }

    /// Move; ends an extrapolation. Does not allocate.
    ///
    /// # Errors
    /// [`ObstacleError::Pose`] where the pose is not finite; the obstacle stays.
    pub fn set_pose(&mut self, pose: &Isometry3<f64>) -> Result<(), ObstacleError> {
        let finite =
            pose.translation.vector.iter().all(|c| c.is_finite()) && pose.rotation.coords.iter().all(|c| c.is_finite());
        if !finite {
            return Err(ObstacleError::Pose);
        }
        self.rotation = pose.rotation.to_rotation_matrix().into_inner();
        self.measured = pose.translation.vector;
        self.position = self.measured;
        Ok(())
    }

    /// Velocity of the origin (m/s, base frame), for [`ObstacleSet::extrapolate`].
    ///
    /// # Errors
    /// [`ObstacleError::Velocity`] where it is not finite.
    pub fn set_velocity(&mut self, velocity: Vector3<f64>) -> Result<(), ObstacleError> {
        if velocity.iter().any(|c| !c.is_finite()) {
            return Err(ObstacleError::Velocity);
        }
        self.velocity = velocity;
        Ok(())
    }

    /// Grow by a radius (m) for uncertainty and age.
    ///
    /// # Errors
    /// [`ObstacleError::Growth`] where it is negative or not finite.
    pub fn set_growth(&mut self, growth_m: f64) -> Result<(), ObstacleError> {
        if !(growth_m.is_finite() && growth_m >= 0.0) {
            return Err(ObstacleError::Growth);
        }
        self.growth = growth_m;
        Ok(())
    }

    /// Signed surface distance (m, negative inside, growth not subtracted) of a point in the base frame, and the
    /// outward unit normal in the base frame. Does not allocate.
    pub fn distance(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (distance, normal) = self.shape.distance(&self.rotation.tr_mul(&(point - self.position)));
        (distance, self.rotation * normal)
    }

    /// Centre (base frame) and radius of a ball around the obstacle, growth not added.
    pub fn bounding_ball(&self) -> (Vector3<f64>, f64) {
        (self.position + self.rotation * self.bound.0, self.bound.1)
    }
}

/// Obstacles, [`OBSTACLES_MAX`] at most unless made for more, addressed by index. Prepared off the control thread; there
/// it is moved only: poses, velocities and growths change without allocation, and whatever would free memory is handed
/// back.
#[derive(Debug, Clone)]
pub struct ObstacleSet {
    obstacles: Vec<Obstacle>,
    capacity: usize,
}

impl Default for ObstacleSet {
    fn default() -> Self {
        Self::new()
    }
}

impl ObstacleSet {
    /// An empty set with room for [`OBSTACLES_MAX`]. Allocates.
    pub fn new() -> Self {
        Self::with_capacity(OBSTACLES_MAX)
    }

    /// An empty set with room for `capacity` obstacles. Beyond [`OBSTACLES_MAX`] it is no set for the control thread:
    /// the first search with it makes the body's buffers longer. Allocates.
    pub fn with_capacity(capacity: usize) -> Self {
        Self { obstacles: Vec::with_capacity(capacity), capacity }
    }

    /// Add one; returns its index. Does not allocate.
    ///
    /// # Errors
    /// [`SetFull`], with the obstacle in it (that path allocates a box).
    pub fn insert(&mut self, obstacle: Obstacle) -> Result<usize, SetFull> {
        if self.obstacles.len() == self.capacity {
            return Err(SetFull(Box::new(obstacle)));
        }
        self.obstacles.push(obstacle);
        Ok(self.obstacles.len() - 1)
    }

    /// Take one out; the last one takes its index. `None` where there is none.
    pub fn remove(&mut self, index: usize) -> Option<Obstacle> {
        (index < self.obstacles.len()).then(|| self.obstacles.swap_remove(index))
    }

    /// Number of obstacles.
    pub fn len(&self) -> usize {
        self.obstacles.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.obstacles.is_empty()
    }

    /// All obstacles in the order of their indices.
    pub fn as_slice(&self) -> &[Obstacle] {
        &self.obstacles
    }

    /// All obstacles, to move them.
    pub fn as_mut_slice(&mut self) -> &mut [Obstacle] {
        &mut self.obstacles
    }

    /// Index of the obstacle with this identifier.
    pub fn index_of(&self, id: u64) -> Option<usize> {
        self.obstacles.iter().position(|o| o.id == id)
    }

    /// Move one, see [`Obstacle::set_pose`].
    ///
    /// # Errors
    /// An index out of range, or a pose that is not finite.
    pub fn set_pose(&mut self, index: usize, pose: &Isometry3<f64>) -> Result<(), ObstacleError> {
        self.obstacles.get_mut(index).ok_or(ObstacleError::Index(index))?.set_pose(pose)
    }

    /// Put every obstacle where it will be `dt` seconds after its pose was measured: `measured + velocity dt`.
    /// Calls do not add up.
    pub fn extrapolate(&mut self, dt_s: f64) {
        for obstacle in &mut self.obstacles {
            obstacle.position = obstacle.measured + obstacle.velocity * dt_s;
        }
    }

    /// Distance (m) of a row's body point after it has moved to `position`, body radius and growth subtracted like in
    /// [`Proximity::distance`]. Exact for closed-form shapes; for a hull the supporting plane of the row, which never
    /// reports more than the true distance. The set must be the one that the row was found with, unmoved.
    ///
    /// The body point stays the same point of the arm: along the curve another point may by then be closer, by second
    /// order in the movement.
    ///
    /// # Panics
    /// If the row's obstacle index is out of range.
    pub fn moved_distance(&self, row: &Proximity, position: &Vector3<f64>) -> f64 {
        let obstacle = &self.obstacles[row.obstacle];
        if obstacle.shape.is_closed_form() {
            obstacle.distance(position).0 - row.inflation
        } else {
            row.distance + row.normal.dot(&(position - row.position))
        }
    }

    /// Centre (m, base frame) and radius (m) where the row's obstacle is a ball: [`Self::moved_distance`] is then the
    /// distance from the centre less radius and inflation.
    ///
    /// # Panics
    /// If the row's obstacle index is out of range.
    pub fn ball(&self, row: &Proximity) -> Option<(Vector3<f64>, f64)> {
        let obstacle = &self.obstacles[row.obstacle];
        obstacle.shape.ball_radius().map(|radius| (obstacle.position, radius))
    }

    /// [`Self::moved_distance`] for one particle: `positions` holds x, y, z per row, `distances` one number per row.
    /// Does not allocate.
    ///
    /// # Panics
    /// If the lengths do not match.
    pub fn moved_distances_into(&self, rows: &[Proximity], positions: &[f64], distances: &mut [f64]) {
        assert_eq!(positions.len(), 3 * rows.len(), "three coordinates per row");
        assert_eq!(distances.len(), rows.len(), "one distance per row");
        for ((row, position), distance) in rows.iter().zip(positions.chunks_exact(3)).zip(distances) {
            *distance = self.moved_distance(row, &Vector3::new(position[0], position[1], position[2]));
        }
    }
}
