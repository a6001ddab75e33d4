//! Block-tridiagonal LU with 11x11 blocks: factor and solve in O(N) (design section 3).
//!
//! Enters: the total tangent S of (14) ordered node by node. Leaves: solutions for one right-hand side or for a panel
//! of them. The block elimination runs from base to tip; pivoting stays inside the diagonal blocks, which are regular
//! (each holds its node's own constraints). Not faer's sparse LU: it took 4 to 15 times as long on this pattern.
//!
//! Two facts of the pattern are used: a node's equations see only the seven coordinates of the node before
//! (`lower` has columns 0..7, and no row for the norm constraint), and only its seven equations of motion see the node
//! behind (`upper` has rows 0..7, and no column for the norm multiplier).

use super::simd::{Columns, Lanes, Scalars};
use pulp::{Arch, Simd, WithSimd};
use std::ops::{Index, IndexMut};

/// Unknowns per node: position 3, quaternion 4, chord multiplier 3, norm multiplier 1.
pub const BLOCK: usize = 11;
/// Row length in memory: whole vectors.
const STRIDE: usize = 12;
/// Coordinates of a node, and its equations of motion.
const COORDINATES: usize = 7;
/// Unknowns without the norm multiplier; equations without the norm constraint.
const COUPLED: usize = 10;

/// One block, row-major.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct Block([[f64; STRIDE]; BLOCK]);

impl Block {
    /// All zero.
    pub const ZERO: Self = Self([[0.0; STRIDE]; BLOCK]);

    /// Adds `factor * m` with its corner at (row, column).
    #[inline(always)]
    pub fn add<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        m: &nalgebra::SMatrix<f64, R, C>,
        factor: f64,
    ) {
        for r in 0..R {
            for c in 0..C {
                self.0[row + r][column + c] += factor * m[(r, c)];
            }
        }
    }

    /// Writes `factor * m` with its corner at (row, column).
    #[inline(always)]
    pub fn set<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        m: &nalgebra::SMatrix<f64, R, C>,
        factor: f64,
    ) {
        for r in 0..R {
            for c in 0..C {
                self.0[row + r][column + c] = factor * m[(r, c)];
            }
        }
    }

    /// Writes `factor * m^T` with its corner at (row, column).
    #[inline(always)]
    pub fn set_transposed<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        m: &nalgebra::SMatrix<f64, R, C>,
        factor: f64,
    ) {
        for r in 0..R {
            for c in 0..C {
                self.0[row + c][column + r] = factor * m[(r, c)];
            }
        }
    }

    /// Adds `factor * m^T` with its corner at (row, column).
    #[inline(always)]
    pub fn add_transposed<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        m: &nalgebra::SMatrix<f64, R, C>,
        factor: f64,
    ) {
        for r in 0..R {
            for c in 0..C {
                self.0[row + c][column + r] += factor * m[(r, c)];
            }
        }
    }
}

impl Index<(usize, usize)> for Block {
    type Output = f64;
    #[inline(always)]
    fn index(&self, (r, c): (usize, usize)) -> &f64 {
        debug_assert!(c < BLOCK);
        &self.0[r][c]
    }
}

impl IndexMut<(usize, usize)> for Block {
    #[inline(always)]
    fn index_mut(&mut self, (r, c): (usize, usize)) -> &mut f64 {
        debug_assert!(c < BLOCK);
        &mut self.0[r][c]
    }
}

/// A block-tridiagonal matrix with the pattern described above.
#[derive(Debug, Clone)]
pub struct BlockTridiagonal {
    /// Diagonal blocks, one per node.
    pub diagonal: Vec<Block>,
    /// `lower[i]`: rows of node i (0..10), columns of node i-1 (0..7); `lower[0]` is unused.
    pub lower: Vec<Block>,
    /// `upper[i]`: rows of node i (0..7), columns of node i+1 (0..10); the last one is unused.
    pub upper: Vec<Block>,
}

/// A diagonal block was singular at this node (0-based) to working precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the tangent is singular at node {0}")]
pub struct Singular(pub usize);

impl BlockTridiagonal {
    /// Zero matrix of `nodes` block rows. Allocates.
    pub fn zeros(nodes: usize) -> Self {
        let zeros = vec![Block::ZERO; nodes];
        Self { diagonal: zeros.clone(), lower: zeros.clone(), upper: zeros }
    }

