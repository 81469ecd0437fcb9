"""Healthy engines outside the regular sweep, dropouts, noise and wrong wheels: the methods side by side.

A run is a train of its own seed. Counted are the runs with a report (of the peers: a loss of synchronisation), and
those with a wrong tooth while synchronisation was proven; in dropouts wrong counts from two turns behind the dropout
on, and behind the last pulse of noise. That is one disturbance of 1 to 40 pulses, at any tooth or in the largest gap:

* *burst*: pulses at random times within one interval;
* *ring*: pulses at 8 to 20 kHz behind one edge, as an amplifier rings behind an ignition;
* *chatter*: one to three pulses close behind each of several teeth.

Of a *wrong wheel* the pulses of another one come than of the configured one, and each place that is proven is wrong.
Pulses that one wheel gives with a defect and another one without are the same, and no method tells them apart:
docs/crank/crank.md has the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_bench.study_pool import Progress, run
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.monitor.faults import FAULTS
from gateway_plants.crank.study.cases import JITTER, TOOTH_ERROR
from gateway_plants.crank.study.follow import METHODS, follower_of, warm
from gateway_plants.crank.wheel import Wheel

WHEELS = ("60-2", "36-1", "30-2", "24-1", "12-1", "36-2", "36-2-1", "36-2-2-2", "12+1")
ORDERS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
#: Speed [rpm] -> amplitudes of the speed's ripple.
AMPLITUDES = {250.0: (0.1, 0.2, 0.3, 0.4), 850.0: (0.04, 0.06, 0.08, 0.1, 0.12)}
#: Turns of a train, and before a dropout; what is judged begins so many turns behind it.
TURNS, BEFORE, GRACE = 40, 10, 2
#: Kinds of noise and speeds [rpm]; its most pulses, share of it that is put into the largest gap, frequency of ringing
#: [Hz].
KINDS, SPEEDS_RPM = ("burst", "ring", "chatter"), (200.0, 600.0, 1500.0, 3000.0, 8000.0)
MOST_PULSES, IN_GAP, RING_HZ = 40, 0.3, (8e3, 20e3)
#: Wheels that are taken for each other, and their speeds [rpm].
WRONG_WHEEL, MIXED_RPM = "wrong wheel", (300.0, 1500.0, 6000.0)
MIXED = (
    "60-2", "36-1", "36-2", "30-2", "24-1", "24-2", "12-1", "8-1", "6-1", "12+1",
    "36-2-1", "36-2-1-1", "36-2-2-2", "4-2",
)  # fmt: skip

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


def _extra(times: NDArray[np.float64], at: int, kind: str, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the times of noise behind pulse ``at`` [us]."""
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


