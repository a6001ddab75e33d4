//! The arm's socket: stop, hold, disarm, emergency stop, speed and status on a way of their own; and for those whom
//! `[access]` names, who have no part in the daemon's shared memory, everything else.
//!
//! Enters: one line with one word, and a number after `speed`, from a process whose user the kernel vouches for. Leaves: one
//! line of JSON, and the order to the control thread, past the I/O thread and shared memory. Stopping an arm must not depend
//! on what an arm is otherwise driven by: this works with shared memory full, its files removed, its locks held, the I/O
//! thread stuck.
//! `arm`, `track`, `home`, `clear` and `target {...}` go through the I/O thread, as those of shared memory do. After
//! `publish obstacles ID` or `publish targets ID` follow lines of JSON without end (`lines`).
//!
//! The socket is `<run folder>/<arm>/control` for the default domain of shared memory, and has a number behind its name
//! for any other; [`crate::ipc::run_dir`] tells which folder. Without sinew at hand: `echo stop | nc -UN <socket>`.

mod lines;
mod server;
mod streams;

pub(crate) use server::{Desk, OperatorSocket};

use super::status::StatusReport;
use crate::ipc::payload::{Obstacles, RequestKind, Response, Target, is_speed_scale};
use crate::ipc::{Domain, IpcError, run_dir};
use lines::{PointLine, SetLine};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};
use serde::{Deserialize, Serialize};
use sinew_hal::peer::{self, user_text};
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use thiserror::Error;

/// What can be asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Word {
    /// Ramp the tensions down, then disarm.
    Stop,
    /// Hold the present pose.
    Hold,
    /// Take the torque off the drives at once, in order.
    Disarm,
    /// Press the operator's emergency stop, which stays pressed.
    EmergencyStop,
    /// Release it.
    EmergencyRelease,
    /// Move at this share of the configured speed.
    Speed(f64),
    /// The daemon's report.
    Status,
    /// Enable the drives and hold the pose.
    Arm,
    /// Follow the target.
    Track,
    /// Go to the home pose.
    Home,
    /// Release a latched fault, forget sources that are gone.
    Clear,
}

/// Reads a speed: a share (`0.5`) or per cent (`50%`) of the configured one.
///
/// # Errors
/// It is no number, or not between 1 % and 100 %; in words.
pub fn parse_speed(text: &str) -> Result<f64, String> {
    let refused = || format!("speed `{text}`: expected 1% to 100% of the configured speed, or 0.01 to 1");
    let text = text.trim();
    let (number, unit) = text.strip_suffix('%').map_or((text, 1.0), |number| (number.trim_end(), 0.01));
    let scale = unit * number.parse::<f64>().map_err(|_| refused())?;
    if is_speed_scale(scale) { Ok(scale) } else { Err(refused()) }
}

impl Word {
    /// Every word that stands alone.
    const ALONE: [Self; 10] = [
        Self::Stop,
        Self::Hold,
        Self::Disarm,
        Self::EmergencyStop,
        Self::EmergencyRelease,
        Self::Status,
        Self::Arm,
        Self::Track,
        Self::Home,
        Self::Clear,
    ];

    /// Reads a line as it is sent, without its end; `None` if it begins with no word, and in words what is wrong with a speed.
    pub fn parse(line: &str) -> Option<Result<Self, String>> {
        match line.strip_prefix("speed ") {
            Some(speed) => Some(parse_speed(speed).map(Self::Speed)),
            None => Self::ALONE.into_iter().find(|word| line == word.text()).map(Ok),
        }
    }

    /// The line as it is sent, without its end.
    pub fn line(self) -> String {
        match self {
            Self::Speed(scale) => format!("speed {scale}"),
            word => word.text().to_owned(),
        }
    }

    /// What it is called.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Hold => "hold",
            Self::Disarm => "disarm",
            Self::EmergencyStop => "emergency-stop",
            Self::EmergencyRelease => "emergency-release",
            Self::Speed(_) => "speed",
            Self::Status => "status",
            Self::Arm => "arm",
            Self::Track => "track",
            Self::Home => "home",
            Self::Clear => "clear",
        }
    }

    /// Whether it can only make an arm rest: such an order goes to every daemon that is found.
    pub const fn stops(self) -> bool {
        matches!(self, Self::Stop | Self::Hold | Self::Disarm | Self::EmergencyStop)
    }

    /// Whether it is the control thread's alone, which hears it past the I/O thread, and of those who may stop.
    pub const fn is_direct(self) -> bool {
        self.stops() || matches!(self, Self::EmergencyRelease | Self::Speed(_))
    }

    /// The request that it stands for; `None` for the report.
    pub const fn request(self) -> Option<RequestKind> {
        match self {
            Self::Stop => Some(RequestKind::Stop),
            Self::Hold => Some(RequestKind::Hold),
            Self::Disarm => Some(RequestKind::Disarm),
            Self::EmergencyStop => Some(RequestKind::EmergencyStop),
            Self::EmergencyRelease => Some(RequestKind::EmergencyRelease),
            Self::Speed(_) => Some(RequestKind::Speed),
            Self::Status => None,
            Self::Arm => Some(RequestKind::Arm),
            Self::Track => Some(RequestKind::Track),
            Self::Home => Some(RequestKind::Home),
            Self::Clear => Some(RequestKind::Clear),
        }
    }
}

