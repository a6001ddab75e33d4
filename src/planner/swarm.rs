//! The improved particle swarm, Algorithm 1 with (29)-(36), and the standard one (29) for comparison.
//!
//! Cost (28): the quadratic of (15a) plus `nu` times the penalty (27) of every pair within reach. A particle costs one
//! column of one matrix product (tensions to `A u` and to the positions of the potential collision points, both
//! affine) plus its distances. Anytime: the caller's `stop` is asked once per sweep; the answer is the best particle
//! so far, always inside the box, never worse than a seed.

use super::problem::Quadratic;
use crate::collision::{ObstacleSet, Proximity, penalty};
use crate::config::SwarmConfig;
use crate::math::simd::{Columns, Lanes, Scalars};
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

/// What ended the search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// No improvement for the configured number of sweeps.
    Stalled,
    /// All sweeps done.
    SweepsDone,
    /// The deadline came.
    BudgetSpent,
}

impl Report {
    /// True where the search itself found its answer or confirmed a seed among its particles; false where a swarm that
    /// knows no seeds found nothing as good as one: it then says nothing about that seed.
    pub fn found(&self) -> bool {
        !self.beaten
    }
}

/// Report of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// What ended it.
    pub status: Status,
    /// Sweeps.
    pub sweeps: usize,
    /// Cost evaluations.
    pub evaluations: usize,
    /// Cost (28) of the answer.
    pub cost: f64,
    /// Share of feasible particles in the last sweep (theta).
    pub feasible: f64,
    /// Index of the seed that was never beaten, if one was not.
    pub seed: Option<usize>,
    /// True where a seed that was not among the particles is better than all that they found.
    beaten: bool,
}

/// Pairs as the swarm sees them: positions affine in the tensions.
#[derive(Debug, Clone, Copy)]
pub struct Pairs<'a> {
    /// Rows found at the iterate.
    pub rows: &'a [Proximity],
    /// Least distance of each row (m).
    pub required: &'a [f64],
    /// Length r of the penalty's argument `(d + r)/(d_s + r)` per row (m); `d` is shifted so that the penalty starts
    /// at the required distance.
    pub length: &'a [f64],
    /// d_s (m).
    pub clearance: f64,
    /// Position at zero tension, 3 per row (m).
    pub origin: &'a [f64],
    /// Its derivative, 3 x cables per row (m/N).
    pub slope: &'a [f64],
    /// The obstacles that the rows were found with.
    pub obstacles: &'a ObstacleSet,
}

/// Which algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// Algorithm 1.
    Improved,
    /// (29) alone, uniform start, no seeds among the particles; the answer is still never worse than a seed.
    Standard,
}

/// A swarm with all memory made at start. Matrices hold one particle per column, so one sweep is one pass of
/// contiguous multiply-adds.
#[derive(Debug, Clone)]
pub struct Swarm {
    n: usize,
    columns: usize,
    position: Vec<f64>,
    velocity: Vec<f64>,
    best: Vec<f64>,
    best_cost: Vec<f64>,
    cost: Vec<f64>,
    order: Vec<usize>,
    place: Vec<f64>,
    infeasible: Vec<bool>,
    answer: Vec<f64>,
}

/// Largest violation (m) of a distance that still counts as feasible.
const FEASIBLE_M: f64 = 1e-9;

impl Swarm {
    /// Room for `n` tensions, the configured particles and `seeds`. Allocates.
    pub fn new(n: usize, config: &SwarmConfig, seeds: usize) -> Self {
        let columns = config.particles_normal + config.particles_uniform + seeds;
        Self {
            n,
            columns,
            position: vec![0.0; n * columns],
            velocity: vec![0.0; n * columns],
            best: vec![0.0; n * columns],
            best_cost: vec![0.0; columns],
            cost: vec![0.0; columns],
            order: Vec::with_capacity(columns),
            place: vec![0.0; 3 * columns],
            infeasible: vec![false; columns],
            answer: vec![0.0; n],
        }
    }

    /// The best tensions of the last search (N).
    pub fn answer(&self) -> &[f64] {
        &self.answer
    }

