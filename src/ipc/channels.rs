//! The hand-over between the I/O thread and the control thread: wait-free on both sides.
//!
//! Inputs are newest-value (triple buffers); commands, records, replies and events go through bounded rings. A full ring
//! drops the new entry and counts it: the control thread never waits, and nothing behind it can stop it.

use super::by_socket::{BySocket, ToSocket};
use super::intake::{EncoderTable, ObstacleTable, TargetTrack, TipTable};
use super::payload::{RefusalReason, Request, RequestKind, State, SupervisorState, Verdict};
use rtrb::{Consumer, Producer, RingBuffer};
use triple_buffer::{Input, Output, triple_buffer};

/// Bit of the tickets that go the direct way, around the I/O thread.
const DIRECT: u64 = 1 << 63;

/// An operator's request on its way to the supervisor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Goes back in [`Reply::ticket`].
    pub ticket: u64,
    /// What is asked for.
    pub kind: RequestKind,
    /// Speed over the configured one, for [`RequestKind::Speed`]; checked by whoever took the request.
    pub speed_scale: f64,
}

/// The supervisor's answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply {
    /// The command's.
    pub ticket: u64,
    /// Accepted or refused.
    pub verdict: Verdict,
    /// Why refused.
    pub reason: RefusalReason,
    /// A number that belongs to the reason.
    pub detail: u32,
    /// Supervisor's state after the command.
    pub supervisor: SupervisorState,
    /// Fault code, 0 without a fault.
    pub fault_code: u32,
    /// Detail of the fault.
    pub fault_detail: u32,
}

impl Reply {
    /// An answer that accepts.
    pub const fn accepted(command: &Command, supervisor: SupervisorState) -> Self {
        Self {
            ticket: command.ticket,
            verdict: Verdict::Accepted,
            reason: RefusalReason::None,
            detail: 0,
            supervisor,
            fault_code: 0,
            fault_detail: 0,
        }
    }

    /// An answer that refuses.
    pub const fn refused(command: &Command, supervisor: SupervisorState, reason: RefusalReason) -> Self {
        Self { verdict: Verdict::Refused, reason, ..Self::accepted(command, supervisor) }
    }
}

/// Something that happened in the loop; formatted by others, later.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// CLOCK_MONOTONIC (ns).
    pub time_ns: u64,
    /// Tick.
    pub tick: u64,
    /// Code of the event's kind.
    pub code: u32,
    /// Index that belongs to it (cable, drive, source).
    pub detail: u32,
    /// Bits that belong to it: those of a fault.
    pub flags: u32,
    /// Number that belongs to it.
    pub value: f64,
    /// Another one; NaN where there is none.
    pub second: f64,
    /// What happened, in fixed words.
    pub text: &'static str,
}

/// Capacities of the rings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChannelCapacity {
    /// Commands and replies.
    pub commands: usize,
    /// Records of ticks (15 kB each).
    pub records: usize,
    /// Events.
    pub events: usize,
}

impl Default for ChannelCapacity {
    fn default() -> Self {
        Self { commands: 16, records: 64, events: 1024 }
    }
}

/// Inputs that a tick in lockstep waits for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LockstepSources {
    /// Encoders.
    pub encoders: bool,
    /// A task client that sends a target for every tick.
    pub target: bool,
    /// Obstacle sources.
    pub obstacles: Vec<u32>,
}

/// What the control thread reads.
#[derive(Debug)]
pub struct ControlInputs {
    encoders: Output<EncoderTable>,
    target: Output<TargetTrack>,
    tip: Output<TipTable>,
    obstacles: Output<ObstacleTable>,
    commands: Consumer<Command>,
    direct: Consumer<Command>,
}

impl ControlInputs {
    /// Takes over the newest of everything, once per tick. Wait-free; does not allocate or copy.
    pub fn update(&mut self) {
        self.encoders.update();
        self.target.update();
        self.tip.update();
        self.obstacles.update();
    }

    /// Encoder states as of the last [`ControlInputs::update`].
    pub fn encoders(&self) -> &EncoderTable {
        self.encoders.output_buffer()
    }

    /// Measured tips as of the last update.
    pub fn tip(&self) -> &TipTable {
        self.tip.output_buffer()
    }

    /// Targets as of the last update.
    pub fn target(&self) -> &TargetTrack {
        self.target.output_buffer()
    }

    /// Obstacles as of the last update.
    pub fn obstacles(&self) -> &ObstacleTable {
        self.obstacles.output_buffer()
    }

