"""The malfunction indicator lamp, the one lamp that legislation knows: lit by what is emission related only."""

from __future__ import annotations

from gateway.faults.catalogue import MIL
from gateway.faults.memory import FaultMemory
from gateway.faults.status import Status


def is_mil_on(memory: FaultMemory) -> bool:
    """Tell whether a DTC asks for the MIL."""
    return any(
        entry.status & Status.WARNING_INDICATOR
        and memory.definition(entry.fault).emission_related
        and memory.definition(entry.fault).lamp == MIL
        for entry in memory.entries()
    )
