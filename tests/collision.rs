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

// ---------------------------------------------------------------- shapes

proptest! {
    #[test]
    fn distances_agree_with_parry_inside_and_outside(x in prop::array::uniform3(-0.4..0.4f64), kind in 0usize..5) {
        let config = &shapes()[kind];
        let (distance, normal) = shape(config).distance(&V::from(x));
        let p = ParryVector::from_array(x);
        let projection = parry_shape(config).project_local_point(p, false);
        let expected = projection.point.distance(p) * if projection.is_inside { -1.0 } else { 1.0 };
        // GJK and EPA are good to 1e-7, the rest are closed forms there as well.
        let tolerance = if kind == 4 { 1e-6 } else { 1e-14 };
        prop_assert!((distance - expected).abs() <= tolerance, "{distance} {expected}");
        let foot = V::from(x) - normal * distance;
        let expected = V::from(projection.point.to_array());
        if distance.abs() > 1e-3 && kind != 4 && !(projection.is_inside) {
            prop_assert!((foot - expected).norm() <= 1e-13);
        }
    }

    #[test]
    fn normal_has_length_one_and_leads_to_the_surface(x in prop::array::uniform3(-0.4..0.4f64), kind in 0usize..5) {
        let shape = shape(&shapes()[kind]);
        let p = V::from(x);
        let (distance, normal) = shape.distance(&p);
        prop_assert!((normal.norm() - 1.0).abs() <= 1e-12);
        prop_assert!(shape.distance(&(p - normal * distance)).0.abs() <= 1e-12);
        // A subgradient: no point can be closer than the supporting plane says.
        for q in [V::new(0.3, -0.1, 0.05), V::zeros(), V::new(-0.2, 0.3, -0.3), V::new(0.05, 0.02, 0.1)] {
            prop_assert!(shape.distance(&q).0 >= distance + normal.dot(&(q - p)) - 1e-12);
        }
    }

    #[test]
    fn hull_of_the_corners_is_the_box(x in prop::array::uniform3(-0.4..0.4f64)) {
        let half = [0.1, 0.05, 0.2];
        let corners = (0..8).map(|c| std::array::from_fn(|k| if c >> k & 1 == 1 { half[k] } else { -half[k] })).collect();
        let (a, _) = shape(&ShapeConfig::Box { half_extents_m: half }).distance(&V::from(x));
        let (b, _) = shape(&ShapeConfig::Hull { points_m: corners }).distance(&V::from(x));
        prop_assert!((a - b).abs() <= 1e-14, "{a} {b}");
    }
}

#[test]
fn distances_agree_with_sampled_surfaces() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
    for config in shapes() {
        let shape = shape(&config);
        let convex = parry_shape(&config);
        let spacing = 0.01;
        // Surface samples by membership alone: along every grid line of three directions, the two crossings.
        let mut surface = Vec::new();
        let inside = |p: &V| convex.contains_local_point(ParryVector::from_array((*p).into()));
        for axis in 0..3 {
            for i in -40..=40 {
                for j in -40..=40 {
                    let mut on = V::zeros();
                    on[(axis + 1) % 3] = f64::from(i) * spacing;
                    on[(axis + 2) % 3] = f64::from(j) * spacing;
                    let line = |s: f64| on + V::ith(axis, s);
                    let within: Vec<f64> =
                        (-40..=40).map(|k| f64::from(k) * spacing).filter(|s| inside(&line(*s))).collect();
                    let (Some(low), Some(high)) = (within.first(), within.last()) else { continue };
                    for (mut a, mut b) in [(*low, low - spacing), (*high, high + spacing)] {
                        // The half-space has no end along some lines.
                        if inside(&line(b)) {
                            continue;
                        }
                        for _ in 0..40 {
                            let m = 0.5 * (a + b);
                            if inside(&line(m)) { a = m } else { b = m }
                        }
                        surface.push(line(a));
                    }
                }
            }
        }
        assert!(surface.len() > 300);
        for _ in 0..60 {
            let p = V::from_fn(|_, _| rng.random_range(-0.25..0.25));
            let (distance, _) = shape.distance(&p);
            assert_eq!(distance < 0.0, inside(&p), "{config:?}");
            let sampled = surface.iter().map(|s| (s - p).norm()).fold(f64::INFINITY, f64::min);
            assert!(distance.abs() <= sampled + 1e-6, "{config:?}: {distance} {sampled}");
            assert!(sampled <= distance.abs() + 1.5 * spacing, "{config:?}: {distance} {sampled}");
        }
    }
}

