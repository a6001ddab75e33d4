//! `sinew arm`, `disarm`, `hold`, `track`, `stop`, `clear`, `home`, `target`: what an operator asks for.

use super::client::{ANSWER, Which, not_connected, numbers, say};
use super::{Outcome, complain};
use clap::{ArgGroup, Args};
use sinew::daemon::operator::{OperatorError, Said, Word};
use sinew::ipc::payload::{MAX_SEGMENTS, Target, TargetMode};
use sinew_hal::peer::user_text;

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
            return said(word.text(), found.address.ask(word, ANSWER));
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
        said("target", self.which.find()?.address.set_target(&target, ANSWER))
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
