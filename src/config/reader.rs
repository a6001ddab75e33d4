//! One table: from TOML values to checked values, through the registry of [`schema`](super::schema).
//!
//! A [`Section`] is one table. Its getters take a key's name, look its kind, range and default up in the registry and
//! return a value; if the value in the file is not permitted they note a [`Problem`] and return a stand-in, so that one
//! pass finds everything that is wrong. Keys that the registry does not know are refused when a section is opened, known
//! keys that nothing asked for (they belong to another variant) when it is dropped.

pub use super::document::{Document, read, read_files};

use super::document::suggestion;
use super::error::{Place, Problem, SourceText};
use super::schema::{Key, Kind, Length, Presence, TableSpec};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table in a file.
#[derive(Clone)]
pub(super) struct Found<'d> {
    pub(super) table: &'d DeTable<'d>,
    pub(super) file: &'d SourceText,
    pub(super) span: Range<usize>,
}

/// One table of a file, or the defaults in its place.
pub struct Section<'d> {
    document: &'d Document<'d>,
    spec: &'static TableSpec,
    path: String,
    found: Option<Found<'d>>,
    /// Where keys that this table does not have are looked up before their defaults.
    fallback: Option<Rc<Section<'d>>>,
    asked: RefCell<BTreeSet<&'static str>>,
}

/// A value as found: in a file, or the text of a default.
struct Value<'s> {
    value: &'s DeValue<'s>,
    text: &'s str,
    place: Option<Place>,
    /// Path of the table that it stands in: this one's, or the one's behind it.
    owner: &'s str,
}

impl Value<'_> {
    fn path_of(&self, name: &str) -> String {
        join(self.owner, name)
    }
}

impl<'d> Section<'d> {
    pub(super) fn open(
        document: &'d Document<'d>,
        spec: &'static TableSpec,
        path: String,
        found: Option<Found<'d>>,
        fallback: Option<Rc<Section<'d>>>,
    ) -> Self {
        let section = Self { document, spec, path, found, fallback, asked: RefCell::default() };
        if let Some(found) = &section.found {
            for (key, _) in found.table {
                let name = key.get_ref().as_ref();
                if spec.key(name).is_none() {
                    section.push(
                        Some(Place { file: found.file.clone(), span: key.span() }),
                        format!("unknown key `{}`", section.path_of(name)),
                        "unknown key".into(),
                        suggestion(name, spec.keys.iter().map(|key| key.name), "keys"),
                    );
                }
            }
        }
        section
    }

    /// The whole path of a key, for messages.
    pub fn path_of(&self, name: &str) -> String {
        join(&self.path, name)
    }

    /// True if no problem has been noted in the whole document.
    pub fn is_clean(&self) -> bool {
        self.document.is_clean()
    }

    /// True if the file itself gives the key, in this table or in the one behind it.
    pub fn has(&self, name: &str) -> bool {
        self.has_own(name) || self.fallback.as_ref().is_some_and(|fallback| fallback.has(name))
    }

    /// True if the file gives the key in this table.
    pub fn has_own(&self, name: &str) -> bool {
        self.found.as_ref().is_some_and(|found| found.table.contains_key(name))
    }

    /// True if the table stands in a file.
    pub fn is_present(&self) -> bool {
        self.found.is_some()
    }

    /// Lets a key of the table behind this one stand unread, because this one chose otherwise.
    pub fn ignore_behind(&self, name: &'static str) {
        if let Some(fallback) = &self.fallback {
            fallback.asked.borrow_mut().insert(name);
        }
    }

    /// Directory of the file that holds this table; relative paths start there.
    pub fn directory(&self) -> PathBuf {
        let name = self.found.as_ref().map_or("", |found| found.file.name());
        Path::new(name).parent().map(Path::to_path_buf).unwrap_or_default()
    }

