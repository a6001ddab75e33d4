//! The arm as a plant: a tension trace in, the tip's path out.
//!
//! The arm of `config/arm.toml` with its elements cut `refinement` times. What is refined is the backbone and the
//! cables' guidance (in the limit the cables follow the curve); the 20 disks keep their mass and place, their rotary
//! inertia is spread over the element before them. With `refinement` 1 this is the arm of the configuration itself.

use crate::{count, cpu_seconds, number};
use serde_json::{Value, json};
use sinew::config::ArmConfig;
use sinew::integrator::{Scheme, Stepper};
use sinew::model::{Arm, State};

/// Most Newton iterations of a step.
const ITERATIONS_MAX: usize = 12;

fn arm(refinement: usize) -> Arm {
    let coarse = ArmConfig::paper();
    let mut fine = coarse.clone();
    for segment in &mut fine.segments {
        segment.elements *= refinement;
    }
    let mut arm = Arm::new(&fine);
    let (mut node, last) = (0, arm.node_count() - 1);
    for (seg, whole) in fine.segments.iter().zip(&coarse.segments) {
        let l = seg.length_m / seg.elements as f64;
        for i in 0..seg.elements {
            let backbone = seg.backbone_mass_kgpm * l * if node == last { 0.5 } else { 1.0 };
            let disk = if (i + 1) % refinement == 0 { whole.disk_mass_kg } else { 0.0 };
            let spread = whole.disk_mass_kg / refinement as f64;
            let (r2, h2, b2) = (seg.disk_radius_m.powi(2), seg.disk_thickness_m.powi(2), seg.backbone_radius_m.powi(2));
            let transverse = spread * (r2 / 4.0 + h2 / 12.0) + backbone * (b2 / 4.0 + l * l / 12.0);
            arm.nodes[node].mass = disk + backbone;
            arm.nodes[node].inertia = [spread * r2 / 2.0 + backbone * b2 / 2.0, transverse, transverse].into();
            node += 1;
        }
    }
    if refinement == 1 {
        assert_eq!(arm, Arm::new(&coarse), "the unrefined arm is that of the configuration");
    }
    arm
}

/// The tension (N) of a cable of segment `s` whose hole lies at `angle`, at time `t`; the same formula as in `tension_trace.py`.
/// A moment that turns around each segment at its own pace, over a co-contraction, eased in during the first second.
fn tension(s: usize, angle: f64, t: f64) -> f64 {
    let pace = std::f64::consts::TAU * (0.25 + 0.15 * s as f64);
    let x = t.min(1.0);
    x * x * (3.0 - 2.0 * x) * (25.0 + 22.0 * (pace * t + angle).sin())
}

/// Everything that the peers need to build the same arm.
pub fn arm_data(request: &Value) -> Value {
    let arm = arm(count(request, "refinement"));
    let v = |v: &[f64]| v.to_vec();
    json!({
        "base_quaternion": v(arm.base_quaternion.as_slice()),
        "nodes": arm.nodes.iter().map(|n| json!({ "mass": n.mass, "inertia": v(n.inertia.as_slice()) })).collect::<Vec<_>>(),
        "elements": arm.elements.iter().map(|e| json!({
            "length": e.length, "connector": e.connector, "stiffness": v(e.stiffness.as_slice()), "damping": e.damping,
        })).collect::<Vec<_>>(),
        "cables": arm.cable_elements.iter().enumerate().map(|(c, range)| {
            let hole = arm.passes.iter().find(|p| p.cable == c).expect("a cable that passes").hole;
            json!({ "hole": v(hole.as_slice()), "elements": [range.start, range.end], "segment": arm.cable_segment[c] })
        }).collect::<Vec<_>>(),
        "backbone_radius": ArmConfig::paper().segments[0].backbone_radius_m,
    })
}

/// Integrates from the straight arm at rest and returns the tip at the samples, with the time that the steps took.
pub fn run(request: &Value) -> Value {
    let (step_s, duration_s) = (number(request, "step"), number(request, "duration"));
    let scheme = Scheme::new(number(request, "rho_inf"));
    let sample = (number(request, "sample") / step_s).round() as usize;
    let arm = arm(count(request, "refinement"));
    let angles: Vec<f64> = (0..arm.cable_count())
        .map(|c| arm.passes.iter().find(|p| p.cable == c).map_or(0.0, |p| p.hole[2].atan2(p.hole[1])))
        .collect();
    let mut stepper = Stepper::new(&arm);
    let mut state = State::at_rest(arm.straight());
    let mut next = state.clone();
    let mut u = vec![0.0; arm.cable_count()];
    let steps = (duration_s / step_s).round() as usize;
    let mut tip = Vec::with_capacity(steps / sample);
    let (mut iterations, mut failed) = (0, Value::Null);
    let begin = cpu_seconds();
    for k in 1..=steps {
        let t = k as f64 * step_s;
        for (c, u) in u.iter_mut().enumerate() {
            *u = tension(arm.cable_segment[c], angles[c], t);
        }
        match stepper.step(&arm, &scheme, step_s, &state, &u, ITERATIONS_MAX, &mut next) {
            Ok(report) if report.converged => iterations += report.iterations,
            Ok(_) => failed = json!(format!("no convergence at {t:.3} s")),
            Err(e) => failed = json!(format!("{e} at {t:.3} s")),
        }
        if !failed.is_null() {
            break;
        }
        std::mem::swap(&mut state, &mut next);
        if k % sample == 0 {
            let r = arm.pose(&state.q, arm.node_count()).0;
            tip.push([r[0], r[1], r[2]]);
        }
    }
    let seconds = cpu_seconds() - begin;
    json!({ "tip": tip, "seconds": seconds, "steps": steps, "iterations": iterations, "failed": failed })
}
