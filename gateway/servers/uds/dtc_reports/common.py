"""DTCs, status and severity, as every report has them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from gateway.faults.entries import Entry
from gateway.servers.uds.context import Context
from gateway.servers.uds.nrc import NegativeError, Nrc

#: "All records", where a record is asked for by number.
ALL_RECORDS = 0xFF
#: Handler of one sub-function: takes what follows the sub-function, returns what follows its echo.
Report = Callable[[Context, bytes], bytes]


def status_of(c: Context, entry: Entry) -> int:
    """Return the status byte of a DTC, as far as it is shown."""
    return int(entry.status) & c.params.status_mask


def matching(c: Context, mask: int) -> list[Entry]:
    """Return the DTCs with any of the bits set that are both asked for and shown."""
    return [entry for entry in c.memory.supported() if status_of(c, entry) & mask]


def with_status(c: Context, entries: Iterable[Entry]) -> bytes:
    """Return the codes of DTCs, each with its status byte."""
    return b"".join(bytes(entry.dtc) + bytes([status_of(c, entry)]) for entry in entries)


def available(c: Context) -> bytes:
    """Return the DTCStatusAvailabilityMask."""
    return bytes([c.params.status_mask])


def entry_of_dtc(c: Context, dtc: bytes) -> Entry:
    """Return what is known of a DTC.

    Raises:
        NegativeError: there is none.
    """
    for entry in c.memory.supported():
        if bytes(entry.dtc) == dtc:
            return entry
    raise NegativeError(Nrc.REQUEST_OUT_OF_RANGE)


def severity_of(c: Context, entry: Entry) -> int:
    """Return the severity byte of a DTC: severity and class."""
    return c.memory.definition(entry.fault).severity


def by_severity(c: Context, severity: int, status: int) -> list[Entry]:
    """Return the DTCs with any of the bits of both masks set."""
    return [entry for entry in matching(c, status) if severity_of(c, entry) & severity]


def permanent(c: Context) -> list[Entry]:
    """Return the permanent DTCs, in order of their codes."""
    faults = {permanent.fault for permanent in c.memory.permanent()}
    return sorted((c.memory.entry(fault) for fault in faults), key=lambda entry: entry.dtc)
