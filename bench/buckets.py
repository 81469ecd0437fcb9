"""What the buckets of test results cost a replay: the same log with and without them, in turn, in one run.

    python bench/buckets.py [--frames 400000] [--rounds 7] [--look-hz 20] [--json]

The log is that of bench/engine.py: four teeth a frame, each with its test results. "without" is the same machine code
with an empty table of buckets. "read" takes the buckets out 20 times a second of the log's time, as the page and the
report do.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time

from engine import make_log

from gateway.config.load import load_config
from gateway.engine.tables import table
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped

CHUNK = 100_000


def made(*, buckets):
    gateway = Gateway(load_config(shipped("gateway.toml")))
    if not buckets:
        engine = gateway.engine
        engine.tables = engine.tables._replace(buckets=table(0, engine.tables.buckets.dtype))
        engine.warm()
    gateway.start(0)
    return gateway


def run(frames, *, buckets, step=None):
    gateway = made(buckets=buckets)
    gateway.feed(frames[:1])
    begun = time.perf_counter()
    for k in range(1, len(frames), step or CHUNK):
        gateway.feed(frames[k : k + (step or CHUNK)])
        if step and buckets:
            gateway.engine.take_buckets()
    return time.perf_counter() - begun


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=400_000)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--look-hz", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    frames = make_log(options.frames)
    seconds = (int(frames["t_ns"][-1]) - int(frames["t_ns"][0])) / 1e9
    step = max(round(len(frames) / seconds / options.look_hz), 1)
    ways = {
        "without": {"buckets": False},
        "with": {"buckets": True},
        "without, in pieces": {"buckets": False, "step": step},
        "with, read": {"buckets": True, "step": step},
    }
    took = {name: [] for name in ways}
    for way in ways.values():
        run(frames[:CHUNK], **way)
    for k in range(options.rounds):  # in turn, forwards and backwards: a machine that slows down slows all of them
        for name in list(ways)[:: 1 if k % 2 else -1]:
            took[name].append(run(frames, **ways[name]))
    best = {name: min(values) for name, values in took.items()}
    rows = [
        {"name": name, "frames_per_s": len(frames) / best[name],
         "ratio": best[name] / best[against], "against": against,
         "median_ratio": statistics.median(a / b for a, b in zip(took[name], took[against], strict=True))}
        for name, against in (("with", "without"), ("with, read", "without, in pieces"))
    ]  # fmt: skip
    if options.json:
        print(json.dumps({"rows": rows, "rounds": options.rounds}, indent=2))
        return
    print(f"{len(frames)} frames, {options.rounds} rounds; best, and median of the rounds' ratios")
    for row in rows:
        print(
            f"{row['name']:12}{row['frames_per_s']:>12,.0f} frames/s  {100 * (row['ratio'] - 1):+.2f} %"
            f" ({100 * (row['median_ratio'] - 1):+.2f} %) of {row['against']}"
        )


if __name__ == "__main__":
    main()