/// The supervisor's answer as it goes over the socket: the fields of [`Response`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// What was asked for.
    pub asked: String,
    /// Whether it is carried out.
    pub accepted: bool,
    /// [`crate::ipc::payload::RefusalReason`].
    pub reason: u32,
    /// Number that belongs to the reason.
    pub detail: u32,
    /// [`crate::ipc::payload::SupervisorState`].
    pub supervisor: u32,
    /// Code of the latched fault, 0 without one.
    pub fault_code: u32,
    /// Detail of the fault.
    pub fault_detail: u32,
    /// The state, or why not, in words.
    pub text: String,
}

impl Answer {
    /// The same as it comes over shared memory.
    pub fn response(&self) -> Response {
        let mut response = Response {
            verdict: u32::from(!self.accepted),
            reason: self.reason,
            detail: self.detail,
            supervisor: self.supervisor,
            fault_code: self.fault_code,
            fault_detail: self.fault_detail,
            ..Response::default()
        };
        response.set_text(&self.text);
        response
    }
}

/// One line of the daemon's.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// Not to this user, or not understood; why.
    Refused(String),
    /// The answer to an order.
    Answer(Answer),
    /// The answer to `status`.
    Status(Box<StatusReport>),
    /// What is published is taken.
    Taken,
}

/// Nothing was heard of a daemon, or nothing that can be used.
#[derive(Debug, Error)]
pub enum OperatorError {
    /// Nobody listens for this arm in any of the folders.
    #[error(transparent)]
    NoDaemon(IpcError),
    /// The socket's folder, or who listens there, cannot be trusted.
    #[error(transparent)]
    Foreign(IpcError),
    /// A daemon is there, and this user may not speak to it.
    #[error(
        "the daemon of arm \"{arm}\" does not listen to this user: {path} may not be opened (`[access]` of its \
         configuration says who may)", path = path.display()
    )]
    NotPermitted {
        /// The arm.
        arm: String,
        /// The socket.
        path: PathBuf,
    },
    /// It refuses.
    #[error("the daemon refuses: {why}")]
    Refused {
        /// Why, in its words.
        why: String,
    },
    /// It did not answer in time.
    #[error(
        "the daemon of arm \"{arm}\" did not answer within {timeout_s} s; if it hangs, SIGTERM is an ordered stop and \
         SIGKILL lets the drives' own guards take over"
    )]
    Timeout {
        /// The arm.
        arm: String,
        /// The time waited (s).
        timeout_s: f64,
    },
    /// What it said is not understood: another version.
    #[error("{path} answers with something else: is the daemon of another version? ({source})", path = path.display())]
    Garbled {
        /// The socket.
        path: PathBuf,
        /// What is wrong with it.
        source: serde_json::Error,
    },
    /// The operating system.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The socket.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
}

/// Where the daemon of an arm listens.
#[derive(Debug, Clone)]
pub struct Address {
    arm: String,
    file: String,
    given: Option<PathBuf>,
}

/// What a daemon says, with its user.
pub type Heard = (u32, Result<Said, OperatorError>);

/// A daemon that was found.
#[derive(Debug)]
struct Line {
    stream: UnixStream,
    path: PathBuf,
    uid: u32,
}

impl Address {
    /// Of an arm in a domain of shared memory. `configured` is `ipc.run_path`; the environment precedes it.
    pub fn new(domain: &Domain, arm: &str, configured: Option<&Path>) -> Self {
        let file = if *domain == Domain::default() {
            "control".to_owned()
        } else {
            // FNV-1a, so that every pair of prefix and root path has a short name of its own.
            let name = super::domain_name(domain);
            let hash = name
                .bytes()
                .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
            format!("control-{hash:016x}")
        };
        Self { arm: arm.to_owned(), file, given: run_dir(configured) }
    }

    /// User of the daemon that answers here, if one does.
    pub fn owner(&self) -> Option<u32> {
        self.find(Instant::now() + Duration::from_secs(1)).ok()?.first().map(|line| line.uid)
    }

