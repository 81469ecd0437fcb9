"""The malfunction indicator lamp, the one lamp that legislation knows: lit by what is emission related only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gateway.faults.catalogue import MIL, FaultDefinition
from gateway.faults.records import Record
from gateway.faults.status import Status

_LIT = int(Status.WARNING_INDICATOR)


def lights_mil(definition: FaultDefinition) -> bool:
    """Return whether a fault can ask for the MIL."""
    return definition.emission_related and definition.lamp == MIL


def is_mil_on(records: Iterable[Record], definitions: Mapping[str, FaultDefinition]) -> bool:
    """Return whether one of these records asks for the MIL."""
    lit = (definitions[record.id] for record in records if record.status & _LIT)
    return any(map(lights_mil, lit))
