//! Reading: any recording, by its own schemas, complete or cut short, message by message and never as a whole.

use super::RecordingError;
use super::decode::Decoder;
use super::indexed::IndexedFile;
use mcap::io::MessageReader;
use mcap::records::Record;
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Channel, MAGIC, McapError, Summary};
use serde_json::Value;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::ops::ControlFlow;
use std::path::Path;

/// Bytes that are read from the disk at once.
const PIECE: usize = 1 << 20;

/// One message.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMessage {
    /// Topic, e.g. `sinew/paper/state`.
    pub topic: String,
    /// Time (ns).
    pub time_ns: u64,
    /// Content, decoded by the schema in the file; NaN and infinity are null.
    pub value: Value,
}

/// A message that is not decoded yet.
pub struct RawMessage<'a> {
    /// Topic.
    pub topic: &'a str,
    /// Time (ns).
    pub time_ns: u64,
    data: &'a [u8],
    decoder: &'a Decoder,
}

impl<'a> RawMessage<'a> {
    pub(super) const fn new(topic: &'a str, time_ns: u64, data: &'a [u8], decoder: &'a Decoder) -> Self {
        Self { topic, time_ns, data, decoder }
    }

    /// Decodes it, or what of it the type has.
    ///
    /// # Errors
    /// It does not match its schema, or lacks a field of the type.
    pub fn decode<T: serde::de::DeserializeOwned>(&self) -> Result<T, RecordingError> {
        let told = |why| RecordingError::Message { topic: self.topic.to_owned(), why };
        self.decoder.decode(self.data).map_err(told)
    }
}

/// How a file ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileEnd {
    /// As it should.
    Whole,
    /// In the middle: its writer was killed, its disk was full, or it was cut.
    Cut,
}

/// Reads all messages of sinew's own topics; of a file that was cut short, those before the cut.
///
/// # Errors
/// The file cannot be read, is no recording at all, or a message does not match its schema.
pub fn read(path: &Path) -> Result<Vec<RecordedMessage>, RecordingError> {
    let mut messages = Vec::new();
    read_each(path, |message| messages.push(message))?;
    Ok(messages)
}

/// Hands the messages of a file over one by one, as [`read`] does: a decoded message takes ten times its place in the
/// file.
///
/// # Errors
/// As [`read`].
pub fn read_each(path: &Path, mut take: impl FnMut(RecordedMessage)) -> Result<(), RecordingError> {
    read_raw(path, |message| {
        take(RecordedMessage { topic: message.topic.into(), time_ns: message.time_ns, value: message.decode()? });
        Ok(ControlFlow::Continue(()))
    })
    .map(drop)
}

