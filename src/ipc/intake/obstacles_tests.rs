use super::*;
use crate::ipc::payload::Header;
use proptest::prelude::*;

const SECOND: u64 = 1_000_000_000;
const NOW: u64 = 100 * SECOND;
const LIMITS: InputLimits = InputLimits {
    stale_after_s: 0.1,
    hold_after_s: 0.5,
    growth_mps: 0.2,
    growth_m_max: 1.0,
    sigma_multiple: 3.0,
    future_tolerance_s: 0.005,
};

fn set(source: u32, sequence: u64, capture_ns: u64, obstacles: &[Obstacle]) -> Obstacles {
    let mut set = Obstacles { header: Header::new(source, sequence, capture_ns), ..Obstacles::default() };
    for o in obstacles {
        assert!(set.push(*o));
    }
    set
}

fn ball(id: u32) -> Obstacle {
    Obstacle { velocity_mps: [0.1, 0.0, -0.2], ..Obstacle::ball(id, [1.0, 2.0, 3.0], 0.1) }
}

fn track(table: &ObstacleTable, now_ns: u64, lookahead_s: f64) -> Vec<TrackedObstacle> {
    let mut tracked = TrackedSet::new();
    table.track_into(now_ns, lookahead_s, &LIMITS, &mut tracked);
    tracked.as_slice().to_vec()
}

/// The set after one change must be refused for exactly this cause, counted there, and leave the old set in place.
fn refused(cause: RejectCause, change: impl Fn(&mut Obstacles)) {
    let mut table = ObstacleTable::new(&[]);
    table.accept(&set(1, 0, NOW, &[ball(1)]), NOW, &LIMITS).unwrap();
    let mut bad = set(1, 1, NOW, &[ball(1), ball(2)]);
    table.clone().accept(&bad, NOW, &LIMITS).expect("valid before the change");
    change(&mut bad);
    assert_eq!(table.accept(&bad, NOW, &LIMITS), Err(cause));
    let mut state = State::default();
    table.report_into(NOW, &LIMITS, &mut state);
    let report = &state.obstacle_sources[0];
    assert_eq!(report.rejected[cause.wire() as usize], 1);
    assert_eq!((report.source_id, report.accepted, report.rejected_total()), (1, 1, 1));
    assert_eq!(track(&table, NOW, 0.0).len(), 1, "the last valid set stays");
}

#[test]
fn not_a_number_is_refused_everywhere() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        refused(RejectCause::NotFinite, |s| s.obstacles[1].position_m[2] = bad);
        refused(RejectCause::NotFinite, |s| s.obstacles[1].velocity_mps[0] = bad);
        refused(RejectCause::NotFinite, |s| s.obstacles[1].quaternion[3] = bad);
        refused(RejectCause::NotFinite, |s| s.obstacles[1].dimensions_m[0] = bad);
        refused(RejectCause::NotFinite, |s| s.obstacles[1].covariance_m2[5] = bad);
    }
}

#[test]
fn malformed_sets_are_refused_one_by_one() {
    refused(RejectCause::Schema, |s| s.header.schema_version = 2);
    refused(RejectCause::Future, |s| s.header.capture_ns = NOW + SECOND);
    refused(RejectCause::Backwards, |s| s.header.capture_ns = NOW - 1);
    refused(RejectCause::Sequence, |s| s.header.sequence = 0);
    refused(RejectCause::UnknownKind, |s| s.obstacles[0].kind = 99);
    refused(RejectCause::UnknownKind, |s| s.obstacles[0].kind = 0);
    refused(RejectCause::Overfull, |s| s.count = MAX_OBSTACLES as u32 + 1);
    refused(RejectCause::Overfull, |s| s.count = u32::MAX);
    refused(RejectCause::Overfull, |s| s.vertex_count = MAX_VERTICES as u32 + 1);
    refused(RejectCause::Dimensions, |s| s.obstacles[0].dimensions_m[0] = 0.0);
    refused(RejectCause::Dimensions, |s| s.obstacles[0].dimensions_m[0] = -0.1);
    refused(RejectCause::Dimensions, |s| s.obstacles[0].position_m[0] = 1e300);
    refused(RejectCause::Quaternion, |s| s.obstacles[0].quaternion = [0.0; 4]);
    refused(RejectCause::Quaternion, |s| s.obstacles[0].quaternion[0] = 1.01);
    refused(RejectCause::Covariance, |s| s.obstacles[0].covariance_m2[0] = -1e-3);
    refused(RejectCause::DuplicateId, |s| s.obstacles[1].id = s.obstacles[0].id);
    refused(RejectCause::Hull, |s| s.obstacles[1].kind = ObstacleKind::Hull.wire());
    refused(RejectCause::Hull, |s| {
        s.obstacles[1].kind = ObstacleKind::Hull.wire();
        (s.obstacles[1].hull_offset, s.obstacles[1].hull_count) = (u32::MAX, 4);
    });
}

