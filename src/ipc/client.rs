//! The clients' side of the services: perception, tasks, operators, viewers, other sensors.

use super::IpcError;
use super::domain::{Domain, Ipc, SET_UP, Session, cause, within};
use super::payload::{Encoders, Header, Obstacles, Request, RequestKind, Response, State, Target, Tip};
use super::ports::{lives, port_error, send, subscribe};
use super::service::{self, Message};
use iceoryx2::port::client::Client as RequestPort;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{CallbackProgression, PortFactory};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The time base of all payloads, the same in every process of a computer.
pub use sinew_hal::clock::monotonic_ns;

/// How often a wait looks for what it waits for.
const POLL: Duration = Duration::from_micros(200);

/// Connection to the daemon of one arm. Its ports outlive it and may go to other threads.
#[derive(Debug)]
pub struct Client {
    arm: String,
    requests: RequestPort<Ipc, Request, (), Response, ()>,
    service: service::Requests,
    sequence: u64,
    session: Arc<Session>,
}

impl Client {
    /// Connects to a running daemon; cleans up after dead processes first.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`] if none runs for the arm, [`IpcError::IncompatiblePayload`] if it is of another version.
    pub fn connect(domain: &Domain, arm: &str) -> Result<Self, IpcError> {
        let (domain, arm) = (domain.clone(), arm.to_owned());
        within(SET_UP, move || Self::set_up(&domain, &arm)).map_err(cause)
    }

    fn set_up(domain: &Domain, arm: &str) -> Result<Self, IpcError> {
        let session = Session::open(domain, "sinew client")?;
        let service = service::open_requests(&session, arm)?;
        let requests = service.client_builder().create().map_err(|e| port_error(e, arm, "request", "client"))?;
        let client = Self { arm: arm.to_owned(), requests, service, sequence: 0, session };
        // A service outlives its daemon while another client has it open.
        if client.has_daemon() { Ok(client) } else { Err(client.no_daemon()) }
    }

    /// Connects as soon as a daemon runs.
    ///
    /// # Errors
    /// Those of [`Client::connect`]; [`IpcError::NoDaemon`] only after the timeout.
    pub fn wait_for_daemon(domain: &Domain, arm: &str, timeout: Duration) -> Result<Self, IpcError> {
        let deadline = Instant::now() + timeout;
        loop {
            match Self::connect(domain, arm) {
                Err(IpcError::NoDaemon { .. }) if Instant::now() < deadline => {
                    std::thread::sleep(Duration::from_millis(20));
                }
                result => return result,
            }
        }
    }

    /// Whether the daemon is there: it has not left, and its process has not ended.
    pub fn has_daemon(&self) -> bool {
        let mut found = false;
        self.service.dynamic_config().list_servers(|details| {
            found |= details.node_id.pid::<Ipc>().is_ok_and(|pid| lives(pid.value()));
            CallbackProgression::Continue
        });
        found
    }

    fn no_daemon(&self) -> IpcError {
        IpcError::NoDaemon { arm: self.arm.clone() }
    }

    /// A publisher of encoder states, obstacles, targets or measured tips under a source id, which is the source's own over restarts.
    ///
    /// # Errors
    /// [`IpcError::Full`] if the service has no place left.
    pub fn publisher<T: Message>(&self, source_id: u32) -> Result<SourcePublisher<T>, IpcError> {
        let (session, arm) = (self.session.clone(), self.arm.clone());
        let port = within(SET_UP, move || {
            let topic = service::open::<T>(&session, &arm)?;
            topic.publisher_builder().create().map_err(|e| port_error(e, &arm, T::SERVICE, "publisher"))
        })
        .map_err(cause)?;
        Ok(SourcePublisher { port, source_id, sequence: 0, _session: self.session.clone() })
    }

    /// A publisher of obstacles.
    pub fn obstacles(&self, source_id: u32) -> Result<SourcePublisher<Obstacles>, IpcError> {
        self.publisher(source_id)
    }

    /// A publisher of targets.
    pub fn targets(&self, source_id: u32) -> Result<SourcePublisher<Target>, IpcError> {
        self.publisher(source_id)
    }

    /// A publisher of encoder states.
    pub fn encoders(&self, source_id: u32) -> Result<SourcePublisher<Encoders>, IpcError> {
        self.publisher(source_id)
    }

    /// A publisher of measured positions of the tip.
    pub fn tips(&self, source_id: u32) -> Result<SourcePublisher<Tip>, IpcError> {
        self.publisher(source_id)
    }

