//! The registry of keys: what may stand in a file, in one place.
//!
//! The reader looks every key up here, `config/README.md` is generated from here, and a test compares the two, so that
//! a key cannot be read without being documented, and its range and default cannot differ between code and page.

use std::fmt::{self, Write as _};

/// Range of a number. Values that are not finite are outside every range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// True if the lower end itself is not permitted.
    pub min_open: bool,
}

impl Range {
    /// Any finite number.
    pub const ANY: Self = Self { min: f64::NEG_INFINITY, max: f64::INFINITY, min_open: false };

    /// `min <= x <= max`.
    pub const fn closed(min: f64, max: f64) -> Self {
        Self { min, max, min_open: false }
    }

    /// `min < x <= max`.
    pub const fn above(min: f64, max: f64) -> Self {
        Self { min, max, min_open: true }
    }

    /// True if `x` is finite and inside.
    pub fn contains(&self, x: f64) -> bool {
        x.is_finite() && x <= self.max && if self.min_open { x > self.min } else { x >= self.min }
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.min == f64::NEG_INFINITY, self.max == f64::INFINITY) {
            (true, true) => f.write_str("any finite number"),
            (true, false) => write!(f, "<= {}", Number(self.max)),
            (false, true) => write!(f, "{} {}", if self.min_open { ">" } else { ">=" }, Number(self.min)),
            (false, false) if self.min_open => write!(f, "> {} and <= {}", Number(self.min), Number(self.max)),
            (false, false) => write!(f, "{} to {}", Number(self.min), Number(self.max)),
        }
    }
}

/// Prints `1e20` as people write it and 0.001 as it stands.
struct Number(f64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if size != 0.0 && !(1e-4..1e5).contains(&size) { write!(f, "{:e}", self.0) } else { write!(f, "{}", self.0) }
    }
}

/// Number of entries of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Length {
    /// Exactly so many.
    Exactly(usize),
    /// From the first to the second number, both included.
    Between(usize, usize),
}

impl Length {
    /// True if `n` entries are permitted.
    pub fn contains(&self, n: usize) -> bool {
        match *self {
            Self::Exactly(length) => n == length,
            Self::Between(least, most) => (least..=most).contains(&n),
        }
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Exactly(length) => write!(f, "{length}"),
            Self::Between(least, most) => write!(f, "{least} to {most}"),
        }
    }
}

/// What a key's value must be.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// A number; an integer will do.
    Float(Range),
    /// An integer, both ends included.
    Integer(i64, i64),
    /// `true` or `false`.
    Bool,
    /// A string of 1 to so many bytes.
    Text(usize),
    /// One of these strings.
    Choice(&'static [&'static str]),
    /// An array of numbers.
    Floats(Length, Range),
    /// An array of different integers, each with both ends included.
    Integers(Length, i64, i64),
    /// An array of strings of 1 to so many bytes.
    Texts(Length, usize),
    /// A unit quaternion `[w, x, y, z]`; its norm may be off by 1e-6 and is made exact.
    Quaternion,
    /// An array of points `[x, y, z]`.
    Points(Length),
    /// A table.
    Table(&'static TableSpec),
    /// An array of so many tables.
    Tables(Length, &'static TableSpec),
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Float(range) => write!(f, "{range}"),
            Self::Integer(min, i64::MAX) => write!(f, "integer >= {min}"),
            Self::Integer(min, max) => write!(f, "integer {min} to {max}"),
            Self::Bool => f.write_str("true, false"),
            Self::Text(most) => write!(f, "string of 1 to {most} bytes"),
            Self::Choice(names) => {
                for (i, name) in names.iter().enumerate() {
                    write!(f, "{}\"{name}\"", if i == 0 { "" } else { ", " })?;
                }
                Ok(())
            }
            Self::Floats(length, range) => write!(f, "{length} numbers, each {range}"),
            Self::Integers(length, min, max) => write!(f, "{length} different integers, each {min} to {max}"),
            Self::Texts(length, most) => write!(f, "{length} strings of 1 to {most} bytes"),
            Self::Quaternion => f.write_str("[w, x, y, z] of norm 1"),
            Self::Points(length) => write!(f, "{length} points [x, y, z]"),
            Self::Table(_) => f.write_str("table"),
            Self::Tables(length, _) => write!(f, "{length} tables"),
        }
    }
}

