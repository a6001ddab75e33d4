//! Faults in words: what happened, with the data and the names of the cables, and what clears it.

use super::fault::Fault;
use super::fault_parts::Subject;
use crate::config::CableNames;
use sinew_hal::canopen::Emergency;
use std::fmt;

/// Causes for which a drive cannot be used that no emergency code stands for, each at its number.
const CAUSES: [&str; 11] = [
    "fault without an emergency object",
    "not usable: configuration failed",
    "no boot-up after the reset",
    "wrong NMT state",
    "restarted by itself",
    "heartbeat lost",
    "a transition of the power state machine did not happen",
    "no feedback",
    "left torque operation by itself",
    "another node has sinew's own node id; change it, or `drives.master_node_id`",
    "a limit or setting of the drive was changed from outside; the log names the object",
];

/// A drive fault's cause in words; an emergency code as the drive's manual has it, with the words of CiA 301 and 402.
pub fn cause_text(cause: u32) -> String {
    if let Some(text) = usize::try_from(cause).ok().and_then(|cause| CAUSES.get(cause)) {
        return (*text).to_owned();
    }
    let code = u16::try_from(cause).unwrap_or_default();
    let words = Emergency { code, register: 0, data: [0; 5] }.words();
    format!("error 0x{cause:04X} ({words})")
}

