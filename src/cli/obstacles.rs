//! `sinew obstacles`: inject one by hand, or list what the loop knows.

use super::client::{ANSWER, Found, Which, loop_time_ns, not_connected, numbers};
use super::{Outcome, complain, print_text};
use clap::{Args, Subcommand};
use comfy_table::Table;
use miette::IntoDiagnostic;
use sinew::daemon::operator::OperatorError;
use sinew::daemon::status::{DistanceStatus, ask};
use sinew::ipc::payload::{
    FLAG_LEAVING, NO_TICK, Obstacle, Obstacles, REJECT_CAUSES, RejectCause, SourceHealth, State,
};
use sinew::ipc::{Client, IpcError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Arguments of `sinew obstacles`.
#[derive(Debug, Args)]
pub(crate) struct ObstaclesArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Be a perception client with one ball until Ctrl-C, or for some seconds.
    Inject(Inject),
    /// List obstacles and their distances.
    List(List),
}

#[derive(Debug, Args)]
struct Inject {
    #[command(flatten)]
    which: Which,
    /// Centre (m, base frame) and radius (m); without it: an empty set, which says that nothing is there.
    #[arg(long, value_name = "X,Y,Z,R", allow_hyphen_values = true)]
    ball: Option<String>,
    /// Velocity (m/s, base frame).
    #[arg(long, value_name = "X,Y,Z", requires = "ball", allow_hyphen_values = true)]
    velocity: Option<String>,
    /// How long (s).
    #[arg(long = "for", value_name = "SECONDS", value_parser = super::positive_seconds)]
    duration: Option<f64>,
    /// Source id.
    #[arg(long, default_value_t = 0x0b5, value_name = "ID")]
    source: u32,
}

#[derive(Debug, Args)]
struct List {
    #[command(flatten)]
    which: Which,
    /// One JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

/// Interval of the sets: a camera's.
const INTERVAL: Duration = Duration::from_millis(30);

impl ObstaclesArguments {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        match self.command {
            Command::Inject(inject) => inject.run(),
            Command::List(list) => list.run(),
        }
    }
}

