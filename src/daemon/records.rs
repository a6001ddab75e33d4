//! From the controller's own values to those of shared memory: records, answers, events. Copies only.

use super::obstacles::{PairReader, unkey};
use crate::config::WarningBranch;
use crate::control::{Cause, Event, EventKind, Fault, Limit, Mode, Record, Refusal, Request, Target, Timing};
use crate::ipc::payload::{
    MAX_CURVATURES, MAX_TRACKED, ObstacleDistance, PlannerBranch, PlannerStatus, RefusalReason, RequestKind, State,
    SupervisorState, TargetMode, TickTiming,
};
use crate::ipc::{Command, Reply};
use crate::planner::{Branch, Report, Status};

/// The mode on the wire.
pub fn supervisor_state(mode: Mode) -> SupervisorState {
    match mode {
        Mode::Disarmed => SupervisorState::Disarmed,
        Mode::Starting => SupervisorState::Arming,
        Mode::Holding => SupervisorState::Holding,
        Mode::Tracking => SupervisorState::Tracking,
        Mode::Homing => SupervisorState::Homing,
        Mode::Stopping => SupervisorState::Stopping,
        Mode::Faulted => SupervisorState::Faulted,
    }
}

/// The supervisor's request for a command; `None` where the supervisor has no part in it.
pub fn request_of(kind: RequestKind) -> Option<Request> {
    match kind {
        RequestKind::Arm => Some(Request::Arm),
        RequestKind::Disarm => Some(Request::Disarm),
        RequestKind::Hold => Some(Request::Hold),
        RequestKind::Track => Some(Request::Track),
        RequestKind::Clear => Some(Request::Clear),
        RequestKind::Stop => Some(Request::Stop),
        RequestKind::Home => Some(Request::Home),
        RequestKind::SetTarget
        | RequestKind::Status
        | RequestKind::EmergencyStop
        | RequestKind::EmergencyRelease
        | RequestKind::Speed => None,
    }
}

/// Why, on the wire. Where several refusals share a reason, `detail` tells them apart: see [`refusal_text`].
pub fn refusal_reason(refusal: Refusal) -> (RefusalReason, u32) {
    match refusal {
        Refusal::Disarmed => (RefusalReason::WrongState, 1),
        Refusal::Stopping => (RefusalReason::WrongState, 2),
        Refusal::StillRamping => (RefusalReason::WrongState, 3),
        Refusal::NothingLatched => (RefusalReason::WrongState, 4),
        Refusal::NotAtRest => (RefusalReason::WrongState, 5),
        Refusal::StillHeld => (RefusalReason::WrongState, 6),
        Refusal::DrivesNotReady => (RefusalReason::DrivesNotReady, 0),
        Refusal::EmergencyStop => (RefusalReason::DrivesNotReady, 1),
        Refusal::NotSettled => (RefusalReason::NotSettled, 0),
        Refusal::NoTarget => (RefusalReason::NoTarget, 0),
        Refusal::ObstaclesExpired => (RefusalReason::ObstaclesExpired, 0),
        Refusal::Faulted => (RefusalReason::Faulted, 0),
        Refusal::CausePersists => (RefusalReason::CausePersists, 0),
    }
}

/// What to do about a refusal, for people.
pub fn refusal_text(reason: RefusalReason, detail: u32) -> &'static str {
    match (reason, detail) {
        (RefusalReason::WrongState, 1) => "the arm is disarmed: `sinew arm` first",
        (RefusalReason::WrongState, 2) => "the arm is stopping: wait until it is disarmed",
        (RefusalReason::WrongState, 6) => {
            "the cables still hold the arm after the fault: `sinew stop` lets it down, then `sinew clear`"
        }
        (RefusalReason::WrongState, 5) => "the arm moves: wait until it rests",
        (RefusalReason::WrongState, 3) => {
            "the tensions are still on their way to the safe value: try again in a moment"
        }
        (RefusalReason::WrongState, 4) => "no fault is latched; sources of obstacles that had expired are forgotten",
        (RefusalReason::Faulted, _) => "a fault is latched: see `sinew status`, mend its cause, then `sinew clear`",
        (RefusalReason::CausePersists, _) => "the cause of the fault persists: see `sinew status`",
        (RefusalReason::DrivesNotReady, 1) => {
            "an emergency stop is pressed: release it (`sinew emergency-stop --release`, or the button at the drives)"
        }
        (RefusalReason::DrivesNotReady, _) => "the drives are not ready: see `sinew status` for the first that is not",
        (RefusalReason::NotSettled, _) => "the observer has not settled yet: wait until the arm is holding",
        (RefusalReason::NoTarget, _) => {
            "there is no fresh target: give one with `sinew target`, or start the task client"
        }
        (RefusalReason::ObstaclesExpired, _) => {
            "obstacles are unknown or too old: start the perception client (an empty set says that nothing is there), \
             `sinew clear` one that is gone for good, or set `obstacles.require_source = false` (to arm without: \
             `obstacles.arm_unknown = true`)"
        }
        (reason, _) => reason.text(),
    }
}

