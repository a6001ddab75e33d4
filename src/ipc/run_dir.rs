//! Where what is private to a user lies: the arm's socket, and the lock by which processes of that user take turns.
//!
//! Enters: a folder that the environment or the configuration names, or none. Leaves: a folder that nobody but its owner
//! can write to, or the reason why there is none. A folder made beforehand by somebody else, or a symbolic link in its
//! place, is never used: whoever owns a folder decides what is in it.

use super::IpcError;
use rustix::process::geteuid;
use sinew_hal::peer::user_text;
use std::fs::{self, DirBuilder};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

/// Environment variable with the folder of the arms' sockets.
pub const RUN_VARIABLE: &str = "SINEW_RUN_DIR";

/// The system's folder: root makes it, or a service manager (`RuntimeDirectory=sinew`).
const SYSTEM: &str = "/run/sinew";

/// The folder of the environment, which precedes that of the configuration.
pub fn run_dir(configured: Option<&Path>) -> Option<PathBuf> {
    std::env::var_os(RUN_VARIABLE).map(PathBuf::from).or_else(|| configured.map(Path::to_path_buf))
}

fn of_session(uid: u32) -> PathBuf {
    PathBuf::from(format!("/run/user/{uid}/sinew"))
}

fn of_user(uid: u32) -> PathBuf {
    PathBuf::from(format!("/tmp/sinew-{uid}"))
}

/// Refuses what is no folder, is another user's, or can be written to by others. Its owner.
///
/// # Errors
/// [`IpcError::Foreign`], which says what is wrong with it.
pub(crate) fn check(folder: &Path, owners: &[u32]) -> Result<u32, IpcError> {
    let foreign = |why: String| IpcError::Foreign { path: folder.to_path_buf(), why };
    // With a slash at its end a link would be followed.
    let bare: PathBuf = folder.components().collect();
    let there = fs::symlink_metadata(&bare).map_err(|e| foreign(e.to_string()))?;
    if there.file_type().is_symlink() {
        return Err(foreign("it is a symbolic link".into()));
    }
    if !there.is_dir() {
        return Err(foreign("it is no folder".into()));
    }
    if !owners.is_empty() && !owners.contains(&there.uid()) {
        return Err(foreign(format!("it belongs to user {}", user_text(there.uid()))));
    }
    if there.mode() & 0o022 != 0 {
        return Err(foreign(format!("others may write to it (mode {:03o})", there.mode() & 0o777)));
    }
    Ok(there.uid())
}

/// Makes a folder unless it is there; then it must be this user's own, and nobody else may write to it.
///
/// # Errors
/// [`IpcError::Foreign`].
pub(crate) fn make(folder: &Path) -> Result<(), IpcError> {
    match DirBuilder::new().mode(0o755).create(folder) {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
        Err(e) => return Err(IpcError::Foreign { path: folder.to_path_buf(), why: format!("it cannot be made: {e}") }),
    }
    check(folder, &[geteuid().as_raw()]).map(drop)
}

/// This user's folder, made unless it is there: the given one, or the first of the usual ones that can be had.
///
/// # Errors
/// [`IpcError::Foreign`]: of the given one, or of the last.
pub(crate) fn own(given: Option<&Path>) -> Result<PathBuf, IpcError> {
    let uid = geteuid().as_raw();
    if let Some(folder) = given {
        return make(folder).map(|()| folder.to_path_buf());
    }
    let session = of_session(uid);
    let in_session = session.parent().is_some_and(|parent| check(parent, &[uid]).is_ok());
    for folder in [PathBuf::from(SYSTEM)].into_iter().chain(in_session.then_some(session)) {
        match make(&folder) {
            Ok(()) => return Ok(folder),
            Err(error) => tracing::debug!(%error, "not used"),
        }
    }
    let last = of_user(uid);
    make(&last).map(|()| last)
}

/// Folders in which a daemon's socket may lie, the most trusted first, with the users that may own it (none: any). Root
/// looks into those of all users.
pub(crate) fn to_search(given: Option<&Path>) -> Vec<(PathBuf, Vec<u32>)> {
    let uid = geteuid().as_raw();
    if let Some(folder) = given {
        return vec![(folder.to_path_buf(), Vec::new())];
    }
    // Only root can make a folder in /run, so whoever owns this one was given it.
    let mut folders = vec![(PathBuf::from(SYSTEM), Vec::new())];
    let mut add = |uid: u32| folders.extend([of_session(uid), of_user(uid)].map(|folder| (folder, vec![uid])));
    add(uid);
    if uid == 0 {
        let users = |folder: &str, prefix: &str| {
            let entries = fs::read_dir(folder).into_iter().flatten().flatten();
            let id = |entry: fs::DirEntry| entry.file_name().to_str()?.strip_prefix(prefix)?.parse().ok();
            entries.filter_map(id).collect::<Vec<u32>>()
        };
        let mut others = [users("/run/user", ""), users("/tmp", "sinew-")].concat();
        others.sort_unstable();
        others.dedup();
        others.into_iter().filter(|other| *other != uid).for_each(add);
    }
    folders
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    fn why(result: Result<(), IpcError>) -> String {
        match result {
            Err(IpcError::Foreign { why, .. }) => why,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn only_an_own_folder_that_nobody_else_can_write_to_is_used() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        make(&at("new")).unwrap();
        make(&at("new")).unwrap();
        assert_eq!(fs::metadata(at("new")).unwrap().mode() & 0o022, 0);
        fs::set_permissions(at("new"), fs::Permissions::from_mode(0o777)).unwrap();
        assert!(why(make(&at("new"))).contains("others may write to it (mode 777)"));
        fs::set_permissions(at("new"), fs::Permissions::from_mode(0o755)).unwrap();
        symlink(at("new"), at("link")).unwrap();
        for link in ["link", "link/"] {
            assert_eq!(why(make(&at(link))), "it is a symbolic link");
        }
        fs::write(at("file"), "").unwrap();
        assert_eq!(why(make(&at("file"))), "it is no folder");
        assert!(why(make(&at("no/where"))).contains("cannot be made"));
        let other = geteuid().as_raw() + 1;
        assert!(why(check(&at("new"), &[other]).map(drop)).contains("it belongs to user"));
        assert_eq!(own(Some(&at("new"))).unwrap(), at("new"));
    }
}
