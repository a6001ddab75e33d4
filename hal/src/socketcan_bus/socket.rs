//! One CAN socket: opening with a reason for every refusal, and the system calls that allocate nothing.
//!
//! The `socketcan` crate sets the options; opening, receiving and sending are done here, because it reports the lack of
//! CAN in the kernel as a missing device, and gives no access to the count of frames that the socket dropped.

use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

use socketcan::{CanSocket, SocketOptions};

use super::wire::FD_LEN;
use crate::bus_config::OpenError;

/// Filters that the kernel takes on one socket (CAN_RAW_FILTER_MAX).
pub(super) const FILTERS_MAX: usize = 512;
/// ARPHRD_CAN of linux/if_arp.h.
const HARDWARE_CAN: u16 = 280;
/// Receive buffer asked for (bytes); without privileges the kernel caps it at net.core.rmem_max. A frame takes about
/// 0.7 kB of it, so this holds some 10,000 and the usual cap of 208 KiB some 500: it counts double.
const RECEIVE_BUFFER: libc::c_int = 4 << 20;

/// An interface name that fits the kernel's structure.
#[derive(Clone, Copy)]
pub(super) struct InterfaceName([u8; libc::IFNAMSIZ]);

impl InterfaceName {
    pub(super) fn new(name: &str) -> Result<Self, OpenError> {
        let refuse = || OpenError::Name(name.into());
        let bad = |b: u8| b == 0 || b == b'/' || b.is_ascii_whitespace();
        if name.is_empty() || name.len() >= libc::IFNAMSIZ || name.bytes().any(bad) {
            return Err(refuse());
        }
        let mut bytes = [0; libc::IFNAMSIZ];
        bytes[..name.len()].copy_from_slice(name.as_bytes());
        Ok(Self(bytes))
    }

    pub(super) fn as_str(&self) -> &str {
        let len = self.0.iter().position(|&b| b == 0).unwrap_or(self.0.len());
        std::str::from_utf8(&self.0[..len]).unwrap_or("?")
    }

    fn request(&self) -> libc::ifreq {
        // SAFETY: ifreq is a plain C structure for which all zeros is a valid value.
        let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
        for (to, &from) in request.ifr_name.iter_mut().zip(&self.0) {
            *to = from as libc::c_char;
        }
        request
    }
}

/// Why a socket did not open; becomes an [`OpenError`] with the interface's name outside the real-time path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refusal {
    NoCan,
    Missing,
    NotCan(u16),
    Down,
    Mtu(u32),
    Permission,
    Os(&'static str, i32),
}

impl Refusal {
    fn last(step: &'static str) -> Self {
        Self::from_io(step, &io::Error::last_os_error())
    }

    pub(super) fn from_io(step: &'static str, e: &io::Error) -> Self {
        match e.raw_os_error().unwrap_or(libc::EIO) {
            libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT => Self::NoCan,
            libc::ENODEV | libc::ENXIO => Self::Missing,
            libc::ENETDOWN => Self::Down,
            libc::EPERM | libc::EACCES => Self::Permission,
            other => Self::Os(step, other),
        }
    }

    pub(super) fn into_error(self, name: InterfaceName) -> OpenError {
        let interface = name.as_str().to_owned();
        match self {
            Self::NoCan => OpenError::NoCan { interface },
            Self::Missing => OpenError::Missing { interface },
            Self::NotCan(found) => OpenError::NotCan { interface, found },
            Self::Down => OpenError::Down { interface },
            Self::Mtu(found) => OpenError::Mtu { interface, found },
            Self::Permission => OpenError::Permission { interface },
            Self::Os(step, e) => OpenError::Os { interface, step, source: io::Error::from_raw_os_error(e) },
        }
    }
}

