//! Writing: directly (open-loop runs), or through a thread of its own (the daemon).

use super::RecordingError;
use super::cdr::{Fields, encode, schema};
use crate::ipc::payload::{Obstacles, SCHEMA_VERSION, State, Target};
use crate::ipc::{Event, Tap, service_name};
use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

/// A chunk is written when it has this many bytes.
const CHUNK_BYTES: u64 = 256 * 1024;
/// Or when it spans this much recorded time (ns): what a crash can cost.
const FLUSH_NS: u64 = 1_000_000_000;
/// Messages that may wait for the disk.
const QUEUE: usize = 4096;

/// Channels of a recording, in the order of their ids.
#[derive(Debug, Clone, Copy)]
enum Channel {
    State,
    Obstacles,
    Target,
    Events,
}

/// A recording that is written in place.
pub struct Recording<W: Write + Seek = BufWriter<File>> {
    writer: Writer<W>,
    channels: [u16; 4],
    sequences: [u32; 4],
    flushed_ns: Option<u64>,
}

impl Recording {
    /// Creates a file, with what the reader should know about the run (scenario, seed, versions).
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, arm: &str, about: &BTreeMap<String, String>) -> Result<Self, RecordingError> {
        let file =
            File::create(path).map_err(|source| RecordingError::File { path: path.display().to_string(), source })?;
        Self::new(BufWriter::new(file), arm, about)
    }
}

