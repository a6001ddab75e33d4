//! A bench for CANopen by hand and for the conformance suite: simulated drives, or sinew's master, on any bus, with a
//! socketcand server beside it so that python-can reaches a virtual bus.
//!
//! `drives`: each drive's motor holds a spring, so that position (counts) follows torque (per mille) tenfold.
//! `master`: brings up the drives, commands `--torque`, prints what comes back, one line of `key=value` each, and
//! disables them. Ends by itself; exit code 1 when something failed.

#![allow(clippy::print_stdout)] // standard output is its interface

use clap::{Parser, Subcommand, ValueEnum};
use miette::{IntoDiagnostic, Result, miette};
use sim_plant::drive::{Drive, DriveBank, Nameplate};
use sinew_hal::bus_config::{BusKind, BusSpec, open};
use sinew_hal::canopen::NodeId;
use sinew_hal::cia402::{DriveSetup, Goal, Master, MasterConfig, Progress};
use sinew_hal::clock::monotonic_ns;
use sinew_hal::socketcand::Server;
use std::time::Duration;

#[derive(Clone, Copy, ValueEnum)]
enum Interface {
    Virtual,
    Socketcan,
}

#[derive(Parser)]
struct Arguments {
    /// Kind of bus.
    #[arg(long, value_enum, default_value = "virtual")]
    interface: Interface,
    /// Name of the bus or network interface.
    #[arg(long, default_value = "vcan0")]
    bus: String,
    /// Node ids of the drives.
    #[arg(long, value_delimiter = ',', default_value = "1")]
    nodes: Vec<u8>,
    /// Serves the bus to socketcand clients on this port of 127.0.0.1; 0 chooses one. The port is printed.
    #[arg(long)]
    socketcand: Option<u16>,
    #[command(subcommand)]
    role: Role,
}

#[derive(Subcommand)]
enum Role {
    /// Simulated drives, until the process is ended.
    Drives,
    /// The master.
    Master {
        /// Torque to command (per mille of rated torque).
        #[arg(long, default_value_t = 100)]
        torque: i16,
        /// Waits for a line on standard input before it starts, and for the input's end before it ends: until then its
        /// socketcand clients have a server.
        #[arg(long)]
        wait: bool,
    },
}

fn main() -> Result<()> {
    tracing_subscriber::fmt().with_writer(std::io::stderr).init();
    let a = Arguments::parse();
    let kind = match a.interface {
        Interface::Virtual => BusKind::Virtual,
        Interface::Socketcan => BusKind::Socketcan,
    };
    let bus = open(&BusSpec::new(kind, &a.bus)).into_diagnostic()?;
    let nodes: Vec<NodeId> = a.nodes.iter().map(|&n| NodeId::new(n)).collect::<Result<_, _>>().into_diagnostic()?;
    let server = match a.socketcand {
        Some(port) => {
            let s = Server::start(("127.0.0.1", port), bus.duplicate().into_diagnostic()?).into_diagnostic()?;
            println!("socketcand={}", s.address().port());
            Some(s)
        }
        None => None,
    };
    let result = match a.role {
        Role::Drives => drives(bus, &nodes),
        Role::Master { torque, wait } => {
            if wait {
                std::io::stdin().read_line(&mut String::new()).into_diagnostic()?;
            }
            let result = master(bus, &nodes, torque);
            if wait {
                std::io::copy(&mut std::io::stdin(), &mut std::io::sink()).into_diagnostic()?;
            }
            result
        }
    };
    drop(server);
    result
}

fn drives(mut bus: Box<dyn sinew_hal::can::CanBus>, nodes: &[NodeId]) -> Result<()> {
    let start = monotonic_ns();
    let mut bank = DriveBank::new(nodes.iter().map(|&n| Drive::new(n, Nameplate::default(), start)).collect());
    println!("ready");
    loop {
        for d in bank.drives_mut() {
            let torque = d.torque_permille();
            d.set_feedback(i32::from(torque) * 10, 0, torque);
        }
        let _ = bank.pump(&mut *bus, Duration::from_millis(1), &mut monotonic_ns); // a lost bus comes back or not
    }
}

fn master(bus: Box<dyn sinew_hal::can::CanBus>, nodes: &[NodeId], torque: i16) -> Result<()> {
    let drives = nodes.iter().map(|&n| DriveSetup::new(0, n)).collect();
    let mut config = MasterConfig::new(drives, NodeId::new(127).into_diagnostic()?, 10_000);
    // Slaves in Python on a busy machine: nothing here is about speed.
    config.sdo_timeout_ms = 2000;
    config.transition_timeout_ms = 10_000;
    config.drive_heartbeat_timeout_ms = 5000;
    config.heartbeat_timeout_ms = 5000;
    let mut receiver = bus.duplicate().into_diagnostic()?;
    let mut master = Master::new(config, vec![bus]).into_diagnostic()?;
    let mut decoder = master.decoder();
    master.start(monotonic_ns());
    run(&mut master, "operational", |p| p.at_goal)?;
    master.set_goal(Goal::Enabled, monotonic_ns());
    run(&mut master, "enabled", |p| p.at_goal)?;
    let mut writer = master.take_writer().ok_or_else(|| miette!("no writer"))?;
    let torques = vec![torque; nodes.len()];
    let begun_ns = monotonic_ns();
    let mut follow = false;
    while !follow && monotonic_ns() - begun_ns < WITHIN_NS {
        let _ = writer.write_cycle(&torques);
        let end = monotonic_ns() + 10_000_000;
        while monotonic_ns() < end {
            if let Ok(Some(f)) = receiver.receive(Duration::from_millis(1)) {
                decoder.on_frame(0, &f);
            }
            master.pump(monotonic_ns());
        }
        follow = decoder.feedback().iter().all(|f| f.torque_permille == torque);
    }
    for (node, f) in nodes.iter().zip(decoder.feedback()) {
        println!(
            "node={node} statusword={:#06x} position={} torque={}",
            f.statusword, f.position_counts, f.torque_permille
        );
    }
    master.return_writer(writer);
    master.set_goal(Goal::Disabled, monotonic_ns());
    run(&mut master, "disabled", |p| p.at_goal)
}

/// Time granted to each step of the master (ns).
const WITHIN_NS: u64 = 20_000_000_000;

fn run(master: &mut Master, what: &str, done: impl Fn(&Progress) -> bool) -> Result<()> {
    let end = monotonic_ns() + WITHIN_NS;
    while monotonic_ns() < end {
        let p = master.pump(monotonic_ns());
        if let Some(f) = master.take_faults().first() {
            return Err(miette!("{f}"));
        }
        if done(&p) {
            println!("{what}");
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    Err(miette!("not {what} within 20 s"))
}
