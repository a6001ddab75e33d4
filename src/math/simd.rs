//! Vector kernels, chosen at run time for the processor.
//!
//! The program is built for the plainest x86-64 (embedded PCs without AVX exist); kernels that are generic over pulp's
//! `Simd` are compiled once per instruction set and dispatched. Results may differ in the last bit between processors,
//! never between runs on one.

use pulp::Simd;

/// `y += f x`, over the shorter of the two. Does not allocate.
#[inline(always)]
pub fn add_scaled<S: Simd>(simd: S, f: f64, x: &[f64], y: &mut [f64]) {
    let (x, x_end) = S::as_simd_f64s(x);
    let (y, y_end) = S::as_mut_simd_f64s(y);
    let factor = simd.splat_f64s(f);
    for (y, x) in y.iter_mut().zip(x) {
        *y = simd.mul_add_e_f64s(factor, *x, *y);
    }
    for (y, x) in y_end.iter_mut().zip(x_end) {
        *y += f * x;
    }
}

/// `x . y` over the shorter of the two. Does not allocate.
#[inline(always)]
pub fn dot<S: Simd>(simd: S, x: &[f64], y: &[f64]) -> f64 {
    let n = x.len().min(y.len());
    let (x, x_end) = S::as_simd_f64s(&x[..n]);
    let (y, y_end) = S::as_simd_f64s(&y[..n]);
    let mut sum = simd.splat_f64s(0.0);
    for (x, y) in x.iter().zip(y) {
        sum = simd.mul_add_e_f64s(*x, *y, sum);
    }
    simd.reduce_sum_f64s(sum) + x_end.iter().zip(y_end).map(|(x, y)| x * y).sum::<f64>()
}

/// `y += sum f_k x_k` for four rows of `y`'s length. Does not allocate.
#[inline(always)]
pub fn add_four<S: Simd>(simd: S, f: [f64; 4], x: [&[f64]; 4], y: &mut [f64]) {
    let heads = x.map(|x| S::as_simd_f64s(x));
    let factors = f.map(|f| simd.splat_f64s(f));
    let (y, y_end) = S::as_mut_simd_f64s(y);
    for (i, y) in y.iter_mut().enumerate() {
        let mut sum = *y;
        for k in 0..4 {
            sum = simd.mul_add_e_f64s(factors[k], heads[k].0[i], sum);
        }
        *y = sum;
    }
    for (i, y) in y_end.iter_mut().enumerate() {
        for k in 0..4 {
            *y += f[k] * heads[k].1[i];
        }
    }
}

/// A few columns at once: a vector, or a single number at the end of a row.
pub(crate) trait Columns: Copy {
    type Value: Copy;
    const WIDTH: usize;
    fn splat(self, v: f64) -> Self::Value;
    fn load(self, s: &[f64]) -> Self::Value;
    fn store(self, v: Self::Value, s: &mut [f64]);
    /// `a b + c`.
    fn multiply_add(self, a: Self::Value, b: Self::Value, c: Self::Value) -> Self::Value;
    fn multiply(self, a: Self::Value, b: Self::Value) -> Self::Value;
    fn divide(self, a: Self::Value, b: Self::Value) -> Self::Value;
    fn square_root(self, a: Self::Value) -> Self::Value;
    /// Of its numbers.
    fn sum(self, a: Self::Value) -> f64;
}

#[derive(Clone, Copy)]
pub(crate) struct Scalars;

impl Columns for Scalars {
    type Value = f64;
    const WIDTH: usize = 1;
    #[inline(always)]
    fn splat(self, v: f64) -> f64 {
        v
    }
    #[inline(always)]
    fn load(self, s: &[f64]) -> f64 {
        s[0]
    }
    #[inline(always)]
    fn store(self, v: f64, s: &mut [f64]) {
        s[0] = v;
    }
    #[inline(always)]
    fn multiply_add(self, a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
    #[inline(always)]
    fn multiply(self, a: f64, b: f64) -> f64 {
        a * b
    }
    #[inline(always)]
    fn divide(self, a: f64, b: f64) -> f64 {
        a / b
    }
    #[inline(always)]
    fn square_root(self, a: f64) -> f64 {
        a.sqrt()
    }
    #[inline(always)]
    fn sum(self, a: f64) -> f64 {
        a
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Lanes<S>(pub(crate) S);

impl<S: Simd> Columns for Lanes<S> {
    type Value = S::f64s;
    const WIDTH: usize = S::F64_LANES;
    #[inline(always)]
    fn splat(self, v: f64) -> S::f64s {
        self.0.splat_f64s(v)
    }
    #[inline(always)]
    fn load(self, s: &[f64]) -> S::f64s {
        S::as_simd_f64s(&s[..S::F64_LANES]).0[0]
    }
    #[inline(always)]
    fn store(self, v: S::f64s, s: &mut [f64]) {
        S::as_mut_simd_f64s(&mut s[..S::F64_LANES]).0[0] = v;
    }
    #[inline(always)]
    fn multiply_add(self, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
        self.0.mul_add_e_f64s(a, b, c)
    }
    #[inline(always)]
    fn multiply(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.mul_f64s(a, b)
    }
    #[inline(always)]
    fn divide(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.div_f64s(a, b)
    }
    #[inline(always)]
    fn square_root(self, a: S::f64s) -> S::f64s {
        self.0.sqrt_f64s(a)
    }
    #[inline(always)]
    fn sum(self, a: S::f64s) -> f64 {
        self.0.reduce_sum_f64s(a)
    }
}
