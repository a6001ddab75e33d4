//! `sinew view`: a page with the arm and its plots, for a browser on this computer.
//!
//! Enters: the records of a running daemon and its report, or a recording. Leaves: a page on 127.0.0.1. It is a process of its own and reads only:
//! no order leaves it, and no thread of the daemon waits for it. `page/` is plain HTML, CSS and ES modules without a build
//! step; the libraries in `page/vendor` are npm's.

mod frame;
mod hub;
mod live;
mod recorded;
mod scene;
mod server;

use super::client::Which;
use super::{Outcome, complain, print_text};
use clap::Args;
use futures_util::future::{Either, select};
use hub::Hub;
use miette::{IntoDiagnostic, WrapErr, miette};
use recorded::Recorded;
use scene::Scene;
use server::{Site, router};
use sinew_hal::peer::user_text;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Arguments of `sinew view`.
#[derive(Debug, Args)]
pub(crate) struct View {
    /// A recording (MCAP) in place of a running daemon.
    #[arg(value_name = "FILE.mcap", conflicts_with = "arm")]
    recording: Option<PathBuf>,
    #[command(flatten)]
    which: Which,
    /// Port on 127.0.0.1; 0 takes a free one.
    #[arg(long, default_value = DEFAULT_PORT)]
    port: u16,
}

/// Port where none is given, as an argument.
pub(super) const DEFAULT_PORT: &str = "7460";
/// How often it is looked whether a signal came.
const LOOK: Duration = Duration::from_millis(50);

impl View {
    pub(crate) fn run(self) -> miette::Result<Outcome> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, stop.clone()).into_diagnostic()?;
        }
        if let Some(path) = &self.recording {
            return self.show(path, &stop);
        }
        if let Some(found) = self.which.foreign()? {
            let owner = found.address.owner().map_or_else(|| "another user".into(), user_text);
            complain(format_args!(
                "sinew view: the records of arm \"{}\" are those of {owner}; run it as that user, or as root",
                found.arm
            ));
            return Ok(Outcome::Failed);
        }
        let found = self.which.find()?;
        let (scene, config) = match self.which.config()? {
            Some(config) => (Scene::of(&config), Some(config)),
            None => Scene::named(&found.arm),
        };
        let names = config.map_or_else(|| sinew::config::CableNames::new([]), |config| config.arm.cable_names());
        let hub = Hub::new();
        let site = Site { hub: hub.clone(), scene: json(&scene)?, recorded: None };
        let served = std::thread::scope(|threads| {
            // Whatever ends, all end.
            let looking = Looking(&stop);
            threads.spawn(|| live::follow(&hub, &self.which, &names, &stop));
            threads.spawn(|| live::report(&hub, &found, &stop));
            let served = serve(site, self.port, &stop);
            drop(looking);
            served
        });
        served.map(|()| Outcome::Done)
    }

    /// Serves a recording.
    fn show(&self, path: &Path, stop: &AtomicBool) -> miette::Result<Outcome> {
        let mut recorded = Recorded::open(path).into_diagnostic()?;
        let (scene, config) = match self.which.config()? {
            Some(config) => (Scene::of(&config), Some(config)),
            None => Scene::named(recorded.arm()),
        };
        if let Some(config) = config {
            recorded.name(config.arm.cable_names());
        }
        let file = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let scene = json(&scene.recorded(file, recorded.span_s()))?;
        let site = Site { hub: Hub::new(), scene, recorded: Some(Arc::new(Mutex::new(recorded))) };
        serve(site, self.port, stop).map(|()| Outcome::Done)
    }
}

fn json(scene: &Scene) -> miette::Result<Arc<str>> {
    Ok(serde_json::to_string(scene).into_diagnostic()?.into())
}

/// Tells the threads to end, however it is dropped.
struct Looking<'a>(&'a AtomicBool);

impl Drop for Looking<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Serves until it is told to stop.
fn serve(site: Site, port: u16, stop: &AtomicBool) -> miette::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().into_diagnostic()?;
    runtime.block_on(async {
        let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, port)).await;
        let listener = listener.map_err(|error| {
            miette!(help = "choose another one with --port, or --port 0", "port {port} of 127.0.0.1: {error}")
        })?;
        let address = listener.local_addr().into_diagnostic()?;
        print_text(&format!("http://{address}/\n"))?;
        let told = async {
            while !stop.load(Ordering::Relaxed) {
                tokio::time::sleep(LOOK).await;
            }
        };
        // Pages that are open do not hold it up.
        match select(pin!(axum::serve(listener, router(site)).into_future()), pin!(told)).await {
            Either::Left((served, _)) => served.into_diagnostic().wrap_err("serving"),
            Either::Right(((), _)) => Ok(()),
        }
    })
}
