//! Where the log goes: standard error.
//!
//! Enters: finished lines, from any thread. Leaves: the same lines on standard error. A pipe that nobody reads, a terminal
//! that is stopped or a journal that is stuck blocks whoever writes to it, so the daemon's threads must never do that: while
//! a [`Queue`] lives, lines go through a bounded queue to a thread without priority, and those that find it full are
//! dropped, counted, and told of as soon as there is room. Every other command writes by itself.

use super::complain;
use std::io::{self, Stderr, Write};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use tracing_appender::non_blocking::{ErrorCounter, NonBlocking, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::fmt::writer::EitherWriter;

/// Lines that may wait.
const LINES: usize = 4096;
/// Time between two attempts to tell of what was dropped.
const TELL: Duration = Duration::from_secs(1);
/// How long the end waits for room in the queue; the library then waits as long for the queue to be written.
const ROOM: Duration = Duration::from_secs(1);

static QUEUE: OnceLock<NonBlocking> = OnceLock::new();

/// Where a line goes now.
pub(crate) fn writer() -> EitherWriter<NonBlocking, Stderr> {
    match QUEUE.get() {
        Some(queue) => EitherWriter::A(queue.clone()),
        None => EitherWriter::B(io::stderr()),
    }
}

/// The queue and its thread; at its end what waits is written, if it can be within two seconds.
pub(crate) struct Queue {
    guard: Option<WorkerGuard>,
    lines: NonBlocking,
    losses: Losses,
}

/// What was dropped, and what of it has been told.
struct Losses {
    counter: ErrorCounter,
    told: usize,
    /// Dropped lines that were to tell of dropped lines.
    own: usize,
    tried: Instant,
}

impl Queue {
    /// From here on the lines of all threads go through the queue, and panics are lines as well: whoever panics must not
    /// wait for standard error either. The thread is where the calling one may be. To be called once.
    ///
    /// # Errors
    /// No thread can be started.
    pub(crate) fn start() -> io::Result<Self> {
        // The library panics where it gets none.
        let tried = std::thread::Builder::new().spawn(|| {})?;
        // Its place is free again only when it has ended.
        let _ = tried.join();
        let queue = Self::before(io::stderr(), LINES);
        // A second one would not be heard of; the first stays.
        let _ = QUEUE.set(queue.lines.clone());
        std::panic::set_hook(Box::new(|panic| {
            let trace = std::backtrace::Backtrace::capture();
            match trace.status() {
                std::backtrace::BacktraceStatus::Captured => complain(format_args!("{panic}\n{trace}")),
                _ => complain(panic),
            }
        }));
        Ok(queue)
    }

    fn before(target: impl Write + Send + 'static, lines: usize) -> Self {
        let builder = NonBlockingBuilder::default().buffered_lines_limit(lines).lossy(true).thread_name("sinew-log");
        let (lines, guard) = builder.finish(target);
        let losses = Losses { counter: lines.error_counter(), told: 0, own: 0, tried: Instant::now() };
        Self { guard: Some(guard), lines, losses }
    }

    /// Tells of dropped lines, at most once a second; to be called now and then.
    pub(crate) fn tell(&mut self) {
        if self.losses.tried.elapsed() > TELL {
            self.losses.tell(&mut self.lines);
        }
    }
}

impl Losses {
    fn tell(&mut self, lines: &mut NonBlocking) {
        self.tried = Instant::now();
        let before = self.counter.dropped_lines();
        let dropped = before.saturating_sub(self.own + self.told);
        if dropped == 0 {
            return;
        }
        let _ =
            lines.write_all(format!("sinew: {dropped} lines of this log were dropped: nobody took them\n").as_bytes());
        if self.counter.dropped_lines() == before {
            self.told += dropped;
        } else {
            self.own += 1;
        }
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        let deadline = Instant::now() + ROOM;
        loop {
            let before = self.losses.counter.dropped_lines();
            // An empty line shows whether there is room, and leaves nothing behind.
            let _ = self.lines.write_all(&[]);
            if self.losses.counter.dropped_lines() == before {
                break;
            }
            self.losses.own += 1;
            if Instant::now() > deadline {
                // The guard would say on standard output that it cannot, and wait there if that is the same pipe.
                std::mem::forget(self.guard.take());
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.losses.tell(&mut self.lines);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, Sender, channel};

    /// Somebody who takes nothing before he is told to.
    struct Slow {
        begun: Sender<()>,
        go: Receiver<()>,
        taken: Sender<Vec<u8>>,
    }

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.begun.send(());
            // Once the other end is gone, nothing holds him any more.
            let _ = self.go.recv();
            let _ = self.taken.send(bytes.to_vec());
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// A queue that is full: one line is being written, so many wait, ten were dropped.
    fn full(lines: usize) -> (Queue, Sender<()>, Receiver<Vec<u8>>) {
        let ((begun, begins), (go, gone), (taken, takes)) = (channel(), channel(), channel());
        let mut queue = Queue::before(Slow { begun, go: gone, taken }, lines);
        queue.lines.write_all(b"first\n").unwrap();
        begins.recv().unwrap();
        (0..lines + 10).for_each(|i| queue.lines.write_all(format!("{i}\n").as_bytes()).unwrap());
        assert_eq!(queue.losses.counter.dropped_lines(), 10);
        (queue, go, takes)
    }

    #[test]
    fn nobody_waits_for_a_slow_reader_and_what_was_dropped_is_told_when_there_is_room() {
        let (mut queue, go, takes) = full(8);
        queue.losses.tell(&mut queue.lines);
        assert_eq!((queue.losses.told, queue.losses.own), (0, 1), "there is no room for it yet");
        drop(go);
        let before = queue.losses.counter.dropped_lines();
        loop {
            let tried = queue.losses.counter.dropped_lines();
            queue.lines.write_all(b"last words\n").unwrap();
            if queue.losses.counter.dropped_lines() == tried {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let dropped = 10 + queue.losses.counter.dropped_lines() - before;
        drop(queue);
        let text = takes.iter().map(|bytes| String::from_utf8(bytes).unwrap()).collect::<String>();
        let expected = format!(
            "first\n0\n1\n2\n3\n4\n5\n6\n7\nlast words\nsinew: {dropped} lines of this log were dropped: nobody took them\n"
        );
        assert_eq!(text, expected);
    }

    #[test]
    fn the_end_does_not_wait_for_ever_for_somebody_who_takes_nothing() {
        let (queue, go, takes) = full(2);
        drop(queue);
        assert!(takes.try_recv().is_err(), "nothing was taken until here");
        drop(go);
    }
}
