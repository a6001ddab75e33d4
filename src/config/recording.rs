//! `[recording]`: how much of a disk recordings may take.

use super::reader::Section;
use super::schema::{Key, Kind, TableSpec};
use serde::Serialize;

/// Bounds of what `sinew run --record` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct RecordingConfig {
    /// Size after which the next file is begun (MiB).
    pub file_mib: u64,
    /// Size of all files together (MiB); then the oldest is removed. `None`: no bound.
    pub total_mib: Option<u64>,
    /// What stays free on the disk (MiB): with less the recording ends.
    pub free_mib: u64,
    /// Pictures for viewers a second of recorded time; 0: none.
    pub pictures_1ps: u32,
}

/// `[recording]`.
pub static RECORDING: TableSpec = TableSpec {
    header: "[recording]",
    name: "recording",
    about: "How much of a disk `sinew run --record` may take. The paper's arm writes 1.2 GB an hour at 100 Hz, and 0.8 GB of pictures. No file is ever \
            replaced; where a folder is given, files are named by arm and start time.",
    keys: &[
        Key::default(
            "file_mib",
            Kind::Integer(1, 1 << 20),
            "MiB",
            "1024",
            "Size after which the next file is begun: `name-2.mcap` and so on.",
        ),
        Key::optional(
            "total_mib",
            Kind::Integer(2, 1 << 30),
            "MiB",
            "no bound",
            "Size of all files of the run together, in a folder of all of the arm, after which the oldest is removed; at \
             least two files.",
        ),
        Key::default(
            "free_mib",
            Kind::Integer(0, 1 << 30),
            "MiB",
            "256",
            "What stays free on the disk: with less the recording ends, and the arm goes on.",
        ),
        Key::default(
            "pictures_1ps",
            Kind::Integer(0, 100),
            "1/s",
            "30",
            "Pictures for viewers (Foxglove, Lichtblick) a second of recorded time; 0: none, and no log for them.",
        ),
    ],
};

/// Reads `[recording]`.
pub(super) fn read(table: &Section<'_>) -> RecordingConfig {
    let config = RecordingConfig {
        file_mib: table.count("file_mib") as u64,
        total_mib: table.count_opt("total_mib").map(|mib| mib as u64),
        free_mib: table.count("free_mib") as u64,
        pictures_1ps: table.count("pictures_1ps") as u32,
    };
    if config.total_mib.is_some_and(|total| total < 2 * config.file_mib) {
        let help = format!("permitted: {} MiB (two of `file_mib`) or more", 2 * config.file_mib);
        table.refuse("total_mib", "less than two files", &help);
    }
    config
}
