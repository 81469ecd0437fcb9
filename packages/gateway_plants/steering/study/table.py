"""Monte Carlo of a steering's faults: detection, isolation, false alarms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_bench.study_pool import Progress, run
from gateway_fdi.stopping import assured
from gateway_plants.steering.ecu.faults import Kind, SteeringFault
from gateway_plants.steering.monitor.faults import (
    ANGLES,
    CURRENT,
    DRIFT,
    ELECTRIC,
    IMPLAUSIBLE,
    INTERMITTENT,
    NOISE,
    OFFSET,
    PINION,
    SCALE,
    STUCK,
    VOLTAGE,
    WHEEL,
)
from gateway_plants.steering.monitor.params import Params
from gateway_plants.steering.study.cases import DURATION, WARM_UP, Spread
from gateway_plants.steering.study.follow import Followed, Run, follow, make

#: Detection counts within this time of the onset [s]; so does the note's.
WITHIN = 2.0
#: Onsets lie between [s].
ONSETS = (2.0, 21.5)
#: No parameter was chosen on seeds from here on.
FIRST_SEED = 100_000
#: Runs of one job.
PIECE = 10
#: What a fault of the motor's angle may be called; ambiguous names isolate nothing.
MOTOR = frozenset(range(OFFSET, IMPLAUSIBLE + 1))
VAGUE = frozenset((ANGLES, ELECTRIC))


@dataclass(frozen=True)
class Case:
    """A fault with its size, what it should be called, and what the research note's best single rule reached."""

    name: str
    kind: Kind
    size: float
    component: frozenset[int]
    called: int
    note_ms: float = float("nan")
    note_percent: float = float("nan")


def _motor(name: str, kind: Kind, size: float, called: int, ms: float, percent: float) -> Case:
    return Case(name, kind, size, MOTOR, called, ms, percent)


def _other(name: str, kind: Kind, size: float, called: int) -> Case:
    return Case(name, kind, size, frozenset((called,)), called)


CASES = (
    _motor("offset 0.1 rad", "motor_angle_offset", 0.1, OFFSET, 5, 100),
    _motor("offset 0.35 rad", "motor_angle_offset", 0.35, OFFSET, 5, 100),
    _motor("drift 0.2 rad/s", "motor_angle_drift", 0.2, DRIFT, 579, 100),
    _motor("stuck", "motor_angle_stuck", 0.0, STUCK, 66, 100),
    _motor("scale 2 %", "motor_angle_scale", 0.02, SCALE, 366, 70),
    _motor("noise 0.02 rad", "motor_angle_noise", 0.02, NOISE, 8, 100),
    _motor("intermittent 0.2 rad", "motor_angle_intermittent", 0.2, INTERMITTENT, 5, 100),
    _other("wheel offset 1 deg", "wheel_angle_offset", 1.0, WHEEL),
    _other("wheel drift 1 deg/s", "wheel_angle_drift", 1.0, WHEEL),
    _other("wheel stuck", "wheel_angle_stuck", 0.0, WHEEL),
    _other("pinion offset 1 deg", "pinion_angle_offset", 1.0, PINION),
    _other("pinion drift 1 deg/s", "pinion_angle_drift", 1.0, PINION),
    _other("pinion stuck", "pinion_angle_stuck", 0.0, PINION),
    _other("current offset 8 A", "current_offset", 8.0, CURRENT),
    _other("current gain +50 %", "current_gain", 0.5, CURRENT),
    _other("current frozen", "current_frozen", 0.0, CURRENT),
    _other("voltage offset 1 V", "voltage_offset", 1.0, VOLTAGE),
    _other("voltage -30 %", "voltage_gain", -0.3, VOLTAGE),
)

#: Parameter spread of the note, the temperature unknown; and with the winding's temperature known.
UNKNOWN, KNOWN = "unknown", "known"
SPREADS = {UNKNOWN: Spread(), KNOWN: replace(Spread(), resistance=(0.95, 1.05))}
ERRORS = {UNKNOWN: 0.35, KNOWN: 0.15}


