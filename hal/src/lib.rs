//! CAN buses, CiA 402 drives, the motor bank, clocks and scheduling.
//!
//! Knows wires and nothing of arms. The only home of `unsafe`.

pub mod bus_config;
pub mod bus_error;
pub mod can;
pub mod canopen;
pub mod cia402;
pub mod clock;
pub mod fault_shim;
pub mod load;
pub mod memory_bus;
pub mod motor_bank;
pub mod peer;
pub mod realtime;
pub mod socketcan_bus;
pub mod socketcand;
pub mod virtual_bus;
pub mod wake_latency;