/// Opens, configures and binds a raw CAN socket, non-blocking. Does not allocate.
pub(super) fn open(name: InterfaceName, fd: bool) -> Result<CanSocket, Refusal> {
    // First of all, so that a kernel without CAN is not reported as a missing interface.
    // SAFETY: a plain system call without pointers.
    let raw =
        unsafe { libc::socket(libc::PF_CAN, libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK, libc::CAN_RAW) };
    if raw < 0 {
        return Err(Refusal::last("socket"));
    }
    // SAFETY: raw is a descriptor that was just made and belongs to nobody else.
    let socket = CanSocket::from(unsafe { OwnedFd::from_raw_fd(raw) });

    let index = ask(&socket, name, libc::SIOCGIFINDEX as _, "SIOCGIFINDEX")?;
    let hardware = ask(&socket, name, libc::SIOCGIFHWADDR as _, "SIOCGIFHWADDR")?;
    // SAFETY: the kernel has filled the member that belongs to the request.
    let (index, hardware) = unsafe { (index.ifr_ifru.ifru_ifindex, hardware.ifr_ifru.ifru_hwaddr.sa_family) };
    if hardware != HARDWARE_CAN {
        return Err(Refusal::NotCan(hardware));
    }
    if !is_up(&socket, name)? {
        return Err(Refusal::Down);
    }
    let mtu = ask(&socket, name, libc::SIOCGIFMTU as _, "SIOCGIFMTU")?;
    // SAFETY: as above.
    let mtu = unsafe { mtu.ifr_ifru.ifru_mtu };
    if fd && usize::try_from(mtu).unwrap_or(0) < FD_LEN {
        return Err(Refusal::Mtu(u32::try_from(mtu).unwrap_or(0)));
    }

    let option = |step, result: io::Result<()>| result.map_err(|e| Refusal::from_io(step, &e));
    if fd {
        option("CAN_RAW_FD_FRAMES", socket.set_socket_option_int(libc::SOL_CAN_RAW, libc::CAN_RAW_FD_FRAMES, 1))?;
    }
    option("CAN_RAW_ERR_FILTER", socket.set_error_filter_accept_all())?;
    set_common_options(&socket)?;

    // SAFETY: sockaddr_can is a plain C structure for which all zeros is a valid value.
    let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
    address.can_family = libc::AF_CAN as _;
    address.can_ifindex = index;
    // SAFETY: the pointer and the length are those of a live sockaddr_can.
    let bound = unsafe {
        libc::bind(socket.as_raw_fd(), (&raw const address).cast(), size_of::<libc::sockaddr_can>() as libc::socklen_t)
    };
    if bound < 0 {
        return Err(Refusal::last("bind"));
    }
    Ok(socket)
}

/// Options that are not special to CAN.
pub(super) fn set_common_options(socket: &CanSocket) -> Result<(), Refusal> {
    let option = |step, result: io::Result<()>| result.map_err(|e| Refusal::from_io(step, &e));
    option("SO_TIMESTAMPNS", socket.set_recv_timestamp(true))?;
    option("SO_RXQ_OVFL", socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1))?;
    let buffer = |name| socket.set_socket_option_int(libc::SOL_SOCKET, name, RECEIVE_BUFFER);
    // With CAP_NET_ADMIN beyond the limit of the system, otherwise up to it.
    option("SO_RCVBUF", buffer(libc::SO_RCVBUFFORCE).or_else(|_| buffer(libc::SO_RCVBUF)))
}

fn ask(socket: &CanSocket, name: InterfaceName, what: libc::Ioctl, step: &'static str) -> Result<libc::ifreq, Refusal> {
    let mut request = name.request();
    // SAFETY: these requests read the name from, and write their answer to, a live ifreq.
    if unsafe { libc::ioctl(socket.as_raw_fd(), what, &raw mut request) } < 0 {
        return Err(Refusal::last(step));
    }
    Ok(request)
}

/// Frames that the interface's transmit queue holds.
pub(super) fn transmit_queue(socket: &CanSocket, name: InterfaceName) -> Result<usize, Refusal> {
    let request = ask(socket, name, libc::SIOCGIFTXQLEN as _, "SIOCGIFTXQLEN")?;
    // SAFETY: the kernel has filled this member, which is the number that ifr_qlen names in C.
    Ok(usize::try_from(unsafe { request.ifr_ifru.ifru_metric }).unwrap_or(0))
}

fn is_up(socket: &CanSocket, name: InterfaceName) -> Result<bool, Refusal> {
    let flags = ask(socket, name, libc::SIOCGIFFLAGS as _, "SIOCGIFFLAGS")?;
    // SAFETY: the kernel has filled this member.
    Ok(i32::from(unsafe { flags.ifr_ifru.ifru_flags }) & libc::IFF_UP != 0)
}

/// Takes the interface down and up again, which makes its driver restart a controller that is bus-off.
pub(super) fn cycle(socket: &CanSocket, name: InterfaceName) -> Result<(), Refusal> {
    let mut request = ask(socket, name, libc::SIOCGIFFLAGS as _, "SIOCGIFFLAGS")?;
    // SAFETY: the kernel has filled this member.
    let flags = unsafe { request.ifr_ifru.ifru_flags };
    let up = libc::IFF_UP as libc::c_short;
    for flags in [flags & !up, flags | up] {
        request.ifr_ifru.ifru_flags = flags;
        // SAFETY: this request reads a live ifreq.
        if unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCSIFFLAGS as _, &raw const request) } < 0 {
            return Err(Refusal::last("SIOCSIFFLAGS"));
        }
    }
    Ok(())
}

