//! `sinew stability` and `sinew arm-info` as users and scripts meet them.
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test may panic

use serde_json::Value;
use std::process::{Command, Output};

fn sinew(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sinew")).env_remove("SINEW_LOG").args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn the_exit_code_tells_whether_the_loop_is_stable_and_json_which_mode_is_not() {
    let stable = sinew(&["stability"]);
    assert_eq!(stable.status.code(), Some(0), "{}", text(&stable.stderr));
    assert!(text(&stable.stdout).contains("at rest: stable"), "{}", text(&stable.stdout));
    let late = sinew(&["stability", "--delay", "30", "--json"]);
    assert_eq!(late.status.code(), Some(1), "{}", text(&late.stderr));
    let json: Value = serde_json::from_slice(&late.stdout).unwrap();
    assert_eq!(json["stable"], false);
    assert_eq!(json["delay_ticks"], 30);
    let mode = &json["places"][0]["modes"][0];
    assert!(mode["growth_1ps"].as_f64().unwrap() > json["places"][0]["growth_limit_1ps"].as_f64().unwrap());
    assert!(mode["damping_ratio"].as_f64().unwrap() < 0.0 && mode["frequency_hz"].as_f64().unwrap() > 0.1, "{mode}");
    let shares = mode["bending"].as_array().unwrap().iter().map(|b| b.as_f64().unwrap()).sum::<f64>();
    let all = shares + mode["torsion"].as_f64().unwrap() + mode["inside"].as_f64().unwrap();
    assert!((all - 1.0).abs() < 1e-9, "{mode}");
}

#[test]
fn what_cannot_be_held_exits_with_2_and_says_why() {
    for (arguments, why) in [
        (&["--pose", "1,2,3"][..], "7 numbers"),
        (&["--pose", "3,3,0,1,0,0,0"], "out of reach"),
        (&["--shape", "0.1,0.2"], "has 8 finite curvatures"),
        (&["--damping", "0"], "0.001 to 1000"),
        (&["--arm", "nobodys"], "arms of the library"),
    ] {
        let output = sinew(&[&["stability"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(why), "{arguments:?}: {}", text(&output.stderr));
    }
}

#[test]
fn arm_info_tells_what_an_arm_can_do_and_draws_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pictures");
    let output = sinew(&["arm-info", "rao-2021", "--svg", &path.to_string_lossy()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let shown = text(&output.stdout);
    for label in
        ["mass that moves", "reach in a plane", "force across", "tip moved by 1 N", "encoders", "mode 10", "suggested"]
    {
        assert!(shown.contains(label), "{label}: {shown}");
    }
    let picture = std::fs::read_to_string(path.join("rao-2021.svg")).unwrap();
    assert!(picture.starts_with("<svg") && picture.matches("<circle").count() > 100, "{}", &picture[..200]);
}

#[test]
fn arm_info_warns_of_cables_that_do_not_hold_the_arm_up() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("heavy.toml");
    let arm = include_str!("../config/arm.toml").replace("[arm]\n", "[arm]\ngravity_mps2 = [-9.81, 0.0, 0.0]\n");
    std::fs::write(&file, arm).unwrap();
    let output = sinew(&["arm-info", &file.to_string_lossy()]);
    let warnings = text(&output.stderr);
    assert!(
        warnings.contains("cannot hold the straight arm up") && warnings.contains("tension_n_max = "),
        "{warnings}"
    );
}