    /// Number of block rows.
    pub fn len(&self) -> usize {
        self.diagonal.len()
    }

    /// True without block rows.
    pub fn is_empty(&self) -> bool {
        self.diagonal.is_empty()
    }

    /// Sets all entries to zero.
    pub fn clear(&mut self) {
        self.diagonal.fill(Block::ZERO);
        self.lower.fill(Block::ZERO);
        self.upper.fill(Block::ZERO);
    }

    /// `y = A x`, both of length 11 N.
    pub fn multiply_into(&self, x: &[f64], y: &mut [f64]) {
        let n = self.len();
        let dot = |block: &Block, r: usize, i: usize| -> f64 {
            block.0[r].iter().zip(&x[i * BLOCK..(i + 1) * BLOCK]).map(|(a, x)| a * x).sum()
        };
        for i in 0..n {
            for r in 0..BLOCK {
                let mut s = dot(&self.diagonal[i], r, i);
                if i > 0 {
                    s += dot(&self.lower[i], r, i - 1);
                }
                if i + 1 < n {
                    s += dot(&self.upper[i], r, i + 1);
                }
                y[i * BLOCK + r] = s;
            }
        }
    }
}

/// Factorisation of a [`BlockTridiagonal`]; all memory is made by [`Factor::new`].
#[derive(Debug, Clone)]
pub struct Factor {
    /// Inverses of the reduced diagonal blocks.
    inverse: Vec<Block>,
    /// `inverse[i] upper[i]`: columns 0..10.
    coupling: Vec<Block>,
    /// Copy of the lower blocks.
    lower: Vec<Block>,
}

impl Factor {
    /// Room for `nodes` block rows. Allocates.
    pub fn new(nodes: usize) -> Self {
        let zeros = vec![Block::ZERO; nodes];
        Self { inverse: zeros.clone(), coupling: zeros.clone(), lower: zeros }
    }

    /// Factors `a`. Does not allocate.
    ///
    /// # Errors
    /// A reduced diagonal block is singular or not finite.
    pub fn factor(&mut self, a: &BlockTridiagonal) -> Result<(), Singular> {
        Arch::new().dispatch(Factoring { factor: self, a })
    }

    /// Solves in place for one right-hand side of length 11 N. Does not allocate.
    pub fn solve_in_place(&self, x: &mut [f64]) {
        let n = self.inverse.len();
        for i in 0..n {
            let (before, here) = x.split_at_mut(i * BLOCK);
            let mut s = [0.0; STRIDE];
            s[..BLOCK].copy_from_slice(&here[..BLOCK]);
            if i > 0 {
                let y: &[f64] = &before[(i - 1) * BLOCK..];
                for (s, row) in s[..COUPLED].iter_mut().zip(&self.lower[i].0) {
                    *s -= (0..COORDINATES).map(|k| row[k] * y[k]).sum::<f64>();
                }
            }
            for (h, row) in here.iter_mut().zip(&self.inverse[i].0) {
                *h = row.iter().zip(&s).map(|(a, s)| a * s).sum();
            }
        }
        for i in (0..n.saturating_sub(1)).rev() {
            let (before, after) = x.split_at_mut((i + 1) * BLOCK);
            for (h, row) in before[i * BLOCK..].iter_mut().zip(&self.coupling[i].0) {
                *h -= row[..COUPLED].iter().zip(&*after).map(|(a, x)| a * x).sum::<f64>();
            }
        }
    }

    /// Solves in place for a panel of `columns` right-hand sides, row-major (11 N x columns). `leading[i]` columns from
    /// the first on may be non-zero in the nodes up to i, the others are zero there and skipped. Does not allocate.
    ///
    /// # Panics
    /// If `leading` is shorter than the number of nodes, or the panel than 11 N x columns.
    pub fn solve_panel_in_place(&self, columns: usize, leading: &[usize], x: &mut [f64]) {
        Arch::new().dispatch(Panel { factor: self, columns, leading, x });
    }
}

/// [`Factor::factor`] with the processor's vectors.
struct Factoring<'a> {
    factor: &'a mut Factor,
    a: &'a BlockTridiagonal,
}

