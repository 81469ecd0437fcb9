"""First samples of a bank: nothing is known of the plant's state; the gain is the filter's at this moment.

With its stationary gain a bank that is made for little noise would need minutes to find the state. So each observer
begins as the Kalman filter that it is in the long run, with the covariance of its error: sensor by sensor

    K = P c / (c^T P c + r),   z += K (y - c^T z),   P -= K c^T P

then z = [[Phi, Gamma], [0, 1]] z + [Gamma; 0] u, and P likewise with the noise added.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8s, i8, kernel, means
from gateway_fdi.linear_algebra import copy, dot, plus
from gateway_plants.linear.mathematics.plant import LinearPlant
from gateway_plants.linear.pi_bank.bank import BANK, MOST, MOST_OUTPUTS
from gateway_plants.linear.pi_bank.bank import Const as Bank
from gateway_plants.linear.pi_bank.design import Noise, covariances


class Const(Record):
    """Constants."""

    samples: i8 = means("samples that the start takes", "samples")
    q: Annotated[f8s, MOST] = means("variance of the noise that is added")
    r: Annotated[f8s, MOST_OUTPUTS] = means("r of each sensor")
    unknown: Annotated[f8s, MOST] = means("variance beforehand")


class State(Record):
    """State."""

    done: i8 = means("samples of the start", "samples")
    p: Annotated[f8s, BANK, MOST, MOST] = means("P of each observer")
    gain: Annotated[f8s, MOST] = means("K")
    work: Annotated[f8s, MOST, MOST] = means("scratch")
    next: Annotated[f8s, MOST] = means("scratch")


def prepare(c: Const, plant: LinearPlant, noise: Noise, samples: int, unknown: np.ndarray) -> None:
    """Fill a record of Const.

    Args:
        noise: of it.
        samples: how long the start takes.
        unknown: standard deviation of states and faults before it, shape (n + m,).
    """
    q, r = covariances(plant, noise)
    c.samples = samples
    c.q[: len(q)], c.r[: len(r)] = np.diag(q), np.diag(r)
    c.unknown[: len(unknown)] = unknown**2


@kernel
def anew(s: State, c: Const) -> None:
    """Start again."""
    s.done = 0
    s.p[:, :, :] = 0.0
    for k in range(BANK):
        for i in range(MOST):
            s.p[k, i, i] = c.unknown[i]


@kernel
def _take(s: State, o: Bank, k: int, z: f8s, j: int, y: float, r: float) -> None:
    """Correct observer k with sensor j."""
    size = o.n + o.m
    for i in range(size):
        s.gain[i] = dot(s.p[k, i], o.c[j], o.n)
    expected, spread = dot(o.c[j], z[k], o.n), plus(r, o.c[j], s.gain, o.n)
    for i in range(size):
        z[k, i] += s.gain[i] * (y - expected) / spread
    for i in range(size):
        for q in range(size):
            s.p[k, i, q] -= s.gain[i] * s.gain[q] / spread


@kernel
def _predict(s: State, c: Const, o: Bank, k: int, z: f8s, u: f8s) -> None:
    """Step observer k to the next sample."""
    size = o.n + o.m
    for i in range(size):
        value = dot(o.phi[i], z[k], size)
        s.next[i] = plus(value, o.gamma[i], u, o.m) if i < o.n else value
        for q in range(size):
            value = 0.0
            for r in range(size):
                value += o.phi[i, r] * s.p[k, r, q]
            s.work[i, q] = value
    copy(z[k], s.next, size)
    for i in range(size):
        for q in range(size):
            s.p[k, i, q] = plus(c.q[i] if i == q else 0.0, s.work[i], o.phi[q], size)


@kernel
def step(s: State, c: Const, o: Bank, z: f8s, y: f8s, u: f8s) -> bool:
    """Take one sample with the whole bank; tells whether the start is over."""
    for k in range(o.p + 1):
        for j in range(o.p):
            if j != k - 1:
                _take(s, o, k, z, j, y[j], c.r[j])
        _predict(s, c, o, k, z, u)
    s.done += 1
    return bool(s.done >= c.samples)


@kernel
def missing(s: State, c: Const, o: Bank, z: f8s, u: f8s) -> None:
    """Step over a sample that did not come."""
    for k in range(o.p + 1):
        _predict(s, c, o, k, z, u)


@kernel
def unknown_command(s: State, c: Const, o: Bank) -> None:
    """Say that the command of the sample before is not known: it may be off by what a fault may be."""
    for k in range(o.p + 1):
        for i in range(o.n):
            for j in range(o.n):
                for r in range(o.m):
                    s.p[k, i, j] += o.gamma[i, r] * o.gamma[j, r] * c.unknown[o.n + r]
