//! The daemon's side of the services.

use super::IpcError;
use super::domain::{Domain, Ipc, SET_UP, Session, cause, within};
use super::payload::{Encoders, Obstacles, Request, Response, State, Target, Tip};
use super::service::{self, Message, Topic, service_name};
use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::server::Server;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{CallbackProgression, PortFactory};
use iceoryx2::service::port_factory::server::ServerCreateError;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::sync::Arc;

/// A request that waits for its answer; dropped without one, the client sees that nobody answers.
pub(crate) type OpenRequest = ActiveRequest<Ipc, Request, (), Response, ()>;

/// All ports of the daemon of one arm, for one I/O thread.
///
/// Dropping it removes the services that nobody else has open, the node, and what iceoryx2 leaves behind.
#[derive(Debug)]
pub struct DaemonPorts {
    encoders: Subscriber<Ipc, Encoders, ()>,
    obstacles: Subscriber<Ipc, Obstacles, ()>,
    target: Subscriber<Ipc, Target, ()>,
    tip: Subscriber<Ipc, Tip, ()>,
    state: Publisher<Ipc, State, ()>,
    requests: Server<Ipc, Request, (), Response, ()>,
    obstacle_topic: Topic<Obstacles>,
    target_topic: Topic<Target>,
    // Behind the ports: fields drop in order, and the node goes last.
    _session: Arc<Session>,
}

pub(crate) fn subscribe<T: Message>(topic: &Topic<T>, arm: &str) -> Result<Subscriber<Ipc, T, ()>, IpcError> {
    topic.subscriber_builder().buffer_size(1).create().map_err(|e| port_error(e, arm, T::SERVICE, "subscriber"))
}

pub(crate) fn port_error(error: impl std::fmt::Debug, arm: &str, service: &str, port: &'static str) -> IpcError {
    let name = service_name(arm, service);
    let cause = format!("{error:?}");
    if cause.contains("ExceedsMaxSupported") {
        IpcError::Full { service: name, port }
    } else {
        IpcError::Port { operation: "creating a port", service: name, cause }
    }
}

impl DaemonPorts {
    /// Creates the services of an arm and the daemon's ports; cleans up after dead processes first.
    ///
    /// # Errors
    /// [`IpcError::AlreadyRunning`] if a living process serves the arm, otherwise what iceoryx2 reports.
    pub fn create(domain: &Domain, arm: &str) -> Result<Self, IpcError> {
        let (domain, arm) = (domain.clone(), arm.to_owned());
        within(SET_UP, move || Self::set_up(&domain, &arm)).map_err(cause)
    }

    fn set_up(domain: &Domain, arm: &str) -> Result<Self, IpcError> {
        let session = Session::open(domain, "sinew daemon")?;
        let state = service::create::<State>(&session, arm)?.publisher_builder().create().map_err(|e| match e {
            PublisherCreateError::ExceedsMaxSupportedPublishers => IpcError::AlreadyRunning { arm: arm.to_owned() },
            e => port_error(e, arm, State::SERVICE, "publisher"),
        })?;
        let encoders = subscribe(&service::create(&session, arm)?, arm)?;
        let obstacle_topic = service::create(&session, arm)?;
        let obstacles = subscribe(&obstacle_topic, arm)?;
        let target_topic = service::create(&session, arm)?;
        let target = subscribe(&target_topic, arm)?;
        let tip = subscribe(&service::create(&session, arm)?, arm)?;
        // Last: by this service clients tell that a daemon is there, and then the others must be.
        let requests = service::create_requests(&session, arm)?.server_builder().create().map_err(|e| match e {
            ServerCreateError::ExceedsMaxSupportedServers => IpcError::AlreadyRunning { arm: arm.to_owned() },
            e => port_error(e, arm, "request", "server"),
        })?;
        Ok(Self { encoders, obstacles, target, tip, state, requests, obstacle_topic, target_topic, _session: session })
    }

