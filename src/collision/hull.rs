//! Convex hull of points: exact signed distance by its faces.
//!
//! parry3d builds the hull. Its GJK query is good to 1e-7 m and knows no depth, so the query here goes over the faces:
//! inside, the largest plane distance is the signed distance; outside, the closest point lies on a face that sees the
//! query, and almost always on the one with the largest plane distance. The cost is linear in the number of faces,
//! hence the limit on the points.

use nalgebra::{Matrix3, Vector3};
use parry3d_f64::math::Vector as ParryVector;
use parry3d_f64::transformation::try_convex_hull;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::shape::ShapeError;

pub use crate::config::HULL_POINTS_MAX;

/// Flatter than this share of its largest extent, a hull is refused: its faces would be noise.
const THICKNESS_MIN: f64 = 1e-6;

/// Farthest that a given point may lie outside of its hull, as a share of the extent: 10 nm for a metre.
const EXCESS_MAX: f64 = 1e-8;

/// How far points are moved where the hull of the points as given fails, as a share of the extent.
const NUDGE: f64 = 1e-9;

/// Most attempts with moved points.
const RETRIES: usize = 8;

#[derive(Debug, Clone)]
pub(super) struct Hull {
    faces: Vec<Face>,
    centre: Vector3<f64>,
    radius: f64,
}

/// A triangle with its outward plane `normal . x = offset`.
#[derive(Debug, Clone)]
struct Face {
    normal: Vector3<f64>,
    offset: f64,
    corners: [Vector3<f64>; 3],
}

impl Hull {
    pub(super) fn new(points: &[[f64; 3]]) -> Result<Self, ShapeError> {
        let count = points.len();
        if !(4..=HULL_POINTS_MAX).contains(&count) {
            return Err(ShapeError::PointCount { count, min: 4, max: HULL_POINTS_MAX });
        }
        if let Some(index) = points.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(ShapeError::NotFinite { index });
        }
        let thickness_m = thickness(points);
        let extent = points.iter().fold(0.0_f64, |m, p| m.max((Vector3::from(*p) - Vector3::from(points[0])).norm()));
        if thickness_m <= THICKNESS_MIN * extent {
            return Err(ShapeError::Flat { thickness_m });
        }

        // Quickhull loses its way on some arrangements with many points in one plane; points moved by a nanometre
        // per metre have none. Repeated points are the most common such arrangement.
        let mut distinct = points.to_vec();
        distinct.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        distinct.dedup();
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(0);
        let mut result = Self::build(&distinct, points, extent);
        for _ in 0..RETRIES {
            if result.is_ok() {
                break;
            }
            let nudge = NUDGE * extent;
            let nudged: Vec<_> = distinct.iter().map(|p| p.map(|x| x + rng.random_range(-nudge..=nudge))).collect();
            result = Self::build(&nudged, points, extent);
        }
        result
    }

    /// Hull of `points`, checked to hold all of `given`.
    fn build(points: &[[f64; 3]], given: &[[f64; 3]], extent: f64) -> Result<Self, ShapeError> {
        let points: Vec<ParryVector> = points.iter().map(|p| ParryVector::from_array(*p)).collect();
        let (vertices, triangles) = try_convex_hull(&points).map_err(|e| ShapeError::Hull { reason: e.to_string() })?;
        let vertices: Vec<Vector3<f64>> = vertices.iter().map(|v| Vector3::from(v.to_array())).collect();
        let centre = vertices.iter().sum::<Vector3<f64>>() / vertices.len() as f64;
        let radius = vertices.iter().fold(0.0_f64, |m, v| m.max((v - centre).norm()));

        let mut faces = Vec::with_capacity(triangles.len());
        for triangle in &triangles {
            let corners = triangle.map(|i| vertices[i as usize]);
            let cross = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
            let area = cross.norm();
            // A sliver's plane is noise; its neighbours cover it.
            if area <= 1e-14 * extent * extent {
                continue;
            }
            let normal = cross / area;
            faces.push(Face { normal, offset: normal.dot(&corners[0]), corners });
        }
        let hull = Self { faces, centre, radius };
        if hull.faces.len() < 4 {
            return Err(ShapeError::Hull { reason: "fewer than four faces".into() });
        }
        // A wrong hull must not become a wrong distance.
        let points = given.iter().map(|p| Vector3::from(*p));
        let outside_m = points.map(|p| hull.distance(&p).0).fold(0.0, f64::max);
        let excess =
            given.iter().flat_map(|p| hull.faces.iter().map(|f| f.plane(&Vector3::from(*p)))).fold(0.0, f64::max);
        if outside_m.max(excess) > EXCESS_MAX * extent {
            return Err(ShapeError::Hull { reason: format!("a point lies {} m outside of it", outside_m.max(excess)) });
        }
        Ok(hull)
    }

    pub(super) fn bounding_ball(&self) -> (Vector3<f64>, f64) {
        (self.centre, self.radius)
    }

    pub(super) fn distance(&self, p: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let mut highest = &self.faces[0];
        let mut height = f64::NEG_INFINITY;
        for face in &self.faces {
            let h = face.plane(p);
            if h > height {
                (height, highest) = (h, face);
            }
        }
        if height == f64::NEG_INFINITY {
            // Only NaN compares like that.
            return (f64::NAN, Vector3::repeat(f64::NAN));
        }
        // Inside, or above the highest face: its plane supports the hull, so nothing can be closer.
        if height <= 0.0 || highest.is_below(p) {
            return (height, highest.normal);
        }
        let mut best = f64::INFINITY;
        let mut off = highest.normal;
        // A point on a surface of several triangles may, by rounding, lie above a wrong one and below the right one.
        let seen = -1e-9 * self.radius;
        for face in self.faces.iter().filter(|f| f.plane(p) > seen) {
            let d = p - closest_on_triangle(p, &face.corners);
            let squared = d.norm_squared();
            if squared < best {
                (best, off) = (squared, d);
            }
        }
        let norm = best.sqrt();
        // Right above an edge the difference of two nearly equal points has no direction left.
        if norm <= 1e-13 * self.radius { (height, highest.normal) } else { (norm, off / norm) }
    }
}

impl Face {
    fn plane(&self, p: &Vector3<f64>) -> f64 {
        self.normal.dot(p) - self.offset
    }

    /// Whether the foot of `p` on the plane lies in the triangle.
    fn is_below(&self, p: &Vector3<f64>) -> bool {
        let [a, b, c] = &self.corners;
        let within = |from: &Vector3<f64>, to: &Vector3<f64>| (to - from).cross(&(p - from)).dot(&self.normal) >= 0.0;
        within(a, b) && within(b, c) && within(c, a)
    }
}

/// Extent of the points across their flattest direction (m).
fn thickness(points: &[[f64; 3]]) -> f64 {
    let centre = points.iter().map(|p| Vector3::from(*p)).sum::<Vector3<f64>>() / points.len() as f64;
    let spread: Matrix3<f64> = points.iter().map(|p| Vector3::from(*p) - centre).map(|d| d * d.transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let across = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let (low, high) = points
        .iter()
        .map(|p| across.dot(&Vector3::from(*p)))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| (low.min(h), high.max(h)));
    high - low
}

/// Closest point of a triangle by the regions of its corners and edges (Ericson, Real-Time Collision Detection, 5.1.5).
fn closest_on_triangle(p: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]) -> Vector3<f64> {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let denominator = 1.0 / (va + vb + vc);
    a + ab * (vb * denominator) + ac * (vc * denominator)
}
