//! The configuration refuses what it must, in words that help, and accepts what is shipped.

// A test that cannot go on fails; the exemption of the lints covers test functions, not their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod along;
mod scenarios;

use sinew::config::schema::{Kind, Presence, TableSpec};
use sinew::config::{
    ArmConfig, BUILTIN_FILES, BusConfig, BusLayout, ChordRule, Config, ConfigError, PayloadConfig, Route, Routing,
    SCENARIOS, ScenarioConfig, SegmentConfig, StrainRule, TABLES, Taper,
};
use std::f64::consts::FRAC_1_SQRT_2;
use std::fmt::Write as _;

fn shipped(name: &str) -> String {
    BUILTIN_FILES.iter().find(|(file, _)| *file == name).unwrap().1.to_owned()
}

fn files(names: &[&str]) -> Vec<(String, String)> {
    names.iter().map(|name| ((*name).to_owned(), shipped(name))).collect()
}

/// Every part must be in the report of the refusal.
fn expect<T: std::fmt::Debug>(result: Result<T, ConfigError>, parts: &[&str]) {
    let error = result.expect_err("must be refused");
    // The snippet's frame breaks long lines; the words are compared without it.
    let report = format!("{}\n{}", error.report(), error.lines().collect::<Vec<_>>().join("\n"));
    for part in parts {
        assert!(report.contains(part), "`{part}` is not in\n{report}");
    }
}

/// The shipped configuration with one text replaced in one file.
fn changed(file: &str, from: &str, to: &str) -> Result<Config, ConfigError> {
    let mut texts = files(&["arm.toml", "controller.toml", "drives.toml"]);
    let text = &mut texts.iter_mut().find(|(name, _)| name == file).unwrap().1;
    assert!(text.contains(from), "{file} has no `{from}`");
    *text = text.replacen(from, to, 1);
    Config::parse(texts)
}

fn line_of(file: &str, from: &str) -> usize {
    let text = shipped(file);
    text[..text.find(from).unwrap()].matches('\n').count() + 1
}

/// One thing wrong in a shipped file: the report must show `file:line`, and these parts.
fn refuse(file: &str, from: &str, to: &str, parts: &[&str]) {
    let place = format!("{file}:{}:", line_of(file, from));
    let mut all = vec![place.as_str()];
    all.extend_from_slice(parts);
    expect(changed(file, from, to), &all);
}

#[test]
fn the_built_in_arm_is_the_papers() {
    let segment = |last: bool| SegmentConfig {
        length_m: 0.65,
        elements: 5,
        bending_stiffness_nm2: 7.0,
        torsional_stiffness_nm2: 7.0 / 1.3,
        damping_stiffness_s: 0.05,
        disk_mass_kg: 0.3,
        disk_radius_m: 0.055,
        disk_thickness_m: 0.01,
        backbone_mass_kgpm: 0.15,
        backbone_radius_m: 0.004,
        connector_length_m: if last { 0.0 } else { 0.05 },
        connector_mass_kg: 0.0,
        hole_radius_m: 0.05,
        hole_angles_rad: (0..6).map(|c| (30.0 + 60.0 * f64::from(c)).to_radians()).collect(),
        tension_n_max: None,
        taper: Taper::default(),
        route: Route::default(),
        cable_ends: Vec::new(),
        cables_from: None,
        cable_stiffness_n: None,
        cable_feed_m: 0.0,
    };
    let expected = ArmConfig {
        name: "paper".into(),
        base_position_m: [0.0; 3],
        base_quaternion: [FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2, 0.0],
        gravity_mps2: [0.0; 3],
        damping_mass_1ps: 0.0,
        chord: ChordRule::Simpson,
        strain: StrainRule::VectorPart,
        routing: Routing::Local,
        rho_inf: 0.8,
        tension_n_min: 0.0,
        tension_n_max: 220.0,
        tension_rate_npsmax: f64::INFINITY,
        segments: (0..4).map(|s| segment(s == 3)).collect(),
        payload: PayloadConfig::default(),
    };
    assert_eq!(ArmConfig::paper(), expected);
}

