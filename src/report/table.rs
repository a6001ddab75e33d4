//! Tables for people.

use super::collect::INSIDE_M;
use super::summary::{Count, Percentiles, Summary};
use crate::config::PublishedFigure;
use comfy_table::{ContentArrangement, Table, presets};
use serde_json::Value;

/// Least width (columns) to which tables are fitted.
const WIDTH_MIN: u16 = 40;

/// What stands for no value.
const NONE: &str = "-";

/// An empty table with a header, in the style of all reports.
pub fn plain_table(header: &[&str]) -> Table {
    let mut t = Table::new();
    t.load_style(presets::UTF8_FULL_CONDENSED).set_content_arrangement(ContentArrangement::Dynamic);
    // A terminal that does not know its width says 0 or 1: then lines are as long as they are.
    if t.width().is_some_and(|width| width < WIDTH_MIN) {
        t.set_content_arrangement(ContentArrangement::Disabled);
    }
    t.set_header(header.iter().copied());
    t
}

/// What the run achieved, in lines of name and value.
pub fn summary_table(s: &Summary) -> String {
    let mut t = plain_table(&["quantity", "value"]);
    let mut row = |name: &str, value: String| {
        t.add_row([name.to_owned(), value]);
    };
    let count = |c: Count| format!("{:.2} mean, {} max", c.mean, c.max);
    let time = |p: Percentiles| format!("{:.0} / {:.0} / {:.0} us", p.p50, p.p99, p.max);
    row("steps", format!("{} of {} s, lookahead {} s, seed {}", s.ticks, s.period_s, s.lookahead_s, s.seed));
    // What a run has no value for is left out.
    if let Some(n) = s.not_converged {
        row("steps not converged", n.to_string());
    }
    if let Some(n) = s.relaxed.filter(|n| *n > 0) {
        row("steps with distances relaxed", n.to_string());
    }
    if let Some(n) = s.truncated.filter(|n| *n > 0) {
        row("steps with pairs left out", n.to_string());
    }
    if let Some(c) = s.newton.safe {
        row("Newton iterations, safe", count(c));
    }
    if let Some(c) = s.newton.warning {
        row("Newton iterations, warning", count(c));
    }
    for o in &s.obstacles {
        row(
            &format!("{}: least surface distance, whole arm", o.id),
            nearest(o.surface_distance_min_m, o.at_s, &o.inside_s),
        );
        row(
            &format!("{}: at the paper's points", o.id),
            nearest(o.points.surface_distance_min_m, o.points.at_s, &o.points.inside_s),
        );
    }
    if s.ticks > 0 {
        row("tensions", format!("{:.3} to {:.3} N", s.tension_n.min, s.tension_n.max));
    }
    for (cable, at) in &s.tension_n.saturated {
        row(&format!("cable {cable} at its bound"), format!("from {} s, {} steps", at.first_s, at.ticks));
    }
    if let Some(e) = &s.tip_error_m {
        row("tip error, largest", format!("{:.2} mm", 1e3 * e.norm_max));
        row("tip error, mean", format!("{:.2} mm", 1e3 * e.norm_mean));
    }
    if let Some(q) = s.quaternion_error_max {
        row("quaternion error, largest", format!("{q:.2e}"));
    }
    if let Some(k) = s.curvature_error_final_1pm {
        row("curvature error at the end", format!("{k:.4} 1/m"));
    }
    if let Some(p) = s.time_us.safe {
        row("time per step, safe (p50/p99/max)", time(p));
    }
    if let Some(p) = s.time_us.warning {
        row("time per step, warning (p50/p99/max)", time(p));
    }
    if let Some(swarm) = s.swarm {
        let rate = |rate| format!(", {:.2} million per second of the steps that searched", rate / 1e6);
        row(
            "swarm evaluations",
            swarm.evaluations.to_string() + &swarm.evaluations_per_s.map_or_else(String::new, rate),
        );
    }
    if let Some(cycle) = s.time_us.cycle {
        row("whole cycle (p50/p99/max)", time(cycle));
    }
    if let Some(l) = &s.loop_ {
        row("deadlines missed", format!("{} ({} left out, {} overran)", l.missed, l.left_out, l.overran));
        row("wake-up late (p50/p99/max)", l.wakeup_us.map_or("lockstep".into(), time));
    }
    row("faults", if s.faults.is_empty() { "none".into() } else { s.faults.join("; ") });
    t.to_string()
}

/// The paper's and the reference's figures with ours beside them; empty where the run has none of them.
pub fn figures_table(figures: &[PublishedFigure], summary: &Summary) -> String {
    let json = serde_json::to_value(summary).unwrap_or(Value::Null);
    let mut t = plain_table(&["quantity", "paper", "reference", "this run"]);
    // A loop counts no iterations: what a run has no value for is left out here, too.
    for (f, shown) in figures.iter().map(|f| (f, show(&json, &f.field))).filter(|(_, shown)| shown != NONE) {
        t.add_row([f.quantity.clone(), f.paper.clone(), f.reference.clone(), shown]);
    }
    if t.is_empty() { String::new() } else { t.to_string() }
}

