//! `sinew client`: a scenario's perception and task as processes of their own, for demonstrations and tests.
//!
//! Enters: the daemon's records. Leaves: obstacles or targets as the scenario has them. The scenario's clock begins
//! [`approach_s`] after the first tick in which the arm tracks; before, everything stands where it is at the beginning.
//! Neither client is told anything about the other, the plant, or who started it.
//!
//! In lockstep exactly one message goes out per tick, after the record of the tick before (see `ipc/PAYLOADS.md`); its
//! capture time is that tick's, and the velocity beside it leads to the next. In real time a message goes out every
//! `--period`.

use super::Outcome;
use clap::{Args, Subcommand};
use miette::IntoDiagnostic;
use sinew::config::{ScenarioConfig, ShapeConfig, Task};
use sinew::ipc::payload::{
    FLAG_LEAVING, MAX_CURVATURES, Obstacle, ObstacleKind, Obstacles, State, SupervisorState, Target, TargetMode,
};
use sinew::ipc::{Client as Daemon, Domain, Message, NewestSubscriber, SourcePublisher, monotonic_ns};
use sinew_hal::clock::{Naps, seconds_to_ns};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How far ahead of time a path's points are sent (s): beyond the planner's lookahead and lead.
const AHEAD_S: f64 = 0.4;
/// Least time between two points (s): the daemon keeps 64 of them, whatever its period.
const POINTS_S: f64 = 0.01;
/// A daemon that has said nothing for so long is gone.
const SILENCE: Duration = Duration::from_secs(30);
/// Silence in lockstep after which is looked whether the daemon is there (ns).
const LOOK_NS: u64 = 1_000_000_000;

/// Time (s) between the first tick that tracks and the beginning of the scenario.
///
/// A tip path begins in a pose that the true arm is several centimetres away from: it rests under the tensions that the
/// controller's model needs there. So first it is brought to where the path begins. A shape is one step of the target,
/// and the approach to it is the scenario.
pub(crate) const fn approach_s(task: &Task) -> f64 {
    match task {
        Task::Tip { .. } => 4.0,
        Task::Shape { .. } => 0.0,
    }
}

/// Arguments of `sinew client`.
#[derive(Debug, Args)]
pub(crate) struct Client {
    #[command(subcommand)]
    role: Role,
}

#[derive(Debug, Subcommand)]
enum Role {
    /// Publishes a scenario's obstacles.
    Obstacles(Common),
    /// Publishes a scenario's targets.
    Task(Common),
}

#[derive(Debug, Args)]
struct Common {
    /// Built-in name or file.
    #[arg(long)]
    scenario: String,
    /// Name of the arm; default: the scenario's.
    #[arg(long)]
    arm: Option<String>,
    /// Source id, the same at every start.
    #[arg(long, default_value_t = 1)]
    source: u32,
    /// One message per tick of a daemon in lockstep.
    #[arg(long)]
    lockstep: bool,
    /// Interval between messages in real time (s).
    #[arg(long, default_value_t = 0.01)]
    period: f64,
}

/// What a client publishes.
trait Content {
    type Payload: Message;

    /// The message of scenario time `t_s`; `None` before the beginning. `origin_ns` is the beginning in the daemon's
    /// clock.
    fn at(&mut self, t_s: Option<f64>, origin_ns: u64) -> &mut Self::Payload;

    /// What to say before going; `None` for nothing.
    fn farewell(&mut self) -> Option<&mut Self::Payload>;
}

impl Client {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, stop.clone()).into_diagnostic()?;
        }
        match self.role {
            Role::Obstacles(common) => {
                let scenario = ScenarioConfig::find(&common.scenario)?;
                publish(&common, &scenario.clone(), ObstacleContent::new(scenario)?, &stop)
            }
            Role::Task(common) => {
                let scenario = ScenarioConfig::find(&common.scenario)?;
                publish(&common, &scenario.clone(), TaskContent::new(scenario), &stop)
            }
        }
    }
}