    /// The next command; `None` if there is none. Those that came the direct way precede the others.
    pub fn next_command(&mut self) -> Option<Command> {
        self.direct.pop().or_else(|_| self.commands.pop()).ok()
    }

    /// Whether a command waits that came the direct way.
    pub fn has_direct_command(&self) -> bool {
        !self.direct.is_empty()
    }

    /// Lockstep: whether all inputs of a tick are here. Call [`ControlInputs::update`] before.
    pub fn is_ready_for(&self, tick: u64, sources: &LockstepSources) -> bool {
        (!sources.encoders || self.encoders().is_ready_for(tick))
            && (!sources.target || self.target().is_ready_for(tick))
            && self.obstacles().is_ready_for(tick, &sources.obstacles)
    }
}

/// What the control thread writes.
#[derive(Debug)]
pub struct ControlOutputs {
    records: Producer<State>,
    replies: Producer<Reply>,
    direct_replies: Producer<Reply>,
    events: Producer<Event>,
    dropped: u64,
}

impl ControlOutputs {
    /// Hands over a tick's record; `records_dropped` is filled in. `false` if the ring was full. Wait-free.
    pub fn record(&mut self, state: &mut State) -> bool {
        state.records_dropped = self.dropped;
        let pushed = self.records.push(*state).is_ok();
        self.dropped += u64::from(!pushed);
        pushed
    }

    /// Answers a command on the way by which it came; `false` if the ring was full (whoever waits at its end then answers
    /// that nobody did). Wait-free.
    pub fn reply(&mut self, reply: Reply) -> bool {
        let ring = if reply.ticket & DIRECT == 0 { &mut self.replies } else { &mut self.direct_replies };
        ring.push(reply).is_ok()
    }

    /// Hands over an event; `false`, and counted with the records, if the ring was full. Wait-free.
    pub fn event(&mut self, event: Event) -> bool {
        let pushed = self.events.push(event).is_ok();
        self.dropped += u64::from(!pushed);
        pushed
    }

    /// Records and events that found their ring full.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

/// The I/O thread's ends.
#[derive(Debug)]
pub struct IoEnds {
    pub(crate) encoders: Input<EncoderTable>,
    pub(crate) target: Input<TargetTrack>,
    pub(crate) tip: Input<TipTable>,
    pub(crate) obstacles: Input<ObstacleTable>,
    pub(crate) commands: Producer<Command>,
    pub(crate) records: Consumer<State>,
    pub(crate) replies: Consumer<Reply>,
    pub(crate) events: Consumer<Event>,
    pub(crate) by_socket: Consumer<BySocket>,
    pub(crate) to_socket: Producer<ToSocket>,
}

/// The socket's end: of the direct way to the control thread, which shares nothing with the I/O thread and shared memory,
/// and of the way to the I/O thread.
#[derive(Debug)]
pub struct DirectEnd {
    commands: Producer<Command>,
    replies: Consumer<Reply>,
    to_io: Producer<BySocket>,
    from_io: Consumer<ToSocket>,
    next: u64,
}

impl DirectEnd {
    /// Asks the control thread; the ticket of its answer. `None` if too many commands wait. Wait-free.
    /// `speed_scale` is for [`RequestKind::Speed`] alone.
    pub fn ask(&mut self, kind: RequestKind, speed_scale: f64) -> Option<u64> {
        let ticket = DIRECT | self.next;
        self.commands.push(Command { ticket, kind, speed_scale }).ok()?;
        self.next += 1;
        Some(ticket)
    }

    /// The next answer; `None` if there is none. Wait-free.
    pub fn next_reply(&mut self) -> Option<Reply> {
        self.replies.pop().ok()
    }

    /// Asks the I/O thread; the ticket of its answer. `None` if too much waits.
    pub fn ask_io(&mut self, request: Request) -> Option<u64> {
        let ticket = DIRECT | self.next;
        self.to_io.push(BySocket::Ask(ticket, Box::new(request))).ok()?;
        self.next += 1;
        Some(ticket)
    }

    /// Hands something to the I/O thread, or gives it back if too much waits.
    ///
    /// # Errors
    /// What was to be handed over.
    pub fn hand_io(&mut self, what: BySocket) -> Result<(), BySocket> {
        self.to_io.push(what).map_err(|rtrb::PushError::Full(what)| what)
    }

