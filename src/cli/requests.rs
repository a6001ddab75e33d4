//! `sinew arm`, `disarm`, `hold`, `track`, `stop`, `clear`, `home`, `speed`, `target`: what an operator asks for.

use super::client::{ANSWER, Which, loop_time_ns, not_connected, numbers, say};
use super::{Outcome, complain};
use clap::{ArgGroup, Args};
use miette::IntoDiagnostic;
use sinew::daemon::ReachStatus;
use sinew::daemon::operator::{OperatorError, Said, Word, parse_speed};
use sinew::ipc::Client;
use sinew::ipc::payload::{Header, MAX_SEGMENTS, Request, RequestKind, SupervisorState, Target, TargetMode};
use sinew_hal::peer::user_text;
use std::time::{Duration, Instant};

/// Arguments of a request without any of its own.
#[derive(Debug, Args)]
pub(crate) struct Ask {
    #[command(flatten)]
    which: Which,
}

impl Ask {
    pub(crate) fn run(&self, kind: RequestKind) -> miette::Result<Outcome> {
        if let Some(word) = Word::of(kind) {
            return self.order(word);
        }
        let mut client = match self.which.connect()? {
            Ok(client) => client,
            Err(error) => return Ok(not_connected(&error)),
        };
        match client.ask(kind, ANSWER) {
            Ok(response) if kind == RequestKind::Track && response.is_accepted() => {
                say(kind.text(), &response)?;
                say_reach(&client)
            }
            Ok(response) => say(kind.text(), &response),
            Err(error) => Ok(not_connected(&error)),
        }
    }
}

impl Ask {
    /// Over the arm's socket, which needs no shared memory.
    fn order(&self, word: Word) -> miette::Result<Outcome> {
        let found = self.which.find()?;
        let all = match found.address.ask_all(word, ANSWER) {
            Ok(all) => all,
            Err(error) => return Ok(not_connected(&error)),
        };
        let several = all.len() > 1;
        let mut outcome = Outcome::Done;
        for (uid, said) in all {
            if several {
                complain(format_args!("sinew: the daemon of user {}:", user_text(uid)));
            }
            let one = match said {
                Ok(Said::Answer(answer)) => say(word.text(), &answer.response())?,
                Ok(Said::Refused(why)) => not_connected(&OperatorError::Refused { why }),
                Ok(Said::Status(_)) => not_connected(&OperatorError::Refused { why: "not understood".into() }),
                Err(error) => not_connected(&error),
            };
            if one != Outcome::Done {
                outcome = one;
            }
        }
        Ok(outcome)
    }
}

/// Arguments of `sinew emergency-stop`.
#[derive(Debug, Args)]
pub(crate) struct EmergencyStop {
    #[command(flatten)]
    ask: Ask,
    /// Release it; `sinew clear` then clears the fault.
    #[arg(long)]
    release: bool,
}

impl EmergencyStop {
    pub(crate) fn run(&self) -> miette::Result<Outcome> {
        self.ask.run(if self.release { RequestKind::EmergencyRelease } else { RequestKind::EmergencyStop })
    }
}

/// Longest wait for what the arm finds out about a target: it looks from several postures.
const REACH: Duration = Duration::from_secs(10);

/// Waits until the loop has found out whether a tip target that is followed from now on is within reach, and says so where it is
/// not.
fn say_reach(client: &Client) -> miette::Result<Outcome> {
    let states = client.states().into_diagnostic()?;
    let deadline = Instant::now() + REACH;
    let (mut first, mut out) = (None, None);
    while Instant::now() < deadline {
        let Some(state) = states.wait(Duration::from_secs(1)).into_diagnostic()? else { break };
        // The tick of the answer may have seen the target before; the next one has not.
        let since = *first.get_or_insert(state.header.tick);
        if state.header.tick < since + 3 {
            continue;
        }
        if let Some(reach) = ReachStatus::of(&state) {
            // The tick that finds it out still tracks; whether it is refused shows the one after.
            let found = *out.get_or_insert(state.header.tick);
            if !reach.refused && state.header.tick < found + 2 {
                continue;
            }
            let refused = reach.refused;
            complain(format_args!("the target is out of reach: {}", reach.text()));
            return Ok(if refused { Outcome::Failed } else { Outcome::Done });
        }
        let looks = state.target_mode == TargetMode::Tip.wire() && state.reach_miss_m.is_nan();
        if state.supervisor != SupervisorState::Tracking.wire() || !looks {
            break;
        }
    }
    Ok(Outcome::Done)
}

