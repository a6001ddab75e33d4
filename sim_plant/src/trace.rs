//! The truth, tick by tick, in the recordings' own schema, so that whatever reads a recording reads this too.
//!
//! Enters: the rig. Leaves: `State` records in an MCAP file, written in place: a trace loses nothing, it rather makes the
//! plant late. Fields that only a controller knows stay at their defaults. In a record
//! `header.tick` is the number of SYNCs served, `header.capture_ns` the plant's time (CLOCK_MONOTONIC, or in lockstep the
//! number of SYNCs times the period), `tension_command_n` what the drums were told, `tension_measured_n` what the cables
//! have at their drives, `cable_length_m` the true lengths, and pose, curvatures and nodes are the true arm's.

use crate::rig::Rig;
use sinew::ipc::payload::{Header, MAX_NODES, State};
use sinew::recording::{Recording, RecordingError};
use std::collections::BTreeMap;
use std::path::Path;

/// Writes the truth.
pub struct Trace {
    recording: Recording,
    state: Box<State>,
    sequence: u64,
}

impl Trace {
    /// Creates the file.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn create(path: &Path, arm: &str, rig: &Rig, seed: u64) -> Result<Self, RecordingError> {
        let nodes = rig.truth().config().node_count();
        if nodes > MAX_NODES {
            tracing::warn!(nodes, room = MAX_NODES, "the trace holds every {}-th node", State::stride_for(nodes));
        }
        let about = BTreeMap::from([
            ("writer".to_owned(), "sim_plant".to_owned()),
            ("content".to_owned(), "true state of the simulated arm".to_owned()),
            ("seed".to_owned(), seed.to_string()),
        ]);
        let recording = Recording::create(path, arm, &about)?;
        Ok(Self { recording, state: Box::default(), sequence: 0 })
    }

    /// Adds the present state.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, rig: &Rig, time_ns: u64, syncs: u64) -> Result<(), RecordingError> {
        let (s, truth) = (&mut *self.state, rig.truth());
        s.header = Header::new(0, self.sequence, time_ns).for_tick(syncs);
        s.time_s = rig.time_s();
        s.cable_count = rig.commands_n().len() as u32;
        s.segment_count = truth.config().segments.len() as u32;
        copy(&mut s.tension_command_n, rig.commands_n().iter().copied());
        copy(&mut s.tension_measured_n, truth.drive_tensions());
        copy(&mut s.cable_length_m, truth.true_lengths().iter().copied());
        let tip = truth.tip();
        s.tip_position_m = tip.position.into();
        s.tip_quaternion = tip.quaternion.into();
        copy(&mut s.curvature_1pm, truth.curvatures().into_iter());
        let q = &truth.state().q;
        s.set_nodes(
            truth.config().node_count(),
            |i| std::array::from_fn(|k| q[7 * i + k]),
            |i| std::array::from_fn(|k| q[7 * i + 3 + k]),
        );
        self.sequence += 1;
        self.recording.state(time_ns, s)
    }

    /// Completes the file.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.recording.finish().map(drop)
    }
}

fn copy(to: &mut [f64], from: impl Iterator<Item = f64>) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
}
