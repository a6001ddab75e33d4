//! What the daemon tells about itself: a report as JSON, over the arm's socket ([`super::operator`]).
//!
//! Shared memory carries the record of every tick; percentiles, buses, rights and sources over the whole run are for
//! people and dashboards, and come from here. One connection, one report, closed.

use super::alarms::{Alarm, Alarms, Seen};
use super::operator::{Address, OperatorError, Said, Word};
use super::reach::{self, ReachStatus};
use super::statistics::{AfterSending, Stages, Statistics, Times};
use super::threads::{Baseline, ThreadReport};
use crate::config::CableNames;
use crate::control::Fault;
use crate::ipc::payload::{
    AlarmRecord, ObstacleDistance, RejectCause, SourceHealth, SourceReport, State, SupervisorState,
};
use nalgebra::Matrix3;
use rtrb::{Consumer, Producer, RingBuffer};
use serde::{Deserialize, Serialize};
use sinew_hal::clock::seconds_to_ns;
use std::collections::BTreeMap;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

/// The latched fault in words.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FaultStatus {
    /// Code, as in `State`.
    pub code: u32,
    /// Cable, bus or count, by code.
    pub detail: u32,
    /// What happened.
    pub what: String,
    /// What clears it.
    pub clears: String,
}

/// A bus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BusReport {
    /// Name.
    pub name: String,
    /// Share of the bus by computation, with worst-case stuffing.
    pub load_computed: f64,
    /// Permitted share.
    pub load_limit: f64,
    /// Share of the bus that the frames of the last half second took, with worst-case stuffing.
    pub load_measured: f64,
    /// State of the controller.
    pub state: String,
    /// Frames seen.
    pub frames: u64,
    /// Frames that this process was too slow for.
    pub lost: u64,
    /// Frames of cycles (torques and SYNC) that the bus did not take, or not before the next cycle: its drives kept the
    /// torques of the cycle before.
    pub unsent: u64,
}

/// What the bus thread knows of a bus.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BusStatus {
    pub(crate) load_measured: f64,
    pub(crate) state: String,
    pub(crate) frames: u64,
    pub(crate) lost: u64,
    pub(crate) unsent: u64,
}

/// The drives.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DriveStatus {
    /// How many there are.
    pub count: usize,
    /// Configured and operational.
    pub ready: usize,
    /// Giving torque.
    pub enabled: usize,
    /// The first in fault: which, and why.
    pub fault: Option<String>,
    /// Protection that drives lack and the configuration accepts: object and number of drives.
    pub lack: BTreeMap<String, usize>,
}

/// A source of inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceStatus {
    /// Source id.
    pub id: u32,
    /// Fresh, stale, expired, absent.
    pub health: String,
    /// Age of its newest content (s); null if there is none.
    pub age_s: Option<f64>,
    /// Messages accepted.
    pub accepted: u64,
    /// Messages rejected, by cause; causes that never occurred are left out.
    pub rejected: BTreeMap<String, u64>,
}

/// How far the estimated arm is from an obstacle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DistanceStatus {
    /// Source id.
    pub source: u32,
    /// Id within the source.
    pub id: u32,
    /// Smallest distance between the surfaces (m), growth not subtracted; negative: contact.
    pub surface_distance_m: f64,
    /// By how much the planner grew it (m).
    pub growth_m: f64,
}

impl DistanceStatus {
    /// Those of a record.
    pub fn of(state: &State) -> Vec<Self> {
        let one = |d: &ObstacleDistance| Self {
            source: d.source_id,
            id: d.obstacle_id,
            surface_distance_m: d.surface_distance_m,
            growth_m: d.growth_m,
        };
        state.distances.iter().take(state.distance_count as usize).map(one).collect()
    }
}