    /// Searches. `seeds`: u_{k-1} first, then u^(j), then any other candidate. Where `strict` is given, a particle
    /// whose worst violation exceeds it costs infinity: the soft penalty may not undercut a seed that is feasible.
    /// Does not allocate.
    ///
    /// # Panics
    /// If there are more particles or seeds than the swarm has room for.
    pub fn search(
        &mut self,
        variant: Variant,
        config: &SwarmConfig,
        quadratic: &Quadratic,
        pairs: &Pairs<'_>,
        lower: &[f64],
        upper: &[f64],
        seeds: &[&[f64]],
        strict: Option<f64>,
        rng: &mut Xoshiro256PlusPlus,
        stop: &mut dyn FnMut() -> bool,
    ) -> Report {
        let n = self.n;
        let random = config.particles_normal + config.particles_uniform;
        assert!(random + seeds.len() <= self.columns, "more particles than the room for {}", self.columns);
        // The standard swarm knows no seeds: they are judged against its answer at the end.
        let (m, late) = match variant {
            Variant::Improved => (random + seeds.len(), &[][..]),
            Variant::Standard => (random, seeds),
        };
        self.initialise(m, variant, config, lower, upper, seeds, rng);

        let mut global = (f64::INFINITY, usize::MAX);
        let mut report = Report {
            status: Status::SweepsDone,
            sweeps: 0,
            evaluations: 0,
            cost: f64::INFINITY,
            feasible: 0.0,
            seed: None,
            beaten: false,
        };
        let mut stall = 0;
        self.best_cost[..m].fill(f64::INFINITY);
        loop {
            // The seeds are judged even when the time is already over: the answer is never worse than they are.
            let feasible = self.evaluate(m, quadratic, pairs, config.penalty, strict);
            report.evaluations += m;
            report.feasible = feasible as f64 / m as f64;
            let before = global.0;
            for j in 0..m {
                if self.cost[j] < self.best_cost[j] {
                    self.best_cost[j] = self.cost[j];
                    for d in 0..n {
                        self.best[d * m + j] = self.position[d * m + j];
                    }
                    if self.cost[j] < global.0 {
                        global = (self.cost[j], j);
                        report.seed = (report.sweeps == 0 && j >= random).then(|| j - random);
                        for d in 0..n {
                            self.answer[d] = self.position[d * m + j];
                        }
                    }
                }
            }
            report.sweeps += 1;
            report.cost = global.0;
            let gain = before - global.0;
            stall = if gain > config.tolerance * global.0.abs() { 0 } else { stall + 1 };
            if report.sweeps >= config.sweeps_max {
                break;
            }
            if stall >= config.stall_sweeps {
                report.status = Status::Stalled;
                break;
            }
            if stop() {
                report.status = Status::BudgetSpent;
                break;
            }
            let chaotic = match variant {
                Variant::Standard => 0,
                // (36)
                Variant::Improved => {
                    let (few, many) = (config.chaotic_min as f64, config.chaotic_max as f64);
                    ((few + (1.0 - report.feasible) * (many - few)).round() as usize).min(m - 1)
                }
            };
            self.advance(m, chaotic, report.sweeps, config, lower, upper, rng);
        }
        if !late.is_empty() {
            self.judge(late, lower, upper, quadratic, pairs, config.penalty, strict, &mut report);
        }
        report
    }

    /// Takes the best of `seeds` for the answer where it beats it.
    fn judge(
        &mut self,
        seeds: &[&[f64]],
        lower: &[f64],
        upper: &[f64],
        quadratic: &Quadratic,
        pairs: &Pairs<'_>,
        nu: f64,
        strict: Option<f64>,
        report: &mut Report,
    ) {
        let m = seeds.len();
        for (j, seed) in seeds.iter().enumerate() {
            for d in 0..self.n {
                self.position[d * m + j] = seed[d].clamp(lower[d], upper[d]);
            }
        }
        self.evaluate(m, quadratic, pairs, nu, strict);
        report.evaluations += m;
        for j in 0..m {
            if self.cost[j] < report.cost {
                report.cost = self.cost[j];
                report.seed = Some(j);
                report.beaten = true;
                for d in 0..self.n {
                    self.answer[d] = self.position[d * m + j];
                }
            }
        }
    }

