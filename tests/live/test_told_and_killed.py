"""kill -9 right after a DTC frame, before a slow SQLite has its verdict: what was told is there."""

import random
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from amount import amount

from gateway.bus.can_structs import Packer
from gateway.bus.frames import empty, put
from gateway.faults import service
from gateway.faults.dtc import Dtc
from gateway_fdi.jit import COMPILED
from tests.system.kill_storm import MESSAGE, write_config

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="the pump sends only where it is compiled")]

ROOT = Path(__file__).parents[2]
DAEMON = """
import socket, sys, threading, time
from pathlib import Path
from bench.live import StructBus
from gateway.faults import restarts
from gateway.faults.store import Store
from gateway.live.daemon import Daemon
from gateway.live.machine import Machine
save, config, memory, fd = Store.save, Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
def slow(store, changes, whole=None):
    if threading.current_thread() is not threading.main_thread():
        time.sleep(0.1)
    save(store, changes, whole)
Store.save = slow
restarts.LONGEST_S = 0.0
bus = socket.socket(fileno=fd)
machine = Machine(open_bus=lambda uri, index: StructBus(bus, index))
Daemon(config, memory=memory, report=lambda event: None, machine=machine).run(lambda: False)
"""


def start(config, memory):
    """Start a daemon on one end of a pair of sockets; returns it with the other."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [sys.executable, "-c", DAEMON, str(config), str(memory), str(theirs.fileno())]
    process = subprocess.Popen(command, cwd=ROOT, pass_fds=[theirs.fileno()], stderr=subprocess.DEVNULL)
    theirs.close()
    ours.settimeout(60)
    return process, ours


def next_change(bus):
    """Wait for a DTC frame that tells a change; returns DTC, status byte and occurrence."""
    while True:
        raw = bus.recv(72)
        values = MESSAGE.decode(raw[8:16], decode_choices=False)
        if int.from_bytes(raw[:4], "little") == MESSAGE.frame_id and values["Dtc"] and values["Index"] == 0:
            return str(Dtc(int(values["Dtc"]))), int(values["Status"]), int(values["Occurrence"])


def test_what_was_told_right_before_a_kill_is_there(tmp_path):
    rng = random.Random(4949)
    print("seed 4949")
    memory, pack, waited = tmp_path / "m.sqlite", Packer(), 0
    config = write_config(tmp_path)
    text = config.read_text().replace('"loopback:"', '"virtual:storm"').replace("cycle_ms = 50.0", "cycle_ms = 60000.0")
    config.write_text(text)
    for kill in range(amount(100, 2, 1)):
        process, bus = start(config, memory)
        while int.from_bytes(bus.recv(72)[:4], "little") != MESSAGE.frame_id:
            pass  # the list at the start
        told, short, counts = {}, [False] * 8, [0] * 8
        for k in range(8):  # what failed before the kill passes first: its operation cycle goes on
            one = empty(1)
            put(one, 0, 0, 0x300 + k, bytes(8))
            bus.send(pack(one[0]))
        changes = rng.randrange(6)
        for n in range(changes + 1):  # some while SQLite is at work, the last one by the journal
            if n == changes:
                time.sleep(1.0)  # until all writes are done: the journal takes verdicts between two of them
            k = rng.randrange(8)
            short[k], counts[k] = not short[k], counts[k] + 1
            one = empty(1)
            put(one, 0, 0, 0x300 + k, bytes([counts[k]]) + bytes(1 if short[k] else 7))
            bus.send(pack(one[0]))
            while short[k] or told.get(f"U02{k:02X}-81", (0, 0))[0] & 1:
                dtc, *state = next_change(bus)
                told[dtc] = state
                if dtc == f"U02{k:02X}-81" and bool(state[0] & 1) == short[k]:
                    break
        process.kill()
        process.wait()
        bus.close()
        waited += service.waiting(memory)
        kept = {entry["dtc"]: entry for entry in service.list_entries(memory)}
        assert {dtc: [kept[dtc]["status"], kept[dtc]["occurrence"]] for dtc in told} == told, kill
    print(f"{waited} verdicts were in the journal only")
    assert waited
