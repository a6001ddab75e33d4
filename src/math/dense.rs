//! Dense LU with partial pivoting in the caller's memory, for systems of some tens of unknowns.
//!
//! Enters: a row-major matrix and a right-hand side. Leaves: the solution in place. nalgebra's dynamic LU and faer's
//! both want memory of their own at each call; these few lines need none, which the control thread requires.

use super::simd::add_scaled;
use pulp::{Arch, Simd, WithSimd};

/// Solves `a x = b` in place (`a` n x n row-major, destroyed; `b` becomes `x`). Returns false where a pivot is zero
/// or not finite. Does not allocate.
pub fn solve_in_place(n: usize, a: &mut [f64], b: &mut [f64]) -> bool {
    solve_panel_in_place(n, 1, a, b)
}

/// The same for `columns` right-hand sides at once, `b` n x columns row-major.
pub fn solve_panel_in_place(n: usize, columns: usize, a: &mut [f64], b: &mut [f64]) -> bool {
    Arch::new().dispatch(Solving { n, columns, a, b })
}

struct Solving<'a> {
    n: usize,
    columns: usize,
    a: &'a mut [f64],
    b: &'a mut [f64],
}

impl WithSimd for Solving<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let Self { n, columns: m, a, b } = self;
        for k in 0..n {
            let mut pivot = k;
            let mut best = a[k * n + k].abs();
            for r in k + 1..n {
                let v = a[r * n + k].abs();
                if v > best {
                    best = v;
                    pivot = r;
                }
            }
            if !(best > 0.0 && best.is_finite()) {
                return false;
            }
            if pivot != k {
                for c in k..n {
                    a.swap(k * n + c, pivot * n + c);
                }
                for c in 0..m {
                    b.swap(k * m + c, pivot * m + c);
                }
            }
            let (top, below) = a.split_at_mut((k + 1) * n);
            let row = &top[k * n..];
            let inverse = 1.0 / row[k];
            for r in k + 1..n {
                let other = &mut below[(r - k - 1) * n..(r - k) * n];
                let f = other[k] * inverse;
                if f != 0.0 {
                    add_scaled(simd, -f, &row[k + 1..n], &mut other[k + 1..]);
                    for c in 0..m {
                        b[r * m + c] -= f * b[k * m + c];
                    }
                }
            }
        }
        for k in (0..n).rev() {
            for c in 0..m {
                let s: f64 = (k + 1..n).map(|r| a[k * n + r] * b[r * m + c]).sum();
                b[k * m + c] = (b[k * m + c] - s) / a[k * n + k];
            }
        }
        b[..n * m].iter().all(|v| v.is_finite())
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn solutions_agree_with_the_library() {
        let n = 7;
        let a: Vec<f64> = (0..n * n).map(|k| ((k * k) as f64 * 1.7).sin()).collect();
        let b: Vec<f64> = (0..n).map(|k| (k as f64).cos()).collect();
        let want =
            nalgebra::DMatrix::from_row_slice(n, n, &a).lu().solve(&nalgebra::DVector::from_vec(b.clone())).unwrap();
        let (mut m, mut x) = (a, b);
        assert!(super::solve_in_place(n, &mut m, &mut x));
        assert!(x.iter().zip(want.iter()).all(|(x, y)| (x - y).abs() < 1e-10));
    }

    #[test]
    fn a_singular_matrix_is_told() {
        assert!(!super::solve_in_place(2, &mut [1.0, 2.0, 2.0, 4.0], &mut [1.0, 1.0]));
    }
}
