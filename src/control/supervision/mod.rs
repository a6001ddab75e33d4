//! What is watched while the arm holds or moves, is raised or lowered, beside its encoders: speed, rates, swing, saturation, tensions against
//! commands, cables against each other and against what the arm does.
//!
//! Enters: the estimate, the reference, tensions and lengths of the tick. Leaves: limits that act, faults, and whether the
//! reference is to slow down or the arm to hold, each as `[supervision]` declares it. It never decides on the mode itself, keeps
//! no clock and after [`Supervision::new`] never allocates.

mod lengths;
mod pulls;
mod swing;
mod tensions;

pub use lengths::{LengthCheck, WrongLength};
pub use pulls::{PullCheck, WrongPull};
pub use swing::Swing;
pub use tensions::{TensionCheck, WrongTension};

use super::fault::{Fault, FaultList, Limit, Limits};
use crate::config::{ArmConfig, SupervisionAnswer, SupervisionConfig};
use crate::model::Arm;
use nalgebra::Vector3;

/// Pace of the reference where something asks to slow down.
pub const SLOW_PACE: f64 = 0.25;
/// An arm that swings by so many times the limit tells nothing of its tensions.
const WILD: f64 = 2.0;
/// A tension counts as saturated within this share of its range below the limit.
const SATURATED: f64 = 1e-3;

/// What a tick shows.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// Time since the tick before (s).
    pub h: f64,
    /// Estimated position of the tip (m).
    pub tip: Vector3<f64>,
    /// What the estimate lacks of the tip (m), where that is measured.
    pub unseen: Option<Vector3<f64>>,
    /// The reference's (m).
    pub reference_tip: Vector3<f64>,
    /// Speed of the tip (m/s).
    pub tip_speed_mps: f64,
    /// Mean curvatures (1/m) and their rates, two a segment.
    pub curvatures: &'a [f64],
    /// As named.
    pub curvature_rates: &'a [f64],
    /// Tensions that act along the cables' routes (N).
    pub sent_n: &'a [f64],
    /// Tensions that the drums were told in the tick before (N).
    pub commanded_n: &'a [f64],
    /// Tensions that the drives measure (N); empty for none, NaN where not valid.
    pub measured_n: &'a [f64],
    /// How long ago they were measured (ticks).
    pub measured_age_ticks: f64,
    /// Cable lengths as measured (m).
    pub lengths_m: &'a [f64],
    /// Cable lengths of the estimate (m).
    pub model_m: &'a [f64],
    /// The observer's disturbance and correction (N m), two a segment; empty for none.
    pub disturbance_nm: &'a [f64],
    /// As named.
    pub correction_nm: &'a [f64],
}

/// What is asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Verdict {
    /// Limits that act.
    pub limits: Limits,
    /// The reference is to slow down.
    pub slow: bool,
    /// The arm is to hold, because of this.
    pub hold: Option<Limit>,
}

/// The supervision of one arm.
#[derive(Debug, Clone)]
pub struct Supervision {
    settings: SupervisionConfig,
    /// Length of the segment of each curvature (m).
    length_m: Vec<f64>,
    /// Each cable's tension from which on it is saturated (N).
    saturated_n: Vec<f64>,
    speeding_s: f64,
    bending_s: f64,
    saturated_s: Vec<f64>,
    swing: Swing,
    swing_m: f64,
    tensions: TensionCheck,
    lengths: LengthCheck,
    pulls: PullCheck,
}

impl Supervision {
    /// For an arm, with what the loop's latency adds to a command's way, and by how much the reference is ahead of the arm
    /// (ticks). Allocates.
    pub fn new(
        arm: &Arm,
        config: &ArmConfig,
        settings: &SupervisionConfig,
        latency_ticks: usize,
        ahead_ticks: usize,
    ) -> Self {
        let cables = arm.cable_count();
        let range_n = config.tension_n_max - config.tension_n_min;
        Self {
            settings: *settings,
            length_m: config.segments.iter().flat_map(|s| [s.length_m; 2]).collect(),
            saturated_n: config.tension_maxima_n().iter().map(|n| n - SATURATED * range_n).collect(),
            speeding_s: 0.0,
            bending_s: 0.0,
            saturated_s: vec![0.0; cables],
            swing: Swing::new(ahead_ticks),
            swing_m: 0.0,
            tensions: TensionCheck::new(cables, settings.tension_error_n, settings.tension_error_s, latency_ticks),
            lengths: LengthCheck::new(arm, settings.length_error_m),
            pulls: PullCheck::new(arm, config, settings.pull_error),
        }
    }

