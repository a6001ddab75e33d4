//! The daemon: threads around the controller, and nothing of the controller itself.
//!
//! Enters: a configuration and options. Leaves: torques on the buses, records in shared memory, a report about itself.
//! It must never let telemetry, requests or logging delay the control thread, and never leave an arm under tension that
//! nobody watches: whatever ends it, the drives are disabled in order or take themselves to the safe torque.
//!
//! | thread | scheduling | does |
//! |---|---|---|
//! | control | SCHED_FIFO, pinned, absolute deadlines | inputs, [`crate::control::Cycle`], torques onto the bus, record |
//! | bus | SCHED_FIFO, one below | feedback into shared memory as `encoders`; brings drives up and down |
//! | I/O | SCHED_FIFO, two below | every port of shared memory, both ways; statistics, recorder's queue |
//! | operator | SCHED_FIFO, three below | the arm's socket: stop, hold, disarm, past everything above but the control thread |
//! | main | normal | signals, `sd_notify`, reports for those who ask over the socket |
//!
//! The control thread allocates, locks and formats nothing once its first tick has begun, and touches no port: inputs come
//! through triple buffers, torques leave by its own handles of the buses, records through a ring that drops and counts
//! when it is full. `setup` turns the configuration into buses and drives, `tick` is the real path of a tick,
//! `control_thread` says when it runs and `deadlines` what it missed, `bus_thread` is the drives' side, `obstacles` builds
//! what must not be built on the control thread, `records` translates, `status` and `statistics` tell about it, `warm_up`
//! walks every path once.
//!
//! # Lockstep
//!
//! Tick k is at `k` times the period. It begins when the encoders of tick k are there, which answer the SYNC of tick
//! k - 1, and an input for tick k or later of every declared source ([`Options::lockstep`]). The drives are brought up
//! before tick 0. With a seed a run gives the same tensions bit for bit; requests of operators fall on whatever tick they
//! meet, so a run that shall be repeated uses [`Options::auto`].

pub mod alarms;
mod bus_thread;
mod control_thread;
mod deadlines;
mod drive_causes;
mod drive_faults;
mod error;
mod heart;
mod link;
mod obstacles;
pub mod operator;
mod reach;
mod recorded;
mod records;
mod setup;
mod statistics;
pub mod status;
mod taps;
mod threads;
mod tick;
mod warm_up;
mod watch;
pub mod words;

pub use bus_thread::ENCODER_SOURCE_ID;
pub use deadlines::overran;
pub use error::DaemonError;
pub use heart::Heart;
pub use reach::ReachStatus;
pub use records::{plan_into, refusal_text, warning_branch};
pub use setup::{BusLoad, bus_loads, check, master_config, motor_bank, motor_channels};
pub use statistics::{Percentiles, Stages};
pub use threads::ThreadReport;
pub use tick::{AutoRequests, FIRST_SYNC, SPEED, limits};

use crate::config::{Config, safe_hold_in_words};
use crate::control::Settings;
use crate::ipc::{ChannelCapacity, Client, DaemonPorts, Domain, IoThread, IpcError, LockstepSources, Pace, channels};
use bus_thread::BusThread;
use link::{LoopTime, Progress, drives_link};
use operator::{Address, Desk, OperatorSocket};
use sinew_hal::can::{CanBus, Filter};
use sinew_hal::cia402::Master;
use sinew_hal::realtime;
use status::{Fixed, Shared, StatusServer, TickNotes};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;
use taps::Taps;

/// Who a run in lockstep waits for, beside the encoders.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LockstepOptions {
    /// Obstacle sources that send a set for every tick.
    pub obstacles: Vec<u32>,
    /// A task client that sends a target for every tick.
    pub target: bool,
    /// Real time after which a source that does not deliver is no longer waited for until it does again; `None`: only the end
    /// of its process ends the waiting.
    pub timeout: Option<Duration>,
}

