"""Which entry gives way when the memory is full (AUTOSAR DEM, event displacement)."""

from __future__ import annotations

from collections.abc import Iterable

from gateway.faults.catalogue import FaultDefinition
from gateway.faults.records import Record
from gateway.faults.status import Status


def victim(newcomer: FaultDefinition, stored: Iterable[tuple[FaultDefinition, Record]]) -> Record | None:
    """Return the entry that gives way to a new one, None if none may.

    Never a more important one; never an emission related one that asks for the indicator, unless for another of
    these. Among the rest: the least important, of these one that is not failing now, of these the oldest. One of
    the newcomer's own priority that has failed in this operation cycle stays.
    """
    candidates = []
    for definition, record in stored:
        status = Status(record.status)
        protected = definition.emission_related and status & Status.WARNING_INDICATOR
        if protected and not (newcomer.emission_related and newcomer.indicator):
            continue
        equal = definition.priority == newcomer.priority
        if definition.priority < newcomer.priority:
            continue
        if equal and status & Status.TEST_FAILED_THIS_CYCLE:
            continue
        failing = bool(status & Status.TEST_FAILED)
        candidates.append((definition.priority, not failing, -(record.last_failed or 0), record))
    if not candidates:
        return None
    return max(candidates, key=lambda entry: entry[:3])[3]
