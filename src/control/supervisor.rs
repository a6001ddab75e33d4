//! Modes, and what changes them.
//!
//! # Requests
//!
//! `-> X` changes the mode, `ok` is accepted and changes nothing, anything else is the refusal's reason.
//!
//! | mode \ request | arm | disarm | hold | track | home | stop | clear |
//! |---|---|---|---|---|---|---|---|
//! | Disarmed | -> Starting, or `DrivesNotReady`, `EmergencyStop`, `NotAtRest`, `ObstaclesExpired` | ok | `Disarmed` | `Disarmed` | `Disarmed` | ok | `NothingLatched` |
//! | Starting | ok | -> Stopping (no ramp) | ok | `NotSettled` | `NotSettled` | -> Stopping | `NothingLatched` |
//! | Holding | ok | -> Stopping (no ramp) | ok | -> Tracking, or `NoTarget`, `ObstaclesExpired` | -> Homing, or `ObstaclesExpired` | -> Stopping | `NothingLatched` |
//! | Tracking | ok | -> Stopping (no ramp) | -> Holding | ok | -> Homing, or `ObstaclesExpired` | -> Stopping | `NothingLatched` |
//! | Homing | ok | -> Stopping (no ramp) | -> Holding | -> Tracking, or `NoTarget`, `ObstaclesExpired` | ok | -> Stopping | `NothingLatched` |
//! | Stopping | `Stopping` | ok, skips the ramp | `Stopping` | `Stopping` | `Stopping` | ok | `NothingLatched` |
//! | Faulted | `Faulted` | ok, skips the ramp | `Faulted` | `Faulted` | `Faulted` | ok, lets go of what is held | -> Disarmed, or `StillHeld`, `StillRamping`, `CausePersists` |
//!
//! # What happens by itself
//!
//! | mode | event | then |
//! |---|---|---|
//! | every one but Disarmed and Faulted | a fault that permits it ([`Fault::permits_holding`]), and cables that are declared to stay | -> Faulted: the cables are held until a stop; latched |
//! | every one but Disarmed and Faulted | any other fault | -> Faulted: ramp to the safe tension, then drives off; latched |
//! | Faulted, held | a fault that does not permit it | ramp to the safe tension, then drives off |
//! | Faulted, held, then a stop | the loop is sound ([`Fault::permits_lowering`]) | as Stopping |
//! | Faulted, held, then a stop | it is not | slow ramp to the safe tension, then drives off |
//! | Starting | drives up, tensions reached, encoders heard, observer settled, start posture reached | -> Holding |
//! | Starting | `settle_timeout_s` is over before it moves | fault `DrivesNotUp`, `EncoderSilent` or `NotSettled`, by what is missing |
//! | Tracking | target absent or too old (`TargetStale`), obstacles expired (`ObstaclesExpired`) | -> Holding |
//! | Homing | home reached; obstacles expired | -> Holding |
//! | Tracking | the target is out of reach and refused (`governor.out_of_reach`) | -> Holding |
//! | Tracking, Homing | the supervision asks to hold ([`super::supervision`]) | -> Holding |
//! | Stopping from Starting, bent by its start tensions | observer settled | the way to the rest posture |
//! | Stopping from Starting, bent by its start tensions | `settle_timeout_s` is over | fault as in Starting |
//! | Stopping | rest posture reached, around obstacles as on any way | ramp to the safe tension, then drives off |
//! | Stopping | ramp over, drives off, arm at rest | -> Disarmed |
//! | Holding, Tracking, Homing | deadlines missed, see [`super::overruns`]: up to `overruns_hold`; above; `overruns_fault` | last tensions held for a tick; ramp to the safe tension, until five ticks in a row were in time; fault `Overruns` |
//!
//! A hold is left by a request only: an arm that waited for a lost client must not start by itself when it is back.
//! Faults while disarmed are not latched, for nothing moves; they keep `arm` from succeeding. `clear` needs the bus and
//! the encoders back, but not the drives: it resets them, and an encoder that is read through a faulted drive comes back
//! only with that drive. Whatever persists is found again at the next `arm`.

use super::event::{Event, EventKind, EventRing};
use super::fault::{Fault, FaultLatch, FaultList, Limit, Limits};
use super::obstacles::ObstacleDemand;
use super::overruns::{Demand, Overruns};
use crate::config::{LoopConfig, ObserverConfig};
use sinew_hal::clock::seconds_to_ns;