/// How to run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Time by ticks, not by the clock.
    pub lockstep: Option<LockstepOptions>,
    /// Recording of everything.
    pub record: Option<PathBuf>,
    /// The text of the configuration's files, which a recording is given.
    pub configuration: Option<String>,
    /// Seed of the planner's random numbers.
    pub seed: u64,
    /// What the loop asks for by itself.
    pub auto: AutoRequests,
    /// Stop in order when so many ticks are done.
    pub ticks: Option<u64>,
    /// Wraps every tick on the control thread: for tests that watch over it, e.g. that it allocates nothing.
    pub around_tick: Option<fn(&mut dyn FnMut())>,
    /// Tensions (N), one per cable, to which arming brings the cables; the arm's least ones unless given.
    pub start_tensions_n: Option<Vec<f64>>,
}

/// How it ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// Stopped, drives off.
    Stopped,
    /// Stopped with a fault latched.
    Faulted,
}

/// Domain of shared memory of a configuration; the environment precedes it, as for every client.
pub fn domain(config: &Config) -> Domain {
    let default = Domain::default().env();
    let environment = Domain::from_env();
    let named = Domain::new(
        config.ipc.prefix.clone(),
        config.ipc.root_path.clone().unwrap_or_else(|| PathBuf::from(&default[1].1)),
    );
    let overridden = |variable| std::env::var_os(variable).is_some();
    match (overridden(crate::ipc::PREFIX_VARIABLE), overridden(crate::ipc::ROOT_VARIABLE)) {
        (false, false) => named,
        (prefix, root) => {
            let [(_, own_prefix), (_, own_root)] = named.env();
            let [(_, env_prefix), (_, env_root)] = environment.env();
            let prefix = if prefix { env_prefix } else { own_prefix };
            Domain::new(prefix.to_string_lossy(), PathBuf::from(if root { env_root } else { own_root }))
        }
    }
}

/// Where the daemon of a configuration listens for `stop`, `hold`, `disarm` and `status`.
pub fn address(config: &Config) -> Address {
    Address::new(&domain(config), &config.ipc.arm, config.ipc.run_path.as_deref())
}

/// What keeps domains apart.
fn domain_name(domain: &Domain) -> String {
    let [(_, prefix), (_, root)] = domain.env();
    format!("{}{}", root.to_string_lossy(), prefix.to_string_lossy())
}

/// Most obstacles, sources' records and events between two looks of the I/O thread.
fn capacity(lockstep: bool) -> ChannelCapacity {
    // In lockstep ticks come as fast as they compute.
    if lockstep { ChannelCapacity { records: 256, ..ChannelCapacity::default() } } else { ChannelCapacity::default() }
}

/// How often the I/O thread looks: a message waits for that long, so it is a small part of a period; looking costs some
/// microseconds, so it is no smaller than need be.
fn pace(period_s: f64) -> Pace {
    let sleep = Duration::from_secs_f64(period_s / 20.0);
    Pace::RealTime { sleep: sleep.clamp(Duration::from_micros(50), Duration::from_micros(200)) }
}

/// A running daemon. Dropping it stops it in order.
#[derive(Debug)]
pub struct Daemon {
    progress: Arc<Progress>,
    shared: Arc<Shared>,
    server: StatusServer,
    control: Option<JoinHandle<()>>,
    bus: Option<JoinHandle<()>>,
    io: Option<JoinHandle<()>>,
    operator: Option<JoinHandle<()>>,
    failed_start: mpsc::Receiver<DaemonError>,
    /// The first thread that was found to have panicked.
    panicked: Option<&'static str>,
    /// Whether the recording ended before the run.
    recording_failed: Arc<AtomicBool>,
}

