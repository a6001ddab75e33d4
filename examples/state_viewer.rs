//! Shows what the controller publishes, a few times per second.
//!
//! `cargo run --example state_viewer -- --arm paper`
#![allow(clippy::print_stdout)]

use clap::Parser;
use sinew::ipc::payload::{PlannerBranch, PlannerStatus, SourceHealth, State, SupervisorState};
use sinew::ipc::{Client, Domain, IpcError};
use std::time::Duration;

/// Shows what the controller publishes.
#[derive(Parser)]
struct Arguments {
    /// Name of the arm.
    #[arg(long, default_value = "paper")]
    arm: String,
    /// Lines per second.
    #[arg(long, default_value_t = 5.0)]
    rate: f64,
    /// Number of lines; without it, until interrupted.
    #[arg(long)]
    lines: Option<usize>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    run(&arguments)?;
    Ok(())
}

fn run(arguments: &Arguments) -> Result<(), IpcError> {
    let client = Client::connect(&Domain::from_env(), &arguments.arm)?;
    let states = client.states()?;
    for _ in 0..arguments.lines.unwrap_or(usize::MAX) {
        match states.wait(Duration::from_secs(1))? {
            Some(state) => println!("{}", line(&state)),
            None => println!("no record for 1 s"),
        }
        std::thread::sleep(Duration::from_secs_f64(1.0 / arguments.rate));
    }
    Ok(())
}

fn line(state: &State) -> String {
    let cables = &state.tension_command_n[..state.cable_count as usize];
    let tension_n_max = cables.iter().copied().fold(0.0, f64::max);
    let nearest = state.distances[..state.distance_count as usize]
        .iter()
        .min_by(|a, b| a.surface_distance_m.total_cmp(&b.surface_distance_m))
        .map_or("no obstacles".to_owned(), |d| {
            format!("{:7.1} mm to {}:{}", 1e3 * d.surface_distance_m, d.source_id, d.obstacle_id)
        });
    let sources: Vec<String> = state
        .obstacle_sources
        .iter()
        .filter(|s| s.accepted + s.rejected_total() > 0)
        .map(|s| {
            let health = SourceHealth::from_wire(s.health).map_or("?", SourceHealth::text);
            format!("{}:{health} {:.0} ms, {} rejected", s.source_id, 1e3 * s.age_s, s.rejected_total())
        })
        .collect();
    format!(
        "{:9.3} s {:9} {}/{} newton {} tip error {:6.2} mm, {nearest}, max {:5.1} N, cycle {:6.0} us, fault {} [{}]",
        state.time_s,
        SupervisorState::from_wire(state.supervisor).map_or("?", SupervisorState::text),
        PlannerBranch::from_wire(state.planner_branch).map_or("?", PlannerBranch::text),
        PlannerStatus::from_wire(state.planner_status).map_or("?", PlannerStatus::text),
        state.newton_iterations,
        1e3 * state.tip_error_m,
        tension_n_max,
        state.timing.cycle_ns as f64 * 1e-3,
        state.fault_code,
        sources.join(", "),
    )
}