#[test]
fn the_shipped_files_are_accepted_together() {
    let config = Config::parse(files(&["arm.toml", "controller.toml", "drives.toml"])).unwrap();
    assert_eq!(config.drives.buses.len(), 1);
    let nodes: Vec<u8> = config.drives.drives.iter().map(|drive| drive.node_id).collect();
    assert_eq!(nodes, (1..=24).collect::<Vec<u8>>());
    assert_eq!(config.planner.period_s, 0.01);
    assert_eq!(config.ipc.arm, "paper");

    let config = Config::parse(files(&["arm.toml", "controller.toml", "drives-4-buses.toml", "plant.toml"])).unwrap();
    assert_eq!(config.drives.buses.len(), 4);
    for (index, drive) in config.drives.drives.iter().enumerate() {
        assert_eq!((drive.bus, usize::from(drive.node_id)), (index / 6, index % 6 + 1));
        assert_eq!((drive.segment, drive.cable), (index / 6 + 1, index % 6 + 1));
    }
    let fd = Config::parse(files(&["arm.toml", "controller.toml", "drives-4-fd-buses.toml"])).unwrap();
    assert_eq!(fd.drives.drives, config.drives.drives);
    for (fd, classic) in fd.drives.buses.iter().zip(&config.drives.buses) {
        let packed = BusConfig { fd: true, data_bitrate_bps: 5_000_000, layout: BusLayout::Packed, ..classic.clone() };
        assert_eq!(*fd, packed);
    }
    assert!(fd.summary().iter().any(|line| line.value.contains("FD 1000 / 5000 kbit/s, packed, 6 drives")));

    let summary: Vec<_> = config.summary().into_iter().map(|line| format!("{}: {}", line.label, line.value)).collect();
    assert!(
        summary.iter().any(|line| line.starts_with("bus bus3: SocketCAN vcan3, 1000 kbit/s, 6 drives, nodes 1 to 6"))
    );
    assert!(summary.iter().any(|line| line.contains("10 ms (100 Hz)")), "{summary:?}");

    let mut fast = files(&["arm.toml", "drives-4-fd-buses.toml"]);
    fast.push(("controller-1khz.toml".to_owned(), include_str!("../../config/controller-1khz.toml").to_owned()));
    let fast = Config::parse(fast).unwrap();
    let period = fast.summary().into_iter().find(|line| line.label == "period").unwrap().value;
    assert_eq!(period, "1 ms (1000 Hz), SCHED_FIFO 80 on processor 1, wake-up latency at most 0 us");
}

#[test]
fn limits_of_missed_deadlines_are_times_where_they_are_not_given() {
    let limits = |config: Config| (config.timing.overruns_hold, config.timing.overruns_fault);
    let mut fast = files(&["arm.toml", "drives-4-fd-buses.toml"]);
    fast.push(("controller-1khz.toml".to_owned(), include_str!("../../config/controller-1khz.toml").to_owned()));
    assert_eq!(limits(Config::parse(fast).unwrap()), (20, 100), "20 ms and 0.1 s");
    let with = |keys: &str| changed("controller.toml", "period_s = 0.01", keys);
    assert_eq!(limits(with("period_s = 0.01").unwrap()), (2, 10));
    assert_eq!(limits(with("period_s = 0.02").unwrap()), (2, 10), "at least");
    assert_eq!(limits(with("period_s = 0.01\noverruns_hold = 0\noverruns_fault = 1").unwrap()), (0, 1));
    expect(with("period_s = 0.01\noverruns_hold = 10"), &["not greater than `overruns_hold`", "11 to 10000"]);
}

#[test]
fn a_wake_up_latency_is_asked_for_only_where_it_is_given_and_within_its_range() {
    assert_eq!(
        Config::parse(files(&["arm.toml", "controller.toml", "drives.toml"])).unwrap().timing.wake_latency_s,
        None
    );
    let with = |value| {
        let keys = format!("period_s = 0.01\nwake_latency_s = {value}");
        changed("controller.toml", "period_s = 0.01", &keys)
    };
    for (value, expected) in [("0", 0.0), ("0.01", 0.01)] {
        assert_eq!(with(value).unwrap().timing.wake_latency_s, Some(expected));
    }
    for value in ["20.0", "0.0101", "-1e-6", "nan"] {
        expect(with(value), &["`loop.wake_latency_s`", value, "0 to 0.01 s"]);
    }
}

#[test]
fn files_from_disk_are_named_by_their_paths() {
    let directory = tempfile::tempdir().unwrap();
    let arm = directory.path().join("my-arm.toml");
    std::fs::write(&arm, shipped("arm.toml").replace("rho", "rhu").replace("cables = 6", "cables = 0")).unwrap();
    let drives = directory.path().join("drives.toml");
    std::fs::write(&drives, shipped("drives.toml")).unwrap();
    let place = format!("{}:{}:10", arm.display(), line_of("arm.toml", "cables = 6"));
    expect(Config::load(&[arm, drives]), &[&place, "`arm.segment_defaults.cables` = 0", "integer 1 to 12"]);
    let missing = directory.path().join("nowhere.toml");
    expect(Config::load(&[missing]), &["cannot read", "nowhere.toml"]);
}

