//! One tick of the real path: inputs from the channels, the cycle, torques onto the bus, the record to the I/O thread.
//!
//! Nothing here allocates, locks, formats or touches a port of shared memory.

use super::link::{DrivesLink, LoopTime};
use super::obstacles::PairReader;
use super::records;
use super::statistics::Branch;
use super::watch::Watch;
use crate::config::{Config, LostAction};
use crate::control::{
    Budget, CableMask, Cycle, DrivesInput, DrivesPhase, EncoderReadings, Estimator, Fault, Mode, ObstacleDemand,
    ObstaclePair, Refusal, Request, Target, TargetInput, TickInputs, Timing, TipReading,
};
use crate::ipc::intake::{self, InputLimits, TargetSample, TargetTrack};
use crate::ipc::payload::{Header, PlannerBranch, RequestKind, SourceHealth, State, TargetMode};
use crate::ipc::{Command, ControlInputs, ControlOutputs, IoLimits, Reply};
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew_hal::cia402::CycleWriter;
use sinew_hal::clock::{monotonic_ns, seconds_to_ns};
use sinew_hal::motor_bank::MotorBank;

/// Thresholds of all inputs as the configuration has them.
///
/// In lockstep an input for the next tick may be looked at by a thread that read the clock just before that tick's time
/// began, so a tick ahead is not the future there.
pub fn limits(config: &Config, lockstep: bool) -> IoLimits {
    let policy = &config.obstacles;
    let ahead_s = if lockstep { 1.5 * config.timing.period_s } else { 0.0 };
    let obstacles = InputLimits {
        stale_after_s: policy.stale_after_s,
        hold_after_s: policy.hold_after_s,
        growth_mps: policy.growth_mps,
        growth_m_max: policy.growth_m_max,
        sigma_multiple: policy.sigma_multiple,
        future_tolerance_s: policy.future_tolerance_s + ahead_s,
    };
    let silent_s = config.guard.encoder_silent_s;
    let encoders = InputLimits {
        stale_after_s: silent_s,
        hold_after_s: silent_s.max(1.0),
        future_tolerance_s: InputLimits::default().future_tolerance_s + ahead_s,
        ..InputLimits::default()
    };
    let policy = &config.target;
    let target = InputLimits {
        stale_after_s: policy.stale_after_s,
        hold_after_s: policy.hold_after_s,
        future_tolerance_s: policy.future_tolerance_s + ahead_s,
        ..InputLimits::default()
    };
    let tip = InputLimits {
        stale_after_s: config.tip_sensor.stale_after_s,
        hold_after_s: config.tip_sensor.stale_after_s.max(1.0),
        future_tolerance_s: InputLimits::default().future_tolerance_s + ahead_s,
        ..InputLimits::default()
    };
    IoLimits { obstacles, target, encoders, tip }
}

/// Code of the event that tells, by its value, how many SYNCs had been sent with that of tick 0.
pub const FIRST_SYNC: u32 = 500;
/// Code of the event that tells, by its value, at what share of the configured speed the arm moves from now on.
pub const SPEED: u32 = 501;

/// What the loop asks for by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AutoRequests {
    /// Arm as soon as the drives and their buses are ready, once.
    pub arm: bool,
    /// Track as soon as the arm holds and there are a target and known obstacles, once.
    pub track: bool,
}

/// When a tick is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TickTime {
    pub(crate) tick: u64,
    /// Time of the tick in the loop's clock (ns).
    pub(crate) now_ns: u64,
    /// CLOCK_MONOTONIC at wake-up (ns).
    pub(crate) woke_ns: u64,
    /// The wake-up's delay (ns).
    pub(crate) wakeup_ns: u64,
    /// Deadlines missed since the tick before ([`TickInputs::missed`]).
    pub(crate) missed: u32,
    /// The planner's time; `None` in lockstep, where only work counts.
    pub(crate) budget: Option<Budget>,
    /// Ticks left out so far.
    pub(crate) left_out: u64,
}

/// What the loop must know after a tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ticked {
    pub(crate) mode: Mode,
    pub(crate) drives: DrivesInput,
    /// CLOCK_MONOTONIC when the torques had left (ns).
    pub(crate) sent_ns: u64,
    pub(crate) branch: Branch,
}

