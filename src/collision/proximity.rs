//! Pairs of body and obstacle within reach: the search.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::Vector3;

use super::body::{BodyGeometry, BodyPoint};
use super::curve::{Curve, SAMPLES_MAX, Sample};
use super::obstacles::{OBSTACLES_MAX, Obstacle, ObstacleSet};
use crate::config::BodyModel;

/// Most rows that [`Body::find`] returns.
pub const ROWS_MAX: usize = 512;

/// A piece of the curve stays within this of its chord (m).
pub const CHORD_DEVIATION_M: f64 = 0.5e-3;

/// Fewest pieces of an element: a straight one, too, gets a row on each half, like the paper's mid-points and nodes.
const PIECES_MIN: usize = 2;

/// Most pieces of an element: enough for 16 rad/m over an element of 0.25 m. Beyond it the rows are fewer, their
/// distances exact all the same.
const PIECES_MAX: usize = 16;

/// Two neighbouring pieces whose closest points are within this are one (m).
const MERGE_M: f64 = 1e-6;

/// One pair within reach: a distance and all that its linearisation needs.
///
/// `d(distance) = normal . (w0 dr_i + w1 dt_i + w2 dr_{i+1} + w3 dt_{i+1})` with the weights of `point`; the closest
/// point's own wandering along the curve contributes nothing at first order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proximity {
    /// Index in the obstacle set.
    pub obstacle: usize,
    /// Which point of the arm.
    pub point: BodyPoint,
    /// Its position (m, base frame).
    pub position: Vector3<f64>,
    /// Unit normal from the obstacle to the point (base frame), inside along the shortest way out.
    pub normal: Vector3<f64>,
    /// Surface distance less body radius less growth (m); negative in contact.
    pub distance: f64,
    /// Body radius plus growth (m), as subtracted in `distance`.
    pub inflation: f64,
    /// Order along the arm among the rows of one obstacle: the index of the paper's point, or of the piece
    /// (it may change with the arm's bend).
    pub ordinal: usize,
}

/// What a search found; borrows the body's buffers.
#[derive(Debug, Clone, Copy)]
pub struct Found<'a> {
    /// All pairs with a distance below the reach, nearest first.
    pub rows: &'a [Proximity],
    /// Smallest distance of each obstacle (m), also beyond the reach; NaN where the arm's state is not finite.
    pub minima: &'a [f64],
    /// Smallest of them (m); infinite without obstacles.
    pub minimum: f64,
    /// Rows that found no room; the nearest were kept.
    pub overflow: usize,
    /// Pieces whose search ran out of samples (curve parallel to the surface): their distance may be too large by
    /// micrometres.
    pub unresolved: usize,
}

/// Smallest surface distances (m) for reports; borrows the body's buffers.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// Per obstacle, along the whole arm.
    pub along_arm: &'a [f64],
    /// Per obstacle, at the paper's points.
    pub at_points: &'a [f64],
}

/// The arm's body with every buffer of the search. `new` allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Body {
    geometry: BodyGeometry,
    model: BodyModel,
    radius: f64,
    points: Vec<BodyPoint>,
    strands: Vec<Strand>,
    /// Positions of `points`.
    positions: Vec<Vector3<f64>>,
    stack: Vec<(Sample, Sample)>,
    nearest: BinaryHeap<Ranked>,
    rows: Vec<Proximity>,
    /// By how much more than its obstacle each element is kept away (m), and the most of it.
    doubt: Vec<f64>,
    doubt_max: f64,
    minima: Vec<f64>,
    minima_points: Vec<f64>,
    overflow: usize,
    unresolved: usize,
}

/// A strand in its present shape.
#[derive(Debug, Clone, Copy)]
struct Strand {
    element: usize,
    connector: bool,
    curve: Curve,
    middle: Vector3<f64>,
    /// Around `middle`, over the whole strand.
    radius: f64,
    pieces: usize,
    /// Ordinal of the first piece.
    first: usize,
}

/// Farthest on top of the heap.
#[derive(Debug, Clone, Copy)]
struct Ranked(Proximity);

impl Ord for Ranked {
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |r: &Self| (r.0.obstacle, r.0.ordinal);
        self.0.distance.total_cmp(&other.0.distance).then_with(|| key(self).cmp(&key(other)))
    }
}

