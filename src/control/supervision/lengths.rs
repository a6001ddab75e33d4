//! A cable against the others of its segment: what its encoder shows must fit the bend that all of them tell.
//!
//! Two bend angles a segment are fewer than its cables. With `J` the straight arm's length Jacobian and `T^T` its
//! pseudo-inverse, `r = (1 - J T^T)(l - l_model)` is what no bend explains: neither a wrong stiffness nor friction, a load or a
//! wrong tension changes it, for it is geometry alone. An error `delta` of cable `c` leaves `r_c = (1 - P_cc) delta` there and
//! less at every other cable, so the cable names itself: `delta = r_c / (1 - P_cc)` explains most of `|r|^2`. Three cables
//! have one such number, which tells that one of them lies but not which.
//!
//! The arm's chords are shorter than its curve, by `theta^2/24` of an element that bends by theta, and by how much they are is
//! known no better than the curve between two disks: so much is borne beside the limit.

use crate::estimator::CableSpace;
use crate::model::Arm;

/// Share of what no bend explains that one cable must explain.
const EXPLAINED: f64 = 0.7;
/// Another cable that explains this share of it as well cannot be told from it.
const AS_WELL: f64 = 0.9;
/// An error at the start, which may be one of the reference, is borne up to so many times the limit.
const START_SHARE: f64 = 30.0;
/// A cable without this share of its error in what no bend explains cannot be judged.
const OWN_MIN: f64 = 0.05;
/// Time for which a finding must last (s); of an encoder that stands still, which its guard may find to stick before.
const LASTS_S: f64 = 0.1;
const STUCK_S: f64 = 3.0;
/// An encoder that shows the same for so long stands still (s).
const STILL_S: f64 = 0.05;

/// A cable whose encoder does not fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrongLength {
    /// Cable (0-based).
    pub cable: u16,
    /// What it shows beyond the others (m).
    pub error_m: f64,
    /// Motion that it shows over the one that the others tell; NaN where none is known.
    pub factor: f64,
    /// Another cable of the segment would explain it as well.
    pub unsure: bool,
}

/// The check of one arm. [`LengthCheck::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct LengthCheck {
    space: CableSpace,
    /// 1 - P_cc.
    own: Vec<f64>,
    /// First cable and number of cables of each segment.
    segments: Vec<(usize, usize)>,
    limit_m: f64,
    straight_m: Vec<f64>,
    /// Length and number of elements of each segment.
    elements: Vec<(f64, f64)>,
    difference: Vec<f64>,
    zeros: Vec<f64>,
    angles: Vec<f64>,
    residual: Vec<f64>,
    /// Whether there was a start, with its residual and lengths.
    started: bool,
    base_residual: Vec<f64>,
    base_m: Vec<f64>,
    base_chords_m: f64,
    /// Newest reading of each cable (m), and for how long it has been the same (s).
    last_m: Vec<f64>,
    still_s: Vec<f64>,
    suspect: Option<u16>,
    lasted_s: f64,
    evidence: f64,
}

impl LengthCheck {
    /// For an arm and a limit (m). Allocates.
    pub fn new(arm: &Arm, limit_m: f64) -> Self {
        let space = CableSpace::new(arm);
        let cables = arm.cable_count();
        let own = (0..cables)
            .map(|c| 1.0 - space.row(c).iter().zip(space.lever(c)).map(|(t, j)| t * j).sum::<f64>())
            .collect();
        let mut straight_m = vec![0.0; cables];
        arm.cable_lengths_into(&arm.straight(), &mut straight_m);
        Self {
            own,
            segments: segments_of(&space, arm),
            limit_m,
            difference: vec![0.0; cables],
            zeros: vec![0.0; cables],
            angles: vec![0.0; space.angle_count()],
            residual: vec![0.0; cables],
            started: false,
            base_residual: vec![0.0; cables],
            base_m: straight_m.clone(),
            base_chords_m: 0.0,
            straight_m,
            elements: arm
                .segment_elements
                .iter()
                .enumerate()
                .map(|(s, e)| (arm.segment_length(s), e.len() as f64))
                .collect(),
            last_m: vec![f64::NAN; cables],
            still_s: vec![0.0; cables],
            suspect: None,
            lasted_s: 0.0,
            evidence: 0.0,
            space,
        }
    }

