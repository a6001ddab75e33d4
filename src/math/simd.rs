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
