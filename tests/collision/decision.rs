//! Obstacle sets that move, the decision (17), the barrier and the penalty (27).

use super::*;

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
