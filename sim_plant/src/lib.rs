//! The simulated arm and its drives.
//!
//! Enters: frames on the buses, the controller's own configuration files and `[plant]`. Leaves: frames, and for judging
//! only, a trace of the true arm. It knows the controller by its frames alone: no shared memory, no other channel.
//!
//! * [`truth`]: the arm; [`drive`]: the drives' protocol; [`rig`]: drums, brakes and encoders between them;
//! * [`server`]: the buses and the passing of time; [`fault`]: what breaks, and when; [`wire`]: what goes wrong on
//!   the buses; [`trace`]: the truth on file;
//! * [`mod@bench`]: the controller and the arm in one process, [`poses`]: a campaign of static poses with it, [`mod@follow`]: a scenario,
//!   [`stops`]: one that is stopped or cut off;
//! * [`config`]: the table of the plant's settings.

pub mod bench;
pub mod config;
pub mod drive;
pub mod fault;
pub mod follow;
pub mod poses;
pub mod rig;
pub mod server;
pub mod stops;
pub mod trace;
pub mod truth;
pub mod wire;
