//! Systems of a chain of nodes with constraints, 11 unknowns each: factor and solve in O(N) (design section 3).
//!
//! Enters: the total tangent S of (14) ordered node by node, as blocks. Leaves: solutions for one right-hand side, or for a
//! panel of them.
//!
//! A node's four constraints (the chord to the node before, its quaternion's norm) leave it three directions `Z` to move in.
//! From tip to base each node is expressed by the one before it and `Z`; what is solved is the motion along `Z`, 3x3 per
//! node (the recursion of articulated bodies, Featherstone 2008, on a tangent that need not be symmetric, with multipliers).
//! That is less than half the work of eliminating 11x11 blocks, and a panel needs no multipliers at all. Pivots are the 3x3
//! matrices: inertia over the step's square plus stiffness, regular but where an equilibrium loses its stability. Not faer's
//! sparse LU: it took 4 to 15 times as long as even those blocks (design, section 9).
//!
//! What is used of the pattern: the chord moves one to one with the node's position and against that of the node before,
//! columns of multipliers are the transposed rows of constraints, and all of them have one scale.

use super::block_tridiagonal::{BLOCK, BlockTridiagonal, COORDINATES, STRIDE};
use super::simd::{Columns, Lanes, Number, Scalars};
use pulp::{Arch, Simd, WithSimd};

/// Rows of eight: seven coordinates and a zero.
type Row = [f64; WIDE];
const WIDE: usize = 8;
/// Rows of four: three directions of the tangent space of a node's constraints, and a zero.
type Narrow = [f64; 4];

/// Eliminates what a block's row holds behind the coordinates.
const ONLY_COORDINATES: Row = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0];

/// What is kept of a node for the solves. With the node before at `y`, its constraints leave `x = x_0 + T_0 y + Z z`; the
/// motion along `Z` gives `z = Y (b - K x_0) - H y`.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
struct Node {
    /// `K` of this node's equations of motion, all nodes behind it eliminated.
    k: [Row; COORDINATES],
    /// Its equations' coupling to the node before.
    l: [Row; COORDINATES],
    /// Coupling of the node before to this one, multipliers eliminated.
    w: [Row; COORDINATES],
    /// `Z`, and `W Z`.
    z: [Narrow; COORDINATES],
    wz: [Narrow; COORDINATES],
    y: [Row; 3],
    h: [Row; 3],
    /// The chord's derivative by the quaternions of the node before and of this one; by the positions it is -1 and 1.
    before: [Narrow; 3],
    here: [Narrow; 3],
    /// The quaternion: half of the norm's derivative.
    p: Narrow,
    /// Scaling of the multipliers' rows and columns.
    scale: f64,
}

impl Node {
    const ZERO: Self = Self {
        k: [[0.0; WIDE]; COORDINATES],
        l: [[0.0; WIDE]; COORDINATES],
        w: [[0.0; WIDE]; COORDINATES],
        z: [[0.0; 4]; COORDINATES],
        wz: [[0.0; 4]; COORDINATES],
        y: [[0.0; WIDE]; 3],
        h: [[0.0; WIDE]; 3],
        before: [[0.0; 4]; 3],
        here: [[0.0; 4]; 3],
        p: [0.0; 4],
        scale: 0.0,
    };

    /// The coordinates with the node before at `y`, but for what `Z` adds.
    #[inline(always)]
    fn follow(&self, y: &Row) -> Row {
        let mut x = [0.0; WIDE];
        for c in 0..3 {
            x[c] = y[c] - (0..4).map(|q| self.before[c][q] * y[3 + q]).sum::<f64>();
        }
        x
    }

    /// Adds `Z z`.
    #[inline(always)]
    fn add_along(&self, z: [f64; 3], x: &mut Row) {
        for (x, row) in x.iter_mut().zip(&self.z) {
            *x += row[0] * z[0] + row[1] * z[1] + row[2] * z[2];
        }
    }
}

/// What is left of the equations of motion at this node (0-based) is singular to working precision, or not finite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the tangent is singular at node {0}")]
pub struct Singular(pub usize);

/// Factorisation of a [`BlockTridiagonal`]; all memory is made by [`Factor::new`].
#[derive(Debug, Clone)]
pub struct Factor {
    nodes: Vec<Node>,
    /// Right-hand sides of the equations of motion, all nodes behind eliminated, of the solve at work.
    load: Vec<Row>,
}

