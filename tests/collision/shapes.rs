//! Shapes: signed distance and normal, against parry, against samples, at their degenerate points; what is refused.

use super::*;

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
