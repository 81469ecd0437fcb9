"""The place on a wheel of equal pitches: its pulses do not tell it, the edges of a cam sensor do.

Of a wheel of P pulses a turn a pulse may be any of the 2 P of a working cycle. Each edge of the cam leaves those at
which one of its edges, of that level, is told to be. When the edges of a whole cycle, three at least, leave one tooth,
that is the place. Where none is left the count begins again: a pulse was missed, or there is no such wheel.

So the cam also counts: between an edge and the same one a cycle later 2 P pulses pass. Another number, again and again,
is another wheel; but not one that a cam with a multiple, or a part, of the edges told would count.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8s, i4, kernel, means, u1s
from gateway_plants.crank.monitor import cam
from gateway_plants.crank.wheel import MOST_TEETH

#: Edges that have to leave one tooth, at least.
EDGES = 3
#: Cycles in a row in which another number of pulses says that it is another wheel, and how far from a whole number the
#: pulses of a cycle may be.
CYCLES, WHOLE = 8, 0.3
#: No tooth yet.
NONE = -1


class Phase(Record):
    """What the cam's edges have left."""

    edges: i4 = means("edges that were taken")
    at: i4 = means("place of the next of numbers")
    known: i4 = means("how many of numbers are known")
    cycle: i4 = means("pulses of the last cycle")
    same: i4 = means("cycles in a row of so many pulses")
    possible: Annotated[u1s, 2 * MOST_TEETH] = means("1: this pulse may be the first of the cycle, as it is counted")
    numbers: Annotated[f8s, cam.MOST_EDGES] = means("pulses at the last edges, with the part of a pitch behind them")


@kernel
def restart(ph: Phase) -> None:
    """Each pulse may be any tooth again; what the cycles have counted stays."""
    ph.edges = 0


@kernel
def take(ph: Phase, c: cam.Const, teeth: int, place: float, level: int, slack: float) -> int:
    """Take an edge; returns by how many teeth the count has to be put on, :data:`NONE`: not known yet.

    Args:
        ph: record of Phase.
        c: record of cam.Const.
        teeth: of one turn.
        place: of the edge in the cycle, as it is counted [pitch].
        level: after it.
        slack: by which the edge may be farther off than the cam's tolerance [deg].
    """
    cycle = 2 * teeth
    left, found, unique = 0, NONE, True
    for d in range(cycle):
        if ph.edges > 0 and ph.possible[d] == 0:
            continue
        fits = cam.fits_cycle(c, (place + d) * 360.0 / teeth, level, slack)
        ph.possible[d] = 1 if fits else 0
        if fits:
            unique = unique and (left == 0 or d % teeth == found)
            found = d % teeth
            left += 1
    ph.edges += 1
    if left == 0:
        restart(ph)
        return NONE
    if not unique or ph.edges < max(EDGES, c.edges):
        return NONE
    restart(ph)
    return int(found)


@kernel
def count(ph: Phase, c: cam.Const, number: float) -> int:
    """Count the pulses of a cycle; returns them when :data:`CYCLES` in a row had as many, 0: they did not.

    Args:
        ph: record of Phase.
        c: record of cam.Const.
        number: of the pulse before the edge, modulo 65536, with the part of a pitch since.
    """
    if ph.known == c.edges:
        pulses = (number - ph.numbers[ph.at]) % 65536.0
        whole = int(pulses + 0.5)
        if abs(pulses - whole) > WHOLE:
            ph.same = 0
        elif whole == ph.cycle:
            ph.same += 1
        else:
            ph.cycle, ph.same = whole, 1
    else:
        ph.known += 1
    ph.numbers[ph.at] = number
    ph.at = ph.at + 1 if ph.at + 1 < c.edges else 0
    return int(ph.cycle) if ph.same >= CYCLES * c.edges else 0


@kernel
def forget(ph: Phase) -> None:
    """The engine stands, or numbers of pulses were lost: nothing is counted yet."""
    restart(ph)
    ph.known = 0
    ph.at = 0
    ph.same = 0


@kernel
def another(pulses: int, teeth: int) -> bool:
    """Return whether the pulses of a cycle are those of another wheel, and of no cam with other edges.

    Args:
        pulses: of a cycle.
        teeth: of one turn of the wheel that is configured.
    """
    cycle = 2 * teeth
    return bool(pulses > 1 and pulses % 2 == 0 and pulses % cycle != 0 and cycle % pulses != 0)
