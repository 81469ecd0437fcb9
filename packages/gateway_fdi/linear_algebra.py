"""Sums of products, and small symmetric systems by Cholesky's decomposition, inside kernels.

Sums are taken in the order of the entries, so that the same numbers give the same bits wherever a kernel is compiled.
"""

from __future__ import annotations

from math import sqrt

from gateway_fdi.jit import f8s, kernel


@kernel
def plus(total: float, a: f8s, b: f8s, n: int) -> float:
    """Return a total and the products of the first ``n`` entries of two vectors."""
    for i in range(n):
        total += a[i] * b[i]
    return total


@kernel
def minus(total: float, a: f8s, b: f8s, n: int) -> float:
    """Return a total without the products of the first ``n`` entries of two vectors."""
    for i in range(n):
        total -= a[i] * b[i]
    return total


@kernel
def dot(a: f8s, b: f8s, n: int) -> float:
    """Return the sum of the products of the first ``n`` entries of two vectors."""
    return plus(0.0, a, b, n)


@kernel
def square(x: f8s, weight: f8s, n: int) -> float:
    """Return x^T W x of the first ``n`` entries."""
    total = 0.0
    for i in range(n):
        for j in range(n):
            total += x[i] * weight[i, j] * x[j]
    return total


@kernel
def copy(target: f8s, source: f8s, n: int) -> None:
    """Copy the first ``n`` entries of a vector."""
    for i in range(n):
        target[i] = source[i]


@kernel
def add(target: f8s, share: float, source: f8s, n: int) -> None:
    """Add a multiple of the first ``n`` entries of a vector to another one."""
    for i in range(n):
        target[i] += share * source[i]


@kernel
def decompose(j: f8s, factor: f8s, m: int) -> None:
    """Put Cholesky's factor of the positive definite ``j`` (m x m) into ``factor``, which may be ``j``."""
    for r in range(m):
        for q in range(r + 1):
            rest = minus(j[r, q], factor[r], factor[q], q)
            factor[r, q] = sqrt(max(rest, 1e-300)) if r == q else rest / factor[q, q]


@kernel
def solve(factor: f8s, b: f8s, x: f8s, m: int) -> float:
    """Solve with the factor: x = J^-1 b; returns b^T J^-1 b. ``x`` may be ``b``."""
    total = 0.0
    for r in range(m):
        x[r] = minus(b[r], factor[r], x, r) / factor[r, r]
        total += x[r] * x[r]
    for r in range(m - 1, -1, -1):
        rest = x[r]
        for k in range(r + 1, m):
            rest -= factor[k, r] * x[k]
        x[r] = rest / factor[r, r]
    return total
