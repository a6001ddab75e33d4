#!/usr/bin/env python3
"""Raw sockets on two vcan interfaces, with nothing but Python's standard library.

Enters: the names of two interfaces that are up with an MTU of 72. Leaves: exit code 0 if classic, extended, remote and
FD frames arrive unchanged, in order, with a kernel time stamp, only on their own interface and only where a filter
lets them through. It must never use what this project wrote: it is what a failing test of the backend is held against.
"""

import socket
import struct
import sys
import time

CLASSIC = struct.Struct("=IB3x8s")  # struct can_frame
FD = struct.Struct("=IBB2x64s")  # struct canfd_frame
BIT_RATE_SWITCH = 0x01
FD_FRAME = 0x04  # set by kernels from 6.1 on in the flags of what they deliver
SO_TIMESTAMPNS = 35


def open_raw(interface: str) -> socket.socket:
    """A raw socket that takes FD frames and asks for receive time stamps."""
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    bus.settimeout(10.0)
    bus.bind((interface,))
    return bus


def receive(bus: socket.socket) -> tuple[bytes, int]:
    """The next frame and its kernel time stamp (ns, CLOCK_REALTIME)."""
    frame, ancillary, _, _ = bus.recvmsg(FD.size, 128)
    for level, kind, data in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS):
            seconds, nanoseconds = struct.unpack("=qq", data)
            return frame, seconds * 1_000_000_000 + nanoseconds
    raise AssertionError("a frame came without a time stamp")


def assert_silent(bus: socket.socket, what: str) -> None:
    """Fails if a frame waits; vcan delivers before `send` returns, so nothing can still be under way."""
    bus.setblocking(False)
    try:
        frame = bus.recv(FD.size)
    except BlockingIOError:
        return
    raise AssertionError(f"{what}: {frame.hex()}")


def main(first: str, second: str) -> None:
    sender, receiver, stranger, filtered = open_raw(first), open_raw(first), open_raw(second), open_raw(first)
    filtered.setsockopt(
        socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, struct.pack("=II", 0x181, socket.CAN_SFF_MASK | socket.CAN_EFF_FLAG)
    )

    frames = [
        CLASSIC.pack(0x181, 8, bytes(range(8))),
        CLASSIC.pack(0x080, 0, bytes(8)),
        CLASSIC.pack(0x1ABCDEF0 | socket.CAN_EFF_FLAG, 3, b"\x01\x02\x03" + bytes(5)),
        CLASSIC.pack(0x701 | socket.CAN_RTR_FLAG, 1, bytes(8)),
        FD.pack(0x200, 64, BIT_RATE_SWITCH, bytes(range(64))),
        FD.pack(0x201, 12, 0, bytes(range(12)) + bytes(52)),
    ]
    before_ns = time.time_ns()
    for frame in frames:
        assert sender.send(frame) == len(frame)
    last_ns = before_ns
    for sent in frames:
        got, time_ns = receive(receiver)
        if len(got) == FD.size:
            got = got[:5] + bytes([got[5] & ~FD_FRAME]) + got[6:]
        assert got == sent, f"sent {sent.hex()}, received {got.hex()}"
        assert last_ns <= time_ns <= time.time_ns(), "the time stamps do not rise"
        last_ns = time_ns

    assert receive(filtered)[0] == frames[0], "the filter let a wrong frame through"
    assert_silent(filtered, "the filter let a second frame through")
    assert_silent(receiver, "a frame came twice")
    assert_silent(sender, "a socket received what it sent itself")
    assert_silent(stranger, f"a frame on {first} reached {second}")
    print(f"can_loopback: {len(frames)} frames on {first}, none of them on {second}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