/// Where the arm is, as far as it is known.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TipStatus {
    /// Estimated position of the tip (m, base frame).
    pub position_m: [f64; 3],
    /// Three standard deviations of it, in the direction in which they are largest (m); null where nothing was estimated yet.
    pub three_sigma_m: Option<f64>,
    /// Its distance from the target (m); null without a target for the tip.
    pub error_m: Option<f64>,
    /// Largest error of a mean curvature (1/m); null without a target for the shape.
    pub curvature_error_1pm: Option<f64>,
    /// Smallest distance between an obstacle and the arm's surface (m); null without obstacles.
    pub nearest_m: Option<f64>,
    /// Smallest and largest tension commanded (N).
    pub tension_n: [f64; 2],
    /// Measured position of the tip (m, base frame); null where no measurement is fresh.
    #[serde(default)]
    pub measured_m: Option<[f64; 3]>,
    /// What lasts of measured less estimated tip (m, base frame).
    #[serde(default)]
    pub bias_m: [f64; 3],
}

/// Everything.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StatusReport {
    /// Version of the daemon.
    pub version: String,
    /// Name of the arm.
    pub arm: String,
    /// Process id.
    pub pid: u32,
    /// Whether time is ticks times the period.
    pub lockstep: bool,
    /// Mode.
    pub mode: String,
    /// The latched fault.
    pub fault: Option<FaultStatus>,
    /// What is wrong now, the fault among it.
    pub alarms: Vec<Alarm>,
    /// Where the arm is, as far as it is known.
    pub tip: TipStatus,
    /// Speed over the configured one that was asked for (`sinew speed`); 1 after the arm was disarmed.
    pub speed_scale: f64,
    /// By how much the tip target is out of reach; null where it is not.
    pub reach: Option<ReachStatus>,
    /// Whether it is not known yet if the tip target that is followed is within reach.
    pub reach_sought: bool,
    /// Ticks done.
    pub ticks: u64,
    /// Period (s).
    pub period_s: f64,
    /// Deadlines missed: the two below together.
    pub missed: u64,
    /// Ticks left out because the loop was late: deadlines missed before the tick began.
    pub left_out: u64,
    /// Ticks whose torques left after the end of their period: deadlines missed by the tick itself.
    pub overran: u64,
    /// Records and events that found their queue full.
    pub records_dropped: u64,
    /// Messages that the recorder dropped; null without a recording.
    pub recording_dropped: Option<u64>,
    /// Real-time rights that were not granted, each with its remedy.
    pub realtime_refused: Vec<String>,
    /// Buses.
    pub buses: Vec<BusReport>,
    /// Drives.
    pub drives: DriveStatus,
    /// What drives do by themselves when the daemon is silent, and the loop with their cables at a fault (`safe_hold`).
    #[serde(default)]
    pub safe_hold: String,
    /// Encoders.
    pub encoders: SourceStatus,
    /// Target.
    pub target: SourceStatus,
    /// Measured tip; null where nothing ever measured it.
    #[serde(default)]
    pub tip_sensor: Option<SourceStatus>,
    /// Obstacle sources.
    pub obstacles: Vec<SourceStatus>,
    /// Obstacle sets refused because all places for sources are taken.
    pub obstacle_sources_refused: u64,
    /// Obstacles that the loop knows.
    pub distances: Vec<DistanceStatus>,
    /// Time per tick (us), by what it planned (`safe`, `warning`; `late` where it held or ramped because deadlines had been
    /// missed; `idle`), then by stage. `cycle` ends when the torques have left; `report` is what follows.
    pub time_us: BTreeMap<String, Stages>,
    /// Threads of the daemon, with what they did since the first tick.
    pub threads: Vec<ThreadReport>,
}

/// What never changes over a run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Fixed {
    pub(crate) arm: String,
    pub(crate) lockstep: bool,
    pub(crate) period_s: f64,
    /// Name, computed load, limit.
    pub(crate) buses: Vec<(String, f64, f64)>,
    /// Obstacle sources that must be there.
    pub(crate) required: Vec<u32>,
    /// What becomes of the cables without a master.
    pub(crate) safe_hold: String,
    /// Whether any of them is declared to stay at a fault.
    pub(crate) stays: bool,
    /// What its cables are called.
    pub(crate) cables: CableNames,
}

/// What is set now and then.
#[derive(Debug, Default)]
struct Inner {
    realtime_refused: Vec<String>,
    buses: Vec<BusStatus>,
    drives: DriveStatus,
    recording_dropped: Option<Arc<std::sync::atomic::AtomicU64>>,
}

