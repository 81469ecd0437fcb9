"""A vehicle's use by OBD (SAE J1979): mode 09, infotype 08, and the PIDs of distance and running time."""

from __future__ import annotations

from gateway.faults.performance import Performance, Ratio
from gateway.faults.usage import Driven

#: Systems of infotype 08, spark ignition, in its order; None: a second bank, or one that has no readiness group here.
_SYSTEMS = ("catalyst", None, "oxygen_sensor", None, "egr", "secondary_air", "evaporative_system", None, None)
#: Data items of infotype 08: general denominator, ignition cycles, then completions and chances of each system.
TRACKED = 2 + 2 * len(_SYSTEMS)
_NONE = Ratio(0, 0)


def tracking(performance: Performance) -> bytes:
    """Return the data of infotype 08, two bytes an item; items that are not monitored are 0."""
    ratios = performance.by_group()
    items = [performance.conditions, performance.ignition_cycles]
    for system in _SYSTEMS:
        items += ratios.get(system or "", _NONE)
    return b"".join(item.to_bytes(2, "big") for item in items)


def driven_pids(since: Driven) -> dict[int, bytes]:
    """Return the PIDs of what is known: km with the MIL on (21) and since the clear (31), minutes likewise (4D, 4E)."""
    found = {
        0x21: (since.lit_m, 1000),
        0x31: (since.cleared_m, 1000),
        0x4D: (since.lit_s, 60),
        0x4E: (since.cleared_s, 60),
    }
    return {
        pid: min(int(value / unit), 0xFFFF).to_bytes(2, "big")
        for pid, (value, unit) in found.items()
        if value is not None
    }
