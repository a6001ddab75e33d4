#!/usr/bin/env python3
"""The bus is lost under the real system: `sim_plant` and `sinew run` on one vcan, in real time, holding 10 N a cable.

The arm has four segments as the paper's, but three cables and one element each: an emulated processor cannot simulate
the paper's in real time, and a plant that is always behind does not answer its drives' configuration in time.

Enters: the folder of the programs, an interface of this script's own choice to take down. Leaves: exit code 0 if
- the daemon faults, says which bus, and stays faulted when the bus is back;
- the drives, who hear neither heartbeat nor SYNC any more, go to their safe tension by themselves before it is back;
- while it is away, and while the fault is latched, arming is refused;
- `clear`, then `arm` bring all drives up again, and an ordered stop ends without a fault.

Times are the shipped ones, stretched for an emulated processor; outcomes are states and an order of events, not
durations. The drives' side is read from the plant's own record of what their drums were told.
"""

import argparse
import os
import signal
import subprocess
import tempfile
import time

import arm

DRIVES = 12
TENSION_N = 10.0
# A tenth of the rated torque's per mille: what 0 N may be on the wire.
ZERO_N = 0.5
HEARTBEAT_TIMEOUT_S = 2.0
SYNC_TIMEOUT_S = 1.5
SAFE_RAMP_S = 0.2

CHANGES = {
    "arm.toml": {"cables": 3, "elements": 1},
    "controller.toml": {
        # A late tick is this processor's doing and not a claim here.
        "period_s": "0.05\noverruns_hold = 1000\noverruns_fault = 10000",
        "encoder_silent_s": 5.0,
        "encoder_stuck_s": 10.0,
    },
    "drives.toml": {
        "kind": '"socketcan"',
        "interface": '"INTERFACE"',
        "heartbeat_s": 0.2,
        "heartbeat_timeout_s": HEARTBEAT_TIMEOUT_S,
        "sync_timeout_s": SYNC_TIMEOUT_S,
    },
    # Two steps a period: drives that a late plant finds silent all at once let go within a step or two.
    "plant.toml": {"step_s": 0.025, "mesh_refinement": 1},
}


def link(interface, state):
    subprocess.run(["ip", "link", "set", interface, state], check=True)
    print(f"ip link set {interface} {state}", flush=True)


def enabled(report):
    return report["mode"] == "holding" and report["drives"]["enabled"] == DRIVES


def judge_trace(path):
    """When the drums were let go, in the plant's own time."""
    # Of the conformance environment.
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    # Time, SYNCs served so far, largest tension told to a drum.
    truth = []
    with open(path, "rb") as file:
        decode = None
        for index, (schema, channel, message) in enumerate(make_reader(file).iter_messages()):
            # A fifth of them is close enough, and an emulated processor is slow to decode.
            if index % 5 or not channel.topic.endswith("/state"):
                continue
            decode = decode or DecoderFactory().decoder_for(channel.message_encoding, schema)
            state = decode(message.data)
            tensions = state.tension_command_n[:DRIVES]
            truth.append((state.header.capture_ns * 1e-9, state.header.tick, max(tensions)))
    # The bus was away where no SYNC came for longest while the cables were pulled.
    since_sync = {}
    for row in truth:
        since_sync.setdefault(row[1], []).append(row)
    pulled = [rows for rows in since_sync.values() if rows[0][2] > TENSION_N / 2]
    arm.require(pulled, f"the cables never had {TENSION_N} N")
    away = max(pulled, key=lambda rows: rows[-1][0] - rows[0][0])
    safe = [row for row in away if row[2] < ZERO_N]
    arm.require(safe, "the drives still pulled when the bus came back")
    arm.require(away[-1][2] < ZERO_N, "the drives pulled again while the bus was away")
    print(
        f"drives: last SYNC at {away[0][0]:.2f} s of the plant, all drums at 0 N {safe[0][0] - away[0][0]:.2f} s later "
        f"(SYNC time-out {SYNC_TIMEOUT_S} s, heartbeat time-out {HEARTBEAT_TIMEOUT_S} s, ramp {SAFE_RAMP_S} s), "
        f"bus away for {away[-1][0] - away[0][0]:.2f} s"
    )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binaries")
    parser.add_argument("interface")
    arguments = parser.parse_args()
    interface = arguments.interface
    print(f"Linux {os.uname().release}, {interface}", flush=True)
    CHANGES["drives.toml"]["interface"] = f'"{interface}"'

    with tempfile.TemporaryDirectory() as folder:
        config = arm.configuration(folder, "drives.toml", CHANGES)
        sinew = arm.Sinew(arguments.binaries, config)
        trace = os.path.join(folder, "truth.mcap")
        plant = subprocess.Popen(
            [sinew.plant, "--config", *config, "--trace", trace], stdout=subprocess.PIPE, text=True
        )
        print(plant.stdout.readline().strip(), flush=True)
        tensions = ",".join([str(TENSION_N)] * DRIVES)
        daemon = subprocess.Popen([sinew.program, "run", "--config", *config, f"--start-tensions={tensions}"])
        both = [plant, daemon]
        sinew.until("drives ready", lambda r: r["drives"]["ready"] == DRIVES and r["mode"] == "disarmed", both)
        arm.require(sinew.ask("arm"), "arming refused")
        sinew.until("holding", enabled, both)

        link(interface, "down")
        # The bus's state is told twice a second, the fault at once.
        report = sinew.until(
            "a fault and a bus that is down",
            lambda r: r["fault"] is not None and r["mode"] == "faulted" and r["buses"][0]["state"] == "Down",
            both,
        )
        print(f"daemon: fault {report['fault']['code']}: {report['fault']['what']}", flush=True)
        arm.require(not sinew.ask("arm"), "armed with a fault and without a bus")
        # Three times what the drives need.
        time.sleep(3 * (HEARTBEAT_TIMEOUT_S + SAFE_RAMP_S))

        link(interface, "up")
        report = sinew.until("the bus back", lambda r: r["buses"][0]["state"] == "ErrorActive", both)
        arm.require(report["mode"] == "faulted" and report["fault"], f"the fault went by itself: {report['mode']}")
        arm.require(not sinew.ask("arm"), "armed with a latched fault")
        while not sinew.ask("clear"):
            time.sleep(0.5)
        sinew.until(
            "drives ready again",
            lambda r: r["fault"] is None and r["drives"]["ready"] == DRIVES and r["mode"] == "disarmed",
            both,
        )
        arm.require(sinew.ask("arm"), "arming refused after the fault was cleared")
        sinew.until("holding again", enabled, both)
        arm.require(sinew.ask("stop"), "the stop was refused")
        sinew.until("disarmed", lambda r: r["mode"] == "disarmed" and r["drives"]["enabled"] == 0, both)
        daemon.send_signal(signal.SIGTERM)
        arm.require(daemon.wait() == 0, f"the daemon ended with {daemon.returncode}")
        plant.send_signal(signal.SIGTERM)
        arm.require(plant.wait() == 0, f"the plant ended with {plant.returncode}")
        judge_trace(trace)
    print("the bus was lost and is back: drives safe by themselves, fault latched, cleared, armed again")


if __name__ == "__main__":
    arm.run_main(main)
