//! How the estimate follows the arm: readings are judged, the estimator takes them over, and a start goes on by what it knows.

use super::{Cycle, Plan, TickInputs};
use crate::control::estimator::Estimator;
use crate::control::fault::{Fault, FaultList, Limit, Limits};
use crate::control::guard::{EncoderReadings, Watch};
use crate::control::supervisor::{DrivesPhase, Mode, Progress};

impl<E: Estimator, P: Plan> Cycle<E, P> {
    /// Judges the readings; in modes that use them, their faults count.
    pub(super) fn watch_encoders(
        &mut self,
        inputs: &TickInputs<'_>,
        periods: u32,
        faults: &mut FaultList,
        limits: &mut Limits,
    ) {
        let model = if self.observing {
            let state = self.estimator.state();
            self.arm.cable_lengths_into(&state.q, &mut self.model_lengths);
            if periods > 1 {
                // The model is a period behind the readings as a rule, and now by more: it goes on at its rates.
                let ahead_s = 1e-9 * (u64::from(periods - 1) * self.period_ns) as f64;
                self.arm.cable_rates_into(&state.q, &state.qd, &mut self.model_rates);
                self.model_lengths.iter_mut().zip(&self.model_rates).for_each(|(l, rate)| *l += ahead_s * rate);
            }
            Some(&self.model_lengths[..])
        } else {
            None
        };
        // While the drives come up readings may be missing; the start waits for them.
        let rises = self.supervisor.mode() == Mode::Disarmed || self.supervisor.is_starting();
        let watch = if self.observing && self.is_settling() {
            Watch::Settling
        } else if self.observing || !rises {
            Watch::All
        } else {
            Watch::Nothing
        };
        let torque = inputs.drives.phase == DrivesPhase::Enabled;
        for (c, (along, drum)) in self.read_m.iter_mut().zip(inputs.encoders.lengths_m).enumerate() {
            *along = self.arm.along_arm(c, *drum, if torque { self.sent[c] } else { 0.0 });
        }
        let told = inputs.encoders.lengths_m.len().min(self.read_m.len());
        let readings = EncoderReadings { lengths_m: &self.read_m[..told], ..inputs.encoders };
        self.encoders.check(&readings, inputs.now_ns, model, watch, faults);
        if self.observing && self.encoders.bridged().0 != 0 {
            limits.insert(Limit::EncoderBridged);
        }
    }

    /// Starts or advances the estimate; how far the start has come.
    pub(super) fn follow(&mut self, inputs: &TickInputs<'_>, periods: u32, faults: &mut FaultList) -> Progress {
        // Torque acts only where the drives give it.
        let torque = inputs.drives.phase == DrivesPhase::Enabled;
        self.applied.copy_from_slice(if torque { &self.sent } else { &self.zeros });
        if self.observing {
            // A bridged length counts as read: it keeps its cable's innovation as it was. Left out, the other cables of the
            // segment would have to tell its bend, and their lengths' own errors give another one: each lost reading
            // would kick the estimate (at a loss of 1 % it never settled). The gap ends with `encoder_silent_s`.
            match self.estimator.update(&self.applied, self.encoders.lengths_m(), periods) {
                Ok(estimate) if self.estimator.state().is_finite() && self.estimator.predicted().is_finite() => {
                    self.estimate = estimate;
                    if !self.is_settling() {
                        let (z, growth) = (estimate.innovation_max_rad, estimate.innovation_growth_rad);
                        if !z.is_finite() {
                            faults.push(Fault::EstimateLost);
                        } else if estimate.beyond_bound {
                            faults.push(Fault::InnovationBound { innovation_rad: z });
                        } else if estimate.growing {
                            faults.push(Fault::InnovationGrowth { growth_rad: growth });
                        }
                    }
                }
                _ => faults.push(Fault::EstimateLost),
            }
        } else {
            self.elapsed.settle();
        }
        if !self.supervisor.is_starting() || !torque {
            return Progress::Drives;
        }
        if self.supervisor.is_planning() {
            let arrived = self.governor.has_arrived(self.postures.start()) || self.governor.is_stuck();
            return if arrived { Progress::Done } else { Progress::Posture };
        }
        let silent = if self.observing { None } else { self.encoders.silent(inputs.now_ns) };
        if silent.is_none() {
            self.postures.choose(self.encoders.lengths_m());
        }
        if self.postures.tensions_n().is_none_or(|start| self.sent != start) {
            return match silent {
                Some((cable, age_s)) if self.postures.tensions_n().is_none() => Progress::Encoder(cable, age_s),
                _ => Progress::Tensions,
            };
        }
        if let Some((cable, age_s)) = silent {
            return Progress::Encoder(cable, age_s);
        }
        if !self.observing {
            match self.estimator.start(self.encoders.lengths_m(), &self.applied) {
                Ok(()) if self.estimator.state().is_finite() => {
                    self.observing = true;
                    self.estimate.settled = false;
                    self.encoders.restart(inputs.now_ns);
                }
                _ => faults.push(Fault::NoStart),
            }
            return Progress::Settling;
        }
        match self.estimate.settled {
            false => Progress::Settling,
            true if self.postures.is_to_raise() => Progress::Posture,
            true => Progress::Done,
        }
    }

    /// Whether the estimate has only begun. Until it has settled its own transient is no fault; the time-out is.
    fn is_settling(&self) -> bool {
        self.supervisor.is_starting() && !self.supervisor.is_planning()
    }

    pub(super) fn measure_curvatures(&mut self) {
        let state = self.estimator.state();
        let count = 2 * self.arm.segment_count();
        self.arm.curvatures_into(
            &state.q,
            &state.qd,
            &mut self.curvatures[..count],
            &mut self.curvature_rates[..count],
        );
    }
}
