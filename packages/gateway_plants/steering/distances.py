"""Distance measures: from an estimate and a measurement to a symptom (paper 001, Fig. 2).

The normalised innovation squared is a distance, too; the filters give it (:mod:`gateway_fdi.filters.gaussian`).
"""

from __future__ import annotations

from math import pi

from gateway_fdi.filters.transforms import wrap
from gateway_fdi.jit import Record, f8, i8, kernel, means


class Increment(Record):
    """What is remembered of an increment."""

    last: f8 = means("angle measured last", "rad")
    started: i8 = means("1: there is one")


class Leaky(Record):
    """What is remembered of a leaky sum."""

    total: f8 = means("the sum")


@kernel
def position(measured: float, estimated: float, turn: float) -> float:
    """Difference of two angles that are known modulo ``turn`` [rad]."""
    return wrap(measured - estimated, turn)


@kernel
def modulo_pi(measured: float, estimated: float, pole_pairs: float) -> float:
    """Difference of mechanical angles, one of which is known modulo half an electrical turn [rad]."""
    return wrap(measured - estimated, pi / pole_pairs)


@kernel
def increment(s: Increment, measured: float, speed: float, dt: float, turn: float) -> float:
    """Difference of a measured angle's step and the one that the estimated speed makes [rad].

    Args:
        measured: angle now, known modulo ``turn`` [rad].
        speed: estimated mean speed since the last call [rad/s].
        dt: time since then [s].
        turn: [rad].
    """
    moved = measured - s.last
    s.last = measured
    if s.started == 0:
        s.started = 1
        return 0.0
    return wrap(moved - speed * dt, turn)


@kernel
def leaky(s: Leaky, x: float, share: float) -> float:
    """Sum that forgets: time constant of 1/share samples.

    Args:
        x: what is added.
        share: of the sum that is forgotten with each sample.
    """
    s.total += x - share * s.total
    return float(s.total)
