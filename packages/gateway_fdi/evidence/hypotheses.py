"""Likelihood and size of each fault.

x integrated out of the form leaves (U, y) of the gains. A fault of size s multiplies its gain in residual i by
u_i = s + e_i, s ~ N(0, V), e_i ~ N(0, error^2 V): second moments of (1 + eps_i) s.

    likelihood ratio = E exp(u' y - u' U u / 2), e and s integrated out, mean over the scales V

so that a fault that the plant does not show (U -> 0) has the likelihood ratio 1: it keeps its prior.
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Any

from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import kernel

#: A size is a mixture of this number of Gaussians, of which each is FINER times as narrow as the one before: faults far
#: below their range are as likely as those that fill it.
SCALES, FINER = 3, 3.0


@kernel
def of_fault(s: Any, c: Any, f: int, largest: float) -> None:
    """Find likelihood and size of a fault, from the form in the scratch that x is integrated out of.

    Args:
        f: the fault.
        largest: standard deviation of its size beforehand, the largest of the scales.
    """
    best, total, mean = -inf, 0.0, 0.0
    for n in range(SCALES):
        value = _scaled(s, c, f, largest / FINER**n)
        fewer = exp(min(best - value, 0.0))
        best = max(best, value)
        share = exp(value - best)
        total, mean = total * fewer + share, mean * fewer + share * s.found[f]
    s.likelihood[f] = best + log(total / SCALES)
    s.found[f] = mean / total


@kernel
def _scaled(s: Any, c: Any, f: int, scale: float) -> float:
    """Return the log likelihood ratio of a fault with one scale of its size; leaves the size."""
    first = c.slow + c.first[f]
    m = c.first[f + 1] - c.first[f]
    own = scale * c.error
    precision = own**-2 if own > 0.0 else inf
    s.one_b[m] = 0.0
    for i in range(m + 1):
        s.one_a[i, m] = s.one_a[m, i] = 0.0
    for i in range(m):
        s.one_b[i] = s.work_b[first + i]
        s.one_b[m] += s.one_b[i]
        for j in range(m):
            s.one_a[i, j] = s.work_a[first + i, first + j]
            s.one_a[i, m] += s.one_a[i, j]
        s.one_a[m, i] = s.one_a[i, m]
        s.one_a[m, m] += s.one_a[i, m]
    gained = 0.0
    for i in range(m):
        gained += blur(s.one_a, s.one_b, m + 1, i, precision)
    s.found[f] = s.one_b[m] / (s.one_a[m, m] + scale**-2)
    return gained + blur(s.one_a, s.one_b, m + 1, m, scale**-2)
