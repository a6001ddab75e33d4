use super::*;
use crate::ipc::payload::Header;

const SECOND: u64 = 1_000_000_000;
const NOW: u64 = 100 * SECOND;

fn limits() -> InputLimits {
    InputLimits::default()
}

fn point(sequence: u64, valid_from_ns: u64, x: f64, vx: f64) -> Target {
    Target {
        header: Header::new(3, sequence, NOW),
        valid_from_ns,
        position_m: [x, 0.0, -2.4],
        velocity_mps: [vx, 0.0, 0.0],
        ..Target::default()
    }
}

fn accept(track: &mut TargetTrack, target: &Target) {
    track.accept(target, NOW, &limits()).unwrap();
}

#[test]
fn a_set_point_is_valid_at_once_and_held() {
    let mut track = TargetTrack::new(4);
    assert_eq!(track.sample(NOW, &limits()), None);
    accept(&mut track, &point(0, 0, 0.3, 0.0));
    for later in [0, SECOND, 3600 * SECOND] {
        let s = track.sample(NOW + later, &limits()).unwrap();
        assert_eq!((s.position_m, s.overrun_s), ([0.3, 0.0, -2.4], 0.0));
    }
}

#[test]
fn a_set_point_that_is_held_is_not_called_expired_and_a_silent_path_is() {
    let health = |vx: f64, from_ns: u64, after_ns: u64| {
        let mut track = TargetTrack::new(4);
        accept(&mut track, &point(0, from_ns, 0.3, vx));
        SourceHealth::from_wire(track.report(NOW + after_ns, &limits()).health).unwrap()
    };
    assert_eq!(health(0.0, 0, 0), SourceHealth::Fresh);
    assert_eq!(health(0.0, 0, 3600 * SECOND), SourceHealth::Held);
    assert_eq!(health(0.1, 0, 3600 * SECOND), SourceHealth::Expired);
    // Not yet in force, and its sender is silent.
    assert_eq!(health(0.0, NOW + 7200 * SECOND, 3600 * SECOND), SourceHealth::Expired);
    let mut track = TargetTrack::new(4);
    accept(&mut track, &point(0, 0, 0.3, 0.0));
    track.clear();
    assert_eq!(track.report(NOW + 3600 * SECOND, &limits()).health, SourceHealth::Expired.wire());
}

#[test]
fn a_point_is_not_followed_before_its_time() {
    let mut track = TargetTrack::new(4);
    accept(&mut track, &point(0, NOW + SECOND, 0.3, 0.0));
    assert_eq!(track.sample(NOW + SECOND - 1, &limits()), None);
    assert!(track.sample(NOW + SECOND, &limits()).is_some());
}

#[test]
fn a_streamed_path_is_met_between_its_points() {
    // x = sin(2 t), sampled every 20 ms: Hermite's error is below h^4/384 max|x''''| = 7e-9.
    let mut track = TargetTrack::new(4);
    for k in 0..40_u64 {
        let t = k as f64 * 0.02;
        accept(&mut track, &point(k, NOW + k * 20_000_000, (2.0 * t).sin(), 2.0 * (2.0 * t).cos()));
    }
    for ns in (0..780_000_000_u64).step_by(7_000_000) {
        let t = ns as f64 * 1e-9;
        let s = track.sample(NOW + ns, &limits()).unwrap();
        assert!((s.position_m[0] - (2.0 * t).sin()).abs() < 7e-9, "at {t}");
        assert!((s.velocity_mps[0] - 2.0 * (2.0 * t).cos()).abs() < 2e-6, "at {t}");
    }
}

#[test]
fn attitude_turns_the_short_way_whatever_the_signs() {
    let half = 0.2_f64;
    for sign in [1.0, -1.0] {
        let mut track = TargetTrack::new(4);
        accept(&mut track, &point(0, NOW, 0.0, 0.0));
        let mut to = point(1, NOW + SECOND, 0.0, 0.0);
        to.quaternion = [half.cos() * sign, 0.0, 0.0, half.sin() * sign];
        accept(&mut track, &to);
        let s = track.sample(NOW + SECOND / 2, &limits()).unwrap();
        let w = (half / 2.0).cos();
        assert!((s.quaternion[0].abs() - w).abs() < 1e-12);
        assert!((s.angular_velocity_radps[2] - 0.4).abs() < 1e-12);
    }
}

#[test]
fn a_moving_target_that_falls_silent_stands_still_and_is_reported() {
    let mut track = TargetTrack::new(4);
    accept(&mut track, &point(0, NOW, 0.0, 0.5));
    let s = track.sample(NOW + 50_000_000, &limits()).unwrap();
    assert!((s.position_m[0] - 0.025).abs() < 1e-12 && s.velocity_mps[0] == 0.5);
    let s = track.sample(NOW + 10 * SECOND, &limits()).unwrap();
    assert!((s.position_m[0] - 0.05).abs() < 1e-12 && s.velocity_mps[0] == 0.0);
    assert!((s.overrun_s - 10.0).abs() < 1e-9);
}

#[test]
fn a_weight_rises_between_its_points_and_none_stays_none() {
    let mut track = TargetTrack::new(4);
    for (k, weight) in [2e7, 4e7, 0.0].into_iter().enumerate() {
        let point = point(k as u64, NOW + k as u64 * SECOND, 0.0, 0.0);
        accept(&mut track, &Target { weight, ..point });
    }
    let weight_at = |ns: u64| track.sample(NOW + ns, &limits()).unwrap().weight;
    assert_eq!([0, SECOND / 2, SECOND].map(weight_at), [2e7, 3e7, 4e7]);
    assert_eq!(weight_at(SECOND + SECOND / 2), 4e7, "up to a point without one, that of the point before");
    assert_eq!(weight_at(5 * SECOND), 0.0);
}

