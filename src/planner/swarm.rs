//! The improved particle swarm, Algorithm 1 with (29)-(36), and the standard one (29) for comparison.
//!
//! Cost (28): the quadratic of (15a) plus `nu` times the penalty (27) of every pair within reach. A particle costs one
//! column of one matrix product (tensions to `A u` and to the positions of the potential collision points, both
//! affine) plus its distances. Anytime: the caller's `stop` is asked once per sweep; the answer is the best particle
//! so far, always inside the box, never worse than a seed.

use super::problem::Quadratic;
use crate::collision::{ObstacleSet, Proximity, penalty};
use crate::config::SwarmConfig;
use crate::math::simd::{Columns, Lanes, Number, Scalars};
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};
use rand::{Rng, RngExt};
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
    /// True where a seed that was not among the particles is better than all that they found.
    beaten: bool,
}

impl Report {
    /// True where the search itself found its answer or confirmed a seed among its particles; false where a swarm that
    /// knows no seeds found nothing as good as one: it then says nothing about that seed.
    pub fn found(&self) -> bool {
        !self.beaten
    }
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
    /// Triangle of the quadratic.
    upper: Vec<f64>,
    chaotic: Vec<bool>,
    bits: Vec<u64>,
}

/// Distance of the rows of a matrix with `m` particles: whole vectors, so that none is left over to be done one by one.
/// The columns between are moved and costed along, and never looked at.
const fn stride(m: usize) -> usize {
    m.next_multiple_of(4)
}

/// Largest violation (m) of a distance that still counts as feasible.
const FEASIBLE_M: f64 = 1e-9;

impl Swarm {
    /// Room for `n` tensions, the configured particles and `seeds`. Allocates.
    pub fn new(n: usize, config: &SwarmConfig, seeds: usize) -> Self {
        let columns = config.particles_normal + config.particles_uniform + seeds;
        let stride = stride(columns);
        Self {
            n,
            columns,
            position: vec![0.0; n * stride],
            velocity: vec![0.0; n * stride],
            best: vec![0.0; n * stride],
            best_cost: vec![0.0; columns],
            cost: vec![0.0; stride],
            order: Vec::with_capacity(columns),
            place: vec![0.0; 3 * stride],
            infeasible: vec![false; stride],
            answer: vec![0.0; n],
            upper: vec![0.0; n * n],
            chaotic: vec![false; stride],
            bits: vec![0; stride],
        }
    }

    /// The best tensions of the last search (N).
    pub fn answer(&self) -> &[f64] {
        &self.answer
    }

    /// Searches. `seeds`: u_{k-1} first, then u^(j), then any other candidate. `strict` bounds the violation (m) of each
    /// pair, or is empty: a particle that exceeds any of the bounds costs infinity, so that the soft penalty may not
    /// undercut a seed that keeps them. Does not allocate.
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
        strict: &[f64],
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
        self.fold(quadratic);
        self.initialise(m, variant, config, lower, upper, seeds, rng);