    /// (30)-(32), or the standard swarm's uniform start.
    fn initialise(
        &mut self,
        m: usize,
        variant: Variant,
        config: &SwarmConfig,
        lower: &[f64],
        upper: &[f64],
        seeds: &[&[f64]],
        rng: &mut Xoshiro256PlusPlus,
    ) {
        let random = config.particles_normal + config.particles_uniform;
        for d in 0..self.n {
            let row = &mut self.position[d * m..(d + 1) * m];
            let span = upper[d] - lower[d];
            for (j, x) in row.iter_mut().enumerate() {
                *x = if j >= random {
                    seeds[j - random][d]
                } else if variant == Variant::Improved && j < config.particles_normal {
                    let z: f64 = StandardNormal.sample(rng);
                    seeds[0][d] + config.sigma_n * z
                } else {
                    lower[d] + rng.random::<f64>() * span
                };
                *x = x.clamp(lower[d], upper[d]);
            }
        }
        self.velocity[..self.n * m].fill(0.0);
    }

    /// Costs (28) of all particles; returns how many are feasible.
    fn evaluate(&mut self, m: usize, quadratic: &Quadratic, pairs: &Pairs<'_>, nu: f64, strict: Option<f64>) -> usize {
        self.infeasible[..m].fill(false);
        Arch::new().dispatch(Evaluation {
            m,
            position: &self.position[..self.n * m],
            quadratic,
            pairs,
            nu,
            strict,
            cost: &mut self.cost[..m],
            infeasible: &mut self.infeasible[..m],
            place: &mut self.place,
        });
        let mut feasible = 0;
        for (cost, infeasible) in self.cost[..m].iter_mut().zip(&self.infeasible) {
            // A cost that is not a number never wins, and never compares.
            if cost.is_nan() {
                *cost = f64::INFINITY;
            }
            feasible += usize::from(!infeasible);
        }
        feasible
    }

    /// (29) for the best, (33)-(35) for the worst `chaotic` particles.
    fn advance(
        &mut self,
        m: usize,
        chaotic: usize,
        sweep: usize,
        config: &SwarmConfig,
        lower: &[f64],
        upper: &[f64],
        rng: &mut Xoshiro256PlusPlus,
    ) {
        let progress = sweep as f64 / config.sweeps_max as f64;
        let inertia = config.inertia[0] + progress * (config.inertia[1] - config.inertia[0]);
        self.order.clear();
        self.order.extend(0..m);
        let first = m - chaotic;
        if chaotic > 0 {
            let cost = &self.cost;
            self.order.select_nth_unstable_by(first, |&a, &b| cost[a].total_cmp(&cost[b]).then(a.cmp(&b)));
        }
        for (place, &j) in self.order.iter().enumerate() {
            for d in 0..self.n {
                let k = d * m + j;
                let (low, high) = (lower[d], upper[d]);
                if place < first {
                    let (t1, t2) = (rng.random::<f64>(), rng.random::<f64>());
                    let x = self.position[k];
                    let v = inertia * self.velocity[k]
                        + config.acceleration[0] * t1 * (self.best[k] - x)
                        + config.acceleration[1] * t2 * (self.answer[d] - x);
                    let next = (x + v).clamp(low, high);
                    // A particle stopped by the wall loses the speed that carried it there.
                    self.velocity[k] = next - x;
                    self.position[k] = next;
                } else if high > low {
                    let p = (self.position[k] - low) / (high - low);
                    self.position[k] = (low + 4.0 * p * (1.0 - p) * (high - low)).clamp(low, high);
                }
            }
        }
    }
}

/// [`Swarm::evaluate`] with the processor's vectors.
struct Evaluation<'a> {
    m: usize,
    position: &'a [f64],
    quadratic: &'a Quadratic,
    pairs: &'a Pairs<'a>,
    nu: f64,
    strict: Option<f64>,
    cost: &'a mut [f64],
    infeasible: &'a mut [bool],
    /// Positions of one pair's point for all particles, coordinate by coordinate.
    place: &'a mut [f64],
}

