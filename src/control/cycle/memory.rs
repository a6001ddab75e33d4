//! What the loop carries from tick to tick.

use super::{Cycle, Plan};
use crate::control::estimator::Estimator;
use crate::estimator::Kept;

impl<E: Estimator, P: Plan> Cycle<E, P> {
    /// The estimator.
    pub const fn estimator_mut(&mut self) -> &mut E {
        &mut self.estimator
    }

    /// Visits every number beside the estimator's through which a small motion of the arm about a hold acts on later ticks.
    /// The reference is not among them: while it rests, nothing of the arm's enters it.
    pub fn memory(&mut self, visit: &mut dyn FnMut(Kept, &mut [f64])) {
        self.governor.memory().into_iter().for_each(|kept| visit(Kept::Curvatures, kept));
        visit(Kept::Tensions, &mut self.sent);
        if self.friction.is_active() {
            visit(Kept::Shares, self.friction.memory());
        }
    }
}