/// What holds when a key is absent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Presence {
    /// The file is refused.
    Required,
    /// This TOML text is read in its place, through the same checks.
    Default(&'static str),
    /// It stays unset, which means this.
    Optional(&'static str),
}

/// One key.
#[derive(Debug, Clone, Copy)]
pub struct Key {
    /// Name, with its unit as suffix.
    pub name: &'static str,
    /// Permitted values.
    pub kind: Kind,
    /// Unit in words, empty for none.
    pub unit: &'static str,
    /// Default.
    pub presence: Presence,
    /// Meaning.
    pub meaning: &'static str,
}

impl Key {
    /// A key that must be given.
    pub const fn required(name: &'static str, kind: Kind, unit: &'static str, meaning: &'static str) -> Self {
        Self { name, kind, unit, presence: Presence::Required, meaning }
    }

    /// A key with a default (TOML text).
    pub const fn default(
        name: &'static str,
        kind: Kind,
        unit: &'static str,
        value: &'static str,
        meaning: &'static str,
    ) -> Self {
        Self { name, kind, unit, presence: Presence::Default(value), meaning }
    }

    /// A key that may be left out; `absent` says what that means.
    pub const fn optional(
        name: &'static str,
        kind: Kind,
        unit: &'static str,
        absent: &'static str,
        meaning: &'static str,
    ) -> Self {
        Self { name, kind, unit, presence: Presence::Optional(absent), meaning }
    }

    /// Permitted values with the unit, as messages show them.
    pub fn permitted(&self) -> String {
        if self.unit.is_empty() { self.kind.to_string() } else { format!("{} {}", self.kind, self.unit) }
    }
}

/// One table of a file.
#[derive(Debug)]
pub struct TableSpec {
    /// Its header as it stands in a file, e.g. `[[arm.segments]]`.
    pub header: &'static str,
    /// Its name in its parent.
    pub name: &'static str,
    /// What it is for.
    pub about: &'static str,
    /// Its keys.
    pub keys: &'static [Key],
}

impl TableSpec {
    /// The key of this name.
    pub fn key(&self, name: &str) -> Option<&'static Key> {
        self.keys.iter().find(|key| key.name == name)
    }

    /// Reference of this table and those below it in Markdown, as `config/README.md` holds it.
    pub fn markdown(&self) -> String {
        let mut page = format!("### `{}`\n\n{}\n\n", self.header, self.about);
        page.push_str("| key | unit | permitted | default | meaning |\n|---|---|---|---|---|\n");
        for key in self.keys {
            let default = match key.presence {
                Presence::Required => "required".to_owned(),
                Presence::Default(value) => format!("`{value}`"),
                Presence::Optional(absent) => absent.to_owned(),
            };
            let unit = if key.unit.is_empty() { "-" } else { key.unit };
            // Writing to a string cannot fail.
            let _ = writeln!(page, "| `{}` | {unit} | {} | {default} | {} |", key.name, key.kind, key.meaning);
        }
        page.push('\n');
        for key in self.keys {
            if let Kind::Table(spec) | Kind::Tables(_, spec) = key.kind {
                page.push_str(&spec.markdown());
            }
        }
        page
    }

    /// Header and key of every key in this table and below it.
    pub fn walk(&'static self, visit: &mut dyn FnMut(&'static TableSpec, &'static Key)) {
        for key in self.keys {
            visit(self, key);
            if let Kind::Table(spec) | Kind::Tables(_, spec) = key.kind {
                spec.walk(visit);
            }
        }
    }
}