/// What a tick saw, but for what is lent: the obstacles are moved between two looks at it.
#[derive(Clone, Copy)]
struct Seen {
    tick: u64,
    now_ns: u64,
    missed: u32,
    valid: CableMask,
    capture_ns: u64,
    demand: ObstacleDemand,
    tip: Option<TipReading>,
    target: Option<TargetInput>,
    drives: DrivesInput,
    request: Option<Request>,
}

impl Seen {
    fn inputs<'a>(&self, lengths_m: &'a [f64], measured_n: &'a [f64], obstacles: &'a ObstaclePair) -> TickInputs<'a> {
        TickInputs {
            tick: self.tick,
            now_ns: self.now_ns,
            missed: self.missed,
            encoders: EncoderReadings { lengths_m, valid: self.valid, capture_ns: self.capture_ns },
            tensions_measured_n: measured_n,
            obstacles,
            demand: self.demand,
            tip: self.tip,
            target: self.target,
            drives: self.drives,
            request: self.request,
        }
    }
}

/// Everything that the control thread owns.
pub(crate) struct Controller<E> {
    cycle: Cycle<E>,
    inputs: ControlInputs,
    outputs: ControlOutputs,
    obstacles: PairReader,
    drives: DrivesLink,
    bank: MotorBank,
    time: LoopTime,
    limits: IoLimits,
    require_source: bool,
    arm_unknown: bool,
    stop_if_lost: bool,
    lookahead_s: f64,
    period_ns: u64,
    rng: Xoshiro256PlusPlus,
    auto: AutoRequests,
    /// Since when the ordered stop has been asked for, and whether its time is over.
    stopping_since_ns: Option<u64>,
    stop_timeout_ns: u64,
    gave_up: bool,
    /// The operator's emergency stop is pressed.
    emergency: bool,
    /// The speed that the last event told.
    speed_told: f64,
    warning: PlannerBranch,
    torques: Vec<i16>,
    lengths: Vec<f64>,
    measured: Vec<f64>,
    state: Box<State>,
}

/// The parts that a controller is put together from.
pub(crate) struct Parts<E> {
    pub(crate) cycle: Cycle<E>,
    pub(crate) inputs: ControlInputs,
    pub(crate) outputs: ControlOutputs,
    pub(crate) obstacles: PairReader,
    pub(crate) drives: DrivesLink,
    pub(crate) bank: MotorBank,
    pub(crate) time: LoopTime,
    pub(crate) rng: Xoshiro256PlusPlus,
    pub(crate) auto: AutoRequests,
}

impl<E: Estimator> Controller<E> {
    /// Puts it together. Allocates.
    pub(crate) fn new(config: &Config, parts: Parts<E>) -> Self {
        let Parts { cycle, inputs, outputs, obstacles, drives, bank, time, rng, auto } = parts;
        let cables = config.arm.cable_count();
        let time_is_lockstep = time.is_lockstep();
        Self {
            cycle,
            inputs,
            outputs,
            obstacles,
            drives,
            bank,
            time,
            rng,
            auto,
            emergency: false,
            speed_told: 1.0,
            limits: limits(config, time_is_lockstep),
            require_source: config.obstacles.require_source,
            arm_unknown: config.obstacles.arm_unknown,
            stop_if_lost: config.obstacles.lost == LostAction::Stop,
            lookahead_s: config.planner.lookahead_s,
            period_ns: period_ns(config),
            stopping_since_ns: None,
            stop_timeout_ns: seconds_to_ns(config.timing.stop_timeout_s),
            gave_up: false,
            warning: records::warning_branch(config.planner.warning),
            torques: vec![0; cables],
            lengths: vec![f64::NAN; cables],
            measured: vec![f64::NAN; cables],
            state: Box::default(),
        }
    }

    /// The inputs, for the gate of lockstep.
    pub(crate) fn inputs_mut(&mut self) -> &mut ControlInputs {
        &mut self.inputs
    }

