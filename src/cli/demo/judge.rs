//! What the run achieved, judged by the true arm.
//!
//! Enters: the plant's trace and the daemon's records. Leaves: a summary. Distances, tip error and curvature error are
//! the true arm's against the scenario at that time; tensions are those that the drums were told; iterations, times and
//! faults are the daemon's. The judgement ends with the first fault, and where the arm is told to stop: from there on the
//! controller no longer moves it along its path.
//!
//! The two files meet in time. In real time both carry CLOCK_MONOTONIC. In lockstep the plant counts SYNCs and the daemon
//! ticks, and an event of the daemon's tells the number of the SYNC that went with tick 0. Laid beside each other so, the
//! tensions of every tick, as the wire carries them, must be the ones that the drums had; a tick or SYNC that is
//! missing or stands twice is an error too. What cannot be laid together is not judged.

use super::setup::Setup;
use super::wire;
use crate::cli::scenario_client::approach_s;
use miette::{IntoDiagnostic, WrapErr, miette};
use nalgebra::{Quaternion, UnitQuaternion, Vector3, Vector4};
use serde::de::DeserializeOwned;
use sinew::collision::{Body, BodyGeometry};
use sinew::config::{ArmConfig, BodyModel, CableNames};
use sinew::control::Fault;
use sinew::daemon::{FIRST_SYNC, motor_bank, overran};
use sinew::ipc::payload::PlannerBranch;
use sinew::model::Outputs;
use sinew::planner::{Branch, Goal};
use sinew::recording::read_each;
use sinew::report::{Collector, Summary, Tick, tip_error};
use sinew::scenario::Course;
use sinew_hal::clock::seconds_to_ns;
use std::path::Path;

/// Between the same torque in whole per mille, as the two programs compute its tension (N).
const WIRE_TOLERANCE_N: f64 = 1e-6;

/// A run and what it came to.
pub(super) struct Judged {
    pub(super) summary: Summary,
    /// The arm touched an obstacle although it should not.
    pub(super) contact: bool,
    /// Scenario time reached (s).
    pub(super) reached_s: f64,
    /// Where the arm held or stopped instead of following its path.
    pub(super) held: Held,
}

/// Times without tracking, up to the first fault or the stop.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Held {
    /// All of them together (s).
    pub(super) for_s: f64,
    /// Scenario time at which the first one began (s).
    pub(super) from_s: f64,
    /// Whether the run ended in one.
    pub(super) at_end: bool,
}

/// One of the daemon's ticks.
pub(super) struct Record {
    pub(super) tick: u64,
    pub(super) capture_ns: u64,
    pub(super) tracks: bool,
    pub(super) stops: bool,
    pub(super) tensions: Vec<f64>,
    pub(super) branch: Option<PlannerBranch>,
    pub(super) iterations: u64,
    pub(super) plan_ns: u64,
    pub(super) cycle_ns: u64,
    pub(super) wakeup_ns: u64,
    pub(super) left_out: u64,
    pub(super) fault: Option<FaultOf>,
}

/// A latched fault.
#[derive(Debug, Clone, Copy)]
pub(super) struct FaultOf {
    code: u32,
    /// `None` for a code of another version.
    fault: Option<Fault>,
}

impl FaultOf {
    /// Of what a record holds; `None` without a fault.
    pub(super) fn new(code: u32, detail: u32, flags: u32, values: [f64; 2]) -> Option<Self> {
        (code != 0).then(|| Self { code, fault: Fault::of_parts(code, detail, flags, values) })
    }
}

impl Record {
    /// A fault, or the ramp of a stop: the path is no longer followed, and what the arm does from here is not judged.
    const fn is_over(&self) -> bool {
        self.fault.is_some() || self.stops
    }
}

/// The true arm after one period.
pub(super) struct Truth {
    pub(super) syncs: u64,
    pub(super) capture_ns: u64,
    pub(super) tensions: Vec<f64>,
    pub(super) nodes: Vec<[f64; 7]>,
    pub(super) curvatures: Vec<f64>,
}

