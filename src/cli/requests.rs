//! `sinew arm`, `disarm`, `hold`, `track`, `stop`, `clear`, `home`, `speed`, `target`: what an operator asks for.

use super::client::{ANSWER, Which, not_connected, numbers, say};
use super::{Outcome, complain};
use clap::{ArgGroup, Args};
use sinew::daemon::operator::{Address, OperatorError, Said, Word, parse_speed};
use sinew::daemon::status;
use sinew::ipc::payload::{MAX_SEGMENTS, SupervisorState, Target, TargetMode};
use sinew_hal::peer::user_text;
use std::time::{Duration, Instant};

/// Arguments of a request without any of its own.
#[derive(Debug, Args)]
pub(crate) struct Ask {
    #[command(flatten)]
    which: Which,
}

impl Ask {
    /// Over the arm's socket, which needs no shared memory. What only stops goes to every daemon of the arm that is found,
    /// anything else to one.
    pub(crate) fn run(&self, word: Word) -> miette::Result<Outcome> {
        let found = self.which.find()?;
        let all = if word.stops() {
            match found.address.ask_all(word, ANSWER) {
                Ok(all) => all,
                Err(error) => return Ok(not_connected(&error)),
            }
        } else {
            let answered = found.address.ask(word, ANSWER);
            let tracks = word == Word::Track && accepted_in(&answered).is_some();
            let outcome = said(word.text(), answered)?;
            return Ok(if tracks { say_reach(&found.address) } else { outcome });
        };
        let several = all.len() > 1;
        let mut outcome = Outcome::Done;
        for (uid, one) in all {
            if several {
                complain(format_args!("sinew: the daemon of user {}:", user_text(uid)));
            }
            let one = said(word.text(), one)?;
            if one != Outcome::Done {
                outcome = one;
            }
        }
        Ok(outcome)
    }
}

/// The supervisor's state where it accepts.
fn accepted_in(said: &Result<Said, OperatorError>) -> Option<SupervisorState> {
    match said {
        Ok(Said::Answer(answer)) if answer.accepted => SupervisorState::from_wire(answer.supervisor),
        _ => None,
    }
}

/// Says what a daemon said.
fn said(asked: &str, said: Result<Said, OperatorError>) -> miette::Result<Outcome> {
    match said {
        Ok(Said::Answer(answer)) => say(asked, &answer.response()),
        Ok(Said::Refused(why)) => Ok(not_connected(&OperatorError::Refused { why })),
        Ok(Said::Status(_) | Said::Taken) => {
            Ok(not_connected(&OperatorError::Refused { why: "not understood".into() }))
        }
        Err(error) => Ok(not_connected(&error)),
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
        self.ask.run(if self.release { Word::EmergencyRelease } else { Word::EmergencyStop })
    }
}

/// Longest wait for what the arm finds out about a target: it looks from several postures.
const REACH: Duration = Duration::from_secs(10);
/// A loop that makes no tick for so long finds nothing out.
const SILENCE: Duration = Duration::from_secs(1);
/// Between two looks at the daemon's report.
const LOOKS: Duration = Duration::from_millis(50);

/// Waits until the loop has found out whether a tip target that is followed from now on is within reach, and says so where it is
/// not.
fn say_reach(address: &Address) -> Outcome {
    let deadline = Instant::now() + REACH;
    let (mut first, mut out, mut newest) = (None, None, (0, Instant::now()));
    while Instant::now() < deadline && newest.1.elapsed() < SILENCE {
        let report = match status::ask(address) {
            Ok(Some(report)) => report,
            Ok(None) => break,
            Err(error) => return not_connected(&error),
        };
        if report.ticks > newest.0 {
            newest = (report.ticks, Instant::now());
        }
        // The tick of the answer may have seen the target before; the next one has not.
        let seen = report.ticks >= *first.get_or_insert(report.ticks) + 3;
        if let Some(reach) = report.reach.filter(|_| seen) {
            // The tick that finds it out still tracks; whether it is refused shows the one after.
            if reach.refused || report.ticks >= *out.get_or_insert(report.ticks) + 2 {
                complain(format_args!("the target is out of reach: {}", reach.text()));
                return if reach.refused { Outcome::Failed } else { Outcome::Done };
            }
        } else if seen && !report.reach_sought {
            break;
        }
        std::thread::sleep(LOOKS);
    }
    Outcome::Done
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
            Ok(scale) => self.ask.run(Word::Speed(scale)),
            Err(why) => {
                complain(format_args!("sinew speed: {why}"));
                Ok(Outcome::Unusable)
            }
        }
    }
}

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
        let target = match self.target() {
            Ok(target) => target,
            Err(why) => {
                complain(format_args!("sinew target: {why}"));
                return Ok(Outcome::Unusable);
            }
        };
        let address = self.which.find()?.address;
        let answered = address.set_target(&target, ANSWER);
        let tracks = accepted_in(&answered) == Some(SupervisorState::Tracking);
        let outcome = said("target", answered)?;
        Ok(if tracks { say_reach(&address) } else { outcome })
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