    /// A subscriber of any of the publish-subscribe services; sees the newest message of each publisher.
    pub fn subscriber<T: Message>(&self) -> Result<NewestSubscriber<T>, IpcError> {
        let (session, arm) = (self.session.clone(), self.arm.clone());
        let port = within(SET_UP, move || subscribe(&service::open::<T>(&session, &arm)?, &arm)).map_err(cause)?;
        Ok(NewestSubscriber { port, _session: self.session.clone() })
    }

    /// A subscriber of the daemon's records.
    pub fn states(&self) -> Result<NewestSubscriber<State>, IpcError> {
        self.subscriber()
    }

    /// Sends a request and waits for its answer. The header is filled in here.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`] if nobody serves the arm any more, [`IpcError::Timeout`] if it does not answer.
    pub fn request(&mut self, mut request: Request, timeout: Duration) -> Result<Response, IpcError> {
        request.header = Header::new(request.header.source_id, self.sequence, monotonic_ns());
        self.sequence += 1;
        let pending = self.requests.send_copy(request).map_err(|e| IpcError::port("sending", "request", e))?;
        if pending.number_of_server_connections() == 0 {
            return Err(self.no_daemon());
        }
        let deadline = Instant::now() + timeout;
        loop {
            match pending.receive() {
                Ok(Some(response)) => return Ok(*response),
                Ok(None) => {}
                Err(e) => return Err(IpcError::port("receiving", "request", e)),
            }
            if Instant::now() >= deadline {
                let timeout_s = timeout.as_secs_f64();
                return Err(IpcError::Timeout { arm: self.arm.clone(), timeout_s });
            }
            std::thread::sleep(POLL);
        }
    }

    /// [`Client::request`] without a target.
    pub fn ask(&mut self, kind: RequestKind, timeout: Duration) -> Result<Response, IpcError> {
        self.request(Request::new(kind), timeout)
    }

    /// Gives the daemon one target, as if it came by the `target` service, under a source id.
    pub fn set_target(&mut self, source_id: u32, mut target: Target, timeout: Duration) -> Result<Response, IpcError> {
        target.header = Header::new(source_id, 0, monotonic_ns());
        let mut request = Request { target, ..Request::new(RequestKind::SetTarget) };
        request.header.source_id = source_id;
        self.request(request, timeout)
    }
}

/// Publishes one source's messages and numbers them.
#[derive(Debug)]
pub struct SourcePublisher<T: Message> {
    port: Publisher<Ipc, T, ()>,
    source_id: u32,
    sequence: u64,
    _session: Arc<Session>,
}

impl<T: Message> SourcePublisher<T> {
    /// Publishes content captured at `capture_ns` (CLOCK_MONOTONIC); fills in the header. Never waits for a subscriber.
    ///
    /// # Errors
    /// What iceoryx2 reports.
    pub fn publish(&mut self, payload: &mut T, capture_ns: u64) -> Result<(), IpcError> {
        *payload.header_mut() = Header::new(self.source_id, self.sequence, capture_ns);
        self.send(payload)
    }

    /// Publishes content for a tick in lockstep.
    ///
    /// # Errors
    /// What iceoryx2 reports.
    pub fn publish_for_tick(&mut self, payload: &mut T, capture_ns: u64, tick: u64) -> Result<(), IpcError> {
        *payload.header_mut() = Header::new(self.source_id, self.sequence, capture_ns).for_tick(tick);
        self.send(payload)
    }

    fn send(&mut self, payload: &T) -> Result<(), IpcError> {
        send(&self.port, payload)?;
        self.sequence += 1;
        Ok(())
    }
}

/// Receives the newest messages.
#[derive(Debug)]
pub struct NewestSubscriber<T: Message> {
    port: Subscriber<Ipc, T, ()>,
    _session: Arc<Session>,
}

impl<T: Message> NewestSubscriber<T> {
    /// The next message that waits: at most one per publisher.
    ///
    /// # Errors
    /// What iceoryx2 reports.
    pub fn receive(&self) -> Result<Option<T>, IpcError> {
        let sample = self.port.receive().map_err(|e| IpcError::port("receiving", T::SERVICE, e))?;
        Ok(sample.map(|s| *s))
    }

    /// Waits for a message; `None` after the timeout.
    ///
    /// # Errors
    /// What iceoryx2 reports.
    pub fn wait(&self, timeout: Duration) -> Result<Option<T>, IpcError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(message) = self.receive()? {
                return Ok(Some(message));
            }
            if Instant::now() >= deadline {
                return Ok(None);
            }
            std::thread::sleep(POLL);
        }
    }
}
