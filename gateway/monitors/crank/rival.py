"""Another place on the wheel that explains a tooth which is missing in each turn as well as the present one does.

A tooth broken off a wheel of N - 1 leaves two equal gaps, half a wheel or any other angle apart: which of them is the
wheel's own, the pulses cannot say. Such a place is not proven, and the other one is told with it. A cam sensor can
decide: its edges fit one of the two.

The pulses that are left are those of the wheel without the tooth. They are laid onto the wheel at each other place: it
is a rival if they fit with exactly one tooth of the wheel missing there, too.
"""

from __future__ import annotations

from gateway.jit import Record, f8s, i4, kernel

#: Two pitches are equal within this [pitch].
EQUAL = 0.15
#: Edges of the cam, more of one place than of the other, that decide.
EDGES = 3
#: There is no rival.
NONE = -1


class Rival(Record):
    """A rival.

    ``tooth`` is missing by the present place, ``other`` by the rival one, which has ``first`` for the tooth behind
    ``tooth``. ``other`` is :data:`NONE` while there is none. ``here``, ``there``: edges of the cam that fitted one of
    them alone.
    """

    tooth: i4
    other: i4
    first: i4
    here: i4
    there: i4


@kernel
def clear(rv: Rival) -> None:
    """There is no rival."""
    rv.other = NONE
    rv.here = 0
    rv.there = 0


@kernel
def _following(tooth: int, pulses: int) -> int:
    """Return the next tooth."""
    return tooth + 1 if tooth + 1 < pulses else 0


@kernel
def _walk(nominal: f8s, pulses: int, missing: int, first: int) -> int:
    """Lay the pulses that are left onto the wheel; returns the one tooth that is missing then, NONE: they do not fit.

    Args:
        nominal: pitches of the wheel.
        pulses: of one turn.
        missing: the tooth that is missing.
        first: where the tooth behind it is laid.
    """
    at, skipped = first, NONE
    tooth = _following(missing, pulses)
    for _ in range(pulses - 1):
        span = nominal[tooth]
        tooth = _following(tooth, pulses)
        if tooth == missing:
            span += nominal[tooth]
        here = nominal[at]
        at = _following(at, pulses)
        if abs(here - span) > EQUAL:
            if skipped != NONE or abs(here + nominal[at] - span) > EQUAL:
                return NONE
            skipped = at
            at = _following(at, pulses)
    return skipped if at == first else NONE


@kernel
def seek(rv: Rival, nominal: f8s, pulses: int, repeats: int, missing: int) -> bool:
    """Look for a rival of a place at which one tooth is missing in each turn; returns whether there is one.

    Args:
        rv: record of Rival.
        nominal: pitches of the wheel.
        pulses: of one turn.
        repeats: pulses after which the wheel's pattern repeats.
        missing: the tooth.
    """
    if rv.other != NONE and rv.tooth == missing:
        return True
    clear(rv)
    rv.tooth = missing
    for shift in range(1, pulses):
        if shift % repeats == 0:
            continue
        first = (missing + 1 + shift) % pulses
        other = _walk(nominal, pulses, missing, first)
        if other != NONE:
            rv.other, rv.first = other, first
            return True
    return False


@kernel
def place_of(rv: Rival, pulses: int, index: int) -> int:
    """Return the tooth that the rival place has for a pulse which is tooth ``index`` by the present one."""
    at = int(rv.first)
    tooth = _following(int(rv.tooth), pulses)
    while tooth != index:
        tooth = _following(tooth, pulses)
        at = _following(at, pulses)
        if at == rv.other:
            at = _following(at, pulses)
    return at


@kernel
def take_edge(rv: Rival, here: bool, there: bool) -> int:
    """Take an edge of the cam; returns 1: it is the present place, 2: the rival, 0: not decided yet.

    Args:
        rv: record of Rival.
        here: whether the edge fits the present place.
        there: whether it fits the rival.
    """
    if here != there:
        rv.here += 1 if here else 0
        rv.there += 1 if there else 0
    if rv.here - rv.there >= EDGES:
        return 1
    return 2 if rv.there - rv.here >= EDGES else 0
