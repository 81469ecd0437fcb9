"""Signs that the ECUs of a bus have another software than their checks were made for, or are another vehicle's.

A fault, or a stranger, begins at some time. A message that never was as its check says since it came is no fault: the
check is wrong. One sign alone may be a fault that was there before; no fault makes several of them.
"""

from __future__ import annotations

from typing import Any

from gateway.engine.events import OTHER
from gateway.engine.results import announce
from gateway_fdi.jit import kernel

#: Time from the last message that began to come, in which too little is known of a bus [ns].
FIRST_NS = 2_000_000_000
#: Signs that are enough. A length that no frame ever had is as much, and a checksum that no frame ever fitted: a fault
#: would let some through.
ENOUGH = 2
#: An identifier that nobody knows is a sign at this frame, if it came while the bus woke, and is no burst [ns].
STEADY, BURST_NS = 3, 10_000_000


@kernel
def is_other(T: Any, t_ns: int, c: Any, kind: int, weight: int, value: float, limit: float) -> bool:
    """Take that a message never was as its check says since it came; returns whether that is no fault.

    On a bus that does not sleep nothing was learned, and each is one.

    Args:
        T: the tables.
        t_ns: now.
        c: its record of CHECK.
        kind: of its faults.
        weight: signs that it is.
        value: now.
        limit: of the check.
    """
    if c.bus >= T.health.shape[0] - 1 or T.health[c.bus].settle_ns == 0:
        return False
    h = T.health[c.bus]
    if c.signs >> kind & 1 == 0:
        c.signs |= 1 << kind
        h.signs += weight
    if h.signs < ENOUGH:
        return bool(t_ns < h.joined_ns + FIRST_NS)
    if c.told >> kind & 1 == 0:
        c.told |= 1 << kind
        clock = T.clock[0]
        at = clock.events
        announce(T, t_ns, OTHER, c.row, c.bus, value, limit)
        if clock.events > at:
            T.ring[at].result = kind
    return True


@kernel
def note_new(T: Any, t_ns: int, h: Any, s: Any) -> None:
    """Take the frame of an unknown identifier that makes it a sign, where it came while the bus woke."""
    if s.woke == 1 and s.count == STEADY and t_ns - s.first_ns >= BURST_NS:
        h.signs += 1