    /// The estimated tip beside the reference's of as long ago as that is ahead of the arm (m, base frame).
    pub const fn tip_beside_m(&self) -> Vector3<f64> {
        self.swing.beside()
    }

    /// Swing of the tip that there may be, peak to peak (m).
    pub const fn swing_m(&self) -> f64 {
        self.swing_m
    }

    /// Evidence against a cable's length and pull, each over its limit: for studies.
    pub const fn evidence(&self) -> [f64; 2] {
        [self.lengths.evidence(), self.pulls.evidence()]
    }

    /// Forgets what was seen: where a motion begins that has nothing to do with what was before.
    pub fn restart(&mut self) {
        (self.speeding_s, self.bending_s, self.swing_m) = (0.0, 0.0, 0.0);
        self.saturated_s.fill(0.0);
        self.swing.restart();
        self.tensions.restart();
        self.lengths.restart();
        self.pulls.restart();
    }

    /// One tick while the arm holds or moves; faults are added to `faults`. Does not allocate.
    pub fn check(&mut self, seen: &Seen<'_>, faults: &mut FaultList) -> Verdict {
        let s = self.settings;
        let mut verdict = Verdict::default();
        let lasts = |since_s: &mut f64, beyond: bool| {
            *since_s = if beyond { *since_s + seen.h } else { 0.0 };
            *since_s
        };
        let fast = seen.tip_speed_mps.is_nan() || seen.tip_speed_mps > s.tip_speed_mps;
        if lasts(&mut self.speeding_s, fast) > s.motion_time_s {
            let fault = Fault::TipSpeed { speed_mps: seen.tip_speed_mps };
            verdict.answer(s.tip_speed_answer, Limit::TipSpeed, fault, faults);
        }
        let rate = seen.curvature_rates.iter().zip(&self.length_m).map(|(k, l)| (k * l).abs()).fold(0.0, f64::max);
        if lasts(&mut self.bending_s, rate > s.bend_rate_radps) > s.motion_time_s {
            verdict.answer(s.bend_rate_answer, Limit::BendRate, Fault::BendRate { rate_radps: rate }, faults);
        }
        let shown_m;
        (shown_m, self.swing_m) = self.swing.follow(seen.h, &seen.tip, seen.unseen.as_ref(), &seen.reference_tip);
        if self.swing_m > s.swing_m {
            verdict.answer(s.swing_answer, Limit::Swinging, Fault::Swinging { swing_m: self.swing_m }, faults);
        }
        let commanded = seen.commanded_n.iter().zip(&self.saturated_n);
        for (cable, (since_s, (u, most))) in self.saturated_s.iter_mut().zip(commanded).enumerate() {
            if lasts(since_s, u >= most) > s.saturation_s {
                let fault = Fault::Saturated { cable: cable as u16, time_s: *since_s };
                verdict.answer(s.saturation_answer, Limit::Saturated, fault, faults);
            }
        }
        if let Some(WrongTension { cable, error_n }) =
            self.tensions.check(seen.h, seen.commanded_n, seen.measured_n, seen.measured_age_ticks)
        {
            verdict.answer(s.tension_error_answer, Limit::TensionError, Fault::TensionError { cable, error_n }, faults);
        }
        if let Some(wrong) = self.lengths.check(seen.h, seen.lengths_m, seen.model_m) {
            let WrongLength { cable, error_m, factor, unsure } = wrong;
            let fault = Fault::CableLength { cable, error_m, factor, unsure };
            verdict.answer(s.cable_answer, Limit::CableSuspect, fault, faults);
        }
        if shown_m > WILD * s.swing_m {
            self.pulls.restart();
        } else if let ([_, ..], [_, ..]) = (seen.disturbance_nm, seen.correction_nm) {
            let beside = |i: usize| seen.disturbance_nm[i] + seen.correction_nm[i];
            let found = self.pulls.check(seen.h, seen.sent_n, beside, seen.curvatures, seen.curvature_rates);
            if let Some(WrongPull { cable, factor }) = found {
                verdict.answer(s.cable_answer, Limit::CableSuspect, Fault::CablePull { cable, factor }, faults);
            }
        }
        verdict
    }
}

impl Verdict {
    fn answer(&mut self, answer: SupervisionAnswer, limit: Limit, fault: Fault, faults: &mut FaultList) {
        self.limits.insert(limit);
        self.slow |= answer >= SupervisionAnswer::Slow;
        if answer >= SupervisionAnswer::Hold {
            self.hold.get_or_insert(limit);
        }
        if answer == SupervisionAnswer::Stop {
            faults.push(fault);
        }
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
