//! Block-tridiagonal LU with 11x11 blocks: factor and solve in O(N) (design section 3).
//!
//! Enters: the total tangent S of (14) ordered node by node. Leaves: solutions for one right-hand side or for a panel
//! of them. The block elimination runs from base to tip; pivoting stays inside the diagonal blocks, which are regular
//! (each holds its node's own constraints). Not faer's sparse LU: it took 4 to 15 times as long on this pattern.

use nalgebra::{SMatrix, SVector};

/// Unknowns per node: position 3, quaternion 4, chord multiplier 3, norm multiplier 1.
pub const BLOCK: usize = 11;
/// One block.
pub type Block = SMatrix<f64, BLOCK, BLOCK>;
/// One node's share of a vector.
pub type BlockVector = SVector<f64, BLOCK>;

/// A block-tridiagonal matrix.
#[derive(Debug, Clone)]
pub struct BlockTridiagonal {
    /// Diagonal blocks, one per node.
    pub diagonal: Vec<Block>,
    /// `lower[i]`: rows of node i, columns of node i-1; `lower[0]` is unused.
    pub lower: Vec<Block>,
    /// `upper[i]`: rows of node i, columns of node i+1; the last one is unused.
    pub upper: Vec<Block>,
}

/// A diagonal block was singular at this node (0-based) to working precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the tangent is singular at node {0}")]
pub struct Singular(pub usize);

impl BlockTridiagonal {
    /// Zero matrix of `nodes` block rows. Allocates.
    pub fn zeros(nodes: usize) -> Self {
        Self {
            diagonal: vec![Block::zeros(); nodes],
            lower: vec![Block::zeros(); nodes],
            upper: vec![Block::zeros(); nodes],
        }
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
        self.diagonal.iter_mut().chain(&mut self.lower).chain(&mut self.upper).for_each(|b| b.fill(0.0));
    }

    /// `y = A x`, both of length 11 N.
    pub fn multiply_into(&self, x: &[f64], y: &mut [f64]) {
        let n = self.len();
        for i in 0..n {
            let mut s = self.diagonal[i] * part(x, i);
            if i > 0 {
                s += self.lower[i] * part(x, i - 1);
            }
            if i + 1 < n {
                s += self.upper[i] * part(x, i + 1);
            }
            y[i * BLOCK..(i + 1) * BLOCK].copy_from_slice(s.as_slice());
        }
    }
}

#[inline]
fn part(x: &[f64], i: usize) -> BlockVector {
    BlockVector::from_column_slice(&x[i * BLOCK..(i + 1) * BLOCK])
}

/// Factorisation of a [`BlockTridiagonal`]; all memory is made by [`Factor::new`].
#[derive(Debug, Clone)]
pub struct Factor {
    /// Inverses of the reduced diagonal blocks.
    inverse: Vec<Block>,
    /// `inverse[i] upper[i]`.
    coupling: Vec<Block>,
    /// Copy of the lower blocks.
    lower: Vec<Block>,
}

impl Factor {
    /// Room for `nodes` block rows. Allocates.
    pub fn new(nodes: usize) -> Self {
        let zeros = vec![Block::zeros(); nodes];
        Self { inverse: zeros.clone(), coupling: zeros.clone(), lower: zeros }
    }

    /// Factors `a`. Does not allocate.
    ///
    /// # Errors
    /// A reduced diagonal block is singular or not finite.
    pub fn factor(&mut self, a: &BlockTridiagonal) -> Result<(), Singular> {
        let n = a.len();
        for i in 0..n {
            let mut d = a.diagonal[i];
            if i > 0 {
                d -= a.lower[i] * self.coupling[i - 1];
                self.lower[i] = a.lower[i];
            }
            let inverse = d.try_inverse().ok_or(Singular(i))?;
            if !inverse.iter().all(|v| v.is_finite()) {
                return Err(Singular(i));
            }
            if i + 1 < n {
                self.coupling[i] = inverse * a.upper[i];
            }
            self.inverse[i] = inverse;
        }
        Ok(())
    }

