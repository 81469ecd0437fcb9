"""Where the time of a replayed frame goes, part by part.

Two configurations, each with a candump log of its own: the crankshaft of gateway.toml (bench/engine.py), and messages
with timeout, alive counter and length alone (bench/growth.py). A part of the loop is what the configuration with it
takes more than the one without: CPU time of the thread, the best of some rounds in turn. Then the whole, from the file
to its last event.

    python bench/replay.py [--frames 500000] [--rounds 5] [--messages 100] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from pathlib import Path

import numpy as np
from engine import make_log
from growth import DBC, MESSAGE, chunks_of, shape_of, timeout_ms

from gateway.bus.frames import EXTENDED, empty, joined
from gateway.bus.logs import LogReader, open_writer
from gateway.bus.timeline import LogTime
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_replay.replay import FED, replay

BUS = '[[bus]]\nname = "powertrain"\nuri = "virtual:bench"\nbitrate = 500_000\ndatabase = {files}\n'
CHECK = '[[bus.check]]\nmessage = "{name}"\ntimeout_ms = {timeout}\nlost = "{lost}"\ninvalid = "{invalid}"\n'
COUNTER = 'counter = { signal = "FrameCnt" }\n'
CRC = 'crc = { signal = "Crc", data_id = 0x700 }\n'
CRANK = '[[monitor]]\nname = "crank"\ntype = "crank_sync"\nbus = "powertrain"\nwheel = "60-2"\n'


def crank_steps():
    """Return the parts of gateway.toml, each with what it adds to the ones before, and the whole."""
    bus = BUS.format(files=json.dumps([str(shipped(f"dbc/{name}.dbc")) for name in ("crank", "gateway")]))
    check = CHECK.format(name="CTW_PT4", timeout=500.0, lost="U0100", invalid="U0401")
    steps = [
        ("dispatch of a frame that nobody wants", bus),
        ("decode, timeout and length", bus + check),
        ("alive counter", bus + check + COUNTER),
        ("CRC", bus + check + COUNTER + CRC),
        ("crankshaft: four teeth", bus + check + COUNTER + CRC + CRANK),
        ("messages sent, and decoded again", bus + check + COUNTER + CRC + CRANK + "send = true\n"),
    ]
    return steps, shipped("gateway.toml").read_text()


def plain_steps(folder, count):
    """Return the parts of a configuration of so many messages, and the whole."""
    (folder / "plain.dbc").write_text(DBC + "".join(MESSAGE.format(id=0x8001_0000 + k, k=k) for k in range(count)))
    bus = BUS.format(files=json.dumps([str(folder / "plain.dbc")]))
    checks = [
        CHECK.format(name=f"M{k}", timeout=timeout_ms(k, count), lost=f"U1{k:03X}", invalid=f"U2{k:03X}")
        for k in range(count)
    ]
    whole = bus + "".join(check + COUNTER for check in checks)
    steps = [
        ("dispatch of a frame that nobody wants", bus),
        ("decode, timeout and length", bus + "".join(checks)),
        ("alive counter", whole),
    ]
    return steps, whole


def ignored(events):
    """Take the events of a loop alone."""


def loop_ns(config, frames, *, whole):
    """Return what the loop, or the whole of ``feed`` around it, takes of a frame [ns]."""
    gateway = Gateway(load_config(config), lasting=True)
    gateway.start(0)
    settling = min(len(frames) // 2, 100_000)  # the first pass of each test is a verdict
    gateway.feed(frames[:settling])
    begun = time.thread_time_ns()
    for k in range(settling, len(frames), FED):
        part = frames[k : k + FED]
        _ = gateway.feed(gateway.without_own(part)) if whole else gateway.engine.process(part, ignored)
    took = time.thread_time_ns() - begun
    gateway.close()
    return took / (len(frames) - settling)


def even_ns(frames):
    """Return what the even time of a log takes of a frame [ns]."""
    even, begun = LogTime(), time.thread_time_ns()
    for k in range(0, len(frames), FED):
        even.apply(frames[k : k + FED])
    return (time.thread_time_ns() - begun) / len(frames)


def read_ns(log):
    """Return what reading a frame takes [ns]."""
    begun = time.thread_time_ns()
    count = sum(len(frames) for frames in LogReader(log, channels={"can0": 0}))
    return (time.thread_time_ns() - begun) / count


def from_file_ns(log, config):
    """Return what a frame takes from the file to its events [ns]."""
    gateway = Gateway(load_config(config), lasting=True)
    gateway.engine.warm()
    begun = time.thread_time_ns()
    count = replay(gateway, LogReader(log, channels={"can0": 0}))
    took = time.thread_time_ns() - begun
    gateway.close()
    return took / count


def parts_of(folder, frames, steps, whole, rounds, log):
    """Return the parts of a frame in order, each in ns."""
    files = []
    for k, (_, text) in enumerate([*steps, ("", whole)]):
        files.append(folder / f"{k}.toml")
        files[-1].write_text(text)
    best = np.full((rounds, len(steps) + 3), np.inf)
    for row in best:  # in turn, so that a machine that slows down slows all of them
        row[0], row[1] = read_ns(log), even_ns(frames)
        for k in range(len(steps)):
            row[2 + k] = loop_ns(files[k], frames, whole=False)
        row[-1] = loop_ns(files[-1], frames, whole=True)
    least = best.min(axis=0)
    names = [
        "file: read, parsed",
        "even time",
        *(name for name, _ in steps),
        "around the loop: recorder, servers, Python",
    ]
    values = [*least[:3], *np.diff(least[2:])]
    return [{"name": name, "ns": float(value)} for name, value in zip(names, values, strict=True)], files[-1]


def measure(folder, frames, steps, whole, options):
    """Return the parts, and the whole."""
    folder.mkdir()
    log = folder / "bench.log"
    with open_writer(log, interfaces={0: "can0"}) as writer:
        writer.write(frames)
    parts, config = parts_of(folder, frames, steps, whole, options.rounds, log)
    return {"parts": parts, "from the file": min(from_file_ns(log, config) for _ in range(options.rounds))}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=500_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--messages", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    shape = shape_of("messages", options.messages)
    plain = joined(list(chunks_of(shape, 0, options.frames, empty, EXTENDED)))
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = {
            "gateway.toml": measure(folder / "crank", make_log(options.frames), *crank_steps(), options=options),
            f"{options.messages} messages": measure(
                folder / "plain", plain, *plain_steps(folder, options.messages), options=options
            ),
        }
    if options.json:
        print(json.dumps({"configurations": found, "machine": machine}, indent=2))
        return
    print(f"{machine}; {options.frames} frames, best of {options.rounds}")
    for title, one in found.items():
        print(f"\n{title:50}{'ns a frame':>12}")
        for part in one["parts"]:
            print(f"{part['name']:50}{part['ns']:>12.1f}")
        print(f"{'all':50}{sum(part['ns'] for part in one['parts']):>12.1f}")
        print(f"{'from the file to the last event':50}{one['from the file']:>12.1f}")


if __name__ == "__main__":
    main()