/// Arguments of `sinew speed`.
#[derive(Debug, Args)]
pub(crate) struct Speed {
    #[command(flatten)]
    ask: Ask,
    /// Share of the configured speed: 1% to 100%, or 0.01 to 1.
    #[arg(value_name = "SPEED", allow_hyphen_values = true)]
    speed: String,
}

impl Speed {
    pub(crate) fn run(&self) -> miette::Result<Outcome> {
        match parse_speed(&self.speed) {
            Ok(scale) => self.ask.order(Word::Speed(scale)),
            Err(why) => {
                complain(format_args!("sinew speed: {why}"));
                Ok(Outcome::Unusable)
            }
        }
    }
}

/// Source id under which this command gives targets.
const SOURCE_ID: u32 = 0x5157;

/// Arguments of `sinew target`.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true, group(ArgGroup::new("what").required(true).args(["pose", "curvatures"])))]
pub(crate) struct TargetArguments {
    #[command(flatten)]
    which: Which,
    /// Tip pose: position (m, base frame) and quaternion, e.g. 0.2,0,-2.5,0.7071,0,0.7071,0.
    #[arg(long, value_name = "X,Y,Z,QW,QX,QY,QZ", allow_hyphen_values = true)]
    pose: Option<String>,
    /// Average curvatures (1/m), (y, z) segment by segment.
    #[arg(long, value_name = "Y1,Z1,Y2,Z2,...", allow_hyphen_values = true)]
    curvatures: Option<String>,
    /// Weight of the task in place of the configured one: that of the pose, or of the curvatures.
    #[arg(long, value_name = "WEIGHT")]
    weight: Option<f64>,
}

impl TargetArguments {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let mut target = match self.target() {
            Ok(target) => target,
            Err(why) => {
                complain(format_args!("sinew target: {why}"));
                return Ok(Outcome::Unusable);
            }
        };
        let mut client = match self.which.connect()? {
            Ok(client) => client,
            Err(error) => return Ok(not_connected(&error)),
        };
        let capture_ns = loop_time_ns(&client)?;
        target.header = Header::new(SOURCE_ID, 0, capture_ns);
        let mut request = Request { target, ..Request::new(RequestKind::SetTarget) };
        request.header.source_id = SOURCE_ID;
        match client.request(request, ANSWER) {
            Ok(response) if response.is_accepted() && response.supervisor == SupervisorState::Tracking.wire() => {
                say("target", &response)?;
                say_reach(&client)
            }
            Ok(response) => say("target", &response),
            Err(error) => Ok(not_connected(&error)),
        }
    }

    fn target(&self) -> Result<Target, String> {
        let mut target = Target::default();
        if let Some(pose) = &self.pose {
            let values = numbers(pose)?;
            let [x, y, z, qw, qx, qy, qz] = values[..] else {
                return Err(format!("--pose has {} numbers, expected 7: x,y,z (m) and qw,qx,qy,qz", values.len()));
            };
            let norm = (qw * qw + qx * qx + qy * qy + qz * qz).sqrt();
            if (norm - 1.0).abs() > 0.01 {
                return Err(format!("--pose: the quaternion has length {norm:.4}, expected 1 (to a hundredth)"));
            }
            target.position_m = [x, y, z];
            target.quaternion = [qw, qx, qy, qz].map(|q| q / norm);
        }
        if let Some(curvatures) = &self.curvatures {
            let values = numbers(curvatures)?;
            if values.is_empty() || !values.len().is_multiple_of(2) || values.len() > 2 * MAX_SEGMENTS {
                return Err(format!("--curvatures has {} numbers, expected two for each segment", values.len()));
            }
            target.mode = TargetMode::Shape.wire();
            target.segment_count = (values.len() / 2) as u32;
            target.curvature_1pm[..values.len()].copy_from_slice(&values);
        }
        if let Some(weight) = self.weight {
            if !(weight > 0.0 && weight <= 1e20) {
                return Err(format!("--weight {weight}: expected a number above 0 and at most 1e20"));
            }
            target.weight = weight;
        }
        Ok(target)
    }
}