    /// One tick. `stop` asks for the ordered stop.
    pub(crate) fn tick(&mut self, time: &TickTime, stop: bool, writer: &mut CycleWriter) -> Ticked {
        let now_ns = time.now_ns;
        self.inputs.update();
        let mut drives = self.drives.read();
        let demand = self.place_obstacles(now_ns);
        let valid = self.read_encoders();
        let capture_ns = self.inputs.encoders().latest().map_or(0, |m| m.header.capture_ns);
        let tip = self.inputs.tip().fresh(now_ns, &self.limits.tip).map(|measured| TipReading {
            position_m: measured.position_m.into(),
            capture_ns: measured.header.capture_ns,
        });
        let target = self.target(now_ns);
        let lost = self.stop_if_lost && self.inputs.obstacles().is_lost(now_ns, &self.limits.obstacles);
        let (request, command) =
            self.next_request(now_ns, stop || lost, &drives, demand, target.is_some_and(|t| t.fresh));
        if self.emergency {
            drives.emergency_stop = drives.emergency_stop.or(Some(Fault::SERVICE));
        }
        let began_ns = monotonic_ns();

        let mut watch = Watch::new(time.budget, now_ns, began_ns);
        let seen = Seen {
            tick: time.tick,
            now_ns,
            missed: time.missed,
            valid,
            capture_ns,
            demand,
            tip,
            target,
            drives,
            request,
        };
        let inputs = seen.inputs(&self.lengths, &self.measured, self.obstacles.pair());
        let output = self.cycle.tick(&inputs, &mut self.rng, &mut watch);

        let sending_ns = monotonic_ns();
        self.drives.command(output.drives, output.mode == Mode::Disarmed);
        // The guard lets only finite tensions out; should one fail to encode, the torques of the tick before stay.
        let _ = self.bank.encode_into(self.cycle.tensions_n(), &mut self.torques);
        // Answers to this SYNC belong to the next tick.
        self.time.advance_to(now_ns + self.period_ns);
        let cycle = writer.write_cycle(&self.torques).cycle;
        let sent_ns = monotonic_ns();

        let [estimated_ns, planned_ns, guarded_ns] = watch.marks_ns();
        if self.cycle.latency_s() > 0.0 {
            // The record's state is that of the tick, and so are the obstacles that it is measured against.
            let (table, limits) = (self.inputs.obstacles(), &self.limits.obstacles);
            self.obstacles.move_to(table, now_ns, [0.0, self.lookahead_s], limits);
        }
        self.cycle.report(&seen.inputs(&self.lengths, &self.measured, self.obstacles.pair()));
        self.cycle.record_mut().timing = Timing {
            wakeup_ns: time.wakeup_ns,
            input_ns: began_ns.saturating_sub(time.woke_ns),
            estimate_ns: estimated_ns.saturating_sub(began_ns),
            plan_ns: planned_ns.saturating_sub(estimated_ns),
            guard_ns: guarded_ns.saturating_sub(planned_ns),
            send_ns: sent_ns.saturating_sub(sending_ns),
            cycle_ns: sent_ns.saturating_sub(time.woke_ns),
        };
        if time.tick == 0 {
            // What lays a recording and the drives' own beside each other.
            let (time_ns, value) = (now_ns, cycle as f64);
            let text = "number of the SYNC of tick 0";
            self.outputs.event(crate::ipc::Event {
                time_ns,
                tick: 0,
                code: FIRST_SYNC,
                detail: 0,
                flags: 0,
                value,
                second: f64::NAN,
                text,
            });
        }
        self.publish(time);
        let fault = self.cycle.supervisor().latch().first.map(|latched| latched.fault);
        if let (Some(command), Some(answer)) = (command, &output.answer) {
            self.outputs.reply(records::reply(&command, answer.refusal, output.mode, fault));
        }
        Ticked { mode: output.mode, drives, sent_ns, branch: Branch::of(&self.state) }
    }

