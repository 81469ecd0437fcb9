"""A method on a plant: fitted on records, its threshold set by others, judged by others again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from gateway_arena.contract import SAMPLES, Array, Found, Method, NotForThisPlantError, Plant, Record
from gateway_arena.score import Row, judged
from gateway_fdi.errors import InputError

#: Seeds from the first on: of records to learn from, for the threshold, without a fault; with faults to learn from, and
#: to judge.
LEARNED, VALIDATED, HEALTHY, SEEN, FAULTY = 0, 1000, 2000, 3000, 10_000


@dataclass(frozen=True)
class Records:
    """Records of a plant; no seed is in two of them.

    Attributes:
        learned: without a fault, to learn from.
        validated: without a fault, for the threshold.
        healthy: without a fault, to judge.
        seen: with each fault, to learn from.
        faulty: with each fault, to judge.
    """

    learned: tuple[Record, ...]
    validated: tuple[Record, ...]
    healthy: tuple[Record, ...]
    seen: tuple[Record, ...]
    faulty: tuple[Record, ...]


def records(plant: Plant, seed: int, *, runs: int, healthy: int, train: int, off: float, size: float = 1.0) -> Records:
    """Return a plant's records.

    Args:
        plant: the plant.
        seed: first one.
        runs: with each fault, to judge.
        healthy: for the threshold, and as many to judge.
        train: without a fault to learn from; half as many with each fault.
        off: share by which the plant's parameters differ from the model's.
        size: of the faults, in those of the plant.
    """

    def made(begin: int, count: int) -> tuple[Record, ...]:
        return tuple(plant.record(seed + begin + k, "", off) for k in range(count))

    def with_faults(begin: int, count: int) -> tuple[Record, ...]:
        drawn = enumerate(fault for fault in plant.sizes for _ in range(count))
        return tuple(plant.record(seed + begin + k, fault, off, size) for k, fault in drawn)

    return Records(
        made(LEARNED, train), made(VALIDATED, healthy), made(HEALTHY, healthy), with_faults(SEEN, (train + 1) // 2),
        with_faults(FAULTY, runs),
    )  # fmt: skip


def trial(name: str, method: Method, plant: Plant, given: Records, false_alarm: float) -> Row:
    """Return how a method does on a plant.

    Args:
        name: of the method.
        method: not fitted.
        plant: the plant.
        given: its records.
        false_alarm: share of healthy records in which it may alarm.

    Raises:
        InputError: what the method says has another shape, is no number, or depends on later samples.
    """
    try:
        if getattr(method, "supervised", False) and not given.seen:
            raise NotForThisPlantError("there are too few records with faults to learn from")
        method.fit(plant, given.learned, given.seen if getattr(method, "supervised", False) else ())
    except NotForThisPlantError as error:
        return Row.refused_by(plant.name, name, str(error))
    _look(name, method, plant, given.healthy[0])
    begun = process_time()
    found = [[_said(name, method, plant, r) for r in some] for some in (given.validated, given.healthy, given.faulty)]
    used = process_time() - begun
    row = judged(plant, name, given.healthy, given.faulty, found, false_alarm)
    return replace(row, us=1e6 * used / (SAMPLES * sum(map(len, found))))


def _said(name: str, method: Method, plant: Plant, record: Record) -> Found:
    found = method.run(record)
    shapes: list[tuple[str, Array, tuple[int, ...]]] = [("score", found.score, record.t_s.shape)]
    if found.weights is not None:
        shapes.append(("weights", found.weights, (*record.t_s.shape, len(plant.sizes))))
    for what, values, shape in shapes:
        if values.shape != shape or np.isnan(values).any():
            text = f"{what} of shape {shape} without NaN, not {values.shape}, on {plant.name}"
            raise InputError(text, key="--method", value=name)
    return found


def _look(name: str, method: Method, plant: Plant, record: Record) -> None:
    """Refuse a method that looks ahead; what it compiles at its first record is not timed."""
    whole, cut = _said(name, method, plant, record), SAMPLES // 2
    begin = _said(name, method, plant, Record(record.t_s[:cut], record.values[:cut], "", cut))
    same: Sequence[bool] = (
        np.allclose(whole.score[:cut], begin.score, rtol=1e-6, atol=1e-9),
        whole.weights is None or begin.weights is None or np.allclose(whole.weights[:cut], begin.weights, atol=1e-9),
    )
    if not all(same):
        raise InputError(f"what it says of a sample depends on later ones, on {plant.name}", key="--method", value=name)
