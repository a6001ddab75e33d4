//! Moves messages between the ports and the control thread's channels.

use super::IpcError;
use super::by_socket::{BySocket, SocketPort, ToSocket};
use super::channels::{Command, Event, IoEnds, Reply};
use super::intake::{EncoderTable, InputLimits, ObstacleTable, TargetTrack, TipTable};
use super::payload::{
    Header, Obstacles, RefusalReason, RejectCause, Request, RequestKind, Response, SCHEMA_VERSION, State,
    SupervisorState, Target, Verdict, is_speed_scale, speed_text,
};
use super::ports::{DaemonPorts, OpenRequest};
use sinew_hal::clock::Naps;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How the loop waits when there is nothing to move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Sleeps, at most 200 us: what a message may wait here.
    RealTime {
        /// Time to sleep.
        sleep: Duration,
    },
    /// As fast as it computes: looks again at once for a while, then more and more seldom ([`Naps`]).
    Lockstep,
}

impl Default for Pace {
    fn default() -> Self {
        Self::RealTime { sleep: Duration::from_micros(100) }
    }
}

/// Thresholds of all inputs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct IoLimits {
    /// Obstacles.
    pub obstacles: InputLimits,
    /// Targets.
    pub target: InputLimits,
    /// Encoders.
    pub encoders: InputLimits,
    /// Measured tip.
    pub tip: InputLimits,
}

/// Sees everything that passes, on the I/O thread: the recorder's place. Must not block.
pub trait Tap: Send {
    /// Adds to a tick's record what the loop does not know.
    fn complete(&mut self, _state: &mut State) {}
    /// A tick's record.
    fn state(&mut self, _state: &State) {}
    /// An accepted obstacle set.
    fn obstacles(&mut self, _obstacles: &Obstacles) {}
    /// An accepted target.
    fn target(&mut self, _target: &Target) {}
    /// A source of obstacles was forgotten: it has none any more.
    fn forgotten(&mut self, _source_id: u32) {}
    /// An event of the loop.
    fn event(&mut self, _event: &Event) {}
}

/// A tap that looks at nothing.
impl Tap for () {}

/// A tap that may be absent: recording is a choice of the configuration.
impl<T: Tap> Tap for Option<T> {
    fn complete(&mut self, state: &mut State) {
        self.iter_mut().for_each(|tap| tap.complete(state));
    }

    fn state(&mut self, state: &State) {
        self.iter_mut().for_each(|tap| tap.state(state));
    }

    fn obstacles(&mut self, obstacles: &Obstacles) {
        self.iter_mut().for_each(|tap| tap.obstacles(obstacles));
    }

    fn target(&mut self, target: &Target) {
        self.iter_mut().for_each(|tap| tap.target(target));
    }

    fn forgotten(&mut self, source_id: u32) {
        self.iter_mut().for_each(|tap| tap.forgotten(source_id));
    }

    fn event(&mut self, event: &Event) {
        self.iter_mut().for_each(|tap| tap.event(event));
    }
}

/// How long the control thread may take over an answer.
const ANSWER_NS_MAX: u64 = 1_000_000_000;
/// Requests that may wait for an answer at once.
const OPEN_REQUESTS_MAX: usize = 16;
/// Records and events moved in one pass, so that inputs are not starved.
const MOVED_PER_PASS: usize = 64;

/// Lockstep: silence after which is looked who is gone (ns).
const GONE_NS: u64 = 100_000_000;

/// Rejections of obstacles that have been told of: each source and cause once.
#[derive(Debug, Default)]
struct Told(Vec<(u32, RejectCause)>);

impl Told {
    /// Whoever sends under ever new ids is not told of without end.
    const MAX: usize = 64;

    fn tell(&mut self, source_id: u32, cause: RejectCause) {
        // What a service's history holds of the dead is in order.
        let ordinary = [RejectCause::TooOld, RejectCause::Sequence].contains(&cause);
        if !ordinary && self.0.len() < Self::MAX && !self.0.contains(&(source_id, cause)) {
            self.0.push((source_id, cause));
            tracing::warn!(source_id, "obstacle set refused: {}", cause.text());
        }
    }
}

/// Who waits for an answer.
#[derive(Debug)]
enum Asker {
    /// A client of shared memory.
    Port(OpenRequest),
    /// Somebody at the arm's socket, by the ticket.
    Socket(u64),
}

