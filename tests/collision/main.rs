//! Claims about the collision module: closed forms, the search along the curve, linearisation, decision, penalty.

// Helpers of tests, too, stop at what must not fail.
#![allow(clippy::unwrap_used)]

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use parry3d_f64::math::Vector as ParryVector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape as parry;
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::*;
use sinew::config::{ArmConfig, BarrierConfig, BodyModel, ShapeConfig};

mod body;
mod decision;
mod shapes;

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

type V = Vector3<f64>;

fn shape(config: &ShapeConfig) -> Shape {
    Shape::new(config).unwrap()
}

fn hull_points(seed: u64, count: usize) -> Vec<[f64; 3]> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    (0..count).map(|_| std::array::from_fn(|_| rng.random_range(-0.15..0.15))).collect()
}

/// One of each kind, sizes as in the arm's surroundings.
fn shapes() -> [ShapeConfig; 5] {
    [
        ShapeConfig::Ball { radius_m: 0.1 },
        ShapeConfig::Capsule { half_length_m: 0.2, radius_m: 0.05 },
        ShapeConfig::Box { half_extents_m: [0.1, 0.05, 0.2] },
        ShapeConfig::HalfSpace,
        ShapeConfig::Hull { points_m: hull_points(7, 40) },
    ]
}

/// The same in parry3d.
fn parry_shape(config: &ShapeConfig) -> Box<dyn PointQuery> {
    match config {
        ShapeConfig::Ball { radius_m } => Box::new(parry::Ball::new(*radius_m)),
        ShapeConfig::Capsule { half_length_m, radius_m } => Box::new(parry::Capsule::new_z(*half_length_m, *radius_m)),
        ShapeConfig::Box { half_extents_m } => Box::new(parry::Cuboid::new(ParryVector::from_array(*half_extents_m))),
        ShapeConfig::HalfSpace => Box::new(parry::HalfSpace::new(ParryVector::Z)),
        ShapeConfig::Hull { points_m } => {
            let points: Vec<_> = points_m.iter().map(|p| ParryVector::from_array(*p)).collect();
            Box::new(parry::ConvexPolyhedron::from_convex_hull(&points).unwrap())
        }
    }
}

/// Positions and tangents of a randomly bent paper arm: curvature up to `bend` (1/m) in every element.
fn bent_arm(rng: &mut impl Rng, bend: f64) -> (BodyGeometry, Vec<V>, Vec<V>) {
    let geometry = BodyGeometry::from_arm(&ArmConfig::paper());
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let mut p = UnitQuaternion::new_normalize(Quaternion::new(h, 0.0, h, 0.0));
    let (mut r, mut t) = (vec![V::zeros()], vec![p * V::x()]);
    for (i, element) in geometry.elements.iter().enumerate() {
        let l = element.length_m;
        let turn = V::from_fn(|_, _| rng.random_range(-bend..=bend)) * (l / 2.0);
        let middle = p * UnitQuaternion::from_scaled_axis(turn);
        let end = middle * UnitQuaternion::from_scaled_axis(turn);
        let start = r[i] + t[i] * element.connector_m;
        r.push(start + (p * V::x() + middle * V::x() * 4.0 + end * V::x()) * (l / 6.0));
        t.push(end * V::x());
        p = end;
    }
    (geometry, r, t)
}

fn random_pose(rng: &mut impl Rng, near: &V, spread: f64) -> Isometry3<f64> {
    let offset = V::from_fn(|_, _| rng.random_range(-spread..=spread));
    let axis = V::from_fn(|_, _| rng.random_range(-3.0..=3.0));
    Isometry3::from_parts(Translation3::from(near + offset), UnitQuaternion::from_scaled_axis(axis))
}

fn one(shape: Shape, pose: &Isometry3<f64>) -> ObstacleSet {
    let mut set = ObstacleSet::new();
    set.insert(Obstacle::new(1, shape, pose).unwrap()).unwrap();
    set
}

