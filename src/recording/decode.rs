//! CDR back to values, by the `ros2msg` schema in the file: a `serde` deserialiser, so that a reader takes what it needs into
//! types of its own and passes over the rest, without a tree in between.

use serde::de::value::StrDeserializer;
use serde::de::{DeserializeSeed, Error as _, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, forward_to_deserialize_any};

type Error = serde::de::value::Error;

/// Type of one value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    U32,
    U64,
    F64,
    Text,
    /// A message, by its place among the types.
    Message(usize),
}

impl Kind {
    /// Bytes of a number; `None` for what has no fixed length.
    const fn size(self) -> Option<usize> {
        match self {
            Self::U32 => Some(4),
            Self::U64 | Self::F64 => Some(8),
            Self::Text | Self::Message(_) => None,
        }
    }
}

/// How many values of its kind a field has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Count {
    One,
    Array(usize),
    Sequence,
}

#[derive(Debug)]
struct Field {
    name: String,
    kind: Kind,
    count: Count,
}

/// Decodes the messages of a schema.
#[derive(Debug)]
pub struct Decoder {
    /// Fields of each type; the first is the message's own.
    types: Vec<Vec<Field>>,
}

impl Decoder {
    /// Of a schema.
    ///
    /// # Errors
    /// In words: a type that the schema does not describe.
    pub fn new(schema: &str) -> Result<Self, String> {
        let mut names = vec![String::new()];
        let mut lines: Vec<Vec<(&str, &str)>> = vec![Vec::new()];
        for line in schema.lines().map(str::trim) {
            if let Some(name) = line.strip_prefix("MSG: ") {
                names.push(name.to_owned());
                lines.push(Vec::new());
            } else if let Some((kind, name)) = line.split_once(' ')
                && !line.starts_with('=')
                && !name.contains('=')
                && let Some(last) = lines.last_mut()
            {
                last.push((kind, name));
            }
        }
        let field = |(kind, name): &(&str, &str)| {
            let (element, count) = match kind.strip_suffix(']').and_then(|k| k.split_once('[')) {
                None => (*kind, Count::One),
                Some((element, "")) => (element, Count::Sequence),
                Some((element, length)) => (element, Count::Array(length.parse().map_err(|e| format!("{kind}: {e}"))?)),
            };
            let kind = match element {
                "uint32" => Kind::U32,
                "uint64" => Kind::U64,
                "float64" => Kind::F64,
                "string" => Kind::Text,
                other => {
                    let place = names.iter().skip(1).position(|name| name == other);
                    Kind::Message(place.ok_or_else(|| format!("unknown type {other}"))? + 1)
                }
            };
            Ok(Field { name: (*name).to_owned(), kind, count })
        };
        let types = lines.iter().map(|fields| fields.iter().map(field).collect()).collect::<Result<_, String>>()?;
        Ok(Self { types })
    }

    /// A message.
    ///
    /// # Errors
    /// In words: it ends too early, has bytes too many, or is no `T`.
    pub fn decode<'de, T: Deserialize<'de>>(&self, data: &'de [u8]) -> Result<T, String> {
        if data.get(..4) != Some(&[0, 1, 0, 0]) {
            return Err("not little-endian CDR".into());
        }
        let mut cursor = Cursor { data: &data[4..], at: 0, types: &self.types };
        let value = T::deserialize(Item { cursor: &mut cursor, kind: Kind::Message(0), count: Count::One, depth: 0 });
        let value = value.map_err(|e| e.to_string())?;
        if cursor.at == cursor.data.len() {
            Ok(value)
        } else {
            Err(format!("{} bytes too many", cursor.data.len() - cursor.at))
        }
    }
}

/// Types that contain each other deeper than any message does.
const DEPTH_MAX: u32 = 16;

struct Cursor<'a, 'de> {
    data: &'de [u8],
    at: usize,
    types: &'a [Vec<Field>],
}

