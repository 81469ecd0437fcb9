"""Signals that follow each other: y = a x + b, y = a (x1 - x2) + b, y = a x1 x2 + b, found in values of the same times.

A relation is claimed where the values agree, their movements do, too, where what the first half of the log says holds
in the second, and where the signals turn around often: two quantities that both only grow, or two slow waves, agree by
chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fleet.learn.tails import block_maxima, limit_above, sustained

#: Rows that it takes, and different values in them, of the signal that is explained and of those that explain it.
LEAST_ROWS, LEAST_VALUES, LEAST_VALUES_BY = 100, 8, 24
#: Correlation of the values, of their movements, and of a difference with a third signal.
SAME, MOVES, DIFFERENCE = 0.995, 0.9, 0.99
#: Largest deviation from the relation, of the signal's span; and the factor that the second half may add to the
#: first's.
MOST_OFF, MOST_WORSE = 0.1, 3.0
#: How often both signals must turn around, less often where they agree to their resolution; by this share of a span.
TURNS, TURNS_EXACT, TURN = 6, 4, 0.01
#: Members of a group whose differences are looked at.
MOST_GROUP = 6


#: A row of deviations counts for a fault if it lasts this time [s].
LASTS_S = 1.0
#: Delays between two signals that are looked for [rows], and by how much one must make the deviations smaller.
MOST_DELAY, BETTER = 20, 0.85
#: An offset that is no larger than this number of its standard errors, and this share of the span, is none.
NO_OFFSET, SMALL = 3.0, 0.02
#: Deviations of this number of robust standard deviations do not count for the slope; number of fits.
OUTLIER, FITS = 4.0, 3
#: How the others of a relation go together.
ONE, LESS, TIMES = "one", "difference", "product"
#: Correlation of a product with a third signal.
PRODUCT = 0.97
#: Largest share that two together leave unexplained, of that of the better one alone.
OF_ALONE = 0.5


@dataclass(frozen=True)
class Relation:
    """One signal by others.

    Attributes:
        of: column of the signal.
        by: columns of the others: one, or two whose difference or product counts.
        slope, offset: of = slope * by + offset.
        limit: exceeded once in hundreds of hours by deviations that last, unit of the signal.
        worst: largest deviation seen, unit of the signal.
        rows: that it was seen in.
        movement: correlation of the movements.
        form: of ONE, LESS, TIMES.
        delay_s: by which the signal follows the others; below zero: they follow it [s].
        seen: least and greatest value of the right side's signals, as they go together.
        slope_error: standard error of the slope.
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


def relations(values: NDArray[np.float64], allowed: Sequence[bool], step_s: float = 0.05) -> list[Relation]:
    """Return the relations between signals.

    Args:
        values: shape (times, signals), NaN where a signal has none.
        allowed: which signals are quantities: counters, checksums and states are not.
        step_s: time between rows [s].
    """
    columns = [k for k, is_allowed in enumerate(allowed) if is_allowed and _moves(values[:, k])]
    if len(values) < LEAST_ROWS or len(columns) < 2:
        return []
    correlation = _correlation(values[:, columns])
    groups = _groups(correlation)
    found: list[Relation] = []
    for group in groups:
        reference = _reference(values, columns, group, correlation)
        for member in (columns[k] for k in group):
            if member != reference:
                found += _checked(values, member, (reference,), ONE, step_s)
    taken = {relation.of for relation in found}
    for group in groups:
        members = [columns[k] for k in group][:MOST_GROUP]
        found += _differences(values, members, columns, taken, step_s)
    taken |= {relation.of for relation in found} | {by for relation in found for by in relation.by}
    for group in groups:
        reference = _reference(values, columns, group, correlation)
        found += _products(values, reference, [k for k in columns if k not in taken], step_s)
    return found


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


def _together(values: NDArray[np.float64], by: tuple[int, ...], form: str) -> NDArray[np.float64]:
    """Return the right side's signals as they go together."""
    if form == ONE:
        return values[:, by[0]]
    return values[:, by[0]] - values[:, by[1]] if form == LESS else values[:, by[0]] * values[:, by[1]]