#[test]
fn points_of_a_hull_are_on_or_in_it_whatever_their_arrangement() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    for case in 0..400 {
        let mut points_m = hull_points(case, 4 + case as usize % 250);
        for p in &mut points_m {
            let norm = V::from(*p).norm();
            *p = p.map(|x| match case % 4 {
                0 => x,
                1 => 0.2 * x / norm,
                2 => (x * 20.0).round() / 20.0,
                _ => (x * 7.0).round() / 7.0,
            });
        }
        // A grid of few points may be flat.
        let shape = match Shape::new(&ShapeConfig::Hull { points_m: points_m.clone() }) {
            Ok(shape) => shape,
            // A grid of few points may be flat.
            Err(ShapeError::Flat { .. }) if case % 4 > 1 && points_m.len() < 12 => continue,
            Err(refused) => panic!("case {case}: {refused}"),
        };
        for _ in 0..200 {
            // Points themselves, and points between any two of them: many on the surface.
            let mut pick = || V::from(points_m[rng.random_range(0..points_m.len())]);
            let (a, b) = (pick(), pick());
            for p in [a, a.lerp(&b, 0.3)] {
                let (distance, normal) = shape.distance(&p);
                assert!(distance < 1e-8 && (normal.norm() - 1.0).abs() < 1e-12, "case {case}: {distance:e}");
            }
        }
    }
}

#[test]
fn centres_and_axes_have_a_normal_that_leads_out() {
    for config in shapes() {
        let shape = shape(&config);
        for p in [V::zeros(), V::z() * 0.1, V::z() * 0.2, V::z() * -0.05] {
            let (distance, normal) = shape.distance(&p);
            assert!((normal.norm() - 1.0).abs() < 1e-14);
            assert!(shape.distance(&(p - normal * (distance - 1e-6))).0 > 0.0, "{config:?} {p}");
        }
    }
}

#[test]
fn bad_shapes_are_refused() {
    let refused = |c: ShapeConfig| Shape::new(&c).unwrap_err();
    assert!(matches!(refused(ShapeConfig::Ball { radius_m: 0.0 }), ShapeError::Length { .. }));
    assert!(matches!(refused(ShapeConfig::Ball { radius_m: f64::NAN }), ShapeError::Length { .. }));
    assert!(matches!(
        refused(ShapeConfig::Capsule { half_length_m: -0.1, radius_m: 0.1 }),
        ShapeError::Length { what: "half length", .. }
    ));
    assert!(matches!(
        refused(ShapeConfig::Box { half_extents_m: [0.1, f64::INFINITY, 0.1] }),
        ShapeError::Length { .. }
    ));
    let hull = |points_m| refused(ShapeConfig::Hull { points_m });
    assert!(matches!(hull(hull_points(1, 3)), ShapeError::PointCount { count: 3, .. }));
    assert!(matches!(hull(hull_points(1, HULL_POINTS_MAX + 1)), ShapeError::PointCount { .. }));
    assert!(matches!(hull(vec![[0.0; 3]; 8]), ShapeError::Flat { .. }));
    let flat = hull_points(1, 20).into_iter().map(|[x, y, _]| [x, y, x - y]).collect();
    assert!(matches!(hull(flat), ShapeError::Flat { .. }));
    let mut points = hull_points(1, 8);
    points[5][1] = f64::NAN;
    assert!(matches!(hull(points), ShapeError::NotFinite { index: 5 }));
}

// ---------------------------------------------------------------- body

