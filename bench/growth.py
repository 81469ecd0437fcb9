"""How the cost of a frame, of a start and of memory grows with the size of the configuration, beside cantools' loop.

One axis at a time, each point in a process of its own. The rate of all frames together stays the same (4000 a second
of the log's time), so that a size only shows where something is searched or does not fit a cache. The peer, in the
same process: the payloads of the same frames through a dictionary of cantools' messages. The exponent is the slope of
the line of least squares through the logarithms: 0 does not grow, 1 grows with the size. All frames count, those too in
which every test passes for the first time; "first us" is a frame of the first 64 of each message. Times are CPU time of
the thread: of other work on the machine they show what it does to the caches only. Memory is that of one gateway
at most, with its configuration and frames, before the peer's messages are loaded.

    python bench/growth.py [--axis messages ...] [--frames 2000000] [--rounds 3] [--json]
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from itertools import chain
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
#: Axis -> (sizes, what is counted).
AXES = {
    "messages": ((10, 30, 100, 300, 1000, 3000), "messages, each with timeout, alive counter, length"),
    "monitors": ((1, 3, 10, 30, 100, 300), "monitors, each stepped by a message of its own, and no other message"),
    "faults": ((300, 1000, 3000, 10_000), "faults, of which 300 are tested: 100 messages come"),
    "buses": ((1, 2, 4, 8), "buses, 104 messages spread over them"),
    "log": ((100_000, 1_000_000, 10_000_000, 100_000_000), "frames, 100 messages"),
    "testers": ((1, 2, 4, 8), "testers that each ask 10 times a second, 100 messages"),
}
RATE = 4000  # frames a second of all messages together
BASE = 0x10000
CHUNK = 100_000
PEER_FRAMES = 5000
ASKED_HZ = 10
SETTLING = 64  # frames of each message until all its tests have passed: each pass is a verdict, which Python keeps

DBC = 'VERSION ""\nNS_ :\nBS_:\nBU_: Ecu Gateway\n'
MESSAGE = """BO_ {id} M{k}: 8 Ecu
 SG_ FrameCnt : 0|8@1+ (1,0) [0|255] "" Gateway
 SG_ A : 16|16@1+ (0.001,0) [0|65] "V" Gateway
 SG_ B : 32|16@1- (0.01,0) [-300|300] "A" Gateway