/// The loop between ports and channels.
#[derive(Debug)]
pub struct IoThread<T: Tap = ()> {
    ports: DaemonPorts,
    ends: IoEnds,
    limits: IoLimits,
    obstacles: ObstacleTable,
    target: TargetTrack,
    encoders: EncoderTable,
    tip: TipTable,
    open: Vec<(Command, u64, Asker)>,
    /// Connections over the arm's socket by which something was published.
    sockets: Vec<SocketPort>,
    next_ticket: u64,
    last: (u32, u32, u32),
    port_errors: u64,
    told: Told,
    tap: T,
}

impl<T: Tap> IoThread<T> {
    /// Takes the ends of [`super::channels`]; the arm's counts and the declared sources must be the same as there.
    pub fn new(ports: DaemonPorts, mut ends: IoEnds, limits: IoLimits, tap: T) -> Self {
        let obstacles = ends.obstacles.input_buffer_mut().clone();
        let target = ends.target.input_buffer_mut().clone();
        let encoders = ends.encoders.input_buffer_mut().clone();
        let open = Vec::with_capacity(OPEN_REQUESTS_MAX);
        let last = (SupervisorState::Disarmed.wire(), 0, 0);
        Self {
            ports,
            ends,
            limits,
            obstacles,
            target,
            encoders,
            tip: TipTable::default(),
            open,
            sockets: Vec::new(),
            next_ticket: 0,
            last,
            port_errors: 0,
            told: Told::default(),
            tap,
        }
    }

    /// Runs until `stop` is set, then moves what is left and answers what waits. `now` is the clock.
    pub fn run(mut self, pace: Pace, stop: &AtomicBool, now: impl Fn() -> u64) {
        let mut naps = Naps::begin();
        let mut looked_ns = 0;
        while !stop.load(Ordering::Acquire) {
            if self.poll(&now) > 0 {
                (naps, looked_ns) = (Naps::begin(), 0);
                continue;
            }
            match pace {
                Pace::RealTime { sleep } => std::thread::sleep(sleep.min(Duration::from_micros(200))),
                Pace::Lockstep => {
                    naps.nap();
                    if naps.waited_ns().saturating_sub(looked_ns) > GONE_NS {
                        looked_ns = naps.waited_ns();
                        self.look_for_the_gone();
                    }
                }
            }
        }
        self.poll(&now);
        for (command, _, request) in std::mem::take(&mut self.open) {
            self.answer(&request, self.refusal(&command, RefusalReason::ShuttingDown));
        }
    }

    /// One pass, never blocking. Returns how many messages were moved.
    ///
    /// Order: outputs first, so that a lockstep client sees tick k before its inputs for k + 1 are looked for; encoders
    /// last, so that a tick that they release finds the obstacles and targets that were sent before them.
    ///
    /// A port that fails is tried again in the next pass: a client that dies while it connects must not end this thread,
    /// and inputs that stay away are noticed by their age. Failures are logged at the 1st, 2nd, 4th, 8th ... one.
    ///
    /// `now` is asked when a message has been taken, not before: this thread may lose its processor between the two, and
    /// a message sent meanwhile would come from the future.
    pub fn poll(&mut self, now: &impl Fn() -> u64) -> usize {
        let results = [self.move_records(), self.move_requests(now), self.move_inputs(now)];
        let mut moved = self.move_sockets(now);
        for result in results {
            match result {
                Ok(count) => moved += count,
                Err(error) => {
                    self.port_errors += 1;
                    if self.port_errors.is_power_of_two() {
                        tracing::warn!(%error, failures = self.port_errors, "shared memory");
                    }
                }
            }
        }
        moved
    }

    /// Lockstep: finds out who will not deliver any more.
    fn look_for_the_gone(&mut self) {
        let mut found = false;
        for port in self.obstacles.publishers().into_iter().filter(|port| *port != 0) {
            if self.has_left(port, |ports| ports.may_replace_obstacles(port, 0)) {
                self.obstacles.set_gone(port);
                found = true;
            }
        }
        if found {
            self.ends.obstacles.input_buffer_mut().copy_from(&self.obstacles);
            self.ends.obstacles.publish();
        }
        let port = self.target.publisher();
        if port != 0 && self.has_left(port, |ports| ports.may_replace_target(port, 0)) {
            self.target.set_gone();
            self.ends.target.input_buffer_mut().copy_from(&self.target);
            self.ends.target.publish();
        }
    }

    /// Whether a port is gone: one of the socket says so itself.
    fn has_left(&self, port: u128, left: impl Fn(&DaemonPorts) -> bool) -> bool {
        !self.sockets.iter().any(|socket| socket.id == port) && left(&self.ports)
    }

