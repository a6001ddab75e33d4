//! The mixed complementarity problem (18)-(26), extended by distance constraints, by Newton on active sets and on (24).
//!
//! minimise `u^T A u + 2 b^T u` subject to `lower <= u <= upper` and `C u + d >= 0`, the rows relaxed by an L1 penalty.
//!
//! With the multipliers `mu` of the rows (half of the usual ones, as in (22)) the optimality conditions are one box
//! complementarity problem in `z = (u, mu)`, `F(z) = (A u + b - C^T mu, C u + d)`, box `[lower, upper] x [0, M]`; the
//! upper end M of `mu`, each row's own price per metre, *is* the L1 penalty, so rows that conflict need no other treatment:
//! where all have one price, the sum of the metres that are missing is least, whatever tensions they take. A price per
//! newton would give a row that hardly moves the right to all tensions. The paper's `alpha` and `beta` of both bounds
//! are eliminated by hand: per component
//! `rho(z - l, rho(h - z, -F)) = 0` with `rho` of (24) (Billups 1995), so Newton works on the tensions and the few
//! rows that matter. Rows enter only when a solution without them violates them: adjacent points of an arm give nearly
//! equal rows, and a Newton on all of them would be needlessly large and badly conditioned. Rows that held back the
//! solution of a like problem may be told, with their multipliers: they are there from the start
//! ([`Solver::solve_warm`]), and the answer is the same.
//!
//! Anytime: the caller's `stop` is asked after every Newton iteration. An answer that is not known to be optimal (stopped,
//! or at the iteration limit) may ignore rows that were not yet in the working set; it is therefore never taken unseen
//! but compared with the start and with the answers of the smaller working sets, all by the cost with the penalty of
//! *all* rows ([`penalized`]), and the best of them is the answer.
//!
//! Newton has two faces here. On the natural residual `z - mid(l, h, z - F)` each iteration is a primal-dual active-set step
//! (Hintermueller, Ito and Kunisch 2002): components are held at the bound that they lean on and a linear system in the free
//! ones is solved, which ends after finitely many steps, from a neighbouring problem's solution mostly after one or two, but
//! may cycle. It comes first; where it has not ended after a few steps, the paper's Newton on (24), which a line search
//! globalises, goes on from the start. Both ends are the same solution.

use crate::math::dense;
use crate::math::simd::{add_scaled, dot};
use pulp::{Arch, Simd, WithSimd};

/// One problem; all slices row-major, n tensions, p rows.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// `A`, n x n, symmetric positive definite.
    pub a: &'a [f64],
    /// `b`, n.
    pub b: &'a [f64],
    /// Lower bounds, n.
    pub lower: &'a [f64],
    /// Upper bounds, n.
    pub upper: &'a [f64],
    /// `C`, p x n.
    pub c: &'a [f64],
    /// `d`, p.
    pub d: &'a [f64],
    /// What a metre of a row's violation costs, half as with the multipliers, p: finite, above 0. [`exact_price`] for rows
    /// that are given up only for one another.
    pub price: &'a [f64],
}

/// A price per metre (half) that no quadratic outbids where it can be paid: 1e6 times what it costs at most to move
/// the longest of `rows` (m/N) by a metre, all in tensions scaled by the diagonal of `A`. With the rows of whatever
/// moves farthest it depends on no pair, and a pair that moves by less than a millionth of that gives way to the task.
pub fn exact_price<'a>(a: &[f64], b: &[f64], rows: impl Iterator<Item = &'a [f64]>) -> f64 {
    let n = b.len();
    let longest =
        rows.map(|row| (0..n).map(|i| row[i] * row[i] / a[i * n + i]).sum::<f64>()).fold(0.0f64, f64::max).sqrt();
    let pull = (0..n).fold(1.0f64, |most, i| most.max(b[i].abs() / a[i * n + i].sqrt()));
    if longest > 0.0 { PRICE * pull / longest } else { PRICE * pull }
}

/// Price of hard rows over the quadratic's pull: much larger and what conflicts would drown in rounding, much smaller and
/// rows that take long ways would be given up.
const PRICE: f64 = 1e6;

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Optimal.
    Optimal,
    /// Optimal for the L1 penalty: some row stays violated, because no tensions satisfy all of them, or only at more than
    /// its price.
    Relaxed,
    /// As many rows work as there is room for, and others are violated: the best answer met, as for the iteration limit.
    Overfull,
    /// The iteration limit came first; the answer is inside the box and no worse than the start, its residual is
    /// reported.
    IterationLimit,
    /// The caller's `stop` came first; the answer as for the iteration limit.
    Stopped,
}

