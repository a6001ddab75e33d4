//! Why a configuration was refused: every problem with file, line, key, value and permitted range.

use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource, SourceCode};
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

/// A file's name and text, shared by the problems found in it.
pub type SourceText = Arc<NamedSource<String>>;

/// Where in a file a problem is.
#[derive(Debug, Clone)]
pub struct Place {
    /// The file.
    pub file: SourceText,
    /// Bytes of the text that are wrong.
    pub span: Range<usize>,
}

impl Place {
    /// Line and column, from 1.
    pub fn line_column(&self) -> (usize, usize) {
        let text = self.file.inner();
        let before = text.get(..self.span.start.min(text.len())).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (line, column) = self.line_column();
        write!(f, "{}:{line}:{column}", self.file.name())
    }
}

/// One thing wrong in a file.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Where; `None` if the problem is what no file holds.
    pub place: Option<Place>,
    /// What is wrong, with the key's whole path and the value found.
    pub message: String,
    /// Words beside the marked text.
    pub label: String,
    /// What would be permitted, or what to do.
    pub help: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Problem {}

impl Diagnostic for Problem {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        (!self.help.is_empty()).then(|| Box::new(&self.help) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.place.as_ref().map(|place| &*place.file as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let place = self.place.as_ref()?;
        let label = (!self.label.is_empty()).then(|| self.label.clone());
        Some(Box::new(std::iter::once(LabeledSpan::new(label, place.span.start, place.span.len()))))
    }
}

/// A configuration that was refused, with everything wrong in it that could be found in one pass.
#[derive(Debug, Clone)]
pub struct ConfigError {
    /// What was being read, e.g. `arm.toml, controller.toml`.
    pub subject: String,
    /// At least one.
    pub problems: Vec<Problem>,
}

/// Problems that are shown with their source; nobody reads more, and each takes its time to draw.
const SHOWN_MAX: usize = 50;

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.problems.len();
        write!(f, "configuration refused: {count} problem{} in {}", if count == 1 { "" } else { "s" }, self.subject)?;
        if count > SHOWN_MAX { write!(f, "; the first {SHOWN_MAX} are:") } else { Ok(()) }
    }
}

impl std::error::Error for ConfigError {}

impl Diagnostic for ConfigError {
    fn related<'a>(&'a self) -> Option<Box<dyn Iterator<Item = &'a dyn Diagnostic> + 'a>> {
        Some(Box::new(self.problems.iter().take(SHOWN_MAX).map(|problem| problem as &dyn Diagnostic)))
    }
}

impl ConfigError {
    /// The whole report with source snippets, without colour, for logs and tests. `main` renders the error itself.
    pub fn report(&self) -> String {
        let mut text = String::new();
        let handler = GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor()).with_width(160);
        if handler.render_report(&mut text, self).is_err() {
            text = self.to_string();
        }
        text
    }

    /// One line per problem: `file:line:column: message; help`.
    pub fn lines(&self) -> impl Iterator<Item = String> + '_ {
        self.problems.iter().map(|problem| match &problem.place {
            Some(place) => format!("{place}: {}; {}", problem.message, problem.help),
            None => format!("{}; {}", problem.message, problem.help),
        })
    }
}
