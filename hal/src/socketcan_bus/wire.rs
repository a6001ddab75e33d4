//! The kernel's frame formats, byte for byte (`linux/can.h`, `linux/can/error.h`), and its time stamps.
//!
//! Pure functions on bytes: what cannot be decoded is said so, never guessed, never a panic.

use crate::can::{BusState, Frame, Id, Kind};

/// Size of `struct can_frame`.
pub(super) const CLASSIC_LEN: usize = libc::CAN_MTU;
/// Size of `struct canfd_frame`.
pub(super) const FD_LEN: usize = libc::CANFD_MTU;

/// What an error frame says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ErrorReport {
    /// State of the controller, where the frame tells it.
    pub state: Option<BusState>,
    /// Transmit and receive error counters, where the frame tells them.
    pub counters: Option<(u8, u8)>,
    /// The controller's receive buffer overflowed: frames were lost.
    pub overflow: bool,
}

/// One datagram of a CAN socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Datagram {
    Frame(Frame),
    Error(ErrorReport),
    Invalid,
}

/// Writes the kernel's form of a frame; returns its length, which also says its kind.
pub(super) fn encode(frame: &Frame, out: &mut [u8; FD_LEN]) -> usize {
    let id = match frame.id() {
        Id::Standard(i) => u32::from(i),
        Id::Extended(i) => i | libc::CAN_EFF_FLAG,
    };
    let (id, flags, len) = match frame.kind() {
        Kind::Classic => (id, 0, CLASSIC_LEN),
        Kind::Remote => (id | libc::CAN_RTR_FLAG, 0, CLASSIC_LEN),
        Kind::Fd { bit_rate_switch } => (id, if bit_rate_switch { libc::CANFD_BRS as u8 } else { 0 }, FD_LEN),
    };
    out.fill(0);
    out[..4].copy_from_slice(&id.to_ne_bytes());
    out[4] = frame.len() as u8; // at most 64
    out[5] = flags;
    out[8..8 + frame.data().len()].copy_from_slice(frame.data());
    len
}

/// Reads the kernel's form.
pub(super) fn decode(bytes: &[u8]) -> Datagram {
    let fd = match bytes.len() {
        CLASSIC_LEN => false,
        FD_LEN => true,
        _ => return Datagram::Invalid,
    };
    let word = u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let data = &bytes[8..];
    if word & libc::CAN_ERR_FLAG != 0 {
        return Datagram::Error(error_report(word, data));
    }
    let id = if word & libc::CAN_EFF_FLAG == 0 {
        Id::Standard((word & libc::CAN_SFF_MASK) as u16)
    } else {
        Id::Extended(word & libc::CAN_EFF_MASK)
    };
    let kind = match (fd, word & libc::CAN_RTR_FLAG != 0) {
        (true, _) => Kind::Fd { bit_rate_switch: i32::from(bytes[5]) & libc::CANFD_BRS != 0 },
        (false, true) => Kind::Remote,
        (false, false) => Kind::Classic,
    };
    let frame = data.get(..usize::from(bytes[4])).map(|data| Frame::new(id, kind, data));
    match frame {
        // A length that the wire does not have would have been padded.
        Some(Ok(frame)) if frame.len() == usize::from(bytes[4]) => Datagram::Frame(frame),
        _ => Datagram::Invalid,
    }
}

// From linux/can/error.h; the classes are in libc, these details of data[1] are not in every version of it.
const RX_OVERFLOW: u8 = 0x01;
const WARNING: u8 = 0x04 | 0x08;
const PASSIVE: u8 = 0x10 | 0x20;
const ACTIVE: u8 = 0x40;

/// Class bits in the identifier, details in the data.
fn error_report(id: u32, data: &[u8]) -> ErrorReport {
    let byte = |i: usize| data.get(i).copied().unwrap_or(0);
    let has = |class: u32| id & class != 0;
    let controller = if has(libc::CAN_ERR_CRTL) { byte(1) } else { 0 };
    let counters = has(CAN_ERR_CNT).then(|| (byte(6), byte(7)));
    let by_flags = if has(libc::CAN_ERR_BUSOFF) {
        Some(BusState::BusOff)
    } else if controller & PASSIVE != 0 {
        Some(BusState::ErrorPassive)
    } else if controller & WARNING != 0 {
        Some(BusState::ErrorWarning)
    } else if controller & ACTIVE != 0 || has(libc::CAN_ERR_RESTARTED) {
        Some(BusState::ErrorActive)
    } else {
        None
    };
    let by_counters = || {
        counters.map(|(tx, rx)| match tx.max(rx) {
            128.. => BusState::ErrorPassive,
            96.. => BusState::ErrorWarning,
            _ => BusState::ErrorActive,
        })
    };
    ErrorReport { state: by_flags.or_else(by_counters), counters, overflow: controller & RX_OVERFLOW != 0 }
}

/// Error counters are in data[6] and data[7].
const CAN_ERR_CNT: u32 = 0x200;