/// The answer to a command that was decided on.
pub fn reply(command: &Command, refusal: Option<Refusal>, mode: Mode, fault: Option<Fault>) -> Reply {
    let accepted = Reply {
        fault_code: fault.map_or(0, |f| f.code()),
        fault_detail: fault.map_or(0, |f| f.detail()),
        ..Reply::accepted(command, supervisor_state(mode))
    };
    match refusal {
        None => accepted,
        Some(refusal) => {
            let (reason, detail) = refusal_reason(refusal);
            Reply { detail, verdict: crate::ipc::payload::Verdict::Refused, reason, ..accepted }
        }
    }
}

/// An event on the wire. Codes: a fault has its own (below 100), a limit its own (from 100) and 100 more where it ends,
/// modes begin at 300 (detail: cause), requests at 400 (detail: 1 if refused, then value and second: reason and its detail).
pub fn event(event: &Event) -> crate::ipc::Event {
    let (mut flags, mut second) = (0, f64::NAN);
    let (code, detail, value, text) = match event.kind {
        EventKind::Fault(fault) => {
            let value;
            ([value, second], flags) = (fault.values(), fault.flags());
            (fault.code(), fault.detail(), value, fault.what())
        }
        EventKind::LimitOn(limit) => (limit.code(), 0, 1.0, limit.text()),
        EventKind::LimitOff(limit) => (limit.code() + 100, 0, 0.0, limit_over(limit)),
        EventKind::Mode { to, cause, .. } => {
            let state = supervisor_state(to);
            (300 + state.wire(), cause_code(&cause), 0.0, state.text())
        }
        EventKind::Request(answer) => {
            let kind = request_kind(answer.request);
            let mut reason = 0.0;
            if let Some((why, detail)) = answer.refusal.map(refusal_reason) {
                (reason, second) = (f64::from(why.wire()), f64::from(detail));
            }
            (400 + kind.wire(), u32::from(answer.refusal.is_some()), reason, kind.text())
        }
    };
    crate::ipc::Event { time_ns: event.now_ns, tick: event.tick, code, detail, flags, value, second, text }
}

fn cause_code(cause: &Cause) -> u32 {
    match cause {
        Cause::Done => 0,
        Cause::Fault(fault) => fault.code(),
        Cause::Limit(limit) => limit.code(),
        Cause::Request(request) => 400 + request_kind(*request).wire(),
    }
}

fn request_kind(request: Request) -> RequestKind {
    match request {
        Request::Arm => RequestKind::Arm,
        Request::Disarm => RequestKind::Disarm,
        Request::Hold => RequestKind::Hold,
        Request::Track => RequestKind::Track,
        Request::Home => RequestKind::Home,
        Request::Stop => RequestKind::Stop,
        Request::Clear => RequestKind::Clear,
    }
}

fn limit_over(limit: Limit) -> &'static str {
    match limit {
        Limit::ObstaclesExpired => "obstacles known again",
        Limit::TargetStale => "target there again",
        Limit::RateLimited => "tension rate no longer limited",
        Limit::OverrunHold | Limit::OverrunRamp => "ticks in time again",
        Limit::BudgetSpent => "planning budget sufficient again",
        Limit::Relaxed => "distance constraints kept again",
        Limit::PlanSingular => "planning step succeeds again",
        Limit::EncoderBridged => "all readings there again",
        Limit::Blocked => "the way is free again",
        Limit::OutOfReach => "target within reach again",
        Limit::Swinging => "the arm no longer swings",
        Limit::TipSpeed => "the tip is within its speed again",
        Limit::BendRate => "the bends are within their rate again",
        Limit::Saturated => "no tension stays at its limit any more",
        Limit::TensionError => "all drives measure what they were told again",
        Limit::EmergencyStop => "no emergency stop is pressed any more",
        Limit::TipDoubted => "the measured tip is near the estimate again",
        Limit::CableSuspect => "all cables do what their drives say again",
    }
}

