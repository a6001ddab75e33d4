#!/usr/bin/env python3
"""The real system on the kernel's CAN: `sinew demo tip` over vcan, with candump beside it.

Enters: the folder of the programs, the interfaces (one or four), the layout of the frames, how much of the scenario to
run. Leaves: the demo's own table, what `sinew status` says of the buses meanwhile, and the count of every kind of frame
that candump saw. Exit code 0 only if
- the demo ends without fault and contact, and, if the run goes that far, with the moving ball held off at the configured
  clearance: without avoidance it would be inside the arm then;
- every drive of every bus was commanded and answered in every tick, and nothing else was on the buses;
- what a drive reports as its torque is what the last command before the SYNC asked of it, in every answer from the one
  on with which its brake has opened;
- in the packed layout commands and answers are CAN FD frames with bit-rate switch, in the classic one none is.

The period is 20 ms, not the shipped 10 ms, because an emulated processor takes a tenth of a second for a tick; in
lockstep that changes nothing but the duration. (At the paper's 100 ms the closed loop is unstable: its observer needs
25 ms or less.) For the same reason the plant takes one step a period, not two.
"""

import argparse
import collections
import os
import re
import subprocess
import tempfile

import arm

PERIOD_S = 0.02
DRIVES = 24
OPERATION_ENABLED = 0x27
# A TIME object of six bytes with worst-case stuffing, and the nominal bit rate of all buses.
TIME_BITS = 115
BITRATE_BPS = 1e6
# The scenario's second ball reaches the arm by then (s); what keeps it off is `clearance_m`.
BALL_NEAR_S = 9.0
CLEARANCE_MM = 10.0
# The scenario's clock begins so long after the arm tracks (s).
APPROACH_S = 4.0


def kind_of(identifier):
    """Name and node of a frame by the predefined connection set of CiA 301."""
    function, node = identifier & 0x780, identifier & 0x7F
    if identifier == 0x080:
        return "SYNC", 0
    if identifier == 0x000:
        return "NMT", 0
    if identifier == 0x100:
        return "TIME", 0
    names = {0x080: "EMCY", 0x180: "TPDO1", 0x200: "RPDO1", 0x580: "SDO answer", 0x600: "SDO request", 0x700: "heartbeat"}
    return names.get(function, f"0x{function:03X}"), node


class Torques:
    """Commands and answers of one bus: who was told what, who says what."""

    def __init__(self, interface, nodes, packed):
        self.interface, self.nodes, self.packed = interface, nodes, packed
        self.told, self.latched, self.following = {}, {}, set()
        self.commands, self.answers = collections.Counter(), collections.Counter()
        self.followed = self.pulling = 0

    def see(self, frame):
        kind, node = kind_of(frame.identifier)
        if kind == "RPDO1":
            self.on_command(frame, node)
        elif kind == "SYNC":
            self.latched = dict(self.told)
        elif kind == "TPDO1":
            self.on_answer(frame, node)

    def on_command(self, frame, node):
        require_format(frame, self.packed)
        slots = enumerate(self.nodes) if self.packed else [(0, node)]
        arm.require(not self.packed or node == 0, f"{self.interface}: a classic command of node {node}")
        for place, to in slots:
            self.told[to] = int.from_bytes(frame.data[4 * place + 2 : 4 * place + 4], "little", signed=True)
            self.commands[to] += 1

    def on_answer(self, frame, node):
        require_format(frame, self.packed)
        arm.require(node in self.nodes, f"{self.interface}: process data of the unknown node {node}")
        self.answers[node] += 1
        statusword = int.from_bytes(frame.data[0:2], "little")
        torque = int.from_bytes(frame.data[6:8], "little", signed=True)
        if statusword & 0x6F != OPERATION_ENABLED:
            return
        told = self.latched.get(node)
        if torque == told:
            self.following.add(node)
        # Before that the brake holds the drum, and the drive reports what it holds.
        if node in self.following:
            arm.require(torque == told, f"{self.interface}: node {node} was told {told} per mille and has {torque}")
            self.followed += 1
            self.pulling += torque != 0

    def judge(self, ticks):
        arm.require(set(self.commands) == set(self.nodes), f"{self.interface}: commanded were {sorted(self.commands)}")
        for node in self.nodes:
            commands, answers = self.commands[node], self.answers[node]
            arm.require(commands >= ticks, f"{self.interface}: node {node} was commanded {commands} times")
            arm.require(answers >= ticks, f"{self.interface}: node {node} answered {answers} times in {ticks} ticks")
        # A cable may be slack for a while.
        arm.require(self.pulling > 0.5 * ticks * len(self.nodes), f"{self.interface}: {self.pulling} answers with torque")
        print(f"{self.interface}: all {self.followed} answers of drives with open brakes have the torque commanded, "
              f"{self.pulling} of them one that pulls")


def require_format(frame, packed):
    arm.require((frame.is_fd, frame.has_rate_switch) == (packed, packed), f"of the wrong format: {frame}")


