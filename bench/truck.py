"""One FTP75 of the hybrid truck (187 400 sets of four frames) through the engine, beside a user's loop, in one run.

The peer does less: it decodes the four frames with cantools, adds up T1's CUSUM, and steps T7's filter of seven states
with filterpy. The gateway also checks CRCs and counters, steps ten residual generators and thirteen test quantities,
keeps the fault memory's debounce and sends FDI_STATUS.

    python bench/truck.py [--sets 3000] [--json]
"""

from __future__ import annotations

import argparse
import json
import time

import cantools
import numpy as np
from filterpy.kalman import KalmanFilter

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_plants.truck.ecu.drive import drive
from gateway_plants.truck.ecu.ecu import frames_of
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.study.follow import DURATION, follow, inputs
from gateway_plants.truck.study.table import TRUCK

REPEATS = 5
LEAST = 1000.0


def peer_us(frames):
    """What one writes with the libraries: time of a set [us]."""
    database = cantools.database.load_file(shipped("dbc/truck.dbc"))
    kf = KalmanFilter(dim_x=7, dim_z=1)
    kf.H[0, 0], kf.R[:] = 2.92, 0.04
    kf.Q = np.diag([1e-8, *[1e-6] * 6])
    rows = [(int(f["can_id"]), bytes(f["data"][:8])) for f in frames]
    total, values = 0.0, {}
    begun = time.perf_counter()
    for k, (number, data) in enumerate(rows):
        values.update(database.decode_message(number, data, decode_choices=False))
        if k % 4 == 3:
            total = max(0.0, total + abs(values["U_em_ctrl"] - values["U_em_sens"]) - 1.4)
            kf.F[0, 1:] = 0.01
            kf.predict()
            kf.update(values["w_gb_sens"])
    return (time.perf_counter() - begun) / (len(rows) // 4) * 1e6


def engine_s(frames):
    """The whole way through the engine [s]."""
    best = np.inf
    for _ in range(REPEATS):
        gateway = Gateway(load_config(shipped("configs/truck.toml")))
        gateway.start(0)
        begun = time.perf_counter()
        for k in range(0, len(frames), 100_000):
            gateway.feed(frames[k : k + 100_000])
        best = min(best, time.perf_counter() - begun)
        assert gateway.engine.state_of(0)[0]["sets"] == len(frames) // 4
        gateway.close()
    return best


def monitor_s(u):
    """The monitor's kernel alone [s]."""
    best = np.inf
    for _ in range(REPEATS):
        begun = time.perf_counter()
        follow(u, Params())
        best = min(best, time.perf_counter() - begun)
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=3000, help="that the peer takes")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    frames = frames_of(TRUCK, drive(TRUCK, (), DURATION), bus=0, rng=np.random.default_rng(1))
    sets = len(frames) // 4
    follow(inputs(TRUCK, None, 1), Params())
    whole, alone = engine_s(frames), monitor_s(inputs(TRUCK, None, 1))
    peer = peer_us(frames[: 4 * options.sets])
    rows = [
        {"name": "cantools, filterpy", "us": peer, "ratio": 1.0},
        {"name": "whole gateway", "us": whole / sets * 1e6, "ratio": peer * sets / whole / 1e6},
        {"name": "the monitor alone", "us": alone / sets * 1e6, "ratio": peer * sets / alone / 1e6},
    ]
    speed = DURATION / whole
    if options.json:
        print(json.dumps({"rows": rows, "times_real_time": speed, "least": LEAST}))
    else:
        for row in rows:
            print(f"{row['name']:20s} {row['us']:9.3f} us a set  {row['ratio']:7.1f} x the peer")
        print(f"FTP75, {sets} sets of 4 frames: {whole:.2f} s, {speed:.0f} x real time (asked for: {LEAST:.0f} x)")
    raise SystemExit(0 if speed >= LEAST else 1)


if __name__ == "__main__":
    main()
