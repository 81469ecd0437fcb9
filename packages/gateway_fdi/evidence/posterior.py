"""Probabilities of the faults, and what is told of them.

One fault at most has begun. In a block a fault begins with probability lambda_f dt; an onset that is kept stands for
the blocks behind the one that is kept before it, w of them. So, relative to no fault,

    weight of (f, onset) = lambda_f dt w * likelihood ratio        before the start: how likely it is there

Told: ``cause`` when one fault has :data:`SURE`; ``one of`` the fewest that have :data:`ENOUGH` together, one or at most
:data:`~gateway_fdi.evidence.model.MOST`; else ``not isolated``; nothing below the threshold of
:mod:`gateway_fdi.evidence.alarm`, and as long as it may be no fault.
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Any

from gateway_fdi.evidence.hypotheses import judge
from gateway_fdi.evidence.model import MOST
from gateway_fdi.jit import i8s, kernel

#: Probability of a cause, and of "one of" together.
SURE, ENOUGH = 0.99, 0.95
NOTHING, CAUSE, ONE_OF, NOT_ISOLATED = range(4)


@kernel
def weigh(s: Any, c: Any) -> float:
    """Find the probabilities of all faults, and their likeliest onsets; returns the largest ratio of all."""
    judge(s, c)
    best, largest = 0.0, 0.0
    for f in range(c.faults):
        s.probability[f], most = 0.0, -inf
        for k in range(s.onsets):
            s.likelihood[k, f] += _before(s, c, k, f)
            best = max(best, s.likelihood[k, f])
            largest = max(largest, s.ratio[k, f])
            if s.likelihood[k, f] > most:
                most, s.chosen[f] = s.likelihood[k, f], k
    total = s.probability[c.faults] = exp(-best)
    for f in range(c.faults):
        for k in range(s.onsets):
            s.probability[f] += exp(s.likelihood[k, f] - best)
        total += s.probability[f]
    for f in range(c.faults + 1):
        s.probability[f] /= total
    return float(largest)


@kernel
def _before(s: Any, c: Any, k: int, f: int) -> float:
    """Return the logarithm of how likely a fault began in the blocks that an onset stands for."""
    if k == 0:
        return float(c.present[f])
    return float(s.entry[k] + c.rate[f] + log(float(s.onset[k] - s.onset[k - 1])))


@kernel
def _listed(s: Any, c: Any, largest: float) -> tuple[int, float]:
    """Find what may be told, a kind and its probability; its faults are left in ``s.new``."""
    for n in range(MOST):
        s.new[n] = -1
    nothing = float(s.probability[c.faults])
    if not largest > c.threshold or nothing > 1.0 - ENOUGH:
        return NOTHING, nothing
    together = 0.0
    for n in range(MOST):
        best = -1
        for f in range(c.faults):
            taken = False
            for earlier in range(n):
                taken = taken or s.new[earlier] == f
            if not taken and (best < 0 or s.probability[f] > s.probability[best]):
                best = f
        if best < 0 or c.common[best] == 0:
            break
        s.new[n] = best
        together += s.probability[best]
        if n == 0 and together >= SURE:
            return CAUSE, together
        if together >= ENOUGH:
            return ONE_OF, together
    for n in range(MOST):
        s.new[n] = -1
    return NOT_ISOLATED, 1.0 - nothing


@kernel
def tell(s: Any, c: Any, largest: float) -> bool:
    """Find what is told; returns whether that has changed. It is told once it has stood for ``c.confirm`` blocks.

    Args:
        s: record of State, after :func:`weigh`.
        c: record of Const.
        largest: ratio, as :func:`weigh` returned it.
    """
    kind, sure = _listed(s, c, largest)
    same = kind == s.found_kind and _are(s.new, s.listed)
    s.stood = s.stood + 1 if same else 1
    s.found_kind = kind
    for n in range(MOST):
        s.listed[n] = s.new[n]
    if s.stood < c.confirm:
        return False
    changed = kind != s.kind or not _are(s.named, s.listed)
    s.kind, s.sure = kind, sure
    for n in range(MOST):
        s.named[n] = s.listed[n]
    s.since = s.onset[s.chosen[s.named[0]]] if s.named[0] >= 0 else s.blocks
    return changed


@kernel
def _are(one: i8s, other: i8s) -> bool:
    """Return whether two lists have the same faults."""
    for n in range(MOST):
        here, there = one[n] < 0, other[n] < 0
        for k in range(MOST):
            here = here or one[n] == other[k]
            there = there or other[n] == one[k]
        if not (here and there):
            return False
    return True
