"""How open engine controllers find the gap: peers, written anew from what their sources do.

These are the synchronisation logic only; the firmware around it (cam, plausible speeds, ignition off while
unsynchronised) catches some of the cases.

* **Ratio logic** (FOME, ``trigger_decoder.cpp``; rusEFI's is of the same origin): a pulse is the synchronisation
  point when the last interval is 0.75 to 1.25 times the gap of the one before, and that 0.75 to 1.25 times the one
  before it. A wrong count at the point, or the wheel's number of pulses without one, drops synchronisation; whatever
  was counted, the next point restores it.
* **Threshold logic** (Speeduino, ``decoders.cpp``, missing tooth): pulses sooner than half the last regular interval
  are not seen (filter 50 %; none directly behind the gap). The gap is an interval longer than 1.5 (one tooth missing)
  or ``m`` times the last one, or comes when more pulses were counted than the wheel has; from 2000 rpm on it is
  looked for in the last quarter of the wheel only. One pulse too few is tolerated. With fewer, synchronisation is
  dropped, but the time of that pulse is not noted: the next interval is measured from before it, is a gap again, and
  its pulse is taken for the first tooth. Behind the gap the gap itself is the last interval.
"""

from __future__ import annotations

from typing import Any

from gateway_fdi.jit import f8, i4, i8, kernel, record, u1

PEER = record(
    synced=u1,
    index=i4,
    count=i4,
    losses=i8,
    y1=f8,
    y2=f8,
    since=f8,
    filter=f8,
    turn=f8,
    revolution=f8,
)

#: Below this speed the threshold logic looks for the gap on the whole wheel: time of a revolution [us].
SLOW_US = 60e6 / 2000.0


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
        point = 0.75 * gap < first < 1.25 * gap and 0.75 < second < 1.25
    s.y2 = s.y1
    s.y1 = y
    s.count += 1
    s.index = s.index + 1 if s.index + 1 < pulses else 0
    if point:
        if s.synced == 1 and s.count != pulses:
            s.synced = 0
            s.losses += 1
        else:
            s.synced = 1
        s.count = 0
        s.index = 0
    elif s.synced == 1 and s.count >= pulses:
        s.synced = 0
        s.losses += 1


@kernel
def threshold(s: Any, pulses: int, gap: float, y: float) -> None:
    """Take an interval [us] by the threshold logic (arguments as for :func:`ratio`)."""
    s.turn += y
    s.since += y
    if s.since < s.filter:
        return
    y = s.since
    s.count += 1
    if s.y1 == 0.0:
        s.y1, s.since = y, 0.0
        return
    slow = s.revolution == 0.0 or s.revolution > SLOW_US
    found = False
    if s.synced == 0 or slow or s.count >= 3 * pulses // 4:
        missing = gap - 1.0
        factor = 1.5 if missing < 1.5 else missing
        found = y > factor * s.y1 or s.count > pulses
    if found and s.synced == 1 and s.count < pulses:
        s.synced = 0
        s.losses += 1
        s.index = 0
        return
    if found:
        s.synced = 1
        s.count = 1
        s.filter = 0.0
        s.revolution, s.turn = s.turn, 0.0
    else:
        s.filter = 0.5 * y
    s.y1, s.since = y, 0.0
    s.index = (s.count - 1) % pulses
