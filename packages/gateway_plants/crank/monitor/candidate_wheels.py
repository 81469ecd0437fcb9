"""Wheels that are made, of as many pitches as the configured one, or of a part of them.

Pulses of such a wheel are also those of the configured one with teeth broken off, or with pulses in its gap, just where
the other wheel has it. A wrong ``wheel`` in the configuration is likelier than that: of 36-1 two teeth of 561 pairs
would have to break, one in 34 and one in 33 of those that leave a gap beside its own. Of a wheel that was once seen
complete it is the defect.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8s, i4, i4s, kernel, means
from gateway_plants.crank.wheel import Wheel
from gateway_plants.crank.wheel_estimation import Seen, fits

#: Wheels that are made, as their pulses show them.
MADE = (
    "60-2", "40-1", "36-1", "36-2", "36-2-1", "36-2-1-1", "36-2-2-2", "36+1", "32-2", "30-1", "30-2", "24-1", "24-2",
    "24+1", "12-1", "12-2", "12-3", "12+1", "8-1", "6-1", "5-1",
)  # fmt: skip
#: Of them that can have as many pitches as one wheel, or a part of them; and the sum of their pulses.
MOST, ROOM = len(MADE), sum(Wheel.parse(text).pulses for text in MADE)
#: Two turns have the same number of pitches within this.
SAME = 0.01


class Const(Record):
    """Constants."""

    count: i4 = means("wheels")
    pulses: Annotated[i4s, MOST] = means("pulses of each wheel")
    pitches: Annotated[f8s, ROOM] = means("pitches of the wheels, one wheel after the other", "pitch")


def prepare(c: Const, wheel: Wheel) -> None:
    """Fill the constants.

    Args:
        c: record of Const.
        wheel: the configured one, which is left out.
    """
    at = 0
    for made in (Wheel.parse(text) for text in MADE):
        parts = wheel.turn / made.turn
        same = made.pitches == wheel.pitches[: wheel.repeats]
        if same or wheel.even or round(parts) < 1 or abs(parts - round(parts)) > SAME:
            continue
        c.pulses[c.count] = made.pulses
        c.pitches[at : at + made.pulses] = np.asarray(made.pitches)
        c.count += 1
        at += made.pulses


@kernel
def shown(c: Const, se: Seen) -> bool:
    """Tell whether the wheel that is seen is one of them, from any pulse on."""
    first = 0
    for k in range(c.count):
        if c.pulses[k] == se.pulses and fits(se, c.pitches[first:], se.pulses):
            return True
        first += c.pulses[k]
    return False