fn publish<C: Content>(
    common: &Common,
    scenario: &ScenarioConfig,
    mut content: C,
    stop: &AtomicBool,
) -> miette::Result<Outcome> {
    let arm = common.arm.as_deref().unwrap_or(&scenario.arm.name);
    let daemon = Daemon::wait_for_daemon(&Domain::from_env(), arm, SILENCE).into_diagnostic()?;
    let states = daemon.states().into_diagnostic()?;
    let mut publisher: SourcePublisher<C::Payload> = daemon.publisher(common.source).into_diagnostic()?;
    let mut clock = ScenarioClock::new(&scenario.task);
    let last_ns = if common.lockstep {
        in_lockstep(&mut content, &mut clock, &daemon, &states, &mut publisher, stop)?
    } else {
        in_real_time(&mut content, &mut clock, &states, &mut publisher, stop, common.period)?
    };
    if let Some(farewell) = content.farewell() {
        publisher.publish(farewell, last_ns.unwrap_or_else(monotonic_ns)).into_diagnostic()?;
        // A publisher that is dropped at once takes its message along.
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(Outcome::Done)
}

/// The scenario's time in the daemon's.
#[derive(Debug)]
struct ScenarioClock {
    approach_ns: u64,
    origin_ns: Option<u64>,
}

impl ScenarioClock {
    fn new(task: &Task) -> Self {
        Self { approach_ns: seconds_to_ns(approach_s(task)), origin_ns: None }
    }

    fn see(&mut self, state: &State) {
        if self.origin_ns.is_none() && state.supervisor == SupervisorState::Tracking.wire() {
            self.origin_ns = Some(state.header.capture_ns + self.approach_ns);
        }
    }

    fn at_s(&self, now_ns: u64) -> Option<f64> {
        self.origin_ns.and_then(|origin| now_ns.checked_sub(origin)).map(|since| since as f64 * 1e-9)
    }
}

/// Returns the capture time of the last message.
fn in_lockstep<C: Content>(
    content: &mut C,
    clock: &mut ScenarioClock,
    daemon: &Daemon,
    states: &NewestSubscriber<State>,
    publisher: &mut SourcePublisher<C::Payload>,
    stop: &AtomicBool,
) -> miette::Result<Option<u64>> {
    let (mut tick, mut capture_ns) = (0, 0);
    loop {
        let payload = content.at(clock.at_s(capture_ns), clock.origin_ns.unwrap_or(0));
        publisher.publish_for_tick(payload, capture_ns, tick).into_diagnostic()?;
        let naps = Naps::begin();
        let state = loop {
            if stop.load(Ordering::Relaxed) {
                return Ok(Some(capture_ns));
            }
            match states.receive().into_diagnostic()? {
                Some(state) if state.header.tick >= tick => break state,
                // However long a tick takes: only a daemon that is gone has no further one.
                _ if naps.waited_ns() > LOOK_NS && !daemon.has_daemon() => return Ok(Some(capture_ns)),
                _ => naps.nap(),
            }
        };
        clock.see(&state);
        (tick, capture_ns) = (state.header.tick + 1, state.header.capture_ns);
    }
}

fn in_real_time<C: Content>(
    content: &mut C,
    clock: &mut ScenarioClock,
    states: &NewestSubscriber<State>,
    publisher: &mut SourcePublisher<C::Payload>,
    stop: &AtomicBool,
    period_s: f64,
) -> miette::Result<Option<u64>> {
    let period = Duration::from_secs_f64(period_s.clamp(1e-3, 10.0));
    let mut next = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        while let Some(state) = states.receive().into_diagnostic()? {
            clock.see(&state);
        }
        let now_ns = monotonic_ns();
        let payload = content.at(clock.at_s(now_ns), clock.origin_ns.unwrap_or(0));
        publisher.publish(payload, now_ns).into_diagnostic()?;
        next += period;
        // All clients must see the same tick as the first that tracks, and a record is kept only until the next.
        while clock.origin_ns.is_none() && Instant::now() < next {
            while let Some(state) = states.receive().into_diagnostic()? {
                clock.see(&state);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    Ok(None)
}

struct ObstacleContent {
    scenario: ScenarioConfig,
    set: Box<Obstacles>,
}

impl ObstacleContent {
    fn new(scenario: ScenarioConfig) -> miette::Result<Self> {
        let mut content = Self { scenario, set: Box::default() };
        content.at(None, 0);
        if content.set.count as usize != content.scenario.obstacles.len() {
            miette::bail!("scenario {} has more obstacles or vertices than a message", content.scenario.name);
        }
        Ok(content)
    }
}

impl Content for ObstacleContent {
    type Payload = Obstacles;

    fn at(&mut self, t_s: Option<f64>, _origin_ns: u64) -> &mut Obstacles {
        (self.set.count, self.set.vertex_count) = (0, 0);
        for (index, o) in self.scenario.obstacles.iter().enumerate() {
            let (kind, dimensions_m, vertices): (_, _, &[[f64; 3]]) = match &o.shape {
                ShapeConfig::Ball { radius_m } => (ObstacleKind::Ball, [*radius_m, 0.0, 0.0], &[]),
                ShapeConfig::Capsule { half_length_m, radius_m } => {
                    (ObstacleKind::Capsule, [*half_length_m, *radius_m, 0.0], &[])
                }
                ShapeConfig::Box { half_extents_m } => (ObstacleKind::Box, *half_extents_m, &[]),
                ShapeConfig::HalfSpace => (ObstacleKind::HalfSpace, [0.0; 3], &[]),
                ShapeConfig::Hull { points_m } => (ObstacleKind::Hull, [0.0; 3], points_m),
            };
            let obstacle = Obstacle {
                quaternion: o.quaternion,
                velocity_mps: t_s.map_or([0.0; 3], |t| o.motion.velocity_at(t)),
                ..Obstacle::new(index as u32 + 1, kind, o.motion.position_at(t_s.unwrap_or(0.0)), dimensions_m)
            };
            // What does not fit is missed in `new`, by its number.
            let _fits =
                if vertices.is_empty() { self.set.push(obstacle) } else { self.set.push_hull(obstacle, vertices) };
        }
        &mut self.set
    }

    fn farewell(&mut self) -> Option<&mut Obstacles> {
        (self.set.count, self.set.vertex_count, self.set.flags) = (0, 0, FLAG_LEAVING);
        Some(&mut self.set)
    }
}

struct TaskContent {
    scenario: ScenarioConfig,
    target: Target,
    /// Time of the scenario of the newest point of a path (s).
    point_s: f64,
}

impl TaskContent {
    fn new(scenario: ScenarioConfig) -> Self {
        Self { scenario, target: Target::default(), point_s: f64::NEG_INFINITY }
    }
}

impl Content for TaskContent {
    type Payload = Target;

    fn at(&mut self, t_s: Option<f64>, origin_ns: u64) -> &mut Target {
        let target = &mut self.target;
        match &self.scenario.task {
            Task::Tip { path, .. } => {
                target.mode = TargetMode::Tip.wire();
                let point_s = t_s.map_or(0.0, |t| t + AHEAD_S);
                if t_s.is_some() {
                    // In time of the clock: whole nanoseconds.
                    if point_s < self.point_s + POINTS_S - 1e-9 {
                        return target;
                    }
                    self.point_s = point_s;
                }
                (target.position_m, target.quaternion) = path.pose_at(point_s);
                if t_s.is_some() {
                    target.velocity_mps = path.velocity_at(point_s);
                    target.angular_velocity_radps = turning_rate(path, point_s);
                    target.valid_from_ns = origin_ns + seconds_to_ns(point_s);
                }
            }
            task @ Task::Shape { curvatures_1pm, .. } => {
                // (46); where it is exactly 0, the least number that is not "the configured one".
                let weight = task.shape_weight_at(t_s.unwrap_or(0.0)).unwrap_or(0.0);
                target.weight = weight.max(f64::MIN_POSITIVE);
                target.mode = TargetMode::Shape.wire();
                target.segment_count = (curvatures_1pm.len() / 2) as u32;
                let used = curvatures_1pm.len().min(MAX_CURVATURES);
                target.curvature_1pm[..used].copy_from_slice(&curvatures_1pm[..used]);
            }
        }
        target
    }

    fn farewell(&mut self) -> Option<&mut Target> {
        None
    }
}

/// Angular velocity of a path (rad/s, base frame), by a central difference: paths give their attitude, not its rate.
fn turning_rate(path: &sinew::config::TipPath, t_s: f64) -> [f64; 3] {
    const H: f64 = 1e-4;
    let unit = |t: f64| {
        let [w, x, y, z] = path.pose_at(t).1;
        nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z))
    };
    let turn = unit(t_s + H) * unit(t_s - H).inverse();
    (turn.scaled_axis() / (2.0 * H)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario(name: &str) -> ScenarioConfig {
        ScenarioConfig::find(name).unwrap()
    }

    #[test]
    fn before_the_beginning_everything_stands_at_the_beginning() {
        let tip = scenario("tip");
        let mut task = TaskContent::new(tip.clone());
        let target = *task.at(None, 0);
        assert_eq!((target.valid_from_ns, target.velocity_mps), (0, [0.0; 3]));
        assert_eq!(target.position_m, [0.6, 0.0, -2.4]);
        let mut obstacles = ObstacleContent::new(tip).unwrap();
        let set = obstacles.at(None, 0);
        assert_eq!(set.count, 2);
        assert!(set.used().iter().all(|o| o.velocity_mps == [0.0; 3]));
    }

    #[test]
    fn a_path_is_sent_ahead_of_time_and_obstacles_as_they_are() {
        let tip = scenario("tip");
        let Task::Tip { path, .. } = &tip.task else { unreachable!() };
        let mut task = TaskContent::new(tip.clone());
        let target = *task.at(Some(10.0), 5_000_000_000);
        assert_eq!(target.valid_from_ns, 15_400_000_000);
        assert_eq!(target.position_m, path.pose_at(10.4).0);
        assert_eq!(target.velocity_mps, path.velocity_at(10.4));
        let mut obstacles = ObstacleContent::new(tip.clone()).unwrap();
        let second = obstacles.at(Some(10.0), 0).used()[1];
        assert_eq!(second.position_m, tip.obstacles[1].motion.position_at(10.0));
        assert_eq!(second.velocity_mps, tip.obstacles[1].motion.velocity_at(10.0));
    }

    #[test]
    fn a_shape_is_one_set_point_for_all_time_whose_weight_rises() {
        let mut task = TaskContent::new(scenario("shape"));
        let target = *task.at(Some(10.0), 7);
        assert_eq!((target.mode, target.segment_count, target.valid_from_ns), (TargetMode::Shape.wire(), 4, 0));
        assert_eq!(target.curvature_1pm[..3], [0.806, 0.806, -2.417]);
        // (46): -9.99e5 (10 - 100)^2 + 1e10.
        assert!((target.weight - 1.9081e9).abs() < 1.0, "{}", target.weight);
        assert!((task.at(None, 0).weight - 1e7).abs() < 1.0);
        assert_eq!(task.at(Some(200.0), 0).weight, 1e10);
    }

    #[test]
    fn the_clock_begins_when_the_arm_has_tracked_for_the_time_of_the_approach() {
        let mut clock = ScenarioClock { approach_ns: 500_000_000, origin_ns: None };
        let state = |ns: u64, mode: SupervisorState| {
            let mut state = State { supervisor: mode.wire(), ..State::default() };
            state.header.capture_ns = ns;
            state
        };
        clock.see(&state(10, SupervisorState::Holding));
        assert_eq!(clock.at_s(20), None);
        clock.see(&state(1_000_000_030, SupervisorState::Tracking));
        clock.see(&state(2_000_000_030, SupervisorState::Tracking));
        assert_eq!(clock.at_s(1_400_000_030), None);
        assert_eq!(clock.at_s(3_500_000_030), Some(2.0));
    }

    #[test]
    fn a_loop_of_any_period_gets_no_more_points_than_the_daemon_keeps() {
        for period_s in [1e-4, 0.001, 0.004, 0.01, 0.02] {
            let mut content = TaskContent::new(scenario("tip"));
            let mut points: Vec<u64> = (0..20_000)
                .map(|k| f64::from(k) * period_s)
                .take_while(|t| *t < 2.0)
                .map(|t| content.at(Some(t), 5).valid_from_ns)
                .collect();
            points.dedup();
            assert!(points.is_sorted());
            let within = |first: u64| points.iter().filter(|p| (first..first + 400_000_000).contains(p)).count();
            assert!(points.iter().all(|first| within(*first) <= 41), "{period_s}");
            assert!(
                points.len() as f64 >= 2.0 / period_s.max(POINTS_S + period_s) - 2.0,
                "{period_s}: {}",
                points.len()
            );
        }
    }
}
