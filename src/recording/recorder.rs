//! Writing: directly (open-loop runs), or through a thread of its own (the daemon, the simulated plant).

use super::RecordingError;
use super::about::About;
use super::cdr::{Fields, encode, encode_into, schema};
use super::files::{Bounds, Files};
use super::viewer::{Shown, Topic};
use crate::ipc::payload::{Obstacles, State, Target};
use crate::ipc::{Event, Tap, service_name};
use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use rtrb::{Consumer, Producer, RingBuffer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A chunk is written when it has this many bytes.
const CHUNK_BYTES: u64 = 256 * 1024;
/// Or when it spans this much recorded time (ns), or that much has passed on the clock: half of what a crash may cost.
const FLUSH_NS: u64 = 500_000_000;
/// Messages that may wait for the disk: two seconds of a loop at 1 kHz.
const QUEUE: usize = 2048;
/// Bytes that a buffer of the queue begins with: the record of a tick of the paper's arm fits.
const BUFFER: usize = 4096;
/// How often the thread looks into the queue.
const LOOK: Duration = Duration::from_millis(5);

/// Bytes after which is looked how long the file has become, and how much room there is.
const LOOK_BYTES: u64 = 1 << 20;

/// Channels of a recording, in the order of their ids.
#[derive(Debug, Clone, Copy)]
enum Channel {
    State,
    Obstacles,
    Target,
    Events,
}

/// Number of sinew's own channels; those for viewers follow.
const OWN_CHANNELS: usize = 4;

/// A recording that is written in place.
pub struct Recording<W: Write + Seek = BufWriter<File>> {
    writer: Writer<W>,
    channels: Vec<u16>,
    sequences: Vec<u32>,
    shown: Option<Box<Shown>>,
    flushed_ns: Option<u64>,
    flushed: Instant,
    /// Whether messages were written since.
    open: bool,
    /// Bytes of messages written, their headers counted roughly.
    bytes: u64,
}

/// Bytes of a message's header in the file, roughly.
const HEADER_BYTES: u64 = 40;

impl Recording {
    /// Creates a file that was not there, with what the reader should know about the run.
    ///
    /// # Errors
    /// The file is there, or cannot be created or written.
    pub fn create(path: &Path, about: &About) -> Result<Self, RecordingError> {
        Self::new(BufWriter::new(super::files::make(path)?), about)
    }
}

impl<W: Write + Seek> Recording<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// The target cannot be written.
    pub fn new(target: W, about: &About) -> Result<Self, RecordingError> {
        let options = WriteOptions::new()
            .library(concat!("sinew ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            // Chunks reach the file whole, never with a length that is filled in later.
            .disable_seeking(true);
        let mut writer = options.create(target)?;
        writer.write_metadata(&Metadata { name: "sinew".into(), metadata: about.metadata.clone() })?;
        for attachment in about.attachments() {
            writer.attach(&attachment)?;
        }
        let arm = &about.arm;
        let mut channels = vec![
            add::<State, W>(&mut writer, &service_name(arm, "state"))?,
            add::<Obstacles, W>(&mut writer, &service_name(arm, "obstacles"))?,
            add::<Target, W>(&mut writer, &service_name(arm, "target"))?,
            add::<Event, W>(&mut writer, &service_name(arm, "events"))?,
        ];
        let mut shown = None;
        if let Some(viewer) = &about.viewer {
            for topic in Topic::ALL {
                let name = service_name(arm, topic.name());
                let (schema, encoding) = match topic.schema() {
                    Some(s) => (writer.add_schema(&s.name, &s.encoding, &s.data)?, "protobuf"),
                    None => (0, ""),
                };
                channels.push(writer.add_channel(schema, &name, encoding, &BTreeMap::new())?);
            }
            let told = |why| RecordingError::Message { topic: service_name(arm, Topic::Scene.name()), why };
            shown = Some(Box::new(Shown::new(viewer.clone()).map_err(told)?));
        }
        // What stands before the messages is there at once.
        writer.flush()?;
        let sequences = vec![0; channels.len()];
        Ok(Self {
            writer,
            channels,
            sequences,
            shown,
            flushed_ns: None,
            flushed: Instant::now(),
            open: false,
            bytes: 0,
        })
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
        self.put(channel as usize, time_ns, data)?;
        self.show(channel, time_ns, data)?;
        if time_ns.saturating_sub(*self.flushed_ns.get_or_insert(time_ns)) >= FLUSH_NS {
            self.flush()?;
            self.flushed_ns = Some(time_ns);
        }
        Ok(())
    }

    fn put(&mut self, index: usize, time_ns: u64, data: &[u8]) -> Result<(), RecordingError> {
        let header = MessageHeader {
            channel_id: self.channels[index],
            sequence: self.sequences[index],
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.sequences[index] = self.sequences[index].wrapping_add(1);
        self.bytes += data.len() as u64 + HEADER_BYTES;
        self.open = true;
        Ok(self.writer.write_to_known_channel(&header, data)?)
    }

    /// Writes what a message shows to viewers.
    fn show(&mut self, channel: Channel, time_ns: u64, data: &[u8]) -> Result<(), RecordingError> {
        let Some(shown) = &mut self.shown else { return Ok(()) };
        let made = match channel {
            Channel::State => shown.state(time_ns, data),
            Channel::Events => shown.event(time_ns, data).map(|made| made.into_iter().collect()),
            Channel::Obstacles => {
                shown.obstacles(data);
                return Ok(());
            }
            Channel::Target => return Ok(()),
        };
        let told = |why| RecordingError::Message { topic: Topic::Scene.name().into(), why };
        for (topic, data) in made.map_err(told)? {
            self.put(OWN_CHANNELS + topic as usize, time_ns, &data)?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), RecordingError> {
        (self.flushed, self.open) = (Instant::now(), false);
        Ok(self.writer.flush()?)
    }

    /// Writes what has waited for long, also where no further message comes.
    fn flush_in_time(&mut self) -> Result<(), RecordingError> {
        if self.open && self.flushed.elapsed() >= Duration::from_nanos(FLUSH_NS) { self.flush() } else { Ok(()) }
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

impl Packet {
    fn empty() -> Self {
        Self { channel: Channel::State, time_ns: 0, data: Vec::with_capacity(BUFFER) }
    }
}

/// Hands messages to a thread that writes them. Never blocks unless told to ([`Recorder::patient`]): what finds the queue
/// full is dropped and counted.
///
/// The one who hands over runs at real-time priority and the thread at none, so they share nothing that one could wait
/// for: two rings, one with messages, one with their buffers on the way back. A channel of the standard library would do
/// for the order, but it wakes its receiver under a lock, and a buffer freed on another thread takes the allocator's: on
/// a busy machine whoever holds such a lock may be without a processor for tens of milliseconds.
///
/// As a [`Tap`] it sees all that passes the I/O thread. Dropping it finishes the file.
pub struct Recorder {
    /// Messages; `None` once closed.
    queue: Option<Producer<Packet>>,
    empty: Consumer<Packet>,
    thread: Option<JoinHandle<Result<(), RecordingError>>>,
    dropped: Arc<AtomicU64>,
    failed: Arc<AtomicBool>,
    offset_ns: u64,
    patient: bool,
}

/// Gives the next recording when the present one, of so many bytes, is long enough.
type Next<W> = Box<dyn FnMut(u64) -> Result<Option<Recording<W>>, RecordingError> + Send>;

impl Recorder {
    /// Creates the file and starts the thread. `offset_ns` is added to every CLOCK_MONOTONIC time: the time of day at its
    /// zero ([`super::wall_clock_offset_ns`]), or 0.
    ///
    /// # Errors
    /// The file is there, or cannot be created or written, or the thread cannot be started.
    pub fn start(path: &Path, about: &About, offset_ns: u64) -> Result<Self, RecordingError> {
        Self::start_within(path, about, offset_ns, Bounds::NONE)
    }

    /// The same within bounds: one file after the other, in a folder by start time where `path` is one.
    ///
    /// # Errors
    /// As [`Self::start`]; less of the disk is free than is to stay so.
    pub fn start_within(path: &Path, about: &About, offset_ns: u64, bounds: Bounds) -> Result<Self, RecordingError> {
        let about = about
            .clone()
            .with("monotonic_offset_ns", offset_ns)
            .with("wall_clock_offset_ns", super::wall_clock_offset_ns());
        let mut files = Files::new(path, &about.arm, bounds);
        files.check_room()?;
        let first = Recording::new(BufWriter::new(files.next()?), &about)?;
        let failed = |source| RecordingError::File { path: path.display().to_string(), source };
        let next = move |bytes| {
            files.check_room()?;
            if !files.is_full(bytes) {
                return Ok(None);
            }
            Recording::new(BufWriter::new(files.next()?), &about).map(Some)
        };
        Self::hand_over(first, Box::new(next), offset_ns).map_err(failed)
    }

    /// Gives a recording to a thread of its own.
    fn hand_over<W>(recording: Recording<W>, next: Next<W>, offset_ns: u64) -> std::io::Result<Self>
    where
        W: Write + Seek + Send + 'static,
    {
        let (queue, packets) = RingBuffer::new(QUEUE);
        let (mut used, empty) = RingBuffer::new(QUEUE);
        while used.push(Packet::empty()).is_ok() {}
        let failed: Arc<AtomicBool> = Arc::default();
        let thread = std::thread::Builder::new().name("sinew-record".into()).spawn({
            let failed = failed.clone();
            move || {
                let written = write_all(recording, next, packets, used);
                failed.store(written.is_err(), Ordering::Release);
                written
            }
        })?;
        let (queue, thread) = (Some(queue), Some(thread));
        Ok(Self { queue, empty, thread, dropped: Arc::default(), failed, offset_ns, patient: false })
    }

    /// One that waits for room in place of dropping: for runs in which nothing waits for the clock. It drops, and counts,
    /// only after the disk has refused.
    #[must_use]
    pub fn patient(mut self) -> Self {
        self.patient = true;
        self
    }

    /// Writes what waits and finishes the file; the number of messages dropped.
    ///
    /// # Errors
    /// The file could not be written: what was recorded before stays readable.
    pub fn finish(mut self) -> Result<u64, RecordingError> {
        self.close()?;
        Ok(self.dropped.load(Ordering::Relaxed))
    }

    fn close(&mut self) -> Result<(), RecordingError> {
        drop(self.queue.take());
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let panicked = |_| Err(mcap::McapError::from(std::io::Error::other("its thread panicked")).into());
        thread.join().unwrap_or_else(panicked)
    }

    /// A buffer, and for a patient recorder the time that it takes.
    fn buffer(&mut self) -> Option<Packet> {
        loop {
            match (self.empty.pop(), &self.queue) {
                (Ok(packet), _) => return Some(packet),
                (Err(_), Some(queue)) if self.patient && !queue.is_abandoned() => std::thread::sleep(LOOK),
                _ => return None,
            }
        }
    }

    /// Counter of dropped messages; stays valid when the recorder has gone elsewhere.
    pub fn dropped(&self) -> Arc<AtomicU64> {
        self.dropped.clone()
    }

    /// Whether the recording ended early; stays valid when the recorder has gone elsewhere.
    pub fn failed(&self) -> Arc<AtomicBool> {
        self.failed.clone()
    }

    fn push<T: Fields>(&mut self, channel: Channel, time_ns: u64, message: &T) {
        let time_ns = time_ns.saturating_add(self.offset_ns);
        let buffer = self.buffer();
        let pushed = match (&mut self.queue, buffer) {
            // Nobody there to write it: the thread has ended early.
            (Some(queue), _) if queue.is_abandoned() => false,
            (Some(queue), Some(mut packet)) => {
                (packet.channel, packet.time_ns) = (channel, time_ns);
                encode_into(message, &mut packet.data);
                // There are no more packets than places.
                queue.push(packet).is_ok()
            }
            _ => false,
        };
        if !pushed {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The thread: until the queue is closed and empty, or the disk refuses.
fn write_all<W: Write + Seek>(
    recording: Recording<W>,
    mut next: Next<W>,
    mut packets: Consumer<Packet>,
    mut used: Producer<Packet>,
) -> Result<(), RecordingError> {
    let mut recording = Some(recording);
    let mut looked = 0;
    let mut write = || -> Result<(), RecordingError> {
        loop {
            // Asked before the queue is emptied: what was pushed before it was closed is written.
            let closed = packets.is_abandoned();
            while let Ok(packet) = packets.pop() {
                let Some(present) = &mut recording else { return Ok(()) };
                present.write(packet.channel, packet.time_ns, &packet.data)?;
                if present.bytes.abs_diff(looked) > LOOK_BYTES {
                    looked = present.bytes;
                    if let Some(following) = next(present.bytes)?
                        && let Some(full) = recording.replace(following)
                    {
                        looked = 0;
                        full.finish()?;
                    }
                }
                // The ring has a place for every packet there is.
                let _ = used.push(packet);
            }
            if closed {
                return Ok(());
            }
            recording.iter_mut().try_for_each(Recording::flush_in_time)?;
            std::thread::sleep(LOOK);
        }
    };
    // The ring's end goes with this thread: after an error every message counts as dropped.
    let written = write();
    let finished = recording.take().map_or(Ok(()), |recording| recording.finish().map(drop));
    written.and(finished).inspect_err(|error| tracing::error!(%error, "recording ended early"))
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
        // Whoever wants to know asks by `finish`; the thread itself has said it, too.
        let _ = self.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Cursor, SeekFrom};
    use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

    /// A disk that takes nothing before its gate opens, and refuses from a number of bytes on.
    struct Disk {
        gate: Option<Receiver<()>>,
        room: usize,
        written: Cursor<Vec<u8>>,
        done: SyncSender<Vec<u8>>,
    }

    impl Write for Disk {
        fn write(&mut self, data: &[u8]) -> std::io::Result<usize> {
            if let Some(gate) = &self.gate
                && self.written.get_ref().len() > 4096
            {
                let _ = gate.recv(); // opened, or its owner is gone
                self.gate = None;
            }
            if self.written.get_ref().len() + data.len() > self.room {
                return Err(std::io::Error::other("full"));
            }
            self.written.write(data)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    impl Seek for Disk {
        fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
            self.written.seek(to)
        }
    }

    impl Drop for Disk {
        fn drop(&mut self) {
            let _ = self.done.try_send(std::mem::take(self.written.get_mut()));
        }
    }

    /// A recorder on a disk with `room` bytes, the key of its gate, and the bytes once it is done.
    fn recorder(room: usize) -> (Recorder, SyncSender<()>, Receiver<Vec<u8>>) {
        let ((key, gate), (done, bytes)) = (sync_channel(1), sync_channel(1));
        let disk = Disk { gate: Some(gate), room, written: Cursor::default(), done };
        let recording = Recording::new(disk, &About::new("paper")).unwrap();
        (Recorder::hand_over(recording, Box::new(|_| Ok(None)), 0).unwrap(), key, bytes)
    }

    fn record(recorder: &mut Recorder, ticks: std::ops::Range<u64>) {
        let mut state = State::default();
        for tick in ticks {
            state.header.capture_ns = 1_000_000 * tick;
            recorder.state(&state);
        }
    }

    fn count(bytes: &[u8]) -> u64 {
        mcap::Summary::read(bytes).unwrap().unwrap().stats.unwrap().message_count
    }

    #[test]
    fn a_disk_that_stands_still_costs_messages_and_no_waiting() {
        let (mut recorder, key, bytes) = recorder(usize::MAX);
        let all = 4 * QUEUE as u64;
        // Returns although nothing is written before the key is turned.
        record(&mut recorder, 0..all);
        key.send(()).unwrap();
        let dropped = recorder.finish().unwrap();
        assert!(dropped > QUEUE as u64, "{dropped}");
        assert_eq!(count(&bytes.recv().unwrap()), all - dropped);
    }

    #[test]
    fn a_patient_recorder_waits_for_the_disk_and_loses_nothing() {
        let (recorder, key, bytes) = recorder(usize::MAX);
        let mut recorder = recorder.patient();
        let all = 4 * QUEUE as u64;
        let writer = std::thread::spawn(move || {
            record(&mut recorder, 0..all);
            recorder.finish().unwrap()
        });
        key.send(()).unwrap();
        assert_eq!(writer.join().unwrap(), 0);
        assert_eq!(count(&bytes.recv().unwrap()), all);
    }

    #[test]
    fn a_disk_that_refuses_is_told_at_the_end_and_holds_nobody_up() {
        let (recorder, key, _bytes) = recorder(1 << 20);
        let mut recorder = recorder.patient();
        key.send(()).unwrap();
        record(&mut recorder, 0..4 * QUEUE as u64);
        assert!(recorder.dropped().load(Ordering::Relaxed) > 0);
        let failed = recorder.failed();
        assert!(recorder.finish().unwrap_err().to_string().contains("full"));
        assert!(failed.load(Ordering::Acquire));
    }
}
