"""Monte Carlo of faulty sensors: the voters side by side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from gateway_bench.study_pool import Progress, run
from gateway_plants.pedal.arrays import Voted
from gateway_plants.pedal.study.cases import (
    ENVIRONMENTS,
    IDEAL,
    NOISY,
    STROKES,
    TEN_BIT,
    Case,
    Environment,
    Kind,
    Run,
    make,
    oracle,
)
from gateway_plants.pedal.study.follow import VOTERS, follow

#: The paper's two points that carry numbers, and its sweeps: rate at value 10 %, value at rate 10 %.
T1, T2 = Case("impulses", 0.15, 0.10), Case("impulses", 0.10, 0.15)
SWEEP = tuple(k / 100 for k in range(5, 16))
RATES = tuple(Case("impulses", rate, 0.10) for rate in SWEEP)
VALUES = tuple(Case("impulses", 0.10, value) for value in SWEEP)
ONSETS = (0, 100, 300, 500, 650)
#: Kinds of fault that are no case of the paper's.
_OTHERS = [k for k in get_args(Kind) if k not in ("none", "impulses", "clean + impulses", "dead")]
FAULTS = (
    Case("none"),
    Case("clean + impulses"),
    T1,
    T2,
    Case("impulses", 0.05, 0.10),
    *(Case("dead", onset=onset) for onset in ONSETS),
    *(Case(kind) for kind in _OTHERS),
)
#: A fault that is off by less is not counted as accepted [V].
LARGE = 0.02
#: An output is latched when it is off by more than this for so many samples [V].
LATCH, LATCHED = 0.25, 50
#: No parameter was chosen on seeds from here on.
FIRST_SEED = 100_000
#: Runs of one job.
PIECE = 100


@dataclass
class Score:
    """What a voter made of the runs of one case in one environment.

    ``iae``: mean over the runs of the sum of its errors [V x sample], ``sd``, ``median``, ``p95`` and ``most`` of
    it; ``oracle``: that of the mean of the healthy readings. ``rejected``: share of the healthy samples that it did
    not use, ``accepted``: of the faulty ones, more than 20 mV off, that it used. Runs in which it ``latched``, held
    a healthy channel for failed (``false_isolations``), the faulty one (``isolations``), saw a ``drift``; ``delay``
    of that, mean [samples]; ``beyond``: samples of a drift in which the output is off by more than half of it.
    """

    environment: str
    stroke: str
    case: str
    rate: float
    value: float
    voter: str
    runs: int
    iae: float
    sd: float
    median: float
    p95: float
    most: float
    oracle: float
    rejected: float
    accepted: float
    latched: int
    false_isolations: int
    isolations: int
    drifts: int
    delay: float
    beyond: int


def longest(over: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], over, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def judge(run: Run, followed: Voted, channels: int, noise: float) -> dict[str, float]:
    """Compare what a voter made of a run with what was in it; values as in :class:`Score`.

    Args:
        run: what it was given.
        followed: what it made of that.
        channels: how many it was given.
        noise: of a reading [V]; five times that is allowed beyond half a drift.
    """
    error = np.abs(followed.value - run.truth)
    used = (followed.used[:, None] >> np.arange(channels)) & 1 > 0
    faulty = run.faulty[:, :channels]
    readings = run.readings[:, :channels]
    large = faulty & (np.abs(readings - run.truth[:, None]) > LARGE)
    isolated = (followed.isolated[:, None] >> np.arange(channels)) & 1 > 0
    bad = np.arange(channels) == run.bad
    seen = np.flatnonzero(followed.drift)
    half = np.abs(readings[:, run.bad] - run.truth) / 2 if run.bad >= 0 else np.full(len(error), np.inf)
    return {
        "iae": float(error.sum()),
        "rejected": float((~used[~faulty]).mean()) if (~faulty).any() else 0.0,
        "accepted": float(used[large].mean()) if large.any() else np.nan,
        "latched": longest(error > LATCH) >= LATCHED,
        "false_isolations": bool(isolated[:, ~bad].any()),
        "isolations": bool(isolated[:, bad].any()),
        "drifts": len(seen) > 0,
        "delay": float(seen[0] - run.onset) if len(seen) and run.bad >= 0 else np.nan,
        "beyond": int((error > half + 5 * noise + 0.01)[run.onset :].sum()),
    }


Job = tuple[Case, str, str, int, int]


def _work(job: Job) -> list[tuple[str, str, dict[str, float]]]:
    """Put the runs of a job through all voters; returns (key of the row, voter, what came out)."""
    case, environment_name, stroke, first, count = job
    environment = ENVIRONMENTS[environment_name]
    found = []
    for seed in range(first, first + count):
        made = make(case, environment, seed, stroke)
        best = float(np.abs(oracle(made) - made.truth).sum())
        for voter, chosen in VOTERS.items():
            facts = judge(made, follow(voter, environment, made), chosen.channels, environment.noise)
            found.append((repr((case, environment_name, stroke)), voter, {**facts, "oracle": best}))
    return found


def jobs(
    cases: tuple[Case, ...],
    environments: tuple[Environment, ...],
    stroke: str,
    runs: int,
    seed: int,
) -> list[Job]:
    """Return the jobs of :func:`monte_carlo`."""
    return [
        (case, environment.name, stroke, first, min(PIECE, seed + runs - first))
        for environment in environments
        for case in cases
        for first in range(seed, seed + runs, PIECE)
    ]


def plan(runs: int, seed: int) -> list[Job]:
    """Return the jobs of the whole study: both sweeps, all faults, and the points of the paper on other strokes."""
    every = (IDEAL, TEN_BIT, NOISY)
    sweeps = tuple(dict.fromkeys((*RATES, *VALUES)))
    cases = tuple(dict.fromkeys((*FAULTS, *sweeps)))
    found = jobs(cases, every, "exponential", runs, seed)
    unclipped = ENVIRONMENTS["ideal, unclipped"]
    found += jobs((T1, T2), (unclipped,), "exponential", runs, seed)
    for stroke in STROKES:
        if stroke != "exponential":
            found += jobs((T1, T2, Case("dead", onset=300)), every, stroke, runs, seed)
    return found


def _scores(job_list: list[Job], rows: list[tuple[str, str, dict[str, float]]]) -> Iterator[Score]:
    groups: dict[tuple[str, str], list[dict[str, float]]] = {}
    for key, voter, facts in rows:
        groups.setdefault((key, voter), []).append(facts)
    meaning = {repr(job[:3]): job for job in job_list}
    for (key, voter), found in groups.items():
        case, environment, stroke, _, _ = meaning[key]
        column = {name: np.array([row[name] for row in found], float) for name in found[0]}
        mean = {name: float(np.nanmean(v)) if not np.isnan(v).all() else float("nan") for name, v in column.items()}
        total = {name: int(np.nansum(v)) for name, v in column.items()}
        iae = column["iae"]
        yield Score(
            environment=environment,
            stroke=stroke,
            case=str(case),
            rate=case.rate,
            value=case.value,
            voter=voter,
            runs=len(found),
            iae=mean["iae"],
            sd=float(iae.std()),
            median=float(np.median(iae)),
            p95=float(np.percentile(iae, 95)),
            most=float(iae.max()),
            oracle=mean["oracle"],
            rejected=mean["rejected"],
            accepted=mean["accepted"],
            latched=total["latched"],
            false_isolations=total["false_isolations"],
            isolations=total["isolations"],
            drifts=total["drifts"],
            delay=mean["delay"],
            beyond=total["beyond"],
        )


def monte_carlo(job_list: list[Job], progress: Progress = lambda: None) -> list[Score]:
    """Return a score for each case, environment, stroke and voter.

    Args:
        job_list: of :func:`plan` or :func:`jobs`.
        progress: called at the end of each job.
    """
    if not job_list:
        return []
    _work((*job_list[0][:4], 1))  # fills the kernels' cache before several processes want it
    return list(_scores(job_list, run(_work, job_list, progress)))