impl Factor {
    /// Room for `nodes` block rows. Allocates.
    pub fn new(nodes: usize) -> Self {
        Self { nodes: vec![Node::ZERO; nodes], load: vec![[0.0; WIDE]; nodes] }
    }

    /// Factors `a`. Does not allocate.
    ///
    /// # Errors
    /// What is left of a node's equations of motion is singular or not finite.
    pub fn factor(&mut self, a: &BlockTridiagonal) -> Result<(), Singular> {
        Arch::new().dispatch(Factoring { factor: self, a })
    }

    /// Solves in place for one right-hand side of length 11 N. Does not allocate.
    pub fn solve_in_place(&mut self, x: &mut [f64]) {
        Arch::new().dispatch(Solving { factor: self, x });
    }

    /// Solves in place for a panel of `columns` right-hand sides that are zero in all constraints: rows of coordinates
    /// only, row-major (7 N x columns). Columns before `first[i]` are zero in node i and all behind it and skipped there.
    /// Does not allocate.
    ///
    /// # Panics
    /// If `first` is shorter than the number of nodes, or the panel than 7 N x columns.
    pub fn solve_panel_in_place(&self, columns: usize, first: &[usize], x: &mut [f64]) {
        Arch::new().dispatch(Panel { factor: self, columns, first, x });
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
        // Of the node behind: what it adds to this one's equations of motion.
        let mut added = [[0.0; WIDE]; COORDINATES];
        for i in (0..a.len()).rev() {
            let node = &mut factor.nodes[i];
            let (diagonal, lower) = (&a.diagonal[i].0, &a.lower[i].0);
            let scale = diagonal[COORDINATES][0];
            let inverse_scale = 1.0 / scale;
            node.scale = scale;
            for r in 0..COORDINATES {
                node.k[r] = added[r];
                add_coordinates(simd, &diagonal[r], &mut node.k[r]);
            }
            for c in 0..3 {
                let (before, here) = (&lower[COORDINATES + c], &diagonal[COORDINATES + c]);
                for q in 0..4 {
                    node.before[c][q] = before[3 + q] * inverse_scale;
                    node.here[c][q] = here[3 + q] * inverse_scale;
                }
            }
            for q in 0..4 {
                node.p[q] = 0.5 * diagonal[BLOCK - 1][3 + q] * inverse_scale;
            }
            // Z: the quaternion along p e_k, the position where the chord then leaves it.
            let [pw, px, py, pz] = node.p;
            let turns = [[-px, -py, -pz, 0.0], [pw, -pz, py, 0.0], [pz, pw, -px, 0.0], [-py, px, pw, 0.0]];
            for c in 0..3 {
                for k in 0..3 {
                    node.z[c][k] = -(0..4).map(|q| node.here[c][q] * turns[q][k]).sum::<f64>();
                }
            }
            node.z[3..].copy_from_slice(&turns);
            let mut along = [[0.0; WIDE]; 3];
            for k in 0..3 {
                for r in 0..COORDINATES {
                    along[k][r] = node.z[r][k];
                }
            }
            // A = Z^T K Z.
            let (mut zk, mut reduced) = ([[0.0; WIDE]; 3], [[0.0; 4]; 3]);
            for k in 0..3 {
                accumulate(simd, column(&node.z, k), rows(&node.k), &mut zk[k]);
                accumulate(simd, seven(&zk[k]), rows(&node.z), &mut reduced[k]);
            }
            let Some(inverse) = inverse3(&reduced) else { return Err(Singular(i)) };
            for k in 0..3 {
                node.y[k] = [0.0; WIDE];
                accumulate(simd, inverse[k], [&along[0], &along[1], &along[2]], &mut node.y[k]);
            }
            if i == 0 {
                break;
            }
            // T_0: the position follows that of the node before and its turn.
            let mut follow = [[0.0; WIDE]; 3];
            for c in 0..3 {
                follow[c][c] = 1.0;
                for q in 0..4 {
                    follow[c][3 + q] = -node.before[c][q];
                }
            }
            for r in 0..COORDINATES {
                node.l[r] = [0.0; WIDE];
                add_coordinates(simd, &lower[r], &mut node.l[r]);
            }
            // H = A^-1 Z^T (K T_0 + L).
            let mut coupled = [[0.0; WIDE]; 3];
            for k in 0..3 {
                accumulate(simd, three(&zk[k]), [&follow[0], &follow[1], &follow[2]], &mut coupled[k]);
                accumulate(simd, column(&node.z, k), rows(&node.l), &mut coupled[k]);
            }
            for k in 0..3 {
                node.h[k] = [0.0; WIDE];
                accumulate(simd, inverse[k], [&coupled[0], &coupled[1], &coupled[2]], &mut node.h[k]);
            }
            // W = U + T_0^T K, and what the node before gets: T_0^T L + W (T_0 - Z H).
            let upper = &a.upper[i - 1].0;
            for r in 0..COORDINATES {
                let (mut w, mut add) = ([0.0; WIDE], [0.0; WIDE]);
                add_coordinates(simd, &upper[r], &mut w);
                let f = [follow[0][r], follow[1][r], follow[2][r]];
                accumulate(simd, f, [&node.k[0], &node.k[1], &node.k[2]], &mut w);
                accumulate(simd, f, [&node.l[0], &node.l[1], &node.l[2]], &mut add);
                let mut wz = [0.0; 4];
                accumulate(simd, seven(&w), rows(&node.z), &mut wz);
                accumulate(simd, three(&w), [&follow[0], &follow[1], &follow[2]], &mut add);
                accumulate(simd, [-wz[0], -wz[1], -wz[2]], [&node.h[0], &node.h[1], &node.h[2]], &mut add);
                (node.w[r], node.wz[r], added[r]) = (w, wz, add);
            }
        }
        Ok(())
    }
}

