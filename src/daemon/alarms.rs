//! Alarms: what is wrong, since when, what it does to the motion, and what clears it; the same words in the log and in
//! `sinew status`.
//!
//! Enters: the newest record, what is known of the drives and of the process. Leaves: a list in a fixed order, a line of the
//! log where an alarm begins or ends. The main thread looks ten times a second; nothing here is on the way of a tick.

use super::reach::ReachStatus;
use super::status::{DriveStatus, FaultStatus};
use crate::control::Limit;
use crate::ipc::payload::{AlarmCode, AlarmRecord, RejectCause, SourceHealth, SourceReport, State, SupervisorState};
use crate::recording::utc_text;
use serde::{Deserialize, Serialize};
use std::time::{SystemTime, UNIX_EPOCH};

/// Something that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Alarm {
    /// Code of the fault, of the limit, or [`AlarmCode`]: as in `State`.
    pub code: u32,
    /// What it is about, as a number: the fault's detail, a source id, a count of drives.
    pub subject: u32,
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
    /// The same in the loop's time (ns).
    pub since_ns: u64,
}

impl Alarm {
    fn is_same(&self, other: &Self) -> bool {
        (self.code, self.subject, &self.what) == (other.code, other.subject, &other.what)
    }
}

/// What alarms are made from.
#[derive(Debug, Default)]
pub(super) struct Seen<'a> {
    pub(super) state: Option<&'a State>,
    pub(super) fault: Option<FaultStatus>,
    /// Whether the cables still hold the arm after it.
    pub(super) held: bool,
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
            match self.0.iter().find(|known| known.is_same(alarm)) {
                Some(known) => (alarm.since_utc, alarm.since_ns) = (known.since_utc.clone(), known.since_ns),
                // Said at the start.
                None if alarm.about == REAL_TIME => {}
                None => tracing::warn!(about = alarm.about, does = alarm.does, clears = alarm.clears, "{}", alarm.what),
            }
        }
        for known in &self.0 {
            if !raised.iter().any(|alarm| known.is_same(alarm)) {
                tracing::info!(about = known.about, "over: {}", known.what);
            }
        }
        self.0 = raised;
    }

    pub(super) fn list(&self) -> Vec<Alarm> {
        self.0.clone()
    }

    /// The same as `State` has them.
    pub(super) fn records_into(&self, records: &mut Vec<AlarmRecord>) {
        records.clear();
        let record = |a: &Alarm| AlarmRecord { code: a.code, subject: a.subject, since_ns: a.since_ns };
        records.extend(self.0.iter().map(record));
    }
}

fn alarm(
    (code, subject): (u32, u32),
    about: impl Into<String>,
    what: impl Into<String>,
    does: &str,
    clears: impl Into<String>,
) -> Alarm {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    Alarm {
        code,
        subject,
        since_ns: 0,
        about: about.into(),
        what: what.into(),
        does: does.into(),
        clears: clears.into(),
        since_utc: utc_text(seconds),
    }
}

/// The alarms that a state by itself tells of, where `required` are the sources that must be there: those of sources, target
/// and limits. What the daemon knows beside (drives, rights, the recording) is not among them; a fault has words of its own.
pub fn of_state(state: &State, required: &[u32]) -> Vec<Alarm> {
    let mut list = raised(&Seen { state: Some(state), required, ..Seen::default() });
    let known = &state.alarms[..(state.alarm_count as usize).min(state.alarms.len())];
    for alarm in &mut list {
        let same = known.iter().find(|known| (known.code, known.subject) == (alarm.code, alarm.subject));
        alarm.since_ns = same.map_or(alarm.since_ns, |known| known.since_ns);
    }
    list
}

const REAL_TIME: &str = "real time";
const HOLDS: &str = "the arm holds, and may not track";