/// What the arm is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Drives off.
    Disarmed,
    /// Drives come up, cables are tightened, the observer settles.
    Starting,
    /// The pose is held, obstacles are avoided.
    Holding,
    /// The target is followed.
    Tracking,
    /// On the way to the home pose.
    Homing,
    /// The arm is lowered to where it rests without torque, tensions are ramped to the safe value, then drives disabled.
    Stopping,
    /// After a fault: held as it is, or as Stopping; latched.
    Faulted,
}

impl Mode {
    /// All modes.
    pub const ALL: [Self; 7] =
        [Self::Disarmed, Self::Starting, Self::Holding, Self::Tracking, Self::Homing, Self::Stopping, Self::Faulted];

    /// Whether the planner runs.
    pub const fn is_planning(self) -> bool {
        matches!(self, Self::Holding | Self::Tracking | Self::Homing)
    }
}

/// What an operator asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Request {
    /// Bring the drives up and hold.
    Arm,
    /// Take the torque off at once, in order.
    Disarm,
    /// Hold the present pose.
    Hold,
    /// Follow the target, or go on following it.
    Track,
    /// Go to the home pose.
    Home,
    /// Lower the arm, ramp down, disarm.
    Stop,
    /// Release a latched fault.
    Clear,
}

impl Request {
    /// All requests.
    pub const ALL: [Self; 7] = [Self::Arm, Self::Disarm, Self::Hold, Self::Track, Self::Home, Self::Stop, Self::Clear];
}

/// Why a request was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Refusal {
    /// The arm is disarmed: `arm` first.
    Disarmed,
    /// The drives cannot be brought up: a bus is lost, or a drive is in fault or not configured.
    DrivesNotReady,
    /// An emergency stop is pressed.
    EmergencyStop,
    /// The observer has not settled.
    NotSettled,
    /// The arm moves.
    NotAtRest,
    /// There is no target, or it is too old.
    NoTarget,
    /// Obstacles are unknown or too old.
    ObstaclesExpired,
    /// The arm is stopping.
    Stopping,
    /// A fault is latched: `clear` first.
    Faulted,
    /// The tensions are still on their way to the safe value, or the drives not yet off.
    StillRamping,
    /// The arm is still held after a fault: `stop` first.
    StillHeld,
    /// The cause of the fault persists.
    CausePersists,
    /// No fault is latched.
    NothingLatched,
}

/// The answer to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    /// Which one.
    pub request: Request,
    /// `None`: accepted.
    pub refusal: Option<Refusal>,
}

/// Why the mode changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cause {
    /// A request.
    Request(Request),
    /// A fault.
    Fault(Fault),
    /// A limit: the declared action on stale inputs.
    Limit(Limit),
    /// What the mode was for is done: settled, home reached, drives off.
    Done,
}

/// What the drives are doing, all taken together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DrivesPhase {
    /// No drive gives torque.
    #[default]
    Off,
    /// Some do: coming up or going down.
    Changing,
    /// All do.
    Enabled,
}

/// State of the drives at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DrivesInput {
    /// What they are doing.
    pub phase: DrivesPhase,
    /// Whether they could be brought up now: every one is configured and without fault.
    pub ready: bool,
    /// A drive in fault: cable, and the drive layer's number for it.
    pub fault: Option<(u16, u32)>,
    /// A bus that does not answer.
    pub bus_lost: Option<u16>,
    /// An emergency stop that is pressed: the cable whose drive has the input, or [`Fault::SERVICE`].
    pub emergency_stop: Option<u16>,
}

/// What the drives shall do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DrivesCommand {
    /// Be off; disable in order if they are not.
    Off,
    /// Give torque; come up if they do not.
    On,
    /// Reset their faults and be off.
    Reset,
}

/// How far the start has come; what it waits for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Progress {
    /// For the drives.
    Drives,
    /// For the start tensions.
    Tensions,
    /// For this cable's encoder, last heard so long ago (s).
    Encoder(u16, f64),
    /// For the observer.
    Settling,
    /// For the start posture.
    Posture,
    /// For nothing.
    Done,
}

