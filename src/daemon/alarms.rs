//! Alarms: what is wrong, since when, what it does to the motion, and what clears it; the same words in the log and in
//! `sinew status`.
//!
//! Enters: the newest record, what is known of the drives and of the process. Leaves: a list in a fixed order, a line of the
//! log where an alarm begins or ends. The main thread looks ten times a second; nothing here is on the way of a tick.

use super::reach::ReachStatus;
use super::status::{DriveStatus, FaultStatus};
use crate::control::Limit;
use crate::ipc::payload::{RejectCause, SourceHealth, SourceReport, State, SupervisorState};
use crate::recording::utc_text;
use serde::{Deserialize, Serialize};
use std::time::{SystemTime, UNIX_EPOCH};

/// Something that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Alarm {
    /// What it is about: `fault`, `motion`, `emergency stop`, `obstacles 7`, `target`, `drives`, `real time`, `recording`.
    pub about: String,
    /// What is wrong.
    pub what: String,
    /// What it does to the motion.
    pub does: String,
    /// What clears it.
    pub clears: String,
    /// Since when, in UTC: `20261129T223318Z`.
    pub since_utc: String,
}

/// What alarms are made from.
#[derive(Debug, Default)]
pub(super) struct Seen<'a> {
    pub(super) state: Option<&'a State>,
    pub(super) fault: Option<FaultStatus>,
    pub(super) drives: DriveStatus,
    /// Sources that the configuration requires.
    pub(super) required: &'a [u32],
    pub(super) realtime_refused: &'a [String],
    pub(super) recording_failed: bool,
}

/// The alarms that are on.
#[derive(Debug, Default)]
pub(super) struct Alarms(Vec<Alarm>);

impl Alarms {
    /// Takes over what is wrong now, and tells of what has changed.
    pub(super) fn update(&mut self, seen: &Seen<'_>) {
        let mut raised = raised(seen);
        for alarm in &mut raised {
            match self.0.iter().find(|known| known.about == alarm.about && known.what == alarm.what) {
                Some(known) => alarm.since_utc.clone_from(&known.since_utc),
                // Said at the start.
                None if alarm.about == REAL_TIME => {}
                None => tracing::warn!(about = alarm.about, does = alarm.does, clears = alarm.clears, "{}", alarm.what),
            }
        }
        for known in &self.0 {
            if !raised.iter().any(|alarm| known.about == alarm.about && known.what == alarm.what) {
                tracing::info!(about = known.about, "over: {}", known.what);
            }
        }
        self.0 = raised;
    }

    pub(super) fn list(&self) -> Vec<Alarm> {
        self.0.clone()
    }
}

fn alarm(about: impl Into<String>, what: impl Into<String>, does: &str, clears: impl Into<String>) -> Alarm {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    Alarm {
        about: about.into(),
        what: what.into(),
        does: does.into(),
        clears: clears.into(),
        since_utc: utc_text(seconds),
    }
}

const REAL_TIME: &str = "real time";
const HOLDS: &str = "the arm holds, and may not track";

fn raised(seen: &Seen<'_>) -> Vec<Alarm> {
    let mut list = Vec::new();
    if let Some(fault) = &seen.fault {
        let does = "the tensions go to the safe value, the drives off; nothing moves before it is cleared";
        list.push(alarm("fault", fault.what.clone(), does, fault.clears.clone()));
    } else if let Some(fault) = &seen.drives.fault {
        list.push(alarm("drives", fault.clone(), "the arm may not be armed", "mend it, then `sinew clear`"));
    }
    if let Some(state) = seen.state {
        state.obstacle_sources.iter().filter_map(|source| of_source(source, seen.required)).for_each(|a| list.push(a));
        let known = |id: &&u32| state.obstacle_sources.iter().any(|s| s.source_id == **id && is_heard(s));
        for id in seen.required.iter().filter(|id| !known(id)) {
            let clears = "start the perception client; it is in `obstacles.required`";
            list.push(alarm(format!("obstacles {id}"), "the source is absent", HOLDS, clears));
        }
        let tracking = state.supervisor == SupervisorState::Tracking.wire();
        if tracking && state.target_report.health == SourceHealth::Expired.wire() {
            let clears = "the task client sends again, then `sinew track`";
            list.push(alarm("target", "the target is too old", HOLDS, clears));
        }
    }
    if let Some(state) = seen.state {
        let acts = |limit: &Limit| state.limits >> (limit.code() - 100) & 1 == 1;
        Limit::ALL.into_iter().filter(acts).filter_map(|limit| of_limit(limit, state)).for_each(|a| list.push(a));
    }
    for (what, count) in &seen.drives.lack {
        let what = format!("{count} of {} drives lack {what}", seen.drives.count);
        list.push(alarm("drives", what, "nothing; it is accepted (`drives.accept_without`)", "other drives"));
    }
    for refused in seen.realtime_refused {
        list.push(alarm(REAL_TIME, refused.clone(), "deadlines may be missed", "grant it and start anew"));
    }
    if seen.recording_failed {
        let clears = "make room, and start anew; the log has the cause";
        list.push(alarm("recording", "the recording ended early", "nothing", clears));
    }
    list
}

