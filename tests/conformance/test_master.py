"""sinew's master, drives made of python canopen's LocalNode as the slaves."""

import struct
import subprocess
import threading
import unittest

import canopen

from bench import EDS, Bench

NODES = [3, 4]
NEXT = {  # state by statusword bits, controlword bits 0 to 3 -> next state
    (0x40, 0x6): 0x21,
    (0x21, 0x7): 0x23,
    (0x21, 0x0): 0x40,
    (0x23, 0xF): 0x27,
    (0x23, 0x6): 0x21,
    (0x27, 0x7): 0x23,
    (0x27, 0x0): 0x40,
}


class PythonDrive:
    """As much of a drive as a master needs, on the library's server, PDO maps and NMT slave."""

    def __init__(self, network, node_id):
        self.local = canopen.LocalNode(node_id, EDS)
        self.network, self.id = network, node_id
        self.state, self.torque, self.target = 0x40, 0, 0
        self.rpdo = None
        network.add_node(self.local)
        self.local.add_read_callback(self.on_read)
        network.subscribe(0, self.on_nmt)
        network.subscribe(0x200 + node_id, self.on_rpdo)
        network.subscribe(0x80, self.on_sync)

    def on_read(self, index, subindex, od):
        if index == 0x6061:
            return self.local.sdo[0x6060].raw
        return None

    def on_nmt(self, cob_id, data, timestamp):
        if data[0] == 129 and data[1] in (0, self.id):
            # The library has taken the command; the boot-up message is the application's business.
            self.local.nmt.state = "INITIALISING"
            self.local.nmt.state = "PRE-OPERATIONAL"

    def on_rpdo(self, cob_id, data, timestamp):
        self.rpdo = struct.unpack("<Hh", data)

    def mapping(self, index):
        return [self.local.sdo[index][s].raw for s in range(1, 1 + self.local.sdo[index][0].raw)]

    def on_sync(self, cob_id, data, timestamp):
        if self.local.nmt.state != "OPERATIONAL":
            return
        if self.rpdo:
            word, self.target = self.rpdo
            self.state = NEXT.get((self.state, word & 0xF), self.state)
        if self.state == 0x27:
            self.torque = self.target
        feedback = struct.pack("<Hih", self.state, 7 * self.torque, self.torque)
        self.network.send_message(0x180 + self.id, feedback)


class MasterTest(unittest.TestCase):
    def test_bring_up_torque_feedback_and_disabling(self):
        bench = Bench(NODES, "master", "--torque", "123", "--wait", stdin=subprocess.PIPE)
        self.addCleanup(bench.close)
        drives = [PythonDrive(bench.network, n) for n in NODES]
        beats = []
        bench.network.subscribe(0x77F, lambda cob_id, data, timestamp: beats.append(bytes(data)))
        lock = threading.Timer(60, bench.process.kill)
        lock.start()
        self.addCleanup(lock.cancel)
        bench.process.stdin.write("\n")
        bench.process.stdin.flush()
        bench.expect("operational")
        bench.expect("enabled")
        for n in NODES:
            bench.expect(f"node={n} statusword=0x0027 position={7 * 123} torque=123")
        bench.expect("disabled")
        bench.network.disconnect()
        bench.process.stdin.close()
        self.assertEqual(bench.process.wait(60), 0)
        for d in drives:
            self.assertEqual(d.state, 0x40)
            self.assertEqual(d.mapping(0x1600), [0x60400010, 0x60710010])
            self.assertEqual(d.mapping(0x1A00), [0x60410010, 0x60640020, 0x60770010])
            self.assertEqual(d.local.sdo[0x1400][2].raw, 1)
            self.assertEqual(d.local.sdo[0x6060].raw, 10)
            self.assertEqual(d.local.sdo[0x1016][1].raw, 127 << 16 | 5000)
        self.assertEqual(set(beats), {b"\5"})


if __name__ == "__main__":
    unittest.main()
