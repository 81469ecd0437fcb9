"""What is wrong in each turn at a place that is not proven: teeth broken off, pulses too many at some of them.

One fault does not speak against a place, and two different ones do: a wrong place has a pulse missed at the wheel's
gap, and one too many where its own gap should be. Teeth broken off are all missed pulses, and double pulses all added
ones. So faults of one sign, none of them beside a gap, are noted for a turn; when the next turn shows the same ones at
the same teeth, one turn later each, they are of the wheel or the sensor, and no reason to doubt the place.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, i4, i4s, i8s, kernel, means

#: Teeth that have a fault in each turn, at most.
MOST = 16
#: A fault comes again a turn later, give or take so many pulses: where it is decided. Two that are decided together
#: count as the first of them.
NEAR, MOST_LATE = 3, 6
#: Turns that have to show the same teeth missing before two places are told: until then it may be another wheel.
SURE = 3


class Defects(Record):
    """Faults of one turn in their order."""

    count: i4 = means("faults")
    next: i4 = means("the one that has to come again; -1: the first turn is not over")
    turns: i4 = means("turns that have shown all of them again")
    teeth: Annotated[i4s, MOST] = means("tooth of each")
    nets: Annotated[i4s, MOST] = means("pulses missed less those added, of each")
    pulses: Annotated[i8s, MOST] = means("number of the pulse at which each came last")


@kernel
def clear(de: Defects) -> None:
    """Forget all."""
    de.count = 0
    de.next = -1
    de.turns = 0


@kernel
def missing(de: Defects) -> int:
    """Return how many teeth are missing in each turn."""
    total = 0
    for k in range(de.count):
        total += max(de.nets[k], 0)
    return total


@kernel
def of_wheel(de: Defects) -> bool:
    """Tell whether a tooth is missing, or its edge far off, in each turn; a pulse too many need not be the wheel's."""
    for k in range(de.count):
        if de.turns > 0 and de.nets[k] >= 0:
            return True
    return False


@kernel
def knows(de: Defects, tooth: int, net: int) -> bool:
    """Tell whether a fault is one of those that come again in each turn."""
    for k in range(de.count):
        if de.turns > 0 and de.teeth[k] == tooth and de.nets[k] == net:
            return True
    return False


@kernel
def take(de: Defects, pulses: int, tooth: int, net: int, number: int, mixed: bool) -> bool:
    """Take a fault; returns whether it belongs to those that come again in each turn, or to the first turn of them.

    Args:
        de: record of Defects.
        pulses: of one turn of the wheel.
        tooth: of the fault.
        net: pulses missed less those added.
        number: of the pulse.
        mixed: whether pulses missed and added may be of one turn.
    """
    if de.next < 0 and (de.count == 0 or tooth != de.teeth[0]):
        return _add(de, pulses, tooth, net, number, mixed)
    k = max(de.next, 0)
    turn = pulses
    for j in range(de.count):
        turn -= de.nets[j]
    if tooth != de.teeth[k] or abs(number - de.pulses[k] - turn) > MOST_LATE:
        return False
    total = de.nets[k]
    de.pulses[k] = number
    while total != net and k + 1 < de.count:
        k += 1
        total += de.nets[k]
        de.pulses[k] += turn
    if total != net:
        return False
    de.next = k + 1
    if de.next == de.count:
        de.next = 0
        de.turns += 1
    return True


@kernel
def learn(de: Defects, pulses: int, tooth: int, net: int, number: int) -> None:
    """Take a fault of a place that is proven, with the arguments of :func:`take`; it may be of either sign.

    Faults that come again are kept when another one comes. They are given up after two turns without them.
    """
    if take(de, pulses, tooth, net, number, True) or (de.turns > 0 and number - de.pulses[0] <= 2 * pulses):
        return
    clear(de)
    _add(de, pulses, tooth, net, number, True)


@kernel
def passed(de: Defects, pulses: int, tooth: int, number: int, at: int) -> int:
    """Pass over pulses that no frame brought; returns how many teeth they are, with what comes again in each turn.

    Args:
        de: record of Defects.
        pulses: of one turn of the wheel.
        tooth: the latest one.
        number: of the pulses that were lost.
        at: number of the latest pulse.
    """
    if de.turns == 0:
        clear(de)
        return number
    for k in range(de.count):
        de.pulses[k] -= number
    teeth, left = 0, number
    while left > 0:
        tooth = tooth + 1 if tooth + 1 < pulses else 0
        for k in range(de.count):
            net = int(de.nets[k])
            if tooth == (de.teeth[k] if net > 0 else (de.teeth[k] + 1) % pulses):
                de.pulses[k] = at - left
                de.next = (k + 1) % de.count
                teeth += max(net, 0)
                tooth = (tooth + max(net, 0)) % pulses
                left += min(net, 0)
        teeth += 1 if left > 0 else 0
        left -= 1
    return teeth


@kernel
def _add(de: Defects, pulses: int, tooth: int, net: int, number: int, mixed: bool) -> bool:
    """Add a fault of the first turn; returns whether it is one of these."""
    k = int(de.count)
    if k == MOST:
        return False
    if k > 0:
        before, here = (de.teeth[k - 1] - de.teeth[0]) % pulses, (tooth - de.teeth[0]) % pulses
        same_sign = (net > 0) == (de.nets[0] > 0)
        if here <= before or not (same_sign or mixed) or number - de.pulses[0] > pulses + k + NEAR:
            return False
    de.teeth[k], de.nets[k], de.pulses[k] = tooth, net, number
    de.count = k + 1
    return True
