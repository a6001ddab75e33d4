//! Where services live: prefix, root path, node, and what is left behind.

use super::IpcError;
use super::run_dir::{self, run_dir};
use iceoryx2::prelude::*;
use rustix::fs::{FlockOperation, flock};
use rustix::process::geteuid;
use sinew_hal::peer::user_text;
use std::fs::{DirBuilder, File, OpenOptions};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path as FsPath, PathBuf};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant, SystemTime};

/// Service variant of every port here: like `ipc::Service`, and its ports may move to another thread.
pub(crate) type Ipc = ipc_threadsafe::Service;

/// Environment variable with the prefix of all files in shared memory.
pub const PREFIX_VARIABLE: &str = "SINEW_IPC_PREFIX";
/// Environment variable with the root path of iceoryx2's own files.
pub const ROOT_VARIABLE: &str = "SINEW_IPC_ROOT";

/// Processes see each other when they use the same domain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    prefix: String,
    root: PathBuf,
}

impl Default for Domain {
    /// iceoryx2's own defaults, so that a client without any configuration finds the services.
    fn default() -> Self {
        Self { prefix: "iox2_".into(), root: "/tmp/iceoryx2/".into() }
    }
}

impl Domain {
    /// A domain of its own.
    pub fn new(prefix: impl Into<String>, root: impl Into<PathBuf>) -> Self {
        Self { prefix: prefix.into(), root: root.into() }
    }

    /// The default domain, with what the environment overrides ([`PREFIX_VARIABLE`], [`ROOT_VARIABLE`]).
    pub fn from_env() -> Self {
        let mut domain = Self::default();
        if let Ok(prefix) = std::env::var(PREFIX_VARIABLE) {
            domain.prefix = prefix;
        }
        if let Some(root) = std::env::var_os(ROOT_VARIABLE) {
            domain.root = root.into();
        }
        domain
    }

