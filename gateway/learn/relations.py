"""Signals that follow each other: y = a x + b, and y = a (x1 - x2) + b, found in values of the same times.

A relation is claimed where the values agree, their movements do, too, where what the first half of the log says holds
in the second, and where the signals turn around often: two quantities that both only grow, or two slow waves, agree by
chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Rows that it takes, and different values of a signal in them.
LEAST_ROWS, LEAST_VALUES = 100, 24
#: Correlation of the values, of their movements, and of a difference with a third signal.
SAME, MOVES, DIFFERENCE = 0.995, 0.9, 0.99
#: Largest deviation from the relation, of the signal's span; and what the second half may add to the first's.
MOST_OFF, MOST_WORSE = 0.1, 3.0
#: How often both signals must turn around, less often where they agree to their resolution; by this share of a span.
TURNS, TURNS_EXACT, TURN = 6, 4, 0.01
#: Members of a group whose differences are looked at.
MOST_GROUP = 6


@dataclass(frozen=True)
class Relation:
    """One signal by others.

    Attributes:
        of: column of the signal.
        by: columns of the others, one, or two whose difference counts.
        slope, offset: of = slope * by + offset.
        worst: largest deviation seen, unit of the signal.
        rows: that it was seen in.
        movement: correlation of the movements.
    """

    of: int
    by: tuple[int, ...]
    slope: float
    offset: float
    worst: float
    rows: int
    movement: float


def relations(values: NDArray[np.float64], allowed: Sequence[bool]) -> list[Relation]:
    """Return the relations between signals.

    Args:
        values: shape (times, signals), NaN where a signal has none.
        allowed: which signals are quantities: counters, checksums and states are not.
    """
    columns = [k for k, is_allowed in enumerate(allowed) if is_allowed and _moves(values[:, k])]
    if len(values) < LEAST_ROWS or len(columns) < 2:
        return []
    correlation = _correlation(values[:, columns])
    groups = _groups(correlation)
    found: list[Relation] = []
    for group in groups:
        inner = np.abs(correlation[np.ix_(group, group)]).mean(axis=0)
        reference = columns[group[int(inner.argmax())]]
        for member in (columns[k] for k in group):
            if member != reference:
                found += _checked(values, member, (reference,))
    taken = {relation.of for relation in found}
    for group in groups:
        found += _differences(values, [columns[k] for k in group][:MOST_GROUP], columns, taken)
    return found


def _moves(column: NDArray[np.float64]) -> bool:
    good = column[~np.isnan(column)]
    return len(good) >= LEAST_ROWS and len(np.unique(good)) >= LEAST_VALUES


def _correlation(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlations of columns, each pair where both have values."""
    present = ~np.isnan(values)
    centred = np.where(present, values - np.nanmean(values, axis=0), 0.0)
    weight = present.astype(np.float64)
    both = weight.T @ weight
    one = centred.T @ weight / np.maximum(both, 1.0)  # mean of the row's signal where the column's is there
    product = centred.T @ centred / np.maximum(both, 1.0) - one * one.T
    square = np.maximum((centred**2).T @ weight / np.maximum(both, 1.0) - one**2, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = product / np.sqrt(square * square.T)
    found[both < LEAST_ROWS] = 0.0
    return np.asarray(np.nan_to_num(found), np.float64)


def _groups(correlation: NDArray[np.float64]) -> list[list[int]]:
    """Return groups of columns that follow each other, each by at least one of the group."""
    count = len(correlation)
    group = list(range(count))
    for one, other in zip(*np.nonzero(np.abs(correlation) > SAME), strict=True):
        if one < other and group[one] != group[other]:
            old, new = group[other], group[one]
            group = [new if each == old else each for each in group]
    made: dict[int, list[int]] = {}
    for k, name in enumerate(group):
        made.setdefault(name, []).append(k)
    return [members for members in made.values() if len(members) > 1]


def _checked(values: NDArray[np.float64], of: int, by: tuple[int, ...]) -> list[Relation]:
    """Return the relation of a signal to others if it holds."""
    x = values[:, by[0]] if len(by) == 1 else values[:, by[0]] - values[:, by[1]]
    y = values[:, of]
    good = ~(np.isnan(x) | np.isnan(y))
    x, y = x[good], y[good]
    if len(x) < LEAST_ROWS or np.ptp(x) == 0 or np.ptp(y) == 0:
        return []
    half = len(x) // 2
    slope, offset = np.polyfit(x, y, 1)
    first = np.polyfit(x[:half], y[:half], 1) if np.ptp(x[:half]) > 0 else (slope, offset)
    off = np.abs(y - slope * x - offset)
    learned = np.abs(y[:half] - np.polyval(first, x[:half])).max()
    held = np.abs(y[half:] - np.polyval(first, x[half:])).max()
    step = _resolution(y)
    movement = _movement(x, y)
    exact = off.max() <= 3 * max(step, abs(slope) * _resolution(x))
    turns = min(_turns(x), _turns(y))
    if (
        off.max() > MOST_OFF * np.ptp(y)
        or held > MOST_WORSE * learned + 2 * step + 0.01 * np.ptp(y)
        or movement < MOVES
        or turns < (TURNS_EXACT if exact and len(by) == 1 else TURNS)
    ):
        return []
    return [Relation(of, by, float(slope), float(offset), float(max(off.max(), held)), len(x), movement)]


def _movement(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the correlation of movements over ten rows: a shorter time is much resolution and little movement."""
    one, other = x[10:] - x[:-10], y[10:] - y[:-10]
    if one.std() == 0 or other.std() == 0:
        return 0.0
    return float(abs(np.corrcoef(one, other)[0, 1]))


def _turns(y: NDArray[np.float64]) -> int:
    """Return how often a course turns around by more than a share of its span."""
    least = TURN * np.ptp(y)
    turns, way, extreme = 0, 0, y[0]  # way: 1 up, -1 down, 0 not known yet
    for value in y:
        if way * (value - extreme) > 0:
            extreme = value
        elif abs(value - extreme) > least:
            turns, way, extreme = turns + 1, 1 if value > extreme else -1, value
    return turns


def _resolution(y: NDArray[np.float64]) -> float:
    steps = np.diff(np.unique(y))
    return float(steps.min()) if len(steps) else 0.0


def _differences(
    values: NDArray[np.float64], group: Sequence[int], columns: Sequence[int], taken: set[int]
) -> list[Relation]:
    """Return signals that are the difference of two of a group, the best pair of each."""
    found: dict[int, Relation] = {}
    others = [k for k in columns if k not in taken and k not in group]
    for at, one in enumerate(group):
        for other in group[at + 1 :]:
            difference = values[:, one] - values[:, other]
            if not _moves(difference):
                continue
            table = np.column_stack([difference, values[:, others]]) if others else difference[:, None]
            near = np.abs(_correlation(table)[0, 1:]) > DIFFERENCE
            for k in np.flatnonzero(near):
                for relation in _checked(values, others[int(k)], (one, other)):
                    best = found.get(relation.of)
                    if best is None or relation.worst < best.worst:
                        found[relation.of] = relation
    return list(found.values())
