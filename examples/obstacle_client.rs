//! Publishes a ball that moves on a circle to the arm's controller.
//!
//! `cargo run --example obstacle_client -- --arm paper --source 1 --rate 50`
//!
//! Velocity and uncertainty go with it, so the controller knows where the ball will be. Ctrl-C leaves in order; killed,
//! the controller sees its source fall silent and acts on that.
#![allow(clippy::print_stdout)]

use clap::Parser;
use sinew::ipc::payload::{FLAG_LEAVING, Obstacle, Obstacles};
use sinew::ipc::{Client, Domain, IpcError, monotonic_ns};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Publishes a ball that moves on a circle.
#[derive(Parser)]
struct Arguments {
    /// Name of the arm.
    #[arg(long, default_value = "paper")]
    arm: String,
    /// Source id, the same at every start.
    #[arg(long, default_value_t = 1)]
    source: u32,
    /// Messages per second.
    #[arg(long, default_value_t = 50.0)]
    rate: f64,
    /// Seconds to run.
    #[arg(long, default_value_t = f64::INFINITY)]
    duration: f64,
    /// Centre of the circle (m).
    #[arg(long, num_args = 3, allow_negative_numbers = true, default_values_t = [0.40, -0.15, -1.68])]
    centre: Vec<f64>,
    /// Radius of the circle (m).
    #[arg(long, default_value_t = 0.32)]
    circle_radius: f64,
    /// Seconds for one turn.
    #[arg(long, default_value_t = 60.0)]
    period: f64,
    /// Radius of the ball (m).
    #[arg(long, default_value_t = 0.1)]
    radius: f64,
    /// Standard deviation of the position (m), all directions.
    #[arg(long, default_value_t = 0.0)]
    sigma: f64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone())?;
    }
    run(&arguments, &stop)?;
    Ok(())
}

fn run(arguments: &Arguments, stop: &AtomicBool) -> Result<(), IpcError> {
    let client = Client::connect(&Domain::from_env(), &arguments.arm)?;
    let mut publisher = client.obstacles(arguments.source)?;
    println!("publishing sinew/{}/obstacles as source {}", arguments.arm, arguments.source);

    let mut set = Obstacles::default();
    let rate = std::f64::consts::TAU / arguments.period;
    let variance = arguments.sigma * arguments.sigma;
    let start = Instant::now();
    let mut sent = 0.0;
    while !stop.load(Ordering::Relaxed) && start.elapsed().as_secs_f64() < arguments.duration {
        let capture_ns = monotonic_ns();
        let (sin, cos) = (rate * start.elapsed().as_secs_f64()).sin_cos();
        let (r, centre) = (arguments.circle_radius, &arguments.centre);
        set.count = 0;
        let pushed = set.push(Obstacle {
            velocity_mps: [-r * rate * sin, r * rate * cos, 0.0],
            covariance_m2: [variance, 0.0, 0.0, variance, 0.0, variance],
            ..Obstacle::ball(1, [centre[0] + r * cos, centre[1] + r * sin, centre[2]], arguments.radius)
        });
        debug_assert!(pushed, "a set has room for one");
        publisher.publish(&mut set, capture_ns)?;
        sent += 1.0;
        let pause = sent / arguments.rate - start.elapsed().as_secs_f64();
        std::thread::sleep(Duration::from_secs_f64(pause.max(0.0)));
    }
    // Leave in order: nobody misses this source from now on.
    set.count = 0;
    set.flags = FLAG_LEAVING;
    publisher.publish(&mut set, monotonic_ns())
}
