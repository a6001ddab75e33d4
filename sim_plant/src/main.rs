//! `sim_plant`: the arm and its drives in place of the hardware.
//!
//! Exit codes: 0 stopped by a signal, 1 the simulation failed, 2 unusable arguments or configuration.
#![allow(clippy::print_stdout)] // the line that says that the drives are on the bus

use clap::Parser;
use miette::{IntoDiagnostic, WrapErr};
use sim_plant::config::{Pace, PlantConfig};
use sim_plant::fault::{FaultSpec, Schedule};
use sim_plant::rig::{Rig, Start};
use sim_plant::server::Server;
use sim_plant::trace::Trace;
use sim_plant::wire::WireFault;
use sinew::config::{BusKind, Config, ScenarioConfig};
use sinew::model::Arm;
use sinew::scenario::Course;
use sinew_hal::virtual_bus::{Claim, Role, claim};
use std::io::IsTerminal;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The simulated arm and its drives, for everything that listens on the bus.
#[derive(Debug, Parser)]
#[command(name = "sim_plant", version)]
struct Arguments {
    /// The controller's configuration files and the one with `[plant]`.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    config: Vec<PathBuf>,
    /// One period per SYNC, as fast as it computes; default: `plant.pace`.
    #[arg(long)]
    lockstep: bool,
    /// Write the true arm, tick by tick, as an MCAP recording.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Seed of tension errors, noise and chance faults; default: `plant.seed`.
    #[arg(long)]
    seed: Option<u64>,
    /// Rest at the start of this scenario (built-in name or file); default: straight.
    #[arg(long, value_name = "SCENARIO", conflicts_with = "start_tensions")]
    start_scenario: Option<String>,
    /// Rest in the equilibrium under these tensions (N), one per cable, reached from the straight arm.
    #[arg(long, value_name = "N", num_args = 1.., value_delimiter = ',')]
    start_tensions: Option<Vec<f64>>,
    /// Break something: stick|jump|silence|trip|dead|reboot|pull|press:CABLE[:METRES or NEWTONS][@SECONDS since the first
    /// drive was enabled]; CABLE is SEGMENT,NUMBER, both from 1 (2,1), or its number over the whole arm from 1, or `any`.
    #[arg(long, value_name = "FAULT")]
    fault: Vec<FaultSpec>,
    /// Let frames between controller and drives go wrong, with chances from the seed:
    /// KIND[:FRAMES[.NODE]][=PROBABILITY][@FROM[-TO] s since the first drive was enabled], e.g. drop=0.01, drop:sync@4-4.05,
    /// delay2:tpdo.5@4; several separated by commas. KIND: drop|delay[N periods]|duplicate|reorder|corrupt; FRAMES:
    /// all|nmt|sync|emcy|rpdo|tpdo|sdo|master|heartbeat.
    #[arg(long, value_name = "FAULT", value_delimiter = ',')]
    wire: Vec<WireFault>,
    /// Serve the first bus to socketcand clients (python-can) on this port of 127.0.0.1; 0 chooses one. It is printed.
    #[arg(long, value_name = "PORT")]
    socketcand: Option<u16>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let text = std::env::var("SINEW_LOG").ok().filter(|text| !text.is_empty()).unwrap_or_else(|| "warn".into());
    let filter = match text.parse::<tracing_subscriber::EnvFilter>() {
        Ok(filter) => filter,
        Err(error) => {
            eprintln!("sim_plant: SINEW_LOG={text}: {error}; expected e.g. info or sim_plant=debug");
            return ExitCode::from(2);
        }
    };
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let stop = Arc::new(AtomicBool::new(false));
    let prepared = prepare(&arguments, &stop);
    match prepared.map(|(server, _socketcand, _claims)| server.run(&stop)) {
        Ok(Ok(served)) => {
            tracing::info!(?served, "stopped");
            if served.late > 0 || served.given_up_ns > 0 || served.dropped > 0 || served.untraced > 0 {
                eprintln!(
                    "sim_plant: {} of {} steps late, {:.3} s given up, {} frames dropped, {} records not traced",
                    served.late,
                    served.steps,
                    served.given_up_ns as f64 * 1e-9,
                    served.dropped,
                    served.untraced
                );
            }
            ExitCode::SUCCESS
        }
        Ok(Err(error)) => {
            eprintln!("sim_plant: {error}");
            ExitCode::from(1)
        }
        Err(report) => {
            eprintln!("{report:?}");
            ExitCode::from(2)
        }
    }
}

