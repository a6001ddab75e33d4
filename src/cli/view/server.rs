//! The page and its stream, on 127.0.0.1.
//!
//! All is read only, and all that the page loads comes from here. A page of another site that finds the port may not read it:
//! requests must name this computer as their host (so no name that was bent to 127.0.0.1 serves), and no other origin is permitted.

use super::hub::{Hub, Piece};
use super::recorded::Recorded;
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, HeaderMap, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{StatusCode, Uri};
use axum::middleware::{Next, from_fn};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::stream::{Stream, unfold};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;

/// Nothing from elsewhere; the one script in the page itself, its map of imports, is named by its hash.
const POLICY: &str = "default-src 'none'; script-src 'self' 'sha256-5ofpvxVlfjfLl2HabHI3myvhBlpBeaEb3J8JAsMbQOM='; style-src 'self' 'unsafe-inline'; \
    img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

macro_rules! files {
    ($($path:literal, $kind:expr;)*) => {
        &[$((concat!("/", $path), $kind, include_str!(concat!("page/", $path)))),*]
    };
}

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

/// Path, kind and content of every file of the page.
static FILES: &[(&str, &str, &str)] = files! {
    "index.html", HTML;
    "style.css", STYLE;
    "main.js", SCRIPT;
    "arm.js", SCRIPT;
    "world.js", SCRIPT;
    "obstacles.js", SCRIPT;
    "playback.js", SCRIPT;
    "plots.js", SCRIPT;
    "panels.js", SCRIPT;
    "window.js", SCRIPT;
    "colours.js", SCRIPT;
    "vendor/three/build/three.module.js", SCRIPT;
    "vendor/three/build/three.core.js", SCRIPT;
    "vendor/three/examples/jsm/controls/OrbitControls.js", SCRIPT;
    "vendor/three/examples/jsm/geometries/ConvexGeometry.js", SCRIPT;
    "vendor/three/examples/jsm/math/ConvexHull.js", SCRIPT;
    "vendor/uplot/dist/uPlot.esm.js", SCRIPT;
    "vendor/uplot/dist/uPlot.min.css", STYLE;
};

/// What requests are answered from.
#[derive(Debug, Clone)]
pub(super) struct Site {
    /// What moves.
    pub(super) hub: Arc<Hub>,
    /// What does not, as JSON.
    pub(super) scene: Arc<str>,
    /// The recording that is looked at, in place of what moves.
    pub(super) recorded: Option<Arc<Mutex<Recorded>>>,
}

/// All that is served.
pub(super) fn router(site: Site) -> Router {
    Router::new()
        .route("/scene", get(scene))
        .route("/events", get(events))
        .route("/frames/{from_s}/{to_s}/{most}", get(frames))
        .fallback(get(file))
        .layer(from_fn(local_alone))
        .with_state(site)
}

/// Whether a request names this computer as its host.
fn is_local(headers: &HeaderMap) -> bool {
    let host = headers.get(HOST).and_then(|host| host.to_str().ok()).unwrap_or("");
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    ["127.0.0.1", "localhost"].contains(&name)
}

async fn local_alone(request: Request, next: Next) -> Response {
    if !is_local(request.headers()) {
        return (StatusCode::FORBIDDEN, "sinew view serves http://127.0.0.1 and http://localhost alone\n")
            .into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let fixed = axum::http::HeaderValue::from_static;
    headers.insert(CONTENT_SECURITY_POLICY, fixed(POLICY));
    headers.insert(X_CONTENT_TYPE_OPTIONS, fixed("nosniff"));
    // Another version of sinew may be behind the same address soon.
    headers.insert(CACHE_CONTROL, fixed("no-cache"));
    response
}

async fn file(uri: Uri) -> Response {
    let path = if uri.path() == "/" { "/index.html" } else { uri.path() };
    match FILES.iter().find(|(name, _, _)| *name == path) {
        Some((_, kind, content)) => ([(CONTENT_TYPE, *kind)], *content).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

async fn scene(State(site): State<Site>) -> Response {
    ([(CONTENT_TYPE, "application/json")], site.scene.to_string()).into_response()
}

/// Frames of a recording: at most so many, of a range of times (s).
async fn frames(State(site): State<Site>, Path((from_s, to_s, most)): Path<(f64, f64, usize)>) -> Response {
    let Some(recorded) = site.recorded else { return StatusCode::NOT_FOUND.into_response() };
    let read = move || {
        let frames = recorded.lock().unwrap_or_else(PoisonError::into_inner).frames([from_s, to_s], most);
        frames.map_err(|e| e.to_string()).and_then(|frames| serde_json::to_string(&frames).map_err(|e| e.to_string()))
    };
    match tokio::task::spawn_blocking(read).await {
        Ok(Ok(text)) => ([(CONTENT_TYPE, "application/json")], text).into_response(),
        Ok(Err(why)) => (StatusCode::INTERNAL_SERVER_ERROR, why).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

async fn events(State(site): State<Site>) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let (first, receiver) = site.hub.listen();
    let stream = unfold((first, receiver), async |(mut first, mut receiver)| {
        let piece = next(&mut first, &mut receiver).await?;
        let event = Event::default().event(piece.0.name()).data(piece.1);
        Some((Ok(event), (first, receiver)))
    });
    Sse::new(stream).keep_alive(KeepAlive::default())
}

/// What is known already, then what comes. A page that is too slow misses frames.
async fn next(first: &mut VecDeque<Piece>, receiver: &mut Receiver<Piece>) -> Option<Piece> {
    if let Some(piece) = first.pop_front() {
        return Some(piece);
    }
    loop {
        match receiver.recv().await {
            Ok(piece) => return Some(piece),
            Err(RecvError::Lagged(_)) => {}
            Err(RecvError::Closed) => return None,
        }
    }
}