fn raised(seen: &Seen<'_>) -> Vec<Alarm> {
    let mut list = Vec::new();
    if let Some(fault) = &seen.fault {
        let (does, clears) = match seen.held {
            true => {
                let first = "`sinew stop` lets the arm down; then";
                ("the cables hold the arm as they are declared to", format!("{first} {}", fault.clears))
            }
            false => {
                let does = "the tensions go to the safe value, the drives off; nothing moves before it is cleared";
                (does, fault.clears.clone())
            }
        };
        list.push(alarm((fault.code, fault.detail), "fault", fault.what.clone(), does, clears));
    } else if let Some(fault) = &seen.drives.fault {
        let id = (AlarmCode::DriveFault.wire(), 0);
        list.push(alarm(id, "drives", fault.clone(), "the arm may not be armed", "mend it, then `sinew clear`"));
    }
    if let Some(state) = seen.state {
        state.obstacle_sources.iter().filter_map(|source| of_source(source, seen.required)).for_each(|a| list.push(a));
        let known = |id: &&u32| state.obstacle_sources.iter().any(|s| s.source_id == **id && is_heard(s));
        for id in seen.required.iter().filter(|id| !known(id)) {
            let clears = "start the perception client; it is in `obstacles.required`";
            let code = AlarmCode::SourceAbsent;
            list.push(alarm((code.wire(), *id), format!("obstacles {id}"), code.text(), HOLDS, clears));
        }
        let tracking = state.supervisor == SupervisorState::Tracking.wire();
        if tracking && state.target_report.health == SourceHealth::Expired.wire() {
            let clears = "the task client sends again, then `sinew track`";
            let code = AlarmCode::TargetExpired;
            list.push(alarm((code.wire(), state.target_report.source_id), "target", code.text(), HOLDS, clears));
        }
    }
    if let Some(state) = seen.state {
        let acts = |limit: &Limit| state.limits >> (limit.code() - 100) & 1 == 1;
        Limit::ALL.into_iter().filter(acts).filter_map(|limit| of_limit(limit, state)).for_each(|a| list.push(a));
    }
    for (what, count) in &seen.drives.lack {
        let what = format!("{count} of {} drives lack {what}", seen.drives.count);
        let id = (AlarmCode::DrivesLack.wire(), *count as u32);
        list.push(alarm(id, "drives", what, "nothing; it is accepted (`drives.accept_without`)", "other drives"));
    }
    for refused in seen.realtime_refused {
        list.push(alarm(
            (AlarmCode::RealTime.wire(), 0),
            REAL_TIME,
            refused.clone(),
            "deadlines may be missed",
            "grant it and start anew",
        ));
    }
    if seen.recording_failed {
        let clears = "make room, and start anew; the log has the cause";
        let code = AlarmCode::Recording;
        list.push(alarm((code.wire(), 0), "recording", code.text(), "nothing", clears));
    }
    let now_ns = seen.state.map_or(0, |state| state.header.capture_ns);
    list.iter_mut().for_each(|alarm| alarm.since_ns = now_ns);
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
        Limit::TipDoubted => (
            "the tip is steered by cables alone".into(),
            "sensor and base frame agree, or `tip_sensor.error_m` is larger",
        ),
        _ => return None,
    };
    let about = if limit == Limit::EmergencyStop { "emergency stop" } else { "motion" };
    Some(alarm((limit.code(), 0), about, limit.text(), &does, clears))
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
    let id = |code: AlarmCode| (code.wire(), source.source_id);
    match SourceHealth::from_wire(source.health)? {
        SourceHealth::Stale => {
            let code = AlarmCode::SourceStale;
            Some(alarm(id(code), about, code.text(), "its obstacles grow", "the source is back"))
        }
        SourceHealth::Expired => {
            Some(alarm(id(AlarmCode::SourceExpired), about, AlarmCode::SourceExpired.text(), HOLDS, gone))
        }
        SourceHealth::Refused => {
            let causes = source.rejected.iter().zip(0..).filter(|(count, _)| **count > 0).max();
            let cause =
                causes.and_then(|(_, cause)| RejectCause::from_wire(cause)).map_or("unknown", RejectCause::text);
            let clears = "the source is mended, or `sinew clear` if it is gone";
            let code = AlarmCode::SourceRefused;
            Some(alarm(id(code), about, format!("{}: {cause}", code.text()), HOLDS, clears))
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
        let refused = ("obstacles 7".to_owned(), "sets are refused: capture time lies in the future".to_owned());
        let absent = ("obstacles 9".to_owned(), "the source is absent".to_owned());
        assert_eq!(abouts(&alarms), [refused.clone(), absent.clone()]);
        assert!(alarms.0.iter().all(|a| a.does == HOLDS && !a.clears.is_empty()));
        alarms.0[0].since_utc = "yesterday".into();
        let first_ns = state.header.capture_ns;
        state.header.capture_ns += 1000;
        alarms.update(&seen(&state));
        assert_eq!(alarms.list()[0].since_utc, "yesterday", "it goes on");
        let mut records = Vec::new();
        alarms.records_into(&mut records);
        assert_eq!(records[0], AlarmRecord { code: 502, subject: 7, since_ns: first_ns });
        assert_eq!((records.len(), records[1].code, records[1].subject), (2, 503, 9));
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
