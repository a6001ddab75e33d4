//! Reading by the index at a file's end: any time of a recording of any length, without the rest of it.

use super::RecordingError;
use super::reader::{Decoders, RawMessage, open, summary};
use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions};
use mcap::{McapError, Summary};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::{ControlFlow, Range};
use std::path::{Path, PathBuf};

/// A file and its index.
#[derive(Debug)]
pub struct IndexedFile {
    path: PathBuf,
    file: File,
    summary: Summary,
    decoders: Decoders,
}

impl IndexedFile {
    /// Opens a file and reads its index.
    ///
    /// # Errors
    /// The file cannot be read, is no recording, or has no index since it was cut short.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let summary = summary(path)?;
        let mut summary = summary.ok_or_else(|| RecordingError::NoIndex { path: path.display().to_string() })?;
        summary.chunk_indexes.sort_by_key(|chunk| chunk.message_start_time);
        Ok(Self { path: path.to_owned(), file: open(path)?, summary, decoders: Decoders::default() })
    }

    /// Name of the arm, by its topics; `None` in a recording of something else.
    pub fn arm(&self) -> Option<&str> {
        let topics = self.summary.channels.values().map(|channel| channel.topic.as_str());
        topics.filter_map(|topic| topic.strip_prefix("sinew/")?.strip_suffix("/state")).next()
    }

    /// Times of the first and of the last message (ns).
    pub fn span_ns(&self) -> [u64; 2] {
        let chunks = &self.summary.chunk_indexes;
        let first = chunks.first().map_or(0, |chunk| chunk.message_start_time);
        [first, chunks.iter().map(|chunk| chunk.message_end_time).max().unwrap_or(first)]
    }

    /// Chunks with messages of a range, roughly: their number is the work that reading it takes.
    fn chunks(&self, range: &Range<u64>) -> Range<usize> {
        let chunks = &self.summary.chunk_indexes;
        // They overlap by the delay of one topic against another; one more on either side has what that leaves out.
        let from = chunks.partition_point(|chunk| chunk.message_end_time < range.start).saturating_sub(1);
        let to = chunks.partition_point(|chunk| chunk.message_start_time < range.end);
        from..to.max(from)
    }

    /// Bytes of the chunks in which messages of a range are.
    pub fn bytes(&self, range: &Range<u64>) -> u64 {
        self.summary.chunk_indexes[self.chunks(range)].iter().map(|chunk| chunk.compressed_size).sum()
    }

    /// Hands the messages of a range of times (ns) over in their order, of topics by their last part (`state`), until `take`
    /// breaks off.
    ///
    /// # Errors
    /// The file cannot be read or is damaged; those of `take`.
    pub fn between(
        &mut self,
        topics: &[&str],
        range: Range<u64>,
        mut take: impl FnMut(&RawMessage<'_>) -> Result<ControlFlow<()>, RecordingError>,
    ) -> Result<(), RecordingError> {
        let asked = |topic: &str| topics.iter().any(|name| topic.rsplit('/').next() == Some(name));
        let chunk_indexes = self.summary.chunk_indexes[self.chunks(&range)].to_vec();
        let (channels, schemas) = (self.summary.channels.clone(), self.summary.schemas.clone());
        let part = Summary { chunk_indexes, channels, schemas, ..Summary::default() };
        let named = part.channels.values().map(|channel| channel.topic.clone()).filter(|topic| asked(topic));
        let options = IndexedReaderOptions::new().include_topics(named).starting_at(range.start);
        let mut reader = IndexedReader::new_with_options(&part, options.ending_before(range.end))?;
        let mut piece = Vec::new();
        while let Some(event) = reader.next_event() {
            match event? {
                IndexedReadEvent::ReadChunkRequest { offset, length } => {
                    piece.resize(length, 0);
                    let read = self.file.seek(SeekFrom::Start(offset)).and_then(|_| self.file.read_exact(&mut piece));
                    read.map_err(|source| RecordingError::File { path: self.path.display().to_string(), source })?;
                    reader.insert_chunk_record_data(offset, &piece)?;
                }
                IndexedReadEvent::Message { header, data } => {
                    let channel = part.channels.get(&header.channel_id);
                    let channel = channel.ok_or(McapError::UnknownChannel(header.sequence, header.channel_id))?;
                    let Some(decoder) = self.decoders.of(channel)? else { continue };
                    if take(&RawMessage::new(&channel.topic, header.log_time, data, decoder))?.is_break() {
                        break;
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{About, Recording};
    use super::*;
    use crate::ipc::payload::{Header, Obstacles, State};

    #[test]
    fn any_time_is_read_by_the_index_and_no_more_than_its_chunks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("long.mcap");
        let mut file = Recording::create(&path, &About::new("paper")).unwrap();
        for tick in 0..30_000u64 {
            let header = Header { tick, ..Header::default() };
            file.state(1_000_000 * tick, &State { header, ..State::default() }).unwrap();
            file.obstacles(1_000_000 * tick, &Obstacles { header, ..Obstacles::default() }).unwrap();
        }
        drop(file.finish().unwrap());
        let mut file = IndexedFile::open(&path).unwrap();
        assert_eq!((file.arm(), file.span_ns()), (Some("paper"), [0, 29_999_000_000]));
        let range = 20_000_000_000..20_003_000_000;
        assert!(file.bytes(&range) < 1_500_000, "{}", file.bytes(&range));
        let mut seen = Vec::new();
        let mut take = |message: &RawMessage<'_>| {
            let value: serde_json::Value = message.decode()?;
            seen.push((message.topic.to_owned(), value["header"]["tick"].as_u64().unwrap()));
            Ok(ControlFlow::Continue(()))
        };
        file.between(&["state"], range, &mut take).unwrap();
        let of = |topic: &str, tick: u64| (format!("sinew/paper/{topic}"), tick);
        assert_eq!(seen, [of("state", 20_000), of("state", 20_001), of("state", 20_002)]);
        let mut count = 0;
        let two = |_: &RawMessage<'_>| {
            count += 1;
            Ok(if count == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
        };
        file.between(&["state", "obstacles"], 0..u64::MAX, two).unwrap();
        assert_eq!(count, 2);
    }

    #[test]
    fn a_file_without_an_index_is_told_as_such() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cut.mcap");
        let mut file = Recording::create(&path, &About::new("paper")).unwrap();
        (0..1000).for_each(|tick| file.state(1_000_000 * tick, &State::default()).unwrap());
        drop(file.finish().unwrap());
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let told = IndexedFile::open(&path).unwrap_err().to_string();
        assert!(told.contains("cut.mcap") && told.contains("no index"), "{told}");
    }
}