type Socketcand = Option<sinew_hal::socketcand::Server>;

fn prepare(arguments: &Arguments, stop: &Arc<AtomicBool>) -> miette::Result<(Server, Socketcand, Vec<Claim>)> {
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).into_diagnostic()?;
    }
    let (mut plant, config) = PlantConfig::load(&arguments.config)?;
    if arguments.lockstep {
        plant.pace = Pace::Lockstep;
    }
    if let Some(seed) = arguments.seed {
        plant.truth.seed = seed;
    }
    let virtual_buses = config.drives.buses.iter().filter(|bus| bus.kind == BusKind::Virtual);
    let claims: Result<_, _> = virtual_buses.map(|bus| claim(&bus.interface, Role::Drives)).collect();
    let claims = claims.into_diagnostic()?;
    let start = start(arguments, &config)?;
    // Commands late by a tick: in lockstep the arm advances once per tick, in real time step by step.
    let steps_per_tick = match plant.pace {
        Pace::Lockstep => 1,
        Pace::Realtime => (config.timing.period_s / plant.truth.step_s).round().max(1.0) as usize,
    };
    let rig = Rig::new(&config, &plant, &start, plant.truth.latency_ticks * steps_per_tick).into_diagnostic()?;
    let schedule = Schedule::new(&arguments.fault, &config.arm.cable_names(), plant.truth.seed)
        .map_err(|refusal| miette::miette!("{refusal}"))?;
    let trace = match &arguments.trace {
        Some(path) => {
            Some(Trace::create(path, &config.arm.name, &rig, plant.pace, plant.truth.seed).into_diagnostic()?)
        }
        None => None,
    };
    let server = Server::open(&config, &plant, rig, schedule, trace)
        .into_diagnostic()?
        .with_wire_faults(arguments.wire.clone(), plant.truth.seed);
    let socketcand = match arguments.socketcand {
        Some(port) => {
            let bus = server.bus_handle().into_diagnostic()?;
            let served = sinew_hal::socketcand::Server::start(("127.0.0.1", port), bus).into_diagnostic()?;
            println!("sim_plant: socketcand on {}", served.address());
            Some(served)
        }
        None => None,
    };
    let buses: Vec<&str> = config.drives.buses.iter().map(|bus| bus.interface.as_str()).collect();
    println!("sim_plant: {} drives on {}", config.drives.drives.len(), buses.join(", "));
    // Whoever waits for the line reads a pipe, and a pipe is not flushed at the end of a line.
    std::io::stdout().flush().into_diagnostic()?;
    Ok((server, socketcand, claims))
}

fn start(arguments: &Arguments, config: &Config) -> miette::Result<Start> {
    let mut start = Start::straight(&config.arm);
    if let Some(name) = &arguments.start_scenario {
        let scenario = ScenarioConfig::find(name)?;
        let (state, tensions) = Course::new(&scenario)
            .start(&config.arm)
            .into_diagnostic()
            .wrap_err_with(|| format!("scenario {name} has no start with this arm"))?;
        let arm = Arm::new(&config.arm);
        let mut rates = start.curvatures_1pm.clone();
        arm.curvatures_into(&state.q, &state.qd, &mut start.curvatures_1pm, &mut rates);
        start.tensions_n = tensions;
    } else if let Some(tensions) = &arguments.start_tensions {
        start.tensions_n.clone_from(tensions);
    }
    Ok(start)
}
