"""Likelihood and size of each fault since each onset.

x integrated out of an onset's form leaves (U, y) of the gains. A fault of size s multiplies its gain in residual i by
u_i = s + e_i, s ~ N(0, V), e_i ~ N(0, error^2 V): second moments of (1 + eps_i) s. With S = (sum U, sum y) of its gains

    2 log of the largest likelihood ratio = S_y^2 / S_U                                 (gains exact)
    likelihood ratio = E exp(u' y - u' U u / 2), e and s integrated out, mean over the scales V

so that a fault that the plant does not show (U -> 0) has the likelihood ratio 1: it keeps its prior.
"""

from __future__ import annotations

from math import erfc, exp, inf, log, pi, sqrt
from typing import Any

from gateway_fdi.evidence.model import SCALES
from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import kernel

#: Standard deviations below 0 from which on the tail of a Gaussian is taken by its series.
FAR = -12.0


@kernel
def judge(s: Any, c: Any) -> None:
    """Find likelihoods, ratios and sizes of all faults since all onsets."""
    n = c.slow + c.first[c.faults]
    for k in range(s.onsets):
        for i in range(n):
            s.work_b[i] = s.since_b[k, i]
            for j in range(n):
                s.work_a[i, j] = s.since_a[k, i, j]
        for f in range(c.slow):
            blur(s.work_a, s.work_b, n, f, 0.0)
        for f in range(c.faults):
            _judge(s, c, k, f)


@kernel
def alone(s: Any, c: Any, k: int, f: int) -> float:
    """Return the log likelihood ratio of one fault, of the form that is in the scratch of an onset."""
    for i in range(c.slow):
        blur(s.work_a, s.work_b, c.slow + c.first[c.faults], i, 0.0)
    _judge(s, c, k, f)
    return float(s.likelihood[k, f])


@kernel
def _judge(s: Any, c: Any, k: int, f: int) -> None:
    """Find likelihood, ratio and size of a fault since an onset, from the form that x is integrated out of."""
    first, last = c.slow + c.first[f], c.slow + c.first[f + 1]
    product, information = 0.0, 0.0
    for i in range(first, last):
        product += s.work_b[i]
        for j in range(first, last):
            information += s.work_a[i, j]
    fits = information > 0.0 and c.common[f] == 1 and c.sign[f] * product >= 0.0
    s.ratio[k, f] = product * product / information if fits else 0.0
    best, total, mean, square = -inf, 0.0, 0.0, 0.0
    for n in range(SCALES):
        value = _scaled(s, c, k, f, c.scale[f, n])
        fewer = exp(min(best - value, 0.0))
        best = max(best, value)
        share = exp(value - best)
        total, mean, square = total * fewer, mean * fewer, square * fewer
        total += share
        mean += share * s.found[k, f]
        square += share * (s.found[k, f] ** 2 + s.spread[k, f] ** 2)
    s.likelihood[k, f] = best + log(total / SCALES)
    s.found[k, f] = mean / total
    s.spread[k, f] = sqrt(max(square / total - (mean / total) ** 2, 0.0))


@kernel
def _scaled(s: Any, c: Any, k: int, f: int, scale: float) -> float:
    """Return the log likelihood ratio of a fault with one scale of its size; leaves the size and its spread."""
    first = c.slow + c.first[f]
    m = c.first[f + 1] - c.first[f]
    own = scale if c.common[f] == 0 else scale * c.error[f]
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
    s.found[k, f] = s.spread[k, f] = 0.0
    if c.common[f] == 0:
        return gained
    pivot = s.one_a[m, m] + scale**-2
    size, spread = s.one_b[m] / pivot, 1.0 / sqrt(pivot)
    gained += blur(s.one_a, s.one_b, m + 1, m, scale**-2)
    s.found[k, f], s.spread[k, f] = size, spread
    if c.sign[f] != 0.0:
        gained += _cut(s, k, f, c.sign[f])
    return gained


@kernel
def _cut(s: Any, k: int, f: int, sign: float) -> float:
    """Cut the sizes of the other sign off; returns the logarithm of what that makes of the likelihood."""
    spread = s.spread[k, f]
    at = sign * s.found[k, f] / spread
    if at > FAR:
        below = log(0.5 * erfc(-at / sqrt(2.0)))
        slope = exp(-0.5 * at * at - below) / sqrt(2.0 * pi)
    else:
        below = -0.5 * at * at - log(-at * sqrt(2.0 * pi)) - 1.0 / (at * at)
        slope = -at - 1.0 / at
    s.found[k, f] += sign * spread * slope
    s.spread[k, f] = spread * sqrt(max(1.0 - slope * (slope + at), 0.0))
    return log(2.0) + below
