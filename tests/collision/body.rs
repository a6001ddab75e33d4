//! The search: the curve against samples, linearisation, room, states that are not finite.

use super::*;

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

#[test]
fn what_an_element_may_be_off_by_counts_to_its_own_distances_alone() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(17);
    let mut rows = 0;
    for case in 0..100 {
        let (geometry, r, t) = bent_arm(&mut rng, [0.0, 1.0, 3.0][case % 3]);
        let pose = random_pose(&mut rng, &r[4 * (case % 6)], 0.3);
        let obstacles = one(shape(&shapes()[case % 5]), &pose);
        let mut body = Body::new(&geometry, BodyModel::Arm, 0.03);
        let doubt: Vec<f64> = (0..geometry.elements.len()).map(|i| 0.002 * i as f64).collect();
        let most = doubt.iter().copied().fold(0.0, f64::max);
        let (reach, wide) = (0.1, 0.1 + most);
        let bare: Vec<Proximity> = body.find(&r, &t, &obstacles, wide).rows.to_vec();
        body.set_doubt(&doubt);
        let found = body.find(&r, &t, &obstacles, reach);
        let kept: Vec<&Proximity> = bare.iter().filter(|row| row.distance - doubt[row.point.element] < reach).collect();
        assert_eq!(found.rows.len(), kept.len(), "case {case}");
        for row in kept {
            let same = found.rows.iter().find(|f| f.ordinal == row.ordinal).expect("the same row");
            let by = doubt[row.point.element];
            assert!((same.distance - (row.distance - by)).abs() < 1e-15);
            assert!((same.inflation - (row.inflation + by)).abs() < 1e-15);
            rows += 1;
        }
        let nearest = found.rows.iter().map(|row| row.distance).fold(f64::INFINITY, f64::min);
        assert!(found.minimum == nearest || (found.rows.is_empty() && found.minimum >= reach - most), "case {case}");
    }
    assert!(rows > 100, "{rows}");
}
