//! Time of one search for the pairs within reach, of a measurement, and of a swarm's distances.
//!
//! The arm is the paper's, bent by 3 rad/m; the obstacles lie around it as in a cluttered cell: every shape in turn,
//! their centres within 0.4 m of the arm. `mixed` holds hulls of 40 points among them, `balls` only balls.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print

// The scene is fixed and good; a bench that cannot build it should stop.

use divan::{Bencher, black_box};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::collision::*;
use sinew::config::{ArmConfig, BodyModel, ShapeConfig};

const REACH_M: f64 = 0.15;

fn main() {
    divan::main();
}

struct Scene {
    r: Vec<Vector3<f64>>,
    t: Vec<Vector3<f64>>,
    obstacles: ObstacleSet,
    geometry: BodyGeometry,
}

fn scene(count: usize, kinds: usize) -> Scene {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut random = |span: f64| Vector3::from_fn(|_, _| rng.random_range(-span..=span));
    let geometry = BodyGeometry::from_arm(&ArmConfig::paper());
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let mut p = UnitQuaternion::new_normalize(Quaternion::new(h, 0.0, h, 0.0));
    let (mut r, mut t) = (vec![Vector3::zeros()], vec![p * Vector3::x()]);
    for (i, element) in geometry.elements.iter().enumerate() {
        let l = element.length_m;
        let middle = p * UnitQuaternion::from_scaled_axis(random(3.0) * (l / 2.0));
        r.push(r[i] + t[i] * element.connector_m + middle * Vector3::x() * l);
        p = middle * UnitQuaternion::from_scaled_axis(random(3.0) * (l / 2.0));
        t.push(p * Vector3::x());
    }
    let points_m = (0..40).map(|_| random(0.15).into()).collect();
    let shapes = [
        ShapeConfig::Ball { radius_m: 0.1 },
        ShapeConfig::Capsule { half_length_m: 0.2, radius_m: 0.05 },
        ShapeConfig::Box { half_extents_m: [0.1, 0.05, 0.2] },
        ShapeConfig::Hull { points_m },
    ];
    let mut obstacles = ObstacleSet::new();
    for k in 0..count {
        let shape = Shape::new(&shapes[k % kinds]).expect("a good shape");
        let at = Translation3::from(r[(7 * k) % r.len()] + random(0.4));
        let pose = Isometry3::from_parts(at, UnitQuaternion::from_scaled_axis(random(2.0)));
        obstacles.insert(Obstacle::new(k as u64, shape, &pose).expect("a good pose")).expect("room");
    }
    Scene { r, t, obstacles, geometry }
}

fn search(bencher: Bencher<'_, '_>, model: BodyModel, count: usize, kinds: usize) {
    let s = scene(count, kinds);
    let mut body = Body::new(&s.geometry, model, 0.055);
    bencher.bench_local(|| body.find(black_box(&s.r), black_box(&s.t), &s.obstacles, REACH_M).minimum);
}

#[divan::bench(args = [2, 64])]
fn find_arm_balls(bencher: Bencher<'_, '_>, count: usize) {
    search(bencher, BodyModel::Arm, count, 1);
}

#[divan::bench(args = [2, 64])]
fn find_arm_mixed(bencher: Bencher<'_, '_>, count: usize) {
    search(bencher, BodyModel::Arm, count, 4);
}

#[divan::bench(args = [2, 64])]
fn find_points_balls(bencher: Bencher<'_, '_>, count: usize) {
    search(bencher, BodyModel::Points, count, 1);
}

#[divan::bench(args = [2, 64])]
fn find_points_mixed(bencher: Bencher<'_, '_>, count: usize) {
    search(bencher, BodyModel::Points, count, 4);
}

#[divan::bench(args = [2, 64])]
fn measure_mixed(bencher: Bencher<'_, '_>, count: usize) {
    let s = scene(count, 4);
    let mut body = Body::new(&s.geometry, BodyModel::Arm, 0.055);
    bencher.bench_local(|| body.measure(black_box(&s.r), black_box(&s.t), &s.obstacles).along_arm[0]);
}

/// All rows of one particle.
#[divan::bench(args = [2, 64])]
fn particle_mixed(bencher: Bencher<'_, '_>, count: usize) {
    let s = scene(count, 4);
    let mut body = Body::new(&s.geometry, BodyModel::Arm, 0.055);
    let rows = body.find(&s.r, &s.t, &s.obstacles, REACH_M).rows;
    let positions: Vec<f64> = rows.iter().flat_map(|w| [w.position.x, w.position.y + 1e-3, w.position.z]).collect();
    let mut distances = vec![0.0; rows.len()];
    bencher
        .counter(divan::counter::ItemsCount::new(rows.len()))
        .bench_local(|| s.obstacles.moved_distances_into(black_box(rows), black_box(&positions), &mut distances));
}
