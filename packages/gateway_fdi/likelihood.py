"""Generalised likelihood ratio of a change that begins at one of the last samples (Willsky and Jones, 1976).

A change a that began d samples ago adds S(d) a to what is observed, whose noise has the covariance V. Of each beginning
in the window b = sum S^T V^-1 r is kept, and gives, with J the information up to d, the ratio

    2 log L = b^T J^-1 b

The largest is what a threshold is for. For a residual in standard deviations, of which the mean jumps, S = 1 and J = d.
"""

from __future__ import annotations

from gateway_fdi.jit import f8s, kernel
from gateway_fdi.linear_algebra import plus


@kernel
def largest(begun: f8s, weighted: f8s, inverse: f8s, newest: f8s, at: int, kept: int, m: int, p: int) -> float:
    """Take the newest sample; returns the largest log likelihood ratio of a beginning before it, doubled.

    Args:
        begun: b of each beginning, a ring whose length is a power of 2, shape (window, changes); changed.
        weighted: S(d)^T V^-1, shape (window, changes, observed).
        inverse: J^-1 at d, shape (window, changes, changes).
        newest: observed values, shape (observed,).
        at: place of the newest sample in the ring.
        kept: samples that are in the ring, with the newest.
        m: changes that are there.
        p: number of observed values.
    """
    mask = begun.shape[0] - 1
    begun[at, :] = 0.0
    best = 0.0
    for d in range(1, kept):
        place = (at - d) & mask
        square = 0.0
        for i in range(m):
            begun[place, i] = plus(begun[place, i], weighted[d, i], newest, p)
        for i in range(m):
            half = plus(0.5 * inverse[d, i, i] * begun[place, i], inverse[d, i], begun[place], i)
            square += half * begun[place, i]
        best = max(best, 2.0 * square)
    return best
