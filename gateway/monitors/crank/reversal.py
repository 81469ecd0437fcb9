"""Kick-back: an engine that nearly stood may have turned back.

A sensor without direction shows the same teeth again. From the slowest interval on, behind tooth
``i``, a wheel that turns on shows its gap after ``P - i`` pulses, one that turned back after ``i + 2``,
the gap recognised by the interval after it.
"""

from __future__ import annotations

from gateway.jit import Record, f8, i4, kernel
from gateway.monitors.contract import report
from gateway.monitors.crank.faults import REVERSED, Reports


class Reversal(Record):
    """Reversal.

    ``index`` of the tooth before the slowest interval (-1: none), ``count`` pulses since, ``slowest`` that
    interval [us].
    """

    index: i4
    count: i4
    slowest: f8


#: Pulses that the two counts must differ by, and that a count may be off.
CLEAR, OFF = 4, 2


@kernel
def begin(re: Reversal, pulses: int, index: int, y: float) -> None:
    """Note that the engine nearly stood behind a tooth; of several slow intervals [us] the slowest counts."""
    if re.index < 0:
        re.index = index
        re.slowest = 0.0
    elif y > re.slowest:
        # Pulses are counted here: so near standstill time does not tell teeth apart.
        re.index = (re.index + re.count + 1) % pulses
    if y > re.slowest:
        re.count = -1
        re.slowest = y


@kernel
def seen(re: Reversal, pulses: int, gap: float, y2: float, y1: float, y: float) -> bool:
    """Take an interval; returns whether the gap came where only a wheel that turned back shows it.

    Args:
        re: record of Reversal.
        pulses: of a revolution.
        gap: pitch at the gap [pitch].
        y2: the last interval but two [us].
        y1: the last but one [us].
        y: the last one [us].
    """
    re.count += 1
    if re.count > pulses + OFF:
        re.index = -1
        return False
    if re.count < 3 or y1 < 0.72 * gap * (y * y2) ** 0.5:
        return False
    back, on = re.index + 2, pulses - re.index
    turned_back = abs(re.count - back) <= OFF and abs(on - back) > CLEAR
    if not turned_back:
        re.index = -1
    return bool(turned_back)


@kernel
def tell(re: Reversal, out: Reports) -> None:
    """Report it."""
    e = report(out, REVERSED, True, re.count, 0.0).reversed
    e.tooth, e.pulses = re.index, re.count
    re.index = -1