impl Status {
    /// Whether no further iteration would change the answer.
    pub const fn is_optimal(self) -> bool {
        matches!(self, Self::Optimal | Self::Relaxed)
    }
}

/// Report of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// How it ended.
    pub status: Status,
    /// Newton iterations, all working sets together.
    pub iterations: usize,
    /// Largest entry of the natural residual `z - mid(l, h, z - F)`, each equation scaled by its diagonal, over the
    /// size of the problem; zero at a solution. Of the last iterate, also where an earlier one is the answer.
    pub kkt_residual: f64,
    /// Rows in the last working set.
    pub rows: usize,
}

/// Solver with all memory made at start.
#[derive(Debug, Clone)]
pub struct Solver {
    n: usize,
    capacity: usize,
    scale: Vec<f64>,
    a: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    row_scale: Vec<f64>,
    /// Lengths of all rows in scaled tensions.
    length: Vec<f64>,
    row_of: Vec<usize>,
    z: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    force: Vec<f64>,
    jacobian: Vec<f64>,
    step: Vec<f64>,
    trial: Vec<f64>,
    start: Vec<f64>,
    /// Best iterate that counts as solved.
    accepted: Vec<f64>,
    /// Components between their bounds in the last active-set step.
    free: Vec<usize>,
    used: Vec<bool>,
    multipliers: Vec<f64>,
    /// Best answer so far by the penalized cost.
    best: Vec<f64>,
}

/// Stop: the natural residual is at most this share of the problem's size, beside the rounding of the multipliers' terms.
const TOLERANCE: f64 = 1e-13;
/// Rounding of the multipliers' terms in the residual, over the sum of the multipliers.
const ROUNDING: f64 = 2.0 * f64::EPSILON;
/// A residual up to this share of the size counts as solved where rounding does not let it fall further.
const ACCEPTED: f64 = 1e-9;
/// Most Newton iterations per working set, steps of active sets among them.
const ITERATIONS_MAX: usize = 80;
/// Most active-set steps per working set; where they have not ended the search by then, they cycle or are far off.
const ACTIVE_SET_STEPS_MAX: usize = 8;
/// Most Newton iterations of a working set that was told, steps of active sets among them; where they do not solve it, it
/// was a bad guess.
const WARM_ITERATIONS_MAX: usize = 12;
/// A row is violated when `C u + d` is below minus this share of its size.
const ROW_TOLERANCE: f64 = 1e-10;
/// Compliance of the rows in scaled units: keeps the Newton matrix regular when working rows are parallel.
const COMPLIANCE: f64 = 1e-11;

impl Solver {
    /// Room for `n` tensions and `rows` distance rows, of which at most [`Solver::WORKING_MAX`] work at once.
    /// Allocates.
    pub fn new(n: usize, rows: usize) -> Self {
        let m = n + Self::WORKING_MAX.min(rows);
        Self {
            n,
            capacity: rows,
            scale: vec![0.0; n],
            a: vec![0.0; n * n],
            b: vec![0.0; n],
            c: vec![0.0; (m - n) * n],
            row_scale: vec![0.0; m - n],
            length: vec![0.0; rows],
            row_of: Vec::with_capacity(m - n),
            z: vec![0.0; m],
            low: vec![0.0; m],
            high: vec![0.0; m],
            force: vec![0.0; m],
            jacobian: vec![0.0; m * m],
            step: vec![0.0; m],
            trial: vec![0.0; m],
            start: vec![0.0; m],
            accepted: vec![0.0; m],
            free: Vec::with_capacity(m),
            used: vec![false; rows],
            multipliers: vec![0.0; rows],
            best: vec![0.0; n],
        }
    }

    /// Most rows that work at once.
    pub const WORKING_MAX: usize = 40;

    /// Multipliers of the rows of the last solve (cost per metre, half), one per row.
    pub fn multipliers(&self) -> &[f64] {
        &self.multipliers
    }

    /// Solves from the start `u`, which receives the answer, inside the box always. `stop` is asked after every Newton
    /// iteration and never again once it said yes. Does not allocate.
    ///
    /// # Panics
    /// If the problem has more rows than the solver has room for.
    pub fn solve(&mut self, problem: &Problem<'_>, u: &mut [f64], stop: &mut dyn FnMut() -> bool) -> Report {
        self.solve_warm(problem, &[], u, stop)
    }

