//! CiA 402 drives in cyclic synchronous torque mode: the master's half, and what it shares with the simulated drive.
//!
//! Enters: a description of the drives, frames with their receive times, torques (per mille of rated torque), the time.
//! Leaves: frames, feedback of each drive, progress, faults as data. It must never wait, never read a clock, and, in
//! the cyclic part ([`CycleWriter`], [`Decoder`]), never allocate.
//!
//! * [`state`]: the power drive state machine; [`objects`]: indices and the two PDOs;
//! * [`config`]: drives and times; [`script`]: the SDO script of one drive, `read_back`: whether it still holds; [`master`]: many drives through boot-up,
//!   configuration, enabling, disabling, fault reset, and their supervision; [`fault`]: everything that can go wrong;
//! * [`layout`]: which frames carry the cyclic traffic, in classic CAN and in CAN FD;
//! * [`cyclic`]: torques out and feedback in, for the control thread and the receive thread;
//! * [`dbc`]: the DBC files of the cyclic traffic.

pub mod config;
pub mod cyclic;
pub mod dbc;
pub mod fault;
pub mod layout;
pub mod master;
pub mod objects;
mod read_back;
pub mod script;
pub mod state;

pub use config::{DriveSetup, Identity, MasterConfig, ObjectWrite, Order};
pub use cyclic::{CycleReport, CycleWriter, Decoder, DriveMask, Event, Feedback};
pub use fault::{DriveFault, Fault};
pub use layout::Layout;
pub use master::{Goal, Master, Phase, Progress};
pub use state::{Command, State};
