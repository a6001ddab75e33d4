//! The daemon's side of the socket: a thread that listens and never waits for one of those who speak.

use super::{Address, Answer, Said, Word};
use crate::config::{AccessConfig, Who};
use crate::daemon::DaemonError;
use crate::daemon::records::refusal_text;
use crate::ipc::payload::{RefusalReason, Verdict, speed_text};
use crate::ipc::{DirectEnd, IpcError, Reply, run_dir};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use sinew_hal::peer::{self, Peer, group_id, user_id, user_text};
use std::fs;
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

/// Connections that may be open at once; a further one takes the place of the oldest that has said nothing yet.
const CONNECTIONS_MAX: usize = 32;
/// How long somebody may take to say a word.
const PATIENCE: Duration = Duration::from_secs(1);
/// How long the control thread may take over an answer: it looks every period.
const ANSWER: Duration = Duration::from_secs(1);
/// Longest line.
const LINE_BYTES_MAX: usize = 64;

/// Users and groups, as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Permitted {
    own: u32,
    users: Vec<u32>,
    groups: Vec<u32>,
}

impl Permitted {
    fn new(key: &'static str, list: Option<&[Who]>) -> Result<Self, DaemonError> {
        let own = rustix::process::geteuid().as_raw();
        let Some(list) = list else {
            return Ok(Self { own, users: Vec::new(), groups: vec![rustix::process::getegid().as_raw()] });
        };
        let mut permitted = Self { own, users: Vec::new(), groups: Vec::new() };
        for who in list {
            let (kind, name, id, ids) = match who {
                Who::User(name) => ("user", name, user_id(name), &mut permitted.users),
                Who::Group(name) => ("group", name, group_id(name), &mut permitted.groups),
            };
            ids.push(id.ok_or_else(|| DaemonError::Access { key, kind, name: name.clone() })?);
        }
        Ok(permitted)
    }

    fn contains(&self, peer: &Peer) -> bool {
        [0, self.own].contains(&peer.uid)
            || self.users.contains(&peer.uid)
            || self.groups.iter().any(|group| peer.is_in(*group))
    }
}

/// The socket, bound; removed when this is dropped.
#[derive(Debug)]
pub(crate) struct OperatorSocket {
    listener: UnixListener,
    path: PathBuf,
    stop: Permitted,
    see: Permitted,
}

impl OperatorSocket {
    /// Makes the socket, in place of one that a killed daemon left.
    ///
    /// # Errors
    /// [`DaemonError::Access`] for a name that nobody has; a folder that cannot be had or trusted; a daemon that listens
    /// there already.
    pub(crate) fn bind(address: &Address, access: &AccessConfig) -> Result<Self, DaemonError> {
        let stop = Permitted::new("stop", access.stop.as_deref())?;
        let see = Permitted::new("see", access.see.as_deref())?;
        let base = run_dir::own(address.given.as_deref())?;
        run_dir::make(&base.join(&address.arm))?;
        let path = address.path_in(&base);
        let socket = |source| DaemonError::Socket { path: path.clone(), source };
        if super::open(&path).is_ok() {
            return Err(IpcError::AlreadyRunning { arm: address.arm.clone() }.into());
        }
        match fs::remove_file(&path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(socket(e)),
            _ => {}
        }
        let listener = UnixListener::bind(&path).map_err(socket)?;
        let this = Self { listener, path: path.clone(), stop, see };
        let mode = this.mode();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).map_err(socket)?;
        this.listener.set_nonblocking(true).map_err(socket)?;
        Ok(this)
    }

    /// Where it is.
    pub(crate) fn path(&self) -> &std::path::Path {
        &self.path
    }

    /// Keeps those out who may ask for nothing, as far as the file system can; the rest is asked of the kernel.
    fn mode(&self) -> u32 {
        let users = !self.stop.users.is_empty() || !self.see.users.is_empty();
        let mut groups = [self.stop.groups.as_slice(), &self.see.groups].concat();
        groups.sort_unstable();
        groups.dedup();
        match (users, groups.as_slice()) {
            (false, []) => 0o600,
            (false, [group]) if chown(&self.path, None, Some(*group)).is_ok() => 0o660,
            _ => 0o666,
        }
    }
}