#[test]
fn a_new_point_replaces_all_that_come_after_it() {
    let mut track = TargetTrack::new(4);
    for k in 0..10 {
        accept(&mut track, &point(k, NOW + k * SECOND, 0.1, 0.0));
    }
    accept(&mut track, &point(10, NOW + 2 * SECOND, 0.9, 0.0));
    assert_eq!(track.sample(NOW + 9 * SECOND, &limits()).unwrap().position_m[0], 0.9);
    assert_eq!(track.sample(NOW + SECOND, &limits()).unwrap().position_m[0], 0.1);
    accept(&mut track, &point(11, 0, 0.5, 0.0));
    assert_eq!(track.sample(NOW, &limits()).unwrap().position_m[0], 0.5, "a set-point replaces everything");
}

#[test]
fn passed_points_make_room_and_a_full_future_is_refused() {
    let mut track = TargetTrack::new(4);
    for k in 0..200 {
        let now = NOW + k * 1_000_000;
        let mut p = point(k, now + 10_000_000, k as f64, 0.0);
        p.header.capture_ns = now;
        track.accept(&p, now, &limits()).unwrap();
    }
    let mut track = TargetTrack::new(4);
    for k in 0..TRACK_POINTS as u64 {
        accept(&mut track, &point(k, NOW + (k + 1) * SECOND, 0.0, 0.0));
    }
    let mut one_more = point(100, NOW + 1000 * SECOND, 0.0, 0.0);
    one_more.header.tick = 7;
    assert!(!track.is_ready_for(7));
    assert_eq!(track.accept(&one_more, NOW, &limits()), Err(RejectCause::Overfull));
    // Nobody says it again: a loop in lockstep that waited for it would wait for ever.
    assert!(track.is_ready_for(7) && !track.is_ready_for(8));
    one_more.header = Header { source_id: one_more.header.source_id + 1, tick: 9, ..one_more.header };
    assert!(
        track.accept(&one_more, NOW, &limits()).is_err() && !track.is_ready_for(8),
        "nor does another say it for it"
    );
}

#[test]
fn a_late_tick_that_asks_for_a_time_before_the_points_that_came_meanwhile_has_a_target() {
    let mut track = TargetTrack::new(4);
    for k in 0..3 {
        let now = NOW + k * SECOND;
        let mut p = point(k, now, k as f64, 0.0);
        p.header.capture_ns = now;
        track.accept(&p, now, &limits()).unwrap();
    }
    // The third came at its own time and dropped the first; the tick is of a time before the second.
    assert_eq!(track.sample(NOW + SECOND / 2, &limits()).unwrap().position_m[0], 1.0);
    // A path that begins anew in the future has not begun.
    let mut later = point(3, NOW + 9 * SECOND, 0.7, 0.0);
    later.header.capture_ns = NOW + 2 * SECOND;
    let mut fresh = TargetTrack::new(4);
    fresh.accept(&later, NOW + 2 * SECOND, &limits()).unwrap();
    assert_eq!(fresh.sample(NOW + 8 * SECOND, &limits()), None);
    later.valid_from_ns = NOW;
    later.header.sequence = 4;
    track.accept(&later, NOW + 2 * SECOND, &limits()).unwrap();
    assert_eq!(track.sample(NOW + SECOND, &limits()).unwrap().position_m[0], 0.7, "it replaces all after its time");
    later.valid_from_ns = NOW + 9 * SECOND;
    later.header.sequence = 5;
    track.clear();
    track.accept(&later, NOW + 2 * SECOND, &limits()).unwrap();
    assert_eq!(track.sample(NOW + 8 * SECOND, &limits()), None);
}

#[test]
fn malformed_targets_are_refused_one_by_one() {
    let refused = |cause: RejectCause, change: &dyn Fn(&mut Target)| {
        let mut track = TargetTrack::new(4);
        accept(&mut track, &point(0, 0, 0.3, 0.0));
        let mut bad = point(1, 0, 0.7, 0.0);
        change(&mut bad);
        assert_eq!(track.accept(&bad, NOW, &limits()), Err(cause));
        assert_eq!(track.report(NOW, &limits()).rejected[cause.wire() as usize], 1);
        assert_eq!(track.sample(NOW, &limits()).unwrap().position_m[0], 0.3, "the last valid target stays");
    };
    refused(RejectCause::NotFinite, &|t| t.position_m[1] = f64::NAN);
    refused(RejectCause::NotFinite, &|t| t.angular_velocity_radps[1] = f64::INFINITY);
    refused(RejectCause::Quaternion, &|t| t.quaternion = [0.0; 4]);
    refused(RejectCause::UnknownKind, &|t| t.mode = 7);
    refused(RejectCause::Dimensions, &|t| t.position_m[1] = 1e9);
    refused(RejectCause::Sequence, &|t| t.header.sequence = 0);
    refused(RejectCause::Future, &|t| t.header.capture_ns = NOW + SECOND);
    refused(RejectCause::TooManySources, &|t| t.header.source_id = 4);
    refused(RejectCause::NotFinite, &|t| t.weight = f64::NAN);
    refused(RejectCause::Weight, &|t| t.weight = -1.0);
    refused(RejectCause::Weight, &|t| t.weight = 1e21);
    refused(RejectCause::WrongCount, &|t| {
        t.mode = TargetMode::Shape.wire();
        t.segment_count = 3;
    });
    refused(RejectCause::NotFinite, &|t| {
        t.mode = TargetMode::Shape.wire();
        t.segment_count = 4;
        t.curvature_1pm[7] = f64::NAN;
    });
}