    /// Every encoder message that waits, each with its port. Returns their number.
    pub fn take_encoders(&self, take: impl FnMut(&Encoders, u128)) -> Result<usize, IpcError> {
        drain(&self.encoders, take)
    }

    /// Every obstacle message that waits, of all publishers, each with its port. Returns their number.
    pub fn take_obstacles(&self, take: impl FnMut(&Obstacles, u128)) -> Result<usize, IpcError> {
        drain(&self.obstacles, take)
    }

    /// Every target message that waits, each with its port. Returns their number.
    pub fn take_targets(&self, take: impl FnMut(&Target, u128)) -> Result<usize, IpcError> {
        drain(&self.target, take)
    }

    /// Every measured tip that waits, each with its port. Returns their number.
    pub fn take_tips(&self, take: impl FnMut(&Tip, u128)) -> Result<usize, IpcError> {
        drain(&self.tip, take)
    }

    /// Whether a port of obstacles is gone, or belongs to the process that another one belongs to (0: to no other).
    pub(crate) fn may_replace_obstacles(&self, port: u128, by: u128) -> bool {
        may_replace(&self.obstacle_topic, port, by)
    }

    /// The same of a port of targets.
    pub(crate) fn may_replace_target(&self, port: u128, by: u128) -> bool {
        may_replace(&self.target_topic, port, by)
    }

    /// The next request; `None` if there is none.
    pub(crate) fn next_request(&self) -> Result<Option<OpenRequest>, IpcError> {
        self.requests.receive().map_err(|e| IpcError::port("receiving", "request", e))
    }

    /// Publishes a tick's record. Allocates 48 bytes; not for the control thread.
    pub fn publish_state(&self, state: &State) -> Result<(), IpcError> {
        send(&self.state, state)
    }
}

/// The process of a port; `None` if the port is not there any more, or its process has ended.
fn process_of<T: Message>(topic: &Topic<T>, port: u128) -> Option<i32> {
    let mut process = None;
    topic.dynamic_config().list_publishers(|details| {
        if details.publisher_id.value() != port {
            return CallbackProgression::Continue;
        }
        process = details.node_id.pid::<Ipc>().ok().map(|pid| pid.value());
        CallbackProgression::Stop
    });
    process.filter(|pid| lives(*pid))
}

fn may_replace<T: Message>(topic: &Topic<T>, port: u128, by: u128) -> bool {
    let process = process_of(topic, port);
    process.is_none() || (by != 0 && process == process_of(topic, by))
}

/// Whether a process has not ended. One that was killed and is not waited for by its parent has.
pub(crate) fn lives(pid: i32) -> bool {
    let Some(pid) = rustix::process::Pid::from_raw(pid) else { return false };
    match rustix::process::pidfd_open(pid, rustix::process::PidfdFlags::empty()) {
        Ok(process) => {
            let mut ended = [PollFd::new(&process, PollFlags::IN)];
            poll(&mut ended, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })) == Ok(0)
        }
        // No descriptor left, or no such call: nothing is known of its end.
        Err(error) => error != rustix::io::Errno::SRCH,
    }
}

pub(crate) fn send<T: Message>(port: &Publisher<Ipc, T, ()>, payload: &T) -> Result<(), IpcError> {
    let sample = port.loan_uninit().map_err(|e| IpcError::port("loaning", T::SERVICE, e))?;
    sample.write_payload(*payload).send().map_err(|e| IpcError::port("sending", T::SERVICE, e))?;
    Ok(())
}

fn drain<T: Message>(port: &Subscriber<Ipc, T, ()>, mut take: impl FnMut(&T, u128)) -> Result<usize, IpcError> {
    // Bounded: one sample per publisher is what the buffers hold; a flood must not keep the thread here.
    for taken in 0..T::MAX_PUBLISHERS {
        match port.receive().map_err(|e| IpcError::port("receiving", T::SERVICE, e))? {
            Some(sample) => take(&sample, sample.origin().value()),
            None => return Ok(taken),
        }
    }
    Ok(T::MAX_PUBLISHERS)
}
