//! The daemon's side of the socket: a thread that listens and never waits for one of those who speak.

use super::lines::PointLine;
use super::streams::{Content, Found, Stream};
use super::{Address, Answer, Said, Word};
use crate::config::{AccessConfig, Who};
use crate::daemon::DaemonError;
use crate::daemon::records::refusal_text;
use crate::ipc::payload::{RefusalReason, Request, RequestKind, Response, Verdict, speed_text};
use crate::ipc::{BySocket, DirectEnd, IpcError, Reply, SocketPort, ToSocket, run_dir};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use sinew_hal::peer::{self, Peer, group_id, user_id, user_text};
use std::collections::BTreeMap;
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
/// Longest line: a target's.
const LINE_BYTES_MAX: usize = 4096;
/// Streams under ids that the configuration does not require, of which there may be so many; of those that it requires as
/// many again, so that no other source takes their places.
const STREAMS_MAX: usize = 16;
/// Source id of targets that are given by a word.
const TARGET_SOURCE_ID: u32 = 0x5157;

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
    rights: Rights,
}

/// Who may do what.
#[derive(Debug)]
struct Rights {
    stop: Permitted,
    see: Permitted,
    command: Permitted,
    publish: Permitted,
    /// Ids that belong to some alone.
    bound: BTreeMap<u32, Permitted>,
}

impl Rights {
    fn new(access: &AccessConfig) -> Result<Self, DaemonError> {
        let free: Vec<Who> = access.publish.iter().filter(|(_, id)| id.is_none()).map(|(who, _)| who.clone()).collect();
        let mut bound = BTreeMap::<u32, Vec<Who>>::new();
        for (who, id) in &access.publish {
            if let Some(id) = id {
                bound.entry(*id).or_default().push(who.clone());
            }
        }
        let permitted = |(id, list): (u32, Vec<Who>)| Ok((id, Permitted::new("publish", Some(&list))?));
        Ok(Self {
            stop: Permitted::new("stop", access.stop.as_deref())?,
            see: Permitted::new("see", access.see.as_deref())?,
            command: Permitted::new("command", Some(&access.command))?,
            publish: Permitted::new("publish", Some(&free))?,
            bound: bound.into_iter().map(permitted).collect::<Result<_, DaemonError>>()?,
        })
    }

    fn all(&self) -> impl Iterator<Item = &Permitted> {
        [&self.stop, &self.see, &self.command, &self.publish].into_iter().chain(self.bound.values())
    }

    fn may_ask(&self, peer: &Peer, word: Word) -> bool {
        let right = match word {
            Word::Status => &self.see,
            word if word.is_direct() => &self.stop,
            _ => &self.command,
        };
        right.contains(peer) || self.command.contains(peer)
    }

    fn may_publish(&self, peer: &Peer, content: Content, source_id: u32) -> bool {
        match content {
            Content::Targets => self.command.contains(peer),
            Content::Obstacles => self.bound.get(&source_id).unwrap_or(&self.publish).contains(peer),
        }
    }
}

impl OperatorSocket {
    /// Makes the socket, in place of one that a killed daemon left.
    ///
    /// # Errors
    /// [`DaemonError::Access`] for a name that nobody has; a folder that cannot be had or trusted; a daemon that listens
    /// there already.
    pub(crate) fn bind(address: &Address, access: &AccessConfig) -> Result<Self, DaemonError> {
        let rights = Rights::new(access)?;
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
        let this = Self { listener, path: path.clone(), rights };
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
        let users = self.rights.all().any(|right| !right.users.is_empty());
        let mut groups: Vec<u32> = self.rights.all().flat_map(|right| right.groups.iter().copied()).collect();
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
    asked: Option<(u64, Asked)>,
}

/// What an answer is waited for.
#[derive(Debug, Clone, Copy)]
enum Asked {
    Word(Word),
    Target,
}

impl Asked {
    fn text(self) -> &'static str {
        match self {
            Self::Word(word) => word.text(),
            Self::Target => "target",
        }
    }

    fn line(self) -> String {
        match self {
            Self::Word(word) => word.line(),
            Self::Target => "target".to_owned(),
        }
    }
}

/// What becomes of a guest after a look.
enum Next {
    Stays,
    Goes,
    /// Wants the report.
    Status,
    /// Stays, and publishes under an id.
    Publishes(Content, u32),
}

/// The thread that listens.
#[derive(Debug)]
pub(crate) struct Desk {
    socket: OperatorSocket,
    direct: DirectEnd,
    /// Reports are made elsewhere: they take milliseconds, and an order must not wait for one.
    status: SyncSender<UnixStream>,
    guests: Vec<Guest>,
    streams: Vec<Stream>,
    /// Streams that were ever opened.
    opened: u64,
    /// Streams that have ended, and of which the I/O thread does not know yet.
    ended: Vec<SocketPort>,
    /// Sources that the configuration requires.
    required: Vec<u32>,
}