/// [`Factor::solve_in_place`] with the processor's vectors.
struct Solving<'a> {
    factor: &'a mut Factor,
    x: &'a mut [f64],
}

impl WithSimd for Solving<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { factor: Factor { nodes, load }, x } = self;
        let n = nodes.len();
        let mut added = [0.0; WIDE];
        for i in (0..n).rev() {
            let (node, here) = (&nodes[i], &mut x[i * BLOCK..(i + 1) * BLOCK]);
            let mut b = added;
            for (b, x) in b.iter_mut().zip(&here[..COORDINATES]) {
                *b += x;
            }
            // x_0 satisfies the constraints with the node before at rest.
            let inverse_scale = 1.0 / node.scale;
            let along_p = 0.5 * here[BLOCK - 1] * inverse_scale / node.p.iter().map(|p| p * p).sum::<f64>();
            let mut x0 = [0.0; WIDE];
            for q in 0..4 {
                x0[3 + q] = node.p[q] * along_p;
            }
            for c in 0..3 {
                let turned = (0..4).map(|q| node.here[c][q] * x0[3 + q]).sum::<f64>();
                x0[c] = here[COORDINATES + c] * inverse_scale - turned;
            }
            let mut rest = b;
            for (rest, k) in rest.iter_mut().zip(&node.k) {
                *rest -= dot8(simd, k, &x0);
            }
            node.add_along(times(simd, &node.y, &rest), &mut x0);
            here[..COORDINATES].copy_from_slice(&x0[..COORDINATES]);
            load[i] = b;
            if i > 0 {
                // The node before carries this one's load through the chord, less what its motion takes.
                added = [0.0; WIDE];
                for r in 0..COORDINATES {
                    let carried = match r {
                        0..3 => b[r],
                        _ => -(0..3).map(|c| node.before[c][r - 3] * b[c]).sum::<f64>(),
                    };
                    added[r] = carried - dot8(simd, &node.w[r], &x0);
                }
            }
        }
        let mut y = [0.0; WIDE];
        for (i, (node, b)) in nodes.iter().zip(load).enumerate() {
            let here = &mut x[i * BLOCK..(i + 1) * BLOCK];
            let mut coordinates = [0.0; WIDE];
            if i > 0 {
                coordinates = node.follow(&y);
                let [a, b, c] = times(simd, &node.h, &y);
                node.add_along([-a, -b, -c], &mut coordinates);
            }
            for (x, here) in coordinates.iter_mut().zip(&here[..COORDINATES]) {
                *x += here;
            }
            // The constraints' multipliers carry what is left of the equations of motion.
            let mut left = *b;
            for r in 0..COORDINATES {
                left[r] -= dot8(simd, &node.k[r], &coordinates);
                if i > 0 {
                    left[r] -= dot8(simd, &node.l[r], &y);
                }
            }
            let mut norm = 0.0;
            for q in 0..4 {
                let turned = (0..3).map(|c| node.here[c][q] * left[c]).sum::<f64>();
                norm += node.p[q] * (left[3 + q] - turned);
            }
            here[..COORDINATES].copy_from_slice(&coordinates[..COORDINATES]);
            for c in 0..3 {
                here[COORDINATES + c] = left[c] / node.scale;
            }
            here[BLOCK - 1] = 0.5 * norm / (node.scale * node.p.iter().map(|p| p * p).sum::<f64>());
            y = coordinates;
        }
    }
}