/// Every strand of the centre line as a function of its parameter, by de Casteljau: independent of the module's weights.
fn strands(geometry: &BodyGeometry, r: &[V], t: &[V]) -> Vec<impl Fn(f64) -> V> {
    let mut all = Vec::new();
    for (i, e) in geometry.elements.iter().enumerate() {
        let start = r[i] + t[i] * e.connector_m;
        let third = e.length_m / 3.0;
        if e.connector_m > 0.0 {
            let along = t[i] * e.connector_m;
            all.push([r[i], r[i] + along / 3.0, r[i] + along * (2.0 / 3.0), start]);
        }
        all.push([start, start + t[i] * third, r[i + 1] - t[i + 1] * third, r[i + 1]]);
    }
    all.into_iter()
        .map(|b| {
            move |x: f64| {
                let mut b = b;
                for n in (1..4).rev() {
                    for k in 0..n {
                        b[k] = b[k] * (1.0 - x) + b[k + 1] * x;
                    }
                }
                b[0]
            }
        })
        .collect()
}

/// Smallest value on [0, 1]: a fine grid, and finer grids around every low point of it.
fn brute_minimum(f: impl Fn(f64) -> f64) -> f64 {
    fn grid(f: &impl Fn(f64) -> f64, from: f64, to: f64, n: usize, level: usize) -> f64 {
        let x = |k: usize| from + (to - from) * k as f64 / n as f64;
        let values: Vec<f64> = (0..=n).map(|k| f(x(k))).collect();
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        if level == 0 {
            return least;
        }
        let step = (to - from) / n as f64;
        let mut best = least;
        for k in 0..=n {
            let low = (k == 0 || values[k] <= values[k - 1]) && (k == n || values[k] <= values[k + 1]);
            if low && values[k] <= least + 0.2 * step {
                best = best.min(grid(f, x(k.saturating_sub(1)), x((k + 1).min(n)), 40, level - 1));
            }
        }
        best
    }
    grid(&f, 0.0, 1.0, 400, 4)
}

#[test]
fn evaluation_does_not_allocate() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(2);
    let (geometry, r, t) = bent_arm(&mut rng, 5.0);
    let mut obstacles = ObstacleSet::new();
    for k in 0..OBSTACLES_MAX {
        let at = random_pose(&mut rng, &r[k % 21], 0.3);
        obstacles.insert(Obstacle::new(k as u64, shape(&shapes()[k % 5]), &at).unwrap()).unwrap();
    }
    let nan = vec![V::repeat(f64::NAN); 21];
    let at = random_pose(&mut rng, &r[3], 0.3);
    for model in [BodyModel::Arm, BodyModel::Points] {
        // Small enough to overflow as well.
        let mut body = Body::with_capacity(&geometry, model, 0.02, 300);
        let mut positions = vec![0.1; 900];
        let mut distances = vec![0.0; 300];
        let mut state = WarningState::new(0.01, 0.01, 0.0);
        let rows = assert_no_alloc(|| {
            obstacles.set_pose(9, &at).unwrap();
            obstacles.extrapolate(0.1);
            let _ = body.measure(&r, &t, &obstacles);
            let _ = body.find(&nan, &r, &obstacles, 0.3);
            let found = body.find(&r, &t, &obstacles, 0.3);
            let n = found.rows.len();
            state.update(found.minimum);
            obstacles.moved_distances_into(found.rows, &positions[..3 * n], &mut distances[..n]);
            n
        });
        positions.clear();
        assert!(rows > 100);
    }
}

/// Not a test of its own: allocates where that is forbidden.
#[test]
#[ignore = "run by `the_allocation_guard_is_alive`"]
fn allocate_under_the_guard() {
    let held = assert_no_alloc(|| vec![1.0; 100]);
    assert_eq!(held.len(), 100);
}

#[test]
fn the_allocation_guard_is_alive() {
    let probe = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "allocate_under_the_guard"])
        .output()
        .unwrap();
    assert!(!probe.status.success(), "an allocation went unnoticed");
}