#[test]
fn pieces_stay_within_half_a_millimetre_of_their_chords() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(11);
    let mut worst = 0.0_f64;
    for _ in 0..30 {
        let (geometry, r, t) = bent_arm(&mut rng, 5.0);
        let mut body = Body::new(&geometry, BodyModel::Arm, 0.0);
        body.find(&r, &t, &ObstacleSet::new(), 0.1);
        for ((_, _, pieces), curve) in body.pieces().zip(strands(&geometry, &r, &t)) {
            for k in 0..pieces {
                let at = |s: f64| curve((k as f64 + s) / pieces as f64);
                let (a, b) = (at(0.0), at(1.0));
                let along = (b - a).normalize();
                for s in 1..40 {
                    let off = at(f64::from(s) / 40.0) - a;
                    worst = worst.max((off - along * along.dot(&off)).norm());
                }
            }
        }
    }
    assert!(worst <= CHORD_DEVIATION_M, "{worst}");
    // Nor are they cut finer than needed by much.
    assert!(worst > 0.5 * CHORD_DEVIATION_M, "{worst}");
}

#[test]
fn arm_distance_is_that_of_the_sampled_curve_for_every_shape() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);
    let (mut contacts, mut unresolved) = (0, 0);
    for case in 0..250 {
        let (geometry, r, t) = bent_arm(&mut rng, [0.0, 1.0, 3.0, 6.0][case % 4]);
        let pose = random_pose(&mut rng, &r[4 * (case % 6)], 0.3);
        let obstacles = one(shape(&shapes()[case % 5]), &pose);
        let obstacle = &obstacles.as_slice()[0];
        let mut body = Body::new(&geometry, BodyModel::Arm, 0.03);
        let reach = 0.1;
        let found = body.find(&r, &t, &obstacles, reach);
        unresolved += found.unresolved;
        contacts += usize::from(found.minimum < 0.0);
        let curves = strands(&geometry, &r, &t);
        let brute = curves.iter().map(|c| brute_minimum(|x| obstacle.distance(&c(x)).0)).fold(f64::INFINITY, f64::min);
        let error = found.minimum - (brute - 0.03);
        assert!(error.abs() <= 1e-9, "case {case}: {error:e} of {brute}");
        for row in found.rows {
            assert!((row.point.combine(&r, &t) - row.position).norm() < 1e-14);
            assert!((obstacle.distance(&row.position).0 - 0.03 - row.distance).abs() < 1e-14 && row.distance < reach);
        }
        // Nothing within reach is without its row: one nearby that is at least as close.
        for curve in &curves {
            for k in 0..=50 {
                let p = curve(f64::from(k) / 50.0);
                let d = obstacle.distance(&p).0 - 0.03;
                let covered = |w: &Proximity| (w.position - p).norm() < 0.066 && w.distance <= d + 1e-9;
                assert!(d >= reach || found.rows.iter().any(covered), "case {case}");
            }
        }
        // No point of the arm has two rows.
        for (k, a) in found.rows.iter().enumerate() {
            assert!(found.rows[..k].iter().all(|b| (a.position - b.position).norm() > 1e-6));
        }
    }
    assert!(contacts > 50 && unresolved == 0, "{contacts} {unresolved}");
}

#[test]
fn joint_of_two_pieces_is_one_row() {
    // Straight along -z; the ball's nearest point is exactly the node between elements 6 and 7.
    let (geometry, r, t) = bent_arm(&mut Xoshiro256PlusPlus::seed_from_u64(0), 0.0);
    let at = Isometry3::from_parts(Translation3::from(r[7] + V::y() * 0.2), UnitQuaternion::identity());
    let obstacles = one(shape(&ShapeConfig::Ball { radius_m: 0.1 }), &at);
    let mut body = Body::new(&geometry, BodyModel::Arm, 0.0);
    let found = body.find(&r, &t, &obstacles, 0.3);
    let here = found.rows.iter().filter(|w| (w.position - r[7]).norm() < 1e-6).count();
    assert_eq!(here, 1, "{:?}", found.rows);
    assert!((found.minimum - 0.1).abs() < 1e-12 && (found.rows[0].position - r[7]).norm() < 1e-6);
}

