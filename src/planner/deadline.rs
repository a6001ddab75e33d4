//! How much of its time a planning step has used: the caller's clock or count of work, as far as the planner knows it.

/// Asked by the planner between two pieces of work.
pub trait Deadline {
    /// Share of the planning time that is used: 0 at its begin, from 1 on it is over. Never falls. Without a deadline
    /// it stays 0, so that work alone decides and plans repeat bit for bit. Must not allocate.
    fn used(&mut self) -> f64;
}

/// Whether it is over is all that a plain function knows.
impl<F: FnMut() -> bool> Deadline for F {
    fn used(&mut self) -> f64 {
        if self() { 1.0 } else { 0.0 }
    }
}

/// A deadline in parts, so that no iteration takes the time of those after it.
pub(super) struct Shares<'a> {
    deadline: &'a mut dyn Deadline,
    over: bool,
    /// The running iteration must end at this share.
    until: f64,
    began: f64,
    /// Largest share that an iteration needed before it chose tensions.
    preparation: f64,
}

impl<'a> Shares<'a> {
    pub(super) fn new(deadline: &'a mut dyn Deadline) -> Self {
        Self { deadline, over: false, until: 1.0, began: 0.0, preparation: 0.0 }
    }

    /// Once it is over nobody is asked any more.
    fn used(&mut self) -> f64 {
        if self.over {
            return 1.0;
        }
        let used = self.deadline.used();
        self.over = used >= 1.0;
        used
    }

    /// Iteration `k` (from 0) of `n` begins. Each but the last may use half of what is left: how many of them will be
    /// needed is not known before they converge.
    pub(super) fn begin(&mut self, k: usize, n: usize) {
        self.began = self.used();
        self.until = if k + 1 < n { 0.5 * (1.0 + self.began) } else { 1.0 };
    }

    /// The iteration is ready to choose tensions.
    pub(super) fn prepared(&mut self) {
        let used = self.used();
        self.preparation = self.preparation.max(used.min(1.0) - self.began);
    }

    /// Whether the choice of tensions in the running iteration must end.
    pub(super) fn iteration_is_over(&mut self) -> bool {
        self.used() >= self.until
    }

    /// Whether there is no time for the preparation of another iteration.
    pub(super) fn is_over(&mut self) -> bool {
        self.used() + self.preparation >= 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Told(Vec<f64>);

    impl Deadline for Told {
        fn used(&mut self) -> f64 {
            self.0.remove(0)
        }
    }

    #[test]
    fn each_iteration_but_the_last_gets_half_of_what_is_left() {
        let mut told = Told(vec![0.0, 0.1, 0.49, 0.5, 0.6, 0.6, 0.7, 0.99]);
        let mut shares = Shares::new(&mut told);
        shares.begin(0, 2);
        shares.prepared();
        assert!(!shares.iteration_is_over() && shares.iteration_is_over());
        assert!(!shares.is_over(), "0.6 and a preparation of 0.1");
        shares.begin(1, 2);
        assert!(!shares.iteration_is_over() && !shares.iteration_is_over());
    }

    #[test]
    fn an_iteration_whose_preparation_would_not_fit_is_not_begun() {
        let mut told = Told(vec![0.0, 0.3, 0.8]);
        let mut shares = Shares::new(&mut told);
        shares.begin(0, 2);
        shares.prepared();
        assert!(shares.is_over());
    }

    #[test]
    fn nobody_is_asked_after_the_end() {
        let mut asked = 0;
        let mut stop = || {
            asked += 1;
            true
        };
        let mut shares = Shares::new(&mut stop);
        shares.begin(0, 3);
        shares.prepared();
        assert!(shares.iteration_is_over() && shares.is_over());
        assert_eq!(asked, 1);
    }
}
