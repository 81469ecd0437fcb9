"""The official indexes of the DAMADICS benchmark (Syfert, Bartys, Quevedo, "Benchmark definition", v1.0, 2002)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway_arena.contract import Array, Found
from gateway_arena.score import NAMED

Bools = NDArray[np.bool_]
#: Begin of the benchmark's zone, and of the fault [s].
ON_S, FROM_S = 300, 900


#: The indexes of a scenario, in their order; NaN: there is none.
INDEXES = {
    "t_dt": "detection time, to the last leading edge [s]",
    "r_fd": "false detection rate, share of the time between begin of the zone and fault",
    "r_td": "true detection rate, share of the time with the fault",
    "fs_d": "strength of the fault at that edge",
    "t_it": "isolation time [s]",
    "r_fi": "false isolation rate",
    "r_ti": "true isolation rate",
    "r_mi": "mismatch isolation rate: other diagnoses pointed at, on average",
    "fs_i": "strength of the fault at the isolation",
    "dacc": "diagnosis accuracy, 1 over the faults that are pointed at",
}


def indexes(
    detected: Bools, primary: Bools, others: NDArray[np.int64], strength: Array, faults: NDArray[np.int64]
) -> dict[str, float]:
    """Return the indexes of a scenario, sampled each second from 0 to the zone's end.

    Args:
        detected: the detection decision, shape (n,).
        primary: whether the diagnosis with the fault is pointed at, likewise.
        others: number of other diagnoses pointed at, without the one that nothing is wrong.
        strength: of the fault.
        faults: number of faults in what is pointed at.
    """
    t_dt, r_fd, r_td, fs_d, _ = _timed(detected, strength)
    t_it, r_fi, r_ti, fs_i, edge = _timed(primary, strength)
    accuracy = 1.0 / float(faults[edge]) if edge >= 0 else math.nan
    found = (t_dt, r_fd, r_td, fs_d, t_it, r_fi, r_ti, float(others[ON_S:].mean()), fs_i, accuracy)
    return dict(zip(INDEXES, found, strict=True))


def _timed(decision: Bools, strength: Array) -> tuple[float, float, float, float, int]:
    """Return time, false rate, true rate, strength and sample of a decision's last leading edge, -1 without one."""
    false, true = float(decision[ON_S:FROM_S].mean()), float(decision[FROM_S:].mean())
    edges = FROM_S + np.flatnonzero(decision[FROM_S:] & ~decision[FROM_S - 1 : -1])
    if not len(edges):
        return math.nan, false, true, math.nan, -1
    last = int(edges[-1])
    return float(last - FROM_S), false, true, float(strength[last]), last


def decided(found: Found, limit: float, own: int, alike: Sequence[Sequence[int]], strength: Array) -> dict[str, float]:
    """Return the indexes of what a method says.

    A diagnosis is pointed at if its faults together have more than half of the probability.

    Args:
        found: by the method.
        limit: score above which it alarms.
        own: place of the fault.
        alike: of each fault the places of those in its diagnosis.
        strength: of the fault, shape (n,).
    """
    detected, n = found.score > limit, len(found.score)
    nothing = np.zeros(n, np.int64)
    if found.weights is None:
        return indexes(detected, nothing > 0, nothing, strength, nothing)
    sums = {tuple(group): found.weights[:, group].sum(1) for group in alike}
    pointed = {group: detected & (each > NAMED) for group, each in sums.items()}
    primary = pointed.pop(tuple(alike[own]))
    mine = found.weights[:, alike[own]]
    count = (mine > 0.5 * mine.max(1, keepdims=True)).sum(1)
    return indexes(detected, primary, sum(pointed.values(), nothing), strength, count)


def middle(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the median of each index over the runs that have it."""
    each = {name: [run[name] for run in runs] for name in INDEXES}
    return {name: float(np.nanmedian(v)) if not np.isnan(v).all() else math.nan for name, v in each.items()}