def _checked(values: NDArray[np.float64], of: int, by: tuple[int, ...], form: str, step_s: float) -> list[Relation]:
    """Return the relation of a signal to others if it holds."""
    x, y = _together(values, by, form), values[:, of]
    delay = _delay(x, y) if form == ONE else 0
    if delay > 0:
        x, y = x[:-delay], y[delay:]
    elif delay < 0:
        x, y = x[-delay:], y[:delay]
    good = ~(np.isnan(x) | np.isnan(y))
    x, y = x[good], y[good]
    if len(x) < LEAST_ROWS or np.ptp(x) == 0 or np.ptp(y) == 0 or len(np.unique(x)) < LEAST_VALUES_BY:
        return []
    half = len(x) // 2
    slope, offset, error = _fitted(x, y)
    first = _fitted(x[:half], y[:half]) if np.ptp(x[:half]) > 0 else (slope, offset, error)
    off = y - slope * x - offset
    rows = max(int(LASTS_S / step_s), 1)
    learned = sustained(y[:half] - first[0] * x[:half] - first[1], rows)
    held = sustained(y[half:] - first[0] * x[half:] - first[1], rows)
    step = _resolution(y)
    movement = _movement(x, y)
    exact = np.abs(off).max() <= 3 * max(step, abs(slope) * _resolution(x))
    turns = min(_turns(x), _turns(y))
    if (
        np.quantile(np.abs(off), 0.99) > MOST_OFF * np.ptp(y)
        or held.max() > MOST_WORSE * learned.max() + 2 * step + 0.02 * np.ptp(y)
        or movement < MOVES
        or turns < (TURNS_EXACT if exact and form == ONE else TURNS)
    ):
        return []
    lasting = sustained(off, rows)
    limit = limit_above(block_maxima(lasting, rows), LASTS_S, 0.25 * step)
    worst = max(float(np.abs(off).max()), float(held.max()))
    seen = float(x.min()), float(x.max())
    limit, late = max(limit, float(held.max())), delay * step_s
    return [Relation(of, by, slope, offset, limit, worst, len(x), movement, form, late, seen, error)]  # fmt: skip


