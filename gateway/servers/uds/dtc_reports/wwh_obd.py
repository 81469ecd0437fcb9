"""WWH-OBD and OBD on UDS (ISO 27145-3, SAE J1979-2): DTCs by functional group and by readiness group."""

from __future__ import annotations

from collections.abc import Iterable
from typing import get_args

from gateway.faults.entries import DtcStatus
from gateway.faults.settings import Readiness
from gateway.servers.uds.context import Context
from gateway.servers.uds.dtc_reports.common import available, by_severity, permanent, severity_of, with_status
from gateway.servers.uds.nrc import Nrc, refuse_unless

#: DTCFormatIdentifier: SAE J2012-DA with failure type byte, in WWH-OBD.
WWH_FORMAT = 0x04
#: Readiness groups by number: in the order of the configuration's names (J1979-DA has numbers that are not public).
READINESS_GROUPS = dict(enumerate(get_args(Readiness), start=1))
#: Functional groups of WWH-OBD (ISO 27145-3): emission system, all of them.
EMISSION_GROUP, ALL_GROUPS = 0x33, 0xFF
#: Bits of the severity byte that are filled: severity and class.
SEVERITY_MASK = 0xFF


def _in_group(c: Context, group: int, dtcs: Iterable[DtcStatus]) -> list[DtcStatus]:
    refuse_unless(group in (EMISSION_GROUP, ALL_GROUPS), Nrc.REQUEST_OUT_OF_RANGE)
    return [dtc for dtc in dtcs if group == ALL_GROUPS or c.memory.definition(dtc.fault).emission_related]


def wwh_by_mask(c: Context, rest: bytes) -> bytes:
    """42 reportWWHOBDDTCByMaskRecord: group, status mask, severity mask."""
    group, status, severity = rest
    found = _in_group(c, group, by_severity(c, severity, status))
    made = bytes([group]) + available(c) + bytes([SEVERITY_MASK, WWH_FORMAT])
    for dtc in found:
        made += bytes([severity_of(c, dtc)]) + with_status(c, [dtc])
    return made


def wwh_permanent(c: Context, rest: bytes) -> bytes:
    """55 reportWWHOBDDTCWithPermanentStatus: group."""
    found = _in_group(c, rest[0], permanent(c))
    return rest + available(c) + bytes([WWH_FORMAT]) + with_status(c, found)


def by_readiness_group(c: Context, rest: bytes) -> bytes:
    """56 reportDTCInformationByDTCReadinessGroupIdentifier: functional group, readiness group."""
    group, readiness = rest
    refuse_unless(readiness in READINESS_GROUPS, Nrc.REQUEST_OUT_OF_RANGE)
    name = READINESS_GROUPS[readiness]
    found = [
        dtc for dtc in _in_group(c, group, c.memory.supported()) if c.memory.definition(dtc.fault).readiness == name
    ]
    return bytes([group]) + available(c) + bytes([WWH_FORMAT, readiness]) + with_status(c, found)
