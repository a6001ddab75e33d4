//! All cables of an element at once: their legs in vectors of cables, and the sums over them that the tangent needs.
//!
//! Enters: an element's [`Span`], the holes in groups of [`WIDE`], tensions. Leaves: [`LegGroup`]s, from which the input
//! matrix is read, and [`Sums`]. With `v = [e; a_i; a_j]` (11 numbers per cable: direction, and its derivative towards both
//! quaternions) a unit tension's force is `[e; a_i; -e; -a_j]`, and the part of the tangent that comes from the direction is
//! the sum of `w v v^T` over the cables, `w = u/length`: 66 products of which each is one for a whole group.
//! Must never: allocate.

use super::arm::HolePass;
use super::cables::Span;
use crate::math::simd::Columns;

/// Cables in a group. Groups at an element's end are filled up with its last hole, at no tension.
pub(super) const WIDE: usize = 4;
/// Rows of `v`: direction, force on `p_i`, force on `p_j`.
pub(super) const ROWS: usize = 11;
/// Where the quaternions' rows begin.
pub(super) const FORCE: [usize; 2] = [3, 7];

/// Holes of a group of cables, coordinates y and z in the disks' frame (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HoleGroup {
    y: [f64; WIDE],
    z: [f64; WIDE],
}

impl HoleGroup {
    /// Groups of an element's passages, filled up.
    pub(super) fn of(passes: &[HolePass]) -> impl Iterator<Item = Self> + '_ {
        passes.chunks(WIDE).map(|group| {
            let hole = |l: usize| group[l.min(group.len() - 1)].hole;
            Self { y: std::array::from_fn(|l| hole(l)[1]), z: std::array::from_fn(|l| hole(l)[2]) }
        })
    }
}

/// Legs of a group of cables.
#[derive(Debug, Clone, Copy)]
pub(super) struct LegGroup {
    /// Rows of `v`.
    pub(super) v: [[f64; WIDE]; ROWS],
    /// Tension (N).
    tension: [f64; WIDE],
    /// Tension over length (N/m).
    weight: [f64; WIDE],
}

impl LegGroup {
    pub(super) const ZERO: Self = Self { v: [[0.0; WIDE]; ROWS], tension: [0.0; WIDE], weight: [0.0; WIDE] };

    /// Fills the groups of one element; `tensions` are those of its cables, in order.
    #[inline(always)]
    pub(super) fn fill<W: Columns>(w: W, span: &Span, holes: &[HoleGroup], tensions: &[f64], groups: &mut [Self]) {
        for ((group, hole), tensions) in groups.iter_mut().zip(holes).zip(tensions.chunks(WIDE)) {
            group.tension = [0.0; WIDE];
            group.tension[..tensions.len()].copy_from_slice(tensions);
            let mut c = 0;
            while c < WIDE {
                let leg = span.legs(w, w.load(&hole.y[c..]), w.load(&hole.z[c..]));
                for k in 0..3 {
                    w.store(leg.direction[k], &mut group.v[k][c..]);
                }
                for (at, force) in FORCE.iter().zip(&leg.forces) {
                    for k in 0..4 {
                        w.store(force[k], &mut group.v[at + k][c..]);
                    }
                }
                w.store(w.divide(w.load(&group.tension[c..]), leg.length), &mut group.weight[c..]);
                c += W::WIDTH;
            }
        }
    }
}

/// Sums over the cables of an element.
pub(super) struct Sums {
    /// `sum w v v^T`, upper triangle.
    pub(super) gram: [[f64; ROWS]; ROWS],
    /// `sum w [1, h_y, h_z, h_y^2, h_y h_z, h_z^2]`.
    pub(super) moments: [f64; 6],
    /// `sum u e [1, h_y, h_z]`.
    pub(super) pull: [[f64; 3]; 3],
}

impl Sums {
    #[inline(always)]
    pub(super) fn of<W: Columns>(w: W, holes: &[HoleGroup], groups: &[LegGroup]) -> Self {
        let mut sums = Self { gram: [[0.0; ROWS]; ROWS], moments: [0.0; 6], pull: [[0.0; 3]; 3] };
        let gram = &mut sums.gram;
        gram_row::<W, 0>(w, groups, gram);
        gram_row::<W, 1>(w, groups, gram);
        gram_row::<W, 2>(w, groups, gram);
        gram_row::<W, 3>(w, groups, gram);
        gram_row::<W, 4>(w, groups, gram);
        gram_row::<W, 5>(w, groups, gram);
        gram_row::<W, 6>(w, groups, gram);
        gram_row::<W, 7>(w, groups, gram);
        gram_row::<W, 8>(w, groups, gram);
        gram_row::<W, 9>(w, groups, gram);
        gram_row::<W, 10>(w, groups, gram);
        let zero = w.splat(0.0);
        let (mut moments, mut pull) = ([zero; 6], [[zero; 3]; 3]);
        for (group, hole) in groups.iter().zip(holes) {
            let mut c = 0;
            while c < WIDE {
                let (y, z) = (w.load(&hole.y[c..]), w.load(&hole.z[c..]));
                let weight = w.load(&group.weight[c..]);
                let (wy, wz) = (w.multiply(weight, y), w.multiply(weight, z));
                let one = w.splat(1.0);
                let factors = [(weight, one), (wy, one), (wz, one), (wy, y), (wy, z), (wz, z)];
                for k in 0..6 {
                    moments[k] = w.multiply_add(factors[k].0, factors[k].1, moments[k]);
                }
                let tension = w.load(&group.tension[c..]);
                for k in 0..3 {
                    let u = w.multiply(tension, w.load(&group.v[k][c..]));
                    pull[0][k] = w.multiply_add(u, one, pull[0][k]);
                    pull[1][k] = w.multiply_add(u, y, pull[1][k]);
                    pull[2][k] = w.multiply_add(u, z, pull[2][k]);
                }
                c += W::WIDTH;
            }
        }
        for k in 0..6 {
            sums.moments[k] = w.sum(moments[k]);
        }
        for k in 0..3 {
            for c in 0..3 {
                sums.pull[k][c] = w.sum(pull[k][c]);
            }
        }
        sums
    }
}

/// Row R of the upper triangle, its sums in registers meanwhile.
#[inline(always)]
fn gram_row<W: Columns, const R: usize>(w: W, groups: &[LegGroup], gram: &mut [[f64; ROWS]; ROWS]) {
    let mut sums = [w.splat(0.0); ROWS];
    for group in groups {
        let mut c = 0;
        while c < WIDE {
            let row = w.multiply(w.load(&group.weight[c..]), w.load(&group.v[R][c..]));
            for k in R..ROWS {
                sums[k] = w.multiply_add(row, w.load(&group.v[k][c..]), sums[k]);
            }
            c += W::WIDTH;
        }
    }
    for k in R..ROWS {
        gram[R][k] = w.sum(sums[k]);
    }
}