impl<'de> Cursor<'_, 'de> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let start = self.at.next_multiple_of(N);
        let bytes = self.data.get(start..start.saturating_add(N)).ok_or_else(early)?;
        self.at = start + N;
        bytes.try_into().map_err(|_| early())
    }

    fn text(&mut self) -> Result<&'de str, Error> {
        let length = u32::from_le_bytes(self.take()?) as usize;
        let end = self.at.saturating_add(length);
        let bytes = self.data.get(self.at..end).ok_or_else(early)?;
        self.at = end;
        std::str::from_utf8(bytes.strip_suffix(&[0]).unwrap_or(bytes)).map_err(Error::custom)
    }

    /// Number of values of a field.
    fn count(&mut self, count: Count) -> Result<usize, Error> {
        let count = match count {
            Count::One => return Ok(1),
            Count::Array(count) => count,
            Count::Sequence => u32::from_le_bytes(self.take()?) as usize,
        };
        if count > self.data.len() { Err(early()) } else { Ok(count) }
    }

    fn skip(&mut self, kind: Kind, count: Count, depth: u32) -> Result<(), Error> {
        let count = self.count(count)?;
        match kind {
            _ if count == 0 => {}
            Kind::Text => (0..count).try_for_each(|_| self.text().map(drop))?,
            Kind::Message(_) if depth == DEPTH_MAX => return Err(Error::custom("types contain themselves")),
            Kind::Message(place) => {
                let types = self.types;
                for _ in 0..count {
                    types[place].iter().try_for_each(|field| self.skip(field.kind, field.count, depth + 1))?;
                }
            }
            Kind::U32 | Kind::U64 | Kind::F64 => {
                let size = kind.size().unwrap_or(1);
                let end = self.at.next_multiple_of(size) + count * size;
                if end > self.data.len() {
                    return Err(early());
                }
                self.at = end;
            }
        }
        Ok(())
    }
}

fn early() -> Error {
    Error::custom("it ends too early")
}

/// A field's value, or one of its values.
struct Item<'c, 'a, 'de> {
    cursor: &'c mut Cursor<'a, 'de>,
    kind: Kind,
    count: Count,
    depth: u32,
}

impl<'de> Deserializer<'de> for Item<'_, '_, 'de> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let Self { cursor, kind, count, depth } = self;
        if count != Count::One {
            let left = cursor.count(count)?;
            return visitor.visit_seq(Items { cursor, kind, left, depth });
        }
        match kind {
            Kind::U32 => visitor.visit_u32(u32::from_le_bytes(cursor.take()?)),
            Kind::U64 => visitor.visit_u64(u64::from_le_bytes(cursor.take()?)),
            Kind::F64 => visitor.visit_f64(f64::from_le_bytes(cursor.take()?)),
            Kind::Text => visitor.visit_borrowed_str(cursor.text()?),
            Kind::Message(_) if depth == DEPTH_MAX => Err(Error::custom("types contain themselves")),
            Kind::Message(place) => {
                let fields = cursor.types[place].iter();
                visitor.visit_map(Fields { cursor, fields, value: None, depth: depth + 1 })
            }
        }
    }

    /// A number that is none counts as absent.
    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        if self.kind == Kind::F64 && self.count == Count::One {
            let number = f64::from_le_bytes(self.cursor.take()?);
            return match number.is_finite() {
                true => visitor.visit_some(IntoDeserializer::<Error>::into_deserializer(number)),
                false => visitor.visit_none(),
            };
        }
        visitor.visit_some(self)
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.cursor.skip(self.kind, self.count, self.depth)?;
        visitor.visit_unit()
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct seq tuple
        tuple_struct map struct enum identifier
    }
}

struct Items<'c, 'a, 'de> {
    cursor: &'c mut Cursor<'a, 'de>,
    kind: Kind,
    left: usize,
    depth: u32,
}