@dataclass
class Score:
    """What the monitor made of the runs with one fault.

    ``detected``, of the runs: within 2 s; ``within_100_ms``; ``delay_ms``, ``delay_max_ms`` of those detected;
    ``isolated``: the component, and no other, was named by the end of the run, if the fault was found at all;
    ``wrong``: runs in which another was; ``kind``: share in which the first name for it was the right one;
    ``isolated_after_ms``: mean.
    """

    case: str
    temperature: str
    period_ms: float
    runs: int
    detected: float
    within_100_ms: float
    delay_ms: float
    delay_max_ms: float
    isolated: float
    isolated_after_ms: float
    wrong: int
    kind: float
    note_ms: float
    note_percent: float


@dataclass
class Health:
    """What the monitor made of healthy runs.

    ``hours`` of them; ``alarms``; ``mtfa_s``: mean time between false alarms, of which 95 % are sure; ``lost``: runs in
    which the filter's angle was off by more than 20 deg, mechanical; ``worst_deg``; ``peaks``: largest level of each
    symptom over its threshold.
    """

    temperature: str
    period_ms: float
    runs: int
    hours: float
    alarms: int
    mtfa_s: float
    lost: int
    worst_deg: float
    peaks: dict[str, float]


Job = tuple[str, str, float, int, int]


def _params(temperature: str, period: float) -> Params:
    return Params(period_ms=1e3 * period, resistance_error=ERRORS[temperature], temperature=False)


def _one(case: Case | None, temperature: str, period: float, seed: int) -> tuple[Run, float]:
    """Return a run and the onset of its fault [s]."""
    rng = np.random.default_rng([seed, 0 if case is None else 1 + CASES.index(case)])
    plant, scale = SPREADS[temperature].draw(rng)
    onset = float(rng.uniform(*ONSETS))
    faults: tuple[SteeringFault, ...] = ()
    if case is not None:
        faults = (SteeringFault(kind=case.kind, size=case.size, from_s=onset),)
    return make(plant, scale, faults, rng, period=period), onset


def judge(case: Case, followed: Followed, onset: float, period: float) -> dict[str, float]:
    """Compare what the monitor named with the fault that a run had; values as in :class:`Score`."""
    named = {int(k): (followed.first[k] + 1) * period - onset for k in np.flatnonzero(followed.first >= 0)}
    known = {k: t for k, t in named.items() if k <= ELECTRIC}
    early = min(known.values(), default=np.inf)
    exact = {k: t for k, t in known.items() if k not in VAGUE}
    right = [t for k, t in exact.items() if k in case.component]
    kinds = {k: t for k, t in exact.items() if k != IMPLAUSIBLE}
    first = min(kinds, key=kinds.__getitem__) if kinds else -1
    found = np.isfinite(early)
    return {
        "detected": float(0.0 <= early <= WITHIN),
        "within_100_ms": float(0.0 <= early <= 0.1),
        "delay_ms": 1e3 * early if 0.0 <= early <= WITHIN else np.nan,
        "isolated": float(bool(right) and len(right) == len(exact)) if found else np.nan,
        "isolated_after_ms": 1e3 * min(right) if right else np.nan,
        "wrong": float(len(right) != len(exact)),
        "kind": float(first == case.called) if kinds else np.nan,
    }