/// What the supervisor sees in a tick.
#[derive(Debug, Clone, Copy)]
pub struct Observed {
    /// Tick.
    pub tick: u64,
    /// Its time (ns).
    pub now_ns: u64,
    /// A request, if there is one.
    pub request: Option<Request>,
    /// Drives.
    pub drives: DrivesInput,
    /// Faults of encoders and estimate found in this tick.
    pub faults: FaultList,
    /// How far the start has come; looked at in [`Mode::Starting`].
    pub progress: Progress,
    /// Whether there is a target that may be followed.
    pub target_fresh: bool,
    /// What the obstacle inputs ask for.
    pub obstacles: ObstacleDemand,
    /// What the supervision asks to hold for.
    pub hold: Option<Limit>,
    /// Whether the tip target is out of reach, and refused for it; looked at in [`Mode::Tracking`].
    pub unreachable: bool,
    /// Whether the tensions are at the safe value.
    pub at_safe_tension: bool,
    /// Whether the home pose is reached; looked at in [`Mode::Homing`].
    pub at_home: bool,
    /// Whether the rest posture is reached; looked at in [`Mode::Stopping`].
    pub lowered: bool,
    /// Whether the start tensions hold the arm elsewhere than where it rests without; looked at in [`Mode::Starting`].
    pub bent: bool,
    /// Whether the arm moves, as far as encoders and estimate tell.
    pub moves: bool,
    /// Deadlines missed since the tick before: ticks left out, and that tick itself if its torques left after its period.
    pub missed: u32,
}

/// What the cycle shall do in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Nothing: drives off, no tension.
    Off,
    /// Bring the cables to the start tensions once the drives are up.
    Tighten,
    /// Plan: hold the pose.
    Hold,
    /// Plan: follow the target.
    Track,
    /// Plan: go home.
    Home,
    /// Plan: go to the start posture.
    Raise,
    /// Plan: go to the rest posture.
    Lower,
    /// Keep the last tensions.
    Keep,
    /// Ramp to the safe tension.
    Ramp,
    /// After a fault: each cable as it is declared to stay.
    Stay,
    /// Slow ramp to the safe tension.
    Release,
}

impl Action {
    /// Whether it is the planner's.
    pub const fn plans(self) -> bool {
        matches!(self, Self::Hold | Self::Track | Self::Home | Self::Raise | Self::Lower)
    }
}

/// What a tick's step decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// What to do.
    pub action: Action,
    /// What the drives shall do.
    pub drives: DrivesCommand,
    /// The answer to the request, if there was one.
    pub answer: Option<Answer>,
    /// Limits that act for the supervisor's reasons.
    pub limits: Limits,
}

/// The state machine.
#[derive(Debug, Clone)]
pub struct Supervisor {
    mode: Mode,
    entered_ns: u64,
    /// Stopping, Faulted: the tensions are still to be ramped down.
    ramping: bool,
    /// Faulted: the cables are held.
    held: bool,
    /// Faulted: what was held is let go slowly.
    slowly: bool,
    /// Cables are declared to stay at a fault.
    stays: bool,
    arms_unknown: bool,
    /// Starting, Stopping: on the way to the start posture, to the rest posture.
    under_way: bool,
    /// Stopping: the observer has to settle, for an arm that is not known cannot be led down.
    settles: bool,
    /// A stop lowers the arm, and is over when it rests.
    lowers: bool,
    overruns: Overruns,
    /// A limit that led to the present hold.
    held_by: Limits,
    latch: FaultLatch,
    events: EventRing,
    limits: Limits,
    settle_timeout_ns: u64,
}

impl Supervisor {
    /// Disarmed; `stays` where cables are declared to stay as they are at a fault, `arms_unknown` where the arm may be armed
    /// while obstacles are not known.
    pub fn new(timing: &LoopConfig, observer: &ObserverConfig, stays: bool, arms_unknown: bool) -> Self {
        Self {
            mode: Mode::Disarmed,
            entered_ns: 0,
            ramping: false,
            held: false,
            slowly: false,
            stays,
            arms_unknown,
            under_way: false,
            settles: false,
            lowers: timing.stop_timeout_s > 0.0,
            overruns: Overruns::new(timing),
            held_by: Limits::default(),
            latch: FaultLatch::default(),
            events: EventRing::default(),
            limits: Limits::default(),
            settle_timeout_ns: seconds_to_ns(observer.settle_timeout_s),
        }
    }

    /// Present mode.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Whether the planner runs: in modes that plan, and on the way to the start and the rest posture.
    pub const fn is_planning(&self) -> bool {
        self.mode.is_planning() || self.under_way
    }