/// [`Factor::solve_panel_in_place`] with the processor's vectors.
struct Panel<'a> {
    factor: &'a Factor,
    columns: usize,
    first: &'a [usize],
    x: &'a mut [f64],
}

impl WithSimd for Panel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { factor, columns, first, x } = self;
        let rows = COORDINATES * columns;
        for (i, node) in factor.nodes.iter().enumerate().rev() {
            let (before, here) = x.split_at_mut(i * rows);
            let mut before = before.len().checked_sub(rows).map(|at| &mut before[at..]);
            let mut c = first[i].min(columns);
            while c < columns {
                c += if c + S::F64_LANES > columns {
                    inward(Scalars, node, columns, c, before.as_deref_mut(), here)
                } else {
                    inward(Lanes(simd), node, columns, c, before.as_deref_mut(), here)
                };
            }
        }
        for (i, node) in factor.nodes.iter().enumerate() {
            let (before, here) = x.split_at_mut(i * rows);
            let before = before.len().checked_sub(rows).map(|at| &before[at..]);
            let mut c = 0;
            while c < columns {
                c += if c + S::F64_LANES > columns {
                    outward(Scalars, node, columns, c, before, here)
                } else {
                    outward(Lanes(simd), node, columns, c, before, here)
                };
            }
        }
    }
}

/// Columns `c..` of one node towards the base: `z = Y b` into the node's first three rows, and `b - W Z z` carried to the
/// node before; returns how many columns were done.
#[inline(always)]
fn inward<C: Columns>(
    w: C,
    node: &Node,
    columns: usize,
    c: usize,
    before: Option<&mut [f64]>,
    here: &mut [f64],
) -> usize {
    let mut b = [w.splat(0.0); COORDINATES];
    for r in 0..COORDINATES {
        b[r] = w.load(&here[r * columns + c..]);
    }
    let mut z = [w.splat(0.0); 3];
    for r in 0..COORDINATES {
        for k in 0..3 {
            z[k] = w.splat(node.y[k][r]).multiply_add(b[r], z[k]);
        }
    }
    for k in 0..3 {
        w.store(z[k], &mut here[k * columns + c..]);
    }
    if let Some(before) = before {
        for r in 0..COORDINATES {
            let mut sum = w.load(&before[r * columns + c..]);
            if r < 3 {
                sum = sum + b[r];
            } else {
                for k in 0..3 {
                    sum = w.splat(-node.before[k][r - 3]).multiply_add(b[k], sum);
                }
            }
            for k in 0..3 {
                sum = w.splat(-node.wz[r][k]).multiply_add(z[k], sum);
            }
            w.store(sum, &mut before[r * columns + c..]);
        }
    }
    C::WIDTH
}

/// Columns `c..` of one node away from the base: `x = T_0 y + Z (z - H y)`; returns how many were done.
#[inline(always)]
fn outward<C: Columns>(w: C, node: &Node, columns: usize, c: usize, before: Option<&[f64]>, here: &mut [f64]) -> usize {
    let mut z = [w.splat(0.0); 3];
    for k in 0..3 {
        z[k] = w.load(&here[k * columns + c..]);
    }
    let mut x = [w.splat(0.0); COORDINATES];
    if let Some(before) = before {
        for r in 0..COORDINATES {
            let y = w.load(&before[r * columns + c..]);
            for k in 0..3 {
                z[k] = w.splat(-node.h[k][r]).multiply_add(y, z[k]);
            }
            if r < 3 {
                x[r] = x[r] + y;
            } else {
                for k in 0..3 {
                    x[k] = w.splat(-node.before[k][r - 3]).multiply_add(y, x[k]);
                }
            }
        }
    }
    for r in 0..COORDINATES {
        for k in 0..3 {
            x[r] = w.splat(node.z[r][k]).multiply_add(z[k], x[r]);
        }
        w.store(x[r], &mut here[r * columns + c..]);
    }
    C::WIDTH
}