impl<'de> SeqAccess<'de> for Items<'_, '_, 'de> {
    type Error = Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Error> {
        let Some(left) = self.left.checked_sub(1) else { return Ok(None) };
        self.left = left;
        seed.deserialize(Item { cursor: self.cursor, kind: self.kind, count: Count::One, depth: self.depth }).map(Some)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left)
    }
}

struct Fields<'c, 'a, 'de> {
    cursor: &'c mut Cursor<'a, 'de>,
    fields: std::slice::Iter<'a, Field>,
    value: Option<&'a Field>,
    depth: u32,
}

impl<'de> MapAccess<'de> for Fields<'_, '_, 'de> {
    type Error = Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Error> {
        self.value = self.fields.next();
        let Some(field) = self.value else { return Ok(None) };
        seed.deserialize(StrDeserializer::<Error>::new(&field.name)).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Error> {
        let field = self.value.take().ok_or_else(|| Error::custom("a value without its key"))?;
        seed.deserialize(Item { cursor: self.cursor, kind: field.kind, count: field.count, depth: self.depth })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    const SCHEMA: &str = "uint32 KIND_BALL=1\nuint32 kind\nstring name\nfloat64[2] pair\nuint64[] many\ntest/Part[] parts\n\
                          float64 last\n================\nMSG: test/Part\nuint32 a\nfloat64 b\n";

    /// A message of the schema by hand.
    fn message() -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        let align = |bytes: &mut Vec<u8>, size: usize| bytes.resize((bytes.len() - 4).next_multiple_of(size) + 4, 0);
        bytes.extend(7u32.to_le_bytes());
        bytes.extend(3u32.to_le_bytes());
        bytes.extend(b"ab\0");
        align(&mut bytes, 8);
        bytes.extend(1.5f64.to_le_bytes());
        bytes.extend(f64::NAN.to_le_bytes());
        bytes.extend(2u32.to_le_bytes());
        align(&mut bytes, 8);
        bytes.extend(11u64.to_le_bytes());
        bytes.extend(12u64.to_le_bytes());
        bytes.extend(1u32.to_le_bytes());
        bytes.extend(5u32.to_le_bytes());
        bytes.extend(2.5f64.to_le_bytes());
        bytes.extend(f64::INFINITY.to_le_bytes());
        bytes
    }

    #[test]
    fn a_message_by_hand_is_read_as_a_tree_and_in_parts() {
        let decoder = Decoder::new(SCHEMA).unwrap();
        let bytes = message();
        let tree: Value = decoder.decode(&bytes).unwrap();
        let expected = json!({
            "kind": 7, "name": "ab", "pair": [1.5, null], "many": [11, 12], "parts": [{ "a": 5, "b": 2.5 }], "last": null,
        });
        assert_eq!(tree, expected);
        #[derive(Debug, PartialEq, Deserialize)]
        struct Some {
            pair: [f64; 2],
            last: Option<f64>,
        }
        let some: Some = decoder.decode(&bytes).unwrap();
        assert!(some.pair[0] == 1.5 && some.pair[1].is_nan() && some.last.is_none());
    }

    #[test]
    fn what_is_cut_or_described_otherwise_is_an_error() {
        let decoder = Decoder::new(SCHEMA).unwrap();
        let bytes = message();
        for length in 0..bytes.len() {
            assert!(decoder.decode::<Value>(&bytes[..length]).is_err(), "{length}");
            assert!(decoder.decode::<serde::de::IgnoredAny>(&bytes[..length]).is_err(), "{length}");
        }
        let long = [&bytes[..], &[0]].concat();
        assert!(decoder.decode::<Value>(&long).unwrap_err().contains("too many"));
        assert!(Decoder::new("test/Nothing x\n").unwrap_err().contains("test/Nothing"));
        let endless = Decoder::new("test/A x\n====\nMSG: test/A\ntest/A x\n").unwrap();
        assert!(endless.decode::<Value>(&[0, 1, 0, 0]).is_err());
    }
}