    /// Forgets where the cables were: the next check is the start.
    pub fn restart(&mut self) {
        self.started = false;
        self.suspect = None;
        self.lasted_s = 0.0;
        self.evidence = 0.0;
    }

    /// Largest error of a cable over the limit, whether it lasts or not: what a study looks at.
    pub const fn evidence(&self) -> f64 {
        self.evidence
    }

    /// One tick of `h` seconds: `lengths_m` as measured, `model_m` those of the estimate (m). Does not allocate.
    pub fn check(&mut self, h: f64, lengths_m: &[f64], model_m: &[f64]) -> Option<WrongLength> {
        for ((still_s, last), l) in self.still_s.iter_mut().zip(&mut self.last_m).zip(lengths_m) {
            *still_s = if last == l { *still_s + h } else { 0.0 };
            *last = *l;
        }
        for ((d, l), m) in self.difference.iter_mut().zip(lengths_m).zip(model_m) {
            *d = l - m;
        }
        self.space.angles_into(&self.difference, &self.zeros, &mut self.angles);
        for c in 0..self.residual.len() {
            let bent: f64 = self.space.lever(c).iter().zip(&self.angles).map(|(j, a)| j * a).sum();
            self.residual[c] = self.difference[c] - bent;
        }
        let chords_m = self.chords_m(model_m);
        if !self.started {
            self.started = true;
            self.base_chords_m = 0.0;
            self.base_residual.fill(0.0);
            self.base_m.copy_from_slice(&self.straight_m);
            // Such an error is no reference that is a little off: it counts from the straight arm on.
            let (error, _) = self.worst();
            if error < START_SHARE * self.limit_m {
                self.base_residual.copy_from_slice(&self.residual);
                self.base_m.copy_from_slice(lengths_m);
                self.base_chords_m = chords_m;
            }
        }
        for (r, base) in self.residual.iter_mut().zip(&self.base_residual) {
            *r -= base;
        }
        let (error, found) = self.worst();
        let borne_m = self.limit_m + chords_m.max(self.base_chords_m);
        self.evidence = error / borne_m;
        let beyond = found.filter(|_| error > borne_m);
        let cable = beyond.map(|f| f.cable);
        self.lasted_s = if cable.is_some() && cable == self.suspect { self.lasted_s + h } else { 0.0 };
        self.suspect = cable;
        let mut found = beyond?;
        let shown = lengths_m[usize::from(found.cable)] - self.base_m[usize::from(found.cable)];
        let moved = shown - found.error_m;
        let still = self.still_s[usize::from(found.cable)] > STILL_S;
        let lasts_s = if still { STUCK_S } else { LASTS_S };
        if self.lasted_s < lasts_s {
            return None;
        }
        // Less motion than the limit tells no factor.
        found.factor = if moved.abs() > self.limit_m { shown / moved } else { f64::NAN };
        Some(found)
    }

    /// By how much the chords of the bent arm are shorter than its curve (m), all segments together.
    fn chords_m(&mut self, model_m: &[f64]) -> f64 {
        for ((d, l), straight) in self.difference.iter_mut().zip(model_m).zip(&self.straight_m) {
            *d = l - straight;
        }
        self.space.angles_into(&self.difference, &self.zeros, &mut self.angles);
        let of = |(&(length, n), a): (&(f64, f64), &[f64])| length * (a[0] * a[0] + a[1] * a[1]) / (24.0 * n * n);
        self.elements.iter().zip(self.angles.chunks_exact(2)).map(of).sum()
    }