/// Hands the messages of sinew's own topics over one by one, not decoded. Those for viewers, in other encodings, are
/// passed over. It ends where `take` breaks off or fails.
///
/// # Errors
/// As [`read`], and those of `take`.
pub fn read_raw(
    path: &Path,
    mut take: impl FnMut(&RawMessage<'_>) -> Result<ControlFlow<()>, RecordingError>,
) -> Result<FileEnd, RecordingError> {
    let file = open(path)?;
    let options = LinearReaderOptions::default().with_skip_end_magic(true);
    let mut decoders = Decoders::default();
    for message in MessageReader::new_with_options(BufReader::with_capacity(PIECE, file), options) {
        let message = match message {
            Ok(message) => message,
            Err(error) if is_cut(&error) => return Ok(FileEnd::Cut),
            Err(error) => return Err(error.into()),
        };
        if let Some(decoder) = decoders.of(&message.channel)? {
            let topic = &message.channel.topic;
            let message = RawMessage { topic, time_ns: message.log_time, data: &message.data, decoder };
            if take(&message)?.is_break() {
                break;
            }
        }
    }
    Ok(FileEnd::Whole)
}

/// The same for the messages of some topics (by their last part: `state`) within `from_ns..until_ns`: by the file's index, so
/// that a long one is not read through. A file without one, cut short, is.
///
/// # Errors
/// As [`read_raw`].
pub fn read_between(
    path: &Path,
    topics: &[&str],
    (from_ns, until_ns): (u64, u64),
    mut take: impl FnMut(&RawMessage<'_>) -> Result<ControlFlow<()>, RecordingError>,
) -> Result<FileEnd, RecordingError> {
    let asked = |topic: &str| topics.iter().any(|name| topic.rsplit('/').next() == Some(name));
    match IndexedFile::open(path) {
        Ok(mut file) => file.between(topics, from_ns..until_ns, take).map(|()| FileEnd::Whole),
        Err(RecordingError::NoIndex { .. }) => {
            read_raw(path, |message| match asked(message.topic) && (from_ns..until_ns).contains(&message.time_ns) {
                true => take(message),
                false => Ok(ControlFlow::Continue(())),
            })
        }
        Err(error) => Err(error),
    }
}

/// Time (ns) of the last message; `None` without any.
///
/// # Errors
/// As [`read_raw`].
pub fn last_ns(path: &Path) -> Result<Option<u64>, RecordingError> {
    if let Some(stats) = summary(path)?.and_then(|summary| summary.stats) {
        return Ok(Some(stats.message_end_time));
    }
    let mut last = None;
    read_raw(path, |message| {
        last = last.max(Some(message.time_ns));
        Ok(ControlFlow::Continue(()))
    })?;
    Ok(last)
}

/// The index at the end of a file; `None` of one that was cut short.
pub(super) fn summary(path: &Path) -> Result<Option<Summary>, RecordingError> {
    let mut file = open(path)?;
    let mut reader = SummaryReader::new();
    while let Some(event) = reader.next_event() {
        let done = match event {
            Ok(SummaryReadEvent::ReadRequest(need)) => {
                file.read(reader.insert(need)).map(|read| reader.notify_read(read))
            }
            Ok(SummaryReadEvent::SeekRequest(to)) => file.seek(to).map(|at| reader.notify_seeked(at)),
            // What is read through will tell what is wrong beside a missing end.
            Err(_) => return Ok(None),
        };
        done.map_err(McapError::from)?;
    }
    Ok(reader.finish().filter(|summary| !summary.chunk_indexes.is_empty()))
}

/// The decoders of a file, by channel.
#[derive(Debug, Default)]
pub(super) struct Decoders(BTreeMap<u16, Decoder>);

impl Decoders {
    /// That of a channel; `None` where it is not sinew's own.
    pub(super) fn of(&mut self, channel: &Channel<'_>) -> Result<Option<&Decoder>, RecordingError> {
        if channel.message_encoding != "cdr" {
            return Ok(None);
        }
        Ok(Some(match self.0.entry(channel.id) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(place) => {
                let schema = channel.schema.as_ref().map_or(&[] as &[u8], |s| &s.data);
                let decoder = Decoder::new(&String::from_utf8_lossy(schema));
                place.insert(decoder.map_err(|why| RecordingError::Message { topic: channel.topic.clone(), why })?)
            }
        }))
    }
}

/// Where a cut file ends.
fn is_cut(error: &McapError) -> bool {
    match error {
        McapError::UnexpectedEof => true,
        McapError::Io(error) => error.kind() == std::io::ErrorKind::UnexpectedEof,
        _ => false,
    }
}

/// Opens what begins as a recording does.
pub(super) fn open(path: &Path) -> Result<File, RecordingError> {
    let told = |source| RecordingError::File { path: path.display().to_string(), source };
    let mut file = File::open(path).map_err(told)?;
    let mut magic = [0; MAGIC.len()];
    match file.read_exact(&mut magic) {
        Err(error) if error.kind() != std::io::ErrorKind::UnexpectedEof => return Err(told(error)),
        read => {
            if read.is_err() || magic != *MAGIC {
                return Err(RecordingError::NoRecording { path: path.display().to_string() });
            }
        }
    }
    file.rewind().map_err(told)?;
    Ok(file)
}

/// What a recording holds beside its messages.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Facts {
    /// Name and value of each fact about the run: arm, seed, versions.
    pub metadata: BTreeMap<String, String>,
    /// Name and text of what is attached.
    pub attachments: BTreeMap<String, String>,
}

/// Reads what a recording holds beside its messages: it stands before them.
///
/// # Errors
/// The file cannot be read, or is no recording.
pub fn facts(path: &Path) -> Result<Facts, RecordingError> {
    let mut file = BufReader::new(open(path)?);
    let mut reader = LinearReader::new_with_options(LinearReaderOptions::default().with_emit_chunks(true));
    let mut facts = Facts::default();
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let read = file.read(reader.insert(need)).map_err(McapError::from)?;
                reader.notify_read(read);
                continue;
            }
            Ok(LinearReadEvent::Record { opcode, data }) => (opcode, data),
            Err(error) if is_cut(&error) => break,
            Err(error) => return Err(error.into()),
        };
        match mcap::parse_record(opcode, data)? {
            Record::Metadata(metadata) => facts.metadata.extend(metadata.metadata),
            Record::Attachment { header, data, .. } => {
                facts.attachments.insert(header.name, String::from_utf8_lossy(&data).into_owned());
            }
            Record::Chunk { .. } | Record::DataEnd(_) => break,
            _ => {}
        }
    }
    Ok(facts)
}
