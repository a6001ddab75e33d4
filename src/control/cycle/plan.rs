//! From what a tick wants to a plan: the goal with its weights, the planner that it belongs to, and what a plan that
//! failed leaves.

use super::{Cycle, Plan, TickInputs};
use crate::control::CURVATURES_MAX;
use crate::control::budget::StopWatch;
use crate::control::estimator::Estimator;
use crate::control::fault::{Limit, Limits};
use crate::control::governor::Wish;
use crate::control::target::Target;
use crate::planner::{Goal, Inputs, LedTo, Report, Status};
use crate::posture::Surroundings;
use nalgebra::{Vector3, Vector4};
use rand_xoshiro::Xoshiro256PlusPlus;

/// What a plan is made for.
pub(super) enum Wanted {
    Tip {
        position: Vector3<f64>,
        quaternion: Vector4<f64>,
    },
    Shape {
        curvatures: [f64; CURVATURES_MAX],
    },
    /// To come to rest and stay.
    Rest,
}

impl Wanted {
    /// A shape of these mean curvatures (1/m).
    pub(super) fn shape(curvatures_1pm: &[f64]) -> Self {
        let mut curvatures = [0.0; CURVATURES_MAX];
        curvatures.iter_mut().zip(curvatures_1pm).for_each(|(to, from)| *to = *from);
        Self::Shape { curvatures }
    }
}

impl<E: Estimator, P: Plan> Cycle<E, P> {
    /// The target at the end of lookahead and lead.
    pub(super) fn wanted(&self, inputs: &TickInputs<'_>) -> Option<Wanted> {
        let target = inputs.target?;
        let ahead = target.ahead.unwrap_or_else(|| target.now.extrapolated(self.lead_s));
        Some(match ahead {
            Target::Tip { position_m, quaternion, .. } => {
                Wanted::Tip { position: position_m, quaternion: quaternion.normalize() }
            }
            Target::Shape { curvatures_1pm, .. } => Wanted::Shape { curvatures: curvatures_1pm },
        })
    }

    pub(super) fn plan(
        &mut self,
        inputs: &TickInputs<'_>,
        wanted: &Wanted,
        limits: &mut Limits,
        rng: &mut Xoshiro256PlusPlus,
        deadline: &mut impl StopWatch,
    ) -> Report {
        let count = 2 * self.arm.segment_count();
        let wish = match wanted {
            Wanted::Tip { position, quaternion } => Wish::Tip { position: *position, quaternion: *quaternion },
            Wanted::Shape { curvatures } => Wish::Shape(&curvatures[..count]),
            Wanted::Rest => Wish::Rest,
        };
        let around = Surroundings {
            now: inputs.obstacles.now(),
            ahead: inputs.obstacles.ahead(),
            span_s: self.settings.planner.lookahead_s,
            beyond_s: self.lead_s - self.latency_s - self.settings.planner.lookahead_s,
        };
        let around = self.settings.planner.avoidance.then_some(&around);
        let period_s = self.settings.timing.period_s;
        let q = &self.estimator.predicted().q;
        let (lasting_m, lacks_m) = (self.tip_sensor.bias_m(), self.tip_sensor.difference_m());
        self.governor.see_tip(self.supervision.tip_beside_m(), lasting_m, lacks_m);
        self.governor.set_swing(self.supervision.swing_m());
        self.governor.advance(period_s, &wish, q, &self.curvatures[..count], around);
        if self.governor.is_blocked() {
            limits.insert(Limit::Blocked);
        }
        if self.governor.is_out_of_reach() {
            limits.insert(Limit::OutOfReach);
        }
        let goal = Goal::Shape {
            curvatures: self.governor.command(),
            weight: self.steering.curvature,
            rate: self.steering.rate,
        };
        let report = self.planner.plan(
            &Inputs {
                state: self.estimator.predicted(),
                u_previous: &self.sent,
                disturbance: self.estimator.disturbance_n(),
                goal,
                now: inputs.obstacles.now(),
                ahead: inputs.obstacles.ahead(),
                led_to: Some(LedTo {
                    coordinates: self.governor.reference_coordinates(),
                    doubt_m: self.governor.doubt_m(),
                }),
            },
            rng,
            deadline,
        );
        if report.status == Status::Singular {
            self.singular_in_row += 1;
            limits.insert(Limit::PlanSingular);
            self.proposed.copy_from_slice(&self.sent);
        } else {
            self.singular_in_row = 0;
            self.proposed.copy_from_slice(self.planner.tensions());
            if let Some(planned) = self.planner.planned() {
                self.friction.update(&self.arm, self.estimator.predicted(), planned);
            }
        }
        if report.status == Status::BudgetSpent {
            limits.insert(Limit::BudgetSpent);
        }
        if report.relaxed {
            limits.insert(Limit::Relaxed);
        }
        report
    }
}
