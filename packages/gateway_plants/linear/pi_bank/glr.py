"""Faults that begin at once, told from the innovations of one observer (generalised likelihood ratio).

While an observer settles behind an actuator's fault, its estimate of another actuator moves too, and what it leaves of
the sensors looks like a sensor's fault: that is where (15) and (16) of paper 003 err. But how it settles is known. A
fault a that begins at a sample leaves the error

    G(d) a,   G(0) = [0; 1],   G(d+1) = ([[Phi, Gamma], [0, 1]] - L C) G(d)

d samples later, and adds C G(d) a to the innovation. Least squares over a window, with the innovation's covariance V,
give a for each possible beginning, and what is left of the window's energy for it (Willsky and Jones, 1976). A fault
that begins within a sample, at a share theta of it, is one of (1 - theta) a at the sample and of theta a at the next,
but for terms of the order of the sample's square; some thetas are tried. The best
beginning then stays, and a is estimated further with every sample; x + G(d) a and omega + G(d) a have no transient. As
G(d) vanishes, that becomes the observer's own estimate.

An offset b of a sensor that the observer does take leaves

    S(0) = 0,   S(d+1) = ([[Phi, Gamma], [0, 1]] - L C) S(d) + L e_j,   and adds (e_j - C S(d)) b to the innovation

(S: what the estimate is moved by). An observer that omits one sensor and still cannot explain its innovations is tested
against a jump of another sensor, as well as of the actuators (:func:`other_sensor`).
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

import numpy as np

from gateway_fdi import likelihood
from gateway_fdi.jit import Record, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy, decompose, minus, plus, solve, square
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.plant import Array, LinearPlant
from gateway_plants.linear.pi_bank.bank import BANK, MOST, MOST_INPUTS, MOST_OUTPUTS
from gateway_plants.linear.pi_bank.bank import Const as Bank
from gateway_plants.linear.pi_bank.design import Observer, augmented

#: Samples that are kept, and searched for the beginning; a power of 2.
WINDOW = 32
#: Shares of a sample at which a fault may begin.
PHASES = 4
#: Share of healthy windows that would be called not explained.
REFUSED = 1e-6


class Const(Record):
    """Constants, of each observer."""

    weighted: Annotated[f8s, BANK, PHASES, WINDOW, MOST_INPUTS, MOST_OUTPUTS] = means("(C G(d))^T V^-1")
    inverse: Annotated[f8s, BANK, PHASES, WINDOW, MOST_INPUTS, MOST_INPUTS] = means("inverse information up to d")
    inverse_v: Annotated[f8s, BANK, MOST_OUTPUTS, MOST_OUTPUTS] = means("V^-1")
    limit: Annotated[f8s, BANK, WINDOW + 1] = means("largest energy left in so many samples")
    variance: Annotated[f8s, BANK, MOST_INPUTS] = means("variance of omega, stationary")
    prior: Annotated[f8s, MOST_INPUTS] = means("information on a beforehand, diagonal")
    sensor_weighted: Annotated[f8s, BANK, WINDOW, MOST_OUTPUTS, MOST_OUTPUTS] = means("weighted, of sensors' offsets")
    sensor_inverse: Annotated[f8s, BANK, WINDOW, MOST_OUTPUTS] = means("inverse, of sensors' offsets")


class State(Record):
    """State, of each observer."""

    r: Annotated[f8s, BANK, WINDOW, MOST_OUTPUTS] = means("innovations that the present estimate leaves")
    at: i8 = means("place of the newest of them")
    kept: i8 = means("samples in the window")
    b: Annotated[f8s, WINDOW, MOST_INPUTS] = means("sums of each beginning in the window, for the observer in use")
    open: Annotated[i8s, BANK] = means("1: a fault is estimated")
    g: Annotated[f8s, BANK, MOST, MOST_INPUTS] = means("G(d)")
    j: Annotated[f8s, BANK, MOST_INPUTS, MOST_INPUTS] = means("information on a")
    h: Annotated[f8s, BANK, MOST_INPUTS] = means("information times a")
    a: Annotated[f8s, BANK, MOST_INPUTS] = means("estimate of the actuators' faults")
    sigma: Annotated[f8s, BANK, MOST_INPUTS] = means("standard deviation of the corrected omega")
    factor: Annotated[f8s, MOST_INPUTS, MOST_INPUTS] = means("scratch: j, decomposed")
    work: Annotated[f8s, MOST_INPUTS] = means("scratch")
    shown: Annotated[f8s, MOST_OUTPUTS, MOST_INPUTS] = means("scratch: C G(d)")
    next: Annotated[f8s, MOST, MOST_INPUTS] = means("scratch: G(d + 1)")
    age: Annotated[i8s, BANK] = means("samples from the beginning to the newest", "samples")
    phase: Annotated[i8s, BANK] = means("share of a sample by which it began later, in PHASES")
    left: Annotated[f8s, BANK] = means("energy that the best beginning leaves")
    gained: Annotated[f8s, BANK] = means("energy that it explains")


def prepare(c: Const, s: State, plant: LinearPlant, bank: tuple[Observer, ...], largest: np.ndarray) -> None:
    """Fill records of CONST and STATE.

    Args:
        bank: its observers.
        largest: standard deviation of each actuator's faults, beforehand; shape (m,).
    """
    n, m = plant.states, plant.inputs
    phi = augmented(plant)
    c.prior[:m] = 1.0 / largest**2
    for k, observer in enumerate(bank):
        rows, shown = observer.rows, observer.shown
        f = phi - observer.gain.gain @ shown
        weight = np.linalg.inv(observer.gain.innovation)
        c.inverse_v[k][np.ix_(rows, rows)] = weight
        c.variance[k][:m] = np.diag(observer.gain.error)[n:]
        s.sigma[k][:m] = np.sqrt(c.variance[k][:m])
        late = np.vstack([np.zeros((n, m)), np.eye(m)])
        for phase in range(PHASES):
            theta = phase / PHASES
            g, information = (1.0 - theta) * late, np.diag(c.prior[:m])
            for d in range(WINDOW):
                signature = shown @ g
                c.weighted[k][phase][d][:m, rows] = signature.T @ weight
                information = information + signature.T @ weight @ signature
                c.inverse[k][phase][d][:m, :m] = np.linalg.inv(information)
                g = f @ g + (theta * late if d == 0 else 0.0)
        _prepare_sensors(c, k, rows, f, observer.gain.gain, shown, np.asarray(weight, np.float64))
        counts = np.arange(1, WINDOW + 1)
        c.limit[k][1:] = chi2_above(REFUSED, len(rows) * counts)


def _prepare_sensors(c: Const, k: int, rows: list[int], f: Array, gain: Array, shown: Array, weight: Array) -> None:
    """Fill the signatures of the offsets of the sensors that observer k takes; shapes (n + m, p) and so on."""
    moved, information = np.zeros_like(gain), np.zeros(len(rows))
    for d in range(WINDOW):
        signature = np.eye(len(rows)) - shown @ moved
        weighted = signature.T @ weight
        c.sensor_weighted[k][d][np.ix_(rows, rows)] = weighted
        information += np.diag(weighted @ signature)
        c.sensor_inverse[k][d][rows] = 1.0 / information
        moved = f @ moved + gain


@kernel
def forget(s: State) -> None:
    """Forget the window."""
    s.kept = 0
    s.b[:, :] = 0.0


@kernel
def _show(s: State, o: Bank, k: int) -> None:
    """Compute C G of observer k."""
    for j in range(o.p):
        for i in range(o.m):
            value = 0.0
            if j != k - 1:
                for q in range(o.n):
                    value += o.c[j, q] * s.g[k, q, i]
            s.shown[j, i] = value


@kernel
def keep(s: State, o: Bank, k: int, e: f8s) -> None:
    """Keep what the present estimate leaves of observer k's innovation ``e``, at place ``at``."""
    copy(s.r[k, s.at], e[k], o.p)
    if s.open[k] == 1:
        _show(s, o, k)
        for j in range(o.p):
            s.r[k, s.at, j] = minus(s.r[k, s.at, j], s.shown[j], s.a[k], o.m)