def _work(job: Job) -> list[tuple[Job, dict[str, Any]]]:
    name, temperature, period, first, count = job
    case = next((c for c in CASES if c.name == name), None)
    params = _params(temperature, period)
    found: list[tuple[Job, dict[str, Any]]] = []
    for seed in range(first, first + count):
        made, onset = _one(case, temperature, period, seed)
        followed = follow(made, params)
        if case is not None:
            found.append((job, judge(case, followed, onset, period)))
            continue
        turn = 90.0  # an electrical turn, in mechanical degrees
        error = np.degrees(followed.trace[:, 6] - made.theta)[round(WARM_UP / period) :]
        error = np.abs(error - turn * np.rint(error / turn))
        limits = np.array(params.thresholds.at(params.period_ms))
        alarms = int(((followed.found[1:] >= 0) & (followed.found[:-1] < 0)).sum())
        found.append((job, {"alarms": alarms, "worst": error.max(), "peaks": followed.peaks / limits}))
    return found


def plan(runs: int, healthy: int, seed: int) -> list[Job]:
    """Return the jobs of :func:`monte_carlo`: every fault ``runs`` times, ``healthy`` runs, and less at 2 and 5 ms."""
    found: list[Job] = []

    def add(name: str, temperature: str, period: float, count: int) -> None:
        for first in range(seed, seed + count, PIECE):
            found.append((name, temperature, period, first, min(PIECE, seed + count - first)))

    for temperature in (UNKNOWN, KNOWN):
        add("", temperature, 1e-3, healthy)
        for case in CASES:
            add(case.name, temperature, 1e-3, runs)
    for period in (2e-3, 5e-3):
        add("", UNKNOWN, period, healthy // 2)
        for case in CASES[:7]:
            add(case.name, UNKNOWN, period, runs // 2)
    return found


def _group(rows: list[tuple[Job, dict[str, Any]]]) -> Iterator[tuple[Job, list[dict[str, Any]]]]:
    groups: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for job, facts in rows:
        groups.setdefault(job[:3], []).append(facts)
    for (name, temperature, period), mine in groups.items():
        yield (name, temperature, period, 0, len(mine)), mine


def _mean(values: NDArray[np.float64]) -> float:
    return float(np.nanmean(values)) if not np.isnan(values).all() else float("nan")


def monte_carlo(jobs: list[Job], progress: Progress = lambda: None) -> tuple[list[Score], list[Health]]:
    """Return what became of the faults, and of healthy runs.

    Args:
        jobs: of :func:`plan`.
        progress: called at the end of each job.
    """
    if not jobs:
        return [], []
    _work((*jobs[0][:4], 1))  # fills the kernels' cache before several processes want it
    scores, health = [], []
    for (name, temperature, period, _, count), facts in _group(run(_work, jobs, progress)):
        case = next((c for c in CASES if c.name == name), None)
        if case is None:
            alarms = sum(f["alarms"] for f in facts)
            hours = count * (DURATION - WARM_UP) / 3600.0
            worst = np.array([f["worst"] for f in facts])
            peaks = np.max([f["peaks"] for f in facts], axis=0)
            names = list(type(Params().thresholds).model_fields)
            health.append(
                Health(
                    temperature=temperature,
                    period_ms=1e3 * period,
                    runs=count,
                    hours=hours,
                    alarms=alarms,
                    mtfa_s=assured(3600.0 * hours, alarms),
                    lost=int((worst > 20.0).sum()),
                    worst_deg=float(worst.max()),
                    peaks=dict(zip(names, map(float, peaks), strict=True)),
                )
            )
            continue
        column = {key: np.array([f[key] for f in facts]) for key in facts[0]}
        scores.append(
            Score(
                case=name,
                temperature=temperature,
                period_ms=1e3 * period,
                runs=count,
                detected=_mean(column["detected"]),
                within_100_ms=_mean(column["within_100_ms"]),
                delay_ms=_mean(column["delay_ms"]),
                delay_max_ms=float(np.nanmax(column["delay_ms"], initial=-np.inf)),
                isolated=_mean(column["isolated"]),
                isolated_after_ms=_mean(column["isolated_after_ms"]),
                wrong=int(column["wrong"].sum()),
                kind=_mean(column["kind"]),
                note_ms=case.note_ms,
                note_percent=case.note_percent,
            )
        )
    return scores, health