/// Installs filters given as the kernel's `struct can_filter` (identifier, mask). Does not allocate.
pub(super) fn set_filters(socket: &CanSocket, filters: &[[u32; 2]]) -> io::Result<()> {
    let mut bytes = [0; FILTERS_MAX * 8];
    let used = bytes.get_mut(..filters.len() * 8).ok_or(io::ErrorKind::InvalidInput)?;
    for (eight, [id, mask]) in used.chunks_exact_mut(8).zip(filters) {
        eight[..4].copy_from_slice(&id.to_ne_bytes());
        eight[4..].copy_from_slice(&mask.to_ne_bytes());
    }
    socket.set_socket_option_bytes(libc::SOL_CAN_RAW, libc::CAN_RAW_FILTER, used)
}

/// Sends one datagram without blocking.
pub(super) fn send(socket: &CanSocket, bytes: &[u8]) -> Result<(), i32> {
    loop {
        // SAFETY: the pointer and the length are those of a live slice.
        let n = unsafe {
            libc::send(socket.as_raw_fd(), bytes.as_ptr().cast(), bytes.len(), libc::MSG_DONTWAIT | libc::MSG_NOSIGNAL)
        };
        match if n < 0 { errno() } else { 0 } {
            0 => return Ok(()),
            libc::EINTR => {}
            e => return Err(e),
        }
    }
}

/// One datagram.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Arrival {
    /// Bytes; more than the buffer has if it was cut.
    pub(super) len: usize,
    /// CLOCK_REALTIME of its arrival (ns).
    pub(super) stamp_real_ns: Option<u64>,
    /// Frames that this socket has dropped so far, because its buffer was full.
    pub(super) dropped: Option<u32>,
    /// Sent by a process of this machine.
    pub(super) local: bool,
}

/// Room for the control messages asked for, aligned as they need.
#[repr(C, align(8))]
struct Control([u8; 128]);

/// Receives one datagram without blocking.
pub(super) fn receive(socket: &CanSocket, buffer: &mut [u8; FD_LEN]) -> Result<Arrival, i32> {
    let mut part = libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: buffer.len() };
    let mut control = Control([0; 128]);
    // SAFETY: msghdr is a plain C structure for which all zeros is a valid value.
    let mut message: libc::msghdr = unsafe { std::mem::zeroed() };
    message.msg_iov = &raw mut part;
    message.msg_iovlen = 1;
    message.msg_control = (&raw mut control).cast();
    message.msg_controllen = size_of::<Control>() as _;
    let n = loop {
        // SAFETY: all pointers in message are to live objects of the lengths given.
        let n = unsafe { libc::recvmsg(socket.as_raw_fd(), &raw mut message, libc::MSG_DONTWAIT | libc::MSG_TRUNC) };
        match if n < 0 { errno() } else { 0 } {
            0 => break n,
            libc::EINTR => {}
            e => return Err(e),
        }
    };
    let mut arrival = Arrival {
        len: usize::try_from(n).unwrap_or(0),
        local: message.msg_flags & libc::MSG_DONTROUTE != 0,
        ..Arrival::default()
    };
    // SAFETY: message is as recvmsg left it, its control buffer alive and aligned; the macros stay inside of it.
    let mut header = unsafe { libc::CMSG_FIRSTHDR(&raw const message) };
    while !header.is_null() {
        // SAFETY: header points at a complete cmsghdr inside the control buffer.
        let (level, kind, len) = unsafe { ((*header).cmsg_level, (*header).cmsg_type, (*header).cmsg_len as usize) };
        // SAFETY: as above; the payload is read only if its whole length is there, and without assuming alignment.
        unsafe {
            let data = libc::CMSG_DATA(header);
            let holds = |size: usize| len >= libc::CMSG_LEN(size as u32) as usize;
            if level == libc::SOL_SOCKET && kind == libc::SO_TIMESTAMPNS && holds(size_of::<libc::timespec>()) {
                let t = data.cast::<libc::timespec>().read_unaligned();
                let ns = (t.tv_sec.max(0) as u64).saturating_mul(1_000_000_000).saturating_add(t.tv_nsec.max(0) as u64);
                arrival.stamp_real_ns = (ns != 0).then_some(ns);
            } else if level == libc::SOL_SOCKET && kind == libc::SO_RXQ_OVFL && holds(4) {
                arrival.dropped = Some(data.cast::<u32>().read_unaligned());
            }
        }
        // SAFETY: as for CMSG_FIRSTHDR.
        header = unsafe { libc::CMSG_NXTHDR(&raw const message, header) };
    }
    Ok(arrival)
}

fn errno() -> i32 {
    io::Error::last_os_error().raw_os_error().unwrap_or(libc::EIO)
}
