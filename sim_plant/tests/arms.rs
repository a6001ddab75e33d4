//! Arms of any size and stiffness by the defaults that their own files give: the short form of
//! `cargo run --release -p sim_plant --example campaign -- arms SCENARIO...`.

#![allow(clippy::expect_used)] // a test stops where it cannot go on
use sim_plant::follow::{Followed, follow, plant, scaled};
use sinew::config::{Config, ScenarioConfig};

/// A scenario of the library by nothing but its arm's file.
fn shown(name: &str, scale: f64, duration_s: Option<f64>) -> Followed {
    let scenario = scaled(&ScenarioConfig::find(name).expect("built in"), scale);
    let mut config = Config::of_arm(&scenario.arm, None).expect("an arm that works");
    config.planner.body_radius_m = scenario.planner.body_radius_m;
    let shown = follow(&config, &plant(&config, 1), &scenario, duration_s, |_, _, _| ()).expect("a start");
    assert_eq!(shown.failed, None, "{name}: {shown:?}");
    assert!(shown.distance > 0.0, "{name} touches: {shown:?}");
    assert!(shown.roughness < 0.003, "{name}: {shown:?}");
    shown
}

#[test]
fn tips_of_published_arms_follow_their_paths() {
    for name in [
        "rucker-webster-2011/tip",
        "rao-2021/tip",
        "till-2019/tip",
        "feizi-sheath/tip",
        "tummers-2023/tip",
        "renda-2018/tip",
        "dong-2017/tip",
        "festo-bha/tip",
        "oc-snake-arm/tip",
    ] {
        let shown = shown(name, 1.0, Some(10.0));
        assert!(shown.error.0 < 0.005 && shown.error.1 < 0.015, "{name}: {shown:?}");
    }
}

#[test]
fn published_arms_bend_as_they_are_told() {
    for name in [
        "rucker-webster-2011/shape",
        "sofa-trunk/shape",
        "rao-2021/shape",
        "till-2019/shape",
        "feizi-sheath/shape",
        "tummers-2023/shape",
        "renda-2018/shape",
        "dong-2017/shape",
    ] {
        let shown = shown(name, 1.0, None);
        assert!(shown.curvature_error < 0.01, "{name}: {shown:?}");
    }
}

/// Similar arms do the same, whatever their size: a tip path to 5 % of its error, bends to a thousandth of the largest.
#[test]
fn an_arm_of_another_size_is_as_good() {
    let (path, bends) = (shown("rao-2021/tip", 1.0, Some(8.0)), shown("shape", 1.0, Some(60.0)));
    for scale in [0.03, 0.3, 3.0] {
        let other = shown("rao-2021/tip", scale, Some(8.0));
        assert!((other.error.0 / path.error.0 - 1.0).abs() < 0.05, "{scale}: {other:?}, at full size {path:?}");
    }
    let other = shown("shape", 0.1, Some(60.0));
    assert!((other.curvature_error - bends.curvature_error).abs() < 1e-3, "{other:?}, at full size {bends:?}");
}
