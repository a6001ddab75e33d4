//! Whatever a client writes into shared memory: nothing panics, and what the control loop gets is finite. (Obstacles:
//! beside their intake.)
#![allow(clippy::unwrap_used, clippy::expect_used)]

use proptest::prelude::*;
use sinew::ipc::intake::{EncoderTable, InputLimits, TargetTrack};
use sinew::ipc::payload::{Encoders, Header, Request, RequestKind, Target, TargetMode};

const NOW: u64 = 1_000_000_000_000;
const CABLES: usize = 24;
const SEGMENTS: usize = 4;

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -10.0..10.0_f64, 1 => any::<f64>(), 1 => Just(f64::NAN), 1 => Just(f64::MAX)]
}

/// Often as it should be, so that what is inside is looked at as well.
fn header() -> impl Strategy<Value = Header> {
    (
        any::<u64>(),
        prop_oneof![4 => Just(NOW), 1 => any::<u64>()],
        prop_oneof![8 => Just(None), 1 => any::<u32>().prop_map(Some)],
    )
        .prop_map(|(sequence, capture_ns, version)| {
            let header = Header::new(1, sequence, capture_ns);
            Header { schema_version: version.unwrap_or(header.schema_version), ..header }
        })
}

fn target() -> impl Strategy<Value = Target> {
    let choice = prop_oneof![4 => 0..3_u32, 1 => any::<u32>()];
    let segments = prop_oneof![4 => Just(SEGMENTS as u32), 1 => any::<u32>()];
    let time = prop_oneof![4 => (0..2_000_000_000_u64).prop_map(|d| NOW - 1_000_000_000 + d), 1 => any::<u64>()];
    (
        header(),
        time,
        choice,
        segments,
        prop::collection::vec(number(), 13),
        prop::collection::vec(number(), 16),
        any::<bool>(),
    )
        .prop_map(|(header, valid_from_ns, mode, segment_count, n, k, unit)| {
            let mut t = Target { header, valid_from_ns, mode, segment_count, ..Target::default() };
            t.position_m.copy_from_slice(&n[..3]);
            if !unit {
                t.quaternion.copy_from_slice(&n[3..7]);
            }
            t.velocity_mps.copy_from_slice(&n[7..10]);
            t.angular_velocity_radps.copy_from_slice(&n[10..13]);
            t.curvature_1pm[..8].copy_from_slice(&k[..8]);
            t.curvature_rate_1pms[..8].copy_from_slice(&k[8..]);
            t
        })
}

proptest! {
    #[test]
    fn arbitrary_targets_give_finite_samples_or_none(
        targets in prop::collection::vec(target(), 1..12),
        at in prop::collection::vec(prop_oneof![4 => (0..4_000_000_000_u64).prop_map(|d| NOW - 1_000_000_000 + d), 1 => any::<u64>()], 8),
    ) {
        let limits = InputLimits::default();
        let mut track = TargetTrack::new(SEGMENTS);
        let accepted = targets.iter().filter(|t| track.accept(t, NOW, &limits).is_ok()).count();
        for at_ns in at {
            let Some(sample) = track.sample(at_ns, &limits) else { continue };
            prop_assert!(accepted > 0);
            prop_assert!(sample.overrun_s.is_finite());
            match sample.mode {
                TargetMode::Tip => {
                    let all = sample.position_m.iter().chain(&sample.quaternion).chain(&sample.velocity_mps);
                    prop_assert!(all.chain(&sample.angular_velocity_radps).all(|v| v.is_finite()), "{sample:?}");
                    let norm: f64 = sample.quaternion.iter().map(|v| v * v).sum();
                    prop_assert!((norm - 1.0).abs() < 1e-6, "{sample:?}");
                }
                TargetMode::Shape => {
                    let all = sample.curvature_1pm[..8].iter().chain(&sample.curvature_rate_1pms[..8]);
                    prop_assert!(all.copied().all(f64::is_finite), "{sample:?}");
                }
            }
        }
    }

    #[test]
    fn arbitrary_encoders_give_finite_readings_or_none(
        header in header(),
        cable_count in prop_oneof![4 => Just(CABLES as u32), 1 => any::<u32>()],
        source in prop_oneof![4 => 0..4_u32, 1 => any::<u32>()],
        valid in any::<[u64; 4]>(),
        numbers in prop::collection::vec(prop_oneof![8 => 0.1..3.0_f64, 1 => number()], 2 * CABLES),
    ) {
        let limits = InputLimits::default();
        let mut m = Encoders { header, cable_count, source, ..Encoders::default() };
        m.length_valid = [valid[0], valid[1]];
        m.tension_valid = [valid[2], valid[3]];
        m.length_m[..CABLES].copy_from_slice(&numbers[..CABLES]);
        m.tension_n[..CABLES].copy_from_slice(&numbers[CABLES..]);
        let mut table = EncoderTable::new(CABLES);
        let accepted = table.accept(&m, NOW, &limits).is_ok();
        prop_assert_eq!(table.latest().is_some(), accepted);
        if let Some(m) = table.latest() {
            prop_assert!((0..CABLES).filter(|&c| m.is_length_valid(c)).all(|c| m.length_m[c].is_finite()));
            prop_assert!((0..CABLES).filter(|&c| m.is_tension_valid(c)).all(|c| m.tension_n[c].is_finite()));
        }
        prop_assert!(table.age_s(NOW) >= 0.0);
    }

    #[test]
    fn an_arbitrary_kind_of_request_is_known_or_refused(kind in prop_oneof![0..20_u32, any::<u32>()]) {
        let known = RequestKind::ALL.iter().copied().find(|known| known.wire() == kind);
        prop_assert_eq!(RequestKind::from_wire(Request { kind, ..Request::default() }.kind), known);
    }
}
