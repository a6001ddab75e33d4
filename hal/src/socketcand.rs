//! A server of the socketcand ASCII protocol: any bus of this crate for clients that speak TCP, such as python-can with
//! `interface="socketcand"`. Raw mode and classic data frames, as those clients use; nothing else.
//!
//! Enters: TCP connections and their `< send ... >` lines; frames of the bus. Leaves: frames on the bus; `< frame ... >`
//! lines. It is a tool for tests and the lab and never part of a control loop: it allocates, formats and owns threads.
//! It has no authentication, as the protocol has none: bind it to 127.0.0.1 only.

use crate::can::{CanBus, Frame, Id, Kind, SendError};
use std::collections::VecDeque;
use std::fmt::Write as _;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Longest line of a client; longer ones end the connection.
const LINE_MAX: usize = 512;
/// How often a thread looks whether it should end.
const TICK: Duration = Duration::from_millis(50);

/// A running server; dropped, it ends with all its connections.
pub struct Server {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    accept: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens on `address` (port 0 chooses a free one) and serves `bus` to any number of clients, whatever name of a
    /// bus they ask for.
    ///
    /// # Errors
    /// The address cannot be bound.
    pub fn start(address: impl std::net::ToSocketAddrs, bus: Box<dyn CanBus>) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let accept = std::thread::Builder::new().name("socketcand".into()).spawn(move || {
            let mut clients = Vec::new();
            while !stopped.load(Ordering::Acquire) {
                match listener.accept() {
                    Ok((stream, _)) => match bus.duplicate() {
                        Ok(handle) => {
                            let stop = stopped.clone();
                            clients.push(std::thread::spawn(move || serve(stream, handle, &stop)));
                        }
                        Err(error) => tracing::warn!(%error, "no further handle on the bus"),
                    },
                    Err(_) => std::thread::sleep(TICK),
                }
                clients.retain(|c: &JoinHandle<()>| !c.is_finished());
            }
            for c in clients {
                let _ = c.join(); // a client's panic was reported by its own thread
            }
        })?;
        Ok(Self { address, stop, accept: Some(accept) })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(t) = self.accept.take() {
            let _ = t.join();
        }
    }
}

/// Frames that the client sent and that its receiving handle, being another one, will see: no client gets its own
/// frames back. They come in the order of sending; what is older than a match was lost.
#[derive(Clone, Default)]
struct Own(Arc<Mutex<VecDeque<Frame>>>);

impl Own {
    fn expect(&self, frame: Frame) {
        let mut own = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if own.len() == 1024 {
            own.pop_front();
        }
        own.push_back(frame);
    }

    fn is_echo(&self, frame: &Frame) -> bool {
        let mut own = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(at) = own.iter().position(|f| f == frame) else { return false };
        own.drain(..=at);
        true
    }
}

/// One client, until it leaves or the server ends.
fn serve(stream: TcpStream, mut bus: Box<dyn CanBus>, stop: &AtomicBool) {
    if let Err(error) = talk(stream, &mut *bus, stop) {
        tracing::debug!(%error, "client gone");
    }
}

fn talk(mut stream: TcpStream, bus: &mut dyn CanBus, stop: &AtomicBool) -> io::Result<()> {
    let gone = Arc::new(AtomicBool::new(false));
    let mut forward = None;
    let result = listen(&mut stream, bus, stop, &gone, &mut forward);
    gone.store(true, Ordering::Release);
    if let Some(t) = forward {
        let _ = t.join(); // its panic was reported by itself
    }
    result
}

/// What the client says, until it leaves, the server ends or nothing can be written any more; the thread that forwards frames
/// to it once it wants them.
fn listen(
    stream: &mut TcpStream,
    bus: &mut dyn CanBus,
    stop: &AtomicBool,
    gone: &Arc<AtomicBool>,
    forward: &mut Option<JoinHandle<()>>,
) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(TICK))?;
    stream.set_write_timeout(Some(TICK))?;
    let ended = || stop.load(Ordering::Acquire) || gone.load(Ordering::Acquire);
    write_all(stream, b"< hi >", ended)?;
    let own = Own::default();
    let mut text = Vec::new();
    let mut chunk = [0; 512];
    while !ended() {
        let count = match stream.read(&mut chunk) {
            Ok(0) => return Ok(()),
            Ok(n) => n,
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => continue,
            Err(e) => return Err(e),
        };
        text.extend_from_slice(&chunk[..count]);
        while let Some(end) = text.iter().position(|&b| b == b'>') {
            let line: Vec<u8> = text.drain(..=end).collect();
            match parse(&line) {
                Some(Line::Open) => write_all(stream, b"< ok >", ended)?,
                Some(Line::RawMode) => {
                    write_all(stream, b"< ok >", ended)?;
                    if forward.is_none() {
                        let (out, handle, gone, own) =
                            (stream.try_clone()?, bus.duplicate()?, gone.clone(), own.clone());
                        *forward = Some(std::thread::spawn(move || forward_frames(out, handle, &gone, &own)));
                    }
                }
                Some(Line::Echo) => write_all(stream, b"< echo >", ended)?,
                Some(Line::Send(frame)) => {
                    if forward.is_some() {
                        own.expect(frame);
                    }
                    send(bus, &frame);
                }
                None => write_all(stream, b"< error unknown command >", ended)?,
            }
        }
        if text.len() > LINE_MAX {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "line too long"));
        }
    }
    Ok(())
}

