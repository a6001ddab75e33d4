//! The truth, tick by tick, in the recordings' own schema, so that whatever reads a recording reads this too.
//!
//! Enters: the rig. Leaves: `State` records in an MCAP file, which a thread of its own writes. In real time a disk that
//! does not keep up costs records, which are counted, and never a step; in lockstep the plant waits for it, and nothing is
//! lost. Fields that only a controller knows stay at their defaults. In a record `header.tick` is the number of SYNCs
//! served, `header.capture_ns` the plant's time (CLOCK_MONOTONIC, or in lockstep the number of SYNCs times the period),
//! `tension_command_n` what the drums were told, `tension_measured_n` what the cables have at their drives,
//! `cable_length_m` the true lengths, and pose, curvatures and nodes are the true arm's.

use crate::config::Pace;
use crate::rig::Rig;
use sinew::ipc::Tap;
use sinew::ipc::payload::{Header, MAX_NODES, State};
use sinew::recording::{About, Recorder, RecordingError, wall_clock_offset_ns};
use std::path::Path;
use std::sync::atomic::Ordering;

/// Writes the truth.
pub struct Trace {
    recorder: Recorder,
    state: Box<State>,
    sequence: u64,
}

impl Trace {
    /// Creates the file and starts the thread.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn create(path: &Path, arm: &str, rig: &Rig, pace: Pace, seed: u64) -> Result<Self, RecordingError> {
        let nodes = rig.truth().config().node_count();
        if nodes > MAX_NODES {
            tracing::warn!(nodes, room = MAX_NODES, "the trace holds every {}-th node", State::stride_for(nodes));
        }
        let about = About::new(arm)
            .with("writer", "sim_plant")
            .with("content", "true state of the simulated arm")
            .with("seed", seed);
        let recorder = match pace {
            Pace::Lockstep => Recorder::start(path, &about, 0)?.patient(),
            Pace::Realtime => Recorder::start(path, &about, wall_clock_offset_ns())?,
        };
        Ok(Self { recorder, state: Box::default(), sequence: 0 })
    }

    /// Adds the present state.
    pub fn add(&mut self, rig: &Rig, time_ns: u64, syncs: u64) {
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
        self.recorder.state(s);
    }

    /// Records that were not kept so far: in lockstep none but after the disk has refused.
    pub fn dropped(&self) -> u64 {
        self.recorder.dropped().load(Ordering::Relaxed)
    }

    /// Completes the file; the number of records that were not kept.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(self) -> Result<u64, RecordingError> {
        self.recorder.finish()
    }
}

fn copy(to: &mut [f64], from: impl Iterator<Item = f64>) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
}