/// What every tick changes.
#[derive(Debug, Default)]
struct Ticks {
    statistics: Statistics,
    state: Option<Box<State>>,
    /// What the threads had done before the first tick.
    baseline: Baseline,
}

/// Gathered from the I/O thread, the bus thread and the main thread; the control thread has no part in it.
///
/// The main thread has no priority, and a report takes milliseconds: whoever waits for its lock waits for a thread that
/// anybody may keep from its processor. So the I/O thread, by which encoders reach the control thread, never waits: what
/// finds the lock taken is kept by [`TickNotes`] until the next tick.
#[derive(Debug)]
pub(crate) struct Shared {
    fixed: Fixed,
    inner: Mutex<Inner>,
    ticks: Mutex<Ticks>,
    /// The main thread's own; under a lock only because a report may be asked for by others.
    alarms: Mutex<Alarms>,
}

/// Ticks whose times are kept while a report is made; a report that takes longer loses the rest.
const KEPT: usize = 4096;

/// The I/O thread's way to [`Shared`]: records of ticks, never waiting.
#[derive(Debug)]
pub(crate) struct TickNotes {
    shared: Arc<Shared>,
    period_ns: u64,
    kept: Vec<Times>,
    after: Consumer<AfterSending>,
    /// The alarms as they were seen last.
    alarms: Vec<AlarmRecord>,
}

impl TickNotes {
    /// With the control thread's end for what no record can tell.
    pub(crate) fn new(shared: Arc<Shared>) -> (Self, Producer<AfterSending>) {
        let period_ns = if shared.fixed.lockstep { 0 } else { seconds_to_ns(shared.fixed.period_s) };
        let (to, after) = RingBuffer::new(KEPT);
        (Self { shared, period_ns, kept: Vec::with_capacity(KEPT), after, alarms: Vec::new() }, to)
    }

    /// Adds the alarms to a record.
    pub(crate) fn complete(&mut self, state: &mut State) {
        if let Ok(alarms) = self.shared.alarms.try_lock() {
            alarms.records_into(&mut self.alarms);
        }
        state.alarm_count = 0;
        for (place, alarm) in state.alarms.iter_mut().zip(&self.alarms) {
            *place = *alarm;
            state.alarm_count += 1;
        }
    }

    pub(crate) fn note(&mut self, state: &State) {
        if self.kept.len() < KEPT {
            self.kept.push(Times::of(state));
        }
        let mut ticks = match self.shared.ticks.try_lock() {
            Ok(ticks) => ticks,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        let Ticks { statistics, state: newest, baseline } = &mut *ticks;
        self.kept.drain(..).for_each(|times| statistics.note(&times, self.period_ns));
        while let Ok(after) = self.after.pop() {
            statistics.note_after(&after);
        }
        match newest {
            Some(place) => **place = *state,
            None => (*newest, *baseline) = (Some(Box::new(*state)), Baseline::now()),
        }
    }
}

impl Shared {
    pub(crate) fn new(fixed: Fixed) -> Self {
        Self { fixed, inner: Mutex::default(), ticks: Mutex::default(), alarms: Mutex::default() }
    }