impl WithSimd for Evaluation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { m, position, quadratic, pairs, nu, strict, cost, infeasible, place } = self;
        let mut j = 0;
        while j < m {
            j += if j + S::F64_LANES > m {
                quadratic_cost(Scalars, quadratic, position, m, j, cost)
            } else {
                quadratic_cost(Lanes(simd), quadratic, position, m, j, cost)
            };
        }
        let n = position.len() / m;
        for (r, row) in pairs.rows.iter().enumerate() {
            let origin = &pairs.origin[3 * r..3 * r + 3];
            let slope = &pairs.slope[3 * r * n..3 * (r + 1) * n];
            let mut j = 0;
            while j < m {
                j += if j + S::F64_LANES > m {
                    place_points(Scalars, origin, slope, position, m, j, place)
                } else {
                    place_points(Lanes(simd), origin, slope, position, m, j, place)
                };
            }
            let (x, yz) = place[..3 * m].split_at(m);
            let (y, z) = yz.split_at(m);
            let mut judge = |j: usize, d: f64| {
                cost[j] += nu * penalty(d + pairs.clearance, pairs.clearance, pairs.length[r]).0;
                infeasible[j] |= d < -FEASIBLE_M;
                if strict.is_some_and(|limit| -d > limit) {
                    cost[j] = f64::INFINITY;
                }
            };
            match pairs.obstacles.ball(row) {
                // Most points of most particles keep their distance: they need no root.
                Some((centre, radius)) => {
                    let least = radius + row.inflation + pairs.required[r];
                    let least_squared = if least > 0.0 { least * least } else { 0.0 };
                    for j in 0..m {
                        let squared =
                            (x[j] - centre[0]).powi(2) + (y[j] - centre[1]).powi(2) + (z[j] - centre[2]).powi(2);
                        if squared < least_squared || squared.is_nan() {
                            judge(j, squared.sqrt() - least);
                        }
                    }
                }
                None => {
                    for j in 0..m {
                        let at = Vector3::new(x[j], y[j], z[j]);
                        let d = pairs.obstacles.moved_distance(row, &at) - pairs.required[r];
                        if d < 0.0 {
                            judge(j, d);
                        }
                    }
                }
            }
        }
    }
}

/// Rows of A that are multiplied at once: each position is then read once for all of them.
const ROWS: usize = 4;

/// `c + x^T (A x + 2 b)` of the particles `j..`; returns how many were done.
#[inline(always)]
fn quadratic_cost<C: Columns>(
    w: C,
    quadratic: &Quadratic,
    position: &[f64],
    m: usize,
    j: usize,
    cost: &mut [f64],
) -> usize {
    let n = quadratic.b.len();
    let mut total = w.splat(quadratic.c);
    let mut i = 0;
    while i < n {
        let rows = ROWS.min(n - i);
        let mut sum = [w.splat(0.0); ROWS];
        // A last group of fewer rows repeats its last one and leaves the copies out.
        let a: [&[f64]; ROWS] = std::array::from_fn(|k| {
            let row = i + k.min(rows - 1);
            &quadratic.a[row * n..(row + 1) * n]
        });
        for k in 0..rows {
            sum[k] = w.splat(2.0 * quadratic.b[i + k]);
        }
        for d in 0..n {
            let x = w.load(&position[d * m + j..]);
            for k in 0..ROWS {
                sum[k] = w.multiply_add(w.splat(a[k][d]), x, sum[k]);
            }
        }
        for k in 0..rows {
            total = w.multiply_add(w.load(&position[(i + k) * m + j..]), sum[k], total);
        }
        i += ROWS;
    }
    w.store(total, &mut cost[j..]);
    C::WIDTH
}

/// `origin + slope x` of the particles `j..`; returns how many were done.
#[inline(always)]
fn place_points<C: Columns>(
    w: C,
    origin: &[f64],
    slope: &[f64],
    position: &[f64],
    m: usize,
    j: usize,
    place: &mut [f64],
) -> usize {
    let n = slope.len() / 3;
    let (sx, syz) = slope.split_at(n);
    let (sy, sz) = syz.split_at(n);
    let mut at = [w.splat(origin[0]), w.splat(origin[1]), w.splat(origin[2])];
    for d in 0..n {
        let u = w.load(&position[d * m + j..]);
        at[0] = w.multiply_add(w.splat(sx[d]), u, at[0]);
        at[1] = w.multiply_add(w.splat(sy[d]), u, at[1]);
        at[2] = w.multiply_add(w.splat(sz[d]), u, at[2]);
    }
    for (c, at) in at.into_iter().enumerate() {
        w.store(at, &mut place[c * m + j..]);
    }
    C::WIDTH
}