impl Daemon {
    /// Starts all threads. In lockstep the first tick comes when the drives are up.
    ///
    /// With `loop.cpu` the calling thread leaves that processor to the control thread, as all others do.
    ///
    /// # Errors
    /// [`DaemonError`]; nothing is left running then.
    pub fn start(config: &Config, options: &Options) -> Result<Self, DaemonError> {
        let loads = setup::check(config)?;
        let settings = settings(config, options)?;
        if let (Some(cpu), None) = (config.timing.cpu, &options.lockstep) {
            // Every thread below starts from here; the control thread then pins itself to the processor left free.
            let others = realtime::leave_processor(cpu);
            if others.is_empty() {
                tracing::warn!(cpu, "no other processor is permitted: the control thread shares its own");
            }
        }
        let domain = domain(config);
        let arm = &config.ipc.arm;
        let ports = open_ports(&domain, arm)?;
        let socket = OperatorSocket::bind(&address(config), &config.access)?;
        tracing::info!(path = %socket.path().display(), "listening for stop, hold, disarm and status");
        let (asks_status, server) = StatusServer::new();
        let lockstep = options.lockstep.is_some();
        let shared = Arc::new(Shared::new(Fixed {
            arm: arm.clone(),
            lockstep,
            period_s: config.timing.period_s,
            buses: loads.into_iter().map(|load| (load.name, load.share, load.limit)).collect(),
            required: config.obstacles.required.clone(),
            safe_hold: safe_hold_in_words(&config.drives.drives),
            stays: config.drives.drives.iter().any(|drive| drive.safe_hold.stays()),
            cables: config.arm.cable_names(),
        }));
        let progress = Arc::new(Progress::default());
        let mut daemon = {
            let (_, none) = mpsc::channel();
            let (progress, shared) = (progress.clone(), shared.clone());
            Self {
                progress,
                shared,
                server,
                control: None,
                bus: None,
                io: None,
                operator: None,
                failed_start: none,
                panicked: None,
                recording_failed: Arc::default(),
            }
        };

        let (masters, listeners) = bus_handles(config)?;
        let mut master = Master::new(setup::master_config(config)?, masters)?;
        let bank = setup::motor_bank(config)?;
        let time = LoopTime::new(lockstep);

        let sources = options.lockstep.clone().unwrap_or_default();
        let mut declared = config.obstacles.required.clone();
        declared.extend(sources.obstacles.iter().filter(|id| !config.obstacles.required.contains(id)));
        let segments = config.arm.segments.len();
        let (inputs, outputs, ends, direct) =
            channels(config.arm.cable_count(), segments, &declared, capacity(lockstep));
        let (pairs, placed) = obstacles::pairs(config.obstacles.capacity);
        let recorder = recorded::start(config, options)?;
        recorder.iter().for_each(|r| shared.set_recorder(r.dropped()));
        daemon.recording_failed = recorder.as_ref().map(|r| r.failed()).unwrap_or_default();
        let (notes, after) = TickNotes::new(shared.clone());
        let taps = Taps { pairs, notes, recorder, cables: config.arm.cable_names() };
        let io = IoThread::new(ports, ends, limits(config, lockstep), taps);
        let below = |steps: u8| if lockstep { 0 } else { config.timing.priority.saturating_sub(steps) };
        daemon.operator = Some(spawn("sinew-operator", below(3), {
            let (progress, desk) =
                (progress.clone(), Desk::new(socket, direct, asks_status, config.obstacles.required.clone()));
            move || desk.run(&progress.operator_stop)
        })?);
        daemon.io = Some(spawn("sinew-io", below(2), {
            let (progress, time) = (progress.clone(), time.clone());
            let pace = if lockstep { Pace::Lockstep } else { pace(config.timing.period_s) };
            move || io.run(pace, &progress.io_stop, || time.now_ns())
        })?);

        let publisher = Client::connect(&domain, arm)?.encoders(ENCODER_SOURCE_ID)?;
        let (link, end) = drives_link();
        // In lockstep the master keeps the sending of cycles until the drives are up.
        let writer = if lockstep { None } else { master.take_writer() };
        let bus = BusThread::new(config, master, bank.clone(), listeners, end, publisher, time.clone(), shared.clone());
        let (to_control, from_bus) = mpsc::channel();
        let (granted, report) = mpsc::channel();
        let (failed, failed_start) = mpsc::channel();
        daemon.failed_start = failed_start;
        let plan = control_thread::Plan {
            config: config.clone(),
            settings,
            inputs,
            outputs,
            obstacles: placed,
            drives: link,
            bank,
            time,
            seed: options.seed,
            auto: options.auto,
            ticks: options.ticks.unwrap_or(u64::MAX),
            around_tick: options.around_tick,
            sources: LockstepSources { encoders: true, target: sources.target, obstacles: sources.obstacles },
            lockstep_timeout: sources.timeout,
            after,
            progress: progress.clone(),
        };
        daemon.control = Some(spawn("sinew-control", 0, move || control_thread::run(plan, &granted, &from_bus))?);
        let report = report.recv().map_err(|_| DaemonError::Panic { name: "sinew-control" })?;
        let refused: Vec<String> = report.refused.iter().map(ToString::to_string).collect();
        if config.timing.require_realtime && !lockstep {
            report.require()?;
        }
        refused.iter().for_each(|refused| tracing::warn!("running degraded: {refused}"));
        shared.set_refused(refused);
        daemon.bus = Some(spawn("sinew-bus", below(1), {
            let progress = progress.clone();
            move || {
                let _gone = GoneAtTheEnd(&progress);
                run_bus(bus, writer, &to_control, &failed, &progress);
            }
        })?);
        Ok(daemon)
    }

