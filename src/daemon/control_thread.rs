//! The control thread: when a tick begins, and what becomes of late ones.

use super::deadlines::Deadlines;
use super::link::Progress;
use super::statistics::AfterSending;
use super::tick::{AutoRequests, Controller, Parts, TickTime, Ticked, budget, period_ns};
use super::warm_up::warm_up;
use crate::config::Config;
use crate::control::{Cycle, DrivesPhase, Mode, Settings};
use crate::estimator::Observer;
use crate::ipc::intake::SourceLog;
use crate::ipc::payload::Header;
use crate::ipc::{ControlInputs, ControlOutputs, LockstepSources};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rtrb::Producer;
use sinew_hal::cia402::CycleWriter;
use sinew_hal::clock::{Clock, Monotonic, Naps, monotonic_ns, seconds_to_ns};
use sinew_hal::motor_bank::MotorBank;
use sinew_hal::realtime::{self, Report};
use sinew_hal::wake_latency::WakeLatency;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, Sender};
use std::time::Duration;

/// Longest that the ordered stop may take beyond the time for its way and for its ramp (s); then the thread ends as it is,
/// and the drives' guards take over.
const STOP_S: f64 = 10.0;

/// What the thread is made from; everything large is made on it, so that its memory is local.
pub(crate) struct Plan {
    pub(crate) config: Config,
    pub(crate) settings: Settings,
    pub(crate) inputs: ControlInputs,
    pub(crate) outputs: ControlOutputs,
    pub(crate) obstacles: super::obstacles::PairReader,
    pub(crate) drives: super::link::DrivesLink,
    pub(crate) bank: MotorBank,
    pub(crate) time: super::link::LoopTime,
    pub(crate) seed: u64,
    pub(crate) auto: AutoRequests,
    /// Ticks after which the ordered stop begins.
    pub(crate) ticks: u64,
    pub(crate) around_tick: Option<fn(&mut dyn FnMut())>,
    pub(crate) sources: LockstepSources,
    pub(crate) lockstep_timeout: Option<Duration>,
    /// Where the times after sending go.
    pub(crate) after: Producer<AfterSending>,
    pub(crate) progress: Arc<Progress>,
}

/// The thread's body: prepare, say what was granted, wait for the sender of cycles, run.
pub(crate) fn run(plan: Plan, granted: &Sender<Report>, writer: &Receiver<CycleWriter>) {
    let lockstep = plan.time.is_lockstep();
    let timing = &plan.config.timing;
    let request = realtime::Request {
        priority: (!lockstep && timing.priority > 0).then_some(timing.priority),
        cpus: timing.cpu.filter(|_| !lockstep).into_iter().collect(),
        lock_memory: !lockstep && timing.lock_memory,
        // The same arithmetic in both, so that a recording can be replayed.
        flush_denormals: true,
        ..realtime::Request::default()
    };
    let mut report = realtime::enter(&request);
    // Held until the loop has ended.
    let _wake_latency = timing.wake_latency_s.filter(|_| !lockstep).and_then(|longest_s| {
        WakeLatency::at_most(Duration::from_secs_f64(longest_s)).map_err(|refused| report.refused.push(refused)).ok()
    });
    let observer = Observer::new(&plan.config.arm, &plan.config.observer, timing.period_s);
    let (ticks, around) = (plan.ticks, Around { hook: plan.around_tick, after: plan.after });
    let parts = Parts {
        cycle: Cycle::new(&plan.settings, observer),
        inputs: plan.inputs,
        outputs: plan.outputs,
        obstacles: plan.obstacles,
        drives: plan.drives,
        bank: plan.bank,
        time: plan.time,
        rng: Xoshiro256PlusPlus::seed_from_u64(plan.seed),
        auto: plan.auto,
    };
    let mut controller = Controller::new(&plan.config, parts);
    if !lockstep {
        warm_up(&plan.config, &plan.settings);
    }
    // Without a receiver, or without a sender, the start was given up.
    if granted.send(report).is_err() {
        return;
    }
    let Ok(mut writer) = writer.recv() else { return };
    let last = if lockstep {
        let gate = Gate::new(plan.sources, plan.lockstep_timeout, period_ns(&plan.config));
        run_lockstep(&mut controller, &mut writer, gate, &plan.config, ticks, around, &plan.progress)
    } else {
        run_realtime(&mut controller, &mut writer, &plan.config, ticks, around, &plan.progress)
    };
    plan.progress.end(last.is_some_and(|ticked| ticked.mode == Mode::Faulted));
}

/// What goes on around a tick: the hook of a test, and the clock behind its end.
struct Around {
    hook: Option<fn(&mut dyn FnMut())>,
    after: Producer<AfterSending>,
}