    /// [`Solver::solve`] with a guess of the rows' multipliers, as [`Solver::multipliers`] gave them for a like problem; 0
    /// for rows that are not expected to matter, empty for no guess. A guess changes the way, not the answer; one that
    /// leads nowhere is dropped. Does not allocate.
    ///
    /// # Panics
    /// If the problem has more rows than the solver has room for.
    pub fn solve_warm(
        &mut self,
        problem: &Problem<'_>,
        guess: &[f64],
        u: &mut [f64],
        stop: &mut dyn FnMut() -> bool,
    ) -> Report {
        let (n, p) = (self.n, problem.d.len());
        assert!(p <= self.capacity, "{p} rows, room for {}", self.capacity);
        for i in 0..n {
            self.scale[i] = 1.0 / problem.a[i * n + i].sqrt();
        }
        for i in 0..n {
            for j in 0..n {
                self.a[i * n + j] = problem.a[i * n + j] * self.scale[i] * self.scale[j];
            }
            self.b[i] = problem.b[i] * self.scale[i];
            self.low[i] = problem.lower[i] / self.scale[i];
            self.high[i] = problem.upper[i] / self.scale[i];
            self.z[i] = (u[i] / self.scale[i]).clamp(self.low[i], self.high[i]);
        }
        let size = self.b.iter().chain(&self.low[..n]).chain(&self.high[..n]).fold(1e-300f64, |s, v| s.max(v.abs()));
        for (row, length) in self.length[..p].iter_mut().enumerate() {
            let c = &problem.c[row * n..(row + 1) * n];
            *length = c.iter().zip(&self.scale).map(|(c, s)| (c * s).powi(2)).sum::<f64>().sqrt();
        }
        self.used[..p].fill(false);
        self.multipliers[..p].fill(0.0);
        self.row_of.clear();
        let mut report = Report { status: Status::Optimal, iterations: 0, kkt_residual: 0.0, rows: 0 };
        for i in 0..n {
            self.best[i] = u[i].clamp(problem.lower[i], problem.upper[i]);
        }
        let mut best = penalized(problem, &self.best);
        let mut stopped = false;
        for (row, multiplier) in guess.iter().enumerate().filter(|(_, multiplier)| **multiplier > 0.0) {
            self.enter(problem, row, *multiplier);
        }
        let mut guessed = !self.row_of.is_empty();
        let (solved, left_out) = loop {
            let limit = if guessed { WARM_ITERATIONS_MAX } else { ITERATIONS_MAX };
            let (iterations, residual, solved) = self.newton(problem, size, limit, stop, &mut stopped);
            report.iterations += iterations;
            // Over an infinite size everything would be small.
            report.kkt_residual = if size.is_finite() { residual / size } else { f64::NAN };
            for i in 0..n {
                u[i] = (self.z[i] * self.scale[i]).clamp(problem.lower[i], problem.upper[i]);
            }
            let cost = penalized(problem, u);
            // Anything that is a number is better than what is not.
            if cost < best || best.is_nan() {
                best = cost;
                self.best.copy_from_slice(u);
            }
            // A guess that leads nowhere: from the best so far, without it.
            if std::mem::take(&mut guessed) && !stopped && !solved {
                for i in 0..n {
                    self.z[i] = self.best[i] / self.scale[i];
                }
                self.used[..p].fill(false);
                self.row_of.clear();
                continue;
            }
            // Stopped, a solution of the working set is one of the problem only where no row is left out.
            let left_out = self.add_violated(problem, u);
            if stopped || left_out != LeftOut::Entered {
                break (solved, left_out);
            }
        };
        report.rows = self.row_of.len();
        let mut relaxed = false;
        for (k, &row) in self.row_of.iter().enumerate() {
            self.multipliers[row] = self.z[n + k].max(0.0) / self.row_scale[k];
            relaxed |= self.z[n + k] >= self.high[n + k] * (1.0 - 1e-9);
        }
        // Rows that no tension moves never work: they would be violated silently.
        relaxed |= (0..p).any(|row| self.length[row] == 0.0 && problem.d[row] < -1e-9);
        let optimal = solved && left_out == LeftOut::None;
        report.status = if !optimal {
            u.copy_from_slice(&self.best);
            match left_out {
                _ if stopped => Status::Stopped,
                LeftOut::NoRoom if solved => Status::Overfull,
                _ => Status::IterationLimit,
            }
        } else if relaxed {
            Status::Relaxed
        } else {
            Status::Optimal
        };
        report
    }

