"""Bursts, ringing and chatter in the pulses of a healthy engine: the methods side by side.

A run is an engine at a constant mean speed with one disturbance of 1 to 40 pulses, at any tooth or in the largest gap:

* *burst*: pulses at random times within one interval;
* *ring*: pulses at 8 to 20 kHz behind one edge, as an amplifier rings behind an ignition;
* *chatter*: one to three pulses close behind each of several teeth.

Counted are the runs with a wrong tooth that was proven behind the disturbance (in its two turns, and later), those that
are proven again later than two turns behind it, those with no report at all, and those told as a place that was wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_bench.study_pool import Progress, run
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.monitor.faults import RELOCATED
from gateway_plants.crank.monitor.runout import FIRING_RPM
from gateway_plants.crank.study.cases import JITTER, TOOTH_ERROR
from gateway_plants.crank.study.follow import Followed, Method, follower_of, warm
from gateway_plants.crank.study.outside import WHEELS
from gateway_plants.crank.wheel import Wheel

KINDS = ("burst", "ring", "chatter")
SPEEDS_RPM = (200.0, 600.0, 1500.0, 3000.0, 8000.0)
METHODS: tuple[Method, ...] = ("adaptive", "ratio", "threshold")
#: Pulses of a disturbance, share of those that are put into the largest gap, turns of a run and before the disturbance.
MOST_PULSES, IN_GAP, TURNS, BEFORE = 40, 0.3, 24, 10
#: Turns within which a place has to be proven again, and share of a turn that is proven then.
GRACE, PROVEN = 2, 0.9
#: Frequency of ringing [Hz].
RING_HZ = (8e3, 20e3)


@dataclass
class Outcome:
    """What a method made of the runs of one kind and wheel.

    Attributes:
        wheel, kind, method: which.
        runs: how many.
        wrong: runs with a wrong tooth that was proven, behind the disturbance.
        late: runs proven again later than :data:`GRACE` turns behind it.
        silent: runs of an engine that fires, without a report (of the peers: without a loss of synchronisation).
        cranking: the same at the starter's speed, where a short burst in the gap may be an engine that turns back.
        relocated: runs told as a place that was wrong.
    """

    wheel: str
    kind: str
    method: str
    runs: int = 0
    wrong: int = 0
    late: int = 0
    silent: int = 0
    cranking: int = 0
    relocated: int = 0


def _extra(times: NDArray[np.float64], at: int, kind: str, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the times of a disturbance behind pulse ``at`` [us]."""
    count = int(rng.integers(1, MOST_PULSES + 1))
    width = times[at + 1] - times[at]
    if kind == "burst":
        return np.asarray(times[at] + width * np.sort(rng.uniform(0.02, 0.98, count)))
    if kind == "ring":
        return np.asarray(times[at] + np.arange(1, count + 1) * 1e6 / rng.uniform(*RING_HZ))
    pieces = []
    for k in range(max(1, count // 2)):
        shares = np.cumsum(rng.uniform(0.02, 0.1, int(rng.integers(1, 4))))
        pieces.append(times[at + k] + shares * (times[at + k + 1] - times[at + k]))
    return np.concatenate(pieces)


def disturbed(
    wheel: Wheel, rpm: float, kind: str, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64], int]:
    """Return pulse times [us], the tooth of each (-1: none), and the number of the disturbance's last pulse."""
    ripple = [(2.0, min(0.05, 40 / rpm), rng.uniform(0, 2 * np.pi))]
    times = tooth_times(
        wheel, [(0, rpm)], TURNS * 60 / rpm, ripple=ripple, jitter=JITTER, tooth_error=TOOTH_ERROR, rng=rng
    )
    us = times / 1e3
    at = (BEFORE + 1) * wheel.pulses - 1
    if rng.random() >= IN_GAP:
        at = BEFORE * wheel.pulses + int(rng.integers(wheel.pulses))
    extra = np.rint(_extra(us, at, kind, rng))
    both = np.concatenate([us, extra])
    teeth = np.concatenate([np.arange(len(us)) % wheel.pulses, np.full(len(extra), -1)])
    order = np.argsort(both, kind="stable")
    both, teeth = both[order], teeth[order]
    apart = np.concatenate([[True], np.diff(both) > 0])
    both, teeth = both[apart], teeth[apart]
    return both, teeth, int(np.searchsorted(both, extra.max()))


def _judge(row: Outcome, found: Followed, teeth: NDArray[np.int64], last: int, wheel: Wheel, rpm: float) -> None:
    """Count one run."""
    real = teeth[1:] >= 0
    right = real & (found.teeth % wheel.repeats == teeth[1:] % wheel.repeats)
    row.runs += 1
    row.wrong += bool((found.proven & ~right)[last:].any())
    behind = found.proven[last:]
    first = next((k for k in np.flatnonzero(behind) if behind[k : k + wheel.pulses].mean() > PROVEN), len(behind))
    row.late += bool(first > GRACE * wheel.pulses)
    silent = not len(found.fault) if row.method == "adaptive" else found.alarms == 0
    row.silent += silent and rpm > FIRING_RPM
    row.cranking += silent and rpm <= FIRING_RPM
    row.relocated += bool((found.fault == RELOCATED).any())


def outcomes(text: str, kind: str, runs: int, seed: int, methods: tuple[Method, ...] = METHODS) -> list[Outcome]:
    """Return an outcome for each method."""
    wheel = Wheel.parse(text)
    rows = {method: Outcome(text, kind, method) for method in methods}
    for speed, rpm in enumerate(SPEEDS_RPM):
        for k in range(runs):
            rng = np.random.default_rng([seed, WHEELS.index(text), KINDS.index(kind), speed, k])
            times, teeth, last = disturbed(wheel, rpm, kind, rng)
            for method, row in rows.items():
                _judge(row, follower_of(method, text)(times), teeth, last, wheel, rpm)
    return list(rows.values())


def outcome(text: str, kind: str, runs: int, seed: int) -> Outcome:
    """Return the outcome of the adaptive method alone; arguments as of :func:`outcomes`."""
    return outcomes(text, kind, runs, seed, ("adaptive",))[0]


def _job(job: tuple[str, str, int, int]) -> list[Outcome]:
    return outcomes(*job)


def jobs(runs: int, seed: int) -> list[tuple[str, str, int, int]]:
    """Return the jobs of :func:`gauntlet`."""
    return [(text, kind, runs, seed) for kind in KINDS for text in WHEELS]


def gauntlet(runs: int, seed: int, progress: Progress = lambda: None) -> list[Outcome]:
    """Return an outcome for each kind, wheel and method.

    Args:
        runs: of each kind, wheel and speed.
        seed: of all of them.
        progress: called at the end of each job.
    """
    warm(METHODS)
    return run(_job, jobs(runs, seed), progress)