/// Fills the loop's part of a state from a record; the sources' part is the intake's. `warning` is the branch that plans
/// in the warning subspace.
pub(crate) fn state_into(record: &Record, obstacles: &PairReader, warning: PlannerBranch, state: &mut State) {
    state.supervisor = supervisor_state(record.mode).wire();
    let fault = record.fault.map(|latched| latched.fault);
    state.fault_code = fault.map_or(0, |fault| fault.code());
    state.fault_detail = fault.map_or(0, |fault| fault.detail());
    state.fault_values = fault.map_or([f64::NAN; 2], |fault| fault.values());
    state.fault_flags = fault.map_or(0, |fault| fault.flags());
    plan_into(record.plan.as_ref(), warning, state);
    state.target_mode = match record.target {
        None => 0,
        Some(Target::Tip { .. }) => TargetMode::Tip.wire(),
        Some(Target::Shape { .. }) => TargetMode::Shape.wire(),
    };
    state.target_sequence = record.target_sequence;
    let (cables, curvatures) = (record.cable_count, record.curvature_count);
    state.cable_count = cables as u32;
    state.segment_count = (curvatures / 2) as u32;
    state.tension_command_n[..cables].copy_from_slice(&record.tension_command_n[..cables]);
    state.tension_measured_n[..cables].copy_from_slice(&record.tension_measured_n[..cables]);
    state.cable_length_m[..cables].copy_from_slice(&record.cable_length_m[..cables]);
    state.tip_position_m = record.tip_position_m;
    state.tip_quaternion = record.tip_quaternion;
    state.tip_velocity_mps = record.tip_velocity_mps;
    state.tip_angular_velocity_radps = record.tip_angular_velocity_radps;
    state.target_position_m = [f64::NAN; 3];
    state.target_quaternion = [f64::NAN; 4];
    state.target_curvature_1pm = [f64::NAN; MAX_CURVATURES];
    match record.target {
        Some(Target::Tip { position_m, quaternion, .. }) => {
            state.target_position_m = position_m.into();
            state.target_quaternion = quaternion.into();
        }
        Some(Target::Shape { curvatures_1pm, .. }) => {
            state.target_curvature_1pm[..curvatures].copy_from_slice(&curvatures_1pm[..curvatures]);
        }
        None => {}
    }
    state.tip_error_m = record.tip_error_m;
    state.quaternion_error = record.quaternion_error;
    state.curvature_error_1pm = record.curvature_error_1pm;
    state.curvature_1pm[..curvatures].copy_from_slice(&record.curvature_1pm[..curvatures]);
    state.innovation_rad[..curvatures].copy_from_slice(&record.innovation_rad[..curvatures]);
    state.disturbance_nm[..curvatures].copy_from_slice(&record.disturbance_nm[..curvatures]);
    state.node_count = record.node_count as u32;
    state.node_stride = record.node_stride as u32;
    for (i, node) in record.nodes[..record.node_count].iter().enumerate() {
        let [x, y, z, qw, qx, qy, qz] = *node;
        state.node_position_m[i] = [x, y, z];
        state.node_quaternion[i] = [qw, qx, qy, qz];
    }
    distances_into(record, obstacles, state);
    state.timing = timing(&record.timing);
    state.limits = u64::from(record.limits.0);
    state.tip_measured_m = record.tip_measured_m;
    state.tip_bias_m = record.tip_bias_m;
    state.swing_m = record.swing_m;
    state.tip_covariance_m2 = record.tip_covariance_m2;
    state.speed_scale = record.speed_scale;
    let unknown = (f64::NAN, f64::NAN, f64::NAN, [f64::NAN; 3]);
    (state.reach_miss_m, state.reach_miss_rad, state.reach_load, state.reach_nearest_m) =
        record.reach.map_or(unknown, |r| (r.miss_m, r.miss_rad, r.load, r.nearest_m.into()));
}

