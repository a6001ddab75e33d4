//! Where services live: prefix, root path, node, and what is left behind.

use super::IpcError;
use iceoryx2::prelude::*;
use std::path::{Path as FsPath, PathBuf};
use std::sync::Arc;

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

    fn config(&self) -> Result<Config, IpcError> {
        let mut config = Config::default();
        config.global.prefix = FileName::new(self.prefix.as_bytes()).map_err(|e| IpcError::Name {
            what: "prefix",
            value: self.prefix.clone(),
            why: format!("{e:?}"),
        })?;
        let root = self.root.to_string_lossy();
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
        for directory in [FsPath::new("/dev/shm"), self.root.as_path()] {
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

/// Holds other processes of this machine off while a node is made or the last one's leftovers are swept: in between, a
/// client that finds no daemon would take files away from under a node that is just coming up. The lock is on the
/// folder itself, so it leaves no file, and it ends with its process. Without it (no such folder) all goes on unlocked.
fn turn() -> Option<std::fs::File> {
    let folder = std::fs::File::open("/dev/shm").ok()?;
    rustix::fs::flock(&folder, rustix::fs::FlockOperation::LockExclusive).ok()?;
    Some(folder)
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
        let _turn = turn();
        let node = NodeBuilder::new()
            .name(&node_name)
            // Signals belong to the program, not to its libraries.
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .config(&config)
            .create::<Ipc>()
            .map_err(|e| IpcError::port("creating the node", name, e))?;
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
