"""0x19 ReadDTCInformation (ISO 14229-1, 12.3): everything that the fault memory knows.

DTCs are in the format of SAE J2012-DA with failure type byte (format identifier 0x00, in WWH-OBD 0x04); their order
is that of their codes. The reports of the sub-functions are in ``dtc_reports``.
"""

from __future__ import annotations

from gateway.servers.uds.context import ANY_SESSION, Context, Service
from gateway.servers.uds.dtc_reports import lists, records, user_memory, wwh_obd
from gateway.servers.uds.dtc_reports.common import Report
from gateway.servers.uds.nrc import Nrc, refuse_unless

#: Sub-functions: how many bytes follow each, and its report.
REPORTS: dict[int, tuple[int, Report]] = {
    0x01: (1, lists.number_by_status),
    0x02: (1, lists.by_status),
    0x03: (0, records.snapshot_identification),
    0x04: (4, records.snapshot_by_dtc),
    0x05: (1, records.stored_data),
    0x06: (4, records.extended_data),
    0x07: (2, lists.number_by_severity),
    0x08: (2, lists.by_severity_mask),
    0x09: (3, lists.severity_of_dtc),
    0x0A: (0, lists.supported),
    0x0B: (0, lists.ordered("first_failed", 0)),
    0x0C: (0, lists.ordered("first_confirmed", 0)),
    0x0D: (0, lists.ordered("last_failed", -1)),
    0x0E: (0, lists.ordered("last_confirmed", -1)),
    0x14: (0, lists.fault_detection_counters),
    0x15: (0, lists.permanent_status),
    0x16: (1, records.extended_by_record),
    0x17: (2, user_memory.user_by_status),
    0x18: (5, user_memory.user_snapshot),
    0x19: (5, user_memory.user_extended_data),
    0x1A: (1, records.extended_identification),
    0x42: (3, wwh_obd.wwh_by_mask),
    0x55: (1, wwh_obd.wwh_permanent),
    0x56: (2, wwh_obd.by_readiness_group),
}


def _handle(c: Context, request: bytes) -> bytes:
    number = request[1] & 0x7F
    length, report = REPORTS[number]
    refuse_unless(len(request) == 2 + length, Nrc.INCORRECT_LENGTH)
    c.check_conditions()
    return bytes([number]) + report(c, request[2:])


SERVICE = Service(
    0x19,
    "ReadDTCInformation",
    _handle,
    lambda _: dict.fromkeys(REPORTS, ANY_SESSION),
    shortest=2,
    action="read_dtcs",
)