pub(super) fn judge(setup: &Setup, lockstep: bool) -> miette::Result<Judged> {
    let mut records: Vec<Record> = Vec::new();
    read(&setup.records(), "/state", |tick: wire::Tick| records.push(tick.into()))?;
    let mut first_sync = None;
    read(&setup.records(), "/events", |event: wire::Event| {
        if event.code == FIRST_SYNC {
            first_sync = Some(event.value.unwrap_or(f64::NAN) as u64);
        }
    })?;
    let mut truths: Vec<Truth> = Vec::new();
    read(&setup.trace(), "/state", |truth: wire::Truth| truths.push(truth.into()))?;
    let Some(first) = records.iter().position(|r| r.tracks) else {
        return Ok(never_tracked(setup, lockstep, &records));
    };
    // The scenario begins when the clients say so: after the approach to its start.
    let approach_s = approach_s(&setup.scenario.task);
    let origin_ns = records[first].capture_ns + seconds_to_ns(approach_s);
    let period_s = setup.config.timing.period_s;
    let truth_s: Vec<f64> = if lockstep {
        let offset = offset(setup, first_sync, &records[first..], &truths)?;
        let tick = records[first].tick as f64;
        truths.iter().map(|t| (t.syncs as f64 - offset as f64 - tick + 1.0) * period_s - approach_s).collect()
    } else {
        truths.iter().map(|t| (t.capture_ns as f64 - origin_ns as f64) * 1e-9).collect()
    };

    let over = records[first..].iter().find(|r| r.is_over());
    let over_s = over.map_or(f64::INFINITY, |r| (r.capture_ns as f64 - origin_ns as f64) * 1e-9);
    let end_s = setup.duration_s.min(over_s) + 0.5 * period_s;
    let mut collector = collector(setup);
    let mut judge = Judge::new(setup)?;
    let mut tick = records.iter().position(|r| r.capture_ns >= origin_ns).unwrap_or(records.len());
    let mut reached_s = 0.0;
    for (truth, &t) in truths.iter().zip(&truth_s) {
        // Half a period: times are multiples of it only up to rounding.
        if t < 0.5 * period_s || t > end_s {
            continue;
        }
        // The newest tick before this state.
        let mut record = None;
        while let Some(r) = records.get(tick)
            && (r.capture_ns as f64 - origin_ns as f64) * 1e-9 < t - 1e-9
        {
            (record, tick) = (Some(r), tick + 1);
        }
        reached_s = t;
        judge.add(&mut collector, truth, t, record, lockstep)?;
    }
    let within = |r: &&Record| !r.stops && (r.capture_ns as f64 - origin_ns as f64) * 1e-9 <= end_s;
    let run: Vec<&Record> = records[first..].iter().take_while(within).collect();
    let (left_out, overran) = missed(&run, if lockstep { 0.0 } else { period_s });
    collector.set_missed(left_out, overran);
    faults(setup, &records, origin_ns, &mut collector);
    let planner = &setup.config.planner;
    let summary = collector.summary(&setup.scenario.name, setup.seed, period_s, planner.lookahead_s, true);
    Ok(Judged {
        contact: setup.scenario.planner.avoidance && collector.contact(BodyModel::Arm, 0.0),
        summary,
        reached_s,
        held: held(&run, origin_ns, period_s),
    })
}

/// A run that ended before it began; its faults say why.
fn never_tracked(setup: &Setup, lockstep: bool, records: &[Record]) -> Judged {
    let mut collector = collector(setup);
    let (period_s, lookahead_s) = (setup.config.timing.period_s, setup.config.planner.lookahead_s);
    let (left_out, overran) = missed(&records.iter().collect::<Vec<_>>(), if lockstep { 0.0 } else { period_s });
    collector.set_missed(left_out, overran);
    faults(setup, records, records.first().map_or(0, |r| r.capture_ns), &mut collector);
    let summary = collector.summary(&setup.scenario.name, setup.seed, period_s, lookahead_s, true);
    Judged { summary, contact: false, reached_s: 0.0, held: Held::default() }
}

