//! Round trips over the virtual bus between two processes, as a control loop makes them: one frame out, one back.
//!
//! `cargo run --release -p sinew-hal --example bus_latency [-- ROUNDS [PRIORITY]]` prints the median, the 99th and
//! 99.9th percentile and the maximum. With a priority both processes ask for SCHED_FIFO and say what they were refused.

#![allow(clippy::print_stdout)] // its purpose

use std::error::Error;
use std::process::{Command, ExitCode};
use std::time::Duration;

use sinew_hal::can::{CanBus, Frame, Id};
use sinew_hal::clock::monotonic_ns;
use sinew_hal::realtime::{Request, enter};
use sinew_hal::virtual_bus::VirtualBus;

const WAIT: Duration = Duration::from_secs(5);
const STOP: Id = Id::Standard(0x7ff);

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("bus_latency: {e}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [part, name, priority] = arguments.as_slice()
        && part == "echo"
    {
        return echo(name, priority.parse().ok());
    }
    let rounds: u32 = arguments.first().map_or(Ok(20_000), |a| a.parse())?;
    let priority: Option<u8> = arguments.get(1).map(|a| a.parse()).transpose()?;

    let name = format!("latency-{}", std::process::id());
    let mut bus = VirtualBus::open(&name, false)?;
    let mut child = Command::new(std::env::current_exe()?)
        .args(["echo", &name, &priority.map_or("-".into(), |p| p.to_string())])
        .spawn()?;
    prepare(priority);
    // The other process announces itself.
    bus.receive(WAIT)?.ok_or("the other process did not start")?;

    let mut times_ns = Vec::with_capacity(rounds as usize);
    for i in 0..rounds {
        let frame = Frame::classic(Id::Standard(0x201), &i.to_le_bytes())?;
        let start_ns = monotonic_ns();
        bus.send(&frame)?;
        let back = bus.receive(WAIT)?.ok_or("no answer")?;
        times_ns.push(monotonic_ns() - start_ns);
        if back.frame.data() != frame.data() {
            return Err("an answer to another frame".into());
        }
    }
    bus.send(&Frame::classic(STOP, &[])?)?;
    child.wait()?;
    times_ns.sort_unstable();
    let us = |share: f64| {
        let last = times_ns.len().saturating_sub(1);
        times_ns.get((last as f64 * share) as usize).map_or(f64::NAN, |&t| t as f64 * 1e-3)
    };
    println!(
        "{rounds} round trips between two processes: p50 {:.1} us, p99 {:.1} us, p99.9 {:.1} us, max {:.1} us",
        us(0.5),
        us(0.99),
        us(0.999),
        us(1.0)
    );
    Ok(())
}

fn echo(name: &str, priority: Option<u8>) -> Result<(), Box<dyn Error>> {
    let mut bus = VirtualBus::open(name, false)?;
    prepare(priority);
    bus.send(&Frame::classic(Id::Standard(0), &[])?)?;
    while let Some(received) = bus.receive(WAIT)? {
        if received.frame.id() == STOP {
            break;
        }
        bus.send(&received.frame)?;
    }
    Ok(())
}

fn prepare(priority: Option<u8>) {
    if let Some(priority) = priority {
        for refused in enter(&Request { priority: Some(priority), ..Request::default() }).refused {
            eprintln!("{refused}");
        }
    }
}
