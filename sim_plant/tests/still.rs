//! Still at poses that nobody prepared: what the true arm does after a step of the target, in the short form of the campaign
//! (`cargo run --release -p sim_plant --example campaign -- poses`).

#![allow(clippy::expect_used)] // a test stops where it cannot go on
use sim_plant::bench::{Bench, TipMeter};
use sim_plant::poses::{Shown, random, show};
use sim_plant::truth::TruthSettings;
use sinew::config::Config;
use sinew::control::{Limit, Settings};

/// A step from the straight arm to the pose, or the posture, of a seed, watched for 10 s.
fn shown(seed: u64, shape: bool, change: impl Fn(&mut Config, &mut TruthSettings)) -> Shown {
    let mut config = Config::builtin();
    let mut truth = TruthSettings::study(seed);
    change(&mut config, &mut truth);
    let mut bench = Bench::new(&config, &Settings::new(&config), &truth);
    bench.arm(60.0).expect("armed");
    show(&mut bench, &random(&config, seed), shape, 10.0, None).expect("no trace, no error")
}

fn judge(shown: &Shown, still_m: f64) {
    assert_eq!(shown.failed, None, "{shown:?}");
    assert!(shown.peak_to_peak < still_m, "{shown:?}");
    assert!(shown.error < 0.01, "{shown:?}");
    assert_eq!(shown.saturated, 0, "{shown:?}");
    // The estimate knows how well it knows.
    assert!(shown.within >= 0.995 && shown.three_sigma < 0.02, "{shown:?}");
    // The declared speed, 0.11 m/s, is that of the reference; what swings beside it comes on top.
    assert!(shown.speed_max < 0.125, "{shown:?}");
    assert!(shown.roughness < 0.04, "{shown:?}");
}

#[test]
fn a_step_to_a_pose_ends_still() {
    // Near ones and far ones; the last needs another posture than the nearest, which is beyond the cables' tensions.
    for seed in [5, 10, 16, 26, 7] {
        judge(&shown(seed, false, |_, _| ()), 3e-3);
    }
}

#[test]
fn a_step_to_a_shape_ends_still_and_on_it() {
    for seed in [10, 16] {
        let shown = shown(seed, true, |_, _| ());
        judge(&shown, 3e-3);
        assert!(shown.curvature_error < 1e-3, "{shown:?}");
    }
}

#[test]
fn an_arm_that_hardly_damps_is_still_too() {
    let light = |config: &mut Config| config.arm.segments.iter_mut().for_each(|s| s.damping_stiffness_s = 0.002);
    judge(&shown(16, false, |config, _| light(config)), 3e-3);
    // And one that damps a quarter, or not a twentieth, of what its model says.
    for factor in [0.25, 0.04] {
        judge(&shown(16, false, |_, truth| truth.damping_factor = factor), 3e-3);
    }
}

/// The same, watched for 40 s, of an arm whose tip a tracker measures, off by so much (m).
fn measured(seed: u64, off_m: f64) -> (Shown, u32) {
    let config = Config::builtin();
    let mut bench = Bench::new(&config, &Settings::new(&config), &TruthSettings::study(seed));
    let mut tracker = TipMeter::tracker(0.5e-3);
    tracker.off_m = [off_m, 0.0, 0.0];
    bench.tip_sensor = Some(tracker);
    bench.arm(60.0).expect("armed");
    let shown = show(&mut bench, &random(&config, seed), false, 40.0, None).expect("no trace, no error");
    (shown, bench.record().limits.0)
}

#[test]
fn a_measured_tip_comes_to_its_target_where_cables_alone_leave_millimetres_and_is_as_still() {
    // Their paths last for more than 60 s: what is learnt meanwhile is there at the end.
    for seed in [1, 4] {
        let (alone, (with, limits)) = (shown(seed, false, |_, _| ()), measured(seed, 0.0));
        judge(&with, 3e-3);
        assert!(alone.error > 1.8e-3 && with.error < 1.2e-3, "{} m, with a sensor {with:?}", alone.error);
        assert_eq!(limits, 0);
    }
}

#[test]
fn a_tip_sensor_in_another_frame_is_not_believed_and_the_arm_goes_by_its_cables() {
    let (shown, limits) = measured(10, 0.2);
    judge(&shown, 3e-3);
    assert_eq!(limits, 1 << (Limit::TipDoubted.code() - 100));
}
