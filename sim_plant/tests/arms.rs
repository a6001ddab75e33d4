//! Arms of any size and stiffness by the defaults that their own files give: the short form of
//! `cargo run --release -p sim_plant --example campaign -- arms SCENARIO...`.

#![allow(clippy::expect_used)] // a test stops where it cannot go on
use sim_plant::follow::{Followed, divided, follow, plant, scaled};
use sinew::config::{Config, ScenarioConfig, Start, Task};

/// A scenario of the library by nothing but its arm's file.
fn shown(name: &str, scale: f64, duration_s: Option<f64>) -> Followed {
    shown_of(name, &scaled(&ScenarioConfig::find(name).expect("built in"), scale), duration_s)
}

fn shown_of(name: &str, scenario: &ScenarioConfig, duration_s: Option<f64>) -> Followed {
    let mut config = Config::of_arm(&scenario.arm, None).expect("an arm that works");
    config.planner.body_radius_m = scenario.planner.body_radius_m;
    let shown = follow(&config, &plant(&config, 1), scenario, duration_s, |_, _, _| ()).expect("a start");
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

/// The paper's rod in so many segments with cables at these angles (deg), bent as told (1/m).
fn bent(name: &str, segments: usize, cables_deg: &[f64], bend: impl Fn(usize) -> [f64; 2]) -> Followed {
    let mut scenario = ScenarioConfig::find("shape").expect("built in");
    let curvatures_1pm = (0..segments).flat_map(bend).collect();
    scenario.task = Task::Shape { curvatures_1pm, weight_end: 1e10, weight_slope: 9.99e5, end_s: 30.0 };
    (scenario.arm, scenario.start) = (divided(segments, cables_deg), Start::Straight);
    (scenario.obstacles, scenario.weight_tension_change) = (Vec::new(), None);
    shown_of(name, &scenario, Some(40.0))
}

#[test]
fn an_arm_of_sixteen_segments_bends_as_it_is_told() {
    let wanted = [[0.4, 0.4], [-1.2, 0.0], [-0.8, -1.2], [-0.8, -1.2]];
    let shown = bent("sixteen", 16, &[30.0, 150.0, 270.0], |segment| wanted[segment / 4]);
    assert!(shown.curvature_error < 0.01, "{shown:?}");
}

/// To where they can pull it: one cable to one side, two that face each other in a plane, two beside each other in a quarter.
#[test]
fn arms_of_one_and_two_cables_bend_as_they_are_told() {
    for (name, cables_deg, bend) in
        [("one", &[0.0][..], [0.0, 0.4]), ("two", &[0.0, 180.0], [0.0, -0.4]), ("a quarter", &[0.0, 90.0], [-0.2, 0.4])]
    {
        let shown = bent(name, 4, cables_deg, |_| bend);
        assert!(shown.curvature_error < 0.01, "{name}: {shown:?}");
    }
}
