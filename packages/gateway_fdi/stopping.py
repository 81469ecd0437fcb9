"""Stopping rules: from a symptom to an alarm (paper 001, Fig. 2; Gustafsson, Adaptive Filtering and Change Detection).

Every rule makes one number of its symptom, the level, and alarms when that reaches the threshold::

    direct      g = |x|
    gma         m += (1 - lambda) (x - m),  g = |m|                           geometric moving average
    cusum       up = max(0, up + x - nu), down = max(0, down - x - nu),  g = max(up, down)
    sprt        up += mu/sigma^2 (x - mu/2), from ``low`` on again; likewise down for -mu,  g = max(up, down)
    chi_square  g = sum of (x/sigma)^2 over the last N samples

CUSUM with nu = mu/2 is the SPRT that starts again at 0 and counts in units of sigma^2/mu. Levels do not depend on the
threshold, so that one run over healthy data tells what any threshold would have done; but those of CUSUM and SPRT are
cut off at ``most``, so that an alarm ends soon after its cause has.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import numpy as np

from gateway_fdi.cusum import grown
from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means
from gateway_fdi.quantiles import chi2_above

Rule = Literal["direct", "gma", "cusum", "sprt", "chi_square"]
RULES: tuple[Rule, ...] = get_args(Rule)
_DIRECT, _GMA, _CUSUM, _SPRT, _CHI_SQUARE = range(5)
#: Longest window of chi-square.
WINDOW = 64


class Const(Record):
    """Constants."""

    rule: i8 = means("place in RULES")
    threshold: f8 = means("level from which on it alarms")
    share: f8 = means("1 - lambda")
    drift: f8 = means("nu")
    shift: f8 = means("mu")
    variance: f8 = means("sigma^2")
    low: f8 = means("where the SPRT accepts that all is well")
    most: f8 = means("largest level of CUSUM and SPRT")
    window: i8 = means("N", "samples")


class State(Record):
    """State."""

    level: f8 = means("the level g")
    up: f8 = means("sum upwards; m of gma; the sum of chi_square")
    down: f8 = means("sum downwards")
    ring: Annotated[f8s, WINDOW] = means("(x/sigma)^2 of the last samples")
    at: i8 = means("place of the next of them")
    peak: f8 = means("largest level since somebody set it to 0")


def prepare(
    c: Const,
    rule: Rule,
    threshold: float,
    *,
    forget: float = 0.98,
    drift: float = 0.0,
    shift: float = 1.0,
    sigma: float = 1.0,
    low: float = -4.6,
    most: float = np.inf,
    window: int = 20,
) -> None:
    """Fill a record of Const.

    Args:
        rule: which.
        threshold: of the level.
        forget: lambda of the moving average.
        drift: nu of CUSUM.
        shift: mu, the change of the mean that the SPRT looks for.
        sigma: standard deviation of the symptom, for SPRT and chi-square.
        low: log likelihood ratio at which the SPRT accepts that all is well, and starts again.
        most: the levels of CUSUM and SPRT do not rise beyond.
        window: N of chi-square, at most 64.

    Raises:
        ValueError: the window is too long or empty.
    """
    if not 1 <= window <= WINDOW:
        raise ValueError(f"a window has 1 to {WINDOW} samples, not {window}")
    c.rule, c.threshold = RULES.index(rule), threshold
    c.share, c.drift, c.shift, c.variance = 1.0 - forget, drift, shift, sigma**2
    c.low, c.most, c.window = low, most, window


def assured(seconds: float, alarms: int) -> float:
    """Return the mean time between false alarms that holds with 95 %, alarms being a Poisson process [s].

    Args:
        seconds: of healthy data.
        alarms: in them.
    """
    return float(2.0 * seconds / chi2_above(0.05, 2 * alarms + 2))


@kernel
def update(s: State, c: Const, x: float) -> bool:
    """Take one value of a symptom; returns whether the level has reached the threshold.

    Args:
        x: the symptom.
    """
    if c.rule == _DIRECT:
        s.level = abs(x)
    elif c.rule == _GMA:
        s.up += c.share * (x - s.up)
        s.level = abs(s.up)
    elif c.rule == _CUSUM:
        s.up = grown(s.up, x - c.drift, c.most)
        s.down = grown(s.down, -x - c.drift, c.most)
        s.level = max(s.up, s.down)
    elif c.rule == _SPRT:
        weight = c.shift / c.variance
        s.up = min(s.up + weight * (x - 0.5 * c.shift), c.most)
        s.down = min(s.down + weight * (-x - 0.5 * c.shift), c.most)
        if s.up < c.low:
            s.up = 0.0
        if s.down < c.low:
            s.down = 0.0
        s.level = max(s.up, s.down, 0.0)
    else:
        square = x * x / c.variance
        s.up += square - s.ring[s.at]
        s.ring[s.at] = square
        s.at += 1
        if s.at == c.window:
            s.at = 0
            s.up = 0.0  # the running sum, made again once a window: rounding does not add up
            for k in range(c.window):
                s.up += s.ring[k]
        s.level = s.up
    s.peak = max(s.peak, s.level)
    return bool(s.level >= c.threshold)


@kernel
def reset(s: State) -> None:
    """Start again; the peak stays."""
    s.level = 0.0
    s.up = 0.0
    s.down = 0.0
    s.at = 0
    for k in range(WINDOW):
        s.ring[k] = 0.0