    /// Solves in place for one right-hand side of length 11 N. Does not allocate.
    pub fn solve_in_place(&self, x: &mut [f64]) {
        let n = self.inverse.len();
        for i in 0..n {
            let mut s = part(x, i);
            if i > 0 {
                s -= self.lower[i] * part(x, i - 1);
            }
            x[i * BLOCK..(i + 1) * BLOCK].copy_from_slice((self.inverse[i] * s).as_slice());
        }
        for i in (0..n.saturating_sub(1)).rev() {
            let s = part(x, i) - self.coupling[i] * part(x, i + 1);
            x[i * BLOCK..(i + 1) * BLOCK].copy_from_slice(s.as_slice());
        }
    }

    /// Solves in place for a panel of `columns` right-hand sides, row-major (11 N x columns); `scratch` holds at
    /// least `11 * columns` numbers. Does not allocate.
    pub fn solve_panel_in_place(&self, columns: usize, x: &mut [f64], scratch: &mut [f64]) {
        let n = self.inverse.len();
        let rows = BLOCK * columns;
        let scratch = &mut scratch[..rows];
        for i in 0..n {
            let (before, rest) = x.split_at_mut(i * rows);
            let here = &mut rest[..rows];
            if i > 0 {
                subtract_product(&self.lower[i], &before[(i - 1) * rows..], here, columns);
            }
            scratch.fill(0.0);
            add_product(&self.inverse[i], here, scratch, columns);
            here.copy_from_slice(scratch);
        }
        for i in (0..n.saturating_sub(1)).rev() {
            let (before, rest) = x.split_at_mut((i + 1) * rows);
            subtract_product(&self.coupling[i], &rest[..rows], &mut before[i * rows..], columns);
        }
    }
}

/// `y += a x` for row-major panels of 11 rows.
fn add_product(a: &Block, x: &[f64], y: &mut [f64], columns: usize) {
    for r in 0..BLOCK {
        let out = &mut y[r * columns..(r + 1) * columns];
        for k in 0..BLOCK {
            let f = a[(r, k)];
            if f != 0.0 {
                for (o, v) in out.iter_mut().zip(&x[k * columns..(k + 1) * columns]) {
                    *o += f * v;
                }
            }
        }
    }
}

/// `y -= a x` for row-major panels of 11 rows.
fn subtract_product(a: &Block, x: &[f64], y: &mut [f64], columns: usize) {
    for r in 0..BLOCK {
        let out = &mut y[r * columns..(r + 1) * columns];
        for k in 0..BLOCK {
            let f = a[(r, k)];
            if f != 0.0 {
                for (o, v) in out.iter_mut().zip(&x[k * columns..(k + 1) * columns]) {
                    *o -= f * v;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    fn random(nodes: usize, seed: u64) -> BlockTridiagonal {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut a = BlockTridiagonal::zeros(nodes);
        for b in a.diagonal.iter_mut().chain(&mut a.lower).chain(&mut a.upper) {
            b.iter_mut().for_each(|v| *v = rng.random_range(-1.0..1.0));
        }
        for b in &mut a.diagonal {
            *b += Block::identity() * 4.0;
        }
        a
    }

    #[test]
    fn solutions_satisfy_the_system_for_vectors_and_panels() {
        for nodes in [1, 2, 20] {
            let a = random(nodes, 7);
            let mut factor = Factor::new(nodes);
            factor.factor(&a).unwrap();
            let columns = 5;
            let rhs: Vec<f64> = (0..nodes * BLOCK * columns).map(|k| (k as f64 * 0.37).sin()).collect();
            let mut panel = rhs.clone();
            factor.solve_panel_in_place(columns, &mut panel, &mut vec![0.0; BLOCK * columns]);
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
    fn singular_and_non_finite_blocks_are_refused_with_their_node() {
        let mut a = random(3, 1);
        a.diagonal[0].fill_row(2, 0.0);
        a.upper[0].fill(0.0);
        assert_eq!(Factor::new(3).factor(&a), Err(Singular(0)));
        let mut a = random(3, 1);
        a.diagonal[2][(4, 4)] = f64::NAN;
        assert_eq!(Factor::new(3).factor(&a), Err(Singular(2)));
    }
}
