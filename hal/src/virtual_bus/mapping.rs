//! The shared file's life: made by the first handle, removed by the last, taken over after a crash.
//!
//! Every process that has the bus open holds a shared `flock` on the file, which the kernel releases even after SIGKILL.
//! Whoever gets the lock exclusively is therefore alone: at opening it makes the content afresh (a file left by a
//! killed process is never trusted), at closing it removes the file. A lock obtained on a file that somebody has removed
//! meanwhile is recognised by its inode, and the opening starts again.
//!
//! The file can be shortened by any process that may write it, which would end every user of the bus with SIGBUS; so it
//! is made for its owner and group only.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::ptr::NonNull;
use std::time::Duration;

use rustix::fs::FlockOperation;
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags};

use super::OpenVirtualError;
use super::layout::{self, FILE_LEN, Header, SLOTS, SLOTS_OFFSET, Slot};

/// Attempts at opening before giving up; each failure means that another process was opening or closing just then.
const ATTEMPTS: u32 = 1000;

/// The mapped file, with a shared lock on it.
pub(super) struct Mapping {
    base: NonNull<u8>,
    file: File,
    path: PathBuf,
}

// SAFETY: the mapping is reached only through `header` and `slots`, whose types consist of atomics, and stays valid
// until drop; the remaining fields are Send and Sync.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Mapping {
    /// Opens or makes the file.
    pub(super) fn open(path: &Path) -> Result<Self, OpenVirtualError> {
        let fail = |e: io::Error| OpenVirtualError::File { path: path.into(), source: e };
        let mut found = None;
        for attempt in 0..ATTEMPTS {
            let file = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false) // others may be using it
                .mode(0o660)
                // A link there would make afresh whatever it points to.
                .custom_flags(libc::O_NOFOLLOW)
                .open(path)
                .map_err(fail)?;
            trusted(&file).map_err(fail)?;
            match rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => initialise(&file).map_err(fail)?,
                Err(Errno::WOULDBLOCK) => {}
                Err(e) => return Err(fail(e.into())),
            }
            // Waits for whoever initialises. From here to drop the file cannot be made afresh by anybody.
            lock_shared(&file).map_err(fail)?;
            match usable(&file, path).map_err(fail)? {
                Usable::Yes => return Self::map(file, path).map_err(fail),
                Usable::Replaced => {}
                Usable::No(version) => found = Some(version),
            }
            if found.is_some() && attempt > 20 {
                break;
            }
            drop(file);
            std::thread::sleep(Duration::from_millis(u64::from(attempt.min(5))));
        }
        Err(match found {
            Some(version) => OpenVirtualError::Layout { path: path.into(), version, expected: layout::VERSION },
            None => fail(io::ErrorKind::TimedOut.into()),
        })
    }

    fn map(file: File, path: &Path) -> io::Result<Self> {
        // SAFETY: a new mapping at an address of the kernel's choice; the length was checked to be the file's, which is
        // not shortened while the shared lock is held.
        let base = unsafe {
            rustix::mm::mmap(
                std::ptr::null_mut(),
                FILE_LEN,
                ProtFlags::READ | ProtFlags::WRITE,
                // Populated now: the first use of a slot must not fault in the control loop.
                MapFlags::SHARED | MapFlags::POPULATE,
                &file,
                0,
            )?
        };
        let base = NonNull::new(base.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self { base, file, path: path.into() })
    }

    /// Locks a byte of the file for this mapping alone; false if another has it. Released with the file, whatever ends
    /// it. Such locks (of open file descriptions) know nothing of the `flock` on the whole file.
    pub(super) fn claim(&self, byte: u8) -> io::Result<bool> {
        let lock = libc::flock {
            l_type: libc::F_WRLCK as libc::c_short,
            l_whence: libc::SEEK_SET as libc::c_short,
            l_start: libc::off_t::from(byte),
            l_len: 1,
            l_pid: 0,
        };
        // SAFETY: the descriptor is this mapping's own open file, and the kernel only reads the structure, which outlives
        // the call.
        if unsafe { libc::fcntl(self.file.as_raw_fd(), libc::F_OFD_SETLK, &lock) } == 0 {
            return Ok(true);
        }
        match io::Error::last_os_error() {
            e if matches!(e.raw_os_error(), Some(libc::EAGAIN | libc::EACCES)) => Ok(false),
            e => Err(e),
        }
    }

    /// Fixed part.
    pub(super) fn header(&self) -> &Header {
        // SAFETY: the mapping is FILE_LEN >= size_of::<Header>() bytes, page aligned, lives as long as self, and all
        // of Header is atomics, for which any bytes and concurrent writers are valid.
        unsafe { self.base.cast::<Header>().as_ref() }
    }

    /// The slot of a ticket, whatever the ticket is.
    pub(super) fn slot(&self, ticket: u64) -> &Slot {
        let index = (ticket % SLOTS) as usize;
        // SAFETY: SLOTS_OFFSET is a multiple of Slot's alignment and the mapping is page aligned; index < SLOTS, so the
        // slot ends within FILE_LEN; Slot is atomics, valid for any bytes and concurrent writers.
        unsafe { self.base.byte_add(SLOTS_OFFSET).cast::<Slot>().add(index).as_ref() }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // Asking for the exclusive lock gives the shared one up even if refused, so of several handles that close at
        // once exactly the last one finds itself alone.
        if rustix::fs::flock(&self.file, FlockOperation::NonBlockingLockExclusive).is_ok()
            && same_file(&self.file, &self.path).unwrap_or(false)
        {
            let _ = std::fs::remove_file(&self.path);
        }
        // SAFETY: this is the mapping made in `map`; references into it borrow self and are gone.
        let _ = unsafe { rustix::mm::munmap(self.base.as_ptr().cast(), FILE_LEN) };
    }
}

