//! CANopen (CiA 301): the protocol pieces that a master and a slave share.
//!
//! Enters: bytes of frames, and requests to read or write objects. Leaves: frames to send, decoded messages, typed
//! errors. Every piece is a state machine that is handed the time; nothing here owns a bus, waits, or reads a clock.
//! It must never panic on what came off a wire: each decoder takes arbitrary bytes and answers `None` or a typed error.
//!
//! * [`cob`]: node identifiers and the predefined connection set;
//! * [`nmt`]: commands, states, heartbeat;
//! * [`sdo`], [`sdo_client`], [`sdo_server`]: expedited and segmented transfers with abort codes;
//! * [`pdo`]: mapping entries, packing and unpacking;
//! * [`emcy`]: emergency objects;
//! * [`dictionary`]: the object dictionary of a slave as data.

pub mod cob;
pub mod dictionary;
pub mod emcy;
pub mod nmt;
pub mod pdo;
pub mod sdo;
pub mod sdo_client;
pub mod sdo_server;

pub use cob::{Message, NodeId};
pub use dictionary::{Access, DataType, ObjectDictionary, Value};
pub use emcy::Emergency;
pub use nmt::{NmtCommand, NmtState};
pub use pdo::{Mapped, Mapping};
pub use sdo::AbortCode;
