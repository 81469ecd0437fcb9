"""Signals that go together: y = a x + b, y = a (x1 + c x2) + b, y = a x1 x2 + b, found in values of the same times.

A relation is claimed where the values agree, their movements do, too, and not by chance, and where what the first half
of the log says holds in the second. The relations found are a tree: each says something that no others together say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway_fleet.learn.fits import LEAST_ROWS, delay_of, fitted, movement, resolution
from gateway_fleet.learn.tails import Rate, block_maxima, limit_above, sustained

#: Different values of the signal that is explained and of those that explain it; signals that are looked at.
LEAST_VALUES, LEAST_VALUES_BY, MOST_SIGNALS = 8, 24, 240
#: Correlation of the values in a group; of two others; of two together with a third; of their movements.
SAME, ALIKE, TOGETHER, MOVES = 0.995, 0.97, 0.985, 0.9
#: Movements are above chance by this number of standard deviations; of equal ones, of the same unit, by this one:
#: chance gives no equal values. Slope and offset, of the span, of what is equal.
PROVEN, PROVEN_EQUAL, EQUAL, NO_OFFSET = 6.5, 2.5, 0.03, 0.05
#: Largest deviation from the relation, of the signal's span; and the factor, and share of the span, that one half of
#: the drive may add to the other's.
MOST_OFF, MOST_WORSE, MOST_MORE = 0.1, 3.0, 0.05
#: A row of deviations counts for a fault if it lasts this time [s].
LASTS_S = 1.0
#: How the others of a relation go together.
ONE, SUM, TIMES = "one", "sum", "product"
#: Correlation of a product with a third signal; members of a group that factors are taken of.
PRODUCT, MOST_GROUP = 0.97, 6
#: Largest share that two together leave unexplained, of that of the better one alone.
OF_ALONE = 0.5
#: The second slope of a sum is a whole number if it is as near to one as this: the difference of two wheels.
WHOLE = 0.02


@dataclass(frozen=True)
class Relation:
    """One signal by others.

    Attributes:
        of: column of the signal.
        by: columns of the others: one, or two whose sum or product counts.
        slope, offset: of = slope * by + offset.
        limit: exceeded as seldom as was asked for by deviations that last, unit of the signal.
        worst: largest deviation seen, unit of the signal.
        rows: that it was seen in.
        movement: correlation of the movements.
        form: of ONE, SUM, TIMES.
        delay_s: by which the signal follows the others; below zero: they follow it [s].
        seen: least and greatest value of the right side, as it goes together.
        slope_error: standard error of the slope.
        second: of SUM: how often the second is added to the first.
        within: least and greatest value of each of the others that was seen.
        strict: it is known to hold only there.
    """

    of: int
    by: tuple[int, ...]
    slope: float
    offset: float
    limit: float
    worst: float
    rows: int
    movement: float
    form: str = ONE
    delay_s: float = 0.0
    seen: tuple[float, float] = (-np.inf, np.inf)
    slope_error: float = 0.0
    second: float = 0.0
    within: tuple[tuple[float, float], ...] = ()
    strict: bool = False


@dataclass
class Search:
    """Values of the same times, and the relations that were found in them.

    Attributes:
        values: shape (times, signals), NaN where a signal has none.
        step_s: time between rows [s].
        rate: of false alarms that is asked for.
        units: of the signals; empty: unknown.
        every: rows from value to value of each signal; empty: each row has one.
        found: relations.
        tree: the tree that a signal belongs to.
    """

    values: NDArray[np.float64]
    step_s: float
    rate: Rate
    units: Sequence[str] = ()
    every: Sequence[int] = ()
    found: list[Relation] = field(default_factory=list)
    tree: dict[int, int] = field(default_factory=dict)

    def add(self, relations: Sequence[Relation]) -> None:
        """Add relations of signals that are not in one tree yet."""
        for relation in relations:
            mine = {self.tree.setdefault(column, column) for column in (relation.of, *relation.by)}
            if len(mine) > 1:
                self.found.append(relation)
                first = min(mine)
                self.tree = {column: first if tree in mine else tree for column, tree in self.tree.items()}

    def free(self, column: int) -> bool:
        """Return whether a signal is in no relation yet."""
        return all(column not in (each.of, *each.by) for each in self.found)


def relations(
    values: NDArray[np.float64],
    allowed: Sequence[bool],
    step_s: float = 0.05,
    rate: Rate | None = None,
    units: Sequence[str] = (),
    every: Sequence[int] = (),
) -> list[Relation]:
    """Return the relations between signals.

    Args:
        values: shape (times, signals), NaN where a signal has none.
        allowed: which signals are quantities: counters, checksums and states are not.
        step_s: time between rows [s].
        rate: of false alarms that is asked for.
        units: of the signals; empty: unknown.
        every: rows from value to value of each signal; empty: each row has one.
    """
    columns = [k for k, is_allowed in enumerate(allowed) if is_allowed and _moves(values[:, k])][:MOST_SIGNALS]
    if len(values) < LEAST_ROWS or len(columns) < 2:
        return []
    search = Search(values, step_s, rate or Rate(), units, every)
    alike = _correlation(values[:, columns])
    groups = _groups(alike)
    references = [_reference(values, columns, group, alike) for group in groups]
    for group, reference in zip(groups, references, strict=True):
        for member in (columns[k] for k in group):
            if member != reference:
                search.add(_checked(search, member, (reference,), ONE))
    for group in groups:
        _sums(search, [columns[k] for k in group][:MOST_GROUP], [k for k in columns if search.free(k)])
    for reference in references:
        _products(search, reference, [k for k in columns if search.free(k)])
    _loose(search, columns, alike)
    return search.found


def _loose(search: Search, columns: Sequence[int], alike: NDArray[np.float64]) -> None:
    """Add relations of signals that follow another less closely, or two others; they hold where they were seen."""
    order = np.argsort(-np.abs(alike - np.eye(len(alike))).max(axis=0))
    for k in order.tolist():
        if search.free(columns[k]):
            near = np.abs(alike[k]) * (np.arange(len(columns)) != k)
            best = int(near.argmax())
            if near[best] >= ALIKE:
                search.add(_checked(search, columns[k], (columns[best],), ONE, strict=True))
    for k in order.tolist():
        if search.free(columns[k]):
            pair = _best_pair(alike, k)
            if pair is not None:
                search.add(_checked(search, columns[k], (columns[pair[0]], columns[pair[1]]), SUM, strict=True))


def _best_pair(alike: NDArray[np.float64], k: int) -> tuple[int, int] | None:
    """Return the two signals whose sum is most like one; None: none is, or one of the two alone says as much."""
    own = alike[k]
    with np.errstate(invalid="ignore", divide="ignore"):
        both = (own[:, None] ** 2 + own**2 - 2.0 * own[:, None] * own * alike) / (1.0 - alike**2)
    both[np.abs(alike) > SAME] = 0.0
    both[k] = both[:, k] = 0.0
    both = np.clip(np.nan_to_num(both), 0.0, 1.0)
    first, second = divmod(int(both.argmax()), len(own))
    needed = 1.0 - both[first, second] <= OF_ALONE * (1.0 - max(own[first] ** 2, own[second] ** 2))
    if both[first, second] < TOGETHER**2 or not needed:
        return None
    return (first, second) if abs(own[first]) >= abs(own[second]) else (second, first)


def _reference(
    values: NDArray[np.float64], columns: Sequence[int], group: Sequence[int], correlation: NDArray[np.float64]
) -> int:
    """Return the column that the others of a group are held against: of those with fine steps the likest to all."""
    inner = np.abs(correlation[np.ix_(group, group)]).mean(axis=0)
    fine = [len(np.unique(values[~np.isnan(values[:, columns[k]]), columns[k]])) >= LEAST_VALUES_BY for k in group]
    return columns[group[int(np.where(fine, inner, inner - 2.0).argmax())]]


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
    return np.asarray(np.clip(np.nan_to_num(found, posinf=0.0, neginf=0.0), -1.0, 1.0), np.float64)


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


def _checked(search: Search, of: int, by: tuple[int, ...], form: str, *, strict: bool = False) -> list[Relation]:
    """Return the relation of a signal to others if it holds; ``strict``: it is not one of a group."""
    y, others, step_s = search.values[:, of], search.values[:, list(by)], search.step_s
    pace = max([1, *(search.every[column] for column in (of, *by))]) if search.every else 1
    delay = delay_of(others[:, 0], y) if form == ONE else 0
    if delay > 0:
        others, y = others[:-delay], y[delay:]
    elif delay < 0:
        others, y = others[-delay:], y[:delay]
    good = ~(np.isnan(others).any(axis=1) | np.isnan(y))
    others, y = others[good], y[good]
    if len(y) < LEAST_ROWS or np.ptp(y) == 0:
        return []
    second = _second(others, y) if form == SUM else 0.0
    x = others[:, 0] * others[:, 1] if form == TIMES else others[:, 0] + second * others[:, -1]
    if (
        np.ptp(x) == 0
        or len(np.unique(x)) < (LEAST_VALUES if form == ONE else LEAST_VALUES_BY)
        or (form == SUM and not _both_say(others, y, second, pace))
    ):
        return []
    slope, offset, error = fitted(x, y)
    off, span = y - slope * x - offset, float(np.ptp(y))
    count = max(int(LASTS_S / step_s), 1)
    # The half in which the others went farther says what holds in the other one.
    one, other = sorted((slice(None, len(x) // 2), slice(len(x) // 2, None)), key=lambda half: -np.ptp(x[half]))
    half_slope, half_offset, _ = fitted(x[one], y[one])
    learned, held = (sustained(y[half] - half_slope * x[half] - half_offset, count) for half in (one, other))
    step = resolution(y)
    if len(np.unique(x)) < LEAST_VALUES_BY and np.abs(off).max() > step:
        return []  # few values show a law only where all of them keep it
    moves, chance = movement(x, y, pace)
    units = {search.units[column] for column in (of, *by)} - {""} if search.units else set()
    equal = form == ONE and len(units) <= 1 and abs(slope - 1.0) <= EQUAL and abs(offset) <= NO_OFFSET * span
    if (
        np.quantile(np.abs(off), 0.99) > MOST_OFF * span
        or held.max() > MOST_WORSE * learned.max() + 2 * step + MOST_MORE * span
        or moves < MOVES
        or chance < (PROVEN_EQUAL if equal else PROVEN)
    ):
        return []
    lasting = sustained(off, count)
    limit = limit_above(block_maxima(lasting, count), LASTS_S, 0.25 * step, search.rate)
    within = tuple((float(each.min()), float(each.max())) for each in others.T)
    worst = max(float(np.abs(off).max()), float(held.max()))
    return [
        Relation(
            of, by, slope, offset, max(limit, float(held.max())), worst, len(x), moves, form, delay * step_s,
            (float(x.min()), float(x.max())), error, second, within, strict,
        )
    ]  # fmt: skip


def _both_say(others: NDArray[np.float64], y: NDArray[np.float64], second: float, pace: int) -> bool:
    """Return whether each of two signals says what the other does not: what is left moves as it does."""
    slope = fitted(others[:, 0] + second * others[:, 1], y)[0]
    parts = slope * others[:, 0], slope * second * others[:, 1]
    rest = y - sum(parts)
    return all(movement(part, part + rest, pace)[1] >= PROVEN for part in parts) and all(
        len(np.unique(each)) >= LEAST_VALUES_BY for each in others.T
    )


def _second(others: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return how often the second of two is added to the first, so that their sum is like a third."""
    made = np.column_stack([others, np.ones(len(y))])
    first, second, _ = np.linalg.lstsq(made, y, rcond=None)[0]
    ratio = float(second / first) if first else 0.0
    return float(round(ratio)) if round(ratio) and abs(ratio - round(ratio)) <= WHOLE * abs(ratio) else ratio