impl PartialOrd for Ranked {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Ranked {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Ranked {}

/// The smaller one, NaN if either is: a distance that is not a number must not be lost.
fn least(a: f64, b: f64) -> f64 {
    if a.is_nan() || a < b { a } else { b }
}

impl Body {
    /// A body of this model with a radius (m) around its centre line; room for [`ROWS_MAX`] rows. Allocates.
    pub fn new(geometry: &BodyGeometry, model: BodyModel, radius_m: f64) -> Self {
        Self::with_capacity(geometry, model, radius_m, ROWS_MAX)
    }

    /// [`Self::new`] with room for `rows` rows (at least one). Allocates.
    pub fn with_capacity(geometry: &BodyGeometry, model: BodyModel, radius_m: f64, rows: usize) -> Self {
        let rows = rows.max(1);
        let mut strands = Vec::with_capacity(2 * geometry.elements.len());
        let blank = Strand {
            element: 0,
            connector: false,
            curve: Curve::empty(),
            middle: Vector3::zeros(),
            radius: 0.0,
            pieces: 1,
            first: 0,
        };
        for (element, shape) in geometry.elements.iter().enumerate() {
            if shape.connector_m > 0.0 {
                strands.push(Strand { element, connector: true, ..blank });
            }
            strands.push(Strand { element, ..blank });
        }
        let points = geometry.paper_points();
        Self {
            geometry: geometry.clone(),
            model,
            radius: radius_m,
            positions: vec![Vector3::zeros(); points.len()],
            points,
            strands,
            stack: Vec::with_capacity(SAMPLES_MAX + 2),
            nearest: BinaryHeap::with_capacity(rows),
            rows: Vec::with_capacity(rows),
            doubt: vec![0.0; geometry.elements.len()],
            doubt_max: 0.0,
            minima: Vec::with_capacity(OBSTACLES_MAX),
            minima_points: Vec::with_capacity(OBSTACLES_MAX),
            overflow: 0,
            unresolved: 0,
        }
    }

    /// What the position of each element may be off by (m): [`Self::find`] counts it to the inflation.
    ///
    /// # Panics
    /// If it is not one number per element.
    pub fn set_doubt(&mut self, doubt_m: &[f64]) {
        self.doubt.copy_from_slice(doubt_m);
        self.doubt_max = doubt_m.iter().copied().fold(0.0, f64::max);
    }

    /// Geometry.
    pub fn geometry(&self) -> &BodyGeometry {
        &self.geometry
    }

    /// Model.
    pub fn model(&self) -> BodyModel {
        self.model
    }

    /// Radius around the centre line (m).
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// The paper's points.
    pub fn points(&self) -> &[BodyPoint] {
        &self.points
    }

    /// Most rows that a search returns.
    pub fn capacity(&self) -> usize {
        self.rows.capacity()
    }

    /// All pairs with a distance below `reach` (m), and the smallest distance of every obstacle.
    ///
    /// `r` (m) and `t` hold positions and tangents of the nodes 0..=N in the base frame. With `points` a pair is one of
    /// the paper's points and an obstacle; with `arm` a piece of the centre line (within [`CHORD_DEVIATION_M`] of its
    /// chord) and an obstacle, at the piece's closest point on the curve itself; a point that two neighbouring pieces
    /// share is one row. A state that is not finite gives NaN minima, never a row and never a panic. Does not allocate.
    ///
    /// # Panics
    /// If the slices do not have N + 1 entries.
    pub fn find(&mut self, r: &[Vector3<f64>], t: &[Vector3<f64>], obstacles: &ObstacleSet, reach: f64) -> Found<'_> {
        self.check_lengths(r, t);
        self.nearest.clear();
        self.rows.clear();
        self.minima.clear();
        (self.overflow, self.unresolved) = (0, 0);
        match self.model {
            BodyModel::Points => self.place_points(r, t),
            BodyModel::Arm => self.bend_strands(r, t),
        }
        for (index, obstacle) in obstacles.as_slice().iter().enumerate() {
            let inflation = self.radius + obstacle.growth();
            let search = Search { obstacle, index, inflation, reach: reach + inflation + self.doubt_max };
            let minimum = match self.model {
                BodyModel::Points => self.scan_points(&search),
                BodyModel::Arm => self.scan_arm(&search),
            };
            self.minima.push(minimum - inflation - self.doubt_max);
        }
        self.rows.extend(self.nearest.drain().map(|ranked| ranked.0));
        if self.doubt_max > 0.0 {
            self.take_off_doubt(reach);
        }
        self.rows.sort_unstable_by_key(|row| Ranked(*row));
        self.found()
    }