    fn move_records(&mut self) -> Result<usize, IpcError> {
        let mut moved = 0;
        while moved < MOVED_PER_PASS
            && let Ok(mut state) = self.ends.records.pop()
        {
            let before = std::mem::replace(&mut self.last, (state.supervisor, state.fault_code, state.fault_detail)).0;
            // Only on the change: clients give their targets before they arm.
            if is_armed(before) && !is_armed(state.supervisor) {
                self.clear_target();
            }
            self.tap.complete(&mut state);
            self.tap.state(&state);
            self.ports.publish_state(&state)?;
            moved += 1;
        }
        while moved < 2 * MOVED_PER_PASS
            && let Ok(event) = self.ends.events.pop()
        {
            self.tap.event(&event);
            moved += 1;
        }
        Ok(moved)
    }

    fn move_inputs(&mut self, now: &impl Fn() -> u64) -> Result<usize, IpcError> {
        let Self { ports, ends, limits, obstacles, target, encoders, tip, tap, told, sockets, .. } = self;
        let living = |port: u128| sockets.iter().any(|socket| socket.id == port);
        let taken_obstacles = ports.take_obstacles(|message, port| {
            let replaces = |other| !living(other) && ports.may_replace_obstacles(other, port);
            let _ = take_set(obstacles, (tap, told), message, port, replaces, now(), &limits.obstacles);
        })?;
        if taken_obstacles > 0 {
            ends.obstacles.input_buffer_mut().copy_from(obstacles);
            ends.obstacles.publish();
        }
        let taken_targets = ports.take_targets(|message, port| {
            let replaces = |other| !living(other) && ports.may_replace_target(other, port);
            let _ = take_point(target, tap, message, port, replaces, now(), &limits.target);
        })?;
        if taken_targets > 0 {
            ends.target.input_buffer_mut().copy_from(target);
            ends.target.publish();
        }
        let taken_tips = ports.take_tips(|message, port| {
            let _ = tip.accept_from(message, port, now(), &limits.tip);
        })?;
        if taken_tips > 0 {
            ends.tip.input_buffer_mut().clone_from(tip);
            ends.tip.publish();
        }
        let taken_encoders = ports.take_encoders(|message, port| {
            // Rejections are counted in the table and reported in `State`.
            let _ = encoders.accept_from(message, port, now(), &limits.encoders);
        })?;
        if taken_encoders > 0 {
            ends.encoders.input_buffer_mut().clone_from(encoders);
            ends.encoders.publish();
        }
        Ok(taken_obstacles + taken_targets + taken_tips + taken_encoders)
    }

    /// What has come over the arm's socket; how much that was.
    fn move_sockets(&mut self, now: &impl Fn() -> u64) -> usize {
        let mut moved = 0;
        while moved < MOVED_PER_PASS
            && let Ok(what) = self.ends.by_socket.pop()
        {
            moved += 1;
            match what {
                BySocket::Ask(ticket, request) => self.take_request(&request, Asker::Socket(ticket), now()),
                BySocket::Obstacles(from, mut set) => {
                    let now_ns = now();
                    fill_capture(&mut set.header.capture_ns, now_ns);
                    let fate = self.take_set_of(from, &set, now_ns);
                    self.tell_socket(ToSocket::Fate(from, fate));
                }
                BySocket::Target(from, mut point) => {
                    let now_ns = now();
                    fill_capture(&mut point.header.capture_ns, now_ns);
                    let fate = self.take_point_of(from, &point, now_ns);
                    self.tell_socket(ToSocket::Fate(from, fate));
                }
                BySocket::Gone(from) => {
                    self.sockets.retain(|socket| *socket != from);
                    self.obstacles.set_gone(from.id);
                    self.ends.obstacles.input_buffer_mut().copy_from(&self.obstacles);
                    self.ends.obstacles.publish();
                    if self.target.publisher() == from.id {
                        self.target.set_gone();
                        self.ends.target.input_buffer_mut().copy_from(&self.target);
                        self.ends.target.publish();
                    }
                }
            }
        }
        moved
    }

    /// Another port gives its id up to this one if it is gone, or of the same process.
    fn replaces(&self, other: u128, by: SocketPort, left: impl Fn(&DaemonPorts) -> bool) -> bool {
        match self.sockets.iter().find(|socket| socket.id == other) {
            Some(socket) => by.pid != 0 && socket.pid == by.pid,
            None => left(&self.ports),
        }
    }