impl Drop for OperatorSocket {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
        // The arm's folder, unless a daemon of another domain has its socket there.
        if let Some(folder) = self.path.parent() {
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Somebody who has connected.
#[derive(Debug)]
struct Guest {
    stream: UnixStream,
    peer: Peer,
    since: Instant,
    line: Vec<u8>,
    /// Waits for the control thread's answer to this.
    asked: Option<(u64, Word)>,
}

/// What becomes of a guest after a look.
enum Next {
    Stays,
    Goes,
    /// Wants the report.
    Status,
}

/// The thread that listens.
#[derive(Debug)]
pub(crate) struct Desk {
    socket: OperatorSocket,
    direct: DirectEnd,
    /// Reports are made elsewhere: they take milliseconds, and an order must not wait for one.
    status: SyncSender<UnixStream>,
    guests: Vec<Guest>,
}

impl Desk {
    pub(crate) fn new(socket: OperatorSocket, direct: DirectEnd, status: SyncSender<UnixStream>) -> Self {
        Self { socket, direct, status, guests: Vec::with_capacity(CONNECTIONS_MAX) }
    }

    /// Listens until `stop` is set.
    pub(crate) fn run(mut self, stop: &AtomicBool) {
        while !stop.load(Ordering::Acquire) {
            self.wait();
            self.look();
        }
    }

    /// Until somebody connects or speaks, or it is time to look for answers.
    fn wait(&self) {
        let waits = self.guests.iter().any(|guest| guest.asked.is_some());
        let nanoseconds = if waits { 500_000 } else { 50_000_000 };
        let speaking = self.guests.iter().filter(|guest| guest.asked.is_none());
        let mut ends = vec![PollFd::new(&self.socket.listener, PollFlags::IN)];
        ends.extend(speaking.map(|guest| PollFd::new(&guest.stream, PollFlags::IN)));
        // An interrupted wait is a short one.
        let _ = poll(&mut ends, Some(&Timespec { tv_sec: 0, tv_nsec: nanoseconds }));
    }

    /// Whoever has come, what was said, what is answered. Never waits.
    pub(crate) fn look(&mut self) {
        for _ in 0..CONNECTIONS_MAX {
            let Ok((stream, _)) = self.socket.listener.accept() else { break };
            self.welcome(stream);
        }
        while let Some(reply) = self.direct.next_reply() {
            let Some(place) = self.guests.iter().position(|g| g.asked.is_some_and(|(t, _)| t == reply.ticket)) else {
                continue;
            };
            let guest = self.guests.swap_remove(place);
            answer(&guest, &reply);
        }
        for place in (0..self.guests.len()).rev() {
            match self.listen(place) {
                Next::Stays => {}
                Next::Goes => drop(self.guests.swap_remove(place)),
                Next::Status => {
                    let guest = self.guests.swap_remove(place);
                    if let Err(error) = self.status.try_send(guest.stream) {
                        tracing::debug!(%error, "too many ask for the status");
                    }
                }
            }
        }
    }

    fn welcome(&mut self, stream: UnixStream) {
        let known = stream.set_nonblocking(true).and_then(|()| peer::of(stream.as_fd()));
        let Ok(peer) = known else { return };
        if !self.socket.stop.contains(&peer) && !self.socket.see.contains(&peer) {
            return refuse(&stream, &peer, "anything");
        }
        if self.guests.len() == CONNECTIONS_MAX {
            // In order of coming, but for those that have left: nobody keeps a place by saying nothing.
            let silent = self.guests.iter().enumerate().filter(|(_, guest)| guest.asked.is_none());
            match silent.min_by_key(|(_, guest)| guest.since).map(|(place, _)| place) {
                Some(place) => drop(self.guests.swap_remove(place)),
                None => return,
            }
        }
        self.guests.push(Guest { stream, peer, since: Instant::now(), line: Vec::new(), asked: None });
    }

    fn listen(&mut self, place: usize) -> Next {
        let Self { guests, direct, socket, .. } = self;
        let guest = &mut guests[place];
        if let Some((_, word)) = guest.asked {
            if guest.since.elapsed() > ANSWER {
                tell(&guest.stream, &Said::Answer(unanswered(word, RefusalReason::NoAnswer)));
                return Next::Goes;
            }
            return Next::Stays;
        }
        let mut part = [0; LINE_BYTES_MAX];
        let ended = match guest.stream.read(&mut part) {
            Ok(0) => true,
            Ok(count) => {
                guest.line.extend_from_slice(&part[..count]);
                false
            }
            Err(e) if [io::ErrorKind::WouldBlock, io::ErrorKind::Interrupted].contains(&e.kind()) => false,
            Err(_) => return Next::Goes,
        };
        let line = guest.line.split(|byte| *byte == b'\n').next().unwrap_or_default();
        if !ended && line.len() == guest.line.len() && line.len() < LINE_BYTES_MAX {
            return if guest.since.elapsed() > PATIENCE { Next::Goes } else { Next::Stays };
        }
        // What is left unread would take the answer along when the connection is closed.
        let mut rest = [0; 4096];
        for _ in 0..16 {
            if !matches!(guest.stream.read(&mut rest), Ok(1..)) {
                break;
            }
        }
        let word = match Word::parse(line) {
            Ok(word) => word,
            Err(why) => {
                tell(&guest.stream, &Said::Refused(why));
                return Next::Goes;
            }
        };
        let permitted = if word == Word::Status { &socket.see } else { &socket.stop };
        if !permitted.contains(&guest.peer) {
            refuse(&guest.stream, &guest.peer, word.text());
            return Next::Goes;
        }
        let Some(kind) = word.request() else { return Next::Status };
        let (uid, pid) = (guest.peer.uid, guest.peer.pid);
        tracing::info!(uid, pid, "asked for {}", word.line().trim_end());
        let speed_scale = if let Word::Speed(scale) = word { scale } else { 1.0 };
        (guest.asked, guest.since) = (direct.ask(kind, speed_scale).map(|ticket| (ticket, word)), Instant::now());
        if guest.asked.is_some() {
            return Next::Stays;
        }
        tell(&guest.stream, &Said::Answer(unanswered(word, RefusalReason::Busy)));
        Next::Goes
    }
}

fn refuse(stream: &UnixStream, peer: &Peer, what: &str) {
    let user = user_text(peer.uid);
    tracing::debug!(uid = peer.uid, pid = peer.pid, what, "refused");
    tell(
        stream,
        &Said::Refused(format!("user {user} may not ask for {what} (`[access]` of the daemon's configuration)")),
    );
}

/// An answer that the control thread did not give.
fn unanswered(word: Word, reason: RefusalReason) -> Answer {
    Answer {
        asked: word.text().into(),
        accepted: false,
        reason: reason.wire(),
        detail: 0,
        supervisor: 0,
        fault_code: 0,
        fault_detail: 0,
        text: reason.text().into(),
    }
}

fn answer(guest: &Guest, reply: &Reply) {
    let Some((_, word)) = guest.asked else { return };
    let accepted = reply.verdict == Verdict::Accepted;
    let text = match word {
        Word::Speed(scale) if accepted => speed_text(reply.supervisor, scale),
        _ if accepted => reply.supervisor.text().into(),
        _ => refusal_text(reply.reason, reply.detail).into(),
    };
    let answer = Answer {
        asked: word.text().into(),
        accepted,
        reason: reply.reason.wire(),
        detail: reply.detail,
        supervisor: reply.supervisor.wire(),
        fault_code: reply.fault_code,
        fault_detail: reply.fault_detail,
        text,
    };
    tell(&guest.stream, &Said::Answer(answer));
}

/// A line, if it can be had at once: an answer fits into the socket's buffer.
fn tell(mut stream: &UnixStream, said: &Said) {
    let mut line = serde_json::to_vec(said).unwrap_or_default();
    line.push(b'\n');
    if let Err(error) = stream.write_all(&line) {
        tracing::debug!(%error, "answer not delivered");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(uid: u32, gid: u32, groups: &[u32]) -> Peer {
        Peer { pid: 1, uid, gid, groups: groups.to_vec() }
    }

    #[test]
    fn the_listed_and_the_daemons_own_and_root_may_and_nobody_else() {
        let own = rustix::process::geteuid().as_raw();
        let list = [Who::User("4711".into()), Who::Group("4800".into())];
        let permitted = Permitted::new("stop", Some(&list)).unwrap();
        for (who, may) in [
            (peer(0, 9, &[]), true),
            (peer(own, 9, &[]), true),
            (peer(4711, 9, &[]), true),
            (peer(4712, 4800, &[]), true),
            (peer(4712, 9, &[8, 4800]), true),
            (peer(4712, 4711, &[4711]), false),
            (peer(4800, 9, &[]), false),
        ] {
            assert_eq!(permitted.contains(&who), may, "{who:?}");
        }
        let group = rustix::process::getegid().as_raw();
        let default = Permitted::new("stop", None).unwrap();
        assert!(default.contains(&peer(4712, 9, &[group])) && !default.contains(&peer(4712, group + 1, &[])));
    }
}
