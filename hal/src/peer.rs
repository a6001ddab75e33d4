//! Who is at the other end of a Unix socket, and what users and groups are called.
//!
//! Enters: a connected socket, names. Leaves: the kernel's word on the peer's process, user and groups as they were when
//! it connected, which the peer cannot forge; ids of names in `/etc/passwd` and `/etc/group`. A directory service is not
//! asked: that may take long, and fail. Its users and groups are named by their numbers.

use std::fs;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};

/// The process at the other end, as the kernel noted it when it connected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Peer {
    /// Process id; 0 if the process cannot be seen from here.
    pub pid: i32,
    /// Effective user.
    pub uid: u32,
    /// Effective group.
    pub gid: u32,
    /// Supplementary groups.
    pub groups: Vec<u32>,
}

impl Peer {
    /// Whether it belongs to a group, by whatever way.
    pub fn is_in(&self, gid: u32) -> bool {
        self.gid == gid || self.groups.contains(&gid)
    }
}

/// Most supplementary groups that Linux permits (`NGROUPS_MAX`).
const GROUPS_MAX: usize = 65536;

/// Asks the kernel who is at the other end.
///
/// # Errors
/// What the kernel reports: no Unix socket, or not connected.
pub fn of(socket: BorrowedFd<'_>) -> io::Result<Peer> {
    let credentials = rustix::net::sockopt::socket_peercred(socket)?;
    // Most have a few; the call says how many there are where that is more.
    let mut groups = vec![0_u32; 64];
    loop {
        let mut length = libc::socklen_t::try_from(size_of_val(groups.as_slice())).map_err(io::Error::other)?;
        // SAFETY: the pointer and the length are those of `groups`, whose elements are gid_t; the kernel writes no more
        // than the length says, and writes the length.
        let done = unsafe {
            libc::getsockopt(
                socket.as_raw_fd(),
                libc::SOL_SOCKET,
                libc::SO_PEERGROUPS,
                groups.as_mut_ptr().cast(),
                &mut length,
            )
        };
        let count = length as usize / size_of::<u32>();
        if done == 0 {
            groups.truncate(count);
            break;
        }
        match io::Error::last_os_error() {
            e if e.raw_os_error() == Some(libc::ERANGE) && count > groups.len() && count <= GROUPS_MAX => {
                groups.resize(count, 0);
            }
            e => return Err(e),
        }
    }
    let pid = credentials.pid.as_raw_nonzero().get();
    Ok(Peer { pid, uid: credentials.uid.as_raw(), gid: credentials.gid.as_raw(), groups })
}

/// The id of a user by name or number; `None` if `/etc/passwd` does not have the name.
pub fn user_id(name: &str) -> Option<u32> {
    name.parse().ok().or_else(|| column(&fs::read_to_string("/etc/passwd").ok()?, name))
}

/// The id of a group by name or number; `None` if `/etc/group` does not have the name.
pub fn group_id(name: &str) -> Option<u32> {
    name.parse().ok().or_else(|| column(&fs::read_to_string("/etc/group").ok()?, name))
}

/// The group of a user; where `/etc/passwd` does not have the user, the group of the same number.
pub fn group_of(uid: u32) -> u32 {
    let table = fs::read_to_string("/etc/passwd").unwrap_or_default();
    let found = table.lines().find_map(|line| {
        let mut numbers = line.split(':').skip(2);
        (numbers.next()?.parse() == Ok(uid)).then(|| numbers.next()?.parse().ok())?
    });
    found.unwrap_or(uid)
}

/// What a user is called, for people: `name (uid)`, or the number alone.
pub fn user_text(uid: u32) -> String {
    let table = fs::read_to_string("/etc/passwd").unwrap_or_default();
    let found = table.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(uid)).then(|| format!("{name} ({uid})"))
    });
    found.unwrap_or_else(|| uid.to_string())
}

/// The third column of the line that begins with a name.
fn column(table: &str, name: &str) -> Option<u32> {
    let line = table.lines().find(|line| line.split(':').next() == Some(name))?;
    line.split(':').nth(2)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::fd::AsFd;
    use std::os::unix::net::UnixStream;

    #[test]
    fn the_peer_of_an_own_socket_is_this_process() {
        let (here, _there) = UnixStream::pair().unwrap();
        let peer = of(here.as_fd()).unwrap();
        assert_eq!(peer.pid, std::process::id() as i32);
        assert_eq!(peer.uid, rustix::process::geteuid().as_raw());
        let own = rustix::process::getgroups().unwrap();
        assert_eq!(peer.groups, own.iter().map(|gid| gid.as_raw()).collect::<Vec<_>>());
        assert!(peer.is_in(rustix::process::getegid().as_raw()));
    }

    #[test]
    fn names_are_found_whole_and_numbers_stand_for_themselves() {
        let table = "root:x:0:0::/root:/bin/sh\nrobot:x:998:997::/:/bin/false\nrobots:x:12:12::/:\nbroken\n";
        assert_eq!(column(table, "robot"), Some(998));
        assert_eq!(column(table, "robots"), Some(12));
        assert_eq!((column(table, "rob"), column(table, "broken"), column(table, "")), (None, None, None));
        assert_eq!(user_id("4711"), Some(4711));
        assert_eq!((user_id("root"), group_id("root")), (Some(0), Some(0)));
        assert_eq!(user_text(0), "root (0)");
    }
}