    /// A thread that panicked leaves numbers, which are as good as any.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the bus thread says; it does not wait either, and says it again soon.
    pub(crate) fn set_wires(&self, buses: Vec<BusStatus>, drives: DriveStatus) {
        let mut inner = match self.inner.try_lock() {
            Ok(inner) => inner,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        (inner.buses, inner.drives) = (buses, drives);
    }

    pub(crate) fn set_refused(&self, refused: Vec<String>) {
        self.lock().realtime_refused = refused;
    }

    pub(crate) fn set_recorder(&self, dropped: Arc<std::sync::atomic::AtomicU64>) {
        self.lock().recording_dropped = Some(dropped);
    }

    /// Looks at what is wrong now, and tells of what has changed; for the main thread, some times a second.
    pub(crate) fn watch(&self, recording_failed: bool) {
        let state = self.ticks.lock().unwrap_or_else(PoisonError::into_inner).state.clone();
        let (drives, realtime_refused) = {
            let inner = self.lock();
            (inner.drives.clone(), inner.realtime_refused.clone())
        };
        let state = state.as_deref();
        let fault = state.and_then(|s| fault_status(s, &self.fixed.cables));
        let (required, realtime_refused) = (&self.fixed.required[..], &realtime_refused[..]);
        let permits = state.and_then(latched).is_some_and(|fault| fault.permits_holding());
        let held = permits && self.fixed.stays && drives.enabled > 0;
        let seen = Seen { state, fault, held, drives, required, realtime_refused, recording_failed };
        self.alarms.lock().unwrap_or_else(PoisonError::into_inner).update(&seen);
    }

    /// The report as of now.
    pub(crate) fn report(&self) -> StatusReport {
        let (state, time_us, overran, threads) = {
            let ticks = self.ticks.lock().unwrap_or_else(PoisonError::into_inner);
            (
                ticks.state.as_deref().copied(),
                ticks.statistics.stages(),
                ticks.statistics.overran(),
                ticks.baseline.since(),
            )
        };
        let done = state.as_ref().map_or(0, |s| s.header.tick + 1);
        let state = state.unwrap_or_default();
        let inner = self.lock();
        let fixed = &self.fixed;
        let bus = |(i, (name, computed, limit)): (usize, &(String, f64, f64))| {
            let seen = inner.buses.get(i);
            BusReport {
                name: name.clone(),
                load_computed: *computed,
                load_limit: *limit,
                load_measured: seen.map_or(0.0, |b| b.load_measured),
                state: seen.map_or_else(String::new, |b| b.state.clone()),
                frames: seen.map_or(0, |b| b.frames),
                lost: seen.map_or(0, |b| b.lost),
                unsent: seen.map_or(0, |b| b.unsent),
            }
        };
        let absent = SourceHealth::Absent.wire();
        let used = |s: &&SourceReport| s.health != absent || s.source_id != 0 || s.rejected_total() > 0;
        StatusReport {
            version: env!("CARGO_PKG_VERSION").into(),
            arm: fixed.arm.clone(),
            pid: std::process::id(),
            lockstep: fixed.lockstep,
            mode: mode_text(state.supervisor).into(),
            fault: fault_status(&state, &fixed.cables),
            alarms: self.alarms.lock().unwrap_or_else(PoisonError::into_inner).list(),
            tip: tip_status(&state),
            speed_scale: state.speed_scale,
            reach: ReachStatus::of(&state),
            reach_sought: reach::is_sought(&state),
            ticks: done,
            period_s: fixed.period_s,
            missed: state.ticks_missed + overran,
            left_out: state.ticks_missed,
            overran,
            records_dropped: state.records_dropped,
            recording_dropped: inner
                .recording_dropped
                .as_ref()
                .map(|dropped| dropped.load(std::sync::atomic::Ordering::Relaxed)),
            realtime_refused: inner.realtime_refused.clone(),
            buses: fixed.buses.iter().enumerate().map(bus).collect(),
            drives: inner.drives.clone(),
            safe_hold: fixed.safe_hold.clone(),
            encoders: source_status(&state.encoder_report),
            target: source_status(&state.target_report),
            tip_sensor: used(&&state.tip_report).then(|| source_status(&state.tip_report)),
            obstacles: state.obstacle_sources.iter().filter(used).map(source_status).collect(),
            obstacle_sources_refused: state.obstacle_sources_refused,
            distances: DistanceStatus::of(&state),
            time_us,
            threads,
        }
    }
}

fn tip_status(state: &State) -> TipStatus {
    let known = |x: f64| x.is_finite().then_some(x);
    let covariance = Matrix3::from_column_slice(&state.tip_covariance_m2);
    let largest = known(covariance.sum()).map(|_| covariance.symmetric_eigenvalues().max().max(0.0));
    let distances = &state.distances[..(state.distance_count as usize).min(state.distances.len())];
    let tensions = &state.tension_command_n[..(state.cable_count as usize).min(state.tension_command_n.len())];
    TipStatus {
        position_m: state.tip_position_m,
        three_sigma_m: largest.map(|largest| 3.0 * largest.sqrt()),
        error_m: known(state.tip_error_m),
        curvature_error_1pm: known(state.curvature_error_1pm),
        nearest_m: distances.iter().map(|d| d.surface_distance_m).reduce(f64::min).and_then(known),
        tension_n: [
            tensions.iter().copied().fold(f64::NAN, f64::min),
            tensions.iter().copied().fold(f64::NAN, f64::max),
        ]
        .map(|x| if x.is_nan() { 0.0 } else { x }),
        measured_m: state.tip_measured_m.iter().all(|x| x.is_finite()).then_some(state.tip_measured_m),
        bias_m: state.tip_bias_m,
    }
}

fn mode_text(supervisor: u32) -> &'static str {
    SupervisorState::from_wire(supervisor).map_or("unknown", SupervisorState::text)
}

/// The latched fault of a record in words: what caused it, and not what is wrong by now.
pub fn fault_status(state: &State, cables: &CableNames) -> Option<FaultStatus> {
    let (code, detail) = (state.fault_code, state.fault_detail);
    if code == 0 {
        return None;
    }
    let fault = latched(state);
    Some(FaultStatus {
        code,
        detail,
        what: fault.map_or("a fault of another version of sinew".into(), |fault| fault.in_words(cables)),
        clears: fault.map_or("see the documentation of that version", |fault| fault.remedy()).to_owned(),
    })
}

/// The latched fault; `None` without one, or for one of another version.
fn latched(state: &State) -> Option<Fault> {
    Fault::of_parts(state.fault_code, state.fault_detail, state.fault_flags, state.fault_values)
}

fn source_status(report: &SourceReport) -> SourceStatus {
    let rejected = report.rejected.iter().zip(0..).filter(|(n, _)| **n > 0).map(|(n, cause)| {
        let text = RejectCause::from_wire(cause).map_or_else(|| cause.to_string(), |c| c.text().to_owned());
        (text, *n)
    });
    SourceStatus {
        id: report.source_id,
        health: SourceHealth::from_wire(report.health).map_or("unknown", SourceHealth::text).into(),
        age_s: report.age_s.is_finite().then_some(report.age_s),
        accepted: report.accepted,
        rejected: rejected.collect(),
    }
}

/// Gives the report to those who ask for it over the arm's socket, on the main thread.
#[derive(Debug)]
pub(crate) struct StatusServer(Receiver<UnixStream>);

/// How many may wait for a report.
const WAITING_MAX: usize = 16;

impl StatusServer {
    /// With the end for those who ask.
    pub(crate) fn new() -> (SyncSender<UnixStream>, Self) {
        let (to, from) = sync_channel(WAITING_MAX);
        (to, Self(from))
    }

