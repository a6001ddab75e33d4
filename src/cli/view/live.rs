//! A running daemon: its records by shared memory, its report by its socket, each on a thread of its own.
//!
//! The daemon does not know of it: a reader of shared memory takes the newest record when it likes. Nothing here ends because
//! the daemon does.

use super::super::client::{Found, Which};
use super::frame::{Frame, Worst};
use super::hub::{Hub, Topic};
use serde::Serialize;
use sinew::config::CableNames;
use sinew::daemon::status::ask;
use sinew::ipc::payload::{FLAG_LEAVING, Obstacles, State};
use sinew::ipc::{Client, IpcError, NewestSubscriber};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Between looks at the newest record: every tick at 250 Hz, every fourth at 1 kHz.
const LOOK: Duration = Duration::from_millis(4);
/// Between frames: 30 a second.
const FRAME: Duration = Duration::from_micros(33_333);
/// Between reports.
const REPORT: Duration = Duration::from_millis(500);
/// Without a record for so long it is looked whether the daemon is there.
const SILENCE: Duration = Duration::from_millis(500);
/// Between attempts to find a daemon.
const RETRY: Duration = Duration::from_millis(500);

/// Whether there is a daemon, and in words why not.
#[derive(Debug, Serialize)]
struct Link<'a> {
    connected: bool,
    why: &'a str,
}

/// Follows the daemon, and the one after it, until it is told to stop.
pub(super) fn follow(hub: &Hub, which: &Which, names: &CableNames, stop: &AtomicBool) {
    let mut said = String::new();
    while !stop.load(Ordering::Relaxed) {
        let why = match which.connect() {
            Ok(Ok(client)) => {
                said.clear();
                match watch(hub, &client, names, stop) {
                    Ok(()) => "the daemon has ended".to_owned(),
                    Err(error) => error.to_string(),
                }
            }
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        if why != said {
            hub.say(Topic::Link, &Link { connected: false, why: &why });
            said = why;
        }
        std::thread::sleep(RETRY);
    }
}

/// Until the daemon goes.
fn watch(hub: &Hub, client: &Client, names: &CableNames, stop: &AtomicBool) -> Result<(), IpcError> {
    let states: NewestSubscriber<State> = client.states()?;
    // There are few places; without one the arm is shown without obstacles.
    let obstacles = client.subscriber::<Obstacles>();
    let mut sets: BTreeMap<u32, Obstacles> = BTreeMap::new();
    let (mut worst, mut newest) = (Worst::default(), None::<Box<State>>);
    let (mut heard, mut shown) = (Instant::now(), Instant::now());
    let (mut last_s, mut told) = (f64::INFINITY, false);
    while !stop.load(Ordering::Relaxed) {
        while let Some(state) = states.receive()? {
            heard = Instant::now();
            if !told {
                told = true;
                hub.say(Topic::Link, &Link { connected: true, why: "" });
            }
            worst.note(&state);
            newest = Some(Box::new(state));
        }
        if let Ok(obstacles) = &obstacles {
            while let Some(set) = obstacles.receive()? {
                if set.flags & FLAG_LEAVING == 0 {
                    sets.insert(set.header.source_id, set);
                } else {
                    sets.remove(&set.header.source_id);
                }
            }
        }
        if shown.elapsed() >= FRAME
            && let Some(state) = newest.take()
        {
            // In step with the clock, so that there are 30 a second and not fewer by every late look.
            shown = if shown.elapsed() > 2 * FRAME { Instant::now() } else { shown + FRAME };
            if state.time_s < last_s {
                hub.forget();
            }
            last_s = state.time_s;
            hub.say(Topic::Frame, &Frame::new(&state, &worst, &sets, names));
            worst = Worst::default();
        }
        if heard.elapsed() > SILENCE {
            if !client.has_daemon() {
                return Ok(());
            }
            heard = Instant::now();
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Asks for the report, again and again, until it is told to stop.
pub(super) fn report(hub: &Hub, found: &Found, stop: &AtomicBool) {
    let mut told = String::new();
    while !stop.load(Ordering::Relaxed) {
        match ask(&found.address) {
            Ok(Some(report)) => {
                told.clear();
                hub.say(Topic::Status, &report);
            }
            Ok(None) => {}
            Err(error) => {
                let why = error.to_string();
                if why != told {
                    tracing::warn!("no report: {why}");
                    told = why;
                }
            }
        }
        std::thread::sleep(REPORT);
    }
}
