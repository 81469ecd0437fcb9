"""Time per sample of the voters, beside a filterpy filter and the same filter in plain Python, in one run.

python bench/pedal.py [--samples 1000000] [--json]
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from filterpy.kalman import KalmanFilter

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.vecu import contract
from gateway_fdi.common.resources import shipped
from gateway_plants.pedal.ecu.ecu import ECU
from gateway_plants.pedal.ecu.params import PedalParams
from gateway_plants.pedal.study.cases import NOISY, Case, Run, make
from gateway_plants.pedal.study.follow import VOTERS, follow

REPEATS = 5
CASES = {
    "no fault": Case("none"),
    "impulses on both": Case("impulses"),
    "one dead, impulses": Case("dead", onset=300),
    "drift": Case("drift"),
}


def filterpy_us(values, states):
    """One predict and update of filterpy's class a sample [us]."""
    kf = KalmanFilter(dim_x=states, dim_z=1)
    kf.F = np.eye(states) + np.eye(states, k=1)
    kf.H = np.eye(1, states)
    kf.Q *= 1e-4
    begun = time.perf_counter()
    for value in values:
        kf.predict()
        kf.update(value)
    return (time.perf_counter() - begun) / len(values) * 1e6


def plain_us(values):
    """The scalar filter of the paper's predictor in plain Python [us]."""
    begun = time.perf_counter()
    x, p = 0.0, 1.0
    for value in values:
        p += 1.0
        k = p / (p + 0.5)
        x += k * (value - x)
        p *= 1.0 - k
    return (time.perf_counter() - begun) / len(values) * 1e6


def voter_us(voter, run):
    follow(voter, NOISY, Run(run.truth, run.readings[:1000], run.faulty, -1, 0))
    best = np.inf
    for _ in range(REPEATS):
        begun = time.perf_counter()
        follow(voter, NOISY, run)
        best = min(best, time.perf_counter() - begun)
    return best / len(run.readings) * 1e6


def engine_us(samples):
    """The whole way of a sample: decode, counter, CRC, monitor with its tests, voted frame [us]."""
    params = PedalParams(stroke="driving")
    frames, _ = ECU.frames(params, (), contract.Run(16.0, 0, np.random.default_rng(1)))
    repeats = max(samples // len(frames), 1)
    many = np.tile(frames, repeats)
    many["t_ns"] += np.repeat(np.arange(repeats) * 16_000_000_000, len(frames))
    best = np.inf
    for _ in range(REPEATS):
        gateway = Gateway(load_config(shipped("configs/pedal.toml")))
        gateway.start(0)
        begun = time.perf_counter()
        sent = sum(len(gateway.feed(part)) for part in np.array_split(many, max(len(many) // 100_000, 1)))
        best = min(best, time.perf_counter() - begun)
        gateway.close()
        assert sent >= len(many)
    return best / len(many) * 1e6


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    filterpy_us(np.zeros(2000), 2)  # the first calls are slow
    for name, case in CASES.items():
        made = make(case, NOISY, 1)
        repeats = max(options.samples // len(made.readings), 1)
        run = Run(made.truth, np.tile(made.readings, (repeats, 1)), made.faulty, -1, 0)
        few = run.readings[:5000, 1]
        peer = filterpy_us(few, 2)
        times = {voter: voter_us(voter, run) for voter in VOTERS}
        times["plain Python, 1 state"] = plain_us(run.readings[:200_000, 1].tolist())
        times["filterpy, 1 state"] = filterpy_us(few, 1)
        times["filterpy, 2 states"] = peer
        rows += [
            {
                "case": name,
                "name": voter,
                "us": us,
                "ratio": peer / us,
                "against": "filterpy, 2 states",
            }
            for voter, us in times.items()
        ]
    rows.append(
        {
            "case": "on the bus",
            "name": "whole gateway",
            "us": (us := engine_us(options.samples)),
            "ratio": peer / us,
            "against": "filterpy, 2 states",
        }
    )
    if options.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        print(f"{row['case']:20s} {row['name']:22s} {row['us']:9.4f} us a sample  {row['ratio']:9.1f} x filterpy")


if __name__ == "__main__":
    main()