    fn take_set_of(&mut self, from: SocketPort, set: &Obstacles, now_ns: u64) -> Result<(), RejectCause> {
        let other = self.obstacles.taken_by(set.header.source_id, from.id);
        let may = other.is_some_and(|other| self.replaces(other, from, |ports| ports.may_replace_obstacles(other, 0)));
        let Self { ends, limits, obstacles, tap, told, .. } = self;
        let fate = take_set(obstacles, (tap, told), set, from.id, |_| may, now_ns, &limits.obstacles);
        ends.obstacles.input_buffer_mut().copy_from(obstacles);
        ends.obstacles.publish();
        self.know(from, fate)
    }

    fn take_point_of(&mut self, from: SocketPort, point: &Target, now_ns: u64) -> Result<(), RejectCause> {
        let other = self.target.taken_by(from.id);
        let may = other.is_some_and(|other| self.replaces(other, from, |ports| ports.may_replace_target(other, 0)));
        let Self { ends, limits, target, tap, .. } = self;
        let fate = take_point(target, tap, point, from.id, |_| may, now_ns, &limits.target);
        ends.target.input_buffer_mut().copy_from(target);
        ends.target.publish();
        self.know(from, fate)
    }

    fn know(&mut self, from: SocketPort, fate: Result<(), RejectCause>) -> Result<(), RejectCause> {
        if fate.is_ok() && !self.sockets.contains(&from) {
            self.sockets.push(from);
        }
        fate
    }

    /// Whoever does not hear in time asks again.
    fn tell_socket(&mut self, what: ToSocket) {
        let _ = self.ends.to_socket.push(what);
    }

    fn move_requests(&mut self, now: &impl Fn() -> u64) -> Result<usize, IpcError> {
        let mut moved = 0;
        while let Ok(reply) = self.ends.replies.pop() {
            moved += 1;
            let Some(place) = self.open.iter().position(|(c, ..)| c.ticket == reply.ticket) else { continue };
            let (.., request) = self.open.swap_remove(place);
            self.answer(&request, reply);
        }
        while self.open.len() < OPEN_REQUESTS_MAX
            && let Some(request) = self.ports.next_request()?
        {
            moved += 1;
            let message = *request.payload();
            self.take_request(&message, Asker::Port(request), now());
        }
        let now_ns = now();
        while let Some(place) = self.open.iter().position(|(_, since, _)| now_ns.saturating_sub(*since) > ANSWER_NS_MAX)
        {
            let (command, _, request) = self.open.swap_remove(place);
            self.answer(&request, self.refusal(&command, RefusalReason::NoAnswer));
        }
        Ok(moved)
    }

    fn take_request(&mut self, message: &Request, asker: Asker, now_ns: u64) {
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let kind = RequestKind::from_wire(message.kind);
        let command = Command { ticket, kind: kind.unwrap_or(RequestKind::Status), speed_scale: message.speed_scale };
        let refused = if message.header.schema_version != SCHEMA_VERSION {
            Some((RefusalReason::Schema, message.header.schema_version))
        } else if kind.is_none() {
            Some((RefusalReason::UnknownRequest, message.kind))
        } else if kind == Some(RequestKind::SetTarget) {
            self.take_target(message.target, now_ns).err().map(|cause| (RefusalReason::BadTarget, cause.wire()))
        } else if kind == Some(RequestKind::Speed) && !is_speed_scale(message.speed_scale) {
            Some((RefusalReason::BadSpeed, 0))
        } else {
            None
        };
        if kind == Some(RequestKind::Clear) && refused.is_none() {
            self.forget_expired(now_ns);
        }
        if let Some((reason, detail)) = refused {
            return self.answer(&asker, Reply { detail, ..self.refusal(&command, reason) });
        }
        match self.ends.commands.push(command) {
            Ok(()) => self.open.push((command, now_ns, asker)),
            Err(_) => self.answer(&asker, self.refusal(&command, RefusalReason::Busy)),
        }
    }

    fn take_target(&mut self, mut target: Target, now_ns: u64) -> Result<(), RejectCause> {
        fill_capture(&mut target.header.capture_ns, now_ns);
        self.target.accept(&target, now_ns, &self.limits.target)?;
        self.tap.target(&target);
        self.ends.target.input_buffer_mut().copy_from(&self.target);
        self.ends.target.publish();
        Ok(())
    }

