"""Average and median voters: what the paper compares with (paper 002, section IV)."""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Readings that any voter can take.
MOST_CHANNELS = 3


class Const(Record):
    """Constants."""

    channels: i8 = means("channels, 2 or 3")


class State(Record):
    """State."""

    value: f8 = means("the value voted")
    used: i8 = means("bits of the channels voted")


def prepare(c: Const, channels: int) -> None:
    """Fill the constants.

    Args:
        channels: 2 or 3.
    """
    c.channels = channels


@kernel
def average(s: State, c: Const, y: f8s) -> None:
    """Vote for the mean of the readings.

    Args:
        y: readings, one a channel.
    """
    total = 0.0
    for i in range(c.channels):
        total += y[i]
    s.value = total / c.channels
    s.used = (1 << c.channels) - 1


@kernel
def middle(y: f8s, n: int) -> float:
    """Return the median of two or three values."""
    if n < 3:
        return float((y[0] + y[n - 1]) / 2.0)
    low, high = min(y[0], y[1]), max(y[0], y[1])
    return float(max(low, min(high, y[2])))


@kernel
def median(s: State, c: Const, y: f8s) -> None:
    """Vote for the median of the readings; of two it is their mean. Arguments as in :func:`average`."""
    n = c.channels
    s.value = middle(y, n)
    s.used = 0
    for i in range(n):
        if n < 3 or y[i] == s.value:
            s.used |= 1 << i