#[test]
fn newest_per_source_wins_and_sources_do_not_mix() {
    let mut table = ObstacleTable::new(&[]);
    table.accept(&set(1, 0, NOW, &[ball(1), ball(2)]), NOW, &LIMITS).unwrap();
    table.accept(&set(9, 0, NOW, &[ball(1)]), NOW, &LIMITS).unwrap();
    let keys = |t: &ObstacleTable| track(t, NOW, 0.0).iter().map(|o| (o.source_id, o.id)).collect::<Vec<_>>();
    assert_eq!(keys(&table), [(1, 1), (1, 2), (9, 1)]);
    table.accept(&set(1, 1, NOW, &[ball(3)]), NOW, &LIMITS).unwrap();
    assert_eq!(keys(&table), [(1, 3), (9, 1)]);
}

#[test]
fn an_empty_set_is_a_statement_and_silence_is_not() {
    let mut table = ObstacleTable::new(&[4]);
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Hold { source_id: 4 }, "declared, never heard");
    table.accept(&set(4, 0, NOW, &[]), NOW, &LIMITS).unwrap();
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Proceed, "looks and sees nothing");
    assert_eq!(table.demand(NOW + SECOND, &LIMITS), ObstacleDemand::Hold { source_id: 4 }, "fell silent");
}

#[test]
fn obstacles_move_with_their_velocity_to_the_planned_time() {
    let mut table = ObstacleTable::new(&[]);
    table.accept(&set(1, 0, NOW, &[ball(1)]), NOW, &LIMITS).unwrap();
    let o = track(&table, NOW + 50_000_000, 0.1)[0];
    for (found, expected) in o.position_m.iter().zip([1.015, 2.0, 2.97]) {
        assert!((found - expected).abs() < 1e-12);
    }
    assert_eq!(o.growth_m, 0.0);
    assert_eq!(o.health, SourceHealth::Fresh);
}

#[test]
fn a_silent_source_grows_then_holds_and_never_vanishes() {
    let mut table = ObstacleTable::new(&[]);
    let mut o = ball(1);
    o.covariance_m2 = [1e-4, 0.0, 0.0, 4e-4, 0.0, 1e-4];
    table.accept(&set(1, 0, NOW, &[o]), NOW, &LIMITS).unwrap();
    let at = |ms: u64| track(&table, NOW + ms * 1_000_000, 0.0)[0];
    assert!((at(100).growth_m - 0.06).abs() < 1e-12, "three sigma");
    assert!((at(300).growth_m - (0.06 + 0.2 * 0.2)).abs() < 1e-9, "and 0.2 m/s beyond 0.1 s");
    assert_eq!(at(300).health, SourceHealth::Stale);
    assert_eq!(table.demand(NOW + 300_000_000, &LIMITS), ObstacleDemand::Proceed);
    assert_eq!(table.demand(NOW + 501_000_000, &LIMITS), ObstacleDemand::Hold { source_id: 1 });
    // An hour later it is where it was extrapolated to when the hold was asked for, and has grown as far as it may.
    assert_eq!(at(3_600_000).position_m, at(501).position_m);
    assert!((at(3_600_000).position_m[0] - 1.05).abs() < 1e-12);
    assert_eq!(at(3_600_000).growth_m, 0.06 + LIMITS.growth_m_max);
    assert!(!table.is_lost(NOW + SECOND, &LIMITS) && table.is_lost(NOW + 3600 * SECOND, &LIMITS));
}

