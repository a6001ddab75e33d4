//! CDR (XCDR1, little-endian) and `ros2msg` schemas, both from one visit of the fields: they cannot disagree.

/// What a message's fields are shown to.
pub(super) trait Sink: Sized {
    fn u32(&mut self, name: &str, value: u32);
    fn u64(&mut self, name: &str, value: u64);
    fn f64(&mut self, name: &str, value: f64);
    fn text(&mut self, name: &str, value: &str);
    /// Array of fixed length.
    fn array(&mut self, name: &str, values: &[f64]);
    /// Sequence of numbers.
    fn numbers(&mut self, name: &str, values: &[f64]);
    fn integers(&mut self, name: &str, values: &[u64]);
    /// Sequence of messages of another type.
    fn messages<T: Fields>(&mut self, name: &str, values: &[T]);
    /// One message of another type.
    fn message<T: Fields>(&mut self, name: &str, value: &T);
    /// Names of a code's numbers; only schemas carry them.
    fn constants(&mut self, _prefix: &str, _names: &[(&str, u32)]) {}
}

/// A message type.
pub(super) trait Fields {
    /// Name without package.
    const NAME: &'static str;

    /// Any value of the type, for its schema.
    fn sample() -> Self;

    /// Shows every field, in order.
    fn visit(&self, sink: &mut impl Sink);
}

/// Encodes a message.
pub(super) fn encode<T: Fields>(message: &T) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode_into(message, &mut bytes);
    bytes
}

/// Encodes a message in place of what a buffer holds; allocates only where its capacity is too small.
pub(super) fn encode_into<T: Fields>(message: &T, bytes: &mut Vec<u8>) {
    bytes.clear();
    bytes.extend_from_slice(&[0, 1, 0, 0]);
    let mut cdr = Cdr { bytes: std::mem::take(bytes) };
    message.visit(&mut cdr);
    *bytes = cdr.bytes;
}

/// Schema of a message type, with the types that it contains.
pub(super) fn schema<T: Fields>() -> String {
    let mut schema = Schema::default();
    T::sample().visit(&mut schema);
    let mut text = schema.text;
    for (name, part) in schema.parts {
        text += &format!("{}\nMSG: sinew/{name}\n{part}", "=".repeat(80));
    }
    text
}

struct Cdr {
    bytes: Vec<u8>,
}

impl Cdr {
    /// Bytes are aligned to their size, counted from behind the four bytes of the encapsulation.
    fn align(&mut self, size: usize) {
        while !(self.bytes.len() - 4).is_multiple_of(size) {
            self.bytes.push(0);
        }
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        self.align(N);
        self.bytes.extend_from_slice(&bytes);
    }

    fn count(&mut self, count: usize) {
        self.put((count as u32).to_le_bytes());
    }
}

impl Sink for Cdr {
    fn u32(&mut self, _: &str, value: u32) {
        self.put(value.to_le_bytes());
    }

    fn u64(&mut self, _: &str, value: u64) {
        self.put(value.to_le_bytes());
    }

    fn f64(&mut self, _: &str, value: f64) {
        self.put(value.to_le_bytes());
    }

    fn text(&mut self, _: &str, value: &str) {
        self.count(value.len() + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(0);
    }

    fn array(&mut self, _: &str, values: &[f64]) {
        for v in values {
            self.put(v.to_le_bytes());
        }
    }

    fn numbers(&mut self, name: &str, values: &[f64]) {
        self.count(values.len());
        self.array(name, values);
    }

    fn integers(&mut self, _: &str, values: &[u64]) {
        self.count(values.len());
        for v in values {
            self.put(v.to_le_bytes());
        }
    }

    fn messages<T: Fields>(&mut self, _: &str, values: &[T]) {
        self.count(values.len());
        for value in values {
            value.visit(self);
        }
    }

    fn message<T: Fields>(&mut self, _: &str, value: &T) {
        value.visit(self);
    }
}

#[derive(Default)]
struct Schema {
    text: String,
    parts: Vec<(&'static str, String)>,
}

impl Schema {
    fn line(&mut self, kind: &str, name: &str) {
        self.text += &format!("{kind} {name}\n");
    }

    fn part<T: Fields>(&mut self) {
        if self.parts.iter().any(|(name, _)| *name == T::NAME) {
            return;
        }
        let mut part = Schema::default();
        T::sample().visit(&mut part);
        self.parts.push((T::NAME, part.text));
        for (name, text) in part.parts {
            if !self.parts.iter().any(|(known, _)| *known == name) {
                self.parts.push((name, text));
            }
        }
    }
}

impl Sink for Schema {
    fn u32(&mut self, name: &str, _: u32) {
        self.line("uint32", name);
    }

    fn u64(&mut self, name: &str, _: u64) {
        self.line("uint64", name);
    }

    fn f64(&mut self, name: &str, _: f64) {
        self.line("float64", name);
    }

    fn text(&mut self, name: &str, _: &str) {
        self.line("string", name);
    }

    fn array(&mut self, name: &str, values: &[f64]) {
        self.line(&format!("float64[{}]", values.len()), name);
    }

    fn numbers(&mut self, name: &str, _: &[f64]) {
        self.line("float64[]", name);
    }

    fn integers(&mut self, name: &str, _: &[u64]) {
        self.line("uint64[]", name);
    }

    fn messages<T: Fields>(&mut self, name: &str, _: &[T]) {
        self.part::<T>();
        self.line(&format!("sinew/{}[]", T::NAME), name);
    }

    fn message<T: Fields>(&mut self, name: &str, _: &T) {
        self.part::<T>();
        self.line(&format!("sinew/{}", T::NAME), name);
    }

    fn constants(&mut self, prefix: &str, names: &[(&str, u32)]) {
        for (name, number) in names {
            let name: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
            self.text += &format!("uint32 {prefix}_{}={number}\n", name.to_uppercase());
        }
    }
}
