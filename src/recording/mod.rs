//! Recordings: MCAP files with one set of schemas for everything that sinew writes.
//!
//! Enters: records of ticks, obstacle sets, targets, events. Leaves: a file that Foxglove, PlotJuggler and the `mcap`
//! packages of Python, C++ and Go read as it is. Never on the control thread; a full queue drops and counts.
//!
//! Beside them, some times a second, stand the arm and what is around it as `foxglove` messages (`viewer`), which viewers
//! draw without knowing sinew's schemas.
//!
//! Messages are CDR with `ros2msg` schemas. Of the self-describing encodings that those tools decode without plug-ins it
//! is the compact one with arrays of numbers that needs neither generated code nor a compiled descriptor (protobuf and
//! flatbuffers do; JSON writes numbers as text), and nothing of ROS is needed to write or read it.
//! Sequences hold what is in use: the paper's arm takes 3 kB per tick where the payload in shared memory takes 15 kB.
//!
//! A file cut short by a crash or a full disk stays readable up to its last complete chunk (a chunk ends after 256 kB or
//! half a second, of recorded time or on the clock).

mod about;
mod cdr;
mod cloud;
mod decode;
mod files;
mod indexed;
mod reader;
mod recorder;
mod schema;
mod shapes;
mod viewer;

pub use about::{About, CONFIGURATION, SETTINGS, SOFTWARE};
pub use decode::Decoder;
pub use files::{Bounds, utc_text, wall_clock_offset_ns};
pub use indexed::IndexedFile;
pub use reader::{
    Facts, FileEnd, RawMessage, RecordedMessage, facts, last_ns, read, read_between, read_each, read_raw,
};
pub use recorder::{Recorder, Recording};
pub use viewer::{Happened, Severity, Viewer, Words};

use thiserror::Error;

/// Writing or reading a recording failed.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// The file.
    #[error("{path}: {source}")]
    File {
        /// Path.
        path: String,
        /// Cause.
        source: std::io::Error,
    },
    /// It cannot be read by its index.
    #[error("{path}: no index at its end: it is no recording, or was cut short")]
    NoIndex {
        /// Path.
        path: String,
    },
    /// It does not begin as a recording does.
    #[error("{path}: this is no MCAP recording, or one whose writer was killed before its first half second")]
    NoRecording {
        /// Path.
        path: String,
    },
    /// The container format.
    #[error("recording: {}", reason(.0))]
    Mcap(#[from] mcap::McapError),
    /// A message does not match its schema.
    #[error("recording: message of {topic} does not match its schema: {why}")]
    Message {
        /// Topic.
        topic: String,
        /// What is wrong.
        why: String,
    },
}

/// The operating system's word where there is one: the container's own only says that there was an error.
fn reason(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}
