//! The arm's constants as the equations need them: nodes, elements, holes.

use super::legs::GROUP;
use crate::config::{ArmConfig, ChordRule, StrainRule};
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
    /// Hole in node i's frame (m): `rho_c [0, cos, sin]`.
    pub hole: Vector3<f64>,
    /// Hole in node i+1's frame (m); another one where the cable is not parallel to the backbone.
    pub end: Vector3<f64>,
    /// Tension here over the cable's: 1 without friction along its route.
    pub share: f64,
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
    /// Cable passages, element by element, by ascending cable.
    pub passes: Vec<HolePass>,
    /// Constant part of each cable's length: connectors passed (m).
    pub cable_constant: Vec<f64>,
    /// Elements that each cable runs through.
    pub cable_elements: Vec<Range<usize>>,
    /// Segment of each cable.
    pub cable_segment: Vec<usize>,
    /// Strain of each cable for a newton (1/N); 0 where it does not stretch.
    pub cable_compliance: Vec<f64>,
    /// Length of each cable between its drum and the arm (m).
    pub cable_feed: Vec<f64>,
    /// Whether any cable has other holes at an element's end than at its beginning.
    pub skew: bool,
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
            let first = elements.len();
            let last = s == last_segment;
            let connector = if last { 0.0 } else { seg.connector_length_m };
            for e in 0..seg.elements {
                let lump = seg.lump(e, last);
                let tip = last && e + 1 == seg.elements;
                nodes.push(Node {
                    mass: lump.mass + if tip { config.payload.mass_kg } else { 0.0 },
                    inertia: Vector3::new(lump.axial, lump.transverse, lump.transverse),
                    segment: s,
                });
                let [torsion, bending] = seg.element_stiffness_nm2(e);
                elements.push(Element {
                    length: seg.element_length_m(),
                    connector: if e == 0 { before } else { 0.0 },
                    stiffness: Vector3::new(torsion, bending, bending),
                    damping: seg.damping_stiffness_s,
                    segment: s,
                    passes: 0..0,
                    groups: 0..0,
                });
            }
            before = connector;
            segment_elements.push(first..elements.len());
        }
        // Each cable's segment and its number there.
        let cables: Vec<(usize, usize)> = config
            .segments
            .iter()
            .enumerate()
            .flat_map(|(s, seg)| (0..seg.hole_angles_rad.len()).map(move |c| (s, c)))
            .collect();
        let cable_elements: Vec<Range<usize>> = cables
            .iter()
            .map(|&(s, c)| {
                let from = segment_elements[config.cable_segments(s).start].start;
                from..segment_elements[s].start + config.segments[s].cable_elements(c)
            })
            .collect();
        let (mut passes, mut groups) = (Vec::new(), 0);
        for (i, element) in elements.iter_mut().enumerate() {
            let start = passes.len();
            let (s, count) = (element.segment, config.segments[element.segment].elements as f64);
            let place = |node: usize| s as f64 + (node - segment_elements[s].start) as f64 / count;
            for (cable, range) in cable_elements.iter().enumerate() {
                if range.contains(&i) {
                    let hole = |node: usize| {
                        let [y, z] = config.segments[cables[cable].0].hole_m(cables[cable].1, place(node));
                        Vector3::new(0.0, y, z)
                    };
                    passes.push(HolePass { cable, hole: hole(i), end: hole(i + 1), share: 1.0 });
                }
            }
            element.passes = start..passes.len();
            let spanned = passes[start..].last().map_or(0, |last: &HolePass| last.cable + 1 - passes[start].cable);
            element.groups = groups..groups + spanned.div_ceil(GROUP);
            groups = element.groups.end;
        }
        // A cable passes the connectors between the segments that it runs along; it starts behind the one of the segment before.
        let passed =
            |s: usize| config.segments[config.cable_segments(s)].split_last().map_or(&[][..], |(_, before)| before);
        let cable_constant =
            cables.iter().map(|&(s, _)| passed(s).iter().map(|seg| seg.connector_length_m).sum()).collect();
        Self {
            base_position: Vector3::from(config.base_position_m),
            base_quaternion: Vector4::from(config.base_quaternion),
            nodes,
            elements,
            skew: passes.iter().any(|pass| pass.hole != pass.end),
            passes,
            cable_constant,
            cable_elements,
            cable_segment: cables.iter().map(|(s, _)| *s).collect(),
            cable_compliance: cables
                .iter()
                .map(|&(s, _)| config.segments[s].cable_stiffness_n.map_or(0.0, |ea| 1.0 / ea))
                .collect(),
            cable_feed: cables.iter().map(|&(s, _)| config.segments[s].cable_feed_m).collect(),
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

    /// From the first to the last of the cables that pass an element; some between them may not.
    #[inline(always)]
    pub(super) fn cables(&self, e: &Element) -> Range<usize> {
        match &self.passes[e.passes.clone()] {
            [first, .., last] => first.cable..last.cable + 1,
            [only] => only.cable..only.cable + 1,
            [] => 0..0,
        }
    }

    /// Passages of a cable in [`Arm::passes`], from the base on, with their elements.
    pub fn passes_of(&self, cable: usize) -> impl Iterator<Item = (usize, usize)> {
        self.elements.iter().enumerate().flat_map(move |(i, e)| {
            e.passes.clone().filter(move |&pass| self.passes[pass].cable == cable).map(move |pass| (pass, i))
        })
    }

    /// Takes over the tension at each passage over its cable's ([`Arm::passes`]' order): what friction leaves of it on the way.
    /// Lengths do not change by it.
    ///
    /// # Panics
    /// If there is not one share for each passage.
    pub fn take_shares(&mut self, shares: &[f64]) {
        assert_eq!(shares.len(), self.passes.len(), "one share for each passage");
        self.passes.iter_mut().zip(shares).for_each(|(pass, share)| pass.share = *share);
    }

    /// Length (m) that a cable of `length_m` along the arm has unstretched, its feed not counted: what its drum tells, under
    /// `tension_n`.
    #[inline]
    pub fn at_drum(&self, cable: usize, length_m: f64, tension_n: f64) -> f64 {
        let (compliance, feed) = (self.cable_compliance[cable], self.cable_feed[cable]);
        if compliance == 0.0 { length_m } else { (length_m + feed) / (1.0 + compliance * tension_n) - feed }
    }

    /// Length (m) along the arm of a cable whose drum tells `drum_m` under `tension_n`: the inverse of [`Arm::at_drum`].
    #[inline]
    pub fn along_arm(&self, cable: usize, drum_m: f64, tension_n: f64) -> f64 {
        let (compliance, feed) = (self.cable_compliance[cable], self.cable_feed[cable]);
        if compliance == 0.0 { drum_m } else { (drum_m + feed) * (1.0 + compliance * tension_n) - feed }
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

    /// Length of a segment's elements (m).
    pub fn segment_length(&self, segment: usize) -> f64 {
        self.elements[self.segment_elements[segment].clone()].iter().map(|e| e.length).sum()
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