impl Around {
    /// A tick; `None` where the hook left it out.
    fn run(&mut self, mut tick: impl FnMut() -> Ticked) -> Option<Ticked> {
        let (mut last, after) = (None, &mut self.after);
        let mut timed = || {
            let ticked = tick();
            let report_ns = monotonic_ns().saturating_sub(ticked.sent_ns);
            // Where nobody has looked for thousands of ticks the statistics go without.
            let _ = after.push(AfterSending { branch: ticked.branch, report_ns });
            last = Some(ticked);
        };
        match self.hook {
            Some(hook) => hook(&mut timed),
            None => timed(),
        }
        last
    }
}

/// Whether the ordered stop is over.
struct Stopping {
    since_ns: Option<u64>,
    longest_ns: u64,
}

impl Stopping {
    fn new(config: &Config) -> Self {
        let timing = &config.timing;
        let longest_s = timing.stop_timeout_s + timing.ramp_s.max(timing.release_s) + STOP_S;
        Self { since_ns: None, longest_ns: seconds_to_ns(longest_s) }
    }

    fn is_over(&mut self, stop: bool, last: Option<&Ticked>) -> bool {
        if !stop {
            return false;
        }
        let Some(last) = last else { return true };
        let now_ns = monotonic_ns();
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        let at_rest = match last.mode {
            Mode::Disarmed => true,
            Mode::Faulted => last.drives.phase == DrivesPhase::Off,
            _ => false,
        };
        at_rest || now_ns.saturating_sub(since_ns) > self.longest_ns
    }
}

/// Absolute deadlines, see [`Deadlines`]. Every missed one counts for the supervisor, also those that the loop's own
/// computing missed.
fn run_realtime(
    controller: &mut Controller<Observer>,
    writer: &mut CycleWriter,
    config: &Config,
    ticks: u64,
    mut around: Around,
    progress: &Progress,
) -> Option<Ticked> {
    let (period_ns, budget) = (period_ns(config), budget(config));
    let mut deadlines = Deadlines::new(monotonic_ns() + 2 * period_ns, period_ns);
    let mut stopping = Stopping::new(config);
    let mut last: Option<Ticked> = None;
    loop {
        let stop = progress.stop.load(Ordering::Acquire) || deadlines.tick() >= ticks;
        if stopping.is_over(stop, last.as_ref()) {
            return last;
        }
        Monotonic.sleep_until(deadlines.due_ns());
        let woke_ns = monotonic_ns();
        let begun = deadlines.begin(woke_ns);
        let time = TickTime {
            tick: begun.tick,
            now_ns: begun.scheduled_ns,
            woke_ns,
            wakeup_ns: begun.wakeup_ns,
            missed: begun.missed,
            budget: Some(budget),
            left_out: begun.left_out,
        };
        last = around.run(|| controller.tick(&time, stop, writer)).or(last);
        deadlines.end(last.as_ref().map_or(woke_ns, |ticked| ticked.sent_ns));
        progress.ticks.store(deadlines.tick(), Ordering::Release);
    }
}

/// Time is ticks times the period; a tick begins when all its inputs are there.
fn run_lockstep(
    controller: &mut Controller<Observer>,
    writer: &mut CycleWriter,
    mut gate: Gate,
    config: &Config,
    ticks: u64,
    mut around: Around,
    progress: &Progress,
) -> Option<Ticked> {
    let period_ns = period_ns(config);
    let mut stopping = Stopping::new(config);
    let (mut tick, mut last) = (0_u64, None);
    loop {
        let began_ns = monotonic_ns();
        gate.wait(controller.inputs_mut(), tick, progress);
        // Looked at behind the gate: the tick that is decided on is the one that runs.
        let stop = progress.stop.load(Ordering::Acquire) || tick >= ticks;
        if stopping.is_over(stop, last.as_ref()) {
            return last;
        }
        let woke_ns = monotonic_ns();
        let time = TickTime {
            tick,
            now_ns: tick * period_ns,
            woke_ns,
            wakeup_ns: woke_ns.saturating_sub(began_ns),
            missed: 0,
            budget: None,
            left_out: 0,
        };
        last = around.run(|| controller.tick(&time, stop, writer)).or(last);
        tick += 1;
        progress.ticks.store(tick, Ordering::Release);
    }
}

