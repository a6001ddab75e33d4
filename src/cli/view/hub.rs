//! From the threads that look at the daemon to the pages that are open, each of which gets the whole window first.

use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::broadcast::{Receiver, Sender, channel};

/// What a page hears of; the names are those of its events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topic {
    /// Whether there is a daemon.
    Link,
    /// The daemon's report.
    Status,
    /// A record.
    Frame,
    /// All records of the window, in an array.
    Window,
}

impl Topic {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Link => "link",
            Self::Status => "status",
            Self::Frame => "frame",
            Self::Window => "window",
        }
    }
}

/// A topic and its JSON.
pub(super) type Piece = (Topic, Arc<str>);

/// Frames that are kept: a minute of them.
pub(super) const WINDOW: usize = 1800;
/// Pieces that a page may be late by before it misses some.
const LATE: usize = 64;

#[derive(Debug)]
pub(super) struct Hub {
    to: Sender<Piece>,
    kept: Mutex<Kept>,
}

#[derive(Debug, Default)]
struct Kept {
    link: Option<Arc<str>>,
    status: Option<Arc<str>>,
    frames: VecDeque<Arc<str>>,
}

impl Hub {
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self { to: channel(LATE).0, kept: Mutex::default() })
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// To all pages, and kept for those that come.
    pub(super) fn say(&self, topic: Topic, content: &impl Serialize) {
        let Ok(text) = serde_json::to_string(content) else { return };
        let text: Arc<str> = text.into();
        let mut kept = self.kept();
        match topic {
            Topic::Link => kept.link = Some(text.clone()),
            Topic::Status => kept.status = Some(text.clone()),
            Topic::Frame => {
                if kept.frames.len() == WINDOW {
                    kept.frames.pop_front();
                }
                kept.frames.push_back(text.clone());
            }
            Topic::Window => {}
        }
        // Nobody need be there.
        let _ = self.to.send((topic, text));
    }

    /// Another run begins: what was before it is forgotten.
    pub(super) fn forget(&self) {
        let mut kept = self.kept();
        kept.frames.clear();
        kept.status = None;
        let _ = self.to.send((Topic::Window, "[]".into()));
    }

    /// What is known by now, and what will come after it.
    pub(super) fn listen(&self) -> (VecDeque<Piece>, Receiver<Piece>) {
        let kept = self.kept();
        let receiver = self.to.subscribe();
        let (link, status) = (kept.link.clone(), kept.status.clone());
        let frames: Vec<Arc<str>> = kept.frames.iter().cloned().collect();
        drop(kept);
        let window = format!("[{}]", frames.iter().map(AsRef::as_ref).collect::<Vec<&str>>().join(","));
        let pieces = [(Topic::Link, link), (Topic::Status, status), (Topic::Window, Some(window.into()))];
        (pieces.into_iter().filter_map(|(topic, text)| Some((topic, text?))).collect(), receiver)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_comes_late_gets_the_window_and_then_what_is_new() {
        let hub = Hub::new();
        (0..WINDOW + 2).for_each(|i| hub.say(Topic::Frame, &i));
        hub.say(Topic::Link, &"here");
        let (first, mut next) = hub.listen();
        assert_eq!(first[0], (Topic::Link, "\"here\"".into()));
        let window: Vec<usize> = serde_json::from_str(&first[1].1).unwrap();
        assert_eq!((window.len(), window[0]), (WINDOW, 2));
        hub.say(Topic::Frame, &7);
        assert_eq!(next.try_recv().unwrap(), (Topic::Frame, "7".into()));
        hub.forget();
        assert_eq!(next.try_recv().unwrap(), (Topic::Window, "[]".into()));
        assert_eq!(hub.listen().0[1].1, "[]".into());
    }
}
