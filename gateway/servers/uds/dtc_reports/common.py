"""DTCs, status and severity, as every report has them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from gateway.faults.entries import DtcStatus, Entry
from gateway.servers.uds.context import Context
from gateway.servers.uds.nrc import NegativeError, Nrc

#: "All records", where a record is asked for by number.
ALL_RECORDS = 0xFF
#: Handler of one sub-function: takes what follows the sub-function, returns what follows its echo.
Report = Callable[[Context, bytes], bytes]


def matching(c: Context, mask: int) -> list[DtcStatus]:
    """Return the DTCs with any of the bits set that are both asked for and shown."""
    return c.memory.supported(mask & c.params.status_mask)


def with_status(c: Context, dtcs: Iterable[DtcStatus]) -> bytes:
    """Return the codes of DTCs, each with its status byte as far as it is shown."""
    shown = c.params.status_mask
    return b"".join((dtc.dtc << 8 | dtc.status & shown).to_bytes(4, "big") for dtc in dtcs)


def available(c: Context) -> bytes:
    """Return the DTCStatusAvailabilityMask."""
    return bytes([c.params.status_mask])


def entry_of_dtc(c: Context, dtc: bytes) -> Entry:
    """Return what is known of a DTC.

    Raises:
        NegativeError: there is none.
    """
    entry = c.memory.entry_of_dtc(int.from_bytes(dtc, "big"))
    if entry is None:
        raise NegativeError(Nrc.REQUEST_OUT_OF_RANGE)
    return entry


def severity_of(c: Context, dtc: DtcStatus) -> int:
    """Return the severity byte of a DTC: severity and class."""
    return c.memory.definition(dtc.fault).severity


def by_severity(c: Context, severity: int, status: int) -> list[DtcStatus]:
    """Return the DTCs with any of the bits of both masks set."""
    return [dtc for dtc in matching(c, status) if severity_of(c, dtc) & severity]


def permanent(c: Context) -> list[DtcStatus]:
    """Return the permanent DTCs, in order of their codes."""
    faults = {permanent.fault for permanent in c.memory.permanent()}
    return sorted(c.memory.entry(fault).listed for fault in faults)