#[test]
fn an_unknown_key_is_refused_with_a_suggestion() {
    refuse(
        "arm.toml",
        "disk_mass_kg",
        "disc_mass_kg",
        &["unknown key `arm.segment_defaults.disc_mass_kg`", "did you mean `disk_mass_kg`"],
    );
}

#[test]
fn an_unknown_table_is_refused_with_a_suggestion() {
    refuse(
        "controller.toml",
        "[observer]",
        "[obsever]",
        &["unknown table or key `obsever`", "did you mean `observer`"],
    );
}

#[test]
fn a_bus_that_cannot_have_its_name_is_refused() {
    refuse(
        "drives.toml",
        "interface = \"sinew0\"",
        "interface = \"a/b\"",
        &["drives.buses[0].interface", "A-Z a-z 0-9"],
    );
    let socketcan = |name: &str| {
        let mut texts = files(&["arm.toml", "controller.toml", "drives.toml"]);
        let drives = &mut texts[2].1;
        *drives = drives.replace("\"virtual\"", "\"socketcan\"").replace("interface = \"sinew0\"", name);
        Config::parse(texts)
    };
    expect(socketcan("interface = \"can 0\""), &["drives.toml:", "no name of a network interface"]);
    assert!(socketcan("interface = \"can0\"").is_ok());
}

#[test]
fn a_negative_stiffness_is_refused() {
    refuse(
        "arm.toml",
        "bending_stiffness_nm2 = 7.0",
        "bending_stiffness_nm2 = -7.0",
        &["bending_stiffness_nm2` = -7.0 is outside its range", "> 0 and <= 1e6 N m^2"],
    );
}

#[test]
fn a_segment_count_of_zero_is_refused() {
    refuse(
        "arm.toml",
        "segment_count = 4",
        "segment_count = 0",
        &["`arm.segment_count` = 0 is outside its range", "integer 1 to 16"],
    );
}

#[test]
fn an_arm_without_segments_is_refused() {
    expect(changed("arm.toml", "segment_count = 4", ""), &["arm.toml:6:", "the arm has no segments", "1 to 16"]);
}

#[test]
fn nan_is_refused() {
    refuse(
        "arm.toml",
        "length_m = 0.65",
        "length_m = nan",
        &["length_m` = nan is outside its range", "> 0 and <= 10 m"],
    );
}

#[test]
fn infinity_is_refused() {
    refuse(
        "arm.toml",
        "tension_n_max = 220.0",
        "tension_n_max = inf",
        &["`arm.tension_n_max` = inf is outside its range", "1e5 N"],
    );
}

#[test]
fn a_value_of_the_wrong_type_is_refused() {
    refuse(
        "arm.toml",
        "elements = 5",
        "elements = 5.0",
        &["elements` = 5.0 is of the wrong type", "found float", "integer 1 to 50"],
    );
    refuse(
        "controller.toml",
        "barrier = true",
        "barrier = \"yes\"",
        &["`planner.barrier` = \"yes\"", "found string", "true, false"],
    );
}

#[test]
fn a_name_that_is_no_choice_is_refused() {
    refuse(
        "controller.toml",
        "warning = \"seeded\"",
        "warning = \"seded\"",
        &["`planner.warning` = \"seded\"", "did you mean `seeded`", "complementarity"],
    );
}

#[test]
fn a_vector_of_the_wrong_length_is_refused() {
    refuse(
        "arm.toml",
        "tension_n_max = 220.0",
        "gravity_mps2 = [0.0, -9.81]\ntension_n_max = 220.0",
        &["`arm.gravity_mps2` = [0.0, -9.81] has 2 entries, not 3", "3 numbers"],
    );
}

#[test]
fn a_number_inside_a_vector_is_pointed_at() {
    refuse(
        "arm.toml",
        "tension_n_max = 220.0",
        "gravity_mps2 = [0.0, nan, 0.0]\ntension_n_max = 220.0",
        &["`arm.gravity_mps2[1]` = nan", ":22"],
    );
}