    /// The environment that puts a child process into this domain.
    pub fn env(&self) -> [(&'static str, std::ffi::OsString); 2] {
        [(PREFIX_VARIABLE, self.prefix.clone().into()), (ROOT_VARIABLE, self.root.clone().into())]
    }

    /// Refuses names that no process can use.
    ///
    /// # Errors
    /// [`IpcError::Name`].
    pub fn check(&self) -> Result<(), IpcError> {
        self.config().map(drop)
    }

    fn config(&self) -> Result<Config, IpcError> {
        let mut config = Config::default();
        config.global.prefix = FileName::new(self.prefix.as_bytes()).map_err(|e| IpcError::Name {
            what: "prefix",
            value: self.prefix.clone(),
            why: format!("{e:?}"),
        })?;
        let root = self.root.to_string_lossy();
        if !self.root.is_absolute() {
            let why = format!("expected a path that starts with / (`ipc.root_path`, {ROOT_VARIABLE})");
            return Err(IpcError::Name { what: "root path", value: root.into_owned(), why });
        }
        let path = Path::new(root.as_bytes()).map_err(|e| IpcError::Name {
            what: "root path",
            value: root.clone().into_owned(),
            why: format!("{e:?}"),
        })?;
        config.global.set_root_path(&path);
        Ok(config)
    }

    /// Removes what iceoryx2 leaves when its last node is gone: what killed processes could not remove, and a counter of 16
    /// bytes per prefix. The counter stays while any node of the domain lives.
    ///
    /// A process that starts in the same instant keeps the counter that it has opened; node ids stay unique because they
    /// hold the process id and the time too.
    pub fn sweep(&self) {
        let Ok(config) = self.config() else { return };
        let _turn = turn();
        let mut in_use = false;
        let listed = Node::<Ipc>::list(&config, |node| {
            let gone = match node {
                NodeState::Dead(dead) => dead.try_remove_stale_resources().is_ok(),
                _ => false,
            };
            in_use |= !gone;
            if in_use { CallbackProgression::Stop } else { CallbackProgression::Continue }
        });
        if listed.is_err() || in_use {
            return;
        }
        for directory in [FsPath::new(SHARED_MEMORY), self.root.as_path()] {
            let Ok(entries) = std::fs::read_dir(directory) else { continue };
            for entry in entries.flatten() {
                let name = entry.file_name();
                let name = name.to_string_lossy();
                if name.starts_with(&self.prefix) && name.ends_with(".global_mgmt") {
                    // Somebody else may have been faster: the file is gone either way.
                    let _ = std::fs::remove_file(entry.path());
                }
            }
        }
        // The default root is shared with whatever else uses iceoryx2; another one is ours. Only empty folders go.
        if *self != Self::default() {
            for folder in [self.root.join("nodes"), self.root.join("services"), self.root.clone()] {
                let _ = std::fs::remove_dir(folder);
            }
        }
    }
}

/// Where POSIX shared memory lies.
const SHARED_MEMORY: &str = "/dev/shm";
/// Longest wait for one's turn; a process that was stopped while it had the turn does not stop the others.
const TURN: Duration = Duration::from_millis(500);
/// Age beyond which a file that is not finished belongs to nobody any more. Finishing one takes microseconds, and on a busy
/// machine as long as its maker has no processor.
const DEAD: Duration = Duration::from_secs(3);
/// The same for the file that a node is made by: whoever has the turn makes none.
const DEAD_NODE: Duration = Duration::from_millis(300);
/// Longest that iceoryx2 may take to set something up. It waits without end for some of what dead processes leave.
pub(crate) const SET_UP: Duration = Duration::from_secs(20);
/// Of which for the node.
const NODE: Duration = Duration::from_secs(15);
/// Room that a daemon and its clients need in shared memory (bytes), with a margin.
const ROOM: u64 = 4 << 20;

/// Holds this user's other processes off while a node is made or the last one's leftovers are swept: in between, a
/// client that finds no daemon would take files away from under a node that is just coming up. The lock is on a file
/// that no other user can open, and ends with its process. Where it cannot be had in time all goes on unlocked: it
/// keeps a rare collision away, which the daemon's second attempt mends as well.
fn turn() -> Option<File> {
    let folder = run_dir::own(run_dir(None).as_deref()).ok()?;
    let no_follow = rustix::fs::OFlags::NOFOLLOW.bits() as i32;
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(0o600).custom_flags(no_follow);
    let file = options.open(folder.join("turn")).ok()?;
    let deadline = Instant::now() + TURN;
    while flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
        if Instant::now() > deadline {
            tracing::debug!("another process has the turn and does not give it back");
            return None;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Some(file)
}

/// Runs what iceoryx2 might never come back from. After the time-out its thread is left to itself: it has nothing that
/// anybody waits for.
///
/// # Errors
/// Those of `set_up`; [`IpcError::Unusable`] after the time-out.
pub(crate) fn within<T: Send + 'static>(
    limit: Duration,
    set_up: impl FnOnce() -> Result<T, IpcError> + Send + 'static,
) -> Result<T, IpcError> {
    let (done, result) = mpsc::sync_channel(1);
    let thread = std::thread::Builder::new().name("sinew-set-up".into());
    let set_up = move || {
        // Nobody listens after the time-out; what came too late is dropped here.
        let _ = done.send(set_up());
    };
    if let Err(error) = thread.spawn(set_up) {
        return Err(IpcError::Unusable { why: format!("no thread could be started: {error}") });
    }
    match result.recv_timeout(limit) {
        Ok(result) => result,
        Err(mpsc::RecvTimeoutError::Timeout) => {
            let why =
                format!("it was not set up within {} s; is there a file of 0 bytes in /dev/shm?", limit.as_secs());
            Err(IpcError::Unusable { why })
        }
        Err(mpsc::RecvTimeoutError::Disconnected) => {
            Err(IpcError::Unusable { why: "setting it up panicked; this is a defect of sinew or iceoryx2".into() })
        }
    }
}

/// Free bytes for this user in the file system of a folder; `None` if it cannot be told.
fn room(folder: &FsPath) -> Option<u64> {
    let there = rustix::fs::statvfs(folder).ok()?;
    // A file system without a limit on files tells 0 of 0.
    let files = there.f_files == 0 || there.f_favail > 0;
    Some(if files { there.f_bavail.saturating_mul(there.f_frsize) } else { 0 })
}

/// Refuses what would end every process here with SIGBUS at its first write.
fn check_room(folder: &FsPath) -> Result<(), IpcError> {
    match room(folder) {
        Some(room) if room < ROOM => {
            let (path, kib) = (folder.display(), room >> 10);
            let why = format!("{path} is full: {kib} KiB left, {} KiB needed; see `df {path}`", ROOM >> 10);
            Err(IpcError::Unusable { why })
        }
        _ => Ok(()),
    }
}

/// What keeps something from being set up, where it can be found out: iceoryx2 has one word for all of it.
pub(crate) fn cause(error: IpcError) -> IpcError {
    if !matches!(error, IpcError::Port { .. }) {
        return error;
    }
    let files = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    let none_left = File::open("/dev/null").is_err_and(|e| [Some(24), Some(23)].contains(&e.raw_os_error()));
    if none_left || files.is_some_and(|files| files < FILES) {
        let limit = files.map_or("no".to_owned(), |files| files.to_string());
        let why = format!("{error}; no file descriptor is left (limit {limit}, `ulimit -n`; {FILES} are enough)");
        return IpcError::Unusable { why };
    }
    check_room(FsPath::new(SHARED_MEMORY)).err().unwrap_or(error)
}

/// Open files with which a daemon with all its clients gets by.
const FILES: u64 = 1024;

impl Domain {
    /// Refuses a root path that is not this user's own: whoever owns it decides which services there are, and a process of
    /// another user, be it root, leaves files there that the daemon cannot open and waits for.
    fn check_root(&self) -> Result<(), IpcError> {
        let parents = self.root.parent().filter(|parent| !parent.exists());
        if let Some(parents) = parents {
            let failed = |e: std::io::Error| IpcError::Foreign { path: parents.to_path_buf(), why: e.to_string() };
            DirBuilder::new().recursive(true).mode(0o755).create(parents).map_err(failed)?;
        }
        let own = run_dir::make(&self.root).and_then(|()| {
            let below = ["nodes", "services"].map(|name| self.root.join(name)).into_iter();
            below
                .filter(|folder| folder.symlink_metadata().is_ok())
                .try_for_each(|folder| run_dir::check(&folder, &[geteuid().as_raw()]).map(drop))
        });
        own.map_err(|error| match error {
            IpcError::Foreign { path, why } => {
                let why = format!(
                    "{why}; run this as the daemon's user, or give the daemon and its clients a folder of their own \
                     (`ipc.root_path`, or {ROOT_VARIABLE})"
                );
                IpcError::Foreign { path, why }
            }
            other => other,
        })
    }

