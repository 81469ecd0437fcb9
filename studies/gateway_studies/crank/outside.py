"""Healthy engines and sensors outside the regular sweep, and dropouts: the methods side by side.

A run is a train of its own seed. Counted are the runs with a report (of the peers: a loss of synchronisation), and
those with a wrong tooth while synchronisation was proven; in dropouts wrong counts from two turns behind the dropout
on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.wheel import Wheel
from gateway.monitors.crank.faults import FAULTS
from gateway.vecu.crank.kinematics import tooth_times
from gateway_studies.crank.cases import JITTER, TOOTH_ERROR
from gateway_studies.crank.follow import Followed, Method, follower
from gateway_studies.pool import Progress, run

WHEELS = ("60-2", "36-1", "30-2", "24-1", "12-1", "36-2", "36-2-1", "36-2-2-2", "12+1")
METHODS: tuple[Method, ...] = ("adaptive", "ratio", "threshold")
ORDERS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
#: Speed [rpm] -> amplitudes of the speed's ripple.
AMPLITUDES = {250.0: (0.1, 0.2, 0.3, 0.4), 850.0: (0.04, 0.06, 0.08, 0.1, 0.12)}
#: Turns of a train, and before a dropout; what is judged begins so many turns behind it.
TURNS, BEFORE, GRACE = 40, 10, 2

#: Pulse times [us], the tooth of each, and the first pulse from which on a wrong tooth counts.
Train = tuple[NDArray[np.float64], NDArray[np.int64], int]


@dataclass
class Outcome:
    """What a method made of the runs of one case.

    Attributes:
        group, case, wheel, method: which.
        runs, pulses: how many.
        reports: runs with a report.
        wrong: runs with a wrong tooth while synchronisation was proven.
        unsynced: share of the pulses without a proven place.
        named: what was reported, and in how many runs (adaptive only).
    """

    group: str
    case: str
    wheel: str
    method: str
    runs: int
    pulses: int
    reports: int
    wrong: int
    unsynced: float
    named: dict[str, int]


def _steady(wheel: Wheel, rpm: float, rng: np.random.Generator, **options: Any) -> Train:
    """Return a train at a constant mean speed."""
    options = {"jitter": JITTER, "tooth_error": TOOTH_ERROR, **options}
    times = tooth_times(wheel, [(0, rpm)], TURNS * 60 / rpm, rng=rng, **options) / 1e3
    return times, np.arange(len(times)) % wheel.pulses, 0


def _rippled(order: float, amplitude: float, rpm: float) -> Callable[[Wheel, np.random.Generator, int], Train]:
    def make(wheel: Wheel, rng: np.random.Generator, number: int) -> Train:
        phase = 2 * np.pi * (number % 16 + rng.random()) / 16
        return _steady(wheel, rpm, rng, ripple=[(order, amplitude, phase)])

    return make


def _off(tooth_error: float, runout: float) -> Callable[[Wheel, np.random.Generator, int], Train]:
    def make(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
        times, teeth, first = _steady(wheel, 1500.0, rng, tooth_error=tooth_error, ripple=[(2.0, 0.03, 1.0)])
        # Off centre: the angle of a tooth by the sine of the turn's, at constant speed its time as well.
        turn = 60e6 / 1500.0
        phase = rng.uniform(0, 2 * np.pi)
        moved = times + runout / (2 * np.pi) * turn * np.sin(2 * np.pi * times / turn + phase)
        return np.asarray(moved, np.float64), teeth, first

    return make


def _gap(change: float) -> Callable[[Wheel, np.random.Generator, int], Train]:
    def make(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
        pitches = list(wheel.pitches)
        pitches[-1] += change
        made = Wheel("", tuple(pitches))
        return _steady(made, 1000.0, rng, ripple=[(2.0, 0.03, rng.uniform(0, 6))])

    return make


def _speed(rpm: float) -> Callable[[Wheel, np.random.Generator, int], Train]:
    return lambda wheel, rng, _: _steady(wheel, rpm, rng, ripple=[(2.0, min(0.05, 50 / rpm), rng.uniform(0, 6))])


def _start_and_stop(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
    """Cranked to 250 rpm over a compression, catches, idles, and runs out to 60 rpm."""
    speed = [(0.0, 20.0), (0.3, 250.0), (1.5, 250.0), (2.0, 900.0), (4.0, 850.0), (5.0, 60.0)]
    ripple = [(2.0, 0.06, rng.uniform(0, 2 * np.pi))]
    times = tooth_times(wheel, speed, 5.0, ripple=ripple, jitter=JITTER, tooth_error=TOOTH_ERROR, rng=rng) / 1e3
    return times, np.arange(len(times)) % wheel.pulses, 0


def _dropout(rpm: float) -> Callable[[Wheel, np.random.Generator, int], Train]:
    def make(wheel: Wheel, rng: np.random.Generator, number: int) -> Train:
        times, teeth, _ = _steady(wheel, rpm, rng, ripple=[(2.0, 0.05, rng.uniform(0, 6))])
        at = BEFORE * wheel.pulses + int(rng.integers(wheel.pulses))
        gone = np.arange(at, at + number % 40 + 1)
        return np.delete(times, gone), np.delete(teeth, gone), at + GRACE * wheel.pulses

    return make


def _kick_back(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
    """Stops, and turns back over the same teeth; nothing is judged from the stop on."""
    rest = 3.0 + rng.uniform(0.4, 0.6)
    speed = [(0.0, 300.0), (3.0, 300.0), (rest, 0.0)]
    times = tooth_times(wheel, speed, 30.0, jitter=JITTER, rng=rng) / 1e3
    back = 2e6 * rest - times[::-1]
    both = np.concatenate([times, back[back > times[-1] + 5e4][: wheel.pulses]]).astype(np.float64)
    return both, np.arange(len(both)) % wheel.pulses, len(both)


@cache
def _cases() -> dict[tuple[str, str], Callable[[Wheel, np.random.Generator, int], Train]]:
    """Return what makes the trains of each group and case."""
    made: dict[tuple[str, str], Callable[[Wheel, np.random.Generator, int], Train]] = {
        (f"order, {rpm:.0f} rpm", f"{order:g} x {100 * share:.0f} %"): _rippled(order, share, rpm)
        for rpm, shares in AMPLITUDES.items()
        for order in ORDERS
        for share in shares
    }
    made |= {("tooth error", f"{100 * k:.0f} %"): _off(k, 0.0) for k in (0.01, 0.03, 0.05)}
    made |= {("runout", f"{100 * k:.0f} %"): _off(TOOTH_ERROR, k) for k in (0.01, 0.03, 0.05)}
    made |= {("gap", f"{k:+.1f} pitch"): _gap(k) for k in (-0.4, -0.2, 0.2, 0.4)}
    made |= {("speed", f"{k:.0f} rpm"): _speed(k) for k in (50.0, 100.0, 200.0, 500.0, 2000.0, 6000.0, 12000.0)}
    made |= {("dropout 1 to 40", f"{k:.0f} rpm"): _dropout(k) for k in (300.0, 1000.0, 6000.0)}
    made[("start and stop", "20 to 900 to 60 rpm")] = _start_and_stop
    made[("kick-back", "300 rpm")] = _kick_back
    return made


@cache
def _follower(method: Method, text: str) -> Callable[[NDArray[np.float64]], Followed]:
    return follower(method, Wheel.parse(text))


def jobs(runs: int, seed: int) -> list[tuple[str, str, str, int, int]]:
    """Return the jobs of :func:`outside`, ``runs`` of each case and wheel."""
    return [(group, case, wheel, runs, seed) for group, case in _cases() for wheel in WHEELS]


def _outcomes(job: tuple[str, str, str, int, int]) -> list[Outcome]:
    """Run one case on one wheel by all methods."""
    group, case, text, runs, seed = job
    wheel, make = Wheel.parse(text), _cases()[(group, case)]
    number = list(_cases()).index((group, case))
    rows = {m: Outcome(group, case, text, m, runs, 0, 0, 0, 0.0, {}) for m in METHODS}
    for k in range(runs):
        times, teeth, first = make(wheel, np.random.default_rng([seed, number, WHEELS.index(text), k]), k)
        for method, row in rows.items():
            found = _follower(method, text)(times)
            right = found.teeth % wheel.repeats == teeth[1:] % wheel.repeats
            row.pulses += len(times)
            row.wrong += bool((found.proven & ~right)[first:].any())
            row.unsynced += float((~found.proven).sum())
            row.reports += bool(len(found.fault)) if method == "adaptive" else found.alarms > 0
            for name in {FAULTS[fault].name for fault in found.fault}:
                row.named[name] = row.named.get(name, 0) + 1
    for row in rows.values():
        row.unsynced /= max(row.pulses, 1)
    return list(rows.values())


def outside(runs: int, seed: int, progress: Progress = lambda: None) -> list[Outcome]:
    """Return an outcome for each group, case, wheel and method.

    Args:
        runs: trains of each case and wheel; 16 have all phases of a ripple, 40 all dropouts.
        seed: of all of them.
        progress: called at the end of each job.
    """
    for method in METHODS:
        _follower(method, WHEELS[0])(np.arange(100.0) * 1e3)
    return run(_outcomes, jobs(runs, seed), progress)


def summed(rows: list[Outcome]) -> Iterator[Outcome]:
    """Yield the sums of a group's cases over all wheels, a row for each case and method."""
    keys = dict.fromkeys((row.group, row.case, row.method) for row in rows)
    for group, case, method in keys:
        mine = [row for row in rows if (row.group, row.case, row.method) == (group, case, method)]
        pulses = sum(row.pulses for row in mine)
        named: dict[str, int] = {}
        for row in mine:
            for name, count in row.named.items():
                named[name] = named.get(name, 0) + count
        yield Outcome(
            group,
            case,
            "all",
            method,
            sum(row.runs for row in mine),
            pulses,
            sum(row.reports for row in mine),
            sum(row.wrong for row in mine),
            sum(row.unsynced * row.pulses for row in mine) / max(pulses, 1),
            named,
        )