impl Desk {
    pub(crate) fn new(
        socket: OperatorSocket,
        direct: DirectEnd,
        status: SyncSender<UnixStream>,
        required: Vec<u32>,
    ) -> Self {
        let guests = Vec::with_capacity(CONNECTIONS_MAX);
        Self { socket, direct, status, guests, streams: Vec::new(), opened: 0, ended: Vec::new(), required }
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
        // A stream that has just sent a line is not looked at before its pause is over.
        let paused = !self.ended.is_empty() || self.streams.iter().any(|stream| !stream.is_due());
        let nanoseconds = if waits || paused { 500_000 } else { 50_000_000 };
        let speaking = self.guests.iter().filter(|guest| guest.asked.is_none());
        let mut ends = vec![PollFd::new(&self.socket.listener, PollFlags::IN)];
        ends.extend(speaking.map(|guest| PollFd::new(&guest.stream, PollFlags::IN)));
        let due = self.streams.iter().filter(|stream| stream.is_due());
        ends.extend(due.map(|stream| PollFd::new(&stream.stream, PollFlags::IN)));
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
        while let Some(said) = self.direct.next_from_io() {
            self.pass_on(said);
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
                Next::Publishes(content, source_id) => {
                    let guest = self.guests.swap_remove(place);
                    self.open(guest, content, source_id);
                }
            }
        }
        self.look_at_streams();
    }

    /// What the I/O thread says.
    fn pass_on(&mut self, said: ToSocket) {
        match said {
            ToSocket::Answer(ticket, response) => {
                let Some(place) = self.guests.iter().position(|g| g.asked.is_some_and(|(t, _)| t == ticket)) else {
                    return;
                };
                let guest = self.guests.swap_remove(place);
                answer_of_io(&guest, &response);
            }
            ToSocket::Fate(port, fate) => {
                if let Some(stream) = self.streams.iter_mut().find(|stream| stream.port == port) {
                    stream.hear(fate);
                }
            }
        }
    }

    /// Gives a place to somebody who publishes.
    fn open(&mut self, guest: Guest, content: Content, source_id: u32) {
        let is_required = |id: u32| content == Content::Obstacles && self.required.contains(&id);
        let alike = self.streams.iter().filter(|stream| is_required(stream.source_id) == is_required(source_id));
        if alike.count() >= STREAMS_MAX {
            return tell(&guest.stream, &Said::Refused("all places for those who publish are taken".into()));
        }
        let port = SocketPort::new(self.opened, guest.peer.pid);
        self.opened += 1;
        let rest = guest.line.iter().position(|byte| *byte == b'\n').map_or(&[][..], |end| &guest.line[end + 1..]);
        let (uid, pid) = (guest.peer.uid, guest.peer.pid);
        tracing::info!(uid, pid, source_id, "publishes {content:?}");
        self.streams.push(Stream::new(guest.stream, port, source_id, content, rest));
    }

    /// At most a line of each.
    fn look_at_streams(&mut self) {
        for place in (0..self.streams.len()).rev() {
            match self.streams[place].look() {
                Found::Nothing => {}
                Found::Line(line) => {
                    if self.direct.hand_io(line).is_err() {
                        self.streams[place].tell(Err(RefusalReason::Busy.text().into()));
                    }
                }
                Found::End => self.ended.push(self.streams.swap_remove(place).port),
            }
        }
        let direct = &mut self.direct;
        self.ended.retain(|port| direct.hand_io(BySocket::Gone(*port)).is_err());
    }

    fn welcome(&mut self, stream: UnixStream) {
        let known = stream.set_nonblocking(true).and_then(|()| peer::of(stream.as_fd()));
        let Ok(peer) = known else { return };
        if !self.socket.rights.all().any(|right| right.contains(&peer)) {
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
        if let Some((_, asked)) = guest.asked {
            if guest.since.elapsed() > ANSWER {
                tell(&guest.stream, &Said::Answer(unanswered(asked, RefusalReason::NoAnswer)));
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
        let end = guest.line.iter().position(|byte| *byte == b'\n');
        if !ended && end.is_none() && guest.line.len() < LINE_BYTES_MAX {
            return if guest.since.elapsed() > PATIENCE { Next::Goes } else { Next::Stays };
        }
        let line = String::from_utf8_lossy(&guest.line[..end.unwrap_or(guest.line.len())]).trim().to_owned();
        let order = Order::of(&line);
        if let Ok(Order::Publish(content, source_id)) = order {
            if socket.rights.may_publish(&guest.peer, content, source_id) {
                return Next::Publishes(content, source_id);
            }
            refuse(&guest.stream, &guest.peer, &line);
            return Next::Goes;
        }
        // What is left unread would take the answer along when the connection is closed.
        let mut rest = [0; 4096];
        for _ in 0..16 {
            if !matches!(guest.stream.read(&mut rest), Ok(1..)) {
                break;
            }
        }
        let (uid, pid) = (guest.peer.uid, guest.peer.pid);
        let (asked, ticket) = match order {
            Err(why) => {
                tell(&guest.stream, &Said::Refused(why));
                return Next::Goes;
            }
            Ok(Order::Target(request)) => {
                if !socket.rights.command.contains(&guest.peer) {
                    refuse(&guest.stream, &guest.peer, "target");
                    return Next::Goes;
                }
                (Asked::Target, direct.ask_io(*request))
            }
            Ok(Order::Word(word)) => {
                if !socket.rights.may_ask(&guest.peer, word) {
                    refuse(&guest.stream, &guest.peer, word.text());
                    return Next::Goes;
                }
                let Some(kind) = word.request() else { return Next::Status };
                let speed_scale = if let Word::Speed(scale) = word { scale } else { 1.0 };
                let ticket =
                    if word.is_direct() { direct.ask(kind, speed_scale) } else { direct.ask_io(Request::new(kind)) };
                (Asked::Word(word), ticket)
            }
            Ok(Order::Publish(..)) => return Next::Goes,
        };
        tracing::info!(uid, pid, "asked for {}", asked.line());
        (guest.asked, guest.since) = (ticket.map(|ticket| (ticket, asked)), Instant::now());
        if guest.asked.is_some() {
            return Next::Stays;
        }
        tell(&guest.stream, &Said::Answer(unanswered(asked, RefusalReason::Busy)));
        Next::Goes
    }
}

/// What a line asks for.
enum Order {
    Word(Word),
    Target(Box<Request>),
    Publish(Content, u32),
}

impl Order {
    /// What is meant; why it is not understood, in words.
    fn of(line: &str) -> Result<Self, String> {
        if let Some(word) = Word::parse(line) {
            return word.map(Self::Word);
        }
        if let Some(text) = line.strip_prefix("target ") {
            let point: PointLine = serde_json::from_str(text).map_err(|error| format!("target: {error}"))?;
            let target = point.point(TARGET_SOURCE_ID, 0).map_err(|why| format!("target: {why}"))?;
            let mut request = Request { target: *target, ..Request::new(RequestKind::SetTarget) };
            request.header.source_id = TARGET_SOURCE_ID;
            return Ok(Self::Target(Box::new(request)));
        }
        let published = line.strip_prefix("publish ").and_then(|rest| {
            let (what, id) = rest.split_once(' ')?;
            let content = match what {
                "obstacles" => Content::Obstacles,
                "targets" => Content::Targets,
                _ => return None,
            };
            Some(Self::Publish(content, id.trim().parse().ok()?))
        });
        published.ok_or_else(|| {
            let words: Vec<&str> = Word::ALONE.iter().map(|word| word.text()).collect();
            format!(
                "expected a line with one of {}, speed and a share of the configured one (`speed 50%`), target {{...}}, \
                 publish obstacles ID, publish targets ID",
                words.join(", ")
            )
        })
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
fn unanswered(asked: Asked, reason: RefusalReason) -> Answer {
    Answer {
        asked: asked.text().into(),
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
    let Some((_, asked)) = guest.asked else { return };
    let accepted = reply.verdict == Verdict::Accepted;
    let text = match asked {
        Asked::Word(Word::Speed(scale)) if accepted => speed_text(reply.supervisor, scale),
        _ if accepted => reply.supervisor.text().into(),
        _ => refusal_text(reply.reason, reply.detail).into(),
    };
    let answer = Answer {
        asked: asked.text().into(),
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

/// The same as the I/O thread has it, in its words.
fn answer_of_io(guest: &Guest, response: &Response) {
    let Some((_, asked)) = guest.asked else { return };
    let reason = RefusalReason::from_wire(response.reason);
    let text = match reason {
        // The text names the cause.
        Some(RefusalReason::BadTarget | RefusalReason::None) | None => response.text(),
        Some(reason) => refusal_text(reason, response.detail),
    };
    let answer = Answer {
        asked: asked.text().into(),
        accepted: response.is_accepted(),
        reason: response.reason,
        detail: response.detail,
        supervisor: response.supervisor,
        fault_code: response.fault_code,
        fault_detail: response.fault_detail,
        text: text.into(),
    };
    tell(&guest.stream, &Said::Answer(answer));
}

/// A line, if it can be had at once: an answer fits into the socket's buffer.
pub(super) fn tell(mut stream: &UnixStream, said: &Said) {
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
