//! Where cables stay at a fault: each at the tension of the last moments without what was swinging, or at the safe one, as it is
//! declared to (`safe_hold`).
//!
//! The cables of a drive that gives no torque any more leave the arm's moments to the others: of all changes that give the bending
//! moments of every segment again, `J^T du = u_lost j_lost`, the one of least norm, `du = J (J^T J)^-1 m` over the cables left; a
//! cable that it would take out of its range stays at the bound, and the others are asked again.

use crate::config::SafeHold;
use crate::control::fault::Fault;
use crate::estimator::CableSpace;
use crate::model::Arm;

/// Tensions of held cables. [`Stay::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub(super) struct Stay {
    holds: Vec<SafeHold>,
    space: CableSpace,
    /// Share of a tick in the mean.
    share: f64,
    tensions_n: Vec<f64>,
    /// Cables whose drives give no torque, and those that are at a bound for it.
    lost: Vec<bool>,
    bound: Vec<bool>,
    moments_nm: Vec<f64>,
    change_n: Vec<f64>,
}

impl Stay {
    /// For an arm, its cables' `safe_hold` and the share of a tick in the mean tension. Allocates.
    pub(super) fn new(arm: &Arm, holds: &[SafeHold], share: f64) -> Self {
        let cables = arm.cable_count();
        let space = CableSpace::new(arm);
        Self {
            holds: holds.to_vec(),
            share,
            tensions_n: vec![0.0; cables],
            lost: vec![false; cables],
            bound: vec![false; cables],
            moments_nm: vec![0.0; space.angle_count()],
            change_n: vec![0.0; cables],
            space,
        }
    }

    /// A tick in which drums were told `commanded_n` (N): what swings is left out where the loop plans.
    pub(super) fn remember(&mut self, plans: bool, commanded_n: &[f64]) {
        let share = if plans { self.share } else { 1.0 };
        self.tensions_n.iter_mut().zip(commanded_n).for_each(|(stay, u)| *stay += share * (u - *stay));
    }

    /// The hold begins: cables that are declared to go to `safe_n` (N), and all drives give torque.
    pub(super) fn begin(&mut self, safe_n: &[f64]) {
        for ((stay, hold), safe) in self.tensions_n.iter_mut().zip(&self.holds).zip(safe_n) {
            *stay = if hold.stays() { *stay } else { *safe };
        }
        self.lost.fill(false);
    }

    /// Tells the others what a drive in fault leaves to them, within their range from `low_n` to `maxima_n` (N).
    pub(super) fn take_over(&mut self, fault: Option<(u16, u32)>, low_n: f64, maxima_n: &[f64]) {
        let Some((cable, cause)) = fault.map(|(cable, cause)| (usize::from(cable), cause)) else { return };
        let stays = self.holds.get(cable).is_some_and(|hold| hold.stays());
        if !stays || !Fault::ends_torque(cause) || self.lost[cable] {
            return;
        }
        self.lost[cable] = true;
        let lost_n = std::mem::replace(&mut self.tensions_n[cable], low_n);
        for (m, lever) in self.moments_nm.iter_mut().zip(self.space.lever(cable)) {
            *m = lost_n * lever;
        }
        self.bound.fill(false);
        // Each turn takes a cable out at least.
        for _ in 0..self.tensions_n.len() {
            let (lost, bound, holds) = (&self.lost, &self.bound, &self.holds);
            self.space.select(|c| !lost[c] && !bound[c] && holds[c].stays());
            self.change_n.fill(0.0);
            self.space.add_tensions(&self.moments_nm, &mut self.change_n);
            let mut fits = true;
            for c in 0..self.tensions_n.len() {
                let (u, high) = (self.tensions_n[c], maxima_n[c]);
                let limited = (u + self.change_n[c]).clamp(low_n.min(u), high.max(u));
                if limited != u + self.change_n[c] {
                    for (m, lever) in self.moments_nm.iter_mut().zip(self.space.lever(c)) {
                        *m -= (limited - u) * lever;
                    }
                    self.tensions_n[c] = limited;
                    self.bound[c] = true;
                    fits = false;
                }
            }
            if fits {
                self.tensions_n.iter_mut().zip(&self.change_n).for_each(|(u, change)| *u += change);
                break;
            }
        }
    }