/// Deadlines that a run missed: by ticks left out since its first one, and by ticks whose torques left after their period
/// (s; 0 in lockstep).
fn missed(run: &[&Record], period_s: f64) -> (u64, u64) {
    let left_out = match run {
        [first, .., last] => last.left_out.saturating_sub(first.left_out),
        _ => 0,
    };
    let period_ns = seconds_to_ns(period_s);
    (left_out, run.iter().filter(|r| overran(r.wakeup_ns, r.cycle_ns, period_ns)).count() as u64)
}

fn held(run: &[&Record], origin_ns: u64, period_s: f64) -> Held {
    let holds = |r: &&&Record| !r.tracks && r.fault.is_none();
    let first = run.iter().find(holds);
    Held {
        for_s: period_s * run.iter().filter(holds).count() as f64,
        from_s: first.map_or(0.0, |r| (r.capture_ns as f64 - origin_ns as f64) * 1e-9),
        at_end: run.last().is_some_and(|last| holds(&last)),
    }
}

fn collector(setup: &Setup) -> Collector {
    let names: Vec<String> = setup.scenario.obstacles.iter().map(|o| o.id.clone()).collect();
    let cables: Vec<usize> = setup.config.arm.segments.iter().map(|s| s.hole_angles_rad.len()).collect();
    Collector::new(&names, &cables, &setup.config.arm.tension_maxima_n())
}

fn faults(setup: &Setup, records: &[Record], origin_ns: u64, collector: &mut Collector) {
    let names = setup.config.arm.cable_names();
    let mut last = None;
    for r in records {
        if let Some(fault) = r.fault
            && last != Some(fault.code)
        {
            let at_s = (r.capture_ns as f64 - origin_ns as f64) * 1e-9;
            let words = fault.fault.map_or("a fault of another version".into(), |fault| fault.in_words(&names));
            collector.add_fault(format!("{words} (code {}) at {at_s:.2} s", fault.code));
        }
        last = r.fault.map(|fault| fault.code);
    }
}

/// SYNCs before that of tick 0, as far as the plant's count goes: those that take effect late count as later.
///
/// # Errors
/// The recordings do not belong together tick by tick.
fn offset(setup: &Setup, first_sync: Option<u64>, records: &[Record], truths: &[Truth]) -> miette::Result<u64> {
    let first_sync = first_sync.ok_or(miette!("the daemon's recording does not tell which SYNC went with tick 0"))?;
    let bank = motor_bank(&setup.config).into_diagnostic()?;
    let given_n = |cable: usize, tension_n: f64| {
        let channel = bank.channels().get(cable);
        channel
            .and_then(|c| c.encode_tension(tension_n).map(|(torque, _)| c.decode_tension(torque)))
            .unwrap_or(f64::NAN)
    };
    let names = setup.config.arm.cable_names();
    aligned(first_sync + setup.latency_ticks, records, truths, given_n, !setup.wire.is_empty(), &names)
}

