"""Logs into tables: gateway decode beside asammdf's extraction of the same MF4 log and cantools, in one run.

    python bench/decode.py [--frames 500000] [--json]

The log: messages of the database of examples/car with random payloads. Ours reads, decodes and writes Parquet;
asammdf's extract_bus_logging reads and decodes, and writes nothing; cantools decodes a part into dictionaries.
CPU time.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import asammdf
import can
import cantools
import numpy as np

from gateway.bus.frames import EXTENDED, empty, to_message
from gateway.bus.logs import LogReader
from gateway.signals.database import load_database
from gateway_fdi.common.resources import shipped
from gateway_logs.decode.parquet_tables import Lake

#: Frames that cantools gets.
PART = 20_000


def whole(message):
    """Tell whether a message is long enough for its signals."""
    try:
        message.decode(bytes(message.length))
    except cantools.database.DecodeError:
        return False
    return True


def traffic(database, count):
    """Return frames of all messages in turn."""
    messages = [m for m in database.messages if m.length <= 8 and not m.is_multiplexed() and whole(m)]
    rng = np.random.default_rng(1)
    frames = empty(count)
    index = np.arange(count) % len(messages)
    ids = np.array([m.frame_id | (EXTENDED if m.is_extended_frame else 0) for m in messages], np.uint32)
    lengths = np.array([m.length for m in messages], np.uint8)
    frames["can_id"], frames["length"] = ids[index], lengths[index]
    frames["t_ns"] = 1_700_000_000 * 10**9 + np.arange(count) * 200_000
    frames["data"][:, :8] = rng.integers(0, 256, (count, 8))
    frames["data"][np.arange(64) >= frames["length"][:, None]] = 0
    return frames


def timed(work):
    begun = time.process_time()
    work()
    return time.process_time() - begun


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=500_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    path = shipped("examples/car/toyota_rav4.dbc")
    database = cantools.database.load_file(path, strict=False)
    frames = traffic(database, options.frames)

    def decode(log):
        lake = Lake(Path(folder) / "lake", [load_database([path])])
        tables = lake.begin("car", log.stem)
        for batch in LogReader(log):
            tables.add(batch)
        return tables.finish().rows

    def extract(log):
        with asammdf.MDF(log) as mdf:
            mdf.extract_bus_logging({"CAN": [(path, 0)]})

    def by_cantools():
        by_id = {m.frame_id: m for m in database.messages}
        for frame in frames[:PART]:
            by_id[int(frame["can_id"]) & 0x1FFFFFFF].decode(bytes(frame["data"][: frame["length"]]), False)

    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mf4"
        with can.Logger(log) as logger:
            for frame in frames:
                logger(to_message(frame, channel=0))
        blf = Path(folder) / "a.blf"
        with can.Logger(blf) as logger:
            for frame in frames:
                logger(to_message(frame, channel=0))
        decode(log)  # what is compiled is
        ours, ours_blf = timed(lambda: decode(log)), timed(lambda: decode(blf))
        theirs = timed(lambda: extract(log))
    per_frame = {
        "ours from MF4": ours / len(frames),
        "ours from BLF": ours_blf / len(frames),
        "asammdf extract_bus_logging": theirs / len(frames),
        "cantools decode": timed(by_cantools) / PART,
    }
    if options.json:
        print(json.dumps(per_frame))
        return
    ours = per_frame["ours from MF4"]
    for name, took in per_frame.items():
        print(f"{name}: {1 / took:,.0f} frames/s, {took / ours:.1f} times the time of ours from MF4")


if __name__ == "__main__":
    main()
