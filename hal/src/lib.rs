//! CAN buses, CiA 402 drives, the motor bank, clocks and scheduling.
//!
//! Knows wires and nothing of arms. The only home of `unsafe`.

pub mod can;
pub mod canopen;
pub mod cia402;
