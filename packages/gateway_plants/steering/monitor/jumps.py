"""Window behind a jump of the motor's angle sensor: what the increment does next tells an offset from noise.

It opens with an increment beyond its threshold, or with an alarm of their mean square, and is judged when it is over
(:mod:`gateway_plants.steering.monitor.symptoms`).
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, i8, kernel, means

#: A first increment beyond so many thresholds is sudden.
SUDDEN = 3.0


class State(Record):
    """State, of the window that is open, or of the last."""

    left: i8 = means("frames that are left of it", "frames")
    exceedances: i8 = means("increments beyond the threshold")
    up: i8 = means("exceedances above zero")
    down: i8 = means("exceedances below zero")
    second_half: i8 = means("exceedances in the second half of the window")
    nis_alarms: i8 = means("frames with an alarm of the innovation", "frames")
    sudden: i8 = means("1: it began far beyond the threshold, without an alarm of the innovation")
    net: f8 = means("sum of all increments", "rad")
    largest: f8 = means("largest exceedance, with its sign", "rad")
    opposite: f8 = means("largest exceedance against that sign", "rad")
    parity_before: f8 = means("parity when it began", "deg")


@kernel
def begin(s: State, length: int, sudden: bool, parity: float) -> None:
    """Open a window.

    Args:
        length: of the window [frames].
        sudden: the first increment is far beyond its threshold, and the innovation is not.
        parity: now [deg].
    """
    s.left = length
    s.exceedances = s.up = s.down = s.second_half = s.nis_alarms = 0
    s.net = s.largest = s.opposite = 0.0
    s.sudden = 1 if sudden else 0
    s.parity_before = parity


@kernel
def _exceed(s: State, length: int, increment: float) -> None:
    """Take an increment beyond the threshold [rad]."""
    s.exceedances += 1
    if increment > 0.0:
        s.up += 1
    else:
        s.down += 1
    if 2 * s.left < length:
        s.second_half += 1
    if abs(increment) > abs(s.largest):
        if increment * s.largest < 0.0:
            s.opposite = abs(s.largest)
        s.largest = increment
    elif increment * s.largest < 0.0:
        s.opposite = max(s.opposite, abs(increment))


@kernel
def update(s: State, length: int, increment: float, exceeds: bool, nis_alarm: int) -> bool:
    """Take one frame of an open window; tells whether it was the last.

    Args:
        length: of the window [frames].
        increment: residual [rad].
        exceeds: it is beyond its threshold.
        nis_alarm: 1: the innovation alarms, 0: not.
    """
    s.left -= 1
    s.net += increment
    if exceeds:
        _exceed(s, length, increment)
    s.nis_alarms += nis_alarm
    return bool(s.left == 0)