"""
CHECK = '[[bus.check]]\nmessage = "M{k}"\ntimeout_ms = {timeout}\ncounter = {{ signal = "FrameCnt" }}\n'
CODES = 'lost = "U1{k:03X}"\ninvalid = "U2{k:03X}"\n'
MONITOR = '[[monitor]]\nname = "m{k}"\nbus = "b0"\ntype = "battery_voltage:MONITOR"\nsignal = "M{k}.A"\n'
DTCS = '[fault."m{k}.low"]\ndtc = "P1{k:03X}-16"\n[fault."m{k}.high"]\ndtc = "P1{k:03X}-17"\n'


def shape_of(axis, size):
    """Return how many messages there are, of which come, monitors, buses, testers and frames at a point."""
    count = {"messages": size, "monitors": size, "faults": size // 3, "buses": 104}.get(axis, 100)
    return {
        "messages": count,
        "coming": 100 if axis == "faults" else count,
        "monitors": size if axis == "monitors" else 0,
        "buses": size if axis == "buses" else 1,
        "testers": size if axis == "testers" else 0,
        "frames": size if axis == "log" else 0,
    }


def timeout_ms(message, coming):
    """Return four cycles of a message: the first has a fourth of all frames, the others share the rest [ms]."""
    if message >= coming:
        return 3.6e6
    if coming == 1:
        return 4e3 / RATE
    return 4e3 / (RATE / 4 if message == 0 else RATE * 3 / 4 / (coming - 1))


def write_config(folder, shape):
    """Write database and configuration of a point; message k is on bus k modulo the buses."""
    toml = 'name = "growth"\n'
    for bus in range(shape["buses"]):
        mine = range(bus, shape["messages"], shape["buses"])
        (folder / f"b{bus}.dbc").write_text(DBC + "".join(MESSAGE.format(id=0x8000_0000 | BASE + k, k=k) for k in mine))
        toml += f'[[bus]]\nname = "b{bus}"\nuri = "virtual:b{bus}"\ndatabase = ["b{bus}.dbc"]\n'
        for k in mine:
            toml += CHECK.format(k=k, timeout=timeout_ms(k, shape["coming"])) + CODES.format(k=k)
    toml += "".join((MONITOR + DTCS).format(k=k) for k in range(shape["monitors"]))
    if shape["testers"]:
        toml += '[output.uds]\nbus = "b0"\nrequest = 0x700\nresponse = 0x780\n'
        for k in range(1, shape["testers"]):
            toml += f"[[output.uds.further]]\nrequest = {0x700 + k}\nresponse = {0x780 + k}\n"
    (folder / "growth.toml").write_text(toml)
    shutil.copy(ROOT / "examples" / "battery_voltage" / "battery_voltage.py", folder)
    return folder / "growth.toml"


def chunks_of(shape, start, end, empty, extended):
    """Yield frames of the log in chunks: counters right, 12.6 V; a tester's request between."""
    coming, period = shape["coming"], round(1e9 / RATE)
    requests = shape["testers"] * ASKED_HZ / RATE  # a frame
    for first in range(start, end, CHUNK):
        at = np.arange(first, min(first + CHUNK, end))
        made = empty(len(at))
        rest, others = at - at // 4 - 1, coming - 1  # how many frames of the others came before
        message, count = np.zeros_like(at), at
        if others:
            message = np.where(at % 4 == 0, 0, 1 + rest % others)
            count = np.where(at % 4 == 0, at // 4, rest // others)
        made["t_ns"] = 1 + at * period
        made["can_id"] = (BASE + message) | extended
        made["bus"] = message % shape["buses"]
        made["length"] = 8
        made["data"][:, 0] = count % 256
        made["data"][:, 2:4] = (12_600).to_bytes(2, "little")[0], (12_600).to_bytes(2, "little")[1]
        asks = np.flatnonzero(np.floor(at * requests) != np.floor((at - 1) * requests)) if requests else []
        if len(asks):
            asked = empty(len(asks))
            asked["t_ns"], asked["length"] = made["t_ns"][asks], 8
            asked["can_id"] = 0x700 + np.arange(len(asks)) % shape["testers"]
            asked["data"][:, :4] = 3, 0x19, 0x01, 0xFF  # how many DTCs there are
            made = np.insert(made, asks, asked)
        yield made


def peer_seconds(databases, frames):
    """Return the time of a frame through cantools alone [s]."""
    messages = [{m.frame_id: m for m in database.messages} for database in databases]
    work = [(int(f["bus"]), int(f["can_id"]) & 0x1FFF_FFFF, f["data"][:8].tobytes()) for f in frames[:PEER_FRAMES]]
    begun = time.thread_time()
    for bus, can_id, data in work:
        message = messages[bus].get(can_id)
        if message is not None:
            message.decode(data, decode_choices=False)
    return (time.thread_time() - begun) / len(work)


def point(axis, size, frames, rounds):
    """Measure one point in this process."""
    sys.modules["asammdf"] = None  # python-can loads it and pandas where they are installed, a daemon does not
    import cantools  # noqa: PLC0415 - the parent's memory must stay small: a child's begins with it

    from gateway.bus.frames import EXTENDED, empty  # noqa: PLC0415
    from gateway.config.load import load_config  # noqa: PLC0415
    from gateway.runtime.app import Gateway  # noqa: PLC0415

    shape = shape_of(axis, size)
    frames = shape["frames"] or frames
    first = min(SETTLING * shape["coming"] * 4 // 3, frames)
    with tempfile.TemporaryDirectory() as name:
        path = write_config(Path(name), shape)
        begun = time.process_time()
        config = load_config(path)
        gateway = Gateway(config)
        gateway.start(0)
        gateway.feed(next(iter(chunks_of(shape, 0, 100, empty, EXTENDED)))[:1])
        start = time.process_time() - begun
        best = settled = float("inf")
        memory = 0.0
        for _ in range(rounds if axis != "log" else 1):
            gateway.close()
            del gateway
            gc.collect()
            gateway = Gateway(config)
            gateway.start(0)
            fed, seconds, answers, at_first = 0, 0.0, 0, 0.0
            parts = (0, first), (first, frames)
            for chunk in chain(*(chunks_of(shape, *part, empty=empty, extended=EXTENDED) for part in parts)):
                begun = time.thread_time()
                answers += len(gateway.feed(chunk))
                seconds += time.thread_time() - begun
                fed += len(chunk)
                if fed <= first:
                    at_first = seconds
            settled, best = min(settled, at_first), min(best, seconds / fed)
            counted = gateway.engine.counters()
            assert counted["timeouts"] == counted["late"] == counted["crc_failed"] == 0, counted
            assert counted["frames"] >= fed
            memory = memory or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        databases = [cantools.database.load_file(Path(name) / f"b{k}.dbc") for k in range(shape["buses"])]
        peer = min(
            peer_seconds(databases, next(iter(chunks_of(shape, 0, PEER_FRAMES, empty, EXTENDED))))
            for _ in range(rounds)
        )
    return {
        "size": size,
        "ns": best * 1e9,
        "peer_ns": peer * 1e9,
        "first_us": settled * 1e6 / first,
        "start_s": start,
        "memory_mb": memory,
        "answers": answers,
    }


def exponent(rows, name):
    """Return the slope of the logarithm of a column over that of the size."""
    x = np.log([row["size"] for row in rows])
    y = np.log([max(row[name], 1e-9) for row in rows])
    return float(np.polyfit(x, y, 1)[0])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--axis", choices=AXES, action="append")
    parser.add_argument("--frames", type=int, default=2_000_000)
    parser.add_argument("--longest", type=int, default=10_000_000, help="longest log of the axis `log`")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--point", nargs=2, metavar=("AXIS", "SIZE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.point:
        axis, size = options.point
        print(json.dumps(point(axis, int(size), options.frames, options.rounds)))
        return
    found = {}
    for axis in options.axis or AXES:
        rows = found[axis] = []
        for size in AXES[axis][0]:
            if axis == "log" and size > options.longest:
                continue
            command = [sys.executable, __file__, "--point", axis, str(size)]
            command += ["--frames", str(options.frames), "--rounds", str(options.rounds)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                sys.exit(f"{axis} {size}:\n{done.stderr}")
            rows.append(json.loads(done.stdout))
            print(f"{axis} {size}", file=sys.stderr)
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    if options.json:
        print(json.dumps({"axes": found, "machine": machine}, indent=2))
        return
    print(f"{machine}; best of {options.rounds}")
    for axis, rows in found.items():
        print(f"\n{AXES[axis][1]}")
        print(
            f"{'':>12}{'ns/frame':>10}{'times':>7}{'cantools':>10}{'ratio':>8}{'first us':>10}{'start s':>9}{'MB':>7}"
        )
        for row in rows:
            print(
                f"{row['size']:>12,}{row['ns']:>10.0f}{row['ns'] / rows[0]['ns']:>7.2f}{row['peer_ns']:>10.0f}"
                f"{row['peer_ns'] / row['ns']:>8.1f}{row['first_us']:>10.2f}"
                f"{row['start_s']:>9.2f}{row['memory_mb']:>7.0f}"
            )
        if len(rows) > 1:
            shown = {name: exponent(rows, name) for name in ("ns", "peer_ns", "first_us", "start_s", "memory_mb")}
            print(f"{'exponent':>12}{shown['ns']:>10.2f}{'':>7}{shown['peer_ns']:>10.2f}", end="")
            print(f"{'':>8}{shown['first_us']:>10.2f}{shown['start_s']:>9.2f}{shown['memory_mb']:>7.2f}")


if __name__ == "__main__":
    main()
