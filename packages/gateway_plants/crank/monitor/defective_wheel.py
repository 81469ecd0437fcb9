"""What is seen as the configured wheel with a defect: teeth that are missing of it, or a pulse in its gap."""

from __future__ import annotations

from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor.sync_state import Const, State

#: Two pitches are the same within this [pitch].
EQUAL = 0.4
#: Teeth that may be missing of the configured wheel: one may be so by chance where all parts of the turn become equal,
#: two are not (36-1 without a tooth at 120 and at 240 degrees would be what 12-1 shows at three times the speed).
MOST_MISSING = 1
#: Teeth missing beside a gap that are looked for.
MOST_BESIDE = 2
#: A pitch from which on it is a gap, that a pulse can fill [pitch].
LEAST_GAP = 1.3
#: No tooth.
NONE = -1


@kernel
def _missing_at(s: State, c: Const, first: int, parts: int, missing: int) -> int:
    """Lay what is seen, so many times a turn, onto the configured wheel from a tooth on.

    Returns:
        the first tooth that is missing then, :data:`NONE`: it does not fit.
    """
    tooth, left, gone = first, missing, NONE
    for k in range(parts * s.seen.pulses):
        span = s.seen.pitches[k % s.seen.pulses] - c.wheel.nominal[tooth]
        tooth = tooth + 1 if tooth + 1 < c.pulses else 0
        while span > EQUAL and left > 0:
            gone = tooth if gone == NONE else gone
            span -= c.wheel.nominal[tooth]
            tooth = tooth + 1 if tooth + 1 < c.pulses else 0
            left -= 1
        if abs(span) > EQUAL:
            return NONE
    return gone


@kernel
def is_left(s: State, c: Const, whole: float) -> bool:
    """Tell whether what is seen, several times a turn, is the configured wheel without a tooth.

    Opposite to the gap of 12-1 a tooth broken off leaves what 6-1 shows at twice the speed.

    Args:
        s: record of State.
        c: record of Const.
        whole: pitches of the turn that is seen.
    """
    parts = int(c.wheel.whole / whole + 0.5)
    missing = c.pulses - parts * s.seen.pulses
    if abs(parts * whole - c.wheel.whole) > EQUAL or missing < 1 or missing > MOST_MISSING:
        return False
    for first in range(c.pulses):
        if _missing_at(s, c, first, parts, missing) != NONE:
            return True
    return False


@kernel
def left_at(s: State, c: Const, parts: int, missing: int) -> tuple[int, int]:
    """Return two teeth each of which may be the first one missing of the configured wheel; NONE: there is no such one.

    Beside the only gap it is the last tooth before it as well as the first one behind. Another gap tells which.

    Args:
        s: record of State.
        c: record of Const.
        parts: how often a turn has what is seen.
        missing: teeth that a turn lacks.
    """
    one = NONE
    if c.repeats < c.pulses or missing < 1 or missing > MOST_BESIDE:
        return NONE, NONE
    for first in range(c.pulses):
        tooth = _missing_at(s, c, first, parts, missing)
        if tooth != NONE and one == NONE:
            one = tooth
        elif tooth not in (NONE, one):
            return one, tooth
    return one, NONE


@kernel
def filled(s: State, c: Const) -> int:
    """Return the tooth before the gap in which there is a pulse too many in each turn that is seen, -1: there is none.

    A pulse at a third of the gap of 60-2 leaves what 60-1 shows, and fits before and behind: the largest gap counts.
    """
    if s.seen.pulses != c.pulses + 1:
        return -1
    for back in range(c.pulses):
        gap = c.pulses - 1 - back
        if c.wheel.nominal[gap] < LEAST_GAP:
            continue
        for first in range(c.pulses + 1):
            fits, at = True, first
            for k in range(c.pulses):
                span = s.seen.pitches[at]
                at = at + 1 if at + 1 <= c.pulses else 0
                if k == gap:
                    span += s.seen.pitches[at]
                    at = at + 1 if at + 1 <= c.pulses else 0
                if abs(span - c.wheel.nominal[k]) > EQUAL:
                    fits = False
                    break
            if fits:
                return gap
    return -1
