//! The recording of a run: within which bounds, and what it tells of the run.

use super::words::event_in_words;
use super::{DaemonError, Options};
use crate::config::Config;
use crate::ipc::monotonic_ns;
use crate::recording::{About, Bounds, Recorder, Viewer, wall_clock_offset_ns};

/// Begins the recording that was asked for.
pub(super) fn start(config: &Config, options: &Options) -> Result<Option<Recorder>, DaemonError> {
    let Some(path) = &options.record else { return Ok(None) };
    // In lockstep times are the loop's own, which no other clock knows.
    let offset_ns = if options.lockstep.is_some() { 0 } else { wall_clock_offset_ns() };
    Ok(Some(Recorder::start_within(path, &about(config, options), offset_ns, bounds(config))?))
}

fn bounds(config: &Config) -> Bounds {
    let recording = &config.recording;
    Bounds {
        file_bytes: recording.file_mib << 20,
        total_bytes: recording.total_mib.map(|mib| mib << 20),
        free_bytes: recording.free_mib << 20,
    }
}

fn about(config: &Config, options: &Options) -> About {
    let viewer = Viewer::new(&config.arm, config.recording.pictures_1ps);
    About::new(&config.ipc.arm)
        .with("seed", options.seed)
        .with("lockstep", options.lockstep.is_some())
        .with("began_ns", monotonic_ns())
        .with("period_s", config.timing.period_s)
        .set(config)
        .configured(options.configuration.clone())
        .shown(viewer.map(|viewer| viewer.telling(event_in_words)))
}