/// The alarm of a limit; `None` for one that is part of ordinary work, or has its alarm from elsewhere.
fn of_limit(limit: Limit, state: &State) -> Option<Alarm> {
    // The text is what an alarm is known by from one look to the next: what changes belongs to what it does.
    let answer = |key: &str| format!("as `supervision.{key}` says");
    let (does, clears) = match limit {
        Limit::Blocked => ("the arm waits".into(), "the obstacle moves, or another target"),
        Limit::OutOfReach => {
            let does = ReachStatus::of(state).map_or_else(|| "the nearest pose is approached".into(), |r| r.text());
            (does, "a target within reach")
        }
        Limit::Swinging => (format!("{:.0} mm; {}", 1e3 * state.swing_m, answer("swing_answer")), "it fades"),
        Limit::TipSpeed => (answer("tip_speed_answer"), "it fades"),
        Limit::BendRate => (answer("bend_rate_answer"), "it fades"),
        Limit::Saturated => (answer("saturation_answer"), "a pose that needs less tension"),
        Limit::TensionError => (answer("tension_error_answer"), "the drive obeys"),
        Limit::EmergencyStop => (
            "the arm stops, and may not be armed".into(),
            "release it (`sinew emergency-stop --release`, or the button), then `sinew clear`",
        ),
        Limit::CableSuspect => (answer("cable_answer"), "the drive's data are mended, or the cable"),
        _ => return None,
    };
    let about = if limit == Limit::EmergencyStop { "emergency stop" } else { "motion" };
    Some(alarm(about, limit.text(), &does, clears))
}

fn is_heard(source: &SourceReport) -> bool {
    source.health != SourceHealth::Absent.wire()
}

fn of_source(source: &SourceReport, required: &[u32]) -> Option<Alarm> {
    let about = format!("obstacles {}", source.source_id);
    let gone = if required.contains(&source.source_id) {
        "the source is back; it is in `obstacles.required`"
    } else {
        "the source is back, or `sinew clear` if it is gone for good"
    };
    match SourceHealth::from_wire(source.health)? {
        SourceHealth::Stale => Some(alarm(about, "the source is silent", "its obstacles grow", "the source is back")),
        SourceHealth::Expired => Some(alarm(about, "the source is too old", HOLDS, gone)),
        SourceHealth::Refused => {
            let causes = source.rejected.iter().zip(0..).filter(|(count, _)| **count > 0).max();
            let cause =
                causes.and_then(|(_, cause)| RejectCause::from_wire(cause)).map_or("unknown", RejectCause::text);
            let clears = "the source is mended, or `sinew clear` if it is gone";
            Some(alarm(about, format!("every set is refused: {cause}"), HOLDS, clears))
        }
        SourceHealth::Absent | SourceHealth::Fresh | SourceHealth::Held => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn abouts(alarms: &Alarms) -> Vec<(String, String)> {
        alarms.0.iter().map(|a| (a.about.clone(), a.what.clone())).collect()
    }

    #[test]
    fn what_is_wrong_is_listed_with_what_it_does_and_keeps_its_beginning() {
        let mut state = State::default();
        state.obstacle_sources[0] =
            SourceReport { source_id: 7, health: SourceHealth::Refused.wire(), ..SourceReport::default() };
        state.obstacle_sources[0].rejected[RejectCause::Future.wire() as usize] = 9;
        state.obstacle_sources[1] =
            SourceReport { source_id: 8, health: SourceHealth::Fresh.wire(), ..SourceReport::default() };
        let mut alarms = Alarms::default();
        fn seen(state: &State) -> Seen<'_> {
            Seen { state: Some(state), required: &[8, 9], ..Seen::default() }
        }
        alarms.update(&seen(&state));
        let refused = ("obstacles 7".to_owned(), "every set is refused: capture time lies in the future".to_owned());
        let absent = ("obstacles 9".to_owned(), "the source is absent".to_owned());
        assert_eq!(abouts(&alarms), [refused.clone(), absent.clone()]);
        assert!(alarms.0.iter().all(|a| a.does == HOLDS && !a.clears.is_empty()));
        alarms.0[0].since_utc = "yesterday".into();
        alarms.update(&seen(&state));
        assert_eq!(alarms.list()[0].since_utc, "yesterday", "it goes on");
        state.obstacle_sources[0].health = SourceHealth::Fresh.wire();
        alarms.update(&seen(&state));
        assert_eq!(abouts(&alarms), [absent]);
    }

    #[test]
    fn a_limit_of_the_motion_is_an_alarm_and_one_of_ordinary_work_is_none() {
        let bit = |limit: Limit| 1 << (limit.code() - 100);
        let state = State {
            limits: bit(Limit::Swinging) | bit(Limit::Blocked) | bit(Limit::BudgetSpent),
            swing_m: 0.0311,
            ..State::default()
        };
        let mut alarms = Alarms::default();
        alarms.update(&Seen { state: Some(&state), ..Seen::default() });
        let of = |what: &str| ("motion".to_owned(), what.to_owned());
        assert_eq!(abouts(&alarms), [of("the way is blocked: waiting"), of("the arm swings")]);
        assert!(alarms.0[1].does.starts_with("31 mm"), "{:?}", alarms.0);
    }

    #[test]
    fn a_latched_fault_speaks_for_the_drive_that_caused_it() {
        let fault = FaultStatus { code: 11, detail: 3, what: "a drive is in fault".into(), clears: "clear".into() };
        let drives = DriveStatus { fault: Some("cable 3: heartbeat lost".into()), ..DriveStatus::default() };
        let mut alarms = Alarms::default();
        alarms.update(&Seen { fault: Some(fault), drives: drives.clone(), ..Seen::default() });
        assert_eq!(abouts(&alarms), [("fault".to_owned(), "a drive is in fault".to_owned())]);
        alarms.update(&Seen { drives, ..Seen::default() });
        assert_eq!(abouts(&alarms), [("drives".to_owned(), "cable 3: heartbeat lost".to_owned())]);
    }
}
