//! What the supervision sees of a tick, and what becomes of its verdict.

use super::{Cycle, Plan, TickInputs};
use crate::control::estimator::Estimator;
use crate::control::fault::{FaultList, Limit, Limits};
use crate::control::supervision::{SLOW_PACE, Seen, Verdict};
use crate::control::supervisor::Mode;
use crate::model::Outputs;

impl<E: Estimator, P: Plan> Cycle<E, P> {
    /// What a tip sensor says of the estimate.
    pub(super) fn measure_tip(
        &mut self,
        inputs: &TickInputs<'_>,
        tip: Option<&Outputs>,
        periods: u32,
        limits: &mut Limits,
    ) {
        let Some(tip) = tip else {
            self.tip_sensor.restart();
            return;
        };
        let h = f64::from(periods) * self.settings.timing.period_s;
        self.tip_sensor.follow(h, &tip.position, inputs.encoders.capture_ns, inputs.tip.as_ref(), inputs.now_ns);
        if self.tip_sensor.doubted_m().is_some() {
            limits.insert(Limit::TipDoubted);
        }
    }

    /// Watches motion, tensions and cables while the loop plans, also on the way up and down.
    pub(super) fn supervise(
        &mut self,
        inputs: &TickInputs<'_>,
        tip: Option<&Outputs>,
        periods: u32,
        faults: &mut FaultList,
    ) -> Verdict {
        let stops = matches!(self.supervisor.mode(), Mode::Stopping | Mode::Faulted);
        self.governor.set_scale(if stops { 1.0 } else { self.speed_scale });
        let Some(tip) = tip.filter(|_| self.supervisor.is_planning()) else {
            self.governor.set_pace(1.0);
            return Verdict::default();
        };
        self.arm.cable_lengths_into(&self.estimator.state().q, &mut self.model_lengths);
        let count = 2 * self.arm.segment_count();
        let age_ns = inputs.now_ns.saturating_sub(inputs.encoders.capture_ns);
        let seen = Seen {
            h: f64::from(periods) * self.settings.timing.period_s,
            tip: tip.position,
            unseen: self.tip_sensor.difference_m(),
            reference_tip: self.governor.reference_tip(),
            tip_speed_mps: tip.velocity.norm(),
            curvatures: &self.curvatures[..count],
            curvature_rates: &self.curvature_rates[..count],
            sent_n: &self.sent,
            commanded_n: &self.commanded,
            measured_n: inputs.tensions_measured_n,
            measured_age_ticks: age_ns as f64 / self.period_ns as f64,
            lengths_m: self.encoders.lengths_m(),
            model_m: &self.model_lengths,
            disturbance_nm: self.estimator.disturbance_nm(),
            correction_nm: self.estimator.correction_nm(),
        };
        let verdict = self.supervision.check(&seen, faults);
        self.governor.set_pace(if verdict.slow { SLOW_PACE } else { 1.0 });
        verdict
    }
}