    /// The cable with the largest error that explains what no bend explains, and that error (m).
    fn worst(&self) -> (f64, Option<WrongLength>) {
        let mut worst = (0.0, None);
        for &(first, count) in &self.segments {
            let all: f64 = self.residual[first..first + count].iter().map(|r| r * r).sum();
            let explained = |c: usize| if self.own[c] > OWN_MIN { self.residual[c].powi(2) / self.own[c] } else { 0.0 };
            let (mut best, mut next) = ((0.0, first), 0.0f64);
            for c in first..first + count {
                let e = explained(c);
                if e > best.0 {
                    next = best.0;
                    best = (e, c);
                } else {
                    next = next.max(e);
                }
            }
            if best.0 <= EXPLAINED * all || best.0 <= 0.0 {
                continue;
            }
            let error_m = self.residual[best.1] / self.own[best.1];
            if error_m.abs() > worst.0 {
                let unsure = next > AS_WELL * best.0;
                let found = WrongLength { cable: best.1 as u16, error_m, factor: f64::NAN, unsure };
                worst = (error_m.abs(), Some(found));
            }
        }
        worst
    }
}

/// First cable and number of cables of each segment: a cable belongs to the last one that it acts on.
pub(super) fn segments_of(space: &CableSpace, arm: &Arm) -> Vec<(usize, usize)> {
    let last = |c: usize| space.lever(c).iter().rposition(|j| *j != 0.0).map_or(0, |i| i / 2);
    (0..arm.segment_count())
        .map(|s| {
            let mut own = (0..arm.cable_count()).filter(|c| last(*c) == s);
            own.next().map_or((0, 0), |first| (first, 1 + own.count()))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ArmConfig;

    /// Lengths of an arm of the paper that bends its second segment, as the encoders show them and as the estimate, which
    /// follows the encoders, has them.
    fn bent(arm: &Arm, bend: f64) -> Vec<f64> {
        let mut curvatures = vec![0.0; 2 * arm.segment_count()];
        curvatures[2] = bend / 0.65;
        let mut lengths = vec![0.0; arm.cable_count()];
        arm.cable_lengths_into(&arm.bent(&curvatures), &mut lengths);
        lengths
    }

    fn run(cables: usize, wrong: impl Fn(&mut [f64], &[f64])) -> Option<(WrongLength, usize)> {
        let mut config = ArmConfig::paper();
        for segment in &mut config.segments {
            segment.hole_angles_rad =
                (0..cables).map(|c| 0.5 + c as f64 * std::f64::consts::TAU / cables as f64).collect();
        }
        let arm = Arm::new(&config);
        let mut check = LengthCheck::new(&arm, 1e-3);
        let straight = bent(&arm, 0.0);
        for k in 0..200 {
            let model = bent(&arm, 0.002 * k as f64);
            let mut shown = model.clone();
            wrong(&mut shown, &straight);
            if let Some(found) = check.check(0.01, &shown, &model) {
                return Some((found, k));
            }
        }
        None
    }

    #[test]
    fn a_sound_arm_is_not_named_however_it_moves() {
        assert_eq!(run(6, |_, _| ()), None);
        // Nor one whose bend the model misses, in whatever direction.
        assert_eq!(run(6, |l, s| l.iter_mut().zip(s).for_each(|(l, s)| *l = s + 1.1 * (*l - s))), None);
    }

    #[test]
    fn a_cable_that_shows_another_motion_is_named_with_its_factor() {
        for factor in [-1.0, 0.25, 0.5, 2.0, 4.0] {
            let (found, k) = run(6, |l, s| l[7] = s[7] + factor * (l[7] - s[7])).expect("found");
            assert_eq!(found.cable, 7, "{factor}");
            assert!((found.factor - factor).abs() < 0.1, "{factor}: {found:?}");
            assert!(!found.unsure && k < 100, "{factor}: {found:?} at {k}");
        }
    }

    #[test]
    fn three_cables_tell_that_one_lies_and_do_not_pretend_to_know_which() {
        let (found, _) = run(3, |l, s| l[4] = s[4] - (l[4] - s[4])).expect("found");
        assert!((3..6).contains(&found.cable) && found.unsure, "{found:?}");
    }
}
