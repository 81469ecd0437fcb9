"""Blocks into what is known since each onset: of the slow errors, from all blocks, and of the faults, since the onset.

Each onset that is kept has a quadratic form of (x, u), u what all gains are multiplied by if its fault began there. So
the walk of x is exact for each of them, and with u = 0 all are the same: the filter without a fault. Before the start
is an onset like the others, and always kept.

A fault begins somewhere in a block, and generators need some time until their residuals show it as the gains say. So,
where a model has a fault that moves each residual by an amount of its own, an onset's first block is that, or as
without a fault, whatever has begun: it does not say which, and no wrong fault has its name from the moment of onset.

Where there is no room for another onset the one goes that lies closest to its neighbours, compared with its age: so the
distances of those that stay grow like their age.
"""

from __future__ import annotations

from math import exp, log
from typing import Any

from gateway_fdi.evidence import blocks, hypotheses
from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import kernel

#: Probability of a fault from which on its likeliest onset is kept.
PROTECTED = 0.01


@kernel
def advance(s: Any, c: Any) -> None:
    """Take the block at hand, and forget it; a fault may have begun with it."""
    p, n = c.slow, c.slow + c.first[c.faults]
    before = s.blocks > 0
    if before:
        for k in range(s.onsets):
            for i in range(p):
                gained = blur(s.since_a[k], s.since_b[k], n, i, c.walk[i])
                s.evidence += gained if k == 0 else 0.0
        _begin(s, c, n)
    s.evidence += blocks.close(s, c)
    last = s.onsets
    if before and c.transient >= 0:
        last -= 1
        s.entry[last] = _transient(s, c, last, n)
    for k in range(last):
        for i in range(n):
            s.since_b[k, i] += s.b[i]
            for j in range(n):
                s.since_a[k, i, j] += s.a[i, j]
    if s.watched > 0:
        for i in range(p):
            blur(s.window_a, s.window_b, n, i, c.walk[i])
        for i in range(n):
            s.window_b[i] += s.b[i]
            for j in range(n):
                s.window_a[i, j] += s.a[i, j]
        s.watched += 1
    s.blocks += 1
    blocks.drop(s)


@kernel
def _transient(s: Any, c: Any, k: int, n: int) -> float:
    """Return the log likelihood ratio of a block in which any fault begins: nothing of it is seen yet, or anything."""
    for i in range(n):
        s.work_b[i] = s.since_b[k, i] + s.b[i]
        for j in range(n):
            s.work_a[i, j] = s.since_a[k, i, j] + s.a[i, j]
    seen = hypotheses.alone(s, c, k, c.transient)
    return float(max(seen, 0.0) + log(0.5 + 0.5 * exp(-abs(seen))))


@kernel
def _begin(s: Any, c: Any, n: int) -> None:
    """Keep an onset at the block at hand: x as without a fault, nothing of the gains."""
    if s.onsets == len(s.onset):
        _leave(s, n, _spare(s, c))
    k = s.onsets
    for i in range(n):
        s.since_b[k, i] = s.since_b[0, i] if i < c.slow else 0.0
        for j in range(n):
            s.since_a[k, i, j] = s.since_a[0, i, j] if max(i, j) < c.slow else 0.0
    for i in range(c.slow):
        s.born_b[k, i] = s.since_b[0, i]
        for j in range(c.slow):
            s.born_a[k, i, j] = s.since_a[0, i, j]
    s.onset[k] = s.blocks
    s.onsets = k + 1


@kernel
def _spare(s: Any, c: Any) -> int:
    """Return the onset that lies closest to its neighbours, by its age; not before the start, nor the likeliest."""
    best, least = 1, 1e300
    for k in range(1, s.onsets):
        kept = False
        for f in range(c.faults):
            kept = kept or (s.chosen[f] == k and s.probability[f] > PROTECTED)
        behind = s.onset[k + 1] if k + 1 < s.onsets else s.blocks
        gap = (behind - s.onset[k - 1]) / (s.blocks - s.onset[k])
        if not kept and gap < least:
            best, least = k, gap
    return best


@kernel
def _leave(s: Any, n: int, out: int) -> None:
    """Leave an onset out."""
    for k in range(out, s.onsets - 1):
        s.onset[k], s.entry[k] = s.onset[k + 1], s.entry[k + 1]
        for i in range(n):
            s.since_b[k, i] = s.since_b[k + 1, i]
            for j in range(n):
                s.since_a[k, i, j] = s.since_a[k + 1, i, j]
        for i in range(len(s.born_b[0])):
            s.born_b[k, i] = s.born_b[k + 1, i]
            for j in range(len(s.born_b[0])):
                s.born_a[k, i, j] = s.born_a[k + 1, i, j]
    s.onsets -= 1
    for f in range(len(s.chosen)):
        if s.chosen[f] > out:
            s.chosen[f] -= 1
