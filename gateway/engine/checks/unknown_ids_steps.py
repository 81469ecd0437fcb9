"""Takes frames of identifiers that no message of the decode plan has."""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.engine.checks.bus_health import NONE, UNKNOWN, WAKING, heal_later
from gateway.engine.checks.software import note_new
from gateway.engine.events import STRANGER
from gateway.engine.results import announce, report_result, store_evidence
from gateway.engine.timers import arm
from gateway.signals.decode import lookup, of_a_tester
from gateway_fdi.jit import kernel


@kernel
def place_of(strangers: Any, bus: int, can_id: int) -> int:
    """Return the place of an unknown identifier, a free one if it has none; the last one is of all that have none."""
    last = int(strangers.shape[0]) - 1
    for k in range(last):
        s = strangers[k]
        if s.count == 0 or (s.can_id == can_id and s.bus == bus):
            return k
    return last


@kernel
def known_elsewhere(T: Any, bus: int, can_id: int) -> int:
    """Return the number of another bus that knows an identifier, and one; 0: none does."""
    for other in range(T.health.shape[0] - 1):
        if other != bus and lookup(T.known_keys, T.known_rows, other, can_id) >= 0:
            return other + 1
    return 0


@kernel(inlined=False)
def on_unknown_id(T: Any, t_ns: int, bus: int, can_id: int, length: int, words: Any) -> None:
    """Take a frame that is of no message that is decoded: nobody knows it, or nobody needs it."""
    if bus >= T.health.shape[0] - 1:
        return
    h = T.health[bus]
    if h.unknown == NONE or of_a_tester(can_id) or lookup(T.known_keys, T.known_rows, bus, can_id) >= 0:
        return
    place = place_of(T.strangers, bus, can_id)
    s = T.strangers[place]
    if s.count == 0:
        s.bus, s.can_id, s.length, s.first_ns, s.word = bus, can_id, length, t_ns, words[0]
        s.elsewhere, s.tell = known_elsewhere(T, bus, can_id), 1
        s.woke = 1 if h.activity == WAKING else 0
    s.count += 1
    if s.woke == 1:
        note_new(T, t_ns, h, s)
    if s.count >= s.tell:
        s.tell *= 10
        announce(T, t_ns, STRANGER, place, bus, float(s.count), 0.0)
    fault = h.fault[UNKNOWN]
    if fault < 0:
        return
    at = report_result(T, t_ns, fault, True, float(s.count), 0.0)
    store_evidence(T, fault, at, 0, float(can_id & 0x1FFFFFFF))
    store_evidence(T, fault, at, 1, float(words[0] & np.uint64(0xFFFFFFFF)))
    store_evidence(T, fault, at, 2, float(words[0] >> np.uint64(32)))
    store_evidence(T, fault, at, 3, float(length))
    store_evidence(T, fault, at, 4, float(s.elsewhere))
    heal_later(h, UNKNOWN, t_ns)
    arm(T, h.timer, h.deadline_ns)
