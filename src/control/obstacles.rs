//! Obstacles on their way to the planner: two sets of the same obstacles, now and at the end of the lookahead.
//!
//! Shapes, above all hulls, are built where allocation is allowed. A pair is built there, travels to the control thread
//! as a whole (in a triple buffer, whose slots come back to the builder, so that whatever is freed is freed there), and
//! is only moved here: [`ObstaclePair::place`] changes poses and growths in place.

use crate::collision::{Obstacle, ObstacleError, ObstacleSet, SetFull, Shape, pose};
use nalgebra::Vector3;

/// What the obstacle inputs ask of the supervisor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ObstacleDemand {
    /// Nothing: every source is fresh enough, or grown for its age.
    #[default]
    Proceed,
    /// Hold: a source is expired, or required and absent.
    Hold {
        /// The first such source.
        source: u32,
    },
}

/// Where an obstacle is, as the intake extrapolated it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Origin now (m, base frame).
    pub position_now_m: [f64; 3],
    /// Origin at the end of the lookahead (m, base frame).
    pub position_ahead_m: [f64; 3],
    /// Quaternion `[w x y z]`, obstacle to base.
    pub quaternion: [f64; 4],
    /// Growth for uncertainty and age (m).
    pub growth_m: f64,
}

/// The same obstacles in the same order, now and ahead.
#[derive(Debug, Clone, Default)]
pub struct ObstaclePair {
    now: ObstacleSet,
    ahead: ObstacleSet,
}

impl ObstaclePair {
    /// Without obstacles, with room for all. Allocates.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an obstacle at rest at the origin; its index. Copies the shape, so it allocates for a hull: not for the
    /// control thread.
    ///
    /// # Errors
    /// The sets are full.
    pub fn insert(&mut self, id: u64, shape: &Shape) -> Result<usize, SetFull> {
        let origin = nalgebra::Isometry3::identity();
        // The pose is finite, so neither can fail.
        let (Ok(now), Ok(ahead)) =
            (Obstacle::new(id, shape.clone(), &origin), Obstacle::new(id, shape.clone(), &origin))
        else {
            return Ok(self.now.len());
        };
        let index = self.now.insert(now)?;
        self.ahead.insert(ahead)?;
        Ok(index)
    }

    /// Takes all obstacles out. Frees hulls: not for the control thread.
    pub fn clear(&mut self) {
        while self.now.remove(0).is_some() {}
        while self.ahead.remove(0).is_some() {}
    }

    /// Moves an obstacle. Does not allocate.
    ///
    /// # Errors
    /// An index out of range, or a placement that is not finite; the obstacle then stays where it was.
    pub fn place(&mut self, index: usize, placement: &Placement) -> Result<(), ObstacleError> {
        let now = pose(placement.position_now_m, placement.quaternion)?;
        let ahead = pose(placement.position_ahead_m, placement.quaternion)?;
        if !(placement.growth_m.is_finite() && placement.growth_m >= 0.0) {
            return Err(ObstacleError::Growth);
        }
        for (set, pose) in [(&mut self.now, &now), (&mut self.ahead, &ahead)] {
            let obstacle = set.as_mut_slice().get_mut(index).ok_or(ObstacleError::Index(index))?;
            obstacle.set_pose(pose)?;
            obstacle.set_growth(placement.growth_m)?;
        }
        Ok(())
    }

    /// Moves an obstacle of constant velocity (m/s): measured at `position_m` `age_s` ago, looked ahead `lookahead_s`.
    /// Does not allocate.
    ///
    /// # Errors
    /// As [`Self::place`].
    pub fn place_moving(
        &mut self,
        index: usize,
        position_m: [f64; 3],
        quaternion: [f64; 4],
        velocity_mps: [f64; 3],
        age_s: f64,
        lookahead_s: f64,
        growth_m: f64,
    ) -> Result<(), ObstacleError> {
        let at = |dt: f64| (Vector3::from(position_m) + dt * Vector3::from(velocity_mps)).into();
        let placement =
            Placement { position_now_m: at(age_s), position_ahead_m: at(age_s + lookahead_s), quaternion, growth_m };
        self.place(index, &placement)
    }

    /// Obstacles now.
    pub fn now(&self) -> &ObstacleSet {
        &self.now
    }

    /// Obstacles at the end of the lookahead.
    pub fn ahead(&self) -> &ObstacleSet {
        &self.ahead
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ShapeConfig;

    fn pair() -> ObstaclePair {
        let mut pair = ObstaclePair::new();
        pair.insert(7, &Shape::new(&ShapeConfig::Ball { radius_m: 0.1 }).unwrap()).unwrap();
        pair
    }

    #[test]
    fn both_sets_hold_the_same_obstacles_in_the_same_order() {
        let mut pair = pair();
        pair.insert(9, &Shape::new(&ShapeConfig::HalfSpace).unwrap()).unwrap();
        let ids = |s: &ObstacleSet| s.as_slice().iter().map(Obstacle::id).collect::<Vec<_>>();
        assert_eq!(ids(pair.now()), [7, 9]);
        assert_eq!(ids(pair.ahead()), [7, 9]);
        pair.clear();
        assert!(pair.now().is_empty() && pair.ahead().is_empty());
    }

    #[test]
    fn a_moving_obstacle_is_extrapolated_by_its_age_and_by_the_lookahead() {
        let mut pair = pair();
        pair.place_moving(0, [1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [2.0, 0.0, -1.0], 0.05, 0.1, 0.02).unwrap();
        assert!((pair.now().as_slice()[0].position() - Vector3::new(1.1, 0.0, -0.05)).norm() < 1e-15);
        assert!((pair.ahead().as_slice()[0].position() - Vector3::new(1.3, 0.0, -0.15)).norm() < 1e-15);
        assert_eq!(pair.ahead().as_slice()[0].growth(), 0.02);
    }

    #[test]
    fn a_placement_that_is_not_finite_moves_neither_set() {
        let mut pair = pair();
        let good = Placement {
            position_now_m: [1.0; 3],
            position_ahead_m: [2.0; 3],
            quaternion: [1.0, 0.0, 0.0, 0.0],
            growth_m: 0.0,
        };
        pair.place(0, &good).unwrap();
        let bad = [
            Placement { position_now_m: [f64::NAN; 3], ..good },
            Placement { position_ahead_m: [0.0, f64::INFINITY, 0.0], ..good },
            Placement { quaternion: [0.0; 4], ..good },
            Placement { growth_m: f64::NAN, ..good },
        ];
        for placement in bad {
            assert!(pair.place(0, &placement).is_err(), "{placement:?}");
            assert_eq!(pair.now().as_slice()[0].position(), Vector3::repeat(1.0));
            assert_eq!(pair.ahead().as_slice()[0].position(), Vector3::repeat(2.0));
        }
        assert_eq!(pair.place(1, &good), Err(ObstacleError::Index(1)));
    }
}
