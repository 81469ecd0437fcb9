"""Levels of stopping rules by the mean run length between false alarms, on white noise (:mod:`gateway_fdi.stopping`).

Those of CUSUM and fading mean are for a rule that begins again after each alarm.
"""

from __future__ import annotations

from functools import lru_cache
from math import expm1, log, sqrt

import numpy as np

from gateway_fdi.quantiles import normal_above

#: Cells of the Markov chain; how far below the mean they begin, in standard deviations; longest run.
_CELLS, _BELOW, _LONGEST = 240, 6.0, 1e13


def direct(samples: float) -> float:
    """Return the level of ``direct`` for a mean number of samples between alarms, of a symptom of variance 1: exact."""
    return float(normal_above(min(0.5 / samples, 0.4)))


def cusum(samples: float, drift: float) -> float:
    """Return the level of ``cusum`` on both sides, for a symptom of variance 1 and a mean number between alarms.

    Siegmund's approximation: (exp(2 nu b) - 1 - 2 nu b) / (2 nu^2) with b = h + 1.166 is twice the samples.
    """
    from scipy.optimize import brentq  # noqa: PLC0415 - slow to load

    def short(level: float) -> float:
        b = 2.0 * drift * (level + 1.166)
        return (expm1(b) - b) / (2.0 * drift**2) - 2.0 * samples

    return float(brentq(short, 1e-6, 300.0 / drift))


@lru_cache(maxsize=64)
def fading(samples: float, forget: float, degrees: int) -> float:
    """Return the level of ``gma`` of chi-square values, from their mean on.

    The run length is that of a Markov chain over cells of [0, level], as Brook and Evans (1972) have it for CUSUM and
    Lucas and Saccucci (1990) for a geometric moving average.

    Args:
        samples: mean number between alarms.
        forget: lambda of the average, 0 to 1.
        degrees: of freedom of the values, their mean.
    """
    from scipy.optimize import brentq  # noqa: PLC0415 - slow to load
    from scipy.special import gammainc  # noqa: PLC0415 - slow to load

    spread = sqrt(2.0 * degrees * (1.0 - forget) / (1.0 + forget))
    least = max(degrees - _BELOW * spread, 0.0)

    def longer(level: float) -> float:
        edge = np.linspace(least, level, _CELLS + 1)
        middle = 0.5 * (edge[1:] + edge[:-1])
        value = np.maximum((edge[None, :] - forget * middle[:, None]) / (1.0 - forget), 0.0)
        value[:, 0] = 0.0  # what is below counts as the lowest cell
        step = np.diff(gammainc(0.5 * degrees, 0.5 * value), axis=1)
        run = float(np.interp(degrees, middle, np.linalg.solve(np.eye(_CELLS) - step, np.ones(_CELLS))))
        return log(run if 1.0 <= run < _LONGEST else _LONGEST) - log(samples)

    low, high = degrees + 0.1 * spread, degrees + 2.0 * spread
    while longer(high) < 0.0:
        low, high = high, high + spread
    return float(brentq(longer, low, high, rtol=1e-6))
