//! From what a tick wants to a plan: the goal with its weights, the planner that it belongs to, and what a plan that
//! failed leaves.

use super::{Cycle, Plan, TickInputs};
use crate::control::CURVATURES_MAX;
use crate::control::budget::StopWatch;
use crate::control::estimator::Estimator;
use crate::control::fault::{Limit, Limits};
use crate::control::target::Target;
use crate::planner::{Goal, Inputs, Report, Status};
use nalgebra::{Vector3, Vector4};
use rand_xoshiro::Xoshiro256PlusPlus;

/// What a plan is made for; a weight of 0 is the configured one.
pub(super) enum Wanted {
    Tip { position: Vector3<f64>, quaternion: Vector4<f64>, weight: f64 },
    Shape { curvatures: [f64; CURVATURES_MAX], weight: f64 },
}

/// A target's weight, or the configured one where the target has none.
fn given_or(weight: f64, configured: f64) -> f64 {
    if weight > 0.0 { weight } else { configured }
}

impl<E: Estimator, P: Plan> Cycle<E, P> {
    /// The target at the end of lookahead and lead.
    pub(super) fn wanted(&self, inputs: &TickInputs<'_>) -> Option<Wanted> {
        let target = inputs.target?;
        let ahead = target.ahead.unwrap_or_else(|| target.now.extrapolated(self.lead_s(target.now.is_tip())));
        Some(match ahead {
            Target::Tip { position_m, quaternion, .. } => {
                Wanted::Tip { position: position_m, quaternion: quaternion.normalize(), weight: target.weight }
            }
            Target::Shape { curvatures_1pm, .. } => Wanted::Shape { curvatures: curvatures_1pm, weight: target.weight },
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
        let weights = &self.settings.weights;
        let (planner, goal) = match wanted {
            Wanted::Tip { position, quaternion, weight } => {
                let w = &weights.tip;
                let pose = given_or(*weight, w.pose);
                // In proportion, so that the lag of the motion stays the one that the lead is made for.
                let rate = w.rate * (pose / w.pose);
                let (position, quaternion) = (*position, *quaternion);
                let goal = Goal::Tip { position, quaternion, pose, rate, damping: w.damping };
                (&mut self.tip_planner, goal)
            }
            Wanted::Shape { curvatures, weight } => {
                let weight = given_or(*weight, weights.shape.curvature);
                let curvatures = &curvatures[..2 * self.arm.segment_count()];
                (&mut self.shape_planner, Goal::Shape { curvatures, weight })
            }
        };
        let report = planner.plan(
            &Inputs {
                state: self.estimator.predicted(),
                u_previous: &self.sent,
                disturbance: self.estimator.disturbance_n(),
                goal,
                now: inputs.obstacles.now(),
                ahead: inputs.obstacles.ahead(),
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
            self.proposed.copy_from_slice(planner.tensions());
            if let Some(planned) = planner.planned() {
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
