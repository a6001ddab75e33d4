//! Tests of numbers, shared by the intakes.

use crate::ipc::payload::RejectCause;
use nalgebra::{Matrix3, Vector3};

/// Tolerance of `| |q| - 1 |` on arrival.
const QUATERNION_TOLERANCE: f64 = 1e-3;
/// Coordinates and lengths beyond this (m) are a mistake of units, and would overflow squared.
const EXTENT_M_MAX: f64 = 1e4;
/// As the configuration's keys permit.
const WEIGHT_MAX: f64 = 1e20;
/// A hull thinner than this share of its largest extent is flat.
const HULL_THICKNESS_MIN: f64 = 1e-6;

pub(super) fn finite(values: &[f64]) -> Result<(), RejectCause> {
    if values.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(RejectCause::NotFinite) }
}

/// Finite and within the extent of any workshop.
pub(super) fn coordinates(values: &[f64]) -> Result<(), RejectCause> {
    finite(values)?;
    if values.iter().all(|v| v.abs() <= EXTENT_M_MAX) { Ok(()) } else { Err(RejectCause::Dimensions) }
}

/// Finite, positive, within the extent.
pub(super) fn lengths(values: &[f64]) -> Result<(), RejectCause> {
    coordinates(values)?;
    if values.iter().all(|&v| v > 0.0) { Ok(()) } else { Err(RejectCause::Dimensions) }
}

/// A task's weight: finite, not negative, and within the range of the configured ones.
pub(super) fn weight(value: f64) -> Result<(), RejectCause> {
    finite(&[value])?;
    if (0.0..=WEIGHT_MAX).contains(&value) { Ok(()) } else { Err(RejectCause::Weight) }
}

pub(super) fn quaternion(q: &[f64; 4]) -> Result<(), RejectCause> {
    finite(q)?;
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if (norm - 1.0).abs() <= QUATERNION_TOLERANCE { Ok(()) } else { Err(RejectCause::Quaternion) }
}

pub(super) fn normalised(q: &[f64; 4]) -> [f64; 4] {
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / norm)
}

/// Largest standard deviation over all directions of a covariance (xx, xy, xz, yy, yz, zz).
pub(super) fn largest_sigma(c: &[f64; 6]) -> Result<f64, RejectCause> {
    coordinates(c)?;
    if c.iter().all(|&v| v == 0.0) {
        return Ok(0.0);
    }
    let matrix = Matrix3::new(c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5]);
    let eigenvalues = matrix.symmetric_eigenvalues();
    let (least, most) = (eigenvalues.min(), eigenvalues.max());
    // Written so that a NaN of the iteration is refused as well.
    if most > 0.0 && least >= -1e-9 * most { Ok(most.sqrt()) } else { Err(RejectCause::Covariance) }
}

/// At least four vertices, not all in one plane.
pub(super) fn hull(vertices: &[[f64; 3]]) -> Result<(), RejectCause> {
    if vertices.len() < 4 {
        return Err(RejectCause::Hull);
    }
    let mut mean = Vector3::zeros();
    for v in vertices {
        coordinates(v)?;
        mean += Vector3::from(*v) / vertices.len() as f64;
    }
    let scatter: Matrix3<f64> = vertices.iter().fold(Matrix3::zeros(), |sum, v| {
        let d = Vector3::from(*v) - mean;
        sum + d * d.transpose()
    });
    let eigenvalues = scatter.symmetric_eigenvalues();
    // Eigenvalues are squared extents. Written so that a NaN of the iteration is refused as well.
    let solid = eigenvalues.min() > HULL_THICKNESS_MIN * HULL_THICKNESS_MIN * eigenvalues.max();
    if solid { Ok(()) } else { Err(RejectCause::Hull) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_is_that_of_the_worst_direction() {
        // Variance 4 along (1, 1, 0)/sqrt 2, 1 across, 0.25 along z.
        let c = [2.5, 1.5, 0.0, 2.5, 0.0, 0.25];
        assert!((largest_sigma(&c).unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(largest_sigma(&[0.0; 6]), Ok(0.0));
        assert_eq!(largest_sigma(&[1.0, 2.0, 0.0, 1.0, 0.0, 1.0]), Err(RejectCause::Covariance));
        assert_eq!(largest_sigma(&[1.0, 0.0, f64::NAN, 1.0, 0.0, 1.0]), Err(RejectCause::NotFinite));
    }

    #[test]
    fn a_flat_hull_is_refused() {
        let mut v = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
        assert_eq!(hull(&v), Err(RejectCause::Hull));
        assert_eq!(hull(&v[..3]), Err(RejectCause::Hull));
        v[3][2] = 0.5;
        assert_eq!(hull(&v), Ok(()));
    }
}