#[test]
fn a_quaternion_that_is_not_of_norm_1_is_refused() {
    refuse(
        "arm.toml",
        "tension_n_max = 220.0",
        "base_quaternion = [1.0, 0.0, 0.1, 0.0]\ntension_n_max = 220.0",
        &["`arm.base_quaternion` = [1.0, 0.0, 0.1, 0.0] is outside", "norm 1"],
    );
}

#[test]
fn a_missing_key_is_named_at_its_table() {
    let place = format!("arm.toml:{}:", line_of("arm.toml", "segment_defaults"));
    expect(
        changed("arm.toml", "length_m = 0.65\n", ""),
        &[&place, "`arm.segment_defaults.length_m` is missing", "> 0 and <= 10 m"],
    );
}

#[test]
fn text_that_is_not_toml_is_refused_at_its_line() {
    refuse("arm.toml", "tension_n_max = 220.0", "tension_n_max = = 220.0", &["not TOML"]);
}

#[test]
fn a_key_given_twice_is_refused() {
    expect(
        changed("arm.toml", "tension_n_max = 220.0", "tension_n_max = 1.0\ntension_n_max = 220.0"),
        &["arm.toml:9:1", "duplicate key"],
    );
}

#[test]
fn a_table_in_two_files_is_refused_naming_both() {
    let mut texts = files(&["arm.toml", "drives.toml"]);
    texts.push(("second.toml".into(), "\n[arm]\nname = \"x\"\n".into()));
    let place = format!("arm.toml:{}:2", line_of("arm.toml", "[arm]"));
    expect(Config::parse(texts), &["second.toml:2:2", "[arm] stands in", &place, "again in second.toml"]);
}

#[test]
fn a_missing_table_is_named_with_the_files() {
    expect(Config::parse(files(&["arm.toml", "controller.toml"])), &["no table [drives] in arm.toml, controller.toml"]);
    expect(Config::parse(files(&["drives.toml"])), &["no table [arm] in drives.toml"]);
    expect(Config::parse(Vec::new()), &["no table [arm] in no file"]);
}

#[test]
fn several_problems_of_a_file_are_reported_at_once() {
    let mut texts = files(&["arm.toml", "drives.toml"]);
    texts[0].1 = texts[0].1.replace("elements = 5", "elements = 0").replace("length_m = 0.65", "length_m = -1");
    texts[1].1 = texts[1].1.replace("gear_ratio = 10.0", "gear_ratio = 0");
    let error = Config::parse(texts).unwrap_err();
    let lines: Vec<_> = error.lines().collect();
    assert_eq!(lines.len(), 3, "{lines:#?}");
    assert!(error.to_string().contains("3 problems in arm.toml, drives.toml"));
}

#[test]
fn holes_outside_the_disk_are_refused() {
    refuse(
        "arm.toml",
        "hole_radius_m = 0.05",
        "hole_radius_m = 0.06",
        &["hole_radius_m` = 0.06", "outside the disk", "<= 0.055 m"],
    );
}

#[test]
fn a_connector_behind_the_last_segment_is_refused() {
    let text = "[[arm.segments]]\n[[arm.segments]]\nconnector_length_m = 0.02\n[arm.segment_defaults]";
    let arm = shipped("arm.toml").replace("segment_count = 4\n", "").replace("[arm.segment_defaults]", text);
    expect(
        ArmConfig::parse("arm.toml", &arm),
        &["`arm.segments[1].connector_length_m` = 0.02", "permitted at the last segment: 0"],
    );
}

#[test]
fn segments_override_their_defaults() {
    let text = "[[arm.segments]]\nelements = 3\n[[arm.segments]]\nhole_angles_deg = [0, 90, 180]\nhole_offset_deg = 10\n[arm.segment_defaults]";
    let arm = shipped("arm.toml").replace("segment_count = 4\n", "").replace("[arm.segment_defaults]", text);
    let arm = ArmConfig::parse("arm.toml", &arm).unwrap();
    assert_eq!((arm.segments[0].elements, arm.segments[1].elements), (3, 5));
    assert_eq!((arm.segments[0].connector_length_m, arm.segments[1].connector_length_m), (0.05, 0.0));
    let expected: Vec<f64> = [10.0, 100.0, 190.0].iter().map(|angle: &f64| angle.to_radians()).collect();
    assert_eq!(arm.segments[1].hole_angles_rad, expected);
    assert_eq!(arm.cable_count(), 9);
}

