//! `[ipc]`: where the shared-memory services live.

use super::reader::Section;
use super::schema::{Key, Kind, TableSpec};
use serde::Serialize;
use std::path::PathBuf;

/// Names and places of the shared-memory services `sinew/<arm>/...`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IpcConfig {
    /// Name of the arm, from `[arm]`.
    pub arm: String,
    /// Prefix of all iceoryx2 files.
    pub prefix: String,
    /// Root path of iceoryx2's files; `None` for its default.
    pub root_path: Option<PathBuf>,
    /// Folder in which the arm's socket lies; `None` for the first of the usual ones that can be had.
    pub run_path: Option<PathBuf>,
}

/// `[ipc]`.
pub static IPC: TableSpec = TableSpec {
    header: "[ipc]",
    name: "ipc",
    about: "Where the shared-memory services `sinew/<arm>/...` live; the arm's name comes from `[arm]`.",
    keys: &[
        Key::default(
            "prefix",
            Kind::Text(32),
            "",
            "\"iox2_\"",
            "Prefix of all iceoryx2 files: letters, digits, `-`, `_`; clients need the same one.",
        ),
        Key::optional(
            "root_path",
            Kind::Text(128),
            "",
            "iceoryx2's own",
            "Absolute path of iceoryx2's files; clients need the same one.",
        ),
        Key::optional(
            "run_path",
            // With the longest name of an arm and of a socket still within the 107 bytes that the kernel permits.
            Kind::Text(48),
            "",
            "`/run/sinew`, else `/run/user/<uid>/sinew`, else `/tmp/sinew-<uid>`",
            "Absolute path of the folder with the socket of `sinew stop`, `hold`, `disarm` and `status`; nobody but the \
             daemon's user may write there.",
        ),
    ],
};

/// Reads `[ipc]` for the arm of this name.
pub(super) fn read(table: &Section<'_>, arm: &str) -> IpcConfig {
    let config = IpcConfig {
        arm: arm.to_owned(),
        prefix: table.text("prefix"),
        root_path: table.text_opt("root_path").map(PathBuf::from),
        run_path: table.text_opt("run_path").map(PathBuf::from),
    };
    if !config.prefix.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_') {
        table.refuse("prefix", "contains other characters", "permitted: letters, digits, `-` and `_`");
    }
    for (key, path) in [("root_path", &config.root_path), ("run_path", &config.run_path)] {
        if path.as_ref().is_some_and(|path| !path.is_absolute()) {
            table.refuse(key, "not an absolute path", "permitted: a path that starts with /");
        }
    }
    config
}
