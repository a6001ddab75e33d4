//! What the judge reads of the recordings: every field must be there.

use super::judge::{FaultOf, Record, Truth as True};
use serde::Deserialize;
use sinew::ipc::payload::{PlannerBranch, SupervisorState};

#[derive(Debug, Deserialize)]
struct Header {
    tick: u64,
    capture_ns: u64,
}

#[derive(Debug, Deserialize)]
struct Timing {
    wakeup_ns: u64,
    plan_ns: u64,
    cycle_ns: u64,
}

/// One of the daemon's ticks.
#[derive(Debug, Deserialize)]
pub(super) struct Tick {
    header: Header,
    supervisor: u32,
    fault_code: u32,
    fault_detail: u32,
    fault_flags: u32,
    /// Null: not a number.
    fault_values: [Option<f64>; 2],
    planner_branch: u32,
    newton_iterations: u64,
    tension_command_n: Vec<f64>,
    ticks_missed: u64,
    timing: Timing,
}

impl From<Tick> for Record {
    fn from(t: Tick) -> Self {
        let values = t.fault_values.map(|value| value.unwrap_or(f64::NAN));
        Self {
            tick: t.header.tick,
            capture_ns: t.header.capture_ns,
            tracks: t.supervisor == SupervisorState::Tracking.wire(),
            stops: t.supervisor == SupervisorState::Stopping.wire(),
            tensions: t.tension_command_n,
            branch: PlannerBranch::from_wire(t.planner_branch),
            iterations: t.newton_iterations,
            plan_ns: t.timing.plan_ns,
            cycle_ns: t.timing.cycle_ns,
            wakeup_ns: t.timing.wakeup_ns,
            left_out: t.ticks_missed,
            fault: FaultOf::new(t.fault_code, t.fault_detail, t.fault_flags, values),
        }
    }
}

/// An event of the daemon's.
#[derive(Debug, Deserialize)]
pub(super) struct Event {
    pub(super) code: u32,
    /// Null: not a number.
    pub(super) value: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct Node {
    position_m: [f64; 3],
    quaternion: [f64; 4],
}

/// The true arm after one period.
#[derive(Debug, Deserialize)]
pub(super) struct Truth {
    header: Header,
    tension_command_n: Vec<f64>,
    nodes: Vec<Node>,
    curvature_1pm: Vec<f64>,
}

impl From<Truth> for True {
    fn from(t: Truth) -> Self {
        let node = |node: Node| {
            let ([x, y, z], [w, a, b, c]) = (node.position_m, node.quaternion);
            [x, y, z, w, a, b, c]
        };
        Self {
            syncs: t.header.tick,
            capture_ns: t.header.capture_ns,
            tensions: t.tension_command_n,
            nodes: t.nodes.into_iter().map(node).collect(),
            curvatures: t.curvature_1pm,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_field_that_is_not_there_is_an_error_and_no_zero() {
        let whole = json!({
            "header": { "tick": 7, "capture_ns": 70 }, "supervisor": 3, "fault_code": 20, "fault_detail": 3,
            "fault_flags": 0, "fault_values": [0.06, null], "planner_branch": 1, "newton_iterations": 2,
            "tension_command_n": [1.0, 2.0], "ticks_missed": 0,
            "timing": { "wakeup_ns": 1, "plan_ns": 2, "cycle_ns": 3 },
        });
        let record = Record::from(Tick::deserialize(&whole).unwrap());
        assert!(record.tracks && record.fault.is_some() && record.tick == 7);
        for field in whole.as_object().unwrap().keys() {
            let mut less = whole.clone();
            less.as_object_mut().unwrap().remove(field);
            assert!(Tick::deserialize(&less).unwrap_err().to_string().contains(field), "{field}");
        }
        let mut bad = whole.clone();
        bad["tension_command_n"][1] = json!(null);
        assert!(Tick::deserialize(&bad).is_err(), "a tension that is no number");
    }
}
