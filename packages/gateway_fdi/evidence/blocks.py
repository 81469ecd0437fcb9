"""Samples into the quadratic form of a block.

With Z the columns of a sample, H and the gains, each gain in the row of its residual, and W the inverses of the noise's
variances,

    A = sum Z' W Z        b = sum Z' W r

A residual that is missing has no weight. When the block is whole, the slow errors' jitter is integrated out of it.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import f8s, kernel


@kernel
def add(s: Any, c: Any, r: f8s, h: f8s, g: f8s) -> bool:
    """Take a sample; returns whether the block is whole.

    Args:
        s: record of State.
        c: record of Const.
        r: residuals, shape (residuals,); NaN: it is missing.
        h: sensitivities to the slow errors, shape (residuals, slow).
        g: gains, shape (gains,).
    """
    _weigh(s, c, r)
    _add_slow(s, c, h)
    _add_gains(s, c, g)
    s.taken += 1
    return bool(s.taken >= c.samples)


@kernel
def _weigh(s: Any, c: Any, r: f8s) -> None:
    """Find W of the residuals that are there, 0 for others, and W r."""
    for i in range(c.residuals):
        there = isfinite(r[i])
        s.there[i] = c.weight[i] if there else 0.0
        s.left[i] = c.weight[i] * r[i] if there else 0.0


@kernel
def _add_slow(s: Any, c: Any, h: f8s) -> None:
    """Take the columns of the slow errors; leaves H' W."""
    for k in range(c.slow):
        for i in range(c.residuals):
            s.weighted[k, i] = 0.0
            if s.there[i] != 0.0:
                s.weighted[k, i] = s.there[i] * h[i, k]
                s.b[k] += h[i, k] * s.left[i]
        for j in range(k + 1):
            for i in range(c.residuals):
                if s.there[i] != 0.0:
                    s.a[k, j] += s.weighted[k, i] * h[i, j]


@kernel
def _add_gains(s: Any, c: Any, g: f8s) -> None:
    """Take the columns of the gains, each in the row of its residual."""
    p = c.slow
    for k in range(c.first[c.faults]):
        row = c.row[k]
        if s.there[row] == 0.0:
            continue
        s.b[p + k] += g[k] * s.left[row]
        for j in range(p):
            s.a[p + k, j] += s.weighted[j, row] * g[k]
        for j in range(k + 1):
            if c.row[j] == row:
                s.a[p + k, p + j] += g[k] * s.there[row] * g[j]


@kernel
def close(s: Any, c: Any) -> float:
    """Make a block's form whole, its jitter integrated out; returns by how much that lessens the sum of squares."""
    n = c.slow + c.first[c.faults]
    for i in range(n):
        for j in range(i):
            s.a[j, i] = s.a[i, j]
    explained = 0.0
    for k in range(c.slow):
        explained += s.b[k] ** 2 / (s.a[k, k] + c.jitter)
        blur(s.a, s.b, n, k, c.jitter)
    return explained


@kernel
def drop(s: Any) -> None:
    """Forget the samples of a block."""
    s.b[:] = 0.0
    s.a[:, :] = 0.0
    s.taken = 0