    /// Asks for the ordered stop: ramp, drives off, end. Returns at once.
    pub fn stop(&self) {
        self.progress.stop.store(true, Ordering::Release);
    }

    /// Ticks done; grows only while the control thread lives and its ticks end.
    pub fn ticks(&self) -> u64 {
        self.progress.ticks.load(Ordering::Acquire)
    }

    /// The report, as [`status::ask`] gives it to others.
    pub fn status(&self) -> status::StatusReport {
        self.shared.report()
    }

    /// Answers one of those who ask for the status; to be called every now and then. Whether there was one.
    pub fn serve(&self) -> bool {
        self.server.serve(&self.shared)
    }

    /// Whether the control thread has ended.
    pub fn is_over(&self) -> bool {
        self.control.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Gives reports to those who ask and tells `beat` how many ticks there were, at least ten times a second, until the loop
    /// has ended: after [`Daemon::stop`], or when `stop` is set, or a thread panicked.
    ///
    /// The loop does not outlive a thread beside it: without the bus thread nobody sends the heartbeat or sees the drives,
    /// without the I/O thread no encoder is heard. The drives and the guard notice that by themselves and go safe; what is
    /// left here stops in order, as far as it can, and the error is for a new start.
    ///
    /// # Errors
    /// The drives did not come up in lockstep, a thread panicked, or what was to be recorded is not (the log says why).
    pub fn wait(mut self, stop: &AtomicBool, mut beat: impl FnMut(u64)) -> Result<Ending, DaemonError> {
        while !self.is_over() {
            if stop.load(Ordering::Relaxed) {
                self.stop();
            }
            self.notice_panics();
            self.shared.watch(self.recording_failed.load(Ordering::Acquire));
            let asked = self.serve();
            beat(self.ticks());
            if asked {
                continue;
            }
            std::thread::sleep(Duration::from_millis(if self.progress.stop.load(Ordering::Acquire) { 10 } else { 50 }));
        }
        let joined = self.join();
        if let Ok(error) = self.failed_start.try_recv() {
            return Err(error);
        }
        joined?;
        if self.recording_failed.load(Ordering::Acquire) && self.progress.ended() != Some(true) {
            return Err(DaemonError::RecordingEnded);
        }
        match self.progress.ended() {
            Some(true) => Ok(Ending::Faulted),
            _ => Ok(Ending::Stopped),
        }
    }

    /// Looks at the threads beside the control thread, whose end [`Self::wait`] sees anyway.
    fn notice_panics(&mut self) {
        let beside = [("sinew-bus", &mut self.bus), ("sinew-io", &mut self.io), ("sinew-operator", &mut self.operator)];
        for (name, thread) in beside {
            if let Some(ended) = thread.take_if(|thread| thread.is_finished())
                && ended.join().is_err()
            {
                tracing::error!(thread = name, "panicked: the loop stops");
                self.panicked.get_or_insert(name);
                self.progress.stop.store(true, Ordering::Release);
            }
        }
    }

    /// Ends the threads in order: control first, so that nothing is sent into a void; the bus, whose master sees the
    /// drives off; the I/O thread, with what the others still had to say; last, whoever tells operators.
    fn join(&mut self) -> Result<(), DaemonError> {
        self.progress.stop.store(true, Ordering::Release);
        let threads = [
            ("sinew-control", self.control.take(), None),
            ("sinew-bus", self.bus.take(), Some(&self.progress.bus_stop)),
            ("sinew-io", self.io.take(), Some(&self.progress.io_stop)),
            ("sinew-operator", self.operator.take(), Some(&self.progress.operator_stop)),
        ];
        for (name, thread, flag) in threads {
            if let Some(flag) = flag {
                flag.store(true, Ordering::Release);
            }
            if thread.is_some_and(|thread| thread.join().is_err()) {
                self.panicked.get_or_insert(name);
            }
        }
        self.panicked.take().map_or(Ok(()), |name| Err(DaemonError::Panic { name }))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        if let Err(error) = self.join() {
            tracing::error!(%error, "stopping");
        }
    }
}

/// The ports; a client that looks for a daemon in the same instant, and sweeps up behind itself because it finds none,
/// can take files away from under the services being made. Then they are made again.
fn open_ports(domain: &Domain, arm: &str) -> Result<DaemonPorts, DaemonError> {
    const TRIES: u32 = 10;
    let mut tries = 0;
    loop {
        match DaemonPorts::create(domain, arm) {
            Err(IpcError::Port { cause, .. }) if tries < TRIES => {
                tracing::debug!(cause, "services not made, again");
                tries += 1;
                std::thread::sleep(Duration::from_millis(50));
            }
            result => return Ok(result?),
        }
    }
}

/// The bus thread's body.
fn run_bus(
    mut bus: BusThread,
    writer: Option<sinew_hal::cia402::CycleWriter>,
    to_control: &mpsc::Sender<sinew_hal::cia402::CycleWriter>,
    failed: &mpsc::Sender<DaemonError>,
    progress: &Progress,
) {
    const WITHIN: Duration = Duration::from_secs(30);
    let writer = match writer {
        Some(writer) => {
            bus.start();
            writer
        }
        None => match bus.bring_up(WITHIN, progress) {
            Ok(writer) => writer,
            // Whoever stops a daemon that starts does not care for its drives.
            Err(_) if progress.stop.load(Ordering::Acquire) => return,
            Err(ready) => {
                let drives = bus.drive_count();
                // Whether or not somebody still listens, the control thread ends with its channel.
                let _ = failed.send(DaemonError::NoDrives { waited_s: WITHIN.as_secs_f64(), ready, drives });
                return;
            }
        },
    };
    if to_control.send(writer).is_ok() {
        bus.run(progress);
    }
}

/// Says that no encoders will come any more, also where the thread panicked.
struct GoneAtTheEnd<'a>(&'a Progress);

