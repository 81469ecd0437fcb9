"""When a fault that is told has gone.

A fault that has begun explains all residuals since its onset, so that nothing of what came later can make it unlikely
by itself. So, while one is told, windows of the newest blocks are judged alone, each with the slow errors as they were
known before the onset: a window that is :data:`GONE` times as likely without the fault says that it has gone, and
everything begins again with what it says of the slow errors. In a window in which the plant does not show the fault
both are as likely: it stands.

The end of a fault is no hypothesis of its own: until a window has seen it, another fault that has begun then may
explain the residuals better, and be told.
"""

from __future__ import annotations

from math import log
from typing import Any

from gateway_fdi.evidence import hypotheses
from gateway_fdi.evidence.model import MOST
from gateway_fdi.evidence.posterior import NOTHING
from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import kernel

#: Likelihood ratio from which on a fault has gone; windows are LONGER times as long as a statement stands first.
GONE, LONGER = 20.0, 4


@kernel
def heal(s: Any, c: Any) -> bool:
    """Judge a window that is whole, and begin the next one; returns whether what is told has gone.

    Args:
        s: record of State, after :func:`gateway_fdi.evidence.posterior.tell`.
        c: record of Const.
    """
    if s.kind == NOTHING:
        s.watched = 0
        return False
    fault = s.named[0] if s.named[0] >= 0 else c.transient
    if fault < 0 or 0 < s.watched <= LONGER * c.confirm:
        return False
    if s.watched > 0 and _gone(s, c, fault):
        _begin_again(s, c)
        return True
    _open(s, c, s.chosen[fault])
    return False


@kernel
def _gone(s: Any, c: Any, fault: int) -> bool:
    """Return whether the window is likely without a fault."""
    n, last = c.slow + c.first[c.faults], s.onsets - 1
    for i in range(n):
        s.work_b[i] = s.window_b[i]
        for j in range(n):
            s.work_a[i, j] = s.window_a[i, j]
    return bool(hypotheses.alone(s, c, last, fault) < -log(GONE))


@kernel
def _open(s: Any, c: Any, k: int) -> None:
    """Begin a window: slow errors as before an onset, which have walked since."""
    n, p = c.slow + c.first[c.faults], c.slow
    for i in range(n):
        s.window_b[i] = s.born_b[k, i] if i < p else 0.0
        for j in range(n):
            s.window_a[i, j] = s.born_a[k, i, j] if max(i, j) < p else 0.0
    for i in range(p):
        blur(s.window_a, s.window_b, n, i, c.walk[i] / max(s.blocks - s.onset[k], 1))
    s.watched = 1


@kernel
def _begin_again(s: Any, c: Any) -> None:
    """Forget all onsets; the slow errors are those of the window."""
    n, p = c.slow + c.first[c.faults], c.slow
    for i in range(n):
        s.since_b[0, i] = s.window_b[i] if i < p else 0.0
        for j in range(n):
            s.since_a[0, i, j] = s.window_a[i, j] if max(i, j) < p else 0.0
    for i in range(p):
        s.born_b[0, i] = s.since_b[0, i]
        for j in range(p):
            s.born_a[0, i, j] = s.since_a[0, i, j]
    s.onsets, s.onset[0] = 1, s.blocks - 1
    s.kind, s.found_kind, s.watched, s.stood = NOTHING, NOTHING, 0, 0
    for f in range(c.faults):
        s.chosen[f], s.probability[f] = 0, 0.0
    s.probability[c.faults] = 1.0
    for k in range(MOST):
        s.named[k] = s.listed[k] = -1
