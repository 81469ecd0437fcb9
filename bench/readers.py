"""Reading logs: our readers beside python-can's, of the same files in one run.

    python bench/readers.py [--frames 1000000] [--their-frames 50000] [--json]

The log is a bus of 64 messages of 8 bytes, a counter, a slow signal and noise in each. Both read from the page cache;
ours into batches of arrays, python-can's into messages that are dropped. Medians of three, of CPU time.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

import can
import numpy as np

from gateway.bus.frames import EXTENDED, empty, to_message
from gateway.bus.log_format import formats
from gateway.bus.logs import LogReader, open_writer


def traffic(count):
    """Return so many frames."""
    rng = np.random.default_rng(1)
    frames = empty(count)
    index = np.arange(count)
    ids = rng.integers(1, 2**11, 64).astype(np.uint32)
    ids[::8] = rng.integers(2**20, 2**29, 8).astype(np.uint32) | EXTENDED
    frames["can_id"] = ids[index % 64]
    frames["t_ns"] = 1_700_000_000 * 10**9 + index * 125_000
    frames["length"] = 8
    data = frames["data"]
    data[:, 0] = index // 64 % 16
    data[:, 1] = np.abs(127 * np.sin(index / 1e4)).astype(np.uint8)
    data[:, 2] = rng.integers(0, 4, count)
    data[:, 7] = rng.integers(0, 256, count)
    return frames


def seconds(work):
    took = []
    for _ in range(3):
        begun = time.process_time()
        work()
        took.append(time.process_time() - begun)
    return statistics.median(took)


def drain(path):
    return sum(map(len, LogReader(path)))


def theirs(path):
    with can.LogReader(path) as reader:
        return sum(1 for _ in reader)


def write(path, frames):
    """Write a log: candump and Parquet by ours, the others by python-can's writers."""
    if path.suffix in (".log", ".parquet"):
        with open_writer(path) as writer:
            writer.write(frames)
        return
    with can.Logger(path) as logger:
        for frame in frames:
            logger(to_message(frame, channel=0))


def grown(small, big, suffix, factor):
    """Make a longer log by repeating lines or containers, where that makes one; else return the short one."""
    if suffix == ".blf":  # containers that were begun in one end in the next: whole objects repeat
        data = small.read_bytes()
        big.write_bytes(data[:144] + data[144:] * factor)
        return big
    if suffix in (".log", ".trc", ".csv", ".asc"):
        lines = small.read_bytes().split(b"\n")[:-1]
        ends = [line for line in lines if line.lower().startswith(b"end")]
        head = [line for line in lines[:40] if not line.strip()[:1].isdigit() and not line.startswith(b"(")]
        if suffix == ".csv":
            head = lines[:1]
        body = [line for line in lines[len(head) :] if not line.lower().startswith(b"end")]
        big.write_bytes(b"\n".join(head + body * factor + ends) + b"\n")
        return big
    if suffix == ".parquet":
        write(big, np.tile(next(iter(LogReader(small))), factor))
        return big
    return small


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--their-frames", type=int, default=50_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    frames = traffic(options.their_frames)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in formats():
            small, big = Path(folder) / f"small{suffix}", Path(folder) / f"big{suffix}"
            write(small, frames)
            path = grown(small, big, suffix, max(1, options.frames // options.their_frames))
            count = drain(path)  # once before: what is compiled is
            ours = count / seconds(lambda path=path: drain(path))
            row = {"format": suffix[1:], "frames": count, "ours": ours}
            if suffix != ".parquet":  # python-can has no reader of it
                peer = options.their_frames / seconds(lambda path=small: theirs(path))
                row |= {"python_can": peer, "ratio": ours / peer}
            rows.append(row)
    if options.json:
        print(json.dumps(rows))
        return
    print("| format | frames/s | python-can | ratio |\n|---|---|---|---|")
    for row in rows:
        peer = f"{row['python_can']:,.0f} | {row['ratio']:.0f}" if "ratio" in row else "none |"
        print(f"| {row['format']} | {row['ours']:,.0f} | {peer} |")


if __name__ == "__main__":
    main()