#[test]
fn arc_around_a_ball_is_bounded_in_work_and_right() {
    // An arc concentric to the ball is nearly parallel to it everywhere: every point is almost the closest.
    let geometry = BodyGeometry { elements: vec![ElementGeometry { length_m: 0.13, connector_m: 0.0 }; 6] };
    let (radius, mut r, mut t) = (0.3, Vec::new(), Vec::new());
    for i in 0..7 {
        let (sin, cos) = (f64::from(i) * 0.13 / radius).sin_cos();
        r.push(V::new(radius * cos, radius * sin, 0.0));
        t.push(V::new(-sin, cos, 0.0));
    }
    let obstacles = one(shape(&ShapeConfig::Ball { radius_m: 0.2 }), &Isometry3::identity());
    let mut body = Body::new(&geometry, BodyModel::Arm, 0.0);
    let found = body.find(&r, &t, &obstacles, 0.2);
    let curves = strands(&geometry, &r, &t);
    let brute = curves.iter().map(|c| brute_minimum(|x| c(x).norm() - 0.2)).fold(f64::INFINITY, f64::min);
    assert!((found.minimum - brute).abs() < 1e-9, "{} {brute}", found.minimum);
    assert!(!found.rows.is_empty());
}

#[test]
fn linearisation_agrees_with_finite_differences_of_the_minimum() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(21);
    let mut checked = [0; 5];
    for case in 0..300 {
        let (geometry, r, t) = bent_arm(&mut rng, 3.0);
        let pose = random_pose(&mut rng, &r[3 + 4 * (case % 5)], 0.35);
        let obstacles = one(shape(&shapes()[case % 5]), &pose);
        let model = if case % 2 == 0 { BodyModel::Arm } else { BodyModel::Points };
        let mut body = Body::new(&geometry, model, 0.02);
        let found = body.find(&r, &t, &obstacles, 0.5);
        let Some(&row) = found.rows.first() else { continue };
        // A minimum that jumps between two far points, and the inside of a polyhedron, have kinks.
        let rival =
            found.rows.iter().any(|w| w.distance < row.distance + 1e-4 && (w.position - row.position).norm() > 1e-3);
        let polyhedron = matches!(case % 5, 2 | 4);
        if rival || (polyhedron && row.distance < 0.0) {
            continue;
        }
        let moves = |rng: &mut Xoshiro256PlusPlus| -> Vec<V> {
            r.iter().map(|_| V::from_fn(|_, _| rng.random_range(-1.0..1.0))).collect()
        };
        let (dr, dt) = (moves(&mut rng), moves(&mut rng));
        let mut at = |e: f64| {
            let shift = |x: &[V], dx: &[V]| -> Vec<V> { x.iter().zip(dx).map(|(x, dx)| x + dx * e).collect() };
            body.find(&shift(&r, &dr), &shift(&t, &dt), &obstacles, 0.5).minimum
        };
        let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
        let analytic = row.normal.dot(&row.point.combine(&dr, &dt));
        assert!((numeric - analytic).abs() < 2e-5, "case {case}: {numeric} {analytic}");
        checked[case % 5] += 1;
    }
    assert!(checked.iter().all(|&n| n > 15), "{checked:?}");
}

#[test]
fn points_body_reports_the_smallest_distance_and_every_point_within_reach() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(8);
    for case in 0..100 {
        let (geometry, r, t) = bent_arm(&mut rng, 3.0);
        let mut obstacles = ObstacleSet::new();
        for config in shapes() {
            let at = random_pose(&mut rng, &r[10], 0.8);
            obstacles.insert(Obstacle::new(case, shape(&config), &at).unwrap()).unwrap();
        }
        let mut body = Body::new(&geometry, BodyModel::Points, 0.0);
        let found = body.find(&r, &t, &obstacles, 0.2);
        let mut expected = 0;
        for (k, obstacle) in obstacles.as_slice().iter().enumerate() {
            let all: Vec<f64> =
                geometry.paper_points().iter().map(|p| obstacle.distance(&p.combine(&r, &t)).0).collect();
            assert_eq!(found.minima[k], all.iter().copied().fold(f64::INFINITY, f64::min));
            expected += all.iter().filter(|d| **d < 0.2).count();
        }
        assert_eq!(found.rows.len(), expected);
        assert!(found.rows.is_sorted_by_key(|row| row.distance));
        let minima: Vec<f64> = found.minima.to_vec();
        assert_eq!(body.measure(&r, &t, &obstacles).at_points, minima);
    }
}