@kernel
def energy(s: State, c: Const, o: Bank, k: int, place: int) -> float:
    """Return r^T V^-1 r of one sample of observer k."""
    return square(s.r[k, place], c.inverse_v[k], o.p)


@kernel
def likelihood_ratio(s: State, c: Const, o: Bank, k: int) -> float:
    """Take the newest sample of observer k; returns the largest log likelihood ratio of a beginning, doubled."""
    return likelihood.largest(s.b, c.weighted[k, 0], c.inverse[k, 0], s.r[k, s.at], s.at, s.kept, o.m, o.p)


@kernel
def search(s: State, c: Const, o: Bank, k: int) -> bool:
    """Find the best beginning for observer k; tells whether it explains the window.

    Sets ``age``, samples since then, 0: none is better; ``phase``, the share of a sample in quarters; and the energy
    that it leaves, ``left``, and takes, ``gained``.
    """
    total = 0.0
    for d in range(s.kept):
        total += energy(s, c, o, k, (s.at - d) % WINDOW)
    best, age, share = 0.0, 0, 0
    for back in range(1, s.kept):
        for phase in range(PHASES):
            s.work[:] = 0.0
            for d in range(back + 1):
                place = (s.at - back + d) % WINDOW
                for i in range(o.m):
                    s.work[i] = plus(s.work[i], c.weighted[k, phase, d, i], s.r[k, place], o.p)
            taken = square(s.work, c.inverse[k, phase, back], o.m)
            if taken > best:
                best, age, share = taken, back, phase
    s.phase[k] = share
    s.age[k], s.left[k], s.gained[k] = age, total - best, best
    return bool(total - best <= c.limit[k, s.kept])