impl Drop for GoneAtTheEnd<'_> {
    fn drop(&mut self) {
        self.0.bus_gone.store(true, Ordering::Release);
    }
}

/// One handle of each bus.
type Handles = Vec<Box<dyn CanBus>>;

/// Two handles of every bus: the master's, which only sends, and the bus thread's.
fn bus_handles(config: &Config) -> Result<(Handles, Handles), DaemonError> {
    let listeners = setup::open_buses(config)?;
    let mut masters = Vec::with_capacity(listeners.len());
    for (bus, settings) in listeners.iter().zip(&config.drives.buses) {
        let duplicate = |source| DaemonError::Duplicate { name: settings.name.clone(), source };
        let mut handle = bus.duplicate().map_err(duplicate)?;
        // Nobody reads from it: what it would hear must not pile up. No frame of ours has this identifier.
        if let Err(error) = handle.set_filters(&[Filter { value: 0x7ff, mask: 0x7ff }]) {
            tracing::warn!(%error, bus = settings.name, "receive filter not set");
        }
        masters.push(handle);
    }
    Ok((masters, listeners))
}

fn settings(config: &Config, options: &Options) -> Result<Settings, DaemonError> {
    let mut settings = Settings::new(config);
    let Some(tensions) = &options.start_tensions_n else { return Ok(settings) };
    let (cables, low, high) = (config.arm.cable_count(), config.arm.tension_n_min, config.arm.tension_maxima_n());
    if tensions.len() != cables {
        let why = format!("{} numbers for {cables} cables", tensions.len());
        return Err(DaemonError::StartTensions { why });
    }
    if let Some(cable) = tensions.iter().zip(&high).position(|(t, high)| !(low..=*high).contains(t)) {
        let name = config.arm.cable_names().words(cable);
        let why = format!("{} N of {name} is outside {low} to {} N", tensions[cable], high[cable]);
        return Err(DaemonError::StartTensions { why });
    }
    settings.start_tensions_n.clone_from(tensions);
    Ok(settings)
}