#[test]
fn measure_ignores_the_model_and_the_growth_but_not_the_radius() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(9);
    let (geometry, r, t) = bent_arm(&mut rng, 3.0);
    let mut obstacles = one(shape(&shapes()[2]), &random_pose(&mut rng, &r[9], 0.3));
    let mut arm = Body::new(&geometry, BodyModel::Arm, 0.0);
    let bare = arm.find(&r, &t, &obstacles, 0.2).minimum;
    obstacles.as_mut_slice()[0].set_growth(0.05).unwrap();
    assert!((arm.find(&r, &t, &obstacles, 0.2).minimum - (bare - 0.05)).abs() < 1e-12);
    let mut points = Body::new(&geometry, BodyModel::Points, 0.01);
    let measured = points.measure(&r, &t, &obstacles);
    assert!((measured.along_arm[0] - (bare - 0.01)).abs() < 1e-9);
    assert!(measured.at_points[0] >= measured.along_arm[0]);
}

#[test]
fn overflow_keeps_the_nearest_and_is_counted() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(4);
    let (geometry, r, t) = bent_arm(&mut rng, 4.0);
    let obstacles = one(shape(&shapes()[0]), &random_pose(&mut rng, &r[10], 0.1));
    let mut roomy = Body::new(&geometry, BodyModel::Arm, 0.0);
    let mut tight = Body::with_capacity(&geometry, BodyModel::Arm, 0.0, 5);
    let all = roomy.find(&r, &t, &obstacles, 0.6);
    let few = tight.find(&r, &t, &obstacles, 0.6);
    assert!(all.rows.len() > 20 && all.overflow == 0);
    assert_eq!(few.rows, &all.rows[..5]);
    assert_eq!(few.overflow, all.rows.len() - 5);
}

#[test]
fn states_that_are_not_finite_give_nan_and_no_row() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(6);
    let (geometry, r, t) = bent_arm(&mut rng, 4.0);
    for model in [BodyModel::Arm, BodyModel::Points] {
        let mut body = Body::new(&geometry, model, 0.0);
        for config in shapes() {
            let obstacles = one(shape(&config), &Isometry3::translation(0.1, 0.0, -1.0));
            for bad in [f64::NAN, f64::INFINITY] {
                for node in [1, 10, 20] {
                    let (mut r, mut t) = (r.clone(), t.clone());
                    if node == 10 {
                        t[node].y = bad
                    } else {
                        r[node].x = bad
                    }
                    let found = body.find(&r, &t, &obstacles, 10.0);
                    assert!(
                        found.rows.iter().all(|w| w.distance.is_finite() && w.position.iter().all(|x| x.is_finite()))
                    );
                    assert!(bad.is_infinite() || found.minimum.is_nan(), "{model:?} {config:?} {}", found.minimum);
                    assert!(bad.is_infinite() || body.measure(&r, &t, &obstacles).along_arm[0].is_nan());
                }
            }
        }
        let nan = vec![V::repeat(f64::NAN); 21];
        let found = body.find(&nan, &nan, &one(shape(&shapes()[1]), &Isometry3::identity()), 1.0);
        assert!(found.minimum.is_nan() && found.rows.is_empty());
    }
}

// ---------------------------------------------------------------- obstacles

#[test]
fn moved_distance_is_exact_for_closed_forms_and_never_too_large_for_hulls() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(31);
    for case in 0..100 {
        let (geometry, r, t) = bent_arm(&mut rng, 3.0);
        let obstacles = one(shape(&shapes()[case % 5]), &random_pose(&mut rng, &r[10], 0.3));
        let mut body = Body::new(&geometry, BodyModel::Arm, 0.01);
        let rows = body.find(&r, &t, &obstacles, 0.3).rows;
        let moved: Vec<V> =
            rows.iter().map(|w| w.position + V::from_fn(|_, _| rng.random_range(-0.03..0.03))).collect();
        let flat: Vec<f64> = moved.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
        let mut distances = vec![0.0; rows.len()];
        obstacles.moved_distances_into(rows, &flat, &mut distances);
        for (p, d) in moved.iter().zip(&distances) {
            let exact = obstacles.as_slice()[0].distance(p).0 - 0.01;
            assert!(if case % 5 == 4 { *d <= exact + 1e-12 } else { *d == exact }, "{d} {exact}");
        }
    }
}