impl Inject {
    fn run(self) -> miette::Result<Outcome> {
        let obstacle = match self.obstacle() {
            Ok(obstacle) => obstacle,
            Err(why) => {
                complain(format_args!("sinew obstacles inject: {why}"));
                return Ok(Outcome::Unusable);
            }
        };
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, stop.clone()).into_diagnostic()?;
        }
        if let Some(found) = self.which.foreign()? {
            return Ok(match self.publish_over_socket(&found, obstacle, &stop) {
                Ok(None) => Outcome::Done,
                Ok(Some(why)) => self.refused(&why),
                Err(error) => not_connected(&error),
            });
        }
        let client = match self.which.connect()? {
            Ok(client) => client,
            Err(error) => return Ok(not_connected(&error)),
        };
        let begun_ns = loop_time_ns(&client)?;
        match self.publish(&client, obstacle, begun_ns, &stop) {
            Ok(None) => Ok(Outcome::Done),
            Ok(Some(why)) => Ok(self.refused(&why)),
            Err(error) => Ok(not_connected(&error)),
        }
    }

    fn refused(&self, why: &str) -> Outcome {
        complain(format_args!("sinew obstacles inject: source {}: refused: {why}", self.source));
        Outcome::Failed
    }

    fn is_over(&self, begun: Instant, stop: &AtomicBool) -> bool {
        stop.load(Ordering::Relaxed) || self.duration.is_some_and(|d| begun.elapsed().as_secs_f64() >= d)
    }

    /// The same as [`Self::publish`], for those who have no part in the daemon's shared memory.
    fn publish_over_socket(
        &self,
        found: &Found,
        obstacle: Option<Obstacle>,
        stop: &AtomicBool,
    ) -> Result<Option<String>, OperatorError> {
        let mut publisher = found.address.publisher(self.source, ANSWER)?;
        let begun = Instant::now();
        let mut set = Obstacles::default();
        // The daemon has the time.
        set.header.capture_ns = 0;
        let mut taken = false;
        while !self.is_over(begun, stop) {
            set.count = 0;
            if let Some(mut o) = obstacle {
                (0..3).for_each(|i| o.position_m[i] += o.velocity_mps[i] * begun.elapsed().as_secs_f64());
                let _ = set.push(o); // one of 64 places
            }
            // Whoever was refused may have been hung up on; what was said is there still.
            let sent = publisher.publish(&set);
            std::thread::sleep(INTERVAL);
            match publisher.heard()? {
                Some(Err(why)) => return Ok(Some(why)),
                Some(Ok(())) if !taken => {
                    taken = true;
                    complain(format_args!("sinew: obstacles of source {} are taken", self.source));
                }
                _ => {}
            }
            sent?;
        }
        set.count = 0;
        set.flags = FLAG_LEAVING;
        publisher.publish(&set)?;
        std::thread::sleep(Duration::from_millis(50));
        Ok((!taken).then(|| "the loop took none of it within this time".into()))
    }

    fn obstacle(&self) -> Result<Option<Obstacle>, String> {
        let Some(ball) = &self.ball else { return Ok(None) };
        let values = numbers(ball)?;
        let [x, y, z, radius] = values[..] else {
            return Err(format!("--ball has {} numbers, expected 4: x,y,z,r (m)", values.len()));
        };
        if radius <= 0.0 {
            return Err(format!("--ball: radius {radius} m, expected above 0"));
        }
        let mut obstacle = Obstacle::ball(1, [x, y, z], radius);
        if let Some(velocity) = &self.velocity {
            let values = numbers(velocity)?;
            obstacle.velocity_mps = values
                .try_into()
                .map_err(|v: Vec<f64>| format!("--velocity has {} numbers, expected 3 (m/s)", v.len()))?;
        }
        Ok(Some(obstacle))
    }

    /// Publishes until it is told to stop, or for its time; why the loop refuses it, if it does.
    fn publish(
        &self,
        client: &Client,
        obstacle: Option<Obstacle>,
        begun_ns: u64,
        stop: &AtomicBool,
    ) -> Result<Option<String>, IpcError> {
        let mut publisher = client.obstacles(self.source)?;
        let states = client.states()?;
        let begun = Instant::now();
        let (mut now_ns, mut tick) = (begun_ns, NO_TICK);
        let mut set = Obstacles::default();
        let mut fate = Fate::new(self.source);
        while !self.is_over(begun, stop) {
            // In the loop's own time, which in lockstep is not the clock's.
            if let Some(state) = states.wait(INTERVAL)? {
                (now_ns, tick) = (state.header.capture_ns, state.header.tick);
                if let Some(why) = fate.see(&state) {
                    return Ok(Some(why));
                }
            } else {
                now_ns += INTERVAL.as_nanos() as u64;
            }
            let moved_s = now_ns.saturating_sub(begun_ns) as f64 * 1e-9;
            set.count = 0;
            if let Some(mut o) = obstacle {
                (0..3).for_each(|i| o.position_m[i] += o.velocity_mps[i] * moved_s);
                let _ = set.push(o); // one of 64 places
            }
            publisher.publish_for_tick(&mut set, now_ns, tick.saturating_add(1))?;
            std::thread::sleep(INTERVAL);
        }
        // An ordered leave: the source sees nothing and is not missed.
        set.count = 0;
        set.flags = FLAG_LEAVING;
        if let Some(state) = states.wait(INTERVAL)? {
            now_ns = state.header.capture_ns;
        }
        publisher.publish(&mut set, now_ns)?;
        // The message must be taken before its publisher goes.
        std::thread::sleep(Duration::from_millis(50));
        Ok(fate.unseen())
    }
}

/// What becomes of the sets that are sent, as the records tell it.
struct Fate {
    source: u32,
    /// Accepted, refused by cause, and refused for want of a place, when the first record was seen.
    before: Option<(u64, [u64; REJECT_CAUSES], u64)>,
    looks: u32,
    seems_taken: bool,
    taken: bool,
}

