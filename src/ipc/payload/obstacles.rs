//! Obstacles as one source sees them.

use super::{Header, MAX_OBSTACLES, MAX_VERTICES, ObstacleKind};
use crate::config::ShapeConfig;
use iceoryx2::prelude::ZeroCopySend;

/// Bit of [`Obstacles::flags`]: the source withdraws; its obstacles are forgotten and it is no longer missed.
///
/// An empty set without this bit says "I look and see nothing", which must keep coming.
pub const FLAG_LEAVING: u32 = 1;

/// One obstacle.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Obstacle.v1")]
pub struct Obstacle {
    /// Id, unique within the source.
    pub id: u32,
    /// [`ObstacleKind`].
    pub kind: u32,
    /// Origin of the obstacle's frame (m), base frame, at the capture time.
    pub position_m: [f64; 3],
    /// Unit quaternion `[w x y z]`, obstacle to base.
    pub quaternion: [f64; 4],
    /// Velocity of the origin (m/s), base frame.
    pub velocity_mps: [f64; 3],
    /// Dimensions (m), by kind; unused ones 0.
    pub dimensions_m: [f64; 3],
    /// Covariance of the position (m^2), base frame: xx, xy, xz, yy, yz, zz.
    pub covariance_m2: [f64; 6],
    /// First vertex of a hull in the set's pool.
    pub hull_offset: u32,
    /// Number of vertices of a hull; 0 otherwise.
    pub hull_count: u32,
}

impl Obstacle {
    /// A ball without velocity and uncertainty.
    pub const fn ball(id: u32, position_m: [f64; 3], radius_m: f64) -> Self {
        Self::new(id, ObstacleKind::Ball, position_m, [radius_m, 0.0, 0.0])
    }

    /// An obstacle of a kind at a position, unrotated, at rest, without uncertainty.
    pub const fn new(id: u32, kind: ObstacleKind, position_m: [f64; 3], dimensions_m: [f64; 3]) -> Self {
        Self {
            id,
            kind: kind.wire(),
            position_m,
            quaternion: [1.0, 0.0, 0.0, 0.0],
            velocity_mps: [0.0; 3],
            dimensions_m,
            covariance_m2: [0.0; 6],
            hull_offset: 0,
            hull_count: 0,
        }
    }
}

impl Default for Obstacle {
    fn default() -> Self {
        // No kind: an entry that was forgotten is refused, not taken for a ball.
        let nothing = Self::ball(0, [0.0; 3], 0.0);
        Self { kind: 0, ..nothing }
    }
}

/// All that one source sees at one time.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Obstacles.v1")]
pub struct Obstacles {
    /// Header; `source_id` tells sources apart.
    pub header: Header,
    /// Number of obstacles in use; 0 is a statement: nothing is there.
    pub count: u32,
    /// Number of vertices in use.
    pub vertex_count: u32,
    /// [`FLAG_LEAVING`].
    pub flags: u32,
    /// 0.
    pub reserved: u32,
    /// Obstacles.
    pub obstacles: [Obstacle; MAX_OBSTACLES],
    /// Vertices of the hulls (m), each in its obstacle's frame.
    pub vertices_m: [[f64; 3]; MAX_VERTICES],
}

impl Obstacles {
    /// The obstacles in use; the count is cut at the capacity.
    pub fn used(&self) -> &[Obstacle] {
        &self.obstacles[..(self.count as usize).min(MAX_OBSTACLES)]
    }

    /// Appends an obstacle; `false`, and nothing changes, if the set is full.
    #[must_use]
    pub fn push(&mut self, obstacle: Obstacle) -> bool {
        let Some(place) = self.obstacles.get_mut(self.count as usize) else { return false };
        *place = obstacle;
        self.count += 1;
        true
    }

    /// Appends an obstacle with a configured shape in place of its own kind and dimensions; `false`, and nothing
    /// changes, if the set is full.
    #[must_use]
    pub fn push_shape(&mut self, mut obstacle: Obstacle, shape: &ShapeConfig) -> bool {
        let (kind, dimensions_m) = match shape {
            ShapeConfig::Ball { radius_m } => (ObstacleKind::Ball, [*radius_m, 0.0, 0.0]),
            ShapeConfig::Capsule { half_length_m, radius_m } => {
                (ObstacleKind::Capsule, [*half_length_m, *radius_m, 0.0])
            }
            ShapeConfig::Box { half_extents_m } => (ObstacleKind::Box, *half_extents_m),
            ShapeConfig::HalfSpace => (ObstacleKind::HalfSpace, [0.0; 3]),
            ShapeConfig::Hull { points_m } => {
                obstacle.dimensions_m = [0.0; 3];
                return self.push_hull(obstacle, points_m);
            }
        };
        obstacle.kind = kind.wire();
        obstacle.dimensions_m = dimensions_m;
        self.push(obstacle)
    }

    /// Appends a hull with its vertices (m, its own frame); `false`, and nothing changes, if either is full.
    #[must_use]
    pub fn push_hull(&mut self, mut obstacle: Obstacle, vertices_m: &[[f64; 3]]) -> bool {
        let start = self.vertex_count as usize;
        let Some(place) = self.vertices_m.get_mut(start..start + vertices_m.len()) else { return false };
        obstacle.kind = ObstacleKind::Hull.wire();
        obstacle.hull_offset = self.vertex_count;
        obstacle.hull_count = vertices_m.len() as u32;
        let count = self.count as usize;
        if count >= MAX_OBSTACLES {
            return false;
        }
        place.copy_from_slice(vertices_m);
        self.vertex_count += vertices_m.len() as u32;
        self.push(obstacle)
    }
}

impl Default for Obstacles {
    fn default() -> Self {
        Self {
            header: Header::default(),
            count: 0,
            vertex_count: 0,
            flags: 0,
            reserved: 0,
            obstacles: [Obstacle::default(); MAX_OBSTACLES],
            vertices_m: [[0.0; 3]; MAX_VERTICES],
        }
    }
}
