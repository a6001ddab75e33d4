//! The table of design section 6.

use crate::closed_loop::{Case, Outcome};
use crate::{Arguments, Kind};

/// Prints one column per observer, as Markdown; over several seeds the worst of each figure.
pub fn print(arguments: &Arguments, done: &[(Kind, Case, u64, Outcome)]) {
    let scenario = if arguments.scenario == crate::scenario::ScenarioName::Tip { "tip" } else { "shape" };
    println!(
        "\n{scenario} example, period {} ms, plant of the study, seeds {} to {}, worst of all seeds",
        1e3 * arguments.period,
        arguments.first_seed,
        arguments.first_seed + arguments.seeds - 1
    );
    let mut rows: Vec<(String, Vec<String>)> = Vec::new();
    for (index, kind) in arguments.observers.iter().enumerate() {
        let mut row = |label: String, value: Option<String>| {
            let at = rows.iter().position(|(l, _)| *l == label).unwrap_or_else(|| {
                rows.push((label, Vec::new()));
                rows.len() - 1
            });
            rows[at].1.resize(index, "-".into());
            rows[at].1.push(value.unwrap_or_else(|| "-".into()));
        };
        let worst = |case: Case, f: &dyn Fn(&Outcome) -> f64| {
            done.iter()
                .filter(|d| d.0 == *kind && d.1 == case)
                .map(|d| if d.3.failed.is_some() { f64::INFINITY } else { f(&d.3) })
                .reduce(f64::max)
        };
        let mm = |case: Case, f: &dyn Fn(&Outcome) -> f64| worst(case, f).map(|x| format!("{:.2}", 1e3 * x));
        let pair =
            |case: Case| Some(format!("{} / {} mm", mm(case, &|o| o.tip_error[0])?, mm(case, &|o| o.tip_error[1])?));
        let clearance = 1e3 * arguments.clearance;
        if arguments.scenario == crate::scenario::ScenarioName::Tip {
            row("holding the start pose, tip error".into(), mm(Case::Hold, &|o| o.tip_error[2]).map(|x| x + " mm"));
            row("no obstacles: tip error mean / max".into(), pair(Case::Free));
            row(
                format!("obstacles, barrier {}, clearance {clearance} mm: tip error mean / max", arguments.gamma),
                pair(Case::Obstacles),
            );
        }
        let least = |case: Case, f: &dyn Fn(&Outcome) -> f64| worst(case, &|o| -f(o)).map(|x| -1e3 * x);
        let show = |x: Option<f64>| x.map(|x| format!("{x:.2} mm"));
        row(
            "same: smallest true distance to a ball's centre (radius 100 mm), at the points".into(),
            show(least(Case::Obstacles, &|o| o.distance_points.0).map(|x| x + 100.0)),
        );
        row(
            "same: smallest true surface distance, along the whole arm".into(),
            show(least(Case::Obstacles, &|o| o.distance_arm.0)),
        );
        row("same: tip estimate's error, max".into(), mm(Case::Obstacles, &|o| o.estimate_error).map(|x| x + " mm"));
        row(
            "same: quaternion error, max".into(),
            worst(Case::Obstacles, &|o| o.quaternion_error).map(|x| format!("{x:.4}")),
        );
        row(
            "same: tension roughness, rms per tick".into(),
            worst(Case::Obstacles, &|o| o.roughness).map(|x| format!("{x:.3} N")),
        );
        if arguments.scenario == crate::scenario::ScenarioName::Tip {
            row("obstacles, clearance 10 mm: tip error mean / max".into(), pair(Case::Wide));
        }
        row(
            "clearance 10 mm: smallest true surface distance, along the whole arm".into(),
            show(least(Case::Wide, &|o| o.distance_arm.0)),
        );
        if arguments.scenario == crate::scenario::ScenarioName::Shape {
            row(
                "same: curvature error at the end".into(),
                worst(Case::Obstacles, &|o| o.curvature_error).map(|x| format!("{x:.4} 1/m")),
            );
        } else {
            row("capstan friction mu = 0.1, no lead: tip error mean / max".into(), pair(Case::Friction));
            row(format!("same, made up for with mu = {}", arguments.compensation), pair(Case::Compensated));
            row(
                format!("{} of latency, compensated: tip error mean / max", ticks(arguments.latency)),
                pair(Case::Latency),
            );
        }
        row(
            "half of (44) held, curvature error".into(),
            worst(Case::Half, &|o| o.curvature_error).map(|x| format!("{x:.4} 1/m")),
        );
    }
    let titles = arguments.observers.iter().map(|kind| kind.title(arguments));
    println!("\n| | {} |", titles.collect::<Vec<_>>().join(" | "));
    println!("|---|{}", "---|".repeat(arguments.observers.len()));
    for (label, values) in &rows {
        println!("| {label} | {} |", values.join(" | "));
    }
    println!();
    for (kind, case, seed, outcome) in done {
        if let Some(why) = &outcome.failed {
            println!("FAILED {kind:?} {case:?} seed {seed}: {why}");
        }
    }
    let (mut observer, mut planner) = (std::time::Duration::ZERO, std::time::Duration::ZERO);
    for d in done {
        observer = observer.max(d.3.observer_time[0]);
        planner = planner.max(d.3.planner_time[0]);
    }
    println!("time per tick, largest mean of a run: observer {observer:.1?}, planner {planner:.1?}");
}

fn ticks(count: usize) -> String {
    if count == 1 { "one tick".into() } else { format!("{count} ticks") }
}