#[test]
fn wherever_an_obstacle_went_at_its_speed_after_the_hold_it_is_inside_what_is_tracked() {
    let mut table = ObstacleTable::new(&[]);
    let moving = Obstacle { velocity_mps: [0.036, 0.0, 0.0], ..Obstacle::ball(1, [0.5, 0.0, -1.0], 0.1) };
    table.accept(&set(1, 0, NOW, &[moving]), NOW, &LIMITS).unwrap();
    for ms in [400, 501, 1000, 2000, 3000] {
        let (o, age_s) = (track(&table, NOW + ms * 1_000_000, 0.0)[0], ms as f64 * 1e-3);
        for truly in [0.5 + 0.036 * age_s, 0.5 + 0.036 * (2.0 * age_s.min(0.5) - age_s)] {
            let outside_m = (truly - o.position_m[0]).abs() - o.growth_m;
            assert!(outside_m <= 1e-9, "{ms} ms: {outside_m} m");
        }
    }
}

#[test]
fn a_source_that_lives_and_is_not_understood_holds_the_arm_beside_one_that_sees_nothing() {
    let stamp_of_the_wall_clock = 1_700_000_000 * SECOND;
    let radius_of_zero = set(2, 0, NOW, &[Obstacle::ball(1, [0.0; 3], 0.0)]);
    let equal_ids = set(2, 0, NOW, &[ball(1), ball(1)]);
    for bad in [set(2, 0, stamp_of_the_wall_clock, &[ball(1)]), radius_of_zero, equal_ids] {
        let mut table = ObstacleTable::new(&[]);
        table.accept(&set(1, 0, NOW, &[]), NOW, &LIMITS).unwrap();
        assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Proceed);
        table.accept(&bad, NOW, &LIMITS).unwrap_err();
        assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Hold { source_id: 2 });
        let mut state = State::default();
        table.report_into(NOW, &LIMITS, &mut state);
        assert_eq!((state.obstacle_sources[1].health, state.stale_sources), (SourceHealth::Refused.wire(), 1));
        // Until something of it is taken, it has left, or the operator has had his say.
        let mut understood = table.clone();
        understood.accept(&set(2, 1, NOW, &[ball(1)]), NOW, &LIMITS).unwrap();
        assert_eq!(understood.demand(NOW, &LIMITS), ObstacleDemand::Proceed);
        let mut forgotten = Vec::new();
        table.forget_expired(NOW, &LIMITS, |id| forgotten.push(id));
        assert_eq!((forgotten, table.demand(NOW, &LIMITS)), (vec![2], ObstacleDemand::Proceed));
    }
}

#[test]
fn what_the_history_holds_of_the_dead_holds_no_arm_and_a_camera_with_old_stamps_does() {
    let mut table = ObstacleTable::new(&[]);
    let old = |sequence| set(2, sequence, NOW - 10 * SECOND, &[ball(1)]);
    assert_eq!(table.accept(&old(7), NOW, &LIMITS), Err(RejectCause::TooOld));
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Proceed);
    (0..4).for_each(|k| assert!(table.accept(&old(k), NOW, &LIMITS).is_err()));
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Hold { source_id: 2 });
}

#[test]
fn a_source_for_which_there_is_no_place_holds_the_arm_and_a_required_one_has_its_own() {
    let mut table = ObstacleTable::new(&[4]);
    for source in 11..=17 {
        table.accept(&set(source, 0, NOW, &[]), NOW, &LIMITS).unwrap();
    }
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Hold { source_id: 4 }, "required, and absent");
    table.accept(&set(4, 0, NOW, &[]), NOW, &LIMITS).expect("its place is kept");
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Proceed);
    table.accept(&set(18, 0, NOW, &[ball(1)]), NOW, &LIMITS).unwrap_err();
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Hold { source_id: 18 }, "eight that see nothing before it");
}

#[test]
fn an_id_belongs_to_the_port_that_was_accepted_first() {
    let (camera, other) = (1_u128 << 100, 2_u128 << 100);
    let mut table = ObstacleTable::new(&[]);
    table.accept_from(&set(1, 0, NOW, &[ball(1)]), camera, NOW, &LIMITS).unwrap();
    let clear = set(1, 1, NOW + 1, &[]);
    assert_eq!(table.accept_from(&clear, other, NOW + 1, &LIMITS), Err(RejectCause::TooManySources));
    assert_eq!(track(&table, NOW, 0.0).len(), 1, "what the camera sees stays");
    assert_eq!((table.taken_by(1, other), table.taken_by(1, camera)), (Some(camera), None));
    table.set_gone(camera);
    assert!(table.log(1).unwrap().is_gone() && table.publishers() == [0; 8]);
    table.accept_from(&clear, other, NOW + 1, &LIMITS).unwrap();
    assert_eq!(table.taken_by(1, camera), Some(other));
}

