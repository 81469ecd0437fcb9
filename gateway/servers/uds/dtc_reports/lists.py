"""Lists and numbers of DTCs: by status and severity, supported, first and most recent, permanent."""

from __future__ import annotations

from gateway.faults.entries import DtcStatus
from gateway.servers.uds.context import Context
from gateway.servers.uds.dtc_reports.common import (
    Report,
    available,
    by_severity,
    entry_of_dtc,
    matching,
    permanent,
    severity_of,
    with_status,
)

#: DTCFormatIdentifier: SAE J2012-DA with failure type byte.
FORMAT = 0x00


def _number(c: Context, dtcs: list[DtcStatus]) -> bytes:
    return available(c) + bytes([FORMAT]) + len(dtcs).to_bytes(2, "big")


def number_by_status(c: Context, rest: bytes) -> bytes:
    """01 reportNumberOfDTCByStatusMask."""
    return _number(c, matching(c, rest[0]))


def by_status(c: Context, rest: bytes) -> bytes:
    """02 reportDTCByStatusMask."""
    return available(c) + with_status(c, matching(c, rest[0]))


def number_by_severity(c: Context, rest: bytes) -> bytes:
    """07 reportNumberOfDTCBySeverityMaskRecord."""
    return _number(c, by_severity(c, rest[0], rest[1]))


def _with_severity(c: Context, dtc: DtcStatus) -> bytes:
    unit = c.memory.definition(dtc.fault).functional_unit
    return bytes([severity_of(c, dtc), unit]) + with_status(c, [dtc])


def by_severity_mask(c: Context, rest: bytes) -> bytes:
    """08 reportDTCBySeverityMaskRecord."""
    found = by_severity(c, rest[0], rest[1])
    return available(c) + b"".join(_with_severity(c, dtc) for dtc in found)


def severity_of_dtc(c: Context, rest: bytes) -> bytes:
    """09 reportSeverityInformationOfDTC."""
    return available(c) + _with_severity(c, entry_of_dtc(c, rest).listed)


def supported(c: Context, _rest: bytes) -> bytes:
    """0A reportSupportedDTC."""
    return available(c) + with_status(c, c.memory.supported())


def ordered(what: str, place: int) -> Report:
    """0B to 0E: the first or most recent DTC to fail, or to be confirmed, since the last clear."""

    def report(c: Context, _rest: bytes) -> bytes:
        found = c.memory.in_order(what)[place:][:1]
        return available(c) + with_status(c, (entry.listed for entry in found))

    return report


def fault_detection_counters(c: Context, _rest: bytes) -> bytes:
    """14 reportDTCFaultDetectionCounter: those on their way, neither passed nor failed."""
    counters = c.control.fault_detection_counters()
    made = b""
    for dtc in c.memory.supported():
        counter = counters.get(dtc.fault, 0)
        if 0 < counter < 127:
            made += (dtc.dtc << 8 | counter).to_bytes(4, "big")
    return made


def permanent_status(c: Context, _rest: bytes) -> bytes:
    """15 reportDTCWithPermanentStatus."""
    return available(c) + with_status(c, permanent(c))