/// Looks after which what is accepted is not another's of the same id: by then this one's would have been refused.
const LOOKS_MIN: u32 = 5;
/// Refusals after which a source is not taken: a single one may be another's of the same id, that has just ended.
const REFUSED_MIN: u64 = 3;

impl Fate {
    const fn new(source: u32) -> Self {
        Self { source, before: None, looks: 0, seems_taken: false, taken: false }
    }

    /// Looks at a record; why the sets are refused, if they are.
    fn see(&mut self, state: &State) -> Option<String> {
        let unused = SourceHealth::Absent.wire();
        let report = state.obstacle_sources.iter().find(|s| s.source_id == self.source && s.health != unused);
        let (accepted, rejected) = report.map_or((0, [0; REJECT_CAUSES]), |r| (r.accepted, r.rejected));
        let crowded = state.obstacle_sources_refused;
        let (first_accepted, first_rejected, first_crowded) = *self.before.get_or_insert((accepted, rejected, crowded));
        let cause = rejected.iter().zip(first_rejected).position(|(now, first)| *now >= first + REFUSED_MIN);
        if let Some(cause) = cause.and_then(|c| RejectCause::from_wire(c as u32)) {
            return Some(match cause {
                RejectCause::TooManySources => {
                    format!(
                        "another process publishes under this id; choose another: --source {}",
                        self.source.wrapping_add(1)
                    )
                }
                cause => cause.text().to_owned(),
            });
        }
        if report.is_none() && crowded >= first_crowded + REFUSED_MIN {
            return Some("all places for sources are taken; see `sinew status`".into());
        }
        self.looks += 1;
        let refused = rejected.iter().sum::<u64>() > first_rejected.iter().sum::<u64>();
        self.seems_taken = !refused && accepted > first_accepted;
        if !self.taken && self.seems_taken && self.looks >= LOOKS_MIN {
            self.taken = true;
            complain(format_args!("sinew: obstacles of source {} are taken", self.source));
        }
        None
    }

    /// At the end: why nothing is known of it.
    fn unseen(&self) -> Option<String> {
        (!self.taken && !self.seems_taken).then(|| "the loop took none of it within this time".into())
    }
}

impl List {
    fn run(self) -> miette::Result<Outcome> {
        if let Some(found) = self.which.foreign()? {
            let no_daemon = || OperatorError::NoDaemon(IpcError::NoDaemon { arm: found.arm.clone() });
            return match ask(&found.address).and_then(|report| report.ok_or_else(no_daemon)) {
                Ok(report) => self.print(report.ticks.saturating_sub(1), &report.distances),
                Err(error) => Ok(not_connected(&error)),
            };
        }
        let client = match self.which.connect()? {
            Ok(client) => client,
            Err(error) => return Ok(not_connected(&error)),
        };
        let Some(state) = client.states().into_diagnostic()?.wait(Duration::from_secs(2)).into_diagnostic()? else {
            complain("sinew: the daemon runs, but its loop sent no record within 2 s");
            return Ok(Outcome::Failed);
        };
        self.print(state.header.tick, &DistanceStatus::of(&state))
    }

    fn print(&self, tick: u64, distances: &[DistanceStatus]) -> miette::Result<Outcome> {
        if self.json {
            let text = serde_json::to_string(&serde_json::json!({ "tick": tick, "obstacles": distances }));
            print_text(&format!("{}\n", text.into_diagnostic()?))?;
            return Ok(Outcome::Done);
        }
        let mut table = Table::new();
        table.set_header(["source", "id", "distance (mm)", "grown by (mm)"]);
        for d in distances {
            table.add_row([
                d.source.to_string(),
                d.id.to_string(),
                format!("{:.1}", 1e3 * d.surface_distance_m),
                format!("{:.1}", 1e3 * d.growth_m),
            ]);
        }
        print_text(&format!("{table}\n{}", if distances.is_empty() { "no obstacles\n" } else { "" }))?;
        Ok(Outcome::Done)
    }
}