    /// Serves one of those who wait, so that whoever asks without end cannot keep the caller from its other duties;
    /// whether there was one.
    pub(crate) fn serve(&self, shared: &Shared) -> bool {
        let Ok(mut stream) = self.0.try_recv() else { return false };
        let answer = serde_json::to_vec(&Said::Status(Box::new(shared.report()))).unwrap_or_default();
        // Whoever does not read is not worth waiting for.
        let sent = stream
            .set_nonblocking(false)
            .and_then(|()| stream.set_write_timeout(Some(Duration::from_millis(100))))
            .and_then(|()| stream.write_all(&answer));
        if let Err(error) = sent {
            tracing::debug!(%error, "status not delivered");
        }
        true
    }
}

/// Asks the daemon of an arm for its report; `None` if none runs.
///
/// # Errors
/// [`OperatorError`]: it does not answer, or not to this user, or is of another version.
pub fn ask(address: &Address) -> Result<Option<StatusReport>, OperatorError> {
    match address.ask(Word::Status, Duration::from_secs(5)) {
        Ok(Said::Status(report)) => Ok(Some(*report)),
        Ok(Said::Refused(why)) => Err(OperatorError::Refused { why }),
        Ok(Said::Answer(_) | Said::Taken) => Err(OperatorError::Refused { why: "an answer to something else".into() }),
        Err(OperatorError::NoDaemon(_)) => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::super::statistics::Branch;
    use super::*;
    use crate::ipc::payload::Header;
    use std::io::Read;

    #[test]
    fn a_report_comes_back_as_it_was() {
        let buses = vec![("bus0".to_owned(), 0.5, 0.7)];
        let shared = Arc::new(Shared::new(Fixed {
            arm: "arm".into(),
            lockstep: true,
            period_s: 0.01,
            buses,
            cables: CableNames::new([6; 4]),
            ..Fixed::default()
        }));
        let mut state = State {
            header: Header { tick: 41, ..Header::default() },
            fault_code: 20,
            fault_detail: 7,
            fault_values: [0.06, f64::NAN],
            ..State::default()
        };
        state.obstacle_sources[0].source_id = 7;
        state.obstacle_sources[0].rejected[RejectCause::NotFinite.wire() as usize] = 2;
        TickNotes::new(shared.clone()).0.note(&state);
        let (ask, server) = StatusServer::new();
        let (mut asking, asked) = UnixStream::pair().unwrap();
        ask.try_send(asked).unwrap();
        // The report is longer than a socket holds: somebody must read meanwhile.
        let asking = std::thread::spawn(move || {
            let mut text = Vec::new();
            asking.read_to_end(&mut text).unwrap();
            text
        });
        assert!(server.serve(&shared));
        let Said::Status(report) = serde_json::from_slice(&asking.join().unwrap()).unwrap() else {
            panic!("no report")
        };
        let report = *report;
        let threads = |report: StatusReport| StatusReport { threads: Vec::new(), ..report };
        assert_eq!(threads(report.clone()), threads(shared.report()), "threads go on meanwhile");
        assert!(report.threads.len() > 1, "{:?}", report.threads);
        assert_eq!(report.ticks, 42);
        assert_eq!(report.obstacles[0].rejected, BTreeMap::from([("NaN or infinite number".to_owned(), 2)]));
        let fault = report.fault.unwrap();
        assert_eq!(fault.what, "the encoder of cable 2,2 has been silent for 0.060 s");
        assert!(fault.clears.contains("clear"));
    }

    #[test]
    fn one_look_serves_one_who_asks() {
        let shared = Shared::new(Fixed { arm: "arm".into(), ..Fixed::default() });
        let (ask, server) = StatusServer::new();
        assert!(!server.serve(&shared), "nobody asks");
        let (asking, asked): (Vec<_>, Vec<_>) = (0..3).map(|_| UnixStream::pair().unwrap()).unzip();
        asked.into_iter().for_each(|stream| ask.try_send(stream).unwrap());
        for served in 0..3 {
            let mut waiting = asking[served..].iter();
            let unanswered = |mut stream: &UnixStream| {
                stream.set_nonblocking(true).unwrap();
                stream.read(&mut [0]).is_err_and(|error| error.kind() == std::io::ErrorKind::WouldBlock)
            };
            assert!(waiting.all(unanswered), "after {served} looks");
            assert!(server.serve(&shared));
        }
        assert!(!server.serve(&shared));
    }

    #[test]
    fn a_tick_is_noted_without_waiting_for_a_report_under_way_and_not_forgotten() {
        let shared = Arc::new(Shared::new(Fixed { period_s: 0.001, ..Fixed::default() }));
        let (mut notes, mut after) = TickNotes::new(shared.clone());
        let tick = |tick, cycle_ns| {
            let mut state = State { header: Header { tick, ..Header::default() }, ..State::default() };
            state.timing.cycle_ns = cycle_ns;
            state
        };
        notes.note(&tick(0, 1_000));
        {
            let _report_under_way = shared.ticks.lock().unwrap();
            notes.note(&tick(1, 2_000_000));
            after.push(AfterSending { branch: Branch::Idle, report_ns: 1_000 }).unwrap();
            notes.note(&tick(2, 1_000));
        }
        assert_eq!((shared.report().ticks, shared.report().overran), (1, 0));
        let mut last = tick(3, 1_000);
        last.ticks_missed = 5;
        notes.note(&last);
        let report = shared.report();
        assert_eq!((report.ticks, report.time_us["idle"]["cycle"].count), (4, 4));
        assert_eq!(report.time_us["idle"]["report"].count, 1);
        assert_eq!((report.missed, report.left_out, report.overran), (6, 5, 1));
    }
}