/// The offset, where both recordings are without a gap and the drums had what was commanded, as the wire carries it
/// (`given_n` of cable and tension): all of it, or where frames were lost on purpose most of it, and more than half.
fn aligned(
    offset: u64,
    records: &[Record],
    truths: &[Truth],
    given_n: impl Fn(usize, f64) -> f64,
    disturbed: bool,
    names: &CableNames,
) -> miette::Result<u64> {
    let count = tracked(records);
    let Some(first) = records.first().filter(|_| count > 0) else { return Err(miette!("nothing was tracked")) };
    let syncs = first.tick + offset;
    let Some(begin) = truths.iter().position(|truth| truth.syncs == syncs) else {
        return Err(miette!("the plant's trace lacks the SYNC {syncs} of tick {}", first.tick));
    };
    let (mut arrived, mut most) = (0, 0);
    for (place, record) in records[..count].iter().enumerate() {
        let tick = record.tick;
        if tick != first.tick + place as u64 {
            return Err(miette!(
                "the daemon's recording has tick {tick} where {} was to be",
                first.tick + place as u64
            ));
        }
        // A plant that is stopped first has no state after the last ticks.
        let Some(truth) = truths.get(begin + place) else { break };
        if truth.syncs != tick + offset {
            let expected = tick + offset;
            return Err(miette!("the plant's trace has SYNC {} where {expected} was to be", truth.syncs));
        }
        most += record.tensions.len();
        arrived += record.tensions.len();
        for (cable, (a, b)) in record.tensions.iter().zip(&truth.tensions).enumerate() {
            let a = given_n(cable, *a);
            if (a - b).abs() <= WIRE_TOLERANCE_N {
                continue;
            }
            if !disturbed {
                return Err(miette!(
                    "the drives did not apply what the controller commanded: at tick {tick} {} had {b:.3} N, not {a:.3} N",
                    names.words(cable)
                ));
            }
            arrived -= 1;
        }
    }
    if 2 * arrived <= most {
        return Err(miette!(
            "less than half of the commands reached the drives: the recordings cannot be laid together"
        ));
    }
    Ok(offset)
}

fn tracked(records: &[Record]) -> usize {
    records.iter().take_while(|r| r.tracks).count()
}

/// Measures the true arm.
struct Judge {
    course: Course,
    obstacles: sinew::collision::ObstacleSet,
    /// On the truth's mesh.
    body: Body,
    /// On the controller's mesh, whose points the paper's are.
    coarse: Body,
    refinement: usize,
    base_quaternion: UnitQuaternion<f64>,
    positions: Vec<Vector3<f64>>,
    tangents: Vec<Vector3<f64>>,
}

impl Judge {
    fn new(setup: &Setup) -> miette::Result<Self> {
        let course = Course::new(&setup.scenario);
        let obstacles = course.obstacles().into_diagnostic()?;
        let refinement = setup.mesh_refinement.max(1);
        let geometry = BodyGeometry::from_arm(&refined(&setup.config.arm, refinement));
        let nodes = geometry.node_count();
        let radius_m = setup.config.planner.body_radius_m;
        let coarse = BodyGeometry::from_arm(&setup.config.arm);
        Ok(Self {
            course,
            obstacles,
            body: Body::with_capacity(&geometry, BodyModel::Arm, radius_m, 1),
            coarse: Body::with_capacity(&coarse, BodyModel::Points, radius_m, 1),
            refinement,
            base_quaternion: unit(setup.config.arm.base_quaternion),
            positions: vec![setup.config.arm.base_position_m.into(); nodes],
            tangents: vec![Vector3::x(); nodes],
        })
    }

