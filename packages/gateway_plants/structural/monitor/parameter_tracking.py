"""Residuals without what the plant's parameters and sensors are off by, as far as that is known.

Each of these is a slow error x_j of :mod:`gateway_fdi.slow.filter`, a share of its bound, in [-1, 1]. What a residual r
has of them comes from the model's own sensitivities around a point x0, at which the model stands: h_j is by how much
the residual gets less when the model takes x_j + 1 for x_j. To first order, with v the residual of the true model,

    r + h' x0 = h' x + v

which is a measurement of x. At the beginning x_j may be anywhere between its bounds: variance 1/3. The noise v is not
white (filters, what the model leaves out): it is taken as independent only once in a time tau, so that its variance is
tau / dt times what it is, dt the time between two samples. Beside it is what the sensitivities leave out, of second
order: a share :data:`BENDS` of what is not known yet, h' P h. Without it the first seconds, of a model that is far off,
make x as sure as it is wrong (underweighting: Zanetti, DeMars, Bishop: Underweighting Nonlinear Measurements, Journal
of Guidance, Control, and Dynamics 33, 2010).

The residual of the corrected model is r + h' (x0 - x). What is not known of x yet leaves a variance h' P h in it,
beside that of its noise, sigma^2. The tests have it as a residual of the noise that they were calibrated for:

    r := (r + h' (x0 - x)) sigma / sqrt(sigma^2 + h' P h)

so that their thresholds are as much higher as the parameters are unknown. What is off moves the residual also a
little before or behind h (the phase of an oscillation, a command between samples), so of h' P h the largest one of the
last time tau is taken, forgetting. sigma is what nu says, or, where none is
known yet (calibration), a running mean.

When x has moved away from x0, the generators go on with the parameters and readings of x, their states carried there
by their own sensitivities. x0 moves in steps: what a product of two that are off leaves is of second order in x - x0,
and a model that moved with each sample would run after the filters of its own residual.

In the beginning a test waits until most of what may be off it is known: as long as parameters are far off, the
residual is not linear in them, and an undamped oscillation runs away from h altogether; learning goes on meanwhile.

A fault that begins moves a residual as a parameter would that jumps, and parameters do not jump: while a test has
fired, or a residual is too large for noise, x is held to its rate. What ages into an alarm leaves it again, as long as
it has no name; of a fault that has one, the tests that see it are not followed at all: x would take it up in the end,
and be wrong for the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, isfinite, sqrt
from typing import Annotated, Any

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import plus
from gateway_fdi.slow import filter as slow
from gateway_fdi.slow.filter import Block
from gateway_plants.structural.monitor.decision import NU_OF_NOISE, sees
from gateway_plants.structural.monitor.plan import MOST_TESTS

#: Standard deviations beyond which a residual is no more of what may be off than while a test has fired.
DOUBTED = 4.0
#: Share of a bound by which x may be off x0.
FAR = 0.1
#: A test waits until no more than this share of what may be off is not known, so many times ``settle_s`` at most.
KNOWN, LATEST = 0.2, 4
#: Share of what is not known that is no line in x: parameters that are off by a fifth bend a residual by a fifth.
BENDS = 0.2
#: Time over which the noise of a residual is averaged where no nu is known [s].
AVERAGED_S = 10.0


class Const(Record):
    """Constants."""

    slow: slow.Const = means("bounds and rates of the slow errors")
    bound: Annotated[f8s, slow.MOST] = means("of what may be off, a share; of a bias in the sensor's unit")
    sigma: Annotated[f8s, MOST_TESTS] = means("of each healthy residual; not above 0: not known")
    sets: Annotated[i8s, MOST_TESTS] = means("samples of a block of each")
    apart_s: Annotated[f8s, MOST_TESTS] = means("after which its noise is independent", "s")


class State(Record, lengths={"tests": MOST_TESTS}):
    """State."""

    slow: slow.State = means("slow errors that are followed")
    h: Annotated[f8s, slow.MOST] = means("by which the residual at hand gets less with each share")
    point: Annotated[f8s, slow.MOST] = means("x0, shares at which the model stands")
    step: Annotated[f8s, slow.MOST] = means("by which it was moved last")
    moved_ns: i8 = means("when that was", "ns")
    corrected: f8 = means("residual of the corrected model, that :func:`correct` has seen last")
    power: Annotated[f8s, "tests"] = means("running mean square of each")
    whole: Annotated[f8s, "tests"] = means("the same as nothing was known")
    doubt: Annotated[f8s, "tests"] = means("standard deviation of what is not known of x, of each residual")
    block: Annotated[list[Block], "tests"] = means("samples of each that wait")


@kernel
def moves(s: State, c: Const, own: Any, own_const: Any, begins: bool) -> bool:
    """Let the time since the last sample pass; returns whether the model is to be moved to x.

    Args:
        own: State of the monitor.
        own_const: Const of the monitor.
        begins: it is the very first sample.
    """
    if begins:
        s.moved_ns = own.at_ns
        return True
    slow.wait(s.slow, own.dt)
    far = 0.0
    for i in range(c.slow.count):
        far = max(far, abs(s.slow.taken[i] - s.point[i]))
    if 10 * (own.at_ns - s.moved_ns) < own_const.settle_ns or far <= FAR:
        return False
    for i in range(c.slow.count):
        s.step[i] = s.slow.taken[i] - s.point[i]
        s.point[i] = s.slow.taken[i]
    s.moved_ns = own.at_ns
    return True


@kernel
def correct(s: State, c: Const, own: Any, own_const: Any, k: int, residual: float) -> float:
    """Return a test's residual as the decision takes it; its sensitivities are in ``s.h``.

    Args:
        own: State of the monitor.
        own_const: Const of the monitor.
        k: number of the test.
        residual: as it was computed.
    """
    s.corrected = residual
    if not isfinite(residual):
        return residual
    rest, corrected = plus(residual, s.h, s.point, c.slow.count), residual
    for i in range(c.slow.count):
        corrected += s.h[i] * (s.point[i] - s.slow.taken[i])
    s.corrected = corrected
    settled = own.at_ns - own.since_ns >= own_const.settle_ns and own.at_ns - own.from_ns[k] >= own_const.settle_ns
    sigma = c.sigma[k]
    if not sigma > 0.0:
        sigma = _running(s, k, corrected, own.dt, settled)
    if not sigma > 0.0:
        own.waits[k] = 0 if settled else own.waits[k]
        return corrected
    doubt = s.doubt[k] = max(slow.doubt(s.slow, c.slow, s.h), exp(-own.dt / c.apart_s[k]) * s.doubt[k])
    spread = sqrt(sigma * sigma + doubt * doubt)
    if own.waits[k] == 1 and settled and _is_known(s, c, own, own_const, k, sigma):
        own.waits[k] = 0
    if 0 <= own.found < own_const.groups and sees(own_const, own.found, k):
        slow.drop(s.block[k])
    elif settled and own.dt > 0.0:
        fired = own.waits[k] == 0 and abs(corrected) > DOUBTED * spread
        for w in range(len(own.fired)):
            fired = fired or own.fired[w] != 0
        bend = BENDS * doubt
        if slow.add(s.block[k], s.h, rest, sigma * sigma + bend * bend, c.sets[k]):
            mode = slow.HELD if fired else slow.LEARNS
            slow.update(s.slow, c.slow, s.block[k], max(c.apart_s[k] / own.dt, 1.0), mode)
    return float(corrected * sigma / spread)


@kernel
def _is_known(s: State, c: Const, own: Any, own_const: Any, k: int, sigma: float) -> bool:
    """Tell whether enough is known of what may be off a test, or it has waited for long enough."""
    whole = 0.0
    for i in range(c.slow.count):
        whole += c.slow.prior[i] * c.slow.prior[i] * s.h[i] * s.h[i]
    s.whole[k] = max(sqrt(whole), exp(-own.dt / c.apart_s[k]) * s.whole[k])
    late = own.at_ns - own.since_ns >= (1 + LATEST) * own_const.settle_ns
    return bool(late or s.doubt[k] <= max(sigma, KNOWN * s.whole[k]))


@kernel
def _running(s: State, k: int, corrected: float, dt: float, settled: bool) -> float:
    """Return the root of a residual's running mean square."""
    if settled:
        share = 1.0 - exp(-dt / AVERAGED_S)
        s.power[k] += share * (corrected * corrected - s.power[k]) if s.power[k] > 0.0 else corrected * corrected
    return sqrt(s.power[k])


def prepare(s: State, c: Const, bounds: Sequence[float], seconds: float) -> None:
    """Fill what is told of all that may be off.

    Args:
        bounds: of each.
        seconds: within which it may change by its whole bound.
    """
    c.slow.count = n = len(bounds)
    c.bound[:n], c.slow.group[:n] = bounds, range(n)
    c.slow.low[:n], c.slow.high[:n], c.slow.prior[:n], c.slow.rate[:n] = -1.0, 1.0, sqrt(1.0 / 3.0), 1.0 / seconds
    slow.prepare(s.slow, c.slow)


def prepare_test(c: Const, k: int, nu: float, apart_s: float, turn: float) -> None:
    """Fill the constants of a test.

    Args:
        k: number of the test.
        nu: of its residual; infinite: not known.
        apart_s: after which its noise is independent [s].
        turn: of its fastest oscillation in a sample [rad]: a block is no longer than one radian of it.
    """
    c.sets[k] = max(int(min(slow.BLOCK, 1.0 / max(turn, 1e-9))), 1)
    c.sigma[k] = nu / NU_OF_NOISE if isfinite(nu) else 0.0
    c.apart_s[k] = apart_s
