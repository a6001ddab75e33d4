//! The arm's constants as the equations need them: nodes, elements, holes.

use super::legs::GROUP;
use crate::config::{ArmConfig, ChordRule, Routing, StrainRule};
use nalgebra::{Vector3, Vector4};
use std::ops::Range;

/// A node behind the base: a disk with its share of the backbone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Mass (kg), connector's and payload's included.
    pub mass: f64,
    /// Inertia about local x, y, z (kg m^2).
    pub inertia: Vector3<f64>,
    /// Segment (0-based).
    pub segment: usize,
}

/// A cable's passage through one element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HolePass {
    /// Cable (0-based).
    pub cable: usize,
    /// Hole in the disks' frame (m): `rho_c [0, cos, sin]`.
    pub hole: Vector3<f64>,
}

/// Element i joins node i to node i+1 (node 0 is the base).
#[derive(Debug, Clone, PartialEq)]
pub struct Element {
    /// Length l (m).
    pub length: f64,
    /// Connector between node i and the element's start (m).
    pub connector: f64,
    /// `[GJ, EI, EI]` (N m^2).
    pub stiffness: Vector3<f64>,
    /// Stiffness-proportional damping beta (s).
    pub damping: f64,
    /// Segment (0-based).
    pub segment: usize,
    /// Its passages in [`Arm::passes`].
    pub passes: Range<usize>,
    /// The groups of their legs in a linearisation.
    pub(super) groups: Range<usize>,
}

/// The arm: everything about it that does not move.
#[derive(Debug, Clone, PartialEq)]
pub struct Arm {
    /// Position of the base node (m, base frame).
    pub base_position: Vector3<f64>,
    /// Quaternion of the base node (body to base).
    pub base_quaternion: Vector4<f64>,
    /// Nodes 1..=N (index 0 is node 1).
    pub nodes: Vec<Node>,
    /// Elements 0..N.
    pub elements: Vec<Element>,
    /// Cable passages, element by element; the cables of an element follow one another.
    pub passes: Vec<HolePass>,
    /// Constant part of each cable's length: connectors passed (m).
    pub cable_constant: Vec<f64>,
    /// Elements that each cable runs through.
    pub cable_elements: Vec<Range<usize>>,
    /// Segment of each cable.
    pub cable_segment: Vec<usize>,
    /// Elements of each segment.
    pub segment_elements: Vec<Range<usize>>,
    /// Gravity (m/s^2, base frame).
    pub gravity: Vector3<f64>,
    /// Mass-proportional damping (1/s).
    pub damping_mass: f64,
    /// Chord constraint.
    pub chord: ChordRule,
    /// Curvature measure.
    pub strain: StrainRule,
}

impl Arm {
    /// Derives the constants. Allocates.
    pub fn new(config: &ArmConfig) -> Self {
        let mut nodes = Vec::with_capacity(config.node_count());
        let mut elements = Vec::with_capacity(config.node_count());
        let mut segment_elements = Vec::new();
        let last_segment = config.segments.len() - 1;
        let mut before = 0.0;
        for (s, seg) in config.segments.iter().enumerate() {
            let l = seg.length_m / seg.elements as f64;
            let first = elements.len();
            let connector = if s < last_segment { seg.connector_length_m } else { 0.0 };
            for e in 0..seg.elements {
                let ends = e + 1 == seg.elements;
                let tip = ends && s == last_segment;
                let mut disk = seg.disk_mass_kg;
                if ends && !tip {
                    disk += seg.connector_mass_kg;
                }
                // The backbone's share: half an element on either side, so the last node has only one half.
                let backbone = seg.backbone_mass_kgpm * l * if tip { 0.5 } else { 1.0 };
                let (r2, h2, b2) =
                    (seg.disk_radius_m.powi(2), seg.disk_thickness_m.powi(2), seg.backbone_radius_m.powi(2));
                let axial = disk * r2 / 2.0 + backbone * b2 / 2.0;
                let transverse = disk * (r2 / 4.0 + h2 / 12.0) + backbone * (b2 / 4.0 + l * l / 12.0);
                nodes.push(Node {
                    mass: disk + backbone + if tip { config.payload.mass_kg } else { 0.0 },
                    inertia: Vector3::new(axial, transverse, transverse),
                    segment: s,
                });
                elements.push(Element {
                    length: l,
                    connector: if e == 0 { before } else { 0.0 },
                    stiffness: Vector3::new(
                        seg.torsional_stiffness_nm2,
                        seg.bending_stiffness_nm2,
                        seg.bending_stiffness_nm2,
                    ),
                    damping: seg.damping_stiffness_s,
                    segment: s,
                    passes: 0..0,
                    groups: 0..0,
                });
            }
            before = connector;
            segment_elements.push(first..elements.len());
        }
        let mut cable_segment = Vec::with_capacity(config.cable_count());
        let mut holes = Vec::with_capacity(config.cable_count());
        for (s, seg) in config.segments.iter().enumerate() {
            for angle in &seg.hole_angles_rad {
                cable_segment.push(s);
                holes.push(seg.hole_radius_m * Vector3::new(0.0, angle.cos(), angle.sin()));
            }
        }
        let cable_elements: Vec<Range<usize>> = cable_segment
            .iter()
            .map(|&s| match config.routing {
                Routing::Local => segment_elements[s].clone(),
                Routing::Through => 0..segment_elements[s].end,
            })
            .collect();
        let (mut passes, mut groups) = (Vec::new(), 0);
        for (i, element) in elements.iter_mut().enumerate() {
            let start = passes.len();
            for (cable, range) in cable_elements.iter().enumerate() {
                if range.contains(&i) {
                    passes.push(HolePass { cable, hole: holes[cable] });
                }
            }
            element.passes = start..passes.len();
            element.groups = groups..groups + element.passes.len().div_ceil(GROUP);
            groups = element.groups.end;
        }
        // Connectors are passed by `through` cables; a `local` cable starts behind its segment's connector.
        let cable_constant = cable_segment
            .iter()
            .map(|&s| match config.routing {
                Routing::Local => 0.0,
                Routing::Through => config.segments[..s].iter().map(|seg| seg.connector_length_m).sum(),
            })
            .collect();
        Self {
            base_position: Vector3::from(config.base_position_m),
            base_quaternion: Vector4::from(config.base_quaternion),
            nodes,
            elements,
            passes,
            cable_constant,
            cable_elements,
            cable_segment,
            segment_elements,
            gravity: Vector3::from(config.gravity_mps2),
            damping_mass: config.damping_mass_1ps,
            chord: config.chord,
            strain: config.strain,
        }
    }

