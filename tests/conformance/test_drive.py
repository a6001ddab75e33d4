"""python canopen as the master, sinew's simulated drive as the slave."""

import struct
import time
import unittest

import canopen
from canopen.objectdictionary import ODVariable
from canopen.profiles.p402 import BaseNode402, State402
from canopen.sdo import SdoAbortedError

from bench import EDS, Bench

NODE = 5
MASTER = 100


# Time-outs of the drive's monitors (ms): longer than a busy machine keeps a sender of 20 or 50 ms waiting. And how long
# nothing may come of them while what they watch for is there (s).
MONITOR_MS = 1500
WATCHED_S = 2.0


def until(condition, timeout=30.0):
    """True as soon as the condition holds, false when the time is over."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


class DriveTest(unittest.TestCase):
    def setUp(self):
        self.bench = Bench([NODE, NODE + 1], "drives")
        self.addCleanup(self.bench.close)
        self.network = self.bench.network
        self.node = self.network.add_node(BaseNode402(NODE, EDS))
        # The library's own are too short for a busy machine.
        self.node.sdo.RESPONSE_TIMEOUT = 10.0
        for name in ("RESET_FAULT", "SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE", "CHECK_TPDO"):
            setattr(self.node, f"TIMEOUT_{name}", 10.0)
        self.bench.expect("ready")
        boots = []  # the library's own wait_for_bootup misses a boot-up that is faster than its call
        self.node.nmt.add_heartbeat_callback(boots.append)
        self.node.nmt.state = "RESET"
        self.assertTrue(until(lambda: 0 in boots))

    def periodic(self, cob_id, data, period):
        """Sends cyclically until the function returned is called, or the test ends: the kernel refuses a second stop."""
        task, running = self.network.send_periodic(cob_id, data, period), [True]

        def stop():
            if running:
                running.clear()
                task.stop()

        self.addCleanup(stop)
        return stop

    def aborts(self, code, function):
        with self.assertRaises(SdoAbortedError) as caught:
            function()
        self.assertEqual(caught.exception.code, code, hex(caught.exception.code))

    def drive_state(self):
        # Read once: a drive that changes its state between two reads would match no row.
        word = self.node.sdo[0x6041].raw
        return next(name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits)

    def command(self, word):
        self.node.sdo[0x6040].raw = word
        return self.drive_state()

    def map_cst(self):
        """The mapping of cyclic synchronous torque, changed by the library's own procedure."""
        self.node.pdo.read()
        rpdo, tpdo = self.node.rpdo[1], self.node.tpdo[1]
        for pdo, objects in (rpdo, (0x6040, 0x6071)), (tpdo, (0x6041, 0x6064, 0x6077)):
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.trans_type = 1
            pdo.enabled = True
            pdo.save()
        return rpdo, tpdo

    def enable_by_pdo(self):
        rpdo, tpdo = self.map_cst()
        self.node.sdo[0x6060].raw = 10
        self.node.nmt.state = "OPERATIONAL"
        for word in (0x06, 0x07, 0x0F):
            rpdo[0x6040].raw = word
            rpdo[0x6071].raw = 0
            rpdo.transmit()
            self.network.sync.transmit()
        self.assertTrue(until(lambda: self.drive_state() == "OPERATION ENABLED"))
        return rpdo, tpdo

    def test_boot_up_identity_and_profile(self):
        self.assertEqual(self.node.sdo[0x1000].raw & 0xFFFF, 402)
        self.assertEqual(self.node.sdo[0x1018][2].raw, 0x53494E57)
        self.assertEqual(self.node.sdo[0x6502].raw & 1 << 9, 1 << 9)
        self.assertEqual(self.node.sdo[0x1008].raw, "sinew simulated cable drive")
        other = self.network.add_node(NODE + 1, EDS)
        self.assertEqual(other.sdo[0x1200][1].raw, 0x600 + NODE + 1)

    def test_the_live_dictionary_is_that_of_the_eds_file(self):
        count = 0
        for index, obj in self.node.object_dictionary.items():
            if index < 0x1000:  # data types, which stand there for dummies in mappings
                self.aborts(0x06020000, lambda: self.node.sdo.upload(index, 0))
                continue
            for entry in [obj] if isinstance(obj, ODVariable) else obj.values():
                where = f"{index:04X}:{entry.subindex:02X}"
                if index == 0x1003 and entry.subindex > 0:
                    self.aborts(0x08000024, lambda: self.node.sdo.upload(index, entry.subindex))
                    continue
                value = entry.decode_raw(self.node.sdo.upload(index, entry.subindex))
                if index not in (0x6041, 0x1018, 0x6064, 0x6077):
                    self.assertEqual(value, entry.default, where)
                if not entry.writable:
                    self.aborts(0x06010002, lambda: self.node.sdo.download(index, entry.subindex, b"\0"))
                count += 1
        self.assertGreater(count, 120)
        self.aborts(0x06020000, lambda: self.node.sdo.upload(0x5FFF, 0))
        self.aborts(0x06090011, lambda: self.node.sdo.upload(0x1018, 9))

    def test_segmented_write_and_read(self):
        text = "cable 3,5: a label that needs several segments"
        self.node.sdo[0x2001].raw = text
        self.assertEqual(self.node.sdo[0x2001].raw, text)

    def test_remap_and_read_back(self):
        self.node.pdo.read()
        tpdo = self.node.tpdo[2]
        tpdo.clear()
        tpdo.add_variable(0x606C)
        tpdo.add_variable(0x603F)
        tpdo.cob_id = 0x280 + NODE
        tpdo.trans_type = 2
        tpdo.enabled = True
        tpdo.save()
        self.node.pdo.read()
        tpdo = self.node.tpdo[2]
        self.assertEqual([v.index for v in tpdo], [0x606C, 0x603F])
        self.assertEqual((tpdo.trans_type, tpdo.enabled, tpdo.cob_id), (2, True, 0x280 + NODE))
        # Out of order: the PDO is valid.
        self.aborts(0x08000022, lambda: self.node.sdo[0x1A01].__getitem__(0).__setattr__("raw", 0))
        # Every second SYNC.
        seen = []
        tpdo.add_callback(seen.append)
        self.node.nmt.state = "OPERATIONAL"
        for _ in range(6):
            self.network.sync.transmit()
        self.assertTrue(until(lambda: len(seen) == 3), len(seen))
        # A number of bytes that does not fit, and one that cannot be mapped.
        self.node.sdo[0x1801][1].raw = 0x80000280 + NODE
        self.node.sdo[0x1A01][0].raw = 0
        self.aborts(0x06040041, lambda: self.node.sdo.download(0x1A01, 1, (0x60720010).to_bytes(4, "little")))

    def test_a_place_of_another_node_in_an_rpdo_is_mapped_by_a_dummy(self):
        rpdo, _ = self.map_cst()
        rpdo.clear()
        for index in (0x0007, 0x6071, 0x0006):
            rpdo.add_variable(index)
        rpdo.save()
        self.node.rpdo.read()
        self.assertEqual([(v.index, v.length) for v in self.node.rpdo[1]], [(7, 32), (0x6071, 16), (6, 16)])
        self.node.nmt.state = "OPERATIONAL"
        self.network.send_message(0x200 + NODE, bytes.fromhex("ffffffff 2c01 ffff"))
        self.network.sync.transmit()
        self.assertTrue(until(lambda: self.node.sdo[0x6071].raw == 300), self.node.sdo[0x6071].raw)
        # In the other direction there is nobody to whom a place could belong.
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.node.sdo[0x1801][1].raw = 0x80000280 + NODE
        self.node.sdo[0x1A01][0].raw = 0
        self.aborts(0x06040041, lambda: self.node.sdo.download(0x1A01, 1, (0x00070020).to_bytes(4, "little")))

    def test_every_legal_transition(self):
        self.node.sdo[0x605A].raw = 6  # stay in quick stop, so that transition 16 exists
        self.assertEqual(self.drive_state(), "SWITCH ON DISABLED")
        for word, state in [
            (0x06, "READY TO SWITCH ON"),  # 2
            (0x00, "SWITCH ON DISABLED"),  # 7
            (0x06, "READY TO SWITCH ON"),
            (0x07, "SWITCHED ON"),  # 3
            (0x06, "READY TO SWITCH ON"),  # 6
            (0x07, "SWITCHED ON"),
            (0x00, "SWITCH ON DISABLED"),  # 10
            (0x06, "READY TO SWITCH ON"),
            (0x07, "SWITCHED ON"),
            (0x0F, "OPERATION ENABLED"),  # 4
            (0x07, "SWITCHED ON"),  # 5
            (0x0F, "OPERATION ENABLED"),
            (0x06, "READY TO SWITCH ON"),  # 8
            (0x07, "SWITCHED ON"),
            (0x0F, "OPERATION ENABLED"),
            (0x02, "QUICK STOP ACTIVE"),  # 11
            (0x0F, "OPERATION ENABLED"),  # 16
            (0x02, "QUICK STOP ACTIVE"),
            (0x00, "SWITCH ON DISABLED"),  # 12
            (0x06, "READY TO SWITCH ON"),
            (0x07, "SWITCHED ON"),
            (0x0F, "OPERATION ENABLED"),
            (0x00, "SWITCH ON DISABLED"),  # 9
        ]:
            self.assertEqual(self.command(word), state, hex(word))

    def test_illegal_transitions_are_refused(self):
        paths = {
            "SWITCH ON DISABLED": ([], [0x07, 0x0F, 0x02, 0x00, 0x80]),
            "READY TO SWITCH ON": ([0x06], [0x06, 0x80]),
            "SWITCHED ON": ([0x06, 0x07], [0x07, 0x80]),
            "OPERATION ENABLED": ([0x06, 0x07, 0x0F], [0x0F, 0x80]),
        }
        for state, (path, refused) in paths.items():
            for word in refused:
                self.command(0x00)
                for step in path:
                    self.command(step)
                self.assertEqual(self.command(word), state, f"{state} {word:#x}")
        self.aborts(0x06090030, lambda: self.node.sdo.download(0x6060, 0, b"\x08"))  # position mode

    def test_the_library_drives_the_state_machine(self):
        self.node.sdo[0x6060].raw = 10
        self.node.setup_402_state_machine()
        for pdo in (self.node.rpdo[1], self.node.tpdo[1]):
            pdo.trans_type = 255
            pdo.save()
        self.node.tpdo[1].event_timer = 20
        self.node.tpdo[1].save()
        self.node.nmt.state = "OPERATIONAL"
        self.assertEqual(self.node.op_mode, "CYCLIC SYNCHRONOUS TORQUE")
        for state in ["READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "SWITCH ON DISABLED"]:
            self.node.state = state
            self.assertEqual(self.drive_state(), state)

    def test_torque_is_latched_by_sync(self):
        rpdo, tpdo = self.enable_by_pdo()
        rpdo[0x6071].raw = 250
        rpdo.transmit()
        time.sleep(0.1)
        self.assertEqual(self.node.sdo[0x6074].raw, 0)
        self.network.sync.transmit()
        self.assertTrue(until(lambda: self.node.sdo[0x6074].raw == 250))
        # The motor answers, and TPDO 1 tells.
        def told():
            self.network.sync.transmit()
            return tpdo[0x6077].raw == 250 and tpdo[0x6064].raw == 2500

        self.assertTrue(until(told))

    def test_loss_of_heartbeat(self):
        rpdo, _ = self.enable_by_pdo()
        self.node.sdo[0x1029][1].raw = 1
        self.node.sdo[0x1016][1].raw = MASTER << 16 | MONITOR_MS
        beat = self.periodic(0x700 + MASTER, [5], 0.05)
        rpdo[0x6071].raw = 400
        rpdo.transmit()
        self.network.sync.transmit()
        time.sleep(WATCHED_S)
        self.assertEqual((self.drive_state(), self.node.sdo[0x6074].raw), ("OPERATION ENABLED", 400))
        self.assertEqual(self.node.emcy.log, [])
        beat()
        self.assertTrue(until(lambda: [e.code for e in self.node.emcy.log] == [0x8130]), self.node.emcy.log)
        self.assertTrue(until(lambda: (self.drive_state(), self.node.sdo[0x6074].raw) == ("FAULT", 0)))
        self.assertEqual(self.node.sdo[0x1001].raw & 0x11, 0x11)
        self.assertEqual((self.node.sdo[0x603F].raw, self.node.sdo[0x1003][1].raw), (0x8130, 0x8130))
        # Latched: neither enabling nor a reset with the cause still there lead out of it.
        for word in (0x06, 0x0F, 0x00, 0x80):
            self.assertEqual(self.command(word), "FAULT")
        beat = self.periodic(0x700 + MASTER, [5], 0.05)
        # With the first beat that it hears.
        self.assertTrue(until(lambda: self.command(0x00) == "FAULT" and self.command(0x80) == "SWITCH ON DISABLED"))
        self.assertTrue(until(lambda: self.node.emcy.log[-1].code == 0))
        self.assertEqual((self.node.sdo[0x1001].raw, self.node.sdo[0x603F].raw), (0, 0))
        # The history survives the reset and is cleared by writing 0.
        self.assertEqual(self.node.sdo[0x1003][0].raw, 1)
        self.node.sdo[0x1003][0].raw = 0
        self.aborts(0x08000024, lambda: self.node.sdo.upload(0x1003, 1))

    def test_loss_of_sync(self):
        rpdo, _ = self.enable_by_pdo()
        rpdo[0x6071].raw = 400
        rpdo.transmit()
        self.network.sync.transmit()
        self.assertTrue(until(lambda: self.node.sdo[0x6074].raw == 400))
        sync = self.periodic(0x80, [], 0.02)
        self.node.sdo[0x2000][1].raw = 1000 * MONITOR_MS
        time.sleep(WATCHED_S)
        self.assertEqual(self.drive_state(), "OPERATION ENABLED")
        sync()
        self.assertTrue(until(lambda: (self.drive_state(), self.node.sdo[0x6074].raw) == ("FAULT", 0)))
        self.assertEqual(self.node.emcy.log[-1].code, 0x81FF)

    def test_loss_of_torques(self):
        # RPDO deadline monitoring: sub-index 5 of its communication parameters, from the next reception on.
        rpdo, _ = self.enable_by_pdo()
        self.node.sdo[0x1400][5].raw = MONITOR_MS
        self.assertEqual(self.node.sdo[0x1400][5].raw, MONITOR_MS)
        self.periodic(0x80, [], 0.02)
        time.sleep(WATCHED_S)
        self.assertEqual((self.drive_state(), self.node.emcy.log), ("OPERATION ENABLED", []))
        torques = self.periodic(0x200 + NODE, struct.pack("<Hh", 0x0F, 400), 0.02)
        time.sleep(WATCHED_S)
        self.assertEqual((self.drive_state(), self.node.sdo[0x6074].raw), ("OPERATION ENABLED", 400))
        torques()  # SYNC goes on
        self.assertTrue(until(lambda: [e.code for e in self.node.emcy.log] == [0x8250]), self.node.emcy.log)
        self.assertTrue(until(lambda: (self.drive_state(), self.node.sdo[0x6074].raw) == ("FAULT", 0)))
        self.assertEqual(self.node.sdo[0x603F].raw, 0x8250)
        # Latched: the cause is still there, and then gone.
        self.assertEqual(self.command(0x80), "FAULT")
        self.command(0x00)
        self.network.send_message(0x200 + NODE, struct.pack("<Hh", 0x00, 400))
        self.assertTrue(until(lambda: self.command(0x00) == "FAULT" and self.command(0x80) == "SWITCH ON DISABLED"))
        self.assertEqual(self.node.sdo[0x6074].raw, 0)


if __name__ == "__main__":
    unittest.main()
