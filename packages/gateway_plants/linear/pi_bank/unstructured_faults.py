"""Actuators that do anything: what a drift, a gain, a stuck actuator makes of the innovations, which no jump explains.

Two kinds of filter run beside the bank, of the sensors that the observer in use takes. Actuators that are *free* may
have any fault at each sample anew (an unknown input; standard deviation :data:`ANY` thresholds a sample):

    0        all actuators are free. What it does not explain no fault of actuators explains, whatever its course:
             only then a sensor is named. It has p - m relations a sample left, Theorem 1's.
    i >= 1   all but actuator i are free, which has the bank's slow fault. What it explains does not ask for a fault of
             actuator i, and its estimate of that fault is not moved by any course of the others': so i is named only
             where its own estimate counts, or points there and this filter is refuted.

A filter is refuted where the energy of its last 1, 2, ... samples is beyond what chance makes of it.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy, square
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.gains import Gain, from_noise
from gateway_plants.linear.mathematics.plant import LinearPlant
from gateway_plants.linear.pi_bank import bank
from gateway_plants.linear.pi_bank.bank import BANK, MOST, MOST_INPUTS, MOST_OUTPUTS
from gateway_plants.linear.pi_bank.design import Noise, Observer, augmented, covariances
from gateway_plants.linear.pi_bank.glr import REFUSED, WINDOW

#: Filters.
FREE = MOST_INPUTS + 1
#: Standard deviations of a free actuator's fault, in thresholds a sample; the largest with which a filter exists.
ANY = (30.0, 3.0)
#: Samples until a filter has forgotten how it began.
SETTLE = 4
#: Standard deviations below which an estimate says nothing.
NOISE = 2.0


class Const(Record):
    """Constants, for each observer in use."""

    filters: i8 = means("filters that run")
    gain: Annotated[f8s, BANK, FREE, MOST, MOST_OUTPUTS] = means("gains")
    inverse_v: Annotated[f8s, BANK, FREE, MOST_OUTPUTS, MOST_OUTPUTS] = means("V^-1 of the innovations")
    spread: Annotated[f8s, BANK, FREE] = means("standard deviation of the fault of the actuator that is not free")
    limit: Annotated[f8s, BANK, WINDOW + 1] = means("largest energy of so many samples")


class State(Record):
    """State, of each filter."""

    z: Annotated[f8s, FREE, MOST] = means("[x; omega]")
    e: Annotated[f8s, FREE, MOST_OUTPUTS] = means("innovation")
    energy: Annotated[f8s, FREE, WINDOW] = means("e^T V^-1 e of the last samples")
    at: i8 = means("place of the newest of them")
    kept: i8 = means("samples in the window")
    work: Annotated[f8s, MOST] = means("scratch")


def _design(plant: LinearPlant, noise: Noise, observer: Observer, threshold: np.ndarray, slow: int) -> Gain:
    """Return a filter of the sensors of an observer, all actuators free but ``slow`` (-1: none is slow)."""
    q, r = covariances(plant, noise)
    own = r[np.ix_(observer.rows, observer.rows)]
    free = plant.states + np.array([i for i in range(plant.inputs) if i != slow], np.int64)
    for any_ in ANY:
        q[free, free] = (any_ * threshold[free - plant.states]) ** 2
        try:
            return from_noise(augmented(plant), observer.shown, q, own)
        except ValueError:
            if any_ == ANY[-1]:
                raise
    raise AssertionError("unreachable")


def prepare(c: Const, plant: LinearPlant, noise: Noise, observers: tuple[Observer, ...], threshold: np.ndarray) -> None:
    """Fill a record of CONST; ``threshold``: of the actuators' faults, shape (m,)."""
    n, m = plant.states, plant.inputs
    c.filters = 1 + m if m > 1 else 1  # of one actuator the bank's own observer is the filter 1
    for k, observer in enumerate(observers):
        rows = observer.rows
        for f in range(c.filters):
            gain = _design(plant, noise, observer, threshold, f - 1)
            c.gain[k][f][: n + m, rows] = gain.gain
            c.inverse_v[k][f][np.ix_(rows, rows)] = np.linalg.inv(gain.innovation)
            if f > 0:
                c.spread[k][f] = sqrt(gain.error[n + f - 1, n + f - 1])
        c.limit[k][1:] = chi2_above(REFUSED, len(rows) * np.arange(1, WINDOW + 1))


@kernel
def begin(s: State, o: bank.Const, z: f8s, at_fault: i8s) -> None:
    """Begin with the state ``z`` of an observer of the bank, ``at_fault`` the flags of the actuators.

    What it has of an actuator that is not at fault may be of another one's drift: filter i begins without.
    """
    s.kept = -SETTLE
    for f in range(FREE):
        copy(s.z[f], z, MOST)
    for i in range(o.m):
        if at_fault[i] == 0:
            s.z[1 + i, o.n + i] = 0.0


@kernel
def step(s: State, c: Const, o: bank.Const, k: int, y: f8s, u: f8s) -> None:
    """Take a sample, as observer k does."""
    s.at = (s.at + 1) % WINDOW
    s.kept = min(s.kept + 1, WINDOW)
    for f in range(c.filters):
        bank.left(s.z[f], s.e[f], o, k, y)
        s.energy[f, s.at] = square(s.e[f], c.inverse_v[k, f], o.p)
        bank.onwards(s.z[f], s.e[f], c.gain[k, f], o, u, s.work)


@kernel
def missing(s: State, c: Const, o: bank.Const, k: int, u: f8s) -> None:
    """Step over a sample that did not come."""
    s.kept = -SETTLE
    for f in range(c.filters):
        s.e[f, :] = 0.0
        bank.onwards(s.z[f], s.e[f], c.gain[k, f], o, u, s.work)


@kernel
def refuted(s: State, c: Const, k: int, f: int) -> bool:
    """Tell whether filter f does not explain the last samples, as many as there are."""
    total = 0.0
    for d in range(s.kept):
        total += s.energy[f, (s.at - d) % WINDOW]
        if total > c.limit[k, d + 1]:
            return True
    return False


@kernel
def asked_for(s: State, c: Const, o: bank.Const, k: int, i: int, way: float, threshold: float, sure: float) -> bool:
    """Tell whether a fault of actuator i, in the direction ``way``, is asked for whatever the others do."""
    if c.filters == 1:
        return True
    own, spread = way * s.z[1 + i, o.n + i], c.spread[k, 1 + i]
    return bool(own > max(0.5 * threshold, sure * spread) or (own > NOISE * spread and refuted(s, c, k, 1 + i)))
