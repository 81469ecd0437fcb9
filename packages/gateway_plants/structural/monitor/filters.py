"""Bandwidths of filters that differentiate, fitted to the noise that the configuration tells of.

White noise of standard deviation s of what is differentiated, sampled every h, leaves a low-pass's slope with

    s k / h sqrt(2 / (2 - k)),   k = 1 - exp(-alpha h)

which grows with the bandwidth alpha. The other noise of the residual does not: it passes as it is, or, where the
residual is filtered (20), with sqrt(k / (2 - k)). The bandwidth is the largest one at which the derivative brings no
more noise than all the rest does: a wider one drowns the residual in it, a narrower one is slower, and hardly quieter.
Where no other noise is told there is nothing to compare with. It stays between what a residual forgets within
``settle_s`` and one sample.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import NamedTuple

from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.plan import Test

#: Time constants of a filter that fit into ``settle_s``.
_FORGETS = 3.0
#: Halvings of the interval of the logarithm.
_HALVINGS = 60


class Bandwidths(NamedTuple):
    """Of a test's filters.

    Attributes:
        filter: of (20) [rad/s].
        derivative: of low-passes whose slope is taken [rad/s].
        said: what was fitted, in words; empty: nothing.
    """

    filter: float
    derivative: float
    said: str


def noises(test: Test, p: Params) -> tuple[float, float]:
    """Return the standard deviations of what is told: of the residual's direct part, and of what is differentiated."""
    direct = sqrt(sum((one.direct * p.noise.get(one.known, 0.0)) ** 2 for one in test.noise))
    slope = sqrt(sum((one.slope * p.noise.get(one.known, 0.0)) ** 2 for one in test.noise))
    return direct, slope


def slope_noise(noise: float, bandwidth: float, period: float) -> float:
    """Return the standard deviation that white noise leaves in a low-pass's slope, per second."""
    k = 1.0 - exp(-bandwidth * period)
    return noise * k / period * sqrt(2.0 / (2.0 - k))


def fitted(direct: float, slope: float, period: float, *, filtered: bool, settle: float) -> float:
    """Return the bandwidth [rad/s] for noise of both kinds, each above 0.

    Args:
        direct: standard deviation of what is not differentiated, of the residual.
        slope: of what is differentiated, times its factor.
        period: between two samples [s].
        filtered: the direct part is filtered too, (20).
        settle: time in which the filter has to forget [s]; 0: any.
    """
    low, high = (_FORGETS / settle if settle > 0 else 1e-6 / period), 1.0 / period
    if low >= high:
        return high

    def more(bandwidth: float) -> bool:
        k = 1.0 - exp(-bandwidth * period)
        rest = direct * sqrt(k / (2.0 - k)) if filtered else direct
        return slope_noise(slope, bandwidth, period) > rest

    if more(low):
        return low
    if not more(high):
        return high
    a, b = log(low), log(high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (a + b)
        a, b = (a, middle) if more(exp(middle)) else (middle, b)
    return exp(a)


def of_meter(p: Params) -> Bandwidths:
    """Return the bandwidths of a generator that only tells a fault's size.

    Its slopes are not fitted to the noise: they would lag behind the fault, and the least squares average them anyway.
    """
    return Bandwidths(p.filter_bandwidth, max(p.derivative_bandwidth, 1e3 / p.period_ms), "")


def bandwidths(test: Test, p: Params) -> Bandwidths:
    """Return the bandwidths of a test: as given, else fitted to the noise, else as by default."""
    given = p.model_fields_set
    own = Bandwidths(p.filter_bandwidth, p.derivative_bandwidth, "")
    direct, slope = noises(test, p)
    key = "derivative_bandwidth" if test.differentiated else "filter_bandwidth"
    if not test.noise or slope <= 0.0 or direct <= 0.0 or key in given:
        return own
    filtered = not test.differentiated
    found = fitted(direct, slope, p.period_ms / 1e3, filtered=filtered, settle=p.settle_s)
    said = f"{key} {found:.3g} rad/s, fitted to the noise"
    return Bandwidths(found, own.derivative, said) if filtered else Bandwidths(own.filter, found, said)