#[test]
fn a_count_that_contradicts_the_list_is_refused() {
    refuse(
        "arm.toml",
        "segment_count = 4",
        "segment_count = 4\nsegments = [{ elements = 3 }]",
        &["`arm.segment_count` = 4", "there are 1 [[arm.segments]]"],
    );
}

#[test]
fn two_cables_on_one_node_id_are_refused() {
    let text = shipped("drives.toml") + "\n[[drives.overrides]]\nsegment = 3\ncable = 2\nnode_id = 5\n";
    let line = text.lines().count();
    let texts = vec![("arm.toml".into(), shipped("arm.toml")), ("drives.toml".into(), text)];
    let place = format!("drives.toml:{line}:");
    expect(
        Config::parse(texts),
        &[&place, "`drives.overrides[0].node_id` = 5", "node id 5 of bus `bus0`", "cable 1,5", "cable 3,2", "1 to 127"],
    );
}

#[test]
fn a_node_id_is_free_on_another_bus() {
    let text = shipped("drives-4-buses.toml")
        + "\n[[drives.overrides]]\nsegment = 3\ncable = 2\nbus = \"bus1\"\nnode_id = 7\nsign = \"-\"\n";
    let config = Config::parse(vec![("arm.toml".into(), shipped("arm.toml")), ("drives.toml".into(), text)]).unwrap();
    let drive = &config.drives.drives[13];
    assert_eq!((drive.segment, drive.cable, drive.bus, drive.node_id, drive.sign), (3, 2, 1, 7, -1));
    assert_eq!(config.drives.drives[12].sign, 1);
}

#[test]
fn node_ids_beyond_canopens_are_refused() {
    let error = changed("drives.toml", "interface = \"sinew0\"", "interface = \"sinew0\"\nfirst_node_id = 110");
    expect(error, &["would get node id 128", "1 to 127"]);
}

#[test]
fn an_override_of_no_cable_is_refused() {
    let text = shipped("drives.toml") + "\n[[drives.overrides]]\nsegment = 4\ncable = 7\n";
    let texts = vec![("arm.toml".into(), shipped("arm.toml")), ("drives.toml".into(), text)];
    expect(Config::parse(texts), &["`drives.overrides[0].cable` = 7", "the arm has no cable 4,7"]);
}

#[test]
fn a_drive_too_weak_for_the_arm_is_refused() {
    refuse(
        "drives.toml",
        "torque_nm_max = 0.35",
        "torque_nm_max = 0.3",
        &["torque_nm_max` = 0.3", "permitted: 0.3300 N m", "to 3.5 N m"],
    );
}

#[test]
fn two_buses_on_one_interface_are_refused() {
    let text = shipped("drives-4-buses.toml").replace("vcan2", "vcan1");
    let texts = vec![("arm.toml".into(), shipped("arm.toml")), ("drives.toml".into(), text)];
    expect(Config::parse(texts), &["`drives.buses[2].interface` = \"vcan1\"", "different for every bus"]);
}

#[test]
fn a_data_bit_rate_without_fd_does_not_apply() {
    let result = changed("drives.toml", "interface = \"sinew0\"", "interface = \"sinew0\"\ndata_bitrate_bps = 2000000");
    expect(result, &["`drives.buses[0].data_bitrate_bps` = 2000000 does not apply here"]);
}

#[test]
fn packed_torques_without_fd_are_refused() {
    let result = changed("drives.toml", "interface = \"sinew0\"", "interface = \"sinew0\"\nlayout = \"packed\"");
    expect(result, &["`drives.buses[0].layout` = \"packed\"", "8 bytes of a classic frame", "`fd = true`"]);
}

#[test]
fn more_drives_than_a_packed_frame_holds_are_refused() {
    let packed = "interface = \"sinew0\"\nfd = true\nlayout = \"packed\"";
    let result = changed("drives.toml", "interface = \"sinew0\"", packed);
    expect(result, &["`drives.buses[0].layout` = \"packed\"", "bus `bus0` has 24 drives", "at most 16 drives"]);
}

#[test]
fn a_period_that_does_not_divide_the_lookahead_is_refused() {
    let place = format!("controller.toml:{}:", line_of("controller.toml", "lookahead_s"));
    expect(
        changed("controller.toml", "period_s = 0.01", "period_s = 0.03"),
        &[&place, "lookahead 0.1 s is no whole multiple of the period 0.03 s"],
    );
    expect(
        changed("controller.toml", "period_s = 0.01", "period_s = 0.2"),
        &["`loop.period_s` = 0.2", "0.001 to 0.1 s"],
    );
}