    /// Takes cables that do what a lost one did there without a ramp, for its moments are missing at once: as fast as tensions may
    /// change.
    pub(super) fn hurry(&self, proposed_n: &mut [f64]) {
        if self.has_taken_over() {
            for ((proposed, stay), hold) in proposed_n.iter_mut().zip(&self.tensions_n).zip(&self.holds) {
                *proposed = if hold.stays() { *stay } else { *proposed };
            }
        }
    }

    fn has_taken_over(&self) -> bool {
        self.lost.contains(&true)
    }

    /// Where the cables stay (N).
    pub(super) fn tensions_n(&self) -> &[f64] {
        &self.tensions_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ArmConfig;

    /// Over current (CiA 301).
    const TRIPPED: u32 = 0x2310;

    fn moments(arm: &Arm, u: &[f64], without: Option<usize>) -> Vec<f64> {
        let space = CableSpace::new(arm);
        let mut m = vec![0.0; space.angle_count()];
        for (c, u) in u.iter().enumerate().filter(|(c, _)| Some(*c) != without) {
            m.iter_mut().zip(space.lever(c)).for_each(|(m, lever)| *m += u * lever);
        }
        m
    }

    fn held(arm: &Arm, u: &[f64]) -> Stay {
        let mut stay = Stay::new(arm, &vec![SafeHold::Hold; arm.cable_count()], 0.1);
        stay.remember(false, u);
        stay.begin(&vec![5.0; arm.cable_count()]);
        stay
    }

    #[test]
    fn the_others_give_the_moments_of_a_cable_that_is_lost() {
        let arm = Arm::new(&ArmConfig::paper());
        let maxima = vec![220.0; 24];
        // With room for all of it, and with some at their bounds.
        for low in [20.0, 2.0] {
            let u: Vec<f64> = (0..24).map(|c| low + 3.0 * f64::from(c % 7)).collect();
            for lost in [0, 7, 23] {
                let mut stay = held(&arm, &u);
                stay.take_over(Some((lost, TRIPPED)), 1.0, &maxima);
                let once = stay.tensions_n().to_vec();
                stay.take_over(Some((lost, TRIPPED)), 1.0, &maxima);
                assert!(stay.has_taken_over() && stay.tensions_n() == once, "once");
                let told = stay.tensions_n();
                assert!(told.iter().all(|u| (1.0..=220.0).contains(u)), "{told:?}");
                let lost = usize::from(lost);
                for (now, before) in moments(&arm, told, Some(lost)).iter().zip(moments(&arm, &u, None)) {
                    assert!((now - before).abs() < 1e-9, "{lost}: {now} for {before}");
                }
            }
        }
    }

    #[test]
    fn a_drive_that_keeps_its_torque_leaves_nothing_to_the_others() {
        let arm = Arm::new(&ArmConfig::paper());
        let u: Vec<f64> = (0..24).map(|c| 10.0 + f64::from(c)).collect();
        let mut stay = held(&arm, &u);
        // Heartbeat lost, protocol error, and what the master alone noticed.
        for cause in [0x8130, 0x8210, 7] {
            stay.take_over(Some((3, cause)), 1.0, &[220.0; 24]);
            assert!(!stay.has_taken_over(), "{cause:#x}");
        }
        stay.take_over(None, 1.0, &[220.0; 24]);
        assert_eq!(stay.tensions_n(), u);
    }

    #[test]
    fn what_the_others_cannot_give_is_not_asked_of_them() {
        // Two cables of a segment pull to every side but one.
        let mut config = ArmConfig::paper();
        for segment in &mut config.segments {
            segment.hole_angles_rad = (0..3).map(|c| f64::from(c) * std::f64::consts::TAU / 3.0).collect();
        }
        let arm = Arm::new(&config);
        let mut stay = held(&arm, &[30.0; 12]);
        stay.take_over(Some((0, TRIPPED)), 1.0, &[220.0; 12]);
        assert!(stay.has_taken_over());
        assert!(stay.tensions_n().iter().all(|u| u.is_finite() && (1.0..=220.0).contains(u)), "{stay:?}");
    }
}
