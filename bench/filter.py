"""What a step of one's own costs: a compiled filter of 4 states, one in Python, a function, beside the libraries.

All get the same frames in batches as the live loop has them. A step is what a gateway with the monitor takes longer
than one without; the peer's is its whole loop: python-can messages, cantools decode, filterpy's predict and update.

    python bench/filter.py [--frames 200000] [--batch 64] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import cantools
import numpy as np

from gateway.bus.frames import empty, put, to_message
from gateway.common import trust
from gateway.config.load import load_config
from gateway.runtime.app import Gateway

DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 256 CAR: 8 ECU
 SG_ Speed : 0|16@1- (0.01,0) [-300|300] "m/s" X
 SG_ Way : 16|16@1- (0.01,0) [-300|300] "m" X
"""
OWN = """import numpy as np
from filterpy.kalman import KalmanFilter
from gateway.monitors.plain import Result, monitor


def make():
    kf = KalmanFilter(4, 2)
    kf.F = np.eye(4) + 0.01 * np.eye(4, k=2)
    kf.H, kf.Q, kf.R = np.eye(2, 4), np.eye(4) * 1e-3, np.eye(2) * 0.01
    return kf


class Own(KalmanFilter):
    pass


def in_python():
    kf = make()
    kf.__class__ = Own  # of a class of one's own: not compiled
    return kf


@monitor(signals=["CAR.Speed", "CAR.Way"], fault="P0500-00")
def plain(speed, way, limit: float = 200.0):
    return Result(abs(speed - way) > limit, speed - way, limit)
"""
CONFIG = '[[bus]]\nname = "can"\nuri = "virtual:car"\ndatabase = ["car.dbc"]\n'
FILTER = (
    '[[monitor]]\nname = "mine"\ntype = "filter"\nz = ["CAR.Speed", "CAR.Way"]\nperiod_ms = 10.0\n'
    'filter = "own_filter:{}"\n'
)
ROWS = {
    "compiled filter of 4 states, all tests": (FILTER.format("make"), 1),
    "the same filter in Python": (FILTER.format("in_python"), 20),
    "a function of plain Python": ('[[monitor]]\nname = "mine"\ntype = "own_filter:plain"\n', 10),
}


def make_log(count):
    rng = np.random.default_rng(1)
    frames = empty(count)
    for k, (speed, way) in enumerate(rng.normal(0.0, 10.0, (count, 2))):
        payload = b"".join(round(value).to_bytes(2, "little", signed=True) for value in (speed, way)) + bytes(4)
        put(frames, k, (k + 1) * 10_000_000, 256, payload, bus=0)
    return frames


def user_loop(messages, database, kf):
    message = database.get_message_by_name("CAR")
    for m in messages:
        values = message.decode(bytes(m.data))
        kf.predict()
        kf.update(np.array([[values["Speed"]], [values["Way"]]]))


def fed(folder, keys, frames, batch):
    """Return the seconds that a gateway takes for frames."""
    path = folder / "gateway.toml"
    path.write_text(CONFIG + keys)
    gateway = Gateway(load_config(path), file=path)
    gateway.start(0)
    gateway.feed(frames[:batch])
    begun = time.perf_counter()
    for k in range(batch, len(frames), batch):
        gateway.feed(frames[k : k + batch])
    seconds = time.perf_counter() - begun
    gateway.close()
    return seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200_000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    os.environ[trust.VARIABLE] = trust.ALL
    best = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "car.dbc").write_text(DBC)
        (folder / "own_filter.py").write_text(OWN)
        frames, space = make_log(options.frames), {}
        exec(OWN.partition("\n\n\nclass")[0], space)
        database, messages = cantools.database.load_file(folder / "car.dbc"), [to_message(f) for f in frames[:5000]]
        for _ in range(options.rounds):
            begun = time.perf_counter()
            user_loop(messages, database, space["make"]())
            found = {"python-can + cantools + filterpy": (time.perf_counter() - begun) / len(messages)}
            for row, (keys, fewer) in ROWS.items():
                part = frames[: len(frames) // fewer]
                more = fed(folder, keys, part, options.batch) - fed(folder, "", part, options.batch)
                found[row] = more / len(part)
            for row, seconds in found.items():
                best[row] = min(best.get(row, 1.0), seconds)
    peer = best["python-can + cantools + filterpy"]
    rows = [
        {"name": row, "us": 1e6 * s, "ratio": peer / s, "against": "python-can + cantools + filterpy"}
        for row, s in best.items()
    ]
    if options.json:
        print(json.dumps({"rows": rows}, indent=2))
        return
    for row in rows:
        print(f"{row['name']:46}{row['us']:>10.3f} us{row['ratio']:>9.1f}x")


if __name__ == "__main__":
    main()