def _noise(kind: str, rpm: float) -> Callable[[Wheel, np.random.Generator, int], Train]:
    def make(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
        times, teeth, _first = _speed(rpm)(wheel, rng, 0)
        at = (BEFORE + 1) * wheel.pulses - 1
        if rng.random() >= IN_GAP:
            at = BEFORE * wheel.pulses + int(rng.integers(wheel.pulses))
        extra = np.rint(_extra(times, at, kind, rng))
        times, kept = np.unique(np.concatenate([times, extra]), return_index=True)
        teeth = np.concatenate([teeth, np.full(len(extra), -1)])[kept]
        return times, teeth, int(np.searchsorted(times, extra.max()))

    return make


def _other(real: str, rpm: float) -> Callable[[Wheel, np.random.Generator, int], Train]:
    return lambda _, rng, number: _speed(rpm)(Wheel.parse(real), rng, number)


def turning_times(
    wheel: Wheel, pieces: Sequence[tuple[float, float]], rpm: float, width: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the pulses of an engine that may turn back [us], rising, and the tooth of each.

    Args:
        wheel: the wheel; the engine begins at its tooth 0.
        pieces: (acceleration [rpm/s], duration [s]), one behind the other.
        rpm: speed at the beginning.
        width: of a tooth [pitch]: turning back the sensor shows its other edge.
    """
    places = np.asarray(wheel.positions)
    found: list[tuple[float, int]] = []
    at, angle, speed = 0.0, 0.0, rpm / 60 * wheel.turn
    for change, duration in pieces:
        a = change / 60 * wheel.turn
        turn = -speed / a if a != 0.0 else -1.0
        for begin, end in ((0.0, turn), (turn, duration)) if 0.0 < turn < duration else ((0.0, duration),):
            low, high = (angle + speed * t + a * t * t / 2 for t in (begin, end))
            back = high < low
            shift = width if back else 0.0
            turns = range(int(min(low, high) // wheel.turn) - 1, int(max(low, high) // wheel.turn) + 2)
            for k in turns:
                for tooth, place in enumerate(places + k * wheel.turn + shift):
                    if not min(low, high) <= place < max(low, high):
                        continue
                    root = np.sqrt(max(speed * speed + 2 * a * (place - angle), 0.0))
                    root = -root if back else root
                    t = (root - speed) / a if abs(a) > 1e-9 else (place - angle) / speed
                    found.append((at + t, tooth))
        angle, speed, at = angle + speed * duration + a * duration**2 / 2, speed + a * duration, at + duration
    found.sort()
    return np.array([t for t, _ in found]) * 1e6, np.array([tooth for _, tooth in found], np.int64)


def _turned(wheel: Wheel, rng: np.random.Generator, pieces: Sequence[tuple[float, float]], rpm: float) -> Train:
    times, teeth = turning_times(wheel, pieces, rpm, float(rng.choice([0.0, 0.3, 0.5])))
    # Edges move by a share of a pitch, as fast as the engine turns there.
    moved = times + JITTER * rng.normal(size=len(times)) * np.minimum(np.gradient(times), 60e6 / rpm / wheel.turn)
    return np.maximum.accumulate(np.rint(moved)) + np.arange(len(times)), teeth, 0


def _stop(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
    """Runs, stops within a tenth of a second to a second, and its last compression turns it back."""
    rpm, brake = 300.0, rng.uniform(400.0, 3000.0)
    back = rng.uniform(0.3, 1.0) * brake
    turn = np.sqrt(2 * rng.uniform(0.05, 0.5) * 60 / back)
    run = 3.0 + rng.uniform(0, 0.2)
    return _turned(wheel, rng, [(0, run), (-brake, rpm / brake), (-back, turn), (2 * back, turn / 2)], rpm)


def _start(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
    """Cranks, does not come over a compression and is turned back by it, cranks on and catches."""
    rpm, brake = rng.uniform(120.0, 250.0), rng.uniform(1500.0, 6000.0)
    turn = np.sqrt(2 * rng.uniform(0.02, 0.2) * 60 / brake)
    push = rng.uniform(1000.0, 3000.0)
    again = [(push, (brake * turn + 250.0) / push), (0, 2.0), (1300.0, 0.5), (0, 1.5)]
    return _turned(wheel, rng, [(0, 2.0 + rng.uniform(0, 0.3)), (-brake, rpm / brake + turn), *again], rpm)


def _rock(wheel: Wheel, rng: np.random.Generator, _: int) -> Train:
    """Stops, rocks back and forth in the last compression, and is started again before it counts as standing."""
    rpm, brake = 300.0, rng.uniform(400.0, 3000.0)
    pieces = [(0.0, 3.0 + rng.uniform(0, 0.2)), (-brake, rpm / brake)]
    for sign in (-1, 1, -1, 1):
        reach = np.sqrt(2 * rng.uniform(0.01, 0.15) * 60 / brake)
        pieces += [(sign * brake, reach), (-sign * brake, reach)]
    return _turned(wheel, rng, [*pieces, (1500.0, 0.2), (0, 3.0)], rpm)


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
    made |= {("turned back", "at a stop"): _stop, ("turned back", "at a start"): _start}
    made[("turned back", "rocks, and starts")] = _rock
    made |= {("noise", f"{kind}, {rpm:.0f} rpm"): _noise(kind, rpm) for kind in KINDS for rpm in SPEEDS_RPM}
    made |= {(WRONG_WHEEL, f"{real}, {rpm:.0f} rpm"): _other(real, rpm) for real in MIXED for rpm in MIXED_RPM}
    return made


def jobs(runs: int, seed: int) -> list[tuple[str, str, str, int, int]]:
    """Return the jobs of :func:`outside`, ``runs`` of each case and wheel that is configured."""
    return [
        (group, case, wheel, runs, seed)
        for group, case in _cases()
        for wheel in (MIXED if group == WRONG_WHEEL else WHEELS)
        if not (group == WRONG_WHEEL and case.startswith(f"{wheel},"))
    ]


def outcomes(job: tuple[str, str, str, int, int]) -> list[Outcome]:
    """Run one case on one wheel by all methods."""
    group, case, text, runs, seed = job
    wheel, make = Wheel.parse(text), _cases()[(group, case)]
    number, wheels = list(_cases()).index((group, case)), MIXED if group == WRONG_WHEEL else WHEELS
    rows = {m: Outcome(group, case, text, m, runs, 0, 0, 0, 0.0, {}) for m in METHODS}
    for k in range(runs):
        times, teeth, first = make(wheel, np.random.default_rng([seed, number, wheels.index(text), k]), k)
        for method, row in rows.items():
            found = follower_of(method, text)(times)
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
    warm(METHODS)
    return run(outcomes, jobs(runs, seed), progress)


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