    /// What the operator clears away whether or not a fault is latched: a camera that is gone for good asks for a hold, and
    /// that is none.
    fn forget_expired(&mut self, now_ns: u64) {
        let Self { obstacles, tap, .. } = self;
        obstacles.forget_expired(now_ns, &self.limits.obstacles, |source_id| {
            tracing::warn!(source_id, "expired source of obstacles forgotten");
            tap.forgotten(source_id);
        });
        self.ends.obstacles.input_buffer_mut().copy_from(obstacles);
        self.ends.obstacles.publish();
    }

    /// An arm that was stopped, or stopped itself, does not go on to where it was sent before: whoever arms it anew gives
    /// a target anew.
    fn clear_target(&mut self) {
        self.target.clear();
        self.ends.target.input_buffer_mut().copy_from(&self.target);
        self.ends.target.publish();
    }

    /// A refusal by this thread, with the state of the last record.
    fn refusal(&self, command: &Command, reason: RefusalReason) -> Reply {
        let supervisor = SupervisorState::from_wire(self.last.0).unwrap_or(SupervisorState::Disarmed);
        Reply { fault_code: self.last.1, fault_detail: self.last.2, ..Reply::refused(command, supervisor, reason) }
    }

    fn answer(&mut self, asker: &Asker, reply: Reply) {
        let asked = match asker {
            Asker::Port(request) => Some(request.payload()),
            Asker::Socket(_) => None,
        };
        let speed = asked.filter(|asked| asked.kind == RequestKind::Speed.wire()).map(|asked| asked.speed_scale);
        let mut response = Response {
            header: asked.map_or_else(Header::default, |asked| asked.header),
            verdict: reply.verdict.wire(),
            reason: reply.reason.wire(),
            detail: reply.detail,
            supervisor: reply.supervisor.wire(),
            fault_code: reply.fault_code,
            fault_detail: reply.fault_detail,
            ..Response::default()
        };
        match (reply.verdict, reply.reason, RejectCause::from_wire(reply.detail)) {
            (Verdict::Accepted, ..) => match speed {
                Some(scale) => response.set_text(&speed_text(reply.supervisor, scale)),
                None => response.set_text(reply.supervisor.text()),
            },
            (_, RefusalReason::BadTarget, Some(cause)) => {
                response.set_text(&format!("{}: {}", reply.reason.text(), cause.text()));
            }
            (_, RefusalReason::WrongState, _) => {
                response.set_text(&format!("{} ({})", reply.reason.text(), reply.supervisor.text()));
            }
            _ => response.set_text(reply.reason.text()),
        }
        match asker {
            // A client that has gone does not wait for its answer.
            Asker::Port(request) => {
                if let Err(error) = request.send_copy(response) {
                    tracing::debug!(?error, "answer not delivered");
                }
            }
            Asker::Socket(ticket) => self.tell_socket(ToSocket::Answer(*ticket, response)),
        }
    }
}

/// Whether the arm is on its way to tension, under tension, or on its way out of it in order.
fn is_armed(supervisor: u32) -> bool {
    ![SupervisorState::Disarmed, SupervisorState::Faulted].map(SupervisorState::wire).contains(&supervisor)
}

/// Whoever leaves the time to the daemon, whose clock it may not know, has seen it just now.
fn fill_capture(capture_ns: &mut u64, now_ns: u64) {
    if *capture_ns == 0 {
        *capture_ns = now_ns;
    }
}

/// Takes over a set of obstacles; `replaces` tells whether this port may have the id of that one.
fn take_set<T: Tap>(
    obstacles: &mut ObstacleTable,
    (tap, told): (&mut T, &mut Told),
    message: &Obstacles,
    port: u128,
    replaces: impl Fn(u128) -> bool,
    now_ns: u64,
    limits: &InputLimits,
) -> Result<(), RejectCause> {
    let id = message.header.source_id;
    if let Some(other) = obstacles.taken_by(id, port)
        && replaces(other)
    {
        obstacles.set_gone(other);
    }
    let fate = obstacles.accept_from(message, port, now_ns, limits);
    match fate {
        Ok(()) => tap.obstacles(message),
        Err(cause) => told.tell(id, cause),
    }
    fate
}

/// The same of a point of the desired motion.
fn take_point<T: Tap>(
    target: &mut TargetTrack,
    tap: &mut T,
    message: &Target,
    port: u128,
    replaces: impl Fn(u128) -> bool,
    now_ns: u64,
    limits: &InputLimits,
) -> Result<(), RejectCause> {
    if let Some(other) = target.taken_by(port)
        && replaces(other)
    {
        target.set_gone();
    }
    target.accept_from(message, port, now_ns, limits).inspect(|()| tap.target(message))
}
