//! `sinew report` and `sinew explain`: what happened in a recording, as a page and in words.

mod buckets;
mod clock;
mod context;
mod explain;
mod record;
mod spans;
mod statistics;
mod story;

pub(crate) use explain::Explain;

use super::{Outcome, complain};
use clap::Args;
use context::Context;
use miette::{IntoDiagnostic, WrapErr, miette};
use sinew::recording::RecordingError;
use std::io::Write;
use std::path::{Path, PathBuf};
use story::Reader;

/// Arguments of `sinew report`.
#[derive(Debug, Args)]
pub(crate) struct Report {
    /// Recording of `run --record`, `demo --keep` or `plan --out`; one that was cut short is told up to there.
    file: PathBuf,
    /// The page; default: beside the recording, with the ending `.html`. `-` is standard output.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl Report {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let out = self.out.unwrap_or_else(|| self.file.with_extension("html"));
        if out == Path::new("-") {
            super::print_text(&page(&self.file)?)?;
        } else {
            write(&self.file, &out)?;
            complain(format_args!("sinew: the report is {}", out.display()));
        }
        Ok(Outcome::Done)
    }
}

/// Reports a recording in a file, which an older report may be replaced by and nothing else.
///
/// # Errors
/// The recording cannot be read, the page not be written, or what is there is no report.
pub(super) fn write(recording: &Path, out: &Path) -> miette::Result<()> {
    refuse_other(out)?;
    let text = page(recording)?;
    let written = std::fs::File::create(out).and_then(|mut file| file.write_all(text.as_bytes()));
    written.into_diagnostic().wrap_err_with(|| format!("{} cannot be written", out.display()))
}

/// In a line: the error names its file and cause itself.
fn told(error: RecordingError) -> miette::Report {
    miette!("{error}")
}

/// How every report begins, behind its document type.
const MARK: &str = "<meta name=\"generator\" content=\"sinew report\">";

/// Keeps what is there, unless it is a report.
pub(super) fn refuse_other(out: &Path) -> miette::Result<()> {
    use std::io::Read;
    let Ok(file) = std::fs::File::open(out) else { return Ok(()) };
    let mut begin = Vec::new();
    let is_file = file.metadata().is_ok_and(|there| there.is_file());
    let read = file.take(1024).read_to_end(&mut begin);
    match read {
        Ok(length) if is_file && length > 0 && !String::from_utf8_lossy(&begin).contains(MARK) => {
            Err(miette!("{} is there already, and no report; give another name (--out)", out.display()))
        }
        _ => Ok(()),
    }
}

/// The page of a recording: everything is in it, it loads nothing.
fn page(recording: &Path) -> miette::Result<String> {
    let name = || recording.display().to_string();
    let context = Context::read(recording)?;
    let story = Reader::new(&context).read(recording).wrap_err_with(name)?;
    if story.modes.is_empty() {
        return Err(miette!("{}: there is no state in it", recording.display()));
    }
    let scenario = context.fact("scenario").map(|name| format!(", scenario {name}")).unwrap_or_default();
    let title = format!("Arm {}{scenario}", context.arm());
    let data = serde_json::json!({
        "title": title,
        "file": recording.file_name().map_or_else(name, |name| name.to_string_lossy().into_owned()),
        "software": context.software(),
        "facts": context.facts.metadata,
        "attachments": context.facts.attachments,
        "story": story,
    });
    // Within a script element a text must not end it.
    let data = serde_json::to_string(&data).into_diagnostic()?.replace('<', "\\u003c");
    let parts = [
        ("{{title}}", escaped(&format!("sinew report: {title}"))),
        ("{{uplot_css}}", include_str!("view/page/vendor/uplot/dist/uPlot.min.css").to_owned()),
        ("{{css}}", include_str!("report/page.css").to_owned()),
        ("{{uplot}}", include_str!("view/page/vendor/uplot/dist/uPlot.iife.min.js").to_owned()),
        ("{{js}}", include_str!("report/page.js").to_owned()),
        ("{{data}}", data),
    ];
    Ok(filled(include_str!("report/page.html"), &parts))
}

/// A template with its places filled; what is filled in is not looked through.
fn filled(template: &str, parts: &[(&str, String)]) -> String {
    let mut text = String::new();
    let mut rest = template;
    while let Some((at, (mark, part))) =
        parts.iter().filter_map(|part| rest.find(part.0).map(|at| (at, part))).min_by_key(|(at, _)| *at)
    {
        text.push_str(&rest[..at]);
        text.push_str(part);
        rest = &rest[at + mark.len()..];
    }
    text + rest
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_template_is_filled_once() {
        let parts = [("{{a}}", "{{b}}".to_owned()), ("{{b}}", "2".to_owned())];
        assert_eq!(filled("x{{b}}y{{a}}z", &parts), "x2y{{b}}z");
    }

    #[test]
    fn nothing_but_a_report_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("page.html");
        assert!(refuse_other(&out).is_ok());
        std::fs::write(&out, "my own page").unwrap();
        assert!(refuse_other(&out).unwrap_err().to_string().contains("page.html is there already"));
        std::fs::write(&out, format!("<!doctype html>{MARK}")).unwrap();
        assert!(refuse_other(&out).is_ok());
        assert!(include_str!("report/page.html").contains(MARK));
    }
}
