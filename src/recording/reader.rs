//! Reading: any recording, by its own schemas, complete or cut short.

use super::RecordingError;
use mcap::read::{MessageStream, Options};
use serde_json::{Map, Value};
use std::path::Path;

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

/// Reads all messages of a file; of one that was cut short, those of its complete chunks.
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
    let bytes =
        std::fs::read(path).map_err(|source| RecordingError::File { path: path.display().to_string(), source })?;
    for message in MessageStream::new_with_options(&bytes, Options::IgnoreEndMagic.into())? {
        let message = match message {
            Ok(message) => message,
            // Where a cut file ends.
            Err(mcap::McapError::UnexpectedEof) => break,
            Err(e) => return Err(e.into()),
        };
        let topic = message.channel.topic.clone();
        let schema = message.channel.schema.as_ref().map_or(&[] as &[u8], |s| &s.data);
        let value = decode(&String::from_utf8_lossy(schema), &message.data)
            .map_err(|why| RecordingError::Message { topic: topic.clone(), why })?;
        take(RecordedMessage { topic, time_ns: message.log_time, value });
    }
    Ok(())
}

/// Types of a `ros2msg` schema: name and fields (type, name); the first one has no name.
fn parse(schema: &str) -> Vec<(String, Vec<(String, String)>)> {
    let mut types = vec![(String::new(), Vec::new())];
    for line in schema.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix("MSG: ") {
            types.push((name.to_owned(), Vec::new()));
        } else if let Some((kind, name)) = line.split_once(' ')
            && !line.starts_with('=')
            && !name.contains('=')
            && let Some(last) = types.last_mut()
        {
            last.1.push((kind.to_owned(), name.to_owned()));
        }
    }
    types
}

pub(super) fn decode(schema: &str, data: &[u8]) -> Result<Value, String> {
    let types = parse(schema);
    if data.get(..4) != Some(&[0, 1, 0, 0]) {
        return Err("not little-endian CDR".into());
    }
    let mut cursor = Cursor { data: &data[4..], at: 0, types: &types };
    let value = cursor.fields(&types[0].1)?;
    if cursor.at == cursor.data.len() {
        Ok(value)
    } else {
        Err(format!("{} bytes too many", data.len() - 4 - cursor.at))
    }
}

struct Cursor<'a> {
    data: &'a [u8],
    at: usize,
    types: &'a [(String, Vec<(String, String)>)],
}

impl Cursor<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let start = self.at.next_multiple_of(N);
        let bytes = self.data.get(start..start + N).ok_or("it ends too early")?;
        self.at = start + N;
        bytes.try_into().map_err(|_| "it ends too early".into())
    }

    fn fields(&mut self, fields: &[(String, String)]) -> Result<Value, String> {
        let mut map = Map::new();
        for (kind, name) in fields {
            map.insert(name.clone(), self.field(kind)?);
        }
        Ok(Value::Object(map))
    }

    fn field(&mut self, kind: &str) -> Result<Value, String> {
        let Some((element, length)) = kind.strip_suffix(']').and_then(|k| k.split_once('[')) else {
            return self.one(kind);
        };
        let count = if length.is_empty() {
            u32::from_le_bytes(self.take()?) as usize
        } else {
            length.parse().map_err(|e| format!("{kind}: {e}"))?
        };
        if count > self.data.len() {
            return Err(format!("{kind} of {count} elements"));
        }
        (0..count).map(|_| self.one(element)).collect()
    }

    fn one(&mut self, kind: &str) -> Result<Value, String> {
        Ok(match kind {
            "uint32" => u32::from_le_bytes(self.take()?).into(),
            "uint64" => u64::from_le_bytes(self.take()?).into(),
            "float64" => f64::from_le_bytes(self.take()?).into(),
            "string" => {
                let length = u32::from_le_bytes(self.take()?) as usize;
                let end = self.at.saturating_add(length);
                let bytes = self.data.get(self.at..end).ok_or("a text ends too early")?;
                self.at = end;
                String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into()
            }
            other => {
                let types = self.types;
                let found = types.iter().find(|(name, _)| name == other).ok_or(format!("unknown type {other}"))?;
                self.fields(&found.1)?
            }
        })
    }
}
