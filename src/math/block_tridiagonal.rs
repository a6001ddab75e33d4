//! The total tangent S of (14) as blocks of a node each: equations and unknowns 11 per node, coupled to the neighbours.
//!
//! Enters: terms, added where they belong. Leaves: blocks, for the elimination in `chain`.
//!
//! The pattern: a node's equations see only the seven coordinates of the node before (`lower` has columns 0..7, and no row
//! for the norm constraint), and only its seven equations of motion see the node behind (`upper` has rows 0..7, and no
//! column for the norm multiplier).

use std::ops::{Index, IndexMut};

/// Unknowns per node: position 3, quaternion 4, chord multiplier 3, norm multiplier 1.
pub const BLOCK: usize = 11;
/// Row length in memory: whole vectors.
pub(super) const STRIDE: usize = 12;
/// Coordinates of a node, and its equations of motion.
pub const COORDINATES: usize = 7;

/// One block, row-major.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct Block(pub(super) [[f64; STRIDE]; BLOCK]);

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
