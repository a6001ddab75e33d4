//! sinew's side of the comparison with its peers (`benches/peers/run`): a server of one request per line.
//!
//! Enters: JSON objects on standard input, one per line, each with `what`. Leaves: one JSON object per line. It speaks
//! through the library's public interface only, and times nothing but the call that a request is about; the Python side
//! asks for small portions, so that both sides' measurements alternate in time. Times are the thread's processor time.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a bench may panic and print

mod plant;
mod safe;
mod swarm;

use serde_json::{Value, json};
use std::io::{BufRead, Write};

fn main() {
    let (mut safe, mut swarm) = (safe::Server::default(), swarm::Server::default());
    for line in std::io::stdin().lock().lines() {
        let request: Value = serde_json::from_str(&line.expect("a readable request")).expect("a request in JSON");
        let answer = match request["what"].as_str().expect("`what`") {
            "arm" => plant::arm_data(&request),
            "plant" => plant::run(&request),
            "safe" => safe.plan(&request),
            "swarm problem" => swarm.problem(&request),
            "swarm" => swarm.search(&request),
            other => json!({ "error": format!("unknown request {other}") }),
        };
        println!("{answer}");
        std::io::stdout().flush().expect("a reader");
    }
}

/// A number of a request.
fn number(request: &Value, key: &str) -> f64 {
    request[key].as_f64().unwrap_or_else(|| panic!("`{key}` is missing"))
}

/// A count of a request.
fn count(request: &Value, key: &str) -> usize {
    request[key].as_u64().unwrap_or_else(|| panic!("`{key}` is missing")) as usize
}

/// Processor time of this thread (s): what others do on the machine counts less than in wall time.
fn cpu_seconds() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
}
