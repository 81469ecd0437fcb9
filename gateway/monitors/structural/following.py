"""Residuals without what the plant's parameters and sensors are off by, as far as that is known.

The residual of the corrected model is r + g (x - x0) (:mod:`gateway.fdi.slow.shares`). What is not known of x yet
leaves a variance g P g' in it, beside that of its noise, sigma^2. The tests have it as a residual of the noise that
they were calibrated for:

    r := (r + g (x - x0)) sigma / sqrt(sigma^2 + g P g')

so that their thresholds are as much higher as the parameters are unknown. sigma is what nu says, or, where none is
known yet (calibration), a running mean.

When x has moved away from x0, the generators go on with the parameters and readings of x, their states carried there
by their own sensitivities.
"""

from __future__ import annotations

from math import exp, isfinite, sqrt
from typing import Annotated, Any

from gateway.fdi.slow import shares as slow
from gateway.jit import Record, f8, f8s, i8, kernel, means
from gateway.monitors.structural.decision import NU_OF_NOISE
from gateway.monitors.structural.plan import MOST_TESTS

#: Standard deviations beyond which a residual is no more of what may be off than while a test has fired.
DOUBTED = 4.0
#: Share of a bound by which x may be off x0.
FAR = 0.1
#: Time over which the noise of a residual is averaged where no nu is known [s].
AVERAGED_S = 10.0


class Const(Record):
    """Constants: of the filter; of each test the standard deviation of its noise, and the time it is independent in."""

    slow: slow.Const
    bound: Annotated[f8s, slow.MOST_SLOW] = means("of what may be off, a share; of a bias in the sensor's unit")
    sigma: Annotated[f8s, MOST_TESTS] = means("of each healthy residual; not above 0: not known")
    apart_s: Annotated[f8s, MOST_TESTS] = means("after which its noise is independent", "s")


class State(Record):
    """State."""

    slow: slow.State
    moved_ns: i8 = means("when the model was moved last", "ns")
    corrected: f8 = means("residual of the corrected model, that :func:`correct` has seen last")
    power: Annotated[f8s, MOST_TESTS] = means("running mean square of each")


@kernel
def moves(s: State, c: Const, own: Any, own_const: Any, begins: bool) -> bool:
    """Let the time since the last sample pass; returns whether the model is to be moved to x.

    Args:
        s: record of State.
        c: record of Const.
        own: State of the monitor.
        own_const: Const of the monitor.
        begins: it is the very first sample.
    """
    if begins:
        slow.begin(s.slow, c.slow)
        s.moved_ns = own.at_ns
        return True
    slow.grow(s.slow, c.slow, own.dt)
    if 10 * (own.at_ns - s.moved_ns) < own_const.settle_ns or not slow.moved(s.slow, c.slow, FAR):
        return False
    slow.relinearise(s.slow, c.slow)
    s.moved_ns = own.at_ns
    return True


@kernel
def correct(s: State, c: Const, own: Any, own_const: Any, k: int, residual: float) -> float:
    """Return a test's residual as the decision takes it; its sensitivities are in ``s.slow.gain``.

    Args:
        s: record of State.
        c: record of Const.
        own: State of the monitor.
        own_const: Const of the monitor.
        k: number of the test.
        residual: as it was computed.
    """
    s.corrected = residual
    if not isfinite(residual):
        return residual
    corrected = slow.correct(s.slow, c.slow, residual)
    s.corrected = corrected
    settled = own.at_ns - own.since_ns >= own_const.settle_ns and own.at_ns - own.from_ns[k] >= own_const.settle_ns
    sigma = c.sigma[k]
    if not sigma > 0.0:
        sigma = _running(s, k, corrected, own.dt, settled)
    if not sigma > 0.0:
        return corrected
    spread = sqrt(sigma * sigma + s.slow.fitted)
    if settled and own.dt > 0.0:
        fired = abs(corrected) > DOUBTED * spread
        for w in range(len(own.fired)):
            fired = fired or own.fired[w] != 0
        many = max(c.apart_s[k] / own.dt, 1.0)
        slow.take(s.slow, c.slow, corrected, many * sigma * sigma, c.slow.rate * own.dt if fired else -1.0)
    return float(corrected * sigma / spread)


@kernel
def _running(s: State, k: int, corrected: float, dt: float, settled: bool) -> float:
    """Return the root of a residual's running mean square."""
    if settled:
        share = 1.0 - exp(-dt / AVERAGED_S)
        s.power[k] += share * (corrected * corrected - s.power[k]) if s.power[k] > 0.0 else corrected * corrected
    return sqrt(s.power[k])


def prepare(c: Const, k: int, nu: float, apart_s: float) -> None:
    """Fill the constants of a test.

    Args:
        c: record of Const.
        k: number of the test.
        nu: of its residual; infinite: not known.
        apart_s: after which its noise is independent [s].
    """
    c.sigma[k] = nu / NU_OF_NOISE if isfinite(nu) else 0.0
    c.apart_s[k] = apart_s
