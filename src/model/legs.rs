//! Cables in elements that stand side by side: their legs, one cable of each element in a vector, and the sums over the
//! cables that the tangent needs.
//!
//! Enters: the elements' [`Span`]s, holes, tensions. Leaves: [`LegGroup`]s, from which the input matrix is read, and
//! [`Sums`]. With `v = [e; a_i; a_j]` (11 numbers per cable: direction, and its derivative towards both quaternions) a unit
//! tension's force is `[e; a_i; -e; -a_j]`, and the part of the tangent that comes from the direction is the sum of
//! `w v v^T` over the cables, `w = u/length`.
//! Must never: allocate after [`Passages::new`].

use super::arm::Arm;
use super::cables::{Leg, Span};
use super::linearize::WIDEST;
use crate::math::simd::{Columns, Number};
use std::ops::Range;

/// Cables in a group of an element's legs; an element's last group may be filled up with zeros.
pub(super) const GROUP: usize = 4;
/// Rows of `v`: direction, force on `p_i`, force on `p_j`.
pub(super) const ROWS: usize = 11;
/// Where the quaternions' rows begin.
pub(super) const FORCE: [usize; 2] = [3, 7];

/// Legs of a group of an element's cables: rows of `v`.
#[derive(Debug, Clone, Copy)]
pub(super) struct LegGroup(pub(super) [[f64; GROUP]; ROWS]);

impl LegGroup {
    pub(super) const ZERO: Self = Self([[0.0; GROUP]; ROWS]);
}

/// Where an arm's cables pass its elements: the k-th cable of each element in a row, which ends with what fills the last
/// vector. Where an element has fewer, there is a hole in the middle, at no tension.
#[derive(Debug, Clone)]
pub(super) struct Passages {
    /// Length of a row.
    length: usize,
    /// Coordinates of the holes in the disks' frame (m), and tensions (N).
    y: Vec<f64>,
    z: Vec<f64>,
    /// The same at the elements' ends, of cables that are not parallel to the backbone.
    end: [Vec<f64>; 2],
    tension: Vec<f64>,
    /// `v` and `u/length` of the elements at work, cable for cable.
    v: Vec<[[f64; WIDEST]; ROWS]>,
    weight: Vec<[f64; WIDEST]>,
}

/// Sums over the cables of an element, or of several side by side.
pub(super) struct Sums<V> {
    /// `sum w v v^T`, upper triangle.
    pub(super) gram: [[V; ROWS]; ROWS],
    /// `sum w`.
    pub(super) weight: V,
    /// `sum w [h_y, h_z]` of the holes in disk i and in disk j.
    pub(super) first: [[V; 2]; 2],
    /// `sum w h h^T` of disks i and i, i and j, j and j.
    pub(super) second: [[[V; 2]; 2]; 3],
    /// `sum u e`.
    pub(super) pull: [V; 3],
    /// `sum u e [h_y, h_z]` of both disks.
    pub(super) pull_at: [[[V; 3]; 2]; 2],
}

impl Passages {
    /// Allocates.
    pub(super) fn new(arm: &Arm) -> Self {
        let length = arm.node_count().next_multiple_of(WIDEST);
        let most = arm.elements.iter().map(|e| e.passes.len()).max().unwrap_or(0);
        let row = vec![0.0; most * length];
        Self {
            length,
            y: row.clone(),
            z: row.clone(),
            end: if arm.skew { [row.clone(), row.clone()] } else { [Vec::new(), Vec::new()] },
            tension: row,
            v: vec![[[0.0; WIDEST]; ROWS]; most],
            weight: vec![[0.0; WIDEST]; most],
        }
    }

    /// Takes holes and tensions.
    pub(super) fn gather(&mut self, arm: &Arm, u: &[f64]) {
        for (i, e) in arm.elements.iter().enumerate() {
            for (k, pass) in arm.passes[e.passes.clone()].iter().enumerate() {
                let at = k * self.length + i;
                (self.y[at], self.z[at], self.tension[at]) = (pass.hole[1], pass.hole[2], pass.share * u[pass.cable]);
                if arm.skew {
                    (self.end[0][at], self.end[1][at]) = (pass.end[1], pass.end[2]);
                }
            }
        }
    }

    /// Legs and sums of the elements from `i` on.
    #[inline(always)]
    pub(super) fn sums<W: Columns>(&mut self, w: W, arm: &Arm, i: usize, span: &Span<W::Value>) -> Sums<W::Value> {
        let mut most = 0;
        for e in &arm.elements[i..arm.elements.len().min(i + W::WIDTH)] {
            most = most.max(e.passes.len());
        }
        let mut sums = if arm.skew { self.skew(w, most, i, span) } else { self.parallel(w, most, i, span) };
        self.gram_row::<W, 0>(w, most, &mut sums.gram);
        self.gram_row::<W, 1>(w, most, &mut sums.gram);
        self.gram_row::<W, 2>(w, most, &mut sums.gram);
        self.gram_row::<W, 3>(w, most, &mut sums.gram);
        self.gram_row::<W, 4>(w, most, &mut sums.gram);
        self.gram_row::<W, 5>(w, most, &mut sums.gram);
        self.gram_row::<W, 6>(w, most, &mut sums.gram);
        self.gram_row::<W, 7>(w, most, &mut sums.gram);
        self.gram_row::<W, 8>(w, most, &mut sums.gram);
        self.gram_row::<W, 9>(w, most, &mut sums.gram);
        self.gram_row::<W, 10>(w, most, &mut sums.gram);
        sums
    }

