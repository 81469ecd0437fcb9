"""Monte Carlo of faults and of healthy engines: the methods side by side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from gateway_bench.study_pool import Progress, run
from gateway_plants.crank.monitor.faults import ADDED, MISSED, PULSES_LOST
from gateway_plants.crank.monitor.isolation import LOSS
from gateway_plants.crank.study.cases import Kind, Train, cranking, sweep, with_fault
from gateway_plants.crank.study.follow import METHODS, Followed, Method, follower_of, warm
from gateway_plants.crank.wheel import Wheel

WHEELS = ("60-2", "36-1", "30-2")
SPEEDS = (300.0, 1000.0, 3000.0, 6000.0, 8000.0)
RAMPS = (-3000.0, 0.0, 3000.0)
KINDS: tuple[tuple[Kind, int], ...] = tuple(product(("missed", "added"), (1, 2, 3)))
NEAR_GAP, NEAR_SPEEDS, NEAR_RAMPS = 2, (600.0, 1000.0, 3000.0, 6000.0), (-3000.0, 0.0, 3000.0)
JITTERS = (0.01, 0.02, 0.03, 0.05)
#: Labels are judged from so many pulses after the fault for so many revolutions.
GRACE, JUDGED = 4, 3
#: Healthy trains are made in pieces of so many pulses.
PIECE = 1_000_000


@dataclass
class Score:
    """What became of the faults of one kind.

    Shares of the runs: ``detected``; ``named``, direction and count right; ``labelled``, every label right
    from 4 pulses after the fault on for 3 revolutions. ``delay`` pulses from the fault's last pulse to the
    report, mean; ``at_once`` share reported at the first pulse that can show it. ``wrong``, ``unsynced`` revolutions
    after the fault with a wrong tooth, or none, mean. ``false`` reports before the fault.
    """

    group: str
    wheel: str
    kind: str
    count: int
    method: str
    runs: int
    detected: float
    named: float
    labelled: float
    delay: float
    at_once: float
    wrong: float
    unsynced: float
    false: int


@dataclass
class Alarms:
    """What became of healthy pulses: false ``alarms`` and ``wrong`` labels while synchronised."""

    case: str
    wheel: str
    jitter: float
    method: str
    pulses: int
    alarms: int
    wrong: int

    @property
    def per_million(self) -> float:
        """False alarms per million pulses."""
        return self.alarms / self.pulses * 1e6


def _groups() -> Iterator[tuple[str, list[tuple[float, float]], int | None]]:
    cells = list(product(SPEEDS, RAMPS))
    hard = [(rpm, ramp) for rpm, ramp in cells if rpm == SPEEDS[0] and ramp]
    yield "regular", [cell for cell in cells if cell not in hard], None
    yield "300 rpm, +-3000 rpm/s", hard, None
    yield "within 2 teeth of the gap", list(product(NEAR_SPEEDS, NEAR_RAMPS)), NEAR_GAP


def judge(train: Train, followed: Followed, kind: Kind, count: int, pulses: int) -> dict[str, float]:
    """Compare what a method made of a train with what was in it; values as in :class:`Score`."""
    last = train.fault + (count - 1 if kind == "added" else 0)
    after = followed.pulse >= train.fault
    fault, pulse = followed.fault[after], followed.pulse[after]
    right = {ADDED} if kind == "added" else {PULSES_LOST if count >= LOSS else MISSED}
    if kind == "missed" and count >= LOSS:
        right.add(MISSED)  # the first of a longer loss may be told apart from the rest
    counts = followed.count[after]
    begin = last + 1 + GRACE
    end = min(begin + JUDGED * pulses, len(train.times_us))
    truth, got = train.teeth[begin:end], followed.teeth[begin - 1 : end - 1]
    real = truth >= 0
    named = len(fault) > 0 and set(fault.tolist()) <= right and int(counts[-1]) == count
    return {
        "detected": len(fault) > 0,
        "named": named,
        "labelled": bool((truth == got)[real].all()),
        "delay": float(pulse[0] - last) if len(fault) else np.nan,
        "at_once": len(fault) > 0 and int(pulse[0]) <= last + (kind == "added"),
        "wrong": float((real & (got >= 0) & (truth != got)).sum()) / pulses,
        "unsynced": float((real & (got < 0)).sum()) / pulses,
        "false": int((~after).sum()),
    }


def _faults(job: tuple[str, str, Kind, int, int, int]) -> list[Score]:
    """Score all methods on one wheel, kind and count, in one group of cells."""
    group, text, kind, count, runs, seed = job
    (cells, near) = next((cells, near) for name, cells, near in _groups() if name == group)
    wheel = Wheel.parse(text)
    rows: dict[Method, list[dict[str, float]]] = {method: [] for method in METHODS}
    for rpm, ramp in cells:
        rng = np.random.default_rng(
            [
                seed,
                WHEELS.index(text),
                int(rpm),
                int(ramp) + 3000,
                KINDS.index((kind, count)),
                near or 0,
            ]
        )
        for _ in range(runs):
            train = with_fault(wheel, rpm, ramp, kind, count, rng, near_gap=near)
            for method in METHODS:
                rows[method].append(judge(train, follower_of(method, text)(train.times_us), kind, count, wheel.pulses))
    scores = []
    for method, found in rows.items():
        mean = {
            name: float(np.nanmean([row[name] for row in found]))
            if any(not np.isnan(row[name]) for row in found)
            else float("nan")
            for name in found[0]
        }
        false = sum(int(row["false"]) for row in found)
        values: dict[str, Any] = {**mean, "false": false}
        scores.append(Score(group, text, kind, count, method, len(found), **values))
    return scores


def _alarms(job: tuple[str, str, float, int, int]) -> list[Alarms]:
    """Count the false alarms of all methods on one piece of a healthy engine."""
    case, text, jitter, pulses, seed = job
    wheel = Wheel.parse(text)
    rng = np.random.default_rng([seed, WHEELS.index(text), int(jitter * 1000), case == "cranking"])
    if case == "cranking":
        times = cranking(wheel, pulses, rng)
    else:
        times = sweep(wheel, pulses, jitter, rng)
    truth = np.arange(1, len(times)) % wheel.pulses
    found = []
    for method in METHODS:
        followed = follower_of(method, text)(times)
        wrong = int((followed.proven & (followed.teeth != truth)).sum())
        count = followed.alarms if method != "adaptive" else len(followed.fault)
        found.append(Alarms(case, text, jitter, method, len(times), count, wrong))
    return found


def fault_jobs(runs: int, seed: int) -> list[tuple[str, str, Kind, int, int, int]]:
    """Return the jobs of :func:`monte_carlo`, ``runs`` a cell."""
    return [
        (group, wheel, kind, count, runs, seed)
        for (group, _, _), wheel, (kind, count) in product(_groups(), WHEELS, KINDS)
    ]


def alarm_jobs(pulses: int, seed: int) -> list[tuple[str, str, float, int, int]]:
    """Return the jobs of :func:`false_alarms`, ``pulses`` a case."""
    cases = [("sweep", wheel, jitter) for wheel, jitter in product(WHEELS, JITTERS)]
    cases += [("cranking", wheel, JITTERS[0]) for wheel in WHEELS]
    pieces = [min(PIECE, pulses - at) for at in range(0, pulses, PIECE)]
    return [(*case, piece, seed + k) for case in cases for k, piece in enumerate(pieces)]


def monte_carlo(runs: int, seed: int, progress: Progress = lambda: None) -> list[Score]:
    """Return a score for each group, wheel, kind of fault and method.

    Args:
        runs: faults a cell (a speed and a ramp).
        seed: of all of them.
        progress: called at the end of each job.
    """
    warm(METHODS)
    return run(_faults, fault_jobs(runs, seed), progress)


def false_alarms(pulses: int, seed: int, progress: Progress = lambda: None) -> list[Alarms]:
    """Return the false alarms for each healthy case, wheel and method.

    Args:
        pulses: a case.
        seed: of all of them.
        progress: called at the end of each job.
    """
    total: dict[tuple[str, str, float, str], Alarms] = {}
    warm(METHODS)
    for row in run(_alarms, alarm_jobs(pulses, seed), progress):
        key = (row.case, row.wheel, row.jitter, row.method)
        if key in total:
            sum_of = total[key]
            sum_of.pulses += row.pulses
            sum_of.alarms += row.alarms
            sum_of.wrong += row.wrong
        else:
            total[key] = row
    return list(total.values())
