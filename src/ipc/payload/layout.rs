//! `PAYLOADS.md` against the compiled types.

use super::*;
use std::collections::BTreeMap;
use std::mem::{offset_of, size_of, size_of_val};

struct Layout {
    name: &'static str,
    size: usize,
    align: usize,
    fields: Vec<(&'static str, usize, usize, String)>,
}

/// The type of a field as the document writes it: `f64[64][3]` for `[[f64; 3]; 64]`, `Header` without its path.
fn written<T>(_: &T) -> String {
    let (mut inner, mut dimensions) = (std::any::type_name::<T>(), String::new());
    while let Some((element, count)) =
        inner.strip_prefix('[').and_then(|array| array.strip_suffix(']')).and_then(|array| array.rsplit_once("; "))
    {
        dimensions += &format!("[{count}]");
        inner = element;
    }
    format!("{}{dimensions}", inner.rsplit("::").next().unwrap())
}

macro_rules! layout {
    ($type:ident: $($field:ident),*) => {{
        let value = $type::default();
        // Exhaustive on purpose: a field that the list forgets does not compile.
        let $type { $($field: _),* } = &value;
        Layout {
            name: stringify!($type),
            size: size_of::<$type>(),
            align: align_of::<$type>(),
            fields: vec![$((
                stringify!($field),
                offset_of!($type, $field),
                size_of_val(&value.$field),
                written(&value.$field),
            )),*],
        }
    }};
}

fn layouts() -> Vec<Layout> {
    vec![
        layout!(Header: schema_version, source_id, sequence, capture_ns, tick),
        layout!(Encoders: header, cable_count, source, length_valid, tension_valid, length_m, tension_n),
        layout!(Obstacle: id, kind, position_m, quaternion, velocity_mps, dimensions_m, covariance_m2, hull_offset, hull_count),
        layout!(Obstacles: header, count, vertex_count, flags, reserved, obstacles, vertices_m),
        layout!(Target: header, valid_from_ns, mode, segment_count, position_m, quaternion, velocity_mps, angular_velocity_radps, curvature_1pm, curvature_rate_1pms, weight),
        layout!(Tip: header, position_m),
        layout!(ObstacleDistance: source_id, obstacle_id, surface_distance_m, growth_m),
        layout!(SourceReport: source_id, health, sequence, age_s, accepted, rejected),
        layout!(AlarmRecord: code, subject, since_ns),
        layout!(TickTiming: wakeup_ns, input_ns, estimate_ns, plan_ns, guard_ns, send_ns, cycle_ns),
        layout!(State: header, time_s, supervisor, fault_code, fault_detail, planner_status, planner_branch, newton_iterations, swarm_sweeps, target_mode, target_sequence, cost, kkt_residual, cable_count, segment_count, node_count, node_stride, distance_count, distance_dropped, tension_command_n, tension_measured_n, cable_length_m, tip_position_m, tip_quaternion, tip_velocity_mps, tip_angular_velocity_radps, target_position_m, target_quaternion, tip_error_m, quaternion_error, curvature_1pm, target_curvature_1pm, curvature_error_1pm, innovation_rad, disturbance_nm, node_position_m, node_quaternion, distances, obstacle_sources, target_report, encoder_report, obstacle_sources_refused, ticks_missed, records_dropped, stale_sources, timing, limits, swing_m, tip_covariance_m2, speed_scale, reach_miss_m, reach_miss_rad, reach_load, reach_nearest_m, fault_values, fault_flags, alarm_count, alarms, tip_report, tip_measured_m, tip_bias_m),
        layout!(Request: header, kind, reserved, target, speed_scale),
        layout!(Response: header, verdict, reason, detail, supervisor, fault_code, fault_detail, text),
    ]
}

/// A row of the document: offset, size, field, type.
type Row = (usize, usize, String, String);

/// `struct -> (size from its heading, rows of offset, size, field, type)` of the document.
fn documented() -> BTreeMap<String, (usize, Vec<Row>)> {
    let mut structs = BTreeMap::new();
    let mut name = String::new();
    let text = include_str!("../PAYLOADS.md");
    for line in text.split("## Codes").next().unwrap().lines() {
        if let Some(heading) = line.strip_prefix("### ") {
            name = heading.to_owned();
        } else if let Some(rest) = line.strip_prefix("Type name `") {
            let bytes = rest.split("`, ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
            assert!(rest.starts_with(&format!("sinew.{name}.v{SCHEMA_VERSION}`")), "{line}");
            structs.insert(name.clone(), (bytes, Vec::new()));
        } else if let Some(entry) = structs.get_mut(&name) {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            if let Some(Ok(offset)) = cells.get(1).map(|c| c.parse()) {
                let [field, kind] = [cells[3], cells[4]].map(|cell| cell.trim_matches('`').to_owned());
                entry.1.push((offset, cells[2].parse().unwrap(), field, kind));
            }
        }
    }
    structs
}

#[test]
fn the_document_states_every_offset_size_and_type() {
    let documented = documented();
    let layouts = layouts();
    assert_eq!(documented.len(), layouts.len(), "structures in the document");
    for layout in layouts {
        let (size, rows) = &documented[layout.name];
        assert_eq!(*size, layout.size, "size of {}", layout.name);
        let compiled: Vec<_> = layout.fields.into_iter().map(|(f, o, s, t)| (o, s, f.to_owned(), t)).collect();
        assert_eq!(*rows, compiled, "rows of {}", layout.name);
    }
}

#[test]
fn no_payload_has_padding() {
    for layout in layouts() {
        let mut end = 0;
        for (field, offset, size, _) in layout.fields {
            assert_eq!(offset, end, "padding before {}.{field}", layout.name);
            end = offset + size;
        }
        assert_eq!(end, layout.size, "padding at the end of {}", layout.name);
        assert_eq!(layout.align, 8, "alignment of {}", layout.name);
    }
}

#[test]
fn the_document_lists_every_code() {
    let codes = include_str!("../PAYLOADS.md").split("## Codes").nth(1).unwrap();
    fn check<T: std::fmt::Debug + Copy>(codes: &str, name: &str, all: &[T], wire: impl Fn(T) -> u32) {
        let section = codes.split(&format!("### {name}\n")).nth(1).unwrap().split("###").next().unwrap();
        let rows: Vec<&str> = section.lines().filter(|l| l.starts_with("| ") && !l.starts_with("| number")).collect();
        assert_eq!(rows.len(), all.len(), "codes of {name}");
        for (row, &code) in rows.iter().zip(all) {
            assert!(row.starts_with(&format!("| {} | {code:?} |", wire(code))), "{name}: {row}");
        }
    }
    macro_rules! check_all {
        ($($type:ident),*) => { $(
            check(codes, stringify!($type), $type::ALL, $type::wire);
            for code in $type::ALL { assert_eq!($type::from_wire(code.wire()), Some(*code)); }
            assert_eq!($type::from_wire(u32::MAX), None);
        )* };
    }
    check_all!(
        ObstacleKind,
        TargetMode,
        EncoderSource,
        SupervisorState,
        PlannerStatus,
        PlannerBranch,
        SourceHealth,
        RejectCause,
        AlarmCode,
        RequestKind,
        Verdict,
        RefusalReason
    );
}

#[test]
fn every_reject_cause_has_a_counter() {
    assert!(RejectCause::ALL.iter().all(|c| (c.wire() as usize) < REJECT_CAUSES));
}

#[test]
fn a_long_arm_sends_every_kth_node_and_the_tip() {
    let mut state = State::default();
    for nodes in [1, 20, 64, 65, 150, 200] {
        state.set_nodes(nodes, |i| [i as f64; 3], |_| [1.0, 0.0, 0.0, 0.0]);
        let count = state.node_count as usize;
        assert!(count <= MAX_NODES && count * state.node_stride as usize >= nodes);
        assert_eq!(state.node_position_m[count - 1][0], (nodes - 1) as f64, "tip of {nodes}");
        if count > 1 {
            assert_eq!(state.node_position_m[0][0], f64::from(state.node_stride) - 1.0);
        }
    }
}

#[test]
fn response_text_is_cut_at_a_character() {
    let mut response = Response::default();
    response.set_text(&"\u{e4}".repeat(100));
    assert_eq!(response.text(), "\u{e4}".repeat(64));
    response.set_text(&format!("a{}", "\u{e4}".repeat(100)));
    assert_eq!(response.text().len(), 127);
}