    /// Legs, and their sums but for the gram, where each cable has the same hole in both disks.
    #[inline(always)]
    fn parallel<W: Columns>(&mut self, w: W, most: usize, i: usize, span: &Span<W::Value>) -> Sums<W::Value> {
        let zero = w.splat(0.0);
        let (mut moments, mut pull) = ([zero; 6], [[zero; 3]; 3]);
        for k in 0..most {
            let at = k * self.length + i;
            let (y, z, tension) = (w.load(&self.y[at..]), w.load(&self.z[at..]), w.load(&self.tension[at..]));
            let leg = span.leg(y, z);
            let weight = self.note(w, k, &leg, tension);
            for c in 0..3 {
                let force = tension * leg.direction[c];
                pull[0][c] = pull[0][c] + force;
                pull[1][c] = force.multiply_add(y, pull[1][c]);
                pull[2][c] = force.multiply_add(z, pull[2][c]);
            }
            let (of_y, of_z) = (weight * y, weight * z);
            moments[0] = moments[0] + weight;
            moments[1] = moments[1] + of_y;
            moments[2] = moments[2] + of_z;
            moments[3] = of_y.multiply_add(y, moments[3]);
            moments[4] = of_y.multiply_add(z, moments[4]);
            moments[5] = of_z.multiply_add(z, moments[5]);
        }
        let [weight, y, z, yy, yz, zz] = moments;
        let [pull, of_y, of_z] = pull;
        Sums {
            gram: [[zero; ROWS]; ROWS],
            weight,
            first: [[y, z]; 2],
            second: [[[yy, yz], [yz, zz]]; 3],
            pull,
            pull_at: [[of_y, of_z]; 2],
        }
    }

    /// The same for any holes.
    #[inline(always)]
    fn skew<W: Columns>(&mut self, w: W, most: usize, i: usize, span: &Span<W::Value>) -> Sums<W::Value> {
        let zero = w.splat(0.0);
        let mut sums = Sums {
            gram: [[zero; ROWS]; ROWS],
            weight: zero,
            first: [[zero; 2]; 2],
            second: [[[zero; 2]; 2]; 3],
            pull: [zero; 3],
            pull_at: [[[zero; 3]; 2]; 2],
        };
        for k in 0..most {
            let at = k * self.length + i;
            let holes = [
                [w.load(&self.y[at..]), w.load(&self.z[at..])],
                [w.load(&self.end[0][at..]), w.load(&self.end[1][at..])],
            ];
            let tension = w.load(&self.tension[at..]);
            let leg = span.leg_between(holes);
            let weight = self.note(w, k, &leg, tension);
            sums.weight = sums.weight + weight;
            for c in 0..3 {
                let force = tension * leg.direction[c];
                sums.pull[c] = sums.pull[c] + force;
                for (at, hole) in sums.pull_at.iter_mut().zip(&holes) {
                    for axis in 0..2 {
                        at[axis][c] = force.multiply_add(hole[axis], at[axis][c]);
                    }
                }
            }
            for (first, hole) in sums.first.iter_mut().zip(&holes) {
                for axis in 0..2 {
                    first[axis] = weight.multiply_add(hole[axis], first[axis]);
                }
            }
            for (second, [a, b]) in sums.second.iter_mut().zip([[0, 0], [0, 1], [1, 1]]) {
                for r in 0..2 {
                    let of_row = weight * holes[a][r];
                    for c in 0..2 {
                        second[r][c] = of_row.multiply_add(holes[b][c], second[r][c]);
                    }
                }
            }
        }
        sums
    }

    /// Keeps the k-th legs' rows and their weight `u/length`, which it returns.
    #[inline(always)]
    fn note<W: Columns>(&mut self, w: W, k: usize, leg: &Leg<W::Value>, tension: W::Value) -> W::Value {
        let (v, weight) = (&mut self.v[k], tension * leg.inverse);
        w.store(weight, &mut self.weight[k]);
        for c in 0..3 {
            w.store(leg.direction[c], &mut v[c]);
        }
        for end in 0..2 {
            for c in 0..4 {
                w.store(leg.forces[end][c], &mut v[FORCE[end] + c]);
            }
        }
        weight
    }

    /// Row R of the upper triangle, its sums in registers meanwhile.
    #[inline(always)]
    fn gram_row<W: Columns, const R: usize>(&self, w: W, most: usize, gram: &mut [[W::Value; ROWS]; ROWS]) {
        let mut sums = [w.splat(0.0); ROWS];
        for (v, weight) in self.v[..most].iter().zip(&self.weight) {
            let row = w.load(weight) * w.load(&v[R]);
            for k in R..ROWS {
                sums[k] = row.multiply_add(w.load(&v[k]), sums[k]);
            }
        }
        gram[R] = sums;
    }

    /// Puts the legs of the elements that [`Passages::sums`] had into their groups.
    #[inline(always)]
    pub(super) fn keep(&self, arm: &Arm, elements: Range<usize>, legs: &mut [LegGroup]) {
        for (l, e) in arm.elements[elements].iter().enumerate() {
            let groups = &mut legs[e.groups.clone()];
            let passes = &arm.passes[e.passes.clone()];
            let Some(first) = passes.first() else { continue };
            for (pass, v) in passes.iter().zip(&self.v) {
                // Places of cables between them that do not pass here stay zero.
                let k = pass.cable - first.cable;
                for (row, v) in groups[k / GROUP].0.iter_mut().zip(v) {
                    row[k % GROUP] = pass.share * v[l];
                }
            }
        }
    }
}