@kernel
def other_sensor(s: State, c: Const, o: Bank, k: int) -> float:
    """Return the energy that a jump of one sensor more would take from observer k's window, the best of all."""
    best = 0.0
    for sensor in range(o.p):
        for back in range(s.kept):
            told = 0.0
            for d in range(back + 1):
                place = (s.at - back + d) % WINDOW
                told = plus(told, c.sensor_weighted[k, d, sensor], s.r[k, place], o.p)
            best = max(best, told * told * c.sensor_inverse[k, back, sensor])
    return best


@kernel
def merge(s: State, o: Bank, k: int, z: f8s) -> None:
    """Put the estimate of observer k into its state ``z``, and close it."""
    if s.open[k] == 1:
        for q in range(o.n + o.m):
            z[k, q] = plus(z[k, q], s.g[k, q], s.a[k], o.m)
    s.open[k] = 0


@kernel
def _onwards(s: State, o: Bank, k: int, corrected: bool) -> None:
    """Step G of observer k by one sample, which has corrected it or did not come."""
    size = o.n + o.m
    _show(s, o, k)
    for i in range(o.m):
        for q in range(size):
            value = 0.0
            for r in range(size):
                value += o.phi[q, r] * s.g[k, r, i]
            if corrected:
                for j in range(o.p):
                    value -= o.gain[k, q, j] * s.shown[j, i]
            s.next[q, i] = value
    for q in range(size):
        copy(s.g[k, q], s.next[q], o.m)


@kernel
def _learn(s: State, c: Const, o: Bank, k: int, e: f8s) -> None:
    """Take one innovation into information and estimate of observer k."""
    _show(s, o, k)
    for i in range(o.m):
        for j in range(o.p):
            weight = 0.0
            for q in range(o.p):
                weight += s.shown[q, i] * c.inverse_v[k, q, j]
            s.h[k, i] += weight * e[j]
            for q in range(o.m):
                s.j[k, i, q] += weight * s.shown[j, q]


@kernel
def begin(s: State, c: Const, o: Bank, k: int) -> None:
    """Open the fault that :func:`search` found for observer k, up to the sample before the newest."""
    s.open[k] = 1
    theta = s.phase[k] / PHASES
    for q in range(o.n + o.m):
        for i in range(o.m):
            s.g[k, q, i] = 1.0 - theta if q == o.n + i else 0.0
    for i in range(o.m):
        s.h[k, i] = s.a[k, i] = 0.0
        for q in range(o.m):
            s.j[k, i, q] = c.prior[i] if i == q else 0.0
    for d in range(s.age[k]):
        place = (s.at - s.age[k] + d) % WINDOW
        _learn(s, c, o, k, s.r[k, place])
        _onwards(s, o, k, True)
        if d == 0:
            for i in range(o.m):
                s.g[k, o.n + i, i] += theta


@kernel
def pulse(s: State, c: Const, o: Bank, k: int, z: f8s, again: bool) -> None:
    """Open, for observer k, a fault of the actuators that has lasted for the sample before, of an unknown size.

    ``again``: the one that is open has not been estimated yet: it has lasted on, with the same size.
    """
    if not again:
        merge(s, o, k, z)
    for i in range(o.m):
        for q in range(o.n + o.m):
            before = s.g[k, q, i] if again else 0.0
            s.g[k, q, i] = before + (o.gamma[q, i] if q < o.n else 0.0)
        s.h[k, i] = s.a[k, i] = 0.0
        for q in range(o.m):
            s.j[k, i, q] = c.prior[i] if i == q else 0.0
    s.open[k] = 1


@kernel
def coast(s: State, o: Bank, k: int) -> None:
    """Step observer k's open fault over a sample that did not come."""
    if s.open[k] == 1:
        _onwards(s, o, k, False)


@kernel
def learn(s: State, c: Const, o: Bank, k: int, e: f8s) -> None:
    """Estimate observer k's open fault with its newest innovation; sets ``a`` and ``sigma``."""
    copy(s.sigma[k], c.variance[k], o.m)
    if s.open[k] == 1:
        _learn(s, c, o, k, e[k])
        decompose(s.j[k], s.factor, o.m)
        solve(s.factor, s.h[k], s.a[k], o.m)
        for i in range(o.m):
            copy(s.work, s.g[k, o.n + i], o.m)
            s.sigma[k, i] += solve(s.factor, s.work, s.work, o.m)
    for i in range(o.m):
        s.sigma[k, i] = sqrt(s.sigma[k, i])


@kernel
def corrected(s: State, o: Bank, k: int, z: f8s, q: int) -> float:
    """Return entry q of observer k's state or fault, without the transient of the open fault."""
    return float(plus(z[k, q], s.g[k, q], s.a[k], o.m) if s.open[k] == 1 else z[k, q])


@kernel
def onwards(s: State, o: Bank, k: int, z: f8s) -> None:
    """Step observer k's open fault to the next sample, behind the bank's own step; closes it once it has settled."""
    if s.open[k] == 0:
        return
    _onwards(s, o, k, True)
    largest = 0.0
    for q in range(o.n + o.m):
        for i in range(o.m):
            largest = max(largest, abs(s.g[k, q, i]))
    if largest < 1e-3:
        merge(s, o, k, z)
