//! What of a recording is read: every field must be there.

use serde::Deserialize;
use sinew::ipc::payload::{AlarmRecord, Header, REJECT_CAUSES, SourceReport, State};

#[derive(Debug, Clone, Deserialize)]
pub(super) struct TickHeader {
    pub(super) tick: u64,
    pub(super) capture_ns: u64,
}

#[derive(Debug, Clone, Deserialize)]
pub(super) struct Distance {
    pub(super) source_id: u32,
    pub(super) obstacle_id: u32,
    pub(super) surface_distance_m: f64,
    pub(super) growth_m: f64,
}

#[derive(Debug, Clone, Default, Deserialize)]
pub(super) struct Source {
    pub(super) source_id: u32,
    pub(super) health: u32,
    pub(super) age_s: f64,
    pub(super) accepted: u64,
    pub(super) rejected: Vec<u64>,
}

#[derive(Debug, Clone, Deserialize)]
pub(super) struct Timing {
    pub(super) wakeup_ns: u64,
    pub(super) estimate_ns: u64,
    pub(super) plan_ns: u64,
    pub(super) cycle_ns: u64,
}

#[derive(Debug, Clone, Deserialize)]
pub(super) struct AlarmOf {
    pub(super) code: u32,
    pub(super) subject: u32,
    pub(super) since_ns: u64,
}

/// A tick's state.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Tick {
    pub(super) header: TickHeader,
    pub(super) time_s: f64,
    pub(super) supervisor: u32,
    pub(super) fault_code: u32,
    pub(super) fault_detail: u32,
    pub(super) fault_flags: u32,
    pub(super) fault_values: [f64; 2],
    pub(super) planner_status: u32,
    pub(super) planner_branch: u32,
    pub(super) newton_iterations: u32,
    pub(super) swarm_sweeps: u32,
    pub(super) target_mode: u32,
    pub(super) tension_command_n: Vec<f64>,
    pub(super) tension_measured_n: Vec<f64>,
    pub(super) tip_position_m: [f64; 3],
    pub(super) target_position_m: [f64; 3],
    pub(super) tip_error_m: f64,
    pub(super) quaternion_error: f64,
    pub(super) curvature_error_1pm: f64,
    pub(super) distances: Vec<Distance>,
    pub(super) obstacle_sources: Vec<Source>,
    pub(super) target_report: Source,
    pub(super) encoder_report: Source,
    /// Recordings of before have none.
    #[serde(default)]
    pub(super) tip_report: Source,
    pub(super) ticks_missed: u64,
    pub(super) records_dropped: u64,
    pub(super) timing: Timing,
    pub(super) limits: u64,
    pub(super) swing_m: f64,
    pub(super) speed_scale: f64,
    pub(super) reach_miss_m: f64,
    pub(super) reach_miss_rad: f64,
    pub(super) reach_load: f64,
    pub(super) reach_nearest_m: [f64; 3],
    pub(super) alarms: Vec<AlarmOf>,
}

impl Tick {
    /// The nearest obstacle.
    pub(super) fn nearest(&self) -> Option<&Distance> {
        let finite = self.distances.iter().filter(|d| d.surface_distance_m.is_finite());
        finite.min_by(|a, b| a.surface_distance_m.total_cmp(&b.surface_distance_m))
    }

    /// What alarms and faults are told from, as the daemon's own state.
    pub(super) fn state(&self) -> Box<State> {
        let source = |s: &Source| SourceReport {
            source_id: s.source_id,
            health: s.health,
            age_s: s.age_s,
            accepted: s.accepted,
            rejected: std::array::from_fn::<_, REJECT_CAUSES, _>(|cause| s.rejected.get(cause).copied().unwrap_or(0)),
            ..SourceReport::default()
        };
        let mut state = Box::new(State {
            header: Header::new(0, self.header.tick, self.header.capture_ns).for_tick(self.header.tick),
            time_s: self.time_s,
            supervisor: self.supervisor,
            fault_code: self.fault_code,
            fault_detail: self.fault_detail,
            fault_flags: self.fault_flags,
            fault_values: self.fault_values,
            target_mode: self.target_mode,
            limits: self.limits,
            swing_m: self.swing_m,
            reach_miss_m: self.reach_miss_m,
            reach_miss_rad: self.reach_miss_rad,
            reach_load: self.reach_load,
            reach_nearest_m: self.reach_nearest_m,
            target_report: source(&self.target_report),
            encoder_report: source(&self.encoder_report),
            tip_report: source(&self.tip_report),
            ..State::default()
        });
        for (place, given) in state.obstacle_sources.iter_mut().zip(&self.obstacle_sources) {
            *place = source(given);
        }
        for (place, given) in state.alarms.iter_mut().zip(&self.alarms) {
            *place = AlarmRecord { code: given.code, subject: given.subject, since_ns: given.since_ns };
            state.alarm_count += 1;
        }
        state
    }
}