/// A stamp of CLOCK_REALTIME as CLOCK_MONOTONIC, both clocks read now. A wall clock that was set back since gives a
/// stamp in the future, which becomes now; one that was set forward makes the frame look older, the safe direction.
pub(super) fn to_monotonic(stamp_real_ns: u64, now_real_ns: u64, now_monotonic_ns: u64) -> u64 {
    now_monotonic_ns.saturating_sub(now_real_ns.saturating_sub(stamp_real_ns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn classic(id: u32, len: u8, data: [u8; 8]) -> [u8; 16] {
        let mut b = [0; 16];
        b[..4].copy_from_slice(&id.to_ne_bytes());
        b[4] = len;
        b[8..].copy_from_slice(&data);
        b
    }

    fn error(class: u32, data: [u8; 8]) -> ErrorReport {
        match decode(&classic(0x2000_0000 | class, 8, data)) {
            Datagram::Error(report) => report,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn frames_lie_in_memory_as_the_kernel_has_them() {
        let mut out = [0xff; FD_LEN];
        let f = Frame::classic(Id::Standard(0x123), &[1, 2, 3]).unwrap();
        assert_eq!(encode(&f, &mut out), 16);
        assert_eq!(out[..16], classic(0x123, 3, [1, 2, 3, 0, 0, 0, 0, 0]));
        let f = Frame::new(Id::Extended(0x1abc_def0), Kind::Remote, &[0; 5]).unwrap();
        assert_eq!(encode(&f, &mut out), 16);
        assert_eq!(out[..16], classic(0x1abc_def0 | 0xc000_0000, 5, [0; 8]));
        let f = Frame::new(Id::Standard(1), Kind::Fd { bit_rate_switch: true }, &[7; 20]).unwrap();
        assert_eq!(encode(&f, &mut out), 72);
        assert_eq!((out[4], out[5], out[8], out[27], out[28]), (20, 1, 7, 7, 0));
    }

    #[test]
    fn error_frames_tell_the_state_of_the_controller() {
        // (class, data[1]) as drivers send them; can_change_state() sets both directions' bits when they agree.
        for (class, detail, state) in [
            (0x40, 0, Some(BusState::BusOff)),
            (0x44, 0x30, Some(BusState::BusOff)),
            (0x04, 0x0c, Some(BusState::ErrorWarning)),
            (0x04, 0x08, Some(BusState::ErrorWarning)),
            (0x04, 0x10, Some(BusState::ErrorPassive)),
            (0x04, 0x24, Some(BusState::ErrorPassive)),
            (0x04, 0x40, Some(BusState::ErrorActive)),
            (0x100, 0, Some(BusState::ErrorActive)),
            (0x88, 0, None),
            (0x20, 0, None),
            (0x04, 0x01, None),
        ] {
            let report = error(class, [0, detail, 0, 0, 0, 0, 200, 200]);
            assert_eq!((report.state, report.counters), (state, None), "{class:#x} {detail:#x}");
        }
        assert!(error(0x04, [0, 1, 0, 0, 0, 0, 0, 0]).overflow);
    }

    #[test]
    fn error_counters_are_read_only_where_the_frame_says_that_they_are_there() {
        let at = |tx, rx| error(0x200, [0, 0, 0, 0, 0, 0, tx, rx]);
        assert_eq!(
            at(95, 3),
            ErrorReport { state: Some(BusState::ErrorActive), counters: Some((95, 3)), overflow: false }
        );
        assert_eq!(at(96, 3).state, Some(BusState::ErrorWarning));
        assert_eq!(at(3, 127).state, Some(BusState::ErrorWarning));
        assert_eq!(at(128, 0).state, Some(BusState::ErrorPassive));
        // The state bits of the controller win over its counters.
        assert_eq!(error(0x204, [0, 0x40, 0, 0, 0, 0, 130, 0]).state, Some(BusState::ErrorActive));
    }

    #[test]
    fn datagrams_of_wrong_lengths_are_invalid() {
        for len in (0..100).filter(|l| *l != 16 && *l != 72) {
            assert_eq!(decode(&vec![0; len]), Datagram::Invalid);
        }
        assert_eq!(decode(&classic(1, 9, [0; 8])), Datagram::Invalid);
        let mut fd = [0; 72];
        fd[4] = 9;
        assert_eq!(decode(&fd), Datagram::Invalid, "9 bytes do not exist in CAN FD");
        fd[4] = 65;
        assert_eq!(decode(&fd), Datagram::Invalid);
    }

    #[test]
    fn stamps_move_to_the_monotonic_clock_and_never_to_its_future() {
        assert_eq!(to_monotonic(1_000_000, 1_000_400, 5_000), 4_600);
        assert_eq!(to_monotonic(1_000_000, 1_000_000, 5_000), 5_000);
        assert_eq!(to_monotonic(2_000_000, 1_000_000, 5_000), 5_000);
        assert_eq!(to_monotonic(0, u64::MAX, 5_000), 0);
    }

    proptest! {
        #[test]
        fn arbitrary_datagrams_decode_or_are_refused_and_frames_survive(bytes in prop::collection::vec(any::<u8>(), 72), fd: bool) {
            if let Datagram::Frame(frame) = decode(&bytes[..if fd { 72 } else { 16 }]) {
                let mut out = [0; FD_LEN];
                let len = encode(&frame, &mut out);
                prop_assert_eq!(decode(&out[..len]), Datagram::Frame(frame));
            }
        }
    }
}