    /// Adds the most violated rows to the working set.
    fn add_violated(&mut self, problem: &Problem<'_>, u: &[f64]) -> LeftOut {
        let mut left_out = LeftOut::None;
        // A few at a time: after the worst is satisfied its neighbours mostly are too.
        for _ in 0..4 {
            // Violation in metres, so that rows of different reach compare by depth.
            let mut worst = (usize::MAX, -ROW_TOLERANCE);
            for row in 0..problem.d.len() {
                if self.used[row] || self.length[row] == 0.0 {
                    continue;
                }
                let value = row_value(problem, row, u);
                if value < worst.1 {
                    worst = (row, value);
                }
            }
            if worst.0 == usize::MAX {
                break;
            }
            if !self.enter(problem, worst.0, 0.0) {
                return if left_out == LeftOut::None { LeftOut::NoRoom } else { left_out };
            }
            left_out = LeftOut::Entered;
        }
        left_out
    }

    /// Takes a row into the working set, where there is room and some tension moves it; tells whether it did.
    fn enter(&mut self, problem: &Problem<'_>, row: usize, multiplier: f64) -> bool {
        let (n, k) = (self.n, self.row_of.len());
        let size = self.length[row];
        if n + k == self.z.len() || size == 0.0 {
            return false;
        }
        let c = &problem.c[row * n..(row + 1) * n];
        self.used[row] = true;
        self.row_of.push(row);
        for i in 0..n {
            self.c[k * n + i] = c[i] * self.scale[i] / size;
        }
        self.row_scale[k] = size;
        self.low[n + k] = 0.0;
        self.high[n + k] = problem.price[row] * size;
        self.z[n + k] = (multiplier * size).min(self.high[n + k]);
        true
    }

    fn evaluate(&self, problem: &Problem<'_>, z: &[f64], force: &mut [f64]) {
        Arch::new().dispatch(Evaluation { solver: self, d: problem.d, z, force });
    }

    fn merit(&self, z: &[f64], force: &[f64]) -> f64 {
        (0..force.len()).map(|i| component(z[i] - self.low[i], self.high[i] - z[i], force[i]).0.powi(2)).sum()
    }

    /// Newton on the working set; returns iterations, the natural residual, and whether that is a solution.
    fn newton(
        &mut self,
        problem: &Problem<'_>,
        size: f64,
        limit: usize,
        stop: &mut dyn FnMut() -> bool,
        stopped: &mut bool,
    ) -> (usize, f64, bool) {
        let (n, m) = (self.n, self.n + self.row_of.len());
        let mut force = std::mem::take(&mut self.force);
        let mut z = std::mem::take(&mut self.z);
        self.start[..m].copy_from_slice(&z[..m]);
        self.evaluate(problem, &z, &mut force[..m]);
        let mut residual = self.natural(&z[..m], &force[..m]);
        // What a price is paid for leaves rounding of its own size.
        let tolerance = |z: &[f64]| TOLERANCE * size + ROUNDING * z[n..m].iter().map(|mu| mu.abs()).sum::<f64>();
        let mut accepted = Accepted { residual: f64::INFINITY, settled: false };
        let (mut iterations, mut regular) = (0, true);
        // Every solve may make one step, whatever the time: a machine that is always late moves all the same.
        while residual > tolerance(&z) && regular && !*stopped && iterations < limit.min(ACTIVE_SET_STEPS_MAX) {
            iterations += 1;
            regular = self.active_set_step(problem, &mut z[..m], &mut force[..m]);
            residual = self.natural(&z[..m], &force[..m]);
            *stopped = stop();
            if accepted.takes(residual, size) {
                self.accepted[..m].copy_from_slice(&z[..m]);
            }
            if accepted.settled {
                break;
            }
        }
        let found = residual <= tolerance(&z) || accepted.residual.is_finite();
        if !(found || *stopped) {
            z[..m].copy_from_slice(&self.start[..m]);
            self.evaluate(problem, &z, &mut force[..m]);
            residual = self.natural(&z[..m], &force[..m]);
        }
        let mut regular = !found;
        while residual > tolerance(&z) && regular && !*stopped && iterations < limit {
            iterations += 1;
            regular = self.fischer_burmeister_step(problem, size, &mut z[..m], &mut force[..m]);
            residual = self.natural(&z[..m], &force[..m]);
            *stopped = stop();
            if accepted.takes(residual, size) {
                self.accepted[..m].copy_from_slice(&z[..m]);
            }
            regular &= !accepted.settled;
        }
        if accepted.residual.is_finite() && (residual.is_nan() || residual > accepted.residual) {
            z[..m].copy_from_slice(&self.accepted[..m]);
            residual = accepted.residual;
        }
        // Over an infinite size everything would be small.
        let solved = size.is_finite() && (residual <= ACCEPTED * size || residual <= tolerance(&z));
        self.force = force;
        self.z = z;
        (iterations, residual, solved)
    }

