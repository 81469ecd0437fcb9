"""Health of the buses: what they say of themselves, debounced."""

from __future__ import annotations

from typing import Any

from gateway.bus.conditions import LOSS, RUNNING
from gateway.engine.message_checks import start_anew
from gateway.engine.results import tested, witness
from gateway.jit import kernel
from gateway.monitors.bus_health import note


@kernel
def conclude(T: Any, t_ns: int, h: Any) -> None:
    """Debounce the verdicts that the health of a bus has just come to."""
    for k in range(h.fault.shape[0]):
        fault, bit = h.fault[k], 1 << k
        if fault >= 0 and (h.failed | h.passed) & bit:
            failed = h.failed & bit != 0
            place = tested(T, t_ns, fault, failed, h.value if failed else 0.0, h.limit)
            for e in range(h.evidence.shape[0]):
                witness(T, fault, place, e, h.evidence[e] if failed else 0.0)


@kernel
def on_error_frame(T: Any, t_ns: int, bus: int, can_id: int, word: int) -> None:
    """Judge what a bus says of itself."""
    clock = T.clock[0]
    clock.error += 1
    if bus >= T.health.shape[0]:
        return
    h = T.health[bus]
    condition = note(h, t_ns, can_id, word)
    if condition in (LOSS, RUNNING):
        start_anew(T, t_ns, bus, condition)
    conclude(T, t_ns, h)
    clock.deadline_ns = min(clock.deadline_ns, h.deadline_ns)
