//! The arm as a picture: at rest, and where its tip reaches in a plane.

use miette::{IntoDiagnostic, WrapErr, miette};
use nalgebra::Vector3;
use plotters::coord::Shift;
use plotters::prelude::*;
use sinew::config::ArmConfig;
use sinew::model::{Arm, State};
use sinew::report::Slice;
use std::path::{Path, PathBuf};

/// Width of both panels together, and height (px).
const SIZE: (u32, u32) = (1040, 540);
/// What a panel shows, over the arm's length: across, and from above the base to below the tip.
const ACROSS: f64 = 0.85;
const ABOVE: f64 = 0.55;
const BELOW: f64 = 1.15;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Where the picture goes: a file that ends in `.svg`, or one of the arm's name in a folder.
pub(super) fn file(path: &Path, arm: &str) -> PathBuf {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("svg")) {
        path.to_owned()
    } else {
        path.join(format!("{arm}.svg"))
    }
}

/// Draws the arm that rests in `state`, or straight without, and the slice.
pub(super) fn draw(
    path: &Path,
    config: &ArmConfig,
    arm: &Arm,
    state: Option<&State>,
    slice: &Slice,
) -> miette::Result<()> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).into_diagnostic().wrap_err_with(|| folder.display().to_string())?;
    }
    let mut text = String::new();
    // What goes wrong in drawing to a string is a defect; writing is told with the file's name.
    picture(&mut text, config, arm, state, slice).map_err(|error| miette!("{}: {error}", path.display()))?;
    std::fs::write(path, text).into_diagnostic().wrap_err_with(|| path.display().to_string())
}

fn picture(
    text: &mut String,
    config: &ArmConfig,
    arm: &Arm,
    state: Option<&State>,
    slice: &Slice,
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let (left, right) = root.split_horizontally(SIZE.0 / 2);
    side_view(&left, config, arm, state)?;
    reach(&right, config, slice)?;
    root.present()?;
    drop((left, right));
    Ok(())
}

/// Along and across the straight arm, in the plane in which bends about local y lead.
fn axes(config: &ArmConfig, arm: &Arm) -> [Vector3<f64>; 2] {
    let at = |curvature: f64| {
        let k: Vec<f64> = (0..2 * config.segments.len()).map(|i| if i % 2 == 0 { curvature } else { 0.0 }).collect();
        arm.pose(&arm.bent(&k), arm.node_count()).0
    };
    let along = (at(0.0) - arm.base_position).normalize();
    let bent = at(0.1 / config.length_m()) - at(0.0);
    [along, (bent - along * bent.dot(&along)).normalize()]
}

fn side_view(
    area: &Area<'_>,
    config: &ArmConfig,
    arm: &Arm,
    state: Option<&State>,
) -> Result<(), Box<dyn std::error::Error>> {
    let length = config.length_m();
    let title = format!("{}, {length:.4} m: at rest", config.name);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(48)
        .build_cartesian_2d(-ACROSS * length..ACROSS * length, BELOW * length..-ABOVE * length)?;
    chart.configure_mesh().x_desc("across (m)").y_desc("along (m)").light_line_style(BLACK.mix(0.05)).draw()?;
    let [along, across] = axes(config, arm);
    let flat = |p: Vector3<f64>| ((p - arm.base_position).dot(&across), (p - arm.base_position).dot(&along));
    let nodes = arm.node_count();
    let mut draw = |q: &[f64], colour: RGBAColor, disks: bool| -> Result<(), Box<dyn std::error::Error>> {
        let (mut r, mut t) = (vec![Vector3::zeros(); nodes + 1], vec![Vector3::zeros(); nodes + 1]);
        arm.frames_into(q, &mut r, &mut t);
        chart.draw_series(LineSeries::new(r.iter().map(|p| flat(*p)), colour.stroke_width(2)))?;
        if !disks {
            return Ok(());
        }
        for (i, node) in arm.nodes.iter().enumerate() {
            let radius = config.segments[node.segment].disk_radius_m;
            let (at, tangent) = (flat(r[i + 1]), t[i + 1]);
            // A disk from the side: across its tangent.
            let (x, y) = (tangent.dot(&along), -tangent.dot(&across));
            let size = x.hypot(y).max(1e-9);
            let (x, y) = (radius * x / size, radius * y / size);
            let shade = Palette99::pick(node.segment).to_rgba();
            let line = vec![(at.0 - x, at.1 - y), (at.0 + x, at.1 + y)];
            chart.draw_series(std::iter::once(PathElement::new(line, shade.stroke_width(3))))?;
        }
        Ok(())
    };
    draw(&arm.straight(), BLACK.mix(0.25), state.is_none())?;
    if let Some(state) = state {
        draw(&state.q, BLACK.mix(0.9), true)?;
    }
    Ok(())
}

fn reach(area: &Area<'_>, config: &ArmConfig, slice: &Slice) -> Result<(), Box<dyn std::error::Error>> {
    let length = config.length_m();
    let mut chart = ChartBuilder::on(area)
        .caption("where the tip rests, bent in one plane", ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(48)
        .build_cartesian_2d(-ACROSS * length..ACROSS * length, BELOW * length..-ABOVE * length)?;
    chart.configure_mesh().x_desc("across (m)").y_desc("along (m)").light_line_style(BLACK.mix(0.05)).draw()?;
    let dots = slice.tips.iter().map(|[along, across]| Circle::new((*across, *along), 2, BLUE.mix(0.35).filled()));
    chart.draw_series(dots)?;
    chart.draw_series(std::iter::once(Circle::new((0.0, 0.0), 4, BLACK.filled())))?;
    Ok(())
}
