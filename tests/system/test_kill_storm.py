"""kill -9 in a storm of DTCs, some of the time with a disk that fills up: what was told as stored is there.

``GATEWAY_TESTS=full`` kills a thousand times, a hundred of them with the full disk; ``GATEWAY_KILLS`` sets the number
of kills (a tenth of them with the full disk), of which each takes about as long as the daemon takes to start.
"""

import os
import random
import signal
import subprocess
import threading
import time
from contextlib import ExitStack

import can
import cantools
import pytest
from amount import amount
from full_disk import small_disk
from processes import GATEWAY, bus

from gateway.common.resources import shipped
from gateway.faults import service
from gateway.faults.dtc import Dtc

pytestmark = pytest.mark.system

KILLS = int(os.environ.get("GATEWAY_KILLS", "0")) or amount(1000, 20)
FULL_DISK = max(KILLS // 10, 2)
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


def kill_9(tmp_path, memory, kills, rng, disk=None):
    """Start, let run, kill; returns what was told in all."""
    config = write_config(tmp_path)
    runs, worst = [], {}
    with ExitStack() as stack:
        uri = stack.enter_context(bus(tmp_path))
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        tester = stack.enter_context(can.Bus(interface="socketcand", host=host, port=int(port), channel="can0"))
        storm = stack.enter_context(Storm(host, int(port), rng.randrange(2**32)))
        while len(runs) < kills:
            started = start(config, uri, memory, tmp_path)
            while tester.recv(0) is not None:
                pass
            told = Told()
            for action in (None,) if disk is None else (disk.fill, disk.free, disk.fill):
                if action is not None and rng.random() < 0.8:
                    action(started)
                limit = time.monotonic() + rng.uniform(0.01, 0.35)
                while (rest := limit - time.monotonic()) > 0:
                    told.note(tester.recv(rest))
            os.kill(started.pid, signal.SIGKILL)
            started.wait(10)
            started.stderr.close()
            time.sleep(0.02)
            while (got := tester.recv(0)) is not None:
                told.note(got)
            if disk is not None:
                disk.free(started)
            runs.append(told)
            kept = {e["dtc"]: e for e in service.list_entries(memory)}
            for dtc, occurrence in told.promised.items():
                assert kept[dtc]["confirmed"], (len(runs), dtc)
                assert kept[dtc]["occurrence"] >= occurrence, (len(runs), dtc)
            for dtc, occurrence in worst.items():
                assert kept[dtc]["occurrence"] >= occurrence, (len(runs), dtc)
            worst = {dtc: entry["occurrence"] for dtc, entry in kept.items()}
        assert storm.is_alive(), "the storm must have lasted to the last kill"
    return runs


@pytest.mark.timeout(300 + 30 * KILLS)
def test_kill_9_while_dtcs_arrive_loses_none_that_was_sent_as_confirmed(tmp_path):
    """At random moments after the daemon is up, in a storm of DTCs."""
    seed = int(os.environ.get("GATEWAY_SEED", "50"))
    print("seed", seed)
    runs = kill_9(tmp_path, tmp_path / "f.sqlite", KILLS, random.Random(seed))
    promised = sum(len(told.promised) for told in runs)
    print(f"{len(runs)} kills, {promised} confirmed DTCs reported before them, none missing")
    assert promised >= 2 * KILLS
    assert not any(told.outages for told in runs)


@pytest.mark.timeout(300 + 60 * FULL_DISK)
def test_kill_9_with_a_disk_that_fills_up_loses_nothing_that_was_told_as_stored(tmp_path):
    seed = int(os.environ.get("GATEWAY_SEED", "51"))
    print("seed", seed)
    with small_disk(tmp_path / "disk") as disk:
        memory = tmp_path / "disk" / "f.sqlite"
        runs = kill_9(tmp_path, memory, FULL_DISK, random.Random(seed), disk)
    promised = sum(len(told.promised) for told in runs)
    outages, unstored = sum(t.outages for t in runs), sum(t.unstored for t in runs)
    print(
        f"{len(runs)} kills with a disk that fills up: {promised} confirmed DTCs reported as stored, none missing;"
        f" {outages} outages told, {unstored} reports in them"
    )
    assert promised > 0
    assert unstored > 0, "what could not be stored was told all the same"


def start(config, uri, memory, folder):
    """Start the daemon, and wait until it monitors."""
    started = subprocess.Popen(
        [*GATEWAY, "run", str(config), "--bus", uri, "--memory", str(memory)],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    line = said_last = ""
    while "monitoring" not in line or "memory" in line:
        line = started.stderr.readline()
        assert line, (said_last, started.wait(5))
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
        self._bus = can.Bus(interface="socketcand", host=host, port=port, channel="can0")
        self._ended = threading.Event()

    def run(self):
        counts = [0] * MESSAGES
        while not self._ended.wait(0.002):
            k = self._rng.randrange(MESSAGES)
            what = self._rng.random()
            counts[k] += 1 + 3 * (what < 0.2)
            data = bytes([counts[k] % 256, *self._rng.randbytes(7)])
            message = data[: 2 if what > 0.8 else 8]
            self._bus.send(can.Message(arbitration_id=0x300 + k, data=message, is_extended_id=False))

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self.join(10)
        self._bus.shutdown()
