//! Where recordings go: files that are made anew, one after the other, within bounds.
//!
//! Enters: a path and bounds. Leaves: files that did not exist before. A recording never replaces a file, whatever it is:
//! what a run before it left is most wanted when that run went wrong.

use super::RecordingError;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// How much of a disk recordings may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Bytes after which the next file is begun.
    pub file_bytes: u64,
    /// Bytes of all files of a run together, or of all files of the arm where they go to a folder; then the oldest is
    /// removed. `None`: no bound.
    pub total_bytes: Option<u64>,
    /// Bytes that stay free on the disk: with less the recording ends.
    pub free_bytes: u64,
}

impl Bounds {
    /// One file, as long as it gets.
    pub const NONE: Self = Self { file_bytes: u64::MAX, total_bytes: None, free_bytes: 0 };
}

/// Nanoseconds from CLOCK_MONOTONIC's zero to 1970 in UTC, as of now: added to a time of the loop it is a time of day.
pub fn wall_clock_offset_ns() -> u64 {
    let before_ns = crate::ipc::monotonic_ns();
    let wall_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as u64);
    let after_ns = crate::ipc::monotonic_ns();
    wall_ns.saturating_sub(before_ns / 2 + after_ns / 2)
}

/// Time of day in UTC as part of a file name: `20261129T223318Z`.
pub fn utc_text(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Days to a date, counted in years that begin in March (Howard Hinnant's civil_from_days).
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!("{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z", rest / 3600, rest / 60 % 60, rest % 60)
}

/// Makes a file that must not be there yet. What is no file, a pipe or a device, holds nothing that could be lost.
///
/// # Errors
/// It is there, or cannot be made.
pub(super) fn make(path: &Path) -> Result<File, RecordingError> {
    let no_file = fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir());
    let made = if no_file { File::options().write(true).open(path) } else { File::create_new(path) };
    made.map_err(|source| {
        let source = match source.kind() {
            io::ErrorKind::AlreadyExists => {
                io::Error::new(source.kind(), "the file is there already; give another name, or a folder")
            }
            _ => source,
        };
        RecordingError::File { path: path.display().to_string(), source }
    })
}

/// The files of a run.
#[derive(Debug)]
pub(super) struct Files {
    folder: PathBuf,
    stem: String,
    extension: String,
    /// Prefix of the arm's files where they go to a folder.
    of_arm: Option<String>,
    bounds: Bounds,
    made: Vec<PathBuf>,
}

impl Files {
    /// Of an arm, at a path: a file, or a folder, in which files are named by arm and start time.
    pub(super) fn new(path: &Path, arm: &str, bounds: Bounds) -> Self {
        let (folder, stem, extension, of_arm) = if path.is_dir() {
            let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
            let prefix = format!("{arm}-");
            (path.to_path_buf(), format!("{prefix}{}", utc_text(seconds)), "mcap".to_owned(), Some(prefix))
        } else {
            let text = |part: Option<&std::ffi::OsStr>| part.map(|p| p.to_string_lossy().into_owned());
            let folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
            let stem = text(path.file_stem()).unwrap_or_default();
            (folder, stem, text(path.extension()).unwrap_or_default(), None)
        };
        Self { folder, stem, extension, of_arm, bounds, made: Vec::new() }
    }

    fn path(&self, number: usize) -> PathBuf {
        let number = if number > 1 { format!("-{number}") } else { String::new() };
        let dot = if self.extension.is_empty() { "" } else { "." };
        self.folder.join(format!("{}{number}{dot}{}", self.stem, self.extension))
    }

    /// The next file.
    ///
    /// # Errors
    /// It cannot be made; a file of that name is there, unless it goes to a folder or is not the first.
    pub(super) fn next(&mut self) -> Result<File, RecordingError> {
        let mut number = self.made.len() + 1;
        let file = loop {
            let path = self.path(number);
            match make(&path) {
                Ok(file) => {
                    self.made.push(path);
                    break file;
                }
                Err(RecordingError::File { source, .. })
                    if source.kind() == io::ErrorKind::AlreadyExists
                        && (self.of_arm.is_some() || !self.made.is_empty())
                        && number < 10_000 =>
                {
                    number += 1;
                }
                Err(error) => return Err(error),
            }
        };
        self.remove_oldest();
        Ok(file)
    }

    /// The file that is written; the first one's name before there is any.
    pub(super) fn current(&self) -> PathBuf {
        self.made.last().cloned().unwrap_or_else(|| self.path(1))
    }