#[test]
fn a_swarm_without_particles_is_refused() {
    let (_, controller) = files(&["controller.toml"]).remove(0);
    let from = controller.find("particles_normal = 15").unwrap();
    let mut text = controller.clone();
    text.replace_range(
        from..from + "particles_normal = 15".len(),
        "particles_normal = 0\nchaotic_min = 0\nchaotic_max = 0",
    );
    let text = text.replace("particles_uniform = 5", "particles_uniform = 0");
    let mut texts = files(&["arm.toml", "drives.toml"]);
    texts.push(("controller.toml".into(), text));
    expect(
        Config::parse(texts),
        &["controller.toml:", "`planner.swarm.particles_uniform` = 0", "permitted: 1 to 10000"],
    );
}

#[test]
fn weights_must_fit_the_segments() {
    refuse(
        "controller.toml",
        "tension_change = [1e4, 2e4, 3e4, 4e4]",
        "tension_change = [1e4, 2e4, 3e4]",
        &["`weights.tip.tension_change` = [1e4, 2e4, 3e4]", "exactly 4 numbers, one per segment"],
    );
}

#[test]
fn a_barrier_key_without_a_barrier_does_not_apply() {
    let place = format!("controller.toml:{}:1", line_of("controller.toml", "barrier_gamma"));
    expect(
        changed("controller.toml", "barrier = true", "barrier = false"),
        &[&place, "`planner.barrier_gamma` = 0.3 does not apply here"],
    );
}

#[test]
fn times_that_contradict_each_other_are_refused() {
    refuse(
        "controller.toml",
        "hold_after_s = 1.0",
        "hold_after_s = 0.1",
        &["`obstacles.hold_after_s` = 0.1", "0.2 s (`stale_after_s`)"],
    );
    let target =
        |keys: &str| changed("controller.toml", "[obstacles]\n", &format!("[target]\n{keys}\n\n[obstacles]\n"));
    expect(
        target("stale_after_s = 0.5\nhold_after_s = 0.4"),
        &["controller.toml", "`target.hold_after_s` = 0.4", "0.5 s (`stale_after_s`) to 600 s"],
    );
    expect(target("stale_after_s = 30.0"), &["controller.toml", "`target.stale_after_s` = 30", "> 0 and <= 10"]);
    refuse("drives.toml", "heartbeat_timeout_s = 0.15", "heartbeat_timeout_s = 0.06", &["0.1 s (two heartbeats)"]);
    refuse("drives.toml", "sync_timeout_s = 0.1", "sync_timeout_s = 0.015", &["0.02 s (two periods of the loop)"]);
    refuse(
        "controller.toml",
        "encoder_silent_s = 0.05",
        "encoder_silent_s = 0.01",
        &["0.02 s (two periods of the loop)"],
    );
    let late = changed("controller.toml", "lookahead_s = 0.1", "lookahead_s = 0.1\nbudget_s = 0.01");
    expect(late, &["`planner.budget_s` = 0.01", "more than the period leaves", "<= 0.0098 s"]);
}

/// Writes every default of a table and of those below it out, except for keys that need another choice.
fn written_out(spec: &TableSpec, text: &mut String) {
    let _ = writeln!(text, "{}", spec.header);
    for key in spec.keys {
        if let Presence::Default(value) = key.presence {
            let _ = writeln!(text, "{} = {value}", key.name);
        }
    }
    for key in spec.keys {
        if let Kind::Table(below) = key.kind {
            written_out(below, text);
        }
    }
}

#[test]
fn every_default_may_be_written_out_and_changes_nothing() {
    let bare = Config::parse(files(&["arm.toml", "drives.toml"])).unwrap();
    for spec in TABLES.iter().filter(|spec| !["arm", "drives"].contains(&spec.name)) {
        let mut text = String::new();
        written_out(spec, &mut text);
        let mut texts = files(&["arm.toml", "drives.toml"]);
        texts.push((format!("{}.toml", spec.name), text));
        assert_eq!(Config::parse(texts).map_err(|error| error.report()).unwrap(), bare, "{}", spec.header);
    }
}

#[test]
fn the_body_has_the_disks_radius_unless_told_otherwise() {
    let bare = Config::parse(files(&["arm.toml", "drives.toml"])).unwrap();
    assert_eq!(bare.planner.body_radius_m, 0.055);
}