    fn add(
        &mut self,
        collector: &mut Collector,
        truth: &Truth,
        t: f64,
        record: Option<&Record>,
        lockstep: bool,
    ) -> miette::Result<()> {
        if truth.nodes.len() + 1 != self.positions.len() {
            let (found, expected) = (truth.nodes.len(), self.positions.len() - 1);
            return Err(miette!("the trace holds {found} of {expected} nodes of the true arm: refine its mesh less"));
        }
        self.tangents[0] = self.base_quaternion * Vector3::x();
        for (i, [x, y, z, q @ ..]) in truth.nodes.iter().enumerate() {
            self.positions[i + 1] = Vector3::new(*x, *y, *z);
            self.tangents[i + 1] = unit(*q) * Vector3::x();
        }
        self.course.place(&mut self.obstacles, t);
        let measured = self.body.measure(&self.positions, &self.tangents, &self.obstacles);
        let every = |v: &[Vector3<f64>]| v.iter().step_by(self.refinement).copied().collect::<Vec<_>>();
        let (r, t_c) = (every(&self.positions), every(&self.tangents));
        let at_points = self.coarse.measure(&r, &t_c, &self.obstacles).at_points;
        let goal = self.course.goal(t);
        let last = truth.nodes[truth.nodes.len() - 1];
        let tip = Outputs {
            position: Vector3::new(last[0], last[1], last[2]),
            quaternion: Vector4::new(last[3], last[4], last[5], last[6]),
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
        };
        let curvature_error = match goal {
            Goal::Shape { curvatures, .. } => {
                Some(truth.curvatures.iter().zip(curvatures).fold(0.0f64, |a, (k, d)| a.max((k - d).abs())))
            }
            Goal::Tip { .. } => None,
        };
        let us = |ns: u64| (ns > 0).then_some(ns as f64 * 1e-3);
        let step = record.and_then(|r| {
            let branch = match r.branch? {
                PlannerBranch::None => return None,
                PlannerBranch::Safe => Branch::Safe,
                PlannerBranch::Swarm
                | PlannerBranch::Seeded
                | PlannerBranch::Complementarity
                | PlannerBranch::StandardSwarm => Branch::Warning,
            };
            Some((branch, r.iterations as usize, true))
        });
        collector.add(&Tick {
            time_s: t,
            tensions: &truth.tensions,
            along_arm: measured.along_arm,
            at_points,
            tip_error: tip_error(&goal, &tip),
            curvature_error,
            step,
            swarm_evaluations: 0,
            plan_us: record.and_then(|r| us(r.plan_ns)),
            cycle_us: record.and_then(|r| us(r.cycle_ns)),
            wakeup_us: record.filter(|_| !lockstep).and_then(|r| us(r.wakeup_ns)),
        });
        Ok(())
    }
}

/// The arm on the truth's mesh, as far as its geometry goes.
fn refined(arm: &ArmConfig, refinement: usize) -> ArmConfig {
    let mut arm = arm.clone();
    arm.segments.iter_mut().for_each(|segment| segment.elements *= refinement);
    arm
}

fn unit([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z))
}

