"""Readiness: have the monitors of each kind run since the last clear, or in this cycle? (J1979 PID 01 and 41, DM5)."""

from __future__ import annotations

from typing import NamedTuple

from gateway.faults.memory import FaultMemory
from gateway.faults.status import Status

#: Bits of byte B of PID 01, the monitors that run all the time; four bits higher: not complete.
CONTINUOUS = {"misfire": 0x01, "fuel_system": 0x02, "components": 0x04}
#: Bits of bytes C (supported) and D (not complete), for spark ignition.
ONCE_A_CYCLE = {
    "catalyst": 0x01,
    "heated_catalyst": 0x02,
    "evaporative_system": 0x04,
    "secondary_air": 0x08,
    "air_conditioning": 0x10,
    "oxygen_sensor": 0x20,
    "oxygen_sensor_heater": 0x40,
    "egr": 0x80,
}


class Readiness(NamedTuple):
    """Bits of the monitors that there are, and of those that have not completed."""

    continuous: int
    continuous_incomplete: int
    others: int
    others_incomplete: int

    @property
    def obd_bytes(self) -> bytes:
        """Bytes B to D of J1979 PID 01 and 41."""
        return bytes(
            [
                self.continuous | self.continuous_incomplete << 4,
                self.others,
                self.others_incomplete,
            ]
        )


def readiness(memory: FaultMemory, *, this_cycle: bool = False) -> Readiness:
    """Return the readiness of the emission related monitors.

    Args:
        memory: the fault memory.
        this_cycle: since the start of the operation cycle, rather than since the last clear.
    """
    waiting = Status.NOT_COMPLETED_THIS_CYCLE if this_cycle else Status.NOT_COMPLETED_SINCE_CLEAR
    found, incomplete = [0, 0], [0, 0]
    for definition in memory.catalogue:
        if not definition.emission_related:
            continue
        for place, bits in enumerate((CONTINUOUS, ONCE_A_CYCLE)):
            bit = bits.get(definition.readiness, 0)
            found[place] |= bit
            if memory.status(definition.id) & waiting:
                incomplete[place] |= bit
    return Readiness(found[0], incomplete[0], found[1], incomplete[1])
