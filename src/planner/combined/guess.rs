//! What held the last solution back: the start of the next one.
//!
//! From one iterate or tick to the next the same few pairs bind with much the same multipliers. Rows are known again by
//! obstacle and place on the arm; a row that is mistaken for another (an obstacle has left, an element has more pieces
//! than before) costs the solver an iteration and never its answer.

use crate::collision::{ObstacleSet, Proximity};
use crate::planner::complementarity::{Solver, Status};

/// A multiplier below this share of the largest binds nothing.
const SHARE_MIN: f64 = 1e-6;

#[derive(Debug, Clone, Copy)]
struct Bound {
    obstacle: u64,
    ordinal: usize,
    multiplier: f64,
}

/// The pairs that bound the last solution, with their multipliers.
#[derive(Debug, Clone)]
pub(super) struct Guess {
    bounds: Vec<Bound>,
}

impl Guess {
    /// Allocates.
    pub(super) fn new() -> Self {
        Self { bounds: Vec::with_capacity(Solver::WORKING_MAX) }
    }

    /// The last solution says nothing about the next one.
    pub(super) fn forget(&mut self) {
        self.bounds.clear();
    }

    /// Multipliers to expect, row by row.
    pub(super) fn guess_into(&self, rows: &[Proximity], obstacles: &ObstacleSet, multipliers: &mut [f64]) {
        for (row, multiplier) in rows.iter().zip(multipliers) {
            let id = obstacles.as_slice()[row.obstacle].id();
            let known = self.bounds.iter().find(|b| b.obstacle == id && b.ordinal == row.ordinal);
            *multiplier = known.map_or(0.0, |b| b.multiplier);
        }
    }

    /// Keeps what bound a solution, or one that time cut short: the next solve goes on from there. One that was not found, or
    /// only by giving rows up, is no start.
    pub(super) fn keep(&mut self, rows: &[Proximity], obstacles: &ObstacleSet, multipliers: &[f64], status: Status) {
        self.forget();
        if !matches!(status, Status::Optimal | Status::Stopped) {
            return;
        }
        let multipliers = &multipliers[..rows.len()];
        let least = SHARE_MIN * multipliers.iter().copied().fold(0.0, f64::max);
        for (row, &multiplier) in rows.iter().zip(multipliers) {
            // No more rows work at once than there is room for here.
            if multiplier > least {
                let obstacle = obstacles.as_slice()[row.obstacle].id();
                self.bounds.push(Bound { obstacle, ordinal: row.ordinal, multiplier });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::{Body, BodyGeometry, Obstacle, Shape, pose};
    use crate::config::{ArmConfig, BodyModel, ShapeConfig};
    use nalgebra::Vector3;

    /// Balls of these ids beside the straight arm.
    fn balls(ids: &[u64]) -> ObstacleSet {
        let mut set = ObstacleSet::new();
        for (k, id) in ids.iter().enumerate() {
            let ball = Shape::new(&ShapeConfig::Ball { radius_m: 0.1 }).unwrap();
            let at = pose([0.12, 0.0, -0.5 - k as f64], [1.0, 0.0, 0.0, 0.0]).unwrap();
            set.insert(Obstacle::new(*id, ball, &at).unwrap()).unwrap();
        }
        set
    }

    fn rows(set: &ObstacleSet) -> Vec<Proximity> {
        let geometry = BodyGeometry::from_arm(&ArmConfig::paper());
        let nodes = geometry.node_count();
        let down = |i: usize| Vector3::new(0.0, 0.0, -2.75 * i as f64 / (nodes - 1) as f64);
        let r: Vec<_> = (0..nodes).map(down).collect();
        let t = vec![-Vector3::z(); nodes];
        Body::new(&geometry, BodyModel::Points, 0.0).find(&r, &t, set, 0.2).rows.to_vec()
    }

    #[test]
    fn rows_are_known_again_by_obstacle_and_place_whatever_their_order() {
        let (mut guess, before, after) = (Guess::new(), balls(&[7, 9]), balls(&[9, 7]));
        let found = rows(&before);
        assert!(found.len() >= 4 && found.iter().any(|r| r.obstacle == 1), "{}", found.len());
        let multipliers: Vec<f64> = (0..found.len()).map(|k| if k % 2 == 0 { 1.0 + k as f64 } else { 1e-12 }).collect();
        guess.keep(&found, &before, &multipliers, Status::Optimal);
        let mut turned = found.clone();
        turned.reverse();
        // The same balls, now the other way round in the set.
        turned.iter_mut().for_each(|row| row.obstacle = 1 - row.obstacle);
        let mut told = vec![f64::NAN; found.len()];
        guess.guess_into(&turned, &after, &mut told);
        told.reverse();
        let want: Vec<f64> = multipliers.iter().map(|m| if *m < 0.5 { 0.0 } else { *m }).collect();
        assert_eq!(told, want);
        guess.guess_into(&found, &balls(&[1, 2]), &mut told);
        assert!(told.iter().all(|m| *m == 0.0), "other obstacles are not known: {told:?}");
    }

    #[test]
    fn a_solution_that_was_not_found_is_no_start() {
        let set = balls(&[7]);
        let found = rows(&set);
        for status in [Status::Relaxed, Status::IterationLimit] {
            let mut guess = Guess::new();
            let multipliers = vec![1.0; found.len()];
            guess.keep(&found, &set, &multipliers, Status::Optimal);
            guess.keep(&found, &set, &multipliers, status);
            assert!(guess.bounds.is_empty(), "{status:?}");
        }
    }
}
