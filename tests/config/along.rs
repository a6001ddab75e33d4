//! Segments that change along themselves, and cables' ways.

use super::{expect, shipped, with_cables};
use sinew::config::{ArmConfig, ConfigError};

/// The paper's arm of two segments, with `lines` in the second and `tables` behind it.
fn second(lines: &str, tables: &str) -> Result<ArmConfig, ConfigError> {
    let text = format!("[[arm.segments]]\n[[arm.segments]]\n{lines}\n{tables}\n[arm.segment_defaults]");
    let arm = shipped("arm.toml").replace("segment_count = 4\n", "").replace("[arm.segment_defaults]", &text);
    ArmConfig::parse("arm.toml", &arm)
}

fn stations(lines: &[&str]) -> String {
    lines.iter().map(|line| format!("[[arm.segments.stations]]\n{}\n", line.replace("; ", "\n"))).collect()
}

fn route(lines: &[&str]) -> String {
    lines.iter().map(|line| format!("[[arm.segments.route]]\n{}\n", line.replace("; ", "\n"))).collect()
}

#[test]
fn stations_give_elements_and_disks_their_own_numbers() {
    let table = stations(&[
        "at = 0; bending_stiffness_nm2 = 8; disk_mass_kg = 0.4",
        "at = 0.4; bending_stiffness_nm2 = 8",
        "at = 0.4; bending_stiffness_nm2 = 2",
        "at = 1; disk_mass_kg = 0.2; disk_radius_m = 0.06",
    ]);
    let arm = second("", &table).unwrap();
    let (plain, stepped) = (&arm.segments[0], &arm.segments[1]);
    for e in 0..5 {
        let want = if e < 2 { 8.0 } else { 2.0 };
        assert!((stepped.element_stiffness_nm2(e)[1] - want).abs() < 1e-12);
        assert_eq!(plain.element_stiffness_nm2(e), [plain.torsional_stiffness_nm2, 7.0]);
        let disk = 0.4 - 0.2 * (e as f64 + 1.0) / 5.0;
        let share = if e == 4 { 0.5 } else { 1.0 };
        assert!((stepped.lump(e, true).mass - disk - 0.15 * 0.13 * share).abs() < 1e-12);
    }
    // As a whole it bends as both beams in series: 1 / (0.4/8 + 0.6/2).
    assert!((stepped.bending_stiffness_nm2 - 1.0 / 0.35).abs() < 1e-12);
    assert!((arm.disk_radius_m() - 0.06).abs() < 1e-12);
}

#[test]
fn a_route_gives_each_disk_its_holes() {
    let table = route(&[
        "segment = 1; at = 0; hole_radius_m = 0.05; turn_deg = 0",
        "at = 1; hole_radius_m = 0.01; turn_deg = 80",
    ]);
    let arm = second("cables_from = 1", &table).unwrap();
    for (place, radius, turn) in [(0.0, 0.05, 0.0), (0.5, 0.04, 20.0), (1.0, 0.03, 40.0), (2.0, 0.01, 80.0)] {
        let [y, z] = arm.segments[1].hole_m(2, place);
        let angle = f64::to_radians(30.0 + 120.0 + turn);
        assert!((y - radius * angle.cos()).abs() < 1e-12 && (z - radius * angle.sin()).abs() < 1e-12, "{place}");
    }
}

#[test]
fn what_cannot_be_along_a_segment_is_refused() {
    let cases: [(&str, String, &[&str]); 11] = [
        ("", stations(&["at = 1.5"]), &["arm.segments[1].stations[0].at` = 1.5", "0 to 1"]),
        ("", stations(&["at = 0.5", "at = 0.2"]), &["stations[1].at` = 0.2", "before the place above", "ascending"]),
        ("", stations(&["at = 0.5", "at = 0.5", "at = 0.5"]), &["stations[2].at` = 0.5", "third at this place"]),
        ("", stations(&["at = 0; bending_stiffness_nm2 = 0"]), &["bending_stiffness_nm2` = 0", "> 0 and <= 1e6 N m^2"]),
        ("", stations(&["at = 0; stiffness = 1"]), &["unknown key `arm.segments[1].stations[0].stiffness`"]),
        (
            "bending_stiffness_nm2 = 3",
            stations(&["at = 0; bending_stiffness_nm2 = 2"]),
            &["arm.segments[1].bending_stiffness_nm2` = 3", "stations give it as well"],
        ),
        ("", route(&["at = 1; hole_radius_m = 0.06"]), &["outside its `disk_radius_m` of 0.0550", "within every disk"]),
        ("", route(&["segment = 1; at = 0"]), &["route[0].segment` = 1", "do not run there", "permitted: 2 to 2"]),
        ("cables_from = 3", String::new(), &["cables_from` = 3", "behind the segment", "permitted: 1 to 2"]),
        ("cable_end_disks = [5, 5, 5, 5, 5, 6]", String::new(), &["cable_end_disks", "does not have", "from 1 to 5"]),
        ("cable_end_disks = [5, 5]", String::new(), &["cable_end_disks` = [5, 5]: 2 disks", "permitted: 6"]),
    ];
    for (lines, tables, parts) in cases {
        expect(second(lines, &tables), parts);
    }
}

#[test]
fn what_cables_that_end_early_or_wind_cannot_do_is_said() {
    for (lines, want) in [
        ("cables = 3\ncable_end_disks = [3, 3, 3]", "beyond disk 3 of 5 none of its cables bends it"),
        ("cables = 3\ncable_end_disks = [5, 3, 3]", "beyond disk 3 of 5 cables at 0 degrees alone"),
        ("cables = 3\nroute = [{ at = 0, turn_deg = 0 }, { at = 1, turn_deg = 90 }]", "wind by 90 degrees"),
    ] {
        let warnings = with_cables(lines).unwrap().warnings();
        assert!(warnings.iter().any(|said| said.contains(want)), "{lines}: {warnings:?}");
    }
    assert_eq!(with_cables("cables = 3\ncable_end_disks = [5, 5, 5]").unwrap().warnings(), [""; 0]);
}
