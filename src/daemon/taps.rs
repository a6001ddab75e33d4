//! What sees everything that passes the I/O thread: the builder of obstacle sets, the statistics, the log, the recorder.

use super::obstacles::PairBuilder;
use super::status::TickNotes;
use super::tick::{FIRST_SYNC, SPEED};
use crate::config::CableNames;
use crate::control::Fault;
use crate::ipc::payload::{Obstacles, State, Target};
use crate::ipc::{Event, Tap};
use crate::recording::Recorder;

pub(crate) struct Taps {
    pub(crate) pairs: PairBuilder,
    pub(crate) notes: TickNotes,
    pub(crate) recorder: Option<Recorder>,
    /// For the log.
    pub(crate) cables: CableNames,
}

impl Tap for Taps {
    fn complete(&mut self, state: &mut State) {
        self.notes.complete(state);
    }

    fn state(&mut self, state: &State) {
        self.notes.note(state);
        self.recorder.state(state);
    }

    fn obstacles(&mut self, obstacles: &Obstacles) {
        self.pairs.accept(obstacles);
        self.recorder.obstacles(obstacles);
    }

    fn forgotten(&mut self, source_id: u32) {
        self.pairs.forget(source_id);
    }

    fn target(&mut self, target: &Target) {
        self.recorder.target(target);
    }

    fn event(&mut self, event: &Event) {
        match event.code {
            0..100 => {
                let parts = [event.value, event.second];
                let fault = Fault::of_parts(event.code, event.detail, event.flags, parts);
                let what = fault.map_or_else(|| event.text.to_owned(), |fault| fault.in_words(&self.cables));
                tracing::error!(code = event.code, tick = event.tick, "fault: {what}");
            }
            100..300 => tracing::info!(code = event.code, tick = event.tick, "{}", event.text),
            FIRST_SYNC => tracing::debug!(number = event.value, "{}", event.text),
            SPEED => tracing::info!(scale = event.value, tick = event.tick, "{}", event.text),
            300..400 => tracing::info!(cause = event.detail, tick = event.tick, "mode: {}", event.text),
            _ => tracing::info!(refused = event.detail, tick = event.tick, "request: {}", event.text),
        }
        self.recorder.event(event);
    }
}
