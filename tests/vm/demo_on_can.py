#!/usr/bin/env python3
"""The real system on the kernel's CAN: `sinew demo tip` over vcan, with candump beside it.

Enters: the folder of the programs, the interfaces (one or four), how much of the scenario to run. Leaves: the demo's own
table, what `sinew status` says of the buses meanwhile, and the count of every kind of frame that candump saw. Exit code
0 only if the demo ends without fault and contact, and every drive of every bus was commanded and answered in every tick.

The period is 20 ms, not the shipped 10 ms, because an emulated processor takes a tenth of a second for a tick; in
lockstep that changes nothing but the duration. (At the paper's 100 ms the closed loop is unstable: its observer needs
25 ms or less.)
"""

import argparse
import collections
import os
import subprocess
import tempfile

import arm

PERIOD_S = 0.02
DRIVES = 24
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


def judge_frames(path, interfaces, ticks):
    """That every drive was commanded and answered in every tick, and that nothing else was on the buses."""
    count = collections.defaultdict(collections.Counter)
    nodes = collections.defaultdict(collections.Counter)
    shown = set()
    print("first frame of each kind, as candump has it:")
    for interface, identifier, data in arm.frames(path):
        kind, node = kind_of(identifier)
        count[interface][kind] += 1
        nodes[interface][kind, node] += 1
        if kind not in shown:
            shown.add(kind)
            print(f"   {interface} {identifier:03X}#{data} ({kind}{f' of node {node}' if node else ''})")
    for interface in interfaces:
        print(f"{interface}: " + ", ".join(f"{number} {kind}" for kind, number in sorted(count[interface].items())))
    each = DRIVES // len(interfaces)
    for interface in interfaces:
        seen, of_node = count[interface], nodes[interface]
        known = {"SYNC", "TIME", "NMT", "TPDO1", "RPDO1", "SDO answer", "SDO request", "heartbeat"}
        arm.require(set(seen) <= known, f"{interface}: unexpected frames: {set(seen) - known}")
        arm.require(seen["SYNC"] >= ticks, f"{interface}: {seen['SYNC']} SYNC in {ticks} ticks")
        for node in range(1, each + 1):
            commands, answers = of_node["RPDO1", node], of_node["TPDO1", node]
            arm.require(commands >= ticks, f"{interface}: node {node} was commanded {commands} times in {ticks} ticks")
            arm.require(answers >= ticks, f"{interface}: node {node} answered {answers} times in {ticks} ticks")
            arm.require(of_node["heartbeat", node] > 0, f"{interface}: no heartbeat of node {node}")
        strangers = {node for kind, node in of_node if kind in ("RPDO1", "TPDO1") and not 1 <= node <= each}
        arm.require(not strangers, f"{interface}: process data of unknown nodes {strangers}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binaries")
    parser.add_argument("interfaces", nargs="+")
    parser.add_argument("--duration", type=float, default=10.0, help="seconds of the scenario, after its approach of 4 s")
    arguments = parser.parse_args()
    interfaces = arguments.interfaces
    print(f"Linux {os.uname().release}, {len(interfaces)} bus(es): {', '.join(interfaces)}", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        changes = {"controller.toml": {"period_s": PERIOD_S}, "plant.toml": {"step_s": PERIOD_S}}
        config = arm.configuration(folder, len(interfaces), changes)
        keep = os.path.join(folder, "kept")
        log = os.path.join(folder, "candump.log")
        candump = arm.Candump(log, interfaces)
        program = os.path.join(arguments.binaries, "sinew")
        command = [program, "demo", "tip", "--fast", "--duration", str(arguments.duration), "--keep", keep]
        command += ["--can", ",".join(interfaces), "--config", *config]
        print("sinew " + " ".join(command[1:]), flush=True)
        demo = subprocess.Popen(command)
        # The demo's own configuration names its shared memory; it is written before anything starts.
        sinew = arm.Sinew(arguments.binaries, [os.path.join(keep, "demo.toml")])
        while not os.path.exists(sinew.config[0]):
            arm.require(demo.poll() in (None, 0), f"the demo ended with {demo.poll()}")
        report = sinew.until("the arm tracks", lambda r: r["mode"] == "tracking" and r["ticks"] > 100, [demo])
        print(sinew.call("status", "--config", *sinew.config).stdout, flush=True)
        for bus in report["buses"]:
            computed, measured = bus["load_computed"], bus["load_measured"]
            print(f"{bus['name']}: load computed {100 * computed:.1f} %, measured {100 * measured:.1f} %")
            # Over half a second of the arm: a heartbeat more or less, and a tick.
            arm.require(0.8 * computed < measured < 1.2 * computed, "the measured load is not the computed one")
            arm.require(bus["state"] == "ErrorActive" and bus["lost"] == 0, f"{bus}")
        code = demo.wait()
        candump.stop()
        if code != 0:
            for name in sorted(os.listdir(keep)):
                if name.endswith(".log"):
                    with open(os.path.join(keep, name), encoding="utf-8", errors="replace") as file:
                        print(f"-- {name}\n{file.read()[-3000:]}")
        arm.require(code == 0, f"the demo ended with {code}: contact, a fault, or worse (see above)")
        judge_frames(log, interfaces, int((APPROACH_S + arguments.duration) / PERIOD_S))
    print(f"the arm followed its path over {', '.join(interfaces)}")


if __name__ == "__main__":
    arm.run_main(main)