    /// Keeps to the bound of all files together, without the one that is written.
    fn remove_oldest(&mut self) {
        let Some(most) = self.bounds.total_bytes else { return };
        let mut files: Vec<PathBuf> = match &self.of_arm {
            None => self.made.clone(),
            Some(prefix) => {
                let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten().map(|e| e.path());
                let ours = |path: &PathBuf| {
                    path.extension().is_some_and(|e| e == "mcap")
                        && path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix))
                };
                entries.filter(ours).collect()
            }
        };
        let current = self.current();
        files.retain(|file| *file != current && file.symlink_metadata().is_ok_and(|there| there.is_file()));
        files.sort_by_key(|file| file.symlink_metadata().and_then(|there| there.modified()).unwrap_or(UNIX_EPOCH));
        let bytes = |file: &PathBuf| file.symlink_metadata().map_or(0, |there| there.len());
        // The new file will get its share.
        let mut total = files.iter().map(bytes).sum::<u64>().saturating_add(self.bounds.file_bytes);
        for file in files {
            if total <= most {
                return;
            }
            total = total.saturating_sub(bytes(&file));
            let removed = fs::remove_file(&file);
            tracing::info!(file = %file.display(), ?removed, "oldest recording removed");
        }
    }

    /// Whether the file that is written is long enough.
    pub(super) fn is_full(&self, bytes: u64) -> bool {
        bytes >= self.bounds.file_bytes
    }

    /// Refuses to take the last of a disk.
    ///
    /// # Errors
    /// Less is free than is to stay so.
    pub(super) fn check_room(&self) -> Result<(), RecordingError> {
        let folder = if self.folder.as_os_str().is_empty() { Path::new(".") } else { &self.folder };
        let Ok(there) = rustix::fs::statvfs(folder) else { return Ok(()) };
        let free = there.f_bavail.saturating_mul(there.f_frsize);
        if free >= self.bounds.free_bytes {
            return Ok(());
        }
        let why = format!("{} MiB are left on its disk, {} are to stay free", free >> 20, self.bounds.free_bytes >> 20);
        let source = io::Error::new(io::ErrorKind::StorageFull, why);
        Err(RecordingError::File { path: self.current().display().to_string(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_time_of_day_by_hand() {
        for (seconds, text) in [
            (0, "19700101T000000Z"),
            (951_782_399, "20000228T235959Z"),
            (951_782_400, "20000229T000000Z"),
            (1_709_251_199, "20240229T235959Z"),
            (4_102_444_800, "21000101T000000Z"),
        ] {
            assert_eq!(utc_text(seconds), text);
        }
    }

    #[test]
    fn nothing_is_ever_replaced() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("run.mcap");
        let mut files = Files::new(&path, "paper", Bounds::NONE);
        files.next().unwrap();
        assert_eq!(files.current(), path);
        fs::write(place.path().join("run-2.mcap"), "another's").unwrap();
        files.next().unwrap();
        assert_eq!(files.current(), place.path().join("run-3.mcap"));
        assert_eq!(fs::read_to_string(place.path().join("run-2.mcap")).unwrap(), "another's");
        let error = Files::new(&path, "paper", Bounds::NONE).next().unwrap_err().to_string();
        assert!(error.contains("there already") && error.contains("run.mcap"), "{error}");
        // In a folder every start has a name of its own, also within one second.
        for _ in 0..3 {
            Files::new(place.path(), "paper", Bounds::NONE).next().unwrap();
        }
        let named = fs::read_dir(place.path()).unwrap().flatten();
        assert_eq!(named.filter(|e| e.file_name().to_string_lossy().starts_with("paper-2")).count(), 3);
    }

    #[test]
    fn the_oldest_goes_when_all_together_are_too_many_and_nobody_elses_does() {
        let place = tempfile::tempdir().unwrap();
        fs::write(place.path().join("papers.txt"), [0; 5000]).unwrap();
        fs::write(place.path().join("paper-notes.txt"), [0; 5000]).unwrap();
        let bounds = Bounds { file_bytes: 1000, total_bytes: Some(3000), free_bytes: 0 };
        let mut files = Files::new(place.path(), "paper", bounds);
        let mut all = Vec::new();
        for _ in 0..5 {
            files.next().unwrap().write_all(&[0; 1000]).unwrap();
            all.push(files.current());
        }
        let there: Vec<bool> = all.iter().map(|file| file.exists()).collect();
        assert_eq!(there.iter().filter(|there| **there).count(), 3, "{there:?}");
        assert!(there[4] && place.path().join("papers.txt").exists() && place.path().join("paper-notes.txt").exists());
    }

    #[test]
    fn the_last_of_a_disk_is_not_taken() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("run.mcap");
        Files::new(&path, "paper", Bounds::NONE).check_room().unwrap();
        let bounds = Bounds { free_bytes: u64::MAX, ..Bounds::NONE };
        let error = Files::new(&path, "paper", bounds).check_room().unwrap_err().to_string();
        assert!(error.contains("run.mcap") && error.contains("are to stay free"), "{error}");
    }
}