impl Fault {
    /// What happened, without the data.
    pub const fn what(&self) -> &'static str {
        match self {
            Self::DriveFault { .. } => "a drive reports a fault",
            Self::DrivesLost => "the drives left torque operation by themselves",
            Self::DrivesNotUp { .. } => "the drives did not come up in time",
            Self::BusLost { .. } => "a bus does not answer",
            Self::TensionError { .. } => "a drive measures another tension than it was told",
            Self::EmergencyStop { .. } => "an emergency stop is pressed",
            Self::EncoderSilent { .. } => "an encoder is silent",
            Self::EncoderJump { .. } => "an encoder jumped",
            Self::EncoderStuck { .. } => "an encoder sticks while its cable moves",
            Self::CableLength { .. } => "an encoder does not fit the other cables of its segment",
            Self::CablePull { .. } => "a cable does not pull what its drive was told",
            Self::InnovationBound { .. } => "model and measured cable lengths disagree",
            Self::InnovationGrowth { .. } => "model and measured cable lengths drift apart",
            Self::NotSettled { .. } => "the observer did not settle in time",
            Self::NoStart => "no arm shape fits the measured cable lengths",
            Self::EstimateLost => "the estimated state is not finite",
            Self::TensionNotFinite { .. } => "a planned tension is not a number",
            Self::TensionOutside { .. } => "a planned tension lies outside its box",
            Self::PlanSingular { .. } => "the planner failed several times in a row",
            Self::TargetNotFinite => "a target that is not a number reached the loop",
            Self::Overruns { .. } => "too many deadlines missed",
            Self::TipSpeed { .. } => "the tip is faster than declared",
            Self::BendRate { .. } => "a segment bends faster than declared",
            Self::Swinging { .. } => "the arm swings",
            Self::Saturated { .. } => "a tension stays at its limit",
        }
    }

    /// What clears it. Every fault is released by `clear` once its cause is gone and the ramp is over.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::DriveFault { .. } => "look up the drive's error, then `clear`: it resets the drives",
            Self::DrivesLost => "check power, brake and enable lines of the drives, then `clear`",
            Self::DrivesNotUp { .. } => "check power, wiring and node ids of the drives, then `clear` and `arm`",
            Self::BusLost { .. } => "restore the bus (cable, termination, interface), then `clear`",
            Self::TensionError { .. } => {
                "check the drive's limits (6072), its current loop and who else writes to it, then `clear`"
            }
            Self::EmergencyStop { .. } => "release the emergency stop, then `clear`",
            Self::EncoderSilent { .. } => "restore the encoder's readings, then `clear`",
            Self::EncoderJump { .. } => "check the encoder and its cable's drum, reference it anew, then `clear`",
            Self::EncoderStuck { .. } => "check the encoder's coupling and the cable (broken, slack), then `clear`",
            Self::CableLength { .. } => {
                "check `sign`, `counts_per_turn`, `gear_ratio` and `drum_radius_m` of its drive, its reference, and whether the cable slips, then `clear`"
            }
            Self::CablePull { .. } => {
                "check `rated_torque_nm`, `gear_ratio`, `drum_radius_m` and `sign` of its drive, whether the cable is whole, and that nothing holds the arm, then `clear`"
            }
            Self::InnovationBound { .. } | Self::InnovationGrowth { .. } => {
                "look for a broken or slack cable, a wrong encoder reference or an unmodelled load, then `clear`"
            }
            Self::NotSettled { .. } => {
                "bring the arm to rest and check the encoders' references, then `clear` and `arm`"
            }
            Self::NoStart => "check the encoders' references and the arm's parameters, then `clear` and `arm`",
            Self::EstimateLost => "check the arm's parameters (damping, masses), then `clear` and `arm`",
            Self::TensionNotFinite { .. } | Self::TensionOutside { .. } => {
                "a defect of the planner: keep the recording, then `clear` and `arm`"
            }
            Self::PlanSingular { .. } => "bring the arm to a regular pose, then `clear` and `arm`",
            Self::TargetNotFinite => "stop the client that sends it, then `clear`",
            Self::Overruns { .. } => "free the processor or lengthen the period, then `clear` and `arm`",
            Self::TipSpeed { .. } | Self::BendRate { .. } => {
                "look for what drove the arm (an obstacle that jumps, a push), or raise the limit in `[supervision]`, then `clear`"
            }
            Self::Swinging { .. } => {
                "let the arm come to rest; check its damping and the observer's settings, then `clear` and `arm`"
            }
            Self::Saturated { .. } => {
                "choose a pose that needs less tension, or look for a load or a contact, then `clear`"
            }
        }
    }

    /// What happened, with its data, in the words of this arm. Allocates.
    pub fn in_words(&self, cables: &CableNames) -> String {
        let of = match self.subject() {
            Subject::Cable(place) => cables.words(usize::from(place)),
            Subject::Arm | Subject::Bus(_) | Subject::Operator => String::new(),
        };
        match *self {
            Self::DriveFault { cause, .. } => format!("the drive of {of}: {}", cause_text(cause)),
            Self::DrivesNotUp { after_s } => format!("the drives did not come up within {after_s:.1} s"),
            Self::BusLost { bus } => format!("bus {bus} does not answer"),
            Self::EncoderSilent { age_s, .. } => {
                format!("the encoder of {of} has been silent for {age_s:.3} s")
            }
            Self::EncoderJump { step_m, .. } => format!("the encoder of {of} jumped by {step_m:.4} m"),
            Self::EncoderStuck { motion_m, .. } => {
                format!("the encoder of {of} sticks while the model moves the cable by {motion_m:.4} m")
            }
            Self::TensionError { error_n, .. } => {
                format!("the drive of {of} measures {error_n:+.2} N beyond the tension it was told")
            }
            Self::EmergencyStop { source: Self::SERVICE } => "an operator's emergency stop is pressed".to_owned(),
            Self::EmergencyStop { .. } => format!("the emergency stop at the drive of {of} is pressed"),
            Self::CableLength { error_m, factor, unsure, .. } => {
                let which = if unsure { ", or another of its segment," } else { "" };
                let motion = match factor.is_finite() {
                    true => format!("; it shows {factor:.2} times their motion"),
                    false => String::new(),
                };
                format!("the encoder of {of}{which} is {:.2} mm off the other cables{motion}", 1e3 * error_m)
            }
            Self::CablePull { factor, .. } => {
                format!("{of} pulls {factor:.2} times what its drive was told")
            }
            Self::InnovationBound { innovation_rad } => {
                format!("model and measured cable lengths disagree by {innovation_rad:.3} rad")
            }
            Self::InnovationGrowth { growth_rad } => {
                format!("model and measured cable lengths drifted apart by {growth_rad:.3} rad within the window")
            }
            Self::NotSettled { after_s } => format!("the observer did not settle within {after_s:.1} s"),
            Self::TensionNotFinite { .. } => format!("the planned tension of {of} is not a number"),
            Self::TensionOutside { tension_n, .. } => {
                format!("the planned tension of {of}, {tension_n:.6} N, lies outside its box")
            }
            Self::PlanSingular { count } => format!("the planner failed {count} times in a row"),
            Self::Overruns { count } => format!("{count} deadlines missed"),
            Self::TipSpeed { speed_mps } => format!("the tip moves at {speed_mps:.3} m/s"),
            Self::BendRate { rate_radps } => format!("a segment bends at {rate_radps:.3} rad/s"),
            Self::Swinging { swing_m } => format!("the tip swings by {:.1} mm", 1e3 * swing_m),
            Self::Saturated { time_s, .. } => {
                format!("the tension of {of} has been at its limit for {time_s:.1} s")
            }
            Self::DrivesLost | Self::NoStart | Self::EstimateLost | Self::TargetNotFinite => self.what().to_owned(),
        }
    }
}

/// For those who have no arm at hand: cables by their places.
impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.in_words(&CableNames::default()))
    }
}
