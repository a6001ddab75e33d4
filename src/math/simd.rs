//! Vector kernels, chosen at run time for the processor.
//!
//! The program is built for the plainest x86-64 (embedded PCs without AVX exist); kernels that are generic over pulp's
//! `Simd` are compiled once per instruction set and dispatched. Results may differ in the last bit between processors,
//! never between runs on one.

use pulp::Simd;
use std::ops::{Add, Mul, Neg, Sub};

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

/// A number, or several side by side, each its own: what kernels and the model's formulas are written in.
pub(crate) trait Number:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Mul<f64, Output = Self> + Neg<Output = Self>
{
    /// `self b + c`, rounded once where the processor can.
    fn multiply_add(self, b: Self, c: Self) -> Self;
    fn square_root(self) -> Self;
    /// `1 / self`.
    fn inverse(self) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn multiply_add(self, b: f64, c: f64) -> f64 {
        self * b + c
    }
    #[inline(always)]
    fn square_root(self) -> f64 {
        self.sqrt()
    }
    #[inline(always)]
    fn inverse(self) -> f64 {
        1.0 / self
    }
}

/// `a . b`.
#[inline(always)]
pub(crate) fn inner<V: Number, const N: usize>(a: &[V; N], b: &[V; N]) -> V {
    let mut sum = a[0] * b[0];
    for k in 1..N {
        sum = a[k].multiply_add(b[k], sum);
    }
    sum
}

/// As many numbers as a vector of the processor has, or one: how they come from memory and go back.
pub(crate) trait Columns: Copy {
    type Value: Number;
    const WIDTH: usize;
    fn splat(self, v: f64) -> Self::Value;
    fn load(self, s: &[f64]) -> Self::Value;
    fn store(self, v: Self::Value, s: &mut [f64]);
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
}

#[derive(Clone, Copy)]
pub(crate) struct Lanes<S>(pub(crate) S);

impl<S: Simd> Columns for Lanes<S> {
    type Value = Vector<S>;
    const WIDTH: usize = S::F64_LANES;
    #[inline(always)]
    fn splat(self, v: f64) -> Vector<S> {
        Vector(self.0, self.0.splat_f64s(v))
    }
    #[inline(always)]
    fn load(self, s: &[f64]) -> Vector<S> {
        Vector(self.0, S::as_simd_f64s(&s[..S::F64_LANES]).0[0])
    }
    #[inline(always)]
    fn store(self, v: Vector<S>, s: &mut [f64]) {
        S::as_mut_simd_f64s(&mut s[..S::F64_LANES]).0[0] = v.1;
    }
}

/// A vector of the processor, with the proof that it has such vectors.
#[derive(Clone, Copy)]
pub(crate) struct Vector<S: Simd>(S, S::f64s);

impl<S: Simd> Number for Vector<S> {
    #[inline(always)]
    fn multiply_add(self, b: Self, c: Self) -> Self {
        Self(self.0, self.0.mul_add_e_f64s(self.1, b.1, c.1))
    }
    #[inline(always)]
    fn square_root(self) -> Self {
        Self(self.0, self.0.sqrt_f64s(self.1))
    }
    #[inline(always)]
    fn inverse(self) -> Self {
        Self(self.0, self.0.div_f64s(self.0.splat_f64s(1.0), self.1))
    }
}

impl<S: Simd> Add for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(self.0, self.0.add_f64s(self.1, b.1))
    }
}

impl<S: Simd> Sub for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(self.0, self.0.sub_f64s(self.1, b.1))
    }
}

impl<S: Simd> Mul for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(self.0, self.0.mul_f64s(self.1, b.1))
    }
}

impl<S: Simd> Mul<f64> for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: f64) -> Self {
        Self(self.0, self.0.mul_f64s(self.1, self.0.splat_f64s(b)))
    }
}

impl<S: Simd> Neg for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0, self.0.neg_f64s(self.1))
    }
}