impl<W: Write + Seek> Recording<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// The target cannot be written.
    pub fn new(target: W, arm: &str, about: &BTreeMap<String, String>) -> Result<Self, RecordingError> {
        let options = WriteOptions::new()
            .library(concat!("sinew ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            // Chunks reach the file whole, never with a length that is filled in later.
            .disable_seeking(true);
        let mut writer = options.create(target)?;
        let mut metadata = about.clone();
        metadata.insert("arm".into(), arm.into());
        metadata.insert("schema_version".into(), SCHEMA_VERSION.to_string());
        metadata.insert("sinew_version".into(), env!("CARGO_PKG_VERSION").into());
        writer.write_metadata(&Metadata { name: "sinew".into(), metadata })?;
        let channels = [
            add::<State, W>(&mut writer, &service_name(arm, "state"))?,
            add::<Obstacles, W>(&mut writer, &service_name(arm, "obstacles"))?,
            add::<Target, W>(&mut writer, &service_name(arm, "target"))?,
            add::<Event, W>(&mut writer, &service_name(arm, "events"))?,
        ];
        Ok(Self { writer, channels, sequences: [0; 4], flushed_ns: None })
    }

    /// Writes a tick's record at a time (ns) of the reader's choice of clock, the same for all messages.
    ///
    /// # Errors
    /// The target cannot be written.
    pub fn state(&mut self, time_ns: u64, state: &State) -> Result<(), RecordingError> {
        self.write(Channel::State, time_ns, &encode(state))
    }

    /// Writes an obstacle set.
    ///
    /// # Errors
    /// The target cannot be written.
    pub fn obstacles(&mut self, time_ns: u64, obstacles: &Obstacles) -> Result<(), RecordingError> {
        self.write(Channel::Obstacles, time_ns, &encode(obstacles))
    }

    /// Writes a target.
    ///
    /// # Errors
    /// The target file cannot be written.
    pub fn target(&mut self, time_ns: u64, target: &Target) -> Result<(), RecordingError> {
        self.write(Channel::Target, time_ns, &encode(target))
    }

    /// Writes an event.
    ///
    /// # Errors
    /// The target cannot be written.
    pub fn event(&mut self, time_ns: u64, event: &Event) -> Result<(), RecordingError> {
        self.write(Channel::Events, time_ns, &encode(event))
    }

    fn write(&mut self, channel: Channel, time_ns: u64, data: &[u8]) -> Result<(), RecordingError> {
        let index = channel as usize;
        let header = MessageHeader {
            channel_id: self.channels[index],
            sequence: self.sequences[index],
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.sequences[index] = self.sequences[index].wrapping_add(1);
        self.writer.write_to_known_channel(&header, data)?;
        if time_ns.saturating_sub(*self.flushed_ns.get_or_insert(time_ns)) >= FLUSH_NS {
            self.flushed_ns = Some(time_ns);
            self.writer.flush()?;
        }
        Ok(())
    }

    /// Writes index and summary, and gives the target back.
    ///
    /// # Errors
    /// The target cannot be written.
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.writer.finish()?;
        let mut target = self.writer.into_inner();
        target.flush().map_err(mcap::McapError::from)?;
        Ok(target)
    }
}

fn add<T: Fields, W: Write + Seek>(writer: &mut Writer<W>, topic: &str) -> Result<u16, RecordingError> {
    let schema = writer.add_schema(&format!("sinew/msg/{}", T::NAME), "ros2msg", schema::<T>().as_bytes())?;
    Ok(writer.add_channel(schema, topic, "cdr", &BTreeMap::new())?)
}

struct Packet {
    channel: Channel,
    time_ns: u64,
    data: Vec<u8>,
}

/// Hands messages to a thread that writes them. Never blocks: what finds the queue full is dropped and counted.
///
/// As a [`Tap`] it sees all that passes the I/O thread. Dropping it finishes the file.
pub struct Recorder {
    queue: Option<SyncSender<Packet>>,
    thread: Option<JoinHandle<()>>,
    dropped: Arc<AtomicU64>,
    offset_ns: u64,
}

impl Recorder {
    /// Creates the file and starts the thread. `offset_ns` is added to every CLOCK_MONOTONIC time: the time of day at its
    /// zero, or 0.
    ///
    /// # Errors
    /// The file cannot be created or written, or the thread cannot be started.
    pub fn start(
        path: &Path,
        arm: &str,
        about: &BTreeMap<String, String>,
        offset_ns: u64,
    ) -> Result<Self, RecordingError> {
        let mut about = about.clone();
        about.insert("monotonic_offset_ns".into(), offset_ns.to_string());
        let recording = Recording::create(path, arm, &about)?;
        let (queue, packets) = sync_channel(QUEUE);
        let thread = std::thread::Builder::new()
            .name("sinew-record".into())
            .spawn(move || write_all(recording, &packets))
            .map_err(|source| RecordingError::File { path: path.display().to_string(), source })?;
        Ok(Self { queue: Some(queue), thread: Some(thread), dropped: Arc::default(), offset_ns })
    }

    /// Counter of dropped messages; stays valid when the recorder has gone elsewhere.
    pub fn dropped(&self) -> Arc<AtomicU64> {
        self.dropped.clone()
    }

    fn push<T: Fields>(&self, channel: Channel, time_ns: u64, message: &T) {
        let packet = Packet { channel, time_ns: time_ns.saturating_add(self.offset_ns), data: encode(message) };
        if self.queue.as_ref().is_none_or(|q| q.try_send(packet).is_err()) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The thread: until the queue is closed, or the disk refuses.
fn write_all(mut recording: Recording, packets: &Receiver<Packet>) {
    let result = packets
        .iter()
        .try_for_each(|p| recording.write(p.channel, p.time_ns, &p.data))
        .and_then(|()| recording.finish().map(drop));
    if let Err(error) = result {
        // The receiver goes with this thread: from here on every message counts as dropped.
        tracing::error!(%error, "recording ended early");
    }
}

impl Tap for Recorder {
    fn state(&mut self, state: &State) {
        self.push(Channel::State, state.header.capture_ns, state);
    }

    fn obstacles(&mut self, obstacles: &Obstacles) {
        self.push(Channel::Obstacles, obstacles.header.capture_ns, obstacles);
    }

    fn target(&mut self, target: &Target) {
        self.push(Channel::Target, target.header.capture_ns, target);
    }

    fn event(&mut self, event: &Event) {
        self.push(Channel::Events, event.time_ns, event);
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        drop(self.queue.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the recording thread panicked");
        }
    }
}