#[test]
fn set_moves_extrapolates_and_refuses() {
    let ball = || Obstacle::new(7, shape(&ShapeConfig::Ball { radius_m: 0.1 }), &Isometry3::identity()).unwrap();
    let mut set = ObstacleSet::new();
    for k in 0..OBSTACLES_MAX {
        assert_eq!(set.insert(ball()).unwrap(), k);
    }
    let SetFull(back) = set.insert(ball()).unwrap_err();
    assert_eq!(back.id(), 7);
    assert_eq!(set.remove(3).map(|o| o.id()), Some(7));
    assert_eq!((set.len(), set.remove(99).is_none(), set.index_of(8)), (63, true, None));

    set.set_pose(5, &pose([1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]).unwrap()).unwrap();
    set.as_mut_slice()[5].set_velocity(V::y()).unwrap();
    for _ in 0..2 {
        set.extrapolate(0.5);
        assert_eq!(set.as_slice()[5].position(), V::new(1.0, 0.5, 0.0));
    }
    let nan = Isometry3::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(set.set_pose(5, &nan), Err(ObstacleError::Pose));
    assert_eq!(set.set_pose(99, &nan), Err(ObstacleError::Index(99)));
    assert_eq!(set.as_mut_slice()[5].set_velocity(V::x() * f64::INFINITY), Err(ObstacleError::Velocity));
    assert_eq!(set.as_mut_slice()[5].set_growth(-0.1), Err(ObstacleError::Growth));
    assert_eq!(set.as_slice()[5].position(), V::new(1.0, 0.5, 0.0));
    assert_eq!(pose([0.0; 3], [0.0; 4]), Err(ObstacleError::Pose));
    assert_eq!(pose([f64::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]), Err(ObstacleError::Pose));
}

// ---------------------------------------------------------------- decision, barrier, penalty

#[test]
fn warning_begins_at_the_margin_and_ends_above_the_hysteresis() {
    let mut state = WarningState::new(0.02, 0.01, 0.005);
    assert!(state.is_warning());
    assert!(!state.update(0.032), "the first decision has no past");
    assert!(state.update(0.03), "d_s + d_w itself is a warning");
    assert!(state.update(0.0301) && state.update(0.0349) && state.is_warning());
    assert!(!state.update(0.0351));
    assert!(!state.update(0.0301));
    assert!(state.update(f64::NAN) && state.update(-1.0));
    assert!(!state.update(f64::INFINITY));
}

#[test]
fn barrier_takes_its_share_and_nothing_beyond_activation() {
    let barrier = BarrierConfig { gamma: 0.25, activation_m: 0.15 };
    assert_eq!(required_distance(0.5, 0.01, None), 0.01);
    assert_eq!(required_distance(0.17, 0.01, Some(&barrier)), 0.01);
    assert!((required_distance(0.11, 0.01, Some(&barrier)) - 0.085).abs() < 1e-15);
    assert!((required_distance(-0.03, 0.01, Some(&barrier)) + 0.02).abs() < 1e-15);
    assert!(required_distance(f64::NAN, 0.01, Some(&barrier)).is_nan());
}

proptest! {
    #[test]
    fn penalty_is_equation_27_for_a_ball(c in 0.0..0.2f64) {
        let expected = if c < 0.1 { (1.0 - (c / 0.1).powi(6)).powi(3) } else { 0.0 };
        prop_assert!((penalty(c - 0.1, 0.0, 0.1).0 - expected).abs() < 1e-14);
    }

    #[test]
    fn penalty_falls_with_distance_and_its_slope_is_the_derivative(d in -0.4..0.2f64, clearance in 0.0..0.05f64) {
        let at = |d: f64| penalty(d, clearance, 0.1).0;
        let slope = penalty(d, clearance, 0.1).1;
        prop_assert!(slope <= 0.0 && (at(d - 1e-7) >= at(d)));
        prop_assert!(((at(d + 1e-6) - at(d - 1e-6)) / 2e-6 - slope).abs() < 2e-3);
    }
}

// ---------------------------------------------------------------- no allocation

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