impl WithSimd for Factoring<'_> {
    type Output = Result<(), Singular>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { factor, a } = self;
        for i in 0..a.len() {
            let mut d = a.diagonal[i];
            if i > 0 {
                factor.lower[i] = a.lower[i];
                let coupling = &factor.coupling[i - 1];
                for r in 0..COUPLED {
                    let f = a.lower[i].0[r];
                    combine_rows(simd, std::array::from_fn(|k| -f[k]), coupling, &mut d.0[r]);
                }
            }
            if !invert(simd, &mut d) {
                return Err(Singular(i));
            }
            let coupling = &mut factor.coupling[i];
            for r in 0..BLOCK {
                coupling.0[r] = [0.0; STRIDE];
                let f = d.0[r];
                combine_rows(simd, std::array::from_fn(|k| f[k]), &a.upper[i], &mut coupling.0[r]);
            }
            factor.inverse[i] = d;
        }
        Ok(())
    }
}

/// `y += sum f_k x_k` over the first rows of a block, every number of `y` kept in a register meanwhile.
#[inline(always)]
fn combine_rows<S: Simd>(simd: S, f: [f64; COORDINATES], x: &Block, y: &mut [f64; STRIDE]) {
    let (y, y_end) = S::as_mut_simd_f64s(y);
    for (v, y) in y.iter_mut().enumerate() {
        let mut sum = *y;
        for k in 0..COORDINATES {
            sum = simd.mul_add_e_f64s(simd.splat_f64s(f[k]), S::as_simd_f64s(&x.0[k]).0[v], sum);
        }
        *y = sum;
    }
    let done = STRIDE - y_end.len();
    for (c, y) in y_end.iter_mut().enumerate() {
        for k in 0..COORDINATES {
            *y += f[k] * x.0[k][done + c];
        }
    }
}

/// Row k is zero in column k and one elsewhere.
const OTHERS: [[f64; STRIDE]; BLOCK] = {
    let mut m = [[1.0; STRIDE]; BLOCK];
    let mut k = 0;
    while k < BLOCK {
        m[k][k] = 0.0;
        k += 1;
    }
    m
};

/// Row k is one in column k and zero elsewhere.
const UNIT: [[f64; STRIDE]; BLOCK] = {
    let mut m = [[0.0; STRIDE]; BLOCK];
    let mut k = 0;
    while k < BLOCK {
        m[k][k] = 1.0;
        k += 1;
    }
    m
};

/// `y = f (y o mask + add)`, entry by entry.
#[inline(always)]
fn scale_masked<S: Simd>(simd: S, f: f64, mask: &[f64; STRIDE], add: &[f64; STRIDE], y: &mut [f64; STRIDE]) {
    let (y, y_end) = S::as_mut_simd_f64s(y);
    let ((m, m_end), (a, a_end)) = (S::as_simd_f64s(mask), S::as_simd_f64s(add));
    let factor = simd.splat_f64s(f);
    for (v, y) in y.iter_mut().enumerate() {
        *y = simd.mul_f64s(factor, simd.mul_add_e_f64s(*y, m[v], a[v]));
    }
    for (c, y) in y_end.iter_mut().enumerate() {
        *y = f * (*y * m_end[c] + a_end[c]);
    }
}

/// `y = y o mask + f x`, entry by entry.
#[inline(always)]
fn add_masked<S: Simd>(simd: S, f: f64, x: &[f64; STRIDE], mask: &[f64; STRIDE], y: &mut [f64; STRIDE]) {
    let (y, y_end) = S::as_mut_simd_f64s(y);
    let ((m, m_end), (x, x_end)) = (S::as_simd_f64s(mask), S::as_simd_f64s(x));
    let factor = simd.splat_f64s(f);
    for (v, y) in y.iter_mut().enumerate() {
        *y = simd.mul_add_e_f64s(factor, x[v], simd.mul_f64s(*y, m[v]));
    }
    for (c, y) in y_end.iter_mut().enumerate() {
        *y = f * x_end[c] + *y * m_end[c];
    }
}