def _sums(search: Search, group: Sequence[int], others: Sequence[int]) -> None:
    """Add signals that are a sum or difference of two of a group, the best pair of each."""
    values, found = search.values, dict[int, Relation]()
    for at, one in enumerate(group):
        for other in group[at + 1 :]:
            difference = values[:, one] - values[:, other]
            if others and _moves(difference):
                _best(search, found, difference, others, (one, other), SUM)
    search.add(list(found.values()))


def _products(search: Search, one: int, others: Sequence[int]) -> None:
    """Add signals that are the product of a group's signal and another: yaw rate by speed and steering angle."""
    found: dict[int, Relation] = {}
    for other in others:
        product = search.values[:, one] * search.values[:, other]
        rest = [k for k in others if k != other]
        if rest and _moves(product):
            _best(search, found, product, rest, (one, other), TIMES)
    search.add(sorted(found.values(), key=lambda each: each.limit))  # a tree has no law backwards


def _best(
    search: Search,
    found: dict[int, Relation],
    together: NDArray[np.float64],
    others: Sequence[int],
    by: tuple[int, int],
    form: str,
) -> None:
    """Put relations of others to two signals that go together into those found, where they are better."""
    values = search.values
    alone = np.where(np.isnan(together)[:, None], np.nan, values[:, list(by)])
    alike = _correlation(np.column_stack([together, alone, values[:, others]]))[:3, 3:] ** 2
    # One of the two alone may say the same: the other hardly changes, and tomorrow it does.
    needed = 1.0 - alike[0] <= OF_ALONE * (1.0 - alike[1:].max(axis=0))
    least = TOGETHER if form == SUM else PRODUCT
    for k in np.flatnonzero((alike[0] > least**2) & needed):
        for relation in _checked(search, others[int(k)], by, form):
            best = found.get(relation.of)
            if best is None or relation.limit < best.limit:
                found[relation.of] = relation
