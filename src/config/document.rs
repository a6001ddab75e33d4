//! Files: reading, parsing, and which top-level table stands in which of them.
//!
//! Problems are gathered while a configuration is built from its sections; stand-ins for refused values never leave,
//! because [`read`] returns the result only if no problem was noted.

use super::error::{ConfigError, Place, Problem, SourceText};
use super::reader::{Found, Section};
use super::schema::TableSpec;
use miette::NamedSource;
use std::cell::RefCell;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use toml::Spanned;
use toml::de::DeTable;

/// The open files, and the problems found so far.
pub struct Document<'a> {
    files: Vec<(SourceText, &'a DeTable<'a>)>,
    pub(super) problems: RefCell<Vec<Problem>>,
}

/// Reads files from disk and hands them to `build`.
///
/// # Errors
/// A file cannot be read, or anything that [`read`] refuses.
pub fn read_files<T>(
    paths: &[PathBuf],
    known: &[&'static TableSpec],
    build: impl FnOnce(&Document<'_>) -> T,
) -> Result<T, ConfigError> {
    let mut texts = Vec::with_capacity(paths.len());
    let mut problems = Vec::new();
    for path in paths {
        match std::fs::read_to_string(path) {
            Ok(text) => texts.push((path.display().to_string(), text)),
            Err(error) => problems.push(Problem {
                place: None,
                message: format!("cannot read {}: {error}", path.display()),
                label: String::new(),
                help: "give the path of a readable TOML file".into(),
            }),
        }
    }
    if !problems.is_empty() {
        let names: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
        return Err(ConfigError { subject: names.join(", "), problems });
    }
    read(texts, known, build)
}

/// Parses texts (name, content), refuses top-level tables outside `known` and tables that two texts define, and hands
/// the rest to `build`.
///
/// # Errors
/// Everything wrong that one pass found.
pub fn read<T>(
    texts: Vec<(String, String)>,
    known: &[&'static TableSpec],
    build: impl FnOnce(&Document<'_>) -> T,
) -> Result<T, ConfigError> {
    let subject = texts.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ");
    let sources: Vec<SourceText> =
        texts.into_iter().map(|(name, text)| Arc::new(NamedSource::new(name, text).with_language("TOML"))).collect();
    let mut problems = Vec::new();
    let mut tables = Vec::new();
    for source in &sources {
        let (table, errors) = DeTable::parse_recoverable(source.inner());
        problems.extend(errors.iter().map(|error| Problem {
            place: Some(Place { file: source.clone(), span: error.span().unwrap_or(0..0) }),
            message: format!("not TOML: {}", error.message()),
            label: "here".into(),
            help: "see https://toml.io for the format".into(),
        }));
        tables.push(table);
    }
    // The remains of a text that is not TOML would only produce problems that are none.
    if !problems.is_empty() {
        return Err(ConfigError { subject, problems });
    }
    let document = Document {
        files: sources.iter().cloned().zip(tables.iter().map(Spanned::get_ref)).collect(),
        problems: RefCell::new(problems),
    };
    document.refuse_unknown_tables(known);
    document.refuse_repeated_tables();
    let value = build(&document);
    let problems = document.problems.into_inner();
    if problems.is_empty() { Ok(value) } else { Err(ConfigError { subject, problems }) }
}

impl<'a> Document<'a> {
    /// True if no problem has been noted: the moment for checks across keys, which stand-ins would mislead.
    pub fn is_clean(&self) -> bool {
        self.problems.borrow().is_empty()
    }

    /// Notes a problem that belongs to no place in a file.
    pub fn note(&self, message: String, help: &str) {
        self.problems.borrow_mut().push(Problem { place: None, message, label: String::new(), help: help.into() });
    }

    /// Takes over the problems of files that were read on behalf of this one.
    pub fn note_all(&self, error: ConfigError) {
        self.problems.borrow_mut().extend(error.problems);
    }

    /// True if a file has this top-level table.
    pub fn has(&self, spec: &TableSpec) -> bool {
        self.find(spec.name).is_some()
    }

    /// Opens a top-level table that must be there.
    pub fn table(&self, spec: &'static TableSpec) -> Section<'_> {
        if !self.has(spec) {
            let names: Vec<_> = self.files.iter().map(|(file, _)| file.name()).collect();
            self.note(
                format!(
                    "no table {} in {}",
                    spec.header,
                    if names.is_empty() { "no file".into() } else { names.join(", ") }
                ),
                spec.about,
            );
        }
        self.table_or_defaults(spec)
    }

    /// Opens a top-level table; one that is absent reads as its defaults.
    pub fn table_or_defaults(&self, spec: &'static TableSpec) -> Section<'_> {
        match self.find(spec.name) {
            Some((file, key_span, table)) => {
                Section::open(self, spec, spec.name.to_owned(), Some(Found { table, file, span: key_span }), None)
            }
            None => Section::open(self, spec, spec.name.to_owned(), None, None),
        }
    }

    /// The keys at a file's top level as a section of their own; for files whose root is one table.
    pub fn root(&self, spec: &'static TableSpec) -> Section<'_> {
        let found = self.files.first().map(|(file, table)| Found { table, file, span: 0..0 });
        Section::open(self, spec, String::new(), found, None)
    }

    fn find(&self, name: &str) -> Option<(&SourceText, Range<usize>, &DeTable<'a>)> {
        self.files.iter().find_map(|(file, table)| {
            let (key, value) = table.get_key_value(name)?;
            Some((file, key.span(), value.get_ref().as_table()?))
        })
    }

    fn refuse_unknown_tables(&self, known: &[&'static TableSpec]) {
        // A single spec with an empty name is a file whose root is one table: its section refuses unknown keys.
        if known.iter().any(|spec| spec.name.is_empty()) {
            return;
        }
        for (file, table) in &self.files {
            for (key, value) in *table {
                let name = key.get_ref().as_ref();
                let known_name = known.iter().any(|spec| spec.name == name);
                if known_name && value.get_ref().is_table() {
                    continue;
                }
                let (message, label) = if known_name {
                    (format!("`{name}` must be a table, found {}", value.get_ref().type_str()), "not a table")
                } else {
                    (format!("unknown table or key `{name}`"), "unknown")
                };
                self.problems.borrow_mut().push(Problem {
                    place: Some(Place { file: file.clone(), span: key.span() }),
                    message,
                    label: label.into(),
                    help: suggestion(name, known.iter().map(|spec| spec.name), "tables"),
                });
            }
        }
    }

    fn refuse_repeated_tables(&self) {
        for (later, (file, table)) in self.files.iter().enumerate() {
            for (key, _) in *table {
                let name = key.get_ref().as_ref();
                let first = self.files[..later].iter().find_map(|(file, table)| {
                    let (key, _) = table.get_key_value(name)?;
                    Some(Place { file: file.clone(), span: key.span() })
                });
                if let Some(first) = first {
                    self.problems.borrow_mut().push(Problem {
                        place: Some(Place { file: file.clone(), span: key.span() }),
                        message: format!("[{name}] stands in {} and again in {}", first, file.name()),
                        label: "second definition".into(),
                        help: "a table belongs to one file; leave one of the two out".into(),
                    });
                }
            }
        }
    }
}

/// "did you mean" if a known name is near, and the list of known names.
pub(super) fn suggestion(name: &str, known: impl Iterator<Item = &'static str> + Clone, what: &str) -> String {
    let nearest = known
        .clone()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(likeness, _)| *likeness > 0.8);
    let list = known.collect::<Vec<_>>().join(", ");
    match nearest {
        Some((_, candidate)) => format!("did you mean `{candidate}`? known {what}: {list}"),
        None => format!("known {what}: {list}"),
    }
}
