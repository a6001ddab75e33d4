//! The arm's geometry for collision, and points of it as linear combinations of nodes.

use nalgebra::Vector3;

use crate::config::ArmConfig;

/// One element of the chain: node `i` to node `i + 1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElementGeometry {
    /// Length l of the elastic part (m).
    pub length_m: f64,
    /// Length L of the rigid connector between node `i` and the start of the elastic part (m); 0 without one.
    pub connector_m: f64,
}

/// The chain of elements from the base (node 0) to the tip (node N).
#[derive(Debug, Clone, PartialEq)]
pub struct BodyGeometry {
    /// Element `i` joins node `i` and node `i + 1`.
    pub elements: Vec<ElementGeometry>,
}

impl BodyGeometry {
    /// Of a checked arm. Allocates.
    pub fn from_arm(arm: &ArmConfig) -> Self {
        let mut elements = Vec::with_capacity(arm.node_count());
        let mut connector_m = 0.0;
        for segment in &arm.segments {
            for i in 0..segment.elements {
                elements.push(ElementGeometry {
                    length_m: segment.length_m / segment.elements as f64,
                    connector_m: if i == 0 { connector_m } else { 0.0 },
                });
            }
            connector_m = segment.connector_length_m;
        }
        Self { elements }
    }

    /// Number of nodes, the base included: the length of the slices of positions and tangents.
    pub fn node_count(&self) -> usize {
        self.elements.len() + 1
    }

    /// The body point at `xi` in [0, 1] of element `element`'s elastic part:
    /// cubic Hermite from `r_i + L t_i` with derivative `l t_i` to `r_{i+1}` with derivative `l t_{i+1}`.
    pub fn backbone_point(&self, element: usize, xi: f64) -> BodyPoint {
        let ElementGeometry { length_m: l, connector_m } = self.elements[element];
        let (xi2, rest) = (xi * xi, 1.0 - xi);
        let h00 = (1.0 + 2.0 * xi) * rest * rest;
        let h10 = xi * rest * rest;
        let h01 = xi2 * (3.0 - 2.0 * xi);
        let h11 = -xi2 * rest;
        BodyPoint { element, weights: [h00, h00 * connector_m + l * h10, h01, l * h11] }
    }

    /// The body point at `xi` in [0, 1] of the connector that precedes element `element`'s elastic part.
    pub fn connector_point(&self, element: usize, xi: f64) -> BodyPoint {
        BodyPoint { element, weights: [1.0, xi * self.elements[element].connector_m, 0.0, 0.0] }
    }

    /// The paper's potential collision points, in its order: per element the mid-point, the end node, and the
    /// connector's end where a connector follows. Allocates.
    pub fn paper_points(&self) -> Vec<BodyPoint> {
        let mut points = Vec::with_capacity(3 * self.elements.len());
        for element in 0..self.elements.len() {
            points.push(self.backbone_point(element, 0.5));
            points.push(self.backbone_point(element, 1.0));
            if self.elements.get(element + 1).is_some_and(|next| next.connector_m > 0.0) {
                points.push(self.connector_point(element + 1, 1.0));
            }
        }
        points
    }
}

/// A point of the arm's centre line: `w0 r_i + w1 t_i + w2 r_{i+1} + w3 t_{i+1}` for element i.
///
/// The weights do not depend on the arm's state, so the same combination of the nodes' displacements is the point's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyPoint {
    /// Element i, from node i to node i + 1.
    pub element: usize,
    /// `[w0 (1), w1 (m), w2 (1), w3 (m)]`.
    pub weights: [f64; 4],
}

impl BodyPoint {
    /// Position (m) for node positions `r` (m) and tangents `t`; equally a displacement or a velocity for those of the
    /// nodes.
    ///
    /// # Panics
    /// If the slices are shorter than `element + 2`.
    pub fn combine(&self, r: &[Vector3<f64>], t: &[Vector3<f64>]) -> Vector3<f64> {
        let [w0, w1, w2, w3] = self.weights;
        let i = self.element;
        r[i] * w0 + t[i] * w1 + r[i + 1] * w2 + t[i + 1] * w3
    }
}
