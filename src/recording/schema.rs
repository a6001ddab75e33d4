//! The messages of a recording: what of the payloads is in use. Units are in the names of the fields.

use super::cdr::{Fields, Sink};
use crate::ipc::Event;
use crate::ipc::payload::{
    AlarmRecord, Header, Obstacle, ObstacleDistance, ObstacleKind, Obstacles, PlannerBranch, PlannerStatus,
    SourceHealth, SourceReport, State, SupervisorState, Target, TargetMode, TickTiming,
};

macro_rules! constants {
    ($sink:expr, $prefix:literal, $code:ident) => {
        $sink.constants($prefix, &$code::ALL.iter().map(|c| (c.text(), c.wire())).collect::<Vec<_>>())
    };
}

impl Fields for Header {
    const NAME: &'static str = "Header";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        sink.u32("schema_version", self.schema_version);
        sink.u32("source_id", self.source_id);
        sink.u64("sequence", self.sequence);
        sink.u64("capture_ns", self.capture_ns);
        sink.u64("tick", self.tick);
    }
}

/// A node of the arm.
struct Node {
    position_m: [f64; 3],
    quaternion: [f64; 4],
}

impl Fields for Node {
    const NAME: &'static str = "Node";

    fn sample() -> Self {
        Self { position_m: [0.0; 3], quaternion: [0.0; 4] }
    }

    fn visit(&self, sink: &mut impl Sink) {
        sink.array("position_m", &self.position_m);
        sink.array("quaternion", &self.quaternion);
    }
}

impl Fields for AlarmRecord {
    const NAME: &'static str = "AlarmRecord";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        sink.u32("code", self.code);
        sink.u32("subject", self.subject);
        sink.u64("since_ns", self.since_ns);
    }
}

impl Fields for ObstacleDistance {
    const NAME: &'static str = "ObstacleDistance";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        sink.u32("source_id", self.source_id);
        sink.u32("obstacle_id", self.obstacle_id);
        sink.f64("surface_distance_m", self.surface_distance_m);
        sink.f64("growth_m", self.growth_m);
    }
}

impl Fields for SourceReport {
    const NAME: &'static str = "SourceReport";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        constants!(sink, "HEALTH", SourceHealth);
        sink.u32("source_id", self.source_id);
        sink.u32("health", self.health);
        sink.u64("sequence", self.sequence);
        sink.f64("age_s", self.age_s);
        sink.u64("accepted", self.accepted);
        // By cause, as far as there were any.
        let last = self.rejected.iter().rposition(|count| *count != 0);
        sink.integers("rejected", first(&self.rejected, last.map_or(0, |last| last as u32 + 1)));
    }
}

impl Fields for TickTiming {
    const NAME: &'static str = "TickTiming";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        sink.u64("wakeup_ns", self.wakeup_ns);
        sink.u64("input_ns", self.input_ns);
        sink.u64("estimate_ns", self.estimate_ns);
        sink.u64("plan_ns", self.plan_ns);
        sink.u64("guard_ns", self.guard_ns);
        sink.u64("send_ns", self.send_ns);
        sink.u64("cycle_ns", self.cycle_ns);
    }
}

fn first<T>(values: &[T], count: u32) -> &[T] {
    &values[..(count as usize).min(values.len())]
}

