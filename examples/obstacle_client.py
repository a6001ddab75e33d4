#!/usr/bin/env python3
"""Publishes a ball that moves on a circle to the arm's controller, from Python.

    pip install 'iceoryx2==0.10.*'
    python3 examples/obstacle_client.py --arm paper --source 2 --rate 50

It shows what goes over the wire, with nothing but iceoryx2; the package in python/ does this and more in three lines. The
structures below are those of src/ipc/PAYLOADS.md, field by field; their type names carry the schema version, so a
controller of another version refuses them when the service is opened. SINEW_IPC_PREFIX and SINEW_IPC_ROOT choose the
domain, as for every other program of sinew.
"""

import argparse
import ctypes
import math
import os
import signal
import sys
import time

import iceoryx2 as iox2

SCHEMA_VERSION = 1
NO_TICK = 2**64 - 1
MAX_OBSTACLES = 64
MAX_VERTICES = 256
BALL, CAPSULE, BOX, HALF_SPACE, HULL = 1, 2, 3, 4, 5
FLAG_LEAVING = 1


class Header(ctypes.Structure):
    _fields_ = [
        ("schema_version", ctypes.c_uint32),
        ("source_id", ctypes.c_uint32),
        ("sequence", ctypes.c_uint64),
        ("capture_ns", ctypes.c_uint64),
        ("tick", ctypes.c_uint64),
    ]


class Obstacle(ctypes.Structure):
    _fields_ = [
        ("id", ctypes.c_uint32),
        ("kind", ctypes.c_uint32),
        ("position_m", ctypes.c_double * 3),
        ("quaternion", ctypes.c_double * 4),
        ("velocity_mps", ctypes.c_double * 3),
        ("dimensions_m", ctypes.c_double * 3),
        ("covariance_m2", ctypes.c_double * 6),
        ("hull_offset", ctypes.c_uint32),
        ("hull_count", ctypes.c_uint32),
    ]


class Obstacles(ctypes.Structure):
    _fields_ = [
        ("header", Header),
        ("count", ctypes.c_uint32),
        ("vertex_count", ctypes.c_uint32),
        ("flags", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("obstacles", Obstacle * MAX_OBSTACLES),
        ("vertices_m", ctypes.c_double * 3 * MAX_VERTICES),
    ]

    @staticmethod
    def type_name() -> str:
        return f"sinew.Obstacles.v{SCHEMA_VERSION}"


# The sizes of PAYLOADS.md: a slip in a list of fields shows here, not in the arm.
assert ctypes.sizeof(Header) == 32
assert ctypes.sizeof(Obstacle) == 168
assert ctypes.sizeof(Obstacles) == 16944


def domain_config():
    """iceoryx2's configuration, with what the environment overrides."""
    config = iox2.config.default()
    if "SINEW_IPC_PREFIX" in os.environ:
        config.global_cfg.prefix = iox2.FileName.new(os.environ["SINEW_IPC_PREFIX"])
    if "SINEW_IPC_ROOT" in os.environ:
        config.global_cfg.root_path = iox2.Path.new(os.environ["SINEW_IPC_ROOT"])
    return config


def open_publisher(arm: str):
    """Opens the arm's obstacle service; returns the node, which must live as long as the publisher, and the publisher."""
    node = (
        iox2.NodeBuilder.new()
        .name(iox2.NodeName.new("sinew python client"))
        # Signals stay Python's, so that Ctrl-C raises KeyboardInterrupt.
        .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
        .config(domain_config())
        .create(iox2.ServiceType.Ipc)
    )
    name = iox2.ServiceName.new(f"sinew/{arm}/obstacles")
    try:
        service = node.service_builder(name).publish_subscribe(Obstacles).open()
    except iox2.PublishSubscribeOpenError as error:
        sys.exit(f'no controller running for arm "{arm}" with schema version {SCHEMA_VERSION}: {error}')
    return node, service.publisher_builder().create()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arm", default="paper", help="name of the arm")
    parser.add_argument("--source", type=int, default=2, help="source id, the same at every start")
    parser.add_argument("--rate", type=float, default=50.0, help="messages per second")
    parser.add_argument("--duration", type=float, default=math.inf, help="seconds to run")
    parser.add_argument("--centre", type=float, nargs=3, default=[0.40, -0.15, -1.68], help="centre of the circle (m)")
    parser.add_argument("--circle-radius", type=float, default=0.32, help="radius of the circle (m)")
    parser.add_argument("--period", type=float, default=60.0, help="seconds for one turn")
    parser.add_argument("--radius", type=float, default=0.1, help="radius of the ball (m)")
    parser.add_argument("--sigma", type=float, default=0.0, help="standard deviation of the position (m)")
    arguments = parser.parse_args()

    node, publisher = open_publisher(arguments.arm)
    message = Obstacles()
    message.header.schema_version = SCHEMA_VERSION
    message.header.source_id = arguments.source
    message.header.tick = NO_TICK
    message.count = 1
    ball = message.obstacles[0]
    ball.id, ball.kind = 1, BALL
    ball.quaternion[:] = [1.0, 0.0, 0.0, 0.0]
    ball.dimensions_m[0] = arguments.radius
    variance = arguments.sigma**2
    ball.covariance_m2[:] = [variance, 0.0, 0.0, variance, 0.0, variance]

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    start = time.monotonic()
    rate = 2.0 * math.pi / arguments.period
    print(f"publishing sinew/{arguments.arm}/obstacles as source {arguments.source}", flush=True)
    sequence = 0
    try:
        while (now := time.monotonic() - start) < arguments.duration:
            angle = rate * now
            ball.position_m[0] = arguments.centre[0] + arguments.circle_radius * math.cos(angle)
            ball.position_m[1] = arguments.centre[1] + arguments.circle_radius * math.sin(angle)
            ball.position_m[2] = arguments.centre[2]
            ball.velocity_mps[0] = -arguments.circle_radius * rate * math.sin(angle)
            ball.velocity_mps[1] = arguments.circle_radius * rate * math.cos(angle)
            message.header.capture_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
            message.header.sequence = sequence
            publisher.send_copy(message)
            sequence += 1
            time.sleep(max(0.0, sequence / arguments.rate - (time.monotonic() - start)))
    except KeyboardInterrupt:
        pass
    # Leave in order: nobody misses this source from now on.
    message.count = 0
    message.flags = FLAG_LEAVING
    message.header.sequence = sequence
    message.header.capture_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    publisher.send_copy(message)


if __name__ == "__main__":
    main()