/// The arm's file with other lines for its segments' cables, and a period that 60 more drives on a bus permit.
fn with_cables(lines: &str) -> Result<Config, ConfigError> {
    let arm = shipped("arm.toml").replace("cables = 6\nhole_start_deg = 30.0", lines);
    Config::of_arm(&ArmConfig::parse("arm.toml", &arm)?, None)
}

#[test]
fn what_few_cables_cannot_bend_is_said() {
    assert_eq!(with_cables("cables = 3").unwrap().warnings(), [""; 0]);
    for (lines, parts) in [
        ("cables = 1", ["segment 1: cables at 0 degrees alone bend it to that side only", "segment 4"]),
        ("cables = 2\nhole_start_deg = 90.0", ["at 90 and 270 degrees bend it in one plane", "segment 4"]),
        ("hole_angles_deg = [0, 60, 120]", ["no cable from 120 to 0 degrees", "segment 4"]),
    ] {
        let warnings = with_cables(lines).unwrap().warnings();
        assert_eq!(warnings.len(), 4, "{warnings:?}");
        for part in parts {
            assert!(warnings.iter().any(|w| w.contains(part)), "{part} is not in {warnings:?}");
        }
    }
}

#[test]
fn sixteen_segments_are_an_arm_and_too_many_cables_are_none() {
    let many = |cables: usize| {
        let text = shipped("arm.toml")
            .replace("segment_count = 4", "segment_count = 16")
            .replace("cables = 6", &format!("cables = {cables}"));
        ArmConfig::parse("arm.toml", &text)
    };
    assert_eq!(many(6).unwrap().cable_count(), 96);
    let refusal = many(7).unwrap_err().report();
    for part in ["112 cables", "at most 96 cables in all"] {
        assert!(refusal.contains(part), "{part} is not in\n{refusal}");
    }
}

#[test]
fn a_segment_may_have_a_tension_of_its_own_inside_the_arms() {
    let with = |tension: &str| {
        let text = shipped("arm.toml").replace("cables = 6", &format!("cables = 6\ntension_n_max = {tension}"));
        ArmConfig::parse("arm.toml", &text)
    };
    assert_eq!(with("150.0").unwrap().tension_maxima_n(), [150.0; 24]);
    for beyond in ["0.0", "230.0"] {
        let refusal = with(beyond).unwrap_err().report();
        assert!(refusal.contains("arm.segment_defaults.tension_n_max"), "{refusal}");
    }
}

#[test]
fn a_segment_of_a_millimetre_is_refused_with_what_is_permitted() {
    let text = shipped("arm.toml").replace("length_m = 0.65", "length_m = 0.001");
    let refusal = ArmConfig::parse("arm.toml", &text).unwrap_err().report();
    for part in ["length_m` = 0.001", "shorter than half a disk", "0.025 m or more"] {
        assert!(refusal.contains(part), "{part} is not in\n{refusal}");
    }
}

#[test]
fn every_configuration_can_be_written_as_json() {
    let config = Config::parse(files(&["arm.toml", "controller.toml", "drives.toml"])).unwrap();
    assert!(serde_json::to_string(&config).unwrap().contains("\"node_id\":24"));
    for (name, _) in SCENARIOS {
        assert!(serde_json::to_string(&ScenarioConfig::find(name).unwrap()).is_ok(), "{name}");
    }
}

/// What hands and editors do to a file: a piece cut out, or replaced by something else.
fn spoiled(text: &str, from: f64, length: usize, put: &str) -> String {
    let characters: Vec<char> = text.chars().collect();
    let start = ((characters.len() as f64 * from) as usize).min(characters.len());
    let end = (start + length).min(characters.len());
    characters[..start].iter().copied().chain(put.chars()).chain(characters[end..].iter().copied()).collect()
}

proptest::proptest! {
    #[test]
    fn a_spoiled_file_is_read_or_refused_with_places_inside_it(
        file in 0..4usize,
        from in 0.0..1.0f64,
        length in 0..40usize,
        put in "(|-|nan|1e999|0x7fffffffffffffffffff|\\[\\[|\\]|\"|[ -~]{0,8}|\\PC{0,4})",
    ) {
        let mut texts = files(&["arm.toml", "controller.toml", "drives-4-buses.toml"]);
        let scenario = file == 3;
        let text = if scenario { SCENARIOS[0].1 } else { texts[file].1.as_str() };
        let text = spoiled(text, from, length, &put);
        let error = if scenario {
            ScenarioConfig::parse("spoiled.toml", &text).err()
        } else {
            texts[file].1 = text;
            Config::parse(texts).err()
        };
        if let Some(error) = error {
            proptest::prop_assert!(!error.problems.is_empty());
            proptest::prop_assert!(!error.report().is_empty());
            for place in error.problems.iter().filter_map(|problem| problem.place.as_ref()) {
                proptest::prop_assert!(place.span.end <= place.file.inner().len());
            }
        }
    }
}

