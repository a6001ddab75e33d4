//! The mixed complementarity problem (18)-(26), extended by distance constraints, by a Fischer-Burmeister Newton.
//!
//! minimise `u^T A u + 2 b^T u` subject to `lower <= u <= upper` and `C u + d >= 0`, the rows relaxed by an L1 penalty.
//!
//! With the multipliers `mu` of the rows (half of the usual ones, as in (22)) the optimality conditions are one box
//! complementarity problem in `z = (u, mu)`, `F(z) = (A u + b - C^T mu, C u + d)`, box `[lower, upper] x [0, M]`; the
//! upper end M of `mu` *is* the L1 penalty, so rows that conflict need no other treatment. The paper's `alpha` and
//! `beta` of both bounds are eliminated by hand: per component
//! `rho(z - l, rho(h - z, -F)) = 0` with `rho` of (24) (Billups 1995), so Newton works on the tensions and the few
//! rows that matter. Rows enter only when a solution without them violates them: adjacent points of an arm give nearly
//! equal rows, and a Newton on all of them would be needlessly large and badly conditioned.
//!
//! Anytime: the caller's `stop` is asked after every Newton iteration. An answer that is not known to be optimal (stopped,
//! or at the iteration limit) may ignore rows that were not yet in the working set; it is therefore never taken unseen
//! but compared with the start and with the answers of the smaller working sets, all by the cost with the penalty of
//! *all* rows ([`Solver::penalized`]), and the best of them is the answer.
//!
//! An exact active-set method would do as well on 24 unknowns; this one warm-starts from any point, its iterations are
//! bounded, and it is the paper's.

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
}

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Optimal.
    Optimal,
    /// Optimal for the L1 penalty: some row stays violated, because no tensions satisfy all of them.
    Relaxed,
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
    /// Relative size of the L1 penalty's multiplier bound.
    penalty: f64,
    scale: Vec<f64>,
    a: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    row_scale: Vec<f64>,
    row_of: Vec<usize>,
    z: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    force: Vec<f64>,
    psi: Vec<f64>,
    weight: Vec<[f64; 2]>,
    jacobian: Vec<f64>,
    step: Vec<f64>,
    trial: Vec<f64>,
    used: Vec<bool>,
    multipliers: Vec<f64>,
    /// Best answer so far by the penalized cost.
    best: Vec<f64>,
}

