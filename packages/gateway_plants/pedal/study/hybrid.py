"""Fault detector, exception handler and voter of hybrid redundancy (paper 002, section III and Fig. 3).

A predictor, which differs between the schemes, forecasts by how much the output changes in one sample, ``FT(k)``.
A reading is believed when its distance from the last output lies in ``(1 +- beta) FT``. If none is, readings no
further than FT from each other are believed together (a fast true change). Otherwise the exception handler
continues the trend by FT. The voter averages what is believed.

What the paper leaves open, and how it is read here: FT is a magnitude, because the handler adds it when the
output rises and subtracts it when it falls; the first output is the mean of the first readings and FT(0) = 0; a
flat trend is held. As printed nothing bounds FT from below: once it is 0, readings that differ by any noise are
all rejected, the output is held, and FT stays 0 for good. ``floor`` repairs that.
"""

from __future__ import annotations

import numpy as np

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means
from gateway_plants.pedal.voting.simple import MOST_CHANNELS


class Const(Record):
    """Constants."""

    channels: i8 = means("channels, 2 or 3")
    beta: f8 = means("width of the interval, a share of FT")
    lower: i8 = means("1: the interval has its lower bound, as printed; 0: repaired")
    floor: f8 = means("least FT")
    low: f8 = means("least output")
    high: f8 = means("largest output")


class State(Record):
    """State."""

    value: f8 = means("r(k)")
    used: i8 = means("bits of the channels voted")
    before: f8 = means("r(k-1)")
    change: f8 = means("FT(k)")
    exception: i8 = means("1: no reading is believed")
    started: i8 = means("1: there is an output")


def prepare(
    c: Const,
    channels: int,
    *,
    beta: float,
    lower: bool,
    floor: float = 0.0,
    low: float = -np.inf,
    high: float = np.inf,
) -> None:
    """Fill the constants.

    Args:
        channels: 2 or 3.
        beta: width of the interval, as a share of FT.
        lower: whether a reading that changes less than predicted is rejected, as printed.
        floor: least FT, unit of the readings.
        low: least output.
        high: largest output.
    """
    c.channels, c.beta, c.lower, c.floor = channels, beta, lower, floor
    c.low, c.high = low, high


@kernel
def start(s: State, c: Const, y: f8s) -> None:
    """Begin with the mean of the first readings."""
    total = 0.0
    for i in range(c.channels):
        total += y[i]
    s.value = total / c.channels
    s.before = s.value
    s.used = (1 << c.channels) - 1
    s.started = 1


@kernel
def _believed(s: State, c: Const, y: f8s, change: float) -> int:
    """Return the bits of the channels that the detector passes."""
    bits = 0
    least = (1.0 - c.beta) * change if c.lower == 1 else 0.0
    for i in range(c.channels):
        moved = abs(y[i] - s.value)
        if least <= moved <= (1.0 + c.beta) * change:
            bits |= 1 << i
    if bits == 0:
        for i in range(c.channels):
            for j in range(i):
                if abs(y[i] - y[j]) <= change:
                    bits |= 1 << i | 1 << j
    return bits


@kernel
def vote(s: State, c: Const, y: f8s, forecast: float) -> float:
    """Detect, handle and vote for one sample.

    Args:
        s: record of State, started.
        y: readings.
        forecast: FT(k) of the predictor.

    Returns:
        ``|r(k) - r(k-1)|``, what the predictor observes.
    """
    change = max(forecast, c.floor)
    s.change = change
    s.used = _believed(s, c, y, change)
    s.exception = 1 if s.used == 0 else 0
    if s.used:
        total, count = 0.0, 0
        for i in range(MOST_CHANNELS):
            if s.used & (1 << i):
                total += y[i]
                count += 1
        r = total / count
    elif s.value > s.before:
        r = s.value + change
    elif s.value < s.before:
        r = s.value - change
    else:
        r = s.value
    r = min(max(r, c.low), c.high)
    s.before = s.value
    s.value = r
    return float(abs(r - s.before))