    /// The next word of the I/O thread; `None` if there is none.
    pub fn next_from_io(&mut self) -> Option<ToSocket> {
        self.from_io.pop().ok()
    }
}

/// Makes all channels. Allocates everything that they ever use. Tables pass over the stack on their way to the heap, which
/// are half a megabyte: never together with the caller's own.
#[inline(never)]
pub fn channels(
    cable_count: usize,
    segment_count: usize,
    declared_sources: &[u32],
    capacity: ChannelCapacity,
) -> (ControlInputs, ControlOutputs, IoEnds, DirectEnd) {
    let (encoders_in, encoders_out) = triple_buffer(&EncoderTable::new(cable_count));
    let (target_in, target_out) = triple_buffer(&TargetTrack::new(segment_count));
    let (tip_in, tip_out) = triple_buffer(&TipTable::default());
    let (obstacles_in, obstacles_out) = triple_buffer(&ObstacleTable::new(declared_sources));
    let (commands_in, commands_out) = RingBuffer::new(capacity.commands);
    let (direct_in, direct_out) = RingBuffer::new(capacity.commands);
    let (direct_replies_in, direct_replies_out) = RingBuffer::new(capacity.commands);
    let (records_in, records_out) = RingBuffer::new(capacity.records);
    let (replies_in, replies_out) = RingBuffer::new(capacity.commands);
    let (events_in, events_out) = RingBuffer::new(capacity.events);
    let (by_socket_in, by_socket_out) = RingBuffer::new(4 * capacity.commands);
    let (to_socket_in, to_socket_out) = RingBuffer::new(4 * capacity.commands);
    (
        ControlInputs {
            encoders: encoders_out,
            target: target_out,
            tip: tip_out,
            obstacles: obstacles_out,
            commands: commands_out,
            direct: direct_out,
        },
        ControlOutputs {
            records: records_in,
            replies: replies_in,
            direct_replies: direct_replies_in,
            events: events_in,
            dropped: 0,
        },
        IoEnds {
            encoders: encoders_in,
            target: target_in,
            tip: tip_in,
            obstacles: obstacles_in,
            commands: commands_in,
            records: records_out,
            replies: replies_out,
            events: events_out,
            by_socket: by_socket_out,
            to_socket: to_socket_in,
        },
        DirectEnd {
            commands: direct_in,
            replies: direct_replies_out,
            to_io: by_socket_in,
            from_io: to_socket_out,
            next: 0,
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_ring_drops_and_counts_and_the_next_record_says_so() {
        let capacity = ChannelCapacity { records: 2, ..ChannelCapacity::default() };
        let (_inputs, mut outputs, mut io, _) = channels(24, 4, &[], capacity);
        let mut state = State::default();
        let pushed: Vec<bool> = (0..4).map(|_| outputs.record(&mut state)).collect();
        assert_eq!(pushed, [true, true, false, false]);
        assert!(io.records.pop().is_ok());
        assert!(outputs.record(&mut state));
        assert_eq!(std::iter::from_fn(|| io.records.pop().ok()).last().unwrap().records_dropped, 2);
    }

    #[test]
    fn the_control_thread_reads_and_writes_without_allocating() {
        let (mut inputs, mut outputs, mut io, mut direct) = channels(24, 4, &[], ChannelCapacity::default());
        let mut state = State::default();
        let mut tracked = crate::ipc::intake::TrackedSet::new();
        let limits = crate::ipc::intake::InputLimits::default();
        assert!(io.commands.push(Command { ticket: 1, kind: RequestKind::Arm, speed_scale: 1.0 }).is_ok());
        let ticket = direct.ask(RequestKind::Stop, 1.0).unwrap();
        assert_no_alloc::assert_no_alloc(|| {
            inputs.update();
            inputs.obstacles().track_into(1, 0.1, &limits, &mut tracked);
            inputs.obstacles().report_into(1, &limits, &mut state);
            for kind in [RequestKind::Stop, RequestKind::Arm] {
                let command = inputs.next_command().unwrap();
                assert!(command.kind == kind, "the direct way precedes");
                outputs.reply(Reply::accepted(&command, SupervisorState::Holding));
            }
            outputs.record(&mut state);
        });
        assert_eq!(io.replies.pop().unwrap().ticket, 1);
        assert_eq!(direct.next_reply().unwrap().ticket, ticket);
        assert!(io.replies.pop().is_err() && direct.next_reply().is_none(), "each by the way it came");
    }
}