    /// Asks every daemon of this arm that is found, which is one unless root finds those of several users; what each says,
    /// with its user. All are asked before the first answer is waited for.
    ///
    /// # Errors
    /// [`OperatorError`] where none is found; what went wrong with one that was found stands in its place.
    pub fn ask_all(&self, word: Word, timeout: Duration) -> Result<Vec<Heard>, OperatorError> {
        let deadline = Instant::now() + timeout;
        self.say(self.find(deadline)?, &word.line(), timeout, deadline)
    }

    fn say(
        &self,
        mut lines: Vec<Line>,
        text: &str,
        timeout: Duration,
        deadline: Instant,
    ) -> Result<Vec<Heard>, OperatorError> {
        // Where the order could not be said, an answer may be there all the same: a refusal.
        let asked: Vec<io::Result<()>> = lines.iter_mut().map(|line| line.say(text)).collect();
        let heard = |(mut line, asked): (Line, io::Result<()>)| {
            let said = match (asked, line.read(deadline)) {
                (Err(source), Ok(text)) if text.is_empty() => Err(source),
                (Err(source), Err(_)) => Err(source),
                (_, read) => read,
            };
            let failed = |source: io::Error| match source.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                    OperatorError::Timeout { arm: self.arm.clone(), timeout_s: timeout.as_secs_f64() }
                }
                _ => OperatorError::Io { path: line.path.clone(), source },
            };
            let garbled = |source| OperatorError::Garbled { path: line.path.clone(), source };
            (line.uid, said.map_err(failed).and_then(|text| serde_json::from_slice(&text).map_err(garbled)))
        };
        Ok(lines.into_iter().zip(asked).map(heard).collect())
    }

    /// Asks the daemon of this arm; of several the most trusted.
    ///
    /// # Errors
    /// [`OperatorError`].
    pub fn ask(&self, word: Word, timeout: Duration) -> Result<Said, OperatorError> {
        self.say_to_one(&word.line(), timeout)
    }

    /// Gives the daemon one target, which is kept until another comes. With a capture time of 0 it is as old as the moment at
    /// which the daemon takes it.
    ///
    /// # Errors
    /// [`OperatorError`].
    pub fn set_target(&self, target: &Target, timeout: Duration) -> Result<Said, OperatorError> {
        let line = serde_json::to_string(&PointLine::of(target)).unwrap_or_default();
        self.say_to_one(&format!("target {line}"), timeout)
    }

    /// Opens a way to publish obstacles under a source id.
    ///
    /// # Errors
    /// [`OperatorError`].
    pub fn publisher(&self, source_id: u32, timeout: Duration) -> Result<SocketPublisher, OperatorError> {
        let mut line = self.find(Instant::now() + timeout)?.swap_remove(0);
        let path = line.path.clone();
        let opened = line.say(&format!("publish obstacles {source_id}"));
        let opened = opened.and_then(|()| line.stream.set_nonblocking(true));
        opened.map_err(|source| OperatorError::Io { path, source })?;
        Ok(SocketPublisher { line, text: Vec::new() })
    }

    fn say_to_one(&self, text: &str, timeout: Duration) -> Result<Said, OperatorError> {
        let deadline = Instant::now() + timeout;
        let mut lines = self.find(deadline)?;
        lines.truncate(1);
        self.say(lines, text, timeout, deadline)?.swap_remove(0).1
    }

    fn path_in(&self, base: &Path) -> PathBuf {
        base.join(&self.arm).join(&self.file)
    }

    /// Connects to whoever listens; never empty.
    fn find(&self, deadline: Instant) -> Result<Vec<Line>, OperatorError> {
        let mut lines = Vec::new();
        let mut failed = None;
        for (base, owners) in crate::ipc::run_dir::to_search(self.given.as_deref()) {
            let path = self.path_in(&base);
            if path.symlink_metadata().is_err() {
                continue;
            }
            match self.connect(&base, &owners, path, deadline) {
                Ok(Some(line)) => lines.push(line),
                Ok(None) => {}
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        // Only root gets here with several, and then only where no folder of its own or the system's had one.
        if lines.first().is_some_and(|line| line.uid == rustix::process::geteuid().as_raw()) {
            lines.truncate(1);
        }
        match (lines.is_empty(), failed) {
            (false, _) => Ok(lines),
            (true, Some(error)) => Err(error),
            (true, None) => Err(OperatorError::NoDaemon(IpcError::NoDaemon { arm: self.arm.clone() })),
        }
    }

    /// `None` where a killed daemon left its socket.
    fn connect(
        &self,
        base: &Path,
        owners: &[u32],
        path: PathBuf,
        deadline: Instant,
    ) -> Result<Option<Line>, OperatorError> {
        let owner = crate::ipc::run_dir::check(base, owners).map_err(OperatorError::Foreign)?;
        crate::ipc::run_dir::check(&base.join(&self.arm), &[owner, 0]).map_err(OperatorError::Foreign)?;
        let io = |source: io::Error| OperatorError::Io { path: path.clone(), source };
        let stream = loop {
            match open(&path) {
                Ok(stream) => break stream,
                Err(e) => match e.kind() {
                    io::ErrorKind::ConnectionRefused | io::ErrorKind::NotFound => return Ok(None),
                    io::ErrorKind::PermissionDenied => {
                        return Err(OperatorError::NotPermitted { arm: self.arm.clone(), path });
                    }
                    // So many wait that there is no place for another; the daemon answers them as fast as it can.
                    io::ErrorKind::WouldBlock if Instant::now() < deadline => {
                        std::thread::sleep(Duration::from_millis(1));
                    }
                    _ => return Err(io(e)),
                },
            }
        };
        let uid = peer::of(stream.as_fd()).map_err(io)?.uid;
        if ![owner, 0].contains(&uid) {
            let why = format!("a process of user {} listens there", user_text(uid));
            return Err(OperatorError::Foreign(IpcError::Foreign { path, why }));
        }
        Ok(Some(Line { stream, path, uid }))
    }
}

/// Connects without waiting for a place.
fn open(path: &Path) -> io::Result<UnixStream> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = rustix::net::socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    rustix::net::connect(&socket, &SocketAddrUnix::new(path)?)?;
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(false)?;
    Ok(stream)
}