/// A table more in the file of the drives.
fn with_table(table: &str) -> Result<Config, ConfigError> {
    changed("drives.toml", "[drives]\n", &format!("{table}\n[drives]\n"))
}

#[test]
fn who_may_stop_and_see_is_users_and_groups_and_else_the_daemons_own_group() {
    use sinew::config::Who;
    let access = with_table("[access]\nstop = [\"alice\", \"@robots\", \"@4711\"]\nsee = []").unwrap().access;
    let expected = [Who::User("alice".into()), Who::Group("robots".into()), Who::Group("4711".into())];
    assert_eq!((access.stop.as_deref(), access.see.as_deref()), (Some(&expected[..]), Some(&[][..])));
    let default = changed("drives.toml", "[drives]\n", "[drives]\n").unwrap().access;
    assert_eq!((&default.stop, &default.see), (&None, &None));
    expect(
        with_table("[access]\nstop = [\"@\"]"),
        &["drives.toml:", "`access.stop`", "a user or group without a name"],
    );
    let named = with_table("[access]\ncommand = [\"4\"]\npublish = [\"@cameras\", \"5=7\"]").unwrap().access;
    assert_eq!(named.command, [Who::User("4".into())]);
    assert_eq!(named.publish, [(Who::Group("cameras".into()), None), (Who::User("5".into()), Some(7))]);
    assert!(default.command.is_empty() && default.publish.is_empty(), "nobody else");
    expect(with_table("[access]\npublish = [\"alice=camera\"]"), &["`access.publish`", "\"user=7\""]);
    expect(with_table("[access]\nstop = \"alice\""), &["`access.stop`"]);
    expect(with_table("[access]\nstop = [\"\"]"), &["`access.stop[0]`", "1 to 64 bytes"]);
}

#[test]
fn what_drives_may_lack_is_named_and_only_the_simulated_ones_guard_sync() {
    let line = "safe_tension_n = 0.0";
    let accepts = |names: &str| changed("drives.toml", line, &format!("{line}\naccept_without = [{names}]"));
    assert_eq!(accepts("\"rpdo_timeout\", \"torque_slope\"").unwrap().drives.accept_without.len(), 2);
    expect(accepts("\"brakes\""), &["`drives.accept_without`", "brakes", "\"sync_guard\""]);
    let foreign = changed("drives.toml", "vendor_id = 0", "vendor_id = 154");
    expect(foreign, &["`drives.accept_without`", "cable 1,1", "no guard of SYNC", "heartbeat consumer (1016)"]);
    let both = changed("drives.toml", "vendor_id = 0\nproduct_code = 0x53494e57", "vendor_id = 154")
        .and_then(|_| accepts("\"sync_guard\""));
    expect(both.map(drop).and(changed("drives.toml", "vendor_id = 0", "vendor_id = -1")), &["vendor_id"]);
    let taken = changed("drives.toml", line, &format!("{line}\nmaster_node_id = 7"));
    expect(taken, &["`drives.master_node_id` = 7", "cable 2,1 has it"]);
}

#[test]
fn required_sources_and_bounds_of_recordings_are_checked() {
    let required =
        |ids: &str| changed("controller.toml", "[obstacles]\n", &format!("[obstacles]\nrequired = [{ids}]\n"));
    assert_eq!(required("4, 4294967295").unwrap().obstacles.required, [4, u32::MAX]);
    expect(required("4, 4"), &["`obstacles.required[1]` = 4", "different integers"]);
    expect(required("-1"), &["`obstacles.required[0]` = -1", "0 to 4294967295"]);
    expect(required("1, 2, 3, 4, 5, 6, 7, 8, 9"), &["`obstacles.required`", "0 to 8"]);
    assert_eq!(with_table("[recording]\nfile_mib = 10\ntotal_mib = 20").unwrap().recording.total_mib, Some(20));
    expect(with_table("[recording]\nfile_mib = 10\ntotal_mib = 19"), &["`recording.total_mib` = 19", "20 MiB"]);
    expect(with_table("[ipc]\nrun_path = \"run\""), &["`ipc.run_path`", "not an absolute path"]);
}