#[test]
fn a_declared_source_whose_id_two_processes_claim_holds_the_arm_and_another_goes_on() {
    for (declared, expected) in [(&[7][..], ObstacleDemand::Hold { source_id: 7 }), (&[][..], ObstacleDemand::Proceed)]
    {
        let mut table = ObstacleTable::new(declared);
        table.accept_from(&set(7, 0, NOW, &[ball(1)]), 1, NOW, &LIMITS).unwrap();
        assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Proceed);
        let other = table.accept_from(&set(7, 1, NOW, &[]), 2, NOW, &LIMITS);
        assert_eq!(other, Err(RejectCause::TooManySources));
        let mut copy = ObstacleTable::new(declared);
        copy.copy_from(&table);
        assert_eq!(copy.demand(NOW, &LIMITS), expected);
        let mut state = State::default();
        copy.report_into(NOW, &LIMITS, &mut state);
        let health = if declared.is_empty() { SourceHealth::Fresh } else { SourceHealth::Refused };
        assert_eq!(state.obstacle_sources[0].health, health.wire());
        assert_eq!(track(&copy, NOW, 0.0).len(), 1, "what the first one saw is kept");
        // The other one has given up.
        let later = NOW + SECOND;
        table.accept_from(&set(7, 2, later, &[ball(1)]), 1, later, &LIMITS).unwrap();
        assert_eq!(table.demand(later, &LIMITS), ObstacleDemand::Proceed);
    }
}

#[test]
fn a_leaving_source_is_not_missed_unless_declared() {
    let mut table = ObstacleTable::new(&[4]);
    for source in [4, 5] {
        table.accept(&set(source, 0, NOW, &[ball(1)]), NOW, &LIMITS).unwrap();
        let mut bye = set(source, 1, NOW, &[]);
        bye.flags = FLAG_LEAVING;
        table.accept(&bye, NOW, &LIMITS).unwrap();
    }
    assert!(track(&table, NOW, 0.0).is_empty());
    assert_eq!(table.demand(NOW, &LIMITS), ObstacleDemand::Hold { source_id: 4 });
    // It may come back, with a new sequence.
    table.accept(&set(4, 0, NOW, &[]), NOW, &LIMITS).unwrap();
    assert_eq!(table.demand(NOW + SECOND / 4, &LIMITS), ObstacleDemand::Proceed);
}

#[test]
fn the_ninth_source_is_refused_and_counted() {
    let mut table = ObstacleTable::new(&[]);
    for source in 1..=8 {
        table.accept(&set(source, 0, NOW, &[]), NOW, &LIMITS).unwrap();
    }
    assert_eq!(table.accept(&set(9, 0, NOW, &[]), NOW, &LIMITS), Err(RejectCause::TooManySources));
    let mut state = State::default();
    table.report_into(NOW, &LIMITS, &mut state);
    assert_eq!(state.obstacle_sources_refused, 1);
    // The operator's clear makes room once one is expired.
    let mut forgotten = Vec::new();
    table.forget_expired(NOW + SECOND, &LIMITS, |source| forgotten.push(source));
    assert_eq!(forgotten, [1, 2, 3, 4, 5, 6, 7, 8]);
    table.accept(&set(9, 0, NOW + SECOND, &[]), NOW + SECOND, &LIMITS).unwrap();
}

#[test]
fn senders_of_rubbish_cannot_take_all_places() {
    let mut table = ObstacleTable::new(&[]);
    for source in 1..=100 {
        let mut bad = set(source, 0, NOW, &[ball(1)]);
        bad.obstacles[0].position_m[0] = f64::NAN;
        assert_eq!(table.accept(&bad, NOW, &LIMITS), Err(RejectCause::NotFinite));
    }
    table.accept(&set(500, 0, NOW, &[ball(1)]), NOW, &LIMITS).unwrap();
}

