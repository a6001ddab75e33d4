//! The simulated drive: the slave's half of CANopen and CiA 402, without physics.
//!
//! Enters: frames, the time, and what the plant measures (position in counts, torque in per mille of rated torque).
//! Leaves: frames to send and the torque that the motor applies (per mille of rated torque, positive pulls the cable).
//! It must never read a clock, wait, or know what hangs on its shaft: every call takes `now_ns`, so it runs in real
//! time and in lockstep alike.
//!
//! * [`objects`]: the object dictionary as a table; [`eds`]: the same as an EDS file;
//! * [`pdo`]: communication parameters and mappings, with the procedure of CiA 301 for changing them;
//! * [`machine`]: the drive itself, its SDO access and its PDO traffic; [`bank`]: many drives on one bus handle.
//!
//! Protection: on loss of a consumed heartbeat, or of SYNC or RPDOs while torque is on, the torque goes to the declared
//! safe value (2000:02) with the declared slope (6087), an emergency object is sent, and the fault stays latched until it is
//! reset by the controlword with its cause gone. Departure from CiA 402, which cuts the power stage in the state
//! "fault": after a communication fault the safe torque is still applied there, so that an arm can keep a pretension;
//! at its default of 0 the two are the same.

pub mod bank;
pub mod eds;
pub mod machine;
pub mod objects;
pub mod pdo;

pub use bank::{DriveBank, Pumped};
pub use machine::Drive;
pub use objects::Nameplate;