    /// Whether a start goes on: as one, or because the arm has to be known before it is lowered.
    pub fn is_starting(&self) -> bool {
        self.mode == Mode::Starting || self.settles
    }

    /// Whether the arm is held after a fault.
    pub const fn is_held(&self) -> bool {
        self.held
    }

    /// What is latched.
    pub const fn latch(&self) -> &FaultLatch {
        &self.latch
    }

    /// Missed deadlines that are not forgotten, see [`super::overruns`].
    pub fn deadlines_missed(&self) -> u32 {
        self.overruns.count()
    }

    /// What happened; the caller takes the events out.
    pub const fn events_mut(&mut self) -> &mut EventRing {
        &mut self.events
    }

    /// One tick: faults first, then the request, then what happens by itself. Does not allocate.
    pub fn step(&mut self, seen: &Observed) -> Decision {
        self.overruns.begin(self.is_planning(), seen.missed);
        self.find_faults(seen);
        let mut reset = false;
        // `progress` speaks of a start that was under way when the tick began.
        let starting = self.is_starting();
        let answer = seen.request.map(|request| {
            let refusal = self.answer(request, seen, &mut reset).err();
            let answer = Answer { request, refusal };
            self.event(seen, EventKind::Request(answer));
            answer
        });
        self.advance(seen, starting);
        let (action, overrun) = self.action();
        self.overruns.end(action.plans());
        let mut limits = self.held_by;
        if seen.drives.emergency_stop.is_some() {
            limits.insert(Limit::EmergencyStop);
        }
        overrun.into_iter().for_each(|limit| limits.insert(limit));
        let drives = match action {
            Action::Off if reset => DrivesCommand::Reset,
            Action::Off => DrivesCommand::Off,
            _ => DrivesCommand::On,
        };
        Decision { action, drives, answer, limits }
    }

    /// A fault found after [`Self::step`], in the tensions; changes the mode at once.
    pub fn raise(&mut self, fault: Fault, tick: u64, now_ns: u64, drives: DrivesPhase) {
        if self.latch.raise(fault, tick, now_ns) {
            self.events.push(Event { tick, now_ns, kind: EventKind::Fault(fault) });
        }
        let (on, stays) = (drives != DrivesPhase::Off, self.stays && fault.permits_holding());
        if self.mode != Mode::Faulted {
            (self.held, self.ramping, self.slowly) = (on && stays, on && !stays, false);
            self.change(Mode::Faulted, Cause::Fault(fault), tick, now_ns);
        } else if self.held && !stays {
            (self.held, self.ramping, self.slowly) = (false, on, false);
        } else if self.under_way {
            // On the way down after a fault: the loop is not sound any more.
            (self.under_way, self.held, self.ramping) = (false, on && stays, on && !stays);
        }
    }

    /// Notes which limits acted in a tick: their beginnings and ends become events.
    pub fn note_limits(&mut self, limits: Limits, tick: u64, now_ns: u64) {
        for limit in Limit::ALL {
            let kind = match (self.limits.contains(limit), limits.contains(limit)) {
                (false, true) => EventKind::LimitOn(limit),
                (true, false) => EventKind::LimitOff(limit),
                _ => continue,
            };
            self.events.push(Event { tick, now_ns, kind });
        }
        self.limits = limits;
    }

    fn event(&mut self, seen: &Observed, kind: EventKind) {
        self.events.push(Event { tick: seen.tick, now_ns: seen.now_ns, kind });
    }

    fn change(&mut self, to: Mode, cause: Cause, tick: u64, now_ns: u64) {
        let from = std::mem::replace(&mut self.mode, to);
        self.entered_ns = now_ns;
        (self.under_way, self.settles) = (false, false);
        self.held_by = match cause {
            Cause::Limit(limit) => Limits(1 << limit as u32),
            _ => Limits::default(),
        };
        self.events.push(Event { tick, now_ns, kind: EventKind::Mode { from, to, cause } });
    }

    fn go(&mut self, to: Mode, cause: Cause, seen: &Observed) {
        self.change(to, cause, seen.tick, seen.now_ns);
    }

