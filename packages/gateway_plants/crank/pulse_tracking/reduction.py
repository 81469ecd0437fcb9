"""Reduction of hypotheses: equal ones merge, those that are far less likely than the best are pruned."""

from __future__ import annotations

from gateway_fdi.jit import kernel
from gateway_plants.crank.pulse_tracking.motion import Hypothesis
from gateway_plants.crank.pulse_tracking.tracker import COARSE, MOST, Tracker

#: Hypotheses so much less likely than the best are dropped [nat]; what was decided can be taken back until then.
MARGIN, COARSE_MARGIN = 16.0, 32.0
#: Two hypotheses with the same tooth are one when elapsed time and period differ by less than this [pitch].
ALIKE, COARSELY_ALIKE = 0.02, 0.25


@kernel
def _alike(a: Hypothesis, b: Hypothesis, tolerance: float) -> bool:
    """Tell whether two hypotheses have the same tooth and, within a tolerance [pitch of ``b``], the same motion."""
    return bool(
        b.associated == 1
        and a.associated == 1
        and a.index == b.index
        and abs(a.period - b.period) < tolerance * b.period
        and abs(a.elapsed - b.elapsed) < tolerance * b.period
    )


@kernel
def merge(tr: Tracker, made: int) -> int:
    """Put the spare hypothesis into the other bank; returns how many are there now.

    One that says the same as another merges with it: the more likely one stays. In a full bank it takes the place of
    the least likely one.
    """
    first = (1 - tr.bank) * MOST
    new = tr.spare[0]
    tolerance = COARSELY_ALIKE if tr.variance > COARSE else ALIKE
    place, greatest_cost = -1, new.cost
    for k in range(made):
        other = tr.banks[first + k]
        if _alike(other, new, tolerance):
            if new.cost < other.cost:
                tr.banks[first + k] = new
            return made
        if other.cost > greatest_cost:
            place, greatest_cost = k, other.cost
    if made < MOST:
        tr.banks[first + made] = new
        return made + 1
    if place >= 0:
        tr.banks[first + place] = new
    return made


@kernel
def prune(tr: Tracker, made: int) -> float:
    """Make the other bank current: the best first, those that are far less likely dropped; returns the best's cost."""
    tr.bank = 1 - tr.bank
    first = tr.bank * MOST
    place = 0
    for k in range(1, made):
        if tr.banks[first + k].cost < tr.banks[first + place].cost:
            place = k
    if place > 0:
        tr.spare[0] = tr.banks[first]
        tr.banks[first] = tr.banks[first + place]
        tr.banks[first + place] = tr.spare[0]
    least = tr.banks[first].cost
    margin = COARSE_MARGIN if tr.variance > COARSE else MARGIN
    kept = 0
    for k in range(made):
        h = tr.banks[first + k]
        if h.cost <= least + margin:
            if kept != k:
                tr.banks[first + kept] = h
            tr.banks[first + kept].cost -= least
            kept += 1
    tr.count = kept
    tr.took = tr.open + 1
    tr.open = tr.took if kept > 1 else 0
    return float(least)
