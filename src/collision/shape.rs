//! Convex shapes in their own frame: signed distance and outward normal.
//!
//! Ball, capsule, box and half-space are closed forms, exact also inside, where GJK reports only contact. A unit
//! normal comes back for every finite point, on the surface and on the medial axis too, and it is always a
//! subgradient of the (convex) signed distance: the search along the curve relies on that.

use nalgebra::Vector3;

use super::hull::Hull;
use crate::config::ShapeConfig;

/// Why a shape was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ShapeError {
    /// A length is not finite or not above zero.
    #[error("{what} must be a finite length above 0 m, not {value}")]
    Length {
        /// Which one.
        what: &'static str,
        /// As given (m).
        value: f64,
    },
    /// A hull with too few or too many points.
    #[error("a convex hull takes {min} to {max} points, not {count}")]
    PointCount {
        /// As given.
        count: usize,
        /// Fewest.
        min: usize,
        /// Most: bounds the time of a query.
        max: usize,
    },
    /// A point of a hull is NaN or infinite.
    #[error("point {index} of the convex hull is not finite")]
    NotFinite {
        /// Position in the list.
        index: usize,
    },
    /// All points of a hull (nearly) in one plane.
    #[error("the points of the convex hull lie in one plane (thickness {thickness_m} m)")]
    Flat {
        /// Extent across the flattest direction (m).
        thickness_m: f64,
    },
    /// The hull could not be built.
    #[error("the convex hull of these points cannot be built: {reason}")]
    Hull {
        /// As reported by the algorithm.
        reason: String,
    },
}

/// A checked convex shape in its own frame (m).
#[derive(Debug, Clone)]
pub struct Shape {
    kind: Kind,
}

#[derive(Debug, Clone)]
enum Kind {
    Ball { radius: f64 },
    Capsule { half_length: f64, radius: f64 },
    Box { half_extents: Vector3<f64> },
    HalfSpace,
    Hull(Hull),
}

fn length(what: &'static str, value: f64) -> Result<f64, ShapeError> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(ShapeError::Length { what, value }) }
}

impl Shape {
    /// Check a shape and prepare it. Allocates for hulls only; a hull is built here, so off the control thread.
    ///
    /// # Errors
    /// A length that is not above zero, a hull that is flat, not finite, or of too few or too many points.
    pub fn new(config: &ShapeConfig) -> Result<Self, ShapeError> {
        let kind = match config {
            ShapeConfig::Ball { radius_m } => Kind::Ball { radius: length("radius", *radius_m)? },
            ShapeConfig::Capsule { half_length_m, radius_m } => {
                // A capsule of length zero is a ball and harmless.
                if *half_length_m != 0.0 {
                    length("half length", *half_length_m)?;
                }
                Kind::Capsule { half_length: *half_length_m, radius: length("radius", *radius_m)? }
            }
            ShapeConfig::Box { half_extents_m } => {
                for value in half_extents_m {
                    length("half extent", *value)?;
                }
                Kind::Box { half_extents: Vector3::from(*half_extents_m) }
            }
            ShapeConfig::HalfSpace => Kind::HalfSpace,
            ShapeConfig::Hull { points_m } => Kind::Hull(Hull::new(points_m)?),
        };
        Ok(Self { kind })
    }

    /// Signed distance (m, negative inside) of a point in the shape's frame to the surface, and the unit normal that
    /// points away from the shape (inside: along the shortest way out). NaN in, NaN out. Does not allocate.
    pub fn distance(&self, p: &Vector3<f64>) -> (f64, Vector3<f64>) {
        match &self.kind {
            Kind::Ball { radius } => from_core(*p, *radius),
            Kind::Capsule { half_length, radius } => {
                let along = p.z.clamp(-half_length, *half_length);
                let mut off = *p;
                off.z -= along;
                // On the axis every direction across it is a shortest way out; along it would not be.
                if off.norm_squared() == 0.0 && along.abs() < *half_length {
                    return (-radius, Vector3::x());
                }
                from_core(off, *radius)
            }
            Kind::Box { half_extents } => box_distance(p, half_extents),
            Kind::HalfSpace => (p.z, if p.z.is_nan() { Vector3::repeat(f64::NAN) } else { Vector3::z() }),
            Kind::Hull(hull) => hull.distance(p),
        }
    }

    /// A centre inside the shape and the radius of a ball around it that holds the whole shape
    /// (infinite for the half-space).
    pub fn bounding_ball(&self) -> (Vector3<f64>, f64) {
        match &self.kind {
            Kind::Ball { radius } => (Vector3::zeros(), *radius),
            Kind::Capsule { half_length, radius } => (Vector3::zeros(), half_length + radius),
            Kind::Box { half_extents } => (Vector3::zeros(), half_extents.norm()),
            Kind::HalfSpace => (Vector3::zeros(), f64::INFINITY),
            Kind::Hull(hull) => hull.bounding_ball(),
        }
    }

    /// Radius of a ball (m), `None` for every other shape: the length in the penalty's argument (27).
    pub fn ball_radius(&self) -> Option<f64> {
        match self.kind {
            Kind::Ball { radius } => Some(radius),
            _ => None,
        }
    }

    /// Whether a query has a closed form of constant cost (all but hulls).
    pub fn is_closed_form(&self) -> bool {
        !matches!(self.kind, Kind::Hull(_))
    }
}

/// Distance to a core rounded by `radius`, `off` pointing from the core's closest point to the query.
fn from_core(off: Vector3<f64>, radius: f64) -> (f64, Vector3<f64>) {
    let norm = off.norm();
    let normal = if norm == 0.0 { Vector3::z() } else { off / norm };
    (norm - radius, normal)
}

fn box_distance(p: &Vector3<f64>, half: &Vector3<f64>) -> (f64, Vector3<f64>) {
    // Per axis: how far beyond the face, negative between the faces.
    let beyond = p.abs() - half;
    let sign = p.map(|x| 1.0_f64.copysign(x));
    let outside = beyond.map(|b| if b <= 0.0 { 0.0 } else { b });
    let norm = outside.norm();
    if norm == 0.0 {
        let axis = beyond.imax();
        let mut normal = Vector3::zeros();
        normal[axis] = sign[axis];
        (beyond[axis], normal)
    } else {
        (norm, (outside / norm).component_mul(&sign))
    }
}
