"""A change of a verdict among 2000 components, 200 of whose tests fail: how long until the diagnoses are there.

    python bench/diagnosis.py [--changes N] [--seed S]

ms of CPU of one thread, and the memory that Python has allocated. Peer: HiGHS (SciPy), which is given the conflicts of
the same moment and finds one diagnosis, the likeliest, without what sizes and the order of failures say; the ratio is
its time over ours. What is there at the start is kept from Python's collector, as the live loop does: each of its
full rounds took 24 to 28 ms, twice what a change does.
"""

from __future__ import annotations

import argparse
import gc
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it

import time
import tracemalloc

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array

from gateway_fdi.diagnosis.cluster import Cluster
from gateway_fdi.diagnosis.diagnoser import Diagnoser
from gateway_fdi.diagnosis.state import FAILED, PASSED
from gateway_fdi.diagnosis.system import Component, Link, Test

COMPONENTS, CONFLICTS, TESTS = 2000, 200, 1000
LIMIT_MS = 20.0


def system(rng: np.random.Generator, causes: int, signed: float) -> tuple[list[Component], list[Test], list[int]]:
    """Return components, tests, and the places of what is faulty; the first CONFLICTS tests see it."""
    components = [Component(f"c{k}", prior=float(10 ** rng.uniform(-4.5, -2.5))) for k in range(COMPONENTS)]
    faulty = rng.choice(COMPONENTS, causes, replace=False).tolist()
    tests = []
    for k in range(TESTS):
        places = set(rng.choice(COMPONENTS, int(rng.integers(5, 60)), replace=False).tolist()) - set(faulty)
        places |= {faulty[k % causes]} if k < CONFLICTS else set()
        gains = rng.random() < signed
        links = [Link(f"c{c}", 0.9, float(rng.normal()) if gains else float("nan")) for c in sorted(places)]
        tests.append(Test(f"t{k}", tuple(links), 1e-4, noise=1.0 if gains else float("nan")))
    return components, tests, faulty


def by_highs(cluster: Cluster) -> float:
    """Return the CPU time in which HiGHS finds the likeliest diagnosis [s]."""
    tests, suspects = np.nonzero(cluster.power > 0.0)
    count, rows = len(cluster.suspects), len(cluster.failed)
    columns = np.concatenate([suspects, count + np.arange(rows)])  # a test may be a false alarm
    matrix = coo_array((np.ones(len(columns)), (np.concatenate([tests, np.arange(rows)]), columns)))
    costs = np.concatenate([-cluster.weights, -np.array(cluster.prices)])
    begun = time.process_time()
    milp(costs, integrality=np.ones(count + rows), bounds=Bounds(0, 1), constraints=LinearConstraint(matrix, lb=1))
    return time.process_time() - begun


def measure(causes: int, signed: float, changes: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    components, tests, faulty = system(rng, causes, signed)
    tracemalloc.start()
    diagnoser = Diagnoser(components, tests)
    size = {c: float(rng.normal() * 20) for c in faulty}
    second = 1_000_000_000

    def tell(k: int, verdict: int, t: int) -> None:
        seen = sum(
            link.gain * size[int(link.component[1:])] for link in tests[k].links if int(link.component[1:]) in size
        )
        diagnoser.update(f"t{k}", verdict, t, seen + rng.normal())

    for k in range(TESTS):
        tell(k, PASSED, 0)
    for k in range(CONFLICTS):
        tell(k, FAILED, second)
    for k in range(CONFLICTS, TESTS):
        tell(k, PASSED, 2 * second)
    diagnoser.diagnose()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    gc.collect()
    gc.freeze()
    times, right = [], 0
    for n in range(changes):
        k, t = int(rng.integers(TESTS)), (3 + n) * second
        tell(
            k,
            PASSED if k < CONFLICTS and diagnoser.state.verdict[k] == FAILED else FAILED if k < CONFLICTS else PASSED,
            t,
        )
        begun = time.process_time()
        groups = diagnoser.diagnose()
        times.append(time.process_time() - begun)
        right += sorted(c for g in groups for c in g.diagnoses[0].components) == sorted(faulty)
    cluster = Cluster(diagnoser.system, diagnoser.state, max((g.failed for g in groups), key=len))
    peer = min(by_highs(cluster) for _ in range(3))
    tracemalloc.start()
    begun = tracemalloc.get_traced_memory()[0]
    diagnoser.update("t0", PASSED, 10**15)
    diagnoser.diagnose()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    ms = np.array(times) * 1e3
    name = f"{causes} faulty, {signed:.0%} of the tests signed"
    print(
        f"{name:<36} p50 {np.median(ms):6.2f}  p99 {np.quantile(ms, 0.99):6.2f}  worst {ms.max():6.2f} ms"
        f"  HiGHS {1e3 * peer:7.1f} ms = {peer / np.median(times):5.1f} x  first is right {right / changes:4.0%}"
        f"  {before / 2**20:.0f} MiB kept, {(peak - begun) / 2**20:.1f} MiB for a change"
    )
    if ms.max() > LIMIT_MS:
        print(f"  more than {LIMIT_MS:g} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--changes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    print(f"{COMPONENTS} components, {TESTS} tests, {CONFLICTS} of them fail; seed {args.seed}, {args.changes} changes")
    for causes in (1, 2, 5):
        for signed in (0.0, 0.5):
            measure(causes, signed, args.changes, args.seed)


if __name__ == "__main__":
    main()
