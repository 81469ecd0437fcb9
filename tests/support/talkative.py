"""A gateway that has very much to say, in a process of its own: ``python talkative.py FOLDER EVENTS FIRST``.

A real gateway, its fault memory a file, and its status socket. So many events are told to the socket's readers,
1000 for each second of the engine's time, and 100 frames are fed in it, of which a tenth fail a test. Readers that
keep up are not outrun; others are sent away and counted. FIRST seconds are without events: 600 fill the history that
pages keep. It prints ``mark N SENT_AWAY`` at a tenth, at half and at
the end of the events, and goes on at a line on stdin.
"""

import select
import sys
import time
from pathlib import Path

import numpy as np

from gateway.bus.frames import empty
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_serve.status_socket import ENOUGH_BYTES, StatusSocket

#: A gateway of one message and one monitor; tests/live/test_status.py has it too.
CONFIG = """
name = "talkative"
[[bus]]
name = "a"
uri = "virtual:a"
bitrate = 500000
database = ["one.dbc"]

[[monitor]]
name = "level"
type = "signal"
signal = [{ signal = "One.Level", plausible = [0, 10], failed_ms = 100 }]
"""
DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 One: 8 A
 SG_ Level : 0|16@1- (0.01,0) [-300|300] "V" B
"""
BATCH = 1000


def write_config(folder):
    (folder / "one.dbc").write_text(DBC)
    (folder / "talkative.toml").write_text(CONFIG)
    return folder / "talkative.toml"


def frames(t_ns):
    """Frames of a second, the level too high for a tenth of it."""
    made = empty(100)
    made["t_ns"] = t_ns + 10_000_000 * (1 + np.arange(100))
    made["can_id"], made["length"] = 256, 8
    level = made["t_ns"] // 10_000_000 % 100
    made["data"][:, :2] = (level + 990 * (level >= 90)).astype("<i2").view("u1").reshape(100, 2)
    return made


def event(number, t_ns):
    """An event as long as those of a DTC are."""
    inputs = {f"One.Signal{k}": float(number + k) for k in range(12)}
    return {
        "event": "dtc", "t_ns": t_ns, "dtc": "U3000-00", "fault": f"a.fault{number % 40}", "status": 0x2F - number % 2,
        "occurrence": number, "evidence": {"value": number / 7, "threshold": 1.0}, "inputs": inputs,
    }  # fmt: skip


def let_them_read(status, clock):
    """Serve the readers until none that reads at all is behind."""
    behind, until = {}, time.monotonic() + 0.5
    while True:
        now = {reader.number: reader.bytes for reader in status._readers if reader.bytes > ENOUGH_BYTES}
        if any(left < behind.get(number, left + 1) for number, left in now.items()):
            until = time.monotonic() + 0.5  # somebody takes something
        behind = now
        if not now or time.monotonic() > until:
            return
        status.turn(clock)
        time.sleep(0.002)


def wait_for_line(status, clock):
    """Serve the readers until a line comes on stdin."""
    while not select.select([sys.stdin], [], [], 0.01)[0]:
        clock += 0.01
        status.turn(clock)
    sys.stdin.readline()
    return clock


def play_a_second(gateway, status, t_ns, clock):
    """Feed frames, with a look of the readers 20 times; returns the time of both clocks then."""
    fed = frames(t_ns)
    for k in range(0, len(fed), 5):
        status.on_frames(fed[k : k + 5])
        gateway.feed(fed[k : k + 5])
        clock += 0.05
        status.turn(clock)
    let_them_read(status, clock)
    return t_ns + 10**9, clock


def main(folder, events, first):
    gateway = Gateway(load_config(write_config(folder)), folder / "faults.sqlite")
    gateway.write_beside()
    t_ns = 1_700_000_000 * 10**9
    gateway.start(t_ns)
    state = {"bus": "a", "state": "open", "received": 1, "errors": {}}
    status = StatusSocket(folder / "status", gateway, lambda: [state])
    gateway.listen(status.report)
    print("ready", flush=True)
    clock = wait_for_line(status, 0.0)
    for _ in range(first):
        t_ns, clock = play_a_second(gateway, status, t_ns, clock)
    for number in range(events):
        status.report(event(number, t_ns))
        if number % BATCH == BATCH - 1:
            t_ns, clock = play_a_second(gateway, status, t_ns, clock)
        if number + 1 in (events // 10, events // 2, events):
            print("mark", number + 1, status.sent_away, flush=True)
            clock = wait_for_line(status, clock)
    status.close()
    gateway.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