/// Writes all of it, however slowly the client reads, unless the connection ends meanwhile. The stream has a write timeout.
fn write_all(stream: &mut TcpStream, mut bytes: &[u8], ended: impl Fn() -> bool) -> io::Result<()> {
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(n) => bytes = &bytes[n..],
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) && !ended() => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// A full queue is waited for a little, as a socket would; then the frame is lost, as on a bus that is off.
fn send(bus: &mut dyn CanBus, frame: &Frame) {
    for _ in 0..100 {
        match bus.send(frame) {
            Err(SendError::Full) => std::thread::sleep(Duration::from_millis(1)),
            Ok(()) => return,
            Err(error) => {
                tracing::warn!(%error, ?frame, "not sent");
                return;
            }
        }
    }
    tracing::warn!(?frame, "not sent: queue full");
}

/// From the bus to the client.
fn forward_frames(mut out: TcpStream, mut bus: Box<dyn CanBus>, gone: &AtomicBool, own: &Own) {
    while !gone.load(Ordering::Acquire) {
        match bus.receive(TICK) {
            Ok(Some(received)) => {
                if own.is_echo(&received.frame) {
                    continue;
                }
                if let Some(line) = format_frame(&received.frame)
                    && write_all(&mut out, line.as_bytes(), || gone.load(Ordering::Acquire)).is_err()
                {
                    gone.store(true, Ordering::Release);
                }
            }
            Ok(None) => {}
            Err(_) => std::thread::sleep(TICK), // the bus is down; it may come back
        }
    }
}

/// `< frame 123 1.000000 11223344 >` with the wall clock's time, as the original server has it.
fn format_frame(frame: &Frame) -> Option<String> {
    if frame.kind() != Kind::Classic {
        return None; // the protocol's raw mode has no FD frames, and its clients know no remote requests
    }
    let time = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let id = match frame.id() {
        Id::Standard(i) => format!("{i:03X}"),
        Id::Extended(i) => format!("{i:08X}"),
    };
    let mut line = format!("< frame {id} {}.{:06} ", time.as_secs(), time.subsec_micros());
    frame.data().iter().try_for_each(|b| write!(line, "{b:02X}")).ok()?;
    line.push_str(" >");
    Some(line)
}

#[derive(Debug, PartialEq, Eq)]
enum Line {
    Open,
    RawMode,
    Echo,
    Send(Frame),
}

/// One `< ... >`; what stands before the bracket is skipped.
fn parse(line: &[u8]) -> Option<Line> {
    let text = std::str::from_utf8(line).ok()?;
    let inner = text[text.find('<')? + 1..].strip_suffix('>')?;
    let mut words = inner.split_ascii_whitespace();
    match words.next()? {
        "open" => words.next().map(|_| Line::Open),
        "rawmode" => Some(Line::RawMode),
        "echo" => Some(Line::Echo),
        "send" => {
            let id_word = words.next()?;
            let number = u32::from_str_radix(id_word, 16).ok()?;
            // Clients tell the kinds of identifiers apart by the number of digits.
            let id = if id_word.len() <= 3 { Id::Standard(u16::try_from(number).ok()?) } else { Id::Extended(number) };
            let length = usize::from_str_radix(words.next()?, 16).ok()?;
            let data: Vec<u8> = words.map(|w| u8::from_str_radix(w, 16)).collect::<Result<_, _>>().ok()?;
            (data.len() == length).then_some(())?;
            Frame::classic(id, &data).ok().map(Line::Send)
        }
        _ => None,
    }
}

