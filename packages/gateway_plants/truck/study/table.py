"""Which system isolates which fault: at four onsets, and on trucks that differ from the model.

A fault is isolated if its own fault is reported and no other's; before that the ambiguity group may be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from gateway_bench import study_pool as pool
from gateway_plants.truck.ecu.params import TruckFault, TruckParams
from gateway_plants.truck.monitor.faults import UNISOLATED
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.study import paper
from gateway_plants.truck.study.follow import calibrated, follow, inputs

#: The paper's systems, and the monitor's.
SYSTEMS = (*paper.TESTS, "RDS")
#: Faults in the monitor's order.
FAULTS = (
    "battery_short",
    "inverter_voltage",
    "machine_efficiency",
    "machine_resistance",
    "machine_voltage_sensor",
)
ONSETS = (0.0, 400.0, 840.0, 1200.0)
TRUCK = TruckParams(type="truck")
#: How a truck differs from its model, what nobody tells the monitor.
DISTURBANCES: dict[str, dict[str, float]] = {
    "none": {},
    "engine +2 %": {"engine": 1.02},
    "engine +5 %": {"engine": 1.05},
    "brakes +10 %": {"brake": 1.1},
    "mass +2 %": {"mass": 1.02},
    "mass +5 %": {"mass": 1.05},
    "wind 2 m/s": {"wind": 2.0},
    "wind 5 m/s": {"wind": 5.0},
    "slope 0.1 %": {"slope": 0.001},
    "slope 0.3 %": {"slope": 0.003},
    "slope 1 %": {"slope": 0.01},
    "hills of 1 %": {"hills": 0.01},
    "hills of 3 %": {"hills": 0.03},
    "drag +10 %": {"drag": 1.1},
}


@dataclass(frozen=True)
class Case:
    """A truck, a fault and noise.

    Attributes:
        disturbance: key of DISTURBANCES.
        fault: kind, or none.
        onset: of it [s].
        seeds: of the noise.
        healthy: seeds of healthy drives that thresholds are learned from anew, none: those of the parameters stay.
    """

    disturbance: str
    fault: str | None
    onset: float
    seeds: tuple[int, ...]
    healthy: tuple[int, ...] = ()

    @property
    def truck(self) -> TruckParams:
        """The truck."""
        return TRUCK.model_copy(update=DISTURBANCES[self.disturbance])


@dataclass(frozen=True)
class Row:
    """What a system made of a case.

    Attributes:
        system: ICDS, MCDS or RDS.
        disturbance: of the truck.
        fault: that it has, or none.
        onset: of the fault [s].
        relearned: thresholds come from healthy drives of this truck.
        runs: number of seeds.
        right: runs in which the fault was isolated; without a fault, runs in which nothing was reported.
        wrong: runs in which another fault was reported.
        delay_s: from the onset to the fault's report, median of those that were right.
        late_s: the longest.
    """

    system: str
    disturbance: str
    fault: str | None
    onset: float
    relearned: bool
    runs: int
    right: int
    wrong: int
    delay_s: float
    late_s: float


def _params(case: Case) -> tuple[Params, paper.Paper]:
    own, papers = Params(), paper.Paper()
    if not case.healthy:
        return own, papers
    drives = [inputs(case.truck, None, seed) for seed in case.healthy]
    return calibrated(own, drives), paper.calibrated(papers, drives)


def judge(case: Case) -> list[Row]:
    """Put a case through all systems."""
    fault = TruckFault(kind=case.fault, from_s=case.onset) if case.fault else None
    params, papers = _params(case)
    own = -1 if case.fault is None else FAULTS.index(case.fault)
    right = dict.fromkeys(SYSTEMS, 0)
    wrong = dict.fromkeys(SYSTEMS, 0)
    delays: dict[str, list[float]] = {system: [] for system in SYSTEMS}
    for seed in case.seeds:
        u = inputs(case.truck, fault, seed)
        told = paper.follow(u, papers).first | {"RDS": follow(u, params).first}
        for system in SYSTEMS:
            first = told[system]
            others = [t for k, t in enumerate(first) if k not in (own, UNISOLATED)]
            mistaken = bool(min(others) < inf)
            wrong[system] += mistaken
            if own < 0:
                right[system] += bool(np.isinf(first).all())
            elif first[own] < inf and not mistaken and first.min() >= case.onset:
                right[system] += 1
                delays[system].append(float(first[own]) - case.onset)
    return [
        Row(
            system=system,
            disturbance=case.disturbance,
            fault=case.fault,
            onset=case.onset,
            relearned=bool(case.healthy),
            runs=len(case.seeds),
            right=right[system],
            wrong=wrong[system],
            delay_s=float(np.median(delays[system])) if delays[system] else inf,
            late_s=max(delays[system], default=inf),
        )
        for system in SYSTEMS
    ]


def firing(seeds: int, first: int, progress: pool.Progress = lambda: None) -> list[Row]:
    """Return the faults at all onsets, and healthy drives."""
    drawn = tuple(range(first, first + seeds))
    cases = [Case("none", fault, onset, drawn) for fault in FAULTS for onset in ONSETS]
    return pool.run(judge, [Case("none", None, 0.0, drawn), *cases], progress)


def disturbed(
    names: Sequence[str],
    seeds: int,
    first: int,
    *,
    relearn: int = 0,
    progress: pool.Progress = lambda: None,
) -> list[Row]:
    """Return faults from 400 s on, and healthy drives, of trucks that differ from the model.

    Args:
        names: keys of DISTURBANCES.
        seeds: number of noises.
        first: seed.
        relearn: healthy drives of this very truck that thresholds are learned from anew; 0: they stay.
        progress: called at the end of each case.
    """
    drawn = tuple(range(first, first + seeds))
    healthy = tuple(range(first + 10_000, first + 10_000 + relearn))
    cases = [
        Case(name, fault, 0.0 if fault is None else 400.0, drawn, healthy)
        for name in names
        for fault in (None, *FAULTS)
    ]
    return pool.run(judge, cases, progress)