/// Stop: the natural residual over the problem's size.
const TOLERANCE: f64 = 1e-13;
/// Most Newton iterations per working set.
const ITERATIONS_MAX: usize = 80;
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
            penalty: 1e6,
            scale: vec![0.0; n],
            a: vec![0.0; n * n],
            b: vec![0.0; n],
            c: vec![0.0; (m - n) * n],
            row_scale: vec![0.0; m - n],
            row_of: Vec::with_capacity(m - n),
            z: vec![0.0; m],
            low: vec![0.0; m],
            high: vec![0.0; m],
            force: vec![0.0; m],
            psi: vec![0.0; m],
            weight: vec![[0.0; 2]; m],
            jacobian: vec![0.0; m * m],
            step: vec![0.0; m],
            trial: vec![0.0; m],
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
        self.used[..p].fill(false);
        self.multipliers[..p].fill(0.0);
        self.row_of.clear();
        let mut report = Report { status: Status::Optimal, iterations: 0, kkt_residual: 0.0, rows: 0 };
        for i in 0..n {
            self.best[i] = u[i].clamp(problem.lower[i], problem.upper[i]);
        }
        let mut best = self.penalized(problem, &self.best);
        let mut stopped = false;
        let left_out = loop {
            let (iterations, residual) = self.newton(problem, size, stop, &mut stopped);
            report.iterations += iterations;
            // Over an infinite size everything would be small.
            report.kkt_residual = if size.is_finite() { residual / size } else { f64::NAN };
            for i in 0..n {
                u[i] = (self.z[i] * self.scale[i]).clamp(problem.lower[i], problem.upper[i]);
            }
            let cost = self.penalized(problem, u);
            // Anything that is a number is better than what is not.
            if cost < best || best.is_nan() {
                best = cost;
                self.best.copy_from_slice(u);
            }
            // Stopped, a solution of the working set is one of the problem only where no row is left out.
            let left_out = self.add_violated(problem, u);
            if stopped || !left_out {
                break left_out;
            }
        };
        report.rows = self.row_of.len();
        let mut relaxed = false;
        for (k, &row) in self.row_of.iter().enumerate() {
            self.multipliers[row] = self.z[n + k].max(0.0) / self.row_scale[k];
            relaxed |= self.z[n + k] >= self.high[n + k] * (1.0 - 1e-9);
        }
        // Rows that found no room in the working set would be violated silently: say so.
        let value = |row: usize| {
            problem.d[row] + problem.c[row * n..(row + 1) * n].iter().zip(&*u).map(|(c, u)| c * u).sum::<f64>()
        };
        relaxed |= (0..p).any(|r| !self.used[r] && value(r) < -1e-9);
        // Not `>`: a residual that is not a number is no optimum.
        let optimal = report.kkt_residual <= 1e-9 && !left_out;
        report.status = if !optimal {
            u.copy_from_slice(&self.best);
            if stopped { Status::Stopped } else { Status::IterationLimit }
        } else if relaxed {
            Status::Relaxed
        } else {
            Status::Optimal
        };
        report
    }

    /// Adds the most violated rows to the working set; false when none is violated or no room is left.
    fn add_violated(&mut self, problem: &Problem<'_>, u: &[f64]) -> bool {
        let n = self.n;
        let room = self.z.len() - n;
        let mut added = 0;
        // A few at a time: after the worst is satisfied its neighbours mostly are too.
        while added < 4 && self.row_of.len() < room {
            let mut worst = (usize::MAX, -ROW_TOLERANCE);
            for row in 0..problem.d.len() {
                if self.used[row] {
                    continue;
                }
                let c = &problem.c[row * n..(row + 1) * n];
                let size = c.iter().zip(&self.scale).map(|(c, s)| (c * s).powi(2)).sum::<f64>().sqrt();
                if size == 0.0 {
                    continue;
                }
                let value = problem.d[row] + c.iter().zip(u).map(|(c, u)| c * u).sum::<f64>();
                // Violation on the scale of 1 m, so that rows of different reach compare by depth.
                if value < worst.1 {
                    worst = (row, value);
                }
            }
            if worst.0 == usize::MAX {
                break;
            }
            let (row, k) = (worst.0, self.row_of.len());
            self.used[row] = true;
            self.row_of.push(row);
            let c = &problem.c[row * n..(row + 1) * n];
            let size = c.iter().zip(&self.scale).map(|(c, s)| (c * s).powi(2)).sum::<f64>().sqrt();
            for i in 0..n {
                self.c[k * n + i] = c[i] * self.scale[i] / size;
            }
            self.row_scale[k] = size;
            self.z[n + k] = 0.0;
            self.low[n + k] = 0.0;
            self.high[n + k] = self.multiplier_max();
            added += 1;
        }
        added > 0
    }

    /// What the last solve minimised, at any tensions: the quadratic plus the L1 penalty of all rows, in the working set
    /// or not. Does not allocate.
    pub fn penalized(&self, problem: &Problem<'_>, u: &[f64]) -> f64 {
        let n = self.n;
        let product = |row: &[f64]| row.iter().zip(u).map(|(a, u)| a * u).sum::<f64>();
        let cost: f64 = (0..n).map(|i| u[i] * (product(&problem.a[i * n..(i + 1) * n]) + 2.0 * problem.b[i])).sum();
        let violation: f64 = (0..problem.d.len())
            .map(|row| {
                let c = &problem.c[row * n..(row + 1) * n];
                let value = problem.d[row] + product(c);
                if value < 0.0 { -value / self.row_size(c) } else { 0.0 }
            })
            .sum();
        cost + 2.0 * self.multiplier_max() * violation
    }

    /// Length of a row in scaled tensions; a row that no tension moves counts by its depth alone.
    fn row_size(&self, c: &[f64]) -> f64 {
        let size = c.iter().zip(&self.scale).map(|(c, s)| (c * s).powi(2)).sum::<f64>().sqrt();
        if size == 0.0 { 1.0 } else { size }
    }

    /// M, the bound of the multipliers.
    fn multiplier_max(&self) -> f64 {
        self.penalty * self.b.iter().fold(1.0f64, |s, v| s.max(v.abs()))
    }

    fn evaluate(&self, problem: &Problem<'_>, z: &[f64], force: &mut [f64]) {
        Arch::new().dispatch(Evaluation { solver: self, d: problem.d, z, force });
    }

    fn merit(&self, z: &[f64], force: &[f64]) -> f64 {
        (0..force.len()).map(|i| component(z[i] - self.low[i], self.high[i] - z[i], force[i]).0.powi(2)).sum()
    }

    /// Semismooth Newton on the working set; returns iterations and the natural residual.
    fn newton(
        &mut self,
        problem: &Problem<'_>,
        size: f64,
        stop: &mut dyn FnMut() -> bool,
        stopped: &mut bool,
    ) -> (usize, f64) {
        let m = self.n + self.row_of.len();
        let mut force = std::mem::take(&mut self.force);
        let mut trial = std::mem::take(&mut self.trial);
        let mut z = std::mem::take(&mut self.z);
        let (n, p) = (self.n, self.row_of.len());
        self.evaluate(problem, &z, &mut force[..m]);
        let mut residual = self.natural(&z[..m], &force[..m]);
        let mut iterations = 0;
        while residual > TOLERANCE * size && iterations < ITERATIONS_MAX {
            iterations += 1;
            let mut merit = 0.0;
            for i in 0..m {
                let (psi, w) = component(z[i] - self.low[i], self.high[i] - z[i], force[i]);
                self.psi[i] = psi;
                self.weight[i] = w;
                merit += psi * psi;
            }
            // Rows of the generalised Jacobian: -(w0 e_i + w1 F'_i).
            for i in 0..m {
                let [w0, w1] = self.weight[i];
                let row = &mut self.jacobian[i * m..(i + 1) * m];
                if i < n {
                    for j in 0..n {
                        row[j] = w1 * self.a[i * n + j];
                    }
                    for k in 0..p {
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
                self.step[i] = self.psi[i];
            }
            if !dense::solve_in_place(m, &mut self.jacobian[..m * m], &mut self.step[..m]) {
                break;
            }
            // Line search on the merit function; a step that solves the linearised problem exactly is taken whole.
            let mut share = 1.0;
            loop {
                for i in 0..m {
                    trial[i] = z[i] + share * self.step[i];
                }
                self.evaluate(problem, &trial, &mut force[..m]);
                let next = self.merit(&trial[..m], &force[..m]);
                if next <= (1.0 - 1e-4 * share) * merit || share < 1e-6 || next <= (TOLERANCE * size).powi(2) {
                    break;
                }
                share *= 0.5;
            }
            std::mem::swap(&mut z, &mut trial);
            residual = self.natural(&z[..m], &force[..m]);
            // Every solve may make one step, whatever the time: a machine that is always late moves all the same.
            *stopped = stop();
            if *stopped {
                break;
            }
        }
        self.force = force;
        self.trial = trial;
        self.z = z;
        (iterations, residual)
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
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    struct Case {
        a: Vec<f64>,
        b: Vec<f64>,
        lower: Vec<f64>,
        upper: Vec<f64>,
        c: Vec<f64>,
        d: Vec<f64>,
    }

    impl Case {
        fn problem(&self) -> Problem<'_> {
            Problem { a: &self.a, b: &self.b, lower: &self.lower, upper: &self.upper, c: &self.c, d: &self.d }
        }
    }

    /// Random strictly convex problems with weights spread over 12 decades; feasible rows unless told.
    fn random(n: usize, rows: usize, seed: u64) -> Case {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let root: Vec<f64> = (0..n * n).map(|_| rng.random_range(-1.0..1.0)).collect();
        let weight: Vec<f64> = (0..n).map(|_| 10f64.powf(rng.random_range(4.0..7.0))).collect();
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                a[i * n + j] = (0..n).map(|k| root[k * n + i] * root[k * n + j] * weight[k]).sum();
            }
            a[i * n + i] += 1e4;
        }
        let inside: Vec<f64> = (0..n).map(|_| rng.random_range(0.0..220.0)).collect();
        let wanted: Vec<f64> = (0..n).map(|_| rng.random_range(-100.0..320.0)).collect();
        let b = (0..n).map(|i| -(0..n).map(|j| a[i * n + j] * wanted[j]).sum::<f64>()).collect();
        let c: Vec<f64> = (0..rows * n).map(|_| rng.random_range(-1e-3..1e-3)).collect();
        let d = (0..rows)
            .map(|r| rng.random_range(0.0..0.01) - (0..n).map(|j| c[r * n + j] * inside[j]).sum::<f64>())
            .collect();
        Case { a, b, lower: vec![0.0; n], upper: vec![220.0; n], c, d }
    }

    fn kkt(case: &Case, u: &[f64], mu: &[f64]) -> f64 {
        let n = u.len();
        let mut worst = 0.0f64;
        for i in 0..n {
            let mut g = case.b[i] + (0..n).map(|j| case.a[i * n + j] * u[j]).sum::<f64>();
            g -= (0..mu.len()).map(|r| case.c[r * n + i] * mu[r]).sum::<f64>();
            let g = g / case.a[i * n + i];
            worst = worst.max((u[i] - (u[i] - g).clamp(case.lower[i], case.upper[i])).abs());
        }
        // Multipliers are costs per metre, up to 1e9 here: compare them by their share of the largest.
        let largest = mu.iter().fold(1.0f64, |a, m| a.max(*m));
        for (r, m) in mu.iter().map(|m| m / largest).enumerate() {
            let s = case.d[r] + (0..n).map(|j| case.c[r * n + j] * u[j]).sum::<f64>();
            assert!(s > -1e-7 && m >= 0.0 && s.min(m).abs() < 1e-7, "row {r}: {s} {m}");
        }
        worst
    }

    #[test]
    fn complementarity_holds_at_the_solution_of_random_box_problems() {
        let mut most = 0;
        for seed in 0..200 {
            let case = random(24, 0, seed);
            let mut solver = Solver::new(24, 0);
            let mut u = vec![0.0; 24];
            let report = solver.solve(&case.problem(), &mut u, &mut || false);
            assert_eq!(report.status, Status::Optimal, "seed {seed} {report:?}");
            assert!(kkt(&case, &u, &[]) < 1e-8, "seed {seed} {report:?} {}", kkt(&case, &u, &[]));
            most = most.max(report.iterations);
        }
        assert!(most <= 60, "{most} iterations");
    }

    #[test]
    fn complementarity_holds_with_rows_and_with_duplicated_rows() {
        for seed in 0..200 {
            let mut case = random(24, 12, seed);
            for copy in 0..4 {
                let row = case.c[copy * 24..(copy + 1) * 24].to_vec();
                case.c.extend(row);
                case.d.push(case.d[copy]);
            }
            let mut solver = Solver::new(24, 16);
            let mut u = vec![110.0; 24];
            let report = solver.solve(&case.problem(), &mut u, &mut || false);
            assert_eq!(report.status, Status::Optimal, "seed {seed} {report:?}");
            assert!(kkt(&case, &u, solver.multipliers()) < 1e-6, "seed {seed} {report:?}");
        }
    }

    #[test]
    fn conflicting_rows_are_relaxed_and_the_status_says_so() {
        let mut case = random(6, 0, 3);
        // u_0 >= 100 and u_0 <= 50 together.
        case.c = [vec![1.0, 0.0, 0.0, 0.0, 0.0, 0.0], vec![-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]].concat();
        case.d = vec![-100.0, 50.0];
        let mut u = vec![0.0; 6];
        let report = Solver::new(6, 2).solve(&case.problem(), &mut u, &mut || false);
        assert_eq!(report.status, Status::Relaxed, "{report:?}");
        assert!(u[0] > 49.9 && u[0] < 100.1, "{u:?}");
        assert!(u.iter().all(|v| (0.0..=220.0).contains(v)));
    }

    #[test]
    fn a_problem_that_is_not_finite_is_not_optimal_and_its_answer_stays_in_the_box() {
        for entry in [f64::NAN, f64::INFINITY] {
            let mut case = random(6, 0, 3);
            case.b[2] = entry;
            let mut u = vec![10.0; 6];
            let report = Solver::new(6, 0).solve(&case.problem(), &mut u, &mut || false);
            assert_eq!(report.status, Status::IterationLimit, "{entry}: {report:?}");
            assert!(u.iter().all(|v| (0.0..=220.0).contains(v)), "{entry}: {u:?}");
        }
    }

    /// Many rows of which a random start violates most, and rows that contradict each other.
    fn hard(seed: u64) -> Case {
        let n = 24;
        let mut case = random(n, 60, seed);
        if seed % 2 == 1 {
            for row in 0..20 {
                let opposite: Vec<f64> = case.c[row * n..(row + 1) * n].iter().map(|c| -c).collect();
                case.c.extend(opposite);
                case.d.push(-case.d[row] - 0.01);
            }
        }
        case
    }

    #[test]
    fn a_solve_that_is_stopped_anywhere_is_bounded_and_no_worse_than_its_start() {
        let (mut stopped, mut gained) = (0, 0);
        for seed in 0..12 {
            let case = hard(seed);
            let problem = case.problem();
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let start: Vec<f64> = (0..24).map(|_| rng.random_range(0.0..220.0)).collect();
            let mut solver = Solver::new(24, 80);
            let (mut least, mut last) = (f64::INFINITY, f64::INFINITY);
            for k in (0..12).chain([20, 30, 50, 80, 120, 200, usize::MAX]) {
                let (mut asked, mut late) = (0, 0);
                let mut u = start.clone();
                let report = solver.solve(&problem, &mut u, &mut || {
                    late += usize::from(asked > k);
                    asked += 1;
                    asked > k
                });
                let (before, after) = (solver.penalized(&problem, &start), solver.penalized(&problem, &u));
                assert!(after <= before * (1.0 + 1e-12 * before.signum()), "seed {seed} k {k}: {after} from {before}");
                assert!(u.iter().all(|v| (0.0..=220.0).contains(v)), "seed {seed} k {k}: {u:?}");
                assert_eq!(late, 0, "seed {seed} k {k}: asked after the end");
                // The iteration after which it was said is the last.
                assert_eq!(report.iterations, asked, "seed {seed} k {k}: {report:?}");
                assert!(report.iterations <= k.saturating_add(1), "seed {seed} k {k}: {report:?}");
                if !report.status.is_optimal() && asked > k {
                    assert_eq!(report.status, Status::Stopped);
                    stopped += 1;
                    gained += usize::from(after < before);
                }
                least = least.min(after);
                last = after;
            }
            // No stopped answer is better than the solved one.
            assert!(last <= least + 1e-6 * least.abs(), "seed {seed}: {last}, {least} on the way");
        }
        assert!(stopped > 60 && gained > 30, "{stopped} stops, {gained} of them with a better answer");
    }

    #[test]
    fn a_warm_start_at_the_answer_needs_no_iteration() {
        let case = random(24, 0, 9);
        let mut solver = Solver::new(24, 0);
        let mut u = vec![0.0; 24];
        solver.solve(&case.problem(), &mut u, &mut || false);
        let again = solver.solve(&case.problem(), &mut u.clone(), &mut || false);
        assert!(again.iterations <= 1, "{again:?}");
    }
}