    /// Notes a problem at a key that the registry's range cannot express.
    pub fn refuse(&self, name: &str, message: impl std::fmt::Display, help: &str) {
        if !self.has_own(name)
            && let Some(fallback) = self.fallback.as_ref().filter(|fallback| fallback.has(name) || !self.is_present())
        {
            return fallback.refuse(name, message, help);
        }
        let value = self.found.as_ref().and_then(|found| Some((found, found.table.get(name)?)));
        let is_tables = |value: &DeValue<'_>| match value {
            DeValue::Table(_) => true,
            DeValue::Array(array) => array.iter().any(|entry| entry.get_ref().is_table()),
            _ => false,
        };
        let text = match value {
            Some((found, value)) if !is_tables(value.get_ref()) => {
                format!(" = {}", shorten(self.value_in(found, value).text))
            }
            _ => String::new(),
        };
        let place = self.found.as_ref().map(|found| Place {
            file: found.file.clone(),
            span: value.map_or(found.span.clone(), |(_, value)| value.span()),
        });
        self.push(place, format!("`{}`{text}: {message}", self.path_of(name)), "refused".into(), help.into());
    }

    /// A number.
    pub fn float(&self, name: &'static str) -> f64 {
        self.float_opt(name).unwrap_or(f64::NAN)
    }

    /// A number that may be absent.
    pub fn float_opt(&self, name: &'static str) -> Option<f64> {
        self.with(name, |key, found| {
            let Kind::Float(range) = key.kind else { return self.misread(key) };
            let Some(number) = number(found.value) else { return self.wrong_type(key, &found) };
            if !range.contains(number) {
                return self.out_of_range(key, &found);
            }
            Some(number)
        })
    }

    /// An integer, as the registry's range permits.
    pub fn integer(&self, name: &'static str) -> i64 {
        self.integer_opt(name).unwrap_or_else(|| match self.spec.key(name).map(|key| key.kind) {
            Some(Kind::Integer(min, _)) => min,
            _ => 0,
        })
    }

    /// An integer that may be absent.
    pub fn integer_opt(&self, name: &'static str) -> Option<i64> {
        self.with(name, |key, found| {
            let Kind::Integer(min, max) = key.kind else { return self.misread(key) };
            let Some(integer) = found.value.as_integer() else { return self.wrong_type(key, &found) };
            match i64::from_str_radix(integer.as_str(), integer.radix()) {
                Ok(integer) if (min..=max).contains(&integer) => Some(integer),
                _ => self.out_of_range(key, &found),
            }
        })
    }

    /// An integer whose range in the registry is not negative.
    pub fn count(&self, name: &'static str) -> usize {
        usize::try_from(self.integer(name)).unwrap_or(0)
    }

    /// The same, and it may be absent.
    pub fn count_opt(&self, name: &'static str) -> Option<usize> {
        self.integer_opt(name).and_then(|integer| usize::try_from(integer).ok())
    }

    /// A switch.
    pub fn boolean(&self, name: &'static str) -> bool {
        self.with(name, |key, found| match found.value.as_bool() {
            Some(value) => Some(value),
            None => self.wrong_type(key, &found),
        })
        .unwrap_or(false)
    }

    /// A string.
    pub fn text(&self, name: &'static str) -> String {
        self.text_opt(name).unwrap_or_default()
    }

    /// A string that may be absent.
    pub fn text_opt(&self, name: &'static str) -> Option<String> {
        self.with(name, |key, found| {
            let Kind::Text(most) = key.kind else { return self.misread(key) };
            let Some(text) = found.value.as_str() else { return self.wrong_type(key, &found) };
            if text.is_empty() || text.len() > most {
                return self.out_of_range(key, &found);
            }
            Some(text.to_owned())
        })
    }

    /// One of the strings that the registry lists.
    pub fn choice(&self, name: &'static str) -> &'static str {
        self.choice_opt(name).unwrap_or("")
    }

    /// The same, and it may be absent.
    pub fn choice_opt(&self, name: &'static str) -> Option<&'static str> {
        self.with(name, |key, found| {
            let Kind::Choice(names) = key.kind else { return self.misread(key) };
            let Some(text) = found.value.as_str() else { return self.wrong_type(key, &found) };
            match names.iter().find(|name| **name == text) {
                Some(name) => Some(*name),
                None => {
                    self.push(
                        found.place.clone(),
                        format!("`{}` = {} is not a permitted value", found.path_of(key.name), found.text),
                        "found".into(),
                        suggestion(text, names.iter().copied(), "values"),
                    );
                    None
                }
            }
        })
    }

    /// An array of numbers.
    pub fn floats(&self, name: &'static str) -> Vec<f64> {
        self.floats_opt(name).unwrap_or_default()
    }

    /// An array of numbers that may be absent.
    pub fn floats_opt(&self, name: &'static str) -> Option<Vec<f64>> {
        self.with(name, |key, found| {
            let Kind::Floats(length, range) = key.kind else { return self.misread(key) };
            let values = self.numbers(key, &found, length)?;
            if let Some(bad) = values.iter().position(|value| !range.contains(*value)) {
                return self.entry_out_of_range(key, &found, bad);
            }
            Some(values)
        })
    }

    /// An array of different integers.
    pub fn integers(&self, name: &'static str) -> Vec<i64> {
        self.with(name, |key, found| {
            let Kind::Integers(length, min, max) = key.kind else { return self.misread(key) };
            let Some(array) = found.value.as_array() else { return self.wrong_type(key, &found) };
            let mut values = Vec::with_capacity(array.len());
            for (index, entry) in array.iter().enumerate() {
                let Some(integer) = entry.get_ref().as_integer() else { return self.wrong_type(key, &found) };
                match i64::from_str_radix(integer.as_str(), integer.radix()) {
                    Ok(value) if (min..=max).contains(&value) && !values.contains(&value) => values.push(value),
                    _ => return self.entry_out_of_range(key, &found, index),
                }
            }
            if !length.contains(values.len()) {
                return self.wrong_length(key, &found, values.len(), length);
            }
            Some(values)
        })
        .unwrap_or_default()
    }

    /// An array of strings that may be absent.
    pub fn texts_opt(&self, name: &'static str) -> Option<Vec<String>> {
        self.with(name, |key, found| {
            let Kind::Texts(length, most) = key.kind else { return self.misread(key) };
            let Some(array) = found.value.as_array() else { return self.wrong_type(key, &found) };
            let mut values = Vec::with_capacity(array.len());
            for (index, entry) in array.iter().enumerate() {
                let Some(text) = entry.get_ref().as_str() else { return self.wrong_type(key, &found) };
                if text.is_empty() || text.len() > most {
                    return self.entry_out_of_range(key, &found, index);
                }
                values.push(text.to_owned());
            }
            if !length.contains(values.len()) {
                return self.wrong_length(key, &found, values.len(), length);
            }
            Some(values)
        })
    }

    /// An array of exactly `N` numbers.
    pub fn vector<const N: usize>(&self, name: &'static str) -> [f64; N] {
        self.vector_opt(name).unwrap_or([f64::NAN; N])
    }

    /// An array of exactly `N` numbers that may be absent.
    pub fn vector_opt<const N: usize>(&self, name: &'static str) -> Option<[f64; N]> {
        self.floats_opt(name).and_then(|values| values.try_into().ok())
    }

    /// A unit quaternion.
    pub fn quaternion(&self, name: &'static str) -> [f64; 4] {
        self.with(name, |key, found| {
            let Kind::Quaternion = key.kind else { return self.misread(key) };
            let values = self.numbers(key, &found, Length::Exactly(4))?;
            let norm = values.iter().map(|value| value * value).sum::<f64>().sqrt();
            // The inequality |norm - 1| <= 1e-6: seven digits in a file are enough, a forgotten entry is not.
            if !(norm - 1.0).abs().le(&1e-6) {
                return self.out_of_range(key, &found);
            }
            Some([values[0] / norm, values[1] / norm, values[2] / norm, values[3] / norm])
        })
        .unwrap_or([1.0, 0.0, 0.0, 0.0])
    }

    /// An array of points.
    pub fn points(&self, name: &'static str) -> Vec<[f64; 3]> {
        self.with(name, |key, found| {
            let Kind::Points(length) = key.kind else { return self.misread(key) };
            let Some(rows) = found.value.as_array() else { return self.wrong_type(key, &found) };
            let mut points = Vec::with_capacity(rows.len());
            for (index, row) in rows.iter().enumerate() {
                let point: Vec<f64> = match row.get_ref().as_array() {
                    Some(row) => row.iter().filter_map(|value| number(value.get_ref())).collect(),
                    None => Vec::new(),
                };
                match <[f64; 3]>::try_from(point) {
                    Ok(point) if point.iter().all(|x| x.is_finite()) => points.push(point),
                    _ => return self.entry_out_of_range(key, &found, index),
                }
            }
            if !length.contains(points.len()) {
                return self.wrong_length(key, &found, points.len(), length);
            }
            Some(points)
        })
        .unwrap_or_default()
    }

    /// A table below this one; one that is absent reads as its defaults.
    pub fn table(&self, name: &'static str) -> Section<'d> {
        let key = self.asked_key(name);
        let spec = match key.map(|key| key.kind) {
            Some(Kind::Table(spec)) => spec,
            _ => self.spec,
        };
        let found = self.found.as_ref().and_then(|found| {
            let (key_text, value) = found.table.get_key_value(name)?;
            match value.get_ref().as_table() {
                Some(table) => Some(Found { table, file: found.file, span: key_text.span() }),
                None => {
                    if let Some(key) = key {
                        self.wrong_type::<()>(key, &self.value_in(found, value));
                    }
                    None
                }
            }
        });
        if found.is_none()
            && let Some(key) = key
            && key.presence == Presence::Required
            && !self.has_own(name)
        {
            self.missing(key);
        }
        Section::open(self.document, spec, self.path_of(name), found, None)
    }

    /// The tables of an array of tables, this table's or the one's behind it; empty if it is absent. Each looks keys that it lacks up in `fallback`.
    pub fn tables(&self, name: &'static str, fallback: Option<&Rc<Section<'d>>>) -> Vec<Section<'d>> {
        let Some(key) = self.asked_key(name) else { return Vec::new() };
        let Kind::Tables(length, spec) = key.kind else { return Vec::new() };
        if let Some(behind) = self.fallback.as_ref().filter(|behind| !self.has_own(name) && behind.has(name)) {
            return behind.tables(name, fallback);
        }
        let Some((found, value)) = self.found.as_ref().and_then(|found| Some((found, found.table.get(name)?))) else {
            if key.presence == Presence::Required {
                self.missing(key);
            }
            return Vec::new();
        };
        let whole = self.value_in(found, value);
        let Some(array) =
            value.get_ref().as_array().filter(|array| array.iter().all(|entry| entry.get_ref().is_table()))
        else {
            self.wrong_type::<()>(key, &whole);
            return Vec::new();
        };
        if !length.contains(array.len()) {
            self.wrong_length::<()>(key, &whole, array.len(), length);
        }
        let open = |(index, entry): (usize, &'d Spanned<DeValue<'d>>)| {
            let table = entry.get_ref().as_table()?;
            let place = Found { table, file: found.file, span: entry.span() };
            Some(Section::open(
                self.document,
                spec,
                format!("{}[{index}]", self.path_of(name)),
                Some(place),
                fallback.cloned(),
            ))
        };
        array.iter().enumerate().filter_map(open).collect()
    }

    /// A table of `spec` that no file holds: every key comes from `fallback` or its default.
    pub fn absent(&self, spec: &'static TableSpec, path: String, fallback: Option<&Rc<Section<'d>>>) -> Section<'d> {
        Section::open(self.document, spec, path, None, fallback.cloned())
    }

    fn asked_key(&self, name: &'static str) -> Option<&'static Key> {
        self.asked.borrow_mut().insert(name);
        if let Some(fallback) = &self.fallback {
            fallback.asked.borrow_mut().insert(name);
        }
        let key = self.spec.key(name);
        debug_assert!(key.is_some(), "{} is read from {} but not registered", name, self.spec.header);
        key
    }

    fn value_in<'s>(&'s self, found: &Found<'s>, value: &'s Spanned<DeValue<'s>>) -> Value<'s> {
        Value {
            value: value.get_ref(),
            text: found.file.inner().get(value.span()).unwrap_or(""),
            place: Some(Place { file: found.file.clone(), span: value.span() }),
            owner: &self.path,
        }
    }

    /// Runs `check` on the key's value: this table's, the one's behind it, or the default.
    fn with<T>(&self, name: &'static str, check: impl FnOnce(&'static Key, Value<'_>) -> Option<T>) -> Option<T> {
        let key = self.asked_key(name)?;
        if let Some(found) = &self.found
            && let Some(value) = found.table.get(name)
        {
            return check(key, self.value_in(found, value));
        }
        if let Some(fallback) = &self.fallback
            && fallback.has(name)
        {
            return fallback.with(name, check);
        }
        match key.presence {
            Presence::Optional(_) => None,
            Presence::Default(text) => match DeValue::parse(text) {
                Ok(value) => check(key, Value { value: value.get_ref(), text, place: None, owner: &self.path }),
                Err(_) => self.misread(key),
            },
            Presence::Required => {
                self.missing(key);
                None
            }
        }
    }

    fn numbers(&self, key: &Key, found: &Value<'_>, length: Length) -> Option<Vec<f64>> {
        let Some(array) = found.value.as_array() else { return self.wrong_type(key, found) };
        let values: Vec<f64> = array.iter().filter_map(|value| number(value.get_ref())).collect();
        if values.len() != array.len() {
            return self.wrong_type(key, found);
        }
        if !length.contains(values.len()) {
            return self.wrong_length(key, found, values.len(), length);
        }
        if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
            return self.entry_out_of_range(key, found, bad);
        }
        Some(values)
    }

    fn push(&self, place: Option<Place>, message: String, label: String, help: String) {
        let mut problems = self.document.problems.borrow_mut();
        let problem = Problem { place, message, label, help };
        // A table behind several others is read once for each of them.
        let known = |other: &Problem| {
            other.message == problem.message
                && other.place.as_ref().map(|place| place.span.clone())
                    == problem.place.as_ref().map(|p| p.span.clone())
        };
        if !problems.iter().any(known) {
            problems.push(problem);
        }
    }

    fn missing(&self, key: &Key) {
        if self.found.is_none()
            && let Some(fallback) = self.fallback.as_ref().filter(|fallback| fallback.is_present())
        {
            return fallback.missing(key);
        }
        // Inside a table that is missing altogether, which has been reported as such.
        if self.found.is_none() && !self.document.is_clean() {
            return;
        }
        let place = self.found.as_ref().map(|found| Place { file: found.file.clone(), span: found.span.clone() });
        self.push(
            place,
            format!("`{}` is missing", self.path_of(key.name)),
            format!("needs `{}`", key.name),
            format!("permitted: {}; {}", key.permitted(), key.meaning),
        );
    }

    fn wrong_type<T>(&self, key: &Key, found: &Value<'_>) -> Option<T> {
        self.push(
            found.place.clone(),
            format!("`{}` = {} is of the wrong type", found.path_of(key.name), shorten(found.text)),
            format!("found {}", found.value.type_str()),
            format!("permitted: {}; {}", key.permitted(), key.meaning),
        );
        None
    }

    fn out_of_range<T>(&self, key: &Key, found: &Value<'_>) -> Option<T> {
        self.push(
            found.place.clone(),
            format!("`{}` = {} is outside its range", found.path_of(key.name), shorten(found.text)),
            "out of range".into(),
            format!("permitted: {}; {}", key.permitted(), key.meaning),
        );
        None
    }

    fn entry_out_of_range<T>(&self, key: &Key, found: &Value<'_>, index: usize) -> Option<T> {
        let entry = found.value.as_array().and_then(|array| array.get(index));
        let place = match (&found.place, entry) {
            (Some(place), Some(entry)) => Some(Place { file: place.file.clone(), span: entry.span() }),
            _ => None,
        };
        let text = place.as_ref().and_then(|place| place.file.inner().get(place.span.clone())).unwrap_or(found.text);
        self.push(
            place.clone(),
            format!("`{}[{index}]` = {} is outside its range", found.path_of(key.name), shorten(text)),
            "out of range".into(),
            format!("permitted: {}; {}", key.permitted(), key.meaning),
        );
        None
    }

    fn wrong_length<T>(&self, key: &Key, found: &Value<'_>, entries: usize, length: Length) -> Option<T> {
        self.push(
            found.place.clone(),
            format!("`{}` = {} has {entries} entries, not {length}", found.path_of(key.name), shorten(found.text)),
            format!("{entries} entries"),
            format!("permitted: {}; {}", key.permitted(), key.meaning),
        );
        None
    }

    /// The code reads a key as something else than it is registered as: found by the first test that reads it.
    fn misread<T>(&self, key: &Key) -> Option<T> {
        debug_assert!(false, "{} of {} is read as another kind than it is registered", key.name, self.spec.header);
        self.push(None, format!("`{}` is registered wrongly", self.path_of(key.name)), String::new(), String::new());
        None
    }
}

impl Drop for Section<'_> {
    fn drop(&mut self) {
        let Some(found) = &self.found else { return };
        // Whatever is already wrong may be the reason why a key was not asked for.
        if !self.document.is_clean() || std::thread::panicking() {
            return;
        }
        let asked = self.asked.borrow();
        for (key, value) in found.table {
            let name = key.get_ref().as_ref();
            if self.spec.key(name).is_some() && !asked.contains(name) {
                self.push(
                    Some(Place { file: found.file.clone(), span: key.span() }),
                    format!(
                        "`{}` = {} does not apply here",
                        self.path_of(name),
                        shorten(self.value_in(found, value).text)
                    ),
                    "does not apply".into(),
                    format!(
                        "another key of {} decides whether it is used; remove it or change that key",
                        self.spec.header
                    ),
                );
            }
        }
    }
}

fn join(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") }
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|value| value as f64)
        }
        _ => None,
    }
}

/// A value as a message quotes it: one line, at most 60 characters.
fn shorten(text: &str) -> String {
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if line.chars().count() <= 60 { line } else { line.chars().take(57).chain("...".chars()).collect() }
}