    /// N.
    #[inline(always)]
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Cables that pass an element.
    #[inline(always)]
    pub(super) fn cables(&self, e: &Element) -> Range<usize> {
        match &self.passes[e.passes.clone()] {
            [first, .., last] => first.cable..last.cable + 1,
            [only] => only.cable..only.cable + 1,
            [] => 0..0,
        }
    }

    /// Number of cables.
    #[inline(always)]
    pub fn cable_count(&self) -> usize {
        self.cable_segment.len()
    }

    /// Number of segments.
    pub fn segment_count(&self) -> usize {
        self.segment_elements.len()
    }

    /// Position and quaternion of node `i`, 0..=N.
    #[inline(always)]
    pub fn pose(&self, q: &[f64], i: usize) -> (Vector3<f64>, Vector4<f64>) {
        if i == 0 {
            (self.base_position, self.base_quaternion)
        } else {
            let s = &q[7 * (i - 1)..7 * i];
            (Vector3::new(s[0], s[1], s[2]), Vector4::new(s[3], s[4], s[5], s[6]))
        }
    }

    /// Rates of [`Arm::pose`]; zero at the base.
    #[inline(always)]
    pub fn rate(&self, qd: &[f64], i: usize) -> (Vector3<f64>, Vector4<f64>) {
        if i == 0 {
            (Vector3::zeros(), Vector4::zeros())
        } else {
            let s = &qd[7 * (i - 1)..7 * i];
            (Vector3::new(s[0], s[1], s[2]), Vector4::new(s[3], s[4], s[5], s[6]))
        }
    }

    /// Straight arm at rest, coordinates only (7N). Allocates.
    pub fn straight(&self) -> Vec<f64> {
        self.bent(&vec![0.0; 2 * self.segment_count()])
    }

    /// Constant-curvature chain (7N): curvatures (1/m) about local y and z of each segment, `(y, z)` segment by
    /// segment; satisfies the constraints exactly. Allocates.
    pub fn bent(&self, curvatures: &[f64]) -> Vec<f64> {
        let mut q = vec![0.0; 7 * self.node_count()];
        self.bent_into(curvatures, &mut q);
        q
    }

    /// [`Arm::bent`] into the caller's buffer; the chord constraints hold exactly.
    pub fn bent_into(&self, curvatures: &[f64], q: &mut [f64]) {
        use crate::math::quaternion as quat;
        let (mut r, mut p) = (self.base_position, self.base_quaternion);
        for (i, e) in self.elements.iter().enumerate() {
            let k = Vector3::new(0.0, curvatures[2 * e.segment], curvatures[2 * e.segment + 1]);
            let v = match self.strain {
                StrainRule::Logarithm => quat::from_rotation_vector(&(k * e.length)),
                StrainRule::VectorPart => {
                    let half = k * (e.length / 2.0);
                    let w = (1.0 - half.norm_squared()).max(0.0).sqrt();
                    Vector4::new(w, half[0], half[1], half[2]).normalize()
                }
            };
            let next = quat::product(&p, &v).normalize();
            r += self.chord_vector(e, &p, &next);
            p = next;
            q[7 * i..7 * i + 3].copy_from_slice(r.as_slice());
            q[7 * i + 3..7 * i + 7].copy_from_slice(p.as_slice());
        }
    }
}