    /// One step of Newton on (24) from `z` with its `force`, which become the next iterate's; false where the generalised
    /// Jacobian is singular, or not finite.
    fn fischer_burmeister_step(&mut self, problem: &Problem<'_>, size: f64, z: &mut [f64], force: &mut [f64]) -> bool {
        let (n, m) = (self.n, z.len());
        let mut merit = 0.0;
        // Rows of the generalised Jacobian: -(w0 e_i + w1 F'_i).
        for i in 0..m {
            let (psi, [w0, w1]) = component(z[i] - self.low[i], self.high[i] - z[i], force[i]);
            merit += psi * psi;
            self.step[i] = psi;
            let row = &mut self.jacobian[i * m..(i + 1) * m];
            if i < n {
                for j in 0..n {
                    row[j] = w1 * self.a[i * n + j];
                }
                for k in 0..m - n {
                    row[n + k] = -w1 * self.c[k * n + i];
                }
            } else {
                for j in 0..n {
                    row[j] = w1 * self.c[(i - n) * n + j];
                }
                row[n..].fill(0.0);
                row[i] = w1 * COMPLIANCE;
            }
            row[i] += w0;
        }
        if !dense::solve_in_place(m, &mut self.jacobian[..m * m], &mut self.step[..m]) {
            return false;
        }
        // Line search on the merit function; a step that solves the linearised problem exactly is taken whole.
        let mut trial = std::mem::take(&mut self.trial);
        let mut share = 1.0;
        loop {
            for i in 0..m {
                trial[i] = z[i] + share * self.step[i];
            }
            self.evaluate(problem, &trial, force);
            let next = self.merit(&trial[..m], force);
            if next <= (1.0 - 1e-4 * share) * merit || share < 1e-6 || next <= (TOLERANCE * size).powi(2) {
                break;
            }
            share *= 0.5;
        }
        z.copy_from_slice(&trial[..m]);
        self.trial = trial;
        true
    }

    /// One step of the active-set method from `z` with its `force`, which become the next iterate's; false where the free
    /// components' system is singular, or not finite.
    fn active_set_step(&mut self, problem: &Problem<'_>, z: &mut [f64], force: &mut [f64]) -> bool {
        let n = self.n;
        self.free.clear();
        for i in 0..z.len() {
            let moved = z[i] - force[i];
            if moved <= self.low[i] {
                z[i] = self.low[i];
            } else if moved >= self.high[i] {
                z[i] = self.high[i];
            } else {
                self.free.push(i);
            }
        }
        self.evaluate(problem, z, force);
        let m = self.free.len();
        for (r, &i) in self.free.iter().enumerate() {
            self.step[r] = -force[i];
            for (entry, &j) in self.jacobian[r * m..(r + 1) * m].iter_mut().zip(&self.free) {
                *entry = match (i < n, j < n) {
                    (true, true) => self.a[i * n + j],
                    (true, false) => -self.c[(j - n) * n + i],
                    (false, true) => self.c[(i - n) * n + j],
                    (false, false) if i == j => COMPLIANCE,
                    (false, false) => 0.0,
                };
            }
        }
        if !dense::solve_in_place(m, &mut self.jacobian[..m * m], &mut self.step[..m]) {
            return false;
        }
        for (&i, step) in self.free.iter().zip(&self.step) {
            z[i] += step;
        }
        self.evaluate(problem, z, force);
        true
    }

