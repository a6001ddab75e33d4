//! The demo's processes: started, watched, stopped in order, and never left behind.
//!
//! Each is started through `sinew leash`, which ties its life to the demo's before it becomes the program: a demo that is
//! killed takes its children along. Each has a process group of its own, so that Ctrl-C reaches the demo alone, which
//! stops the others in order. What they say goes to a file each.

use super::setup::Setup;
use super::{LOOK, STOP};
use miette::{IntoDiagnostic, WrapErr, miette};
use rustix::process::{Pid, Signal, kill_process};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Bytes of a log that are shown when its process ended.
const TAIL: usize = 2000;
/// Time granted to the plant to find its start.
const PLANT_START: Duration = Duration::from_secs(60);

struct Running {
    name: &'static str,
    child: Child,
    log: PathBuf,
}

/// A child that ended although nobody had asked it to.
#[derive(Debug)]
pub(super) struct Ended {
    pub(super) name: &'static str,
    pub(super) status: ExitStatus,
    pub(super) tail: String,
}

/// All of them, in the order of their start.
pub(super) struct Children {
    folder: PathBuf,
    running: Vec<Running>,
}

const PLANT: &str = "plant";
const DAEMON: &str = "daemon";
const OBSTACLES: &str = "obstacle client";
const TASK: &str = "task client";
const VIEW: &str = "view";
/// The daemon first: it disables the drives while clients and plant still live.
const ORDER_OF_STOP: [&str; 5] = [DAEMON, OBSTACLES, TASK, PLANT, VIEW];

impl Children {
    pub(super) fn new(setup: &Setup) -> Self {
        Self { folder: setup.folder().to_owned(), running: Vec::new() }
    }

    /// Starts the plant and waits until its drives are on the bus.
    pub(super) fn start_plant(&mut self, setup: &Setup, stop: &AtomicBool) -> miette::Result<()> {
        let stdout = self.spawn(setup, PLANT, &setup.plant, &setup.plant_arguments(), Stdio::piped())?;
        let heard = first_line(stdout);
        let deadline = Instant::now() + PLANT_START;
        while Instant::now() < deadline && !stop.load(Ordering::Relaxed) {
            match heard.recv_timeout(LOOK) {
                Ok(_) => return Ok(()),
                Err(mpsc::RecvTimeoutError::Disconnected) => {
                    // It has closed its output, so it is ending: its code says why.
                    std::thread::sleep(LOOK);
                    self.check()?;
                }
                Err(mpsc::RecvTimeoutError::Timeout) => {}
            }
        }
        if stop.load(Ordering::Relaxed) { Ok(()) } else { Err(miette!("the plant did not become ready")) }
    }

    pub(super) fn start_daemon(&mut self, setup: &Setup) -> miette::Result<()> {
        self.spawn(setup, DAEMON, &setup.sinew, &setup.daemon_arguments(), Stdio::null()).map(drop)
    }

    /// Starts the page; its address.
    pub(super) fn start_view(&mut self, setup: &Setup, port: u16) -> miette::Result<String> {
        let stdout = self.spawn(setup, VIEW, &setup.sinew, &setup.view_arguments(port), Stdio::piped())?;
        match first_line(stdout).recv_timeout(STOP) {
            Ok(line) => Ok(line.trim_end().to_owned()),
            Err(_) => {
                let said = self.running.last().map(|view| tail(&view.log)).unwrap_or_default();
                Err(miette!("--view: the page is not served\n{said}"))
            }
        }
    }

    pub(super) fn start_clients(&mut self, setup: &Setup) -> miette::Result<()> {
        self.spawn(setup, OBSTACLES, &setup.sinew, &setup.client_arguments("obstacles"), Stdio::null())?;
        self.spawn(setup, TASK, &setup.sinew, &setup.client_arguments("task"), Stdio::null()).map(drop)
    }

