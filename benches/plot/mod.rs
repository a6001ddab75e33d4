//! What the benches leave in `results/`: tables, lines of text, and line charts with logarithmic axes as SVG.
#![allow(dead_code)] // each bench uses its own part

use plotters::prelude::*;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;

/// One line of a chart.
pub struct Line {
    pub name: String,
    pub points: Vec<(f64, f64)>,
}

/// `benches/results/<name>`.
pub fn results(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/results").join(name)
}

/// Commit, date, compiler and machine in a line, as `benches/machine.py` describes them for all benches: asked for at the
/// start of a bench, whose own load comes after.
///
/// # Errors
/// There is no python3: a result of which nobody knows where it comes from is not worth writing.
pub fn machine() -> std::io::Result<String> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/machine.py");
    let output = Command::new("python3").arg(script).arg("--line").output()?;
    let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    if !output.status.success() || text.is_empty() {
        return Err(std::io::Error::other("benches/machine.py failed"));
    }
    Ok(if cfg!(debug_assertions) { format!("{text}; with debug assertions, so no measurement") } else { text })
}

/// Writes lines below a comment that says where they come from.
pub fn write(name: &str, machine: &str, lines: &[String]) -> std::io::Result<()> {
    let path = results(name);
    let bench = env!("CARGO_CRATE_NAME");
    std::fs::write(&path, format!("# cargo bench --bench {bench}, {machine}\n{}\n", lines.join("\n")))?;
    println!("{}", path.display());
    Ok(())
}

/// The same for rows below their header.
pub fn write_csv(name: &str, machine: &str, header: &str, rows: &[String]) -> std::io::Result<()> {
    let lines: Vec<String> = std::iter::once(header.to_owned()).chain(rows.iter().cloned()).collect();
    write(name, machine, &lines)
}

/// A chart with both axes logarithmic.
pub fn chart(name: &str, title: &str, x: &str, y: &str, lines: &[Line]) -> Result<(), Box<dyn Error>> {
    let path = results(name);
    let all = || lines.iter().flat_map(|l| l.points.iter().copied());
    let range = |of: &dyn Fn((f64, f64)) -> f64| {
        let (low, high) = all().map(of).fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
        low / 1.3..high * 1.3
    };
    let root = SVGBackend::new(&path, (860, 520)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(range(&|p| p.0).log_scale(), range(&|p| p.1).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(x)
        .y_desc(y)
        .label_style(("sans-serif", 13))
        .light_line_style(BLACK.mix(0.05))
        .x_label_formatter(&number)
        .y_label_formatter(&number)
        .draw()?;
    for (k, line) in lines.iter().enumerate() {
        let colour = Palette99::pick(k).to_rgba();
        chart
            .draw_series(LineSeries::new(line.points.iter().copied(), colour.stroke_width(2)).point_size(3))?
            .label(line.name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.2))
        .label_font(("sans-serif", 13))
        .draw()?;
    root.present()?;
    println!("{}", path.display());
    Ok(())
}

fn number(v: &f64) -> String {
    if (0.01..100_000.0).contains(v) { format!("{v}") } else { format!("{v:.0e}") }
}
