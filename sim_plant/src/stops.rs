//! A motion of a scenario that is stopped, or cut off, at an instant; told by the true arm.

use crate::bench::{Bench, Trouble};
use crate::follow::target;
use crate::truth::TruthSettings;
use nalgebra::Vector3;
use sinew::collision::{Body, BodyGeometry};
use sinew::config::{BodyModel, Config, ScenarioConfig};
use sinew::control::{Mode, Request};

/// Time before a path at its first pose (s).
const APPROACH_S: f64 = 10.0;
/// The arm rests where its tip has been slower than this, over its length (1/s), for so long (s).
const REST_1PS: f64 = 0.004;
const REST_S: f64 = 1.0;

/// How a motion ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ending {
    /// By a request.
    Stop,
    /// The daemon is told to end: a stop whose time is limited.
    Sigterm,
    /// Something goes wrong.
    Trouble(Trouble),
}

/// What a stop showed.
#[derive(Debug, Clone, PartialEq)]
pub struct Stopped {
    /// Least distance of the arm's surface from an obstacle (m), negative in contact; infinite without obstacles.
    pub distance_m: f64,
    /// The same of an arm that stood still from that instant on: what comes to an arm that holds, no hold prevents.
    pub still_m: f64,
    /// Largest speed of the tip (m/s).
    pub speed_mps: f64,
    /// How far the tip is from where it was (m), at rest or at the end.
    pub moved_m: f64,
    /// Time until it rested (s); `None` if it did not.
    pub rest_s: Option<f64>,
    /// Mode at the end, and the fault that is latched.
    pub mode: Mode,
    /// As named.
    pub fault: Option<String>,
}

/// Runs a scenario with the arm of `config`, which starts where the scenario does, ends it `at_s` after its path's beginning,
/// and watches the arm until it rests, `watch_s` at most. `trace` sees the bench, the task's time (s), the tip's speed (m/s) and the
/// least distance (m) after each tick from that instant on.
///
/// # Errors
/// The arm does not stand where the scenario starts, its controller does not come to hold it, or the run does not get so far.
pub fn stop(
    config: &Config,
    truth: &TruthSettings,
    scenario: &ScenarioConfig,
    at_s: f64,
    ending: Ending,
    watch_s: f64,
    mut trace: impl FnMut(&mut Bench, f64, f64, f64),
) -> Result<Stopped, String> {
    let mut config = config.clone();
    config.planner.avoidance = scenario.planner.avoidance;
    let mut bench = Bench::at_start_of(scenario, &config, truth)?;
    bench.insert(&scenario.obstacles)?;
    bench.arm(config.observer.settle_timeout_s + 10.0).map_err(|why| format!("not armed: {why}"))?;
    let (h, lookahead) = (config.timing.period_s, config.planner.lookahead_s);
    let nodes = bench.truth.config().node_count() + 1;
    let (mut r, mut t) = (vec![Vector3::zeros(); nodes], vec![Vector3::zeros(); nodes]);
    let mut body = Body::with_capacity(&BodyGeometry::from_arm(bench.truth.config()), BodyModel::Arm, 0.0, 16);
    let begin = bench.time_s() + APPROACH_S;
    let mut request = Some(Request::Track);
    // Where the arm was when it ended: its tip, and its nodes.
    let mut ended: Option<Vector3<f64>> = None;
    let (mut still_r, mut still_t) = (r.clone(), t.clone());
    let mut before = bench.truth.tip().position;
    let mut shown = Stopped {
        distance_m: f64::INFINITY,
        still_m: f64::INFINITY,
        speed_mps: 0.0,
        moved_m: 0.0,
        rest_s: None,
        mode: Mode::Disarmed,
        fault: None,
    };
    let mut quiet_s = 0.0;
    while bench.time_s() < begin + at_s + watch_s {
        let now = bench.time_s() + h - begin;
        bench.place(&scenario.obstacles, now, lookahead)?;
        bench.target = Some(target(&scenario.task, now, now + bench.cycle.lead_s()));
        if ended.is_none() && now >= at_s {
            if bench.cycle.mode() != Mode::Tracking {
                let why = bench.cycle.supervisor().latch().first.map(|l| l.fault.to_string());
                return Err(format!("{:?} before {at_s:.2} s: {}", bench.cycle.mode(), why.unwrap_or_default()));
            }
            ended = Some(before);
            bench.truth.frames_into(&mut still_r, &mut still_t);
            match ending {
                Ending::Stop | Ending::Sigterm => request = Some(Request::Stop),
                Ending::Trouble(trouble) => bench.befall(trouble),
            }
        }
        if ending == Ending::Sigterm && now >= at_s + config.timing.stop_timeout_s {
            request = request.or(Some(Request::Disarm));
        }
        let output = bench.step(request.take());
        if let Some(why) = &bench.broken {
            return Err(format!("plant {why}"));
        }
        let tip = bench.truth.tip().position;
        let speed = (tip - before).norm() / h;
        before = tip;
        let Some(from) = ended else { continue };
        bench.truth.frames_into(&mut r, &mut t);
        let measured = body.measure(&r, &t, bench.obstacles.now());
        let distance = measured.along_arm.iter().copied().fold(f64::INFINITY, f64::min);
        shown.distance_m = shown.distance_m.min(distance);
        let measured = body.measure(&still_r, &still_t, bench.obstacles.now());
        shown.still_m = measured.along_arm.iter().copied().fold(shown.still_m, f64::min);
        shown.speed_mps = shown.speed_mps.max(speed);
        trace(&mut bench, now, speed, distance);
        shown.moved_m = (tip - from).norm();
        shown.mode = output.mode;
        quiet_s = if speed > REST_1PS * config.arm.length_m() { 0.0 } else { quiet_s + h };
        let over = match ending {
            Ending::Stop | Ending::Sigterm => output.mode == Mode::Disarmed,
            Ending::Trouble(_) => true,
        };
        if over && quiet_s >= REST_S && now > at_s + 1.0 {
            shown.rest_s = Some(now - at_s - REST_S);
            break;
        }
    }
    shown.fault = bench.cycle.supervisor().latch().first.map(|l| l.fault.to_string());
    Ok(shown)
}

/// A trouble of a kind, by a number: `kill`, `bus`, `fault`.
pub fn trouble(kind: &str, cables: usize, number: u64) -> Option<Trouble> {
    let cable = (number as usize * 7) % cables;
    Some(match kind {
        "kill" => Trouble::Dead,
        // All of them, or a quarter of the cables, as on four buses.
        "bus" => match number as usize % 5 {
            4 => Trouble::Bus(0, cables),
            quarter => Trouble::Bus(quarter * cables / 4, (quarter + 1) * cables / 4),
        },
        "fault" => match number % 4 {
            0 => Trouble::Trip(cable),
            1 => Trouble::Silent(cable),
            2 => Trouble::Jump(cable),
            _ => Trouble::Late,
        },
        _ => return None,
    })
}
