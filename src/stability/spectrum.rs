//! Eigenvalues of the map of one tick about a fixed point, without the matrix: Arnoldi's method on differences of ticks.

use super::held::Held;
use super::modes::{Layout, LoopMode, Moved};
use super::{StabilityError, growth_limit_1ps};
use crate::config::{Config, Scale};
use crate::estimator::Kept;
use crate::integrator::free_motions;
use crate::math::block_tridiagonal::COORDINATES;
use crate::model::{Linearization, Motion, Rates};
use faer::{Mat, c64};
use nalgebra::DVector;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Norm of the step to either side of the fixed point, in the units of [`Units`]: beside it the map's own rounding is a
/// millionth, and what is not linear in it another.
const STEP: f64 = 3e-4;
/// Vectors of the basis, at first and at most, and after how many more it is looked at again.
const BASIS_MIN: usize = 120;
const BASIS_MAX: usize = 420;
const BASIS_MORE: usize = 60;
/// Leading eigenvalues that must have converged, of those that do not rest, and the residual at which they have.
const LEADING: usize = 8;
const CONVERGED: f64 = 1e-6;
/// Modes that are told.
const MODES_MAX: usize = 12;

/// The slowest to fade, or fastest to grow, of the modes of a held loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Modes, the least stable one first.
    pub modes: Vec<LoopMode>,
    /// Growth (1/s) from which a mode is not stable.
    pub limit_1ps: f64,
    /// Numbers that the loop remembers from tick to tick.
    pub dimension: usize,
    /// Vectors of the basis.
    pub basis: usize,
    /// Largest residual of the leading eigenvalues.
    pub residual: f64,
}

impl Spectrum {
    /// Of a held loop. Allocates; takes about a second for the paper's arm.
    ///
    /// # Errors
    /// [`StabilityError::NoMap`].
    pub fn of(config: &Config, held: &Held) -> Result<Self, StabilityError> {
        let map = Map::new(config, held);
        let mut basis = vec![map.start()?];
        let mut h: Vec<Vec<f64>> = Vec::new();
        loop {
            let mut image = map.times(&basis[basis.len() - 1])?;
            let mut column = vec![0.0; basis.len() + 1];
            // Twice: once leaves what rounding took.
            for _ in 0..2 {
                for (c, v) in column.iter_mut().zip(&basis) {
                    let along = v.dot(&image);
                    *c += along;
                    image.axpy(-along, v, 1.0);
                }
            }
            let rest = image.norm();
            column[basis.len()] = rest;
            h.push(column);
            let m = h.len();
            let exhausted = rest < 1e-12;
            if exhausted || m == BASIS_MAX || (m >= BASIS_MIN && (m - BASIS_MIN).is_multiple_of(BASIS_MORE)) {
                let ritz = ritz(&h)?;
                let limit = growth_limit_1ps(config) * held.period_s();
                let moving = ritz.iter().filter(|r| r.value.norm_sqr().sqrt().ln().abs() > limit);
                let residual = moving.take(LEADING).map(|r| r.residual).fold(0.0, f64::max);
                if exhausted || residual < CONVERGED || m == BASIS_MAX {
                    return Ok(map.told(config, &ritz, &basis, residual));
                }
            }
            basis.push(image / rest);
        }
    }

    /// Growth (1/s) of the least stable mode.
    pub fn growth_1ps(&self) -> f64 {
        self.modes.first().map_or(f64::NEG_INFINITY, |mode| mode.growth_1ps)
    }

    /// Largest modulus of an eigenvalue.
    pub fn modulus(&self) -> f64 {
        self.modes.first().map_or(0.0, |mode| mode.modulus)
    }

    /// Whether no mode grows.
    pub fn is_stable(&self) -> bool {
        self.growth_1ps() <= self.limit_1ps
    }
}

/// An eigenvalue of the small matrix, with its vector.
struct Ritz {
    value: c64,
    vector: Vec<c64>,
    residual: f64,
}

/// Eigenvalues of the small matrix, the largest first; of a pair the one above the axis.
fn ritz(h: &[Vec<f64>]) -> Result<Vec<Ritz>, StabilityError> {
    let m = h.len();
    let small = Mat::<f64>::from_fn(m, m, |i, j| h[j].get(i).copied().unwrap_or(0.0));
    let eigen = small.eigen().map_err(|_| StabilityError::NoMap("no eigenvalues were found".to_owned()))?;
    let (values, vectors) = (eigen.S().column_vector(), eigen.U());
    let mut found: Vec<Ritz> = (0..m)
        .filter(|k| values[*k].im >= 0.0)
        .map(|k| {
            let vector: Vec<c64> = (0..m).map(|i| vectors[(i, k)]).collect();
            let norm = vector.iter().map(|y| y.norm_sqr()).sum::<f64>().sqrt();
            let residual = h[m - 1][m] * vector[m - 1].norm_sqr().sqrt() / norm;
            Ritz { value: values[k], vector, residual }
        })
        .collect();
    found.sort_by(|a, b| b.value.norm_sqr().total_cmp(&a.value.norm_sqr()));
    Ok(found)
}

/// What each kind of number is counted in, so that the numbers of a motion are alike.
struct Units {
    length_m: f64,
    time_s: f64,
    tension_n: f64,
    moment_nm: f64,
    curvature_1pm: f64,
}