/// Refuses the file of another user, and one that others may write: whoever can shorten it ends all who use it.
fn trusted(file: &File) -> io::Result<()> {
    let there = file.metadata()?;
    let refused = |why: String| Err(io::Error::new(io::ErrorKind::PermissionDenied, why));
    if !there.is_file() {
        return refused("it is no file".into());
    }
    if there.uid() != rustix::process::geteuid().as_raw() {
        return refused(format!("it belongs to user {}", crate::peer::user_text(there.uid())));
    }
    if there.mode() & 0o002 != 0 {
        return refused(format!("everybody may write to it (mode {:03o})", there.mode() & 0o777));
    }
    Ok(())
}

/// Whether another open file has the lock of [`Mapping::claim`].
pub(super) fn is_claimed(path: &Path, byte: u8) -> io::Result<bool> {
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW).open(path)?;
    let mut lock = libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: libc::off_t::from(byte),
        l_len: 1,
        l_pid: 0,
    };
    // SAFETY: the descriptor is `file`'s own, and the kernel reads and writes the structure, which outlives the call.
    if unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_GETLK, &mut lock) } != 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(lock.l_type != libc::F_UNLCK as libc::c_short)
}

/// Removes a bus's file if no process has it open; true if there was one.
pub(super) fn remove_stale(path: &Path) -> io::Result<bool> {
    let file = match OpenOptions::new().read(true).write(true).open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(false),
        Err(e) => return Err(e),
    };
    match rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) if same_file(&file, path)? => std::fs::remove_file(path).map(|()| true),
        Ok(()) | Err(Errno::WOULDBLOCK) => Ok(false),
        Err(e) => Err(e.into()),
    }
}

/// Makes the content afresh; only under the exclusive lock.
fn initialise(file: &File) -> io::Result<()> {
    file.set_len(0)?;
    file.set_len(FILE_LEN as u64)?;
    // Reserves the pages now: on a full file system this fails here, and not with SIGBUS at a later write.
    rustix::fs::fallocate(file, rustix::fs::FallocateFlags::empty(), 0, FILE_LEN as u64)?;
    file.write_all_at(&layout::initial_header(), 0)
}

fn lock_shared(file: &File) -> io::Result<()> {
    loop {
        match rustix::fs::flock(file, FlockOperation::LockShared) {
            Err(Errno::INTR) => {}
            other => return other.map_err(Into::into),
        }
    }
}

enum Usable {
    Yes,
    /// Removed or replaced between opening and locking.
    Replaced,
    /// Another layout (its version), or none (0).
    No(u32),
}

fn usable(file: &File, path: &Path) -> io::Result<Usable> {
    if !same_file(file, path)? {
        return Ok(Usable::Replaced);
    }
    let mut start = [0; 24];
    if file.metadata()?.len() < 24 {
        return Ok(Usable::No(0));
    }
    file.read_exact_at(&mut start, 0)?;
    Ok(match layout::check_header(&start) {
        Ok(()) if file.metadata()?.len() == FILE_LEN as u64 => Usable::Yes,
        Ok(()) => Usable::No(layout::VERSION),
        Err(version) => Usable::No(version.unwrap_or(0)),
    })
}

fn same_file(file: &File, path: &Path) -> io::Result<bool> {
    let ours = file.metadata()?;
    match std::fs::metadata(path) {
        Ok(there) => Ok(there.ino() == ours.ino() && there.dev() == ours.dev()),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(e) => Err(e),
    }
}
