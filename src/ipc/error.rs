//! What can go wrong between processes.

use std::path::PathBuf;
use thiserror::Error;

/// An operation on shared memory failed.
#[derive(Debug, Error)]
pub enum IpcError {
    /// Nobody serves this arm.
    #[error("no daemon running for arm \"{arm}\" (start it with `sinew run`, or check SINEW_IPC_PREFIX)")]
    NoDaemon {
        /// The arm.
        arm: String,
    },
    /// Somebody serves this arm already.
    #[error("a daemon for arm \"{arm}\" is already running")]
    AlreadyRunning {
        /// The arm.
        arm: String,
    },
    /// The service exists with another payload: the other side speaks another schema version.
    #[error("service {service} has another payload: the other side is not of schema version {expected}")]
    IncompatiblePayload {
        /// Full name of the service.
        service: String,
        /// Our schema version.
        expected: u32,
    },
    /// All places for clients of a service are taken.
    #[error("service {service} has no place for another {port}")]
    Full {
        /// Full name of the service.
        service: String,
        /// Kind of the port.
        port: &'static str,
    },
    /// A name or path that shared memory cannot carry.
    #[error("{what} \"{value}\" is not usable: {why}")]
    Name {
        /// What is named.
        what: &'static str,
        /// Its value.
        value: String,
        /// Why not.
        why: String,
    },
    /// The daemon did not answer in time.
    #[error("the daemon of arm \"{arm}\" did not answer within {timeout_s} s")]
    Timeout {
        /// The arm.
        arm: String,
        /// The time waited (s).
        timeout_s: f64,
    },
    /// A folder or file that cannot be trusted or had.
    #[error("{path} is not used: {why}", path = path.display())]
    Foreign {
        /// The folder or file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// Shared memory cannot be set up, for a cause that was found.
    #[error("shared memory cannot be used: {why}")]
    Unusable {
        /// The cause, and what mends it.
        why: String,
    },
    /// Anything else that iceoryx2 reports.
    #[error("{operation} failed for {service}: {cause}")]
    Port {
        /// What was tried.
        operation: &'static str,
        /// Full name of the service, or of the node.
        service: String,
        /// The cause, as iceoryx2 names it.
        cause: String,
    },
}

impl IpcError {
    pub(crate) fn port(operation: &'static str, service: &str, cause: impl std::fmt::Debug) -> Self {
        Self::Port { operation, service: service.to_owned(), cause: format!("{cause:?}") }
    }
}
