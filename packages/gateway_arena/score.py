"""From scores to figures: threshold, detection, delay, isolation, ROC."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from gateway_arena.contract import SAMPLES, SETTLE, Array, Found, Plant, Record
from gateway_fdi.structure.isolability import isolability_of_model
from gateway_fdi.structure.model import Model

#: A fault is named if its probability is above this.
NAMED = 0.5


@dataclass(frozen=True)
class Row:
    """A method on a plant.

    Attributes:
        plant: its name.
        method: likewise.
        refused: why it cannot be used there; "": it can.
        runs: with a fault.
        detected: of these with an alarm after the fault's onset, and none before.
        early: of these with an alarm before the onset.
        delay: median from onset to alarm [samples].
        delay_s: the same [s].
        true: mean probability of the true fault at the end; 0 where nothing is detected. NaN: it names no faults.
        group: the same of all faults together that the equations cannot tell from it.
        wrong: of the detected runs those in which another fault is named at the end.
        healthy: runs without a fault.
        false: of these with an alarm.
        auc: area under the ROC curve of the largest scores, with a fault against without.
        roc: its points, shape (points, 2): false alarms, detections.
        us: CPU of a sample [us].
        missed: fault -> runs in which it is not detected.
        limit: score above which it alarms.
    """

    plant: str
    method: str
    refused: str = ""
    runs: int = 0
    detected: int = 0
    early: int = 0
    delay: float = math.nan
    delay_s: float = math.nan
    true: float = math.nan
    group: float = math.nan
    wrong: int = 0
    healthy: int = 0
    false: int = 0
    auc: float = math.nan
    roc: tuple[tuple[float, float], ...] = ()
    us: float = math.nan
    missed: tuple[tuple[str, int], ...] = ()
    limit: float = math.inf

    @classmethod
    def refused_by(cls, plant: str, method: str, why: str) -> Row:
        """Return the row of a method that cannot be used on a plant."""
        return cls(plant, method, why)


def diagnoses(model: Model, faults: Sequence[str]) -> list[list[int]]:
    """Return for each fault the places of those that the structure cannot tell from it, itself among them."""
    found = isolability_of_model(model)
    both = found.confused & found.confused.T & found.detectable & found.detectable[:, None]
    place = [found.faults.index(fault) for fault in faults]
    return [[k for k, j in enumerate(place) if i == j or both[i, j]] for i in place]


def number(value: float, digits: int = 2) -> str:
    """Return a figure as tables show it."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures as JSON has them: none is NaN."""
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in values.items()}


def threshold(largest: Array, false_alarm: float) -> float:
    """Return the score above which a method alarms.

    Args:
        largest: score of each of n healthy records, shape (n,).
        false_alarm: probability that the next healthy record is above it (at most; infinite with too few records).
    """
    rank = math.ceil((1.0 - false_alarm) * (len(largest) + 1))
    return float(np.sort(largest)[rank - 1]) if rank <= len(largest) else math.inf


def roc(without: Array, with_fault: Array) -> tuple[tuple[float, float], ...]:
    """Return points of false alarms and detections, from (0, 0) to (1, 1), for all thresholds."""
    levels = np.unique(np.concatenate([without, with_fault]))[::-1]
    points = [(float((without >= x).mean()), float((with_fault >= x).mean())) for x in levels]
    return ((0.0, 0.0), *points)


def judged(
    plant: Plant,
    method: str,
    healthy: Sequence[Record],
    faulty: Sequence[Record],
    found: Sequence[Sequence[Found]],
    false_alarm: float,
) -> Row:
    """Return the figures of a method on a plant.

    Args:
        plant: the plant.
        method: the method's name.
        healthy: records without a fault.
        faulty: records with one.
        found: what is said of the records for the threshold, of ``healthy``, and of ``faulty``.
        false_alarm: share of healthy records in which it may alarm.
    """
    validated, fine, bad = found
    limit = threshold(np.array([one.score[SETTLE:].max() for one in validated]), false_alarm)
    faults, delays, early, wrong, true, group = list(plant.sizes), [], 0, 0, [], []
    alike = diagnoses(plant.model, faults) if any(one.weights is not None for one in bad) else []
    missed = dict.fromkeys(faults, 0)
    for record, one in zip(faulty, bad, strict=True):
        alarms = np.flatnonzero(one.score[SETTLE:] > limit) + SETTLE
        before = bool((alarms < record.onset).any())
        seen = bool(len(alarms)) and not before
        early += before
        missed[record.fault] += not seen
        delays += [int(alarms[0]) - record.onset] if seen else []
        if one.weights is not None:
            weights, own = one.weights[-1], faults.index(record.fault)
            true.append(float(weights[own]) if seen else 0.0)
            group.append(float(weights[alike[own]].sum()) if seen else 0.0)
            wrong += seen and bool((np.delete(weights, own) > NAMED).any())
    middle = SAMPLES // 2
    curve = roc(
        np.array([one.score[middle:].max() for one in fine]),
        np.array([one.score[record.onset :].max() for record, one in zip(faulty, bad, strict=True)]),
    )
    delay = median(delays) if delays else math.nan
    return Row(
        plant.name, method, "", len(faulty), len(delays), early, delay, delay * plant.period_s,
        float(np.mean(true)) if true else math.nan, float(np.mean(group)) if group else math.nan, wrong, len(healthy),
        sum(bool((one.score[SETTLE:] > limit).any()) for one in fine),
        float(np.trapezoid([y for _, y in curve], [x for x, _ in curve])), curve,
        missed=tuple((fault, count) for fault, count in missed.items() if count), limit=limit,
    )  # fmt: skip