/// Longest answer: a report of a long arm is a hundredth of it.
const ANSWER_BYTES_MAX: u64 = 4 << 20;

impl Line {
    fn say(&mut self, text: &str) -> io::Result<()> {
        self.stream.set_write_timeout(Some(Duration::from_millis(500)))?;
        self.stream.write_all(format!("{text}\n").as_bytes())
    }

    /// Reads until the daemon hangs up.
    fn read(&mut self, deadline: Instant) -> io::Result<Vec<u8>> {
        let mut text = Vec::new();
        let mut part = [0; 16 << 10];
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() || text.len() as u64 > ANSWER_BYTES_MAX {
                return Err(io::ErrorKind::TimedOut.into());
            }
            self.stream.set_read_timeout(Some(left))?;
            match self.stream.read(&mut part) {
                Ok(0) => return Ok(text),
                Ok(count) => text.extend_from_slice(&part[..count]),
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                // It has answered before it had read all: who may ask for nothing is not listened to.
                Err(e) if e.kind() == io::ErrorKind::ConnectionReset && !text.is_empty() => return Ok(text),
                Err(e) => return Err(e),
            }
        }
    }
}

/// Publishes one source's obstacles over the socket.
#[derive(Debug)]
pub struct SocketPublisher {
    line: Line,
    text: Vec<u8>,
}

impl SocketPublisher {
    /// Sends a set; its id and number are the connection's. Waits while the daemon has not taken those before.
    ///
    /// # Errors
    /// [`OperatorError::Io`]: the daemon has hung up.
    pub fn publish(&mut self, set: &Obstacles) -> Result<(), OperatorError> {
        let mut line = serde_json::to_vec(&SetLine::of(set)).unwrap_or_default();
        line.push(b'\n');
        let stream = &mut self.line.stream;
        let sent = stream.set_nonblocking(false).and_then(|()| stream.write_all(&line));
        sent.and_then(|()| stream.set_nonblocking(true)).map_err(|source| self.failed(source))
    }

    /// What the daemon has said since, if it has: taken, or why not. It says what changes.
    ///
    /// # Errors
    /// [`OperatorError::Io`]: the daemon has hung up; [`OperatorError::Garbled`].
    pub fn heard(&mut self) -> Result<Option<Result<(), String>>, OperatorError> {
        let mut part = [0; 4096];
        let ended = match self.line.stream.read(&mut part) {
            Ok(count) => {
                self.text.extend_from_slice(&part[..count]);
                count == 0
            }
            Err(e) if [io::ErrorKind::WouldBlock, io::ErrorKind::Interrupted].contains(&e.kind()) => false,
            Err(source) => return Err(self.failed(source)),
        };
        let Some(end) = self.text.iter().position(|byte| *byte == b'\n') else {
            return if ended { Err(self.failed(io::ErrorKind::UnexpectedEof.into())) } else { Ok(None) };
        };
        let line: Vec<u8> = self.text.drain(..=end).collect();
        match serde_json::from_slice(&line) {
            Ok(Said::Taken) => Ok(Some(Ok(()))),
            Ok(Said::Refused(why)) => Ok(Some(Err(why))),
            Ok(_) => Ok(Some(Err("an answer to something else".into()))),
            Err(source) => Err(OperatorError::Garbled { path: self.line.path.clone(), source }),
        }
    }

    fn failed(&self, source: io::Error) -> OperatorError {
        OperatorError::Io { path: self.line.path.clone(), source }
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
