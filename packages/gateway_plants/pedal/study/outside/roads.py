"""Pedals of another make behind roads that lose, delay and swap frames: what is said of faults, and of none.

Lags of 0 to 10 ms on either channel, noise of 0.3 to 4 mV, ADCs of 8, 10 and 12 bits where 12 are told, loss of 0 to
5 %, stamps late by exp(0 to 2 ms) with the others waiting or overtaking, 2 % swapped: each drawn at random.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway_bench.study_pool import Progress, run
from gateway_bench.wire.replay import config_of, through
from gateway_plants.pedal.study.outside import faults, sensors

#: Length of a drive with a fault [s], and of a healthy one [h].
SECONDS, HOURS = 45.0, 0.1
#: No parameter was chosen on seeds from here on.
FIRST_SEED = 5_000_000
HEALTHY = "healthy"


@dataclass(frozen=True)
class Place:
    """Where a pedal drives: lags [ms], noise [V] and bits of its sensors, and what happens to the frames."""

    lags: tuple[float, float]
    noise: float
    bits: int
    way: faults.Way

    def plant(self, rng: np.random.Generator) -> sensors.Plant:
        """Return its sensors, with small errors of gain and offset."""
        return sensors.brake(self.noise, self.lags, rng=rng, bits=self.bits)


def place(rng: np.random.Generator) -> Place:
    """Draw one."""
    way = {
        "loss": float(rng.choice([0.0, 0.002, 0.01, 0.03, 0.05])),
        "stamps_ms": float(rng.choice([0.0, 0.3, 1.0, 2.0])),
        "reorder": float(rng.choice([0.0, 0.02])),
        "overtakes": bool(rng.integers(2)),
    }
    lag = float(rng.choice([0.0, 1.5, 3.0, 5.0, 8.0, 10.0]))
    lags = (lag, 0.0) if rng.integers(2) else (0.0, lag)
    return Place(lags, float(rng.choice([0.0003, 0.002, 0.004])), int(rng.choice([8, 10, 12])), way)


@dataclass(frozen=True)
class Outcome:
    """What was said of a drive.

    Attributes:
        fault: its name, or HEALTHY.
        seed: of it.
        first: what was said first, "": nothing.
        delay: of that, after the fault's begin [s].
        visible: the fault can be seen, by the criterion of :func:`faults.visible`.
        right: the first name is one of those that are right.
        wrong: a healthy channel was named, or something was said before the fault began.
        hours: length.
    """

    fault: str
    seed: int
    first: str
    delay: float
    visible: bool
    right: bool
    wrong: bool
    hours: float


def outcome(name: str, seed: int) -> Outcome:
    """Drive with a fault, or without one, and listen."""
    if name == HEALTHY:
        where = place(np.random.default_rng(seed))
        said = faults.healthy(where.plant, HOURS, seed, way=where.way)
        first = said.set[0] if said.set else ""
        return Outcome(name, seed, first, np.nan, False, not first, bool(first), HOURS)
    where = place(np.random.default_rng([seed, list(faults.FAULTS).index(name)]))
    made = faults.drive(name, seed, plant=where.plant, seconds=SECONDS, way=where.way)
    said = through(config_of(faults.monitor(), sensors.DBC), [made.frames])
    told = [(t, fault) for t, fault, failed in said.dtcs if failed]
    at, first = told[0] if told else (np.nan, "")
    early = at < made.begin
    return Outcome(
        name,
        seed,
        first,
        at - made.begin,
        made.visible is not None,
        not early and first in faults.FAULTS[name].names,
        early or bool(faults.blamed(said)),
        SECONDS / 3600.0,
    )


def _work(job: tuple[str, int]) -> list[Outcome]:
    return [outcome(*job)]


def jobs(runs: int, hours: float, seed: int) -> list[tuple[str, int]]:
    """Return drives: ``runs`` of each fault, and healthy ones of so many hours in all."""
    found = [(name, seed + k) for name in faults.FAULTS for k in range(runs)]
    return found + [(HEALTHY, seed + k) for k in range(round(hours / HOURS))]


def drives(job_list: list[tuple[str, int]], progress: Progress = lambda: None) -> list[Outcome]:
    """Return what was said of each drive.

    Args:
        job_list: of :func:`jobs`.
        progress: called at the end of each drive.
    """
    return run(_work, job_list, progress) if job_list else []


@dataclass(frozen=True)
class Named:
    """How a fault was named, over all its drives.

    Attributes:
        fault: its name, or HEALTHY.
        runs: drives.
        right: those in which the first name was right.
        visible: those in which it can be seen.
        visible_right: those of them in which the first name was right.
        own: those of them in which the first name was one of the channel itself.
        median, longest: of the delays of right names, where it can be seen [s].
        wrong: drives in which a healthy channel was named, or something before the fault began.
        hours: length of all.
    """

    fault: str
    runs: int
    right: int
    visible: int
    visible_right: int
    own: int
    median: float
    longest: float
    wrong: int
    hours: float


def names(outcomes: list[Outcome]) -> list[Named]:
    """Return a row for each fault."""
    found = []
    for fault in dict.fromkeys(each.fault for each in outcomes):
        rows = [each for each in outcomes if each.fault == fault]
        seen = [each for each in rows if each.visible]
        delays = [each.delay for each in seen if each.right]
        found.append(
            Named(
                fault,
                len(rows),
                sum(each.right for each in rows),
                len(seen),
                len(delays),
                sum(each.right and each.first.startswith("channel_1") for each in seen),
                float(np.median(delays)) if delays else np.nan,
                max(delays, default=np.nan),
                sum(each.wrong for each in rows),
                sum(each.hours for each in rows),
            )
        )
    return found
