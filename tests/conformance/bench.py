"""Starts the Rust side (`canopen_bench`) and connects python-can to its bus."""

import os
import subprocess

import canopen

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
EDS = os.path.join(ROOT, "sim_plant", "eds", "sinew_drive.eds")
SOCKETCAN = os.environ.get("SINEW_CONFORMANCE_SOCKETCAN")


class Bench:
    """One process of the Rust side, and a canopen network on the same bus."""

    def __init__(self, nodes, *role, stdin=None):
        command = [os.environ["SINEW_CONFORMANCE_BENCH"], "--nodes", ",".join(map(str, nodes))]
        if SOCKETCAN:
            command += ["--interface", "socketcan", "--bus", SOCKETCAN]
        else:
            self.bus_name = f"conformance{os.getpid()}"
            command += ["--bus", self.bus_name, "--socketcand", "0"]
        self.process = subprocess.Popen(command + list(role), stdout=subprocess.PIPE, stdin=stdin, text=True)
        self.network = canopen.Network()
        if SOCKETCAN:
            self.network.connect(interface="socketcan", channel=SOCKETCAN)
        else:
            port = int(self.process.stdout.readline().split("=")[1])
            self.network.connect(interface="socketcand", host="127.0.0.1", port=port, channel="vcan0", tcp_tune=True)

    def expect(self, line):
        found = self.process.stdout.readline().strip()
        assert found == line, f"expected {line!r}, found {found!r}"

    def close(self):
        # Before the Rust side ends and takes its server with it.
        self.network.disconnect()
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        if self.process.stdin:
            self.process.stdin.close()