/// Waits for the inputs of a tick, however long they take: a run must not depend on how busy the machine is. A client whose
/// process or port has ended is not waited for until it, or another in its place, sends again; the arm goes on without it,
/// and its age leads to the declared action or to a fault. The encoders come from this process.
struct Gate {
    sources: LockstepSources,
    waiting_for: LockstepSources,
    /// What a source had sent when it was given up, in the order of `sources`: the target, then the obstacles.
    given_up_at: Vec<Option<Header>>,
    timeout_ns: Option<u64>,
    period: Duration,
    told: bool,
}

/// Clients' time-out once the stop is asked for (ns): they may have gone already. The drives are still needed.
const STOP_TIMEOUT_NS: u64 = 200_000_000;
/// The drives' own, once the stop is asked for (ns): longer than the bus thread waits for a plant that has gone.
const STOP_DRIVES_NS: u64 = 6_000_000_000;
/// How long an operator's order waits for inputs (ns).
const ORDER_NS: u64 = 50_000_000;
/// Waiting that is told of (ns).
const TELL_NS: u64 = 5_000_000_000;

impl Gate {
    fn new(sources: LockstepSources, timeout: Option<Duration>, period_ns: u64) -> Self {
        let given_up_at = vec![None; 1 + sources.obstacles.len()];
        let timeout_ns = timeout.map(|timeout| timeout.as_nanos() as u64);
        let period = Duration::from_nanos(period_ns);
        Self { waiting_for: sources.clone(), sources, given_up_at, timeout_ns, period, told: false }
    }

    fn wait(&mut self, inputs: &mut ControlInputs, tick: u64, progress: &Progress) {
        inputs.update();
        self.take_back(inputs, tick);
        if !self.waiting_for.encoders {
            // Nothing else sets the pace of a loop without a plant.
            std::thread::sleep(self.period);
        }
        let naps = Naps::begin();
        while !inputs.is_ready_for(tick, &self.waiting_for) {
            naps.nap();
            let waited_ns = naps.waited_ns();
            let stops = progress.stop.load(Ordering::Acquire);
            let late = self.timeout_ns.is_some_and(|timeout_ns| waited_ns > timeout_ns)
                || stops && waited_ns > STOP_TIMEOUT_NS;
            self.give_up_clients(inputs, tick, !late);
            if stops && waited_ns > STOP_DRIVES_NS || progress.bus_gone.load(Ordering::Acquire) {
                self.waiting_for.encoders &= inputs.encoders().is_ready_for(tick);
            }
            if inputs.has_direct_command() && waited_ns > ORDER_NS {
                // This tick is the operator's; the next waits again.
                return;
            }
            if waited_ns > TELL_NS && !self.told {
                self.told = true;
                tracing::warn!(tick, waits_for = ?self.waiting_for, "lockstep waits for inputs, without a limit");
            }
            inputs.update();
        }
    }

    /// No longer waits for clients that have not delivered: for those that are gone, or for all.
    fn give_up_clients(&mut self, inputs: &ControlInputs, tick: u64, only_gone: bool) {
        let gives_up = |log: Option<&SourceLog>| !only_gone || log.is_some_and(SourceLog::is_gone);
        let target = inputs.target();
        if self.waiting_for.target && !target.is_ready_for(tick) && gives_up(Some(target.log())) {
            self.waiting_for.target = false;
            self.given_up_at[0] = target.log().last;
        }
        let (sources, given_up_at) = (&self.sources.obstacles, &mut self.given_up_at);
        self.waiting_for.obstacles.retain(|id| {
            let log = inputs.obstacles().log(*id);
            let stays = inputs.obstacles().is_ready_for(tick, &[*id]) || !gives_up(log);
            if let (false, Some(place)) = (stays, sources.iter().position(|source| source == id)) {
                given_up_at[1 + place] = log.and_then(|log| log.last);
            }
            stays
        });
    }

    /// Waits again for those who have sent since they were given up: whoever comes back may be behind by some ticks at
    /// first, and would never catch up with a loop that does not wait.
    fn take_back(&mut self, inputs: &ControlInputs, tick: u64) {
        self.waiting_for.encoders |= self.sources.encoders && inputs.encoders().is_ready_for(tick);
        let is_back = |log: Option<&SourceLog>, given_up_at: &Option<Header>| {
            log.is_some_and(|log| !log.is_gone() && log.last.is_some() && log.last != *given_up_at)
        };
        let target = Some(inputs.target().log());
        self.waiting_for.target |= self.sources.target && is_back(target, &self.given_up_at[0]);
        for (id, given_up_at) in self.sources.obstacles.iter().zip(&self.given_up_at[1..]) {
            if !self.waiting_for.obstacles.contains(id) && is_back(inputs.obstacles().log(*id), given_up_at) {
                // Within the capacity that it was cloned with.
                self.waiting_for.obstacles.push(*id);
            }
        }
    }
}