    /// Moves the obstacles to where they will be when this tick's tensions begin to act, for the planner starts from the
    /// arm as it will be then; and what their sources ask for.
    fn place_obstacles(&mut self, now_ns: u64) -> ObstacleDemand {
        let limits = &self.limits.obstacles;
        let table = self.inputs.obstacles();
        let acts_s = self.cycle.latency_s();
        let unplaced = self.obstacles.place(table, now_ns, [acts_s, acts_s + self.lookahead_s], limits);
        table.report_into(now_ns, limits, &mut self.state);
        if let Some(source) = unplaced {
            return ObstacleDemand::Hold { source };
        }
        match table.demand(now_ns, limits) {
            intake::ObstacleDemand::Hold { source_id } => ObstacleDemand::Hold { source: source_id },
            intake::ObstacleDemand::Proceed if self.require_source && !self.any_source() => {
                ObstacleDemand::Hold { source: 0 }
            }
            intake::ObstacleDemand::Proceed => ObstacleDemand::Proceed,
        }
    }

    /// Whether any source of obstacles was heard and has not left.
    fn any_source(&self) -> bool {
        let none = [SourceHealth::Absent, SourceHealth::Refused].map(SourceHealth::wire);
        self.state.obstacle_sources.iter().any(|source| !none.contains(&source.health))
    }

    /// Copies the newest readings; which of them count.
    fn read_encoders(&mut self) -> CableMask {
        let mut valid = CableMask::default();
        let Some(message) = self.inputs.encoders().latest() else { return valid };
        for cable in 0..self.lengths.len() {
            self.measured[cable] = if message.is_tension_valid(cable) { message.tension_n[cable] } else { f64::NAN };
            if message.is_length_valid(cable) {
                self.lengths[cable] = message.length_m[cable];
                valid.insert(cable);
            }
        }
        valid
    }

    fn target(&self, now_ns: u64) -> Option<TargetInput> {
        let (track, limits) = (self.inputs.target(), &self.limits.target);
        let now = track.sample(now_ns, limits)?;
        let fresh = now.overrun_s <= limits.hold_after_s;
        let sequence = now.sequence;
        let now_target = target_of(&now);
        let (ahead, weight) = match self.ahead(track, now_ns, limits) {
            Some(sample) => (Some(target_of(&sample)), sample.weight),
            None => (None, now.weight),
        };
        Some(TargetInput { now: now_target, ahead, weight, sequence, fresh })
    }

    /// The target at the end of lookahead and lead, where the client has told that much of its path. Beyond it the
    /// cycle extrapolates by the rates.
    fn ahead(&self, track: &TargetTrack, now_ns: u64, limits: &InputLimits) -> Option<TargetSample> {
        let lead_ns = seconds_to_ns(self.cycle.lead_s());
        track.sample(now_ns + lead_ns, limits).filter(|sample| sample.overrun_s <= 0.0)
    }

    /// The request of this tick, and the command that it answers. What needs no supervisor is answered here.
    fn next_request(
        &mut self,
        now_ns: u64,
        stop: bool,
        drives: &DrivesInput,
        demand: ObstacleDemand,
        target_fresh: bool,
    ) -> (Option<Request>, Option<Command>) {
        let mode = self.cycle.mode();
        if stop {
            let since_ns = *self.stopping_since_ns.get_or_insert(now_ns);
            let moving = !matches!(mode, Mode::Disarmed | Mode::Stopping | Mode::Faulted);
            if moving || self.cycle.supervisor().is_held() {
                return (Some(Request::Stop), None);
            }
            // Nobody may be there to decide what a way that stays blocked means; the process has to end.
            let stopping = mode == Mode::Stopping || mode == Mode::Faulted && drives.phase != DrivesPhase::Off;
            if stopping && now_ns.saturating_sub(since_ns) > self.stop_timeout_ns && !self.gave_up {
                self.gave_up = true;
                return (Some(Request::Disarm), None);
            }
        } else if self.auto.arm
            && mode == Mode::Disarmed
            && can_come_up(drives)
            && (self.arm_unknown || demand == ObstacleDemand::Proceed)
        {
            self.auto.arm = false;
            return (Some(Request::Arm), None);
        } else if self.auto.track && mode == Mode::Holding && target_fresh && demand == ObstacleDemand::Proceed {
            self.auto.track = false;
            return (Some(Request::Track), None);
        }
        // As many as their ring holds.
        for _ in 0..16 {
            let Some(command) = self.inputs.next_command() else { break };
            match command.kind {
                RequestKind::EmergencyStop => self.emergency = true,
                RequestKind::EmergencyRelease => self.emergency = false,
                RequestKind::Speed => {
                    let reply = self.take_speed(&command);
                    self.outputs.reply(reply);
                    continue;
                }
                _ => {}
            }
            match records::request_of(command.kind) {
                // A drive that tripped while nothing was latched: there is no fault to clear but its own.
                Some(Request::Clear) if mode == Mode::Disarmed && drives.fault.is_some() => {
                    self.drives.reset();
                    self.outputs.reply(Reply::accepted(&command, records::supervisor_state(mode)));
                }
                Some(request) => return (Some(request), Some(command)),
                None => {
                    let fault = self.cycle.supervisor().latch().first.map(|latched| latched.fault);
                    self.outputs.reply(Reply {
                        fault_code: fault.map_or(0, |f| f.code()),
                        fault_detail: fault.map_or(0, |f| f.detail()),
                        ..Reply::accepted(&command, records::supervisor_state(mode))
                    });
                }
            }
        }
        (None, None)
    }