/// The door of the fuzz target: a line is a command, whose frame has at most eight bytes, or nothing.
#[cfg(fuzzing)]
pub fn fuzz_parse(line: &[u8]) {
    if let Some(Line::Send(frame)) = parse(line) {
        assert!(format_frame(&frame).is_some());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::can::{BusCounters, BusState, Filter, ReceiveError, Received};
    use proptest::prelude::*;
    use std::sync::atomic::AtomicU64;

    #[test]
    fn lines_of_python_can_are_understood() {
        let frame = |id, data: &[u8]| Some(Line::Send(Frame::classic(id, data).unwrap()));
        assert_eq!(parse(b"< open vcan0 >"), Some(Line::Open));
        assert_eq!(parse(b"< rawmode >"), Some(Line::RawMode));
        assert_eq!(parse(b"< send 080 0  >"), frame(Id::Standard(0x80), &[]));
        assert_eq!(parse(b"< send 601 3 40 0 10 >"), frame(Id::Standard(0x601), &[0x40, 0, 0x10]));
        assert_eq!(parse(b"< send 00000601 1 ff >"), frame(Id::Extended(0x601), &[0xff]));
        assert_eq!(parse(b"< send 601 2 40 >"), None);
        assert_eq!(parse(b"< send 801 0 >"), None);
    }

    /// Frames without end, counted.
    struct Endless(Arc<AtomicU64>);

    impl CanBus for Endless {
        fn send(&mut self, _: &Frame) -> Result<(), SendError> {
            Ok(())
        }
        fn receive(&mut self, _: Duration) -> Result<Option<Received>, ReceiveError> {
            self.0.fetch_add(1, Ordering::AcqRel);
            Ok(Some(Received { frame: Frame::classic(Id::Standard(1), &[0; 8]).unwrap(), time_ns: 0 }))
        }
        fn state(&self) -> BusState {
            BusState::ErrorActive
        }
        fn counters(&self) -> BusCounters {
            BusCounters::default()
        }
        fn set_filters(&mut self, _: &[Filter]) -> Result<(), ReceiveError> {
            Ok(())
        }
        fn duplicate(&self) -> io::Result<Box<dyn CanBus>> {
            Ok(Box::new(Self(self.0.clone())))
        }
    }

    #[test]
    fn the_server_ends_although_a_client_does_not_read_and_a_slow_one_gets_all() {
        let taken = Arc::new(AtomicU64::new(0));
        let server = Server::start("127.0.0.1:0", Box::new(Endless(taken.clone()))).unwrap();
        let mut client = TcpStream::connect(server.address()).unwrap();
        client.write_all(b"< open any >< rawmode >").unwrap();
        // Until nothing more goes into the socket.
        let stands = || {
            let before = taken.load(Ordering::Acquire);
            std::thread::sleep(4 * TICK);
            before > 0 && taken.load(Ordering::Acquire) == before
        };
        while !stands() {}
        // It reads again: every line is whole, what could not be written for a while too.
        let mut text = vec![0; 1 << 20];
        client.read_exact(&mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        let lines: Vec<&str> = text.trim_start_matches("< hi >< ok >< ok >").split_inclusive('>').collect();
        assert!(lines.len() > 1000);
        for line in &lines[..lines.len() - 1] {
            assert!(line.starts_with("< frame 001 ") && line.ends_with(" 0000000000000000 >"), "{line}");
        }
        while !stands() {}
        let (tell, told) = std::sync::mpsc::channel();
        let ending = std::thread::spawn(move || {
            drop(server);
            tell.send(()).unwrap();
        });
        told.recv_timeout(Duration::from_secs(60)).expect("the server waits for a client that does not read");
        ending.join().unwrap();
    }

    proptest! {
        #[test]
        fn arbitrary_lines_do_not_panic(line in proptest::collection::vec(any::<u8>(), 0..80)) {
            let _ = parse(&line);
        }

        #[test]
        fn a_send_line_gives_its_frame(id in 0u16..0x800, data in proptest::collection::vec(any::<u8>(), 0..9)) {
            let bytes: Vec<_> = data.iter().map(|b| format!("{b:x}")).collect();
            let line = format!("< send {id:03X} {:X} {} >", data.len(), bytes.join(" "));
            let frame = Frame::classic(Id::Standard(id), &data).unwrap();
            prop_assert_eq!(parse(line.as_bytes()), Some(Line::Send(frame)));
            let head = format!("< frame {id:03X} ");
            let same = format_frame(&frame).unwrap().starts_with(&head);
            prop_assert!(same);
        }
    }
}