    /// Of the rows found within `reach` and the largest doubt, those within `reach` (m) at their own; distances with it.
    fn take_off_doubt(&mut self, reach: f64) {
        let mut seen = [false; OBSTACLES_MAX];
        for row in &mut self.rows {
            let doubt = self.doubt[row.point.element];
            row.inflation += doubt;
            row.distance -= doubt;
            let minimum = &mut self.minima[row.obstacle];
            *minimum = if std::mem::replace(&mut seen[row.obstacle], true) {
                least(*minimum, row.distance)
            } else {
                row.distance
            };
        }
        self.rows.retain(|row| row.distance < reach || row.distance.is_nan());
    }

    /// What the last [`Self::find`] found.
    pub fn found(&self) -> Found<'_> {
        Found {
            rows: &self.rows,
            minima: &self.minima,
            minimum: self.minima.iter().copied().fold(f64::INFINITY, least),
            overflow: self.overflow,
            unresolved: self.unresolved,
        }
    }

    /// Smallest surface distance of every obstacle to the arm, whichever model the body has: body radius subtracted,
    /// growth not, since growth is doubt and not matter. Overwrites what [`Self::found`] gives. Does not allocate.
    ///
    /// # Panics
    /// If the slices do not have N + 1 entries.
    pub fn measure(&mut self, r: &[Vector3<f64>], t: &[Vector3<f64>], obstacles: &ObstacleSet) -> Measured<'_> {
        self.check_lengths(r, t);
        self.rows.clear();
        self.minima.clear();
        self.minima_points.clear();
        (self.overflow, self.unresolved) = (0, 0);
        self.place_points(r, t);
        self.bend_strands(r, t);
        for (index, obstacle) in obstacles.as_slice().iter().enumerate() {
            let search = Search { obstacle, index, inflation: self.radius, reach: f64::NEG_INFINITY };
            let along_arm = self.scan_arm(&search) - self.radius;
            self.minima.push(along_arm);
            let at_points = self.scan_points(&search) - self.radius;
            self.minima_points.push(at_points);
        }
        Measured { along_arm: &self.minima, at_points: &self.minima_points }
    }

    /// Number of pieces of each strand in the shape last searched, for tests and reports: `(element, connector, pieces)`.
    pub fn pieces(&self) -> impl Iterator<Item = (usize, bool, usize)> + '_ {
        self.strands.iter().map(|s| (s.element, s.connector, s.pieces))
    }

    fn check_lengths(&self, r: &[Vector3<f64>], t: &[Vector3<f64>]) {
        let nodes = self.geometry.node_count();
        assert!(r.len() == nodes && t.len() == nodes, "{nodes} nodes expected, found {} and {}", r.len(), t.len());
    }

    fn place_points(&mut self, r: &[Vector3<f64>], t: &[Vector3<f64>]) {
        for (position, point) in self.positions.iter_mut().zip(&self.points) {
            *position = point.combine(r, t);
        }
    }

    fn bend_strands(&mut self, r: &[Vector3<f64>], t: &[Vector3<f64>]) {
        let mut first = 0;
        for strand in &mut self.strands {
            let i = strand.element;
            let shape = &self.geometry.elements[i];
            let connector = t[i] * shape.connector_m;
            strand.curve = if strand.connector {
                Curve::straight(r[i], connector)
            } else {
                Curve::hermite(r[i] + connector, t[i] * shape.length_m, r[i + 1], t[i + 1] * shape.length_m)
            };
            strand.middle = strand.curve.at(0.5);
            strand.radius = strand.curve.control.iter().map(|b| (b - strand.middle).norm()).fold(0.0, f64::max);
            strand.pieces = if strand.connector {
                1
            } else {
                // A piece of width 1/n is within |c''| / (8 n^2) of its chord. A NaN becomes 0 in the cast.
                ((strand.curve.bend / (8.0 * CHORD_DEVIATION_M)).sqrt().ceil() as usize).clamp(PIECES_MIN, PIECES_MAX)
            };
            strand.first = first;
            first += strand.pieces;
        }
    }

    /// Smallest distance at the points, nothing subtracted; emits rows below the search's reach.
    fn scan_points(&mut self, search: &Search<'_>) -> f64 {
        let (centre, radius) = search.obstacle.bounding_ball();
        let mut minimum = f64::INFINITY;
        for i in 0..self.positions.len() {
            let position = self.positions[i];
            if (position - centre).norm() - radius > search.reach.max(minimum) {
                continue;
            }
            let (value, normal) = search.obstacle.distance(&position);
            minimum = least(value, minimum);
            if value < search.reach {
                self.keep(search.row(self.points[i], position, normal, value, i));
            }
        }
        minimum
    }

    /// Smallest distance along the arm, nothing subtracted; emits rows below the search's reach.
    fn scan_arm(&mut self, search: &Search<'_>) -> f64 {
        let (centre, radius) = search.obstacle.bounding_ball();
        let distance = |p: &Vector3<f64>| search.obstacle.distance(p);
        // The strand whose middle is nearest to the centre gives a first upper bound; most others then fall at once.
        let mut nearest = (f64::INFINITY, 0);
        for (i, strand) in self.strands.iter().enumerate() {
            let apart = (strand.middle - centre).norm_squared();
            if apart < nearest.0 {
                nearest = (apart, i);
            }
        }
        let mut minimum = match self.strands.get(nearest.1) {
            Some(strand) => distance(&strand.middle).0,
            None => f64::INFINITY,
        };
        let mut previous: Option<Proximity> = None;
        for i in 0..self.strands.len() {
            let strand = self.strands[i];
            let limit = search.reach.max(minimum);
            if (strand.middle - centre).norm() - radius - strand.radius > limit {
                continue;
            }
            let (value, normal) = distance(&strand.middle);
            minimum = least(value, minimum);
            if strand.curve.lower_bound(&strand.middle, value, &normal) > search.reach.max(minimum) {
                continue;
            }
            let mut a = strand.curve.sample(0.0, &distance);
            for piece in 0..strand.pieces {
                let b = strand.curve.sample((piece + 1) as f64 / strand.pieces as f64, &distance);
                let limit = search.reach.max(minimum);
                let (closest, resolved) = strand.curve.closest(a, b, limit, &mut self.stack, &distance);
                a = b;
                self.unresolved += usize::from(!resolved);
                minimum = least(closest.value, minimum);
                if closest.value < search.reach {
                    let point = if strand.connector {
                        self.geometry.connector_point(strand.element, closest.xi)
                    } else {
                        self.geometry.backbone_point(strand.element, closest.xi)
                    };
                    let ordinal = strand.first + piece;
                    let row = search.row(point, closest.position, closest.normal, closest.value, ordinal);
                    match previous {
                        Some(last) if (last.position - row.position).norm() <= MERGE_M => {
                            previous = Some(if row.distance < last.distance { row } else { last });
                        }
                        _ => {
                            if let Some(last) = previous.replace(row) {
                                self.keep(last);
                            }
                        }
                    }
                }
            }
        }
        if let Some(last) = previous {
            self.keep(last);
        }
        minimum
    }

    /// Keep a row among the nearest.
    fn keep(&mut self, row: Proximity) {
        if self.nearest.len() < self.rows.capacity() {
            self.nearest.push(Ranked(row));
            return;
        }
        self.overflow += 1;
        if let Some(mut farthest) = self.nearest.peek_mut()
            && Ranked(row) < *farthest
        {
            *farthest = Ranked(row);
        }
    }
}

/// One obstacle against the body.
struct Search<'a> {
    obstacle: &'a Obstacle,
    index: usize,
    inflation: f64,
    /// Of the bare surface distance.
    reach: f64,
}

impl Search<'_> {
    fn row(
        &self,
        point: BodyPoint,
        position: Vector3<f64>,
        normal: Vector3<f64>,
        value: f64,
        ordinal: usize,
    ) -> Proximity {
        let inflation = self.inflation;
        Proximity { obstacle: self.index, point, position, normal, distance: value - inflation, inflation, ordinal }
    }
}
