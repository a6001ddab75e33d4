//! The improved particle swarm, Algorithm 1 with (29)-(36), and the standard one (29) for comparison.
//!
//! Cost (28): the quadratic of (15a) plus `nu` times the penalty (27) of every pair within reach. A particle costs one
//! column of one matrix product (tensions to `A u` and to the positions of the potential collision points, both
//! affine) plus its distances. Anytime: the caller's `stop` is asked once per sweep; the answer is the best particle
//! so far, always inside the box, never worse than a seed.

use super::problem::Quadratic;
use crate::collision::{ObstacleSet, Proximity, penalty};
use crate::config::SwarmConfig;
use nalgebra::Vector3;
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
    product: Vec<f64>,
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
            product: vec![0.0; columns * n.max(3)],
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
        let n = self.n;
        self.cost[..m].fill(quadratic.c);
        for i in 0..n {
            let product = &mut self.product[..m];
            product.fill(2.0 * quadratic.b[i]);
            for k in 0..n {
                axpy(quadratic.a[i * n + k], &self.position[k * m..(k + 1) * m], product);
            }
            for ((c, p), x) in self.cost[..m].iter_mut().zip(&*product).zip(&self.position[i * m..(i + 1) * m]) {
                *c += p * x;
            }
        }
        // `order` serves as the mark of infeasible particles until the selection needs it.
        self.order.clear();
        self.order.resize(m, 0);
        for (r, row) in pairs.rows.iter().enumerate() {
            let (xyz, _) = self.product.split_at_mut(3 * m);
            for c in 0..3 {
                let out = &mut xyz[c * m..(c + 1) * m];
                out.fill(pairs.origin[3 * r + c]);
                let slope = &pairs.slope[(3 * r + c) * n..(3 * r + c + 1) * n];
                for k in 0..n {
                    axpy(slope[k], &self.position[k * m..(k + 1) * m], out);
                }
            }
            for j in 0..m {
                let at = Vector3::new(xyz[j], xyz[m + j], xyz[2 * m + j]);
                let d = pairs.obstacles.moved_distance(row, &at) - pairs.required[r];
                if d < 0.0 {
                    self.cost[j] += nu * penalty(d + pairs.clearance, pairs.clearance, pairs.length[r]).0;
                    if d < -FEASIBLE_M {
                        self.order[j] = 1;
                    }
                    if strict.is_some_and(|limit| -d > limit) {
                        self.cost[j] = f64::INFINITY;
                    }
                }
            }
        }
        // A cost that is not a number never wins, and never compares.
        self.cost[..m].iter_mut().for_each(|c| {
            if c.is_nan() {
                *c = f64::INFINITY;
            }
        });
        self.order.iter().filter(|&&mark| mark == 0).count()
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

fn axpy(f: f64, x: &[f64], y: &mut [f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += f * x;
    }
}
