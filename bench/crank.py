"""CPU time per tooth of the crankshaft methods, beside a filterpy filter and the peers' gap logic, in one run.

Of this thread, so that what else the machine does counts little; arrays for the results (3 ns a tooth) are in it.

python bench/crank.py [--teeth 1000000] [--json]
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from filterpy.kalman import KalmanFilter

from gateway_plants.crank.study.cases import healthy, sweep
from gateway_plants.crank.study.follow import METHODS, follower
from gateway_plants.crank.wheel import Wheel

REPEATS = 5


def filterpy_us(times):
    """One predict and update of a three-state filter per tooth, as one writes it with filterpy [us]."""
    kf = KalmanFilter(dim_x=3, dim_z=1)
    kf.F = np.array([[1, 1, -0.25], [0, 1, -0.5], [0, 0, 1]])
    kf.H = np.array([[1.0, 0, 0]])
    kf.Q *= 1e-4
    y = np.diff(times[:5000])
    begun = time.thread_time()
    for value in y:
        kf.predict()
        kf.update(value)
    return (time.thread_time() - begun) / len(y) * 1e6


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--teeth", type=int, default=1_000_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    wheel = Wheel.parse("60-2")
    rng = np.random.default_rng(1)
    seconds = options.teeth / wheel.pulses / (3000 / 60)
    cases = {
        "3000 rpm, 1 % jitter": healthy(wheel, [(0.0, 3000.0)], seconds, rng),
        "300..8000 rpm, 1 %": sweep(wheel, options.teeth, 0.01, rng),
        "300..8000 rpm, 5 %": sweep(wheel, options.teeth, 0.05, rng),
    }
    facts = []
    for case, times in cases.items():
        peer = filterpy_us(times)
        for method in METHODS:
            follow = follower(method, wheel)
            follow(times[:2000])
            best = min(_timed(follow, times) for _ in range(REPEATS))
            facts.append({"case": case, "method": method, "us": best, "times_filterpy": peer / best})
        facts.append({"case": case, "method": "filterpy, 3 states", "us": peer, "times_filterpy": 1.0})
    if options.json:
        print(json.dumps(facts))
        return
    for fact in facts:
        print(
            f"{fact['case']:24s} {fact['method']:20s} {fact['us']:9.3f} us a tooth"
            f"  {fact['times_filterpy']:9.1f} x filterpy"
        )


def _timed(follow, times):
    begun = time.thread_time()
    follow(times)
    return (time.thread_time() - begun) / len(times) * 1e6


if __name__ == "__main__":
    main()
