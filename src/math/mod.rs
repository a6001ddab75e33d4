//! Small mathematics that the model stands on: quaternion forms and the factorisation of a chain of nodes.
//!
//! Enters and leaves: plain vectors and matrices of fixed size. Knows nothing of arms, never allocates in a step.

pub mod block_tridiagonal;
pub mod chain;
pub mod dense;
pub mod quaternion;
pub mod simd;