def _fitted(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return slope, offset and the slope's standard error: total least squares, outliers left out.

    Both signals have noise, estimated by their second differences (a course without corners has none); deviations count
    across the line in units of it (Deming's regression, ratio of the variances known). An offset that may be chance is
    none: laws of physics go through zero.
    """
    ratio = max(_noise(y), 1e-12) ** 2 / max(_noise(x), 1e-12) ** 2
    used = np.ones(len(x), np.bool_)
    slope = offset = 0.0
    for _ in range(FITS):
        a, b = x[used], y[used]
        xx, yy, xy = float(a.var()), float(b.var()), float(((a - a.mean()) * (b - b.mean())).mean())
        if xy == 0.0 or xx == 0.0:
            return 0.0, float(y.mean()), np.inf
        slope = (yy - ratio * xx + np.sqrt((yy - ratio * xx) ** 2 + 4.0 * ratio * xy**2)) / (2.0 * xy)
        offset = float(b.mean() - slope * a.mean())
        off = y - slope * x - offset
        scale = 1.4826 * float(np.median(np.abs(off - np.median(off))))
        used = np.abs(off) <= max(OUTLIER * scale, 1e-12 * np.ptp(y))
        if used.sum() < LEAST_ROWS // 2:
            used[:] = True
    off = (y - slope * x - offset)[used]
    follows = float(np.corrcoef(off[1:], off[:-1])[0, 1]) if off.std() > 0 and len(off) > 2 else 0.0
    follows = float(np.clip(np.nan_to_num(follows), 0.0, 0.999))
    free = max(len(off) * (1.0 - follows) / (1.0 + follows), 2.0)
    error = float(off.std() / (max(x[used].std(), 1e-12) * np.sqrt(free)))
    if abs(offset) <= max(NO_OFFSET * error * abs(x[used].mean()), 0.0) and abs(offset) <= SMALL * np.ptp(y):
        slope, offset = float((x[used] * y[used]).sum() / (x[used] ** 2).sum()), 0.0
    return float(slope), float(offset), error


def _noise(y: NDArray[np.float64]) -> float:
    """Return the standard deviation of a signal around its course, at least that of its rounding."""
    second = y[2:] - 2.0 * y[1:-1] + y[:-2]
    return float(max(1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0), _resolution(y) / np.sqrt(12.0)))


def _delay(x: NDArray[np.float64], y: NDArray[np.float64]) -> int:
    """Return by how many rows one signal follows another, 0 where that explains little; below 0: the other follows."""
    if len(x) < LEAST_ROWS + 2 * MOST_DELAY:
        return 0
    middle = slice(MOST_DELAY, len(x) - MOST_DELAY)
    off = {}
    for delay in range(-MOST_DELAY, MOST_DELAY + 1):
        a, b = x[MOST_DELAY - delay : len(x) - MOST_DELAY - delay], y[middle]
        good = ~(np.isnan(a) | np.isnan(b))
        if good.sum() < LEAST_ROWS:
            return 0
        a, b = a[good], b[good]
        rest = 1.0 - np.corrcoef(a, b)[0, 1] ** 2 if a.std() > 0 and b.std() > 0 else 1.0
        off[delay] = float(np.sqrt(max(rest, 0.0)))
    best = min(off, key=lambda delay: off[delay])
    return best if off[best] < BETTER * off[0] and abs(best) < MOST_DELAY else 0


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
    values: NDArray[np.float64], group: Sequence[int], columns: Sequence[int], taken: set[int], step_s: float
) -> list[Relation]:
    """Return signals that are the difference of two of a group, the best pair of each."""
    found: dict[int, Relation] = {}
    others = [k for k in columns if k not in taken and k not in group]
    for at, one in enumerate(group):
        for other in group[at + 1 :]:
            difference = values[:, one] - values[:, other]
            if _moves(difference):
                _best(found, values, difference, others, (one, other), LESS, step_s)
    return list(found.values())


def _products(values: NDArray[np.float64], one: int, others: Sequence[int], step_s: float) -> list[Relation]:
    """Return signals that are the product of a group's signal and another: yaw rate by speed and steering angle."""
    found: dict[int, Relation] = {}
    for other in others:
        product = values[:, one] * values[:, other]
        if _moves(product):
            _best(found, values, product, [k for k in others if k != other], (one, other), TIMES, step_s)
    kept: dict[int, Relation] = {}
    for relation in sorted(found.values(), key=lambda each: each.limit):
        if relation.of not in {by for each in kept.values() for by in each.by}:  # not the same law backwards
            kept[relation.of] = relation
    return list(kept.values())


def _best(
    found: dict[int, Relation],
    values: NDArray[np.float64],
    together: NDArray[np.float64],
    others: Sequence[int],
    by: tuple[int, int],
    form: str,
    step_s: float,
) -> None:
    """Put relations of others to two signals that go together into those found, where they are better."""
    if not others:
        return
    alone = np.where(np.isnan(together)[:, None], np.nan, values[:, list(by)])
    alike = _correlation(np.column_stack([together, alone, values[:, others]]))[:3, 3:] ** 2
    # One of the two alone may say the same: the other hardly changes, and tomorrow it does.
    needed = 1.0 - alike[0] <= OF_ALONE * (1.0 - alike[1:].max(axis=0))
    least = DIFFERENCE if form == LESS else PRODUCT
    for k in np.flatnonzero((alike[0] > least**2) & needed):
        for relation in _checked(values, others[int(k)], by, form, step_s):
            best = found.get(relation.of)
            if best is None or relation.limit < best.limit:
                found[relation.of] = relation