/// A thread with a name and, above 0, a real-time priority, if it is granted: the control thread has said what is not.
fn spawn(
    name: &'static str,
    priority: u8,
    body: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, DaemonError> {
    let enter = move || {
        if priority > 0 {
            let request = realtime::Request {
                priority: Some(priority),
                cpus: Vec::new(),
                lock_memory: false,
                prefault_stack: 0,
                flush_denormals: false,
            };
            let _ = realtime::enter(&request);
        }
        body();
    };
    std::thread::Builder::new().name(name.into()).spawn(enter).map_err(|source| DaemonError::Thread { name, source })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A daemon of threads that do nothing but what the test wants of them.
    fn daemon(bus: fn(&Progress), io: fn(&Progress)) -> Daemon {
        let progress = Arc::new(Progress::default());
        let shared = Arc::new(Shared::new(Fixed { arm: "arm".into(), period_s: 0.01, ..Fixed::default() }));
        let (_, server) = StatusServer::new();
        let thread = |name, body: Box<dyn FnOnce(&Progress) + Send>| {
            let progress = progress.clone();
            Some(spawn(name, 0, move || body(&progress)).unwrap())
        };
        // Ticks until it is stopped, as the control thread does.
        let control = thread(
            "sinew-control",
            Box::new(|progress: &Progress| {
                while !progress.stop.load(Ordering::Acquire) {
                    progress.ticks.fetch_add(1, Ordering::AcqRel);
                    std::thread::sleep(Duration::from_millis(1));
                }
                progress.end(false);
            }),
        );
        let (bus, io) = (thread("sinew-bus", Box::new(bus)), thread("sinew-io", Box::new(io)));
        let (_, failed_start) = mpsc::channel();
        let progress = progress.clone();
        let (operator, panicked, recording_failed) = (None, None, Arc::default());
        Daemon { progress, shared, server, control, bus, io, operator, failed_start, panicked, recording_failed }
    }

    fn until(flag: &AtomicBool) {
        while !flag.load(Ordering::Acquire) {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    const BUS: fn(&Progress) = |progress| until(&progress.bus_stop);
    const IO: fn(&Progress) = |progress| until(&progress.io_stop);

    #[test]
    fn a_thread_that_panics_ends_the_loop_and_is_named() {
        let panics: fn(&Progress) = |_| panic!("on purpose");
        for (name, bus, io) in [("sinew-bus", panics, IO), ("sinew-io", BUS, panics)] {
            // Nobody asks for the stop.
            let ended = daemon(bus, io).wait(&AtomicBool::new(false), |_| {});
            assert!(matches!(ended, Err(DaemonError::Panic { name: found }) if found == name), "{name}: {ended:?}");
        }
    }

    #[test]
    fn threads_that_live_or_end_in_order_do_not_end_the_loop() {
        let (stop, mut ticks) = (AtomicBool::new(false), 0);
        let daemon = daemon(BUS, |_| {});
        let ended = daemon.wait(&stop, |done| {
            ticks = done;
            stop.store(done > 100, Ordering::Relaxed);
        });
        assert!(matches!(ended, Ok(Ending::Stopped)), "{ended:?}");
        assert!(ticks > 100);
    }
}
