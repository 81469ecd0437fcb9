"""A healthy engine with another wheel than the configured one: what is told of each pair of wheels.

A run is :data:`TURNS` turns of the real wheel at a constant mean speed. The mismatch is *named* when ``wrong_wheel`` is
the only report of the run and comes within :data:`WITHIN` turns. Pulses that
one wheel gives with a defect and another one without are the same, and no method tells them apart: docs/crank/crank.md
has the table.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gateway_bench.study_pool import Progress, run
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.monitor.faults import FAULTS, WRONG_WHEEL
from gateway_plants.crank.study.cases import JITTER, TOOTH_ERROR
from gateway_plants.crank.study.follow import Followed, follower_of, warm
from gateway_plants.crank.wheel import Wheel

WHEELS = (
    "60-2", "36-1", "36-2", "30-2", "24-1", "24-2", "12-1", "8-1", "6-1", "12+1",
    "36-2-1", "36-2-1-1", "36-2-2-2", "4-2",
)  # fmt: skip
SPEEDS_RPM = (300.0, 1500.0, 6000.0)
#: Turns of a run, and within which the mismatch has to be named.
TURNS, WITHIN = 60, 30


@dataclass
class Outcome:
    """What was told of one wheel while another one was configured.

    Attributes:
        told: the configured wheel.
        real: the one that the pulses are of.
        rpm: mean speed.
        runs: how many.
        named: of them in which the mismatch was named, alone and in time.
        turn: the latest turn at which it was, in these.
        proven: runs in which a place was proven for more than a turn.
        reports: what else was told first, and in how many runs; "nothing" where nothing was.
    """

    told: str
    real: str
    rpm: float
    runs: int = 0
    named: int = 0
    turn: float = 0.0
    proven: int = 0
    reports: dict[str, int] = field(default_factory=dict)


def _pulses(text: str, rpm: float, rng: np.random.Generator) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the pulse times [us] of a healthy engine."""
    ripple = [(2.0, min(0.05, 40 / rpm), rng.uniform(0, 2 * np.pi))]
    wheel = Wheel.parse(text)
    seconds = TURNS * 60 / rpm
    return tooth_times(wheel, [(0, rpm)], seconds, ripple=ripple, jitter=JITTER, tooth_error=TOOTH_ERROR, rng=rng) / 1e3


def _judge(row: Outcome, found: Followed) -> None:
    """Count one run."""
    pulses = Wheel.parse(row.real).pulses
    row.runs += 1
    row.proven += bool(found.proven.sum() > pulses)
    turn = found.pulse[0] / pulses if len(found.pulse) else np.inf
    if set(found.fault.tolist()) == {WRONG_WHEEL} and turn <= WITHIN:
        row.named += 1
        row.turn = max(row.turn, float(turn))
        return
    names = " ".join(dict.fromkeys(FAULTS[k].name for k in found.fault.tolist())) or "nothing"
    row.reports[names] = row.reports.get(names, 0) + 1


def outcomes(job: tuple[str, str, int, int]) -> list[Outcome]:
    """Return an outcome for each speed.

    Args:
        job: the configured wheel, the real one, runs at each speed, seed of all of them.
    """
    told, real, runs, seed = job
    rows = []
    for number, rpm in enumerate(SPEEDS_RPM):
        row = Outcome(told, real, rpm)
        for k in range(runs):
            rng = np.random.default_rng([seed, WHEELS.index(told), WHEELS.index(real), number, k])
            _judge(row, follower_of("adaptive", told)(_pulses(real, rpm, rng)))
        rows.append(row)
    return rows


def jobs(runs: int, seed: int) -> list[tuple[str, str, int, int]]:
    """Return the jobs of :func:`pairs`: each wheel configured, each other one there."""
    return [(told, real, runs, seed) for told in WHEELS for real in WHEELS if real != told]


def pairs(runs: int, seed: int, progress: Progress = lambda: None) -> list[Outcome]:
    """Return an outcome for each pair of wheels and speed.

    Args:
        runs: of each pair at each speed.
        seed: of all of them.
        progress: called at the end of each job.
    """
    warm(("adaptive",))
    return run(outcomes, jobs(runs, seed), progress)