/// `y += sum f_k x_k`, every number of `y` kept in a register meanwhile.
#[inline(always)]
fn accumulate<S: Simd, const N: usize, const K: usize>(simd: S, f: [f64; K], x: [&[f64; N]; K], y: &mut [f64; N]) {
    let (y, y_end) = S::as_mut_simd_f64s(y);
    for (v, y) in y.iter_mut().enumerate() {
        let mut sum = *y;
        for k in 0..K {
            sum = simd.mul_add_e_f64s(simd.splat_f64s(f[k]), S::as_simd_f64s(x[k]).0[v], sum);
        }
        *y = sum;
    }
    let done = N - y_end.len();
    for (c, y) in y_end.iter_mut().enumerate() {
        for k in 0..K {
            *y += f[k] * x[k][done + c];
        }
    }
}

/// Adds the coordinates of a block's row.
#[inline(always)]
fn add_coordinates<S: Simd>(simd: S, row: &[f64; STRIDE], y: &mut Row) {
    let (y, y_end) = S::as_mut_simd_f64s(y);
    let (mask, row) = (S::as_simd_f64s(&ONLY_COORDINATES), S::as_simd_f64s(&row[..WIDE]));
    for (v, y) in y.iter_mut().enumerate() {
        *y = simd.mul_add_e_f64s(row.0[v], mask.0[v], *y);
    }
    for (c, y) in y_end.iter_mut().enumerate() {
        *y += row.1[c] * mask.1[c];
    }
}

/// `a . b`.
#[inline(always)]
fn dot8<S: Simd>(simd: S, a: &Row, b: &Row) -> f64 {
    let ((a, a_end), (b, b_end)) = (S::as_simd_f64s(a), S::as_simd_f64s(b));
    let mut sum = simd.splat_f64s(0.0);
    for (a, b) in a.iter().zip(b) {
        sum = simd.mul_add_e_f64s(*a, *b, sum);
    }
    simd.reduce_sum_f64s(sum) + a_end.iter().zip(b_end).map(|(a, b)| a * b).sum::<f64>()
}

/// Three rows times a vector. No closure: the compiler need not inline it, and would call every vector operation.
#[inline(always)]
fn times<S: Simd>(simd: S, rows: &[Row; 3], x: &Row) -> [f64; 3] {
    [dot8(simd, &rows[0], x), dot8(simd, &rows[1], x), dot8(simd, &rows[2], x)]
}

#[inline(always)]
fn rows<const N: usize>(m: &[[f64; N]; COORDINATES]) -> [&[f64; N]; COORDINATES] {
    [&m[0], &m[1], &m[2], &m[3], &m[4], &m[5], &m[6]]
}

#[inline(always)]
fn column(m: &[Narrow; COORDINATES], k: usize) -> [f64; COORDINATES] {
    [m[0][k], m[1][k], m[2][k], m[3][k], m[4][k], m[5][k], m[6][k]]
}

#[inline(always)]
fn seven(r: &Row) -> [f64; COORDINATES] {
    [r[0], r[1], r[2], r[3], r[4], r[5], r[6]]
}

#[inline(always)]
fn three(r: &Row) -> [f64; 3] {
    [r[0], r[1], r[2]]
}

/// Inverse of a 3x3 matrix by its adjugate; `None` where it is singular or not finite.
#[inline(always)]
fn inverse3(m: &[Narrow; 3]) -> Option<[[f64; 3]; 3]> {
    let minor = |r: usize, c: usize| {
        let ([r1, r2], [c1, c2]) = ([(r + 1) % 3, (r + 2) % 3], [(c + 1) % 3, (c + 2) % 3]);
        m[r1][c1] * m[r2][c2] - m[r1][c2] * m[r2][c1]
    };
    let determinant = m[0][0] * minor(0, 0) + m[0][1] * minor(0, 1) + m[0][2] * minor(0, 2);
    if !(determinant != 0.0 && determinant.is_finite()) {
        return None;
    }
    let f = 1.0 / determinant;
    Some([
        [f * minor(0, 0), f * minor(1, 0), f * minor(2, 0)],
        [f * minor(0, 1), f * minor(1, 1), f * minor(2, 1)],
        [f * minor(0, 2), f * minor(1, 2), f * minor(2, 2)],
    ])
}

#[cfg(test)]
#[path = "chain_tests.rs"]
mod tests;
