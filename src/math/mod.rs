//! Small mathematics that the model stands on: quaternion forms and the block-tridiagonal factorisation.
//!
//! Enters and leaves: plain vectors and matrices of fixed size. Knows nothing of arms, never allocates in a step.

pub mod block_tridiagonal;
pub mod dense;
pub mod quaternion;
pub mod simd;