/// Gauss-Jordan with row pivoting, in place; false where a pivot is zero or not finite.
///
/// A single number is never written into a row that a vector reads next: the processor would have to wait until the
/// write has left its store buffer. Column k is therefore cleared by a mask, which halves the time of a factorisation.
#[inline(always)]
fn invert<S: Simd>(simd: S, d: &mut Block) -> bool {
    let m = &mut d.0;
    let mut order = [0usize; BLOCK];
    for k in 0..BLOCK {
        let mut pivot = k;
        for r in k + 1..BLOCK {
            if m[r][k].abs() > m[pivot][k].abs() {
                pivot = r;
            }
        }
        order[k] = pivot;
        if pivot != k {
            m.swap(k, pivot);
        }
        let p = m[k][k];
        if !(p != 0.0 && p.is_finite()) {
            return false;
        }
        scale_masked(simd, 1.0 / p, &OTHERS[k], &UNIT[k], &mut m[k]);
        let row = m[k];
        for (r, other) in m.iter_mut().enumerate() {
            if r != k {
                add_masked(simd, -other[k], &row, &OTHERS[k], other);
            }
        }
    }
    // Row swaps of the matrix are column swaps of its inverse, undone last to first.
    for k in (0..BLOCK).rev() {
        if order[k] != k {
            for row in m.iter_mut() {
                row.swap(k, order[k]);
            }
        }
    }
    // Zero times anything finite is zero.
    let mut sum = [0.0; STRIDE];
    for row in m.iter() {
        let (sum, sum_end) = S::as_mut_simd_f64s(&mut sum);
        let (row, row_end) = S::as_simd_f64s(row);
        for (s, v) in sum.iter_mut().zip(row) {
            *s = simd.mul_add_e_f64s(*v, simd.splat_f64s(0.0), *s);
        }
        sum_end.iter_mut().zip(row_end).for_each(|(s, v)| *s += 0.0 * v);
    }
    sum.iter().all(|s| *s == 0.0)
}

/// [`Factor::solve_panel_in_place`] with the processor's vectors.
struct Panel<'a> {
    factor: &'a Factor,
    columns: usize,
    leading: &'a [usize],
    x: &'a mut [f64],
}

impl WithSimd for Panel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { factor, columns, leading, x } = self;
        let n = factor.inverse.len();
        let rows = BLOCK * columns;
        for i in 0..n {
            let (before, here) = x.split_at_mut(i * rows);
            // Of the node before, only its own leading columns are non-zero.
            let coupled = if i > 0 { leading[i - 1].min(columns) } else { 0 };
            let y = if i > 0 { &before[(i - 1) * rows..] } else { &[][..] };
            let (lower, inverse) = (&factor.lower[i], &factor.inverse[i]);
            let mut c = 0;
            let active = leading[i].min(columns);
            while c < active {
                let tail = c + S::F64_LANES > columns;
                let y = (c < coupled).then_some(y);
                c += if tail {
                    forward(Scalars, lower, inverse, columns, c, y, &mut here[..rows])
                } else {
                    forward(Lanes(simd), lower, inverse, columns, c, y, &mut here[..rows])
                };
            }
        }
        for i in (0..n.saturating_sub(1)).rev() {
            let (before, after) = x.split_at_mut((i + 1) * rows);
            let here = &mut before[i * rows..];
            let coupling = &factor.coupling[i];
            let mut c = 0;
            while c < columns {
                c += if c + S::F64_LANES > columns {
                    backward(Scalars, coupling, columns, c, after, here)
                } else {
                    backward(Lanes(simd), coupling, columns, c, after, here)
                };
            }
        }
    }
}

/// Columns `c..` of one node: `here = inverse * (here - lower * y)`; returns how many were done.
#[inline(always)]
fn forward<C: Columns>(
    w: C,
    lower: &Block,
    inverse: &Block,
    columns: usize,
    c: usize,
    y: Option<&[f64]>,
    here: &mut [f64],
) -> usize {
    let mut s = [w.splat(0.0); BLOCK];
    for r in 0..BLOCK {
        s[r] = w.load(&here[r * columns + c..]);
    }
    if let Some(y) = y {
        for k in 0..COORDINATES {
            let v = w.load(&y[k * columns + c..]);
            for r in 0..COUPLED {
                s[r] = w.multiply_add(w.splat(-lower.0[r][k]), v, s[r]);
            }
        }
    }
    let mut out = [w.splat(0.0); BLOCK];
    for k in 0..BLOCK {
        for r in 0..BLOCK {
            out[r] = w.multiply_add(w.splat(inverse.0[r][k]), s[k], out[r]);
        }
    }
    for r in 0..BLOCK {
        w.store(out[r], &mut here[r * columns + c..]);
    }
    C::WIDTH
}