    /// Everything that is a fault in this mode.
    fn find_faults(&mut self, seen: &Observed) {
        if self.mode == Mode::Disarmed {
            return;
        }
        let raise = |this: &mut Self, fault| this.raise(fault, seen.tick, seen.now_ns, seen.drives.phase);
        if let Some(source) = seen.drives.emergency_stop {
            raise(self, Fault::EmergencyStop { source });
        }
        if let Some(bus) = seen.drives.bus_lost {
            raise(self, Fault::BusLost { bus });
        }
        if let Some((cable, cause)) = seen.drives.fault {
            raise(self, Fault::DriveFault { cable, cause });
        }
        seen.faults.iter().for_each(|fault| raise(self, fault));
        // Without torque although nobody took it: in every mode that needs it, after the causes that name themselves.
        if self.is_planning() && seen.drives.phase != DrivesPhase::Enabled {
            raise(self, Fault::DrivesLost);
        }
        if self.is_starting() && seen.now_ns.saturating_sub(self.entered_ns) > self.settle_timeout_ns {
            let after_s = self.settle_timeout_ns as f64 * 1e-9;
            match seen.progress {
                Progress::Done | Progress::Posture => {}
                Progress::Drives => raise(self, Fault::DrivesNotUp { after_s }),
                Progress::Encoder(cable, age_s) => raise(self, Fault::EncoderSilent { cable, age_s }),
                Progress::Tensions | Progress::Settling => raise(self, Fault::NotSettled { after_s }),
            }
        }
        if self.is_planning() && self.overruns.is_fault() {
            raise(self, Fault::Overruns { count: self.overruns.count() });
        }
    }

    /// The table of requests.
    fn answer(&mut self, request: Request, seen: &Observed, reset: &mut bool) -> Result<(), Refusal> {
        let obstacles = match seen.obstacles {
            ObstacleDemand::Proceed => Ok(()),
            ObstacleDemand::Hold { .. } => Err(Refusal::ObstaclesExpired),
        };
        let target = if seen.target_fresh { Ok(()) } else { Err(Refusal::NoTarget) };
        let to = match (self.mode, request) {
            (Mode::Disarmed, Request::Arm) => {
                let drives = &seen.drives;
                if drives.emergency_stop.is_some() {
                    return Err(Refusal::EmergencyStop);
                }
                if !drives.ready || drives.fault.is_some() || drives.bus_lost.is_some() {
                    return Err(Refusal::DrivesNotReady);
                }
                if seen.moves {
                    return Err(Refusal::NotAtRest);
                }
                if !self.arms_unknown {
                    obstacles?;
                }
                Mode::Starting
            }
            (Mode::Disarmed, Request::Disarm | Request::Stop) => return Ok(()),
            (Mode::Disarmed, Request::Hold | Request::Track | Request::Home) => return Err(Refusal::Disarmed),

            (Mode::Faulted, Request::Clear) => {
                if self.held || self.under_way {
                    return Err(Refusal::StillHeld);
                }
                if self.ramping || seen.drives.phase != DrivesPhase::Off {
                    return Err(Refusal::StillRamping);
                }
                // An encoder behind a faulted drive comes back only when that drive is reset.
                let encoders_persist = !seen.faults.is_empty() && seen.drives.fault.is_none();
                if seen.drives.emergency_stop.is_some() || seen.drives.bus_lost.is_some() || encoders_persist {
                    return Err(Refusal::CausePersists);
                }
                self.latch.clear();
                *reset = true;
                Mode::Disarmed
            }
            (Mode::Faulted | Mode::Stopping, Request::Disarm) => {
                (self.ramping, self.under_way, self.settles, self.held) = (false, false, false, false);
                return Ok(());
            }
            (Mode::Faulted, Request::Stop) if self.held => {
                let sound = self.latch.first.is_some_and(|latched| latched.fault.permits_lowering());
                self.under_way = sound && self.lowers && seen.drives.phase == DrivesPhase::Enabled;
                (self.held, self.ramping, self.slowly) = (false, true, !self.under_way);
                return Ok(());
            }
            (Mode::Faulted | Mode::Stopping, Request::Stop) => return Ok(()),
            (Mode::Faulted, _) => return Err(Refusal::Faulted),
            (_, Request::Clear) => return Err(Refusal::NothingLatched),
            (Mode::Stopping, _) => return Err(Refusal::Stopping),

            (Mode::Starting, Request::Arm | Request::Hold) => return Ok(()),
            (Mode::Starting, Request::Track | Request::Home) => return Err(Refusal::NotSettled),
            (_, Request::Disarm) => {
                self.ramping = false;
                Mode::Stopping
            }
            (_, Request::Stop) => {
                self.ramping = seen.drives.phase != DrivesPhase::Off;
                let lowers = self.lowers && self.is_planning();
                let settles = self.lowers && !lowers && seen.bent && seen.drives.phase == DrivesPhase::Enabled;
                self.go(Mode::Stopping, Cause::Request(request), seen);
                (self.under_way, self.settles) = (lowers, settles);
                return Ok(());
            }
            (_, Request::Arm)
            | (Mode::Holding, Request::Hold)
            | (Mode::Tracking, Request::Track)
            | (Mode::Homing, Request::Home) => return Ok(()),
            (_, Request::Hold) => Mode::Holding,
            (_, Request::Track) => {
                target.and(obstacles)?;
                Mode::Tracking
            }
            (_, Request::Home) => {
                obstacles?;
                Mode::Homing
            }
        };
        self.go(to, Cause::Request(request), seen);
        Ok(())
    }