impl Units {
    fn of(config: &Config) -> Self {
        let scale = Scale::of(&config.arm);
        let segment = &config.arm.segments[0];
        Self {
            length_m: scale.length_m / 3.0,
            time_s: config.planner.lookahead_s,
            tension_n: 0.05 * scale.tension_n,
            moment_nm: segment.bending_stiffness_nm2 / segment.length_m,
            curvature_1pm: 1.0 / segment.length_m,
        }
    }

    fn unit(&self, kept: Kept, index: usize) -> f64 {
        let coordinate = if index % COORDINATES < 3 { self.length_m } else { 1.0 };
        match kept {
            Kept::Coordinates => coordinate,
            Kept::Rates => coordinate / self.time_s,
            Kept::Accelerations => coordinate / self.time_s.powi(2),
            Kept::Tensions => self.tension_n,
            Kept::Moments => self.moment_nm,
            Kept::Curvatures => self.curvature_1pm,
            Kept::Angles | Kept::Shares => 1.0,
        }
    }
}

/// The map of a tick about its fixed point.
struct Map<'a> {
    held: &'a Held,
    layout: Layout,
    point: DVector<f64>,
    unit: DVector<f64>,
}

impl<'a> Map<'a> {
    fn new(config: &Config, held: &'a Held) -> Self {
        let units = Units::of(config);
        let (mut point, mut unit, mut parts) = (Vec::new(), Vec::new(), Vec::new());
        held.clone().memory(&mut |kept, values| {
            parts.push((kept, point.len(), values.len()));
            point.extend_from_slice(values);
            unit.extend((0..values.len()).map(|i| units.unit(kept, i)));
        });
        Self { held, layout: Layout::new(parts), point: DVector::from_vec(point), unit: DVector::from_vec(unit) }
    }

    /// Where a tick from beside the fixed point leads, in the units' numbers.
    fn tick(&self, along: &DVector<f64>, step: f64) -> Result<DVector<f64>, StabilityError> {
        let mut held = self.held.clone();
        let mut at = 0;
        held.memory(&mut |_, values| {
            for value in values {
                *value = self.point[at] + step * along[at] * self.unit[at];
                at += 1;
            }
        });
        held.step()?;
        let mut image = Vec::with_capacity(self.point.len());
        held.memory(&mut |_, values| image.extend_from_slice(values));
        Ok(DVector::from_vec(image).component_div(&self.unit))
    }

    fn times(&self, v: &DVector<f64>) -> Result<DVector<f64>, StabilityError> {
        Ok((self.tick(v, STEP)? - self.tick(v, -STEP)?) / (2.0 * STEP))
    }

    /// A motion of everything: arm and estimate as their constraints permit, a tick later.
    fn start(&self) -> Result<DVector<f64>, StabilityError> {
        let (arm, state) = (self.held.plant().arm(), self.held.plant().state());
        let mut linearization = Linearization::new(arm);
        let tensions = self.held.tensions_n();
        arm.linearize(&Motion::from(state), tensions, Rates::STATIC, &mut linearization);
        let z = free_motions(arm, state, &linearization.tangent);
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut random = || rng.random_range(-1.0..=1.0);
        let mut v = DVector::zeros(self.point.len());
        for &(kept, at, count) in self.layout.parts() {
            match kept {
                Kept::Coordinates | Kept::Rates => {
                    // Rotations that add up along the arm: slow modes more than fast ones.
                    let mut turns: Vec<f64> = (0..z.ncols()).map(|_| random()).collect();
                    (3..turns.len()).for_each(|i| turns[i] += turns[i - 3]);
                    let motion = &z * DVector::from_vec(turns);
                    let rate = if kept == Kept::Rates { self.unit[at + 3] } else { 1.0 };
                    (0..count).for_each(|i| v[at + i] = rate * motion[i] / self.unit[at + i]);
                }
                Kept::Accelerations => {}
                _ => (0..count).for_each(|i| v[at + i] = random()),
            }
        }
        v.normalize_mut();
        let mut moved = self.times(&v)?;
        if moved.normalize() == DVector::zeros(moved.len()) || !moved.norm().is_finite() {
            return Err(StabilityError::NoMap("nothing moves".to_owned()));
        }
        moved.normalize_mut();
        Ok(moved)
    }

    fn told(&self, config: &Config, ritz: &[Ritz], basis: &[DVector<f64>], residual: f64) -> Spectrum {
        let arm = self.held.plant().arm();
        let moved = |r: &Ritz| {
            let (mut re, mut im) = (DVector::zeros(self.point.len()), DVector::zeros(self.point.len()));
            for (y, v) in r.vector.iter().zip(basis) {
                re.axpy(y.re, v, 1.0);
                im.axpy(y.im, v, 1.0);
            }
            Moved { parts: [re.component_mul(&self.unit), im.component_mul(&self.unit)] }
        };
        let period_s = self.held.period_s();
        // Tensions against one another fade at the pace of R over W, one mode for each way; the first of them is enough.
        let (limit, mut resting) = (growth_limit_1ps(config) * period_s, 0);
        let modes = ritz
            .iter()
            .filter(|r| {
                let rests = r.value.norm_sqr().sqrt().ln().abs() <= limit && r.value.im.abs() <= limit;
                resting += usize::from(rests);
                !rests || resting == 1
            })
            .take(MODES_MAX)
            .map(|r| {
                LoopMode::new(config, arm, &self.held.plant().state().q, &self.layout, period_s, r.value, &moved(r))
            })
            .collect();
        Spectrum {
            modes,
            limit_1ps: growth_limit_1ps(config),
            dimension: self.point.len(),
            basis: basis.len(),
            residual,
        }
    }
}
