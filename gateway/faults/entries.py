"""Outputs of the fault memory: changes of status bytes, and entries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from gateway.faults.catalogue import FaultDefinition
from gateway.faults.dtc import Dtc
from gateway.faults.records import FreezeFrame, Record
from gateway.faults.status import NOT_COMPLETED, STATUS, Status

#: The bits that tell of the fault.
_TOLD = 0xFF & ~int(NOT_COMPLETED)


class DtcChange(NamedTuple):
    """A status byte that changed."""

    definition: FaultDefinition
    old_status: Status
    new_status: Status
    fdc: int
    occurrence: int
    t_ns: int
    evidence: Mapping[str, float | None]

    @property
    def dtc(self) -> Dtc:
        """The fault's DTC."""
        return self.definition.dtc

    @property
    def concerns_fault(self) -> bool:
        """Whether more changed than that the test is complete now."""
        return bool((int(self.old_status) ^ int(self.new_status)) & _TOLD)


#: As a status byte of :class:`Foreseen`: only the verdict itself will tell; it will tell nothing of the fault.
UNKNOWN, UNTOLD = -1, -2


class Foreseen(NamedTuple):
    """A DTC after the next verdict of its test.

    Attributes:
        failed, passed: its status byte after a failure, and after a pass; or UNKNOWN, or UNTOLD.
        occurrence: its failures after a failure.
    """

    failed: int = UNKNOWN
    passed: int = UNKNOWN
    occurrence: int = 0

    @classmethod
    def of(cls, now: int, failed: int, passed: int, occurrence: int) -> Foreseen:
        """Return it, where the status byte is ``now``."""
        told = [after if (now ^ after) & _TOLD else UNTOLD for after in (failed, passed)]
        return cls(told[0], told[1], occurrence)


class DtcStatus(NamedTuple):
    """A DTC with its status byte, as lists have it; cheap, for catalogues of ten thousand faults."""

    dtc: int
    fault: str
    status: int


class DtcState(NamedTuple):
    """A DTC as its frames have it: code, status byte, failures."""

    dtc: int
    status: int
    occurrence: int


@dataclass(frozen=True)
class Entry:
    """One DTC for readers: a copy of its record, and what records hold as numbers.

    Attributes:
        record: the copy.
        dtc: its code.
        status: its status byte.
    """

    record: Record
    dtc: Dtc
    status: Status

    @property
    def fault(self) -> str:
        """Id of the fault."""
        return self.record.id

    @property
    def freeze_frames(self) -> tuple[FreezeFrame, ...]:
        """Its freeze frames, in order of their record numbers."""
        return tuple(frame for _, frame in sorted(self.record.freeze_frames.items()))

    @property
    def listed(self) -> DtcStatus:
        """The entry as lists have it."""
        return DtcStatus(self.record.dtc, self.fault, self.record.status)


def entry_of(record: Record) -> Entry:
    """Return a stored record as an entry."""
    return Entry(record.copy(), Dtc(record.dtc), STATUS[record.status])
