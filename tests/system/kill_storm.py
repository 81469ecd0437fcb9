"""A storm of DTCs for a daemon that is killed in it: its configuration, what it is sent, and what it told."""

import random
import subprocess
import threading

import can
import cantools
import warm
from processes import TIRELESS

from gateway.faults.dtc import Dtc
from gateway_fdi.common.resources import shipped

MESSAGES = 8
#: The DTC that says that what is told now is not stored.
NOT_WRITTEN = "U3000-44"
MESSAGE = cantools.database.load_file(shipped("dbc/gateway.dbc")).get_message_by_name("GW_DTC")


class Told:
    """What the DTC frames of one run promised: confirmed DTCs, told while the memory was said to be written."""

    def __init__(self):
        self.promised = {}
        self.not_written = False
        self.outages = self.unstored = 0

    def note(self, got):
        if got is None or got.arbitration_id != MESSAGE.frame_id:
            return
        values = MESSAGE.decode(bytes(got.data))
        dtc = str(Dtc(values["Dtc"]))
        if dtc == NOT_WRITTEN:
            failing = bool(values["Status"] & 0x01)
            self.outages += failing and not self.not_written
            self.not_written = failing
        elif values["Status"] & 0x08:
            if self.not_written:
                self.unstored += 1
            else:
                self.promised[dtc] = values["Occurrence"]


def start(config, uri, memory, folder):
    """Start the daemon, and wait until it monitors."""
    started = warm.Popen(
        [*TIRELESS, "run", str(config), "--bus", uri, "--memory", str(memory)],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    line = said_last = ""
    while "monitoring" not in line or "memory" in line:
        line = started.stderr.readline()
        assert line, (said_last, started.wait(60))
        said_last = line
    return started


DBC = """VERSION ""
NS_ :
BS_:
BU_: Ecu Gateway
"""


def write_config(folder):
    """Write a configuration: eight messages with alive counters, each judged at once, all DTCs told often."""
    dbc, toml = DBC, f'[[bus]]\nname = "b"\nuri = "loopback:"\ndatabase = ["{folder}/storm.dbc"]\n'
    faults = ""
    for k in range(MESSAGES):
        dbc += f"BO_ {0x300 + k} M{k}: 8 Ecu\n"
        dbc += ' SG_ FrameCnt : 0|8@1+ (1,0) [0|255] "" Gateway\n'
        dbc += ' SG_ Value : 8|16@1+ (0.1,0) [0|6553] "V" Gateway\n'
        toml += f'[[bus.check]]\nmessage = "M{k}"\ncounter = {{ signal = "FrameCnt" }}\n'
        for name, dtc in (("counter", f"U01{k:02X}-82"), ("length", f"U02{k:02X}-81")):
            faults += f'[fault."b.M{k}.{name}"]\ndtc = "{dtc}"\nfreeze_frame = ["M{k}.Value"]\n'
            faults += "debounce = { failed_after = 1, passed_after = 1, jump_down = true }\n"
    toml += faults + "[output.dtc_frame]\ncycle_ms = 50.0\nmin_interval_ms = 0\n"
    toml += "[memory]\nrecording = { before_ms = 20.0, after_ms = 5.0, most_per_fault = 1 }\n"
    (folder / "storm.dbc").write_text(dbc)
    (folder / "storm.toml").write_text(toml)
    return folder / "storm.toml"


class Storm(threading.Thread):
    """Sends frames, of which every fifth has a wrong counter and every fifth is too short."""

    def __init__(self, host, port, seed):
        super().__init__(daemon=True)
        self._rng = random.Random(seed)
        self._counts = [0] * MESSAGES
        self._bus = can.Bus(interface="socketcand", host=host, port=port, channel="can0")
        self._ended = threading.Event()

    def run(self):
        while not self._ended.wait(0.002):
            can_id, data = self.next_frame()
            self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def next_frame(self):
        """Return identifier and data of the next frame."""
        k = self._rng.randrange(MESSAGES)
        what = self._rng.random()
        self._counts[k] += 1 + 3 * (what < 0.2)
        data = bytes([self._counts[k] % 256, *self._rng.randbytes(7)])
        return 0x300 + k, data[: 2 if what > 0.8 else 8]

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self.join(10)
        self._bus.shutdown()