    fn natural(&self, z: &[f64], force: &[f64]) -> f64 {
        (0..z.len()).fold(0.0f64, |worst, i| {
            let moved = (z[i] - force[i]).clamp(self.low[i], self.high[i]);
            // `max` would lose a NaN, and with it the only sign of a problem that is not one.
            let off = (z[i] - moved).abs();
            if off.is_nan() {
                off
            } else if worst.is_nan() {
                worst
            } else {
                worst.max(off)
            }
        })
    }
}

/// What a solution of the working set leaves out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LeftOut {
    /// No violated row.
    None,
    /// Rows that now work too.
    Entered,
    /// Rows for which there is no room.
    NoRoom,
}

/// The best residual that counts as solved.
struct Accepted {
    residual: f64,
    /// Another iterate did not halve it: rounding is all that is left.
    settled: bool,
}

impl Accepted {
    /// Whether this iterate is the best now.
    fn takes(&mut self, residual: f64, size: f64) -> bool {
        if residual.is_nan() || residual > ACCEPTED * size {
            return false;
        }
        self.settled = self.residual.is_finite() && residual > 0.5 * self.residual;
        let better = residual < self.residual;
        self.residual = self.residual.min(residual);
        better
    }
}

/// `C u + d` of one row.
fn row_value(problem: &Problem<'_>, row: usize, u: &[f64]) -> f64 {
    let n = u.len();
    problem.d[row] + problem.c[row * n..(row + 1) * n].iter().zip(u).map(|(c, u)| c * u).sum::<f64>()
}

/// What a solve minimises, at any tensions: the quadratic plus the L1 penalty of all rows, in the working set or not. Does
/// not allocate.
pub fn penalized(problem: &Problem<'_>, u: &[f64]) -> f64 {
    let n = u.len();
    let product = |row: &[f64]| row.iter().zip(u).map(|(a, u)| a * u).sum::<f64>();
    let cost: f64 = (0..n).map(|i| u[i] * (product(&problem.a[i * n..(i + 1) * n]) + 2.0 * problem.b[i])).sum();
    let missing: f64 =
        (0..problem.d.len()).map(|row| problem.price[row] * (-row_value(problem, row, u)).max(0.0)).sum();
    cost + 2.0 * missing
}

/// [`Solver::evaluate`] with the processor's vectors: `F(z)` of the working set.
struct Evaluation<'a> {
    solver: &'a Solver,
    d: &'a [f64],
    z: &'a [f64],
    force: &'a mut [f64],
}

impl WithSimd for Evaluation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { solver, d, z, force } = self;
        let n = solver.n;
        let (upper, lower) = force.split_at_mut(n);
        upper.copy_from_slice(&solver.b);
        // A is symmetric: its columns are its rows.
        for j in 0..n {
            add_scaled(simd, z[j], &solver.a[j * n..(j + 1) * n], upper);
        }
        for (k, &row) in solver.row_of.iter().enumerate() {
            let c = &solver.c[k * n..(k + 1) * n];
            add_scaled(simd, -z[n + k], c, upper);
            lower[k] = d[row] / solver.row_scale[k] + COMPLIANCE * z[n + k] + dot(simd, c, &z[..n]);
        }
    }
}

/// `rho(a, rho(b, -f))` and the weights `w0`, `w1` of its derivative `-(w0 dz + w1 dF)`; `a` is the distance to the
/// lower bound, `b` to the upper one.
fn component(a: f64, b: f64, f: f64) -> (f64, [f64; 2]) {
    let (inner, [ib, jf]) = fischer_burmeister(b, -f);
    let (outer, [oa, oi]) = fischer_burmeister(a, inner);
    // d outer = oa dz + oi (ib (-dz) + jf (-dF)).
    (outer, [-(oa - oi * ib), oi * jf])
}

/// (24) and its derivatives; at the kink the element of the generalised derivative along (1, 1).
fn fischer_burmeister(tau: f64, chi: f64) -> (f64, [f64; 2]) {
    let r = tau.hypot(chi);
    if r == 0.0 {
        let d = std::f64::consts::FRAC_1_SQRT_2 - 1.0;
        return (0.0, [d, d]);
    }
    // r - (tau + chi) without cancellation where both are positive.
    let value = if tau > 0.0 && chi > 0.0 { -2.0 * tau * chi / (r + tau + chi) } else { r - (tau + chi) };
    (value, [tau / r - 1.0, chi / r - 1.0])
}

#[cfg(test)]
#[path = "complementarity_tests.rs"]
mod tests;
