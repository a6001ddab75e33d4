//! Why a daemon did not start, or ended early.

use super::setup::BusLoad;
use crate::ipc::IpcError;
use crate::recording::RecordingError;
use sinew_hal::bus_config::OpenError;
use sinew_hal::cia402::config::SetupError;
use sinew_hal::motor_bank::ChannelError;
use sinew_hal::realtime::NotRealtime;
use std::path::PathBuf;
use thiserror::Error;

/// The daemon did not start, or could not go on.
#[derive(Debug, Error)]
pub enum DaemonError {
    /// The traffic does not fit a bus.
    #[error(
        "bus {}: the cyclic traffic takes {:.0} % of it at a period of {} ms, permitted are {:.0} % (`load_limit`): \
         {}", load.name, 100.0 * load.share, 1e3 * period_s, 100.0 * load.limit, remedy(load)
    )]
    BusLoad {
        /// The bus.
        load: BusLoad,
        /// The loop's period (s).
        period_s: f64,
    },
    /// A drive that cannot pull its cable.
    #[error("[drives]: {0}")]
    Channel(#[from] ChannelError),
    /// Settings that the drives' protocol does not have.
    #[error("[drives]: {0}")]
    Setup(#[from] SetupError),
    /// A node id out of range.
    #[error("[drives]: node id {found}, permitted are 1 to 127")]
    NodeId {
        /// As configured.
        found: u8,
    },
    /// All node ids belong to drives.
    #[error("[drives]: no node id is left for the master; the drives of a bus may have at most 126")]
    NoNodeLeft,
    /// Another number of start tensions than cables, or one outside the box.
    #[error("start tensions: {why}")]
    StartTensions {
        /// What is wrong.
        why: String,
    },
    /// A bus did not open.
    #[error("bus {name}: {source}")]
    Bus {
        /// Name of the bus.
        name: String,
        /// Why.
        source: OpenError,
    },
    /// A bus handle could not be duplicated.
    #[error("bus {name}: another handle could not be opened: {source}")]
    Duplicate {
        /// Name of the bus.
        name: String,
        /// Why.
        source: std::io::Error,
    },
    /// Shared memory.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The recording ended before the run did.
    #[error("the recording ended early: it is not complete (the log says why); the arm was stopped in order")]
    RecordingEnded,
    /// Real time is required and not granted.
    #[error(transparent)]
    NotRealtime(#[from] NotRealtime),
    /// A thread did not start.
    #[error("thread {name} could not be started: {source}")]
    Thread {
        /// Its name.
        name: &'static str,
        /// Why.
        source: std::io::Error,
    },
    /// A thread panicked: a defect of this program.
    #[error("thread {name} panicked; this is a defect of sinew")]
    Panic {
        /// Its name.
        name: &'static str,
    },
    /// In lockstep the drives must be there before the first tick.
    #[error(
        "the drives did not come up within {waited_s} s ({ready} of {drives} are operational): is the plant running on the \
         same bus?"
    )]
    NoDrives {
        /// Time waited (s).
        waited_s: f64,
        /// Operational.
        ready: usize,
        /// In all.
        drives: usize,
    },
    /// The arm's socket cannot be made.
    #[error("socket {path}: {source}", path = path.display())]
    Socket {
        /// Its path.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A user or group that this machine does not have.
    #[error("[access] {key}: this machine has no {kind} \"{name}\"; those of a directory service are given by number")]
    Access {
        /// The key.
        key: &'static str,
        /// User or group.
        kind: &'static str,
        /// Its name.
        name: String,
    },
}

fn remedy(load: &BusLoad) -> String {
    if load.period_s_min.is_finite() {
        format!(
            "lengthen `loop.period_s` to at least {:.2} ms, deal the drives to more buses, or use CAN FD with \
             `layout = \"packed\"`",
            1e3 * load.period_s_min
        )
    } else {
        "its heartbeats alone exceed that: lengthen `drives.heartbeat_s`".to_owned()
    }
}