/// Columns `c..` of one node: `here -= coupling * after`; returns how many were done.
#[inline(always)]
fn backward<C: Columns>(w: C, coupling: &Block, columns: usize, c: usize, after: &[f64], here: &mut [f64]) -> usize {
    let mut s = [w.splat(0.0); BLOCK];
    for r in 0..BLOCK {
        s[r] = w.load(&here[r * columns + c..]);
    }
    for k in 0..COUPLED {
        let v = w.load(&after[k * columns + c..]);
        for r in 0..BLOCK {
            s[r] = w.multiply_add(w.splat(-coupling.0[r][k]), v, s[r]);
        }
    }
    for r in 0..BLOCK {
        w.store(s[r], &mut here[r * columns + c..]);
    }
    C::WIDTH
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    fn random(nodes: usize, seed: u64) -> BlockTridiagonal {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut a = BlockTridiagonal::zeros(nodes);
        for i in 0..nodes {
            for r in 0..BLOCK {
                for c in 0..BLOCK {
                    a.diagonal[i][(r, c)] = rng.random_range(-1.0..1.0);
                    if r < COUPLED && c < COORDINATES {
                        a.lower[i][(r, c)] = rng.random_range(-0.3..0.3);
                    }
                    if r < COORDINATES && c < COUPLED {
                        a.upper[i][(r, c)] = rng.random_range(-0.3..0.3);
                    }
                }
                // Off the diagonal: without row pivoting the inverse would fail.
                a.diagonal[i][(r, (r + 3) % BLOCK)] += 4.0;
            }
        }
        a
    }

    #[test]
    fn solutions_satisfy_the_system_for_vectors_and_panels() {
        for (nodes, columns) in [(1, 1), (2, 4), (20, 5), (20, 24)] {
            let a = random(nodes, 7);
            let mut factor = Factor::new(nodes);
            factor.factor(&a).unwrap();
            let rhs: Vec<f64> = (0..nodes * BLOCK * columns).map(|k| (k as f64 * 0.37).sin()).collect();
            let mut panel = rhs.clone();
            factor.solve_panel_in_place(columns, &vec![columns; nodes], &mut panel);
            for c in 0..columns {
                let column = |m: &[f64]| (0..nodes * BLOCK).map(|r| m[r * columns + c]).collect::<Vec<_>>();
                let mut one = column(&rhs);
                factor.solve_in_place(&mut one);
                let mut back = vec![0.0; nodes * BLOCK];
                a.multiply_into(&one, &mut back);
                for (r, (x, y)) in one.iter().zip(column(&panel)).enumerate() {
                    assert!((x - y).abs() < 1e-12);
                    assert!((back[r] - rhs[r * columns + c]).abs() < 1e-11);
                }
            }
        }
    }

    #[test]
    fn skipping_leading_zeros_changes_nothing() {
        let (nodes, columns) = (7, 6);
        let a = random(nodes, 3);
        let mut factor = Factor::new(nodes);
        factor.factor(&a).unwrap();
        // Column c begins at node c.
        let leading: Vec<usize> = (0..nodes).map(|i| (i + 1).min(columns)).collect();
        let mut rhs = vec![0.0; nodes * BLOCK * columns];
        for i in 0..nodes {
            for r in 0..BLOCK {
                for c in 0..leading[i] {
                    rhs[(i * BLOCK + r) * columns + c] = ((i * 31 + r * 7 + c) as f64).cos();
                }
            }
        }
        let mut all = rhs.clone();
        factor.solve_panel_in_place(columns, &vec![columns; nodes], &mut all);
        factor.solve_panel_in_place(columns, &leading, &mut rhs);
        assert!(rhs.iter().zip(&all).all(|(x, y)| (x - y).abs() < 1e-13));
    }

    #[test]
    fn singular_and_non_finite_blocks_are_refused_with_their_node() {
        let mut a = random(3, 1);
        (0..BLOCK).for_each(|c| a.diagonal[0][(2, c)] = 0.0);
        assert_eq!(Factor::new(3).factor(&a), Err(Singular(0)));
        let mut a = random(3, 1);
        a.diagonal[2][(4, 4)] = f64::NAN;
        assert_eq!(Factor::new(3).factor(&a), Err(Singular(2)));
    }
}
