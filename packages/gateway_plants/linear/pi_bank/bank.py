"""The bank's kernel: all observers step on one sample (paper 003, (14), in discrete time).

    e_k = y^k - C^k x_k                          what is left of the sensors that observer k takes
    [x_k; omega_k] := [[Phi, Gamma], [0, 1]] [x_k; omega_k] + [Gamma; 0] u + [K_k; H_k] e_k

Observer 0 takes all sensors, observer k from 1 on all but the k-th.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8s, i8, kernel, means
from gateway_fdi.linear_algebra import copy, dot, minus, plus
from gateway_plants.linear.mathematics.plant import LinearPlant
from gateway_plants.linear.pi_bank.design import Observer, augmented

#: Largest plant.
MOST_STATES, MOST_INPUTS, MOST_OUTPUTS = 8, 4, 6
#: States with faults; observers.
MOST, BANK = MOST_STATES + MOST_INPUTS, MOST_OUTPUTS + 1


class Const(Record):
    """Constants."""

    n: i8 = means("states")
    m: i8 = means("inputs")
    p: i8 = means("outputs")
    phi: Annotated[f8s, MOST, MOST] = means("[[Phi, Gamma], [0, 1]]")
    gamma: Annotated[f8s, MOST_STATES, MOST_INPUTS] = means("Gamma")
    c: Annotated[f8s, MOST_OUTPUTS, MOST_STATES] = means("C")
    gain: Annotated[f8s, BANK, MOST, MOST_OUTPUTS] = means("[K_k; H_k] of each observer")


class State(Record):
    """State."""

    z: Annotated[f8s, BANK, MOST] = means("[x_k; omega_k] of each observer")
    e: Annotated[f8s, BANK, MOST_OUTPUTS] = means("what each observer left of each sensor; 0: it does not take it")
    work: Annotated[f8s, MOST] = means("scratch")


def prepare(c: Const, plant: LinearPlant, bank: tuple[Observer, ...]) -> None:
    """Fill a record of Const.

    Raises:
        ValueError: the plant is too large.
    """
    n, m, p = plant.states, plant.inputs, plant.outputs
    if n > MOST_STATES or m > MOST_INPUTS or p > MOST_OUTPUTS:
        raise ValueError(f"{n} states, {m} inputs, {p} outputs: at most {MOST_STATES}, {MOST_INPUTS}, {MOST_OUTPUTS}")
    c.n, c.m, c.p = n, m, p
    c.phi[: n + m, : n + m] = augmented(plant)
    c.gamma[:n, :m] = plant.gamma
    c.c[:p, :n] = plant.c
    for k, observer in enumerate(bank):
        c.gain[k][: n + m, observer.rows] = observer.gain.gain


@kernel
def left(z: f8s, e: f8s, c: Const, k: int, y: f8s) -> None:
    """Compute what an observer with the state ``z``, which does not take sensor k - 1, leaves of the outputs."""
    for j in range(c.p):
        if j == k - 1:
            e[j] = 0.0
            continue
        e[j] = minus(y[j], c.c[j], z, c.n)


@kernel
def onwards(z: f8s, e: f8s, gain: f8s, c: Const, u: f8s, work: f8s) -> None:
    """Step an observer with this gain to the next sample, the commands ``u`` held till then."""
    size = c.n + c.m
    for i in range(size):
        value = plus(dot(c.phi[i], z, size), c.gamma[i], u, c.m) if i < c.n else z[i]
        work[i] = plus(value, gain[i], e, c.p)
    copy(z, work, size)


@kernel
def innovate(s: State, c: Const, k: int, y: f8s) -> None:
    """Compute what observer k leaves of a sample of the outputs."""
    left(s.z[k], s.e[k], c, k, y)


@kernel
def advance(s: State, c: Const, k: int, u: f8s) -> None:
    """Step observer k to the next sample, the commands ``u`` held till then."""
    onwards(s.z[k], s.e[k], c.gain[k], c, u, s.work)


@kernel
def step(s: State, c: Const, y: f8s, u: f8s) -> None:
    """Take one sample with the whole bank."""
    for k in range(c.p + 1):
        innovate(s, c, k, y)
        advance(s, c, k, u)


@kernel
def missing(s: State, c: Const, k: int, u: f8s) -> None:
    """Step observer k over a sample that did not come: nothing corrects it."""
    s.e[k, :] = 0.0
    advance(s, c, k, u)