    /// What happens by itself.
    fn advance(&mut self, seen: &Observed, starting: bool) {
        let expired = seen.obstacles != ObstacleDemand::Proceed;
        match self.mode {
            Mode::Starting if starting && seen.progress == Progress::Done => self.go(Mode::Holding, Cause::Done, seen),
            Mode::Starting => self.under_way |= starting && seen.progress == Progress::Posture,
            Mode::Tracking if expired => self.go(Mode::Holding, Cause::Limit(Limit::ObstaclesExpired), seen),
            Mode::Tracking | Mode::Homing if seen.hold.is_some() => {
                let limit = seen.hold.unwrap_or(Limit::Swinging);
                self.go(Mode::Holding, Cause::Limit(limit), seen);
            }
            Mode::Tracking if seen.unreachable => self.go(Mode::Holding, Cause::Limit(Limit::OutOfReach), seen),
            Mode::Tracking if !seen.target_fresh => self.go(Mode::Holding, Cause::Limit(Limit::TargetStale), seen),
            Mode::Homing if expired => self.go(Mode::Holding, Cause::Limit(Limit::ObstaclesExpired), seen),
            Mode::Homing if seen.at_home => self.go(Mode::Holding, Cause::Done, seen),
            Mode::Stopping if self.settles => {
                self.under_way = starting && seen.progress == Progress::Done;
                self.settles = !self.under_way;
            }
            Mode::Stopping | Mode::Faulted if self.under_way => self.under_way = !seen.lowered,
            // A drive that is not heard may hold by itself, and is told the same when it hears again.
            Mode::Faulted if self.held => {
                self.held = seen.drives.phase != DrivesPhase::Off || seen.drives.bus_lost.is_some();
            }
            Mode::Stopping | Mode::Faulted => {
                // Without torque there is nothing left to ramp.
                if seen.at_safe_tension || seen.drives.phase == DrivesPhase::Off {
                    self.ramping = false;
                }
                let off = !self.ramping && seen.drives.phase == DrivesPhase::Off;
                if self.mode == Mode::Stopping && off && !(self.lowers && seen.moves) {
                    self.go(Mode::Disarmed, Cause::Done, seen);
                }
            }
            _ => {}
        }
    }

    fn action(&self) -> (Action, Option<Limit>) {
        let plan = match self.mode {
            Mode::Disarmed => return (Action::Off, None),
            Mode::Starting if !self.under_way => return (Action::Tighten, None),
            Mode::Stopping if self.settles => return (Action::Tighten, None),
            Mode::Starting => Action::Raise,
            Mode::Stopping | Mode::Faulted if self.under_way => Action::Lower,
            Mode::Faulted if self.held => return (Action::Stay, None),
            Mode::Faulted if self.ramping && self.slowly => return (Action::Release, None),
            Mode::Stopping | Mode::Faulted => return (if self.ramping { Action::Ramp } else { Action::Off }, None),
            Mode::Holding => Action::Hold,
            Mode::Tracking => Action::Track,
            Mode::Homing => Action::Home,
        };
        match self.overruns.demand() {
            Demand::Plan => (plan, None),
            Demand::Hold => (Action::Keep, Some(Limit::OverrunHold)),
            Demand::Ramp => (Action::Ramp, Some(Limit::OverrunRamp)),
        }
    }
}

#[cfg(test)]
#[path = "supervisor_tests.rs"]
mod tests;
