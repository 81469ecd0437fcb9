"""Small symmetric systems inside kernels, by Cholesky's decomposition."""

from __future__ import annotations

from math import sqrt

from gateway_fdi.jit import f8s, kernel


@kernel
def decompose(j: f8s, factor: f8s, m: int) -> None:
    """Put Cholesky's factor of the positive definite ``j`` (m x m) into ``factor``."""
    for r in range(m):
        for q in range(r + 1):
            rest = j[r, q]
            for k in range(q):
                rest -= factor[r, k] * factor[q, k]
            factor[r, q] = sqrt(rest) if r == q else rest / factor[q, q]


@kernel
def solve(factor: f8s, b: f8s, x: f8s, m: int) -> float:
    """Solve with the factor: x = J^-1 b; returns b^T J^-1 b. ``x`` may be ``b``."""
    square = 0.0
    for r in range(m):
        rest = b[r]
        for k in range(r):
            rest -= factor[r, k] * x[k]
        x[r] = rest / factor[r, r]
        square += x[r] * x[r]
    for r in range(m - 1, -1, -1):
        rest = x[r]
        for k in range(r + 1, m):
            rest -= factor[k, r] * x[k]
        x[r] = rest / factor[r, r]
    return square