/// Value(s) at the path(s) `field`, several separated by `, `.
fn show(json: &Value, field: &str) -> String {
    let one = |path: &str| {
        let value = path.split('.').try_fold(json, |v, key| match key.parse::<usize>() {
            Ok(i) if v.is_array() => v.get(i),
            _ => v.get(key),
        });
        match value {
            Some(v @ Value::Number(_)) => format!("{}{}", short(v), unit(path)),
            Some(v @ Value::Array(a)) if !a.is_empty() => format!("{}{}", short(v), unit(path)),
            other => other.map_or_else(|| NONE.into(), short),
        }
    };
    field.split(',').map(|p| one(p.trim())).collect::<Vec<_>>().join("; ")
}

/// The unit that a path's names say, the last one first.
fn unit(path: &str) -> &'static str {
    const UNITS: [(&str, &str); 4] = [("_1pm", " 1/m"), ("_m", " m"), ("_n", " N"), ("_s", " s")];
    let of = |key: &str| UNITS.iter().find(|(suffix, _)| key.ends_with(suffix)).map(|(_, unit)| *unit);
    path.rsplit('.').find_map(of).unwrap_or_default()
}

fn short(v: &Value) -> String {
    match v {
        Value::Null => NONE.into(),
        Value::Number(n) if n.is_f64() => {
            let x = n.as_f64().unwrap_or(f64::NAN);
            if x != 0.0 && (x.abs() < 1e-2 || x.abs() >= 1e4) {
                return format!("{x:.2e}");
            }
            format!("{x:.4}").trim_end_matches('0').trim_end_matches('.').to_owned()
        }
        Value::Number(n) => n.to_string(),
        Value::String(s) => s.clone(),
        Value::Bool(b) => b.to_string(),
        Value::Array(a) if a.is_empty() => "never".into(),
        Value::Array(a) => format!("[{}]", a.iter().map(short).collect::<Vec<_>>().join(", ")),
        Value::Object(o) if o.is_empty() => "none".into(),
        Value::Object(o) => o.iter().map(|(k, v)| format!("{k} {}", short(v))).collect::<Vec<_>>().join(", "),
    }
}

/// A least distance; a run that ended before it began has none.
fn nearest(distance_m: f64, at_s: f64, inside_s: &[[f64; 2]]) -> String {
    if distance_m.is_finite() {
        format!("{} at {at_s} s{}", millimetres(distance_m), inside(inside_s))
    } else {
        "-".into()
    }
}

/// A distance whose sign is that of the judgement: one that touches is not below zero, and a contact is not zero.
fn millimetres(distance_m: f64) -> String {
    match 1e3 * distance_m {
        _ if (-INSIDE_M..0.0).contains(&distance_m) => "0.00 mm".to_owned(),
        mm if mm < 0.0 && mm > -0.01 => format!("{mm:.4} mm"),
        mm => format!("{mm:.2} mm"),
    }
}

fn inside(intervals: &[[f64; 2]]) -> String {
    if intervals.is_empty() {
        return String::new();
    }
    let list: Vec<_> = intervals.iter().map(|[a, b]| format!("[{a}, {b}]")).collect();
    format!(", inside {} s", list.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_distance_below_zero_is_a_contact_and_nothing_else() {
        assert_eq!(nearest(-3e-7, 1.0, &[]), "0.00 mm at 1 s");
        assert_eq!(nearest(-4e-6, 1.0, &[[1.0, 1.1]]), "-0.0040 mm at 1 s, inside [1, 1.1] s");
        assert_eq!(nearest(-2.5e-3, 1.0, &[]), "-2.50 mm at 1 s");
        assert_eq!(nearest(8e-3, 1.0, &[]), "8.00 mm at 1 s");
    }

    #[test]
    fn a_figure_is_shown_with_the_unit_of_its_name() {
        let run = json!({
            "tip_error_m": {"min": [-6.69e-3, 0.25]}, "newton": {"safe": {"mean": 2.717}}, "at": [{"inside_s": []}],
            "curvature_error_final_1pm": 0.0592, "tension_n": {"saturated": {"3,3": {"ticks": 349}}}, "none": null,
        });
        let shown = |field| show(&run, field);
        assert_eq!(shown("tip_error_m.min"), "[-6.69e-3, 0.25] m");
        assert_eq!(shown("newton.safe.mean, newton.missing"), "2.717; -");
        assert_eq!(shown("at.0.inside_s"), "never");
        assert_eq!(shown("curvature_error_final_1pm"), "0.0592 1/m");
        assert_eq!(shown("tension_n.saturated"), "3,3 ticks 349");
        assert_eq!(shown("none"), "-");
    }
}