    /// Removes what processes that died while making it left in shared memory: without a size or without the owner's right
    /// to read, it is waited for without end. What others left, and this process cannot remove, is told.
    fn remove_unfinished(&self, has_turn: bool) -> Result<(), IpcError> {
        let uid = geteuid().as_raw();
        let deadline = Instant::now() + DEAD + DEAD_NODE;
        loop {
            let mut young = false;
            let Ok(entries) = std::fs::read_dir(SHARED_MEMORY) else { return Ok(()) };
            for entry in entries.flatten() {
                if !entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                    continue;
                }
                let Ok(there) = entry.metadata() else { continue };
                if !there.is_file() || (there.len() > 0 && there.mode() & 0o400 != 0) {
                    continue;
                }
                let changed = SystemTime::UNIX_EPOCH + Duration::new(there.ctime() as u64, there.ctime_nsec() as u32);
                // Only this one is waited for by whoever makes a node.
                let of_nodes = entry.file_name().to_string_lossy().ends_with(".global_mgmt");
                let dead = if of_nodes && has_turn { DEAD_NODE } else { DEAD };
                if changed.elapsed().is_ok_and(|age| age < dead) {
                    young |= of_nodes;
                    continue;
                }
                if [there.uid(), 0].contains(&uid) {
                    let removed = std::fs::remove_file(entry.path());
                    tracing::warn!(file = %entry.path().display(), ?removed, "left unfinished by a dead process");
                } else {
                    let why = format!(
                        "a process of user {} left it unfinished; that user or root must remove it, or give the daemon \
                         and its clients another prefix (`ipc.prefix`, or {PREFIX_VARIABLE})",
                        user_text(there.uid())
                    );
                    return Err(IpcError::Foreign { path: entry.path(), why });
                }
            }
            if !young || Instant::now() > deadline {
                return Ok(());
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// A node, removed with its leftovers when the last port that it serves is gone.
#[derive(Debug)]
pub(crate) struct Session {
    node: Option<Node<Ipc>>,
    domain: Domain,
}

impl Session {
    /// Creates the node; dead nodes of the domain are cleaned on the way.
    pub(crate) fn open(domain: &Domain, name: &str) -> Result<Arc<Self>, IpcError> {
        let config = domain.config()?;
        let node_name = NodeName::new(name).map_err(|e| IpcError::Name {
            what: "node name",
            value: name.into(),
            why: format!("{e:?}"),
        })?;
        let turn = turn();
        domain.check_root()?;
        check_room(FsPath::new(SHARED_MEMORY))?;
        check_room(&domain.root)?;
        domain.remove_unfinished(turn.is_some())?;
        let name = name.to_owned();
        let create = move || {
            NodeBuilder::new()
                .name(&node_name)
                // Signals belong to the program, not to its libraries.
                .signal_handling_mode(SignalHandlingMode::Disabled)
                .config(&config)
                .create::<Ipc>()
                .map_err(|e| cause(IpcError::port("creating the node", &name, e)))
        };
        let node = within(NODE, create)?;
        drop(turn);
        Ok(Arc::new(Self { node: Some(node), domain: domain.clone() }))
    }

    pub(crate) fn service(&self, name: &str) -> Result<iceoryx2::service::builder::Builder<Ipc>, IpcError> {
        let service_name = ServiceName::new(name).map_err(|e| IpcError::Name {
            what: "service name",
            value: name.into(),
            why: format!("{e:?}"),
        })?;
        match &self.node {
            Some(node) => Ok(node.service_builder(&service_name)),
            None => Err(IpcError::port("opening", name, "the node is closed")),
        }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        drop(self.node.take());
        self.domain.sweep();
    }
}
