//! The services of one arm and their settings.

use super::IpcError;
use super::domain::{Ipc, Session};
use super::payload::{Encoders, Header, Obstacles, Request, Response, SCHEMA_VERSION, State, Target, Tip};
use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::service::builder::publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError};
use iceoryx2::service::builder::request_response::{RequestResponseOpenError, RequestResponseOpenOrCreateError};
use iceoryx2::service::port_factory::{publish_subscribe, request_response};

pub(crate) type Topic<T> = publish_subscribe::PortFactory<Ipc, T, ()>;
pub(crate) type Requests = request_response::PortFactory<Ipc, Request, (), Response, ()>;

/// Most processes that have one of an arm's services open.
const MAX_NODES: usize = 32;
/// Requests of one client that wait for an answer.
const MAX_ACTIVE_REQUESTS: usize = 4;
/// Clients of the request service.
const MAX_CLIENTS: usize = 16;

/// A payload of a publish-subscribe service.
pub trait Message: std::fmt::Debug + Copy + ZeroCopySend + 'static {
    /// Last part of the service's name.
    const SERVICE: &'static str;
    /// Most publishers; the dead ones among them count until the next process starts.
    const MAX_PUBLISHERS: usize;
    /// Most subscribers.
    const MAX_SUBSCRIBERS: usize;

    /// Header.
    fn header(&self) -> &Header;
    /// Header.
    fn header_mut(&mut self) -> &mut Header;
}

macro_rules! message {
    ($type:ident, $service:literal, $publishers:literal, $subscribers:literal) => {
        impl Message for $type {
            const SERVICE: &'static str = $service;
            const MAX_PUBLISHERS: usize = $publishers;
            const MAX_SUBSCRIBERS: usize = $subscribers;

            fn header(&self) -> &Header {
                &self.header
            }

            fn header_mut(&mut self) -> &mut Header {
                &mut self.header
            }
        }
    };
}

message!(Encoders, "encoders", 4, 8);
message!(Obstacles, "obstacles", 16, 8);
message!(Target, "target", 4, 8);
message!(Tip, "tip", 4, 8);
message!(State, "state", 1, 16);

/// Full name of one of an arm's services.
pub fn service_name(arm: &str, service: &str) -> String {
    format!("sinew/{arm}/{service}")
}

/// Newest value wins: a full buffer overwrites, so a publisher never waits for a slow subscriber.
fn settings<T: Message>(
    session: &Session,
    name: &str,
) -> Result<iceoryx2::service::builder::publish_subscribe::Builder<T, (), Ipc>, IpcError> {
    Ok(session
        .service(name)?
        .publish_subscribe::<T>()
        .history_size(1)
        .subscriber_max_buffer_size(1)
        .subscriber_max_borrowed_samples(2)
        .enable_safe_overflow(true)
        .max_publishers(T::MAX_PUBLISHERS)
        .max_subscribers(T::MAX_SUBSCRIBERS)
        .max_nodes(MAX_NODES))
}

/// Opens the service, or creates it: the daemon's way.
pub(crate) fn create<T: Message>(session: &Session, arm: &str) -> Result<Topic<T>, IpcError> {
    let name = service_name(arm, T::SERVICE);
    settings::<T>(session, &name)?.open_or_create().map_err(|e| match e {
        PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(e) => open_error(&name, arm, e),
        e => IpcError::port("creating the service", &name, e),
    })
}

/// Opens an existing service: the clients' way.
pub(crate) fn open<T: Message>(session: &Session, arm: &str) -> Result<Topic<T>, IpcError> {
    let name = service_name(arm, T::SERVICE);
    settings::<T>(session, &name)?.open().map_err(|e| open_error(&name, arm, e))
}

fn open_error(name: &str, arm: &str, error: PublishSubscribeOpenError) -> IpcError {
    match error {
        PublishSubscribeOpenError::DoesNotExist | PublishSubscribeOpenError::IsMarkedForDestruction => {
            IpcError::NoDaemon { arm: arm.to_owned() }
        }
        PublishSubscribeOpenError::IncompatibleTypes => {
            IpcError::IncompatiblePayload { service: name.to_owned(), expected: SCHEMA_VERSION }
        }
        PublishSubscribeOpenError::ExceedsMaxNumberOfNodes => {
            IpcError::Full { service: name.to_owned(), port: "process" }
        }
        e => IpcError::port("opening the service", name, e),
    }
}

fn request_settings(
    session: &Session,
    name: &str,
) -> Result<iceoryx2::service::builder::request_response::Builder<Request, (), Response, (), Ipc>, IpcError> {
    Ok(session
        .service(name)?
        .request_response::<Request, Response>()
        .max_servers(1)
        .max_clients(MAX_CLIENTS)
        .max_active_requests_per_client(MAX_ACTIVE_REQUESTS)
        .max_response_buffer_size(1)
        .max_nodes(MAX_NODES))
}

pub(crate) fn create_requests(session: &Session, arm: &str) -> Result<Requests, IpcError> {
    let name = service_name(arm, "request");
    request_settings(session, &name)?.open_or_create().map_err(|e| match e {
        RequestResponseOpenOrCreateError::RequestResponseOpenError(e) => request_open_error(&name, arm, e),
        e => IpcError::port("creating the service", &name, e),
    })
}

pub(crate) fn open_requests(session: &Session, arm: &str) -> Result<Requests, IpcError> {
    let name = service_name(arm, "request");
    request_settings(session, &name)?.open().map_err(|e| request_open_error(&name, arm, e))
}

fn request_open_error(name: &str, arm: &str, error: RequestResponseOpenError) -> IpcError {
    match error {
        RequestResponseOpenError::DoesNotExist | RequestResponseOpenError::IsMarkedForDestruction => {
            IpcError::NoDaemon { arm: arm.to_owned() }
        }
        RequestResponseOpenError::IncompatibleRequestOrResponseType => {
            IpcError::IncompatiblePayload { service: name.to_owned(), expected: SCHEMA_VERSION }
        }
        RequestResponseOpenError::ExceedsMaxNumberOfNodes => {
            IpcError::Full { service: name.to_owned(), port: "process" }
        }
        e => IpcError::port("opening the service", name, e),
    }
}
