//! Shared memory: payloads, services, validation, and the hand-over to the control thread.
//!
//! Enters: messages of clients (encoders, obstacles, targets, requests), any bytes whatever. Leaves: validated inputs
//! for the control thread, its records for everyone. The control thread touches no port: it reads the newest values
//! from triple buffers and writes its records to bounded rings, both wait-free; what finds a ring full is counted and
//! dropped. Nothing here may delay or fail the loop.

mod by_socket;
mod channels;
mod client;
mod domain;
mod error;
pub mod intake;
mod io_thread;
pub mod payload;
mod ports;
pub(crate) mod run_dir;
mod service;

pub use by_socket::*;
pub use channels::*;
pub use client::*;
pub use domain::{Domain, PREFIX_VARIABLE, ROOT_VARIABLE};
pub use error::*;
pub use io_thread::*;
pub use ports::DaemonPorts;
pub use run_dir::{RUN_VARIABLE, run_dir};
pub use service::{Message, service_name};