def judge_frames(path, interfaces, ticks, packed):
    """That every drive was commanded and answered in every tick, and that nothing else was on the buses."""
    count = collections.defaultdict(collections.Counter)
    beats = collections.defaultdict(collections.Counter)
    nodes = range(1, DRIVES // len(interfaces) + 1)
    torques = {interface: Torques(interface, nodes, packed) for interface in interfaces}
    shown = set()
    print("first frame of each kind, as candump has it:")
    for frame in arm.frames(path):
        kind, node = kind_of(frame.identifier)
        count[frame.interface][kind] += 1
        beats[frame.interface][node] += kind == "heartbeat"
        torques[frame.interface].see(frame)
        if kind not in shown:
            shown.add(kind)
            form = " (CAN FD, bit-rate switch)" if frame.has_rate_switch else ""
            whose = f" of node {node}" if node else ""
            print(f"   {frame.interface} {frame.identifier:03X}#{frame.data.hex().upper()} {kind}{whose}{form}")
    known = {"SYNC", "TIME", "NMT", "TPDO1", "RPDO1", "SDO answer", "SDO request", "heartbeat"}
    for interface in interfaces:
        seen = count[interface]
        print(f"{interface}: " + ", ".join(f"{number} {kind}" for kind, number in sorted(seen.items())))
        arm.require(set(seen) <= known, f"{interface}: unexpected frames: {set(seen) - known}")
        arm.require(seen["SYNC"] >= ticks, f"{interface}: {seen['SYNC']} SYNC in {ticks} ticks")
        arm.require(all(beats[interface][node] > 0 for node in nodes), f"{interface}: heartbeats of {beats[interface]}")
        torques[interface].judge(ticks)


def judge_table(table, duration_s):
    """That the moving ball was where it matters, and held off."""
    found = re.search(r"2: least surface distance, whole arm\W+([\d.]+) mm", table)
    arm.require(found, "the table has no least distance of ball 2")
    if duration_s >= BALL_NEAR_S:
        nearest_mm = float(found[1])
        # The reference keeps 2 mm more than the clearance, and lets a slow ball take a quarter of what is left of a distance per
        # second: at the end of this run the arm has not come nearer. Without avoidance it would be 0.09 m inside the ball soon
        # after.
        arm.require(nearest_mm < 2.5 * CLEARANCE_MM, f"the ball was never nearer than {nearest_mm} mm: nothing to avoid")


def drives_file(buses, packed):
    """The shipped one of so many buses and this layout."""
    files = {(1, False): "drives.toml", (4, False): "drives-4-buses.toml", (4, True): "drives-4-fd-buses.toml"}
    arm.require((buses, packed) in files, f"no configuration has {buses} buses{' of CAN FD' if packed else ''}")
    return files[buses, packed]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binaries")
    parser.add_argument("interfaces", nargs="+")
    parser.add_argument("--duration", type=float, default=10.0, help="seconds of the scenario, after its approach of 4 s")
    parser.add_argument("--packed", action="store_true", help="CAN FD, one command frame for all drives of a bus")
    arguments = parser.parse_args()
    interfaces = arguments.interfaces
    print(f"Linux {os.uname().release}, {len(interfaces)} bus(es): {', '.join(interfaces)}", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        # Lowering the arm would take minutes here, and shows nothing about the bus. All of the distance kept is clearance: the
        # ball is to be avoided within seconds, however well the estimate knows where the arm is.
        changes = {
            "controller.toml": {
                "period_s": PERIOD_S,
                "stop_timeout_s": 0.0,
                "clearance_m": 1e-3 * CLEARANCE_MM,
                "margin_sigmas": 0.0,
            },
            "plant.toml": {"step_s": PERIOD_S},
        }
        config = arm.configuration(folder, drives_file(len(interfaces), arguments.packed), changes)
        keep = os.path.join(folder, "kept")
        log = os.path.join(folder, "candump.log")
        candump = arm.Candump(log, interfaces)
        program = os.path.join(arguments.binaries, "sinew")
        command = [program, "demo", "tip", "--fast", "--duration", str(arguments.duration), "--keep", keep]
        command += ["--can", ",".join(interfaces), "--config", *config]
        print("sinew " + " ".join(command[1:]), flush=True)
        demo = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        # The demo's own configuration names its shared memory; it is written before anything starts.
        sinew = arm.Sinew(arguments.binaries, [os.path.join(keep, "demo.toml")])
        while not os.path.exists(sinew.config[0]):
            arm.require(demo.poll() in (None, 0), f"the demo ended with {demo.poll()}")
        report = sinew.until("the arm tracks", lambda r: r["mode"] == "tracking" and r["ticks"] > 100, [demo])
        print(sinew.call("status", "--config", *sinew.config).stdout, flush=True)
        for bus in report["buses"]:
            computed, measured = bus["load_computed"], bus["load_measured"]
            print(f"{bus['name']}: load computed {100 * computed:.1f} %, measured {100 * measured:.1f} %")
            # Over half a second of the arm: a heartbeat more or less, and a tick. TIME ends the periods of lockstep alone.
            most = 1.2 * computed + TIME_BITS / PERIOD_S / BITRATE_BPS
            arm.require(0.8 * computed < measured < most, "the measured load is not the computed one")
            arm.require(bus["state"] == "ErrorActive" and bus["lost"] == 0, f"{bus}")
        table, _ = demo.communicate()
        code = demo.returncode
        print(table, flush=True)
        candump.stop()
        if code != 0:
            for name in sorted(os.listdir(keep)):
                if name.endswith(".log"):
                    with open(os.path.join(keep, name), encoding="utf-8", errors="replace") as file:
                        print(f"-- {name}\n{file.read()[-3000:]}")
        arm.require(code == 0, f"the demo ended with {code}: contact, a fault, or worse (see above)")
        judge_table(table, arguments.duration)
        judge_frames(log, interfaces, int((APPROACH_S + arguments.duration) / PERIOD_S), arguments.packed)
    print(f"the arm followed its path over {', '.join(interfaces)}")


if __name__ == "__main__":
    arm.run_main(main)