/// Every message of a topic. One that lacks a field, or has it otherwise, is an error: what is not there decides nothing.
fn read<T: DeserializeOwned>(path: &Path, topic: &str, mut take: impl FnMut(T)) -> miette::Result<()> {
    let mut wrong = None;
    let read = read_each(path, |message| {
        if message.topic.ends_with(topic) && wrong.is_none() {
            match T::deserialize(&message.value) {
                Ok(value) => take(value),
                Err(error) => wrong = Some(error),
            }
        }
    });
    read.into_diagnostic().wrap_err_with(|| path.display().to_string())?;
    match wrong {
        None => Ok(()),
        Some(error) => Err(miette!("{}: a message of {topic} is not understood: {error}", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(tick: u64, tracks: bool) -> Record {
        Record {
            tick,
            capture_ns: 1_000_000_000 + 10_000_000 * tick,
            tracks,
            stops: false,
            tensions: Vec::new(),
            branch: None,
            iterations: 0,
            plan_ns: 0,
            cycle_ns: 0,
            wakeup_ns: 0,
            left_out: 0,
            fault: None,
        }
    }

    #[test]
    fn a_deadline_is_missed_by_a_tick_left_out_and_by_torques_that_left_too_late() {
        const MS: u64 = 1_000_000;
        let mut run: Vec<Record> = (0..6).map(|k| record(k, true)).collect();
        run.iter_mut().for_each(|r| (r.cycle_ns, r.left_out) = (3 * MS, 7));
        (run[2].wakeup_ns, run[2].cycle_ns) = (9 * MS, 2 * MS);
        // Two ticks left out, and torques in time behind them.
        run[4].wakeup_ns = 25 * MS;
        (run[4].left_out, run[5].left_out) = (9, 9);
        let run: Vec<&Record> = run.iter().collect();
        assert_eq!(missed(&run, 0.01), (2, 1));
        assert_eq!(missed(&run, 0.0).1, 0, "in lockstep nothing is due");
        assert_eq!(missed(&[], 0.01), (0, 0));
    }

    fn names() -> CableNames {
        CableNames::new([2])
    }

    /// Ticks 5 to 14 that track, and the SYNCs 100 to 119 of a plant that began the loop's tick 0 with SYNC 100.
    fn recordings() -> (Vec<Record>, Vec<Truth>) {
        let tensions = |tick: u64| vec![50.0 + tick as f64, 60.0 - tick as f64];
        let records = (5..15).map(|tick| Record { tensions: tensions(tick), ..record(tick, true) }).collect();
        let truth = |tick: u64| Truth {
            syncs: 100 + tick,
            capture_ns: 10_000_000 * (100 + tick),
            tensions: tensions(tick),
            nodes: Vec::new(),
            curvatures: Vec::new(),
        };
        (records, (0..20).map(truth).collect())
    }

    fn refused(change: impl Fn(&mut Vec<Record>, &mut Vec<Truth>), disturbed: bool) -> String {
        let (mut records, mut truths) = recordings();
        change(&mut records, &mut truths);
        aligned(100, &records, &truths, |_, n| n, disturbed, &names()).unwrap_err().to_string()
    }

    #[test]
    fn recordings_meet_by_their_ticks() {
        let (records, truths) = recordings();
        assert_eq!(aligned(100, &records, &truths, |_, n| n, false, &names()).unwrap(), 100);
        // The plant went first.
        assert_eq!(aligned(100, &records, &truths[..10], |_, n| n, false, &names()).unwrap(), 100);
    }

    #[test]
    fn what_does_not_meet_tick_by_tick_is_not_judged() {
        assert!(
            refused(
                |_, t| t
                    .insert(8, Truth { tensions: vec![58.0, 52.0], nodes: Vec::new(), curvatures: Vec::new(), ..t[8] }),
                false
            )
            .contains("SYNC 108 where 109")
        );
        assert!(refused(|_, t| drop(t.remove(9)), false).contains("SYNC 110 where 109"));
        assert!(refused(|r, _| drop(r.remove(4)), false).contains("tick 10 where 9"));
        assert!(refused(|_, t| drop(t.drain(..6)), false).contains("lacks the SYNC 105"));
        assert!(refused(|_, t| t[7].tensions[1] += 0.2, false).contains("at tick 7 cable 1,2"));
        // Laid beside each other a tick off.
        let (records, truths) = recordings();
        assert!(aligned(101, &records, &truths, |_, n| n, false, &names()).is_err());
        assert!(
            aligned(101, &records, &truths, |_, n| n, true, &names())
                .unwrap_err()
                .to_string()
                .contains("less than half")
        );
    }

    #[test]
    fn commands_lost_on_purpose_are_no_reason_unless_they_are_most() {
        let (records, mut truths) = recordings();
        truths.iter_mut().step_by(3).for_each(|t| t.tensions[0] -= 1.0);
        assert_eq!(aligned(100, &records, &truths, |_, n| n, true, &names()).unwrap(), 100);
        assert!(aligned(100, &records, &truths, |_, n| n, false, &names()).is_err());
    }

    #[test]
    fn a_hold_is_told_by_its_time_and_whether_it_lasted() {
        let held_of = |ticks: &[(bool, u32)]| {
            let record = |(k, (tracks, fault)): (usize, &(bool, u32))| Record {
                fault: FaultOf::new(*fault, 0, 0, [f64::NAN; 2]),
                ..record(k as u64, *tracks)
            };
            let records: Vec<Record> = ticks.iter().enumerate().map(record).collect();
            held(&records.iter().collect::<Vec<_>>(), 1_000_000_000, 0.01)
        };
        assert_eq!(held_of(&[(true, 0); 5]), Held::default());
        let (tracks, holds, faulted) = ((true, 0), (false, 0), (false, 13));
        let passing = held_of(&[tracks, holds, holds, tracks]);
        assert!((passing.for_s - 0.02).abs() < 1e-9 && (passing.from_s - 0.01).abs() < 1e-9 && !passing.at_end);
        assert!(held_of(&[tracks, tracks, holds]).at_end);
        // A fault is told by itself.
        assert_eq!(held_of(&[tracks, faulted]), Held::default());
    }
}