    fn spawn(
        &mut self,
        setup: &Setup,
        name: &'static str,
        program: &std::path::Path,
        arguments: &[String],
        stdout: Stdio,
    ) -> miette::Result<Option<ChildStdout>> {
        let log = self.folder.join(format!("{}.log", name.replace(' ', "-")));
        let file = File::create(&log).into_diagnostic()?;
        let mut child = Command::new(&setup.sinew)
            .arg("leash")
            .arg(std::process::id().to_string())
            .arg("--")
            .arg(program)
            .args(arguments)
            .envs(setup.domain.env())
            .stdin(Stdio::null())
            .stdout(stdout)
            .stderr(file)
            .process_group(0)
            .spawn()
            .into_diagnostic()
            .wrap_err_with(|| format!("{name} could not be started ({})", program.display()))?;
        let output = child.stdout.take();
        self.running.push(Running { name, child, log });
        Ok(output)
    }

    /// That all live.
    pub(super) fn check(&mut self) -> miette::Result<()> {
        // A run does not need anybody who looks at it.
        for running in self.running.iter_mut().filter(|running| running.name != VIEW) {
            if let Some(status) = running.child.try_wait().into_diagnostic()? {
                return Err(Ended { name: running.name, status, tail: tail(&running.log) }.report());
            }
        }
        Ok(())
    }

    /// SIGKILL: what a crash is to the others.
    pub(super) fn kill_obstacle_client(&mut self) -> miette::Result<()> {
        let Some(place) = self.running.iter().position(|r| r.name == OBSTACLES) else { return Ok(()) };
        let mut running = self.running.remove(place);
        running.child.kill().into_diagnostic()?;
        running.child.wait().into_diagnostic().map(drop)
    }

    /// Stops all in order: SIGTERM, and SIGKILL for whoever does not go. An unclean end of one that was asked to stop is
    /// an error, after all have gone.
    pub(super) fn stop_all(&mut self, setup: &Setup) -> miette::Result<()> {
        let mut unclean = Vec::new();
        for name in ORDER_OF_STOP {
            let Some(place) = self.running.iter().position(|r| r.name == name) else { continue };
            let mut running = self.running.remove(place);
            let ended_before = running.child.try_wait().into_diagnostic()?.is_some();
            // The daemon lowers the arm first.
            let lowering_s = if name == DAEMON { setup.config.timing.stop_timeout_s } else { 0.0 };
            let patience = STOP + Duration::from_secs_f64(lowering_s);
            if !ended_before && let Err(trouble) = stop(&mut running, patience) {
                unclean.push(format!("{name}: {trouble}"));
            }
        }
        if unclean.is_empty() {
            return Ok(());
        }
        Err(miette!("{}; logs in {}", unclean.join("; "), setup.folder().display()))
    }
}

/// The first line that a program says; nothing comes where it ends before.
fn first_line(stdout: Option<ChildStdout>) -> mpsc::Receiver<String> {
    let (said, heard) = mpsc::channel();
    if let Some(stdout) = stdout {
        // Ends with the line, or with the program.
        std::thread::spawn(move || {
            let mut line = String::new();
            if BufReader::new(stdout).read_line(&mut line).is_ok() && !line.is_empty() {
                let _ = said.send(line);
            }
        });
    }
    heard
}

fn stop(running: &mut Running, patience: Duration) -> Result<(), String> {
    kill_process(Pid::from_child(&running.child), Signal::TERM).map_err(|e| e.to_string())?;
    let deadline = Instant::now() + patience;
    while Instant::now() < deadline {
        if running.child.try_wait().map_err(|e| e.to_string())?.is_some() {
            return Ok(());
        }
        std::thread::sleep(LOOK / 4);
    }
    running.child.kill().map_err(|e| e.to_string())?;
    running.child.wait().map_err(|e| e.to_string())?;
    Err(format!("did not stop within {} s and was killed", patience.as_secs()))
}

impl Drop for Children {
    /// Whatever went wrong before: nobody stays.
    fn drop(&mut self) {
        for running in &mut self.running {
            let _ = running.child.kill();
            let _ = running.child.wait();
        }
    }
}

fn tail(log: &std::path::Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let mut from = text.len().saturating_sub(TAIL);
    while !text.is_char_boundary(from) {
        from += 1;
    }
    text[from..].trim_end().to_owned()
}
