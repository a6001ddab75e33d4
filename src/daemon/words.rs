//! Events in words: those of the log, of a recording's log, and of what reads recordings.

use super::records::refusal_text;
use super::tick::SPEED;
use crate::config::CableNames;
use crate::control::{Fault, Limit};
use crate::ipc::payload::{RefusalReason, RequestKind, SupervisorState};
use crate::recording::{Happened, Severity};

/// What kind of event a code stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventClass {
    /// A fault.
    Fault,
    /// A limit began to act.
    LimitOn(Limit),
    /// A limit no longer acts.
    LimitOff(Limit),
    /// The mode changed.
    Mode(SupervisorState),
    /// A request was answered.
    Request(RequestKind),
    /// Anything else.
    Other,
}

impl EventClass {
    /// Of a code (`records::event` gives them).
    pub fn of(code: u32) -> Self {
        let limit = |code: u32| Limit::ALL.into_iter().find(|limit| limit.code() == code);
        let found = match code {
            0..100 => Some(Self::Fault),
            100..200 => limit(code).map(Self::LimitOn),
            200..300 => limit(code - 100).map(Self::LimitOff),
            300..400 => SupervisorState::from_wire(code - 300).map(Self::Mode),
            400..500 => RequestKind::from_wire(code - 400).map(Self::Request),
            _ => None,
        };
        found.unwrap_or(Self::Other)
    }
}

/// A fault of an event; `None` for one of another version.
pub fn fault_of(event: &Happened) -> Option<Fault> {
    Fault::of_parts(event.code, event.detail, event.flags, [event.value, event.second])
}

/// An event in a sentence.
pub fn event_in_words(event: &Happened, cables: &CableNames) -> (Severity, String) {
    match EventClass::of(event.code) {
        EventClass::Fault => {
            let fault = fault_of(event);
            let what = fault.map_or_else(|| event.text.clone(), |fault| fault.in_words(cables));
            (Severity::Error, format!("fault: {what}"))
        }
        EventClass::LimitOn(limit) => (severity(limit), event.text.clone()),
        EventClass::LimitOff(_) | EventClass::Other if event.code != SPEED => (Severity::Info, event.text.clone()),
        EventClass::LimitOff(_) | EventClass::Other => {
            (Severity::Info, format!("speed: {:.0} % of the configured one", 1e2 * event.value))
        }
        EventClass::Mode(to) => {
            let severity = if to == SupervisorState::Faulted { Severity::Error } else { Severity::Info };
            let why = mode_cause(event.detail).map_or_else(String::new, |why| format!(" ({why})"));
            (severity, format!("mode: {}{why}", to.text()))
        }
        EventClass::Request(kind) if event.detail == 0 => (Severity::Info, format!("request: {}", kind.text())),
        EventClass::Request(kind) => {
            let reason = refusal_of(event).map_or_else(String::new, |why| format!(": {why}"));
            (Severity::Warning, format!("request: {}, refused{reason}", kind.text()))
        }
    }
}

/// Whether a limit is part of ordinary work or keeps the arm from what was asked.
const fn severity(limit: Limit) -> Severity {
    match limit {
        Limit::RateLimited | Limit::BudgetSpent | Limit::EncoderBridged => Severity::Info,
        _ => Severity::Warning,
    }
}

/// Why the mode changed, by the code in an event's `detail`; `None` where a way came to its end.
pub fn mode_cause(code: u32) -> Option<String> {
    match EventClass::of(code) {
        _ if code == 0 => None,
        EventClass::Fault => {
            let fault = Fault::EXAMPLES.into_iter().find(|fault| fault.code() == code);
            Some(fault.map_or("a fault of another version", |fault| fault.what()).to_owned())
        }
        EventClass::LimitOn(limit) => Some(limit.text().to_owned()),
        EventClass::Request(kind) => Some(format!("asked by {}", kind.text())),
        _ => None,
    }
}

/// Why a request was refused.
pub fn refusal_of(event: &Happened) -> Option<&'static str> {
    let number = |value: f64| (value >= 0.0).then_some(value as u32);
    let reason = RefusalReason::from_wire(number(event.value)?)?;
    (reason != RefusalReason::None).then(|| refusal_text(reason, number(event.second).unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use super::super::records;
    use super::*;
    use crate::control::{Answer, Cause, Event, EventKind, Mode, Refusal, Request};

    fn told(kind: EventKind) -> (Severity, String) {
        let event = records::event(&Event { tick: 1, now_ns: 10, kind });
        let happened = Happened {
            time_ns: event.time_ns,
            tick: event.tick,
            code: event.code,
            detail: event.detail,
            flags: event.flags,
            value: event.value,
            second: event.second,
            text: event.text.into(),
        };
        event_in_words(&happened, &CableNames::new([3, 3]))
    }

    #[test]
    fn what_happened_is_told_with_its_cause() {
        let fault = Fault::EncoderSilent { cable: 4, age_s: 0.25 };
        for (kind, severity, words) in [
            (EventKind::Fault(fault), Severity::Error, "fault: the encoder of cable 2,2 has been silent for 0.250 s"),
            (
                EventKind::Mode { from: Mode::Tracking, to: Mode::Faulted, cause: Cause::Fault(fault) },
                Severity::Error,
                "mode: faulted (an encoder is silent)",
            ),
            (
                EventKind::Mode {
                    from: Mode::Tracking,
                    to: Mode::Holding,
                    cause: Cause::Limit(Limit::ObstaclesExpired),
                },
                Severity::Info,
                "mode: holding (obstacles unknown or too old: holding)",
            ),
            (
                EventKind::Mode { from: Mode::Holding, to: Mode::Tracking, cause: Cause::Request(Request::Track) },
                Severity::Info,
                "mode: tracking (asked by track)",
            ),
            (
                EventKind::Request(Answer { request: Request::Track, refusal: Some(Refusal::NoTarget) }),
                Severity::Warning,
                "request: track, refused: there is no fresh target: give one with `sinew target`, or start the task client",
            ),
            (EventKind::Request(Answer { request: Request::Arm, refusal: None }), Severity::Info, "request: arm"),
            (EventKind::LimitOn(Limit::Blocked), Severity::Warning, "the way is blocked: waiting"),
            (EventKind::LimitOff(Limit::Blocked), Severity::Info, "the way is free again"),
        ] {
            assert_eq!(told(kind), (severity, words.to_owned()));
        }
    }
}