        let stride = stride(m);
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
                        self.best[d * stride + j] = self.position[d * stride + j];
                    }
                    if self.cost[j] < global.0 {
                        global = (self.cost[j], j);
                        report.seed = (report.sweeps == 0 && j >= random).then(|| j - random);
                        for d in 0..n {
                            self.answer[d] = self.position[d * stride + j];
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
        strict: &[f64],
        report: &mut Report,
    ) {
        let m = seeds.len();
        let stride = stride(m);
        for (j, seed) in seeds.iter().enumerate() {
            for d in 0..self.n {
                self.position[d * stride + j] = seed[d].clamp(lower[d], upper[d]);
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
                    self.answer[d] = self.position[d * stride + j];
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
        let stride = stride(m);
        for d in 0..self.n {
            let row = &mut self.position[d * stride..(d + 1) * stride];
            let span = upper[d] - lower[d];
            row[m..].fill(lower[d]);
            for (j, x) in row[..m].iter_mut().enumerate() {
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
        self.velocity[..self.n * stride].fill(0.0);
        // Where no cost is a number, nothing of an earlier search may show.
        self.best[..self.n * stride].copy_from_slice(&self.position[..self.n * stride]);
        for (d, seed) in seeds[0].iter().enumerate() {
            self.answer[d] = seed.clamp(lower[d], upper[d]);
        }
    }

    /// Costs (28) of all particles; returns how many are feasible.
    fn evaluate(&mut self, m: usize, quadratic: &Quadratic, pairs: &Pairs<'_>, nu: f64, strict: &[f64]) -> usize {
        let stride = stride(m);
        self.infeasible[..m].fill(false);
        Arch::new().dispatch(Evaluation {
            m,
            stride,
            position: &self.position[..self.n * stride],
            upper: &self.upper,
            quadratic,
            pairs,
            nu,
            strict,
            cost: &mut self.cost[..stride],
            infeasible: &mut self.infeasible[..stride],
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
        let stride = stride(m);
        self.order.clear();
        self.order.extend(0..m);
        let first = m - chaotic;
        if chaotic > 0 {
            let cost = &self.cost;
            self.order.select_nth_unstable_by(first, |&a, &b| cost[a].total_cmp(&cost[b]).then(a.cmp(&b)));
        }
        self.chaotic[..stride].fill(false);
        for &j in &self.order[first..] {
            self.chaotic[j] = true;
        }
        Arch::new().dispatch(Advance { swarm: self, stride, inertia, config, lower, upper, rng });
    }

    /// The triangle U with `u^T U u = u^T A u`: half the products of the symmetric matrix.
    fn fold(&mut self, quadratic: &Quadratic) {
        let n = self.n;
        for i in 0..n {
            let (row, a) = (&mut self.upper[i * n..(i + 1) * n], &quadratic.a[i * n..(i + 1) * n]);
            row[..i].fill(0.0);
            row[i] = a[i];
            for d in i + 1..n {
                row[d] = a[d] + quadratic.a[d * n + i];
            }
        }
    }
}

/// [`Swarm::advance`] with the processor's vectors, tension by tension.
struct Advance<'a> {
    swarm: &'a mut Swarm,
    stride: usize,
    inertia: f64,
    config: &'a SwarmConfig,
    lower: &'a [f64],
    upper: &'a [f64],
    rng: &'a mut Xoshiro256PlusPlus,
}

impl WithSimd for Advance<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { swarm, stride, inertia, config, lower, upper, rng } = self;
        let [own, social] = config.acceleration;
        let (chaotic, bits) = (&swarm.chaotic[..stride], &mut swarm.bits[..stride]);
        for d in 0..swarm.n {
            let row = d * stride..(d + 1) * stride;
            bits.iter_mut().for_each(|b| *b = rng.next_u64());
            let (low, high, answer) = (lower[d], upper[d], swarm.answer[d]);
            let span = high - low;
            let inverse = if span > 0.0 { 1.0 / span } else { 0.0 };
            let columns = swarm.position[row.clone()].iter_mut().zip(&mut swarm.velocity[row.clone()]);
            for (((x, v), best), (bits, chaotic)) in columns.zip(&swarm.best[row]).zip(bits.iter().zip(chaotic)) {
                // One number of the source is both of (29): 32 bits each are more than the search can tell.
                let (t1, t2) = (unit(*bits >> 32), unit(*bits & 0xffff_ffff));
                let moved = *x + inertia * *v + own * t1 * (*best - *x) + social * t2 * (answer - *x);
                let moved = between(moved, low, high);
                let p = (*x - low) * inverse;
                let jumped = between(low + 4.0 * p * (1.0 - p) * span, low, high);
                // A particle stopped by the wall loses the speed that carried it there.
                *v = if *chaotic { *v } else { moved - *x };
                *x = if *chaotic { jumped } else { moved };
            }
        }
    }
}

/// `f64::clamp` in two instructions; what is not a number becomes `low`.
#[inline(always)]
fn between(x: f64, low: f64, high: f64) -> f64 {
    let x = if x > low { x } else { low };
    if x < high { x } else { high }
}

/// Uniform in [0, 1) from 32 bits.
#[inline(always)]
fn unit(bits: u64) -> f64 {
    f64::from_bits((bits << 20) | 1.0f64.to_bits()) - 1.0
}

/// [`Swarm::evaluate`] with the processor's vectors.
struct Evaluation<'a> {
    m: usize,
    stride: usize,
    position: &'a [f64],
    upper: &'a [f64],
    quadratic: &'a Quadratic,
    pairs: &'a Pairs<'a>,
    nu: f64,
    strict: &'a [f64],
    /// `stride` entries, as `infeasible`.
    cost: &'a mut [f64],
    infeasible: &'a mut [bool],
    /// Positions of one pair's point for all particles, coordinate by coordinate.
    place: &'a mut [f64],
}

impl WithSimd for Evaluation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { m, stride, position, upper, quadratic, pairs, nu, strict, cost, infeasible, place } = self;
        let (w, step) = (Lanes(simd), S::F64_LANES);
        let n = position.len() / stride;
        let mut j = 0;
        while j < stride {
            j += match (stride - j) / step {
                0 => quadratic_cost::<_, 1>(Scalars, upper, quadratic, position, stride, j, cost),
                1 => quadratic_cost::<_, 1>(w, upper, quadratic, position, stride, j, cost),
                // Three would not fit into the registers of AVX2.
                _ => quadratic_cost::<_, 2>(w, upper, quadratic, position, stride, j, cost),
            };
        }
        for (r, row) in pairs.rows.iter().enumerate() {
            let origin = &pairs.origin[3 * r..3 * r + 3];
            let slope = &pairs.slope[3 * r * n..3 * (r + 1) * n];
            let mut j = 0;
            while j < stride {
                j += match (stride - j) / step {
                    0 => place_points::<_, 1>(Scalars, origin, slope, position, stride, j, place),
                    1 => place_points::<_, 1>(w, origin, slope, position, stride, j, place),
                    2 => place_points::<_, 2>(w, origin, slope, position, stride, j, place),
                    _ => place_points::<_, 3>(w, origin, slope, position, stride, j, place),
                };
            }
            let (x, yz) = place[..3 * stride].split_at_mut(stride);
            let (y, z) = yz.split_at(stride);
            let limit = strict.get(r).copied().unwrap_or(f64::INFINITY);
            let mut judge = |j: usize, d: f64| {
                cost[j] += nu * penalty(d + pairs.clearance, pairs.clearance, pairs.length[r]).0;
                infeasible[j] |= d < -FEASIBLE_M;
                if -d > limit {
                    cost[j] = f64::INFINITY;
                }
            };
            match pairs.obstacles.ball(row) {
                // Most points of most particles keep their distance: they need no root.
                Some((centre, radius)) => {
                    let least = radius + row.inflation + pairs.required[r];
                    let least_squared = if least > 0.0 { least * least } else { 0.0 };
                    for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
                        let (dx, dy, dz) = (*x - centre[0], *y - centre[1], *z - centre[2]);
                        *x = dx * dx + dy * dy + dz * dz;
                    }
                    for (j, squared) in x[..m].iter().enumerate() {
                        if *squared < least_squared || squared.is_nan() {
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

/// `c + x^T (U x + 2 b)` of `B` vectors of particles from `j` on, with U the triangle of [`Swarm::fold`]; returns how
/// many were done. Several vectors at once share each entry of U.
#[inline(always)]
fn quadratic_cost<C: Columns, const B: usize>(
    w: C,
    upper: &[f64],
    quadratic: &Quadratic,
    position: &[f64],
    stride: usize,
    j: usize,
    cost: &mut [f64],
) -> usize {
    let n = quadratic.b.len();
    let mut total = [w.splat(quadratic.c); B];
    let mut i = 0;
    while i < n {
        let rows = ROWS.min(n - i);
        // A last group of fewer rows repeats its last one and leaves the copies out.
        let a: [&[f64]; ROWS] = std::array::from_fn(|k| {
            let row = i + k.min(rows - 1);
            &upper[row * n..(row + 1) * n]
        });
        let mut sum: [[C::Value; B]; ROWS] =
            std::array::from_fn(|k| [w.splat(2.0 * quadratic.b[i + k.min(rows - 1)]); B]);
        for d in i..n {
            let at = &position[d * stride + j..d * stride + j + B * C::WIDTH];
            let x: [C::Value; B] = std::array::from_fn(|v| w.load(&at[v * C::WIDTH..]));
            for k in 0..ROWS {
                let f = w.splat(a[k][d]);
                for v in 0..B {
                    sum[k][v] = f.multiply_add(x[v], sum[k][v]);
                }
            }
        }
        for k in 0..rows {
            for v in 0..B {
                let x = w.load(&position[(i + k) * stride + j + v * C::WIDTH..]);
                total[v] = x.multiply_add(sum[k][v], total[v]);
            }
        }
        i += ROWS;
    }
    for v in 0..B {
        w.store(total[v], &mut cost[j + v * C::WIDTH..]);
    }
    B * C::WIDTH
}

/// `origin + slope x` of `B` vectors of particles from `j` on; returns how many were done.
#[inline(always)]
fn place_points<C: Columns, const B: usize>(
    w: C,
    origin: &[f64],
    slope: &[f64],
    position: &[f64],
    stride: usize,
    j: usize,
    place: &mut [f64],
) -> usize {
    let n = slope.len() / 3;
    let mut at: [[C::Value; B]; 3] = std::array::from_fn(|c| [w.splat(origin[c]); B]);
    for d in 0..n {
        let row = &position[d * stride + j..d * stride + j + B * C::WIDTH];
        let u: [C::Value; B] = std::array::from_fn(|v| w.load(&row[v * C::WIDTH..]));
        for c in 0..3 {
            let f = w.splat(slope[c * n + d]);
            for v in 0..B {
                at[c][v] = f.multiply_add(u[v], at[c][v]);
            }
        }
    }
    for c in 0..3 {
        for v in 0..B {
            w.store(at[c][v], &mut place[c * stride + j + v * C::WIDTH..]);
        }
    }
    B * C::WIDTH
}