impl Fields for State {
    const NAME: &'static str = "State";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        constants!(sink, "SUPERVISOR", SupervisorState);
        constants!(sink, "STATUS", PlannerStatus);
        constants!(sink, "BRANCH", PlannerBranch);
        constants!(sink, "MODE", TargetMode);
        sink.message("header", &self.header);
        sink.f64("time_s", self.time_s);
        sink.u32("supervisor", self.supervisor);
        sink.u32("fault_code", self.fault_code);
        sink.u32("fault_detail", self.fault_detail);
        sink.u32("planner_status", self.planner_status);
        sink.u32("planner_branch", self.planner_branch);
        sink.u32("newton_iterations", self.newton_iterations);
        sink.u32("swarm_sweeps", self.swarm_sweeps);
        sink.u32("target_mode", self.target_mode);
        sink.u64("target_sequence", self.target_sequence);
        sink.f64("cost", self.cost);
        sink.f64("kkt_residual", self.kkt_residual);
        sink.numbers("tension_command_n", first(&self.tension_command_n, self.cable_count));
        sink.numbers("tension_measured_n", first(&self.tension_measured_n, self.cable_count));
        sink.numbers("cable_length_m", first(&self.cable_length_m, self.cable_count));
        sink.array("tip_position_m", &self.tip_position_m);
        sink.array("tip_quaternion", &self.tip_quaternion);
        sink.array("tip_velocity_mps", &self.tip_velocity_mps);
        sink.array("tip_angular_velocity_radps", &self.tip_angular_velocity_radps);
        sink.array("target_position_m", &self.target_position_m);
        sink.array("target_quaternion", &self.target_quaternion);
        sink.f64("tip_error_m", self.tip_error_m);
        sink.f64("quaternion_error", self.quaternion_error);
        let curvatures = 2 * self.segment_count;
        sink.numbers("curvature_1pm", first(&self.curvature_1pm, curvatures));
        sink.numbers("target_curvature_1pm", first(&self.target_curvature_1pm, curvatures));
        sink.f64("curvature_error_1pm", self.curvature_error_1pm);
        sink.numbers("innovation_rad", first(&self.innovation_rad, curvatures));
        sink.numbers("disturbance_nm", first(&self.disturbance_nm, curvatures));
        sink.u32("node_stride", self.node_stride);
        let nodes: Vec<Node> = first(&self.node_position_m, self.node_count)
            .iter()
            .zip(&self.node_quaternion)
            .map(|(&position_m, &quaternion)| Node { position_m, quaternion })
            .collect();
        sink.messages("nodes", &nodes);
        sink.messages("distances", first(&self.distances, self.distance_count));
        let used = self.obstacle_sources.iter().filter(|s| s.accepted + s.rejected_total() > 0 || s.source_id != 0);
        sink.messages("obstacle_sources", &used.copied().collect::<Vec<_>>());
        sink.message("target_report", &self.target_report);
        sink.message("encoder_report", &self.encoder_report);
        sink.u64("obstacle_sources_refused", self.obstacle_sources_refused);
        sink.u64("ticks_missed", self.ticks_missed);
        sink.u64("records_dropped", self.records_dropped);
        sink.u64("stale_sources", self.stale_sources);
        sink.message("timing", &self.timing);
        sink.u64("limits", self.limits);
        sink.f64("swing_m", self.swing_m);
        sink.array("tip_covariance_m2", &self.tip_covariance_m2);
        sink.f64("speed_scale", self.speed_scale);
        sink.f64("reach_miss_m", self.reach_miss_m);
        sink.f64("reach_miss_rad", self.reach_miss_rad);
        sink.f64("reach_load", self.reach_load);
        sink.array("reach_nearest_m", &self.reach_nearest_m);
        sink.numbers("fault_values", &self.fault_values);
        sink.u32("fault_flags", self.fault_flags);
        sink.messages("alarms", first(&self.alarms, self.alarm_count));
        sink.message("tip_report", &self.tip_report);
        sink.array("tip_measured_m", &self.tip_measured_m);
        sink.array("tip_bias_m", &self.tip_bias_m);
    }
}

/// An obstacle with its own vertices.
struct RecordedObstacle {
    obstacle: Obstacle,
    vertices_m: Vec<f64>,
}

impl Fields for RecordedObstacle {
    const NAME: &'static str = "Obstacle";

    fn sample() -> Self {
        Self { obstacle: Obstacle::default(), vertices_m: Vec::new() }
    }

    fn visit(&self, sink: &mut impl Sink) {
        constants!(sink, "KIND", ObstacleKind);
        sink.u32("id", self.obstacle.id);
        sink.u32("kind", self.obstacle.kind);
        sink.array("position_m", &self.obstacle.position_m);
        sink.array("quaternion", &self.obstacle.quaternion);
        sink.array("velocity_mps", &self.obstacle.velocity_mps);
        sink.array("dimensions_m", &self.obstacle.dimensions_m);
        sink.array("covariance_m2", &self.obstacle.covariance_m2);
        sink.numbers("vertices_m", &self.vertices_m);
    }
}

impl Fields for Obstacles {
    const NAME: &'static str = "Obstacles";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        sink.message("header", &self.header);
        sink.u32("flags", self.flags);
        let obstacles: Vec<RecordedObstacle> = self
            .used()
            .iter()
            .map(|&obstacle| {
                let start = obstacle.hull_offset as usize;
                let vertices = self.vertices_m.get(start..start.saturating_add(obstacle.hull_count as usize));
                RecordedObstacle { obstacle, vertices_m: vertices.unwrap_or(&[]).concat() }
            })
            .collect();
        sink.messages("obstacles", &obstacles);
    }
}

impl Fields for Target {
    const NAME: &'static str = "Target";

    fn sample() -> Self {
        Self::default()
    }

    fn visit(&self, sink: &mut impl Sink) {
        constants!(sink, "MODE", TargetMode);
        sink.message("header", &self.header);
        sink.u64("valid_from_ns", self.valid_from_ns);
        sink.u32("mode", self.mode);
        sink.array("position_m", &self.position_m);
        sink.array("quaternion", &self.quaternion);
        sink.array("velocity_mps", &self.velocity_mps);
        sink.array("angular_velocity_radps", &self.angular_velocity_radps);
        let curvatures = 2 * self.segment_count;
        sink.numbers("curvature_1pm", first(&self.curvature_1pm, curvatures));
        sink.numbers("curvature_rate_1pms", first(&self.curvature_rate_1pms, curvatures));
        sink.f64("weight", self.weight);
    }
}

impl Fields for Event {
    const NAME: &'static str = "Event";

    fn sample() -> Self {
        Self { time_ns: 0, tick: 0, code: 0, detail: 0, flags: 0, value: 0.0, second: 0.0, text: "" }
    }

    fn visit(&self, sink: &mut impl Sink) {
        sink.u64("time_ns", self.time_ns);
        sink.u64("tick", self.tick);
        sink.u32("code", self.code);
        sink.u32("detail", self.detail);
        sink.u32("flags", self.flags);
        sink.f64("value", self.value);
        sink.f64("second", self.second);
        sink.text("text", self.text);
    }
}
