"""Logarithms of likelihoods as quadratic forms, and the one operation on them.

A form (A, b) of z, shape (n,), is the function b' z - z' A z / 2. An independent N(0, q) that is added to z_k, and
integrated out, leaves with p = 1 / q

    A := A - A_k A_k' / (A_kk + p)        b := b - A_k b_k / (A_kk + p)

and a factor of the likelihood, (p / (A_kk + p))^(1/2) exp(b_k^2 / (A_kk + p) / 2). A walk, a jitter, a variable that
is not asked for (p = 0, or its prior's p) and a residual that is missing are all this. It needs no inverse of q, so
that what does not walk (q = 0) loses no digits.
"""

from __future__ import annotations

from math import inf, log

from gateway_fdi.jit import f8s, kernel


@kernel
def blur(a: f8s, b: f8s, n: int, k: int, precision: float) -> float:
    """Integrate out what is added to a variable; returns the logarithm of the factor, without log(p) / 2 for p = 0.

    Args:
        a: A, shape (n, n) at least; changed.
        b: b, shape (n,) at least; changed.
        n: variables.
        k: the variable.
        precision: p, 1 over the variance of what is added to it; 0: the variable may be anything, infinite: nothing is.
    """
    pivot = a[k, k] + precision
    if precision == inf or not pivot > 0.0:
        return 0.0
    for i in range(n):
        if i == k or a[i, k] == 0.0:
            continue
        share = a[i, k] / pivot
        b[i] -= share * b[k]
        for j in range(n):
            if j != k:
                a[i, j] -= share * a[k, j]
    gained = 0.5 * b[k] * b[k] / pivot - 0.5 * log(pivot / precision if precision > 0.0 else pivot)
    left = precision / pivot
    b[k] *= left
    for i in range(n):
        a[i, k] *= left
        if i != k:
            a[k, i] *= left
    return float(gained)