/// The branch that plans in the warning subspace, on the wire.
pub const fn warning_branch(warning: WarningBranch) -> PlannerBranch {
    match warning {
        WarningBranch::Swarm => PlannerBranch::Swarm,
        WarningBranch::Seeded => PlannerBranch::Seeded,
        WarningBranch::Complementarity => PlannerBranch::Complementarity,
        WarningBranch::StandardSwarm => PlannerBranch::StandardSwarm,
    }
}

/// Fills the planner's part of a state from its report; `None` where it did not run. A step that failed is told as such
/// whatever was relaxed on its way: its tensions are those of the step before.
pub fn plan_into(report: Option<&Report>, warning: PlannerBranch, state: &mut State) {
    let Some(plan) = report else {
        state.planner_status = PlannerStatus::Idle.wire();
        state.planner_branch = PlannerBranch::None.wire();
        (state.newton_iterations, state.swarm_sweeps) = (0, 0);
        (state.cost, state.kkt_residual) = (f64::NAN, f64::NAN);
        return;
    };
    state.planner_status = match plan.status {
        Status::Singular => PlannerStatus::Failed,
        _ if plan.relaxed => PlannerStatus::Relaxed,
        Status::Converged => PlannerStatus::Converged,
        // A work budget, and the normal end in receding use.
        Status::IterationLimit | Status::BudgetSpent => PlannerStatus::BudgetSpent,
    }
    .wire();
    state.planner_branch = match plan.branch {
        Branch::Safe => PlannerBranch::Safe,
        Branch::Warning => warning,
    }
    .wire();
    state.newton_iterations = plan.iterations as u32;
    state.swarm_sweeps = plan.sweeps as u32;
    state.cost = plan.cost;
    state.kkt_residual = plan.kkt_residual;
}

fn distances_into(record: &Record, obstacles: &PairReader, state: &mut State) {
    let mut count = 0;
    state.distance_dropped = 0;
    for (index, distance) in record.distances[..record.obstacle_count].iter().enumerate() {
        if obstacles.is_parked(index) {
            continue;
        }
        if count == MAX_TRACKED {
            state.distance_dropped += 1;
            continue;
        }
        let (source_id, obstacle_id) = unkey(distance.id);
        state.distances[count] = ObstacleDistance {
            source_id,
            obstacle_id,
            surface_distance_m: distance.along_arm_m,
            growth_m: distance.growth_m,
        };
        count += 1;
    }
    state.distance_count = count as u32;
}

fn timing(t: &Timing) -> TickTiming {
    TickTiming {
        wakeup_ns: t.wakeup_ns,
        input_ns: t.input_ns,
        estimate_ns: t.estimate_ns,
        plan_ns: t.plan_ns,
        guard_ns: t.guard_ns,
        send_ns: t.send_ns,
        cycle_ns: t.cycle_ns,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_refusal_has_a_reason_and_a_text_of_its_own() {
        let all = [
            Refusal::Disarmed,
            Refusal::Stopping,
            Refusal::StillRamping,
            Refusal::StillHeld,
            Refusal::NothingLatched,
            Refusal::DrivesNotReady,
            Refusal::EmergencyStop,
            Refusal::NotSettled,
            Refusal::NotAtRest,
            Refusal::NoTarget,
            Refusal::ObstaclesExpired,
            Refusal::Faulted,
            Refusal::CausePersists,
        ];
        let texts: std::collections::BTreeSet<_> =
            all.iter().map(|r| refusal_reason(*r)).map(|(a, b)| refusal_text(a, b)).collect();
        assert_eq!(texts.len(), all.len());
    }

    #[test]
    fn a_refused_request_keeps_the_latched_fault_in_its_answer() {
        let command = Command { ticket: 7, kind: RequestKind::Arm, speed_scale: 1.0 };
        let reply = reply(&command, Some(Refusal::Faulted), Mode::Faulted, Some(Fault::BusLost { bus: 3 }));
        assert_eq!(
            (reply.ticket, reply.reason, reply.fault_code, reply.fault_detail),
            (7, RefusalReason::Faulted, 13, 3)
        );
        assert_eq!(reply.supervisor, SupervisorState::Faulted);
    }
}
