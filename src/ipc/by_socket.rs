//! What comes over the arm's socket for the I/O thread, and what goes back: requests and inputs of those whom `[access]`
//! names, who have no part in the daemon's shared memory.

use super::payload::{Obstacles, RejectCause, Request, Response, Target};

/// A connection by which somebody publishes, known to the intake as a port is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SocketPort {
    /// Never given twice, and none of iceoryx2's.
    pub id: u128,
    /// Process at its other end; 0 if it cannot be seen from here.
    pub pid: i32,
}

impl SocketPort {
    /// The port of a number that counts the connections.
    pub const fn new(number: u64, pid: i32) -> Self {
        Self { id: (0x534f_434b_4554 << 80) | number as u128, pid }
    }
}

/// To the I/O thread. A capture time of 0 stands for the time at which it is taken.
#[derive(Debug)]
pub enum BySocket {
    /// A request; the answer bears the ticket.
    Ask(u64, Box<Request>),
    /// All that a source sees.
    Obstacles(SocketPort, Box<Obstacles>),
    /// A point of the desired motion.
    Target(SocketPort, Box<Target>),
    /// The connection has ended.
    Gone(SocketPort),
}

/// From the I/O thread.
#[derive(Debug)]
pub enum ToSocket {
    /// The answer to a request.
    Answer(u64, Response),
    /// What became of what was published.
    Fate(SocketPort, Result<(), RejectCause>),
}