#[test]
fn more_obstacles_than_can_be_tracked_are_refused_on_arrival() {
    let mut table = ObstacleTable::new(&[]);
    let full: Vec<_> = (0..MAX_OBSTACLES as u32).map(ball).collect();
    for source in 1..=4 {
        table.accept(&set(source, 0, NOW, &full), NOW, &LIMITS).unwrap();
    }
    assert_eq!(track(&table, NOW, 0.0).len(), MAX_TRACKED);
    assert_eq!(table.accept(&set(5, 0, NOW, &[ball(1)]), NOW, &LIMITS), Err(RejectCause::Overfull));
    // A source may always replace its own set.
    table.accept(&set(4, 1, NOW, &full), NOW, &LIMITS).unwrap();
}

#[test]
fn hull_vertices_survive_the_copy_to_the_control_thread() {
    let mut table = ObstacleTable::new(&[]);
    let mut message = set(1, 0, NOW, &[ball(1)]);
    let a = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let b = a.map(|v| v.map(|x| 2.0 * x));
    assert!(
        message.push_hull(Obstacle { id: 2, ..ball(2) }, &a) && message.push_hull(Obstacle { id: 3, ..ball(3) }, &b)
    );
    table.accept(&message, NOW, &LIMITS).unwrap();
    let mut copy = ObstacleTable::new(&[8, 9]);
    copy.copy_from(&table);
    let tracked = track(&copy, NOW, 0.0);
    assert_eq!(copy.hull_vertices(&tracked[0]), &[] as &[[f64; 3]]);
    assert_eq!(copy.hull_vertices(&tracked[1]), a);
    assert_eq!(copy.hull_vertices(&tracked[2]), b);
}

#[test]
fn lockstep_waits_for_every_declared_source() {
    let mut table = ObstacleTable::new(&[]);
    let for_tick = |source, sequence, tick| {
        let mut s = set(source, sequence, NOW, &[]);
        s.header.tick = tick;
        s
    };
    table.accept(&for_tick(1, 0, 3), NOW, &LIMITS).unwrap();
    assert!(table.is_ready_for(3, &[1]) && table.is_ready_for(2, &[1]) && !table.is_ready_for(4, &[1]));
    assert!(!table.is_ready_for(3, &[1, 2]));
    table.accept(&for_tick(2, 0, crate::ipc::payload::NO_TICK), NOW, &LIMITS).unwrap();
    assert!(!table.is_ready_for(3, &[1, 2]), "an input that belongs to no tick releases none");
}

proptest! {
    /// Whatever a client writes, nothing panics, and what is tracked is finite and bounded.
    #[test]
    fn arbitrary_sets_never_panic_and_never_reach_the_planner_unchecked(
        count in prop_oneof![0..4_u32, any::<u32>()],
        vertex_count in prop_oneof![0..300_u32, any::<u32>()],
        kind in prop_oneof![0..7_u32, any::<u32>()],
        numbers in prop::collection::vec(prop_oneof![-10.0..10.0_f64, any::<f64>()], 19),
        hull in (prop_oneof![0..300_u32, any::<u32>()], prop_oneof![0..300_u32, any::<u32>()]),
        times in (any::<u64>(), prop_oneof![3 => Just(NOW), 1 => any::<u64>()]),
        unit in any::<bool>(),
    ) {
        let mut message = set(1, times.0, times.1, &[]);
        (message.count, message.vertex_count) = (count, vertex_count);
        message.obstacles[0] = Obstacle {
            id: 1,
            kind,
            position_m: [numbers[0], numbers[1], numbers[2]],
            quaternion: if unit { [1.0, 0.0, 0.0, 0.0] } else { [numbers[3], numbers[4], numbers[5], numbers[6]] },
            velocity_mps: [numbers[7], numbers[8], numbers[9]],
            dimensions_m: [numbers[10], numbers[11], numbers[12]],
            covariance_m2: std::array::from_fn(|i| numbers[13 + i]),
            hull_offset: hull.0,
            hull_count: hull.1,
        };
        let mut table = ObstacleTable::new(&[]);
        let accepted = table.accept(&message, NOW, &LIMITS).is_ok();
        let tracked = track(&table, NOW, 0.1);
        prop_assert_eq!(tracked.len(), if accepted { count as usize } else { 0 });
        for o in tracked {
            prop_assert!(o.position_m.iter().chain(&o.quaternion).chain([&o.growth_m]).all(|v| v.is_finite()));
            let norm: f64 = o.quaternion.iter().map(|v| v * v).sum();
            prop_assert!((norm - 1.0).abs() < 1e-12);
        }
    }
}
