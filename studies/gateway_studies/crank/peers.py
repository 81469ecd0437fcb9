"""How open engine controllers find the gap: peers, written from a description of their behaviour.

These are models of the synchronisation logic only; the firmware around it (doubled-edge filters, cam, plausible
speeds) catches some of the cases.

* **Ratio logic** (rusEFI, FOME): a pulse is the synchronisation point when the last interval is 0.75 to 1.25
  times the gap of the one before, and that 0.75 to 1.25 times the one before it. A wrong count at that point, or
  more pulses than the wheel has without one, drops synchronisation; the next gap (with the right count, after
  a wrong one) restores it.
* **Threshold logic** (Speeduino): the gap is an interval longer than 1.5 (one tooth missing) or ``m`` times the
  last. Intervals shorter than half the last one are ignored (noise filter 50 %). From 2000 rpm on it is
  looked for in the last quarter of the wheel only; the counter wraps at the wheel's count in any case.
"""

from __future__ import annotations

from typing import Any

from gateway.jit import f8, i4, i8, kernel, record, u1

PEER = record(
    synced=u1,
    suspect=u1,
    index=i4,
    count=i4,
    losses=i8,
    y1=f8,
    y2=f8,
    held=f8,
)


@kernel
def ratio(s: Any, pulses: int, gap: float, y: float) -> None:
    """Take an interval [us] by the ratio logic.

    Args:
        s: record of PEER.
        pulses: of one revolution.
        gap: the gap's pitches.
        y: interval [us].
    """
    point = False
    if s.y1 > 0.0 and s.y2 > 0.0:
        first, second = y / s.y1, s.y1 / s.y2
        point = 0.75 * gap <= first <= 1.25 * gap and 0.75 <= second <= 1.25
    s.y2 = s.y1
    s.y1 = y
    s.count += 1
    s.index = s.index + 1 if s.index + 1 < pulses else 0
    if point:
        right = s.count == pulses
        if s.synced == 1 and not right:
            s.synced = 0
            s.suspect = 1
            s.losses += 1
        elif s.synced == 0 and (right or s.suspect == 0):
            s.synced = 1
            s.suspect = 0
        s.count = 0
        s.index = 0
    elif s.synced == 1 and s.count > pulses:
        s.synced = 0
        s.suspect = 0
        s.losses += 1


@kernel
def threshold(s: Any, pulses: int, gap: float, y: float) -> None:
    """Take an interval [us] by the threshold logic (arguments as for :func:`ratio`)."""
    y += s.held
    if y < 0.5 * s.y1:
        s.held = y
        return
    s.held = 0.0
    missing = gap - 1.0
    factor = 1.5 if missing < 1.5 else missing
    found = s.y1 > 0.0 and y > factor * s.y1
    # 2000 rpm as the pitch time of this wheel; the gap itself is no measure of it.
    fast = s.y1 > 0.0 and s.y1 * (pulses + missing) < 30_000.0
    if s.synced == 1 and fast and s.count < 3 * pulses // 4:
        found = False
    s.y1 = y / gap if found else y
    s.count += 1
    s.index = s.index + 1 if s.index + 1 < pulses else 0
    if found or (s.synced == 1 and s.count >= pulses):
        if s.synced == 1 and found and s.count < pulses:
            s.synced = 0
            s.losses += 1
        elif found:
            s.synced = 1
        s.count = 0
        s.index = 0