    /// The speed that is asked for; a stop keeps its own, and leads to full speed.
    fn take_speed(&mut self, command: &Command) -> Reply {
        let mode = self.cycle.mode();
        let refusal = match mode {
            Mode::Stopping => Some(Refusal::Stopping),
            Mode::Faulted => Some(Refusal::Faulted),
            _ => None,
        };
        if refusal.is_none() {
            self.cycle.set_speed_scale(command.speed_scale);
        }
        let fault = self.cycle.supervisor().latch().first.map(|latched| latched.fault);
        records::reply(command, refusal, mode, fault)
    }

    /// Hands record and events to the I/O thread.
    fn publish(&mut self, time: &TickTime) {
        let now_ns = time.now_ns;
        let state = &mut *self.state;
        records::state_into(self.cycle.record_mut(), &self.obstacles, self.warning, state);
        state.header = Header { tick: time.tick, ..Header::new(0, time.tick, now_ns) };
        state.time_s = time.tick as f64 * self.period_ns as f64 * 1e-9;
        state.target_report = self.inputs.target().report(now_ns, &self.limits.target);
        state.encoder_report = self.inputs.encoders().report(now_ns, &self.limits.encoders);
        state.tip_report = self.inputs.tip().report(now_ns, &self.limits.tip);
        state.ticks_missed = time.left_out;
        self.outputs.record(state);
        if state.speed_scale != self.speed_told {
            self.speed_told = state.speed_scale;
            let (value, text) = (state.speed_scale, "speed over the configured one");
            self.outputs.event(crate::ipc::Event {
                time_ns: now_ns,
                tick: time.tick,
                code: SPEED,
                detail: 0,
                flags: 0,
                value,
                second: f64::NAN,
                text,
            });
        }
        while let Some(event) = self.cycle.events_mut().pop() {
            self.outputs.event(records::event(&event));
        }
    }
}

/// Whether the supervisor would not refuse to bring the drives up: what is asked for once must not be spent on a refusal.
fn can_come_up(drives: &DrivesInput) -> bool {
    drives.ready && drives.fault.is_none() && drives.bus_lost.is_none() && drives.emergency_stop.is_none()
}

/// The loop's period (ns).
pub(crate) fn period_ns(config: &Config) -> u64 {
    seconds_to_ns(config.timing.period_s)
}

/// The planner's budget.
pub(crate) fn budget(config: &Config) -> Budget {
    Budget::new(&config.timing, config.planner.budget_s)
}

fn target_of(sample: &TargetSample) -> Target {
    match sample.mode {
        TargetMode::Tip => Target::Tip {
            position_m: sample.position_m.into(),
            quaternion: sample.quaternion.into(),
            velocity_mps: sample.velocity_mps.into(),
            angular_velocity_radps: sample.angular_velocity_radps.into(),
        },
        TargetMode::Shape => {
            Target::Shape { curvatures_1pm: sample.curvature_1pm, rates_1pms: sample.curvature_rate_1pms }
        }
    }
}

#[cfg(test)]
#[path = "tick_tests.rs"]
mod tests;
