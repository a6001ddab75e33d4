//! The input matrix `B` of (8) and its products, read from the legs of a linearisation.
//!
//! Rows of coordinates only, 7 per node: a cable does not pull at a constraint. An element's cables give the node at its
//! end minus what they give the node before it in the positions, and each its own in the quaternions.

use super::arm::Arm;
use super::legs::{FORCE, GROUP, LegGroup, ROWS};
use super::linearize::Linearization;
use crate::math::block_tridiagonal::COORDINATES;
use crate::math::simd::{Columns, Lanes, Number, Scalars, dot};
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

impl Linearization {
    /// Writes `B`, row-major 7N x cables. Does not allocate.
    pub fn input_into(&self, arm: &Arm, out: &mut [f64]) {
        Arch::new().dispatch(Matrix { from: self, arm, out });
    }

    /// Writes `B T` for a matrix T (row-major cables x columns), row-major 7N x columns. Does not allocate.
    pub fn input_times_into(&self, arm: &Arm, t: &[f64], columns: usize, out: &mut [f64]) {
        Arch::new().dispatch(Product { from: self, arm, t, columns, out });
    }

    /// Writes the forces `B u` of tensions `u`, 7N. Does not allocate.
    pub fn force_into(&self, arm: &Arm, u: &[f64], out: &mut [f64]) {
        Arch::new().dispatch(Force { from: self, arm, u, out });
    }

    /// The k-th of the [`FILLED`] rows that element i's cables fill: which, from which row of `v`, with which factor; `None`
    /// at the base.
    #[inline(always)]
    fn filled(&self, i: usize, k: usize) -> Option<(usize, usize, f64)> {
        let r = k % COORDINATES;
        if k >= COORDINATES {
            let position = r < FORCE[0];
            let (source, factor) = if position { (r, -1.0) } else { (r - FORCE[0] + FORCE[1], -self.sign[i]) };
            Some((COORDINATES * i + r, source, factor))
        } else {
            (i > 0).then(|| (COORDINATES * (i - 1) + r, r, 1.0))
        }
    }
}

/// Rows of the input matrix that an element's cables fill: those of the node before it and of its end.
const FILLED: usize = 2 * COORDINATES;

struct Matrix<'a> {
    from: &'a Linearization,
    arm: &'a Arm,
    out: &'a mut [f64],
}

impl WithSimd for Matrix<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { from, arm, out } = self;
        let nc = arm.cable_count();
        out.fill(0.0);
        for (i, e) in arm.elements.iter().enumerate() {
            let (cables, legs) = (arm.cables(e), &from.legs[e.groups.clone()]);
            for k in 0..FILLED {
                let Some((row, source, factor)) = from.filled(i, k) else { continue };
                let row = &mut out[row * nc..][cables.clone()];
                for (group, row) in legs.iter().zip(row.chunks_mut(GROUP)) {
                    if row.len() == GROUP && GROUP.is_multiple_of(S::F64_LANES) {
                        add(Lanes(simd), factor, &group.0[source], row);
                    } else {
                        add(Scalars, factor, &group.0[source], row);
                    }
                }
            }
        }
    }
}

/// `row += factor v` over the row's length.
#[inline(always)]
fn add<W: Columns>(w: W, factor: f64, v: &[f64; GROUP], row: &mut [f64]) {
    let mut c = 0;
    while c < row.len() {
        let sum = w.splat(factor).multiply_add(w.load(&v[c..]), w.load(&row[c..]));
        w.store(sum, &mut row[c..]);
        c += W::WIDTH;
    }
}

struct Product<'a> {
    from: &'a Linearization,
    arm: &'a Arm,
    t: &'a [f64],
    columns: usize,
    out: &'a mut [f64],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { from, arm, t, columns, out } = self;
        out.fill(0.0);
        for (i, e) in arm.elements.iter().enumerate() {
            let (cables, legs) = (arm.cables(e), &from.legs[e.groups.clone()]);
            for k in 0..FILLED {
                let Some((row, source, factor)) = from.filled(i, k) else { continue };
                let row = &mut out[row * columns..(row + 1) * columns];
                let mut c = 0;
                while c < columns {
                    c += if c + S::F64_LANES > columns {
                        times(Scalars, legs, source, factor, t, columns, cables.clone(), c, row)
                    } else {
                        times(Lanes(simd), legs, source, factor, t, columns, cables.clone(), c, row)
                    };
                }
            }
        }
    }
}

/// Columns `c..` of `row += factor v T` for one row of `v`; returns how many were done.
#[inline(always)]
fn times<W: Columns>(
    w: W,
    legs: &[LegGroup],
    source: usize,
    factor: f64,
    t: &[f64],
    columns: usize,
    cables: Range<usize>,
    c: usize,
    row: &mut [f64],
) -> usize {
    let mut sum = w.load(&row[c..]);
    for (k, cable) in cables.enumerate() {
        let v = factor * legs[k / GROUP].0[source][k % GROUP];
        sum = w.splat(v).multiply_add(w.load(&t[cable * columns + c..]), sum);
    }
    w.store(sum, &mut row[c..]);
    W::WIDTH
}

struct Force<'a> {
    from: &'a Linearization,
    arm: &'a Arm,
    u: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for Force<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { from, arm, u, out } = self;
        out.fill(0.0);
        for (i, e) in arm.elements.iter().enumerate() {
            let mut pull = [0.0; ROWS];
            for (group, u) in from.legs[e.groups.clone()].iter().zip(u[arm.cables(e)].chunks(GROUP)) {
                let mut tensions = [0.0; GROUP];
                tensions[..u.len()].copy_from_slice(u);
                for r in 0..ROWS {
                    pull[r] += dot(simd, &group.0[r], &tensions);
                }
            }
            for k in 0..FILLED {
                if let Some((row, source, factor)) = from.filled(i, k) {
                    out[row] += factor * pull[source];
                }
            }
        }
    }
}
